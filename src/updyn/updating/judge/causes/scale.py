"""Data in another unit than SI: a known factor between units."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import ClassVar, Self

import numpy as np

from updyn.errors import OptionError
from updyn.frf import FRF
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import Fault, multiply_channels
from updyn.updating.judge.causes.settings import CHANNEL_FAULT

__all__ = ["UNITS", "WrongUnit"]

#: Factors by which data are too large, by cause: units of motion, of force, and of both together.
UNITS: Mapping[str, float] = MappingProxyType(
    {
        "g instead of m/s2": 1.0 / 9.80665,
        "m/s2 taken for g": 9.80665,
        "mm instead of m": 1e3,
        "m taken for mm": 1e-3,
        "um instead of m": 1e6,
        "inch instead of m": 1.0 / 0.0254,
        "m taken for inch": 0.0254,
        "lbf instead of N": 4.4482216152605,
        "N taken for lbf": 1.0 / 4.4482216152605,
        "kN instead of N": 1e3,
        "g over lbf": 4.4482216152605 / 9.80665,
        "inch over lbf": 4.4482216152605 / 0.0254,
        "mm over kN": 1e6,
    }
)


class WrongUnit(Fault):
    """All data are `value` times their values in SI."""

    __slots__ = ()

    kind: ClassVar[str] = "scale"

    odds: ClassVar[float] = 5e-3

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield the factors between units in use."""
        for factor in sorted(set(UNITS.values())):
            yield cls((), factor)

    @classmethod
    def near(cls, channels: tuple[str, ...], factor: float) -> Iterable[Self]:
        """Yield the factors between units near a factor that was found."""
        for known in sorted(set(UNITS.values())):
            if abs(np.log(known / factor)) < CHANNEL_FAULT.near_unit:
                yield cls(channels, known)

    @classmethod
    def parse(cls, channels: str, value: str) -> Self:
        """Return the fault from its text."""
        found = super().parse(channels, value)
        if not found.value > 0.0:
            raise OptionError(f"repair 'scale': {value!r}; expected a factor above 0")
        return found

    def repair(self, frf: FRF) -> FRF:
        """Return the data in SI."""
        return multiply_channels(frf, self.channels, np.full(len(frf.freq), -np.log(self.value)))

    def statement(self) -> str:
        """Return a sentence with the factor and the units that explain it."""
        near = CHANNEL_FAULT.same_unit
        causes = [name for name, f in UNITS.items() if abs(np.log(f / self.value)) < near]
        return (
            f"The values of {self.channel_text} are {self.value:.6g} times the true values:"
            f" {' or '.join(causes) or 'another unit'}."
        )
