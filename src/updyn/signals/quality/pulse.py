"""The channel named as the force of hits, which has to be a pulse."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from updyn.signals.quality.finding import RecordFinding

__all__ = ["no_pulse", "time_of_energy"]

_Real = NDArray[np.float64]

#: A signal lasts for the shortest time with this share of its energy, of samples above this share
#: of the largest: the rest is noise.
_ENERGY, _LOUD = 0.9, 0.05
#: |sum| over the sum of sizes in that time, from which a signal is of one sign and below which it
#: swings: of half a sine it is 1, of a free vibration 0.
_ONE_SIGN, _SWINGS = 0.8, 0.5
#: A pulse is shorter than what rings by this factor.
_SHORTER = 4.0


def no_pulse(
    values: _Real, step: float, names: Sequence[str], force: int, others: Sequence[int]
) -> RecordFinding | None:
    """Return a finding if the force swings for long, and another channel is a pulse.

    A response to a hit cannot be shorter than the hit, and a shaker makes no pulse in a response.

    Parameters
    ----------
    values : ndarray of float, shape (n_records, n_channels, n_samples)
        The records.
    step : float
        Between samples, in s.
    names : sequence of str
        Of the channels.
    force : int
        Position of the channel named as the force.
    others : sequence of int
        Positions of the channels that are not named as forces.

    Returns
    -------
    RecordFinding or None
        Of all records together; None if fewer than half of them show it.
    """
    lasts, sign = _shape(values[:, force])
    for row in others:
        short, one = _shape(values[:, row])
        is_pulse = (one >= _ONE_SIGN) & (short * _SHORTER <= lasts) & (sign < _SWINGS)
        if 2 * np.count_nonzero(is_pulse) < len(values):
            continue
        times = [1e3 * step * float(np.median(n[is_pulse])) for n in (lasts, short)]
        return RecordFinding(
            "no-pulse",
            names[force],
            None,
            times[0] / times[1],
            f"All records, {names[force]}: the force is no pulse; it swings for {times[0]:.3g} ms."
            f" Channel {names[row]} is a pulse of {times[1]:.3g} ms.",
            f"Name {names[row]} as the excitation if it is the hammer; for a lasting force give"
            " segment.",
        )
    return None


def time_of_energy(channel: _Real) -> _Real:
    """Return by record the fewest samples in a row with 90 % of the energy.

    Parameters
    ----------
    channel : ndarray of float, shape (n_records, n_samples)
        The records of a channel.

    Returns
    -------
    ndarray of float, shape (n_records,)
    """
    return _shape(channel)[0]


def _shape(channel: _Real) -> tuple[_Real, _Real]:
    """Return by record the samples that a channel lasts, and |sum| over sum of sizes in them."""
    found = [_of_record(record - np.median(record)) for record in channel]
    lasts, sign = np.array(found).T
    return lasts, sign


def _of_record(record: _Real) -> tuple[float, float]:
    """Return the shortest number of samples with most of the energy, and |sum| over sum of sizes.

    A channel that is zero throughout has all samples, and 0.
    """
    size = np.abs(record)
    passed = np.concatenate([[0.0], np.cumsum(np.where(size > _LOUD * size.max(), size**2, 0.0))])
    if passed[-1] == 0.0:
        return float(len(record)), 0.0
    ends = np.searchsorted(passed, passed[:-1] + _ENERGY * passed[-1])
    lengths = np.where(ends < len(passed), ends - np.arange(len(record)), len(record) + 1)
    begin = int(np.argmin(lengths))
    part = record[begin : begin + int(lengths[begin])]
    return float(len(part)), float(abs(part.sum()) / np.abs(part).sum())
