"""Matrices and loads of double precision, for factors in single precision."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["in_range", "solved"]


def in_range(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the values of a matrix that were rounded to single precision.

    Raises
    ------
    RuntimeError
        If one is beyond its range.
    """
    if not np.isfinite(values).all():
        raise RuntimeError("values beyond the range of single precision")
    return values


def solved(
    solve: Callable[[NDArray[np.float32]], NDArray[Any]], B: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Solve for loads, whatever their size: they are worked on as columns of size 1.

    Parameters
    ----------
    solve : callable
        Solves in single precision.
    B : ndarray of float, shape (n, r)
        Right-hand sides.

    Returns
    -------
    ndarray of float, shape (n, r)
    """
    # A power of two, so that nothing is rounded.
    scale = np.ldexp(1.0, np.frexp(np.abs(B).max(axis=0, initial=0.0))[1])
    loads = np.empty(B.shape, dtype=np.float32, order="F")
    np.divide(B, scale, out=loads, casting="same_kind")
    return np.asarray(np.multiply(solve(loads), scale, dtype=np.float64))
