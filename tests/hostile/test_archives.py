"""Archives of arrays (``.npz``), of models, FRFs and plants: what is wrong with them is said, never raised raw."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import io_samples
import plants_by_hand
import updyn
from array_mutants import archive, changed_bytes, mutants
from overriding import override
from updyn.control.files.plant_file import read_plant, write_plant
from updyn.errors import FormatError, UpdynError
from updyn.foreign.settings import READING
from updyn.io.npz import read_arrays

KINDS: dict[str, tuple[Callable[[Path], None], Callable[[Path], Any]]] = {
    "model": (lambda p: updyn.write_model(io_samples.model(), p), updyn.read_model),
    "frf": (lambda p: updyn.write_frf(io_samples.frf(), p), updyn.read_frf),
    "plant": (lambda p: write_plant(plants_by_hand.two_masses(), p), read_plant),
}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", KINDS)
def test_mutants_raise_nothing_but_our_errors(kind, tmp_path):
    write, read = KINDS[kind]
    count = 150
    path = tmp_path / "a.npz"
    write(path)
    content = path.read_bytes()
    rng = np.random.default_rng(17)
    items = mutants(read_arrays(path), rng)
    refused = 0
    for number in range(count):
        path.write_bytes(archive(next(items)) if number % 3 else changed_bytes(content, rng))
        try:
            read(path)
        except UpdynError as error:
            refused += "a.npz" in str(error)
    assert refused > count // 2


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path, monkeypatch):
    override(monkeypatch, READING, unpacked_bytes=10**6)
    np.savez_compressed(tmp_path / "a.npz", K=np.zeros((1000, 1000)), allow_pickle=False)
    with pytest.raises(FormatError, match=r"a\.npz: declares 8 MB of data or more"):
        updyn.read_model(tmp_path / "a.npz")


def test_a_header_that_promises_more_than_follows(tmp_path):
    with (
        zipfile.ZipFile(tmp_path / "a.npz", "w") as file,
        file.open("K.npy", "w") as stream,
    ):
        header = {"descr": "<f8", "fortran_order": False, "shape": (10**9, 10**3)}
        np.lib.format.write_array_header_1_0(stream, header)
        stream.write(bytes(80))
    with pytest.raises(FormatError, match=r"K: declares float64 of shape .* but 80 bytes follow"):
        updyn.read_model(tmp_path / "a.npz")


def test_arrays_come_back_in_either_order(tmp_path):
    rows = np.arange(6.0).reshape(2, 3)
    np.savez(tmp_path / "a.npz", c=rows, f=np.asfortranarray(rows), t=np.array(["é", ""]))
    found = read_arrays(tmp_path / "a.npz")
    np.testing.assert_array_equal(found["c"], rows)
    np.testing.assert_array_equal(found["f"], rows)
    assert found["t"].tolist() == ["é", ""]
    assert found["f"].flags.writeable
