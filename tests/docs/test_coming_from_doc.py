"""docs/coming-from.md: its blocks run as printed on files as the other programs write them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import updyn
from pages import ROOT, blocks, run_python

PAGE = ROOT / "docs" / "coming-from.md"
#: Fields of the arrays that SDynPy 0.24 saves.
COORDINATE = [("node", "uint64"), ("direction", "int8")]
FREQ = 0.175 * np.arange(1, 401)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in an empty folder."""
    monkeypatch.chdir(tmp_path)


def run(section: str) -> dict[str, Any]:
    """Run the Python block of a section in the current folder; return its names."""
    text = PAGE.read_text(encoding="utf-8")
    start = text[: text.index(f'<a id="{section}"></a>')].count("\n")
    block = next(b for b in blocks(PAGE) if b.language == "python" and b.line > start)
    names: dict[str, Any] = {"__name__": "page"}
    run_python(block, PAGE.name, names)
    return names


@pytest.fixture
def model() -> updyn.Model:
    """Return three masses of 1, 2 and 3 kg on a line, with natural frequencies below 70 Hz."""
    k = 1e4 * np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    group = updyn.Group(k, np.diag([1.0, 2.0, 3.0]), 0.02)
    return updyn.Model.from_groups({"chain": group}, ["1:X", "2:X", "3:X"])


def coordinates(labels: list[tuple[int, int]]) -> np.ndarray:
    return np.array(labels, dtype=COORDINATE)


def test_arrays_of_sdynpy(model: updyn.Model) -> None:
    exact = updyn.response(model, FREQ, ["1:X", "2:-X", "3:X"], ["1:X", "3:X"], "accelerance")
    fields = [("abscissa", "f8", len(FREQ)), ("ordinate", "c16", len(FREQ))]
    saved = np.zeros((3, 2), dtype=[*fields, ("coordinate", COORDINATE, 2)])
    saved["abscissa"] = FREQ
    saved["ordinate"] = np.moveaxis(exact.values, 0, -1)
    saved["coordinate"][..., 0] = coordinates([(1, 1), (2, -1), (3, 1)])[:, None]
    saved["coordinate"][..., 1] = coordinates([(1, 1), (3, 1)])[None]
    np.savez("frfs.npz", data=saved, function_type=4)
    modes = updyn.modes(model, 3)
    fields = [("frequency", "f8"), ("damping", "f8"), ("shape_matrix", "f8", 3)]
    shapes = np.zeros(3, dtype=[*fields, ("coordinate", COORDINATE, 3)])
    shapes["frequency"], shapes["damping"] = modes.frequency, 0.01
    shapes["shape_matrix"] = np.real(modes.shapes).T
    shapes["coordinate"] = coordinates([(1, 1), (2, 1), (3, 1)])
    np.save("shapes.npy", shapes)
    names = run("sdynpy")
    test = names["test"]
    assert test.responses.labels == ["1:X", "2:-X", "3:X"]
    assert test.references.labels == ["1:X", "3:X"]
    np.testing.assert_array_equal(test.values, exact.values)
    np.testing.assert_allclose(names["modes"].loss_factor, 0.02)
    np.testing.assert_allclose(names["modes"].shapes, modes.shapes)


def test_arrays_of_pyfbs(model: updyn.Model) -> None:
    pd = pytest.importorskip("pandas")
    exact = updyn.response(model, FREQ, ["1:X", "2:X", "3:-X"], ["2:X"], "accelerance")
    np.save("Y.npy", exact.values)
    np.save("freq.npy", FREQ)
    columns = [f"{what}_{k}" for what in ("Position", "Direction") for k in (1, 2, 3)]
    rows = [[0.1, 0, 0, 1, 0, 0], [0.2, 0, 0, 1, 0, 0], [0.3, 0, 0, -1, 0, 0]]
    pd.DataFrame(rows, columns=columns).to_csv("channels.csv")
    pd.DataFrame(rows[1:2], columns=columns).to_csv("impacts.csv")
    test = run("pyfbs")["test"]
    assert test.responses.labels == ["1:X", "2:X", "3:-X"]
    assert test.references.labels == ["2:X"]
    np.testing.assert_allclose(test.geometry.position([3]), [[0.3, 0.0, 0.0]])
    np.testing.assert_array_equal(test.values, exact.values)


@pytest.mark.filterwarnings("ignore:f_upper:UserWarning")
def test_modes_of_sdypy_ema(model: updyn.Model) -> None:
    pytest.importorskip("sdypy.EMA", reason="needs sdypy-EMA")
    exact = updyn.response(model, FREQ, ["1:X", "2:X", "3:X"], ["1:X"], "accelerance")
    updyn.write_frf(exact, "test.unv")
    modes = run("sdypy")["modes"]
    expected = updyn.modes(model, 3)
    np.testing.assert_allclose(modes.frequency, expected.frequency, rtol=1e-3)
    np.testing.assert_allclose(modes.loss_factor, 0.02, rtol=0.02)


def small_plate() -> str:
    """Return a cantilever plate of two by two shells, of two properties."""
    lines = ["SPC = 1", "BEGIN BULK"]
    lines += [f"GRID,{10 * i + j + 1},,{0.1 * i},{0.1 * j},0." for i in range(3) for j in range(3)]
    for k, (i, j) in enumerate(((0, 0), (0, 1), (1, 0), (1, 1)), 1):
        a, b = 10 * i + j + 1, 10 * (i + 1) + j + 1
        lines.append(f"CQUAD4,{k},{i + 1},{a},{b},{b + 1},{a + 1}")
    lines += [f"PSHELL,{n},1,.002,1,,1" for n in (1, 2)]
    lines += ["MAT1,1,7.+10,,.3,2700.,,,.02", "SPC1,1,123456,1,2,3", "SPC1,1,6,11,THRU,23"]
    return "\n".join([*lines, "ENDDATA"]) + "\n"


@pytest.mark.needs("mystran")
def test_files_of_femtools() -> None:
    Path("plate.bdf").write_text(small_plate())
    truth = updyn.read_model("plate.bdf").scaled({"PSHELL 1": {"stiffness": 0.9}})
    sensors, lines = ["11:Z", "21:Z", "23:Z"], np.linspace(5.0, 300.0, 80)
    exact = updyn.response(truth, lines, sensors, ["23:Z"], "accelerance")
    # without geometry, whose faces a universal file cannot hold
    test = updyn.FRF(lines, exact.values, sensors, ["23:Z"], "accelerance")
    updyn.write_frf(test, "test.unv")
    result = run("femtools")["result"]
    assert result.values["PSHELL 1.stiffness"] == pytest.approx(0.9, rel=1e-3)
    assert result.values["PSHELL 2.stiffness"] == pytest.approx(1.0, rel=1e-3)
    assert Path("updated.bdf").exists()


def test_files_of_ansys() -> None:
    pytest.importorskip("ansys.mapdl.reader", reason="needs updyn[ansys]")
    import shutil

    from ansys.mapdl import reader as mapdl
    from ansys.mapdl.reader import examples

    from ansys_samples import beam_elements, write_emat

    mesh = mapdl.read_binary(examples.rstfile).mesh
    elements = beam_elements(mesh, 16.9e6, 0.31, 4.1408e-4)
    matrices = [(number, nodes, {"stiffness": K, "mass": M}) for number, nodes, K, M in elements]
    write_emat(Path("beam.emat"), matrices)
    shutil.copy(examples.fullfile, "beam.full")
    model = run("ansys")["model"]
    assert list(model.groups) == ["root", "tip"]
    assert updyn.read_frf("computed.unv").values.shape == (2, 3, 1)
