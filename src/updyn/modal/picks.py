"""Poles picked by the user: refined with the others, and rejected if they are not modes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from updyn.arrays import BoolArray, ComplexArray
from updyn.errors import DataError
from updyn.group import is_number
from updyn.modal.fits import WeightedFit
from updyn.modal.measured import Measured
from updyn.modal.settings import CHANNEL_FIT, POLE_PICK
from updyn.modal.settle import collect_poles, fit_all_windows
from updyn.modal.stabilisation import Diagram

__all__ = ["add_picks", "check_picks", "start_pole_at"]


def check_picks(poles: Sequence[float]) -> list[float]:
    """Return the frequencies in Hz of poles picked by the user."""
    for frequency in poles:
        if not is_number(frequency) or not 0.0 < frequency < np.inf:
            raise DataError(f"poles: expected frequencies in Hz above 0, found {frequency!r}")
    return [float(frequency) for frequency in poles]


def start_pole_at(
    measured: Measured, diagram: Diagram, others: ComplexArray, frequency: float
) -> complex:
    """Return the initial pole of a pick at a frequency in Hz.

    It is the stable pole of largest order there, else one with the median loss factor of `others`,
    the poles of the fits, but at least a width of one line.
    """
    low, high = float(measured.freq[0]), float(measured.freq[-1])
    if not low <= frequency <= high:
        raise DataError(
            f"poles: {frequency:.6g} Hz is not within the band, {low:.6g} to {high:.6g} Hz"
        )
    axis, stable = measured.axis, np.flatnonzero(diagram.stable)
    off = np.abs(diagram.frequency[stable] / frequency - 1.0)
    if off.min(initial=np.inf) > POLE_PICK.diagram_distance:
        line = measured.spacing / frequency
        loss = max(float(np.median(axis.loss(others))) if len(others) else line, line)
        return complex(axis.pole(np.array([frequency]), loss)[0])
    nearby = stable[off <= off.min() + POLE_PICK.diagram_distance]
    best = nearby[np.argmax(diagram.order[nearby])]
    size, ratio = 2.0 * np.pi * diagram.frequency[best], diagram.damping[best]
    s = complex(-size * ratio, size * np.sqrt(1.0 - ratio**2))
    return complex(axis.poles(np.array([s]))[0])


def add_picks(
    measured: Measured, fits: list[WeightedFit], begin: ComplexArray, shown: ComplexArray
) -> list[WeightedFit]:
    """Return the fits including the picks `begin`; `shown` are the poles that are modes."""
    axis, poles = measured.axis, collect_poles(fits)
    added = np.full(len(poles), -1)
    for number, pole in enumerate(begin):
        at = float(axis.frequency(np.array([pole]))[0])
        of = shown[_find_same(measured, shown, pole)]
        if len(of):
            raise DataError(
                f"modes: the pole at {at:.6g} Hz is that of the mode at"
                f" {axis.frequency(of)[0]:.6g} Hz, which is found without it"
            )
        twice = begin[:number][_find_same(measured, begin[:number], pole)]
        if len(twice):
            raise DataError(
                f"modes: the pole at {at:.6g} Hz is that of another pick, at"
                f" {axis.frequency(twice)[0]:.6g} Hz; leave one"
            )
        # A pole of the fits that is too weak to be a mode by itself.
        hidden = _find_same(measured, poles, pole) & ~np.isin(poles, shown) & (added < 0)
        if hidden.any():
            added[int(np.argmax(hidden))] = number
        else:
            poles, added = np.append(poles, pole), np.append(added, number)
    order = np.argsort(axis.frequency(poles), kind="stable")
    fits = fit_all_windows(measured, poles[order], added[order])
    after, chosen = collect_poles(fits), np.concatenate([fit.added for fit in fits])
    for number, pole in enumerate(begin):
        is_pick = chosen == number
        _check_added(measured, complex(pole), complex(after[is_pick][0]), shown, after[~is_pick])
    return fits


def _find_same(measured: Measured, poles: ComplexArray, pole: complex) -> BoolArray:
    width = np.abs(poles.real if measured.axis.mirrored else poles.imag)
    return np.asarray(np.abs(poles - pole) < POLE_PICK.same_distance * width)


def _check_added(
    measured: Measured, first: complex, last: complex, modes: ComplexArray, others: ComplexArray
) -> None:
    """Raise if the fit moved an added pole, from `first` to `last`, to a mode or away.

    `modes` are the modes without it, `others` the other poles of the fit.
    """
    begin, end = (float(measured.axis.frequency(np.array([p]))[0]) for p in (first, last))
    width = float(np.nanmax(measured.bandwidth(np.array([first, last]))))
    reach = max(width, measured.spacing)
    name = f"modes: the pole at {begin:.6g} Hz, refined,"
    at, other_frequencies = measured.axis.frequency(modes), measured.axis.frequency(others)
    bandwidth = measured.bandwidth(others)
    for mode in at[np.abs(at - end) < reach]:
        if not (np.abs(other_frequencies - mode) < reach).any():
            raise DataError(f"{name} takes the place of the mode at {mode:.6g} Hz")
    near = np.abs(others - last) < POLE_PICK.merged_distance * bandwidth / np.maximum(
        other_frequencies, CHANNEL_FIT.smallest_divisor
    ) * np.abs(others)
    if near.any():
        raise DataError(f"{name} merges with the mode at {other_frequencies[near][0]:.6g} Hz")
    if not measured.is_inside(np.array([last]))[0]:
        raise DataError(f"{name} leaves the band or has no damping that a mode can have")
    if abs(end - begin) > reach:
        raise DataError(f"{name} leaves its place and moves to {end:.6g} Hz")
