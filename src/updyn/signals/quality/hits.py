"""Faults of single hits: overloads, second hits, forces that end too early, responses cut off."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.signal import detrend

from updyn.signals.quality.finding import RecordFinding

__all__ = [
    "REACH",
    "about_the_hit",
    "clipped",
    "clipped_alike",
    "clipped_pair",
    "cut_off",
    "ringing_before",
    "second_hits",
    "short_force",
    "start_of_hit",
]

_Real = NDArray[np.float64]

#: Samples in a row at the largest value from which a channel was overloaded; and how far it has to
#: jump onto them, in steps of its converter: a slow signal dwells at its peak, too.
_FLAT, _JUMP = 3, 5.0
#: In steps of a converter that is fine, samples at the largest value need not be neighbours.
_FINE = 2.0**14
#: Two neighbours at the largest value: how far they have to be jumped at, in steps of the
#: converter, for such a pair to be no chance; and by how many steps, and which share, the jumps on
#: either side differ at least: those of a computed pulse that is symmetric are the same.
_CERTAIN, _UNEVEN = 1e4, (10.0, 1e-6)
#: The same largest value in two hits: how large it has to be, in steps of the converter and for
#: each pair of hits, for that to be no chance among hits whose levels differ by 1 %.
_REPEATED = 1e5
#: A second hit: a force this share of the largest, and so many times its noise.
_SECOND, _ABOVE_NOISE = 0.05, 20.0
#: A hit is over where its force stays below this share for as long as it took to get there.
_OVER = 0.02
#: Level of the force at a line over its largest one, in dB, from which noise takes its place.
REACH = -20.0
#: A response whose last twentieth is above this share of its first has been cut off.
_CUT, _LAST = 0.02, 20
#: Samples before the hit, and how much more than at the end of the record there has to be, for a
#: response to have been there before; samples in which the filters of converters ring ahead of it.
_REST, _MORE, _FILTER = 16, 3.0, 64
#: A response is noise where this share of its power, or more, is not a linear combination of so
#: many samples before: of white noise that is all but 1 / 8, of half white and half slow noise a
#: half, of modes nothing.
_UNPREDICTED, _ORDER = 0.3, 8
#: Rms in the third quarter of a response over that in the last, below which it does not decay: that
#: of a steady wave is 1, of a mode that loses a third of its motion in the record 1.1.
_DECAYS = 1.1


def clipped(channel: _Real, name: str, record: int) -> Iterator[RecordFinding]:
    """Find an overload: neighbouring samples all at the extreme value, jumped at."""
    quantum, rest = _smallest_step(channel), np.median(channel)
    for extreme in _extremes(channel):
        at = np.flatnonzero(channel == extreme)
        runs = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1)
        longest = at if abs(extreme - rest) > _FINE * quantum else max(runs, key=len)
        if len(longest) < _FLAT or len(longest) == len(channel):
            continue
        beside = np.setdiff1d(np.concatenate([longest - 1, longest + 1]), at)
        beside = beside[(beside >= 0) & (beside < len(channel))]
        jump = float(np.abs(channel[beside] - extreme).max(initial=0.0))
        if jump > _JUMP * quantum:
            yield RecordFinding(
                "clipped",
                name,
                record,
                extreme,
                f"Record {record}, {name}: overload, {len(longest)} samples"
                f"{' in a row' if len(longest) == np.ptp(longest) + 1 else ''} at {extreme:g}.",
                f"Leave record {record} out; measure with a larger range.",
            )


def clipped_pair(channel: _Real, name: str, record: int) -> Iterator[RecordFinding]:
    """Find an overload of two samples of a hit, told by their equal values.

    The two samples about a sound peak differ by anything up to the jump beside them; the chance
    that they are equal is a step of the converter over that jump.
    """
    quantum = _smallest_step(channel)
    for extreme in _extremes(channel):
        at = np.flatnonzero(channel == extreme)
        if len(at) != 2 or at[1] != at[0] + 1 or at[0] == 0 or at[1] == len(channel) - 1:
            continue
        jumps = np.abs(channel[[at[0] - 1, at[1] + 1]] - extreme)
        steps, share = _UNEVEN
        is_even = abs(jumps[0] - jumps[1]) <= max(steps * quantum, share * jumps.max())
        if jumps.min() > _CERTAIN * quantum and not is_even:
            yield RecordFinding(
                "clipped",
                name,
                record,
                extreme,
                f"Record {record}, {name}: overload, 2 samples in a row at {extreme:g}.",
                f"Leave record {record} out; measure with a larger range.",
            )


def clipped_alike(channels: _Real, name: str) -> Iterator[RecordFinding]:
    """Find an overload of single samples, told by the same largest value of several hits.

    Parameters
    ----------
    channels : ndarray of float, shape (records, samples)
        A channel in all hits.
    name : str
        Its name.
    """
    quantum = min(_smallest_step(channel) for channel in channels)
    found: dict[float, list[int]] = {}
    for number, channel in enumerate(channels, 1):
        for extreme in _extremes(channel):
            found.setdefault(extreme, []).append(number)
    for extreme, numbers in found.items():
        hits = [channels[number - 1] for number in numbers]
        places = [np.flatnonzero(hit == extreme) for hit in hits]
        if len(numbers) < 2 or any(len(at) > 1 for at in places):
            continue  # more than one sample of a hit is told by that hit alone
        around = [hit[max(at[0] - 1, 0) : at[0] + 2] for hit, at in zip(hits, places, strict=True)]
        is_copy = any(np.array_equal(around[0], other) for other in around[1:])
        pairs = 0.5 * len(channels) * (len(channels) - 1)
        if abs(extreme) > _REPEATED * pairs * quantum and not is_copy:
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


def _extremes(channel: _Real) -> list[float]:
    """Return the largest and the smallest value, but for that at which the channel rests."""
    rest = np.median(channel)
    least = 0.5 * np.abs(channel - rest).max()
    both = (float(channel.max()), float(channel.min()))
    return [extreme for extreme in both if abs(extreme - rest) >= least]


def _smallest_step(channel: _Real) -> float:
    """Return the smallest step between two samples: that of the converter, or of the digits."""
    steps = np.abs(np.diff(channel))
    return float(steps[steps > 0.0].min(initial=np.inf))


def second_hits(channel: _Real, step: float, name: str, record: int) -> Iterator[RecordFinding]:
    """Find a force that comes back after the hit is over."""
    force = np.abs(channel - np.median(channel))
    noise = float(np.median(force))
    begin = start_of_hit(channel) - _FILTER
    if begin >= _REST:  # a window on the record takes the noise after the hit away
        noise = max(noise, float(np.median(force[:begin])))
    first = int(np.argmax(force))
    for part, when in ((force[first:], "after"), (force[first::-1], "before")):
        below = part < _OVER * force[first]
        over = 2 * int(np.argmax(below)) if below.any() else len(part)
        if over >= len(part):
            continue
        second = over + int(np.argmax(part[over:]))
        share = float(part[second] / force[first])
        if share > _SECOND and part[second] > _ABOVE_NOISE * noise:
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


def short_force(
    channel: _Real, step: float, band: tuple[float, float], name: str, record: int
) -> Iterator[RecordFinding]:
    """Find lines of the band that the hit does not reach."""
    begin = start_of_hit(channel)
    offset = channel[:begin].mean() if begin >= _REST else np.median(channel)
    force = np.where(about_the_hit(channel), channel - offset, 0.0)
    level = np.abs(np.fft.rfft(force))
    freq = np.fft.rfftfreq(len(channel), step)
    faint = (freq >= band[0]) & (freq <= band[1]) & (level < 10.0 ** (REACH / 20) * level.max())
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
            f"Take a harder tip, or end the band below {low:g} Hz.",
            (low, high),
        )


def about_the_hit(channel: _Real) -> NDArray[np.bool_]:
    """Return the samples about the largest force up to where it is over, and as far again.

    Parameters
    ----------
    channel : ndarray of float, shape (n_samples,)
        The force of one record.

    Returns
    -------
    ndarray of bool, shape (n_samples,)
    """
    force = _from_rest(channel)
    first = int(np.argmax(force))
    below = np.abs(np.arange(len(force)) - first)[force < _OVER * force[first]]
    width = 2 * int(below.min()) if len(below) else len(force)
    return np.asarray(np.abs(np.arange(len(force)) - first) <= width)


def cut_off(channel: _Real, force: _Real, name: str, record: int) -> Iterator[RecordFinding]:
    """Find a response that goes on at the end of the record."""
    free = channel - np.median(channel)
    begin = int(np.argmax(np.abs(force - np.median(force))))
    n = max(2, len(channel) // _LAST)
    early, late = _rms(free[begin : begin + n]), _rms(free[-n:])
    if early > 0.0 and late > _CUT * early and not _is_noise(free, start_of_hit(force), n):
        yield RecordFinding(
            "cut-off",
            name,
            record,
            late / early,
            f"Record {record}, {name}: at its end {100.0 * late / early:.2g} % of the response are"
            " left.",
            "Record for longer, or use ImpactWindow(exponential=0.05).",
        )


def _is_noise(free: _Real, begin: int, n: int) -> bool:
    """Return whether the last n samples of a response that begins somewhere are noise.

    If nothing was recorded before the hit, noise is recognised by its prediction error: n modes
    follow a recursion over 2 n samples, and noise follows none. So does a line of the mains, which
    does not decay.
    """
    if begin - _FILTER >= _REST:
        return _rms(free[-n:]) <= 2.0 * _rms(free[: begin - _FILTER])
    if len(free) - begin < 8 * _ORDER:
        return False
    first, *_, third, fourth = (_rms(part) for part in np.array_split(free[begin:], 4))
    if fourth < 0.5 * first and third < _DECAYS * fourth:
        return True
    last = detrend(free[-max(n, 8 * _ORDER) :])
    past = np.lib.stride_tricks.sliding_window_view(last[:-1], _ORDER)
    rest = last[_ORDER:] - past @ np.linalg.lstsq(past, last[_ORDER:], rcond=None)[0]
    return bool(rest @ rest > _UNPREDICTED * (last @ last))


def _rms(part: _Real) -> float:
    return float(np.sqrt(np.mean(part**2)))


def ringing_before(channel: _Real, force: _Real, name: str, record: int) -> Iterator[RecordFinding]:
    """Find a response that was not at rest when the hit came: it leaks into that of this one."""
    begin = start_of_hit(force)
    if begin - _FILTER < _REST:
        return
    free = channel - np.median(channel)
    n = max(2, len(channel) // _LAST)
    before = detrend(free[: begin - _FILTER])
    early, late = _rms(free[begin : begin + n]), _rms(detrend(free[-n:]))
    share = _rms(before) / early if early > 0.0 else 0.0
    # Under an exponential window noise decays, too: that of the force by as much.
    quiet = [_rms(detrend(part)) for part in (force[: begin - _FILTER], force[-n:])]
    windowed = max(quiet[0] / quiet[1], 1.0) if quiet[1] > 0.0 else 1.0
    if share > _CUT and _rms(before) > _MORE * late * windowed:
        yield RecordFinding(
            "leakage",
            name,
            record,
            share,
            f"Record {record}, {name}: before the hit there is already {100.0 * share:.2g} % of"
            " the response, which decays: the structure was not at rest.",
            "Wait between hits until the structure is at rest, or until its response has fallen to"
            " the noise.",
        )


def start_of_hit(force: _Real) -> int:
    """Return the sample at which the hit begins.

    Parameters
    ----------
    force : ndarray of float, shape (n_samples,)
        The force of one record.

    Returns
    -------
    int
    """
    free = _from_rest(force)
    largest = int(np.argmax(free))
    below = np.flatnonzero(free[: largest + 1] < _OVER * free[largest])
    return int(below[-1]) if len(below) else 0


def _from_rest(force: _Real) -> _Real:
    """Return how far a force is from where it was before the hit, which may not be its median."""
    free = force - np.median(force)
    largest = int(np.argmax(np.abs(free)))
    if largest >= _FILTER:
        free = free - np.median(free[:largest])
    return np.abs(free)
