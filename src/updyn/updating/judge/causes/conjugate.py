"""Data with the sign of the phase turned: another convention of time, e^(-i omega t)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import ClassVar, Self

from updyn.frf import FRF
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import Fault

__all__ = ["NonCausal"]


class NonCausal(Fault):
    """All data are the conjugates of what is there: they answer before they are struck."""

    __slots__ = ()

    kind: ClassVar[str] = "non-causal"

    @property
    def changes_all(self) -> bool:
        """It does."""
        return True

    @classmethod
    def suspected(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield the one that there is."""
        yield cls()

    def repair(self, frf: FRF) -> FRF:
        """Return the conjugates."""
        return replace(frf, values=frf.values.conj())

    def statement(self) -> str:
        """Return what is wrong."""
        return (
            "The phase of all channels has the wrong sign: the data are conjugated"
            " (e^(-i omega t)), and answer before the force acts."
        )
