"""A mass that the model lacks."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

from updyn.frf import FRF
from updyn.updating.judge.causes.element import MeasuredDofs
from updyn.updating.judge.causes.missing_element import MissingElement

__all__ = ["MissingMass"]


class MissingMass(MissingElement):
    """A mass of `value` kg on a node that the model lacks.

    It acts in all measured translations of the node, or as a moment of inertia in one rotation.
    """

    __slots__ = ()

    kind: ClassVar[str] = "missing-mass"
    unit: ClassVar[str] = "kg"
    quantity: ClassVar[str] = "mass"
    noun: ClassVar[str] = "mass"
    units: ClassVar[tuple[str, str]] = ("kg", "kg m2")

    @classmethod
    def list_places(cls, frf: FRF) -> Iterator[tuple[tuple[str, ...], bool]]:
        """Yield the measured translations of each node, and each measured rotation."""
        of_node: dict[str, list[str]] = {}
        for label in MeasuredDofs.of(frf).labels:
            node, _, direction = label.partition(":")
            of_node.setdefault(label if direction.startswith("R") else node, []).append(label)
        for labels in of_node.values():
            yield tuple(labels), False
