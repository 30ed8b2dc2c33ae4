"""Frequency lines that resolve a loop function, and its crossings, extremes and phase."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import elementwise

from updyn.arrays import ComplexArray, IndexArray, NumberArray, RealArray
from updyn.control.offsets import mirror_offsets
from updyn.control.servo.settings import LOOP_LINES
from updyn.errors import DataError

__all__ = [
    "Loop",
    "add_extremes",
    "crossings_of_gain",
    "crossings_of_phase",
    "find_level_crossing",
    "find_minimum",
    "frequencies",
    "resolve",
    "unwrap_phase",
]

#: A loop function of s.
Loop = Callable[[NumberArray], ComplexArray]

_TOLERANCES = {"xatol": 0.0, "xrtol": 1e-14, "fatol": 0.0, "frtol": 0.0}


def frequencies(features: ComplexArray, low: float, high: float, delay: float = 0.0) -> RealArray:
    """Return frequencies in rad/s that resolve the poles, zeros and dead time of a loop."""
    decades = max(np.log10(high / low), 0.1)
    count = int(LOOP_LINES.lines_per_decade * decades) + 2
    parts: list[NumberArray] = [np.geomspace(low, high, count)]
    centre = np.abs(features.imag)
    oscillating = centre > 0.0
    half = np.maximum(np.abs(features.real), LOOP_LINES.least_half_width * centre)[oscillating]
    offsets = mirror_offsets(LOOP_LINES.offsets)
    parts.append((centre[oscillating][:, None] + half[:, None] * offsets).ravel())
    parts.append(np.abs(features.real[~oscillating]))
    if delay:
        turns = high * delay / LOOP_LINES.largest_turn
        if turns > LOOP_LINES.most_lines:
            rounds = high * delay / (2 * np.pi)
            raise DataError(
                f"dead time {delay:g} s turns the phase {rounds:.0f} times up"
                f" to {high / (2 * np.pi):.4g} Hz; expected a dead time in s"
            )
        parts.append(np.arange(1, int(turns) + 1) * (LOOP_LINES.largest_turn / delay))
    w = np.unique(np.concatenate(parts))
    return w[(w >= low) & (w <= high)]


def resolve(loop: Loop, w: RealArray) -> tuple[RealArray, ComplexArray]:
    """Return lines between which the phase changes little, and the loop function at them."""
    w, values = _finite(w, loop(1j * w))
    while True:
        turn = np.abs(np.angle(values[1:] / values[:-1]))
        wide = (turn > LOOP_LINES.largest_turn) & (np.diff(w) > 1e-13 * w[1:])
        if not wide.any() or len(w) > LOOP_LINES.most_lines:
            return w, values
        count = len(w)
        between = 0.5 * (w[:-1] + w[1:])[wide]
        w, values = _merge_lines(w, values, between, loop(1j * between))
        if len(w) == count:  # the loop function is 0 or infinite at all new lines
            return w, values


def add_extremes(loop: Loop, w: RealArray, values: ComplexArray) -> tuple[RealArray, ComplexArray]:
    """Return lines with added extremes of gain and phase that could hide two crossings."""
    for gain in (True, False):
        if gain:
            measure = np.log(np.abs(values))
            near = np.abs(measure) < 1.0
        else:
            measure = np.unwrap(np.angle(values))
            near = np.abs(np.mod(measure, 2.0 * np.pi) - np.pi) < LOOP_LINES.largest_turn

        def of(x: RealArray, base: ComplexArray, sign: float, gain: bool = gain) -> RealArray:
            values = loop(1j * x)
            return -sign * (np.log(np.abs(values)) if gain else np.angle(values / base))

        found = [np.zeros(0)]
        for sign in (1.0, -1.0):
            at = _peaks(sign * measure)
            at = at[near[at]]
            if len(at):
                found.append(_minimum(of, w, at, values[at], np.full(len(at), sign)))
        more = np.concatenate(found)
        w, values = _merge_lines(w, values, more, loop(1j * more))
    return w, values


def crossings_of_gain(loop: Loop, w: RealArray, values: ComplexArray) -> RealArray:
    """Return the frequencies at which |L| = 1, in rad/s, ascending."""
    # Crossings hidden by rounding next to a pole on the axis (an undamped mode that is hardly
    # observable) are omitted; the closed-loop poles determine the stability of such a mode.
    above = np.abs(values) >= 1.0
    at = np.flatnonzero(above[1:] != above[:-1])
    return _roots(lambda x: np.log(np.abs(loop(1j * x))), w, at)[0]


def crossings_of_phase(loop: Loop, w: RealArray, values: ComplexArray) -> RealArray:
    """Return the frequencies at which L is real and negative, in rad/s, ascending."""
    share = values.imag / np.abs(values)
    side = np.sign(np.where(np.abs(share) < LOOP_LINES.real_share, 0.0, share))
    # A value that is real up to rounding belongs to the side of the previous value.
    last = np.maximum.accumulate(np.where(side != 0, np.arange(len(side)), 0))
    side = side[last]
    at = np.flatnonzero((side[1:] * side[:-1] < 0) & (values.real[1:] < 0) & (values.real[:-1] < 0))
    at = at[np.abs(share[at + 1]) >= LOOP_LINES.real_share]
    found = _roots(lambda x: (v := loop(1j * x)).imag / np.abs(v), w, last[at], at + 1)[0]
    size = np.abs(loop(1j * found))
    # The phase jumps at a pole or zero on the axis.
    limit = LOOP_LINES.infinite_gain
    return found[(size < limit) & (size > 1.0 / limit)]


def find_minimum(
    function: Callable[[RealArray], RealArray], w: RealArray, values: RealArray
) -> tuple[float, float]:
    """Return the smallest value of a function and its frequency in rad/s."""
    at = _peaks(-values)
    at = at[values[at] < 1.5 * values.min()]
    best = int(np.argmin(values))
    found = [(float(values[best]), float(w[best]))]
    if len(at):
        places = _minimum(function, w, at)
        found += [(float(v), float(x)) for v, x in zip(function(places), places, strict=True)]
    return min(found)


def find_level_crossing(
    function: Callable[[RealArray], RealArray], w: RealArray, values: RealArray
) -> float | None:
    """Return the frequency at which a function first falls through 0, in rad/s, or None."""
    at = np.flatnonzero((values[1:] < 0) & (values[:-1] >= 0))[:1]
    return float(_roots(function, w, at)[1][0]) if len(at) else None


def unwrap_phase(w: RealArray, values: ComplexArray) -> RealArray:
    """Return the continuous phase in degrees; it starts at -90 times the number of integrations."""
    phase = np.degrees(np.unwrap(np.angle(values)))
    k = min(5, len(w) - 1)
    slope = np.log(np.abs(values[k] / values[0])) / np.log(w[k] / w[0]) if k else 0.0
    return np.asarray(phase + 360.0 * np.round((90.0 * np.round(slope) - phase[0]) / 360.0))


# -- helpers --------------------------------------------------------------------------------------
def _finite(w: RealArray, values: ComplexArray) -> tuple[RealArray, ComplexArray]:
    good = np.isfinite(values) & (values != 0)
    return w[good], values[good]


def _merge_lines(
    w: RealArray, values: ComplexArray, more: RealArray, more_values: ComplexArray
) -> tuple[RealArray, ComplexArray]:
    more, more_values = _finite(more, more_values)
    both, at = np.unique(np.concatenate([w, more]), return_index=True)
    return both, np.concatenate([values, more_values])[at]


def _peaks(values: RealArray) -> IndexArray:
    """Return the indices of local maxima, without the ends."""
    return np.flatnonzero((values[1:-1] >= values[:-2]) & (values[1:-1] > values[2:])) + 1


def _minimum(
    function: Callable[..., RealArray], w: RealArray, at: IndexArray, *args: NumberArray
) -> RealArray:
    """Return the positions of the minima of a function near given indices."""
    with np.errstate(divide="ignore", invalid="ignore"):
        found = elementwise.find_minimum(
            function, (w[at - 1], w[at], w[at + 1]), args=args, maxiter=60
        )
    return np.asarray(np.where(np.isfinite(found.x), found.x, w[at]))


def _roots(
    function: Callable[[RealArray], RealArray],
    w: RealArray,
    at: IndexArray,
    ends: IndexArray | None = None,
) -> tuple[RealArray, RealArray]:
    """Return the zeros of a function between indices: the resolved ones, and all."""
    if not len(at):
        return np.zeros(0), np.zeros(0)
    ends = at + 1 if ends is None else ends
    with np.errstate(divide="ignore", invalid="ignore"):
        found = elementwise.find_root(
            function, (w[at], w[ends]), tolerances=_TOLERANCES, maxiter=200
        )
        x = np.sort(np.asarray(found.x))
        magnitudes = np.abs(function(x))
    return x[magnitudes < LOOP_LINES.root_residual], x
