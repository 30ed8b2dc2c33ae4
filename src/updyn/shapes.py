"""Shapes of finite elements: edges and faces to draw, by corner.

Corners are in the order that Nastran, Abaqus, CalculiX, Ansys, Exodus, OpenSees and VTK share.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from updyn.arrays import IntArray

__all__ = [
    "HEXAHEDRON",
    "LINE",
    "PYRAMID",
    "QUADRANGLE",
    "TETRAHEDRON",
    "TRIANGLE",
    "WEDGE",
    "Shape",
    "as_quadrangles",
    "outer_faces",
    "unique_edges",
    "unique_faces",
]


@dataclass(frozen=True, slots=True)
class Shape:
    """The corners of an element; nodes on edges follow them.

    `faces` have their corners as seen from outside. If it `encloses` a volume, a face that two
    elements share is an inner face.
    """

    n_corners: int
    edges: tuple[tuple[int, int], ...]
    faces: tuple[tuple[int, ...], ...] = ()
    encloses: bool = False


def _ring_edges(n: int, start: int = 0) -> tuple[tuple[int, int], ...]:
    return tuple((start + i, start + (i + 1) % n) for i in range(n))


def _upright_edges(n: int) -> tuple[tuple[int, int], ...]:
    return tuple((i, i + n) for i in range(n))


def _apex_edges(n: int) -> tuple[tuple[int, int], ...]:
    return tuple((i, n) for i in range(n))


LINE = Shape(2, ((0, 1),))
TRIANGLE = Shape(3, _ring_edges(3), ((0, 1, 2),))
QUADRANGLE = Shape(4, _ring_edges(4), ((0, 1, 2, 3),))
TETRAHEDRON = Shape(
    4,
    (*_ring_edges(3), *_apex_edges(3)),
    ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)),
    encloses=True,
)
PYRAMID = Shape(
    5,
    (*_ring_edges(4), *_apex_edges(4)),
    ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
    encloses=True,
)
WEDGE = Shape(
    6,
    (*_ring_edges(3), *_ring_edges(3, 3), *_upright_edges(3)),
    ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    encloses=True,
)
HEXAHEDRON = Shape(
    8,
    (*_ring_edges(4), *_ring_edges(4, 4), *_upright_edges(4)),
    ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
    encloses=True,
)


def unique_edges(elements: Iterable[tuple[Shape, IntArray]]) -> IntArray:
    """Return the edges of elements, each once, as two nodes, (n, 2), that do not coincide."""
    pairs = [np.empty((0, 2), dtype=np.int64)]
    for shape, nodes in elements:
        pairs.append(nodes[:, np.array(shape.edges)].reshape(-1, 2))
    joined = np.unique(np.sort(np.concatenate(pairs), axis=1), axis=0)
    return np.asarray(joined[joined[:, 0] != joined[:, 1]])


def unique_faces(elements: Iterable[tuple[Shape, IntArray]]) -> IntArray:
    """Return the outer faces of elements, each once, (n, 4); triangles repeat the last node."""
    solid = [np.empty((0, 4), dtype=np.int64)]
    open_ = [np.empty((0, 4), dtype=np.int64)]
    for shape, nodes in elements:
        found = solid if shape.encloses else open_
        found += [as_quadrangles(nodes[:, face]) for face in map(list, shape.faces)]
    return outer_faces(np.concatenate(solid), np.concatenate(open_))


def as_quadrangles(faces: IntArray) -> IntArray:
    """Return faces of three or more distinct nodes, (m, 4); triangles repeat the last node."""
    given = faces if faces.shape[1] == 4 else faces[:, [0, 1, 2, 2]]
    stands = given != np.roll(given, -1, axis=1)  # last of coincident neighbours
    order = np.argsort(~stands, axis=1, kind="stable")
    out = np.take_along_axis(given, order, axis=1)
    count = stands.sum(axis=1)
    out[count == 3, 3] = out[count == 3, 2]
    return np.asarray(out[count >= 3])


def outer_faces(solid: IntArray, open_: IntArray) -> IntArray:
    """Return shell faces, and faces of solids that occur once, in order and without repetition."""
    _, first, count = np.unique(_sort_nodes(solid), axis=0, return_index=True, return_counts=True)
    every = np.concatenate([solid[np.sort(first[count == 1])], open_])
    _, first = np.unique(_sort_nodes(every), axis=0, return_index=True)
    return np.asarray(every[np.sort(first)])


def _sort_nodes(faces: IntArray) -> IntArray:
    """Return faces, shape (n, 4), with sorted nodes; a triangle has its smallest node twice."""
    out = np.sort(faces, axis=1)
    triangle = faces[:, 2] == faces[:, 3]
    three = np.sort(faces[triangle, :3], axis=1)
    out[triangle] = three[:, [0, 0, 1, 2]]
    return out
