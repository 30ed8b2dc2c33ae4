"""Noise of data that are compared with a model which holds only roughly."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.frf import FRF
from updyn.updating.problem.noise.known import NoiseModel, Wrapping

__all__ = ["Approximate"]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]


@dataclass(frozen=True, slots=True, eq=False)
class Approximate(Wrapping):
    """Noise to which the error of an approximate model is added, as far as it is known beforehand.

    What a search weighs by it counts as far as the model resolves it. The noise itself, which a fit
    in a better model goes by, is left as it is.

    Parameters
    ----------
    base : NoiseModel
        The noise.
    share : ndarray of float, shape (n_i, n_j)
        Error of the model in each channel, over the largest |H| of the line.
    """

    base: NoiseModel
    share: NDArray[np.float64]

    @property
    def scale_known(self) -> bool:
        """Whether the variance of the noise is known absolutely."""
        return self.base.scale_known

    def beforehand(self, frf: FRF) -> _Real:
        """Return that of the noise and the squared error of the model, shape (n_f, n_i, n_j)."""
        level = np.abs(frf.values).max(axis=(1, 2), keepdims=True)
        return np.asarray(self.base.beforehand(frf) + (self.share * level) ** 2)

    def variance(self, H: _Complex, frf: FRF) -> _Real:
        """Return that of the noise, shape (n_f, n_i, n_j)."""
        return self.base.variance(H, frf)

    def unlikelihood(self, H: _Complex, frf: FRF) -> float:
        """Return that of the noise."""
        return self.base.unlikelihood(H, frf)

    def refit(self, H: _Complex, frf: FRF, n_parameters: int) -> Approximate:
        """Return the model with its noise refitted to the residual frf - H."""
        return replace(self, base=self.base.refit(H, frf, n_parameters))

    def figures(self) -> dict[str, Any]:
        """Return those of the noise."""
        return self.base.figures()
