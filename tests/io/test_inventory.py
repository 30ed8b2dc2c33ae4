"""Columns and variables of files from which FRFs can be selected, with the proposed mapping."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.io

import updyn
from updyn.errors import FormatError
from updyn.io.inventory import Item, list_items
from updyn.io.toml_text import format_mapping, parse_toml

LINES = np.array([10.0, 20.0, 30.0, 40.0])
VALUES = np.array([1 + 2j, 3 - 4j, 0.5 + 0.25j, -1 - 1j])


def test_columns_have_names_units_and_first_values(tmp_path):
    path = tmp_path / "hit.csv"
    rows = [f"{f:g};{h.real};{h.imag}" for f, h in zip(LINES, VALUES, strict=True)]
    path.write_text("\n".join(["Analyser", "f [Hz];Re [g/N];Re [g/N]", *rows, ""]))
    found = list_items(path)
    assert found.option == "columns"
    assert found.items == (
        Item("f [Hz]", "f [Hz]", "Hz", "10, 20, 30"),
        Item(2, "Re [g/N]", "g/N", "1, 3, 0.5"),  # a name that occurs twice is no name
        Item(3, "Re [g/N]", "g/N", "2, -4, 0.25"),
    )
    assert found.layout == "4 rows from line 3 in 3 columns with names, separated by semicolons"
    assert found.proposal == {}


def test_the_first_of_several_files_is_listed_with_its_proposal(tmp_path):
    for node in (2, 10):
        rows = [f"{f:g} {node}.0 {h.imag}" for f, h in zip(LINES, VALUES, strict=True)]
        (tmp_path / f"hit_{node}X.txt").write_text("\n".join(["freq re im", *rows, ""]))
    found = list_items(tmp_path / "hit_{node}{axis}.txt")
    assert found.items[1].first == "2, 2, 2"
    channel = {"response": "?", "reference": "?", "real": "re", "imaginary": "im"}
    assert found.proposal == {"frequency": "freq", "channels": [channel]}


@pytest.mark.parametrize("suffix", [".mat", ".npz"])
def test_variables_have_sizes_and_columns_of_tables(tmp_path, suffix):
    path = tmp_path / f"frf{suffix}"
    arrays = {"f": LINES, "frf": VALUES, "tab": np.stack([LINES, VALUES], axis=1), "name": "x"}
    scipy.io.savemat(path, arrays) if suffix == ".mat" else np.savez(path, **arrays)
    found = list_items(path)
    items = {item.select: item for item in found.items}
    assert (found.option, found.layout) == ("variables", "3 arrays of numbers")
    assert list(items) == ["f", "frf", "tab", "tab(:,1)", "tab(:,2)"]
    assert items["tab"].size == "4 x 2 complex"
    assert items["tab(:,2)"].first == "1+2j, 3-4j, 0.5+0.25j"
    assert found.proposal == {"freq": "f", "H": "frf"}


def test_datasets_have_units(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["run/f"] = LINES
        file["run/f"].attrs["units"] = "kHz"
    (item,) = list_items(tmp_path / "a.h5").items
    assert item == Item("run.f", "run.f", "kHz", "10, 20, 30", "4 real")


@pytest.mark.parametrize(
    ("name", "expected"), [("a.txt", "no table"), ("none.csv", "no such file")]
)
def test_a_file_without_items_is_refused(tmp_path, name, expected):
    (tmp_path / "a.txt").write_text("a letter\n")
    with pytest.raises(FormatError, match=expected):
        list_items(tmp_path / name)


def test_the_first_lines_of_a_text_are_shown(tmp_path):
    rows = [200 * "n", *(f"note {n}" for n in range(1, 20)), "f,a,b", "1,2,3", "2,3,4", ""]
    (tmp_path / "a.csv").write_text("n" + "\n".join(rows))
    assert list_items(tmp_path / "a.csv").head == tuple(rows[:15])


def test_a_mapping_is_written_with_one_channel_per_line(tmp_path):
    channels = [
        {"response": f"{n}:Z", "reference": "1:Z", "real": 2 * n, "imaginary": 2 * n + 1}
        for n in (1, 2)
    ]
    mapping = {"frequency": "f", "unit": "g/N", "channels": channels}
    text = format_mapping(mapping)
    assert len(text.splitlines()) == 4
    assert parse_toml(f"columns = {text}\n")["columns"] == mapping
    rows = [f"{f:g},1,2,3,4" for f in LINES]
    (tmp_path / "a.csv").write_text("\n".join(["f,a,b,c,d", *rows, ""]))
    frf = updyn.read_frf(tmp_path / "a.csv", columns=mapping)
    assert frf.responses.labels == ["1:Z", "2:Z"]


@pytest.mark.parametrize(
    ("name", "labels"),
    [
        ("5:-Z/1:Z Re", ("5:-Z", "1:Z")),
        ("2X real", ("2:X", "?")),
        ("H_12RZ_1Z re", ("12:RZ", "1:Z")),
        ("Run 3 2Xa re", ("?", "?")),
        ("H1 re", ("?", "?")),
    ],
)
def test_labels_are_taken_from_names_of_columns(tmp_path, name, labels):
    imaginary = name.replace("real", "imag").replace("Re", "Im").replace(" re", " im")
    rows = [f"{f:g},1,2" for f in LINES]
    (tmp_path / "a.csv").write_text("\n".join([f"freq,{name},{imaginary}", *rows, ""]))
    (channel,) = list_items(tmp_path / "a.csv").proposal["channels"]
    assert (channel["response"], channel["reference"]) == labels
