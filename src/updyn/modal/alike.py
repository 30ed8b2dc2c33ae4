"""`find_alike_pairs`: modes that the sensors cannot distinguish, such as one mode found twice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from updyn.correlation import auto_mac
from updyn.modal.mode_set import ModeSet
from updyn.modal.settings import PHYSICAL_MODE

__all__ = ["AlikePair", "find_alike_pairs"]


@dataclass(frozen=True, slots=True)
class AlikePair:
    """Two modes with nearly the same shape; `first` and `second` are frequencies in Hz, ascending.

    `overlap`: they differ by less than the sum of the half-power bandwidths, so the two may be one
    mode found twice.
    """

    first: float
    second: float
    mac: float
    overlap: bool


def find_alike_pairs(modes: ModeSet) -> list[AlikePair]:
    """Return the pairs of modes with a MAC of 0.9 or more, overlapping ones first, then by MAC."""
    mac, frequency = auto_mac(modes.shapes), modes.frequency
    width = frequency * modes.loss_factor
    found = []
    for i, j in np.argwhere(np.triu(mac >= PHYSICAL_MODE.alike_mac, 1)).tolist():
        overlap = bool(frequency[j] - frequency[i] < width[i] + width[j])
        found.append(AlikePair(float(frequency[i]), float(frequency[j]), float(mac[i, j]), overlap))
    return sorted(found, key=lambda pair: (not pair.overlap, -pair.mac))
