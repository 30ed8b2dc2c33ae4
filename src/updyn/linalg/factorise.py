"""Sparse solves with symmetric matrices of one pattern, complex or real, by a backend that can be chosen, each checked.

Adding a backend is one module with ``available()`` and a class that analyses a pattern and
factorises matrices of it, and one line in `BACKENDS`.
"""

from __future__ import annotations

import importlib
import weakref
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from updyn.errors import OptionError, SolverError, suggest
from updyn.linalg.check import (
    LARGEST_GROWTH,
    LARGEST_PROBE_GROWTH,
    RESIDUAL,
    accuracy,
    growth,
    probe_load,
    singular_message,
    unit_scale,
)

__all__ = [
    "BACKENDS",
    "LARGEST_GROWTH",
    "Backend",
    "Factorised",
    "Factors",
    "SparseSolver",
    "check_backend",
    "growth",
    "singular_message",
]


class Factors(Protocol):
    """A factorised matrix; valid until its backend factorises another."""

    @property
    def negative(self) -> int | None:
        """Number of negative eigenvalues of a real matrix; None where it is not known."""

    def __call__(self, B: NDArray[Any], /) -> NDArray[Any]:
        """Solve for right-hand sides of the matrix's kind, shape (n, r)."""


class Backend(Protocol):
    """A pattern, analysed once, for complex matrices or (`real`) real ones."""

    def __init__(self, pattern: Any, *, real: bool = False) -> None: ...

    @property
    def peak_bytes(self) -> int | None:
        """Largest memory of the library so far, the factor included (estimated before `factor`); None: not known."""

    def factor(self, A: Any) -> Factors:
        """Factorise a matrix of the pattern. Raises RuntimeError if it cannot, MemoryError if memory is short."""

    def release(self) -> None:
        """Give the memory back; the object is of no more use."""


#: By name, best first: module and class. Where one fails, those after it are tried.
BACKENDS: dict[str, tuple[str, str]] = {
    "pardiso": ("updyn.linalg.pardiso", "Pardiso"),
    "mumps": ("updyn.linalg.mumps", "Mumps"),
    "superlu": ("updyn.linalg.superlu", "SuperLU"),
}

_INSTALL = {
    "pardiso": "pip install 'updyn[mkl]' (x86_64)",
    "mumps": (
        "install the library MUMPS (Debian: libmumps-seq-dev), then pip install 'updyn[mumps]'"
    ),
}


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
        raise OptionError(f"backend {name!r} is not installed; {_INSTALL[name]}, or use 'superlu'")
    return name


def _module(name: str) -> Any:
    return importlib.import_module(BACKENDS[name][0])


@dataclass(slots=True, eq=False)
class SparseSolver:
    """Solve with matrices of one pattern; the analysis is kept between calls.

    Only one factorisation is alive at a time: its memory serves the next.

    Parameters
    ----------
    backend : str
        One of `BACKENDS`.
    real : bool
        Matrices are real (and may be indefinite) instead of complex: 2.5 times faster, in half the
        memory.

    Attributes
    ----------
    used : dict
        How many solves each backend answered; another than `backend` only where that one failed.
    refined : int
        How many of them needed a step of refinement.
    """

    backend: str
    real: bool = field(default=False, kw_only=True)
    used: dict[str, int] = field(default_factory=dict, init=False)
    refined: int = field(default=0, init=False)
    _analysed: dict[str, Backend] = field(default_factory=dict, init=False)
    _pattern: tuple[NDArray[Any], NDArray[Any]] | None = field(default=None, init=False)
    _alive: weakref.ref[Factorised] | None = field(default=None, init=False)

    def __reduce__(self) -> tuple[Any, ...]:
        # In another process it begins anew: what a library holds cannot be sent there.
        return partial(SparseSolver, real=self.real), (self.backend,)

    def solve(self, A: Any, B: NDArray[Any], freq: float, held: str = "") -> NDArray[Any]:
        """Solve A X = B once and check the answer.

        Parameters
        ----------
        A : sparse CSC, shape (n, n), symmetric, of the solver's kind
            Matrix; sorted, with a full diagonal.
        B : ndarray, shape (n, r)
            Right-hand sides.
        freq : float
            The line in Hz, for messages.
        held : str
            Which DOFs are held, for messages.

        Returns
        -------
        ndarray of A's kind, shape (n, r)

        Raises
        ------
        SolverError
            If A is singular to rounding, memory is short, or the residual |A X - B| of a column
            exceeds 1e-8 of
            |A| |X| + |B| even after one step of refinement and with the other backends.
        """
        factorised = self.factorise(A, freq, held)
        try:
            return factorised.solve(B)
        finally:
            self._retire()

    def factorise(self, A: Any, freq: float, held: str = "") -> Factorised:
        """Factorise A for right-hand sides that come later; an earlier factorisation ends.

        Parameters
        ----------
        A : sparse CSC, shape (n, n), symmetric, of the solver's kind
            Matrix; sorted, with a full diagonal. Not to be changed while it is solved with.
        freq : float
            The line or shift in Hz, for messages.
        held : str
            Which DOFs are held, for messages.

        Returns
        -------
        Factorised

        Raises
        ------
        SolverError
            If A is singular, or memory is short.
        TypeError
            If A is not of the solver's kind.
        """
        if np.iscomplexobj(A) == self.real:
            raise TypeError(
                f"a {'real' if self.real else 'complex'} solver was given a matrix of {A.dtype}"
            )
        self._retire()
        self._forget_other_pattern(A)
        made = Factorised(self, A, freq, held)
        self._alive = weakref.ref(made)
        return made

    @property
    def peak_bytes(self) -> int | None:
        """Largest memory of the backends in use, the factor included; None where they do not say."""
        known = [b for backend in self._analysed.values() if (b := backend.peak_bytes) is not None]
        return max(known, default=None)

    def release(self) -> None:
        """Give all memory back now; a later call analyses anew."""
        self._retire()
        for backend in self._analysed.values():
            backend.release()
        self._analysed.clear()
        self._pattern = None

    def _retire(self) -> None:
        alive = None if self._alive is None else self._alive()
        if alive is not None:
            alive._factors = None
        self._alive = None

    def _factor(self, name: str, A: Any) -> Factors:
        if name not in self._analysed:
            self._analysed[name] = getattr(_module(name), BACKENDS[name][1])(A, real=self.real)
        return self._analysed[name].factor(A)

    def _forget(self, name: str) -> None:
        """Free a backend that failed, before another needs the memory."""
        failed = self._analysed.pop(name, None)
        if failed is not None:
            failed.release()

    def _forget_other_pattern(self, A: Any) -> None:
        known = self._pattern
        same = known is not None and (
            (known[0] is A.indptr and known[1] is A.indices)
            or (np.array_equal(known[0], A.indptr) and np.array_equal(known[1], A.indices))
        )
        if not same:
            self.release()
            self._pattern = (A.indptr, A.indices)


class Factorised:
    """A factorised matrix, made by `SparseSolver.factorise`; valid until that solver factorises another."""

    __slots__ = (
        "_A",
        "__weakref__",
        "_factors",
        "_line",
        "_name",
        "_names",
        "_probed",
        "_scale",
        "_solver",
    )

    def __init__(self, solver: SparseSolver, A: Any, freq: float, held: str) -> None:
        names = list(BACKENDS)
        self._solver, self._A, self._line = solver, A, (freq, held)
        self._scale = unit_scale(A.diagonal())
        self._names: Iterator[str] = iter(names[names.index(solver.backend) :])
        self._factors: Factors | None = None
        self._name = ""
        # A real matrix is shifted to just beside an eigenvalue on purpose.
        self._probed = solver.real
        if not self._factored_by_next():
            raise SolverError(singular_message(freq, held))

    @property
    def negative(self) -> int | None:
        """How many eigenvalues of a real A are negative (Sylvester's law of inertia); None where it is not known.

        For A = K - omega^2 M with M positive definite: how many natural frequencies lie below
        omega.
        """
        return self._current().negative

    def solve(self, B: NDArray[Any]) -> NDArray[Any]:
        """Solve A X = B and check the answer.

        Parameters
        ----------
        B : ndarray, shape (n, r)
            Right-hand sides.

        Returns
        -------
        ndarray of A's kind, shape (n, r)

        Raises
        ------
        SolverError
            As `SparseSolver.solve`.
        RuntimeError
            If the solver has factorised another matrix since, or was released.
        """
        self._current()
        if self._solver.real and np.iscomplexobj(B):
            raise TypeError("a real solver was given complex right-hand sides")
        n, r = B.shape
        if self._probed:
            B = np.asfortranarray(B, dtype=np.float64 if self._solver.real else np.complex128)
        else:
            loads = np.empty((n, r + 1), dtype=np.complex128, order="F")
            loads[:, :r], loads[:, r:] = B, probe_load(self._scale)
            B = loads
        while True:
            try:
                X, left, grown = self._refined(B)
            except RuntimeError:
                left = np.inf
            if left <= RESIDUAL:
                break
            name = self._name
            if not self._factored_by_next():
                if np.isinf(left):
                    raise SolverError(singular_message(*self._line))
                where = f"residual {left:.1e} at {self._line[0]:g} Hz"
                raise SolverError(f"{name}: {where}; the matrix is singular there or nearly so")
        if not (grown[:r] <= LARGEST_GROWTH).all() or not (grown[r:] <= LARGEST_PROBE_GROWTH).all():
            raise SolverError(singular_message(*self._line))
        self._probed = True
        self._solver.used[self._name] = self._solver.used.get(self._name, 0) + 1
        return X[:, :r]

    def _refined(self, B: NDArray[Any]) -> tuple[NDArray[Any], float, NDArray[np.float64]]:
        """Return the solution, its largest backward error and the growth of each column.

        Columns that are off are corrected once.
        """
        run = self._current()
        X = run(B)
        errors, grown = accuracy(self._A, self._scale, X, B)
        off = ~(errors <= RESIDUAL)
        if off.any():
            with np.errstate(invalid="ignore", over="ignore"):
                X[:, off] += run(np.asfortranarray(B[:, off] - self._A @ X[:, off]))
            errors[off], grown[off] = accuracy(self._A, self._scale, X[:, off], B[:, off])
            self._solver.refined += 1
        return X, float(errors.max(initial=0.0)), grown

    def _factored_by_next(self) -> bool:
        """Factorise with the next backend that can; False if none is left."""
        self._factors = None
        if self._name:
            self._solver._forget(self._name)
        for name in self._names:
            if not _module(name).available():
                continue
            try:
                self._factors, self._name = self._solver._factor(name, self._A), name
            except RuntimeError:
                self._solver._forget(name)
                continue
            except MemoryError as error:
                # Others need no less, and would end the process instead.
                what = f"{name}: not enough memory to factorise {self._A.shape[0]} DOFs"
                raise SolverError(f"{what} ({error})" if str(error) else what) from error
            return True
        return False

    def _current(self) -> Factors:
        if self._factors is None:
            raise RuntimeError(
                "this factorisation has ended: its solver has factorised another matrix, or was"
                " released"
            )
        return self._factors
