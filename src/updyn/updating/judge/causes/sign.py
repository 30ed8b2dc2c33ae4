"""A sensor or a force of opposite direction."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar, Self

import numpy as np

from updyn.frf import FRF
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import Fault, list_channels, multiply_channels

__all__ = ["WrongSign"]


class WrongSign(Fault):
    """The opposite sign of a sensor or of a force; without channels, of all data."""

    __slots__ = ()

    kind: ClassVar[str] = "sign"
    is_local: ClassVar[bool] = True

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield each sensor, and all together."""
        yield from map(cls, [(), *list_channels(evidence.frf)])

    def repair(self, frf: FRF) -> FRF:
        """Return the data with the sign changed."""
        return multiply_channels(frf, self.channels, np.full(len(frf.freq), 1j * np.pi))

    def statement(self) -> str:
        """Return a sentence with the channels."""
        return f"The sign of {self.channel_text} is opposite to the label."
