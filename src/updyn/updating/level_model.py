"""`LevelModel`: a model with nonlinear elements at the force level of a test."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.dynamics.response import response_like
from updyn.dynamics.settings import REDUCTION
from updyn.frf import FRF
from updyn.model import Model
from updyn.updating.fit.reducing import make_reduction
from updyn.updating.problem.parameters import no_unknowns
from updyn.updating.problem.periodic_forward import PeriodicForward
from updyn.updating.problem.problem import FRFPart
from updyn.updating.problem.random_forward import RandomForward

__all__ = ["LevelModel", "respond_as_measured"]


@dataclass(frozen=True, slots=True, eq=False)
class LevelModel:
    """A model with nonlinear elements at the lines and the level of a test, as in a fit.

    At a line with several solutions, the stable one nearest to the measured values is used.
    """

    part: FRFPart

    @classmethod
    def of(cls, model: Model, frf: FRF, freq: RealArray, options: Mapping[str, Any]) -> LevelModel:
        """Return the model at lines in Hz, solved as by an update with these options."""
        tier = options.get("tier")
        part = FRFPart.build(
            model,
            _interpolate(frf, freq),
            no_unknowns(),
            tier="sparse" if tier == "reduced" else tier,
        )
        part = replace(part, as_read=False)
        if tier != "reduced":
            return cls(part)
        state = part.state(part.coordinates.start)
        reduction = make_reduction(part, float(options.get("accuracy", REDUCTION.accuracy)))
        reduction.build(state)
        reduction.enrich_until_accurate([state], part.solved_lines)
        return cls(part.with_solver(reduction.solver()))

    @property
    def frf(self) -> FRF:
        """The FRF in the channels, quantity and level of the test."""
        return replace(
            self.part.frf,
            values=self.responses(),
            coherence=None,
            variance=None,
            averages=None,
        )

    def responses(self) -> ComplexArray:
        """Return the FRF in the quantity of the test, (n_f, n_i, n_j)."""
        return self.part.responses(self.part.coordinates.start)

    def motions(self) -> list[tuple[float, float]]:
        """Return the largest amplitude of each element in m (rad), and its frequency in Hz.

        Under a random force, that of the sine of the same standard deviations of deformation and
        velocity; none without a level.
        """
        part, forward = self.part, self.part.forward
        if isinstance(forward, RandomForward):
            _, sigma, sigma_v = forward.spreads(part, part.coordinates.start)
            j = sigma.argmax(axis=1)[:, None]
            sigma, sigma_v = (np.take_along_axis(one, j, axis=1)[:, 0] for one in (sigma, sigma_v))
            freq = sigma_v / (2.0 * np.pi * sigma)
            return list(zip((np.sqrt(2.0) * sigma).tolist(), freq.tolist(), strict=True))
        if not isinstance(forward, PeriodicForward):
            return []
        largest = forward.amplitudes(part, part.coordinates.start).max(axis=2)
        at = largest.argmax(axis=0).tolist()
        return [(float(largest[k, e]), float(part.frf.freq[k])) for e, k in enumerate(at)]


def respond_as_measured(
    model: Model, frf: FRF, freq: RealArray, *, tier: str | None = None, **options: Any
) -> FRF:
    """Return the FRF of a model in the channels, quantity and force of a test, at lines in Hz.

    `options` are those of `response_like`; with nonlinear elements, `accuracy` alone has an effect.
    """
    if model.nonlinear:
        return LevelModel.of(model, frf, freq, {"tier": tier, **options}).frf
    return response_like(model, frf, freq, tier=tier, **options)


def _interpolate(frf: FRF, freq: RealArray) -> FRF:
    """Return data at other lines within the band, linear in real and imaginary part."""
    if np.array_equal(freq, frf.freq):
        return frf
    flat = frf.values.reshape(len(frf.freq), -1).T
    values = np.stack([np.interp(freq, frf.freq, row) for row in flat], axis=1)
    level = None if frf.level is None else np.interp(freq, frf.freq, frf.level)
    return replace(
        frf,
        freq=freq,
        values=values.reshape(len(freq), *frf.values.shape[1:]),
        coherence=None,
        variance=None,
        level=level,
    )
