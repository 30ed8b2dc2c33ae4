"""Faults of single hits: overloads, second hits, forces that end too early, truncated responses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy  # loads scipy.signal on use; its import is slow

from updyn.arrays import BoolArray, RealArray
from updyn.signals.quality.finding import RecordFinding
from updyn.signals.quality.settings import CLIPPING, HIT_FORCE, HIT_RESPONSE

__all__ = [
    "find_clipped_pair",
    "find_clipped_run",
    "find_cut_off",
    "find_equal_peaks",
    "find_hit_start",
    "find_ringing_before",
    "find_second_hits",
    "find_short_force",
    "hit_mask",
]


def find_clipped_run(channel: RealArray, name: str, record: int) -> Iterator[RecordFinding]:
    """Yield an overload of consecutive samples at the extreme value after a jump."""
    quantum, rest = _smallest_step(channel), np.median(channel)
    for extreme in _extremes(channel):
        at = np.flatnonzero(channel == extreme)
        runs = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1)
        longest = at if abs(extreme - rest) > CLIPPING.fine_value * quantum else max(runs, key=len)
        if len(longest) < CLIPPING.least_samples or len(longest) == len(channel):
            continue
        neighbours = np.setdiff1d(np.concatenate([longest - 1, longest + 1]), at)
        neighbours = neighbours[(neighbours >= 0) & (neighbours < len(channel))]
        jump = float(np.abs(channel[neighbours] - extreme).max(initial=0.0))
        if jump > CLIPPING.least_jump * quantum:
            yield RecordFinding(
                "clipped",
                name,
                record,
                extreme,
                f"Record {record}, {name}: overload, {len(longest)} samples"
                f"{' in a row' if len(longest) == np.ptp(longest) + 1 else ''} at {extreme:g}.",
                f"Leave record {record} out; measure with a larger range.",
            )


def find_clipped_pair(channel: RealArray, name: str, record: int) -> Iterator[RecordFinding]:
    """Yield an overload of two samples of a hit with equal values."""
    # The two samples at a regular peak differ by up to the adjacent jump; the probability of equal
    # values is a step of the converter over that jump.
    quantum = _smallest_step(channel)
    for extreme in _extremes(channel):
        at = np.flatnonzero(channel == extreme)
        if len(at) != 2 or at[1] != at[0] + 1 or at[0] == 0 or at[1] == len(channel) - 1:
            continue
        jumps = np.abs(channel[[at[0] - 1, at[1] + 1]] - extreme)
        allowed = max(CLIPPING.uneven_steps * quantum, CLIPPING.uneven_share * float(jumps.max()))
        is_even = abs(jumps[0] - jumps[1]) <= allowed
        if jumps.min() > CLIPPING.pair_jump * quantum and not is_even:
            yield RecordFinding(
                "clipped",
                name,
                record,
                extreme,
                f"Record {record}, {name}: overload, 2 samples in a row at {extreme:g}.",
                f"Leave record {record} out; measure with a larger range.",
            )


def find_equal_peaks(channels: RealArray, name: str) -> Iterator[RecordFinding]:
    """Yield an overload of single samples with the same largest value in several hits."""
    quantum = min(_smallest_step(channel) for channel in channels)
    found: dict[float, list[int]] = {}
    for number, channel in enumerate(channels, 1):
        for extreme in _extremes(channel):
            found.setdefault(extreme, []).append(number)
    for extreme, numbers in found.items():
        hits = [channels[number - 1] for number in numbers]
        places = [np.flatnonzero(hit == extreme) for hit in hits]
        if len(numbers) < 2 or any(len(at) > 1 for at in places):
            continue  # `clipped` and `find_clipped_pair` find several samples of one hit
        around = [hit[max(at[0] - 1, 0) : at[0] + 2] for hit, at in zip(hits, places, strict=True)]
        is_copy = any(np.array_equal(around[0], other) for other in around[1:])
        pairs = 0.5 * len(channels) * (len(channels) - 1)
        if abs(extreme) > CLIPPING.repeated_value * pairs * quantum and not is_copy:
            for number in numbers:
                others = ", ".join(str(other) for other in numbers if other != number)
                yield RecordFinding(
                    "clipped",
                    name,
                    number,
                    extreme,
                    f"Record {number}, {name}: overload, a sample at {extreme:g}, as in record"
                    f" {others}.",
                    f"Leave record {number} out; measure with a larger range.",
                )


def _extremes(channel: RealArray) -> list[float]:
    """Return the largest and the smallest value, except the value at rest."""
    rest = np.median(channel)
    least = 0.5 * np.abs(channel - rest).max()
    both = (float(channel.max()), float(channel.min()))
    return [extreme for extreme in both if abs(extreme - rest) >= least]


def _smallest_step(channel: RealArray) -> float:
    """Return the smallest step between two samples: that of the converter or of the digits."""
    steps = np.abs(np.diff(channel))
    return float(steps[steps > 0.0].min(initial=np.inf))


def find_second_hits(
    channel: RealArray, step: float, name: str, record: int
) -> Iterator[RecordFinding]:
    """Yield a force that returns after the end of the hit."""
    force = np.abs(channel - np.median(channel))
    noise = float(np.median(force))
    begin = find_hit_start(channel) - HIT_RESPONSE.filter_samples
    if begin >= HIT_RESPONSE.rest_samples:  # a window on the record removes the noise after the hit
        noise = max(noise, float(np.median(force[:begin])))
    first = int(np.argmax(force))
    for part, when in ((force[first:], "after"), (force[first::-1], "before")):
        below = part < HIT_FORCE.end_share * force[first]
        over = 2 * int(np.argmax(below)) if below.any() else len(part)
        if over >= len(part):
            continue
        second = over + int(np.argmax(part[over:]))
        share = float(part[second] / force[first])
        if share > HIT_FORCE.second_share and part[second] > HIT_FORCE.second_over_noise * noise:
            apart = step * second
            yield RecordFinding(
                "double-hit",
                name,
                record,
                share,
                f"Record {record}, {name}: a second hit of {100.0 * share:.2g} % of the largest,"
                f" {1e3 * apart:.3g} ms {when} it.",
                f"Leave record {record} out: its spectrum has a ripple {1.0 / apart:.3g} Hz long.",
            )
            return


def find_short_force(
    channel: RealArray, step: float, band: tuple[float, float], name: str, record: int
) -> Iterator[RecordFinding]:
    """Yield the lines of the band without sufficient force."""
    begin = find_hit_start(channel)
    offset = channel[:begin].mean() if begin >= HIT_RESPONSE.rest_samples else np.median(channel)
    force = np.where(hit_mask(channel), channel - offset, 0.0)
    level = np.abs(np.fft.rfft(force))
    freq = np.fft.rfftfreq(len(channel), step)
    weak = level < 10.0 ** (HIT_FORCE.least_level / 20) * level.max()
    faint = (freq >= band[0]) & (freq <= band[1]) & weak
    if faint.any():
        low, high = float(freq[faint][0]), float(freq[faint][-1])
        down = float(20.0 * np.log10(max(level[faint].min() / level.max(), 1e-16)))
        yield RecordFinding(
            "short-force",
            name,
            record,
            down,
            f"Record {record}, {name}: from {low:g} to {high:g} Hz the force falls to {down:.0f} dB"
            " of its largest line.",
            f"Use a harder tip, or end the band below {low:g} Hz.",
            (low, high),
        )


def hit_mask(channel: RealArray) -> BoolArray:
    """Return a mask of the samples around the largest force, to twice the distance of its end."""
    force = _from_rest(channel)
    first = int(np.argmax(force))
    below = np.abs(np.arange(len(force)) - first)[force < HIT_FORCE.end_share * force[first]]
    width = 2 * int(below.min()) if len(below) else len(force)
    return np.asarray(np.abs(np.arange(len(force)) - first) <= width)


def find_cut_off(
    channel: RealArray, force: RealArray, name: str, record: int
) -> Iterator[RecordFinding]:
    """Yield a response that continues at the end of the record."""
    free = channel - np.median(channel)
    begin = int(np.argmax(np.abs(force - np.median(force))))
    n = max(2, len(channel) // HIT_RESPONSE.parts)
    early, late = _rms(free[begin : begin + n]), _rms(free[-n:])
    is_large = early > 0.0 and late > HIT_RESPONSE.least_share * early
    if is_large and not _is_noise(free, find_hit_start(force), n):
        yield RecordFinding(
            "cut-off",
            name,
            record,
            late / early,
            f"Record {record}, {name}: at its end, {100.0 * late / early:.2g} % of the response"
            " remain.",
            "Use longer records, or ImpactWindow(exponential=0.05).",
        )


def _is_noise(free: RealArray, begin: int, n: int) -> bool:
    """Return whether the last n samples of a response are noise."""
    # Without samples before the hit, noise is recognised by its prediction error: n modes follow a
    # recursion over 2 n samples, noise follows none. A line of the mains does, but does not decay.
    quiet, order = begin - HIT_RESPONSE.filter_samples, HIT_RESPONSE.prediction_order
    if quiet >= HIT_RESPONSE.rest_samples:
        return _rms(free[-n:]) <= 2.0 * _rms(free[:quiet])
    if len(free) - begin < 8 * order:
        return False
    first, *_, third, fourth = (_rms(part) for part in np.array_split(free[begin:], 4))
    if fourth < 0.5 * first and third < HIT_RESPONSE.steady_ratio * fourth:
        return True
    last = scipy.signal.detrend(free[-max(n, 8 * order) :])
    past = np.lib.stride_tricks.sliding_window_view(last[:-1], order)
    rest = last[order:] - past @ np.linalg.lstsq(past, last[order:], rcond=None)[0]
    return bool(rest @ rest > HIT_RESPONSE.unpredicted_share * (last @ last))


def _rms(part: RealArray) -> float:
    return float(np.sqrt(np.mean(part**2)))


def find_ringing_before(
    channel: RealArray, force: RealArray, name: str, record: int
) -> Iterator[RecordFinding]:
    """Yield a response that was not at rest before the hit and adds to that of the hit."""
    begin = find_hit_start(force)
    end = begin - HIT_RESPONSE.filter_samples
    if end < HIT_RESPONSE.rest_samples:
        return
    free = channel - np.median(channel)
    n = max(2, len(channel) // HIT_RESPONSE.parts)
    before = scipy.signal.detrend(free[:end])
    early, late = _rms(free[begin : begin + n]), _rms(scipy.signal.detrend(free[-n:]))
    share = _rms(before) / early if early > 0.0 else 0.0
    # With an exponential window noise decays, too: that of the force by the same factor.
    quiet = [_rms(scipy.signal.detrend(part)) for part in (force[:end], force[-n:])]
    windowed = max(quiet[0] / quiet[1], 1.0) if quiet[1] > 0.0 else 1.0
    if share > HIT_RESPONSE.least_share and _rms(before) > HIT_RESPONSE.over_end * late * windowed:
        yield RecordFinding(
            "leakage",
            name,
            record,
            share,
            f"Record {record}, {name}: {100.0 * share:.2g} % of the response are present before"
            " the hit and decay: the structure was not at rest.",
            "Wait between hits until the structure is at rest, or until its response has fallen to"
            " the noise.",
        )


def find_hit_start(force: RealArray) -> int:
    """Return the first sample of the hit."""
    free = _from_rest(force)
    largest = int(np.argmax(free))
    below = np.flatnonzero(free[: largest + 1] < HIT_FORCE.end_share * free[largest])
    return int(below[-1]) if len(below) else 0


def _from_rest(force: RealArray) -> RealArray:
    """Return the absolute force relative to its value before the hit."""
    free = force - np.median(force)
    largest = int(np.argmax(np.abs(free)))
    if largest >= HIT_RESPONSE.filter_samples:
        free = free - np.median(free[:largest])
    return np.abs(free)
