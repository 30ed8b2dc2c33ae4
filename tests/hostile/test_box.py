"""The child process that reads files of other programs: whatever it does, the answer is sound or one message."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import h5py
import meshio
import numpy as np
import pytest
import scipy.io

import foreign_loaders
import io_samples
import updyn
from overriding import override
from places import DATA
from updyn.elements.mesh import read_mesh
from updyn.errors import FormatError
from updyn.foreign import box, limits, processes
from updyn.foreign.plain import Sparse, decode, encode
from updyn.foreign.settings import READING

HOSTILE = DATA / "hostile"


@pytest.fixture(params=["fork", "new process"])
def path(tmp_path: Path, request, monkeypatch) -> Path:
    """A file, read in each of the two kinds of child processes."""
    if request.param == "new process":
        monkeypatch.setattr(processes, "_CAN_FORK", False)
    elif not processes._CAN_FORK:
        pytest.skip("no fork here")
    found = tmp_path / "a file.x"
    found.write_bytes(b"content")
    return found


def load(function: str, path: Path, *arguments: Any) -> Any:
    return box.load(f"foreign_loaders:{function}", path, *arguments, what="picture", reader="libx")


def same(found: Any, expected: Any) -> bool:
    if isinstance(expected, np.ndarray):
        np.testing.assert_array_equal(found, expected)
        return found.dtype == expected.dtype and found.shape == expected.shape
    if isinstance(expected, Sparse):
        parts = ("data", "indices", "indptr")
        return found.shape == expected.shape and all(
            same(getattr(found, part), getattr(expected, part)) for part in parts
        )
    if isinstance(expected, dict):
        return list(found) == list(expected) and all(same(found[k], expected[k]) for k in expected)
    if isinstance(expected, list):
        return len(found) == len(expected) and all(map(same, found, expected))
    return type(found) is type(expected) and found == expected


def test_plain_data_come_back_from_the_child(path):
    assert same(load("everything", path), foreign_loaders.everything(""))


def test_what_a_library_prints_is_not_taken_for_the_answer(path):
    assert load("talk", path) == "the answer"


@pytest.mark.parametrize(
    ("function", "arguments", "message"),
    [
        pytest.param(
            "crash", (), r"its reader \(libx\) crashed \(SIGABRT\)",
            marks=pytest.mark.skipif(sys.platform == "win32", reason="no signals"),
        ),
        pytest.param(
            "allocate", (10**9,), r"its reader \(libx\) needed over 1,024 MB of memory",
            marks=pytest.mark.skipif(sys.platform != "linux", reason="no limit of memory"),
        ),
        ("stop", (), r"not a readable picture: .*\(1\)"),
        ("no_such", (), "not a readable picture: .*no attribute 'no_such'"),
    ],
)  # fmt: skip
def test_whatever_happens_is_one_message(path, function, arguments, message):
    with pytest.raises(FormatError, match=f"a file.x: .*{message}"):
        load(function, path, *arguments)


def test_a_reader_without_end_is_stopped(path, monkeypatch):
    override(monkeypatch, READING, seconds=0.5)
    with pytest.raises(FormatError, match=r"a file.x: .*its reader \(libx\) ran over 1 s"):
        load("hang", path)


def test_an_error_of_ours_keeps_its_place(path):
    with pytest.raises(FormatError) as caught:
        load("refuse", path)
    assert str(caught.value) == f"{path}:7: line of nonsense"
    assert (caught.value.path, caught.value.line, caught.value.key) == (str(path), 7, ("x", 2))


def test_no_such_file(tmp_path):
    with pytest.raises(FormatError, match="cannot be read: No such file"):
        load("talk", tmp_path / "none")


def test_an_answer_that_is_damaged_is_an_error_and_takes_no_memory():
    """A child whose memory a file has corrupted may send anything."""
    good = b"".join(encode(foreign_loaders.everything("")))
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(2000):
        mutant = bytearray(good)
        for at in rng.integers(len(good), size=rng.integers(1, 4)).tolist():
            mutant[at] = int(rng.integers(256))
        try:
            decode(memoryview(mutant[: rng.integers(1, len(good) + 1)]))
        except box.UNSOUND:
            refused += 1
    assert refused > 1000


# -- files that ended or blocked the process that read them
@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("huge.h5", "declares 4,295 MB of data or more"),
        ("loadmat_segv.mat", r"crashed \(SIGSEGV\)|not a readable MATLAB file"),
        ("one_bit.nc", r"its reader \(libhdf5\) (ran over 1 s|crashed)|not a readable"),
    ],
)
def test_hostile_files_are_refused_by_name(name, message, monkeypatch):
    override(monkeypatch, READING, seconds=0.6)
    read = updyn.read_frf if name.endswith(".nc") else updyn.read_model
    with pytest.raises(FormatError, match=rf"{name}: .*({message})"):
        read(HOSTILE / name)


def test_limits_go_by_the_size_of_all_files_that_are_read(tmp_path, monkeypatch):
    """A small XDMF file may stand for many numbers, in an HDF5 file beside it."""
    path = tmp_path / "large.xdmf"
    corners = np.array([[0, 1, 2, 3]])
    meshio.Mesh(np.random.default_rng(0).random((4000, 3)), [("quad", corners)]).write(path)
    asked = []
    monkeypatch.setattr(
        box, "limits_of", lambda *given: asked.append(limits.limits_of(*given)) or asked[0]
    )
    assert len(read_mesh(path, unit="m").xyz) == 4000
    assert asked[0].size == sum(p.stat().st_size for p in tmp_path.iterdir()) > 96_000


def test_groups_without_end_are_refused(tmp_path):
    updyn.write_model(io_samples.model(), tmp_path / "m.h5")
    with h5py.File(tmp_path / "m.h5", "r+") as file:
        file["groups/again"] = file["groups"]
    with pytest.raises(FormatError, match="groups nested more than 16 deep"):
        updyn.read_model(tmp_path / "m.h5")


def test_a_mat_file_of_zeros_is_refused_by_its_size(tmp_path, monkeypatch):
    override(monkeypatch, READING, unpacked_bytes=10**6)
    scipy.io.savemat(tmp_path / "m.mat", {"K": np.zeros((1000, 1000))}, do_compression=True)
    with pytest.raises(FormatError, match=r"declares .* of data"):
        box.load_in_process("updyn.foreign.matlab:load", tmp_path / "m.mat", what="MATLAB file")
