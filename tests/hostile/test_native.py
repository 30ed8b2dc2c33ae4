"""Native files that are damaged, of an older updyn, opened by other programs, or written onto a full disk."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

import io_samples
import updyn
from native_samples import MARK, NATIVE, Native, bit_flips
from updyn.errors import FormatError

FLIPS = 400


@pytest.fixture(params=NATIVE, ids=lambda native: native.name)
def native(request: pytest.FixtureRequest) -> Native:
    return request.param


def test_a_flipped_bit_is_refused_by_name(native: Native, tmp_path: Path) -> None:
    path = tmp_path / native.name
    native.write(path)
    good = path.read_bytes()
    marked = range(good.rindex(MARK), good.rindex(MARK) + len(MARK))
    refused = 0
    for at, mutant in bit_flips(good, FLIPS, seed=17):
        if at in marked:  # the content is sound, and read as that of another program
            continue
        path.write_bytes(mutant)
        with pytest.raises(FormatError, match=rf"{native.name}: ") as caught:
            native.read(path)
        refused += "differs from the content written" in str(caught.value)
    assert refused > FLIPS - 10  # others no longer start as an HDF5 file


def test_a_file_without_digest_is_read_without_a_word(native: Native, tmp_path: Path) -> None:
    path = tmp_path / native.name
    native.write(path)
    good = path.read_bytes()
    read = native.read(path)
    path.write_bytes(good[: good.rindex(MARK)])
    again = native.read(path)
    if native.name == "model.h5":
        io_samples.assert_same_model(again, read)
    elif native.name == "frf.nc":
        io_samples.assert_same_frf(again, read)
    else:
        assert again.summary() == read.summary()


def test_every_hdf5_program_opens_a_native_file(native: Native, tmp_path: Path) -> None:
    path = tmp_path / native.name
    native.write(path)
    with h5py.File(path) as file:
        assert file.attrs["updyn_kind"] in (native.name.split(".")[0].encode(), b"frf", b"result")
    with xr.open_dataset(path, engine="h5netcdf") as data:
        assert data.attrs["updyn_format"] == 1


def test_a_program_that_changes_a_file_removes_its_digest(tmp_path: Path) -> None:
    path = tmp_path / "model.h5"
    updyn.write_model(io_samples.model(), path)
    with h5py.File(path, "r+") as file:
        file["groups/0000/mass/data"][0] = 1.5
    assert MARK not in path.read_bytes()
    assert updyn.read_model(path).group("shaft").mass[0, 0] == 1.5


# -- numbers that stand elsewhere, or nowhere
def linked(file: h5py.File, source: Path) -> None:
    del file["groups/0000/stiffness/data"]
    file["groups/0000/stiffness/data"] = h5py.ExternalLink(source, "/x")


def external(file: h5py.File, source: Path) -> None:
    del file["groups/0000/stiffness/data"]
    place = file["groups/0000/stiffness"]
    place.create_dataset("data", (5,), "f8", external=[(source, 0, 40)])


def virtual(file: h5py.File, source: Path) -> None:
    del file["groups/0000/stiffness/data"]
    layout = h5py.VirtualLayout((5,), "f8")
    layout[:] = h5py.VirtualSource(source, "x", (5,))
    file["groups/0000/stiffness"].create_virtual_dataset("data", layout)


def unwritten(file: h5py.File, source: Path) -> None:
    del file["groups/0000/stiffness/data"]
    file["groups/0000/stiffness"].create_dataset("data", (5,), "f8")


def written_in_part(file: h5py.File, source: Path) -> None:
    del file["groups/0000/stiffness/data"]
    data = file["groups/0000/stiffness"].create_dataset("data", (5,), "f8", chunks=(2,))
    data[:2] = 1.0


def external_as_a_dimension(file: h5py.File, source: Path) -> None:
    external(file, source)
    data = file["groups/0000/stiffness/data"]
    data.attrs["NAME"] = np.bytes_(
        b"This is a netCDF dimension but not a netCDF variable         5"
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (linked, r"/groups/0000/stiffness: 'data' is a link to the file '.*other\.h5'"),
        (external, r"/groups/0000/stiffness/data: its numbers are in the file '.*other\.h5'"),
        (virtual, "/groups/0000/stiffness/data: a virtual dataset"),
        (unwritten, "/groups/0000/stiffness/data: some numbers were never written"),
        (written_in_part, "/groups/0000/stiffness/data: some numbers were never written"),
        (external_as_a_dimension, "/groups/0000/stiffness/data: .*without variable"),
    ],
)
def test_numbers_that_are_not_in_the_file_are_refused(tmp_path, change, message):
    path, source = tmp_path / "model.h5", tmp_path / "other.h5"
    with h5py.File(source, "w") as file:
        file["x"] = np.arange(5.0)
    updyn.write_model(io_samples.model(), path)
    with h5py.File(path, "r+") as file:
        change(file, source)
    with pytest.raises(FormatError, match=message):
        updyn.read_model(path)


# -- a full disk
@contextlib.contextmanager
def room_for(size: int) -> Iterator[None]:
    """Let no file grow beyond a size; Python ignores the signal, so that writing fails."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


OTHERS = (
    Native("frf.npz", io_samples.frf, updyn.write_frf, updyn.read_frf),
    Native("frf.mat", io_samples.frf, updyn.write_frf, updyn.read_frf),
    Native("frf.uff", lambda: io_samples.frf(with_geometry=False), updyn.write_frf, updyn.read_frf),
    Native("model.npz", io_samples.model, updyn.write_model, updyn.read_model),
    Native("model.mat", io_samples.model, updyn.write_model, updyn.read_model),
)


@pytest.mark.filterwarnings("ignore::updyn.UpdynWarning")
@pytest.mark.parametrize("native", [*NATIVE, *OTHERS], ids=lambda native: native.name)
def test_a_full_disk_is_one_message_and_leaves_the_old_file(native, tmp_path):
    path = tmp_path / native.name
    native.write(path)
    good = path.read_bytes()
    for size in np.linspace(0, len(good) - 1, 7, dtype=int).tolist():
        with room_for(size), pytest.raises(FormatError) as caught:
            native.write(path)
        assert str(caught.value) == f"{path}: cannot be written: {os.strerror(errno.EFBIG)}"
        assert path.read_bytes() == good
        assert [found.name for found in tmp_path.iterdir()] == [native.name]
