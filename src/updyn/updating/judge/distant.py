"""Stiffnesses and masses that ended farther from their start than the usual error of models."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from updyn.updating.judge.settings import PLAUSIBILITY, SIGNIFICANCE
from updyn.updating.problem.parameters import ParameterSet

__all__ = ["DistantUnknown", "find_distant_unknowns"]


@dataclass(frozen=True, slots=True)
class DistantUnknown:
    """An unknown at `factor` times its start, `deviations` of its prior or of usual errors away."""

    name: str
    factor: float
    deviations: float

    @property
    def statement(self) -> str:
        """The distance as text."""
        if self.factor >= 1.0:
            return f"{self.name} ended at {self.factor:.3g} times its start"
        return f"{self.name} ended at 1/{1.0 / self.factor:.3g} of its start"


def find_distant_unknowns(
    parameters: ParameterSet, values: Mapping[str, float]
) -> tuple[DistantUnknown, ...]:
    """Return the stiffnesses and masses that are far from their start, the farthest first."""
    usual, found = math.log(PLAUSIBILITY.usual_factor), []
    for p in parameters:
        value = values[p.name]
        if not p.is_factor or p.is_channel or not (value > 0.0 and p.start > 0.0):
            continue
        deviations = abs(math.log(value / p.start)) / (p.prior_std or usual)
        if deviations > SIGNIFICANCE.stds:
            found.append(DistantUnknown(p.name, value / p.start, deviations))
    return tuple(sorted(found, key=lambda one: -one.deviations))
