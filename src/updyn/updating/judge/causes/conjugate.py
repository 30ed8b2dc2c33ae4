"""Data with the opposite sign of the phase, by the time convention e^(-i omega t)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import ClassVar, Self

from updyn.frf import FRF
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import Fault

__all__ = ["ConjugatedData"]


class ConjugatedData(Fault):
    """All data are conjugated, and therefore not causal."""

    __slots__ = ()

    kind: ClassVar[str] = "non-causal"

    @property
    def affects_all_data(self) -> bool:
        """True."""
        return True

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield the only fault of this kind."""
        yield cls()

    def repair(self, frf: FRF) -> FRF:
        """Return the conjugated data."""
        return replace(frf, values=frf.values.conj())

    def statement(self) -> str:
        """Return a sentence that describes the fault."""
        return (
            "The phase of all channels has the wrong sign: the data are conjugated"
            " (e^(-i omega t)), so that the response precedes the force."
        )
