"""Meshes of Gmsh, Abaqus, VTK and others, read by meshio: each physical group becomes a part of a structure.

meshio drops the node numbers of a file and reads some Abaqus decks wrongly: node numbers are read
here, and such decks are refused.
"""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
from updyn.model import Model

__all__ = [
    "Mesh",
    "numbers_in",
    "read_mesh",
    "structure_from_mesh",
]

#: Metres in a unit of length.
UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254}
_SOLIDS = ("tetra", "tetra10", "hexahedron", "hexahedron20")
_SHELLS = ("triangle", "quad")
_LINES = ("line",)
_POINTS = ("vertex",)
#: What meshio raises for damaged files.
_FAILURES = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    LookupError,
    OSError,
    SyntaxError,
    TypeError,
    ValueError,
)


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A mesh with its groups.

    Attributes
    ----------
    path : str
        Where it was read.
    nodes : ndarray of int, shape (n,)
        Node numbers of the file; 1, 2, ... of formats that have none.
    xyz : ndarray of float, shape (n, 3)
        Positions in m.
    groups : mapping of str to mapping of str to ndarray of int, shape (m, k)
        By group and kind of cell (of meshio: ``"quad"``, ``"tetra10"``, ...) the node numbers of
        its cells.
    node_sets : mapping of str to ndarray of int, shape (m,)
        Named sets of nodes.
    ungrouped : mapping of str to int
        Number of cells in no group, by kind.
    """

    path: str
    nodes: NDArray[np.int64]
    xyz: NDArray[np.float64]
    groups: Mapping[str, Mapping[str, NDArray[np.int64]]]
    node_sets: Mapping[str, NDArray[np.int64]]
    ungrouped: Mapping[str, int]

    def nodes_of(self, name: str) -> NDArray[np.int64]:
        """Return the numbers of the nodes of a group or of a set of nodes, ascending.

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
            If there is none of that name; the nearest are named.
        """
        if name in self.node_sets:
            return np.unique(self.node_sets[name])
        if name in self.groups:
            return np.unique(
                np.concatenate([cells.ravel() for cells in self.groups[name].values()])
            )
        raise FormatError(
            f"no group {name!r}; {suggest(name, [*self.groups, *self.node_sets])}", self.path
        )

    def parts(
        self, materials: Mapping[str, Mapping[str, Any]], leave_out: Iterable[str] = ()
    ) -> list[Element]:
        """Return the parts of a structure: one for each group and kind of cell.

        Parameters
        ----------
        materials : mapping of str to mapping
            By group the fields of its part, in SI units, name and connectivity left out. Surfaces
            are `Shell`, volumes `Solid`; lines are `Beam` where ``section`` is given, else `Truss`;
            points are `PointMass`.
        leave_out : iterable of str
            Groups that are no parts: faces to hold, or to link.

        Returns
        -------
        list of Element

        Raises
        ------
        FormatError
            If a group has no material, a material no group, a cell two of them, or a kind of cell
            is not known.
        ModelError
            If a field is missing or unknown, or a value out of range.
        """
        omitted = set(leave_out)
        for name in [*materials, *omitted]:
            if name not in self.groups and not (name in omitted and name in self.node_sets):
                raise FormatError(
                    f"no group {name!r}; {suggest(str(name), self.groups)}", self.path
                )
        for name in self.groups:
            if name not in materials and name not in omitted:
                kinds = ", ".join(f"{len(c)} {kind}" for kind, c in self.groups[name].items())
                raise FormatError(
                    f"group {name!r} ({kinds}) has no material; give it one, or leave the"
                    " group out",
                    self.path,
                )
        self._check_once(materials)
        out: list[Element] = []
        for name, given in materials.items():
            for kind, cells in self.groups[name].items():
                out += _parts(self.path, name, kind, cells, given)
        return out

    def _check_once(self, materials: Iterable[str]) -> None:
        chosen = list(materials)
        for kind in {k for name in chosen for k in self.groups[name]}:
            own = [(name, self.groups[name][kind]) for name in chosen if kind in self.groups[name]]
            cells = np.sort(np.concatenate([c for _, c in own]), axis=1)
            group = np.repeat(np.arange(len(own)), [len(c) for _, c in own])
            _, first, place = np.unique(cells, axis=0, return_index=True, return_inverse=True)
            twice = np.flatnonzero(first[place.ravel()] != np.arange(len(cells)))
            if twice.size:
                at = int(twice[0])
                names = own[group[first[place.ravel()[at]]]][0], own[group[at]][0]
                raise FormatError(
                    f"the {kind} of nodes {cells[at].tolist()} stands twice: in group {names[0]!r}"
                    f" and in {names[1]!r}",
                    self.path,
                )


def _parts(
    path: str, name: str, kind: str, cells: NDArray[np.int64], given: Mapping[str, Any]
) -> list[Element]:
    what = f"material of group {name!r}"
    if not isinstance(given, Mapping):
        raise ModelError(f"{what}: {given!r}; expected a mapping of field to value")
    part: Any
    if kind in _SOLIDS:
        part = Solid
    elif kind in _SHELLS:
        part = Shell
    elif kind in _LINES:
        part = Beam if "section" in given else Truss
    elif kind in _POINTS:
        part = PointMass
    else:
        known = (*_POINTS, *_LINES, *_SHELLS, *_SOLIDS)
        raise FormatError(
            f"group {name!r} has {len(cells)} cells of kind {kind!r}; {suggest(kind, known)}", path
        )
    names, required = field_names(part)
    left_out = ("name", "connectivity", "node")
    check_keys(
        f"{what}, a {part.__name__}",
        given,
        [name for name in required if name not in left_out],
        [name for name in names if name not in left_out],
    )
    if kind in _POINTS:
        return [PointMass(name, int(node), **given) for node in cells.ravel()]
    return [part(name, cells, **given)]


def read_mesh(path: str | PathLike[str], *, unit: str) -> Mesh:
    """Read a mesh file with its groups.

    Parameters
    ----------
    path : path
        ``.msh`` of Gmsh (text), ``.inp`` of Abaqus, ``.vtu``, ``.med`` or whatever else meshio
        reads.
    unit : {"m", "mm", "cm", "in"}
        Of the positions in the file; no format says it.

    Returns
    -------
    Mesh
        Groups are the physical groups of Gmsh and the element sets of Abaqus, by their names. A
        file without any has one group, called ``"all"``.

    Raises
    ------
    FormatError
        If the file is not there, is damaged, or holds what meshio would read wrongly.
    ModelError
        If the unit is not known, or meshio is missing.
    """
    if unit not in UNITS:
        raise ModelError(f"unit {unit!r}: {suggest(str(unit), UNITS)}")
    path = Path(path)
    if not path.is_file():
        raise FormatError("no such file; expected a mesh", path)
    numbers = numbers_in(path)
    found = _read(path)
    xyz = np.zeros((len(found.points), 3))
    xyz[:, : found.points.shape[1]] = found.points
    if not np.isfinite(xyz).all():
        raise FormatError("a position is not finite", path)
    if numbers is None:
        numbers = np.arange(1, len(xyz) + 1)
    if len(numbers) != len(xyz):
        raise FormatError(f"found {len(numbers)} node numbers for {len(xyz)} positions", path)
    groups, ungrouped = _groups(path, found, numbers)
    sets = {str(k): numbers[np.asarray(v, dtype=np.intp)] for k, v in found.point_sets.items()}
    return Mesh(str(path), numbers, xyz * UNITS[unit], groups, sets, ungrouped)


def _read(path: Path) -> Any:
    try:
        import meshio
    except ImportError as error:
        raise ModelError('mesh files need meshio: pip install "updyn[mesh]"') from error
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            return meshio.read(path)
    except (
        meshio.ReadError,
        SystemExit,
        *_FAILURES,
    ) as error:  # meshio ends the process on some bad files
        lines = [
            line
            for line in (*said.getvalue().splitlines(), str(error))
            if line.strip() and line.strip() != "1"
        ]
        raise FormatError(
            f"not a mesh that can be read ({lines[0].strip() if lines else error!r})", path
        ) from error


def _groups(
    path: Path, found: Any, numbers: NDArray[np.int64]
) -> tuple[dict[str, dict[str, NDArray[np.int64]]], dict[str, int]]:
    """Return the cells of each group by kind, and how many are in none."""
    chosen: dict[str, list[NDArray[np.intp]]] = {}
    for name, members in found.cell_sets.items():
        if not name.startswith("gmsh:"):
            chosen[str(name)] = _members(path, str(name), members, found.cells)
    physical = found.cell_data.get("gmsh:physical", [])
    for block, tags in enumerate(physical):
        for tag in np.unique(tags).tolist():
            name = _physical(found, tag, found.cells[block].dim)
            if tag == 0 or name in found.cell_sets:
                continue
            own = chosen.setdefault(name, [np.empty(0, dtype=np.intp) for _ in found.cells])
            own[block] = np.flatnonzero(np.asarray(tags) == tag)
    if not chosen:
        chosen["all"] = [np.arange(len(cells.data)) for cells in found.cells]
    groups: dict[str, dict[str, NDArray[np.int64]]] = {}
    for name, lists in chosen.items():
        for cells, at in zip(found.cells, lists, strict=True):
            if len(at):
                kinds = groups.setdefault(name, {})
                more = numbers[np.asarray(cells.data)[at]]
                kinds[cells.type] = (
                    np.concatenate([kinds[cells.type], more]) if cells.type in kinds else more
                )
    none: dict[str, int] = {}
    for block, cells in enumerate(found.cells):
        free = len(cells.data) - len(
            np.unique(np.concatenate([lists[block] for lists in chosen.values()]))
        )
        if free:
            none[cells.type] = none.get(cells.type, 0) + free
    return groups, none


def _members(path: Path, name: str, members: Any, cells: Any) -> list[NDArray[np.intp]]:
    if len(members) != len(cells) or any(
        m is not None and np.ndim(m) != 1 for m in map(_array, members)
    ):
        raise FormatError(
            f"group {name!r} is made of other groups in a way that cannot be told apart; name its"
            " elements themselves",
            path,
        )
    return [np.asarray([] if m is None else m, dtype=np.intp) for m in members]


def _array(members: Any) -> Any:
    try:
        return None if members is None else np.asarray(members, dtype=np.intp)
    except (TypeError, ValueError):
        return np.empty((0, 0))  # a list of lists of other groups


def _physical(found: Any, tag: int, dim: int) -> str:
    for name, (own, own_dim) in found.field_data.items():
        if int(own) == tag and int(own_dim) == dim:
            return str(name)
    return f"{dim}-{tag}"


def structure_from_mesh(
    path: str | PathLike[str],
    materials: Mapping[str, Mapping[str, Any]],
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
        By group the fields of its part, as for `Mesh.parts`, in SI units whatever the unit of the
        mesh.
    unit : {"m", "mm", "cm", "in"}
        Of the positions in the file.
    leave_out : iterable of str
        Groups that are no parts. Those in `grounded` need not be named again.
    ungrouped : {"error", "leave out"}
        What becomes of cells in no group.
    more : iterable of Element
        Parts that the mesh does not have: springs, masses.
    links, equations
        As for `structure`.
    grounded : iterable of str, Dof or int
        As for `structure`; the name of a group or set of nodes holds all its nodes.
    title : str
        For the record.

    Returns
    -------
    Model
        As of `structure`.

    Raises
    ------
    FormatError
        If the file cannot be read, a group has no material, a material no group, or a cell no
        group.
    ModelError
        As for `structure`.
    """
    if ungrouped not in ("error", "leave out"):
        raise ModelError(
            f"ungrouped {ungrouped!r}: {suggest(str(ungrouped), ('error', 'leave out'))}"
        )
    mesh = read_mesh(path, unit=unit)
    held: list[str | Dof | int] = []
    named: list[str] = []
    for item in grounded:
        if isinstance(item, str) and (item in mesh.groups or item in mesh.node_sets):
            named.append(item)
            held += mesh.nodes_of(item).tolist()
        elif isinstance(item, str) and ":" not in item:
            raise FormatError(
                f"grounded: no group {item!r}; {suggest(item, [*mesh.groups, *mesh.node_sets])}",
                path,
            )
        else:
            held.append(item)
    if mesh.ungrouped and ungrouped == "error":
        kinds = ", ".join(f"{count} {kind}" for kind, count in mesh.ungrouped.items())
        raise FormatError(
            f"cells in no group: {kinds}; put them into one, or say ungrouped='leave out'", path
        )
    parts = mesh.parts(materials, [*leave_out, *(n for n in named if n not in materials)])
    nodes = dict(zip(mesh.nodes.tolist(), mesh.xyz, strict=True))
    return structure(
        nodes,
        [*parts, *more],
        links=links,
        equations=equations,
        grounded=list(dict.fromkeys(held)),
        title=title,
    )


_KEYWORD = re.compile(r"\*\s*(\w[\w ]*)")


def numbers_in(path: Path) -> NDArray[np.int64] | None:
    """Return the node numbers of a mesh file, in its order; None where the format has none.

    Raises
    ------
    FormatError
        If the numbers are not there, or meshio would take the groups of an Abaqus deck for others:
        element blocks without a set beside some with one, one set in two blocks, several blocks of
        nodes, parts and includes.
    """
    suffix = path.suffix.lower()
    if suffix == ".msh":
        with path.open("rb") as file:
            head = file.read(200)
        if not head.startswith(b"$MeshFormat"):
            return None  # the same suffix is used by others
        words = head.split()
        if len(words) < 3 or words[2] != b"0":
            raise FormatError(
                "a binary .msh: its node numbers are not read; save it as text (Mesh.Binary = 0)",
                path,
            )
        return _gmsh(path, _lines(path), words[1].decode(errors="replace"))
    return _abaqus(path, _lines(path)) if suffix == ".inp" else None


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise FormatError(
            f"byte {error.start} is not text; expected a mesh in UTF-8", path
        ) from error


def _gmsh(path: Path, lines: list[str], version: str) -> NDArray[np.int64]:
    try:
        at = lines.index("$Nodes") + 1
        out: list[int] = []
        if version.startswith("2"):
            count = int(lines[at])
            out = [int(line.split(maxsplit=1)[0]) for line in lines[at + 1 : at + 1 + count]]
        else:
            blocks, at = int(lines[at].split()[0]), at + 1
            for _ in range(blocks):
                count = int(lines[at].split()[3])
                out += [int(line) for line in lines[at + 1 : at + 1 + count]]
                at += 1 + 2 * count
    except (ValueError, IndexError) as error:
        raise FormatError(f"the nodes cannot be read ({error})", path) from error
    return np.array(out, dtype=np.int64)


def _abaqus(path: Path, lines: list[str]) -> NDArray[np.int64]:
    out: list[int] = []
    sets: dict[str, int] = {}
    without: int | None = None
    blocks, inside = 0, False
    for number, line in enumerate(lines, 1):
        if line.startswith("**"):
            continue
        found = _KEYWORD.match(line)
        if found is None:
            if inside and line.strip():
                out.append(_first(path, number, line))
            continue
        word = found[1].strip().upper()
        inside = word == "NODE"
        if word in ("PART", "INSTANCE", "INCLUDE"):
            raise FormatError(
                f"*{word}: only flat decks are read; expected *NODE, *ELEMENT and sets",
                path,
                number,
            )
        if inside:
            blocks += 1
            if blocks > 1:
                raise FormatError(
                    "a second *NODE block, of which the first would be lost; join them",
                    path,
                    number,
                )
        if word == "ELEMENT":
            own = re.search(r"ELSET\s*=\s*([^,\s]+)", line, re.IGNORECASE)
            if own is None:
                without = without or number
            elif own[1] in sets:
                raise FormatError(
                    f"*ELEMENT with ELSET={own[1]}, as on line {sets[own[1]]}, which would be lost;"
                    " use two names",
                    path,
                    number,
                )
            else:
                sets[own[1]] = number
    if sets and without is not None:
        raise FormatError(
            "*ELEMENT without ELSET beside others with one; give each block its own", path, without
        )
    return np.array(out, dtype=np.int64)


def _first(path: Path, number: int, line: str) -> int:
    try:
        return int(line.split(",", maxsplit=1)[0])
    except ValueError as error:
        raise FormatError(
            f"{line.strip()[:30]!r}: expected a node number first", path, number
        ) from error
