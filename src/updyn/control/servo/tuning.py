"""Sizes of a controller by rule, from the rigid-body inertia of the plant."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from updyn.control.plant import Plant
from updyn.control.servo.controller import Controller
from updyn.control.servo.loops import Cascade, Wiring
from updyn.errors import ModelError, OptionError
from updyn.group import is_number

__all__ = ["inertia_of", "tuned"]

#: Poles below this share of the highest stand at 0 but for rounding; where below the lowest other one, and at how
#: many points, to look.
_AT_REST, _BELOW, _POINTS = 1e-6, 0.03, 6


def inertia_of(plant: Plant, torque: str, velocity: str) -> float | None:
    """Return the rigid-body inertia from a torque to a velocity: the limit of 1 / (s G(s)) as s goes to 0.

    Parameters
    ----------
    plant : Plant
        The plant, continuous.
    torque, velocity : str
        Names of input and output; a displacement is differentiated.

    Returns
    -------
    float or None
        In kg m2 (kg), negative where a positive torque turns the output the negative way; None where nothing turns
        freely.
    """
    cascade = Cascade(
        plant, Controller(1.0, low_pass=1.0), Wiring.of(plant, Controller(1.0), torque, velocity, *[None] * 3)
    )
    poles = np.abs(plant.poles)
    moving = poles[poles > _AT_REST * poles.max(initial=0.0)]
    s = _BELOW * (float(moving.min()) if len(moving) else 1.0)
    points = s * 0.5 ** np.arange(_POINTS, dtype=np.complex128)
    mobility: NDArray[np.float64] = (points * cascade.motion(points)[:, 0, 0]).real  # 1 / J + O(s)
    limit = mobility
    for k in range(1, _POINTS):  # Richardson: without its terms in s, s^2, ...
        limit = (2.0**k * limit[1:] - limit[:-1]) / (2.0**k - 1.0)
    if not limit[0] or abs(mobility[-1] - limit[0]) > 1e-2 * abs(limit[0]):
        return None
    return float(1.0 / limit[0])


def tuned(
    plant: Plant,
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
            raise OptionError(f"{name} is {value!r}; expected a number above 0{', ' + where if where else ''}")
    inertia = inertia_of(plant, torque, velocity)
    if inertia is None:
        raise ModelError(
            f"the plant has no rigid-body motion from {torque!r} to {velocity!r}, of whose inertia the gain is to be "
            "sized; give kp, ti and kv by hand"
        )
    if inertia < 0:
        raise ModelError(
            f"a positive torque at {torque!r} turns {velocity!r} the negative way (inertia {inertia:.4g}); turn one of "
            "the two ports round (a minus sign in its label or weights)"
        )
    w = 2.0 * np.pi * crossover
    gains = {"ti": None if ti_ratio is None else ti_ratio / w, "kv": None if kv_ratio is None else w / kv_ratio}
    for name, value in gains.items():
        others.setdefault(name, value)
    return Controller(kp=inertia * w, **others)  # type: ignore[arg-type]
