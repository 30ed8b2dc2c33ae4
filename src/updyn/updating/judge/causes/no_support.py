"""A support of the model that does not hold the structure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import ClassVar, Self

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import IrreparableFault
from updyn.updating.judge.causes.holding import list_ground_springs
from updyn.updating.judge.causes.settings import SUPPORT_FAULT
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.problem import FRFPart

__all__ = ["NoSupport"]


class NoSupport(IrreparableFault):
    """A group that holds the model to the ground has at most exp(value) times its stiffness.

    Its channel is the name of the group, whose stiffness is not an unknown.
    """

    __slots__ = ()

    kind: ClassVar[str] = "no-support"
    concerns_model: ClassVar[bool] = True
    has_free_size: ClassVar[bool] = True
    is_adaptive: ClassVar[bool] = True
    odds: ClassVar[float] = 2e-3
    advice: ClassVar[str] = (
        "Check how the structure was supported in the test; leave that group out of the model,"
        " or make its stiffness an unknown with a wide prior."
    )

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield the groups of springs to the ground whose stiffness is taken as known."""
        for group in list_ground_springs(evidence.part):
            for share in SUPPORT_FAULT.first_shares:
                yield cls((group,), float(np.log(share)))

    def slope(self, evidence: Evidence) -> ComplexArray:
        """Return the derivative of the model's ln H by the logarithm of the stiffness."""
        low, high = (
            evidence.log_ratio_with_stiffness(self.channels[0], self.value + step)
            for step in (-SUPPORT_FAULT.share_step, SUPPORT_FAULT.share_step)
        )
        return np.asarray((high - low) / (2.0 * SUPPORT_FAULT.share_step))

    def log_change(self, evidence: Evidence) -> ComplexArray:
        """Return the model's ln H with this stiffness over H."""
        return evidence.log_ratio_with_stiffness(self.channels[0], self.value)

    def correct_part(self, part: FRFPart, x: RealArray) -> FRFPart:
        """Return the part with this stiffness as an unknown with a wide prior."""
        items, at = list(part.coordinates.parameters), self._stiffness_index(part)
        items[at] = replace(
            items[at], lower=SUPPORT_FAULT.least_share, prior_std=SUPPORT_FAULT.share_std
        )
        wide = replace(part.coordinates, parameters=ParameterSet(tuple(items)))
        return replace(part, coordinates=wide)

    def choose_start(self, part: FRFPart, x: RealArray) -> RealArray:
        """Return x with the stiffness at its share."""
        return part.coordinates.with_coordinate(
            x, self._stiffness_index(part), max(self.value, np.log(SUPPORT_FAULT.least_share))
        )

    def adapt_to(self, evidence: Evidence) -> Self:
        """Return the fault with the stiffness at the point."""
        return replace(self, value=float(evidence.x[self._stiffness_index(evidence.part)]))

    def _stiffness_index(self, part: FRFPart) -> int:
        return part.coordinates.parameters.names.index(f"{self.channels[0]}.stiffness")

    def is_plausible(self) -> bool:
        """Return whether most of the stiffness is missing."""
        return bool(self.value < np.log(SUPPORT_FAULT.most_share))

    def statement(self) -> str:
        """Return a sentence with the group and the remaining share of its stiffness."""
        share = 100.0 * np.exp(max(self.value, -20.0))
        return (
            f"The group {self.channel_text!r} holds the model to the ground, but apparently not the"
            f" structure: the data agree with {share:.2g} % of its stiffness."
        )
