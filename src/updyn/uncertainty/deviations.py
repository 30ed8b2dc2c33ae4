"""Standard deviations of unknowns from a reduced Jacobian."""

from __future__ import annotations

import numpy as np

from updyn.arrays import RealArray
from updyn.updating.judge.identifiability import analyse_identifiability
from updyn.updating.problem.coordinates import Coordinates

__all__ = ["find_deviations"]


def find_deviations(R: RealArray, coordinates: Coordinates, x: RealArray) -> dict[str, float]:
    """Return the standard deviation of each unknown with the priors; inf for undetermined ones.

    `R`, (k, n), is by the optimiser's coordinates, in standard deviations of the noise.
    """
    names = list(coordinates.parameters.names)
    analysis = analyse_identifiability(np.vstack([R, np.diag(coordinates.prior[1])]), names)
    std = np.sqrt(np.diag(analysis.covariance)) * np.abs(coordinates.slope(x))
    std[analysis.involved] = np.inf
    return dict(zip(names, std.tolist(), strict=True))
