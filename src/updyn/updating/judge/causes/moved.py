"""A sensor that stands at a neighbouring node, or points in another direction, than its label."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np

from updyn.dofs import Dof, DofSet
from updyn.errors import OptionError, suggest
from updyn.frf import FRF
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.problem.problem import Part

if TYPE_CHECKING:
    from updyn.updating.judge.causes.evidence import Evidence

__all__ = ["Moved"]

#: Most places that are tried for one sensor.
_MOST = 40


class Moved(Fault):
    """The response that is called the first of the channels stands at the second."""

    __slots__ = ()

    kind: ClassVar[str] = "moved"

    @classmethod
    def suspected(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield for each response the other directions of its node, and the neighbouring nodes."""
        for dof, place in _candidates(evidence.part):
            yield cls((str(abs(dof)), str(place)))

    @classmethod
    def further(cls, part: Part) -> list[str]:
        """Return the labels of all places where a response may stand, beside the measured ones."""
        return list(dict.fromkeys(str(place) for _, place in _candidates(part)))

    @classmethod
    def read(cls, channels: str, value: str) -> Self:
        """Return the fault that is written down.

        Raises
        ------
        OptionError
            If it does not name two.
        """
        found = super().read(channels, value)
        if len(found.channels) != 2 or value:
            raise OptionError(f"repair {cls.kind!r}: expected two places, found {channels!r}")
        return found

    def repair(self, frf: FRF) -> FRF:
        """Return the data with the sensor called what it is.

        Raises
        ------
        OptionError
            If it is not in the data, or another sensor has its place.
        """
        labels = [str(abs(dof)) for dof in frf.responses]
        here, there = self.channels
        if here not in labels:
            raise OptionError(f"{here!r} is no response of the data; {suggest(here, labels)}")
        if there in labels:
            raise OptionError(f"{there!r} is a response of the data already")
        sign = {label: dof.sign for label, dof in zip(labels, frf.responses, strict=True)}
        moved = [
            replace(Dof.parse(there), sign=sign[label]) if label == here else dof
            for label, dof in zip(labels, frf.responses, strict=True)
        ]
        return replace(frf, responses=DofSet(moved))

    def statement(self) -> str:
        """Return where it stands."""
        return f"The sensor called {self.channels[0]} stands at {self.channels[1]}."


def _candidates(part: Part) -> Iterator[tuple[Dof, Dof]]:
    """Yield each response with the places that it may be mistaken for."""
    dofs = part.solver.system.dofs
    measured = {str(abs(dof)) for dof in part.frf.responses}
    of_node: dict[int, list[int]] = {}
    for i, dof in enumerate(dofs):
        of_node.setdefault(dof.node, []).append(i)
    for dof in part.frf.responses:
        turns = dof.direction.startswith("R")
        near = [i for i in of_node[dof.node] if dofs[i].direction.startswith("R") == turns]
        near += [i for i in _beside(part, of_node[dof.node]) if dofs[i].direction == dof.direction]
        for i in near[:_MOST]:
            place = abs(dofs[i])
            if str(place) not in measured:
                yield dof, place


def _beside(part: Part, own: list[int]) -> list[int]:
    """Return the DOFs of other nodes that are coupled with those of a node, nearest in number."""
    system = part.solver.system
    coupled: set[int] = set()
    for i in own:
        coupled.update(system.indices[system.indptr[i] : system.indptr[i + 1]].tolist())
    return sorted(coupled - set(own), key=lambda i: int(np.abs(i - own[0])))
