"""`updyn plant`, and the plant of `updyn run`: what is written is what the model answers; what is refused, and said."""

from __future__ import annotations

import json
import re
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import updyn
from updyn.cli import main
from updyn.control.files.plant_file import PLANT_FORMATS
from updyn.control.job.tables import PLANT_SUFFIXES
from updyn.control.weight import uncertainty_weight
from updyn.demos import find_demo
from updyn.elements.masses import add_masses

JOB = """[model]
file = "chain.h5"
[test]
file = "chain.uff"
[[parameter]]
groups = ["part1", "part2", "part3", "part4"]
quantity = "stiffness"
[method]
starts = 0
[plant]
inputs = ["12:X"]
outputs = [{ name = "tip", dof = "12:X" }, { name = "twist", weights = { "5:X" = 1, "2:X" = -1 } }]
quantity = ["mobility", "receptance"]
band = [1.0, 30.0]
sampling = { dt = 0.002 }
[output]
report = false
"""
FILES = {
    f"plant{more}.{suffix}" for more in ("", "-sampled") for suffix in ("mat", "json", "h")
} | {"control.json"}


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A job that has been run with a profile: what the terminal said is in said.txt."""
    folder = tmp_path_factory.mktemp("planted")
    find_demo("chain").write_inputs(folder)
    (folder / "job.toml").write_text(
        JOB + '[uncertainty]\nkind = "profile"\nnames = ["part4.stiffness"]\n'
    )
    said: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("updyn.cli.commands.print_outcome", lambda *texts, **_: said.extend(texts))
        # The masses of the model are wrong, and held.
        assert main(["run", str(folder / "job.toml")]) == 3
    (folder / "said.txt").write_text("\n".join(said))
    return folder


@pytest.fixture
def folder(ran: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(ran, tmp_path / "copy"))


def record(folder: Path) -> dict:
    return json.loads((folder / "control.json").read_text(encoding="utf-8"))


def off(model: updyn.Model, plant: updyn.Plant) -> np.ndarray:
    """The largest error of each channel as a share of its peak, on lines that the plant was not made on."""
    freq = np.linspace(1.0, 30.0, 977)
    H = updyn.response(model, freq, ["12:X", "5:X", "2:X"], ["12:X"]).values[:, :, 0]
    exact = np.stack([2j * np.pi * freq * H[:, 0], H[:, 1] - H[:, 2]], axis=1)
    found = plant.response(freq).values[:, :, 0]
    return np.abs(found - exact).max(axis=0) / np.abs(exact).max(axis=0)


def test_a_run_writes_the_plant_of_the_updated_model(ran: Path) -> None:
    out = ran / "job"
    assert {p.name for p in out.iterdir()} >= FILES
    plant = updyn.read_plant(out / "plant.json")
    assert plant.outputs == ("tip", "twist")
    assert plant.output_units == ("m/s", "m")
    assert off(updyn.read_model(out / "model.h5"), plant).max() <= 0.021
    assert (
        off(updyn.read_model(ran / "chain.h5"), plant).max() > 0.1
    )  # the start is another structure
    found = record(out)
    assert (found["updated"], found["met"], found["plant"]["order"]) == (True, True, plant.n_states)
    assert found["plant"]["error"] == pytest.approx(plant.error)
    assert {c["name"] for c in found["conversions"]} == {
        "modal",
        "complex",
        "biot",
        "diagonal",
        "single-frequency",
    }
    assert any("extends beyond the data" in note for note in found["notes"])
    assert updyn.read_plant(out / "plant-sampled.json").dt == 0.002


def test_the_terminal_shows_what_a_run_found_besides(ran: Path) -> None:
    said = (ran / "said.txt").read_text()
    assert "Profile likelihood, 95 % intervals" in said
    assert "damping converted by" in said
    assert (
        said.index("part4.stiffness") < said.index("Profile likelihood") < said.index("Results in")
    )


def test_check_says_what_the_plant_will_be(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", str(folder / "job.toml")]) == 0
    out, _ = capsys.readouterr()
    assert "Plant from 1 to 30 Hz, tolerance 2 %: 1 input (12:X), 2 outputs (tip, twist)" in out
    assert "extends beyond the data, 0.6349 to 22.7 Hz" in out


def test_the_plant_of_a_finished_run(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    job = folder / "job.toml"
    job.write_text(
        job.read_text().replace("band = [1.0, 30.0]", 'band = [1.0, 20.0]\nfiles = "drive.npz"')
    )
    assert main(["plant", str(job), "--out", str(folder / "elsewhere")]) == 0
    out, _ = capsys.readouterr()
    assert f"The updated model of the run in '{folder / 'job'}' (not-credible)." in out
    assert "beyond the data" not in out
    names = {p.name for p in (folder / "elsewhere").iterdir()}
    assert names == {
        "drive.npz",
        "drive-sampled.npz",
        "control.json",
        "plant.html",
        "manifest.json",
    }
    there = updyn.read_plant(folder / "elsewhere" / "drive.npz")
    assert there.band == (1.0, 20.0)
    assert record(folder / "elsewhere")["updated"] is True


def test_from_the_job_that_the_run_wrote(folder: Path) -> None:
    left = folder / "job" / "job.toml"
    for out in ([], ["--out", str(folder / "elsewhere")]):
        assert main(["plant", str(left), *out]) == 0
    assert record(folder / "elsewhere")["updated"] is True
    assert (folder / "job" / "plant.html").is_file()
    assert not (folder / "job" / "job").exists()


def test_without_a_run_it_is_of_the_model_as_it_stands(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.rmtree(folder / "job")
    assert main(["plant", str(folder / "job.toml")]) == 0
    assert "The original model, NOT updated" in capsys.readouterr().out
    assert record(folder / "job")["updated"] is False
    assert "NOT updated" in (folder / "job" / "plant.html").read_text(encoding="utf-8")
    plant = updyn.read_plant(folder / "job" / "plant.json")
    assert off(updyn.read_model(folder / "chain.h5"), plant).max() <= 0.021


def test_where_the_tolerance_is_not_met_no_plant_is_left(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = folder / "job.toml"
    job.write_text(job.read_text().replace("sampling =", "tolerance = 1e-6\nsampling ="))
    assert main(["plant", str(job)]) == 3
    out, _ = capsys.readouterr()
    assert "no order holds a tolerance of 1e-06" in out
    assert "No plant is written" in out
    assert not (FILES - {"control.json"}) & {p.name for p in (folder / "job").iterdir()}
    found = record(folder / "job")
    assert (found["met"], found["plant"]) == (False, None)
    assert "no order holds" in found["message"]
    assert len(found["conversions"]) == 5
    assert "Tolerance not met" in (folder / "job" / "plant.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("starts = 0", "starts = 1", "job.toml:8: [method] differs from that of the run in"),
        ('["part1", ', "[", "job.toml:5: [parameter] differs from that of the run in"),
        (
            "[plant]",
            "[[damping]]\ngroups = ['part1']\nloss_factor = 0.01\n[plant]",
            "[damping] differs from that of the run",
        ),
        (
            'inputs = ["12:X"]',
            'inputs = ["13:X"]',
            "job.toml:11: input 13:X is not among the 12 DOFs",
        ),
        ("[plant]", "[plant]\nroute = 'diagonal'", "plant.route = 'diagonal'"),
    ],
)
def test_what_does_not_fit_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, said: str
) -> None:
    job = folder / "job.toml"
    job.write_text(job.read_text().replace(old, new, 1))
    before = {p: p.stat().st_mtime_ns for p in (folder / "job").iterdir()}
    assert main(["plant", str(job)]) == 2
    err = " ".join(capsys.readouterr().err.split())
    assert said in err
    assert err.count("error:") == 1
    assert {p: p.stat().st_mtime_ns for p in (folder / "job").iterdir()} == before


def test_data_that_have_changed_are_seen(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frf = updyn.read_frf(folder / "chain.uff")
    changed = updyn.FRF(frf.freq, 1.01 * frf.values, frf.responses, frf.references, frf.quantity)
    updyn.write_frf(changed, folder / "chain.uff")
    assert main(["plant", str(folder / "job.toml")]) == 2
    assert "the measurement differs from that of the run" in " ".join(
        capsys.readouterr().err.split()
    )


def test_folders_and_jobs_that_cannot_be(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    job = folder / "job.toml"
    assert main(["plant", str(job), "--run", str(folder / "gone")]) == 2
    assert "no finished run in" in " ".join(capsys.readouterr().err.split())
    job.write_text(job.read_text().replace('files = "', "").partition("[plant]")[0])
    assert main(["plant", str(job)]) == 2
    assert "the job has no [plant]" in " ".join(capsys.readouterr().err.split())


def test_suffixes_are_those_of_the_writers() -> None:
    assert set(PLANT_SUFFIXES) == {
        s for f in PLANT_FORMATS if "write_plant" in f.can for s in f.suffixes
    }


# -- [servo] ---------------------------------------------------------------------------------------------------
SERVO = """
[servo]
velocity = "tip"
motor = "12:X"
load = "1:X"
[servo.controller]
"""


def test_a_servo_that_cannot_be_is_an_error_of_plant(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The chain is held at one end: nothing turns freely, so no gain can be sized by an inertia."""
    job = folder / "job.toml"
    job.write_text(job.read_text() + SERVO + "crossover = 2.0\n")
    before = {p: p.stat().st_mtime_ns for p in (folder / "job").iterdir()}
    assert main(["plant", str(job)]) == 2
    err = " ".join(capsys.readouterr().err.split())
    line = job.read_text().splitlines().index("crossover = 2.0")
    assert f"job.toml:{line}: " in err  # the table, whose first key that the message names is none
    assert "no rigid-body motion" in err
    assert {p: p.stat().st_mtime_ns for p in (folder / "job").iterdir()} == before


def test_a_run_keeps_its_plant_where_the_servo_cannot_be(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = folder / "job.toml"
    job.write_text(job.read_text().partition("[uncertainty]")[0] + SERVO + "crossover = 2.0\n")
    assert main(["run", str(job)]) == 3
    out, _ = capsys.readouterr()
    assert "note: [servo] is omitted:" in out
    assert updyn.read_plant(folder / "job" / "plant.json").outputs == ("tip", "twist")
    found = record(folder / "job")
    assert (found["servo"], found["met"]) == (None, True)


def test_a_servo_is_printed_and_recorded(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    job = folder / "job.toml"
    job.write_text(job.read_text() + SERVO + "kp = 20\ndead_time = 0.001\n")
    assert main(["plant", str(job), "--verbose"]) == 0
    out, _ = capsys.readouterr()
    assert "velocity loop" in out
    assert "Drive from 12:X (motor) to 1:X (load)" in out
    found = record(folder / "job")["servo"]
    plant = updyn.read_plant(folder / "job" / "plant.json")
    controller = updyn.Controller(20.0, dead_time=0.001)
    servo = updyn.servo(plant, controller, torque="12:X", velocity="tip")
    assert found["velocity_loop"]["margins"]["modulus_margin"] == pytest.approx(
        servo.velocity_loop.margins.modulus_margin, rel=1e-6
    )
    assert found["stable"] == servo.stable
    assert 'data-figure="bode-velocity"' in (folder / "job" / "plant.html").read_text(
        encoding="utf-8"
    )


# -- several tests -----------------------------------------------------------------------------------------------
def test_the_plant_of_one_of_several_tests(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One test with an added mass: the plant is of the configuration that is named."""
    model = updyn.read_model(folder / "chain.h5")
    loaded = add_masses(model, {"12:X": 5.0})
    for name, one in (("plain", model), ("loaded", loaded)):
        frf = updyn.response(one, np.linspace(1.0, 20.0, 40), ["12:X", "5:X"], ["12:X"])
        updyn.write_frf(frf, folder / f"{name}.npz")
    tests = '[[test]]\nname = "loaded"\nfile = "loaded.npz"\nmasses = { "12:X" = 5.0 }\n'
    tests += '[[test]]\nname = "plain"\nfile = "plain.npz"\n'
    job = folder / "several.toml"
    text = JOB.replace('[test]\nfile = "chain.uff"\n', tests).replace(
        "starts = 0", "starts = 0\nnoise = 'flat'"
    )
    text = text.replace("noise = 'flat'", "noise = { relative = 0.01 }").replace(
        "[plant]", "[plant]\ntest = 'loaded'"
    )
    job.write_text(text)
    assert main(["run", str(job)]) == 0
    out = folder / "several"
    assert (
        off(
            updyn.read_model(out / "loaded" / "model.h5"), updyn.read_plant(out / "plant.json")
        ).max()
        <= 0.021
    )
    note = "in test 'loaded', with its added masses"
    assert note in capsys.readouterr().out
    job.write_text(text.replace("test = 'loaded'", "test = 'plain'"))  # the second test
    assert main(["plant", str(job), "--out", str(folder / "elsewhere")]) == 0
    assert note not in capsys.readouterr().out
    plant = updyn.read_plant(folder / "elsewhere" / "plant.json")
    assert off(updyn.read_model(out / "plain" / "model.h5"), plant).max() <= 0.021
    assert off(updyn.read_model(out / "loaded" / "model.h5"), plant).max() > 0.1
    job.write_text(text.replace("test = 'loaded'", "test = 'plan'"))
    assert main(["plant", str(job)]) == 2
    assert "did you mean 'plain'" in " ".join(capsys.readouterr().err.split())


def test_the_family_is_of_the_draws_that_there_are(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The search for the order of a weight takes seconds; the tests of sections on plants have it.
    of_order_2 = partial(uncertainty_weight, order=2)
    monkeypatch.setattr("updyn.control.job.plant_result.uncertainty_weight", of_order_2)
    job = folder / "job.toml"
    text = (
        job.read_text()
        .partition("[uncertainty]")[0]
        .replace("sampling =", "family = 2\nsampling =")
    )
    text = re.sub(r"outputs = .*\nquantity = .*\n", 'outputs = ["12:X"]\n', text)
    text = text.replace("band = [1.0, 30.0]", "band = [1.0, 5.0]")
    job.write_text(text + '[uncertainty]\nkind = "bootstrap"\nn = 3\n')
    assert main(["run", str(job)]) == 3
    draws = updyn.read_uncertainty(folder / "job" / "uncertainty.nc")
    first = record(folder / "job")["family"]
    assert main(["plant", str(job), "--verbose"]) == 0
    again = record(folder / "job")["family"]
    assert first == again
    assert (first["members"], first["facts"]["source"]) == (2, "bootstrap")
    assert len(draws) == 3
    shutil.rmtree(folder / "job")
    assert main(["plant", str(job), "--verbose"]) == 0
    found = record(folder / "job")
    assert found["family"] is None
    assert any("the model is not updated" in note for note in found["notes"])
