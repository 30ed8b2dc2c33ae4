"""Significant peaks of the measurement without a mode."""

from __future__ import annotations

import numpy as np
import scipy  # loads scipy.ndimage on use
import scipy.special

from updyn.arrays import ComplexArray, RealArray
from updyn.modal.measured import Measured
from updyn.modal.settings import UNEXPLAINED_PEAK

__all__ = ["describe_unexplained", "find_unexplained"]


def describe_unexplained(peaks: RealArray) -> str:
    """Return the frequencies of significant peaks without a mode, as text; empty for none."""
    if not len(peaks):
        return ""
    most = UNEXPLAINED_PEAK.listed_peaks
    shown = ", ".join(f"{f:.6g}" for f in peaks[:most]) + ", ..." * (len(peaks) > most)
    return f"{'Peak' if len(peaks) == 1 else 'Peaks'} without a mode: {shown} Hz"


def find_unexplained(measured: Measured, poles: ComplexArray) -> RealArray:
    """Return the frequencies in Hz of significant peaks without a mode, ascending."""
    # The mode indicator is the sum of the squared values of all channels over its running median.
    n = len(measured.freq)
    channels = measured.cube.reshape(n, -1)
    power = np.sum(np.abs(channels) ** 2, axis=1)
    p = int(np.count_nonzero(np.any(channels, axis=0)))
    least = max(10.0 ** (0.1 * UNEXPLAINED_PEAK.least_height), _noise_peak(p, n))
    over = np.zeros(n, dtype=np.bool_)
    for lines in (UNEXPLAINED_PEAK.narrow_surroundings, UNEXPLAINED_PEAK.wide_surroundings):
        if n > 2 * lines:
            over |= power > least * scipy.ndimage.median_filter(power, 2 * lines + 1)
    width = 2 * UNEXPLAINED_PEAK.dominated_lines + 1
    highest = power >= scipy.ndimage.maximum_filter1d(power, width)
    highest[[0, -1]] = False  # edges of a slope
    peaks = measured.freq[over & highest]
    at = measured.axis.frequency(poles)
    reach = UNEXPLAINED_PEAK.mode_bandwidths * measured.bandwidth(poles)
    reach = reach + UNEXPLAINED_PEAK.mode_lines * measured.spacing
    is_unexplained = np.abs(peaks[:, None] - at) > reach
    return np.asarray(peaks[is_unexplained.all(axis=1)])


def _noise_peak(p: int, n: int) -> float:
    """Return the indicator that noise of p channels exceeds by chance on any of n lines."""
    # The sum of p squares over an estimate of its mean has an F distribution. A median of m
    # squares is as accurate as a mean of half as many: 0.48 m for exponential variables, 0.64 m
    # for normal ones (H. Cramer, Mathematical Methods of Statistics, 1946, section 28.5).
    lines = 2 * UNEXPLAINED_PEAK.narrow_surroundings + 1
    probability = 1.0 - UNEXPLAINED_PEAK.false_alarm / (2 * n)  # two surroundings
    over_mean = scipy.special.fdtri(2 * p, p * lines, probability)
    return float(over_mean * p / scipy.special.gammaincinv(p, 0.5))
