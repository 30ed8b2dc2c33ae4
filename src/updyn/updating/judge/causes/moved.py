"""A sensor or a force at another node, or in another direction, than its label states."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import ClassVar, Self

from updyn.dofs import Dof, DofSet
from updyn.errors import OptionError, suggest
from updyn.frf import FRF
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import FORCE, Fault
from updyn.updating.judge.causes.labels import list_unsigned_labels
from updyn.updating.judge.causes.places import iter_force_places, iter_sensor_places

__all__ = ["MisplacedSensor"]


class MisplacedSensor(Fault):
    """The response or reference with the label of the first channel is at the second one."""

    __slots__ = ()

    kind: ClassVar[str] = "moved"
    pair_noun: ClassVar[str] = "places"
    moves_channel: ClassVar[bool] = True

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield other directions of a node and neighbouring nodes; for a force also all sensors."""
        for dof, place in iter_sensor_places(evidence.part):
            yield cls((str(abs(dof)), str(place)))
        for dof, place in iter_force_places(evidence.part):
            yield cls((f"{FORCE}{abs(dof)}", f"{FORCE}{place}"))

    @property
    def changed_channels(self) -> tuple[str, ...]:
        """The channel whose label is wrong."""
        return self.channels[:1]

    def repair(self, frf: FRF) -> FRF:
        """Return the data with the correct label of the sensor or the force."""
        stated, actual = (name.removeprefix(FORCE) for name in self.channels)
        if self._is_force:
            return replace(frf, references=_rename_dof(frf.references, stated, actual, "reference"))
        return replace(frf, responses=_rename_dof(frf.responses, stated, actual, "response"))

    @property
    def _is_force(self) -> bool:
        return self.channels[0].startswith(FORCE)

    def statement(self) -> str:
        """Return a sentence with the correct place."""
        stated, actual = (name.removeprefix(FORCE) for name in self.channels)
        if self._is_force:
            return f"The force labelled {stated} acts at {actual}."
        return f"The sensor labelled {stated} is at {actual}."

    @classmethod
    def parse(cls, channels: str, value: str) -> Self:
        """Return the fault from its text."""
        found = super().parse(channels, value)
        if len({name.startswith(FORCE) for name in found.channels}) > 1:
            raise OptionError(
                f"repair {cls.kind!r}: expected two places of a sensor, or of a force as in"
                f" 'moved:force 1:Z,force 10:Z', found {channels!r}"
            )
        return found


def _rename_dof(dofs: DofSet, stated: str, actual: str, role: str) -> DofSet:
    """Return DOFs of which one has another label."""
    labels = list_unsigned_labels(dofs)
    if stated not in labels:
        raise OptionError(f"{stated!r} is no {role} of the data; {suggest(stated, labels)}")
    if actual in labels:
        raise OptionError(f"{actual!r} is a {role} of the data already")
    new_dofs = [
        replace(Dof.parse(actual), sign=dof.sign) if label == stated else dof
        for label, dof in zip(labels, dofs, strict=True)
    ]
    return DofSet(new_dofs)
