"""Measured functions for the identification of modes, and windows of their lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, IndexArray, RealArray
from updyn.errors import DataError
from updyn.frf import FRF
from updyn.modal.axis import Axis
from updyn.modal.envelope import Envelope
from updyn.modal.refine import LineWindow
from updyn.modal.settings import MODE_WINDOW

__all__ = ["Measured", "group_overlapping"]


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Measured accelerances, divided by the rms of their unit."""

    axis: Axis
    freq: RealArray  # shape (n_f,)
    x: ComplexArray  # shape (n_f,)
    cube: ComplexArray  # shape (n_f, n_i, n_j)
    level: RealArray  # shape (n_i, n_j): divisor of the functions
    envelope: Envelope

    @classmethod
    def of(cls, frf: FRF, *, mirrored: bool) -> Measured:
        """Return the functions of an FRF; `mirrored` states viscous damping (`Axis`)."""
        moving = frf.freq > 0.0
        freq = frf.freq[moving]
        if len(freq) < MODE_WINDOW.least_lines:
            raise DataError(
                f"modes: {len(freq)} {'line is' if len(freq) == 1 else 'lines are'} too few to"
                " identify a mode; expected at least"
                f" {MODE_WINDOW.least_lines}, better 30"
            )
        omega = 2.0 * np.pi * freq
        values = frf.values[moving] * ((1j * omega) ** (2 - frf.modal_power))[:, None, None]
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
    def runs(self) -> tuple[IndexArray, IndexArray]:
        """Number of the response and of the reference of each channel."""
        rows, columns = np.indices(self.level.shape)
        return rows.reshape(-1), columns.reshape(-1)

    @property
    def spacing(self) -> float:
        """Median distance of the lines in Hz."""
        return float(np.median(np.diff(self.freq)))

    def lines_of(self, poles: ComplexArray) -> slice:
        """Return the lines of a window around some poles."""
        f, reach = self.axis.frequency(poles), MODE_WINDOW.bandwidths_beyond * self.bandwidth(poles)
        first, last = np.searchsorted(self.freq, [np.min(f - reach), np.max(f + reach)])
        least = MODE_WINDOW.fewest_window_lines + MODE_WINDOW.lines_per_mode * len(poles)
        few = max(0, least - (last - first)) // 2
        return slice(int(max(0, first - few - 1)), int(min(len(self.freq), last + few + 1)))

    def window(
        self, lines: slice, others: ComplexArray, residues: ComplexArray | None = None
    ) -> LineWindow:
        """Return a window of some lines with nearby poles of other modes fixed.

        If residues of the others are given, shape (m, p), distant contributions are subtracted.
        """
        freq = self.freq[lines]
        frequency = self.axis.frequency(others)
        beyond = np.maximum(freq[0] - frequency, frequency - freq[-1])
        order = np.argsort(beyond, kind="stable")[: len(freq) // MODE_WINDOW.lines_per_fixed_pole]
        near = order[beyond[order] < freq[-1] - freq[0]]
        x, Y = self.x[lines], self.cube[lines].reshape(len(freq), -1).T
        if residues is None:
            return LineWindow(self.axis.basis, x, Y, others[near], envelope=self.envelope)
        far = np.delete(np.arange(len(others)), near)
        subtracted = self._part(x, others[far], residues[far]).T
        return LineWindow(
            self.axis.basis, x, Y - subtracted, others[near], subtracted, self.envelope
        )

    def _part(self, x: ComplexArray, poles: ComplexArray, residues: ComplexArray) -> ComplexArray:
        """Return the contribution of some modes to the functions, shape (n, p)."""
        part = (1.0 / (x[:, None] - poles)) @ residues
        if self.axis.mirrored:
            part = part + (1.0 / (x[:, None] - poles.conj())) @ residues.conj()
        return np.asarray(part)

    def bandwidth(self, poles: ComplexArray) -> RealArray:
        """Return the half-power bandwidths in Hz."""
        loss = np.clip(self.axis.loss(poles), 0.0, MODE_WINDOW.largest_loss_factor)
        return np.asarray(self.axis.frequency(poles) * loss)

    def is_inside(self, poles: ComplexArray) -> BoolArray:
        """Return which poles may be modes within the band."""
        frequency, loss = self.axis.frequency(poles), self.axis.loss(poles)
        within = (frequency >= self.freq[0]) & (frequency <= self.freq[-1])
        damped = loss > -MODE_WINDOW.damping_rounding
        return np.asarray(within & damped & (loss < MODE_WINDOW.largest_loss_factor))


def group_overlapping(frequency: RealArray, bandwidth: RealArray) -> list[slice]:
    """Return groups of neighbours with overlapping lines, at most a few in each."""
    groups, first = [], 0
    reach = np.maximum.accumulate(frequency + MODE_WINDOW.bandwidths_beyond * bandwidth)
    gap = frequency[1:] - MODE_WINDOW.bandwidths_beyond * bandwidth[1:] - reach[:-1]
    while first < len(frequency):
        ahead = gap[first : first + MODE_WINDOW.most_modes]
        if (ahead > 0.0).any():
            last = first + 1 + int(np.argmax(ahead > 0.0))
        elif len(ahead) < MODE_WINDOW.most_modes:
            last = len(frequency)
        else:
            half = MODE_WINDOW.most_modes // 2
            last = first + 1 + half + int(np.argmax(np.diff(frequency[first + half :])[:half]))
        groups.append(slice(first, last))
        first = last
    return groups
