"""Gear ratios that may be inverted, judged by natural frequencies with ratio and inverse."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from updyn.arrays import RealArray
from updyn.dynamics.eigen import mass_rank
from updyn.dynamics.modes import modes
from updyn.elements.drivetrain.pieces import Part
from updyn.elements.settings import TRAIN
from updyn.errors import UpdynError
from updyn.model import Model

__all__ = ["inverted_ratios"]

_Band = tuple[float, float]


def inverted_ratios(
    parts: Sequence[Part],
    model: Model,
    build: Callable[[Sequence[Part]], Model],
    band: _Band | None = None,
) -> list[str]:
    """Return a question about each gear ratio whose inverse gives more plausible frequencies.

    A ratio is doubtful if only its inverse has a natural frequency within an octave of `band` in
    Hz; without a band, if more frequencies are plausible with the inverse. Too large trains are
    not examined.
    """
    geared = [at for at, part in enumerate(parts) if part.speeds is not None]
    if not geared:
        return []
    found = _frequencies(model)
    if not _is_doubtful(found, band):
        return []
    out = []
    for at in geared:
        instead = _frequencies_with_inverted(parts, [at], build)
        if _is_better(found, instead, band):
            out.append(_question([parts[at]], found, instead, band))
    if not out and len(geared) > 1:
        instead = _frequencies_with_inverted(parts, geared, build)
        if _is_better(found, instead, band):
            out.append(_question([parts[at] for at in geared], found, instead, band))
    return out


def _frequencies_with_inverted(
    parts: Sequence[Part], which: Sequence[int], build: Callable[[Sequence[Part]], Model]
) -> RealArray:
    """Return the natural frequencies with given ratios inverted; empty if this cannot be built."""
    others = [part.inverted() if at in which else part for at, part in enumerate(parts)]
    try:
        return _frequencies(build(others))
    except UpdynError:  # two paths between the same shafts may have contradicting ratios
        return np.zeros(0)


def _frequencies(model: Model) -> RealArray:
    """Return the natural frequencies in Hz without rigid-body modes; empty if not computed."""
    if model.n_dofs > TRAIN.examined_dofs:
        return np.zeros(0)
    try:
        found = modes(model, mass_rank(model.mass)).frequency
    except UpdynError:
        return np.zeros(0)
    return np.asarray(found[found > 0.0])


def _outside_plausible(found: RealArray) -> RealArray:
    low, high = TRAIN.lowest_frequency, TRAIN.highest_frequency
    return np.asarray(found[(found < low) | (found > high)])


def _near_band(found: RealArray, band: _Band) -> RealArray:
    low, high = band[0] / TRAIN.band_factor, band[1] * TRAIN.band_factor
    return np.asarray(found[(found >= low) & (found <= high)])


def _is_doubtful(found: RealArray, band: _Band | None) -> bool:
    if band is None:
        return len(_outside_plausible(found)) > 0
    return len(found) > 0 and len(_near_band(found, band)) == 0


def _is_better(found: RealArray, instead: RealArray, band: _Band | None) -> bool:
    """Return whether the inverse of a doubtful ratio gives more plausible frequencies."""
    if band is not None:
        return len(_near_band(instead, band)) > 0
    return len(instead) > 0 and len(_outside_plausible(instead)) < len(_outside_plausible(found))


def _question(
    parts: Sequence[Part], found: RealArray, instead: RealArray, band: _Band | None
) -> str:
    names = ", ".join(repr(part.name) for part in parts)
    ask, they = "is the ratio inverted", "its inverse"
    if len(parts) > 1:
        ask, they = "are the ratios inverted", "their inverses"
    meant = []
    for part in parts:
        assert part.speeds is not None
        first, second, ratio = part.speeds
        meant.append(f"node {first} turns {_ratio(ratio)} times as fast as node {second}")
    if band is None:
        low, high = TRAIN.lowest_frequency, TRAIN.highest_frequency
        outside = _format_frequencies(_outside_plausible(found))
        finding = f"the train has natural frequencies outside {low:g} to {high:g} Hz: {outside}"
    else:
        low, high = band
        finding = (
            "no natural frequency of the train lies within an octave of the band of the test,"
            f" {low:g} to {high:g} Hz: {_format_frequencies(found)}"
        )
    return (
        f"{names}: {ask}? As stated, {', '.join(meant)}, and {finding}; with {they} they are"
        f" {_format_frequencies(instead)}"
    )


def _ratio(ratio: float) -> str:
    """Return a ratio as text; as a fraction if below 1."""
    if abs(ratio) >= 1.0:
        return f"{ratio:.6g}"
    return f"{'-' if ratio < 0 else ''}1/{abs(1.0 / ratio):.6g}"


def _format_frequencies(frequencies: RealArray, most: int = 4) -> str:
    shown = ", ".join(f"{f:.5g}" for f in frequencies[:most])
    more = ", ..." if len(frequencies) > most else ""
    return f"{shown}{more} Hz"
