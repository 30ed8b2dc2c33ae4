"""A time delay between channels."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar, Self

from updyn.arrays import ComplexArray
from updyn.frf import FRF
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import Fault, find_channels, list_channels, multiply_channels
from updyn.updating.judge.causes.settings import CHANNEL_FAULT

__all__ = ["Delay"]


class Delay(Fault):
    """A channel is late by `value` seconds; a negative value means early."""

    __slots__ = ()

    kind: ClassVar[str] = "delay"
    unit: ClassVar[str] = "s"
    has_free_size: ClassVar[bool] = True
    is_additive: ClassVar[bool] = True
    is_local: ClassVar[bool] = True

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield each sensor, and all together, with several delays."""
        for channels in [(), *list_channels(evidence.frf)]:
            for periods in CHANNEL_FAULT.delay_periods:
                yield cls(channels, float(periods / evidence.frf.freq[-1]))

    def repair(self, frf: FRF) -> FRF:
        """Return the data with the phase corrected."""
        return multiply_channels(frf, self.channels, frf.s * self.value)

    def slope(self, evidence: Evidence) -> ComplexArray:
        """Return -i omega at the channels."""
        frf = evidence.frf
        return find_channels(self.channels, frf).broadcast(-frf.s, frf.values.shape)

    def statement(self) -> str:
        """Return a sentence with the delay."""
        late = "late" if self.value > 0 else "early"
        return f"{self.begin_sentence('is', 'are')} {abs(self.value):.4g} s {late}."
