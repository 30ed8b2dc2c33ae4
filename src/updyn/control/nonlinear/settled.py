"""`settled`: what the end of a simulated oscillation is: a limit cycle, decay, rest or growth."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

__all__ = ["Settled", "settled"]

_Real = NDArray[np.float64]
_STEADY = 0.01  # spread of the last periods
_SMALL = 0.2  # share of the largest amplitude below which an oscillation has decayed
_PERIODS = 5
_LAST = 0.4  # share of the time that is looked at


@dataclass(frozen=True, slots=True)
class Settled:
    """The end of an oscillation.

    Attributes
    ----------
    verdict : str
        As of a `Simulation`.
    amplitude, peak, frequency : float or None
        First harmonic, half of peak to peak, and Hz.
    periods : int
        Over which they were taken.
    """

    verdict: str
    amplitude: float | None = None
    peak: float | None = None
    frequency: float | None = None
    periods: int = 0


def settled(time: _Real, z: _Real, switches: _Real, half: float) -> Settled:
    """Judge the end of a series.

    Parameters
    ----------
    time : ndarray of float, shape (n_t,)
        In s, not falling.
    z : ndarray of float, shape (n_t,)
        What the nonlinearity reads.
    switches : ndarray of float
        Times at which contact or sticking changed.
    half : float
        Half the gap of a backlash; 0 for friction.
    """
    end = float(time[-1])
    first = int(np.searchsorted(time, (1.0 - _LAST) * end))
    t, y = time[first:], z[first:]
    span, whole = float(np.ptp(y)), float(np.ptp(z))
    if span <= 1e-9 * max(float(np.abs(z).max()), half):
        return Settled("at rest")
    if not len(switches) or switches[-1] < t[0]:
        # Nothing touches any more: a swing within the gap, or a drift.
        if np.ptp(y[len(y) // 2 :]) > 1.02 * np.ptp(y[: len(y) // 2]):
            return _trend(t, y, whole)
        return Settled("decays")
    starts = _rises(t, y - 0.5 * (y.max() + y.min()))
    if len(starts) < 3:
        return _trend(t, y, whole)
    lengths = np.diff(starts)
    tops = np.array([np.ptp(y[(t >= a) & (t <= b)]) / 2 for a, b in pairwise(starts)])
    n = min(len(lengths), 4 * _PERIODS)
    lengths, tops = lengths[-n:], tops[-n:]
    if (
        n >= _PERIODS
        and np.ptp(tops) <= _STEADY * tops[-1]
        and np.ptp(lengths) <= _STEADY * lengths[-1]
    ):
        a, b = float(starts[-n - 1]), float(starts[-1])
        frequency = n / (b - a)
        return Settled(
            "limit cycle", _harmonic(t, y, a, b, frequency), float(tops.mean()), frequency, n
        )
    return _trend(t, y, whole)


def _trend(t: _Real, y: _Real, whole: float) -> Settled:
    """Judge by the sizes of quarters of the stretch, beside that of the whole series."""
    edges = np.linspace(t[0], t[-1], 5)
    sizes = np.array([np.ptp(y[(t >= a) & (t <= b)]) for a, b in pairwise(edges)])
    steps = np.diff(sizes)
    small = sizes.max() < _SMALL * whole and sizes[2:].max() <= sizes[:2].max()
    if small or ((steps < 0).all() and sizes[-1] < (1 - _STEADY) * sizes[0]):
        return Settled("decays")
    if (steps > 0).all() and sizes[-1] > (1 + _STEADY) * sizes[0]:
        return Settled("grows")
    return Settled("not settled")


def _rises(t: _Real, y: _Real) -> _Real:
    """Return the upward zero crossings of a series that reach a tenth of its size."""
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


def _harmonic(t: _Real, y: _Real, a: float, b: float, frequency: float) -> float:
    """Return the amplitude of the first harmonic over whole periods, by the trapezoidal rule."""
    inside = (t > a) & (t < b)
    times = np.concatenate([[a], t[inside], [b]])
    values = np.interp(times, t, y)
    wave = np.exp(-2j * np.pi * frequency * times)
    return float(abs(2.0 / (b - a) * np.trapezoid(values * wave, times)))
