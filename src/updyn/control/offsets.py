"""Distances of lines from a resonance or an antiresonance, on both sides of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from updyn.arrays import RealArray

__all__ = ["mirror_offsets"]


def mirror_offsets(offsets: Sequence[float]) -> RealArray:
    """Return ascending distances above 0 with 0 and their negatives."""
    above = np.array(offsets, dtype=np.float64)
    return np.concatenate([-above[::-1], [0.0], above])
