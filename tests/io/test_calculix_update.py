"""A whole job on a CalculiX deck: measured on another deck, updated, written back, run again."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import updyn
from deck_samples import DENSITIES, MODULI, NAMES, bar, needs_ccx, own_frequencies
from updyn.cli import main
from updyn.io.calculix import read_model

pytestmark = pytest.mark.kernels

STIFFER, HEAVIER, LOSS = (0.82, 1.31, 1.12), (1.0, 1.15, 0.9), (0.004, 0.012, 0.007)
SENSORS = ["14:Y", "27:Z", "30:Y", "42:Y", "42:Z", "37:X"]


def deck_of_the_real_thing(path: Path) -> None:
    """Write a deck with other moduli, densities and loss factors than the first."""
    text = bar(per_part=3)
    for E, rho, k, m, gamma in zip(MODULI, DENSITIES, STIFFER, HEAVIER, LOSS, strict=True):
        old = f"*ELASTIC\n{E:.10g}, 0.3\n*DENSITY\n{rho:.10g}\n"
        assert old in text
        text = text.replace(
            old,
            f"*ELASTIC\n{E * k:.10g}, 0.3\n*DENSITY\n{rho * m:.10g}\n*DAMPING,"
            f" STRUCTURAL={gamma}\n",
        )
    path.write_text(text)


@needs_ccx
def test_a_deck_is_updated_to_another_and_written_back(tmp_path: Path) -> None:
    deck, real = tmp_path / "bar.inp", tmp_path / "real.inp"
    deck.write_text(bar(per_part=3))
    deck_of_the_real_thing(real)
    lines = np.linspace(60.0, 4200.0, 120)
    frf = updyn.response(read_model(real), lines, SENSORS, ["42:Y", "42:Z"])
    model = read_model(deck)
    unknowns = updyn.parameters(model, stiffness="all", mass=["alu", "BRONZE"], loss_factor="all")
    result = updyn.update(model, frf, unknowns)
    assert result.status == "converged"
    for name, k, m, gamma in zip(NAMES, STIFFER, HEAVIER, LOSS, strict=True):
        # As far as the digits go that ccx prints, and that the numbers of the decks have.
        np.testing.assert_allclose(result.values[f"{name}.stiffness"], k, rtol=1e-6)
        np.testing.assert_allclose(result.values[f"{name}.loss_factor"], gamma, rtol=1e-4)
        if name != "Steel":
            np.testing.assert_allclose(result.values[f"{name}.mass"], m, rtol=1e-6)
    updyn.write_properties(result, deck, tmp_path / "updated.inp")
    text = deck.read_text()
    for name in NAMES:
        text = re.sub(rf"\*MATERIAL, NAME={name}\n\*ELASTIC\n.*\n\*DENSITY\n.*\n", "", text)
    again = tmp_path / "again.inp"
    again.write_text(
        text.replace("*Solid section", "*INCLUDE, INPUT=updated.inp\n*Solid section", 1)
    )
    np.testing.assert_allclose(own_frequencies(again), own_frequencies(real), rtol=1e-6)
    for name, group in read_model(again).groups.items():
        np.testing.assert_allclose(
            group.loss_factor, result.values[f"{name}.loss_factor"], rtol=1e-12
        )


@needs_ccx
def test_a_job_reads_a_deck_in_mm_and_writes_its_properties(tmp_path: Path) -> None:
    """mm, t, s: lengths by 1e3, moduli by 1e-6, densities by 1e-12."""
    (tmp_path / "bar.inp").write_text(bar(unit=(1e3, 1e-6, 1e-12)))
    model = read_model(tmp_path / "bar.inp", unit="mm")
    truth = model.scaled({"Steel": {"stiffness": 0.9}})
    tip = str(model.dofs[model.n_dofs - 2])
    updyn.write_frf(
        updyn.response(truth, np.linspace(60.0, 4200.0, 60), [tip], [tip]), tmp_path / "test.npz"
    )
    job = tmp_path / "job.toml"
    job.write_text(f"""
[model]
file = "bar.inp"
unit = "mm"
[test]
file = "test.npz"
[[parameter]]
groups = "Steel"
quantity = "stiffness"
nominal = {MODULI[NAMES.index("Steel")]}
unit = "Pa"
[method]
starts = 0
[output]
properties = "updated.inp"
report = false
""")
    assert main(["run", str(job), "--out", str(tmp_path / "out")]) == 0
    written = (tmp_path / "out" / "updated.inp").read_text()
    found = re.search(
        r"\*MATERIAL, NAME=Steel\n(?:\*\*.*\n)*\*ELASTIC.*\n([^,\s]+)", written, re.IGNORECASE
    )
    assert found is not None, written
    np.testing.assert_allclose(
        float(found[1]), 0.9 * MODULI[NAMES.index("Steel")] * 1e-6, rtol=1e-6
    )
    assert main(["run", str(tmp_path / "out" / "job.toml"), "--out", str(tmp_path / "again")]) == 0
    assert main(["info", str(tmp_path / "bar.inp"), "--unit", "mm"]) == 0
