"""Files that are written whole or not at all, and the front doors of the room."""

import os
import stat
from pathlib import Path

import numpy as np
import pytest

import updyn
from io_samples import assert_same_frf, assert_same_model, frf, model
from updyn.errors import FormatError, OptionError
from updyn.io.atomic import atomic_path


def test_the_file_appears_whole(tmp_path):
    path = tmp_path / "a.nc"
    with atomic_path(path) as temporary:
        assert (temporary.parent, temporary.suffix) == (tmp_path, ".nc")
        temporary.write_text("new")
        assert not path.exists()
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_file_then_folder_are_on_disk(tmp_path, monkeypatch):
    order = []
    fsync, replace = os.fsync, Path.replace
    monkeypatch.setattr(os, "fsync", lambda n: (order.append(os.fstat(n).st_ino), fsync(n)))
    monkeypatch.setattr(Path, "replace", lambda a, b: (order.append("replace"), replace(a, b)))
    with atomic_path(tmp_path / "a.nc") as temporary:
        temporary.write_text("new")
    assert order == [(tmp_path / "a.nc").stat().st_ino, "replace", tmp_path.stat().st_ino]


def test_a_failure_leaves_what_was_there(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("old")

    def write():
        with atomic_path(path) as temporary:
            temporary.write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_rights_are_those_of_a_plain_file_or_of_the_old_one(tmp_path):
    plain, path = tmp_path / "plain", tmp_path / "a.csv"
    plain.write_text("x")
    with atomic_path(path) as temporary:
        temporary.write_text("1")
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)
    path.chmod(0o640)
    with atomic_path(path) as temporary:
        temporary.write_text("2")
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_places_that_cannot_be_written(tmp_path, monkeypatch):
    with (
        pytest.raises(FormatError, match=r"the folder .*absent' does not exist"),
        atomic_path(tmp_path / "absent" / "a"),
    ):
        pass
    with pytest.raises(FormatError, match="is a folder, not a file"), atomic_path(tmp_path):
        pass

    def denied(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", denied)
    with (
        pytest.raises(FormatError, match=r"a\.csv: cannot be written: Permission denied"),
        atomic_path(tmp_path / "a.csv"),
    ):
        pass


# -- the front doors ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["a.npz", "a.mat", "a.nc", "a.h5", "a.hdf5"])
def test_frfs_by_suffix_and_back_by_content(tmp_path, name):
    updyn.write_frf(frf(), tmp_path / name)
    (tmp_path / name).rename(tmp_path / "renamed.dat")
    assert_same_frf(updyn.read_frf(tmp_path / "renamed.dat"), frf())


@pytest.mark.parametrize("name", ["a.npz", "a.mat", "a.h5"])
def test_models_by_suffix_and_back_by_content(tmp_path, name):
    updyn.write_model(model(), tmp_path / name)
    (tmp_path / name).rename(tmp_path / "renamed.dat")
    assert_same_model(updyn.read_model(tmp_path / "renamed.dat"), model())


def test_a_format_can_be_forced(tmp_path):
    path = tmp_path / "a.dat"
    updyn.write_frf(frf(), path, format="npz")
    assert_same_frf(updyn.read_frf(path, format="npz"), frf())
    with pytest.raises(FormatError, match="format 'nzp' cannot read_frf; did you mean 'npz'"):
        updyn.read_frf(path, format="nzp")
    with pytest.raises(FormatError, match=r"neither content nor suffix '\.dat'"):
        updyn.write_frf(frf(), path)


def test_options_are_checked_by_name(tmp_path):
    updyn.write_frf(frf(), tmp_path / "a.npz")
    with pytest.raises(
        OptionError, match="read_frf of the format 'npz' has no option 'ordr'; did you mean 'order'"
    ):
        updyn.read_frf(tmp_path / "a.npz", ordr=("freq",))
    updyn.write_model(model(), tmp_path / "m.npz")
    with pytest.raises(
        OptionError, match="read_model of the format 'npz' has no option 'dofs'; valid: 'format'"
    ):
        updyn.read_model(tmp_path / "m.npz", dofs=["1:X"])


def test_files_that_are_not_there_or_not_readable(tmp_path, monkeypatch):
    updyn.write_frf(frf(), tmp_path / "test.npz")
    with pytest.raises(FormatError, match=r"no such file; did you mean 'test\.npz'"):
        updyn.read_frf(tmp_path / "tset.npz")
    with pytest.raises(FormatError, match="is a folder, not a file"):
        updyn.read_frf(tmp_path)

    def denied(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", denied)
    with pytest.raises(FormatError, match=r"test\.npz: cannot be read: Permission denied"):
        updyn.read_frf(tmp_path / "test.npz")


def test_a_text_with_the_suffix_of_a_binary_format(tmp_path):
    (tmp_path / "a.npz").write_text("not an archive")
    with pytest.raises(FormatError, match="neither content nor suffix"):
        updyn.read_frf(tmp_path / "a.npz")
    (tmp_path / "a.nc").write_bytes(b"CDF\x01" + bytes(60))
    with pytest.raises(FormatError, match="classic format"):
        updyn.read_frf(tmp_path / "a.nc")


def test_values_survive_a_chain_of_formats(tmp_path):
    data = frf()
    for suffix in (".npz", ".mat", ".nc", ".h5"):
        updyn.write_frf(data, tmp_path / f"a{suffix}")
        data = updyn.read_frf(tmp_path / f"a{suffix}")
    np.testing.assert_array_equal(data.values, frf().values)
