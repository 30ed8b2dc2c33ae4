"""Continuation of a fit with separate noise for each sensor, if sensors differ.

The new fit is kept if its residual is noise: if the model cannot follow a sensor, its residual is
larger than noise, however small its weight. The first fit is kept if noise cannot be distinguished
from the residual of a wrong sensor: lines so far apart that the response is not smooth, or noise of
a third of the response.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.errors import SolverError
from updyn.updating.fit.method import Fit, Method
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.reducing import Reducing
from updyn.updating.judge.adequacy import (
    Adequacy,
    add_noisy_sensors,
    can_be_sensor_noise,
    has_unequal_noise,
)
from updyn.updating.judge.assessment import Judgement
from updyn.updating.judge.whitening import whitening_weights
from updyn.updating.problem.noise import (
    Estimated,
    EstimatedByChannel,
    NoiseChoice,
    NoiseModel,
    Robust,
)
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.session import Stopped

__all__ = ["SensorNoiseFit"]


@dataclass(frozen=True, slots=True, eq=False)
class SensorNoiseFit:
    """Continues a fit with separate noise for each sensor, from `noises` common to all sensors."""

    problem: Problem
    strategy: Method
    noises: Sequence[NoiseModel]
    chosen: Sequence[NoiseChoice]
    monitor: Monitor
    reduced: Reducing | None

    def continue_fit(
        self, found: Judgement, judge: Callable[[Fit, Sequence[NoiseModel]], Judgement]
    ) -> Judgement:
        """Return the judgement of the continued fit; `found`, of the first fit, if not better."""
        noises = self._separate_noises(found)
        if noises is None:
            return found
        n_steps = len(self.monitor.history)
        try:
            fit = self.strategy.fit(self.problem, noises, self.monitor, found.fit.x)
            if fit.reason == "converged":
                judgement = judge(fit, noises)
                parts = judgement.adequacy[: len(self.problem.parts)]
                is_noise = all(a is not None and a.adequate for a in parts)
                if (
                    is_noise
                    and self._is_distinguishable(fit.x, noises)
                    and self._is_reduction_accurate(fit)
                ):
                    named = [
                        self._name_noisy_sensors(i, fit.x, noises[i], a)
                        for i, a in enumerate(parts)
                        if a
                    ]
                    return replace(judgement, adequacy=(*named, *judgement.adequacy[len(parts) :]))
        except (SolverError, Stopped):
            pass
        del self.monitor.history[n_steps:]  # discard the steps of the rejected fit
        return found

    def _separate_noises(self, found: Judgement) -> list[NoiseModel] | None:
        fit = found.fit
        if fit.reason not in ("converged", "unsettled") or fit.rivals or self.monitor.stopped:
            return None
        if not self.strategy.is_likelihood:
            return None
        out, differ = list[NoiseModel](), False
        for part, noise, chosen, adequacy in zip(
            self.problem.parts, self.noises, self.chosen, found.adequacy, strict=False
        ):
            separate = noise
            if _is_open(chosen) and adequacy is not None and has_unequal_noise(adequacy):
                separate = _make_sensor_noise(noise, part)
            out.append(separate)
            differ = differ or separate is not noise
        return out if differ else None

    def _is_distinguishable(self, x: RealArray, noises: Sequence[NoiseModel]) -> bool:
        """Return whether noise can be distinguished from the residual of a wrong sensor."""
        for i, (part, noise) in enumerate(zip(self.problem.parts, noises, strict=True)):
            if noise is self.noises[i]:
                continue
            H = part.responses(x)
            weight = whitening_weights(self._refit_noise(noise, part, H), H, part)
            weight = np.where(weight > 0.0, weight, np.nan)
            if not can_be_sensor_noise(
                H, weight * H, weight * (part.frf.values - H), part.frf.freq
            ):
                return False
        return True

    def _refit_noise(self, noise: NoiseModel, part: FRFPart, H: ComplexArray) -> NoiseModel:
        """Return a noise model, without outliers, refitted to the residual."""
        return noise.bulk.refit(H, part.frf, self.problem.share(part))

    def _is_reduction_accurate(self, fit: Fit) -> bool:
        return self.reduced is None or self.reduced.certify_at(fit.x)

    def _name_noisy_sensors(
        self, i: int, x: RealArray, noise_of_sensors: NoiseModel, adequacy: Adequacy
    ) -> Adequacy:
        """Return the assessment of a part with the sensors noisier than most."""
        if noise_of_sensors is self.noises[i]:
            return adequacy
        part = self.problem.parts[i]
        H = part.responses(x)
        each, common = (
            self._refit_noise(noise, part, H).variance(H, part.frf).sum(axis=(0, 2))
            for noise in (noise_of_sensors, self.noises[i])
        )
        return add_noisy_sensors(adequacy, np.sqrt(each / common))


def _is_open(chosen: NoiseChoice) -> bool:
    """Return whether the user did not specify the source of the noise."""
    return chosen is None or (isinstance(chosen, Mapping) and set(chosen) == {"robust"})


def _make_sensor_noise(noise: NoiseModel, part: FRFPart) -> NoiseModel:
    """Return a noise model with separate noise for each sensor; unchanged if not estimated."""
    if isinstance(noise, Robust):
        return replace(noise, base=_make_sensor_noise(noise.base, part))
    if not isinstance(noise, Estimated):
        return noise
    return EstimatedByChannel.of_data(part.frf, noise.tails)
