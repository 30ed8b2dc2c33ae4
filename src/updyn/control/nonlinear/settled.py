"""`judge_end`: classify the end of a simulated oscillation: limit cycle, decay, rest or growth."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from updyn.arrays import RealArray
from updyn.control.nonlinear.settings import OSCILLATION_END

__all__ = ["OscillationEnd", "judge_end"]


@dataclass(frozen=True, slots=True)
class OscillationEnd:
    """The end of an oscillation: verdict and figures as in `Simulation`."""

    verdict: str
    amplitude: float | None = None
    peak: float | None = None
    frequency: float | None = None
    periods: int = 0


def judge_end(time: RealArray, z: RealArray, switches: RealArray, half: float) -> OscillationEnd:
    """Return the classification of the end of a series `z`.

    `switches` are times of changes of contact or sticking; `half` is half a gap, 0 for friction.
    """
    end = float(time[-1])
    first = int(np.searchsorted(time, (1.0 - OSCILLATION_END.evaluated_share) * end))
    t, y = time[first:], z[first:]
    span, whole = float(np.ptp(y)), float(np.ptp(z))
    if span <= 1e-9 * max(float(np.abs(z).max()), half):
        return OscillationEnd("at rest")
    if not len(switches) or switches[-1] < t[0]:
        # No contact any more: a swing within the gap, or a drift.
        if np.ptp(y[len(y) // 2 :]) > 1.02 * np.ptp(y[: len(y) // 2]):
            return _trend(t, y, whole)
        return OscillationEnd("decays")
    starts = _rises(t, y - 0.5 * (y.max() + y.min()))
    if len(starts) < 3:
        return _trend(t, y, whole)
    lengths = np.diff(starts)
    tops = np.array([np.ptp(y[(t >= a) & (t <= b)]) / 2 for a, b in pairwise(starts)])
    spread, least = OSCILLATION_END.steady_spread, OSCILLATION_END.least_periods
    n = min(len(lengths), 4 * least)
    lengths, tops = lengths[-n:], tops[-n:]
    steady = np.ptp(tops) <= spread * tops[-1] and np.ptp(lengths) <= spread * lengths[-1]
    if n >= least and steady:
        a, b = float(starts[-n - 1]), float(starts[-1])
        frequency = n / (b - a)
        return OscillationEnd(
            "limit cycle", _harmonic(t, y, a, b, frequency), float(tops.mean()), frequency, n
        )
    return _trend(t, y, whole)


def _trend(t: RealArray, y: RealArray, whole: float) -> OscillationEnd:
    """Return a verdict from the ranges of quarters of the series, relative to the whole record."""
    edges = np.linspace(t[0], t[-1], 5)
    sizes = np.array([np.ptp(y[(t >= a) & (t <= b)]) for a, b in pairwise(edges)])
    steps = np.diff(sizes)
    spread = OSCILLATION_END.steady_spread
    is_small = sizes.max() < OSCILLATION_END.decayed_share * whole
    if is_small and sizes[2:].max() <= sizes[:2].max():
        return OscillationEnd("decays")
    if (steps < 0).all() and sizes[-1] < (1 - spread) * sizes[0]:
        return OscillationEnd("decays")
    if (steps > 0).all() and sizes[-1] > (1 + spread) * sizes[0]:
        return OscillationEnd("grows")
    return OscillationEnd("not settled")


def _rises(t: RealArray, y: RealArray) -> RealArray:
    """Return the times of upward zero crossings whose swings exceed a tenth of the maximum."""
    size = 0.1 * float(np.abs(y).max())
    out, armed = [], False
    for i in range(1, len(y)):
        if y[i] < -size:
            armed = True
        if armed and y[i - 1] < 0 <= y[i]:
            crossing = t[i - 1] - y[i - 1] * (t[i] - t[i - 1]) / (y[i] - y[i - 1])
        if armed and y[i] > size:
            out.append(float(crossing))
            armed = False
    return np.array(out)


def _harmonic(t: RealArray, y: RealArray, a: float, b: float, frequency: float) -> float:
    """Return the amplitude of the first harmonic over whole periods, by the trapezoidal rule."""
    inside = (t > a) & (t < b)
    times = np.concatenate([[a], t[inside], [b]])
    values = np.interp(times, t, y)
    wave = np.exp(-2j * np.pi * frequency * times)
    return float(abs(2.0 / (b - a) * np.trapezoid(values * wave, times)))
