"""A first-order low-pass in one measurement chain."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar, Self

import numpy as np

from updyn.arrays import ComplexArray
from updyn.frf import FRF
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import Fault, find_channels, list_channels, multiply_channels
from updyn.updating.judge.causes.settings import CHANNEL_FAULT

__all__ = ["LowPass"]


class LowPass(Fault):
    """A channel is filtered by 1 / (1 + i omega value), with `value` in s."""

    __slots__ = ()

    kind: ClassVar[str] = "low-pass"
    unit: ClassVar[str] = "s"
    has_free_size: ClassVar[bool] = True
    is_positive: ClassVar[bool] = True
    is_local: ClassVar[bool] = True

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield each sensor, and all together, with several corner frequencies."""
        highest = 2.0 * np.pi * evidence.frf.freq[-1]
        for channels in [(), *list_channels(evidence.frf)]:
            for corner in CHANNEL_FAULT.corner_shares:
                yield cls(channels, 1.0 / (corner * highest))

    def repair(self, frf: FRF) -> FRF:
        """Return the data without the filter."""
        return multiply_channels(frf, self.channels, np.log1p(frf.s * self.value))

    def slope(self, evidence: Evidence) -> ComplexArray:
        """Return -i omega / (1 + i omega value) at the channels."""
        frf = evidence.frf
        s = frf.s
        return find_channels(self.channels, frf).broadcast(
            -s / (1.0 + s * self.value), frf.values.shape
        )

    def statement(self) -> str:
        """Return a sentence with the corner frequency."""
        corner = 1.0 / (2.0 * np.pi * self.value)
        subject = self.begin_sentence("is", "are")
        return f"{subject} filtered by a first-order low-pass at {corner:.4g} Hz."
