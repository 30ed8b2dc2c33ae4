"""Every format that holds a model: written, read, measured with other values, and these found again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import updyn
from updyn.demos import chain
from updyn.io.formats import FORMATS, Format

pytestmark = pytest.mark.kernels

HOLDING = [f for f in FORMATS.values() if {"read_model", "write_model"} <= set(f.can)]
FACTORS = {"part1": 0.8, "part2": 1.2, "part3": 0.9, "part4": 1.25}


@pytest.mark.parametrize("known", HOLDING, ids=lambda f: f.name)
def test_stiffness_and_mass_of_every_group_are_found(known: Format, tmp_path: Path) -> None:
    plain = {name: updyn.Group(g.stiffness, g.mass) for name, g in chain.build().groups.items()}
    path = tmp_path / f"chain{known.suffixes[0]}"
    if known.name == "mtx":
        path = path.with_suffix(".toml")
    updyn.write_model(updyn.Model.from_groups(plain, chain.build().dofs), path, format=known.name)
    written = path if path.is_file() else next(tmp_path.glob("*.toml"))
    model = updyn.read_model(written, format=known.name if written == path else None)
    assert set(model.groups) == set(plain)
    for name, group in plain.items():
        for what in ("stiffness", "mass"):
            a, b = (getattr(g, what).toarray() for g in (model.group(name), group))
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * np.abs(b).max())
    changes = {
        name: {"stiffness": k, "mass": 2.0 - k, "loss_factor": 0.02} for name, k in FACTORS.items()
    }
    truth = model.scaled(changes)
    frf = updyn.response(
        truth, np.linspace(0.7, 22.0, 50), ["2:X", "5:X", "10:X", "12:X"], ["2:X", "12:X"]
    )
    unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    result = updyn.update(model, frf, unknowns)
    assert result.ok, result.summary()
    for name, change in changes.items():
        for quantity, value in change.items():
            assert result.values[f"{name}.{quantity}"] == pytest.approx(value, rel=1e-6)
