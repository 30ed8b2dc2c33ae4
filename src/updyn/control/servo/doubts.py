"""Doubts about the gains of a controller: a crossover far below the modes of its plant."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from updyn.control.plant import Plant
from updyn.control.servo.controller import Controller
from updyn.control.servo.record import Loop
from updyn.control.servo.settings import SERVO_VERDICT

__all__ = ["question_crossovers"]


def question_crossovers(
    plant: Plant, controller: Controller, loops: Sequence[Loop], inertia: float | None
) -> tuple[str, ...]:
    """Return a sentence with the likely cause of a crossover that is too low; else nothing.

    The velocity loop is compared with the lowest flexible mode in the band of the plant, or the
    lower end of the band without one; then the position loop with the velocity loop. `inertia` is
    that of the rigid-body motion, None without one.
    """
    inner, *outer = loops
    flexible = plant.modes[plant.rigid :]
    inside = flexible[flexible >= plant.band[0]]
    lowest, name = float(plant.band[0]), "the lower end of the band of the plant"
    if len(inside):
        lowest, name = float(inside[0]), "the lowest mode in the band of the plant"
    found = _describe(inner, lowest, name)
    if found:
        return (f"{found}: {_velocity_cause(controller, inertia, lowest)}.",)
    crossover = inner.margins.crossover
    if outer and inner.margins.stable and crossover is not None:
        found = _describe(outer[0], crossover, "the crossover of the velocity loop")
        if found:
            return (f"{found}: {_position_cause(controller, crossover)}.",)
    return ()


def _describe(loop: Loop, expected: float, name: str) -> str:
    """Return that a crossover in Hz is far below an expected one, as text; empty if it is not."""
    crossover = loop.margins.crossover
    if crossover is None:
        largest = float(np.abs(loop.L).max())
        if largest >= 1.0:
            return ""
        return f"The gain of the {loop.name} loop is at most {largest:.2g}, below 1 everywhere"
    if crossover >= SERVO_VERDICT.questioned_crossover * expected:
        return ""
    return (
        f"The crossover of the {loop.name} loop, {crossover:.2g} Hz, is"
        f" {expected / crossover:.2g} times lower than {name}, {expected:.3g} Hz"
    )


def _velocity_cause(controller: Controller, inertia: float | None, lowest: float) -> str:
    if inertia is not None:
        needed = 2.0 * np.pi * lowest * abs(inertia)
        return (
            f"check the unit of kp = {controller.kp:.3g}, torque over velocity as the ports count"
            f" them (2 pi f J is {needed:.2g} at that frequency)"
        )
    held = "the torque moves no rigid body"
    if controller.ti is None:
        return (
            f"{held} and the controller has no integrator; give ti, or use a model with free rotor"
        )
    return f"{held}; use a model with free rotor"


def _position_cause(controller: Controller, crossover: float) -> str:
    kv = 0.0 if controller.kv is None else controller.kv
    return (
        f"check the unit of kv = {kv:.3g}, 1/s, and the ratio of velocity to position,"
        f" {controller.ratio:.3g} (2 pi f is {2.0 * np.pi * crossover:.2g} at that frequency)"
    )
