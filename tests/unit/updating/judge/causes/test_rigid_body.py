"""Sensors that do not follow the rigid-body motion of a free structure, and none in sound data."""

import itertools
import re
from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.elements.structure import Beam, rectangle, structure
from updyn.updating.judge.causes import rigid_explanation
from updyn.updating.judge.causes.data_alone import make_finding
from updyn.updating.judge.causes.rigid_body import RigidBody
from updyn.updating.judge.causes.rigid_explanation import Explanation, explain_sensors
from updyn.updating.judge.causes.rigid_motion import RigidMotion
from updyn.updating.judge.causes.rigid_shapes import RigidShapes
from updyn.updating.problem.problem import FRFPart

STEEL = (2.1e11, 7850.0)
CORNERS = ["1:X", "1:Y", "1:Z", "2:X", "3:Y", "4:Z", "5:X", "6:Z", "7:Y", "8:X", "8:Y", "8:-Z"]


@pytest.fixture(scope="module")
def cube():
    """A free frame of 0.5 m, node 1 + 4 x + 2 y + z at its corners; first elastic mode 63 Hz."""
    at = {1 + 4 * x + 2 * y + z: [0.5 * x, 0.5 * y, 0.5 * z] for x, y, z in np.ndindex(2, 2, 2)}
    nodes, edges = dict(at), []
    for a, b in itertools.combinations(at, 2):
        if sum(p != q for p, q in zip(at[a], at[b], strict=True)) == 1:
            middle = 10 * a + b
            nodes[middle] = [(p + q) / 2 for p, q in zip(at[a], at[b], strict=True)]
            edges.append([a, middle, b])
    section = rectangle(0.02, 0.015)
    parts = [
        Beam(
            f"edge {a}-{b}",
            [[a, m], [m, b]],
            *STEEL,
            section,
            orientation=[0.3, 0.5, 0.8],
            loss_factor=0.01,
        )
        for a, m, b in edges
    ]
    return structure(nodes, parts), {node: np.array(x) for node, x in at.items()}


def rigid(positions, sensors, forces):
    """Accelerance of a rigid body of 7 kg, Ewins, Modal Testing, 2nd ed. 2000, section 5.5.4."""
    mass = np.diag([7.0, 7.0, 7.0, 0.4, 0.5, 0.3])

    def motion(label):
        dof = updyn.Dof.parse(label)
        along = dof.sign * np.eye(3)["XYZ".index(dof.direction)]
        arm = positions[dof.node] - np.array([0.22, 0.26, 0.3])
        return np.concatenate([along, np.cross(arm, along)])

    out, into = (np.array([motion(label) for label in labels]) for labels in (sensors, forces))
    return out @ np.linalg.solve(mass, into.T)


@pytest.fixture(scope="module")
def sound(cube):
    """Closed form: the masses are not those of the model, and nothing is elastic."""
    freq = np.linspace(2.0, 40.0, 20)
    values = np.tile(rigid(cube[1], CORNERS, ["1:Z", "4:X"]), (len(freq), 1, 1))
    return updyn.FRF(freq, values, CORNERS, ["1:Z", "4:X"], "accelerance")


@pytest.fixture(scope="module")
def shapes(cube):
    return shapes_of(cube[0], "1:X")


def shapes_of(model, label):
    frf = updyn.FRF([1.0], np.ones((1, 1, 1)), [label], [label], "receptance")
    return RigidShapes.of(FRFPart.build(model, frf, updyn.parameters(model, stiffness="all")))


def found_in(shapes, frf):
    with_noise = replace(frf, variance=1e-4 * np.abs(frf.values) ** 2)
    return [make_finding(one, "") for one in RigidBody.detect_in(with_noise, shapes)]


def with_row(frf, label, row):
    values = frf.values.copy()
    values[:, CORNERS.index(label)] = row
    return replace(frf, values=values)


def repairs(finding):
    return re.findall(r"\(([a-z]+:[^)]+)\)", finding.statement)


def test_rigid_body_shapes_are_translations_and_rotations(cube, shapes):
    model, positions = cube
    rows = shapes.at(updyn.DofSet(f"{node}:{d}" for node in positions for d in "XYZ"))
    expected = np.concatenate([np.hstack([np.eye(3), _cross(x)]) for x in positions.values()])
    assert shapes.shapes.shape[1] == np.linalg.matrix_rank(np.hstack([rows, expected])) == 6
    assert shapes.elastic == pytest.approx(updyn.modes(model, 7).frequency[-1])


def _cross(x):
    return np.cross(np.eye(3), x).T


def test_a_held_model_has_no_rigid_body_shapes(cube):
    held = cube[0].with_element("foot", ["1:X", "1:Y", "1:Z"], stiffness=1e5)
    assert shapes_of(held, "1:X") is None


def test_the_shapes_leave_the_model_as_it_is(cube):
    """Zero entries of the stiffness are not dropped from the pattern of the whole model."""
    frf = updyn.response(cube[0], [10.0], ["1:X"], ["1:X"])
    part = FRFPart.build(cube[0], frf, updyn.parameters(cube[0], stiffness="all"))
    before = part.responses(part.coordinates.start)
    RigidShapes.of(part)
    after = FRFPart.responses(replace(part), part.coordinates.start)
    assert after == pytest.approx(before, rel=1e-9)
    assert before == pytest.approx(frf.values, rel=1e-9)


@pytest.mark.parametrize("quantity", ["accelerance", "mobility", "receptance"])
def test_rigid_body_motion_is_sound(shapes, sound, add_noise, quantity):
    assert found_in(shapes, sound.converted(quantity)) == []
    for seed in range(5):
        noisy = add_noise(sound, np.random.default_rng(seed), 0.03, 0.01)
        assert found_in(shapes, noisy.converted(quantity)) == []


def test_usual_errors_of_sensors_are_not_reported(cube, shapes, sound):
    """Sensitivities off by 3 % and directions off by 2 degrees."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        values = sound.values.copy()
        for i, label in enumerate(CORNERS):
            node, direction = label.replace("-", "").split(":")
            across = [f"{node}:{d}" for d in "XYZ" if d != direction]
            turned = np.radians(2.0 * rng.standard_normal(2))
            values[:, i] *= 1.0 + 0.03 * rng.standard_normal()
            values[:, i] += turned @ rigid(cube[1], across, ["1:Z", "4:X"])
        assert found_in(shapes, replace(sound, values=values)) == []


@pytest.mark.parametrize("label", ["1:X", "7:Y", "8:-Z"])
def test_the_opposite_sign_is_named(shapes, sound, label):
    (found,) = found_in(shapes, with_row(sound, label, -sound.values[:, CORNERS.index(label)]))
    plain = label.replace("-", "")
    assert (found.kind, found.channels) == ("rigid-body", (plain,))
    assert repairs(found)[0] == f"sign:{plain}"
    assert f'repair = ["sign:{plain}"]' in found.remedy
    assert found.written == ""
    row = sound.values[0, CORNERS.index(label)]
    assert found.value == pytest.approx(2 * _relative(row, sound, label), rel=1e-3)


def _relative(row, sound, label):
    others = np.delete(sound.values[0], CORNERS.index(label), axis=0)
    return np.max(np.abs(row) / np.sqrt(np.mean(np.abs(others) ** 2, axis=0)))


def test_a_calibration_is_named_with_its_factor(shapes, sound):
    (found,) = found_in(shapes, with_row(sound, "1:Z", 1.5 * sound.values[:, 2]))
    assert found.channels == ("1:Z",)
    assert "a factor of 1.5 (calibration:1:Z=0.4055" in found.statement


def test_exchanged_sensors_are_named(shapes, sound):
    values = sound.values.copy()
    values[:, [1, 8]] = values[:, [8, 1]]
    (found,) = found_in(shapes, replace(sound, values=values))
    assert found.channels == ("1:Y", "7:Y")
    assert repairs(found)[0] == "swapped:1:Y,7:Y"


def test_a_turned_sensor_is_named_with_its_angle(cube, shapes, sound):
    """A sensor of one direction has no repair; all directions of one that is turned have one."""
    across = rigid(cube[1], ["4:X"], ["1:Z", "4:X"])
    c, s = np.cos(np.radians(30.0)), np.sin(np.radians(30.0))
    row = c * sound.values[:, CORNERS.index("4:Z")] + s * across
    (found,) = found_in(shapes, with_row(sound, "4:Z", row))
    assert found.channels == ("4:Z",)
    assert "a turn by 30 degrees towards X" in found.statement
    x, y = sound.values[:, 9], sound.values[:, 10]
    both = with_row(with_row(sound, "8:X", c * x + s * y), "8:Y", c * y - s * x)
    (found,) = found_in(shapes, both)
    assert set(found.channels) <= {"8:X", "8:Y"}
    assert "turned:8:Z=30" in repairs(found)


def test_a_sensor_at_another_node_is_named_with_its_place(cube, shapes, sound):
    """Node 26, amid nodes 2 and 6, is next to node 6."""
    positions = {**cube[1], 26: (cube[1][2] + cube[1][6]) / 2}
    row = rigid(positions, ["26:Z"], ["1:Z", "4:X"])
    (found,) = found_in(shapes, with_row(sound, "6:Z", row))
    assert found.channels == ("6:Z",)
    assert "moved:6:Z,26:Z" in repairs(found)


@pytest.mark.parametrize("factor", [1 / 3, 1.0, 3.0])
def test_the_stiffness_of_the_model_does_not_matter(cube, add_noise, factor):
    model, _ = cube
    wrong = shapes_of(model.scaled({g: {"stiffness": factor} for g in model.groups}), "1:X")
    freq = np.arange(1.0, 250.0, 1.0)
    clean = updyn.response(model, freq, CORNERS, ["1:Z", "4:X"], "accelerance")
    for seed in range(3):
        frf = add_noise(clean, np.random.default_rng(seed), 0.02, 0.01)
        assert found_in(wrong, frf) == []
        (found,) = found_in(wrong, with_row(frf, "7:Y", -frf.values[:, 8]))
        assert (found.channels, repairs(found)[0]) == (("7:Y",), "sign:7:Y")


def test_a_soft_suspension_does_not_matter(cube, shapes, add_noise):
    """Four springs at the upper corners, rigid-body modes at 1 to 3 Hz; the model is free."""
    model, _ = cube
    held = model
    for node in (2, 4, 6, 8):
        held = held.with_element(
            f"cord {node}", [f"{node}:{d}" for d in "XYZ"], stiffness=200.0, loss_factor=0.05
        )
    assert updyn.modes(held, 7).frequency[:6].max() < 4.0
    clean = updyn.response(held, np.arange(1.0, 100.0, 0.5), CORNERS, ["1:Z", "4:X"], "accelerance")
    for seed in range(3):
        frf = add_noise(clean, np.random.default_rng(seed), 0.02, 0.003)
        assert found_in(shapes, frf) == []
        (found,) = found_in(shapes, with_row(frf, "7:Y", -frf.values[:, 8]))
        assert (found.channels, repairs(found)[0]) == (("7:Y",), "sign:7:Y")


@pytest.fixture(scope="module")
def bar():
    """Five masses of 1 kg on springs, free; first elastic mode 98 Hz."""
    groups = {}
    for i in range(4):
        K = np.zeros((5, 5))
        K[i : i + 2, i : i + 2] = 1e6 * np.array([[1.0, -1.0], [-1.0, 1.0]])
        groups[f"spring {i + 1}"] = updyn.Group(K, loss_factor=0.02)
    groups["masses"] = updyn.Group(mass=np.eye(5))
    return updyn.Model.from_groups(groups, [f"{i}:X" for i in range(1, 6)])


def test_of_two_sensors_alone_none_is_blamed(bar):
    """Each of two could be wrong; with a third it is clear."""
    rows = np.array([[1.0], [1.0], [-1.0]]) / 5
    frf = updyn.FRF(
        np.linspace(1.0, 20.0, 20),
        np.tile(rows, (20, 1, 1)),
        ["1:X", "3:X", "5:X"],
        ["1:X"],
        "accelerance",
    )
    shapes = shapes_of(bar, "1:X")
    (found,) = found_in(shapes, frf)
    assert (found.channels, repairs(found)) == (("5:X",), ["sign:5:X"])
    assert found.value == pytest.approx(2.0)
    (found,) = found_in(shapes, frf.select(responses=["1:X", "5:X"]))
    assert found.channels == ("1:X", "5:X")
    assert "number of wrong sensors: 1" in found.statement
    assert "repair" not in found.remedy
    assert found_in(shapes, frf.select(responses=["5:X"])) == []


def test_lines_near_the_elastic_modes_are_not_used(shapes, sound):
    bad = with_row(sound, "1:X", -sound.values[:, 0])
    assert found_in(shapes, replace(bad, freq=bad.freq + 20.0)) == []


def test_a_sensor_without_others_is_not_checked(shapes, sound):
    """Of the sensors in X and Y at the bottom none shares the motion of the others along Z."""
    few = sound.select(responses=["1:X", "1:Y", "2:X", "3:Y", "5:X", "1:Z", "7:Y", "8:X", "8:Y"])
    values = few.values.copy()
    values[:, 5] *= -1.0
    assert found_in(shapes, replace(few, values=values)) == []


def test_a_fault_found_with_the_model_is_reported_alone(bar, add_noise):
    sensors = [f"{i}:X" for i in range(1, 6)]
    clean = updyn.response(bar, np.arange(4.0, 400.0, 8.0), sensors, ["1:X"], "accelerance")
    frf = add_noise(clean, np.random.default_rng(0), 0.01, 0.001)
    unknowns = updyn.parameters(bar, stiffness="all", loss_factor="all")
    values = frf.values.copy()
    values[:, 2] *= -1.0
    (found,) = updyn.diagnose(bar, replace(frf, values=values), unknowns)
    assert (found.kind, found.channels) == ("sign", ("3:X",))


def test_a_model_that_is_far_off_names_the_sensor_all_the_same(bar, add_noise):
    """Stiffnesses a hundred times too large: model and data have nothing else in common."""
    sensors = [f"{i}:X" for i in range(1, 6)]
    clean = updyn.response(bar, np.arange(4.0, 400.0, 8.0), sensors, ["1:X"], "accelerance")
    frf = add_noise(clean, np.random.default_rng(0), 0.01, 0.001)
    values = frf.values.copy()
    values[:, 2] *= -1.0
    stiff = bar.scaled({f"spring {i}": {"stiffness": 9.0 * i} for i in range(1, 5)})
    unknowns = updyn.parameters(stiff, loss_factor="all")
    found = updyn.diagnose(stiff, replace(frf, values=values), unknowns)
    assert (found[0].kind, found[0].channels) == ("rigid-body", ("3:X",))
    assert repairs(found[0])[0] == "sign:3:X"


# -- thresholds
@pytest.fixture(scope="module")
def motion(cube, shapes):
    """24 sensors of a rigid body: 18 more than its rigid-body modes."""
    sensors = [f"{node}:{axis}" for node in cube[1] for axis in "XYZ"]
    return RigidMotion.of(measured_rigidly(cube, sensors, np.linspace(2.0, 18.0, 20)), shapes)


def measured_rigidly(cube, sensors, freq):
    values = np.tile(rigid(cube[1], sensors, ["1:Z"]), (len(freq), 1, 1))
    variance = 1e-16 * np.abs(values) ** 2
    return updyn.FRF(freq, values, sensors, ["1:Z"], "accelerance", variance=variance)


def test_sound_sensors_deviate_by_4_per_cent_of_their_node_and_2_of_the_rms(motion):
    std = motion.standard_deviation(motion.leave_out([]))[:, 0]
    of_node = np.linalg.norm(motion.values.reshape(8, 3), axis=1).repeat(3)
    rms = np.sqrt(np.mean(np.abs(motion.values) ** 2))
    assert std == pytest.approx(np.hypot(0.04 * of_node, 0.02 * rms), rel=1e-6)


@pytest.mark.parametrize(
    ("share", "usable"), [((0.2, 0.22, 0.25, 0.28), True), ((0.2, 0.22, 0.25), False)]
)
def test_four_lines_below_three_tenths_of_the_elastic_mode_are_enough(cube, shapes, share, usable):
    freq = np.append(np.array(share), [0.32, 0.4, 0.5]) * shapes.elastic
    found = RigidMotion.of(measured_rigidly(cube, CORNERS, freq), shapes)
    assert (found is not None) == usable
    if usable:
        assert found.data.freq == pytest.approx(freq[:4])


@pytest.mark.parametrize(
    ("misfits", "wrong"),
    [
        # Odds of 20 to 1 between two sensors, and of 1000 to 1 for each further one.
        ({(0,): 10.0, (1,): 12.9}, [(0,), (1,)]),
        ({(0,): 10.0, (1,): 13.1}, [(0,)]),
        ({(0,): 20.0, (1, 2): 9.9}, [(1, 2)]),
        ({(0,): 20.0, (1, 2): 16.1}, [(0,)]),
        # Up to three of the twelve that deviate most.
        ({(0, 1, 2): 1.0}, [(0, 1, 2)]),
        ({(0, 1, 2, 3): 1.0}, []),
        ({(11,): 1.0, (12,): 0.0}, [(11,)]),
    ],
)
def test_the_likeliest_sets_of_wrong_sensors(motion, monkeypatch, misfits, wrong):
    deviations = np.arange(30.0, 6.0, -1.0)
    monkeypatch.setattr(RigidMotion, "deviations", lambda self, rows: deviations)
    monkeypatch.setattr(RigidMotion, "_misfit", lambda self, left_out: misfits.get(left_out))
    assert motion.find_wrong() == wrong


@pytest.mark.parametrize(("share", "unchecked"), [(0.04, True), (0.06, False)])
def test_a_sensor_of_which_others_show_a_twentieth_is_checked(motion, share, unchecked):
    """Of a shape (1, a, a), the share 2 a^2 / (1 + 2 a^2) of the first sensor is redundant."""
    a = np.sqrt(0.5 * share / (1.0 - share))
    three = {"sensors": motion.sensors[:3], "shapes": np.array([[1.0], [a], [a]])}
    names = replace(motion, values=np.ones((3, 1), dtype=complex), **three).list_unchecked()
    assert (str(motion.sensors[0]) in names) == unchecked


@pytest.mark.parametrize(
    ("deviations", "kept"), [((1.9, 2.1), (1.9,)), ((2.1,), ()), ((0.0, 1.7, 1.8), (0.0, 1.7))]
)
def test_faults_that_explain_to_two_deviations_and_as_likely_are_named(
    motion, monkeypatch, deviations, kept
):
    """Odds of 20 to 1 are a difference of 3 between the squares."""
    faults = [Explanation("a fault", "", one) for one in deviations]
    monkeypatch.setattr(rigid_explanation, "_try_faults", lambda *given: iter(faults))
    (found,) = explain_sensors(motion, [0]).values()
    assert tuple(one.deviation for one in found) == kept
