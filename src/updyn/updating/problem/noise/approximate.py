"""Noise of data that are compared with an approximate model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.frf import FRF
from updyn.updating.problem.noise.known import NoiseModel, WrappedNoise

__all__ = ["Approximate"]


@dataclass(frozen=True, slots=True, eq=False)
class Approximate(WrappedNoise):
    """Noise plus the known error of a model, as a share of the largest |H| of the line.

    The error is included in the variance before a fit (`initial_variance`), which weights a search.
    The noise itself, which a fit with a better model uses, is unchanged.
    """

    base: NoiseModel
    share: RealArray

    @property
    def scale_known(self) -> bool:
        """Whether the variance of the noise is known absolutely."""
        return self.base.scale_known

    def initial_variance(self, frf: FRF) -> RealArray:
        """Return E|dH|^2 of noise and model error before a fit, shape (n_f, n_i, n_j)."""
        level = np.abs(frf.values).max(axis=(1, 2), keepdims=True)
        return np.asarray(self.base.initial_variance(frf) + (self.share * level) ** 2)

    def variance(self, H: ComplexArray, frf: FRF) -> RealArray:
        """Return E|dH|^2 of the noise, shape (n_f, n_i, n_j)."""
        return self.base.variance(H, frf)

    def negative_log_likelihood(self, H: ComplexArray, frf: FRF) -> float:
        """Return the negative log-likelihood under the noise, up to a constant."""
        return self.base.negative_log_likelihood(H, frf)

    def refit(self, H: ComplexArray, frf: FRF, n_parameters: int) -> Approximate:
        """Return the model with its noise refitted to the residual frf - H."""
        return replace(self, base=self.base.refit(H, frf, n_parameters))

    def figures(self) -> dict[str, Any]:
        """Return the numbers of the noise."""
        return self.base.figures()
