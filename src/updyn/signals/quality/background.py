"""Background of a signal along a record: drift of its offset, lines of the mains, noise."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy  # loads scipy.signal on use; its import is slow

from updyn.arrays import BoolArray, RealArray
from updyn.signals.quality.finding import RecordFinding
from updyn.signals.quality.settings import DRIFT, MAINS, NOISE_FLOOR

__all__ = ["find_drift", "find_mains", "find_noise_floor"]


#: Nominal frequencies of mains in Hz.
_MAINS_FREQUENCIES = (50.0, 60.0)


def find_drift(
    channel: RealArray, begin: int | None, name: str, record: int
) -> Iterator[RecordFinding]:
    """Yield an offset that changes along the record, for a hit from sample `begin` on."""
    if len(channel) < 2 * DRIFT.pieces:
        return
    offsets = np.array([piece.mean() for piece in np.array_split(channel, DRIFT.pieces)])
    size = float(np.abs(channel - np.median(channel)).max())
    if begin is not None:
        offsets = offsets[DRIFT.pieces // 2 :]  # in the second half the response is small
    change = _trend(offsets)
    if begin is not None and begin >= DRIFT.least_samples_before:
        change = max(change, _offset_after(offsets, channel[:begin]))
    if change > DRIFT.least_share * size:
        yield RecordFinding(
            "drift",
            name,
            record,
            change,
            f"Record {record}, {name}: the offset drifts by {change:.3g},"
            f" {100.0 * change / size:.2g} % of the largest value.",
            "Let sensor and amplifier settle, or use a high-pass filter; exclude the lowest lines"
            " from the band.",
        )


def _trend(offsets: RealArray) -> float:
    """Return the change of a straight line through offsets in a record; 0 if insignificant."""
    at = np.arange(len(offsets)) - 0.5 * (len(offsets) - 1)
    slope = float(at @ offsets / (at @ at))
    residual = offsets - offsets.mean() - slope * at
    error = float(np.sqrt(residual @ residual / (len(at) - 2) / (at @ at)))
    return abs(slope) * DRIFT.pieces if abs(slope) > DRIFT.least_t * error else 0.0


def _offset_after(offsets: RealArray, before: RealArray) -> float:
    """Return the difference of offsets from that before the hit; 0 if insignificant."""
    apart = abs(float(offsets.mean() - before.mean()))
    spread = float(offsets.std(ddof=1))
    error = float(before.std()) / np.sqrt(len(before))
    return apart if apart > DRIFT.over_spread * spread and apart > DRIFT.over_error * error else 0.0


def find_mains(
    channel: RealArray,
    step: float,
    lasting: bool,
    band: tuple[float, float] | None,
    name: str,
) -> Iterator[RecordFinding]:
    """Yield the largest mains line present throughout most records (of hits: their second half)."""
    found: list[tuple[float, float, float]] = []
    multiples = range(1, MAINS.harmonics + 1)
    for f in (base * multiple for base in _MAINS_FREQUENCIES for multiple in multiples):
        if f + 10.0 >= 0.5 / step or (band is not None and not band[0] <= f <= band[1]):
            continue
        lines = [_sine_in_record(record, step, lasting, f) for record in channel]
        amplitude, share = np.median(lines, axis=0)
        if share > MAINS.least_share:
            found.append((float(amplitude), f, float(share)))
    if found:
        amplitude, f, share = max(found)
        yield RecordFinding(
            "mains",
            name,
            None,
            amplitude,
            f"All records, {name}: a line of the mains at {f:g} Hz, {amplitude:.3g} throughout,"
            f" {100.0 * share:.0f} % of the spectrum at this line.",
            "Break the ground loop or run the sensor from batteries; exclude the lines around"
            f" {f:g} Hz from the fit.",
            (f - 1.0, f + 1.0),
        )


def _sine_in_record(record: RealArray, step: float, lasting: bool, f: float) -> tuple[float, float]:
    """Return the amplitude of a steady sine near f, and its share of the spectrum."""
    n = len(record)
    part = record if lasting else record[n // 2 :]
    amplitude = _steady_line(np.array_split(part - part.mean(), 2), step, f)
    if amplitude == 0.0:
        return 0.0, 0.0
    spectrum = np.abs(np.fft.rfft(record - np.median(record)))
    return amplitude, min(1.0, 0.5 * amplitude * n / _largest_near(spectrum, f * n * step))


def _largest_near(spectrum: RealArray, line: float) -> float:
    """Return the largest value of a spectrum within a line of a position."""
    at = round(line)
    return float(spectrum[max(at - 1, 0) : at + 2].max(initial=np.finfo(float).tiny))


def _steady_line(halves: list[RealArray], step: float, f: float) -> float:
    """Return the amplitude of a sine near f with equal amplitudes in both halves; else 0."""
    found = [_find_sine(half, step, f) for half in halves]
    if any(line is None for line in found):
        return 0.0
    first, second = (line for line in found if line is not None)
    amplitude = 0.5 * (first[0] + second[0])
    allowed = MAINS.steady_change * amplitude + 2.0 * max(first[1], second[1])
    return amplitude if abs(first[0] - second[0]) <= allowed else 0.0


def _find_sine(half: RealArray, step: float, f: float) -> tuple[float, float] | None:
    """Return amplitude and error of a sine near f that exceeds its surroundings; else None."""
    n = len(half)
    if n * step < MAINS.least_half or f * n * step < MAINS.last_adjacent + 1:
        return None
    window, resolution = np.hanning(n), 1.0 / (n * step)
    finer = MAINS.interpolation * n
    spectrum = np.abs(np.fft.rfft(half * window, finer)) * 2.0 / window.sum()
    # The frequency of the mains varies; a record that resolves this is searched.
    off = MAINS.frequency_deviation
    lines = finer * step * np.array([f - off, f + off])
    amplitude = float(spectrum[int(lines[0]) : int(np.ceil(lines[1])) + 1].max())
    apart = np.arange(MAINS.first_adjacent, MAINS.last_adjacent + 1) * resolution
    places = np.round(finer * step * np.concatenate([f - apart, f + apart])).astype(int)
    surroundings = float(np.median(spectrum[places] ** 2))
    if amplitude**2 <= MAINS.over_surroundings * surroundings:
        return None
    return amplitude, float(np.sqrt(surroundings))


def find_noise_floor(
    channel: RealArray,
    step: float,
    lines: BoolArray,
    name: str,
    record: int,
) -> Iterator[RecordFinding]:
    """Yield a response to a hit that is noise at many lines.

    The response must have decayed in the last quarter.
    """
    n = len(channel)
    freq = np.fft.rfftfreq(n, step)
    if lines.sum() < 8 or n < NOISE_FLOOR.least_samples:
        return
    tail = channel[-(n // 4) :]
    at, density = scipy.signal.welch(tail, fs=1.0 / step, nperseg=max(16, len(tail) // 4))
    # The remaining response has narrow lines, which the median removes.
    floor = scipy.ndimage.median_filter(density, size=min(15, len(density)), mode="nearest")
    power = np.abs(np.fft.rfft(channel - np.median(channel))) ** 2 * 2.0 * step / n
    noise = np.interp(freq, at, floor)
    # Smoothed, as a single line of noise may be ten times its mean.
    smooth = np.convolve(power, np.ones(5) / 5.0, mode="same")
    faint = lines & (smooth < 10.0 ** (NOISE_FLOOR.least_ratio / 10.0) * noise)
    share = float(faint.sum() / lines.sum())
    if share > NOISE_FLOOR.most_faint_share:
        low, high = float(freq[faint][0]), float(freq[faint][-1])
        yield RecordFinding(
            "noise-floor",
            name,
            record,
            share,
            f"Record {record}, {name}: at {100.0 * share:.0f} % of the lines, within {low:g} to"
            f" {high:g} Hz, the response is less than {NOISE_FLOOR.least_ratio:.0f} dB above the"
            " noise.",
            "Hit harder, take a more sensitive sensor or a smaller range, or average more hits.",
            (low, high),
        )
