"""Antiresonances of a channel: frequency, width, and shift in a plant.

Near a zero, H(omega) = c (omega - omega_z - i sigma) has the half-power width 2 |sigma|. A shift by
a tenth of the width is an error of a fifth of |H| at omega_z. Errors at antiresonances are
therefore shares of the magnitude one width away, and the shift is stated separately.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, RealArray
from updyn.control.offsets import mirror_offsets
from updyn.control.settings import ANTIRESONANCES

__all__ = [
    "Dip",
    "ZeroShift",
    "antiresonance_shifts",
    "fill_antiresonances",
    "find_antiresonances",
    "find_dips",
    "resolve_antiresonances",
]


@dataclass(frozen=True, slots=True)
class Dip:
    """An antiresonance of a channel: frequency and half-power width, in Hz."""

    frequency: float
    width: float


@dataclass(frozen=True, slots=True)
class ZeroShift:
    """An antiresonance of the structure, in Hz, and its relative shift in the plant, in percent.

    The shift is nan if the plant has no zero within a tenth. Depths in dB are the ratio of the
    lower adjacent maximum to the response at the antiresonance, in structure and plant.
    """

    output: str
    input: str
    frequency: float
    shift: float
    depth: float
    plant_depth: float


def find_dips(freq: RealArray, values: ComplexArray) -> list[Dip]:
    """Return the dips of a channel: complex zeros of (a + b f) / (1 + c f) at each minimum."""
    size = np.abs(values)
    low = 1 + np.flatnonzero((size[1:-1] < size[:-2]) & (size[1:-1] <= size[2:]))
    out = []
    for k in low:
        left, right = freq[k - 1] - freq[k], freq[k + 1] - freq[k]
        slopes = (values[k - 1] - values[k]) / left, (values[k + 1] - values[k]) / right
        change = values[k + 1] - values[k - 1]
        b = slopes[0] * change + (slopes[0] - slopes[1]) * values[k - 1]
        if b == 0:
            continue
        zero = freq[k] - values[k] * change / b
        width = 2.0 * abs(zero.imag)
        near = left - width <= zero.real - freq[k] <= right + width
        if near and width <= ANTIRESONANCES.largest_width * zero.real:
            width = max(width, ANTIRESONANCES.least_width * zero.real)
            out.append(Dip(float(zero.real), float(width)))
    return out


def find_antiresonances(freq: RealArray, values: ComplexArray) -> list[Dip]:
    """Return the antiresonances of one channel with the phase change of a zero."""
    out = []
    for dip in find_dips(freq, values):
        ends = dip.frequency - dip.width, dip.frequency + dip.width
        real, imag = np.interp(ends, freq, values.real), np.interp(ends, freq, values.imag)
        turn = np.angle((real[1] + 1j * imag[1]) * (real[0] - 1j * imag[0]))
        if abs(turn) > ANTIRESONANCES.least_turn:
            out.append(dip)
    return out


def resolve_antiresonances(
    response: Callable[[RealArray], ComplexArray], freq: RealArray, values: ComplexArray
) -> tuple[RealArray, ComplexArray]:
    """Return lines in Hz and values, with additional lines around every antiresonance."""
    low, high = freq[0], freq[-1]
    every = mirror_offsets(ANTIRESONANCES.line_offsets)
    for number in range(ANTIRESONANCES.rounds):
        steps = every if number == ANTIRESONANCES.rounds - 1 else np.array([-1.0, 0.0, 1.0])
        new: list[RealArray] = []
        for i, j in np.ndindex(values.shape[1:]):
            for dip in find_dips(freq, values[:, i, j]):
                new.append(dip.frequency + dip.width * steps)
        if not new:
            break
        more = np.unique(np.concatenate(new))
        more = more[(more > low) & (more < high)]
        after = np.searchsorted(freq, more).clip(1, len(freq) - 1)
        apart = np.minimum(np.abs(more - freq[after - 1]), np.abs(more - freq[after]))
        least = ANTIRESONANCES.merge_distance * high
        more = more[(apart > least) & (np.diff(more, prepend=-1.0) > least)]
        if not len(more):
            break
        both = np.concatenate([freq, more])
        order = np.argsort(both)
        freq, values = both[order], np.concatenate([values, response(more)])[order]
    return freq, values


def fill_antiresonances(freq: RealArray, values: ComplexArray) -> RealArray:
    """Return the magnitude of each channel, at antiresonances that one width away.

    Around a resonance sharper than a loss factor of 0.0005 it is that of the peak. The lines must
    resolve the antiresonances.
    """
    out = _highest(freq, np.abs(values))
    for i, j in np.ndindex(values.shape[1:]):
        size = np.abs(values[:, i, j])
        for dip in find_antiresonances(freq, values[:, i, j]):
            ends = dip.frequency - dip.width, dip.frequency + dip.width
            level = float(np.interp(ends, freq, size).min())
            inside = (freq >= ends[0]) & (freq <= ends[1])
            out[inside, i, j] = np.maximum(out[inside, i, j], level)
    return out


def _highest(freq: RealArray, size: RealArray) -> RealArray:
    """Return the largest magnitude of the neighbours of each line."""
    first = np.searchsorted(freq, freq * (1.0 - ANTIRESONANCES.neighbour_distance))
    last = np.searchsorted(freq, freq * (1.0 + ANTIRESONANCES.neighbour_distance), side="right")
    return np.stack([size[a:b].max(axis=0) for a, b in zip(first, last, strict=True)])


def antiresonance_shifts(
    freq: RealArray, values: ComplexArray, answer: ComplexArray, zeros: ComplexArray
) -> list[tuple[float, float, float, float]]:
    """Return frequency, shift (percent), depth and plant depth (dB) of each antiresonance."""
    size, plant_size = np.abs(values), np.abs(answer)
    zero_frequencies = np.abs(zeros.imag[zeros.imag > 0]) / (2.0 * np.pi)
    out = []
    for dip in find_antiresonances(freq, values):
        shift = np.nan
        if len(zero_frequencies):
            nearest = float(zero_frequencies[np.argmin(np.abs(zero_frequencies - dip.frequency))])
            if abs(nearest - dip.frequency) <= ANTIRESONANCES.match_distance * dip.frequency:
                shift = 100.0 * (nearest / dip.frequency - 1.0)
        depths = []
        for part in (size, plant_size):
            depths.append(_depth(part, np.abs(freq - dip.frequency) <= dip.width))
        out.append((dip.frequency, shift, depths[0], depths[1]))
    return out


def _depth(size: RealArray, inside: BoolArray) -> float:
    """Return the ratio of the lower adjacent maximum to the minimum within some lines, in dB."""
    at = int(np.argmin(np.where(inside, size, np.inf)))
    tops = []
    for side in (size[: at + 1][::-1], size[at:]):
        falls = np.flatnonzero(np.diff(side) < 0)
        tops.append(float(side[falls[0] if len(falls) else -1]))
    return float(20.0 * np.log10(max(min(tops), 1e-300) / max(float(size[at]), 1e-300)))
