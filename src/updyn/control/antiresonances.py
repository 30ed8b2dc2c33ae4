"""Antiresonances of a channel: where they are, how wide, and how far a plant has moved them.

Near a zero close to the imaginary axis a response is H(omega) = c (omega - omega_z - i sigma), of
which omega_z is the frequency and 2 |sigma| the half-power width. At omega_z a plant whose zero is
off by a tenth of the width is off by a fifth of |H|: errors there are shares of the level one width
beside it, and the zero's shift is stated on its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Dip", "ZeroShift", "crossed", "dips", "raised", "resolved", "shifts"]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]

#: A minimum wider than this share of its frequency is no antiresonance.
_WIDE = 0.3
#: One narrower than this share of its frequency counts as so wide.
_NARROW = 1e-2
#: Share of a frequency to which lines are next to each other.
_NEXT = 2.5e-4
#: Least turn of the phase between one width below and one above, in rad; of a single zero 2.2.
_TURN = 1.2
#: Lines about an antiresonance, in half-power widths.
_AROUND = np.array([-2.0, -1.0, -0.6, -0.3, -0.1, 0.0, 0.1, 0.3, 0.6, 1.0, 2.0])
#: Rounds in which antiresonances are located.
_ROUNDS = 4
#: Lines nearer to each other than this share of the highest are one.
_MERGED = 1e-12
#: A zero of a plant this far from one of the structure, as a share, is another one.
_LOST = 0.1


@dataclass(frozen=True, slots=True)
class Dip:
    """An antiresonance of a channel.

    Attributes
    ----------
    frequency : float
        In Hz.
    width : float
        Between its half-power points, in Hz.
    """

    frequency: float
    width: float


@dataclass(frozen=True, slots=True)
class ZeroShift:
    """An antiresonance of the structure, and that of the plant.

    Attributes
    ----------
    output, input : str
        Names of the channel's ports.
    frequency : float
        Of the structure's, in Hz.
    shift : float
        Of the plant's against it, in per cent of the frequency; nan where the plant has none
        within a tenth.
    depth : float
        Of the structure's: height of the lower of the two maxima beside it over the response in
        it, in dB.
    plant_depth : float
        The same of the plant.
    """

    output: str
    input: str
    frequency: float
    shift: float
    depth: float
    plant_depth: float


def dips(freq: _Real, values: _Complex) -> list[Dip]:
    """Return the antiresonances of one channel, from its values at some lines.

    Parameters
    ----------
    freq : ndarray of float, shape (n_f,)
        Lines in Hz, ascending.
    values : ndarray of complex, shape (n_f,)
        The channel.

    Returns
    -------
    list of Dip
        Ascending. At each minimum the response is taken for (a + b f) / (1 + c f) through three
        lines, whose zero is complex.
    """
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
        if near and width <= _WIDE * zero.real:
            out.append(Dip(float(zero.real), float(max(width, _NARROW * zero.real))))
    return out


def crossed(freq: _Real, values: _Complex) -> list[Dip]:
    """Return the antiresonances of one channel at which its phase turns, as it does at a zero.

    Parameters
    ----------
    freq, values
        As for `dips`, with lines that resolve them.
    """
    out = []
    for dip in dips(freq, values):
        ends = dip.frequency - dip.width, dip.frequency + dip.width
        real, imag = np.interp(ends, freq, values.real), np.interp(ends, freq, values.imag)
        turn = np.angle((real[1] + 1j * imag[1]) * (real[0] - 1j * imag[0]))
        if abs(turn) > _TURN:
            out.append(dip)
    return out


def resolved(
    response: Callable[[_Real], _Complex], freq: _Real, values: _Complex
) -> tuple[_Real, _Complex]:
    """Return lines and values with further lines about every antiresonance.

    Parameters
    ----------
    response : callable
        Returns the values at lines in Hz, shape (n_f, n_y, n_u).
    freq : ndarray of float, shape (n_f,)
        Lines to begin with, ascending.
    values : ndarray of complex, shape (n_f, n_y, n_u)
        At these.
    """
    low, high = freq[0], freq[-1]
    for number in range(_ROUNDS):
        steps = _AROUND if number == _ROUNDS - 1 else np.array([-1.0, 0.0, 1.0])
        new: list[_Real] = []
        for i, j in np.ndindex(values.shape[1:]):
            for dip in dips(freq, values[:, i, j]):
                new.append(dip.frequency + dip.width * steps)
        if not new:
            break
        more = np.unique(np.concatenate(new))
        more = more[(more > low) & (more < high)]
        after = np.searchsorted(freq, more).clip(1, len(freq) - 1)
        apart = np.minimum(np.abs(more - freq[after - 1]), np.abs(more - freq[after]))
        more = more[(apart > _MERGED * high) & (np.diff(more, prepend=-1.0) > _MERGED * high)]
        if not len(more):
            break
        both = np.concatenate([freq, more])
        order = np.argsort(both)
        freq, values = both[order], np.concatenate([values, response(more)])[order]
    return freq, values


def raised(freq: _Real, values: _Complex) -> _Real:
    """Return the level of each channel: its size, at antiresonances that one width beside them.

    About a resonance sharper than a loss factor of 0.0005 it is that of the peak.

    Parameters
    ----------
    freq : ndarray of float, shape (n_f,)
        Lines in Hz, ascending, that resolve the antiresonances.
    values : ndarray of complex, shape (n_f, n_y, n_u)
        The response.

    Returns
    -------
    ndarray of float, shape (n_f, n_y, n_u)
    """
    out = _highest(freq, np.abs(values))
    for i, j in np.ndindex(values.shape[1:]):
        size = np.abs(values[:, i, j])
        for dip in crossed(freq, values[:, i, j]):
            ends = dip.frequency - dip.width, dip.frequency + dip.width
            level = float(np.interp(ends, freq, size).min())
            inside = (freq >= ends[0]) & (freq <= ends[1])
            out[inside, i, j] = np.maximum(out[inside, i, j], level)
    return out


def _highest(freq: _Real, size: _Real) -> _Real:
    """Return the largest size next to each line."""
    first = np.searchsorted(freq, freq * (1.0 - _NEXT))
    last = np.searchsorted(freq, freq * (1.0 + _NEXT), side="right")
    return np.stack([size[a:b].max(axis=0) for a, b in zip(first, last, strict=True)])


def shifts(
    freq: _Real, values: _Complex, answer: _Complex, zeros: _Complex
) -> list[tuple[float, float, float, float]]:
    """Return frequency, shift (per cent), depth and the plant's depth (dB) of each antiresonance.

    Parameters
    ----------
    freq : ndarray of float, shape (n_f,)
        Lines in Hz, ascending.
    values : ndarray of complex, shape (n_f,)
        Response of the structure.
    answer : ndarray of complex, shape (n_f,)
        That of the plant.
    zeros : ndarray of complex, shape (n,)
        Of the plant, in rad/s.
    """
    size, own = np.abs(values), np.abs(answer)
    there = np.abs(zeros.imag[zeros.imag > 0]) / (2.0 * np.pi)
    out = []
    for dip in crossed(freq, values):
        shift = np.nan
        if len(there):
            nearest = float(there[np.argmin(np.abs(there - dip.frequency))])
            if abs(nearest - dip.frequency) <= _LOST * dip.frequency:
                shift = 100.0 * (nearest / dip.frequency - 1.0)
        depths = []
        for part in (size, own):
            depths.append(_depth(part, np.abs(freq - dip.frequency) <= dip.width))
        out.append((dip.frequency, shift, depths[0], depths[1]))
    return out


def _depth(size: _Real, inside: NDArray[np.bool_]) -> float:
    """Return how far the minimum of some lines lies below the lower maximum beside it, in dB."""
    at = int(np.argmin(np.where(inside, size, np.inf)))
    tops = []
    for side in (size[: at + 1][::-1], size[at:]):
        falls = np.flatnonzero(np.diff(side) < 0)
        tops.append(float(side[falls[0] if len(falls) else -1]))
    return float(20.0 * np.log10(max(min(tops), 1e-300) / max(float(size[at]), 1e-300)))
