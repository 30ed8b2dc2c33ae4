"""Misfit by which faults are compared: the log error of values above the noise."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, Self, TypeVar

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, RealArray
from updyn.frf import FRF
from updyn.settings import ROUNDING
from updyn.updating.judge.causes.settings import CAUSE_MISFIT
from updyn.updating.judge.settings import SIGNIFICANCE
from updyn.updating.problem.noise import level_by_unit

__all__ = [
    "WeightedData",
    "add_perfect_fit",
    "add_resolution",
    "compute_log_misfit",
    "count_values",
    "find_weightless",
    "remove_weight",
]

_Real = TypeVar("_Real", float, RealArray)


@dataclass(frozen=True, slots=True, eq=False, init=False)
class WeightedData(FRF):
    """Data near the response of a model, weighted by likelihood.

    The misfit of a value is its error in standard deviations times `relative_noise`, which is that
    of the most exact values.
    """

    relative_noise: float

    def __init__(self, *about: Any, relative_noise: float, **further: Any) -> None:
        FRF.__init__(self, *about, **further)
        object.__setattr__(self, "relative_noise", relative_noise)

    @classmethod
    def near_response(cls, H: ComplexArray, frf: FRF, variance: RealArray) -> Self:
        """Return the data with the variance of their noise, near the response H of a model."""
        level = np.abs(H)
        is_seen = level > ROUNDING.receptance_share * level.max()
        share = np.sqrt(variance[is_seen]) / level[is_seen]
        exact = np.quantile(share, CAUSE_MISFIT.exact_quantile) if share.size else 1.0
        return cls.of(frf, variance, float(exact))

    @classmethod
    def of(cls, frf: FRF, variance: RealArray, relative_noise: float) -> Self:
        """Return the data with the variance of their noise, and the resolution of sensors."""
        field_values = {one.name: getattr(frf, one.name) for one in fields(FRF)}
        field_values["variance"] = add_resolution(variance, frf)
        return cls(relative_noise=relative_noise, **field_values)

    def __reduce__(self) -> tuple[object, ...]:
        field_values = {one.name: getattr(self, one.name) for one in fields(self)}
        return _rebuild, (type(self), field_values)

    @property
    def misfit_scale(self) -> RealArray:
        """Misfit of an error of 1 in each value."""
        return self.relative_noise / _compute_deviation(self)

    def misfit(self, H: ComplexArray) -> tuple[ComplexArray, RealArray]:
        """Return w (H_X / H_A - 1) and w, as `compute_log_misfit`."""
        scale, size = self.misfit_scale, np.abs(H)
        unit = np.where(size > 0.0, H.conj(), 1.0) / np.where(size > 0.0, size, 1.0)
        return scale * (self.values - H) * unit, scale * size


def _rebuild(cls: type[WeightedData], field_values: dict[str, Any]) -> WeightedData:
    return cls(**field_values)


def compute_log_misfit(H: ComplexArray, frf: FRF) -> tuple[ComplexArray, RealArray]:
    """Return w ln(H_X / H_A) and w, shape (n_f, n_i, n_j); by likelihood for `WeightedData`."""
    # Unlike the residual of a fit, it includes values that are above the noise in the model only
    # or in the data only, as with exchanged channels of a structure with uncoupled directions.
    # Values below three standard deviations of the noise are set to this level, without a phase.
    if isinstance(frf, WeightedData):
        return frf.misfit(H)
    noise = _compute_deviation(frf)
    least = SIGNIFICANCE.stds * noise
    size = [np.abs(H), np.abs(frf.values)]
    is_seen = [one > least for one in size]
    level = [np.log(np.maximum(one, least)) for one in size]
    phase = np.where(is_seen[0] & is_seen[1], np.angle(frf.values * H.conj()), 0.0)
    clear = np.maximum(np.maximum(*size) ** 2 - least**2, 0.0)
    weight = np.sqrt(clear / (clear + (noise / CAUSE_MISFIT.clear_noise) ** 2))
    return weight * (level[1] - level[0] + 1j * phase), weight


def count_values(frf: FRF) -> int:
    """Return the number of real values with weight; those above the noise, or of `WeightedData`."""
    if isinstance(frf, WeightedData):
        return 2 * int(np.count_nonzero(~find_weightless(frf)))
    clear = np.abs(frf.values) > SIGNIFICANCE.stds * _compute_deviation(frf)
    return 2 * int(np.count_nonzero(clear))


def add_perfect_fit(mean_square: _Real) -> _Real:
    """Return a mean square misfit plus that of a perfect fit, so that it has a logarithm."""
    return mean_square + CAUSE_MISFIT.perfect_rms**2


def remove_weight(frf: FRF, mask: BoolArray) -> FRF:
    """Return the data in which some values have no weight; the mask may omit the lines."""
    assert frf.variance is not None
    large = CAUSE_MISFIT.weightless_variance * float(np.abs(frf.values).max()) ** 2
    return replace(frf, variance=np.where(mask, large, frf.variance))


def find_weightless(frf: FRF) -> BoolArray:
    """Return which values have no weight: their variance is above all squared values."""
    assert frf.variance is not None
    return np.asarray(frf.variance > np.abs(frf.values).max() ** 2)


def add_resolution(variance: RealArray, frf: FRF) -> RealArray:
    """Return the variance of the noise of data, with that of the resolution of sensors."""
    return np.asarray(variance + (CAUSE_MISFIT.sensor_resolution * level_by_unit(frf)) ** 2)


def _compute_deviation(frf: FRF) -> RealArray:
    """Return the standard deviation of the noise of each value."""
    assert frf.variance is not None
    return np.sqrt(frf.variance)
