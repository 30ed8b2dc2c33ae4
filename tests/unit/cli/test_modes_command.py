"""`updyn modes`: the table, both files, modes picked by the job, and what is refused with its line."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import updyn
from updyn.cli import main
from updyn.demos import chain
from updyn.io import read_modes
from updyn.modal import ModeSet
from updyn.report.formats import number

JOB = """\
[model]
file = "chain.h5"

[test]
file = "chain.uff"

[[parameter]]
groups = "part*"
quantity = "stiffness"
"""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("chain")
    chain.write_inputs(folder)
    text = (folder / "job.toml").read_text(encoding="utf-8")
    measured = next(
        line for line in text.splitlines() if line.startswith("file =") and "uff" in line
    )
    (folder / "modes.toml").write_text(
        JOB.replace('file = "chain.uff"', measured), encoding="utf-8"
    )
    return folder


def job(inputs: Path, further: str = "") -> Path:
    path = inputs / "picked.toml"
    text = (inputs / "modes.toml").read_text(encoding="utf-8")
    path.write_text(text + further, encoding="utf-8")
    return path


def measured(inputs: Path) -> ModeSet:
    (path,) = inputs.glob("*.uff")
    return updyn.identify_modes(updyn.read_frf(path))


def embedded(page: str, name: str) -> Any:
    return json.loads(re.search(rf'id="{name}">(.*?)</script>', page)[1])


def test_both_files_and_the_table(
    inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["modes", str(job(inputs)), "--out", str(tmp_path / "out")]) == 0
    found = measured(inputs)
    said = capsys.readouterr().out
    assert f"Modes: {len(found)} from" in said
    files = {p.name for p in (tmp_path / "out").iterdir()}
    assert files == {"modes.html", "modes.unv", "manifest.json"}
    written = read_modes(tmp_path / "out" / "modes.unv")
    assert written.frequency == pytest.approx(found.frequency, rel=1e-5)
    assert written.std_frequency == pytest.approx(found.std_frequency, rel=1e-5)
    scale = np.abs(found.real_shapes).max()
    assert written.std_shapes == pytest.approx(found.std_shapes, rel=1e-5, abs=1e-6 * scale)
    page = (tmp_path / "out" / "modes.html").read_text(encoding="utf-8")
    share = np.linalg.norm(found.std_shapes, axis=0) / np.linalg.norm(found.real_shapes, axis=0)
    first = [text.strip() for text in re.findall(r"<td[^>]*>(.*?)</td>", page, re.DOTALL)[:7]]
    assert first[4] == f"{number(100 * float(share[0]), 2)} %"
    modes = embedded(page, "updyn-picks")["modes"]
    assert [mode["f"] for mode in modes] == pytest.approx(found.frequency.tolist())
    traces = [trace["name"] for trace in embedded(page, "updyn-figures")["picker"]["data"]]
    assert set(traces) >= {"pole stable", "pole new in this order", "CMIF"}


def test_the_job_picks(inputs: Path, tmp_path: Path) -> None:
    found = measured(inputs).frequency
    pick = f"\n[modes]\npick = [{1.003 * found[2]:.6g}, {found[0]:.6g}]\n"
    assert main(["modes", str(job(inputs, pick)), "--out", str(tmp_path / "out")]) == 0
    written = read_modes(tmp_path / "out" / "modes.unv")
    assert written.frequency == pytest.approx(found[[0, 2]], rel=1e-5)


def test_a_measurement_is_enough(
    inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Other commands still say what is missing; what the job has is still checked."""
    text = (inputs / "modes.toml").read_text(encoding="utf-8")
    test = text[text.index("[test]") : text.index("[[parameter]]")]
    path = inputs / "bare.toml"
    path.write_text(test, encoding="utf-8")
    assert main(["modes", str(path), "--out", str(tmp_path / "out")]) == 0
    written = read_modes(tmp_path / "out" / "modes.unv")
    assert written.frequency == pytest.approx(measured(inputs).frequency, rel=1e-5)
    capsys.readouterr()
    assert main(["check", str(path)]) == 2
    said = capsys.readouterr().err
    assert "missing key 'model'" in said
    assert "missing key 'parameter'" in said
    for wrong, message in (
        ("[modle]\nfile = 'a.h5'\n" + test, "bare.toml:1: unknown key 'modle'"),
        ("[modes]\n", "missing key 'test'"),
        ("[model]\n" + test, "bare.toml:1: [model] needs a file, or a kind"),
    ):
        path.write_text(wrong, encoding="utf-8")
        assert main(["modes", str(path), "--out", str(tmp_path / "other")]) == 2
        assert message in capsys.readouterr().err
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize(
    ("further", "fragment"),
    [
        ("[modes]\npick = [0.2]\n", "no mode is found within 2 % of 0.2 Hz; the nearest is at"),
        ("[modes]\npick = []\n", "expected an array of frequencies in Hz"),
        ('[modes]\ndamping = "viscos"\n', "viscous"),
        ("[modes]\npicks = [1.0]\n", "pick"),
    ],
)
def test_what_is_refused(
    inputs: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    further: str,
    fragment: str,
) -> None:
    path = job(inputs, "\n" + further)
    assert main(["modes", str(path), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert fragment in said
    assert "picked.toml:" in said
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def weak(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, float, float]:
    """A job whose second mode moves by a thousandth of the others; a pole of it and of the first."""
    folder = tmp_path_factory.mktemp("weak")
    freq = np.linspace(0.5, 100.0, 400)
    lines = (2 * np.pi * freq)[:, None]
    natural, loss = 2 * np.pi * np.array([20.0, 31.0, 58.0]), np.array([0.01, 0.012, 0.02])
    rng = np.random.default_rng(2)
    signs = np.array([[1, 1, 1, -1, 1, -1], [1, -1, 1, 1, -1, -1], [1, 1, -1, 1, -1, 1]])
    H = (-(lines**2) / (natural**2 * (1 + 1j * loss) - lines**2)) @ (signs.T * [1, 1e-3, 1]).T
    noise = rng.standard_normal((2, *H.shape, 2)) @ (1, 1j)
    H = H * (1 + 3e-5 * noise[0]) + 3e-5 * noise[1]
    labels = [f"{k}:Z" for k in range(1, 7)]
    frf = updyn.FRF(freq, H[:, :, None], labels, ["9:Z"], "accelerance")
    updyn.write_frf(frf, folder / "test.npz")
    diagram = updyn.identify_modes(updyn.read_frf(folder / "test.npz")).diagram
    stable = diagram.frequency[diagram.stable]
    poles = [float(stable[np.abs(stable / f - 1.0) < 5e-3][-1]) for f in (31.0, 20.0)]
    return folder, poles[0], poles[1]


def picking(folder: Path, *picks: str) -> Path:
    path = folder / "job.toml"
    path.write_text(
        f'[test]\nfile = "test.npz"\n\n[modes]\npick = [{", ".join(picks)}]\n', encoding="utf-8"
    )
    return path


def test_a_pole_that_is_clicked_becomes_a_mode(
    weak: tuple[Path, float, float], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, pole, of_a_mode = weak
    path = picking(folder, f"{pole:.7g}", f"{of_a_mode:.7g}")
    assert main(["modes", str(path), "--out", str(folder / "out")]) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert f"The pole at {pole:.6g} Hz is refined to a mode at 31" in said
    assert "with 0.6 % (" in said
    written = read_modes(folder / "out" / "modes.unv")
    assert written.frequency == pytest.approx([20.0, 31.0], rel=3e-4)
    assert written.loss_factor == pytest.approx([0.01, 0.012], rel=0.05)


def test_a_pole_is_meant_only_as_it_was_clicked(
    weak: tuple[Path, float, float], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, pole, _ = weak
    for picks, message in (
        (["31.1"], "no mode is found within 2 % of 31.1 Hz; the nearest is at 20"),
        (["31.1"], "the nearest stable pole of the diagram at 31."),
        ([f"{pole:.7g}"] * 2, f"two picks are the pole at {pole:.6g} Hz; leave one"),
    ):
        assert main(["modes", str(picking(folder, *picks)), "--out", str(folder / "no")]) == 2
        said = capsys.readouterr().err
        assert message in said
        assert "job.toml:5: " in said
    assert not (folder / "no").exists()


def test_a_mode_is_picked_twice(inputs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    f = float(measured(inputs).frequency[0])
    path = job(inputs, f"\n[modes]\npick = [{f:.6g}, {1.001 * f:.6g}]\n")
    assert main(["modes", str(path)]) == 2
    assert "two picks are nearest to the mode at" in capsys.readouterr().err


@pytest.fixture
def hidden(tmp_path: Path) -> Path:
    """Two modes, and one line at 300 Hz that is a disturbance."""
    freq = np.linspace(0.5, 500.0, 1000)
    x = freq[:, None] ** 2
    rng = np.random.default_rng(3)
    values = 0.02 * (rng.standard_normal((1000, 2, 2)) @ (1, 1j))
    for f, loss, size in ((40.0, 0.02, 1.0), (190.0, 0.02, 1.0)):
        values += -x / (f**2 * (1 + 1j * loss) - x) * size * np.array([1.0, -0.7])
    values[599] += np.array([40.0, 30.0])  # 300 Hz, one line
    frf = updyn.FRF(freq, values[:, :, None], ["1:Z", "2:Z"], ["1:Z"], "accelerance")
    updyn.write_frf(frf, tmp_path / "test.npz")
    return tmp_path


def test_a_peak_without_a_mode_is_named_and_drawn(
    hidden: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = hidden / "modes.toml"
    path.write_text('[test]\nfile = "test.npz"\n', encoding="utf-8")
    assert main(["modes", str(path), "--out", str(hidden / "out")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "Peak without a mode: 300 Hz; [modes] poles makes modes of them." in said
    page = (hidden / "out" / "modes.html").read_text(encoding="utf-8")
    assert embedded(page, "updyn-picks")["peaks"] == pytest.approx([300.0])
    assert "Peak without a mode: 300 Hz." in page


def test_a_peak_without_a_mode_is_picked_by_its_frequency(
    hidden: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """To 2 %, as a mode; further away it is named."""
    assert main(["modes", str(picking(hidden, "299.0")), "--out", str(hidden / "out")]) == 0
    assert "The pole at 300 Hz is refined to a mode" in " ".join(capsys.readouterr().err.split())
    found = read_modes(hidden / "out" / "modes.unv")
    assert found.frequency == pytest.approx([300.0], rel=2e-3)
    assert main(["modes", str(picking(hidden, "320.0")), "--out", str(hidden / "no")]) == 2
    assert "the nearest peak without a mode at 300 Hz" in " ".join(capsys.readouterr().err.split())


def with_poles(folder: Path, *rows: str) -> Path:
    path = folder / "poles.toml"
    rows_ = "\n".join(rows)
    path.write_text(f'[test]\nfile = "test.npz"\n\n[modes]\n{rows_}\n', encoding="utf-8")
    return path


def test_a_mode_is_added_at_any_frequency(
    weak: tuple[Path, float, float], capsys: pytest.CaptureFixture[str]
) -> None:
    """The weak mode at 31 Hz, from a frequency beside it; the others stay unless some are picked."""
    folder, _, _ = weak
    found = updyn.identify_modes(updyn.read_frf(folder / "test.npz"))
    assert np.abs(found.frequency - 31.0).min() > 5.0
    path = with_poles(folder, "poles = [31.05]")
    assert main(["modes", str(path), "--out", str(folder / "out")]) == 0
    assert "The pole at 31.05 Hz is refined to a mode" in " ".join(capsys.readouterr().err.split())
    written = read_modes(folder / "out" / "modes.unv")
    assert written.frequency == pytest.approx([20.0, 31.0, 58.0], rel=3e-4)
    page = embedded((folder / "out" / "modes.html").read_text(encoding="utf-8"), "updyn-picks")
    assert [mode["pole"] for mode in page["modes"]] == [None, 31.05, None]

    path = with_poles(folder, "pick = [58.3]", "poles = [31.05]")
    assert main(["modes", str(path), "--out", str(folder / "out")]) == 0
    written = read_modes(folder / "out" / "modes.unv")
    assert written.frequency == pytest.approx([31.0, 58.0], rel=3e-4)
    page = embedded((folder / "out" / "modes.html").read_text(encoding="utf-8"), "updyn-picks")
    shown = {round(mode["f"]): mode["on"] for mode in page["modes"]}
    assert shown == {31: True, 58: True, 20: False}


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("poles = [101.0]", "101 Hz is not within the band, 0.5 to 100 Hz"),
        ("poles = [31.05, 31.05]", "two are the pole at 31.05 Hz; leave one"),
        ("poles = 31.05", "expected an array of frequencies in Hz"),
    ],
)
def test_poles_that_are_no_modes_are_refused_with_their_line(
    weak: tuple[Path, float, float],
    capsys: pytest.CaptureFixture[str],
    row: str,
    message: str,
) -> None:
    folder, _, _ = weak
    path = with_poles(folder, 'damping = "structural"', row)
    assert main(["modes", str(path), "--out", str(folder / "none")]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert message in said
    assert "poles.toml:6: " in said
    assert not (folder / "none").exists()


def test_the_file_has_the_geometry_of_the_test(inputs: Path, tmp_path: Path) -> None:
    (path,) = inputs.glob("*.uff")
    frf = updyn.read_frf(path)
    nodes = sorted({*frf.responses.nodes.tolist(), *frf.references.nodes.tolist()})
    placed = updyn.Geometry(nodes, np.outer(nodes, [1.0, 0.0, 0.5]), [nodes[:2]])
    updyn.write_frf(
        replace(frf, geometry=placed, variance=None, averages=None), tmp_path / path.name
    )
    text = (inputs / "modes.toml").read_text(encoding="utf-8")
    (tmp_path / "job.toml").write_text(text, encoding="utf-8")
    assert main(["modes", str(tmp_path / "job.toml"), "--out", str(tmp_path / "out")]) == 0
    found = updyn.read_geometry(tmp_path / "out" / "modes.unv")
    np.testing.assert_array_equal(found.xyz, placed.xyz)
    np.testing.assert_array_equal(found.lines, placed.lines)
