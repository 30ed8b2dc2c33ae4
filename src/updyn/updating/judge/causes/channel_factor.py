"""Faults that multiply channels by a factor: sign, calibration, delay, low-pass."""

from __future__ import annotations

from abc import abstractmethod
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

__all__ = ["Calibration", "ChannelFactor", "Delay", "LowPass", "WrongSign"]


class ChannelFactor(Fault):
    """A factor exp(`log_factor`) on one channel, or without channels on all data."""

    __slots__ = ()

    is_local: ClassVar[bool] = True

    @abstractmethod
    def log_factor(self, frf: FRF) -> ComplexArray:
        """Return the logarithm of the factor over the lines, shape (n_f,)."""

    def log_slope(self, frf: FRF) -> ComplexArray:
        """Return the derivative of `log_factor` by the size, shape (n_f,); 0 without a size."""
        return np.zeros(len(frf.freq), dtype=np.complex128)

    @classmethod
    def list_sizes(cls, frf: FRF) -> Iterable[float]:
        """Return the sizes from which the search begins."""
        return (0.0,)

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield all channels together, then each, with several sizes."""
        for channels in [(), *list_channels(evidence.frf)]:
            for size in cls.list_sizes(evidence.frf):
                yield cls(channels, float(size))

    def repair(self, frf: FRF) -> FRF:
        """Return the data divided by the factor."""
        return multiply_channels(frf, self.channels, -self.log_factor(frf))

    def slope(self, evidence: Evidence) -> ComplexArray:
        """Return `log_slope` at the channels, else 0."""
        frf = evidence.frf
        return find_channels(self.channels, frf).broadcast(self.log_slope(frf), frf.values.shape)


class WrongSign(ChannelFactor):
    """The opposite sign of a sensor or of a force; without channels, of all data."""

    __slots__ = ()

    kind: ClassVar[str] = "sign"

    def log_factor(self, frf: FRF) -> ComplexArray:
        """Return -i pi."""
        return np.full(len(frf.freq), -1j * np.pi)

    def statement(self) -> str:
        """Return a sentence with the channels."""
        return f"The sign of {self.channel_text} is opposite to the label."


class Calibration(ChannelFactor):
    """The values of a channel are exp(value) times too large."""

    __slots__ = ()

    kind: ClassVar[str] = "calibration"
    has_free_size: ClassVar[bool] = True
    is_additive: ClassVar[bool] = True

    def log_factor(self, frf: FRF) -> ComplexArray:
        """Return the value."""
        return np.full(len(frf.freq), self.value, dtype=np.complex128)

    def log_slope(self, frf: FRF) -> ComplexArray:
        """Return 1."""
        return np.ones(len(frf.freq), dtype=np.complex128)

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


class Delay(ChannelFactor):
    """A channel is late by `value` seconds; a negative value means early."""

    __slots__ = ()

    kind: ClassVar[str] = "delay"
    unit: ClassVar[str] = "s"
    has_free_size: ClassVar[bool] = True
    is_additive: ClassVar[bool] = True

    @classmethod
    def list_sizes(cls, frf: FRF) -> Iterable[float]:
        """Return delays in s."""
        return [periods / frf.freq[-1] for periods in CHANNEL_FAULT.delay_periods]

    def log_factor(self, frf: FRF) -> ComplexArray:
        """Return -i omega value."""
        return -frf.s * self.value

    def log_slope(self, frf: FRF) -> ComplexArray:
        """Return -i omega."""
        return -frf.s

    def statement(self) -> str:
        """Return a sentence with the delay."""
        late = "late" if self.value > 0 else "early"
        return f"{self.begin_sentence('is', 'are')} {abs(self.value):.4g} s {late}."


class LowPass(ChannelFactor):
    """A channel is filtered by 1 / (1 + i omega value), with `value` in s."""

    __slots__ = ()

    kind: ClassVar[str] = "low-pass"
    unit: ClassVar[str] = "s"
    has_free_size: ClassVar[bool] = True
    is_positive: ClassVar[bool] = True

    @classmethod
    def list_sizes(cls, frf: FRF) -> Iterable[float]:
        """Return time constants in s."""
        highest = 2.0 * np.pi * frf.freq[-1]
        return [1.0 / (corner * highest) for corner in CHANNEL_FAULT.corner_shares]

    def log_factor(self, frf: FRF) -> ComplexArray:
        """Return -ln(1 + i omega value)."""
        return -np.log1p(frf.s * self.value)

    def log_slope(self, frf: FRF) -> ComplexArray:
        """Return -i omega / (1 + i omega value)."""
        return -frf.s / (1.0 + frf.s * self.value)

    def statement(self) -> str:
        """Return a sentence with the corner frequency."""
        corner = 1.0 / (2.0 * np.pi * self.value)
        subject = self.begin_sentence("is", "are")
        return f"{subject} filtered by a first-order low-pass at {corner:.4g} Hz."
