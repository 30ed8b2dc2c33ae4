"""Records that were cut off before the response had decayed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from updyn.frf import FRF
from updyn.updating.judge.causes.shown import LIKELY, Shown, ShownFault
from updyn.updating.problem.noise import level_by_unit

__all__ = ["Leakage"]

_Real = NDArray[np.float64]

#: Fewest lines, and how far spacings may differ.
_FEWEST, _EVEN = 48, 1e-3
#: Samples beside the end of the record that its band limits blur, and averaged over.
_BLURRED, _LEAST_AVERAGED, _SHARE = 3, 5, 1.0 / 16.0
#: Logarithm of the ratio of powers from which there is an edge: 22 dB.
_EDGE = 2.2 * np.log(10.0)
#: Share of the largest fall.
_MOST_OF_IT = 0.7


@dataclass(frozen=True, slots=True)
class Leakage(ShownFault):
    """Records of `value` seconds were cut off while the structure still moved, and padded by zeros.

    Along the lines the FRF then ripples with a period of 1 / value; the impulse response ends at
    value, earlier than 1 over the spacing of the lines.
    """

    kind: ClassVar[str] = "leakage"
    unit: ClassVar[str] = "s"
    blurs: ClassVar[tuple[str, ...]] = ("missing-mode", "drive-point")

    @classmethod
    def shown(cls, frf: FRF) -> Iterable[Shown]:
        """Yield the end of the impulse response, where it has one, of evenly spaced lines."""
        spacing = np.diff(frf.freq)
        if len(frf.freq) < _FEWEST or np.ptp(spacing) > _EVEN * spacing.mean():
            return
        power = _impulse_power(frf)
        n = max(int(_SHARE * len(power)), _LEAST_AVERAGED)
        edges, first = _edges(power, n)
        # The taper still falls behind the end: the first sample that has most of it.
        best = int(np.argmax(edges > _MOST_OF_IT * edges.max()))
        # Under a Hann window every other sample is one more observation.
        log_odds = 0.5 * n * float(edges[best] - 1.0) + float(np.log(cls.odds))
        if edges[best] > _EDGE and log_odds > LIKELY:
            end = _end(power, best + first, n)
            length = end / (len(power) * float(spacing.mean()))
            lost = float(power[end - n : end].mean() / power.max())
            yield Shown(cls((), length), log_odds, min(lost, 1.0))

    @property
    def remedy(self) -> str:
        """What to do about it."""
        return (
            "Measure longer records, or with an exponential window whose damping is taken out"
            ' again: repair = ["window-damping=..."].'
        )

    def statement(self) -> str:
        """Return where the records end."""
        return (
            f"The records were cut off after {self.value:.3g} s, before the response had decayed:"
            f" the FRFs ripple with a period of {1.0 / self.value:.3g} Hz (leakage)."
        )


def _impulse_power(frf: FRF) -> _Real:
    """Return the mean square of the impulse responses of all channels, shape (n_f,).

    They are those of the band, tapered by a Hann window against the ringing of its limits, from 0
    to 1 over the spacing of the lines.
    """
    n = len(frf.freq)
    H = (frf.values / level_by_unit(frf)).reshape(n, -1)
    h = np.fft.ifft(H * np.hanning(n)[:, None], axis=0)
    return np.asarray(np.mean(np.abs(h) ** 2, axis=1))


def _edges(power: _Real, n: int) -> tuple[_Real, int]:
    """Return by how much the logarithm of the power falls at each sample, and the first sample.

    What is returned is beyond the decay that averages over n samples before and after show.
    """
    mean = np.log(sliding_window_view(power, n).mean(axis=1) + 1e-12 * power.max())
    first = 2 * n + _BLURRED
    at = np.arange(first, len(power) - first + 1)
    early, before = mean[at - _BLURRED - 2 * n], mean[at - _BLURRED - n]
    after, late = mean[at + _BLURRED], mean[at + _BLURRED + n]
    decay = np.maximum(np.maximum(early - before, after - late), 0.0)
    return before - after - decay * (n + 2 * _BLURRED) / n, first


def _end(power: _Real, near: int, n: int) -> int:
    """Return the sample of an edge: the taper leaves half of the amplitude there."""
    before = power[near - n - _BLURRED : near - _BLURRED].mean()
    above = np.flatnonzero(power[near - n : near + n] > 0.25 * before)
    return int(near - n + above[-1] + 1) if len(above) else near
