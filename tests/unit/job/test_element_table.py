"""Nonlinear elements and force levels in a job."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import updyn
from updyn.cli import main
from updyn.errors import JobError
from updyn.job import load_job, prepare, run_job
from updyn.job.start import StartModel, compute_start_frf
from updyn.report.formats import percentage

FREQ = np.linspace(0.7, 2.0, 25) / (2 * np.pi)
JOB = """\
[model]
file = "linear.h5"
[[element]]
name = "cube"
kind = "cubic-spring"
dofs = "1:X"
coefficient = 0.4
[[test]]
name = "low"
file = "low.npz"
level = 0.05
[[test]]
name = "high"
file = "high.npz"
level = 0.2
sweep = "up"
[[parameter]]
groups = "spring"
quantity = "stiffness"
[[parameter]]
element = "cube"
quantity = "coefficient"
bounds = [0.01, 10.0]
[method]
starts = 0
noise = { relative = 0.01 }
[output]
report = false
"""


def linear() -> updyn.Model:
    groups = {
        "spring": updyn.Group([[1.0]], viscous=[[0.1]]),
        "mass": updyn.Group(mass=[[1.0]]),
    }
    return updyn.Model.from_groups(groups, ["1:X"])


def write(folder: Path, text: str = JOB) -> Path:
    true = linear().scaled({"spring": {"stiffness": 1.2}})
    true = true.with_elements({"cube": (updyn.CubicSpring(1.0), "1:X")})
    updyn.write_model(linear(), folder / "linear.h5")
    for name, level in (("low", 0.05), ("high", 0.2)):
        found = updyn.response(true, FREQ, ["1:X"], ["1:X"], level=level)
        updyn.write_frf(found.frf.with_level(None), folder / f"{name}.npz")
    path = folder / "job.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_job_fits_an_element_over_levels_and_keeps_it(tmp_path: Path) -> None:
    outcome = run_job(load_job(write(tmp_path)), tmp_path / "out")
    joint = outcome.result
    assert joint.values["cube.coefficient"] == pytest.approx(1.0, rel=1e-3)
    assert joint.values["spring.stiffness"] == pytest.approx(1.2, rel=1e-3)
    folder = next((tmp_path / "out").rglob("model.h5")).parent
    model = updyn.read_model(folder / "model.h5")
    assert model.nonlinear["cube"].element.coefficient == joint.values["cube.coefficient"]
    again = updyn.read_result(folder / "run.nc")
    assert again.parameters.names == ["spring.stiffness", "cube.coefficient"]
    assert again.parameters[1].of_element
    assert again.parameters[1].value_unit == "N/m^3"
    assert again.data.level is not None
    assert again.model.nonlinear["cube"].element == model.nonlinear["cube"].element


def test_checks_compare_the_start_at_each_level(tmp_path: Path, capsys) -> None:
    path = write(tmp_path, JOB.replace("report = false", "report = true"))
    assert main(["check", str(path)]) == 0
    text = capsys.readouterr().out
    assert "The data determine 2 of 2 unknowns" in text
    assert "No known fault was found" in text
    ready = prepare(load_job(path))
    high = ready.tests[1]
    computed = compute_start_frf(high, StartModel.of(high, ready.parameters))
    model = linear().with_elements({"cube": (updyn.CubicSpring(0.4), "1:X")})
    wanted = updyn.response(model, FREQ, ["1:X"], ["1:X"], level=0.2).values
    np.testing.assert_allclose(computed.values, wanted, rtol=1e-3)
    page = (tmp_path / "job-check" / "high" / "check.html").read_text(encoding="utf-8")
    std = identifiability_std(path)
    assert f"±{percentage(std)}" in page.split('id="unknowns"')[1]
    assert main(["correlate", str(path)]) == 0
    frac = updyn.correlate(computed, high.frf).frac[0, 0]
    assert f"{frac:.4f}" in capsys.readouterr().out


def identifiability_std(path: Path) -> float:
    """Return the expected relative standard deviation of the coefficient, from differences."""
    J, weight = [], []
    for level, test in zip((0.05, 0.2), prepare(load_job(path)).tests, strict=True):
        ends = []
        for spring, cube in ((1.001, 0.4), (0.999, 0.4), (1.0, 0.4004), (1.0, 0.3996)):
            model = linear().scaled({"spring": {"stiffness": spring}})
            model = model.with_elements({"cube": (updyn.CubicSpring(cube), "1:X")})
            found = updyn.response(model, FREQ, ["1:X"], ["1:X"], level=level, sweep="up")
            ends.append(found.values.ravel())
        J.append(np.array([(ends[0] - ends[1]) / 2e-3, (ends[2] - ends[3]) / 2e-3]))
        weight.append(np.sqrt(2.0) / (0.01 * np.abs(0.5 * (ends[0] + ends[1]))))
        assert test.data.level[0] == level
    whitened = np.hstack(J) * np.concatenate(weight)
    information = (whitened @ whitened.conj().T).real
    return float(np.sqrt(np.linalg.solve(information, np.eye(2))[1, 1]))


def test_only_faults_that_data_show_are_found_with_elements(tmp_path: Path) -> None:
    write(tmp_path)
    frf = updyn.read_frf(tmp_path / "high.npz").with_level(0.2)
    model = linear().with_elements({"cube": (updyn.CubicSpring(1.0), "1:X")})
    assert updyn.diagnose(model, frf) == ()
    turned = replace(frf, values=-frf.values)
    (found,) = updyn.diagnose(model, turned)
    assert "sign" in str(found)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ('kind = "cubic-spring"', 'kind = "cubic"', r":3: .*'cubic-spring'"),
        ("coefficient = 0.4", "stiffness = 0.4", r":3: .*'stiffness'.*'coefficient'"),
        ('dofs = "1:X"', 'dofs = "2:X"', r":3: .*2:X"),
        ('element = "cube"', 'element = "cub"', r":21: .*'cube"),
        ('element = "cube"\nquantity', 'element = "cube"\ngroups = "spring"\nquantity', "groups"),
        ('quantity = "coefficient"', 'quantity = "slip"', r":21: .*'cube.slip'"),
    ],
)
def test_mistakes_are_located(tmp_path: Path, old: str, new: str, text: str) -> None:
    with pytest.raises(JobError, match=text):
        prepare(load_job(write(tmp_path, JOB.replace(old, new))))


@pytest.mark.parametrize(
    "element",
    [
        updyn.PolynomialSpring({1: 2.0, 3: -0.5}),
        updyn.Backlash(2.0, 0.1, offset=0.02),
        updyn.CoulombFriction(0.5, transition=0.1),
        updyn.IwanJoint(4.0, 5e3, -0.4, 0.3),
    ],
)
def test_files_keep_elements(tmp_path: Path, element) -> None:
    model = linear().with_elements({"joint": (element, {"1:X": -2.0})})
    updyn.write_model(model, tmp_path / "model.h5")
    found = updyn.read_model(tmp_path / "model.h5").nonlinear["joint"]
    assert found.element == element
    assert dict(found.weights) == {"1:X": -2.0}
    with pytest.raises(updyn.UpdynError, match=r"only .h5 files store nonlinear elements"):
        updyn.write_model(model, tmp_path / "model.npz")
