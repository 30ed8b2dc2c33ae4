"""A mass that the model lacks."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

from updyn.updating.judge.causes.element import MeasuredDofs
from updyn.updating.judge.causes.missing_element import MissingElement
from updyn.updating.problem.problem import FRFPart

__all__ = ["MissingMass"]


class MissingMass(MissingElement):
    """A mass of `value` kg on a measured node that the model lacks.

    It acts in all translations of the node, or as a moment of inertia in one measured rotation.
    """

    __slots__ = ()

    kind: ClassVar[str] = "missing-mass"
    unit: ClassVar[str] = "kg"
    quantity: ClassVar[str] = "mass"
    noun: ClassVar[str] = "mass"
    units: ClassVar[tuple[str, str]] = ("kg", "kg m2")

    @classmethod
    def list_places(cls, part: FRFPart) -> Iterator[tuple[tuple[str, ...], bool]]:
        """Yield the translations of each measured node, and each measured rotation."""
        of_node: dict[str, list[str]] = {}
        for label in MeasuredDofs.with_translations(part).labels:
            node, _, direction = label.partition(":")
            of_node.setdefault(label if direction.startswith("R") else node, []).append(label)
        for labels in of_node.values():
            yield tuple(labels), False

    @property
    def place_text(self) -> str:
        """Place as text."""
        if ":R" in self.channels[0]:
            return super().place_text
        return f"at node {self.channels[0].partition(':')[0]}"
