"""`[population]` of a job: scatter over specimens, its file, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import updyn
from updyn.cli import main
from updyn.demos import find_demo
from updyn.errors import JobError
from updyn.job import load_job, run_job

FACTORS = {"a": 0.9, "b": 1.0, "c": 1.15, "d": 1.05}
HEAD = """[model]
file = "chain.h5"
[[parameter]]
groups = ["part1"]
quantity = "stiffness"
[method]
name = "modal"
[output]
report = {report}
"""
TEST = """[[test]]
name = "{name}"
modes = "{name}.unv"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    find_demo("chain").write_inputs(tmp_path)
    model = updyn.read_model(tmp_path / "chain.h5")
    sensors = ["2:X", "5:X", "7:X", "10:X", "12:X"]
    for name, factor in FACTORS.items():
        found = updyn.modes(model.scaled({"part1": {"stiffness": factor}}), 3)
        modes = updyn.ModeSet(found.frequency, found.at(sensors), sensors)
        updyn.write_modes(modes, tmp_path / f"{name}.unv")
    return tmp_path


def write_job(folder: Path, table: str, names=tuple(FACTORS), report: str = "false") -> Path:
    path = folder / "job.toml"
    tests = "".join(TEST.format(name=name) for name in names)
    path.write_text(HEAD.format(report=report) + tests + table)
    return path


def test_a_run_estimates_the_scatter_of_specimens(folder: Path) -> None:
    out = folder / "out"
    done = run_job(load_job(write_job(folder, "[population]\nlevel = 0.9\n", report="true")), out)
    record = json.loads((out / "population.json").read_text(encoding="utf-8"))
    (unknown,) = record["unknowns"]
    factors = np.array(list(FACTORS.values()))
    assert unknown["name"] == "part1.stiffness"
    assert unknown["mean"] == pytest.approx(factors.mean(), abs=0.01)
    assert unknown["std"] == pytest.approx(factors.std(ddof=1), rel=0.1)
    found = done.further["population"]
    assert unknown["interval"] == pytest.approx(found.intervals(0.9)["part1.stiffness"])
    assert record["level"] == 0.9
    for name, factor in FACTORS.items():
        assert record["specimens"][name]["values"]["part1.stiffness"] == pytest.approx(
            factor, abs=0.02
        )
    assert found.statement in done.summary()
    assert 'id="population"' in (out / "report.html").read_text(encoding="utf-8")


def test_a_job_with_one_test_is_refused_with_its_line(folder: Path, capsys) -> None:
    path = write_job(folder, "[population]\n", ("a",))
    line = path.read_text().splitlines().index("[population]") + 1
    assert main(["check", str(path)]) == 2
    error = capsys.readouterr().err
    assert f"job.toml:{line}:" in error
    assert "expected a [[test]] for each specimen" in error


def test_a_selection_is_refused(folder: Path) -> None:
    path = write_job(folder, "[population]\n[selection]\nn = 1\n")
    with pytest.raises(JobError, match="chooses other unknowns for each specimen"):
        load_job(path)
