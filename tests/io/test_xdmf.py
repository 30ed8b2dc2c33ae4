"""XDMF meshes whose numbers stand in an HDF5 file beside them: read, or refused by the name of that file."""

from __future__ import annotations

from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest

from updyn.elements.mesh import read_mesh
from updyn.errors import FormatError

XYZ = np.array([[0.0, 0, 0], [500, 0, 0], [500, 250, 0], [0, 250, 0], [1000, 125.5, 0]])
QUADS, TRIANGLES = np.array([[0, 1, 2, 3]]), np.array([[1, 4, 2]])


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A quadrangle, with its HDF5 file, as meshio writes them."""
    (tmp_path / "a mesh").mkdir()
    path = tmp_path / "a mesh" / "plate.xdmf"
    meshio.Mesh(XYZ, [("quad", QUADS)]).write(path)
    assert (path.parent / "plate.h5").is_file()
    return path


def replaced(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


def test_numbers_of_the_file_beside_it(path, monkeypatch):
    monkeypatch.chdir(path.parent.parent)
    for name in (path, Path("a mesh/plate.xdmf")):
        mesh = read_mesh(name, unit="mm")
        np.testing.assert_array_equal(mesh.xyz, XYZ * 1e-3)
        np.testing.assert_array_equal(mesh.groups["all"]["quad"], QUADS + 1)


def test_several_kinds_of_cells(tmp_path):
    path = tmp_path / "both.xdmf"
    meshio.Mesh(XYZ, [("quad", QUADS), ("triangle", TRIANGLES)]).write(path)
    groups = read_mesh(path, unit="m").groups["all"]
    np.testing.assert_array_equal(groups["quad"], QUADS + 1)
    np.testing.assert_array_equal(groups["triangle"], TRIANGLES + 1)


def cut(h5: Path) -> None:
    h5.write_bytes(h5.read_bytes()[:-100])


def flipped(h5: Path) -> None:
    raw = bytearray(h5.read_bytes())
    raw[1] ^= 1
    h5.write_bytes(raw)


def remade(h5: Path, what: str) -> None:
    with h5py.File(h5, "r+") as file:
        del file["data0"]
        if what == "shape":
            file["data0"] = XYZ[:4]
        elif what == "link":
            file["data0"] = h5py.ExternalLink("other.h5", "/data0")
        elif what == "unwritten":
            file.create_dataset("data0", (5, 3), dtype="f8")
        elif what == "group":
            file.create_group("data0/data0")
        elif what == "virtual":
            layout = h5py.VirtualLayout((5, 3), dtype="f8")
            layout[:] = h5py.VirtualSource("other.h5", "x", (5, 3), dtype="f8")
            file.create_virtual_dataset("data0", layout)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (Path.unlink, "no such file; plate.xdmf refers to it for its numbers"),
        (
            cut,
            "not a readable HDF5 file: damaged, truncated.*plate.xdmf refers to it for its numbers",
        ),
        (flipped, "not a readable HDF5 file: damaged, truncated"),
        (lambda h5: h5.write_bytes(b""), "not a readable HDF5 file: damaged, truncated"),
        (lambda h5: remade(h5, "none"), "no dataset '/?data0'"),
        (lambda h5: remade(h5, "shape"), r"data0: 4 x 3 numbers, expected 5 x 3 by plate\.xdmf"),
        (lambda h5: remade(h5, "link"), r"'data0' is a link to the file 'other\.h5'"),
        (lambda h5: remade(h5, "unwritten"), "were never written"),
        (lambda h5: remade(h5, "group"), "'/?data0' is not a dataset"),
        (lambda h5: remade(h5, "virtual"), "a virtual dataset"),
    ],
)
def test_a_bad_file_beside_it_is_named(path, damage, said):
    damage(path.parent / "plate.h5")
    with pytest.raises(FormatError, match=rf"plate\.h5: .*{said}"):
        read_mesh(path, unit="m")


@pytest.mark.parametrize(
    ("new", "said"),
    [
        ("../plate.h5:", r"in the file '../plate\.h5'; expected .* in the same folder"),
        ("/etc/plate.h5:", r"in the file '/etc/plate\.h5'; expected .* in the same folder"),
        (":", "in the file ''; expected"),
    ],
)
def test_files_of_other_folders_are_not_followed(path, new, said):
    replaced(path, "plate.h5:", new)
    with pytest.raises(FormatError, match=rf"plate\.xdmf: .*{said}"):
        read_mesh(path, unit="m")


def test_binary_files_and_bad_xml_are_refused(path):
    replaced(path, 'Format="HDF"', 'Format="Binary"')
    with pytest.raises(FormatError, match=r"plate\.xdmf: .*binary file 'plate\.h5:/?data0'"):
        read_mesh(path, unit="m")
    path.write_text("<Xdmf><Domain>", encoding="utf-8")
    with pytest.raises(FormatError, match=r"plate\.xdmf:1: not a readable XDMF file"):
        read_mesh(path, unit="m")
