"""What lies under a signal all along a record: drift of its offset, lines of the mains, noise."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.signal import welch

from updyn.signals.quality.finding import RecordFinding

__all__ = ["drift", "mains", "noise_floor"]

_Real = NDArray[np.float64]

#: Offsets are means of so many pieces of a record; a drift is at least this share of the largest
#: value. It shows as a slope of the offsets, by its t, or as an offset that differs from that
#: before the hit by so many times their spread and the error of the latter.
_PIECES, _DRIFT, _SLOPE, _ABOVE_SPREAD, _ABOVE_ERROR = 20, 0.01, 12.0, 4.0, 8.0
#: Samples before the hit that give an offset.
_BEFORE = 64
#: Frequencies of mains in Hz and how far they wander; harmonics that are looked at.
_MAINS, _WANDER, _HARMONICS = (50.0, 60.0), 0.15, 3
#: A line of mains is this many times the power beside it, keeps its amplitude to this share from
#: one half to the next, and is at least this share of the spectrum of the whole record there.
_ABOVE_BESIDE, _STEADY, _SHARE = 30.0, 0.25, 0.05
#: Least length of a half, in s: in shorter ones a mode decays too little to be told from a line.
_LEAST = 0.2
#: Lines between the lines that are looked at.
_FINER = 4
#: Lines beside, on either side: from the first to the last of these.
_BESIDE = (3, 8)
#: Response over noise, in dB, that FRFs need; share of lines without it from which it is told.
_ENOUGH, _WITHOUT = 3.0, 0.45
#: Samples from which the noise at the end of a record is known.
_SHORTEST = 256


def drift(channel: _Real, begin: int | None, name: str, record: int) -> Iterator[RecordFinding]:
    """Find an offset that moves along the record.

    Parameters
    ----------
    channel : ndarray of float, shape (n_samples,)
        The record.
    begin : int or None
        Sample at which the hit begins; None: the signal lasts.
    name, record
        Of the finding.

    Yields
    ------
    RecordFinding
    """
    if len(channel) < 2 * _PIECES:
        return
    offsets = np.array([piece.mean() for piece in np.array_split(channel, _PIECES)])
    size = float(np.abs(channel - np.median(channel)).max())
    if begin is not None:
        offsets = offsets[_PIECES // 2 :]  # in the second half little is left of a response
    moved = _trend(offsets)
    if begin is not None and begin >= _BEFORE:
        moved = max(moved, _offset_after(offsets, channel[:begin]))
    if moved > _DRIFT * size:
        yield RecordFinding(
            "drift",
            name,
            record,
            moved,
            f"Record {record}, {name}: the offset drifts by {moved:.3g},"
            f" {100.0 * moved / size:.2g} % of the largest value.",
            "Let sensor and amplifier settle, or take a high-pass filter; leave the lowest lines"
            " out of the band.",
        )


def _trend(offsets: _Real) -> float:
    """Return how far a straight line through offsets goes in a record; 0 if that may be chance."""
    at = np.arange(len(offsets)) - 0.5 * (len(offsets) - 1)
    slope = float(at @ offsets / (at @ at))
    left = offsets - offsets.mean() - slope * at
    error = float(np.sqrt(left @ left / (len(at) - 2) / (at @ at)))
    return abs(slope) * _PIECES if abs(slope) > _SLOPE * error else 0.0


def _offset_after(offsets: _Real, before: _Real) -> float:
    """Return how far offsets are from that before the hit; 0 if that may be chance."""
    apart = abs(float(offsets.mean() - before.mean()))
    spread = float(offsets.std(ddof=1))
    error = float(before.std()) / np.sqrt(len(before))
    return apart if apart > _ABOVE_SPREAD * spread and apart > _ABOVE_ERROR * error else 0.0


def mains(
    channel: _Real,
    step: float,
    lasting: bool,
    band: tuple[float, float] | None,
    name: str,
) -> Iterator[RecordFinding]:
    """Find lines of the mains, which are there all along most records.

    Parameters
    ----------
    channel : ndarray of float, shape (n_records, n_samples)
        All records of it.
    step : float
        Between samples, in s.
    lasting : bool
        Whether the force lasts; of hits the second half of a record is looked at.
    band : (float, float) or None
        Lines in Hz that are wanted.
    name : str
        Of the finding.

    Yields
    ------
    RecordFinding
        Of the largest line.
    """
    found: list[tuple[float, float, float]] = []
    for f in (base * harmonic for base in _MAINS for harmonic in range(1, _HARMONICS + 1)):
        if f + 10.0 >= 0.5 / step or (band is not None and not band[0] <= f <= band[1]):
            continue
        lines = [_of_record(record, step, lasting, f) for record in channel]
        amplitude, share = np.median(lines, axis=0)
        if share > _SHARE:
            found.append((float(amplitude), f, float(share)))
    if found:
        amplitude, f, share = max(found)
        yield RecordFinding(
            "mains",
            name,
            None,
            amplitude,
            f"All records, {name}: a line of the mains at {f:g} Hz, {amplitude:.3g} from beginning"
            f" to end, {100.0 * share:.0f} % of the spectrum there.",
            "Break the ground loop or run the sensor from batteries; leave the lines about"
            f" {f:g} Hz out of the fit.",
            (f - 1.0, f + 1.0),
        )


def _of_record(record: _Real, step: float, lasting: bool, f: float) -> tuple[float, float]:
    """Return the amplitude of a steady sine near f, and its share of the spectrum there."""
    n = len(record)
    part = record if lasting else record[n // 2 :]
    amplitude = _steady_line(np.array_split(part - part.mean(), 2), step, f)
    if amplitude == 0.0:
        return 0.0, 0.0
    spectrum = np.abs(np.fft.rfft(record - np.median(record)))
    return amplitude, min(1.0, 0.5 * amplitude * n / _about(spectrum, f * n * step))


def _about(spectrum: _Real, line: float) -> float:
    """Return the largest of a spectrum within a line of a place."""
    at = round(line)
    return float(spectrum[max(at - 1, 0) : at + 2].max(initial=np.finfo(float).tiny))


def _steady_line(halves: list[_Real], step: float, f: float) -> float:
    """Return the amplitude of a sine near f that is the same in both halves; 0 if there is none."""
    found = [_line(half, step, f) for half in halves]
    if any(line is None for line in found):
        return 0.0
    first, second = (line for line in found if line is not None)
    amplitude = 0.5 * (first[0] + second[0])
    allowed = _STEADY * amplitude + 2.0 * max(first[1], second[1])
    return amplitude if abs(first[0] - second[0]) <= allowed else 0.0


def _line(half: _Real, step: float, f: float) -> tuple[float, float] | None:
    """Return amplitude and error of a sine near f that stands out of its surroundings."""
    n = len(half)
    if n * step < _LEAST or f * n * step < _BESIDE[1] + 1:
        return None
    window, resolution = np.hanning(n), 1.0 / (n * step)
    spectrum = np.abs(np.fft.rfft(half * window, _FINER * n)) * 2.0 / window.sum()
    # The mains wander; a record that resolves that is searched.
    lines = _FINER * n * step * np.array([f - _WANDER, f + _WANDER])
    amplitude = float(spectrum[int(lines[0]) : int(np.ceil(lines[1])) + 1].max())
    apart = np.arange(_BESIDE[0], _BESIDE[1] + 1) * resolution
    places = np.round(_FINER * n * step * np.concatenate([f - apart, f + apart])).astype(int)
    beside = float(np.median(spectrum[places] ** 2))
    if amplitude**2 <= _ABOVE_BESIDE * beside:
        return None
    return amplitude, float(np.sqrt(beside))


def noise_floor(
    channel: _Real,
    step: float,
    lines: NDArray[np.bool_],
    name: str,
    record: int,
) -> Iterator[RecordFinding]:
    """Find a response that is noise at many lines.

    Parameters
    ----------
    channel : ndarray of float, shape (n_samples,)
        The response to a hit, which has decayed in the last quarter.
    step : float
        Between samples, in s.
    lines : ndarray of bool, shape (n_samples // 2 + 1,)
        Which lines are looked at.
    name, record
        Of the finding.

    Yields
    ------
    RecordFinding
    """
    n = len(channel)
    freq = np.fft.rfftfreq(n, step)
    if lines.sum() < 8 or n < _SHORTEST:
        return
    tail = channel[-(n // 4) :]
    at, density = welch(tail, fs=1.0 / step, nperseg=max(16, len(tail) // 4))
    # The response that is left rings at narrow lines, which the median takes away.
    floor = median_filter(density, size=min(15, len(density)), mode="nearest")
    power = np.abs(np.fft.rfft(channel - np.median(channel))) ** 2 * 2.0 * step / n
    noise = np.interp(freq, at, floor)
    # Of the response, smoothed: a single line of noise may be ten times its mean.
    smooth = np.convolve(power, np.ones(5) / 5.0, mode="same")
    faint = lines & (smooth < 10.0 ** (_ENOUGH / 10.0) * noise)
    share = float(faint.sum() / lines.sum())
    if share > _WITHOUT:
        low, high = float(freq[faint][0]), float(freq[faint][-1])
        yield RecordFinding(
            "noise-floor",
            name,
            record,
            share,
            f"Record {record}, {name}: at {100.0 * share:.0f} % of the lines, within {low:g} to"
            f" {high:g} Hz, the response is less than {_ENOUGH:.0f} dB above the noise.",
            "Hit harder, take a more sensitive sensor or a smaller range, or average more hits.",
            (low, high),
        )
