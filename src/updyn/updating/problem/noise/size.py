"""Probability of a misfit under noise of known size."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["size_p"]

#: Number of real values over which the errors of a noise level estimated from averages are
#: correlated.
_SHARED = 32.0


def size_p(
    square: ArrayLike, count: ArrayLike, freedom: ArrayLike, averages: int | None
) -> NDArray[np.float64]:
    """Return the probability that noise causes sums of squares at least as large.

    All arrays have the same shape.

    Parameters
    ----------
    square : ndarray of float, any shape
        Sums of squares of real and imaginary parts of residuals, each divided by its standard
        deviation.
    count : ndarray of float, same shape
        Number of real values in each sum.
    freedom : ndarray of float, same shape
        `count` less the number of unknowns fitted to these values, at least 1.
    averages : int or None
        Number of averages from which the noise level of each line was estimated; None: it is known
        exactly.

    Notes
    -----
    If the noise is known exactly, the sum has the chi-square distribution with `freedom` degrees of
    freedom. If it is estimated from n averages, the mean has the F distribution with n - 1 times
    `count` as second degrees of freedom, but with `count` at most that of sixteen lines: smoothing
    correlates the errors of the noise level over more lines.
    """
    from scipy.special import chdtrc, fdtrc  # slow to import and rarely needed

    if averages is None:
        return np.asarray(chdtrc(freedom, square))
    known = np.clip(count, 1.0, _SHARED) * max(averages - 1, 1)
    return np.asarray(fdtrc(freedom, known, np.asarray(square) / freedom))
