"""A chain of twelve masses and springs in four groups, with data made from known true values.

The data have 1 % noise from a fixed seed; the update has no access to the true values.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from updyn.dynamics.modes import modes
from updyn.dynamics.response import response
from updyn.frf import FRF
from updyn.model import Group, Model

if TYPE_CHECKING:
    from updyn.updating.result import UpdateResult

__all__ = ["TRUTH", "build", "epilogue", "headline", "measure", "write_inputs"]

_STIFFNESS = (10e3, 12e3, 14e3, 11e3, 13e3, 10e3, 12e3, 14e3, 11e3, 13e3, 10e3, 12e3)  # N/m
_MASS = 1.0  # kg, each
_LOSS_FACTOR = 0.03
_SENSORS = ("2:X", "5:X", "7:X", "10:X", "12:X")
_HAMMER = ("2:X", "12:X")
_NOISE = 0.01
_SEED = 2010

#: True values: factors on stiffness and mass, and loss factors.
TRUTH = {
    "part1": {"mass": 1.10, "stiffness": 0.80, "loss_factor": 0.02},
    "part2": {"mass": 0.90, "stiffness": 1.20, "loss_factor": 0.05},
    "part3": {"mass": 1.15, "stiffness": 0.90, "loss_factor": 0.03},
    "part4": {"mass": 0.85, "stiffness": 1.25, "loss_factor": 0.04},
}

_JOB = """\
title = "Chain of twelve masses"

[model]
file = "chain.h5"

[test]
file = "chain.uff"

[[parameter]]
groups = "part*"
quantity = "mass"
bounds = [0.3, 3.0]

[[parameter]]
groups = "part*"
quantity = "stiffness"
bounds = [0.3, 3.0]

[[parameter]]
groups = "part*"
quantity = "loss_factor"
bounds = [0.0, 0.3]

[method]
name = "maximum-likelihood"
validation = ["7:X"]
"""


def build() -> Model:
    """Return the chain before the update: fixed - k1 - m1 - ... - k12 - m12, in groups of three."""
    groups = {}
    for number in range(4):
        K = np.zeros((12, 12))
        M = np.zeros((12, 12))
        for i in range(3 * number, 3 * number + 3):
            M[i, i] += _MASS
            K[i, i] += _STIFFNESS[i]
            if i > 0:
                K[i - 1, i - 1] += _STIFFNESS[i]
                K[i - 1, i] -= _STIFFNESS[i]
                K[i, i - 1] -= _STIFFNESS[i]
        groups[f"part{number + 1}"] = Group(K, M, loss_factor=_LOSS_FACTOR)
    return Model.from_groups(
        groups, [f"{i}:X" for i in range(1, 13)], title="Chain of twelve masses"
    )


def measure() -> FRF:
    """Return the accelerances of the true chain over its first six modes, with noise."""
    true = build().scaled(TRUTH)
    f = modes(true, 6).frequency
    exact = response(
        true, np.linspace(0.3 * f[0], 1.05 * f[5], 60), _SENSORS, _HAMMER, quantity="accelerance"
    )
    rng = np.random.default_rng(_SEED)
    noise = rng.normal(size=(2, *exact.values.shape)) / np.sqrt(2.0)
    values = exact.values * (1.0 + _NOISE * (noise[0] + 1j * noise[1]))
    return FRF(exact.freq, values, _SENSORS, _HAMMER, "accelerance", source="synthetic, 1 % noise")


def write_inputs(folder: Path) -> Path:
    """Write model, measurement and job file; return the path of the job file."""
    from updyn.io import write_frf, write_model

    write_model(build(), folder / "chain.h5")
    write_frf(measure(), folder / "chain.uff")
    job = folder / "job.toml"
    job.write_text(_JOB, encoding="utf-8")
    return job


def headline(results: Sequence[UpdateResult]) -> str:
    """Return the largest deviation from the true values, in standard deviations."""
    result = results[-1]
    off = []
    for p in result.parameters:
        error = result.values[p.name] - TRUTH[p.group][p.quantity]
        off.append(abs(error / result.std[p.name]))
    return (
        f"All {len(off)} unknowns are within {max(off):.1f} standard deviations of the values that"
        " made the data."
    )


def epilogue(results: Sequence[UpdateResult], folder: Path) -> str:
    """Compare the results with the true values."""
    lines = [f"{'unknown':<18} {'true':>6} {'found':>10} {'std':>8} {'error / std':>12}"]
    result = results[-1]
    for p in result.parameters:
        true = TRUTH[p.group][p.quantity]
        value = result.values[p.name]
        std = result.std[p.name]
        error = (value - true) / std
        lines.append(f"{p.name:<18} {true:>6g} {value:>10.5g} {std:>8.2g} {error:>+12.1f}")
    return "Against the values that made the data:\n" + "\n".join(lines)
