"""The demo ``backlash``: a gear train with a gap, identified, and the limit cycle of its loop.

The drive, its tests and the job are those of `updyn.demos.loose_train`. The epilogue predicts the
limit cycle of a position loop over the dish (node 1), with an interval that follows from the
covariance of the unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import cast

from updyn.control.build import plant
from updyn.control.nonlinear.balance import LimitCycles, limit_cycles
from updyn.control.nonlinear.open_element import OpenElement, open_element
from updyn.control.plant import Plant
from updyn.control.ports import Port
from updyn.control.servo.controller import Controller
from updyn.demos.loose_train import MOTOR, true_elements, true_model, true_values, write_inputs
from updyn.model import Model
from updyn.nonlinear.backlash import Backlash
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["CONTROLLER", "epilogue", "headline", "predict_cycles", "write_inputs"]

#: Position loop over the dish around a velocity loop at the motor.
CONTROLLER = Controller(kp=4.5e5, kv=3.0, ratio=-1.88)


def headline(results: Sequence[JointResult]) -> str:
    """Return gap and friction with their errors."""
    result, true = results[-1].first, true_elements()
    text = []
    for name, what, unit in (
        ("mesh.gap", "gap", "rad"),
        ("motor.level", "friction", "N m"),
    ):
        value, std = result.values[name], result.std[name]
        text.append(f"{what} {value:.4g} {unit} +- {std:.2g} (true: {true[name]:g})")
    return f"Identified {' and '.join(text)}."


def epilogue(results: Sequence[JointResult], folder: Path) -> str:
    """Compare the results with the true values."""
    result, true = results[-1].first, true_values()
    rows = [f"{'unknown':<20} {'true':>10} {'found':>10} {'std':>8} {'error / std':>12}"]
    for name, value in true.items():
        found, std = result.values[name], result.std[name]
        rows.append(
            f"{name:<20} {value:>10.5g} {found:>10.5g} {std:>8.2g} {(found - value) / std:>+12.1f}"
        )
    return "\n\n".join(
        ["Against the values that made the data:\n" + "\n".join(rows), _compare_cycles(results[-1])]
    )


def predict_cycles(model: Model | UpdateResult | JointResult, n: int = 0) -> LimitCycles:
    """Return the limit cycles of the position loop, with intervals from n members of an update.

    The friction, which takes energy from a cycle, is left out.
    """
    mesh = open_element(model, "mesh", n=n)
    members = [(_make_plant(one), cast(Backlash, one.element)) for one in mesh.members]
    return limit_cycles(
        _make_plant(mesh),
        CONTROLLER,
        cast(Backlash, mesh.element),
        "gap",
        torque="motor",
        velocity="speed",
        position="dish",
        band=(0.3, 5.0),
        members=members,
    )


def _make_plant(mesh: OpenElement) -> Plant:
    """Return the plant with motor, dish and the open mesh as ports."""
    free = open_element(mesh.model, "motor").model
    return plant(
        free,
        [Port.at(MOTOR, "motor"), mesh.port],
        [Port.at(MOTOR, "speed"), Port.at("1:RZ", "dish"), mesh.port],
        (0.5, 200.0),
        quantity=["mobility", "receptance", "receptance"],
        error="peak",
    )


def _compare_cycles(result: JointResult) -> str:
    """Return the predicted limit cycles and those of the true model as text."""
    found, true = predict_cycles(result, n=40), predict_cycles(true_model())
    lines = ["Limit cycles of a position loop over the dish, from the identified drive:"]
    lines += [f"  {cycle}" for cycle in found]
    return "\n".join([*lines, "From the true drive:", *(f"  {cycle}" for cycle in true)])
