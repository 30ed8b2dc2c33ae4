"""Elements of universal files, dataset 2412: lines and faces of a geometry.

Layout: SDRC, universal file format, dataset 2412. Beams have one more record than other elements.
Nodes on edges are between the corners that they connect. Elements without a shape to draw (lumped
masses, springs, rigid elements) are passed over.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from updyn.arrays import IntArray
from updyn.errors import FormatError
from updyn.io.uff.datasets import read_integer_fields
from updyn.shapes import (
    HEXAHEDRON,
    LINE,
    QUADRANGLE,
    TETRAHEDRON,
    TRIANGLE,
    WEDGE,
    Shape,
    unique_edges,
    unique_faces,
)

__all__ = ["Elements", "element_lines", "read_elements"]

#: Descriptors of elements with an additional record.
_BEAMS = (11, 21, 22, 23, 24, 31, 32, 121)
#: Shape and positions of the corners among the nodes, by descriptor.
_SHAPES: dict[int, tuple[Shape, tuple[int, ...]]] = {
    **dict.fromkeys((11, 21, 22, 31), (LINE, (0, 1))),
    **dict.fromkeys((23, 24, 32), (LINE, (0, 2))),
    **dict.fromkeys((41, 51, 61, 74, 81, 91), (TRIANGLE, (0, 1, 2))),
    **dict.fromkeys((42, 52, 62, 72, 82, 92), (TRIANGLE, (0, 2, 4))),
    **dict.fromkeys((44, 54, 64, 71, 84, 94), (QUADRANGLE, (0, 1, 2, 3))),
    **dict.fromkeys((45, 55, 65, 75, 85, 95), (QUADRANGLE, (0, 2, 4, 6))),
    111: (TETRAHEDRON, (0, 1, 2, 3)),
    118: (TETRAHEDRON, (0, 2, 4, 9)),
    112: (WEDGE, (0, 1, 2, 3, 4, 5)),
    113: (WEDGE, (0, 2, 4, 9, 11, 13)),
    115: (HEXAHEDRON, tuple(range(8))),
    116: (HEXAHEDRON, (0, 2, 4, 6, 12, 14, 16, 18)),
}
_TRIANGLE_SHELL, _QUADRANGLE_SHELL = 91, 94
_IN_A_LINE = 8


@dataclass(frozen=True, slots=True, eq=False)
class Elements:
    """Elements of one shape: node numbers of their corners, shape (n, corners), and file lines."""

    shape: Shape
    corners: IntArray
    lines: tuple[int, ...]

    @staticmethod
    def edges(every: Sequence[Elements]) -> IntArray:
        """Return the edges of elements, shape (m, 2)."""
        return unique_edges((e.shape, e.corners) for e in every)

    @staticmethod
    def faces(every: Sequence[Elements]) -> IntArray:
        """Return the outer faces of elements, shape (k, 4)."""
        return unique_faces((e.shape, e.corners) for e in every)


def read_elements(lines: Sequence[tuple[int, str]], path: str | Path) -> list[Elements]:
    """Return the elements of a dataset 2412, given its lines with their numbers."""
    found: dict[int, list[tuple[int, list[int]]]] = {}
    at = 0
    while at < len(lines):
        line, text = lines[at]
        what = "dataset 2412, element"
        _, descriptor, _, _, _, count = read_integer_fields(text, 6, what, path, line)
        first = at + (2 if descriptor in _BEAMS else 1)
        at = first + -(-count // _IN_A_LINE)
        if count < 1 or at > len(lines):
            raise FormatError(f"{what}: {count} nodes in too few lines", path, line)
        nodes: list[int] = []
        for below, row in lines[first:at]:
            size = min(_IN_A_LINE, count - len(nodes))
            nodes += read_integer_fields(row, size, "dataset 2412, node", path, below)
        if descriptor not in _SHAPES:
            continue
        corners = _SHAPES[descriptor][1]
        if count <= max(corners):
            raise FormatError(
                f"{what}: {count} nodes of an element {descriptor}; expected at least"
                f" {max(corners) + 1}",
                path,
                line,
            )
        found.setdefault(descriptor, []).append((line, [nodes[i] for i in corners]))
    out = []
    for descriptor, rows in found.items():
        corner_nodes = np.array([nodes for _, nodes in rows], dtype=np.int64)
        out.append(Elements(_SHAPES[descriptor][0], corner_nodes, tuple(n for n, _ in rows)))
    return out


def element_lines(faces: IntArray) -> Iterator[str]:
    """Yield the lines of a dataset 2412 with faces as linear shells."""
    for number, face in enumerate(faces.tolist(), 1):
        nodes = face[:3] if face[2] == face[3] else face
        kind = _TRIANGLE_SHELL if len(nodes) == 3 else _QUADRANGLE_SHELL
        for values in ((number, kind, 1, 1, 7, len(nodes)), nodes):
            yield "".join(f"{value:10d}" for value in values)
