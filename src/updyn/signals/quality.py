"""Quality of records: what is wrong with which channel of which record, told before an estimate."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from updyn.errors import DataError, key_path
from updyn.signals.records import Records, records_of

if TYPE_CHECKING:
    import xarray

__all__ = ["RecordFinding", "check_records"]

_Real = NDArray[np.float64]

#: Samples in a row at the largest value from which a channel was overloaded; and how far it has to
#: jump onto them, in steps of its converter: a slow signal dwells at its peak, too.
_FLAT, _JUMP = 3, 5.0
#: A second hit: a force this share of the largest, and so many times its noise.
_SECOND, _ABOVE_NOISE = 0.05, 20.0
#: A hit is over where its force stays below this share for as long as it took to get there.
_OVER = 0.02
#: Level of the force at a line over its largest one, in dB, from which noise takes its place.
_REACH = -20.0
#: A response whose last twentieth is above this share of its first has been cut off.
_CUT, _LAST = 0.02, 20


@dataclass(frozen=True, slots=True)
class RecordFinding:
    """Something that is wrong with a record.

    Attributes
    ----------
    kind : str
        ``"clipped"``, ``"double-hit"``, ``"short-force"``, ``"cut-off"``.
    channel : str
        Which channel.
    record : int
        Which record, from 1.
    value : float
        By how much, in the unit that the statement names.
    statement : str
        What is wrong, in a sentence.
    remedy : str
        What to do.
    band : (float, float) or None
        The lines in Hz that it concerns; None: all.
    """

    kind: str
    channel: str
    record: int
    value: float
    statement: str
    remedy: str
    band: tuple[float, float] | None = None


def check_records(
    records: xarray.DataArray | Records,
    excitation: str | Iterable[str],
    *,
    band: tuple[float, float] | None = None,
    segment: float | None = None,
) -> tuple[RecordFinding, ...]:
    """Look for faults of records.

    Parameters
    ----------
    records : xarray.DataArray
        Of `read_records`.
    excitation : str or iterable of str
        The channel of the force, or those of several.
    band : (float, float), optional
        Lines in Hz that are wanted; the force is looked at up to there.
    segment : float, optional
        As of `estimate_frf`, in s: the force lasts, and faults of hits are not looked for.

    Returns
    -------
    tuple of RecordFinding
        By record, then by channel. `estimate_frf` leaves out nothing by itself: pass
        ``reject={finding.record: finding.kind}`` for those that are to go.

    Raises
    ------
    DataError
        If there is no such channel, or it is zero throughout.
    """
    given = records_of(records)
    forces = [excitation] if isinstance(excitation, str) else list(excitation)
    rows = []
    for name in forces:
        with key_path("excitation", name):
            rows.append(given.index(name))
            if not given.values[:, rows[-1]].any():
                raise DataError(f"channel {name!r}: the force is zero throughout")
    found: list[RecordFinding] = []
    for number, record in enumerate(given.values, 1):
        for name, channel in zip(given.channels, record, strict=True):
            found += _clipped(channel, name, number)
            if segment is not None:
                continue
            if name in forces:
                found += _second_hits(channel, given.step, name, number)
                if band is not None:
                    found += _short_force(channel, given.step, band, name, number)
            else:
                found += _cut_off(channel, record[rows[0]], name, number)
    return tuple(found)


def _clipped(channel: _Real, name: str, record: int) -> Iterator[RecordFinding]:
    """Find an overload: neighbouring samples all at the extreme value, jumped at."""
    quantum, rest = _smallest_step(channel), np.median(channel)
    for extreme in (channel.max(), channel.min()):
        if abs(extreme - rest) < 0.5 * np.abs(channel - rest).max():
            continue  # where the channel rests
        at = np.flatnonzero(channel == extreme)
        runs = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1)
        longest = max(runs, key=len)
        if len(longest) < _FLAT or len(longest) == len(channel):
            continue
        beside = [i for i in (longest[0] - 1, longest[-1] + 1) if 0 <= i < len(channel)]
        jump = float(np.abs(channel[beside] - extreme).max())
        if jump > _JUMP * quantum:
            yield RecordFinding(
                "clipped",
                name,
                record,
                float(extreme),
                f"Record {record}, {name}: overload, {len(longest)} samples in a row at"
                f" {extreme:g}.",
                f"Leave record {record} out; measure with a larger range.",
            )


def _smallest_step(channel: _Real) -> float:
    """Return the smallest step between two samples: that of the converter, or of the digits."""
    steps = np.abs(np.diff(channel))
    return float(steps[steps > 0.0].min(initial=np.inf))


def _second_hits(channel: _Real, step: float, name: str, record: int) -> Iterator[RecordFinding]:
    """Find a force that comes back after the hit is over."""
    force = np.abs(channel - np.median(channel))
    noise = float(np.median(force))
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


def _short_force(
    channel: _Real, step: float, band: tuple[float, float], name: str, record: int
) -> Iterator[RecordFinding]:
    """Find lines of the band that the hit does not reach."""
    force = np.where(_about_the_hit(channel), channel - np.median(channel), 0.0)
    level = np.abs(np.fft.rfft(force))
    freq = np.fft.rfftfreq(len(channel), step)
    faint = (freq >= band[0]) & (freq <= band[1]) & (level < 10.0 ** (_REACH / 20) * level.max())
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


def _about_the_hit(channel: _Real) -> NDArray[np.bool_]:
    """Return the samples about the largest force up to where it is over, and as far again."""
    force = np.abs(channel - np.median(channel))
    first = int(np.argmax(force))
    below = np.abs(np.arange(len(force)) - first)[force < _OVER * force[first]]
    width = 2 * int(below.min()) if len(below) else len(force)
    return np.asarray(np.abs(np.arange(len(force)) - first) <= width)


def _cut_off(channel: _Real, force: _Real, name: str, record: int) -> Iterator[RecordFinding]:
    """Find a response that goes on at the end of the record."""
    free = channel - np.median(channel)
    begin = int(np.argmax(np.abs(force - np.median(force))))
    n = max(2, len(channel) // _LAST)
    early, late = _rms(free[begin : begin + n]), _rms(free[-n:])
    noise = _rms(free[:begin]) if begin >= 2 else 0.0
    if early > 0.0 and late > _CUT * early and late > 2.0 * noise:
        yield RecordFinding(
            "cut-off",
            name,
            record,
            late / early,
            f"Record {record}, {name}: at its end {100.0 * late / early:.2g} % of the response are"
            " left.",
            "Record for longer, or use ImpactWindow(exponential=0.05).",
        )


def _rms(part: _Real) -> float:
    return float(np.sqrt(np.mean(part**2)))
