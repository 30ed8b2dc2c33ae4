"""Probability of a misfit under noise of known size."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import RealArray
from updyn.updating.problem.noise.settings import SMOOTH_VARIANCE

__all__ = ["size_p_value"]


def size_p_value(
    square: ArrayLike, count: ArrayLike, freedom: ArrayLike, averages: int | None
) -> RealArray:
    """Return the probability that noise causes whitened sums of squares at least as large."""
    # Chi-square with `freedom` (`count` less fitted unknowns, at least 1) degrees of freedom for
    # noise known exactly (`averages` None). Else F with n - 1 times `count` as second degrees of
    # freedom, `count` at most that of sixteen lines: smoothing correlates errors of the noise
    # level.
    from scipy.special import chdtrc, fdtrc  # slow to import and rarely needed

    if averages is None:
        return np.asarray(chdtrc(freedom, square))
    known = np.clip(count, 1.0, SMOOTH_VARIANCE.correlated_values) * max(averages - 1, 1)
    return np.asarray(fdtrc(freedom, known, np.asarray(square) / freedom))
