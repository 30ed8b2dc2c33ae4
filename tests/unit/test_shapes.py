"""Shapes of elements: Euler's formula, areas and volumes of what their corners enclose."""

from __future__ import annotations

import numpy as np
import pytest

from updyn.shapes import (
    HEXAHEDRON,
    LINE,
    PYRAMID,
    QUADRANGLE,
    TETRAHEDRON,
    TRIANGLE,
    WEDGE,
    as_quadrangles,
    unique_edges,
    unique_faces,
)

CUBE = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float
)
#: Corners of solids in the order of the readers, and their volume.
SOLIDS = [
    (HEXAHEDRON, CUBE, 1.0),
    (WEDGE, CUBE[[0, 1, 2, 4, 5, 6]], 0.5),
    (PYRAMID, CUBE[[0, 1, 2, 3, 4]], 1 / 3),
    (TETRAHEDRON, CUBE[[0, 1, 2, 4]], 1 / 6),
]


def volume(xyz, faces):
    """By the theorem of Gauss: a third of the flux of the position through the faces."""
    total = 0.0
    for a, b, c, d in faces:
        for triangle in ((a, b, c), (a, c, d)):
            total += np.linalg.det(xyz[list(triangle)]) / 6.0
    return total


@pytest.mark.parametrize(("shape", "xyz", "expected"), SOLIDS)
def test_the_faces_of_a_solid_enclose_it_seen_from_outside(shape, xyz, expected):
    nodes = np.arange(len(xyz))[None]
    assert len(xyz) == shape.n_corners
    faces = unique_faces([(shape, nodes)])
    assert volume(xyz, faces) == pytest.approx(expected)
    assert shape.n_corners - len(shape.edges) + len(shape.faces) == 2  # Euler
    around = {frozenset((face[i], face[i - 1])) for face in shape.faces for i in range(len(face))}
    assert around == {frozenset(edge) for edge in shape.edges}


def test_a_face_between_two_solids_of_different_shape_lies_within():
    """A cube with a pyramid on top of it, whose nodes go round the other way."""
    xyz = np.vstack([CUBE, [[0.5, 0.5, 2.0]]])
    cube, tip = np.arange(8)[None], np.array([[4, 5, 6, 7, 8]])
    faces = unique_faces([(HEXAHEDRON, cube), (PYRAMID, tip)])
    assert len(faces) == 5 + 4
    assert volume(xyz, faces) == pytest.approx(1.0 + 1 / 3)
    assert len(unique_edges([(HEXAHEDRON, cube), (PYRAMID, tip)])) == 12 + 4


@pytest.mark.parametrize(
    ("corners", "expected", "n_faces"),
    [
        ([0, 1, 2, 2, 4, 5, 6, 6], 0.5, 5),  # wedge
        ([0, 1, 2, 3, 4, 4, 4, 4], 1 / 3, 5),  # pyramid
        ([0, 1, 2, 2, 4, 4, 4, 4], 1 / 6, 4),  # tetrahedron
    ],
)
def test_a_hexahedron_whose_corners_coincide_is_what_is_left_of_it(corners, expected, n_faces):
    """As SOLID185 of Ansys writes them (Element Reference, figure of SOLID185)."""
    nodes = np.array([corners])
    faces = unique_faces([(HEXAHEDRON, nodes)])
    assert len(faces) == n_faces
    assert volume(CUBE, faces) == pytest.approx(expected)
    edges = unique_edges([(HEXAHEDRON, nodes)])
    assert len(np.unique(nodes)) - len(edges) + n_faces == 2  # Euler


def test_faces_with_corners_that_coincide():
    given = np.array([[1, 2, 3, 4], [1, 2, 3, 3], [1, 1, 2, 3], [3, 1, 2, 3], [1, 1, 2, 2]])
    expected = [[1, 2, 3, 4], [1, 2, 3, 3], [1, 2, 3, 3], [3, 1, 2, 2]]
    assert as_quadrangles(given).tolist() == expected
    assert as_quadrangles(np.array([[7, 8, 9]])).tolist() == [[7, 8, 9, 9]]


def test_shells_and_lines_and_nodes_on_edges():
    shells = np.array([[1, 2, 3, 4, 11, 12, 13, 14], [4, 3, 5, 6, 13, 15, 16, 17]])
    elements = [(QUADRANGLE, shells), (TRIANGLE, np.array([[6, 5, 7]])), (LINE, np.array([[7, 8]]))]
    assert unique_faces(elements).tolist() == [[1, 2, 3, 4], [4, 3, 5, 6], [6, 5, 7, 7]]
    edges = [[1, 2], [1, 4], [2, 3], [3, 4], [3, 5], [4, 6], [5, 6], [5, 7], [6, 7], [7, 8]]
    assert unique_edges(elements).tolist() == edges


def test_the_same_shell_twice_is_drawn_once():
    nodes = np.array([[1, 2, 3, 4], [3, 4, 1, 2]])
    assert len(unique_faces([(QUADRANGLE, nodes)])) == 1
    assert unique_faces([]).shape == (0, 4)
    assert unique_edges([]).shape == (0, 2)
