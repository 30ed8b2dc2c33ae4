"""Matching by label where both geometries are known: equal numbers at different places are an error."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

import updyn
from updyn.errors import UpdynWarning
from updyn.frf import FRF
from updyn.geometry import Geometry
from updyn.matching import MatchError, Matching, match
from updyn.model import Group, Model
from updyn.positions import CoordinateSystem, _Comparison, is_in_line

#: Mesh of a wing, 1.7 m by 0.52 m, numbered across the chord first; its size is 1.778 m.
ROWS, COLUMNS = 18, 14
MESH = np.array([[0.1 * i, 0.04 * j, 0.0] for i in range(ROWS) for j in range(COLUMNS)])
SIZE = float(np.hypot(1.7, 0.52))
#: Sensors 1 to 18: 6 stations along the span, 3 along the chord, and the nodes of the mesh there.
AT = np.array([COLUMNS * i + j + 1 for i in (2, 5, 8, 11, 14, 17) for j in (0, 6, 13)])
PLACES = MESH[AT - 1]
ABOVE = np.array([0.0, 0.0, 5.0])


def wing(xyz: ArrayLike = MESH) -> Model:
    """Make a model with one mass and one spring to ground at each node, along Z."""
    n = len(np.asarray(xyz))
    group = Group(1e4 * np.eye(n), np.eye(n), 0.02)
    dofs = [f"{node}:Z" for node in range(1, n + 1)]
    return Model.from_groups({"wing": group}, dofs, geometry=Geometry(range(1, n + 1), xyz))


def measured(nodes: ArrayLike, xyz: ArrayLike, geometry: bool = True) -> FRF:
    """Make a measurement of responses along Z at some nodes, with a force at the first."""
    names = np.asarray(nodes).tolist()
    labels = [f"{node}:Z" for node in names]
    values = np.ones((3, len(labels), 1), dtype=complex)
    known = Geometry(names, xyz) if geometry else None
    return FRF([5.0, 9.0, 14.0], values, labels, labels[:1], "receptance", geometry=known)


def moved(xyz: ArrayLike, seed: int = 1) -> NDArray[np.float64]:
    turn = Rotation.from_euler("z", 35.0 + seed, degrees=True).as_matrix()
    return np.asarray(xyz) @ turn.T + [3.0, -0.7, 0.2]


def refusal(*given: Any, **options: Any) -> MatchError:
    with pytest.raises(MatchError, match="labels and positions contradict") as caught:
        match(*given, **options)
    return caught.value


# -- contradictions --------------------------------------------------------------------------------
def test_numbers_of_the_test_that_are_others_in_the_mesh_are_refused() -> None:
    error = refusal(wing(), measured(range(1, 19), PLACES))
    distance = np.linalg.norm(PLACES - MESH[:18], axis=1)
    worst = int(np.argmax(distance))
    first, second = str(error).splitlines()[:2]
    assert f"{np.sum(distance > 0.05 * SIZE)} of 18 nodes" in first
    assert "0.0889 m (5 % of the model's size)" in first
    assert second.startswith(f"  {worst + 1}: {distance[worst]:.3g} m from node {worst + 1}")
    assert second.endswith(f"node {AT[worst]} is nearer: 0 m")
    assert error.key == ("by",)
    assert error.proposal == {"by": "coordinates"}
    assert 'by = "coordinates"' in str(error)
    assert 'tolerance = "any"' in str(error)
    found = match(wing(), measured(range(1, 19), PLACES), **error.proposal)
    assert [m.dof for m in found.table] == [f"{node}:Z" for node in AT]


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1000.0), ("in", 1 / 0.0254)])
def test_a_contradiction_in_another_unit_proposes_the_unit(unit: str, factor: float) -> None:
    error = refusal(wing(), measured(range(1, 19), factor * PLACES))
    assert error.proposal == {"by": "coordinates", "unit": unit}
    assert f'unit = "{unit}"' in str(error)
    found = match(wing(), measured(range(1, 19), factor * PLACES), **error.proposal)
    assert [m.dof for m in found.table] == [f"{node}:Z" for node in AT]


def test_a_contradiction_of_positions_with_errors_proposes_a_tolerance() -> None:
    rough = PLACES + np.random.default_rng(3).uniform(-0.02, 0.02, PLACES.shape)
    error = refusal(wing(), measured(range(1, 19), rough))
    assert error.proposal["by"] == "coordinates"
    match(wing(), measured(range(1, 19), rough), **error.proposal)


def test_a_contradiction_in_another_system_asks_for_an_alignment() -> None:
    error = refusal(wing(), measured(range(1, 19), moved(PLACES)))
    assert error.proposal == {}
    assert "alignment" in str(error)


def test_nodes_of_the_mesh_beside_each_other_are_no_test_in_millimetres() -> None:
    """In mm the whole test would lie at the origin, where nodes 1 to 3 of the mesh are."""
    error = refusal(wing(), measured([1, 2, 3], PLACES[[0, 8, 17]]))
    assert error.proposal == {"by": "coordinates"}


def test_a_beam_numbered_from_its_other_end_is_refused() -> None:
    """A turn by 180 degrees would bring all on each other; as they are, others lie there."""
    line = np.array([[0.05 * k, 0.0, 0.0] for k in range(21)])
    error = refusal(wing(line), measured(range(1, 22, 4), line[::-4]))
    assert error.proposal == {"by": "coordinates"}


def test_one_position_that_is_wrong_is_named() -> None:
    wrong = PLACES.copy()
    wrong[4] += [0.3, 0, 0]
    error = refusal(wing(), measured(AT, wrong))
    assert "1 of 18 nodes" in str(error)
    assert f"\n  {AT[4]}: 0.3 m from node {AT[4]}" in str(error)
    assert error.proposal == {}


@pytest.mark.parametrize("seed", range(12))
def test_numbers_in_random_order_are_always_refused(seed: int) -> None:
    rng = np.random.default_rng(seed)
    xyz = rng.uniform(0, [2.0, 1.0, 0.5], (30, 3))
    n = int(rng.integers(4, 12))
    at = rng.choice(30, n, replace=False)
    order = np.roll(at, 1) + 1
    given = xyz[at]
    if seed % 3 == 1:
        given = 1000.0 * given
    if seed % 3 == 2:
        given = moved(given, seed)
    refusal(wing(xyz), measured(order, given))


# -- no contradiction ------------------------------------------------------------------------------
def accepted(model: Model, data: FRF, *given: Any, **options: Any) -> Matching:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = match(model, data, *given, **options)
    assert [m.sensor for m in found.table] == [m.dof for m in found.table]
    return found


@pytest.mark.parametrize("seed", range(6))
def test_equal_places_and_errors_of_centimetres_are_accepted(seed: int) -> None:
    assert accepted(wing(), measured(AT, PLACES)).plain
    errors = np.random.default_rng(seed).uniform(-0.04, 0.04, PLACES.shape)
    found = accepted(wing(), measured(AT, PLACES + errors))
    distance = [m.distance for m in found.table]
    np.testing.assert_allclose(distance, np.linalg.norm(errors, axis=1), rtol=1e-9)
    assert "as they are" in str(found)


@pytest.mark.parametrize(
    ("unit", "factor"), [("mm", 1e3), ("cm", 1e2), ("in", 1 / 0.0254), ("ft", 1 / 0.3048)]
)
def test_another_unit_is_no_contradiction_and_is_stated(unit: str, factor: float) -> None:
    errors = np.random.default_rng(2).uniform(-0.01, 0.01, PLACES.shape)
    found = accepted(wing(), measured(AT, factor * (PLACES + errors)))
    assert f"look like {unit}" in str(found)
    distance = [m.distance for m in found.table]
    np.testing.assert_allclose(distance, np.linalg.norm(errors, axis=1), rtol=1e-9)
    geometry = found.frf.geometry
    assert geometry is not None
    np.testing.assert_allclose(geometry.position(AT), PLACES)


def test_a_model_in_millimetres_is_a_warning() -> None:
    with pytest.warns(UpdynWarning, match="those of the model look like mm"):
        match(wing(1000.0 * MESH), measured(AT, PLACES))


def test_another_origin_is_no_contradiction_and_is_stated() -> None:
    found = accepted(wing(), measured(AT, PLACES + np.array([3.0, -0.7, 0.2])))
    assert "moved by (-3, 0.7, -0.2) m" in str(found)
    assert max(m.distance for m in found.table) < 1e-9


@pytest.mark.parametrize("factor", [1.0, 1000.0])
def test_other_axes_are_a_warning_because_directions_of_labels_may_be_others(factor: float) -> None:
    with pytest.warns(UpdynWarning, match=r"turned by 36 degrees.*alignment = \{ 29 = 29") as told:
        found = match(wing(), measured(AT, factor * moved(PLACES)))
    assert len(told) == 1
    assert "turned by 36 degrees" in str(found)
    assert max(m.distance for m in found.table) < 1e-9


@pytest.mark.parametrize(("degrees", "is_warned"), [(0.9, False), (1.1, True)])
def test_directions_are_doubtful_from_a_degree(degrees: float, is_warned: bool) -> None:
    turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    data = measured(AT, PLACES @ turn.T + np.array([3.0, -0.7, 0.2]))
    if not is_warned:
        accepted(wing(), data)
        return
    with pytest.warns(UpdynWarning, match="directions are taken as the labels name them"):
        match(wing(), data)


@pytest.mark.parametrize(("width", "in_line"), [(1.3e-6, True), (1.5e-6, False)])
def test_points_in_line_are_a_millionth_wide(width: float, in_line: bool) -> None:
    """The root of the sum of squares of the width, over that of the length."""
    points = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, width, 0.0]])
    assert is_in_line(points) is in_line


def test_two_nodes_or_one_in_another_system_cannot_be_compared() -> None:
    with pytest.warns(UpdynWarning, match="cannot be compared"):
        match(wing(), measured(AT[:1], PLACES[:1] + ABOVE))
    with pytest.warns(UpdynWarning, match="cannot be compared"):
        match(wing(), measured(AT[[0, 17]], PLACES[[0, 17]] + ABOVE))
    refusal(wing(), measured([1, 3], PLACES[[0, 17]] + ABOVE))  # 8 cm apart, and 1.6 m


def test_the_limit_is_a_twentieth_of_the_size_unless_the_node_is_the_nearest() -> None:
    for share, is_refused in ((0.049, False), (0.051, True)):
        places = PLACES.copy()
        places[4, 0] += share * SIZE
        if is_refused:
            refusal(wing(), measured(AT, places))
        else:
            accepted(wing(), measured(AT, places))
    coarse = np.array([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0], [3.0, 0, 0]])
    places = coarse + np.array([0.0, 0.4, 0.0])  # an eighth of the size beside its lumped mass
    accepted(wing(coarse), measured([1, 2, 3, 4], places))


@pytest.mark.parametrize(("share", "is_refused"), [(0.24, False), (0.26, True)])
def test_a_nearest_node_may_be_a_quarter_of_the_size_away(share: float, is_refused: bool) -> None:
    coarse = np.array([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0], [3.0, 0, 0]])
    places = coarse.copy()
    places[1, 1] += share * 3.0  # node 2 is still the nearest one
    check = refusal if is_refused else accepted
    check(wing(coarse), measured([1, 2, 3, 4], places))


def compare_shifted(shift: float) -> tuple[_Comparison, float]:
    """Return pairs that are a multiple of their rms radius apart, any distance permitted."""
    radius = float(np.sqrt(np.mean(np.sum((PLACES - PLACES.mean(axis=0)) ** 2, axis=1))))
    test = Geometry(AT, PLACES + shift * radius * np.array([0.0, 0.0, 1.0]))
    return _Comparison(AT, test, wing(), SIZE, limit=1e9), radius


@pytest.mark.parametrize(("shift", "fits"), [(0.19, True), (0.21, False)])
def test_another_unit_brings_pairs_within_a_fifth_of_their_radius(shift: float, fits: bool) -> None:
    pairs, _ = compare_shifted(shift)
    assert pairs.fits_labels(CoordinateSystem()) == fits


@pytest.mark.parametrize(
    ("shift", "residual", "fits"),
    [(9.0, 0.099, True), (9.0, 0.101, False), (0.2, 0.049, True), (0.2, 0.051, False)],
)
def test_a_motion_brings_pairs_within_a_tenth_and_to_a_quarter_of_their_distance(
    shift: float, residual: float, fits: bool
) -> None:
    pairs, radius = compare_shifted(shift)
    assert pairs.fits_rigidly(CoordinateSystem(residual=residual * radius)) == fits


def test_without_a_geometry_on_either_side_nothing_is_compared() -> None:
    model = wing()
    accepted(model, measured(range(1, 19), PLACES, geometry=False))
    accepted(Model(model.groups, model.dofs), measured(range(1, 19), PLACES))
    own = Geometry(range(1, 19), PLACES)
    error = refusal(model, measured(range(1, 19), PLACES, geometry=False), own)
    assert error.proposal == {"by": "coordinates"}
    others = Geometry(range(501, 519), PLACES)  # no node of the measurement has a position
    accepted(model, measured(range(1, 19), PLACES, geometry=False), others)


def test_modes_are_compared_too() -> None:
    shapes = np.random.default_rng(0).standard_normal((18, 2))
    modes = updyn.ModeSet([5.0, 9.0], shapes, [f"{n}:Z" for n in range(1, 19)])
    refusal(wing(), modes, Geometry(range(1, 19), PLACES))


# -- to insist -------------------------------------------------------------------------------------
@pytest.mark.parametrize("tolerance", ["any", 2.0, "95 %"])
def test_the_user_may_insist_on_labels(tolerance: Any) -> None:
    data = measured(range(1, 19), PLACES)
    found = accepted(wing(), data, tolerance=tolerance)
    assert max(m.distance for m in found.table) == pytest.approx(
        np.linalg.norm(PLACES - MESH[:18], axis=1).max()
    )
    geometry = found.frf.geometry
    assert geometry is not None
    np.testing.assert_array_equal(geometry.position(range(1, 19)), MESH[:18])
    accepted(wing(), found.frf)


def test_a_stated_tolerance_is_kept() -> None:
    places = PLACES.copy()
    places[4, 0] += 0.03
    accepted(wing(), measured(AT, places))
    error = refusal(wing(), measured(AT, places), tolerance=0.02)
    assert "farther than 0.02 m from 1 of 18 nodes" in str(error)
    with pytest.raises(MatchError, match=r"'some': expected a distance in m, .*'any'"):
        match(wing(), measured(AT, places), tolerance="some")
    with pytest.raises(MatchError, match="'any' belongs to by = 'label'"):
        match(wing(), measured(AT, places), by="coordinates", tolerance="any")


def test_entries_of_table_are_what_the_user_insists_on() -> None:
    wrong = PLACES.copy()
    wrong[4] += [0.3, 0, 0]
    name = str(AT[4])
    accepted(wing(), measured(AT, wrong), table={name: name})
    accepted(wing(), measured(AT, wrong), table={f"{name}:Z": f"{name}:Z"})


# -- without `match` -------------------------------------------------------------------------------
def test_update_and_correlate_warn_where_labels_are_used_as_they_are() -> None:
    model = wing(MESH[::14])
    places = MESH[::14][[0, 8, 17]]
    good, bad = (measured(nodes, places) for nodes in ([1, 9, 18], [1, 2, 3]))
    for data, wanted in ((good, 0), (bad, 1)):
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            updyn.correlate(model, data)
        assert sum("labels and positions contradict" in str(w.message) for w in told) == wanted
    unknowns = updyn.parameters(model, stiffness="all")
    with pytest.warns(UpdynWarning, match="labels and positions contradict"):
        updyn.update(model, bad, unknowns, starts=0, max_iterations=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UpdynWarning)
        updyn.update(model, replace(bad, geometry=None), unknowns, starts=0, max_iterations=1)
