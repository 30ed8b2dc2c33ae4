"""The front doors of `updyn.io`: whatever goes wrong in a reader is an error of ours that names file and reader."""

import numpy as np
import pytest

import uff_samples as uff
import updyn
from updyn.cli import main
from updyn.errors import FormatError, OptionError, UpdynWarning
from updyn.io import matrix_market


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (IndexError("list index out of range"), r"cannot be read \(reader 'mtx'\): IndexError: list"),
        (KeyError("a"), r"cannot be read \(reader 'mtx'\): KeyError: 'a'$"),
        (RecursionError("too deep\nmore"), r"cannot be read \(reader 'mtx'\): RecursionError: too deep$"),
        (SystemError(), r"cannot be read \(reader 'mtx'\): SystemError$"),
        (MemoryError(), r"cannot be read \(reader 'mtx'\): out of memory$"),
        (PermissionError(13, "Permission denied"), r"m\.toml: cannot be read: Permission denied$"),
    ],
)  # fmt: skip
def test_what_a_reader_did_not_foresee(tmp_path, monkeypatch, error, message):
    def broken(path):
        raise error

    (tmp_path / "m.toml").write_text("x = 1\n")
    monkeypatch.setattr(matrix_market, "read_model", broken)
    with pytest.raises(FormatError, match=rf"m\.toml: .*{message}|{message}") as caught:
        updyn.read_model(tmp_path / "m.toml")
    assert caught.value.__cause__ is error


@pytest.mark.parametrize("error", [KeyboardInterrupt(), FormatError("ours"), UpdynWarning("told")])
def test_what_passes(tmp_path, monkeypatch, error):
    def broken(path):
        raise error

    (tmp_path / "m.toml").write_text("x = 1\n")
    monkeypatch.setattr(matrix_market, "read_model", broken)
    with pytest.raises(type(error)) as caught:
        updyn.read_model(tmp_path / "m.toml")
    assert caught.value is error


@pytest.mark.parametrize("read", [updyn.read_frf, updyn.read_model, updyn.read_geometry])
@pytest.mark.parametrize("name", ["n" * 300 + ".csv", "d" * 300 + "/a.csv", "a\0b.csv", "n" * 9999])
def test_names_that_no_file_can_have(tmp_path, read, name):
    with pytest.raises(FormatError, match=r"no such file|embedded null"):
        read(tmp_path / name)


@pytest.mark.parametrize("path", [None, 3, b"model.npz"])
@pytest.mark.parametrize("read", [updyn.read_frf, updyn.read_model, updyn.read_modes])
def test_what_is_no_path_is_refused(read, path):
    with pytest.raises(OptionError, match="path: expected the name of a file, found"):
        read(path)


def test_a_path_in_the_place_of_data_is_refused(tmp_path):
    frf = updyn.FRF([1.0], np.ones((1, 1, 1)), ["1:X"], ["1:X"], "mobility")
    with pytest.raises(OptionError, match="path: expected the name of a file, found FRF"):
        updyn.write_frf(tmp_path / "x.csv", frf)


@pytest.mark.parametrize("key", ["stiffness", "dofs"])
def test_a_model_that_names_a_file_of_too_long_a_name(tmp_path, key):
    table = {"dofs": "dofs.csv", "stiffness": "K.mtx"} | {key: "n" * 5000}
    (tmp_path / "dofs.csv").write_text("dof\n1:X\n")
    (tmp_path / "m.toml").write_text(
        f'dofs = "{table["dofs"]}"\n[[group]]\nname = "a"\nstiffness = "{table["stiffness"]}"\n'
    )
    with pytest.raises(FormatError, match=rf"m\.toml:\d: {key}: no such file .*name is too long"):
        updyn.read_model(tmp_path / "m.toml")


def test_a_damaged_measurement_is_not_hidden_by_what_stands_beside_it(tmp_path, capsys):
    path = tmp_path / "a.uff"
    geometry = uff.nodes15((1, 0, 0, 0.0, 0.0, 0.0), (2, 0, 0, 1.0, 0.0, 0.0))
    frf = uff.ascii58(np.array([1.25 + 2j, 3 - 1j]))
    assert b" 1.25000E+00" in frf
    path.write_bytes(geometry + frf)
    assert main(["info", str(path)]) == 0
    assert "FRF: accelerance, 2 lines" in capsys.readouterr().out
    path.write_bytes(geometry + frf.replace(b" 1.25000E+00", b" 1.2x000E+00"))
    assert main(["info", str(path)]) == 2
    said = capsys.readouterr()
    assert "a.uff:19: data: expected a number, found '1.2x000E+00'" in said.err
    assert not said.out
    path.write_bytes(geometry)  # no measurement at all: the nodes are the answer
    assert main(["info", str(path)]) == 0
    assert "Geometry: 2 nodes" in capsys.readouterr().out
