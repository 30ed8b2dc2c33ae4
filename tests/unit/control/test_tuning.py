"""Tuning of the controller of a job: the numbers found, edited, and the loop with them."""

from __future__ import annotations

import tomllib

import pytest
import tomlkit

import updyn
from servo_cases import NAMES, quick, two_masses
from updyn.control.job.tuning import find_plant_file, list_gains, set_gains, tune_loop
from updyn.errors import JobError

JOB = """[model]
file = "m.h5"
[test]
file = "t.npz"
[[parameter]]
groups = "all"
quantity = "stiffness"
[plant]
inputs = [{ name = "motor", dof = "1:RZ" }]
outputs = [{ name = "speed", dof = "1:RZ" }]
quantity = "mobility"
[servo]
velocity = "speed"
[servo.controller]  # as tested
kp = 170
ti = 0.2
feed_forward = 0
notch = [{ frequency = 9, zero_damping = 0.1, pole_damping = 0.5 }, { frequency = 30, width = 5 }]
"""
KP, SECOND = ("kp",), ("notch", 1, "frequency")


@pytest.fixture
def plant_file(tmp_path):
    """The plant of two masses, with a torque on the first."""
    updyn.write_plant(two_masses(), tmp_path / "plant.json")
    return tmp_path / "plant.json"


def test_the_positive_numbers_of_a_controller():
    found = {gain.path: (gain.label, gain.unit, gain.value) for gain in list_gains(JOB)}
    assert found == {
        KP: ("kp", "", 170),
        ("ti",): ("ti", "s", 0.2),
        ("notch", 0, "frequency"): ("notch 1, frequency", "Hz", 9),
        ("notch", 0, "zero_damping"): ("notch 1, zero damping", "", 0.1),
        ("notch", 0, "pole_damping"): ("notch 1, pole damping", "", 0.5),
        SECOND: ("notch 2, frequency", "Hz", 30),
        ("notch", 1, "width"): ("notch 2, width", "Hz", 5),
    }


@pytest.mark.parametrize("text", ["", "[servo]\n", "servo = 3\n", "[servo\n"])
def test_a_job_without_a_controller(text):
    assert list_gains(text) == []


def test_an_edit_keeps_everything_else():
    document = tomlkit.parse(JOB)
    set_gains({KP: 123.456, SECOND: 31.0})(document)
    text = tomlkit.dumps(document)
    assert text == JOB.replace("kp = 170", "kp = 123.5").replace("frequency = 30", "frequency = 31.0")  # fmt: skip


def test_the_loop_is_that_of_the_changed_controller(plant_file, tmp_path):
    values = {KP: 210.0, SECOND: 25.0}
    found = tune_loop(tmp_path / "job.toml", JOB, plant_file, values)
    notches = updyn.Notch(9.0, 0.1, 0.5), updyn.Notch.of_width(25.0, 5.0, 0.0)
    margins = quick(two_masses(), updyn.Controller(210.0, 0.2, notches=notches), **NAMES).velocity_loop.margins  # fmt: skip
    rows = dict(found.rows)
    assert rows["velocity loop: phase margin"] == f"{margins.phase_margin:.3g}°"
    assert rows["velocity loop: modulus margin"] == f"{margins.modulus_margin:.3g}"
    assert rows["velocity loop: crossover"] == f"{margins.crossover:.4g} Hz"
    bode, step = found.figures
    assert len(bode["data"]) >= 3
    assert step["layout"]["xaxis"]["title"]["text"] == "time (s)"


def test_wrong_numbers_are_refused_as_in_a_job(plant_file, tmp_path):
    with pytest.raises(JobError, match=r"job.toml:15: controller: kp is -1.0; expected"):
        tune_loop(tmp_path / "job.toml", JOB, plant_file, {KP: -1.0})


def test_the_file_of_the_plant(plant_file, tmp_path):
    assert find_plant_file(JOB, tmp_path) == plant_file
    named = JOB.replace("[servo]", 'files = ["drive.h", "drive.npz"]\n[servo]')
    assert find_plant_file(named, tmp_path) is None
    (tmp_path / "drive.h").touch()
    assert find_plant_file(named, tmp_path) is None
    (tmp_path / "drive.npz").touch()
    assert tomllib.loads(named)["plant"]["files"] == ["drive.h", "drive.npz"]
    assert find_plant_file(named, tmp_path) == tmp_path / "drive.npz"
