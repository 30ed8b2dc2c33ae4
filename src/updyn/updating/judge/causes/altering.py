"""Base class of the faults whose trial adds an element or a property to the model."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar

from updyn.arrays import ComplexArray, RealArray
from updyn.updating.judge.causes.altered import Alteration, AlteredPart, compute_log_ratio
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import IrreparableFault, divide_odds
from updyn.updating.problem.problem import FRFPart

__all__ = ["AlteringFault"]


@dataclass(frozen=True, slots=True)
class AlteringFault(IrreparableFault):
    """An element or a property of size `value` that the model lacks.

    The prior odds of the kind are divided among the `n_places` tested places.
    """

    n_places: int = field(default=1, kw_only=True)

    has_free_size: ClassVar[bool] = True
    is_additive: ClassVar[bool] = True
    has_constant_size: ClassVar[bool] = True
    alters_model: ClassVar[bool] = True
    odds: ClassVar[float] = 1e-2

    @property
    @abstractmethod
    def alteration(self) -> Alteration:
        """The change of the model."""

    @property
    def prior(self) -> float:
        """Prior odds of the fault at its place."""
        return divide_odds(self.odds, self.n_places)

    def log_change(self, evidence: Evidence) -> ComplexArray:
        """Return ln H of the altered model over the model's H."""
        return compute_log_ratio(evidence.part, self.alteration, evidence.x)

    def correct_part(self, part: FRFPart, x: RealArray) -> FRFPart:
        """Return the part with the altered model."""
        return AlteredPart.of(part, self.alteration) if self.is_plausible() else part
