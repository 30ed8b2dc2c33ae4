"""docs/formats.md against the registry, and what it shows against the readers."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from places import ROOT
from updyn.cli import main
from updyn.errors import FormatError
from updyn.io import read_frf, read_geometry, read_model
from updyn.io.formats import FORMATS, Format, load
from updyn.job import load_job, prepare

TEXT = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
ROW = re.compile(
    r"^\| \[`(\w+)`\]\(#(\w+)\) \| ([^|]*) \| ([^|]*) \| ([^|]*) \| ([^|]*) \| ([^|]*) \|$",
    re.MULTILINE,
)


def section(name: str) -> str:
    return TEXT.split(f'<a id="{name}"></a>')[1].split("\n<a id=")[0]


def block(name: str, language: str) -> str:
    found = re.search(rf"```{language}\n(.*?)```", section(name), re.DOTALL)
    assert found is not None
    return found[1]


def test_the_formats_are_those_of_the_registry_in_order() -> None:
    assert [m[1] for m in ROW.finditer(TEXT)] == [f.name for f in FORMATS.values()]


@pytest.mark.parametrize("known", tuple(FORMATS.values()), ids=lambda f: f.name)
def test_suffixes_and_abilities(known: Format) -> None:
    row = next(m for m in ROW.finditer(TEXT) if m[1] == known.name)
    assert row[2] == known.name
    assert tuple(re.findall(r"`(\.\w+)`", row[3])) == known.suffixes
    for cell, ability in (
        (row[4], "frf"),
        (row[5], "model"),
        (row[6], "geometry"),
        (row[7], "records"),
    ):
        said = (
            set()
            if cell.strip() == "-"
            else {f"{word}_{ability}" for word in cell.strip().split(", ")}
        )
        assert said == {c for c in known.can if c.endswith(ability)}
    assert section(known.name).startswith(f"\n## `{known.name}`")


@pytest.mark.parametrize(
    "known", [f for f in FORMATS.values() if "read_frf" in f.can], ids=lambda f: f.name
)
def test_every_option_of_reading_is_named(known: Format) -> None:
    signature = inspect.signature(load(known).read_frf)
    options = {n for n, p in signature.parameters.items() if p.kind is p.KEYWORD_ONLY}
    if known.name == "mat":  # "as npz"
        npz = load(next(f for f in FORMATS.values() if f.name == "npz"))
        assert options == set(inspect.signature(npz.read_frf).parameters) - {"path"}
        return
    if known.name != "uff":
        options -= {"duplicates"}  # takes "raise" only
    assert all(f"`{name}`" in section(known.name) for name in options)


def test_the_table_is_read(tmp_path: Path) -> None:
    path = tmp_path / "test.csv"
    path.write_text(block("csv", "text"), encoding="utf-8")
    frf = read_frf(path)
    np.testing.assert_array_equal(frf.values[:, 0, 0], [0.12 - 0.03j, 0.13 - 0.04j])
    assert (frf.quantity, frf.averages, frf.responses.labels, frf.references.labels) == (
        "accelerance",
        12,
        ["3:Z"],
        ["1:X"],
    )
    assert frf.coherence is not None
    np.testing.assert_array_equal(frf.coherence[:, 0, 0], [0.98, 0.97])


def test_the_table_must_say_or_be_told_what_it_holds(tmp_path: Path) -> None:
    path = tmp_path / "silent.csv"
    path.write_text(block("csv", "text").split("\n", 1)[1], encoding="utf-8")
    with pytest.raises(FormatError, match="does not state the measured quantity"):
        read_frf(path)
    assert read_frf(path, quantity="mobility").quantity == "mobility"


def test_the_geometry_table_is_read(tmp_path: Path) -> None:
    header = re.search(r"`(xx,[xyz,]*)`", section("csv"))
    assert header is not None
    path = tmp_path / "nodes.csv"
    path.write_text(f"node,x,y,z,{header[1]}\n7,1,2,3,0,1,0,-1,0,0,0,0,1\n", encoding="utf-8")
    geometry = read_geometry(path)
    assert geometry.axes is not None
    np.testing.assert_array_equal(geometry.xyz, [[1.0, 2.0, 3.0]])
    np.testing.assert_array_equal(geometry.axes[0], [[0, 1, 0], [-1, 0, 0], [0, 0, 1]])


def test_the_matrix_market_model_is_read(tmp_path: Path) -> None:
    (tmp_path / "case.toml").write_text(block("mtx", "toml"), encoding="utf-8")
    (tmp_path / "dofs.csv").write_text("dof\n1:X\n1:Y\n", encoding="utf-8")
    (tmp_path / "nodes.csv").write_text("node,x,y,z\n1,0,0,0\n2,1,0,0\n3,0,1,0\n", encoding="utf-8")
    (tmp_path / "lines.csv").write_text("from,to\n1,2\n", encoding="utf-8")
    (tmp_path / "faces.csv").write_text("a,b,c,d\n1,2,3,3\n", encoding="utf-8")
    for name, diagonal in (("K", [3.0, 5.0]), ("M", [1.0, 2.0])):
        scipy.io.mmwrite(tmp_path / f"{name}_housing.mtx", np.diag(diagonal))
    model = read_model(tmp_path / "case.toml")
    assert (model.title, model.dofs.labels, model.groups["housing"].loss_factor) == (
        "Gear case",
        ["1:X", "1:Y"],
        0.02,
    )
    np.testing.assert_array_equal(model.groups["housing"].stiffness.toarray(), np.diag([3.0, 5.0]))
    assert model.geometry is not None
    np.testing.assert_array_equal(model.geometry.lines, [[1, 2]])
    np.testing.assert_array_equal(model.geometry.faces, [[1, 2, 3, 3]])
    with pytest.raises(FormatError, match="one matrix is not a model"):
        read_model(tmp_path / "K_housing.mtx")


def test_names_of_the_archive_are_read(tmp_path: Path) -> None:
    K, M = np.diag([3.0, 5.0]), np.diag([1.0, 2.0])
    np.savez(tmp_path / "one.npz", K=K, M=M, loss_factor=0.01, dofs=["1:X", "2:X"])
    assert list(read_model(tmp_path / "one.npz").groups) == ["model"]
    arrays = {"a.K": K, "b.M": M, "b.K": K, "a.loss_factor": 0.1}
    np.savez(tmp_path / "two.npz", dofs=np.array([[1, 1], [2, 4]]), groups=["b", "a"], **arrays)
    model = read_model(tmp_path / "two.npz")
    assert (list(model.groups), model.dofs.labels) == (["b", "a"], ["1:X", "2:RX"])
    bare = np.arange(12).reshape(2, 3, 2) * (1 + 1j)
    np.savez(tmp_path / "bare.npz", freq=[1.0, 2.0, 3.0], H=bare)
    frf = read_frf(
        tmp_path / "bare.npz",
        quantity="mobility",
        response_labels=["1:X", "2:-X"],
        reference_labels=["1:X", "2:X"],
        order=["response", "freq", "reference"],
    )
    np.testing.assert_array_equal(frf.values, bare.transpose(1, 0, 2))


def test_matlab_names_of_the_page_are_read(tmp_path: Path) -> None:
    page = block("mat", "matlab")
    saved = [re.findall(r"'(\w+)'", line) for line in page.splitlines() if line.startswith("save")]
    K = np.diag([3.0, 5.0, 7.0, 9.0])
    cells = {
        name: np.array(re.findall(r"'([^']*)'", found), dtype=object)[:, None]
        for name, found in re.findall(r"(\w+) = (\{[^}]*\})", page)
    }
    values = {
        "K": K,
        "M": K,
        "loss_factor": 0.01,
        "freq": np.array([[1.0], [2.0]]),
        "quantity": "accelerance",
        **cells,
    }
    values["H"] = np.array([[1 + 1j, 2], [3, 4]])
    for names, file in zip(saved, ("model.mat", "test.mat"), strict=True):
        scipy.io.savemat(tmp_path / file, {name: values[name] for name in names})
    assert read_model(tmp_path / "model.mat").dofs.labels == ["1:Z", "1:RY", "2:Z", "2:RY"]
    frf = read_frf(tmp_path / "test.mat")
    assert frf.responses.labels == ["5:Z", "9:-Z"]
    np.testing.assert_array_equal(frf.values[:, :, 0], values["H"])


def test_a_universal_file_in_g_is_converted_and_one_in_volts_is_scaled(
    chain_inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    raw = (chain_inputs / "chain.uff").read_bytes()
    assert b" m/s^2 " in raw
    expected = read_frf(chain_inputs / "chain.uff").values * 9.80665
    file = tmp_path / "g.uff"
    file.write_bytes(raw.replace(b" m/s^2 ", b" g     "))
    np.testing.assert_array_equal(read_frf(file).values, expected)
    file.write_bytes(raw.replace(b" m/s^2 ", b" mV    "))
    assert main(["convert", str(file), str(tmp_path / "si.npz")]) == 2
    assert "unit 'mV' of the acceleration is not known" in capsys.readouterr().err
    assert main(["convert", str(file), str(tmp_path / "si.npz"), "--scale", "9.80665"]) == 0
    np.testing.assert_array_equal(read_frf(tmp_path / "si.npz").values, expected)
    job = (
        (chain_inputs / "job.toml")
        .read_text(encoding="utf-8")
        .replace('"chain.h5"', f'"{chain_inputs}/chain.h5"')
    )
    (tmp_path / "job.toml").write_text(
        job.replace('"chain.uff"', '"g.uff"\nscale = 9.80665'), encoding="utf-8"
    )
    np.testing.assert_array_equal(prepare(load_job(tmp_path / "job.toml")).frf.values, expected)
