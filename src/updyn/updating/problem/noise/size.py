"""How likely noise of known size is to leave a misfit as large."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["size_p"]

#: Real numbers over which the errors of a noise level that was estimated from averages extend.
_SHARED = 32.0


def size_p(
    square: ArrayLike, count: ArrayLike, freedom: ArrayLike, averages: int | None
) -> NDArray[np.float64]:
    """Return how likely noise makes sums of squares as large.

    Parameters
    ----------
    square : ndarray of float, any shape
        Sums of squares of residuals over the standard deviation of their real and of their
        imaginary part.
    count : ndarray of float, same shape
        Number of real values in each.
    freedom : ndarray of float, same shape
        The same less the unknowns that were fitted to them, at least 1.
    averages : int or None
        Number of averages from which the size of the noise was estimated by line; None: it is known
        exactly.

    Returns
    -------
    ndarray of float, same shape

    Notes
    -----
    Of noise that is known exactly the sum has the chi-square distribution with `freedom` degrees of
    freedom. From n averages its mean has the F distribution, with n - 1 times as many degrees of
    freedom as values, but no more than sixteen lines have: smoothing correlates the errors of the
    size over more.
    """
    from scipy.special import chdtrc, fdtrc  # slow to load, and seldom needed

    if averages is None:
        return np.asarray(chdtrc(freedom, square))
    known = np.clip(count, 1.0, _SHARED) * max(averages - 1, 1)
    return np.asarray(fdtrc(freedom, known, np.asarray(square) / freedom))
