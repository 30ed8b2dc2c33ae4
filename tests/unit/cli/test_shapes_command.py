"""`updyn shapes`: modes, models, FRFs and runs as animation and universal file, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import updyn
from updyn.cli import main

LABELS = ["1:Z", "2:Z", "3:Z"]
QUICK = ["--option", "frames=3"]


def geometry() -> updyn.Geometry:
    return updyn.Geometry([1, 2, 3], [[0, 0, 0], [0, 1, 0], [0, 2, 0]], [[1, 2], [2, 3]])


def model() -> updyn.Model:
    K = 1e4 * (2 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1))
    groups = {"a": updyn.Group(K, np.eye(3), loss_factor=0.02)}
    return updyn.Model.from_groups(groups, LABELS, geometry=geometry())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("shapes")
    frf = updyn.response(model(), [5.0, 10.0, 15.0], LABELS, ["1:Z", "3:Z"], "mobility")
    updyn.write_frf(replace(frf, geometry=None), path / "bare.npz")
    updyn.write_frf(frf, path / "test.uff")
    updyn.write_model(model(), path / "model.h5")
    computed = updyn.modes(model(), 3)
    modes = updyn.ModeSet(computed.frequency, computed.shapes, LABELS, computed.loss_factor)
    updyn.write_modes(modes, path / "bare.unv")
    updyn.write_modes(modes, path / "modes.unv", geometry=geometry())
    (path / "nodes.csv").write_text("node,x,y,z\n1,0,0,0\n2,0,1,0\n3,0,2,0\n")
    return path


def test_modes_of_a_file_with_its_geometry(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "modes.gif"
    assert main(["shapes", str(folder / "modes.unv"), str(out), *QUICK]) == 0
    assert "written from ModeSet(3 modes at 3 DOFs" in capsys.readouterr().out
    with Image.open(out) as image:
        assert image.n_frames >= 6  # equal frames are one
    assert main(["shapes", str(folder / "modes.unv"), str(out)]) == 2
    assert "--force writes over it" in capsys.readouterr().err


def test_modes_of_a_model_by_number(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "modes.unv"
    words = ["--mode", "3", "--mode", "1", "--option", "dataset=2414"]
    assert main(["shapes", str(folder / "model.h5"), str(out), *words]) == 0
    expected = updyn.modes(model(), 3).frequency[[0, 2]]
    assert updyn.read_modes(out).frequency == pytest.approx(expected, rel=1e-5)
    assert b"\n  2414\n" in out.read_bytes()


def test_an_operating_shape_of_frfs(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "shape.unv"
    words = ["--freq", "9.0", "--reference", "3:Z"]
    assert main(["shapes", str(folder / "test.uff"), str(out), *words]) == 0
    assert "Operating shape, mobility" in out.read_text()
    assert "Frequency   1.00000E+01 reference 3:Z" in out.read_text()


def test_the_geometry_of_another_file(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "modes.unv"
    words = ["--structure", str(folder / "nodes.csv"), "--unit", "mm"]
    assert main(["shapes", str(folder / "bare.unv"), str(out), *words]) == 0
    assert updyn.read_geometry(out).xyz[2].tolist() == [0, 0.002, 0]
    words = ["--structure", str(folder / "model.h5")]
    assert main(["shapes", str(folder / "bare.unv"), str(out), *words, "--force"]) == 0
    assert updyn.read_geometry(out).lines.tolist() == [[1, 2], [2, 3]]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["bare.unv", "out.gif"], "name the file of the model or of a geometry with --structure"),
        (["bare.npz", "out.gif", "--freq", "5", "--reference", "3:Z"], "has no positions of nodes"),
        (["modes.unv", "out.gif", "--mode", "4"], "--mode 4: there are modes 1 to 3"),
        (["modes.unv", "out.gif", "--mode", "0"], "--mode 0: there are modes 1 to 3"),
        (["test.uff", "out.gif"], "freq: expected the frequency of an operating shape, 5 to 15 Hz"),
        (["test.uff", "out.gif", "--mode", "1"], "an operating shape is chosen by --freq"),
        (["test.uff", "out.gif", "--freq", "5"], "expected one of 1:Z, 3:Z"),
        (["modes.unv", "out.csv"], "can write_shapes"),
        (["modes.unv", "modes.unv"], "is the file to read"),
        (["modes.unv", "out.gif", "--option", "scael=2"], "did you mean 'scale'"),
    ],
)
def test_refused(
    folder: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(folder)
    before = sorted(folder.iterdir())
    assert main(["shapes", *words]) == 2
    assert message in capsys.readouterr().err
    assert sorted(folder.iterdir()) == before
