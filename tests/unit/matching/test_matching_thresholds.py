"""Thresholds of matching: a case on either side of each."""

from __future__ import annotations

from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest

from updyn.dofs import Dof
from updyn.geometry import Geometry
from updyn.matching import MatchError, directions, placement
from updyn.matching.directions import SensorDirection, _Local
from updyn.matching.result import format_list
from updyn.matching.sensors import _UserInput


def raises(wrong: bool):
    """Return the context in which an input is wrong, or not."""
    return pytest.raises(MatchError) if wrong else nullcontext()


def turned(degrees: float, other: int = 1) -> np.ndarray:
    """Return a vector at an angle from X."""
    vector = np.zeros(3)
    vector[[0, other]] = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return vector


def local(vector: np.ndarray) -> _Local:
    target = SensorDirection(Dof.parse("1:X"), "sensor", Dof.parse("1:X"), vector)
    return _Local(target, 0, vector, 0.0)


@pytest.mark.parametrize(("degrees", "count"), [(0.09, 1), (0.11, 2)])
def test_directions_are_equal_within_a_tenth_of_a_degree(degrees, count):
    both = [local(turned(0.0)), local(turned(degrees))]
    assert len(directions._select_distinct(both)) == count


@pytest.mark.parametrize(("degrees", "wrong"), [(0.9, True), (1.1, False)])
def test_dofs_are_a_degree_apart(degrees, wrong):
    with raises(wrong):
        directions._check_angles(1, [local(turned(0.0)), local(turned(degrees))])


@pytest.mark.parametrize(("least", "wrong"), [(0.009, True), (0.011, False)])
def test_three_directions_are_not_in_one_plane(least, wrong):
    found = []
    for degrees in (0.0, 120.0, 240.0):
        vector = turned(degrees)
        vector[2] = least / np.sqrt(3.0)
        found.append(local(vector / np.linalg.norm(vector)))
    values = np.linalg.svd([one.vector for one in found], compute_uv=False)
    assert values[-1] == pytest.approx(least, rel=1e-3)
    with raises(wrong):
        directions._select_independent(1, found, 0, np.ones(3, dtype=bool))


@pytest.mark.parametrize(("off", "same"), [(4e-5, True), (6e-5, False)])
def test_nearly_orthogonal_directions_are_axes(off, same):
    first, second = turned(30.0), turned(120.0 - np.degrees(off))
    basis = directions._basis(1, [local(first), local(second)], tuple(range(6)))
    assert basis.same is same


@pytest.mark.parametrize(("degrees", "suggested"), [(9.5, True), (10.5, False)])
def test_an_angle_is_suggested(degrees, suggested):
    target = SensorDirection(Dof.parse("1:X"), "sensor", Dof.parse("1:X"), turned(degrees, 2))
    model = SimpleNamespace()
    text = directions._find_local_direction(model, target, np.eye(3), (0, 1), 0.1)
    assert isinstance(text, str)
    assert ("with angle = " in text) is suggested


def test_the_label_decides_between_axes_that_are_equally_near():
    diagonal = [np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0])]
    by_label = directions._label_score(diagonal, [1], (1,))
    assert by_label - directions._label_score(diagonal, [1], (0,)) == pytest.approx(1e-6)


@pytest.mark.parametrize(("change", "differs"), [(0.9e-9, False), (1.1e-9, True)])
def test_axes_of_a_node_differ(change, differs):
    given = SimpleNamespace(axes=lambda node: np.eye(3))
    assert _UserInput._has_other_axes(given, 1, np.eye(3) + change) is differs


@pytest.mark.parametrize(
    ("scale", "shear", "wrong"),
    [(0.9e-6, 0.0, False), (1.1e-6, 0.0, True), (0.0, 0.9e-6, False), (0.0, 1.1e-6, True)],
)
def test_a_matrix_is_a_rotation(scale, shear, wrong):
    matrix = np.eye(4)
    matrix[:3, :3] *= 1.0 + scale
    matrix[0, 1] = shear
    with raises(wrong):
        placement._read_matrix(matrix, 1.0, None)


def test_the_default_tolerance_is_a_hundredth_of_the_model():
    assert placement.read_tolerance(None, 2.0) == pytest.approx(0.02)


def near_nodes(first: float, second: float) -> dict[int, placement.NodeMatch]:
    """Return the match of a node with two nodes of a model of 1 m at these distances."""
    nearest = np.array([[0, 1]]), np.array([[first, second]])
    candidates = SimpleNamespace(nearest=lambda points, k: nearest, size=1.0)
    model = SimpleNamespace(nodes=np.array([11, 12]))
    given = SimpleNamespace(candidates=candidates, model_geometry=model, nodes=[1])
    return placement._node_matches(given, SimpleNamespace(points=np.zeros((1, 3))))


def test_two_nodes_are_equally_near():
    with pytest.raises(MatchError, match="equally near"):
        near_nodes(0.1, 0.1 + 0.9e-6)
    assert near_nodes(0.1, 0.1 + 1.1e-6)[1].node == 11


@pytest.mark.parametrize(("second", "noted"), [(0.19, True), (0.21, False)])
def test_a_second_node_is_noted(second, noted):
    assert bool(near_nodes(0.1, second)[1].note) is noted


@pytest.mark.parametrize(("scale", "named"), [(1.018, False), (1.022, True)])
def test_another_scale_of_pairs_is_named(scale, named):
    xyz = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]])
    test, model = Geometry(range(1, 5), xyz), Geometry(range(1, 5), scale * xyz)
    with pytest.raises(MatchError) as caught:
        placement._check_pairs({k: k for k in range(1, 5)}, test, model, 1.0, 1e-4)
    assert ("times as far apart" in str(caught.value)) is named


def test_a_message_lists_eight_items():
    assert "more" not in format_list(list("abcdefgh"))
    assert format_list(list("abcdefghi")).endswith("... and 1 more")
