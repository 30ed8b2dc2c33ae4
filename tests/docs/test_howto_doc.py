"""The how-tos run as printed, on files of the names that they give to a user's own."""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import updyn
from ansys_samples import beam_elements, write_emat
from nastran_decks import plate
from pages import ROOT, blocks, run_console, run_python, save_toml
from updyn.elements.beam import beam_from_table
from updyn.elements.drivetrain import drivetrain_from_table
from updyn.elements.structure import structure_from_table
from updyn.model import Model

DOCS = ROOT / "docs"


def run(name: str) -> dict[str, Any]:
    """Run the blocks of a page from top to bottom in the current folder; return its names."""
    names: dict[str, Any] = {"__name__": "page"}
    for block in blocks(DOCS / f"{name}.md"):
        if block.language == "console":
            run_console(block, name)
        elif block.language == "python":
            run_python(block, name, names)
        elif block.language == "toml":
            save_toml(block)
    return names


def measure(truth: Model, lines: np.ndarray, sensors: Sequence[str], force: str, path: str) -> None:
    exact = updyn.response(truth, lines, sensors, [force], "accelerance")
    real, imaginary = np.random.default_rng(0).normal(size=(2, *exact.values.shape))
    values = exact.values * (1 + 0.01 * (real + 1j * imaginary) / np.sqrt(2))
    updyn.write_frf(updyn.FRF(lines, values, sensors, [force], "accelerance"), path)


def found(path: str) -> dict[str, float]:
    result = updyn.read_result(path)
    assert result.status == "converged"
    return result.values


@pytest.fixture(autouse=True)
def in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.needs("mystran")
def test_nastran() -> None:
    Path("plate.bdf").write_text(plate())
    truth = updyn.read_model("plate.bdf").scaled(
        {"PSHELL 1": {"stiffness": 0.85, "loss_factor": 0.03}, "PELAS 4": {"stiffness": 1.2}}
    )
    sensors = ["101:Z", "107:Z", "303:Z", "501:Z", "507:Z"]
    measure(truth, np.linspace(1, 70, 80), sensors, "107:Z", "test.unv")
    names = run("howto-nastran")
    values = found("result/run.nc")
    assert values["PSHELL 1.stiffness"] == pytest.approx(0.85, rel=0.01)
    assert values["PELAS 4.stiffness"] == pytest.approx(1.2, rel=0.01)
    assert values["PSHELL 1.loss_factor"] == pytest.approx(0.03, abs=0.003)
    assert Path("result/updated.bdf").exists()
    own = updyn.modes(names["result"].model, 6).frequency
    assert updyn.modes(names["updated"], 6).frequency == pytest.approx(own, rel=1e-6)


def test_ansys() -> None:
    pytest.importorskip("ansys.mapdl.reader", reason="needs updyn[ansys]")
    from ansys.mapdl import reader as mapdl
    from ansys.mapdl.reader import examples

    mesh = mapdl.read_binary(examples.rstfile).mesh
    elements = beam_elements(mesh, 16.9e6, 0.31, 4.1408e-4)
    write_emat(
        Path("beam.emat"),
        [(number, nodes, {"stiffness": K, "mass": M}) for number, nodes, K, M in elements],
    )
    shutil.copy(examples.fullfile, "beam.full")
    deck = Path(examples.hexarchivefile).read_text().splitlines()
    for i, line in enumerate(deck):
        fields = line.split()
        if len(fields) == 19 and fields[8] == "20" and fields[0] == "1" and int(fields[10]) > 20:
            deck[i] = f"{2:10d}" + line[10:]
    at = deck.index("*ENDIF")  # NUMOFF above it numbers materials anew
    deck[at + 1 : at + 1] = ["MP,EX,2,1.69E+07", "MP,NUXY,2,0.31", "MP,DENS,2,4.1408E-04"]
    Path("beam.cdb").write_text("\n".join(deck))
    truth = updyn.read_model("beam.emat").scaled(
        {
            "material 1": {"stiffness": 0.9, "loss_factor": 0.02},
            "material 2": {"stiffness": 1.1, "loss_factor": 0.01},
        }
    )
    band = np.linspace(0.2, 2.5, 100) * updyn.modes(truth, 1).frequency[0]
    sensors = truth.dofs.labels[-6:]
    measure(truth, band, sensors, sensors[0], "test.unv")
    run("howto-ansys")
    values = found("result/run.nc")
    assert values["material 1.stiffness"] == pytest.approx(0.9, rel=0.02)
    assert values["material 1.loss_factor"] == pytest.approx(0.02, abs=0.003)
    assert Path("result/updated.inp").exists()


def test_drivetrain(capsys: pytest.CaptureFixture[str]) -> None:
    page = next(b.text for b in blocks(DOCS / "howto-drivetrain.md") if b.language == "toml")
    table = tomllib.loads(page)["model"]
    del table["kind"]
    truth = drivetrain_from_table(table).scaled(
        {
            "motor shaft": {"stiffness": 0.75, "loss_factor": 0.03},
            "output shaft": {"stiffness": 0.9, "loss_factor": 0.02},
            "table": {"mass": 1.15},
        }
    )
    measure(truth, np.linspace(2, 250, 249), ["1:RZ", "3:RZ", "4:RZ"], "1:RZ", "drive.csv")
    run("howto-drivetrain")
    values = found("drive/run.nc")
    assert values["motor shaft.stiffness"] == pytest.approx(0.75, rel=0.01)
    assert values["output shaft.stiffness"] == pytest.approx(0.9, rel=0.01)
    assert values["table.mass"] == pytest.approx(1.15, rel=0.01)
    assert "motor shaft.stiffness" in capsys.readouterr().out


def test_notebook() -> None:
    names = run("howto-notebook")
    assert names["result"].status == "converged"
    assert {"report.html", "run.nc", "unknowns.csv"} <= {path.name for path in Path().iterdir()}


def test_from_zero_to_a_report() -> None:
    run("tutorial-report")
    assert Path("first/report.html").exists()


def test_a_test_with_other_labels() -> None:
    page = next(b for b in blocks(DOCS / "howto-test.md") if b.language == "toml")
    model = beam_from_table(tomllib.loads(page.text)["model"])
    true = model.scaled({"beam": {"stiffness": 0.9}, "clamp": {"stiffness": 0.5}})
    loaded, _ = updyn.sensor_masses(true, {"103:Z": 0.03})
    lines = np.arange(1.0, 400.0, 2.0)
    exact = updyn.response(loaded, lines, ["101:Z", "102:Z", "103:Z"], ["103:Z"], "accelerance")
    real, imaginary = np.random.default_rng(0).normal(size=(2, *exact.values.shape))
    values = exact.values * (1 + 0.01 * (real + 1j * imaginary) / np.sqrt(2))
    values[:, 2] *= 1.08  # the sensitivity of the tip sensor
    values[(lines >= 49.0) & (lines <= 51.0)] *= 100.0
    np.savez("hammer.npz", freq=lines, values=values)
    points = [f"{node},{x},0,0" for node, x in ((1, 320.5), (2, 520), (3, 719))]
    Path("points.csv").write_text("\n".join(["node,x,y,z", *points]) + "\n")
    run("howto-test")
    values = found("result/run.nc")
    assert values["beam.stiffness"] == pytest.approx(0.9, rel=0.01)
    assert values["clamp.stiffness"] == pytest.approx(0.5, rel=0.05)
    assert values["103:Z.calibration"] == pytest.approx(1.08, rel=0.01)


def test_a_sweep_on_a_shaker() -> None:
    page = next(b for b in blocks(DOCS / "howto-shaker.md") if b.language == "toml")
    table = tomllib.loads(page.text)["model"]
    del table["kind"]
    truth = structure_from_table(table).scaled(
        {
            "clamp band": {"stiffness": 0.7, "loss_factor": 0.05},
            "lower tube": {"stiffness": 1.1},
            "struts": {"stiffness": 1.25, "loss_factor": 0.015},
        }
    )
    lines = np.geomspace(5.0, 150.0, 250)
    sensors = ["2:X", "3:X", "4:X", "5:X", "4:RY"]
    exact = updyn.response(truth, lines, sensors, ["1:X"], "transmissibility", base=["1:X"])
    real, imaginary = np.random.default_rng(0).normal(size=(2, *exact.values.shape))
    values = exact.values * (1 + 0.01 * (real + 1j * imaginary) / np.sqrt(2))
    updyn.write_frf(updyn.FRF(lines, values, sensors, ["1:X"], "transmissibility"), "sweep.uff")
    names = run("howto-shaker")
    values_found = found("result/run.nc")
    assert values_found["clamp band.stiffness"] == pytest.approx(0.7, rel=0.01)
    assert values_found["lower tube.stiffness"] == pytest.approx(1.1, rel=0.01)
    assert values_found["upper tube.stiffness"] == pytest.approx(1.0, rel=0.01)
    assert values_found["struts.stiffness"] == pytest.approx(1.25, rel=0.01)
    assert values_found["clamp band.loss_factor"] == pytest.approx(0.05, rel=0.05)
    assert names["again"].values["struts.stiffness"] == pytest.approx(1.25, rel=0.01)
    exact = updyn.response(truth, [20.0, 40.0], ["4:X"], ["1:X"], "transmissibility", base=["1:X"])
    np.testing.assert_allclose(names["predicted"].values, exact.values, rtol=0.02)
