"""Is an answer of a factorisation right? Tests that cost little beside the factorisation and the solve."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "LARGEST_GROWTH",
    "LARGEST_PROBE_GROWTH",
    "RESIDUAL",
    "accuracy",
    "growth",
    "probe_load",
    "singular_message",
    "unit_scale",
]

#: Backward error above which an answer is not accepted.
RESIDUAL = 1e-8

#: A solution that outgrows its right-hand side by this has lost 12 of its 16 digits: the matrix
#: counts as singular.
LARGEST_GROWTH = 1e12

#: The same for a load that excites every mode (`probe_load`). At a natural frequency that is hit to
#: rounding it grows by 1e14 or more, by an amount that depends on the kernel of BLAS. The forces of
#: a test may grow by less than 1e12 there, if they excite that mode little.
LARGEST_PROBE_GROWTH = 1e13

#: Columns that are checked by one combination of them.
_BLOCK = 64

#: Entries of a matrix that BLAS multiplies with a vector in one thread (OpenBLAS: up to 9216).
_ALONE = 8192
#: Numbers that are worked on at a time, so that they stay in the cache.
_CACHED = 2**15


def unit_scale(diagonal: NDArray[Any]) -> NDArray[np.float64]:
    """Return the roots of the sizes of a diagonal: rows and columns divided by them compare, whatever their units.

    Parameters
    ----------
    diagonal : ndarray of float or complex, shape (..., n)
        Of the matrix; N/m or N m/rad on its rows.

    Returns
    -------
    ndarray of float, shape (..., n)
        A DOF without an entry of its own cannot be compared; it gets 1e-8 of the largest, 1 if all
        are zero.
    """
    scale = np.sqrt(np.abs(diagonal))
    largest = scale.max(axis=-1, keepdims=True, initial=0.0)
    return np.asarray(np.where(largest > 0, np.maximum(scale, 1e-8 * largest), 1.0))


def growth(diagonal: NDArray[Any], X: NDArray[Any], B: NDArray[Any]) -> NDArray[np.float64]:
    """Return how far the solution of A X = B outgrows its right-hand side, whatever the units.

    Parameters
    ----------
    diagonal : ndarray of complex, shape (..., n)
        Of A; scales rows and columns, so that translations and rotations compare.
    X, B : ndarray of complex, shape (..., n, r)
        Solution and right-hand sides.

    Returns
    -------
    ndarray of float, shape (...)
        Largest over the columns; about a lower bound of the condition number of the scaled matrix.
    """
    scale = unit_scale(diagonal)[..., None]
    grown = _grown((np.abs(X) * scale).max(axis=-2), (np.abs(B) / scale).max(axis=-2))
    return np.asarray(grown.max(axis=-1, initial=0))


def probe_load(scale: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return a load that excites every mode: entries of random phase, as large as their rows.

    Parameters
    ----------
    scale : ndarray of float, shape (..., n)
        `unit_scale` of the matrix.

    Returns
    -------
    ndarray of complex, shape (..., n, 1)
        The same on every call; its `growth` is close to the condition number of the scaled matrix.
    """
    phase = 2j * np.pi * np.random.default_rng(0).random(scale.shape[-1])
    return np.asarray(np.exp(phase) * scale)[..., None]


def accuracy(
    A: Any, scale: NDArray[np.float64], X: NDArray[Any], B: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Judge the answer of A X = B at the cost of about one column in 64.

    The residual of a random combination of the columns is looked at (Freivalds, 1977), each
    weighted by its size so that a small column counts as much as a large one. Only where it is
    suspicious is every column looked at.

    Parameters
    ----------
    A : sparse, shape (n, n)
        Matrix.
    scale : ndarray of float, shape (n,)
        Its `unit_scale`.
    X, B : ndarray, shape (n, r)
        Solution and right-hand sides.

    Returns
    -------
    errors : ndarray of float, shape (r,)
        Normwise backward error of each column, or a bound of it, in the scaled DOFs:
        max |A x - b| / max (|A| |x| + |b|). Not a number where the solution is not.
    grown : ndarray of float, shape (r,)
        As `growth`, by column, to a factor of 1.4.
    """
    errors, grown = np.zeros(X.shape[1]), np.zeros(X.shape[1])
    absolute = None
    for first in range(0, X.shape[1], _BLOCK):
        part = slice(first, first + _BLOCK)
        x, b = X[:, part], B[:, part]
        solved, load = _sizes(x, scale), _sizes(b, 1.0 / scale)
        grown[part] = _grown(solved, load)
        with np.errstate(
            invalid="ignore", over="ignore"
        ):  # what is not a number stays so, and is found
            bound = _combined(A, scale, x, b, solved + load)
            if not bound <= RESIDUAL:
                absolute = abs(A) if absolute is None else absolute
                residual = (np.abs(A @ x - b) / scale[:, None]).max(axis=0, initial=0.0)
                size = ((absolute @ np.abs(x) + np.abs(b)) / scale[:, None]).max(
                    axis=0, initial=0.0
                )
                bound = residual / np.maximum(size, _TINY)
        errors[part] = bound
    return errors, grown


_TINY = np.finfo(float).tiny


def _combined(
    A: Any, scale: NDArray[np.float64], x: NDArray[Any], b: NDArray[Any], size: NDArray[np.float64]
) -> np.float64:
    """Return a bound of the backward errors of some columns, from that of one random combination of them."""
    r = len(size)
    weight = np.random.default_rng(0).uniform(0.5, 1.5, r) / np.maximum(size, _TINY)
    y, c = _times(x, weight), _times(b, weight)
    # |A| |y| is at least the diagonal's part of it, which spares |A|.
    error = (np.abs(A @ y - c) / scale).max(initial=0.0)
    # One column's weight is at least a third of each other's.
    return np.float64(
        3
        * r
        * error
        / max((np.abs(y) * scale).max(initial=0.0), (np.abs(c) / scale).max(initial=_TINY))
    )


def _times(X: NDArray[Any], weight: NDArray[np.float64]) -> NDArray[Any]:
    """Return X @ weight, in pieces so small that BLAS keeps to one thread.

    More would wait for the cores on which the threads of the solver still spin.
    """
    step = max(1, _ALONE // len(weight))
    return np.concatenate([X[i : i + step] @ weight for i in range(0, len(X), step)])


def _sizes(X: NDArray[Any], scale: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the largest scaled entry of each column, real and imaginary parts apart: three times as fast."""
    if np.iscomplexobj(X):
        scale = np.repeat(scale, 2)
    columns = np.asfortranarray(X).T.view(np.float64)
    step = max(1, _CACHED // len(scale))
    pieces = [columns[i : i + step] for i in range(0, len(columns), step)]
    return np.concatenate([(np.abs(piece) * scale).max(axis=1, initial=0.0) for piece in pieces])


def _grown(solved: NDArray[np.float64], load: NDArray[np.float64]) -> NDArray[np.float64]:
    with np.errstate(divide="ignore", invalid="ignore"):
        grown = solved / load
    # 0 / 0: a column without load.
    return np.where(np.isfinite(solved), np.nan_to_num(grown, nan=0.0), np.inf)


def singular_message(freq: float, held: str = "") -> str:
    """Say which line could not be solved and what to do."""
    if freq == 0.0:
        why = "the structure is free to move there. Leave the line out or support the structure"
    else:
        why = (
            "a natural frequency without damping. Leave the line out or give the groups a loss"
            " factor"
        )
    return f"the dynamic stiffness {held}is singular at {freq:g} Hz: {why}"
