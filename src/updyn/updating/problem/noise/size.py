"""Probability of a misfit under noise of known size."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["size_p_value"]

#: Number of real values over which the errors of a noise level estimated from averages are
#: correlated.
_SHARED = 32.0


def size_p_value(
    square: ArrayLike, count: ArrayLike, freedom: ArrayLike, averages: int | None
) -> NDArray[np.float64]:
    """Return the probability that noise causes sums of squares at least as large.

    `square` are sums of squares of the real and imaginary parts of residuals, each divided by its
    standard deviation; `count` is the number of real values in each, and `freedom` this number less
    that of the unknowns fitted to them, at least 1. All have one shape.

    If the noise is known exactly (`averages` None), the sum has the chi-square distribution with
    `freedom` degrees of freedom. If its level at each line is estimated from n averages, the mean
    has the F distribution with n - 1 times `count` as second degrees of freedom, but with `count`
    at most that of sixteen lines: smoothing correlates the errors of the noise level over more
    lines.
    """
    from scipy.special import chdtrc, fdtrc  # slow to import and rarely needed

    if averages is None:
        return np.asarray(chdtrc(freedom, square))
    known = np.clip(count, 1.0, _SHARED) * max(averages - 1, 1)
    return np.asarray(fdtrc(freedom, known, np.asarray(square) / freedom))
