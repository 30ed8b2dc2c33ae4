"""Frequency lines that resolve a plant's poles and zeros, and responses on many lines."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from updyn.control.plant import Plant
from updyn.control.servo.state_space import StateSpace, Transfer
from updyn.control.servo.state_space import channel_zeros as zeros_of

__all__ = ["channel_zeros", "dense_lines", "sweep"]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]

#: Offsets of lines around a resonance, in half widths; a coarse set for smoother curves.
_FINE = np.array([0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.5, 7.0, 11.0, 20.0])
_COARSE = np.array([0.5, 1.0, 2.0, 5.0])
#: Relative distance within which lines are merged.
_MERGE_DISTANCE = 1e-10
#: Smallest damping ratio that is resolved.
_SHARPEST = 1e-9
#: Largest damping ratio of a resonance; the lines of each decade resolve the others.
_DAMPED = 0.3
_PER_DECADE = 60


def sweep(plant: Plant, freq: _Real) -> _Complex:
    """Return the response of a plant at many lines in Hz (none on a pole), by one Schur form."""
    s = 2j * np.pi * freq
    points = s if plant.dt is None else np.exp(s * plant.dt)
    return Transfer.of(StateSpace(plant.A, plant.B, plant.C, plant.D)).at(points)


def channel_zeros(plant: Plant, output: int, input: int) -> _Complex:
    """Return the finite zeros of one channel of a continuous plant, in rad/s."""
    B, C = plant.B[:, [input]], plant.C[[output]]
    if not B.any() or not C.any():
        return np.zeros(0, dtype=np.complex128)
    return zeros_of(StateSpace(plant.A, B, C, plant.D[[output]][:, [input]]))


def dense_lines(
    sharp: Iterable[_Complex],
    others: Iterable[_Complex],
    low: float,
    high: float,
    per_decade: int = _PER_DECADE,
) -> _Real:
    """Return ascending lines in Hz that resolve poles and zeros in rad/s, `sharp` ones finely."""
    count = int(np.ceil(np.log10(high / low) * per_decade)) + 1
    lines = [np.geomspace(low, high, max(count, 2))]
    for roots, offsets in ((sharp, _FINE), (others, _COARSE)):
        for some in roots:
            lines.append(_lines_around(some, offsets))
    every = np.sort(np.concatenate(lines))
    every = every[(every >= low) & (every <= high)]
    kept = np.concatenate([[True], np.diff(np.log(every)) > _MERGE_DISTANCE])
    return np.asarray(every[kept])


def _lines_around(roots: _Complex, offsets: _Real) -> _Real:
    size = np.abs(roots)
    is_relevant = (roots.imag > 0) & (size > 0) & (np.abs(roots.real) < _DAMPED * size)
    size, damping = (
        size[is_relevant],
        np.maximum(np.abs(roots.real[is_relevant]) / size[is_relevant], _SHARPEST),
    )
    steps = np.concatenate([-offsets[::-1], [0.0], offsets])
    lines = size[:, None] * (1.0 + damping[:, None] * steps) / (2 * np.pi)
    # The peak of a damped resonance lies a little below |s|.
    top = np.sqrt(np.maximum(size**2 - 2 * roots.real[is_relevant] ** 2, 0.0)) / (2 * np.pi)
    return np.asarray(
        np.concatenate([lines.ravel(), top, np.abs(roots.imag[is_relevant]) / (2 * np.pi)])
    )
