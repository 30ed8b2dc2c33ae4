"""A wrong sensitivity of a sensor, or of all sensors."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar, Self

import numpy as np

from updyn.arrays import ComplexArray
from updyn.frf import FRF
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import Fault, find_channels, list_channels, multiply_channels
from updyn.updating.judge.causes.scale import WrongUnit
from updyn.updating.judge.causes.settings import CHANNEL_FAULT
from updyn.updating.problem.problem import FRFPart

__all__ = ["Calibration"]


class Calibration(Fault):
    """The values of a channel are exp(value) times too large."""

    __slots__ = ()

    kind: ClassVar[str] = "calibration"
    has_free_size: ClassVar[bool] = True
    is_additive: ClassVar[bool] = True
    is_local: ClassVar[bool] = True

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield each sensor, and all together."""
        yield from map(cls, [(), *list_channels(evidence.frf)])

    def repair(self, frf: FRF) -> FRF:
        """Return the data divided by the factor."""
        return multiply_channels(frf, self.channels, np.full(len(frf.freq), -self.value))

    def slope(self, evidence: Evidence) -> ComplexArray:
        """Return 1 at the channels."""
        frf = evidence.frf
        return find_channels(self.channels, frf).broadcast(np.ones(len(frf.freq)), frf.values.shape)

    def list_similar_faults(self, part: FRFPart) -> Iterable[Fault]:
        """Return the nearest factors between units."""
        return WrongUnit.near(self.channels, float(np.exp(self.value)))

    def is_plausible(self) -> bool:
        """Return whether the calibration is off by more than 1.5 % and less than a factor of 30."""
        return CHANNEL_FAULT.least_calibration < abs(self.value) < CHANNEL_FAULT.most_calibration

    def statement(self) -> str:
        """Return a sentence with the factor."""
        factor = float(np.exp(self.value))
        return f"The values of {self.channel_text} are {factor:.4g} times the true values."
