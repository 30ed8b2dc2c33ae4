"""Two FRFs that should be equal: response at a to a force at b, and the reverse."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.frf import FRF
from updyn.remedy import Remedy
from updyn.updating.judge.causes.settings import CAUSE_ODDS, CAUSE_SEARCH, CHANNEL_FAULT, DATA_FAULT
from updyn.updating.judge.causes.shown import DataFault, Detection
from updyn.updating.judge.causes.square import CollocatedFrfs

__all__ = ["Reciprocity"]


@dataclass(frozen=True, slots=True)
class Reciprocity(DataFault):
    """H_ab and H_ba differ by a share of `value`.

    They are equal for a linear passive structure without rotating parts (Ewins, Modal Testing, 2nd
    ed. 2000, section 2.5).
    """

    explanation: str = ""

    kind: ClassVar[str] = "reciprocity"
    odds: ClassVar[float] = 1e-2
    is_symptom: ClassVar[bool] = True
    needs_forces: ClassVar[bool] = True

    @classmethod
    def detect_faults(cls, frf: FRF) -> Iterable[Detection]:
        """Yield the pairs that are not reciprocal, the worst first."""
        square = CollocatedFrfs.of(frf)
        found = []
        for a, b in square.iter_pairs():
            difference = _Difference.of(square, a, b)
            if len(difference.freq) < CAUSE_SEARCH.least_lines:
                continue
            size = difference.size
            noise = float(np.median(difference.noise**2))
            ratio = size**2 / (DATA_FAULT.usual_difference**2 + noise)
            # A difference of one cause is the same at all lines: it counts as one sample.
            log_odds = ratio - 1.0 - float(np.log(max(ratio, 1.0))) + float(np.log(cls.odds))
            if ratio > 1.0 and log_odds > CAUSE_ODDS.likely_log_odds:
                pair = (square.labels[a], square.labels[b])
                fault = cls(pair, size, difference.explain())
                found.append(Detection(fault, log_odds, min(size, 1.0)))
        number = max(sum(1 for _ in square.iter_pairs()), 1)
        found.sort(key=lambda one: -one.log_odds)
        for one in found:
            yield replace(one, share=one.share / number)

    @property
    def remedy(self) -> Remedy:
        """Advice to the user."""
        return Remedy(
            "Check place and direction of sensor and hammer, and the sensitivities, in the two"
            f" runs; measure {self.channel_text} again, or omit the doubtful one."
        )

    def statement(self) -> str:
        """Return a sentence with the pair, the difference, and its explanation."""
        a, b = self.channels
        return (
            f"Reciprocity is violated: the response at {a} to a force at {b} and that at {b} to a"
            f" force at {a} differ by {100.0 * self.value:.0f} %{self.explanation}."
        )

    def mask_values(self, frf: FRF) -> FRF:
        """Return the data in which neither of the two FRFs has weight."""
        square = CollocatedFrfs.of(frf)
        a, b = (square.labels.index(label) for label in self.channels)
        return square.mask_pairs(frf, [(a, b), (b, a)])


@dataclass(frozen=True, slots=True, eq=False)
class _Difference:
    """ln(H_ab / H_ba) at the lines with both above the noise, its noise, and the lines in Hz."""

    log_ratio: ComplexArray
    noise: RealArray
    freq: RealArray

    @classmethod
    def of(cls, square: CollocatedFrfs, a: int, b: int) -> _Difference:
        H, G = square.values[:, a, b], square.values[:, b, a]
        h, g = square.noise[:, a, b], square.noise[:, b, a]
        clear = (np.abs(H) > DATA_FAULT.phase_stds * h) & (np.abs(G) > DATA_FAULT.phase_stds * g)
        H, G = H[clear], G[clear]
        noise = np.hypot(h[clear] / np.abs(H), g[clear] / np.abs(G))
        return cls(np.log(H / G), noise, square.freq[clear])

    @property
    def size(self) -> float:
        """Median difference, which ignores the few lines of slightly shifted resonances."""
        return float(np.sqrt(np.median(np.abs(self.log_ratio) ** 2)))

    def divide_by(self, log_factor: complex | ComplexArray) -> _Difference:
        """Return the difference after division by a factor, with phases between -pi and pi."""
        remaining = self.log_ratio - log_factor
        return replace(self, log_ratio=remaining.real + 1j * np.angle(np.exp(1j * remaining.imag)))

    def estimate_delay(self) -> float:
        """Return the delay in s that aligns the two best."""
        most = CHANNEL_FAULT.delay_periods[-1]
        delays = np.linspace(-most, most, DATA_FAULT.delay_points) / self.freq[-1]
        unit = np.exp(1j * self.log_ratio.imag)
        aligned = (np.exp(2j * np.pi * delays[:, None] * self.freq) @ unit).real
        return float(delays[np.argmax(aligned)])

    def explain(self) -> str:
        """Return the explanation of the difference by one or two numbers, if there is one."""
        factor, late = float(np.median(self.log_ratio.real)), self.estimate_delay()
        delay_phase: ComplexArray = np.asarray(-2j * np.pi * self.freq * late)
        times = f"a factor of {np.exp(factor):.3g}"
        explanations: list[tuple[complex | ComplexArray, str]] = [
            (1j * np.pi, "the sign"),
            (factor, times),
            (factor + 1j * np.pi, f"the sign and {times}"),
            (delay_phase, f"a delay of {late:.2g} s"),
            (np.asarray(factor + delay_phase), f"a delay of {late:.2g} s and {times}"),
        ]
        for log_factor, text in explanations:
            if self.divide_by(log_factor).size < DATA_FAULT.explained_difference * self.size:
                return f"; {text} explains it"
        return "; neither sign nor a factor nor a delay explains it"
