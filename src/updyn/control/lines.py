"""Frequency lines that resolve a plant's poles and zeros, and responses on many lines."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.control.offsets import mirror_offsets
from updyn.control.plant import Plant
from updyn.control.servo.state_space import StateSpace, Transfer
from updyn.control.servo.state_space import channel_zeros as zeros_of
from updyn.control.settings import PLANT_LINES

__all__ = ["channel_zeros", "dense_lines", "sweep"]


def sweep(plant: Plant, freq: RealArray) -> ComplexArray:
    """Return the response of a plant at many lines in Hz (none on a pole), by one Schur form."""
    s = 2j * np.pi * freq
    points = s if plant.dt is None else np.exp(s * plant.dt)
    return Transfer.of(StateSpace(plant.A, plant.B, plant.C, plant.D)).at(points)


def channel_zeros(plant: Plant, output: int, input: int) -> ComplexArray:
    """Return the finite zeros of one channel of a continuous plant, in rad/s."""
    B, C = plant.B[:, [input]], plant.C[[output]]
    if not B.any() or not C.any():
        return np.zeros(0, dtype=np.complex128)
    return zeros_of(StateSpace(plant.A, B, C, plant.D[[output]][:, [input]]))


def dense_lines(
    sharp: Iterable[ComplexArray],
    others: Iterable[ComplexArray],
    low: float,
    high: float,
    per_decade: int | None = None,
) -> RealArray:
    """Return ascending lines in Hz that resolve poles and zeros in rad/s, `sharp` ones finely."""
    per_decade = PLANT_LINES.lines_per_decade if per_decade is None else per_decade
    count = int(np.ceil(np.log10(high / low) * per_decade)) + 1
    lines = [np.geomspace(low, high, max(count, 2))]
    fine = mirror_offsets(PLANT_LINES.fine_offsets)
    coarse = mirror_offsets(PLANT_LINES.coarse_offsets)
    for roots, offsets in ((sharp, fine), (others, coarse)):
        for some in roots:
            lines.append(_lines_around(some, offsets))
    every = np.sort(np.concatenate(lines))
    every = every[(every >= low) & (every <= high)]
    kept = np.concatenate([[True], np.diff(np.log(every)) > PLANT_LINES.merge_distance])
    return np.asarray(every[kept])


def _lines_around(roots: ComplexArray, offsets: RealArray) -> RealArray:
    size = np.abs(roots)
    is_sharp = np.abs(roots.real) < PLANT_LINES.largest_damping * size
    is_relevant = (roots.imag > 0) & (size > 0) & is_sharp
    size, damping = (
        size[is_relevant],
        np.maximum(np.abs(roots.real[is_relevant]) / size[is_relevant], PLANT_LINES.least_damping),
    )
    lines = size[:, None] * (1.0 + damping[:, None] * offsets) / (2 * np.pi)
    # The peak of a damped resonance lies a little below |s|.
    top = np.sqrt(np.maximum(size**2 - 2 * roots.real[is_relevant] ** 2, 0.0)) / (2 * np.pi)
    return np.asarray(
        np.concatenate([lines.ravel(), top, np.abs(roots.imag[is_relevant]) / (2 * np.pi)])
    )
