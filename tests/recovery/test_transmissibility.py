"""Stiffnesses of a frame on a shaker, from noisy transmissibilities: in Python, by a job, by three tiers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import updyn
from updyn.cli import main
from updyn.errors import OptionError

STOREYS = 5
SENSORS = ["2:X", "3:X", "5:X", "1:X"]
TRUTH = {"storey 2": 1.3, "storey 4": 0.8}
FREQ = np.linspace(3.0, 45.0, 200)


def frame(n: int = STOREYS + 1, n_groups: int = STOREYS, k: float = 2e4) -> updyn.Model:
    """Masses of 1 kg in a row on springs; node 0 is the base."""
    i = np.arange(n - 1)
    groups = {}
    for number, some in enumerate(np.array_split(i, n_groups), 1):
        rows = np.concatenate([some, some + 1, some, some + 1])
        columns = np.concatenate([some, some + 1, some + 1, some])
        values = np.repeat([k, k, -k, -k], len(some))
        stiffness = sp.csr_array((values, (rows, columns)), shape=(n, n))
        groups[f"storey {number}"] = updyn.Group(stiffness, loss_factor=0.02)
    groups["mass"] = updyn.Group(mass=sp.eye_array(n, format="csr"))
    return updyn.Model.from_groups(groups, [f"{j}:X" for j in range(n)])


def true_model(model: updyn.Model) -> updyn.Model:
    return model.scaled({name: {"stiffness": value} for name, value in TRUTH.items()})


def partitioned(model: updyn.Model, freq: np.ndarray, sensors: list[str]) -> np.ndarray:
    """Return -Z_ff^-1 Z_fb for the base 0:X, shape (n_f, n_i, 1)."""
    K, M = (A.toarray() for A in (model.stiffness, model.mass))
    at = [int(label.partition(":")[0]) - 1 for label in sensors]
    out = []
    for f in freq:
        Z = K * (1 + 0.02j) - (2 * np.pi * f) ** 2 * M
        out.append(-np.linalg.solve(Z[1:, 1:], Z[1:, 0])[at])
    return np.array(out)[:, :, None]


def measure(
    values: np.ndarray, sensors: list[str], reference: str, seed: int = 1, **more: Any
) -> updyn.FRF:
    """Return transmissibilities with 1 % noise."""
    real, imaginary = np.random.default_rng(seed).standard_normal((2, *values.shape))
    noisy = values * (1 + 0.01 * (real + 1j * imaginary) / np.sqrt(2))
    return updyn.FRF(FREQ, noisy, sensors, [reference], "transmissibility", **more)


@pytest.fixture(scope="module")
def shaken() -> updyn.FRF:
    return measure(partitioned(true_model(frame()), FREQ, SENSORS), SENSORS, "0:X")


def check_values(result: updyn.UpdateResult) -> None:
    for number in range(1, STOREYS + 1):
        name = f"storey {number}.stiffness"
        error = result.values[name] - TRUTH.get(f"storey {number}", 1.0)
        assert abs(error) < 4 * result.std[name] < 4e-3


@pytest.mark.parametrize("method", ["maximum-likelihood", "log"])
def test_update(shaken: updyn.FRF, method: str) -> None:
    model = frame()
    unknowns = updyn.parameters(model, stiffness="storey*", bounds={"*": (0.3, 3.0)})
    result = updyn.update(model, shaken, unknowns, method=method, base=["0:X"])
    assert result.status == "converged"
    assert result.findings == ()
    check_values(result)
    table = updyn.modal_table(result)
    held = true_model(model)
    K, M = (A.toarray()[1:, 1:] for A in (held.stiffness, held.mass))
    exact = np.sqrt(np.linalg.eigvalsh(np.linalg.solve(M, K))) / (2 * np.pi)
    assert table.updated is not None
    np.testing.assert_allclose(table.updated.frequency, exact, rtol=2e-3)


def test_reduced_tier() -> None:
    """The same estimate as by exact solutions, for 700 degrees of freedom."""
    model = frame(700, k=6e8)
    sensors = ["150:X", "400:X", "699:X"]
    truth = updyn.response(
        true_model(model), FREQ, sensors, ["0:X"], "transmissibility", base=["0:X"]
    )
    data = measure(truth.values, sensors, "0:X", base=["0:X"])
    unknowns = updyn.parameters(model, stiffness="storey*")
    results = {
        tier: updyn.update(model, data, unknowns, tier=tier, starts=0)
        for tier in ("reduced", "sparse")
    }
    assert results["reduced"].options["tier"] == "reduced"
    for name, value in results["sparse"].values.items():
        std = results["sparse"].std[name]
        assert results["reduced"].values[name] == pytest.approx(value, abs=0.02 * std)
        assert results["reduced"].std[name] == pytest.approx(std, rel=1e-3)


def test_ratio_of_two_responses() -> None:
    """One force of unknown size at a known place; the base has a spring to the ground."""
    model = frame()
    ground = updyn.Group(np.diag([3e4, *[0.0] * STOREYS]))
    model = updyn.Model.from_groups({**model.groups, "ground": ground}, model.dofs)
    sensors = ["1:X", "2:X", "4:X", "5:X"]
    truth = updyn.response(
        true_model(model), FREQ, sensors, ["3:X"], "transmissibility", force="5:X"
    )
    unknowns = updyn.parameters(model, stiffness="storey*")
    result = updyn.update(model, measure(truth.values, sensors, "3:X"), unknowns, force="5:X")
    # Neither the ground nor a storey on the other side of the reference and the force is seen by all.
    assert result.status in ("converged", "not-identifiable")
    for number in (2, 4):
        name = f"storey {number}.stiffness"
        assert result.values[name] == pytest.approx(TRUTH[f"storey {number}"], rel=5e-3)


JOB = """
[model]
file = "frame.h5"
[test]
file = "{file}"
base = ["0:X"]
[[parameter]]
groups = "storey*"
quantity = "stiffness"
bounds = [0.3, 3.0]
"""


@pytest.mark.parametrize("suffix", ["uff", "csv"])
def test_job(shaken: updyn.FRF, tmp_path: Path, suffix: str) -> None:
    updyn.write_model(frame(), tmp_path / "frame.h5")
    updyn.write_frf(shaken, tmp_path / f"sweep.{suffix}")
    job = tmp_path / "job.toml"
    job.write_text(JOB.format(file=f"sweep.{suffix}"))
    assert main(["run", str(job)]) == 0
    found = json.loads((tmp_path / "job" / "result.json").read_text())
    for row in found["parameters"]:
        assert abs(row["value"] - TRUTH.get(row["group"], 1.0)) < 4 * row["std"]
    assert updyn.read_result(tmp_path / "job" / "run.nc").frf.base.labels == ["0:X"]
    page = (tmp_path / "job" / "report.html").read_text()
    assert "per unit motion of the reference" in page
    assert "unit force" not in page


def test_new_check_and_correlate(
    shaken: updyn.FRF,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    updyn.write_model(frame(), tmp_path / "frame.h5")
    updyn.write_frf(shaken, tmp_path / "sweep.uff")
    assert main(["new", "frame.h5", "sweep.uff"]) == 0
    assert 'base = ["0:X"]' in Path("job.toml").read_text()
    assert main(["check", "job.toml"]) == 0
    out = capsys.readouterr().out
    assert "test: transmissibility, 200 lines" in out
    assert "No known fault was found in the data" in out
    assert main(["correlate", "job.toml"]) == 0
    first = np.sqrt(np.linalg.eigvalsh(frame().stiffness.toarray()[1:, 1:])[0]) / (2 * np.pi)
    assert f"{first:.5g}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ('base = ["0:X"]', "", "the excitation is not stated"),
        ('base = ["0:X"]', 'base = ["9:X"]', "base: DOF 9:X is not among the 6 DOFs"),
        ('base = ["0:X"]', 'base = ["0:X"]\nforce = "5:X"', "expected one of them"),
        ('base = ["0:X"]', 'base = ["0:X"]\nquantity = "accelerance"', "contradicts the file"),
        ("[[param", '[method]\nname = "equation-error"\n[[param', "needs measured forces"),
    ],
)
def test_refusals(
    shaken: updyn.FRF,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    old: str,
    new: str,
    text: str,
) -> None:
    """Each with the line of the job."""
    updyn.write_model(frame(), tmp_path / "frame.h5")
    updyn.write_frf(shaken, tmp_path / "sweep.uff")
    job = tmp_path / "job.toml"
    job.write_text(JOB.format(file="sweep.uff").replace(old, new))
    assert main(["check", str(job)]) == 2
    error = capsys.readouterr().err
    assert text in " ".join(error.split())
    assert "job.toml:" in error


def test_base_of_modes() -> None:
    modes = updyn.ModeSet([6.5, 18.0])
    model = frame()
    with pytest.raises(OptionError, match="modes have none"):
        updyn.update(model, modes, updyn.parameters(model, stiffness="storey*"), base=["0:X"])
