"""Data of another quantity than stated: displacement, velocity or acceleration over force."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import ClassVar, Self

import numpy as np

from updyn.errors import DataError, OptionError, suggest
from updyn.frf import FRF, QUANTITIES
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import Fault, multiply_channels
from updyn.updating.judge.causes.labels import list_response_labels

__all__ = ["WrongQuantity"]

_NAMES = {power: name for name, power in QUANTITIES.items()}


class WrongQuantity(Fault):
    """The channels are (i omega)**value times receptance, which is another quantity than stated."""

    __slots__ = ()

    kind: ClassVar[str] = "quantity"
    odds: ClassVar[float] = 1e-2
    needs_forces: ClassVar[bool] = True
    is_local: ClassVar[bool] = True

    @property
    def affects_all_data(self) -> bool:
        """Whether it affects all channels."""
        return not self.channels

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield the two other quantities, for all data and for each of several sensors."""
        frf = evidence.frf
        if frf.freq[0] == 0.0:
            return
        each = [(label,) for label in list_response_labels(frf)]
        places = [(), *each] if len(each) > 1 else [()]
        for name, power in QUANTITIES.items():
            if name != frf.quantity:
                yield from (cls(channels, float(power)) for channels in places)

    @property
    def quantity(self) -> str:
        """Name of the quantity."""
        return _NAMES[round(self.value)]

    def repair(self, frf: FRF) -> FRF:
        """Return the data with the correct quantity; single channels are converted."""
        if not self.channels:
            return replace(frf, quantity=self.quantity)
        if (frf.s == 0.0).any():
            raise DataError(f"repair {self.repair_text!r}: no quantity is converted at 0 Hz")
        power = QUANTITIES[frf.quantity] - round(self.value)
        return multiply_channels(frf, self.channels, power * np.log(frf.s))

    def statement(self) -> str:
        """Return a sentence with the quantity."""
        if not self.channels:
            return f"The data are {self.quantity}, not the stated quantity."
        return f"{self.begin_sentence('is', 'are')} {self.quantity}, unlike the other channels."

    @property
    def repair_text(self) -> str:
        """Text of the fault: ``quantity=mobility``, ``quantity:2:Z=mobility``."""
        return f"{self.name}={self.quantity}"

    @classmethod
    def parse(cls, channels: str, value: str) -> Self:
        """Return the fault from its text."""
        if value not in QUANTITIES:
            raise OptionError(f"repair 'quantity': {value!r}; {suggest(value, QUANTITIES)}")
        return replace(super().parse(channels, ""), value=float(QUANTITIES[value]))
