"""Exodus II files (Cubit, Coreform, Sierra, MOOSE): where nodes stand, and edges of elements.

Positions are ``coordx``, ``coordy``, ``coordz``, or the rows of ``coord``; of plane files z is 0.
Node numbers are ``node_num_map``, else 1, 2, ... Blocks of elements ``connect1``, ... name nodes by
their place in the file, and their ``elem_type`` says which of them are joined by edges. The file
states no unit.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.errors import AbsentError, FormatError, UpdynWarning
from updyn.foreign import box
from updyn.geometry import Geometry
from updyn.io.items import placed, real, vector, whole
from updyn.io.lengths import length

__all__ = ["read_geometry"]

_Edges = tuple[tuple[int, int], ...]


def _ring(n: int, start: int = 0) -> _Edges:
    return tuple((start + i, start + (i + 1) % n) for i in range(n))


def _to_apex(n: int) -> _Edges:
    return tuple((i, n) for i in range(n))


def _upright(n: int) -> _Edges:
    return tuple((i, i + n) for i in range(n))


_LINE = ((0, 1),)
_TRIANGLE = _ring(3)
_QUADRANGLE = _ring(4)
#: Edges between corners, which come first in every element, by the start of its type.
_EDGES: dict[str, _Edges] = {
    "SPHERE": (),
    "CIRCLE": (),
    "POINT": (),
    "NODE": (),
    "BEAM": _LINE,
    "BAR": _LINE,
    "TRUSS": _LINE,
    "ROD": _LINE,
    "EDGE": _LINE,
    "LINE": _LINE,
    "SPRING": _LINE,
    "TRI": _TRIANGLE,  # TRISHELL, too
    "QUAD": _QUADRANGLE,
    "SHELL": _QUADRANGLE,
    "TET": (*_TRIANGLE, *_to_apex(3)),
    "PYR": (*_QUADRANGLE, *_to_apex(4)),
    "WEDGE": (*_TRIANGLE, *_ring(3, 3), *_upright(3)),
    "HEX": (*_QUADRANGLE, *_ring(4, 4), *_upright(4)),
}


def read_geometry(path: str | Path, *, unit: str = "m") -> Geometry:
    """Read where the nodes of an Exodus II file stand.

    Parameters
    ----------
    path : path
        The file: netCDF-4, or classic netCDF (also with 64-bit offsets).
    unit : {"m", "cm", "mm", "in", "ft"}
        Unit of length of the file, which states none.

    Returns
    -------
    Geometry
        Positions in m, and the edges of the elements.

    Raises
    ------
    FormatError
        If the file is damaged, or not an Exodus II file.
    OptionError
        If the unit is not known.

    Warns
    -----
    UpdynWarning
        If there are elements of a type whose edges are not known; they are not drawn.
    """
    scale = length(unit)
    found = box.load(
        "updyn.foreign.exodus:load", path, what="Exodus II file", reader="libhdf5 or scipy"
    )
    variables = found["variables"]
    xyz = _positions(variables, path)
    numbers = np.arange(1, len(xyz) + 1)
    if "node_num_map" in variables:
        numbers = whole(
            vector(variables["node_num_map"], "node_num_map", path), "node_num_map", path
        )
        if len(numbers) != len(xyz):
            raise FormatError(
                f"node_num_map: {len(numbers)} numbers for {len(xyz)} positions", path
            )
    with placed(path):
        return Geometry(numbers, xyz * scale, numbers[_edges(found, len(xyz), path)])


def _positions(variables: Mapping[str, Any], path: str | Path) -> NDArray[np.float64]:
    """Return positions in the unit of the file, shape (n, 3)."""
    if "coord" in variables:
        rows = list(np.atleast_2d(real(variables["coord"], "coord", path)))
    else:
        names = [name for name in ("coordx", "coordy", "coordz") if name in variables]
        if "coordz" in names and "coordy" not in names:
            raise FormatError("holds coordx and coordz, but no coordy", path)
        rows = [vector(variables[name], name, path) for name in names]
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


def _edges(found: Mapping[str, Any], n_nodes: int, path: str | Path) -> NDArray[np.int64]:
    """Return the places of nodes that are joined, each pair once, shape (m, 2)."""
    pairs = [np.empty((0, 2), dtype=np.int64)]
    unknown: dict[str, int] = {}
    for name, values in found["variables"].items():
        if not name.startswith("connect") or not values.size:
            continue
        kind = found["types"][name]
        elements = whole(values, name, path)
        edges = _edges_of(kind, elements.shape[1]) if elements.ndim == 2 else None
        if edges is None:
            unknown[kind] = unknown.get(kind, 0) + len(elements)
            continue
        wrong = elements[(elements < 1) | (elements > n_nodes)]
        if wrong.size:
            raise FormatError(
                f"{name}: an element at node {wrong[0]} of the file; expected 1 to {n_nodes}", path
            )
        if edges:
            pairs.append(elements[:, np.array(edges)].reshape(-1, 2) - 1)
    if unknown:
        said = ", ".join(f"{number} of type {kind!r}" for kind, number in unknown.items())
        warnings.warn(
            f"{path}: elements whose edges are not known are not drawn: {said}",
            UpdynWarning,
            stacklevel=3,
        )
    joined = np.sort(np.concatenate(pairs), axis=1)
    distinct: NDArray[np.int64] = np.unique(joined[joined[:, 0] != joined[:, 1]], axis=0)
    return distinct


def _edges_of(kind: str, n_nodes: int) -> _Edges | None:
    """Return which nodes of an element are joined, or None where that is not known."""
    for start, edges in _EDGES.items():
        if kind.upper().startswith(start):
            # A shell may be a triangle, and of a plane file a line.
            if start == "SHELL" and n_nodes < 4:
                edges = _TRIANGLE if n_nodes == 3 else _LINE
            fits = all(max(pair) < n_nodes for pair in edges)
            return edges if fits else None
    return None
