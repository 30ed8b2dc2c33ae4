"""Conversion of matrices and loads of double precision for factors in single precision."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from updyn.arrays import NumberArray, RealArray

__all__ = ["round_to_single", "solve_scaled"]


def round_to_single(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return values rounded to single precision; raises RuntimeError if one is beyond its range."""
    if not np.isfinite(values).all():
        raise RuntimeError("values beyond the range of single precision")
    return values


def solve_scaled(solve: Callable[[NDArray[np.float32]], NumberArray], B: RealArray) -> RealArray:
    """Return the solution for loads of any magnitude, which are scaled to columns of size 1."""
    # Powers of two, so scaling causes no rounding.
    scale = np.ldexp(1.0, np.frexp(np.abs(B).max(axis=0, initial=0.0))[1])
    loads = np.empty(B.shape, dtype=np.float32, order="F")
    np.divide(B, scale, out=loads, casting="same_kind")
    return np.asarray(np.multiply(solve(loads), scale, dtype=np.float64))
