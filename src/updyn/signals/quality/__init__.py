"""Quality of records: faults by channel and record, before an estimate."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from updyn.arrays import BoolArray, RealArray
from updyn.errors import DataError, key_path
from updyn.frf import check_band
from updyn.signals.quality.background import find_drift, find_mains, find_noise_floor
from updyn.signals.quality.finding import RecordFinding
from updyn.signals.quality.hits import (
    find_clipped_pair,
    find_clipped_run,
    find_cut_off,
    find_equal_peaks,
    find_hit_start,
    find_ringing_before,
    find_second_hits,
    find_short_force,
    hit_mask,
)
from updyn.signals.quality.pulse import check_pulse
from updyn.signals.quality.settings import HIT_FORCE
from updyn.signals.quality.together import find_leakage, find_level_dependence
from updyn.signals.records import Records, as_records

if TYPE_CHECKING:
    import xarray

__all__ = ["RecordFinding", "check_records"]

_Band = tuple[float, float]
#: Hits with these faults are not compared with others.
_EXCLUDED_FAULTS = ("clipped", "double-hit", "cut-off", "leakage")


def check_records(
    records: xarray.DataArray | Records,
    excitation: str | Iterable[str],
    *,
    band: tuple[float, float] | None = None,
    segment: float | None = None,
) -> tuple[RecordFinding, ...]:
    """Return the faults of records.

    Parameters
    ----------
    records : xarray.DataArray
        From `read_records`.
    excitation : str or iterable of str
        Channel of the force, or those of several forces.
    band : (float, float), optional
        Frequency range in Hz. Without it the required range of force and response is unknown:
        ``"short-force"`` and ``"noise-floor"`` are not checked, and levels are compared at the
        lines with a force within 20 dB of its largest.
    segment : float, optional
        As for `estimate_frf`, in s: the force is continuous, and faults of hits are not checked.

    Returns
    -------
    tuple of RecordFinding
        By record, then by channel. ``"no-pulse"`` (the channel named as the force is not a force)
        is returned alone, as all others depend on the force. Those of several records together are
        last; ``"leakage"`` of segments and ``"level-dependence"`` require a single force.
        `estimate_frf` omits no record by itself: pass ``reject={finding.record: finding.kind}`` for
        those to omit.

    Raises
    ------
    DataError
        If a channel is missing or zero throughout, or the band is invalid.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray
    >>> force = np.zeros((3, 1024))
    >>> force[:, 100:110] = 50.0 * np.sin(np.pi * np.arange(10) / 10)
    >>> records = xarray.DataArray(
    ...     np.stack([force, force / 2.0], axis=1),  # a mass of 2 kg
    ...     dims=("record", "channel", "time"),
    ...     coords={
    ...         "channel": ["1:X", "2:X"],
    ...         "unit": ("channel", ["N", "m/s^2"]),
    ...         "time": np.arange(1024) / 1024,
    ...     },
    ... )
    >>> [finding.kind for finding in updyn.check_records(records, "1:X")]
    []
    """
    given = as_records(records)
    if band is not None:
        with key_path("band"):
            band = check_band(band)
    forces = [excitation] if isinstance(excitation, str) else list(excitation)
    rows = []
    for name in forces:
        with key_path("excitation", name):
            rows.append(given.index(name))
            if not given.values[:, rows[-1]].any():
                raise DataError(f"channel {name!r}: the force is zero throughout")
    others = [row for row in range(len(given.channels)) if row not in rows]
    if segment is None:
        for row in rows:
            wrong = check_pulse(given.values, given.step, given.channels, row, others)
            if wrong is not None:
                return (wrong,)  # all other findings depend on the force
    found: list[RecordFinding] = []
    equal_peaks: list[RecordFinding] = []
    if segment is None:
        for row, name in enumerate(given.channels):
            equal_peaks += find_equal_peaks(given.values[:, row], name)
    for number in range(1, len(given.values) + 1):
        if segment is None:
            found += _check_hit(given, rows, number, band, equal_peaks)
        else:
            found += _check_continuous(given, number)
    for row, name in enumerate(given.channels):
        found += find_mains(given.values[:, row], given.step, segment is not None, band, name)
    if len(rows) > 1:
        return tuple(found)
    for row in others:
        if segment is None:
            found += _check_channel(given, rows[0], row, band, found)
        else:
            names = (given.channels[rows[0]], given.channels[row])
            pair = given.values[:, rows[0]], given.values[:, row]
            found += find_leakage(*pair, given.step, segment, names)
    return tuple(found)


def _check_hit(
    records: Records,
    rows: list[int],
    number: int,
    band: _Band | None,
    equal_peaks: list[RecordFinding],
) -> Iterator[RecordFinding]:
    """Yield the faults of one hit, including those in common with other hits."""
    record, step = records.values[number - 1], records.step
    force = record[rows[0]]
    begin = find_hit_start(force)
    for row, (name, channel) in enumerate(zip(records.channels, record, strict=True)):
        found = [
            *find_clipped_run(channel, name, number),
            *find_clipped_pair(channel, name, number),
        ]
        found += [one for one in equal_peaks if (one.record, one.channel) == (number, name)]
        if row in rows:
            found += find_second_hits(channel, step, name, number)
            if band is not None:
                found += find_short_force(channel, step, band, name, number)
        else:
            found += find_cut_off(channel, force, name, number)
            found += find_ringing_before(channel, force, name, number)
            if band is not None and not any(one.kind == "cut-off" for one in found):
                found += find_noise_floor(channel, step, _lines(force, step, band), name, number)
        found += find_drift(channel, begin, name, number)
        yield from found


def _check_continuous(records: Records, number: int) -> Iterator[RecordFinding]:
    for name, channel in zip(records.channels, records.values[number - 1], strict=True):
        yield from find_clipped_run(channel, name, number)
        yield from find_drift(channel, None, name, number)


def _check_channel(
    records: Records, force: int, row: int, band: _Band | None, found: list[RecordFinding]
) -> Iterator[RecordFinding]:
    """Yield the faults of a channel over all hits."""
    name = records.channels[row]
    if any(one.kind == "mains" and one.channel == name for one in found):
        return  # a line that is equal in all hits is a larger share of the weak ones
    spoilt = {
        one.record
        for one in found
        if one.kind in _EXCLUDED_FAULTS and one.channel in (name, records.channels[force])
    }
    numbers = [n for n in range(1, len(records.values) + 1) if n not in spoilt]
    if not numbers:
        return
    at = np.array(numbers) - 1
    F, X = (
        values - np.median(values, axis=1, keepdims=True)
        for values in (records.values[at, force], records.values[at, row])
    )
    lines = np.all([_lines(one, records.step, band) for one in F], axis=0)
    quiet = np.array([np.where(hit_mask(one), one, 0.0) for one in F])
    yield from find_level_dependence(quiet, X, records.step, lines, name, numbers)


def _lines(force: RealArray, step: float, band: _Band | None) -> BoolArray:
    """Return a mask of the lines in the band with sufficient force."""
    level = np.abs(np.fft.rfft(force - np.median(force)))
    freq = np.fft.rfftfreq(len(force), step)
    lines = (level > 10.0 ** (HIT_FORCE.least_level / 20.0) * level[1:].max()) & (freq > 0.0)
    if band is not None:
        lines &= (freq >= band[0]) & (freq <= band[1])
    return np.asarray(lines)
