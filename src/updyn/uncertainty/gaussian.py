"""The Gaussian that the likelihood looks like about a minimum."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from updyn.uncertainty.likelihood import Likelihood, Point

__all__ = ["Gaussian", "furthest"]

_Vector = NDArray[np.float64]


class Gaussian:
    """Mean and root of the covariance about a minimum; what the data leave open is limited by the bounds.

    Parameters
    ----------
    likelihood : Likelihood
        Whose bounds they are.
    top : Point
        The minimum.
    """

    def __init__(self, likelihood: Likelihood, top: Point) -> None:
        lower, upper = likelihood.bounds
        # A flat density between bounds has the variance width^2 / 12.
        R = np.vstack([top.local.R, np.diag(np.sqrt(12.0) / (upper - lower))])
        _, s, Vt = np.linalg.svd(R, full_matrices=False)
        self.mean = top.x
        self.root: NDArray[np.float64] = Vt.T / s
        self.log_volume = float(-np.sum(np.log(s)))

    def at(self, z: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points, shape (m, n), for standard normal numbers of that shape."""
        return np.asarray(self.mean + z @ self.root.T)


def furthest(X: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return the points that lie furthest from the middle of all, shape (count, n), in standard deviations.

    Parameters
    ----------
    X : ndarray of float, shape (m, n)
        Points.
    count : int
        How many; fewer where there are not so many.
    """
    centred = X - X.mean(axis=0)
    _, s, Vt = np.linalg.svd(centred, full_matrices=False)
    keep = s > 1e-10 * max(float(s[0]), np.finfo(float).tiny)
    distance = np.linalg.norm(centred @ (Vt[keep].T / s[keep]), axis=1)
    return np.asarray(X[np.argsort(-distance, kind="stable")[:count]])
