"""Mains hum: single lines at multiples of 50 or 60 Hz."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, RealArray
from updyn.errors import OptionError
from updyn.frf import FRF
from updyn.updating.judge.causes.settings import CAUSE_ODDS, DATA_FAULT, MAINS_HUM
from updyn.updating.judge.causes.shown import DataFault, Detection
from updyn.updating.judge.settings import SIGNIFICANCE

__all__ = ["MainsHum"]


#: Mains frequencies in Hz.
_FREQUENCIES = (50.0, 60.0)


@dataclass(frozen=True, slots=True)
class MainsHum(DataFault):
    """Lines at multiples of `value` Hz contain mains hum; `lines` are the outliers in Hz."""

    lines: tuple[float, ...] = ()
    channel_count: str = ""

    kind: ClassVar[str] = "mains"
    unit: ClassVar[str] = "Hz"
    odds: ClassVar[float] = 1e-2
    advice: ClassVar[str] = "Omit these lines:"
    remark: ClassVar[str] = "Before the next test, check cables and grounding."

    @classmethod
    def detect_faults(cls, frf: FRF) -> Iterable[Detection]:
        """Yield 50 or 60 Hz, the more likely one, for evenly and finely spaced lines."""
        if len(frf.freq) <= 2 * MAINS_HUM.neighbours:
            return
        found: list[Detection] = []
        for frequency in _FREQUENCIES:
            is_multiple = _find_mains_lines(frf.freq, frequency)
            if (
                is_multiple.any()
                and np.gradient(frf.freq)[is_multiple].max() <= MAINS_HUM.coarse * frequency
            ):
                found += cls._detect_at(frf, frequency, is_multiple)
        yield from sorted(found, key=lambda one: -one.log_odds)[:1]

    @classmethod
    def _detect_at(cls, frf: FRF, frequency: float, is_multiple: BoolArray) -> Iterable[Detection]:
        found = _Neighbours.of(frf, is_multiple)
        # A mains line has to exceed the largest outlier of all other lines.
        height = np.median(found.deviation_ratio, axis=1)
        others = float(height[~is_multiple].max(initial=0.0))
        is_outlier = _find_mains_lines(frf.freq, frequency, MAINS_HUM.near) & (
            height > max(DATA_FAULT.outlier_stds, others)
        )
        is_outlier &= np.median(found.pole_ratio, axis=1) < SIGNIFICANCE.stds
        # One line may be a very sharp resonance; several at multiples are unlikely to be.
        is_proven = is_outlier & (found.bandwidth < MAINS_HUM.sharp_lines)
        if not is_proven.any() and len(np.unique(np.round(frf.freq[is_outlier] / frequency))) < 2:
            return
        # The noise of a force is common to all its channels, so only one channel counts.
        n = MAINS_HUM.neighbours - MAINS_HUM.degree - 1
        gains = n * np.log1p(height[is_outlier] ** 2 / n) - np.log(len(frf.freq))
        log_odds = float(np.sum(gains) + np.log(cls.odds))
        if log_odds > CAUSE_ODDS.likely_log_odds:
            is_affected = (
                np.mean(found.deviation_ratio[is_outlier] > DATA_FAULT.outlier_stds, axis=0)
                >= MAINS_HUM.affected_share
            )
            text = f"{np.count_nonzero(is_affected)} of {is_affected.size} channels"
            lines = tuple(float(f) for f in frf.freq[is_outlier])
            share = np.count_nonzero(is_outlier) / len(frf.freq)
            yield Detection(cls((), frequency, lines, text), log_odds, share)

    @property
    def repair_text(self) -> str:
        """Text of the fault: ``mains=50``."""
        return f"{self.kind}={self.value:g}"

    @classmethod
    def parse(cls, channels: str, value: str) -> MainsHum:
        """Return the fault from its text."""
        found = super(DataFault, cls).parse(channels, value)
        if not found.value > 0.0 or found.channels:
            raise OptionError(f"repair {cls.kind!r}: expected mains=50 or mains=60")
        return found

    def repair(self, frf: FRF) -> FRF:
        """Return the data without the lines next to multiples of the frequency."""
        return frf.select(lines=frf.freq[~_find_mains_lines(frf.freq, self.value)])

    def statement(self) -> str:
        """Return a sentence with the affected lines."""
        shown = ", ".join(f"{f:.4g}" for f in self.lines[:6])
        if len(self.lines) > 6:
            shown += f" and {len(self.lines) - 6} more"
        plural = "s" if len(self.lines) > 1 else ""
        return (
            f"Mains hum of {self.value:g} Hz: the line{plural} at {shown} Hz"
            f" deviate{'s' * (not plural)} from the neighbouring lines in {self.channel_count}."
        )


def _find_mains_lines(freq: RealArray, frequency: float, share: float = 0.5) -> BoolArray:
    """Return the lines next to multiples of a frequency, within a share of the spacing."""
    order = np.round(freq / frequency)
    distance = np.abs(freq - order * frequency) / np.gradient(freq)
    return np.asarray((order >= 1) & (distance <= share * (1.0 + 1e-9)))


@dataclass(frozen=True, slots=True, eq=False)
class _Neighbours:
    """Comparison of lines with a polynomial through neighbouring lines without hum.

    `deviation_ratio` and `pole_ratio` (the size of a resonance on the line), shape (n_f, n_c), are
    in standard deviations; `bandwidth`, shape (n_f,), is the smallest half-power bandwidth, in
    lines, of a resonance that would explain the line (Pintelon & Schoukens, System Identification,
    2nd ed. 2012, chapter 7, without the transient).
    """

    deviation_ratio: RealArray
    pole_ratio: RealArray
    bandwidth: RealArray

    @classmethod
    def of(cls, frf: FRF, is_multiple: BoolArray) -> _Neighbours:
        n, width = len(frf.freq), MAINS_HUM.neighbours
        flat = frf.values.reshape(n, -1)
        least = 1e-12 * np.abs(flat).max() + np.finfo(float).tiny
        deviation_ratio, pole_ratio, bandwidth = (
            np.zeros(flat.shape),
            np.zeros(flat.shape),
            np.zeros(n),
        )
        quiet = np.flatnonzero(~is_multiple)
        compared = quiet[:: -(-n // MAINS_HUM.most_compared)]
        for k in np.union1d(np.flatnonzero(is_multiple), compared):
            others = quiet[quiet != k]
            first = np.searchsorted(others, k) - width // 2
            near = others[np.clip(first, 0, len(others) - width) + np.arange(width)]
            distance = (frf.freq[near] - frf.freq[k]) / (np.ptp(frf.freq[near]) / width)
            powers = (distance / width)[:, None] ** np.arange(MAINS_HUM.degree + 1)
            weights, std = _fit_basis(powers, flat[near], least)
            deviation = np.abs(flat[k] - weights[0] @ flat[near])
            deviation_ratio[k] = deviation / (std * np.sqrt(1.0 + weights[0] @ weights[0]))
            with_pole = np.column_stack([1.0 / distance, powers[:, : MAINS_HUM.degree]])
            weights, std = _fit_basis(with_pole, flat[near], least)
            deviation_of_pole = float(np.sqrt(weights[0] @ weights[0]))
            pole_ratio[k] = np.abs(weights[0] @ flat[near]) / (std * deviation_of_pole)
            # A resonance is at the same line in all channels, so their noise averages out.
            power = max(float(np.sum(pole_ratio[k] ** 2 - 1.0)), 0.0) + 2.0 * np.sqrt(len(std))
            height = np.maximum(np.linalg.norm(deviation / std), np.finfo(float).tiny)
            bandwidth[k] = deviation_of_pole * np.sqrt(power) / height
        return cls(deviation_ratio, pole_ratio, bandwidth)


def _fit_basis(basis: RealArray, values: ComplexArray, least: float) -> tuple[RealArray, RealArray]:
    """Return the weights for each coefficient, and the standard deviation of the residual."""
    Q, R = np.linalg.qr(basis)
    residual = values - Q @ (Q.T @ values)
    freedom = len(basis) - basis.shape[1]
    std = np.sqrt(np.sum(np.abs(residual) ** 2, axis=0) / freedom)
    return np.linalg.solve(R, Q.T), np.maximum(std, least)
