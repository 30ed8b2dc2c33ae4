"""Jobs, commands and code of docs/formats.md run on files of their layout, and give their values."""

from __future__ import annotations

import re
import shlex
import tomllib
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
import scipy.io
import scipy.io.wavfile
from nptdms import ChannelObject, TdmsWriter

import updyn
from pages import blocks, run_python
from places import ROOT
from updyn.cli import main
from updyn.elements.beam import Segment, beam
from updyn.plots import animation

PAGE = ROOT / "docs" / "formats.md"
TEXT = PAGE.read_text(encoding="utf-8")
FREQ = np.linspace(10.0, 50.0, 5)
H = np.outer(FREQ - 20.0, [1.0, -2.0]) + 1j * np.outer(FREQ, [0.5, 1.0])


def find_blocks(anchor: str, *languages: str) -> list[str]:
    """Return the texts of the blocks between an anchor and the next one."""
    section = TEXT.split(f'<a id="{anchor}"></a>')[1].split("\n<a id=")[0]
    names = "|".join(languages)
    return re.findall(rf"```(?:{names})\n(.*?)```", section, re.DOTALL)


def read_test(anchor: str, number: int = 0) -> updyn.FRF:
    """Return the FRF of the table `[test]` that the page shows."""
    table: dict[str, Any] = tomllib.loads(find_blocks(anchor, "toml")[number])["test"]
    return updyn.read_frf(table.pop("file"), **table)


@pytest.fixture(autouse=True)
def _in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_columns() -> None:
    rows = ["Freq (Hz);Re 3;Im 3;Coh 3;Re 5;Im 5;Coh 5"]
    for f, (a, b) in zip(FREQ, H, strict=True):
        rows.append(f"{f};{a.real};{a.imag};0.9;{b.real};{b.imag};0.8")
    Path("export.txt").write_text("\n".join(rows) + "\n", encoding="utf-8")
    frf = read_test("columns")
    np.testing.assert_array_equal(frf.freq, FREQ)
    np.testing.assert_allclose(frf.values[:, :, 0], H, rtol=1e-12)
    np.testing.assert_array_equal(frf.coherence[:, :, 0], np.tile([0.9, 0.8], (5, 1)))
    assert frf.responses.labels == ["3:Z", "5:Z"]


def test_one_file_per_point(capsys: pytest.CaptureFixture[str]) -> None:
    for name, values in zip(("2X", "5X"), H.T, strict=True):
        rows = [f"{f} {v.real} {v.imag}" for f, v in zip(FREQ, values, strict=True)]
        Path(f"hit_{name}.txt").write_text("\n".join(rows) + "\n", encoding="utf-8")
    frf = read_test("point-files")
    assert frf.responses.labels == ["2:X", "5:X"]
    np.testing.assert_allclose(frf.values[:, :, 0], H, rtol=1e-12)
    (command,) = find_blocks("point-files", "console")
    words = shlex.split(command)
    assert words[0] == "updyn"
    assert main(words[1:]) == 0
    said = capsys.readouterr().out
    assert "2 responses" in said


def test_variables() -> None:
    run = {"H1": H[:, :, None], "coh": np.full((5, 2, 1), 0.7)}
    scipy.io.savemat("frf.mat", {"f": FREQ[:, None], "result": run})
    frf = read_test("variables")
    np.testing.assert_array_equal(frf.values[:, :, 0], H)
    np.testing.assert_array_equal(frf.coherence, np.full((5, 2, 1), 0.7))
    assert frf.responses.labels == ["3:Z", "5:Z"]


def test_a_table_with_the_frequency_in_its_first_column() -> None:
    text = re.search(r"^`(variables = \{ freq = \"data.*\})`", TEXT, re.MULTILINE)
    assert text is not None
    scipy.io.savemat("frf.mat", {"data": np.column_stack([FREQ, H[:, 0]])})
    given = tomllib.loads(text[1])
    labels = {"response_labels": ["3:Z"], "reference_labels": ["1:Z"]}
    frf = updyn.read_frf("frf.mat", quantity="accelerance", **labels, **given)
    np.testing.assert_array_equal(frf.values[:, 0, 0], H[:, 0])


def test_a_model_in_variables() -> None:
    K = np.array([[2.0, -1.0], [-1.0, 2.0]])
    content = {"M0": np.eye(2), "K_1": K, "K_2": 3.0 * K, "dofs": np.array([[1, 3], [2, 3]])}
    scipy.io.savemat("work.mat", content)
    table = tomllib.loads(find_blocks("mat", "toml")[0])["model"]
    model = updyn.read_model(table.pop("file"), **table)
    assert list(model.groups) == ["K_1", "K_2", "model"]
    np.testing.assert_array_equal(model.groups["K_2"].stiffness.toarray(), 3.0 * K)
    np.testing.assert_array_equal(model.groups["model"].mass.toarray(), np.eye(2))


def test_the_excitation_of_a_wav_file_has_its_full_scale() -> None:
    (text,) = find_blocks("wav", "text")
    rate, number = 1024, 2048
    hit = np.zeros(number)
    hit[10:14] = [0.1, 0.5, 0.4, 0.1]
    answer = np.convolve(hit, 0.5 ** np.arange(12))[:number]
    samples = np.round(np.column_stack([hit, answer]) * 0.5 * 2**31).astype(np.int32)
    scipy.io.wavfile.write("hit.wav", rate, samples)
    Path("records.toml").write_text(text, encoding="utf-8")
    assert main(["frf", "records.toml"]) == 0
    frf = updyn.read_frf("test.uff")
    exact = 1.0 / (1.0 - 0.5 * np.exp(-2j * np.pi * frf.freq / rate))
    exact *= 50.0 * 9.80665 / 2200.0
    at = (frf.freq > 1.0) & (frf.freq < 300.0)
    np.testing.assert_allclose(frf.values[at, 0, 0], exact[at], rtol=2e-3)


def test_groups_of_a_tdms_file_are_hits() -> None:
    (text,) = find_blocks("tdms", "text")
    rate, number = 1024, 2048
    with TdmsWriter("hits.tdms") as writer:
        for name, level in (("hit 1", 1.0), ("hit 2", 2.0), ("hit 3", 1.5)):
            hit = np.zeros(number)
            hit[10:14] = level * np.array([0.1, 0.5, 0.4, 0.1])
            answer = 7.0 * np.convolve(hit, 0.5 ** np.arange(12))[:number]
            for channel, unit, values in (("hammer", "N", hit), ("3:Z", "m/s^2", answer)):
                given = {"wf_increment": 1.0 / rate, "wf_start_offset": 0.0, "unit_string": unit}
                writer.write_segment([ChannelObject(name, channel, values, given)])
    Path("records.toml").write_text(text, encoding="utf-8")
    assert main(["frf", "records.toml"]) == 0
    frf = updyn.read_frf("test.uff")
    assert frf.responses.labels == ["3:Z"]
    exact = 7.0 / (1.0 - 0.5 * np.exp(-2j * np.pi * frf.freq / rate))
    at = (frf.freq > 1.0) & (frf.freq < 300.0)
    np.testing.assert_allclose(frf.values[at, 0, 0], exact[at], rtol=2e-3)


def test_a_table_of_records() -> None:
    text = next(block for block in find_blocks("csv", "text") if "hammer" in block)
    Path("hits.csv").write_text(text, encoding="utf-8")
    records = updyn.read_records("hits.csv")
    assert records.channel.values.tolist() == ["hammer", "3:Z"]
    assert records.unit.values.tolist() == ["N", "g"]
    exact = [[0.1, 35.2, 28.9], [-0.02, 0.31, 0.87]]
    np.testing.assert_allclose(records.values[0], exact)
    np.testing.assert_allclose(records.time.values, [0.0, 1e-3, 2e-3])


# -- shapes ----------------------------------------------------------------------------------------
@pytest.fixture
def namespace(no_causes: None) -> dict[str, Any]:
    """The objects of the blocks on shapes: a beam, its result, its modes and FRFs at four nodes."""
    size = {"length": 1.0, "E": 7e10, "rho": 2700.0, "width": 0.03, "height": 0.01}
    segments = [Segment("a", 0.0, 0.5), Segment("b", 0.5, 1.0)]
    model = beam(**size, n_elements=8, segments=segments)
    sensors = ["1:Z", "3:Z", "6:Z", "9:Z"]
    unknowns = updyn.parameters(model, stiffness="all")
    frf = updyn.response(model.scaled({"b": {"stiffness": 1.1}}), FREQ, sensors, ["1:Z"])
    modes = updyn.modes(model, 5).select(np.arange(2, 5))
    measured = updyn.ModeSet(modes.frequency, modes.at(sensors), sensors)
    result = updyn.update(model, frf, unknowns)
    rows = [f"{n},{x},{y},{z}" for n, (x, y, z) in _positions(model, (1, 3, 6, 9))]
    Path("nodes.csv").write_text("\n".join(["node,x,y,z", *rows]) + "\n", encoding="utf-8")
    return {
        "updyn": updyn,
        "model": model,
        "modes": measured,
        "frf": frf,
        "result": result,
        "geometry": updyn.read_geometry("nodes.csv"),
    }


def _positions(model: updyn.Model, nodes: tuple[int, ...]) -> list[tuple[int, np.ndarray]]:
    assert model.geometry is not None
    return list(zip(nodes, model.geometry.position(nodes), strict=True))


@pytest.fixture
def few_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    """Animations have six frames a period instead of 24: drawing one takes 50 ms."""
    monkeypatch.setitem(animation.write_shapes.__kwdefaults__, "frames", 6)


@pytest.mark.usefixtures("few_frames")
def test_shapes_are_written(namespace: dict[str, Any]) -> None:
    written = set()
    for block in blocks(PAGE):
        if block.language == "python" and "write_shapes" in block.text:
            text = block.text.replace(".mp4", ".gif")  # without the program for films
            run_python(type(block)(block.language, text, block.line), "formats.md", namespace)
            written |= set(re.findall(r'"(\w+\.(?:unv|vtu|gif))"', text))
    assert written == {
        *("modes.unv", "computed.unv", "shape.unv", "updated.vtu"),
        *("modes.gif", "mode3.gif", "operating.gif"),
    }
    np.testing.assert_allclose(
        updyn.read_modes("modes.unv").frequency, namespace["modes"].frequency, rtol=1e-4
    )
    mesh = meshio.read("updated.vtu")
    factors = np.concatenate(mesh.cell_data["stiffness factor"])
    np.testing.assert_allclose(np.unique(np.round(factors, 4)), [1.0, 1.1], atol=1e-3)
    for name in written:
        if name.endswith(".gif"):
            assert Path(name).read_bytes().startswith(b"GIF89a")


@pytest.mark.usefixtures("few_frames")
def test_commands_on_shapes_run(namespace: dict[str, Any]) -> None:
    """The four lines of docs/job.md, with files of their names."""
    page = (ROOT / "docs" / "job.md").read_text(encoding="utf-8")
    lines = re.findall(r"^updyn shapes .*$", page, re.MULTILINE)
    assert len(lines) == 4
    Path("job-modes").mkdir()
    updyn.write_modes(namespace["modes"], "job-modes/modes.unv", geometry=namespace["geometry"])
    updyn.write_model(namespace["model"], "model.h5")
    updyn.write_frf(namespace["frf"], "test.uff")
    Path("job").mkdir()
    updyn.write_result(namespace["result"], "job/run.nc")
    for line in lines:
        words = shlex.split(line.replace("model.bdf", "model.h5").replace(".mp4", ".gif"))
        assert main(words[1:]) == 0, line
        out = next(word for word in words if re.search(r"\.(gif|vtu)$", word))
        assert Path(out).stat().st_size > 1000
