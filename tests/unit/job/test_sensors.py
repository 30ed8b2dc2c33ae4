"""Jobs whose sensors have unknowns: calibration factors, masses; and Rayleigh damping."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import updyn
from updyn.demos import chain
from updyn.errors import JobError
from updyn.job import load_job, prepare, run_job

TRUE = {
    "part1": {"stiffness": 1.1, "mass_damping": 2.0},
    "part3": {"stiffness": 0.9, "stiffness_damping": 3e-3},
    "sensor 7": {"mass": 1.5},
}
JOB = """\
[model]
file = "chain.h5"
[test]
file = "chain.npz"
sensor_masses = {{ 7 = 2.0, "2:X" = 1.0 }}
noise = {{ relative = 0.005 }}
[[parameter]]
groups = "part*"
quantity = "stiffness"
[[parameter]]
groups = "part1"
quantity = "mass_damping"
bounds = [0.0, 20.0]
[[parameter]]
groups = "part3"
quantity = "stiffness_damping"
bounds = [0.0, 0.1]
{more}
[output]
report = false
"""
SENSORS = """\
[[parameter]]
groups = "sensor *"
quantity = "mass"
prior_std = 0.3
[[calibration]]
responses = ["5:X", "7:X"]
[[calibration]]
references = "all"
prior_std = 0.01
name = "hammer"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    model = chain.build()
    updyn.write_model(model, tmp_path / "chain.h5")
    loaded, _ = updyn.sensor_masses(model, {7: 2.0, "2:X": 1.0})
    frf = updyn.response(
        loaded.scaled(TRUE),
        np.linspace(0.5, 20.0, 80),
        ["2:X", "5:X", "7:X", "10:X"],
        ["12:X"],
        "accelerance",
    )
    rng = np.random.default_rng(5)
    noise = rng.standard_normal(frf.values.shape) + 1j * rng.standard_normal(frf.values.shape)
    values = frf.values + 0.005 * np.abs(frf.values) * noise / np.sqrt(2)
    values[:, 1] *= 1.07
    updyn.write_frf(
        updyn.FRF(frf.freq, values, frf.responses, frf.references, frf.quantity),
        tmp_path / "chain.npz",
    )
    return tmp_path


def write(folder: Path, text: str) -> Path:
    path = folder / "job.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_job_finds_what_is_wrong_with_its_sensors(folder: Path) -> None:
    result = run_job(load_job(write(folder, JOB.format(more=SENSORS))), folder / "out").result
    assert result.status == "converged"
    expected = {
        f"{group}.{quantity}": v for group, change in TRUE.items() for quantity, v in change.items()
    }
    for name, value in {**expected, "5:X.calibration": 1.07, "7:X.calibration": 1.0}.items():
        assert abs(result.values[name] - value) < 4 * result.std[name], name
    assert result.std["5:X.calibration"] < 0.01
    masses = {
        p.name: (p.nominal, p.unit) for p in result.parameters if p.group.startswith("sensor")
    }
    assert masses == {"sensor 7.mass": (2.0, "kg"), "sensor 2.mass": (1.0, "kg")}
    assert result.model.groups["part1"].mass_damping == result.values["part1.mass_damping"]
    # What is written is read again, and the job that is left behind is the same.
    again = updyn.read_result(folder / "out" / "run.nc")
    assert again.parameters == result.parameters
    assert updyn.read_model(folder / "out" / "model.h5").groups["part3"].stiffness_damping > 2e-3
    told = {
        p["name"]: p for p in json.loads((folder / "out" / "result.json").read_text())["parameters"]
    }
    assert told["5:X.calibration"]["quantity"] == "calibration"
    assert told["hammer.calibration"]["drives"] == [
        {"group": "12:X", "quantity": "force_calibration", "power": 1.0}
    ]
    repeated = prepare(load_job(folder / "out" / "job.toml"))
    assert repeated.parameters.names == result.parameters.names
    assert [p.prior_std for p in repeated.parameters][-3:] == [0.05, 0.05, 0.01]


def test_added_masses_can_be_unknown(folder: Path) -> None:
    text = JOB.format(more='[[parameter]]\ngroups = "added mass"\nquantity = "mass"\n')
    text = text.replace("sensor_masses", 'masses = { "4:X" = 1.0 }\nsensor_masses')
    ready = prepare(load_job(write(folder, text)))
    assert "added mass.mass" in ready.parameters.names
    assert ready.tests[0].model.groups["added mass"].mass[3, 3] == 1.0


def test_a_mass_of_two_values_is_no_unknown(folder: Path) -> None:
    two = '[[test]]\nname = "{}"\nfile = "chain.npz"\nsensor_masses = {{ 7 = {} }}\n'
    rest = '[[parameter]]\ngroups = "sensor 7"\nquantity = "mass"\n'
    head = '[model]\nfile = "chain.h5"\n'
    job = write(folder, head + two.format("a", 1.0) + two.format("b", 2.0) + rest)
    with pytest.raises(
        JobError, match=r"job.toml:11: 'sensor 7' weighs 1 and 2 kg in different tests"
    ):
        prepare(load_job(job))
    ready = prepare(
        load_job(write(folder, head + two.format("a", 1.0) + two.format("b", 1.0) + rest))
    )
    assert ready.parameters[0].nominal == 1.0


def test_a_job_says_what_damping_groups_begin_with(folder: Path) -> None:
    tables = """
[[damping]]
groups = "all"
loss_factor = 0.01
mass_damping = 1.0
[[damping]]
groups = ["part2", "part4"]
loss_factor = 0.03
loss_table = [[0, 100], [1, 2]]
"""
    ready = prepare(load_job(write(folder, JOB.format(more=tables))))
    told = {name: group.damping_words for name, group in ready.model.groups.items()}
    assert told["part1"] == "loss factor 0.01, mass damping 1 1/s"
    assert told["part4"] == "loss factor 0.03 by a table from 0 to 100 Hz, mass damping 1 1/s"
    assert told["sensor 7"] == "loss factor 0"
    start = {p.name: p.start for p in ready.parameters}
    assert start["part1.mass_damping"] == 1.0
