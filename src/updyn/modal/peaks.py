"""`find_resonance_peaks`: peaks of the complex mode indicator function as approximate modes.

At a well separated resonance the first singular vectors are the shape (C. Y. Shih et al., Mech.
Syst. Signal Process. 2 (1988) 367-377).
"""

from __future__ import annotations

import numpy as np

from updyn.arrays import ComplexArray, IndexArray, RealArray
from updyn.frf import FRF
from updyn.modal.mode_set import ModeSet
from updyn.modal.settings import RESONANCE_PEAK
from updyn.modal.sides import Sides, as_accelerance

__all__ = ["find_resonance_peaks"]


def find_resonance_peaks(frf: FRF) -> ModeSet | None:
    """Return the peaks of a measurement as undamped modes of any scale; None without peaks."""
    moving = np.flatnonzero(np.abs(frf.s) > 0.0)
    if len(moving) < RESONANCE_PEAK.least_lines:
        return None
    if frf.values[0].size < RESONANCE_PEAK.least_channels:
        return None
    found = as_accelerance(frf.select(lines=frf.freq[moving]))
    sides = Sides.of(found)
    scaled = found.values * sides.row_scale[:, None] * sides.column_scale
    level = np.linalg.svd(scaled, compute_uv=False)[:, 0]
    if not level.all():  # zero response at a line
        level = np.maximum(level, np.finfo(np.float64).tiny)
    peaks, height = find_prominences(20.0 * np.log10(level))
    high = height >= RESONANCE_PEAK.least_height
    peaks, height = peaks[high], height[high]
    lasting = np.array([_is_lasting(scaled, k) for k in peaks], dtype=np.bool_)
    peaks, height = peaks[lasting], height[lasting]
    peaks = np.sort(peaks[np.argsort(-height, kind="stable")[: RESONANCE_PEAK.most_peaks]])
    if not peaks.size:
        return None
    shapes = [_dominant_shape(sides, found.values[k]) for k in peaks]
    return ModeSet(found.freq[peaks], np.stack(shapes, axis=1), sides.dofs, source=frf.source)


def find_prominences(level: RealArray) -> tuple[IndexArray, RealArray]:
    """Return positions of the inner local maxima of a curve, and their topographic prominences."""
    # A prominence is the height over the higher of the two lowest values before the next higher
    # value, or the end of the curve, on either side.
    inner = level[1:-1]
    peaks = 1 + np.flatnonzero((inner > level[:-2]) & (inner >= level[2:]))
    height = np.empty(len(peaks))
    for i, k in enumerate(peaks):
        higher = np.flatnonzero(level > level[k])
        at = int(np.searchsorted(higher, k))
        first = higher[at - 1] if at > 0 else 0
        last = higher[at] if at < len(higher) else len(level) - 1
        height[i] = level[k] - max(level[first : k + 1].min(), level[k : last + 1].min())
    return peaks, height


def _is_lasting(scaled: ComplexArray, k: int) -> bool:
    """Return whether the FRFs at a line are nearly proportional to those at an adjacent line."""
    here = scaled[k].ravel()
    norm = float(np.vdot(here, here).real)
    for other in (scaled[k - 1].ravel(), scaled[k + 1].ravel()):
        size = float(np.vdot(other, other).real) * norm
        if size > 0.0 and abs(np.vdot(here, other)) ** 2 >= RESONANCE_PEAK.lasting_mac * size:
            return True
    return False


def _dominant_shape(sides: Sides, values: ComplexArray) -> ComplexArray:
    """Return the shape from the dominant part of the FRF matrix of a line."""
    U, s, Vh = np.linalg.svd(values * sides.row_scale[:, None] * sides.column_scale)
    product = s[0] * np.outer(U[:, 0], Vh[0])
    return sides.shapes(product / sides.row_scale[:, None] / sides.column_scale)[0]
