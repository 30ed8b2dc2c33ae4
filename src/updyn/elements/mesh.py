"""Meshes of Gmsh, Abaqus, VTK and others, read by meshio: groups become parts of a structure.

meshio drops the node numbers of a file and reads some Abaqus decks wrongly. Node numbers are
therefore read here, and such decks are rejected.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from updyn.arrays import IndexArray, IntArray, NumberArray, RealArray
from updyn.dofs import Dof
from updyn.elements.checks import check_keys, field_names
from updyn.elements.constraints import Equation
from updyn.elements.structure import (
    Beam,
    Element,
    PointMass,
    RigidLink,
    Shell,
    Solid,
    Truss,
    structure,
)
from updyn.errors import FormatError, ModelError, suggest
from updyn.foreign import box
from updyn.model import Model

__all__ = [
    "Mesh",
    "read_mesh",
    "structure_from_mesh",
]

#: Length units in metres.
UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254}
#: Elements by cell type; lines are `Beam` if their material has a section.
_ELEMENTS: Mapping[str, type] = {
    "vertex": PointMass,
    "line": Truss,
    "triangle": Shell,
    "quad": Shell,
    "tetra": Solid,
    "tetra10": Solid,
    "hexahedron": Solid,
    "hexahedron20": Solid,
}
#: Node order of VTK for the nodes of a mirrored solid.
_MIRRORED = {
    "tetra": [0, 2, 1, 3],
    "tetra10": [0, 2, 1, 3, 6, 5, 4, 7, 9, 8],
    "hexahedron": [0, 3, 2, 1, 4, 7, 6, 5],
    "hexahedron20": [0, 3, 2, 1, 4, 7, 6, 5, 11, 10, 9, 8, 15, 14, 13, 12, 16, 19, 18, 17],
}
_KEYWORD = re.compile(r"\*\s*(\w[\w ]*)")  # of an Abaqus deck
#: Name of an HDF5 file in an XDMF file.
_HDF = re.compile(rb"""\bFormat\s*=\s*["']HDF["'][^<>]*>\s*([^<>:]+):""")
_ELSET = re.compile(r"ELSET\s*=\s*([^,\s]+)", re.IGNORECASE)


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A mesh with its groups.

    Attributes
    ----------
    path : str
        Path of the file.
    nodes : ndarray of int, shape (n,)
        Node numbers of the file; 1, 2, ... for formats without numbers.
    xyz : ndarray of float, shape (n, 3)
        Positions in m.
    groups : mapping of str to mapping of str to ndarray of int, shape (m, k)
        Node numbers of cells, by group and cell type of meshio (``"quad"``, ``"tetra10"``, ...).
    node_sets : mapping of str to ndarray of int, shape (m,)
        Named sets of nodes.
    ungrouped : mapping of str to int
        Number of cells without a group, by cell type.
    """

    path: str
    nodes: IntArray
    xyz: RealArray
    groups: Mapping[str, Mapping[str, IntArray]]
    node_sets: Mapping[str, IntArray]
    ungrouped: Mapping[str, int]

    def nodes_of(self, name: str) -> IntArray:
        """Return the node numbers of a group or a node set, ascending.

        Parameters
        ----------
        name : str
            Name in the file.

        Returns
        -------
        ndarray of int, shape (m,)

        Raises
        ------
        FormatError
            If there is no such group or set; the message gives the nearest names.
        """
        if name in self.node_sets:
            return np.unique(self.node_sets[name])
        if name in self.groups:
            cells = map(np.ravel, self.groups[name].values())
            return np.unique(np.concatenate(list(cells)))
        raise FormatError(
            f"no group {name!r}; {suggest(name, [*self.groups, *self.node_sets])}", self.path
        )

    def parts(
        self, materials: Mapping[str, Mapping[str, Any]], leave_out: Iterable[str] = ()
    ) -> list[Element]:
        """Return the parts of a structure, one per group and cell type.

        Parameters
        ----------
        materials : mapping of str to mapping
            Fields of the part of each group in SI units, without name and connectivity. Surfaces
            are `Shell`, volumes `Solid`; lines are `Beam` if ``section`` is given, else `Truss`;
            points are `PointMass`.
        leave_out : iterable of str
            Groups that are not parts, such as faces to be fixed or linked.

        Returns
        -------
        list of Element

        Raises
        ------
        FormatError
            If a group has no material, an omitted group has one, a material has no group, a cell
            is in two groups, or a cell type is unknown.
        ModelError
            If a field is missing or unknown, or a value out of range.
        """
        omitted = set(leave_out)
        self._check_names(materials, omitted)
        self._check_once(materials)
        out: list[Element] = []
        for name, given in materials.items():
            for kind, cells in self.groups[name].items():
                out += _elements(self.path, name, kind, cells, given)
        return out

    def _check_names(self, materials: Collection[str], omitted: Collection[str]) -> None:
        for name in materials:
            if name not in self.groups:
                raise self._unknown_group_error(name)
            if name in omitted:
                raise FormatError(
                    f"group {name!r} has a material, but is omitted; expected one of both",
                    self.path,
                )
        for name in omitted:
            if name not in self.groups and name not in self.node_sets:
                raise self._unknown_group_error(name)
        for name, group in self.groups.items():
            if name not in materials and name not in omitted:
                kinds = ", ".join(f"{len(cells)} {kind}" for kind, cells in group.items())
                raise FormatError(
                    f"group {name!r} ({kinds}) has no material; give it one, or leave the"
                    " group out",
                    self.path,
                )

    def _unknown_group_error(self, name: str) -> FormatError:
        return FormatError(f"no group {name!r}; {suggest(str(name), self.groups)}", self.path)

    def _check_once(self, names: Iterable[str]) -> None:
        """Raise an error for a cell that is in two groups."""
        owners: dict[str, list[str]] = {}
        for name in names:
            for kind, cells in self.groups[name].items():
                owners.setdefault(kind, []).extend([name] * len(cells))
        for kind, owner in owners.items():
            blocks = []
            for name in dict.fromkeys(owner):
                blocks.append(self.groups[name][kind])
            cells = np.sort(np.concatenate(blocks), axis=1)
            _, first, place = np.unique(cells, axis=0, return_index=True, return_inverse=True)
            original = first[place.ravel()]
            twice = np.flatnonzero(original != np.arange(len(cells)))
            if twice.size:
                at = int(twice[0])
                raise FormatError(
                    f"the {kind} of nodes {cells[at].tolist()} occurs twice: in group"
                    f" {owner[original[at]]!r} and in {owner[at]!r}",
                    self.path,
                )


def _elements(
    path: str, name: str, kind: str, cells: IntArray, given: Mapping[str, Any]
) -> list[Element]:
    what = f"material of group {name!r}"
    if not isinstance(given, Mapping):
        raise ModelError(f"{what}: {given!r}; expected a mapping of field to value")
    if kind not in _ELEMENTS:
        raise FormatError(
            f"group {name!r} has {len(cells)} cells of kind {kind!r}; {suggest(kind, _ELEMENTS)}",
            path,
        )
    element = _ELEMENTS[kind]
    if kind == "line" and "section" in given:
        element = Beam
    names, required = field_names(element)
    for field in ("name", "connectivity", "node"):  # from the mesh
        if field in names:
            names.remove(field)
            required.remove(field)
    check_keys(f"{what}, a {element.__name__}", given, required, names)
    if element is PointMass:
        return [PointMass(name, node, **given) for node in cells.ravel().tolist()]
    return [element(name, cells, **given)]


def read_mesh(path: str | PathLike[str], *, unit: str) -> Mesh:
    """Read a mesh file with its groups.

    Parameters
    ----------
    path : path
        ``.msh`` of Gmsh (text), ``.inp`` of Abaqus, ``.vtu``, ``.med`` or another format of
        meshio.
    unit : {"m", "mm", "cm", "in"}
        Unit of the positions; the formats do not give it.

    Returns
    -------
    Mesh
        Groups are the physical groups of Gmsh and the element sets of Abaqus, by their names. A
        file without groups has one group ``"all"``.

    Raises
    ------
    FormatError
        If the file does not exist, is damaged, or has content that meshio reads wrongly.
    ModelError
        If the unit is unknown, or meshio is not installed.
    """
    if unit not in UNITS:
        raise ModelError(f"unit {unit!r}: {suggest(str(unit), UNITS)}")
    path = Path(path)
    if not path.is_file():
        raise FormatError("no such file; expected a mesh", path)
    numbers = _node_numbers(path)
    found = _load_mesh(path)
    xyz = _positions(path, found.points)
    if path.suffix.lower() == ".med":
        found = replace(found, cells=[_orient_outwards(one, xyz) for one in found.cells])
    if numbers is None:
        numbers = np.arange(1, len(xyz) + 1)
    if len(numbers) != len(xyz):
        raise FormatError(f"found {len(numbers)} node numbers for {len(xyz)} positions", path)
    found_numbers, times = np.unique(numbers, return_counts=True)
    if (times > 1).any():
        raise FormatError(f"node {found_numbers[np.argmax(times > 1)]} occurs twice", path)
    groups, ungrouped = _groups(path, found, numbers)
    sets = {}
    for name, members in found.point_sets.items():
        sets[str(name)] = numbers[_check_indices(path, f"set {name!r}", members, len(numbers))]
    return Mesh(str(path), numbers, xyz * UNITS[unit], groups, sets, ungrouped)


@dataclass(frozen=True, slots=True, eq=False)
class _CellBlock:
    """Cells of one type, as indices of their nodes."""

    type: str
    dim: int
    data: NumberArray


@dataclass(frozen=True, slots=True, eq=False)
class _MeshContent:
    """Content that meshio finds in a file, from `updyn.foreign.mesh.load`."""

    points: NumberArray
    cells: Sequence[_CellBlock]
    point_sets: Mapping[str, NumberArray]
    cell_sets: Mapping[str, Sequence[object]]
    physical: Sequence[NumberArray]
    names: Mapping[str, NumberArray]


def _load_mesh(path: Path) -> _MeshContent:
    found = box.load(
        "updyn.foreign.mesh:load",
        path,
        what="mesh",
        reader="meshio",
        extra_files=_find_hdf5_files(path),
    )
    cells = [_CellBlock(*one) for one in found.pop("cells")]
    for one in cells:
        if one.data.ndim != 2 or one.data.dtype.kind not in "iu":
            raise FormatError(f"cells of kind {one.type!r} are not rows of nodes", path)
        if one.data.size and not 0 <= one.data.min() <= one.data.max() < len(found["points"]):
            raise FormatError(f"a cell of kind {one.type!r} has a nonexistent node", path)
    tags = found["physical"]
    if tags and [t.shape for t in tags] != [(len(one.data),) for one in cells]:
        raise FormatError("the tags of the physical groups are not one for each cell", path)
    for name, pair in found["names"].items():
        if pair.shape != (2,) or pair.dtype.kind not in "iu":
            raise FormatError(f"physical group {name!r}: expected its tag and dimension", path)
    return _MeshContent(cells=cells, **found)


def _find_hdf5_files(path: Path) -> list[Path]:
    """Return the existing HDF5 files with the numbers of an XDMF file."""
    if path.suffix.lower() not in (".xdmf", ".xmf"):
        return []
    names = {found.strip().decode("utf-8", "replace") for found in _HDF.findall(path.read_bytes())}
    return [file for file in path.parent.iterdir() if file.name in names and file.is_file()]


def _positions(path: Path, points: NumberArray) -> RealArray:
    if points.ndim != 2 or not 1 <= points.shape[1] <= 3 or points.dtype.kind not in "iuf":
        raise FormatError(
            f"positions: {points.dtype} of shape {points.shape}; expected rows of 1 to 3 numbers",
            path,
        )
    xyz = np.zeros((len(points), 3))
    xyz[:, : points.shape[1]] = points
    if not np.isfinite(xyz).all():
        raise FormatError("a position is not finite", path)
    return xyz


def _orient_outwards(cells: _CellBlock, xyz: RealArray) -> _CellBlock:
    """Return solids in the node order that encloses a positive volume."""
    # The node order of MED is mirrored relative to VTK (Gmsh, GModelIO_MED.cpp, med2mshNodeIndex),
    # but meshio writes and reads it in the order of VTK.
    order = _MIRRORED.get(cells.type)
    if order is None or not len(cells.data) or cells.data.shape[1] != len(order):
        return cells
    # From the first corner along three edges, those of the first face in its order.
    ends = [1, 2, 3] if cells.type.startswith("tetra") else [1, 3, 4]
    corners = xyz[cells.data[:, [0, *ends]]]
    volume = np.linalg.det(corners[:, 1:] - corners[:, :1])
    data = np.where((volume < 0.0)[:, None], cells.data[:, order], cells.data)
    return _CellBlock(cells.type, cells.dim, data)


def _check_indices(path: Path, what: str, members: NumberArray, size: int) -> IndexArray:
    if members.size and (members.dtype.kind not in "iu" or members.ndim != 1):
        raise FormatError(f"{what}: {members.dtype} of shape {members.shape}, no numbers", path)
    if members.size and not 0 <= members.min() <= members.max() < size:
        raise FormatError(f"{what} has a nonexistent member; {size} exist", path)
    return members.astype(np.intp)


def _groups(
    path: Path, found: _MeshContent, numbers: IntArray
) -> tuple[dict[str, dict[str, IntArray]], dict[str, int]]:
    """Return the cells of each group by type, and the number of ungrouped cells by type."""
    chosen = _members_of_groups(path, found)
    groups: dict[str, dict[str, IntArray]] = {}
    ungrouped: dict[str, int] = {}
    for block, cells in enumerate(found.cells):
        grouped = np.zeros(len(cells.data), dtype=np.bool_)
        for name, members in chosen.items():
            at = members[block]
            grouped[at] = True
            if len(at):
                kinds = groups.setdefault(name, {})
                cell_nodes = numbers[np.asarray(cells.data)[at]]
                if cells.type in kinds:
                    cell_nodes = np.concatenate([kinds[cells.type], cell_nodes])
                kinds[cells.type] = cell_nodes
        free = int((~grouped).sum())
        if free:
            ungrouped[cells.type] = ungrouped.get(cells.type, 0) + free
    return {name: groups[name] for name in chosen if name in groups}, ungrouped


def _members_of_groups(path: Path, found: _MeshContent) -> dict[str, list[IndexArray]]:
    """Return the positions of the cells of each group in each block of cells."""
    chosen: dict[str, list[IndexArray]] = {}
    for name, members in found.cell_sets.items():
        if not name.startswith("gmsh:"):
            chosen[str(name)] = _members(path, str(name), members, found.cells)
    for block, tags in enumerate(found.physical):
        for tag in np.unique(tags).tolist():
            name = _physical_group_name(found, tag, found.cells[block].dim)
            if tag == 0 or name in found.cell_sets:
                continue
            if name not in chosen:
                chosen[name] = [np.empty(0, dtype=np.intp)] * len(found.cells)
            chosen[name][block] = np.flatnonzero(np.asarray(tags) == tag)
    if not chosen:
        chosen["all"] = [np.arange(len(cells.data)) for cells in found.cells]
    return chosen


def _members(path: Path, name: str, members: Any, cells: Any) -> list[IndexArray]:
    """Return the members of a set of cells in each block; missing ones become empty arrays."""
    out = []
    for positions in members:
        array: NumberArray = np.empty((0, 0), dtype=np.intp)
        if positions is None:
            array = np.empty(0, dtype=np.intp)
        elif isinstance(positions, np.ndarray):  # else lists of other groups
            array = positions
        out.append(array)
    if len(members) != len(cells) or any(array.ndim != 1 for array in out):
        raise FormatError(
            f"group {name!r} consists of other groups in an ambiguous way; list its elements"
            " instead",
            path,
        )
    pairs = zip(out, cells, strict=True)
    return [_check_indices(path, f"group {name!r}", array, len(one.data)) for array, one in pairs]


def _physical_group_name(found: _MeshContent, tag: int, dim: int) -> str:
    for name, (group_tag, group_dim) in found.names.items():
        if int(group_tag) == tag and int(group_dim) == dim:
            return str(name)
    return f"{dim}-{tag}"


def structure_from_mesh(
    path: str | PathLike[str],
    materials: Mapping[str, Mapping[str, object]],
    *,
    unit: str,
    leave_out: Iterable[str] = (),
    ungrouped: str = "error",
    more: Iterable[Element] = (),
    links: Iterable[RigidLink] = (),
    equations: Iterable[Equation] = (),
    grounded: Iterable[str | Dof | int] = (),
    title: str = "",
) -> Model:
    """Build a structure from a mesh file.

    Parameters
    ----------
    path : path
        The mesh, as for `read_mesh`.
    materials : mapping of str to mapping
        Fields of the part of each group, as for `Mesh.parts`, in SI units for any unit of the
        mesh.
    unit : {"m", "mm", "cm", "in"}
        Unit of the positions in the file.
    leave_out : iterable of str
        Groups that are not parts. Groups in `grounded` need not be repeated.
    ungrouped : {"error", "leave out"}
        Whether cells without a group are an error or omitted.
    more : iterable of Element
        Parts that are not in the mesh: springs, masses.
    links, equations
        As for `structure`.
    grounded : iterable of str, Dof or int
        As for `structure`; the name of a group or node set fixes all its nodes.
    title : str
        Title, for documentation.

    Returns
    -------
    Model
        As from `structure`.

    Raises
    ------
    FormatError
        If the file cannot be read, a group has no material, a material has no group, or a cell has
        no group.
    ModelError
        As for `structure`.
    """
    if ungrouped not in ("error", "leave out"):
        raise ModelError(
            f"ungrouped {ungrouped!r}: {suggest(str(ungrouped), ('error', 'leave out'))}"
        )
    mesh = read_mesh(path, unit=unit)
    held: list[str | Dof | int] = []
    left_out = list(leave_out)
    for item in grounded:
        if not isinstance(item, str) or ":" in item:
            held.append(item)
        elif item in mesh.groups or item in mesh.node_sets:
            held += mesh.nodes_of(item).tolist()
            if item not in materials:
                left_out.append(item)
        else:
            known = [*mesh.groups, *mesh.node_sets]
            raise FormatError(f"grounded: no group {item!r}; {suggest(item, known)}", path)
    if mesh.ungrouped and ungrouped == "error":
        kinds = ", ".join(f"{count} {kind}" for kind, count in mesh.ungrouped.items())
        raise FormatError(
            f"cells in no group: {kinds}; put them into one, or say ungrouped='leave out'", path
        )
    return structure(
        dict(zip(mesh.nodes.tolist(), mesh.xyz, strict=True)),
        [*mesh.parts(materials, left_out), *more],
        links=links,
        equations=equations,
        grounded=list(dict.fromkeys(held)),
        title=title,
    )


# -- node numbers


def _node_numbers(path: Path) -> IntArray | None:
    """Return the node numbers of a mesh file, in its order; None if the format has none."""
    suffix = path.suffix.lower()
    if suffix == ".inp":
        return _abaqus_numbers(path, _lines(path))
    if suffix != ".msh":
        return None
    with path.open("rb") as file:
        head = file.read(200)
    if not head.startswith(b"$MeshFormat"):
        return None  # another format with the same suffix
    words = head.split()
    if len(words) < 3 or words[2] != b"0":
        raise FormatError(
            "a binary .msh: its node numbers are not read; save it as text (Mesh.Binary = 0)", path
        )
    return _gmsh_numbers(path, _lines(path), words[1].decode(errors="replace"))


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise FormatError(
            f"byte {error.start} is not text; expected a mesh in UTF-8", path
        ) from error


def _gmsh_numbers(path: Path, lines: list[str], version: str) -> IntArray:
    out: list[int] = []
    try:
        at = lines.index("$Nodes") + 1
        if version.startswith("2"):
            count = _count(lines[at])
            for line in lines[at + 1 : at + 1 + count]:
                out.append(int(line.split(maxsplit=1)[0]))
        else:
            blocks = int(lines[at].split()[0])
            at += 1
            for _ in range(blocks):
                count = _count(lines[at].split()[3])
                out += map(int, lines[at + 1 : at + 1 + count])
                at += 1 + 2 * count  # numbers, then positions
        return np.array(out, dtype=np.int64)
    except (ValueError, IndexError, OverflowError) as error:
        raise FormatError(f"the nodes cannot be read ({error})", path) from error


def _count(text: str) -> int:
    count = int(text)
    if count < 0:
        raise ValueError(f"{count} of them")
    return count


def _abaqus_numbers(path: Path, lines: list[str]) -> IntArray:
    numbers: list[int] = []
    set_lines: dict[str, int] = {}
    without_set: int | None = None
    n_node_blocks = 0
    in_nodes = False
    for number, line in enumerate(lines, 1):
        if line.startswith("**"):
            continue
        found = _KEYWORD.match(line)
        if found is None:
            if in_nodes and line.strip():
                numbers.append(_first_number(path, number, line))
            continue
        keyword = found[1].strip().upper()
        in_nodes = keyword == "NODE"
        if keyword in ("PART", "INSTANCE", "INCLUDE"):
            raise FormatError(
                f"*{keyword}: only flat decks are read; expected *NODE, *ELEMENT and sets",
                path,
                number,
            )
        if in_nodes:
            n_node_blocks += 1
            if n_node_blocks > 1:
                raise FormatError(
                    "a second *NODE block, of which the first would be lost; join them",
                    path,
                    number,
                )
        if keyword == "ELEMENT":
            element_set = _ELSET.search(line)
            if element_set is None:
                without_set = without_set or number
            elif element_set[1] in set_lines:
                raise FormatError(
                    f"*ELEMENT with ELSET={element_set[1]}, as on line"
                    f" {set_lines[element_set[1]]}, which would be lost; use two names",
                    path,
                    number,
                )
            else:
                set_lines[element_set[1]] = number
    if set_lines and without_set is not None:
        raise FormatError(
            "*ELEMENT without ELSET, but others have one; give each block an ELSET",
            path,
            without_set,
        )
    return np.array(numbers, dtype=np.int64)


def _first_number(path: Path, number: int, line: str) -> int:
    try:
        return int(np.int64(int(line.split(",", maxsplit=1)[0])))
    except (ValueError, OverflowError) as error:
        raise FormatError(
            f"{line.strip()[:30]!r}: expected a node number first", path, number
        ) from error
