"""Sparse solves with complex symmetric matrices of one pattern, by a backend that can be chosen, each checked.

Adding a backend is one module with ``available()`` and a class that analyses a pattern and factorises matrices of it,
and one line in `BACKENDS`.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from updyn.errors import OptionError, SolverError, suggest

__all__ = [
    "BACKENDS",
    "LARGEST_GROWTH",
    "Backend",
    "SparseSolver",
    "check_backend",
    "growth",
    "singular_message",
]

_Solve = Callable[[NDArray[np.complex128]], NDArray[np.complex128]]


class Backend(Protocol):
    """A pattern, analysed once."""

    def factor(self, A: Any) -> _Solve:
        """Factorise a matrix of the pattern; return what solves with it. Raises RuntimeError if it cannot."""


#: By name, best first: module and class.
BACKENDS: dict[str, tuple[str, str]] = {
    "pardiso": ("updyn.linalg.pardiso", "Pardiso"),
    "superlu": ("updyn.linalg.superlu", "SuperLU"),
}
#: Tried where another backend fails; it pivots freely.
_FALLBACK = "superlu"

_RESIDUAL = 1e-8

#: A solution that outgrows its right-hand side by this has lost 12 of its 16 digits: the matrix counts as singular.
LARGEST_GROWTH = 1e12


def check_backend(name: str | None) -> str:
    """Return the backend to use: the one named, else the best that is installed.

    Raises
    ------
    OptionError
        If there is none of that name, or it is not installed.
    """
    if name is None:
        return next(b for b in BACKENDS if _module(b).available())
    if name not in BACKENDS:
        raise OptionError(f"backend {name!r}: {suggest(str(name), BACKENDS)}")
    if not _module(name).available():
        raise OptionError(f"backend {name!r} is not installed; pip install 'updyn[mkl]' (x86_64), or use 'superlu'")
    return name


def _module(name: str) -> Any:
    return importlib.import_module(BACKENDS[name][0])


@dataclass(slots=True, eq=False)
class SparseSolver:
    """Solve with matrices of one pattern; the analysis is kept between calls.

    Parameters
    ----------
    backend : str
        One of `BACKENDS`.
    """

    backend: str
    _analysed: dict[str, Backend] = field(default_factory=dict, init=False)
    _pattern: tuple[NDArray[Any], NDArray[Any]] | None = field(default=None, init=False)

    def solve(self, A: Any, B: NDArray[np.complex128], freq: float, held: str = "") -> NDArray[np.complex128]:
        """Solve A X = B and check the answer.

        Parameters
        ----------
        A : sparse CSC, shape (n, n), complex symmetric
            Matrix.
        B : ndarray of complex, shape (n, r)
            Right-hand sides.
        freq : float
            The line in Hz, for messages.
        held : str
            Which DOFs are held, for messages.

        Returns
        -------
        ndarray of complex, shape (n, r)

        Raises
        ------
        SolverError
            If A is singular to rounding, or the residual |A X - B| exceeds 1e-8 of |A| |X| even after one step of
            refinement and with another backend.
        """
        self._forget_other_pattern(A)
        names = [self.backend] if self.backend == _FALLBACK else [self.backend, _FALLBACK]
        left = np.inf
        for name in names:
            try:
                X, left = self._refined(name, A, B)
            except RuntimeError:
                left = np.inf
                continue
            if left <= _RESIDUAL:
                if not growth(A.diagonal(), X, B) <= LARGEST_GROWTH:
                    raise SolverError(singular_message(freq, held))
                return X
        if np.isinf(left):
            raise SolverError(singular_message(freq, held))
        raise SolverError(f"{name}: residual {left:.1e} at {freq:g} Hz; the matrix is singular there or nearly so")

    def _refined(self, name: str, A: Any, B: NDArray[np.complex128]) -> tuple[NDArray[np.complex128], float]:
        if name not in self._analysed:
            self._analysed[name] = getattr(_module(name), BACKENDS[name][1])(A)
        run = self._analysed[name].factor(A)
        X = run(B)
        left = _backward_error(A, X, B)
        if not left <= _RESIDUAL:
            X = X + run(B - A @ X)
            left = _backward_error(A, X, B)
        return X, left

    def _forget_other_pattern(self, A: Any) -> None:
        known = self._pattern
        same = known is not None and (
            (known[0] is A.indptr and known[1] is A.indices)
            or (np.array_equal(known[0], A.indptr) and np.array_equal(known[1], A.indices))
        )
        if not same:
            self._analysed.clear()
            self._pattern = (A.indptr, A.indices)


def growth(
    diagonal: NDArray[np.complex128], X: NDArray[np.complex128], B: NDArray[np.complex128]
) -> NDArray[np.float64]:
    """Return how far the solution of A X = B outgrows its right-hand side, whatever the units.

    Parameters
    ----------
    diagonal : ndarray of complex, shape (..., n)
        Of A; the roots of its sizes scale rows and columns, so that translations and rotations compare.
    X, B : ndarray of complex, shape (..., n, r)
        Solution and right-hand sides.

    Returns
    -------
    ndarray of float, shape (...)
        Largest over the columns; about a lower bound of the condition number of the scaled matrix.
    """
    scale = np.sqrt(np.abs(diagonal))
    # A DOF without an entry of its own cannot be compared; a small scale errs towards not complaining.
    scale = np.maximum(scale, 1e-8 * scale.max(axis=-1, keepdims=True))[..., None]
    with np.errstate(divide="ignore", invalid="ignore"):
        grown = (np.abs(X) * scale).max(axis=-2) / (np.abs(B) / scale).max(axis=-2)
    # 0 / 0: a column without load.
    return np.asarray(
        np.where(np.isfinite(X).all(axis=-2), np.nan_to_num(grown, nan=0.0), np.inf).max(axis=-1, initial=0)
    )


def singular_message(freq: float, held: str = "") -> str:
    """Say which line could not be solved and what to do."""
    if freq == 0.0:
        why = "the structure is free to move there. Leave the line out or support the structure"
    else:
        why = "a natural frequency without damping. Leave the line out or give the groups a loss factor"
    return f"the dynamic stiffness {held}is singular at {freq:g} Hz: {why}"


def _backward_error(A: Any, X: NDArray[np.complex128], B: NDArray[np.complex128]) -> float:
    residual = np.abs(A @ X - B).max(initial=0.0)
    scale = abs(A) @ np.abs(X) + np.abs(B)
    return float(residual / max(scale.max(initial=0.0), np.finfo(float).tiny))
