"""Records that were cut off before the response had decayed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from updyn.arrays import RealArray
from updyn.frf import FRF
from updyn.updating.judge.causes.settings import CAUSE_ODDS, CUT_RECORD
from updyn.updating.judge.causes.shown import DataFault, Detection
from updyn.updating.problem.noise import level_by_unit

__all__ = ["Leakage"]


@dataclass(frozen=True, slots=True)
class Leakage(DataFault):
    """Records of `value` seconds were cut off before the response had decayed, and padded by zeros.

    The FRF then ripples along the lines with a period of 1 / value; the impulse response ends at
    value, before the reciprocal of the spacing of the lines.
    """

    kind: ClassVar[str] = "leakage"
    unit: ClassVar[str] = "s"
    imitated_kinds: ClassVar[tuple[str, ...]] = ("missing-mode", "drive-point")
    advice: ClassVar[str] = (
        "Measure longer records, or use an exponential window and correct its damping:"
        ' repair = ["window-damping=..."].'
    )

    @classmethod
    def detect_faults(cls, frf: FRF) -> Iterable[Detection]:
        """Yield the end of the impulse response, if any, of data with evenly spaced lines."""
        if len(frf.freq) < CUT_RECORD.least_lines:
            return
        spacing = np.diff(frf.freq)
        if np.ptp(spacing) > CUT_RECORD.even_spacing * spacing.mean():
            return
        power = _compute_impulse_power(frf)
        n = max(int(CUT_RECORD.averaged_share * len(power)), CUT_RECORD.least_averaged)
        edges, first = _measure_edges(power, n)
        # The taper falls after the end as well: take the first sample with most of the drop.
        best = int(np.argmax(edges > CUT_RECORD.edge_share * edges.max()))
        # Under a Hann window every other sample is an independent observation.
        log_odds = 0.5 * n * float(edges[best] - 1.0) + float(np.log(cls.odds))
        if edges[best] > CUT_RECORD.edge and log_odds > CAUSE_ODDS.likely_log_odds:
            end = _find_end(power, best + first, n)
            length = end / (len(power) * float(spacing.mean()))
            lost = float(power[end - n : end].mean() / power.max())
            yield Detection(cls((), length), log_odds, min(lost, 1.0))

    def statement(self) -> str:
        """Return a sentence with the length of the records."""
        return (
            f"The records were cut off after {self.value:.3g} s, before the response had decayed:"
            f" the FRFs ripple with a period of {1.0 / self.value:.3g} Hz (leakage)."
        )


def _compute_impulse_power(frf: FRF) -> RealArray:
    """Return the mean square of the impulse responses, tapered by a Hann window, shape (n_f,)."""
    n = len(frf.freq)
    H = (frf.values / level_by_unit(frf)).reshape(n, -1)
    h = np.fft.ifft(H * np.hanning(n)[:, None], axis=0)
    return np.asarray(np.mean(np.abs(h) ** 2, axis=1))


def _measure_edges(power: RealArray, n: int) -> tuple[RealArray, int]:
    """Return the drop of the log power beyond the decay at each sample, and the first sample."""
    mean = np.log(sliding_window_view(power, n).mean(axis=1) + 1e-12 * power.max())
    blurred = CUT_RECORD.blurred_samples
    first = 2 * n + blurred
    at = np.arange(first, len(power) - first + 1)
    early, before = mean[at - blurred - 2 * n], mean[at - blurred - n]
    after, late = mean[at + blurred], mean[at + blurred + n]
    decay = np.maximum(np.maximum(early - before, after - late), 0.0)
    return before - after - decay * (n + 2 * blurred) / n, first


def _find_end(power: RealArray, near: int, n: int) -> int:
    """Return the sample of an edge, at which the taper leaves half of the amplitude."""
    last = near - CUT_RECORD.blurred_samples
    before = power[last - n : last].mean()
    above = np.flatnonzero(power[near - n : near + n] > 0.25 * before)
    return int(near - n + above[-1] + 1) if len(above) else near
