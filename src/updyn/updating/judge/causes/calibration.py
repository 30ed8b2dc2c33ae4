"""A wrong sensitivity of a sensor, or of all sensors."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from updyn.frf import FRF
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import Fault, each_sensor, multiplied, place_of
from updyn.updating.judge.causes.scale import Scale
from updyn.updating.problem.problem import Part

__all__ = ["Calibration"]


class Calibration(Fault):
    """The values of a channel are exp(value) times too large."""

    __slots__ = ()

    kind: ClassVar[str] = "calibration"
    tunes: ClassVar[bool] = True
    adds: ClassVar[bool] = True

    @classmethod
    def suspected(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield each sensor, and all together."""
        yield from map(cls, [(), *each_sensor(evidence.frf)])

    def repair(self, frf: FRF) -> FRF:
        """Return the data divided by the factor."""
        return multiplied(frf, self.channels, np.full(len(frf.freq), -self.value))

    def slope(self, evidence: Evidence) -> NDArray[np.complex128]:
        """Return 1 at the channels."""
        frf = evidence.frf
        return place_of(self.channels, frf).spread(np.ones(len(frf.freq)), frf.values.shape)

    def relatives(self, part: Part) -> Iterable[Fault]:
        """Return the nearest factors between units."""
        return Scale.near(self.channels, float(np.exp(self.value)))

    def plausible(self) -> bool:
        """Return whether the calibration is off by more than 1.5 % and less than a factor of 30."""
        return 0.015 < abs(self.value) < 3.4

    def statement(self) -> str:
        """Return a sentence with the factor."""
        factor = float(np.exp(self.value))
        return f"{self.does('reads', 'read')} {factor:.4g} times what is there."
