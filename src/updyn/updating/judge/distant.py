"""Stiffnesses and masses that ended farther from their start than the usual error of models."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from updyn.updating.problem.parameters import ParameterSet

__all__ = ["DistantUnknown", "find_distant_unknowns"]

#: Standard deviation of the logarithm of a stiffness or mass without a prior: a factor of 1.5, as
#: in the search for causes.
_USUAL = math.log(1.5)
#: Number of standard deviations above which a value is far from its start: a factor of 3.4 without
#: a prior.
_FAR = 3.0


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
    found = []
    for p in parameters:
        value = values[p.name]
        if not p.is_factor or p.is_channel or not (value > 0.0 and p.start > 0.0):
            continue
        deviations = abs(math.log(value / p.start)) / (p.prior_std or _USUAL)
        if deviations > _FAR:
            found.append(DistantUnknown(p.name, value / p.start, deviations))
    return tuple(sorted(found, key=lambda one: -one.deviations))
