"""`[levels]` of a job: information of force levels, its file, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import updyn
from updyn.cli import main
from updyn.job import load_job, run_job

FREQ = np.linspace(0.7, 2.0, 25) / (2 * np.pi)
ELEMENT = """[[element]]
name = "cube"
kind = "cubic-spring"
dofs = "1:X"
coefficient = 0.8
[[parameter]]
element = "cube"
quantity = "coefficient"
bounds = [0.01, 10.0]
"""
JOB = """[model]
file = "linear.h5"
[[test]]
name = "low"
file = "low.npz"
level = 0.05
[[test]]
name = "high"
file = "high.npz"
level = 0.2
[[parameter]]
groups = "spring"
quantity = "stiffness"
[method]
starts = 0
noise = { relative = 0.01 }
"""


def write(folder: Path, text: str) -> Path:
    groups = {"spring": updyn.Group([[1.0]], viscous=[[0.1]]), "mass": updyn.Group(mass=[[1.0]])}
    linear = updyn.Model.from_groups(groups, ["1:X"])
    true = linear.with_elements({"cube": (updyn.CubicSpring(1.0), "1:X")})
    updyn.write_model(linear, folder / "linear.h5")
    for name, level in (("low", 0.05), ("high", 0.2)):
        found = updyn.response(true, FREQ, ["1:X"], ["1:X"], level=level)
        updyn.write_frf(found.frf.with_level(None), folder / f"{name}.npz")
    path = folder / "job.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_run_assesses_its_levels(tmp_path: Path) -> None:
    out = tmp_path / "out"
    path = write(tmp_path, f"{JOB}[levels]\ncandidates = [0.1, 0.4]\n{ELEMENT}")
    done = run_job(load_job(path), out)
    record = json.loads((out / "levels.json").read_text(encoding="utf-8"))
    found = updyn.assess_levels(done.result, [0.1, 0.4])
    assert [one["name"] for one in record["tests"]] == ["low", "high"]
    assert [one["level"] for one in record["candidates"]] == [0.1, 0.4]
    name = "cube.coefficient"
    assert record["unknowns"][name]["std"] == pytest.approx(found.std[name])
    for one, same in zip(record["candidates"], found.candidates, strict=True):
        assert one["std"][name] == pytest.approx(same.std[name])
        assert one["gain"] == pytest.approx(same.gain)
    assert record["tests"][1]["without"][name] == pytest.approx(found.fitted[1].without[name])
    assert record["best"] == 0.4
    assert "Add a test at 0.4 N" in done.summary()
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "Add a test at 0.4 N" in page.split('id="levels"')[1]
    assert "[levels]" in (out / "job.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{JOB}[levels]\n", "no nonlinear elements"),
        (f"{JOB}[levels]\ncandidates = [0.0]\n{ELEMENT}", "force amplitude above 0"),
        (f"{JOB}[levels]\ncandidates = []\n{ELEMENT}", "candidates"),
        (
            JOB.replace("[method]\n", '[method]\nname = "log"\n') + f"[levels]\n{ELEMENT}",
            "requires a fit by",
        ),
    ],
)
def test_mistakes_are_refused_with_their_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, message: str
) -> None:
    path = write(tmp_path, text)
    line = text.splitlines().index("[levels]") + 1
    assert main(["check", str(path)]) == 2
    error = capsys.readouterr().err
    assert message in " ".join(error.split())
    assert f"job.toml:{line}:" in error or f"job.toml:{line + 1}:" in error
