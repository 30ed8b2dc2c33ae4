"""Measured functions for the identification of modes, and windows of their lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.errors import DataError
from updyn.frf import FRF, QUANTITIES
from updyn.modal.axis import Axis
from updyn.modal.envelope import Envelope
from updyn.modal.refine import LineWindow

__all__ = ["Measured", "group_overlapping"]

_Complex = NDArray[np.complex128]
_Real = NDArray[np.float64]

#: Largest number of modes in a window, and its extent beyond them in half-power bandwidths and
#: lines.
_TOGETHER, _BEYOND, _LINES = 6, 4.0, 20
#: Largest loss factor of a mode.
_HEAVY = 0.5
#: Smallest number of lines.
_FEWEST = 4
#: Smallest number of lines in a window for each fixed pole.
_LINES_A_POLE = 5
#: Negative damping up to this value is rounding error.
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Measured accelerances, divided by the rms of their unit."""

    axis: Axis
    freq: _Real  # shape (n_f,)
    x: _Complex  # shape (n_f,)
    cube: _Complex  # shape (n_f, n_i, n_j)
    level: _Real  # shape (n_i, n_j): divisor of the functions
    envelope: Envelope

    @classmethod
    def of(cls, frf: FRF, *, mirrored: bool) -> Measured:
        """Return the functions of an FRF; `mirrored` states viscous damping (`Axis`)."""
        moving = frf.freq > 0.0
        freq = frf.freq[moving]
        if len(freq) < _FEWEST:
            raise DataError(
                f"modes: {len(freq)} {'line is' if len(freq) == 1 else 'lines are'} too few to"
                " identify a mode; expected at least"
                f" {_FEWEST}, better 30"
            )
        omega = 2.0 * np.pi * freq
        values = (
            frf.values[moving] * ((1j * omega) ** (2 - QUANTITIES[frf.quantity]))[:, None, None]
        )
        if not np.abs(values).any():
            raise DataError("modes: all values are zero")
        kind = 2 * (frf.responses.axes >= 3)[:, None] + (frf.references.axes >= 3)[None, :]
        level = np.ones(kind.shape)
        for k in np.unique(kind):
            rms = float(np.sqrt(np.mean(np.abs(values[:, kind == k]) ** 2)))
            if rms > 0:
                level[kind == k] = rms
        axis = Axis(mirrored, float(omega[-1]))
        cube = np.asarray(values / level, dtype=np.complex128)
        return cls(axis, freq, axis.at(freq), cube, level, Envelope.of(freq, cube))

    @property
    def runs(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Number of the response and of the reference of each channel."""
        rows, columns = np.indices(self.level.shape)
        return rows.reshape(-1), columns.reshape(-1)

    @property
    def spacing(self) -> float:
        """Median distance of the lines in Hz."""
        return float(np.median(np.diff(self.freq)))

    def lines_of(self, poles: _Complex) -> slice:
        """Return the lines of a window around some poles."""
        f, bandwidth = self.axis.frequency(poles), self.bandwidth(poles)
        first, last = np.searchsorted(
            self.freq, [np.min(f - _BEYOND * bandwidth), np.max(f + _BEYOND * bandwidth)]
        )
        few = max(0, _LINES + 4 * len(poles) - (last - first)) // 2
        return slice(int(max(0, first - few - 1)), int(min(len(self.freq), last + few + 1)))

    def window(
        self, lines: slice, others: _Complex, residues: _Complex | None = None
    ) -> LineWindow:
        """Return a window of some lines with nearby poles of other modes fixed.

        If residues of the others are given, shape (m, p), distant contributions are subtracted.
        """
        freq = self.freq[lines]
        frequency = self.axis.frequency(others)
        beyond = np.maximum(freq[0] - frequency, frequency - freq[-1])
        order = np.argsort(beyond, kind="stable")[: len(freq) // _LINES_A_POLE]
        near = order[beyond[order] < freq[-1] - freq[0]]
        x, Y = self.x[lines], self.cube[lines].reshape(len(freq), -1).T
        if residues is None:
            return LineWindow(self.axis.basis, x, Y, others[near], envelope=self.envelope)
        far = np.delete(np.arange(len(others)), near)
        subtracted = self._part(x, others[far], residues[far]).T
        return LineWindow(
            self.axis.basis, x, Y - subtracted, others[near], subtracted, self.envelope
        )

    def _part(self, x: _Complex, poles: _Complex, residues: _Complex) -> _Complex:
        """Return the contribution of some modes to the functions, shape (n, p)."""
        part = (1.0 / (x[:, None] - poles)) @ residues
        if self.axis.mirrored:
            part = part + (1.0 / (x[:, None] - poles.conj())) @ residues.conj()
        return np.asarray(part)

    def bandwidth(self, poles: _Complex) -> _Real:
        """Return the half-power bandwidths in Hz."""
        return np.asarray(self.axis.frequency(poles) * np.clip(self.axis.loss(poles), 0.0, _HEAVY))

    def is_inside(self, poles: _Complex) -> NDArray[np.bool_]:
        """Return which poles may be modes within the band."""
        frequency, loss = self.axis.frequency(poles), self.axis.loss(poles)
        within = (frequency >= self.freq[0]) & (frequency <= self.freq[-1])
        return np.asarray(within & (loss > -_ROUNDING) & (loss < _HEAVY))


def group_overlapping(frequency: _Real, bandwidth: _Real) -> list[slice]:
    """Return groups of neighbours with overlapping lines, at most a few in each."""
    groups, first = [], 0
    reach = np.maximum.accumulate(frequency + _BEYOND * bandwidth)
    gap = frequency[1:] - _BEYOND * bandwidth[1:] - reach[:-1]
    while first < len(frequency):
        ahead = gap[first : first + _TOGETHER]
        if (ahead > 0.0).any():
            last = first + 1 + int(np.argmax(ahead > 0.0))
        elif len(ahead) < _TOGETHER:
            last = len(frequency)
        else:
            half = _TOGETHER // 2
            last = first + 1 + half + int(np.argmax(np.diff(frequency[first + half :])[:half]))
        groups.append(slice(first, last))
        first = last
    return groups
