"""Exodus II files (Cubit, Coreform, Sierra, MOOSE): node positions, and the elements to draw.

Node numbers are ``node_num_map``, else 1, 2, ... Blocks ``connect1``, ... refer to nodes by their
position in the file. The file states no unit.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from updyn.arrays import IntArray, RealArray
from updyn.errors import AbsentError, FormatError, UpdynWarning
from updyn.foreign import box
from updyn.geometry import Geometry
from updyn.io.items import as_integers, as_reals, as_vector, locate_errors
from updyn.io.lengths import length
from updyn.shapes import (
    HEXAHEDRON,
    LINE,
    PYRAMID,
    QUADRANGLE,
    TETRAHEDRON,
    TRIANGLE,
    WEDGE,
    Shape,
    unique_edges,
    unique_faces,
)

__all__ = ["read_geometry"]

#: Shapes by the start of their type; None if nothing is drawn.
_SHAPES = {
    "SPHERE": None,
    "CIRCLE": None,
    "POINT": None,
    "NODE": None,
    "BEAM": LINE,
    "BAR": LINE,
    "TRUSS": LINE,
    "ROD": LINE,
    "EDGE": LINE,
    "LINE": LINE,
    "SPRING": LINE,
    "TRI": TRIANGLE,  # TRISHELL, too
    "QUAD": QUADRANGLE,
    "SHELL": QUADRANGLE,
    "TET": TETRAHEDRON,
    "PYR": PYRAMID,
    "WEDGE": WEDGE,
    "HEX": HEXAHEDRON,
}
#: A shell may be a triangle, or a line in a plane file.
_SHELLS = {2: LINE, 3: TRIANGLE}


def read_geometry(path: str | Path, *, unit: str = "m") -> Geometry:
    """Read node positions in m and edges of an Exodus II file, in netCDF-4 or classic netCDF."""
    scale = length(unit)
    found = box.load(
        "updyn.foreign.exodus:load", path, what="Exodus II file", reader="libhdf5 or scipy"
    )
    variables = found["variables"]
    xyz = _positions(variables, path)
    numbers = np.arange(1, len(xyz) + 1)
    if "node_num_map" in variables:
        numbers = as_integers(
            as_vector(variables["node_num_map"], "node_num_map", path), "node_num_map", path
        )
        if len(numbers) != len(xyz):
            raise FormatError(
                f"node_num_map: {len(numbers)} numbers for {len(xyz)} positions", path
            )
    with locate_errors(path):
        drawn = _corners_by_shape(found, len(xyz), path)
        lines, faces = numbers[unique_edges(drawn)], numbers[unique_faces(drawn)]
        return Geometry(numbers, xyz * scale, lines, faces=faces)


def _positions(variables: Mapping[str, object], path: str | Path) -> RealArray:
    """Return positions in the unit of the file, shape (n, 3)."""
    if "coord" in variables:
        rows = list(np.atleast_2d(as_reals(variables["coord"], "coord", path)))
    else:
        names = [name for name in ("coordx", "coordy", "coordz") if name in variables]
        if "coordz" in names and "coordy" not in names:
            raise FormatError("holds coordx and coordz, but no coordy", path)
        rows = [as_vector(variables[name], name, path) for name in names]
    lengths = [len(row) for row in rows]
    if len(rows) > 3 or len(set(lengths)) > 1:
        raise FormatError(
            f"found {' and '.join(map(str, lengths))} numbers as the coordinates of the nodes;"
            " expected at most three rows, equally long",
            path,
        )
    if not lengths[0]:
        raise AbsentError("an Exodus II file without nodes", path)
    xyz = np.zeros((lengths[0], 3))
    xyz[:, : len(rows)] = np.transpose(rows)
    return xyz


def _corners_by_shape(
    found: Mapping[str, Any], n_nodes: int, path: str | Path
) -> list[tuple[Shape, IntArray]]:
    """Return the elements by shape, with the positions of their nodes."""
    drawn: list[tuple[Shape, IntArray]] = []
    unknown: dict[str, int] = {}
    for name, values in found["variables"].items():
        if not name.startswith("connect") or not values.size:
            continue
        kind = found["types"][name].upper()
        elements = as_integers(values, name, path)
        start = next((start for start in _SHAPES if kind.startswith(start)), None)
        n_own = elements.shape[1] if elements.ndim == 2 else 0
        shape = None if start is None else _SHAPES[start]
        if start == "SHELL":
            shape = _SHELLS.get(n_own, shape)
        if start is None or not n_own or (shape is not None and n_own < shape.n_corners):
            unknown[found["types"][name]] = unknown.get(found["types"][name], 0) + len(elements)
            continue
        wrong = elements[(elements < 1) | (elements > n_nodes)]
        if wrong.size:
            raise FormatError(
                f"{name}: an element at node {wrong[0]} of the file; expected 1 to {n_nodes}", path
            )
        if shape is not None:
            drawn.append((shape, elements - 1))
    if unknown:
        found_kinds = ", ".join(f"{number} of type {kind!r}" for kind, number in unknown.items())
        warnings.warn(
            f"{path}: elements of unknown types are not drawn: {found_kinds}",
            UpdynWarning,
            stacklevel=3,
        )
    return drawn
