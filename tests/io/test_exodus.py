"""Exodus II: positions, node numbers and edges, from netCDF-4 and classic netCDF; other files and bad ones."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5netcdf
import h5py
import numpy as np
import pytest
from scipy.io import netcdf_file

import updyn
from updyn.cli import main
from updyn.errors import FormatError, OptionError, UpdynWarning

# A hexahedron with a bar on it, and a point mass: node numbers are not places.
XYZ = np.array(
    [[0, 0, 0], [2, 0, 0], [2, 3, 0], [0, 3, 0], [0, 0, 4], [2, 0, 4], [2, 3, 4], [0, 3, 4], [0, 0, 9.5]]
)  # fmt: skip
NUMBERS = [11, 12, 13, 14, 21, 22, 23, 24, 7]
BLOCKS = {
    "HEX8": [[1, 2, 3, 4, 5, 6, 7, 8]],
    "BAR2": [[5, 9]],
    "SPHERE": [[9]],
}
HEX = [
    (11, 12), (12, 13), (13, 14), (11, 14), (21, 22), (22, 23), (23, 24), (21, 24),
    (11, 21), (12, 22), (13, 23), (14, 24),
]  # fmt: skip
MARKS = {"api_version": np.float32(5.14), "version": np.float32(5.14), "title": "block"}


def contents(
    xyz: Any = XYZ,
    numbers: Any = NUMBERS,
    blocks: Mapping[str, Any] = BLOCKS,
    whole: bool = False,
) -> dict[str, tuple[Any, str]]:
    """Arrays, with the type of elements, by the names of the format."""
    xyz = np.asarray(xyz, dtype=float)
    out: dict[str, tuple[Any, str]] = {"time_whole": (np.zeros(1), "")}
    if whole:
        out["coord"] = (xyz.T, "")
    else:
        out |= {f"coord{axis}": (row, "") for axis, row in zip("xyz", xyz.T, strict=False)}
    if numbers is not None:
        out["node_num_map"] = (np.array(numbers, dtype=np.int32), "")
    for i, (kind, elements) in enumerate(blocks.items(), 1):
        out[f"connect{i}"] = (np.array(elements, dtype=np.int32), kind)
    return out


def write_4(path: Path, held: Mapping[str, tuple[Any, str]], marks: Mapping[str, Any]) -> None:
    with h5netcdf.File(path, "w") as file:
        file.attrs.update(marks)
        _put(held, file.dimensions.__setitem__, file.create_variable)


def write_3(path: Path, held: Mapping[str, tuple[Any, str]], marks: Mapping[str, Any]) -> None:
    with netcdf_file(path, "w", version=2) as file:
        for name, value in marks.items():
            setattr(file, name, value)

        def create(name: str, dimensions: tuple[str, ...], dtype: Any) -> Any:
            return file.createVariable(name, dtype, dimensions)

        _put(held, file.createDimension, create)


def _put(held: Mapping[str, tuple[Any, str]], dimension: Any, create: Any) -> None:
    for name, (values, kind) in held.items():
        names = tuple(f"{name}_{i}" for i in range(values.ndim))
        for one, size in zip(names, values.shape, strict=True):
            dimension(one, size)
        variable = create(name, names, values.dtype)
        variable[:] = values
        if kind and hasattr(variable, "attrs"):
            variable.attrs["elem_type"] = kind
        elif kind:
            variable.elem_type = kind


def pairs(geometry: updyn.Geometry) -> set[tuple[int, int]]:
    return {(min(a, b), max(a, b)) for a, b in geometry.lines.tolist()}


@pytest.fixture(params=[write_4, write_3], ids=["netcdf4", "classic"])
def write(request: pytest.FixtureRequest) -> Any:
    return request.param


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize(("unit", "metres"), [("m", 1.0), ("mm", 1e-3), ("in", 0.0254)])
def test_a_mesh(tmp_path: Path, write: Any, whole: bool, unit: str, metres: float) -> None:
    path = tmp_path / "block.exo"
    write(path, contents(whole=whole), MARKS)
    geometry = updyn.read_geometry(path, unit=unit)
    assert geometry.nodes.tolist() == NUMBERS
    np.testing.assert_allclose(geometry.xyz, XYZ * metres, rtol=1e-15)
    assert pairs(geometry) == {*HEX, (7, 21)}
    assert len(geometry.lines) == len(HEX) + 1
    assert geometry.faces.shape == (6, 4)
    assert geometry.axes is None


def test_without_numbers_and_elements_nodes_are_counted(tmp_path: Path, write: Any) -> None:
    path = tmp_path / "cloud.e"
    write(path, contents(numbers=None, blocks={}), MARKS)
    geometry = updyn.read_geometry(path)
    assert geometry.nodes.tolist() == list(range(1, 10))
    assert not len(geometry.lines)


def test_a_plane_mesh(tmp_path: Path, write: Any) -> None:
    path = tmp_path / "plane.exo"
    blocks = {"TRI3": [[1, 2, 3]], "QUAD4": [[1, 3, 4, 2]]}
    write(path, contents(XYZ[:4, :2], NUMBERS[:4], blocks), MARKS)
    geometry = updyn.read_geometry(path)
    np.testing.assert_array_equal(geometry.xyz, XYZ[:4])
    assert pairs(geometry) == {(11, 12), (12, 13), (11, 13), (13, 14), (12, 14)}
    assert geometry.faces.tolist() == [[11, 12, 13, 13], [11, 13, 14, 12]]


@pytest.mark.parametrize(
    ("kind", "n_nodes", "n_edges", "n_faces"),
    [("TETRA10", 10, 6, 4), ("tet4", 4, 6, 4), ("PYRAMID5", 5, 8, 5), ("WEDGE6", 6, 9, 5),
     ("HEX20", 20, 12, 6), ("SHELL4", 4, 4, 1), ("SHELL3", 3, 3, 1), ("TRISHELL3", 3, 3, 1),
     ("QUAD9", 9, 4, 1), ("TRUSS", 2, 1, 0), ("BEAM3", 3, 1, 0), ("SPHERE", 1, 0, 0)],
)  # fmt: skip
def test_edges_join_corners(
    tmp_path: Path, kind: str, n_nodes: int, n_edges: int, n_faces: int
) -> None:
    """A corner of a solid or a shell is met by as many edges at least as it has dimensions."""
    path = tmp_path / "one.exo"
    rng = np.random.default_rng(3)
    write_4(path, contents(rng.random((20, 3)), None, {kind: [list(range(1, n_nodes + 1))]}), MARKS)
    geometry = updyn.read_geometry(path)
    assert (len(geometry.lines), len(geometry.faces)) == (n_edges, n_faces)


def test_other_elements_are_not_drawn_and_said_so(tmp_path: Path, write: Any) -> None:
    path = tmp_path / "block.exo"
    write(path, contents(blocks=BLOCKS | {"NSIDED": [[1, 2, 3]], "HEX": [[1, 2]]}), MARKS)
    said = "not drawn: 1 of type 'NSIDED', 1 of type 'HEX'"
    with pytest.warns(UpdynWarning, match=said):
        assert pairs(updyn.read_geometry(path)) == {*HEX, (7, 21)}


@pytest.mark.parametrize(
    ("held", "marks", "said"),
    [
        (contents(), {}, "not an Exodus II file: expected an attribute api_version"),
        ({"frf": (np.zeros(3), "")}, MARKS, "not an Exodus II file: .* it holds: .*frf"),
        (contents(blocks={"BAR2": [[1, 10]]}), MARKS, "connect1: an element at node 10 .* 1 to 9"),
        (contents(blocks={"BAR2": [[0, 1]]}), MARKS, "connect1: an element at node 0 .* 1 to 9"),
        (contents(numbers=[1, 2]), MARKS, "node_num_map: 2 numbers for 9 positions"),
        (contents(numbers=[5, *NUMBERS[1:8], 5]), MARKS, "node 5 occurs twice"),
        (contents() | {"coordy": (np.zeros(4), "")}, MARKS, "found 9 and 4 and 9 numbers"),
        (contents(np.where(XYZ == 9.5, np.nan, XYZ)), MARKS, "position of node 7 is not finite"),
    ],
)
def test_what_is_refused(
    tmp_path: Path, write: Any, held: Any, marks: Mapping[str, Any], said: str
) -> None:
    path = tmp_path / "block.exo"
    write(path, held, marks)
    with pytest.raises(FormatError, match=said):
        updyn.read_geometry(path)


def test_other_files(tmp_path: Path) -> None:
    """HDF5 of another kind, CDF-5, a text, an unknown unit."""
    path = tmp_path / "block.exo"
    with h5py.File(path, "w") as file:
        file["x"] = [1.0]
    with pytest.raises(FormatError, match=r"not an Exodus II file: .*it holds: x"):
        updyn.read_geometry(path)
    path.write_bytes(b"CDF\x05" + bytes(60))
    with pytest.raises(FormatError, match=r"64-bit data format .*nccopy -k netCDF-4"):
        updyn.read_geometry(path)
    path.write_bytes(b"CDF\x01" + bytes(5))
    with pytest.raises(FormatError, match=r"block\.exo"):
        updyn.read_geometry(path)
    path.write_text("not a mesh\n")
    with pytest.raises(FormatError, match="neither content nor suffix"):
        updyn.read_geometry(path)
    write_4(path, contents(), MARKS)
    with pytest.raises(OptionError, match=r"unit 'feet': did you mean 'ft'|unit 'feet': valid"):
        updyn.read_geometry(path, unit="feet")


def test_info(tmp_path: Path, capsys: pytest.CaptureFixture[str], write: Any) -> None:
    path = tmp_path / "block.exo"
    write(path, contents(), MARKS)
    assert main(["info", str(path)]) == 0
    assert "9 nodes" in capsys.readouterr().out


def test_info_of_a_bad_mesh_says_what_is_wrong_with_the_mesh(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], write: Any
) -> None:
    path = tmp_path / "block.exo"
    write(path, contents(numbers=[1, 2]), MARKS)
    assert main(["info", str(path)]) == 2
    said = capsys.readouterr().err
    assert said == f"error: {path}: node_num_map: 2 numbers for 9 positions\n"
