"""Sparse solves with a complex symmetric matrix, by a backend that can be chosen.

Adding a backend is one function ``(matrix, right_hand_sides) -> solution`` and one line in `BACKENDS`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.errors import OptionError, SolverError, suggest

__all__ = ["BACKENDS", "LARGEST_GROWTH", "check_backend", "growth", "solve"]


def _superlu(A: Any, B: NDArray[np.complex128]) -> NDArray[np.complex128]:
    from scipy.sparse.linalg import splu

    # Minimum degree on A + A^T with nearly diagonal pivots: 1.6 x faster than the default ordering on solids.
    lu = splu(A, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.001, options={"SymmetricMode": True})
    return np.asarray(lu.solve(B))


BACKENDS: dict[str, Callable[[Any, NDArray[np.complex128]], NDArray[np.complex128]]] = {"superlu": _superlu}

_RESIDUAL = 1e-8

#: A solution that outgrows its right-hand side by this has lost 12 of its 16 digits: the matrix counts as singular.
LARGEST_GROWTH = 1e12


def check_backend(name: str | None) -> str:
    """Return the backend to use.

    Raises
    ------
    OptionError
        If there is none of that name.
    """
    if name is None:
        return "superlu"
    if name not in BACKENDS:
        raise OptionError(f"backend {name!r}: {suggest(str(name), BACKENDS)}")
    return name


def solve(A: Any, B: NDArray[np.complex128], backend: str, freq: float, held: str = "") -> NDArray[np.complex128]:
    """Solve A X = B and check the answer.

    Parameters
    ----------
    A : sparse CSC, shape (n, n), complex symmetric
        Matrix.
    B : ndarray of complex, shape (n, r)
        Right-hand sides.
    backend : str
        One of `BACKENDS`.
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
        refinement.
    """
    run = BACKENDS[backend]
    try:
        X = run(A, B)
        if not _backward_error(A, X, B) <= _RESIDUAL:
            X = X + run(A, B - A @ X)
    except RuntimeError:
        raise SolverError(singular_message(freq, held)) from None
    if not (error := _backward_error(A, X, B)) <= _RESIDUAL:
        raise SolverError(f"{backend}: residual {error:.1e} at {freq:g} Hz; the matrix is singular there or nearly so")
    # A factorisation is backward stable: a singular matrix shows in the size of the solution, not in the residual.
    if not growth(A.diagonal(), X, B) <= LARGEST_GROWTH:
        raise SolverError(singular_message(freq, held))
    return X


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
