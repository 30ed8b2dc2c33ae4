"""Wrong section axes in the model: exchanged Iy and Iz, or an orientation turned by 90 degrees."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

from updyn.arrays import RealArray
from updyn.remedy import Remedy
from updyn.updating.judge.causes.fault import IrreparableFault, divide_odds
from updyn.updating.judge.causes.other_model import CompiledVariant
from updyn.updating.problem.problem import FRFPart
from updyn.variants import exchanged_axes

__all__ = ["WrongAxes"]


@dataclass(frozen=True, slots=True)
class WrongAxes(IrreparableFault):
    """The beams of the groups in `channels` have exchanged section axes in the model.

    `compiled_variant` has the correct axes; the `n_places` variants share the odds of the kind.
    `select_variants` selects these faults.
    """

    compiled_variant: CompiledVariant | None = field(default=None, compare=False, repr=False)
    n_places: int = 1

    kind: ClassVar[str] = "wrong-axes"
    alters_model: ClassVar[bool] = True
    odds: ClassVar[float] = 1e-2

    @property
    def prior(self) -> float:
        """Prior odds that the axes of these groups are wrong."""
        return divide_odds(self.odds, self.n_places)

    def correct_part(self, part: FRFPart, x: RealArray) -> FRFPart:
        """Return the part with the other model."""
        return (
            part if self.compiled_variant is None else self.compiled_variant.prepare_part(part, [x])
        )

    def prepare_next_search(self, part: FRFPart, x: RealArray) -> FRFPart:
        """Return the part with the other model."""
        return self.correct_part(part, x)

    def statement(self) -> str:
        """Return a sentence with the groups."""
        text = exchanged_axes(self.channels)
        return f"{text[0].upper()}{text[1:]}."

    @property
    def remedy(self) -> Remedy:
        """Line of the model to change."""
        one = self.compiled_variant
        return Remedy("" if one is None else one.variant.remedy)
