"""A sensor that stands at a neighbouring node, or points in another direction, than its label."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import ClassVar, Self

from updyn.dofs import Dof, DofSet
from updyn.errors import OptionError, suggest
from updyn.frf import FRF
from updyn.updating.judge.causes.evidence import Evidence, labels_of
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.places import mistaken

__all__ = ["Moved"]


class Moved(Fault):
    """The response that is called the first of the channels stands at the second."""

    __slots__ = ()

    kind: ClassVar[str] = "moved"
    two: ClassVar[str] = "places"

    @classmethod
    def suspected(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield for each response the other directions of its node, and the neighbouring nodes."""
        for dof, place in mistaken(evidence.part):
            yield cls((str(abs(dof)), str(place)))

    def repair(self, frf: FRF) -> FRF:
        """Return the data with the sensor called what it is.

        Raises
        ------
        OptionError
            If it is not in the data, or another sensor has its place.
        """
        labels = labels_of(frf)
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
