"""A scaled frequency axis, due to a wrong sample rate."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import ClassVar, Self

import numpy as np

from updyn.arrays import ComplexArray
from updyn.frf import FRF
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.settings import CHANNEL_FAULT

__all__ = ["FrequencyScale"]


class FrequencyScale(Fault):
    """The true frequencies are exp(value) times those of the data."""

    __slots__ = ()

    kind: ClassVar[str] = "frequency-scale"
    has_free_size: ClassVar[bool] = True
    is_additive: ClassVar[bool] = True

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield the only fault of this kind."""
        yield cls()

    def repair(self, frf: FRF) -> FRF:
        """Return the data at their true frequencies."""
        factor = np.exp(self.value)
        return replace(frf, freq=frf.freq * factor, decay=frf.decay * factor)

    def slope(self, evidence: Evidence) -> ComplexArray:
        """Return d ln H / d ln f."""
        return evidence.frf.freq[:, None, None] * evidence.slope_by_frequency

    def is_plausible(self) -> bool:
        """Return whether the axis is off by more than 0.1 %."""
        return CHANNEL_FAULT.least_scale < abs(self.value) < CHANNEL_FAULT.most_scale

    def statement(self) -> str:
        """Return a sentence with the factor."""
        return (
            f"The frequency axis is scaled: the true frequencies are {np.exp(self.value):.5g} times"
            " those of the data. One factor on all stiffnesses would have nearly the same effect"
            " if no mass is known."
        )
