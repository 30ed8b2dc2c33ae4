"""Faults of several records together: FRFs that depend on the level, leakage of segments."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # loads scipy.signal on use; its import is slow

from updyn.arrays import BoolArray, ComplexArray, RealArray
from updyn.signals.quality.finding import RecordFinding
from updyn.signals.quality.settings import LEVEL_DEPENDENCE, RECORD_PEAK, SEGMENT_LEAKAGE

__all__ = ["find_leakage", "find_level_dependence"]


def find_level_dependence(
    force: RealArray,
    motion: RealArray,
    step: float,
    lines: BoolArray,
    name: str,
    records: Sequence[int],
) -> Iterator[RecordFinding]:
    """Yield the peak whose shape changes most with the level of the hits: a nonlinear structure."""
    # Around each peak the FRF of a hit is divided by the complex factor that brings it closest to
    # the mean, which removes the effect of a hit away from the point. The remaining shape is
    # regressed on the level, and the explained part is compared with chance (F test). `force` and
    # `motion` have no offset.
    levels = np.abs(force).max(axis=1)
    n = len(levels)
    if n < LEVEL_DEPENDENCE.least_hits:
        return
    if levels.max() < LEVEL_DEPENDENCE.least_range * levels.min():
        return
    gate = _gate(motion)
    F, X = np.fft.rfft(force * gate, axis=1), np.fft.rfft(motion * gate, axis=1)
    freq = np.fft.rfftfreq(force.shape[1], step)
    H = np.zeros_like(X)
    lines = lines & (np.abs(F) > 0.0).all(axis=0)
    H[:, lines] = X[:, lines] / F[:, lines]
    least = (n - 2) * (LEVEL_DEPENDENCE.false_alarm ** (-1.0 / (n - 2)) - 1.0)
    found: list[tuple[float, float]] = []
    for peak, about in _peaks(np.abs(H.mean(axis=0)), lines):
        change, F_ratio = _shape_change(H[:, about], levels)
        if change > LEVEL_DEPENDENCE.least_change and F_ratio > least:
            found.append((change, float(freq[peak])))
    if found:
        change, f = max(found)
        low, high = float(levels.min()), float(levels.max())
        yield RecordFinding(
            "level-dependence",
            name,
            None,
            change,
            f"Records {', '.join(map(str, records))}, {name}: from the weakest hit ({low:.3g}) to"
            f" the strongest ({high:.3g}) the peak at {f:g} Hz changes its shape by"
            f" {100.0 * change:.0f} %: the structure is not linear.",
            "Use hits of one level, or fit the FRFs of one level; look for joints that slip or"
            " rattle.",
            (0.95 * f, 1.05 * f),
        )


def _gate(motion: RealArray) -> RealArray:
    """Return a window that ends when the responses have decayed to their noise."""
    n = motion.shape[1]
    size = max(1, n // LEVEL_DEPENDENCE.blocks)
    blocks = motion[:, : n // size * size].reshape(len(motion), -1, size)
    level = np.sqrt(np.mean(blocks**2, axis=(0, 2)))
    noise = np.median(level[-len(level) // 4 :])
    loud = np.flatnonzero(level > LEVEL_DEPENDENCE.loud_ratio * noise)
    end = n if not len(loud) else min(n, (int(loud[-1]) + 2) * size)
    fall = max(2, end // 4)
    gate = np.zeros(n)
    gate[:end] = 1.0
    gate[end - fall : end] = 0.5 + 0.5 * np.cos(np.pi * np.arange(fall) / fall)
    return gate


def _peaks(size: RealArray, lines: BoolArray) -> Iterator[tuple[int, slice]]:
    """Yield the indices of the largest peaks, and the lines around each."""
    places, known = scipy.signal.find_peaks(np.where(lines, size, 0.0), prominence=0.0)
    high = known["prominences"] > 0.5 * size[places]
    places = places[high]
    for peak in places[np.argsort(-size[places])][: RECORD_PEAK.most_peaks].tolist():
        of_peak = lines & (size > RECORD_PEAK.flank_share * size[peak])
        others = np.concatenate([[-1], np.flatnonzero(~of_peak), [len(size)]])
        after = int(np.searchsorted(others, peak))
        low, high = int(others[after - 1]) + 1, int(others[after])
        if high - low > 2:
            yield peak, slice(low, high)


def _shape_change(H: ComplexArray, levels: RealArray) -> tuple[float, float]:
    """Return the change of a shape from the lowest level to the highest, and F of that change."""
    # The noise of an FRF is inverse to the level of its hit, so the levels are the weights.
    mean = levels**2 @ H / np.sum(levels**2)
    power = float(np.vdot(mean, mean).real)
    shapes = H / (H @ mean.conj() / power)[:, None]
    weighted = levels[:, None] * shapes
    Q, R = np.linalg.qr(np.column_stack([levels, levels**2]))
    along = Q.T @ weighted
    explained = float(np.vdot(along[1], along[1]).real)
    residual_power = float(np.sum(np.abs(weighted - Q @ along) ** 2))
    residual_power = max(residual_power, 1e-24 * power * float(np.sum(levels**2)))
    change = float(np.sqrt(explained / power)) / abs(float(R[1, 1])) * float(np.ptp(levels))
    return change, explained / (residual_power / (len(levels) - 2))


def find_leakage(
    force: RealArray, motion: RealArray, step: float, segment: float, names: tuple[str, str]
) -> Iterator[RecordFinding]:
    """Yield the peak that loses most relative to segments twice as long."""
    size = round(segment / step)
    if size < 16 or 2 * size > force.shape[1]:
        return
    short, long = (_Averages.of(force, motion, n) for n in (size, 2 * size))
    if len(long.xf) < SEGMENT_LEAKAGE.segments_per_part * SEGMENT_LEAKAGE.parts:
        return
    freq = np.fft.rfftfreq(size, step)
    whole = np.abs(short.h1(slice(None)))
    places, _ = scipy.signal.find_peaks(whole, prominence=0.0)
    places = places[places > 1]
    found: list[tuple[float, float]] = []
    for peak in places[np.argsort(-whole[places])][: RECORD_PEAK.most_peaks].tolist():
        about = np.abs(long.h1(slice(None))[2 * peak - 1 : 2 * peak + 2])
        lost = 1.0 - whole[peak] / about.max()
        at = 2 * peak - 1 + int(np.argmax(about))
        # The two estimates share their noise; its effect on the loss follows from parts of records.
        parts = []
        for part in range(SEGMENT_LEAKAGE.parts):
            pair = (one.h1(slice(part, None, SEGMENT_LEAKAGE.parts)) for one in (short, long))
            low, high = (float(np.abs(H[k])) for H, k in zip(pair, (peak, at), strict=True))
            parts.append(1.0 - low / high)
        error = float(np.std(parts, ddof=1)) / np.sqrt(SEGMENT_LEAKAGE.parts)
        if lost > SEGMENT_LEAKAGE.least_loss + SEGMENT_LEAKAGE.least_stds * error:
            found.append((float(lost), float(freq[peak])))
    if found:
        lost, f = max(found)
        force_name, name = names
        yield RecordFinding(
            "leakage",
            name,
            None,
            lost,
            f"All records, {force_name} to {name}: in segments of {segment:g} s the peak at {f:g}"
            f" Hz is {100.0 * lost:.0f} % lower than in segments twice as long.",
            f"Use segments of {2.0 * segment:g} s or more.",
            (f - 2.0 / segment, f + 2.0 / segment),
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Averages:
    """X conj(F) and |F|^2 of segments with an overlap of a half, shape (n, lines)."""

    xf: ComplexArray
    ff: RealArray

    @classmethod
    def of(cls, force: RealArray, motion: RealArray, size: int) -> _Averages:
        F, X = _segments(force, size), _segments(motion, size)
        return cls(X * F.conj(), np.abs(F) ** 2)

    def h1(self, chosen: slice) -> ComplexArray:
        """Return H1 over some of the segments."""
        power = np.maximum(self.ff[chosen].mean(axis=0), np.finfo(float).tiny)
        return np.asarray(self.xf[chosen].mean(axis=0) / power)


def _segments(channel: RealArray, size: int) -> ComplexArray:
    """Return the spectra of the segments of a channel, shape (n, size // 2 + 1)."""
    cut = np.lib.stride_tricks.sliding_window_view(channel, size, axis=1)[:, :: size // 2]
    flat = cut.reshape(-1, size)
    return np.fft.rfft((flat - flat.mean(axis=1, keepdims=True)) * np.hanning(size), axis=1)
