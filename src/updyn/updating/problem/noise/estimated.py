"""Noise models that are estimated from the residual during a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, TypeAlias

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, NumberArray, RealArray
from updyn.frf import FRF
from updyn.updating.problem.noise.known import (
    ASSUMED,
    Assumed,
    NoiseModel,
    Stated,
    level_by_unit,
    two_part_variance,
)
from updyn.updating.problem.noise.neighbours import estimate_scatter
from updyn.updating.problem.noise.settings import ESTIMATED_NOISE, LINE_SCATTER, NOISE_LIMITS

__all__ = [
    "Estimated",
    "EstimatedByChannel",
    "fit_two_numbers",
    "ratio_range",
]

#: Pairs of response label and noise floor.
Floors: TypeAlias = "tuple[tuple[str, float], ...]"


@dataclass(frozen=True, slots=True)
class Estimated(NoiseModel):
    """Noise with E|dH|^2 = (relative |H|)^2 + (floor rms)^2, both estimated from the residual.

    Both maximise the likelihood of the residual, corrected for the fitted unknowns; model error
    counts as noise. With fewer than 30 degrees of freedom (`spare`) the likelihood would mistake
    small residuals for a lack of noise: one scale is estimated, at a ratio in the middle of
    `ratio_range`. `tails` are the degrees of freedom of Student's distribution (inf: Gaussian);
    `common_floor` and the deviating `own_floors` come from the scatter of neighbouring lines.
    """

    relative: float = np.nan
    floor: float = np.nan
    tails: float = np.inf
    common_floor: float = 0.0
    own_floors: Floors = ()
    spare: int | None = None
    kind: ClassVar[str] = "estimated from the residual"
    source: ClassVar[str] = "estimated"

    @classmethod
    def of_data(cls, frf: FRF, tails: float = np.inf) -> Estimated:
        """Return the model before the first residual."""
        common_floor, own_floors = estimate_floors(frf)
        return cls(tails=tails, common_floor=common_floor, own_floors=own_floors)

    def initial_variance(self, frf: FRF) -> RealArray:
        """Return the square of the floor of neighbouring lines, shape (n_f, n_i, n_j)."""
        return _squared_floors(self.common_floor, self.own_floors, frf)

    def variance(self, H: ComplexArray, frf: FRF) -> RealArray:
        """Return E|dH|^2, shape (n_f, n_i, n_j)."""
        return two_part_variance(self.relative, self.floor, H, level_by_unit(frf))

    def refit(self, H: ComplexArray, frf: FRF, n_parameters: int) -> Estimated | Assumed:
        """Return the model estimated from frf - H, or `Assumed` without degrees of freedom."""
        residual = _NoiseResidual.of(H, frf)
        freedom = 2 * residual.n_values - n_parameters
        if freedom <= 0:
            return Assumed(**ASSUMED)
        if freedom < NOISE_LIMITS.many_freedoms:
            relative, floor = residual.fit_scale(freedom)
            return replace(self, relative=relative, floor=floor, spare=freedom)
        relative, floor = residual.fit_two_numbers(freedom, self.tails)
        return replace(self, relative=relative, floor=floor, spare=None)

    def figures(self) -> dict[str, Any]:
        """Return relative noise and floor, and the degrees of freedom if there are few."""
        few = {} if self.spare is None else {"degrees_of_freedom": self.spare}
        return {"relative": self.relative, "floor": self.floor, **few}


@dataclass(frozen=True, slots=True, eq=False)
class _NoiseResidual:
    """A residual for the estimation of noise; all arrays have the shape (n_f, n_i, n_j).

    Values that are zero in model and data, as by symmetry, carry no information on the noise.
    """

    size: RealArray
    level: RealArray
    squared: RealArray
    is_nonzero: BoolArray

    @classmethod
    def of(cls, H: ComplexArray, frf: FRF) -> _NoiseResidual:
        level = np.broadcast_to(level_by_unit(frf), H.shape)
        is_nonzero = np.maximum(np.abs(H), np.abs(frf.values)) > NOISE_LIMITS.least_noise * level
        return cls(np.abs(H), level, np.abs(frf.values - H) ** 2, is_nonzero)

    @property
    def n_values(self) -> int:
        return int(np.count_nonzero(self.is_nonzero))

    def of_response(self, i: int) -> _NoiseResidual:
        return _NoiseResidual(
            self.size[:, i], self.level[:, i], self.squared[:, i], self.is_nonzero[:, i]
        )

    def fit_two_numbers(self, freedom: float, tails: float) -> tuple[float, float]:
        """Return relative noise and floor for a residual with `freedom` degrees of freedom."""
        if self.n_values == 0:
            return NOISE_LIMITS.least_noise, NOISE_LIMITS.least_noise
        squared = self.squared[self.is_nonzero] * (2 * self.n_values / freedom)
        return fit_two_numbers(
            self.size[self.is_nonzero], self.level[self.is_nonzero], squared, tails
        )

    def fit_scale(self, freedom: float) -> tuple[float, float]:
        """Return relative noise and floor at the middle of their `ratio_range`."""
        if self.n_values == 0:
            return NOISE_LIMITS.least_noise, NOISE_LIMITS.least_noise
        size, level = self.size[self.is_nonzero], self.level[self.is_nonzero]
        squared = self.squared[self.is_nonzero] * (2 * self.n_values / freedom)
        ratio = np.exp(np.mean(ratio_range(size, level)))
        shape = (ratio * size) ** 2 + level**2
        floor = np.sqrt(np.mean(squared / shape))
        a, b = np.clip([ratio * floor, floor], *np.exp(_log_range()))
        return float(a), float(b)


def _log_range() -> tuple[float, float]:
    """Return the bounds of the logarithms of relative noise and floor."""
    # Noise as large as the response carries no information.
    return float(np.log(NOISE_LIMITS.least_noise)), 0.0


def ratio_range(size: RealArray, level: RealArray) -> tuple[float, float]:
    """Return the range of log(relative / floor) in which the two can be distinguished."""
    over = np.log(size[size > 0.0] / level[size > 0.0])
    if over.size == 0:
        return 0.0, 0.0
    return -float(over.max()), -float(over.min())


def fit_two_numbers(
    size: RealArray, level: RealArray, squared: RealArray, tails: float
) -> tuple[float, float]:
    """Return the relative noise and floor of maximum likelihood; relative noise is at most 1."""
    # `size` is |H| of the model, `level` that to which the floor is relative. At a given ratio of
    # the two numbers, the Gaussian likelihood is largest if the reduced chi-square is 1, so the
    # search is over the ratio alone and has no local minimum of two variables.
    from scipy.optimize import minimize

    stride = max(1, size.size // ESTIMATED_NOISE.most_values)
    size, level = size.ravel()[::stride], level.ravel()[::stride]
    squared = squared.ravel()[::stride]
    found = _fit_gaussian(size, level, squared)
    if np.isfinite(tails):
        # Outliers bias the Gaussian estimate; start also from an estimate with the smaller half of
        # the residuals.
        is_small = squared <= np.median(squared / level**2) * level**2
        tries = [found, _fit_gaussian(size[is_small], level[is_small], squared[is_small])]
        about, bounds = (size**2, level**2, squared, tails), [_log_range()] * 2
        options = {"ftol": 1e-12, "gtol": 1e-8}
        minima = [
            minimize(
                _mean_student_cost,
                np.log(start),
                about,
                jac=True,
                method="L-BFGS-B",
                bounds=bounds,
                options=options,
            )
            for start in tries
        ]
        found = np.exp(min(minima, key=lambda minimum: float(minimum.fun)).x)
    a, b = np.clip(found, *np.exp(_log_range()))
    return float(a), float(b)


def _variance(logs: NumberArray, size: RealArray, level: RealArray) -> RealArray:
    """Return the variance for the logarithms of relative noise and floor."""
    low, high = _log_range()
    a, b = np.exp(np.minimum(np.maximum(logs, low), high))  # np.clip takes three times as long
    return np.asarray((a * size) ** 2 + (b * level) ** 2)


def _mean(values: RealArray) -> float:
    """Return np.mean of a vector to the last bit, in a third of its time for few values."""
    return float(np.add.reduce(values)) / values.size


def _student_cost(squared: RealArray, variance: RealArray, tails: float) -> RealArray:
    """Return the negative logarithm of Student's density of each value, up to a constant."""
    far = np.log1p(2.0 / tails * squared / variance)
    return np.asarray(np.log(variance) + (0.5 * tails + 1.0) * far)


def _mean_student_cost(
    logs: RealArray, size: RealArray, level: RealArray, squared: RealArray, tails: float
) -> tuple[float, RealArray]:
    """Return the mean of `_student_cost` and its derivatives by the logarithms of both numbers.

    `size` and `level` are squared.
    """
    a, b = np.exp(2.0 * logs)
    variance = a * size + b * level
    share = 2.0 / tails * squared / variance
    weight = 0.5 * tails + 1.0
    cost = _mean(np.log(variance) + weight * np.log1p(share))
    slope = (1.0 - weight * share / (1.0 + share)) / variance
    return cost, 2.0 / len(variance) * np.array([a * (slope @ size), b * (slope @ level)])


#: Estimate that this likelihood gives for Gaussian noise of standard deviation 1: it is largest at
#: the s with a mean of 3 p / (1 + 2 p) of 1, with p = |r|^2 / s^2 of 2 complex degrees of freedom.
_SHRUNK = 0.84129


def estimate_floors(frf: FRF) -> tuple[float, Floors]:
    """Return the noise floor, as a share of the rms of its unit, and those of some responses."""
    # 0 for fewer than twenty lines, because resonances fill every window.
    if len(frf.freq) < LINE_SCATTER.least_lines:
        return 0.0, ()
    size, squared = np.abs(frf.values), estimate_scatter(frf)
    level = np.broadcast_to(level_by_unit(frf), squared.shape)
    common = _estimate_common_floor(size, level, squared)
    if len(frf.responses) < 2:
        return common, ()
    return common, _find_own_floors(frf.responses.labels, size, level, squared, common)


def _estimate_common_floor(size: RealArray, level: RealArray, squared: RealArray) -> float:
    # The scatter about a local polynomial also contains the shape of resonances if lines are not
    # dense. The shape is proportional to the level: it counts as relative noise, which is
    # discarded.
    if not squared.any():
        return 0.0
    return fit_two_numbers(size, level, squared, LINE_SCATTER.tail_freedoms)[1] / _SHRUNK


def _find_own_floors(
    labels: Sequence[str], size: RealArray, level: RealArray, squared: RealArray, common: float
) -> Floors:
    """Return the floors of the responses whose lines contradict the common floor."""
    # The odds have to be 100 to 1, each with its best relative noise. Only one in five lines
    # counts, because windows overlap.
    found = []
    for i, label in enumerate(labels):
        n_values = squared[:, i].size
        stride = max(1, n_values // LINE_SCATTER.most_response_values)
        own_size, own_level, own_squared = (
            one[:, i].ravel()[::stride] for one in (size, level, squared)
        )
        if not own_squared.any():
            continue
        floor, gain = _estimate_own_floor(own_size, own_level, own_squared, common * _SHRUNK)
        if gain * n_values / LINE_SCATTER.window_lines > LINE_SCATTER.own_floor_log_odds:
            found.append((label, floor / _SHRUNK))
    return tuple(found)


def _estimate_own_floor(
    size: RealArray, level: RealArray, squared: RealArray, common: float
) -> tuple[float, float]:
    """Return the floor of a response and its mean gain in log-likelihood per value."""
    from scipy.optimize import minimize_scalar

    tails = LINE_SCATTER.tail_freedoms

    def cost(log_relative: float, floor: float) -> float:
        logs = np.array([log_relative, np.log(max(floor, NOISE_LIMITS.least_noise))])
        return _mean(_student_cost(squared, _variance(logs, size, level), tails))

    relative, floor = fit_two_numbers(size, level, squared, tails)
    best = minimize_scalar(cost, bounds=_log_range(), method="bounded", args=(common,))
    return floor, float(best.fun) - cost(np.log(relative), floor)


def _squared_floors(common_floor: float, own_floors: Floors, frf: FRF) -> RealArray:
    """Return the squared floors of the responses, shape (n_f, n_i, n_j)."""
    known = dict(own_floors)
    floors = np.array([known.get(label, common_floor) for label in frf.responses.labels])
    return two_part_variance(0.0, floors[:, None], frf.values, level_by_unit(frf))


def _fit_gaussian(size: RealArray, level: RealArray, squared: RealArray) -> RealArray:
    """Return relative noise and floor of maximum Gaussian likelihood, shape (2,)."""
    from scipy.optimize import minimize_scalar

    def scale(log_ratio: float) -> tuple[RealArray, float]:
        shape = (np.exp(log_ratio) * size) ** 2 + level**2
        return shape, max(_mean(squared / shape), NOISE_LIMITS.least_noise**2)

    def cost(log_ratio: float) -> float:
        shape, floor = scale(log_ratio)
        return _mean(np.log(shape)) + float(np.log(floor))

    if not size.any():
        return np.array([NOISE_LIMITS.least_noise, np.sqrt(scale(-np.inf)[1])])
    # The search covers ratios from a relative part of a thousandth of the floor at the largest
    # value to a floor of a thousandth of the relative part at the smallest value.
    low, high = ratio_range(size, level)
    margin, number = ESTIMATED_NOISE.ratio_margin, ESTIMATED_NOISE.ratio_points
    grid = np.linspace(low - margin, high + margin, number)
    best = int(np.argmin([cost(ratio) for ratio in grid]))
    bracket = grid[max(best - 1, 0)], grid[min(best + 1, number - 1)]
    options = {"xatol": 1e-4}
    ratio = float(minimize_scalar(cost, bounds=bracket, method="bounded", options=options).x)
    floor = np.sqrt(scale(ratio)[1])
    return np.asarray(np.clip([np.exp(ratio) * floor, floor], *np.exp(_log_range())))


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedByChannel(NoiseModel):
    """Noise with E|dH|^2 = (relative |H|)^2 + (floor rms)^2, estimated for each response.

    `relative` and `floor`, shape (n_i,), are None before the first residual, when noise of typical
    size is assumed; the floor is a share of the rms of all data of the same unit. Other fields are
    those of `Estimated`.
    """

    tails: float = np.inf
    relative: RealArray | None = None
    floor: RealArray | None = None
    names: tuple[str, ...] = ()
    held: bool = False
    common_floor: float = 0.0
    own_floors: Floors = ()
    kind: ClassVar[str] = "estimated from the residual, channel by channel"
    source: ClassVar[str] = "estimated"

    @classmethod
    def of_data(cls, frf: FRF, tails: float = np.inf) -> EstimatedByChannel:
        """Return the model before the first residual."""
        common_floor, own_floors = estimate_floors(frf)
        return cls(tails=tails, common_floor=common_floor, own_floors=own_floors)

    def initial_variance(self, frf: FRF) -> RealArray:
        """Return the square of the floor of neighbouring lines, shape (n_f, n_i, n_j)."""
        return _squared_floors(self.common_floor, self.own_floors, frf)

    def variance(self, H: ComplexArray, frf: FRF) -> RealArray:
        """Return E|dH|^2, shape (n_f, n_i, n_j)."""
        if self.relative is None or self.floor is None:
            return Stated(**ASSUMED).variance(H, frf)
        return two_part_variance(self.relative[:, None], self.floor[:, None], H, level_by_unit(frf))

    def refit(
        self, H: ComplexArray, frf: FRF, n_parameters: int
    ) -> EstimatedByChannel | Estimated | Assumed:
        """Return the model estimated by response, or with common numbers if values are few."""
        if self.held:
            return self
        residual = _NoiseResidual.of(H, frf)
        freedom = 2 * residual.n_values - n_parameters
        if freedom <= 0 or H[:, 0].size < ESTIMATED_NOISE.least_channel_values:
            return Estimated(tails=self.tails).refit(H, frf, n_parameters)
        share = freedom / residual.n_values
        channels = [residual.of_response(i) for i in range(H.shape[1])]
        found = np.array(
            [one.fit_two_numbers(share * one.n_values, self.tails) for one in channels]
        )
        return replace(
            self, relative=found[:, 0], floor=found[:, 1], names=tuple(frf.responses.labels)
        )

    def figures(self) -> dict[str, Any]:
        """Return relative noise and floor of each response."""
        if self.relative is None or self.floor is None:
            return {}
        return {
            "relative_by_channel": dict(zip(self.names, self.relative.tolist(), strict=True)),
            "floor_by_channel": dict(zip(self.names, self.floor.tolist(), strict=True)),
        }
