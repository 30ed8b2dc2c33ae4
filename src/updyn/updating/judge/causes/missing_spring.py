"""A spring that the model lacks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

from updyn.arrays import RealArray
from updyn.updating.judge.causes.holding import is_free
from updyn.updating.judge.causes.missing_element import MissingElement
from updyn.updating.problem.problem import FRFPart

__all__ = ["MissingSpring"]


@dataclass(frozen=True, slots=True)
class MissingSpring(MissingElement):
    """A spring of `value` N/m at a DOF, or between two, that the model lacks.

    `supports`: it acts between a DOF and the ground, while the model is free.
    """

    supports: bool = False

    kind: ClassVar[str] = "missing-spring"
    unit: ClassVar[str] = "N/m"
    quantity: ClassVar[str] = "stiffness"
    noun: ClassVar[str] = "spring"
    units: ClassVar[tuple[str, str]] = ("N/m", "N m/rad")
    #: Loss factor between that of steel springs (up to 0.01) and of bolted joints and rubber
    #: (0.05).
    loss: ClassVar[float] = 0.02

    @property
    def ends_search(self) -> bool:
        """Whether it is a support, which may represent several; the model needs these first."""
        return self.supports

    def add_model_figures(self, part: FRFPart, x: RealArray) -> Self:
        """Return the spring, as a support if it acts on the ground and the model is free."""
        return replace(self, supports=is_free(part) and not self.between)

    def statement(self) -> str:
        """Return a sentence with the place and the size."""
        if not self.supports:
            # Without arguments, `super` refers to the class without slots.
            return super(MissingSpring, self).statement()
        return (
            "The structure seems to be supported, while the model is free: a spring of"
            f" {self.size_text} to the ground {self.place_text}, or several that act like it,"
            " explain the data."
        )

    @property
    def search_advice(self) -> str:
        """First advice to the user."""
        if not self.supports:
            return super(MissingSpring, self).search_advice
        return "Check how the structure was supported in the test. Add each support to the model"
