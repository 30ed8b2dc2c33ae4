"""Matching: turned DOFs against combinations of the untouched model, positions against known motions, and refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import updyn
from updyn.dofs import DIRECTIONS
from updyn.errors import DofError, OptionError, UpdynWarning
from updyn.frf import FRF
from updyn.geometry import Geometry
from updyn.matching import MatchError, Matching, match
from updyn.model import Group, Model

LINES = np.array([3.0, 7.5, 11.0, 16.0])
#: Corners of a block, without symmetry; numbered 11 to 18.
CORNERS = np.array(
    [
        [0, 0, 0],
        [1.3, 0, 0],
        [1.2, 0.7, 0],
        [0, 0.8, 0.1],
        [0.1, 0, 0.5],
        [1.3, 0.1, 0.45],
        [1.25, 0.75, 0.6],
        [0, 0.8, 0.55],
    ]
)


def structure(directions: tuple[str, ...] = DIRECTIONS, axes: Any = None, nodes: int = 4) -> Model:
    """Make a model of random, fully coupled, damped groups on the first nodes of the block."""
    rng = np.random.default_rng(3)
    dofs = [f"{11 + i}:{d}" for i in range(nodes) for d in directions]
    n, groups = len(dofs), {}
    for name, own in (("left", np.arange(2 * n // 3)), ("right", np.arange(n // 3, n))):
        K, M, C, at = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)), np.ix_(own, own)
        A, B = rng.standard_normal((2, len(own), len(own)))
        K[at], M[at], C[at] = (
            1e4 * (A @ A.T + np.eye(len(own))),
            B @ B.T + np.eye(len(own)),
            np.eye(len(own)),
        )
        groups[name] = Group(K, M, 0.03, C)
    return Model.from_groups(
        groups, dofs, geometry=Geometry(range(11, 11 + nodes), CORNERS[:nodes], axes=axes)
    )


def receptance(model: Model) -> np.ndarray:
    """Return H of all DOFs at `LINES` by dense solves, shape (n_f, N, N)."""
    K = model.stiffness.toarray() + 1j * model.structural.toarray()
    w = 2 * np.pi * LINES[:, None, None]
    return np.linalg.solve(
        K + 1j * w * model.viscous.toarray() - w**2 * model.mass.toarray(), np.eye(model.n_dofs)
    )


def data(responses: list[str], references: list[str], geometry: Geometry | None = None) -> FRF:
    rng = np.random.default_rng(1)
    shape = (len(LINES), len(responses), len(references))
    return FRF(
        LINES,
        rng.standard_normal(shape) + 1j,
        responses,
        references,
        "receptance",
        geometry=geometry,
    )


def unit(*vector: float) -> np.ndarray:
    return np.array(vector) / np.linalg.norm(vector)


def rows(found: Matching) -> dict[str, str]:
    return {m.sensor: m.dof for m in found.table}


def along(model: Model, node: int, vector: np.ndarray, part: int = 0) -> np.ndarray:
    """Return the vector over all DOFs that reads (or loads) a direction of a node, in the node's own system."""
    out = np.zeros(model.n_dofs)
    for k in range(3):
        if f"{node}:{DIRECTIONS[part + k]}" in model.dofs:
            out[model.dofs.match([f"{node}:{DIRECTIONS[part + k]}"]).index[0]] = vector[k]
    return out


def check_exact(
    model: Model, found: Matching, readings: dict[str, np.ndarray], loads: dict[str, np.ndarray]
) -> None:
    """Compare the matched model with combinations of the responses of the model as it was given."""
    got = updyn.response(found.model, LINES, found.frf.responses, found.frf.references).values
    R, L = (np.array(list(v.values())) for v in (readings, loads))
    want = np.einsum("ri,fij,lj->frl", R, receptance(model), L)
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-12 * np.abs(want).max())


# -- by label ----------------------------------------------------------------------------------------------
def test_by_label_nothing_changes() -> None:
    model, frf = structure(), data(["11:X", "12:-RZ"], ["13:Y"])
    found = match(model, frf)
    assert found.model is model
    assert found.plain
    assert found.frf.responses.labels == ["11:X", "12:-RZ"]
    assert rows(found) == {"11:X": "11:X", "12:RZ": "12:RZ", "13:Y": "13:Y"}
    assert (
        str(found).splitlines()[0] == "Matched by label: 3 sensors and forces are DOFs of the model"
    )


def test_table_of_labels_and_of_nodes_with_signs() -> None:
    frf = data(["1:X", "1:-Y", "2:Z", "12:X"], ["2:-Z"])
    found = match(structure(), frf, table={"1": "13", "2:Z": "11:-X"})
    assert found.frf.responses.labels == ["13:X", "13:-Y", "11:-X", "12:X"]
    assert found.frf.references.labels == ["11:X"]
    np.testing.assert_array_equal(found.frf.values, frf.values)
    assert [m.role for m in found.table] == ["response"] * 2 + [
        "response and reference",
        "response",
    ]
    assert (
        match(structure(), frf, table={"1": 13, "2:-Z": "11:X"}).frf.responses
        == found.frf.responses
    )  # type: ignore[dict-item]


@pytest.mark.parametrize(
    ("table", "directions", "message", "place"),
    [
        (
            {"9:X": "11:X"},
            {},
            "'9:X' is no response or reference of the measurement; valid: '11:X'",
            ("table", "9:X"),
        ),
        ({"11:x": "11:X"}, {}, "did you mean '11:X'", ("table", "11:x")),
        ({"11:X": "12:X", "11:-X": "13:X"}, {}, "already has an entry", ("table", "11:-X")),
        ({"7": "12"}, {}, "node 7 holds no response or reference", ("table", "7")),
        (
            {"11": "12:X"},
            {},
            "11 is a node: expected a node of the model, found '12:X'",
            ("table", "11"),
        ),
        ({"9" * 5000: "12"}, {}, "expected node:direction", ("table", "9" * 5000)),
        ({"11": "9" * 5000}, {}, "11 is a node: expected a node of the model", ("table", "11")),
        (
            {"11:X": "12:Y"},
            {},
            "DOF 12:Y occurs twice: responses 11:X and 12:Y would be the same",
            ("table", "11:X"),
        ),
        (
            {"12": "11", "11:-X": "11:Y"},
            {},
            "DOF 11:Y occurs twice: responses 11:X and 12:Y would be the same",
            ("table", "11:-X"),
        ),
        (
            {"11": "14", "12:Y": "77:Y"},
            {},
            "not DOFs of the model",
            ("table", "12:Y"),
        ),
        (
            {"12": "77", "13": "14"},
            {},
            "not DOFs of the model",
            ("table", "12"),
        ),
        ({}, {"12:X": [1, 0, 0]}, "'12:X' is no response or reference", ("directions", "12:X")),
        (
            {},
            {"11:X": [0, 0, 0]},
            "expected three finite numbers, not all 0",
            ("directions", "11:X"),
        ),
        ({}, {"11:X": [1, 2]}, r"found \[1, 2\]", ("directions", "11:X")),
        ({}, {"11:X": "up"}, "direction of 11:X: expected three numbers", ("directions", "11:X")),
        (
            {},
            {"11:X": [1, 0, 0], "11:-X": [1, 0, 0]},
            "already has a direction",
            ("directions", "11:-X"),
        ),
        (
            {"11:X": "13:-X"},
            {"11:X": [1, 0, 1]},
            "the sign of 13:-X in table besides",
            ("directions", "11:X"),
        ),
    ],
)
def test_what_is_said_wrongly(
    table: Any, directions: Any, message: str, place: tuple[str, ...]
) -> None:
    with pytest.raises(MatchError, match=message) as caught:
        match(structure(), data(["11:X", "12:Y"], ["13:Y"]), table=table, directions=directions)
    assert caught.value.key == place
    assert isinstance(caught.value, DofError)


def test_sensors_that_are_no_dofs_are_listed_with_the_nearest() -> None:
    frf = data([f"{n}:X" for n in range(1, 11)], ["11:X"])
    with pytest.raises(MatchError) as caught:
        match(structure(), frf, table={"1:X": "20:X"})
    lines = str(caught.value).splitlines()
    assert lines[0] == "10 of the sensors and forces of the measurement are not DOFs of the model:"
    assert lines[1] == "  1:X: response 20:X is not among the 24 DOFs; nearest: 14:X, 14:Y, 14:Z"
    assert lines[2] == "  response 2:X is not among the 24 DOFs; nearest: 11:X, 11:Y, 11:Z"
    assert lines[9:] == ["  ... and 2 more"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"by": "labels"}, "did you mean 'label'"),
        ({"tolerance": 0.1}, "tolerance: the measurement has no positions that could be"),
        ({"unit": "mm"}, "unit belongs to by = 'coordinates'"),
        ({"by": "coordinates", "alignment": "best"}, "alignment 'best': expected 'fit'"),
        ({"angle": 60}, "angle 60: expected degrees between 0 and 45"),
        ({"by": "coordinates"}, "the measurement has no geometry"),
        ({"table": ["11:X"]}, "expected labels by label, found list"),
    ],
)
def test_options_are_checked(options: Any, message: str) -> None:
    with pytest.raises((MatchError, OptionError), match=message):
        match(structure(), data(["11:X"], ["12:X"]), **options)


# -- oblique sensors ---------------------------------------------------------------------------------------
A, B, C = unit(0.8, 0.1, 0.55), unit(-0.2, 0.9, 0.3), unit(0.3, -0.3, 0.8)


@pytest.mark.parametrize("axes", [None, Rotation.random(4, random_state=4).as_matrix()])
def test_oblique_sensors_and_forces_read_the_combination_of_three_dofs(axes: Any) -> None:
    """Up to three, not at right angles, at nodes whose own directions may be rotated; also rotations."""
    model = structure(axes=axes)
    frf = data(["11:X", "11:-Y", "12:RX", "13:X"], ["11:Z", "11:X", "14:Y"])
    directions = {"11:X": 3 * A, "11:Y": B, "11:Z": C, "12:RX": B, "13:X": C, "14:Y": A}
    found = match(model, frf, directions=directions)
    frames = np.tile(np.eye(3), (4, 1, 1)) if axes is None else axes

    def reads(node: int, vector: np.ndarray, part: int = 0) -> np.ndarray:
        return along(model, node, frames[node - 11] @ vector, part)

    readings = {
        "11:X": reads(11, A),
        "11:-Y": -reads(11, B),
        "12:RX": reads(12, B, 3),
        "13:X": reads(13, C),
    }
    loads = {"11:Z": reads(11, C), "11:X": reads(11, A), "14:Y": reads(14, A)}
    check_exact(model, found, readings, loads)
    assert not found.plain
    assert all(m.turned for m in found.table)
    assert found.model.dofs == model.dofs
    assert next(m.direction for m in found.table) == pytest.approx(tuple(A))


@pytest.mark.parametrize("seed", range(12))
def test_any_directions_at_one_node(seed: int) -> None:
    """One to three of translations and of rotations, some along DOFs, some shared by sensor and force, any sense."""
    rng = np.random.default_rng(seed)
    model = structure(axes=None if seed % 2 else Rotation.random(4, random_state=seed).as_matrix())
    frames = np.tile(np.eye(3), (4, 1, 1)) if model.geometry.axes is None else model.geometry.axes
    directions = {}
    for part in ("", "R"):
        some = [unit(*rng.standard_normal(3)) for _ in range(rng.integers(1, 4))]
        if rng.random() < 0.5:
            some[0] = rng.choice([-1, 1]) * frames[1][rng.integers(3)]
        while (
            np.linalg.svd(np.array(some), compute_uv=False)[-1] < 0.05
        ):  # nearly of one plane: refused
            some[-1] = unit(*rng.standard_normal(3))
        directions |= {f"12:{part}{'XYZ'[k]}": v for k, v in enumerate(some)}
    labels = [f"{d[:3]}{rng.choice(['', '-'])}{d[3:]}" for d in directions]
    loads = [*rng.permutation(labels)[: rng.integers(1, len(labels) + 1)].tolist(), "14:Z"]
    found = match(model, data(labels, loads), directions=directions)

    def vector(label: str) -> np.ndarray:
        plain = label.replace("-", "")
        a = directions.get(plain, np.eye(3)[2] @ frames[3])
        node = int(plain[:2])
        return (-1.0 if "-" in label else 1.0) * along(
            model, node, frames[node - 11] @ a, 3 if "R" in plain else 0
        )

    check_exact(model, found, {x: vector(x) for x in labels}, {x: vector(x) for x in loads})


def test_the_whole_model_is_the_same_in_other_coordinates() -> None:
    model = structure()
    found = match(model, data(["11:X", "12:Z"], ["13:Y"]), directions={"11:X": A, "12:Z": B})
    turned, given = (np.sort(updyn.modes(m, 24).frequency) for m in (found.model, model))
    np.testing.assert_allclose(turned, given, rtol=1e-9)
    for name, group in model.groups.items():
        changed = found.model.groups[name]
        assert changed.loss_factor == group.loss_factor
        for what in ("stiffness", "mass", "viscous"):
            before, after = (getattr(g, what).toarray() for g in (group, changed))
            np.testing.assert_array_equal(
                after[12:, 12:], before[12:, 12:]
            )  # other nodes: to the last bit
            np.testing.assert_array_equal(after, after.T)


def test_a_group_that_does_not_reach_the_node_is_shared() -> None:
    model = structure()
    found = match(model, data(["14:X"], ["14:Y"]), directions={"14:X": A})
    assert found.model.groups["left"] is model.groups["left"]
    assert found.model.groups["right"] is not model.groups["right"]


def test_directions_at_right_angles_are_told_by_the_geometry() -> None:
    """A rotated triaxial sensor: the axes of the node, its rotations turned with it."""
    R = Rotation.from_euler("zyx", [30, 20, -10], degrees=True).as_matrix()
    model = structure()
    directions = {"11:X": R[0], "11:Y": R[1], "11:Z": R[2]}
    found = match(
        model,
        data(["11:X", "11:Y", "11:Z", "11:RX"], ["12:X"]),
        directions=directions | {"11:RX": R[0]},
    )
    assert rows(found) == {
        "11:X": "11:X",
        "11:Y": "11:Y",
        "11:Z": "11:Z",
        "11:RX": "11:RX",
        "12:X": "12:X",
    }
    np.testing.assert_allclose(found.model.geometry.axes[0], R, atol=1e-12)
    np.testing.assert_array_equal(found.model.geometry.axes[1:], np.tile(np.eye(3), (3, 1, 1)))
    assert found.model.title == ""
    assert found.notes == ()
    np.testing.assert_array_equal(found.frf.geometry.axes[0], found.model.geometry.axes[0])
    got = updyn.response(found.model, LINES, ["11:RY"], ["12:X"]).values[:, 0, 0]
    want = receptance(model) @ along(model, 12, np.eye(3)[0]) @ along(model, 11, R[1], 3)
    np.testing.assert_allclose(got, want, rtol=1e-10)


def test_directions_not_at_right_angles_are_told_by_the_title() -> None:
    found = match(structure(), data(["11:X", "11:Z"], ["12:X"]), directions={"11:Z": [1, 0, 1]})
    assert found.model.geometry.axes is None
    assert found.model.title == "(turned DOFs: 11:Z along (0.7071, 0, 0.7071))"
    assert found.notes == ("Not in the geometry of the model: DOFs 11:Z along (0.7071, 0, 0.7071)",)
    assert "turned along (0.7071, 0, 0.7071)" in str(found)
    assert [round(m.angle, 9) for m in found.table] == [0.0, 45.0, 0.0]


def test_a_label_stays_where_it_is_readable() -> None:
    """The nearest axis names a direction; halfway between two the sensor's own label does."""
    model = structure()
    halfway = match(model, data(["11:Z"], ["12:X"]), directions={"11:Z": [1, 0, 1]})
    assert rows(halfway)["11:Z"] == "11:Z"
    assert (
        rows(match(model, data(["11:X"], ["12:X"]), directions={"11:X": [1, 0, 1]}))["11:X"]
        == "11:X"
    )
    assert (
        rows(match(model, data(["11:X"], ["12:X"]), directions={"11:X": [0.3, 0, -1]}))["11:X"]
        == "11:-Z"
    )
    model_axis = match(
        model, data(["11:X", "11:Y"], ["12:X"]), directions={"11:X": [0, 0, 1], "11:Y": [0, -1, 0]}
    )
    assert rows(model_axis) == {"11:X": "11:Z", "11:Y": "11:-Y", "12:X": "12:X"}
    assert model_axis.model is model


def test_a_planar_model_stays_planar() -> None:
    model = structure(("X", "Z", "RY"))
    found = match(model, data(["11:X"], ["12:X"]), directions={"11:X": [0.6, 0, 0.8]})
    check_exact(
        model,
        found,
        {"11:X": along(model, 11, unit(0.6, 0, 0.8))},
        {"12:X": along(model, 12, np.eye(3)[0])},
    )
    assert np.abs(found.model.geometry.axes[0][1]).tolist() == [0, 1, 0]
    text = (
        r"12:X along \(0\.7071, 0\.7071, 0\) is 45 degrees off 12:X, and a part of 0\.707 is along"
        r" what node 12 of "
    )
    with pytest.raises(MatchError, match=text + r"the model lacks; it has 12:X, 12:Z, 12:RY"):
        match(model, data(["11:X"], ["12:X"]), directions={"12:X": [1, 1, 0]})
    with pytest.raises(
        MatchError, match=r"2.86 degrees off 12:X, .*; with angle = 3 it is taken along that"
    ):
        match(model, data(["11:X"], ["12:X"]), directions={"12:X": [1, 0.05, 0]})
    with pytest.raises(MatchError, match=r"is 45 degrees off 12:RY, and a part of 0.707"):
        match(model, data(["11:X"], ["12:RX"]), directions={"12:RX": [1, 1, 0]})


def test_a_sensor_and_a_force_in_one_direction_are_one_dof() -> None:
    model = structure()
    found = match(model, data(["11:X"], ["11:Y"]), directions={"11:X": A, "11:Y": -A})
    assert rows(found) == {"11:X": "11:X", "11:Y": "11:-X"}
    check_exact(model, found, {"11:X": along(model, 11, A)}, {"11:Y": -along(model, 11, A)})


def test_up_to_a_tenth_of_a_degree_is_along_and_more_is_said() -> None:
    model, tilt = structure(), np.array([np.cos(np.radians(0.09)), 0, np.sin(np.radians(0.09))])
    frf = data(["11:X"], ["12:X"])
    found = match(model, frf, directions={"11:X": tilt})
    assert found.model is model
    assert found.table[0].angle == pytest.approx(0.09)
    steep = {"11:X": [np.cos(np.radians(3)), 0, np.sin(np.radians(3))]}
    assert match(model, frf, directions=steep).table[0].turned
    with pytest.warns(
        UpdynWarning, match=r"1 sensors and forces are taken along .* 3 degrees, of 11:X with 11:X"
    ):
        found = match(model, frf, directions=steep, angle=5)
    assert found.model is model
    assert found.table[0].angle == pytest.approx(3)


@pytest.mark.parametrize(
    ("directions", "message"),
    [
        ({"11:X": A, "11:Y": B, "11:Z": C, "11:RX": A}, None),
        (
            {"11:X": A, "11:Z": unit(*(A + np.array([0, 0, 0.01])))},
            "11:Z and 11:X at node 11 of the model point 0.4",
        ),
        ({"11:X": [1, 1, 0], "11:Z": [1, -1, 0]}, "point in 3 directions of one plane"),
    ],
)
def test_directions_that_cannot_all_be_dofs(directions: Any, message: str | None) -> None:
    frf = data(["11:X", "11:Y", "11:Z", "11:RX"], ["12:X"])
    if message is None:
        match(structure(), frf, directions=directions)
        return
    with pytest.raises(MatchError, match=message) as caught:
        match(structure(), frf, directions=directions)
    assert caught.value.key == ("directions",)


def test_a_fourth_direction_at_a_node_is_refused() -> None:
    frf = data(["1:X", "1:Y", "1:Z", "2:X"], ["12:X"])
    with pytest.raises(
        MatchError, match=r"at node 11 of the model point in 4 directions, of which it has 3"
    ) as caught:
        match(structure(), frf, table={"1": "11", "2": "11"}, directions={"2:X": A})
    assert "response 2:X along (0.8197, 0.1025, 0.5635)" in str(caught.value)


def test_two_sensors_in_one_direction_are_refused() -> None:
    frf = data(["1:X", "2:Y"], ["12:X"])
    with pytest.raises(MatchError, match=r"DOF 11:X occurs twice: responses 1:X and 2:Y"):
        match(structure(), frf, table={"1": "11", "2": "11"}, directions={"1:X": A, "2:Y": A})


def test_condensation_and_update_see_an_ordinary_model() -> None:
    """Condensed receptance by hand; and the fit finds what combinations of three DOFs were made with."""
    model = structure()
    true = model.scaled(
        {"left": {"stiffness": 1.2, "loss_factor": 0.05}, "right": {"stiffness": 0.85, "mass": 1.1}}
    )
    read = np.array([along(model, 11, A), along(model, 12, np.eye(3)[1]), along(model, 13, B)])
    load = np.array([along(model, 11, A), along(model, 14, C)])
    lines = np.linspace(2.0, 40.0, 40)
    w = 2 * np.pi * lines[:, None, None]
    Z = true.stiffness.toarray() + 1j * true.structural.toarray() + 1j * w * true.viscous.toarray()
    H = np.einsum(
        "ri,fij,lj->frl", read, np.linalg.solve(Z - w**2 * true.mass.toarray(), np.eye(24)), load
    )
    frf = FRF(lines, H, ["11:X", "12:Y", "13:Z"], ["11:X", "14:X"], "receptance")
    found = match(model, frf, directions={"11:X": A, "13:Z": B, "14:X": C})
    reduced = updyn.condense(found.model, LINES, [*found.frf.responses, found.frf.references[1]])
    both = np.array([*read, load[1]])
    want = np.einsum("ri,fij,lj->frl", both, receptance(model), both)
    signs = np.array([d.sign for d in (*found.frf.responses, found.frf.references[1])])
    got = np.linalg.solve(reduced.Z, np.eye(4)) * signs[:, None] * signs
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-11 * np.abs(want).max())

    unknowns = updyn.parameters(found.model, stiffness="all", mass=["right"], loss_factor=["left"])
    result = updyn.update(found.model, found.frf, unknowns, noise={"relative": 1e-3}, starts=0)
    assert result.values == pytest.approx(
        {
            "left.stiffness": 1.2,
            "right.stiffness": 0.85,
            "right.mass": 1.1,
            "left.loss_factor": 0.05,
        },
        rel=1e-6,
    )


# -- by coordinates ----------------------------------------------------------------------------------------
TURN = Rotation.from_euler("zyx", [25, -40, 10], degrees=True).as_matrix()
SHIFT = np.array([0.4, -1.1, 2.0])
NAMES = np.array([3, 5, 8, 13, 21, 34, 55, 89])


def block() -> Model:
    return structure(("X", "Y", "Z"), nodes=8)


def sensors(xyz: np.ndarray, directions: str = "XYZ", axes: Any = None, lines: Any = None) -> FRF:
    """Return data at nodes 3, 5, 8, ... that stand at `xyz`, in the order of the block's corners."""
    names = NAMES[: len(xyz)]
    return data(
        [f"{n}:{d}" for n in names for d in directions],
        [f"{names[0]}:X"],
        Geometry(names, xyz, lines, axes),
    )


def check_nodes(found: Matching, distance: float = 0.0) -> None:
    assert {m.sensor.split(":")[0]: m.dof.split(":")[0] for m in found.table} == {
        str(a): str(b) for a, b in zip(NAMES, range(11, 19), strict=True)
    }
    np.testing.assert_allclose([m.distance for m in found.table], distance, atol=1e-12)


def test_by_coordinates_where_they_stand() -> None:
    found = match(
        block(),
        sensors(CORNERS + np.array([0, 0, 0.003]), lines=[[3, 5], [5, 8]]),
        by="coordinates",
    )
    check_nodes(found, 0.003)
    assert rows(found)["8:Y"] == "13:Y"
    assert found.frf.geometry.nodes.tolist() == list(range(11, 19))
    np.testing.assert_array_equal(found.frf.geometry.xyz, CORNERS)
    assert found.frf.geometry.lines.tolist() == [[11, 12], [12, 13]]
    text = str(found)
    assert "positions in m; not moved" in text
    assert "Distances: rms 0.003 m, largest 0.003 m" in text
    assert "(1 % of the model's size)" in text


@pytest.mark.parametrize("tolerance", [0.004, "0.3 %"])  # of 1.63 m: 4.9 mm
def test_a_tolerance_in_metres_or_as_a_share(tolerance: Any) -> None:
    check_nodes(
        match(
            block(),
            sensors(CORNERS + np.array([0.003, 0, 0])),
            by="coordinates",
            tolerance=tolerance,
        ),
        0.003,
    )
    with pytest.raises(MatchError, match=r"8 of 8 nodes of the test are not within 0\.00"):
        match(
            block(),
            sensors(CORNERS + np.array([0.006, 0, 0])),
            by="coordinates",
            tolerance=tolerance,
        )


@pytest.mark.parametrize("tolerance", ["3", "x %", 0.0, -1.0, np.inf, True, "-1 %"])
def test_a_tolerance_that_is_none(tolerance: Any) -> None:
    with pytest.raises(MatchError, match="expected a distance in m, or a share"):
        match(block(), sensors(CORNERS), by="coordinates", tolerance=tolerance)


def test_the_measurement_keeps_a_record_of_its_labels() -> None:
    frf = data(["1:X", "12:Y"], ["11:X"])
    found = match(structure(), frf, table={"1:X": "13:-Z"}, directions={"12:Y": B})
    assert found.frf.source == "matched by label, test = model: 1:X = 13:-Z, 12:Y = 12:Y (turned)"
    assert match(structure(), data(["11:X"], ["12:X"])).frf.source == ""


def test_what_is_too_far_is_listed_with_the_nearest() -> None:
    xyz = CORNERS.copy()
    xyz[1] += [0.1, 0, 0]
    with pytest.raises(MatchError) as caught:
        match(block(), sensors(xyz), by="coordinates")
    first, second, third = str(caught.value).splitlines()
    assert first.startswith(
        "1 of 8 nodes of the test are not within 0.0164 m of a node of the model (positions in m;"
    )
    assert second == "  node 5 at (1.4, 0, 0) m: nearest 12 at 0.1 m, 16 at 0.472 m, 13 at 0.728 m"
    assert '"5" = "..."' in third
    check = match(block(), sensors(xyz), by="coordinates", table={"5": "12"})
    assert rows(check)["5:Z"] == "12:Z"
    assert check.table[3].distance == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("unit", "metres"), [("mm", 0.001), ("in", 0.0254), ("cm", 0.01), ("ft", 0.3048)]
)
@pytest.mark.parametrize("pairs", [False, True])
def test_a_unit_is_asked_for_and_applied_only_when_stated(
    unit: str, metres: float, pairs: bool
) -> None:
    frf = sensors(((CORNERS - SHIFT) @ TURN if pairs else CORNERS) / metres)
    alignment = {3: 11, 5: 12, 8: 13} if pairs else None
    with pytest.raises(
        MatchError, match=f"look like {unit}: then all 8 nodes .* state it: unit = '{unit}'"
    ) as caught:
        match(block(), frf, by="coordinates", alignment=alignment)
    assert caught.value.key == ("unit",)
    found = match(block(), frf, by="coordinates", alignment=alignment, unit=unit)
    check_nodes(found)
    assert f"positions in {unit}" in str(found)
    with pytest.raises(
        MatchError, match=f"look like {unit}.* in m 8 do not|look like {unit}.* in m [1-8] do not"
    ):
        match(block(), frf, by="coordinates", alignment=alignment, unit="m")


def test_a_model_in_millimetres_is_told_too() -> None:
    big = Model(block().groups, block().dofs, Geometry(range(11, 19), 1000 * CORNERS))
    with pytest.raises(MatchError, match=r"those of the model look like mm: .* models are in SI"):
        match(big, sensors(CORNERS, "X"), by="coordinates")
    with pytest.raises(MatchError, match="DOF 11:X occurs twice"):  # a stated unit is not doubted
        match(big, sensors(CORNERS, "X"), by="coordinates", unit="m")


def test_an_unknown_unit() -> None:
    with pytest.raises(MatchError, match="unit 'mmm': did you mean 'mm'"):
        match(block(), sensors(CORNERS), by="coordinates", unit="mmm")


@pytest.mark.parametrize("how", ["pairs", "matrix"])
def test_a_rigid_motion_is_found_and_turns_the_sensors(how: str) -> None:
    """The test's own X, Y, Z are oblique in the model; what is measured is the same motion."""
    model = block()
    frf = sensors((CORNERS - SHIFT) @ TURN)  # x_model = TURN @ x_test + SHIFT
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = TURN, SHIFT
    alignment: Any = {3: 11, 5: 12, 8: 13, 34: 16} if how == "pairs" else matrix.tolist()
    found = match(model, frf, by="coordinates", alignment=alignment)
    check_nodes(found)
    np.testing.assert_allclose(found.alignment.rotation, TURN, atol=1e-12)
    np.testing.assert_allclose(found.alignment.shift, SHIFT, atol=1e-12)
    angle = np.degrees(Rotation.from_matrix(TURN).magnitude())
    assert found.alignment.turn == pytest.approx(angle, abs=1e-9)
    assert f"turned by {angle:.3g} degrees, moved by (0.4, -1.1, 2) m" in str(found)
    nodes = dict(zip(NAMES.tolist(), range(11, 19), strict=True))
    readings = {
        str(d): along(model, nodes[d.node], TURN[:, "XYZ".index(d.direction)])
        for d in frf.responses
    }
    check_exact(model, found, readings, {"3:X": along(model, 11, TURN[:, 0])})
    assert (found.alignment.residual is None) == (how == "matrix")
    for row in found.model.geometry.axes:  # the test's axes, by the nearest axis of the model
        assert sorted(np.abs(row @ TURN).max(axis=1)) == pytest.approx([1, 1, 1])


def test_a_fit_to_the_nearest_nodes_recovers_a_small_motion() -> None:
    small = Rotation.from_euler("zyx", [2, -3, 1], degrees=True).as_matrix()
    frf = sensors((CORNERS - np.array([0.03, 0.02, -0.04])) @ small)
    with pytest.raises(MatchError, match="nodes of the test are not within"):
        match(block(), frf, by="coordinates")
    found = match(block(), frf, by="coordinates", alignment="fit")
    check_nodes(found)
    np.testing.assert_allclose(found.alignment.rotation, small, atol=1e-12)
    assert found.alignment.residual == pytest.approx(0, abs=1e-12)
    assert "fitted to the nearest nodes, started from the positions as given" in str(found)


def test_a_fit_that_went_far_is_doubted() -> None:
    with pytest.warns(
        UpdynWarning, match=r"moved the sensors by up to 8\.\d+ m, .* confirm it with three pairs"
    ):
        found = match(block(), sensors(CORNERS + 5.0), by="coordinates", alignment="fit")
    check_nodes(found)
    assert "started with the centres on each other" in str(found)


def test_least_squares_over_pairs() -> None:
    """With noise on the positions: the stationary point of the sum of squares, by its own conditions."""
    from updyn.matching.placement import fit_rigid

    rng = np.random.default_rng(5)
    x = rng.standard_normal((9, 3))
    y = x @ TURN.T + SHIFT + 0.05 * rng.standard_normal((9, 3))
    R, shift, residual = fit_rigid(x, y)
    left = y - x @ R.T - shift
    np.testing.assert_allclose(left.sum(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(
        np.cross(x @ R.T, left).sum(axis=0), 0, atol=1e-10
    )  # no turn improves it
    assert residual == pytest.approx(np.sqrt((left**2).sum() / 9))
    for axis in np.eye(3):
        worse = Rotation.from_rotvec(0.01 * axis).as_matrix() @ R
        assert ((y - y.mean(axis=0) - (x - x.mean(axis=0)) @ worse.T) ** 2).sum() > (left**2).sum()


def mirror() -> np.ndarray:
    return CORNERS * [1.0, -1.0, 1.0]


@pytest.mark.parametrize(
    ("xyz", "alignment", "message"),
    [
        (CORNERS, {3: 11, 5: 12}, "needs three points that are not in a line, found 2"),
        (
            np.outer(np.arange(8), [1.0, 2.0, 0.5]),
            {3: 11, 5: 12, 8: 13},
            "points of the test lie in a line",
        ),
        (np.outer(np.arange(8), [1.0, 2.0, 0.5]), "fit", "points of the test lie in a line"),
        (CORNERS, {3: 11, 5: 12, 8: 99}, "alignment: geometry: node 99 has no position"),
        (CORNERS, {3: 11, 5: 12, 8: 14}, "do not lie on each other within 0.0164 m"),
        (mirror(), {3: 11, 5: 12, 8: 13, 55: 17}, "they would as a mirror image"),
        (CORNERS * 1.25, {3: 11, 5: 12, 8: 13, 55: 17}, "0.8 times as far apart"),
        (CORNERS, np.diag([1.0, 1.0, -1.0, 1.0]), "the matrix is a reflection"),
        (
            CORNERS,
            np.diag([0.001, 0.001, 0.001, 1.0]),
            "the matrix stretches by 0.001; state the unit",
        ),
        (
            CORNERS,
            [[1, 0.1, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
            "its rows are not at right angles",
        ),
        (CORNERS, np.eye(3), r"expected a 4 x 4 matrix .* found shape \(3, 3\)"),
        (CORNERS, [["a"]], "not a matrix of numbers"),
    ],
)
def test_alignments_that_are_none(xyz: np.ndarray, alignment: Any, message: str) -> None:
    with pytest.raises(MatchError, match=message):
        match(block(), sensors(xyz), by="coordinates", alignment=alignment)


def test_two_nodes_equally_near_are_told_apart_by_the_user() -> None:
    xyz = CORNERS.copy()
    xyz[1] = (CORNERS[0] + CORNERS[1]) / 2
    with pytest.raises(
        MatchError,
        match=r'\("5" = "..."\):\n  node 5 at \(0\.65, 0, 0\) m: 11 and 12, both at 0\.65 m',
    ):
        match(block(), sensors(xyz[:2], "Z"), by="coordinates", tolerance=1.0)
    found = match(
        block(), sensors(xyz[:2], "Z"), by="coordinates", tolerance=1.0, table={"5": "12"}
    )
    assert rows(found)["5:Z"] == "12:Z"
    xyz[1] = 0.6 * CORNERS[0] + 0.4 * CORNERS[1]
    found = match(
        block(), sensors(xyz[:2], "Y"), by="coordinates", tolerance=1.0, table={"3": "14"}
    )
    assert found.table[0].distance == pytest.approx(np.linalg.norm(CORNERS[3]))
    assert found.table[1].note == "node 15 is at 0.653 m"


def test_a_sensor_goes_to_a_node_that_can_move_as_it_measures() -> None:
    """A drive train of rotations stands among nodes of translations, some at the same place."""
    shaft = Group(np.eye(2) * 1e3 + 1e3, np.eye(2))
    three = Group(np.eye(3) * 1e3, np.eye(3))
    zero = np.zeros((5, 5))
    K, M = zero.copy(), zero.copy()
    K[:2, :2], M[:2, :2] = shaft.stiffness.toarray(), shaft.mass.toarray()
    K[2:, 2:], M[2:, 2:] = three.stiffness.toarray(), three.mass.toarray()
    geometry = Geometry([1, 2, 3], [[0, 0, 0], [1, 0, 0], [0, 0, 0]])
    model = Model.from_groups(
        {"all": Group(K, M)}, ["1:RZ", "2:RZ", "3:X", "3:Y", "3:Z"], geometry=geometry
    )
    test = Geometry([7], [[0.001, 0, 0]])
    found = match(model, data(["7:X"], ["7:Y"], test), by="coordinates")
    assert rows(found) == {"7:X": "3:X", "7:Y": "3:Y"}
    found = match(model, data(["7:RZ"], ["7:RZ"], test), by="coordinates")
    assert rows(found) == {"7:RZ": "1:RZ"}
    with pytest.raises(
        MatchError, match="no node of the model with a position has translations and rotations"
    ):
        match(model, data(["7:RZ"], ["7:X"], test), by="coordinates")


def test_local_axes_of_a_test_node_are_directions() -> None:
    model = block()
    axes = np.tile(np.eye(3), (8, 1, 1))
    axes[2] = TURN
    frf = sensors(CORNERS, axes=axes)
    for found in (
        match(model, frf, by="coordinates"),
        match(model, frf, table=dict(zip(map(str, NAMES), map(str, range(11, 19)), strict=True))),
    ):
        assert [m.turned for m in found.table] == [m.sensor.startswith("8:") for m in found.table]
        readings = {
            f"{n}:{d}": along(model, 11 + i, axes[i][k])
            for i, n in enumerate(NAMES)
            for k, d in enumerate("XYZ")
        }
        check_exact(model, found, readings, {"3:X": along(model, 11, np.eye(3)[0])})


def test_axes_of_the_same_node_in_model_and_test_are_compared() -> None:
    """Both in one local system: nothing turns. The model knows none: labels are taken, and it is said."""
    axes = np.tile(np.eye(3), (4, 1, 1))
    axes[1] = TURN
    geometry = Geometry(range(11, 15), CORNERS[:4], axes=axes)
    frf = data(["12:X", "12:Y"], ["11:X"], geometry)
    local = structure(axes=axes)
    assert match(local, frf).model is local
    assert not match(local, frf).table[0].turned
    bare = Model(structure().groups, structure().dofs)
    with pytest.warns(UpdynWarning, match="nodes 12 have their own directions"):
        found = match(bare, frf)
    assert found.model is bare
    assert rows(found) == {"12:X": "12:X", "12:Y": "12:Y", "11:X": "11:X"}


def test_directions_of_the_measurement_hold_before_those_of_another_geometry() -> None:
    """Labels of a file whose reader has turned them to the global system must not be turned twice."""
    model, axes = block(), np.tile(np.eye(3), (8, 1, 1))
    axes[0] = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    with pytest.warns(UpdynWarning, match="Directions of nodes 3 are those of the measurement"):
        found = match(
            model, sensors(CORNERS), Geometry(NAMES, CORNERS, axes=axes), by="coordinates"
        )
    assert rows(found)["3:X"] == "11:X"
    bare = sensors(CORNERS)
    bare = FRF(bare.freq, bare.values, bare.responses, bare.references, bare.quantity)
    found = match(model, bare, Geometry(NAMES, CORNERS, axes=axes), by="coordinates")
    assert rows(found)["3:X"] == "11:Y"
    assert rows(found)["3:Y"] == "11:-X"
    assert found.model is model


def test_a_node_without_position_and_a_model_without() -> None:
    frf = data(["3:X", "4:X"], ["3:Y"], Geometry(NAMES, CORNERS))
    with pytest.raises(
        MatchError,
        match=r"1 nodes of the measurement have no position .* \(it has 3, 5, 8.*table: 4",
    ):
        match(block(), frf, by="coordinates")
    assert rows(match(block(), frf, by="coordinates", table={"4:X": "13:-Z"}))["4:X"] == "13:-Z"
    bare = Model(block().groups, block().dofs)
    with pytest.raises(MatchError, match="the model has no geometry"):
        match(bare, frf, by="coordinates")


def test_a_fitted_turn_of_less_than_a_degree_is_no_turn_of_the_sensors() -> None:
    """It is no better known than the positions: along the DOFs, and said; exact where that is asked for."""
    half = Rotation.from_euler("y", 0.5, degrees=True).as_matrix()
    frf = sensors(CORNERS @ half)
    with pytest.warns(
        UpdynWarning,
        match=r"16 sensors .* not quite along; the largest angle is 0\.5 degrees, of 3:X",
    ):
        found = match(block(), frf, by="coordinates", alignment="fit")
    assert not any(m.turned for m in found.table)
    assert max(m.angle for m in found.table) == pytest.approx(0.5)
    assert all(
        m.turned
        for m in match(block(), frf, by="coordinates", alignment="fit", angle=0.1).table
        if "Y" not in m.sensor
    )


def test_a_fitted_turn_of_more_than_a_degree_turns_the_sensors() -> None:
    turn = Rotation.from_euler("y", 1.5, degrees=True).as_matrix()
    found = match(block(), sensors(CORNERS @ turn), by="coordinates", alignment="fit")
    assert any(m.turned for m in found.table)
