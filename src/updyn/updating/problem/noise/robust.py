"""Noise with outliers: Student's t distribution by iterative reweighting."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.frf import FRF
from updyn.updating.problem.noise.known import NoiseModel, WrappedNoise
from updyn.updating.problem.noise.settings import ROBUST_NOISE

__all__ = ["Robust"]


@dataclass(frozen=True, slots=True, eq=False)
class Robust(WrappedNoise):
    """Noise model with Student's t distribution instead of the Gaussian one.

    The weight of a residual is (nu + 2) / (nu + 2 |r|^2 / v), updated together with the noise
    (Lange, Little & Taylor, J. Am. Stat. Assoc. 84 (1989) 881, section 3); an estimated level is
    scaled so that the median of |r|^2 is Gaussian. Weights are divided by a common number so that
    the weighted Jacobian gives the covariance of an M-estimate, E psi^2 / (E psi')^2 (Huber, Robust
    Statistics, 1981, eq. 6.4 of chapter 7). `weight` divides the variance; `factor` scales a level
    not known.
    """

    base: NoiseModel
    factor: float = 1.0
    weight: RealArray | None = None
    outliers: dict[str, Any] = field(default_factory=dict)
    name: ClassVar[str] = "student-t"

    @property
    def scale_known(self) -> bool:
        """True: the level is known after the first refit."""
        return True

    @property
    def bulk(self) -> NoiseModel:
        """The noise without outliers."""
        return self.base

    @property
    def heavy_tails(self) -> bool:
        """True: outliers have less weight."""
        return True

    def variance(self, H: ComplexArray, frf: FRF) -> RealArray:
        """Return E|dH|^2 divided by the weights, shape (n_f, n_i, n_j)."""
        plain = self.factor * self.base.variance(H, frf)
        if self.weight is None or self.weight.shape != plain.shape:
            return plain
        return plain / self.weight

    def negative_log_likelihood(self, H: ComplexArray, frf: FRF) -> float:
        """Return the negative log-likelihood of Student's distribution, up to a constant."""
        v = self.factor * self.base.variance(H, frf)
        power = np.abs(frf.values - H) ** 2 / v
        nu = ROBUST_NOISE.freedoms
        tails = (0.5 * nu + 1.0) * np.log1p(2.0 / nu * power)
        return float(np.sum(np.log(v) + tails))

    def refit(self, H: ComplexArray, frf: FRF, n_parameters: int) -> Robust:
        """Return the model with weights from the residual frf - H."""
        base = self.base.refit(H, frf, n_parameters)
        if 2 * H.size <= n_parameters:  # no degrees of freedom
            return Robust(base)
        squared = np.abs(frf.values - H) ** 2 * H.size / (H.size - 0.5 * n_parameters)
        power = squared / base.variance(H, frf)  # |r|^2 / v
        bulk = float(np.median(power) / np.log(2.0))
        is_estimated = not base.scale_known or base.source == "estimated"
        factor = bulk if is_estimated and bulk > 0.0 else 1.0
        power = power / factor
        nu = ROBUST_NOISE.freedoms
        weight = (nu + 2.0) / (nu + 2.0 * power)
        # Slope of psi: the mean over the real and the imaginary part.
        slope = nu / (nu + 2.0) * float(np.mean(weight**2))
        spread = float(np.mean(weight**2 * power)) / slope**2
        level = max(float(np.mean(weight)) * spread, 1e-12)
        small = weight * nu / (nu + 2.0) < ROBUST_NOISE.small_weight
        reported = ROBUST_NOISE.reported_share
        channels = []
        for i, j in np.argwhere(small.mean(axis=0) >= reported):
            channels.append(f"{frf.responses[i]} / {frf.references[j]}")
        outliers = {
            "robust": self.name,
            "chi_square": 1.0 if is_estimated else bulk,
            "down_weighted": float(np.mean(small)),
            "down_weighted_lines": frf.freq[small.mean(axis=(1, 2)) >= reported].tolist(),
            "down_weighted_channels": channels,
        }
        return replace(self, base=base, factor=factor, weight=weight / level, outliers=outliers)

    def figures(self) -> dict[str, Any]:
        """Return the numbers of the noise without outliers, and the down-weighted values."""
        plain = self.base.figures()
        scale = float(np.sqrt(self.factor))
        level: dict[str, Any] = {}
        for key in ("relative", "floor"):
            if key in plain:
                level[key] = float(plain[key] * scale)
        for key in ("relative_by_channel", "floor_by_channel"):
            if key in plain:
                level[key] = {name: value * scale for name, value in plain[key].items()}
        return {**plain, **level, **self.outliers}
