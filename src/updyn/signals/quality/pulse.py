"""Check that the channel named as the force of hits is a pulse."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from updyn.arrays import RealArray
from updyn.signals.quality.finding import RecordFinding
from updyn.signals.quality.settings import PULSE

__all__ = ["check_pulse", "time_of_energy"]


def check_pulse(
    values: RealArray, step: float, names: Sequence[str], force: int, others: Sequence[int]
) -> RecordFinding | None:
    """Return a finding if the force oscillates and another channel is a pulse; else None."""
    # A response to a hit cannot be shorter than the hit, and a shaker causes no pulse in a
    # response. At least half of the records must show it.
    lasts, sign = _shape(values[:, force])
    for row in others:
        short, one = _shape(values[:, row])
        is_shorter = short * PULSE.duration_ratio <= lasts
        is_pulse = (one >= PULSE.one_sign) & is_shorter & (sign < PULSE.oscillation)
        if 2 * np.count_nonzero(is_pulse) < len(values):
            continue
        times = [1e3 * step * float(np.median(n[is_pulse])) for n in (lasts, short)]
        return RecordFinding(
            "no-pulse",
            names[force],
            None,
            times[0] / times[1],
            f"All records, {names[force]}: the force is not a pulse; it oscillates for"
            f" {times[0]:.3g} ms."
            f" Channel {names[row]} is a pulse of {times[1]:.3g} ms.",
            f"Name {names[row]} as the excitation if it is the hammer; for a lasting force give"
            " segment.",
        )
    return None


def time_of_energy(channel: RealArray) -> RealArray:
    """Return for each record the fewest consecutive samples with 90 % of the energy."""
    return _shape(channel)[0]


def _shape(channel: RealArray) -> tuple[RealArray, RealArray]:
    """Return the duration of each record in samples, and |sum| over sum of absolute values."""
    found = [_pulse_shape(record - np.median(record)) for record in channel]
    lasts, sign = np.array(found).T
    return lasts, sign


def _pulse_shape(record: RealArray) -> tuple[float, float]:
    """Return the duration in samples, and |sum| over the sum of absolute values in it."""
    size = np.abs(record)
    energy = np.where(size > PULSE.loud_share * size.max(), size**2, 0.0)
    passed = np.concatenate([[0.0], np.cumsum(energy)])
    if passed[-1] == 0.0:
        return float(len(record)), 0.0
    ends = np.searchsorted(passed, passed[:-1] + PULSE.energy_share * passed[-1])
    lengths = np.where(ends < len(passed), ends - np.arange(len(record)), len(record) + 1)
    begin = int(np.argmin(lengths))
    part = record[begin : begin + int(lengths[begin])]
    return float(len(part)), float(abs(part.sum()) / np.abs(part).sum())
