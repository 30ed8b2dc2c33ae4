"""Data of another quantity than is stated: displacement, velocity or acceleration."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import ClassVar, Self

from updyn.errors import OptionError, suggest
from updyn.frf import FRF, QUANTITIES
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import Fault

__all__ = ["Quantity"]

_NAMES = {power: name for name, power in QUANTITIES.items()}


class Quantity(Fault):
    """The data are what (i omega)**value times receptance is, whatever they are called."""

    __slots__ = ()

    kind: ClassVar[str] = "quantity"
    odds: ClassVar[float] = 1e-2
    changes_all: ClassVar[bool] = True

    @classmethod
    def suspected(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield the two other quantities."""
        for name, power in QUANTITIES.items():
            if name != evidence.frf.quantity and evidence.frf.freq[0] > 0.0:
                yield cls((), float(power))

    @property
    def name(self) -> str:
        """What the data are."""
        return _NAMES[round(self.value)]

    def repair(self, frf: FRF) -> FRF:
        """Return the same numbers under the right name."""
        return replace(frf, quantity=self.name)

    def statement(self) -> str:
        """Return what the data are."""
        return f"The data are {self.name}, and not what they are called."

    @property
    def written(self) -> str:
        """``quantity=mobility``."""
        return f"{self.kind}={self.name}"

    @classmethod
    def read(cls, channels: str, value: str) -> Self:
        """Return the fault that is written down.

        Raises
        ------
        OptionError
            If it names no quantity.
        """
        if value not in QUANTITIES:
            raise OptionError(f"repair 'quantity': {value!r}; {suggest(value, QUANTITIES)}")
        return cls((), float(QUANTITIES[value]))
