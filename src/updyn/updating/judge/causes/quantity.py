"""Data of another quantity than is stated: displacement, velocity or acceleration."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import ClassVar, Self

import numpy as np

from updyn.errors import DataError, OptionError, suggest
from updyn.frf import FRF, QUANTITIES
from updyn.updating.judge.causes.evidence import Evidence, labels_of
from updyn.updating.judge.causes.fault import Fault, multiplied

__all__ = ["Quantity"]

_NAMES = {power: name for name, power in QUANTITIES.items()}


class Quantity(Fault):
    """The channels are what (i omega)**value times receptance is, whatever they are called."""

    __slots__ = ()

    kind: ClassVar[str] = "quantity"
    odds: ClassVar[float] = 1e-2

    @property
    def changes_all(self) -> bool:
        """Whether it is of all channels."""
        return not self.channels

    @classmethod
    def suspected(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield the two other quantities, of all data and of each sensor among several."""
        frf = evidence.frf
        if frf.freq[0] == 0.0:
            return
        each = [(label,) for label in labels_of(frf)]
        places = [(), *each] if len(each) > 1 else [()]
        for name, power in QUANTITIES.items():
            if name != frf.quantity:
                yield from (cls(channels, float(power)) for channels in places)

    @property
    def name(self) -> str:
        """What the channels are."""
        return _NAMES[round(self.value)]

    def repair(self, frf: FRF) -> FRF:
        """Return the same numbers under the right name; single channels in the quantity stated.

        Raises
        ------
        DataError
            If single channels have a line at 0 Hz, where quantities cannot be converted.
        """
        if not self.channels:
            return replace(frf, quantity=self.name)
        if (frf.s == 0.0).any():
            raise DataError(f"repair {self.written!r}: no quantity is converted at 0 Hz")
        power = QUANTITIES[frf.quantity] - round(self.value)
        return multiplied(frf, self.channels, power * np.log(frf.s))

    def statement(self) -> str:
        """Return what the channels are."""
        if not self.channels:
            return f"The data are {self.name}, and not what they are called."
        return f"{self.does('is', 'are')} {self.name}, unlike the other channels."

    @property
    def written(self) -> str:
        """``quantity=mobility``, ``quantity:2:Z=mobility``."""
        return f"{self.named}={self.name}"

    @classmethod
    def read(cls, channels: str, value: str) -> Self:
        """Return the fault that is written down.

        Raises
        ------
        OptionError
            If it names no quantity, or a label cannot be read.
        """
        if value not in QUANTITIES:
            raise OptionError(f"repair 'quantity': {value!r}; {suggest(value, QUANTITIES)}")
        return replace(super().read(channels, ""), value=float(QUANTITIES[value]))
