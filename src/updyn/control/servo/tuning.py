"""Sizes of a controller by rule, from the rigid-body inertia of the plant."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from updyn.control.plant import Plant
from updyn.control.servo.controller import Controller
from updyn.control.servo.loops import Cascade, Wiring
from updyn.errors import ModelError, OptionError
from updyn.group import is_number

if TYPE_CHECKING:
    from updyn.control.family import PlantFamily

__all__ = ["inertia_of", "tuned"]

#: Poles nearer to 0 than this share of the lowest oscillation are as good as at 0; smaller ones
#: oscillate by rounding.
_AT_REST = 1e-3
#: Points on a circle about the slow poles, the ratio of the poles on either side of it that leaves
#: room for it, and the least share of the mobility there that the slow poles have if something
#: turns freely.
_POINTS, _ROOM, _DOMINANT = 256, 1.5, 0.5


def inertia_of(plant: Plant, torque: str, velocity: str) -> float | None:
    """Return the rigid-body inertia from a torque to a velocity.

    Its reciprocal is the sum of the residues of the mobility at the slow poles: that at 0 of a body
    that turns freely, that at -c / J of one with bearing friction c. It is taken from an integral
    on a circle about them.

    Parameters
    ----------
    plant : Plant
        The plant, continuous.
    torque, velocity : str
        Names of input and output; a displacement is differentiated.

    Returns
    -------
    float or None
        In kg m2 (kg), negative where a positive torque turns the output the negative way; None
        where nothing turns freely.
    """
    cascade = Cascade(
        plant,
        Controller(1.0, low_pass=1.0),
        Wiring.of(plant, Controller(1.0), torque, velocity, *[None] * 3),
    )
    best, share = None, _DOMINANT
    for radius in _radii(plant.poles):
        points = radius * np.exp(2j * np.pi * (np.arange(_POINTS) + 0.5) / _POINTS)
        mobility = points * cascade.motion(points)[:, 0, 0]
        residue = float(mobility.mean().real)
        own = abs(residue) / float(np.abs(mobility).mean())
        if own > share:
            best, share = 1.0 / residue, own
    return best


def _radii(poles: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Return radii of circles in the gaps below the first oscillation, in rad/s."""
    size = np.abs(poles)
    moving = size > 1e-6 * size.max(initial=0.0)
    oscillating = size[moving & (np.abs(poles.imag) > 0.1 * size)]
    first = (
        float(oscillating.min())
        if len(oscillating)
        else 10.0 * float(size[moving].max(initial=1.0))
    )
    low = _AT_REST * first
    steps = np.unique(np.concatenate([[low], np.clip(size[size <= first], low, None), [first]]))
    wide = steps[1:] > _ROOM * steps[:-1]
    return np.asarray(np.sqrt(steps[1:] * steps[:-1])[wide])


def tuned(
    plant: Plant | PlantFamily,
    crossover: float,
    *,
    torque: str,
    velocity: str,
    ti_ratio: float | None = 2.0,
    kv_ratio: float | None = 4.0,
    **others: object,
) -> Controller:
    """Return a controller sized by rule; see `Controller.tuned`."""
    for name, value, where in (
        ("crossover", crossover, "in Hz"),
        ("ti_ratio", ti_ratio, ""),
        ("kv_ratio", kv_ratio, ""),
    ):
        if value is None and name != "crossover":
            continue
        if value is None or not is_number(value) or not 0 < value < np.inf:
            raise OptionError(
                f"{name} is {value!r}; expected a number above 0{', ' + where if where else ''}"
            )
    nominal = plant if isinstance(plant, Plant) else plant.nominal
    inertia = inertia_of(nominal, torque, velocity)
    if inertia is None:
        raise ModelError(
            f"the plant has no rigid-body motion from {torque!r} to {velocity!r}, of whose inertia"
            " the gain is to be sized; give kp, ti and kv by hand"
        )
    if inertia < 0:
        raise ModelError(
            f"a positive torque at {torque!r} turns {velocity!r} the negative way (inertia"
            f" {inertia:.4g}); turn one of the two ports round (a minus sign in its label or"
            " weights)"
        )
    w = 2.0 * np.pi * crossover
    gains = {
        "ti": None if ti_ratio is None else ti_ratio / w,
        "kv": None if kv_ratio is None else w / kv_ratio,
    }
    for name, value in gains.items():
        others.setdefault(name, value)
    return Controller(kp=inertia * w, **others)  # type: ignore[arg-type]
