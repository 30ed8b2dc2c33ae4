"""Attributes of the elements of an Ansys model, and the positions of its nodes.

Both are read from the ``.cdb`` archive (CDWRITE) or the ``.rst`` result file by ansys-mapdl-reader.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from updyn.arrays import IntArray, RealArray
from updyn.errors import FormatError, OptionError, suggest
from updyn.foreign import box
from updyn.geometry import Geometry
from updyn.io.ansys.archive import check_archive
from updyn.io.items import is_file, locate_errors
from updyn.shapes import (
    HEXAHEDRON,
    LINE,
    QUADRANGLE,
    TETRAHEDRON,
    Shape,
    unique_edges,
    unique_faces,
)

__all__ = ["BY", "Attributes", "find_neighbour", "name_groups", "read_attributes"]

#: The first numbers in an element's row.
_NUMBERS = ("material", "type", "real", "section")
BY = (*_NUMBERS, "component")

#: Elements whose matrices are defined by real constants or a matrix, not by a material:
#: COMBIN14, MASS21, MATRIX27, COMBIN37, COMBIN39, COMBIN40, COMBI214, COMBI250.
_NO_MATERIAL = (14, 21, 27, 37, 39, 40, 214, 250)
#: Shapes by element routine.
_SHAPES: dict[int, Shape] = {
    **dict.fromkeys((45, 95, 185, 186, 190), HEXAHEDRON),
    **dict.fromkeys((92, 187, 285), TETRAHEDRON),
    **dict.fromkeys((42, 63, 82, 93, 181, 182, 183, 281), QUADRANGLE),
    **dict.fromkeys((3, 4, 8, 14, 16, 39, 40, 44, 180, 188, 189, 214, 288, 289), LINE),
}
_FIRST_NODE = 10  # in an element's row, after ten attributes


@dataclass(frozen=True, slots=True)
class Attributes:
    """Elements and nodes of a model.

    `numbers` has the attribute number of each element, shape (n,), by "material", "type", "real"
    and "section"; `routine` is 186 for SOLID186. `nodes_of` are the node numbers of each element,
    `components` element numbers by name. `xyz` (m, 3) is in units of the deck; `angles` (m, 3) are
    the rotations THXY, THYZ, THZX of the nodal systems in degrees.
    """

    path: Path
    elements: IntArray
    numbers: Mapping[str, IntArray]
    routine: IntArray
    nodes_of: Sequence[IntArray]
    components: Mapping[str, IntArray]
    nodes: IntArray
    xyz: RealArray
    angles: RealArray

    def geometry(self, length: float) -> Geometry:
        """Return positions in m, nodal systems, edges and faces; `length` is the unit in m."""
        drawn = self._corners_by_shape()
        axes = _axes(self.angles) if np.any(self.angles) else None
        with locate_errors(self.path):
            xyz = self.xyz * length
            return Geometry(self.nodes, xyz, unique_edges(drawn), axes, unique_faces(drawn))

    def _corners_by_shape(self) -> list[tuple[Shape, IntArray]]:
        """Return the corner nodes of the elements, by shape."""
        known = set(self.nodes.tolist())
        found: dict[Shape, list[IntArray]] = {}
        for routine, nodes in zip(self.routine.tolist(), self.nodes_of, strict=True):
            shape = _SHAPES.get(routine)
            if shape is None or len(nodes) < shape.n_corners:
                continue
            corners = nodes[: shape.n_corners]
            if known.issuperset(corners.tolist()):
                found.setdefault(shape, []).append(corners)
        return [(shape, np.array(nodes)) for shape, nodes in found.items()]


def _axes(angles: RealArray) -> RealArray:
    """Return directions of nodal systems, shape (m, 3, 3), rows X, Y, Z in the global system."""
    # The rotations are about Z, then the new X, then the new Y (Ansys Mechanical APDL, command N).
    cz, cx, cy = np.cos(np.radians(angles.T))
    sz, sx, sy = np.sin(np.radians(angles.T))
    zero = np.zeros_like(cz)
    one = np.ones_like(cz)
    about_z = np.array([[cz, -sz, zero], [sz, cz, zero], [zero, zero, one]])
    about_x = np.array([[one, zero, zero], [zero, cx, -sx], [zero, sx, cx]])
    about_y = np.array([[cy, zero, sy], [zero, one, zero], [-sy, zero, cy]])
    columns = np.einsum("ijn,jkn,kln->nil", about_z, about_x, about_y)
    return np.asarray(columns.transpose(0, 2, 1))


def read_attributes(path: str | Path) -> Attributes:
    """Read a ``.cdb`` archive or a ``.rst`` result file."""
    path = Path(path)
    if not is_file(path):
        raise FormatError("attributes: no such file", path)
    if path.suffix.lower() != ".rst":
        check_archive(path)
    found = box.load(
        "updyn.foreign.ansys:load", path, what="file of Ansys", reader="ansys-mapdl-reader"
    )
    if not found["lengths"].size:
        raise FormatError("holds no elements (EBLOCK)", path)
    lengths = found["lengths"]
    if len(found["elements"]) != len(lengths) or lengths.min() < len(_NUMBERS):
        raise FormatError(
            f"{len(found['elements'])} element numbers for {len(lengths)} elements: damaged", path
        )
    rows = np.split(found["rows"], np.cumsum(lengths)[:-1])
    numbers = np.array([row[: len(_NUMBERS)] for row in rows])
    routines = dict(found["routines"].tolist())
    angles = found["angles"]
    if angles is None:
        angles = np.zeros((len(found["nodes"]), 3))
    return Attributes(
        path,
        found["elements"],
        dict(zip(_NUMBERS, numbers.T, strict=True)),
        np.array([routines.get(kind, 0) for kind in numbers[:, 1].tolist()]),
        [row[_FIRST_NODE:] for row in rows],
        found["components"],
        found["nodes"],
        found["xyz"],
        angles,
    )


def name_groups(
    elements: IntArray,
    attributes: Attributes | None,
    by: str,
    groups: Mapping[str, Iterable[int]] | None,
    path: str | Path,
) -> NDArray[np.object_]:
    """Return the group name of each element: "material 1", a component, or "remaining"."""
    # For `by` "material", springs, point masses and matrices (COMBIN14, MASS21, MATRIX27 and the
    # like) are grouped by their real constants, because they have no material.
    if groups is not None:
        parts = {str(name): np.array(list(part), dtype=np.int64) for name, part in groups.items()}
        return _assign_groups(elements, parts, "groups", path)
    if by not in BY:
        raise OptionError(f"by={by!r}: {suggest(str(by), BY)}")
    if attributes is None:
        raise FormatError(
            f"the file does not contain the {by} of its elements: give attributes= (the model's"
            " .cdb, written with CDWRITE, or its .rst), or groups= with element numbers; a .cdb or"
            " .rst with the same name in the same folder is found automatically",
            path,
        )
    if by == "component":
        if not attributes.components:
            raise FormatError("holds no component of elements (CM, ...,ELEM)", attributes.path)
        members = {}
        for name, part in attributes.components.items():
            existing = part[np.isin(part, elements)]
            if existing.size:
                members[name] = existing
        return _assign_groups(elements, members, "components", path)
    missing = elements[~np.isin(elements, attributes.elements)]
    if missing.size:
        raise FormatError(
            f"element {missing[0]} ({missing.size} such) is not in {attributes.path.name}, which"
            f" has {len(attributes.elements)} elements; the reader supports only one EBLOCK: use"
            " the .rst file, or write one block (CDWRITE)",
            path,
        )
    order = np.argsort(attributes.elements, kind="stable")
    index = order[np.searchsorted(attributes.elements, elements, sorter=order)]
    names = np.array([f"{by} {n}" for n in attributes.numbers[by][index]], dtype=object)
    if by == "material":
        springs = np.isin(attributes.routine[index], _NO_MATERIAL)
        names[springs] = [f"real {n}" for n in attributes.numbers["real"][index][springs]]
    return names


def _assign_groups(
    elements: IntArray, parts: Mapping[str, IntArray], what: str, path: str | Path
) -> NDArray[np.object_]:
    if not parts:
        raise OptionError(f"{what}: none contains an element")
    for name, part in parts.items():
        if not part.size:
            raise OptionError(f"{what}: {name!r} is empty")
        absent = part[~np.isin(part, elements)]
        if absent.size:
            raise OptionError(
                f"{what}: {name!r} contains element {absent[0]} ({absent.size} such), which is not"
                f" in {path}"
            )
    members = np.concatenate([np.unique(part) for part in parts.values()])
    numbers, counts = np.unique(members, return_counts=True)
    twice = numbers[counts > 1]
    if twice.size:
        names = [name for name, part in parts.items() if twice[0] in part]
        raise FormatError(
            f"element {twice[0]} ({twice.size} such) is in"
            f" {' and '.join(map(repr, names))}; expected one group per element: select it with"
            " groups=",
            path,
        )
    out = np.full(len(elements), "remaining", dtype=object)
    for name, part in parts.items():
        out[np.isin(elements, part)] = name
    return out


def find_neighbour(path: str | Path, *suffixes: str) -> Path | None:
    """Return the existing file of the same name with one of the suffixes, in order, or None."""
    for suffix in suffixes:
        for found in (Path(path).with_suffix(suffix), Path(path).with_suffix(suffix.upper())):
            if is_file(found):
                return found
    return None
