"""Draws of the unknowns from the covariance of an update, a Gaussian in its coordinates."""

from __future__ import annotations

import numpy as np

from updyn.arrays import BoolArray, RealArray
from updyn.updating.problem.coordinates import Coordinates
from updyn.updating.result import UpdateResult

__all__ = ["draw_normal", "draw_values", "name_undetermined"]


def name_undetermined(result: UpdateResult) -> str:
    """Return the names of the unknowns without a standard deviation, the first six of them."""
    unsure = [p.name for p in result.parameters if not np.isfinite(result.std[p.name])]
    few = ", ".join(unsure[:6])
    return few + f" and {len(unsure) - 6} more" if len(unsure) > 6 else few


def draw_normal(size: int, n: int, seed: int) -> RealArray:
    """Return standard normal draws, (n, size); a row does not depend on n."""
    z = np.empty((n, size))
    for number in range(n):
        z[number] = np.random.default_rng((seed, number)).standard_normal(size)
    return z


def draw_values(result: UpdateResult, z: RealArray) -> tuple[RealArray, BoolArray]:
    """Return the values of the unknowns at standard normal draws, (n, n_p), and which are clipped.

    Draws beyond a bound are clipped to it.
    """
    parameters = result.parameters
    coordinates = Coordinates(parameters)
    x = coordinates.to_x(np.array([result.values[name] for name in parameters.names]))
    slope = coordinates.slope(x)
    size, axes = np.linalg.eigh(result.covariance / slope / slope[:, None])
    # The symmetric root does not depend on the sign or order of eigenvectors.
    root = (axes * np.sqrt(np.maximum(size, 0.0))) @ axes.T
    drawn = x + z @ root
    within = np.clip(drawn, *coordinates.bounds)
    found = np.clip(coordinates.to_values(within), parameters.lower, parameters.upper) + 0.0
    return found, drawn != within
