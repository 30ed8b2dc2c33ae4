"""How far the members of a family lie from its nominal plant, on lines that miss no resonance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from updyn.control.family import PlantFamily
from updyn.control.lines import channel_zeros, dense_lines, sweep
from updyn.control.plant import Plant
from updyn.control.weight_fit import Bound
from updyn.errors import ModelError

__all__ = [
    "channels_of",
    "closest",
    "family_lines",
    "floors_of",
    "radius_of",
    "refuse_unbounded",
    "refuse_undamped",
]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]

#: Of poles and zeros that count as undamped: share of the real part.
_UNDAMPED = 1e-9
#: Lines reach so far below the slowest and above the fastest of band, poles and zeros.
_BEYOND = 10.0
#: Slower than this share of the fastest pole is 0, where rounding leaves a double pole.
_STILL = 1e-6
#: Lines that are added about a place divide the gaps beside it by so many.
_ZOOM = 8
#: Places that are looked at once.
_LOOKED = 40


def _name(number: int) -> str:
    return "the nominal plant" if number == 0 else f"member {number - 1}"


def refuse_undamped(roots: list[_Complex]) -> None:
    """Refuse plants with poles on the imaginary axis, but for those at 0, or to the right of it.

    Parameters
    ----------
    roots : list of ndarray of complex
        Poles in rad/s, the nominal plant's first.

    Raises
    ------
    ModelError
        See above; the message names the plant.
    """
    for number, poles in enumerate(roots):
        size = np.abs(poles)
        moving = size > _STILL * max(float(size.max(initial=0.0)), np.finfo(float).tiny)
        if (poles.real[moving] > _UNDAMPED * size[moving]).any():
            raise ModelError(
                f"{_name(number)} has a pole in the right half plane: a bound on the distance is"
                " not enough to tell stability then"
            )
        bad = np.flatnonzero(moving & (np.abs(poles.real) <= _UNDAMPED * size))
        if bad.size:
            raise ModelError(
                f"{_name(number)} has an undamped resonance at {size[bad[0]] / (2 * np.pi):.6g} Hz,"
                " where the distance to it has no bound; give the model damping"
            )


def family_lines(family: PlantFamily, poles: list[_Complex]) -> _Real:
    """Return lines in Hz, shape (n_f,), dense about the poles and zeros of all plants."""
    plants = (family.nominal, *family.members)
    fastest = max(float(np.abs(p).max(initial=0.0)) for p in poles)
    high = max(2 * np.pi * family.nominal.band[1], fastest)
    still = _STILL * high
    zeros = [[_finite(p, i, j, still, high) for i, j in channels_of(family)] for p in plants]
    moving = [p[np.abs(p) > still] for p in poles]
    slowest = min([float(np.abs(p).min()) for p in moving if p.size] + [high])
    slowest = min([slowest] + [2 * np.pi * f for f in family.nominal.band[:1] if f > 0])
    sharp = [*moving, *zeros[0]]
    others = [z for one in zeros[1:] for z in one]
    return dense_lines(sharp, others, slowest / (2 * np.pi * _BEYOND), high * _BEYOND / (2 * np.pi))


def channels_of(family: PlantFamily) -> list[tuple[int, int]]:
    """Return the positions of output and input of every channel."""
    return [(i, j) for i in range(len(family.outputs)) for j in range(len(family.inputs))]


def _finite(plant: Plant, i: int, j: int, low: float, high: float) -> _Complex:
    zeros = channel_zeros(plant, i, j)
    size = np.abs(zeros)
    return np.asarray(zeros[(size > low) & (size < _BEYOND * high)])


def radius_of(family: PlantFamily, lines: _Real, kind: str) -> _Real:
    """Return l, shape (n_f, n_y, n_u)."""
    G = sweep(family.nominal, lines)
    largest = np.zeros(G.shape)
    for member in family.members:
        np.maximum(largest, np.abs(sweep(member, lines) - G), out=largest)
    if kind == "additive":
        return largest
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(largest > 0.0, largest / np.abs(G), 0.0)


def refuse_unbounded(family: PlantFamily, lines: _Real, radius: _Real, kind: str) -> None:
    """Refuse a radius without bound: zeros of the nominal plant on the imaginary axis that others do not have.

    Raises
    ------
    ModelError
        See above; the message names channel and frequency.
    """
    if np.isfinite(radius).all() and kind == "additive":
        return
    for i, j in channels_of(family):
        zeros = channel_zeros(family.nominal, i, j)
        size = np.abs(zeros)
        inside = (size > 2 * np.pi * lines[0]) & (size < 2 * np.pi * lines[-1])
        bad = size[inside & (np.abs(zeros.real) <= _UNDAMPED * size)] / (2 * np.pi)
        for f in bad:
            if radius_of(family, np.array([f * (1 + 1e-9)]), kind)[0, i, j] > 1e3:
                raise ModelError(
                    f"{family.outputs[i]} / {family.inputs[j]}: the nominal plant has an undamped"
                    f" antiresonance at {f:.6g} Hz, where the multiplicative radius has no bound;"
                    " use kind='additive'"
                )
        if not np.isfinite(radius[:, i, j]).all():
            at = lines[np.flatnonzero(~np.isfinite(radius[:, i, j]))[0]]
            raise ModelError(
                f"{family.outputs[i]} / {family.inputs[j]}: the nominal plant does not answer at"
                f" {at:.6g} Hz while members do: the multiplicative radius has no bound; use"
                " kind='additive'"
            )


def floors_of(family: PlantFamily, radius: _Real, kind: str, floor: float | None) -> _Real:
    """Return the floor of each channel; 0 where the members are the nominal plant."""
    peak = radius.max(axis=0)
    plain = (
        np.full(peak.shape, family.nominal.tolerance) if kind == "multiplicative" else 1e-3 * peak
    )
    return np.where(peak > 0.0, plain if floor is None else floor, 0.0)


def closest(
    lines: _Real, radius: _Real, floors: _Real, bounds: dict[tuple[int, int], Bound], within: float
) -> _Real:
    """Return lines between those there are, where a weight comes closest to what it bounds.

    Parameters
    ----------
    lines : ndarray of float, shape (n_f,)
        In Hz.
    radius, floors, bounds
        What is bounded, from where on, and by what.
    within : float
        How near to the closest place others are looked at, in log |W|.

    Returns
    -------
    ndarray of float
        In Hz.
    """
    more: list[_Real] = []
    for (i, j), bound in bounds.items():
        level = np.maximum(radius[:, i, j], floors[i, j])
        close = np.log(level) - bound.log_magnitude(2 * np.pi * lines)
        inner = np.flatnonzero((close[1:-1] >= close[:-2]) & (close[1:-1] >= close[2:])) + 1
        inner = inner[close[inner] > close.max() - within]
        for k in inner[np.argsort(-close[inner], kind="stable")[:_LOOKED]]:
            more.append(np.linspace(lines[k - 1], lines[k], _ZOOM + 1)[1:-1])
            more.append(np.linspace(lines[k], lines[k + 1], _ZOOM + 1)[1:-1])
    return np.setdiff1d(np.concatenate(more), lines) if more else np.zeros(0)
