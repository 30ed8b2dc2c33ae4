"""Every method on the paper's gear train: three jobs for ``updyn compare``, with their truth.

``compare.toml`` has all 18 unknowns of the paper and 60 lines. ``compare_stiffness.toml`` takes the
masses as known and a band up to the second resonance: there the method with independently reduced
matrices, which the paper compares its own with, gives an answer, too; with all 18 unknowns it
breaks down. ``compare_full.toml`` has every DOF measured and two forces, as the methods without
condensation need it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from updyn.demos.gear_train_case import table, true_model, true_values, unit_names
from updyn.dynamics.response import response
from updyn.model import Model

__all__ = ["BANDS", "known_masses", "write_comparisons"]

#: Lines of the jobs: first and last in rad/s, and how many, evenly.
BANDS: Mapping[str, tuple[float, float, int]] = {
    "compare": (5.0, 900.0, 60),
    "compare_stiffness": (5.0, 60.0, 30),
    "compare_full": (5.0, 900.0, 30),
}
#: DOF of the second force where there is one.
_SECOND = 5

_JOB = """\
# updyn compare {name}.toml --truth {name}_truth.toml --fewest
title = "Gear train, {what}"

[model]
file = "{model}"

[test]
file = "{name}.uff"

{unknowns}
[method]
name = "equation-error"
"""


def known_masses() -> Model:
    """Return the start of Table 4 with the masses of Table 1, without damping."""
    changes = {}
    for e, name in enumerate(unit_names()):
        changes[name] = {
            "stiffness": 1.0 + table()["stiffness_error_percent_Y"][e] / 100.0,
            "loss_factor": 0.0,
        }
    return true_model().scaled(changes)


def write_comparisons(folder: Path) -> None:
    """Write the jobs with model, measurement and truth.

    Parameters
    ----------
    folder : Path
        Where to; ``model.h5`` is there.
    """
    from updyn.io import write_frf, write_model

    write_model(known_masses(), folder / "known_masses.h5")
    everything = ("mass", "stiffness", "loss_factor")
    jobs = (
        ("compare", "every method, 18 unknowns", "model.h5", everything),
        (
            "compare_stiffness",
            "every method, masses known",
            "known_masses.h5",
            ("stiffness", "loss_factor"),
        ),
        ("compare_full", "every method, every DOF measured", "model.h5", everything),
    )
    for name, what, model, quantities in jobs:
        low, high, count = BANDS[name]
        freq = np.linspace(low, high, count) / (2.0 * np.pi)
        full = name == "compare_full"
        sensors = range(1, table()["dofs"] + 1) if full else table()["measured_dofs"]
        forces = [table()["force_dof"], *([_SECOND] if full else [])]
        test = response(
            true_model(), freq, [f"{i}:RZ" for i in sensors], [f"{i}:RZ" for i in forces]
        )
        write_frf(test, folder / f"{name}.uff")
        unknowns = "".join(
            f'[[parameter]]\ngroups = "all"\nquantity = "{q}"\n\n' for q in quantities
        )
        job = _JOB.format(name=name, what=what, model=model, unknowns=unknowns.rstrip("\n") + "\n")
        (folder / f"{name}.toml").write_text(job, encoding="utf-8")
        truth = {k: v for k, v in true_values().items() if k.rsplit(".", 1)[1] in quantities}
        lines = "".join(f'"{unknown}" = {value!r}\n' for unknown, value in truth.items())
        (folder / f"{name}_truth.toml").write_text(lines, encoding="utf-8")
