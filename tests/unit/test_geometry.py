"""Geometry: positions, lines to draw, directions."""

from __future__ import annotations

import dataclasses
import pickle
import re

import numpy as np
import pytest

from updyn.errors import InputError
from updyn.geometry import Geometry

TURNED = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]


@pytest.fixture
def three() -> Geometry:
    return Geometry(
        [7, 3, 5],
        [[0, 0, 0], [1, 0, 0], [1, 2, 0]],
        lines=[[7, 3], [3, 5]],
        axes=[np.eye(3), TURNED, np.eye(3)],
    )


def test_what_is_held(three):
    assert three.nodes.tolist() == [7, 3, 5]
    assert three.xyz.tolist() == [[0, 0, 0], [1, 0, 0], [1, 2, 0]]
    assert three.lines.tolist() == [[7, 3], [3, 5]]
    assert three.axes[1].tolist() == TURNED


def test_lines_and_axes_are_optional():
    bare = Geometry([1], [[0, 0, 0]])
    assert bare.lines.shape == (0, 2)
    assert bare.axes is None
    assert Geometry([1], [[0, 0, 0]], lines=[]).lines.shape == (0, 2)
    assert Geometry([], np.zeros((0, 3))).nodes.size == 0


def test_position(three):
    assert three.position([5, 7, 5]).tolist() == [[1, 2, 0], [0, 0, 0], [1, 2, 0]]
    assert three.position(3).tolist() == [[1, 0, 0]]


@pytest.mark.parametrize(
    ("nodes", "text"),
    [
        ([3, 9, 8], "geometry: node 9 has no position (2 such); nearest: 7, 5, 3"),
        ([-1], "geometry: node -1 has no position; nearest: 3, 5, 7"),
        ([3.5], "geometry: nodes: expected whole numbers"),
    ],
)
def test_position_of_an_unknown_node(three, nodes, text):
    with pytest.raises(InputError, match=re.escape(text)):
        three.position(nodes)


def test_position_in_an_empty_geometry():
    with pytest.raises(InputError, match="node 1 has no position; the geometry is empty"):
        Geometry([], np.zeros((0, 3))).position([1])


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (
            ([1, 2], [[0, 0, 0]]),
            "expected n node numbers and (n, 3) positions, found (2,) and (1, 3)",
        ),
        (([1], [[0, 0]]), "found (1,) and (1, 2)"),
        (
            ([1.5], [[0, 0, 0]]),
            "geometry: nodes: expected whole numbers of at most 1e+17 in size, found 1.5",
        ),
        ((["a"], [[0, 0, 0]]), "geometry: nodes: expected whole numbers, found <U1"),
        (([1], [["a", 0, 0]]), "geometry: positions are not an array of numbers"),
        (([4, 1], [[0, 0, 0], [0, np.nan, 0]]), "geometry: the position of node 1 is not finite"),
        (([4, 4], np.zeros((2, 3))), "geometry: node 4 occurs twice"),
        (
            ([1, 2], np.zeros((2, 3)), [[1, 3]]),
            "geometry: a line names node 3, which has no position",
        ),
        (
            ([1, 2], np.zeros((2, 3)), [1, 2, 1]),
            "geometry: expected lines as (m, 2) node numbers, found (3,)",
        ),
        (
            ([1, 2], np.zeros((2, 3)), [1, 2, 2, 1]),
            "geometry: expected lines as (m, 2) node numbers, found (4,)",
        ),
        (([1, 2], np.zeros((2, 3)), [[1, 1.5]]), "geometry: lines: expected whole numbers"),
        (
            ([1], [[0, 0, 0]], None, np.eye(3)),
            "geometry: expected axes of shape (1, 3, 3), found (3, 3)",
        ),
        (
            ([8], [[0, 0, 0]], None, [np.diag([1, 1, np.nan])]),
            "the axes of node 8 are not three perpendicular",
        ),
        (
            ([8], [[0, 0, 0]], None, [np.diag([1, 1, 1.01])]),
            "the axes of node 8 are not three perpendicular",
        ),
        (([8], [[0, 0, 0]], None, [[[1, 0, 0], [0.1, 1, 0], [0, 0, 1]]]), "directions of length 1"),
    ],
)
def test_what_is_refused(arguments, text):
    with pytest.raises(InputError, match=re.escape(text)):
        Geometry(*arguments)


def test_directions_may_be_rounded_to_four_digits():
    c = round(np.cos(0.3), 5)
    s = round(np.sin(0.3), 5)
    assert Geometry([1], [[0, 0, 0]], axes=[[[c, s, 0], [-s, c, 0], [0, 0, 1]]]).axes[0, 0, 0] == c


def test_nothing_can_be_changed(three):
    with pytest.raises(dataclasses.FrozenInstanceError):
        three.nodes = np.array([1])
    for array in (three.nodes, three.xyz, three.lines, three.axes):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_the_arrays_given_are_copied():
    xyz = np.zeros((1, 3))
    geometry = Geometry([1], xyz)
    xyz[0, 0] = 5.0
    assert geometry.xyz[0, 0] == 0.0


def test_pickling_keeps_all_and_keeps_it_read_only(three):
    other = pickle.loads(pickle.dumps(three))  # noqa: S301
    for name in ("nodes", "xyz", "lines", "axes"):
        assert np.array_equal(getattr(other, name), getattr(three, name))
        assert not getattr(other, name).flags.writeable
