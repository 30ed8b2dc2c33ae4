"""What a noise model offers, and what several of them share."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from updyn.frf import FRF

__all__ = ["ASSUMED", "SMALLEST", "NoiseModel", "level_by_unit", "two_part"]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]

#: Relative noise below this is rounding; it keeps the weights of exact data finite.
SMALLEST = 1e-12

#: Noise that is assumed where neither the user nor the data say how large it is.
ASSUMED = {"relative": 0.05, "floor": 0.001}


class NoiseModel(Protocol):
    """What a noise model offers."""

    @property
    def kind(self) -> str:
        """How the noise is known."""

    @property
    def scale_known(self) -> bool:
        """Whether the variance is known absolutely, or only up to one factor."""

    def variance(self, H: _Complex, frf: FRF) -> _Real:
        """Return E|dH|^2 of each value for a model's H, shape (n_f, n_i, n_j), in the unit of the data squared."""

    def refit(self, H: _Complex, frf: FRF, n_parameters: int) -> NoiseModel:
        """Return the noise model after a look at the residual; the same where nothing is estimated."""

    def figures(self) -> dict[str, Any]:
        """Return what is stated or was estimated, for the record."""


def level_by_unit(frf: FRF) -> _Real:
    """Return the rms of |H_X| over all data of one unit (translation or rotation), shape (1, n_i, n_j)."""
    rows, columns = frf.responses.axes >= 3, frf.references.axes >= 3
    kind = 2 * rows[:, None] + columns[None, :]
    squared = np.mean(np.abs(frf.values) ** 2, axis=0)
    level = np.zeros(kind.shape)
    for k in np.unique(kind):
        level[kind == k] = np.sqrt(np.mean(squared[kind == k]))
    return np.asarray(np.maximum(level, np.finfo(float).tiny ** 0.25)[None])


def two_part(relative: float | _Real, floor: float | _Real, H: _Complex, level: _Real) -> _Real:
    """Return (relative |H|)^2 + (floor level)^2, shape (n_f, n_i, n_j)."""
    return np.asarray((relative * np.abs(H)) ** 2 + (np.maximum(floor, SMALLEST) * level) ** 2)
