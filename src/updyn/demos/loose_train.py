"""The gear train of Bao, Wang & Cheng (2010) with a gap in a mesh and friction at the motor.

Sine tests at three torques of the motor (node 5) with 1 % noise and a floor. Unit 2, the mesh of
nodes 2 and 3, has a gap, within which the two parts of the drive are free of each other; Coulomb
friction acts on the motor. The low torque stays in the gap and below the friction, the middle one
crosses the gap at half of the lines, the high one at most. Units without damping in the paper have
a loss factor of 0.03. The start is off by up to 25 %, gap and friction by a factor of 2.5.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from updyn.arrays import RealArray
from updyn.demos import gear_train
from updyn.dynamics.response import response
from updyn.frf import FRF
from updyn.model import Group, Model
from updyn.nonlinear.backlash import Backlash
from updyn.nonlinear.friction import CoulombFriction

__all__ = [
    "LEVELS",
    "MOTOR",
    "SENSORS",
    "lines",
    "measure",
    "open_train",
    "starting_model",
    "true_elements",
    "true_model",
    "true_values",
    "write_inputs",
]

#: Torques of the motor in N m.
LEVELS = (60.0, 300.0, 1500.0)
MOTOR = "5:RZ"
SENSORS = ("1:RZ", "2:RZ", "3:RZ", "6:RZ", "7:RZ")

_MESH = "unit 2"
_GAP, _FRICTION, _TRANSITION = 1e-4, 150.0, 5e-4  # rad, N m, rad/s
_LOSS_FACTOR = 0.03
_RELATIVE, _FLOOR, _SEED = 0.01, 0.001, 2010

#: Start over truth: factors of stiffness, loss factors, and parameters of elements.
_OFF = {
    "unit 1": (0.8, 1.3),
    "unit 3": (1.25, 0.75),
    "unit 4": (0.75, 1.2),
    "unit 5": (1.2, 0.8),
    "unit 6": (0.85, 1.25),
}
_OFF_ELEMENTS = {"mesh.stiffness": 0.75, "mesh.gap": 2.5, "motor.level": 0.4}

_JOB = """\
title = "Gear train with a gap and friction"

[model]
file = "model.h5"
{tests}
[[parameter]]
groups = [{groups}]
quantity = "stiffness"

[[parameter]]
groups = [{groups}]
quantity = "loss_factor"

[[parameter]]
element = "mesh"
quantity = "stiffness"

[[parameter]]
element = "mesh"
quantity = "gap"

[[parameter]]
element = "motor"
quantity = "level"

[method]
noise = {{ relative = {relative:g}, floor = {floor:g} }}
"""


def open_train() -> tuple[Model, float, Mapping[str, float]]:
    """Return the train without the stiffness of its mesh, this stiffness, and the twist.

    The twist of the mesh is counted at node 3, whose weight is 1.
    """
    train = gear_train.true_model()
    undamped = [name for name, group in train.groups.items() if not group.loss_factor]
    train = train.scaled({name: {"loss_factor": _LOSS_FACTOR} for name in undamped})
    mesh = train.groups[_MESH]
    assert mesh.stiffness is not None
    K = mesh.stiffness.toarray()
    a, b = (list(train.dofs.labels).index(label) for label in ("2:RZ", "3:RZ"))
    k = float(K[b, b])
    groups = {**train.groups, _MESH: Group(mass=mesh.mass)}
    return replace(train, groups=groups), k, {"2:RZ": float(K[a, b]) / k, "3:RZ": 1.0}


def true_model() -> Model:
    """Return the gear train with its gap and friction."""
    train, k, twist = open_train()
    friction = CoulombFriction(_FRICTION, transition=_TRANSITION)
    return train.with_elements({"mesh": (Backlash(k, _GAP), twist)}).with_elements(
        {"motor": (friction, [MOTOR])}
    )


def starting_model() -> Model:
    """Return the model before the update."""
    true = true_model()
    changes = {
        name: {"stiffness": k, "loss_factor": eta * true.groups[name].loss_factor}
        for name, (k, eta) in _OFF.items()
    }
    k, gap, friction = true_elements().values()
    off_k, off_gap, off_friction = _OFF_ELEMENTS.values()
    values = {
        "mesh": {"stiffness": off_k * k, "gap": off_gap * gap},
        "motor": {"level": off_friction * friction},
    }
    return true.scaled({**changes, **values})


def true_elements() -> dict[str, float]:
    """Return the true parameters of the elements that are unknown."""
    _, k, _ = open_train()
    return {"mesh.stiffness": k, "mesh.gap": _GAP, "motor.level": _FRICTION}


def true_values() -> dict[str, float]:
    """Return the true values of the 13 unknowns by name: stiffnesses as factors on the start."""
    true = true_model()
    out = {f"{name}.stiffness": 1.0 / k for name, (k, _) in _OFF.items()}
    out |= {f"{name}.loss_factor": float(true.groups[name].loss_factor) for name in _OFF}
    return out | true_elements()


def lines() -> RealArray:
    """Return the lines of the tests in Hz, shape (160,)."""
    return np.geomspace(14.0, 450.0, 160) / (2.0 * np.pi)


def measure(level: float, rng: np.random.Generator) -> FRF:
    """Return the receptances at a torque of the motor, with noise."""
    frf = response(true_model(), lines(), SENSORS, [MOTOR], level=level).frf
    floor = _FLOOR**2 * np.mean(np.abs(frf.values) ** 2)
    size = np.sqrt((_RELATIVE * np.abs(frf.values)) ** 2 + floor)
    noise = rng.standard_normal((2, *frf.values.shape)) / np.sqrt(2.0)
    return replace(frf, values=frf.values + size * (noise[0] + 1j * noise[1]))


def write_inputs(folder: Path) -> Path:
    """Write the start, the tests at all levels and the job; return the path of the job."""
    from updyn.io import write_frf, write_model

    write_model(starting_model(), folder / "model.h5")
    rng, tests = np.random.default_rng(_SEED), ""
    for level in LEVELS:
        write_frf(measure(level, rng), folder / f"torque-{level:g}.npz")
        tests += f'\n[[test]]\nname = "{level:g} N m"\nfile = "torque-{level:g}.npz"\n'
    groups = ", ".join(f'"{name}"' for name in _OFF)
    path = folder / "job.toml"
    text = _JOB.format(tests=tests, groups=groups, relative=_RELATIVE, floor=_FLOOR)
    path.write_text(text, encoding="utf-8")
    return path
