"""The paper's seven-DOF gear train (Bao, Wang & Cheng 2010, Tables 1-5), as models.

The numbers are in ``data/gear_train.json``. The tables give element matrices of two DOFs each; the
fourth is the inertia of the last disc of a branch, so that masses of neighbours add up.
"""

from __future__ import annotations

import json
import warnings
from importlib import resources
from typing import Any

import numpy as np

from updyn.errors import UpdynWarning
from updyn.model import Group, Model

__all__ = ["READINGS", "starting_model", "table", "true_model", "true_values", "unit_names"]

#: How the paper's "error rates" may be meant; it does not say, and both recover.
READINGS = ("start = true (1 + rate)", "true = start (1 + rate)")


def table() -> dict[str, Any]:
    """Return the paper's numbers."""
    text = (
        resources.files("updyn.demos").joinpath("data/gear_train.json").read_text(encoding="utf-8")
    )
    return dict(json.loads(text))


def unit_names() -> list[str]:
    """Return the names of the six units."""
    return [f"unit {e}" for e in range(1, 7)]


def true_model() -> Model:
    """Return the gear train of Tables 1-3; DOFs ``1:RZ`` to ``7:RZ``, SI units (kg m2, N m/rad)."""
    data = table()
    n = data["dofs"]
    groups = {}
    for e, (name, pair) in enumerate(zip(unit_names(), data["pairs_of_dofs_1_based"], strict=True)):
        at = np.ix_(np.array(pair) - 1, np.array(pair) - 1)
        K, M = np.zeros((n, n)), np.zeros((n, n))
        K[at] = 1e6 * np.array(data["stiffness_units_1e6"][e])
        M[at] = data["mass_units"][e]
        groups[name] = Group(K, M, loss_factor=data["loss_factor"][e])
    with warnings.catch_warnings():
        # K_2 and K_6 are indefinite by the rounding of Table 2 (det K_2 = -3e-4): known, and said
        # in the demo.
        warnings.simplefilter("ignore", UpdynWarning)
        return Model.from_groups(
            groups, [f"{i}:RZ" for i in range(1, n + 1)], title="Gear train, Bao et al. 2010"
        )


def starting_model(reading: int = 0) -> Model:
    """Return the start of Tables 4 and 5, without damping, in one of the two `READINGS`."""
    data = table()
    changes = {}
    for e, name in enumerate(unit_names()):
        kappa = 1.0 + data["stiffness_error_percent_Y"][e] / 100.0
        mu = 1.0 + data["mass_error_percent_X"][e] / 100.0
        if reading == 1:
            kappa, mu = 1.0 / kappa, 1.0 / mu
        changes[name] = {"stiffness": kappa, "mass": mu, "loss_factor": 0.0}
    return true_model().scaled(changes)


def true_values(reading: int = 0) -> dict[str, float]:
    """Return the true values of the 18 unknowns, by name, as `starting_model` of that reading has them."""
    data = table()
    out = {}
    for e, name in enumerate(unit_names()):
        for quantity, rates in (
            ("mass", "mass_error_percent_X"),
            ("stiffness", "stiffness_error_percent_Y"),
        ):
            start = 1.0 + data[rates][e] / 100.0
            out[f"{name}.{quantity}"] = 1.0 / start if reading == 0 else start
        out[f"{name}.loss_factor"] = float(data["loss_factor"][e])
    return out
