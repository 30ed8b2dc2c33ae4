"""A drive train on a structure: against matrices put together by hand."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose

import updyn
from updyn.elements.drivetrain import GearPair, Inertia, Motor, Shaft, drivetrain, mounted
from updyn.errors import DofError, ModelError
from updyn.model import Group, Model

LABELS = [f"{n}:{d}" for n in (1, 2) for d in ("X", "Y", "Z", "RX", "RY", "RZ")]
rng = np.random.default_rng(5)
A = rng.standard_normal((12, 12))
STRUCTURE = Model.from_groups(
    {"frame": Group(A @ A.T * 1e3, np.diag(rng.uniform(1, 3, 12)))}, LABELS, title="Frame"
)
AXIS = np.array([1.0, 2.0, 2.0]) / 3.0
DRIVE = [Motor("motor", 101, 0.02), Shaft("shaft", 101, 102, 4e3), Inertia("wheel", 102, 0.5)]


def test_a_wheel_that_turns_with_a_node():
    model = mounted(drivetrain(DRIVE), STRUCTURE, {102: (2, (1.0, 2.0, 2.0))})
    assert model.dofs.labels == [*LABELS, "101:RZ"]
    assert list(model.groups) == ["frame", "motor", "shaft", "wheel"]
    assert model.title == "Frame"
    n = np.zeros(13)
    n[9:12] = AXIS  # of theta_102 in RX, RY, RZ of node 2
    motor = np.eye(13)[12]
    K, M = np.zeros((13, 13)), np.zeros((13, 13))
    K[:12, :12], M[:12, :12] = STRUCTURE.stiffness.toarray(), STRUCTURE.mass.toarray()
    K += 4e3 * np.outer(n - motor, n - motor)
    M += 0.02 * np.outer(motor, motor) + 0.5 * np.outer(n, n)
    assert_allclose(model.stiffness.toarray(), K, rtol=1e-12, atol=1e-9)
    assert_allclose(model.mass.toarray(), M, rtol=1e-12, atol=1e-12)


def test_response_is_that_of_the_two_coupled_by_their_impedances():
    """Receptance coupling at one DOF: H = H_s - H_sc H_cs / (H_cc + H_dd)."""
    drive = drivetrain(DRIVE)
    freq = np.array([3.0, 11.0, 40.0])
    whole = updyn.response(
        mounted(drive, STRUCTURE, {102: (2, AXIS)}), freq, ["1:X"], ["1:X"]
    ).values[:, 0, 0]
    names = ["1:X", "2:RX", "2:RY", "2:RZ"]
    H = updyn.response(STRUCTURE, freq, names, names).values
    turn = np.array([[1, 0, 0, 0], [0, *AXIS]])
    H = turn @ H @ turn.T
    H_d = updyn.response(drive, freq, ["102:RZ"], ["102:RZ"]).values[:, 0, 0]
    coupled = H[:, 0, 0] - H[:, 0, 1] * H[:, 1, 0] / (H[:, 1, 1] + H_d)
    assert_allclose(whole, coupled, rtol=1e-9)


def test_housing_and_load_on_one_structure_leave_its_rigid_rotation_free():
    """A drive between two nodes of a free body, about one axis: turning the whole costs nothing."""
    k = np.array([[2e4, -2e4], [-2e4, 2e4]])
    body = Model.from_groups({"frame": Group(k, np.diag([3.0, 4.0]))}, ["1:RY", "2:RY"])
    train = [
        Motor("motor", 101, 0.02, rotor="locked", housing=100),
        GearPair("gear", 101, 102, ratio=12.0, torsional_stiffness=1e5, housing=100),
        Shaft("shaft", 102, 103, 4e3),
    ]
    model = mounted(drivetrain(train), body, {100: (1, (0, 1, 0)), 103: (2, (0, 1, 0))})
    assert model.dofs.labels == ["1:RY", "2:RY", "102:RZ"]
    assert_allclose(model.stiffness @ np.ones(3), 0.0, atol=1e-9)
    # between the nodes: frame beside gear and shaft in a row
    K = model.stiffness.toarray()
    between = K[0, 0] - K[0, 2] ** 2 / K[2, 2]
    assert_allclose(between, 2e4 + 1 / (1 / 1e5 + 1 / 4e3), rtol=1e-12)


def test_an_axis_turned_round_turns_the_sense():
    one, other = (
        mounted(drivetrain(DRIVE), STRUCTURE, {102: (2, axis)}).stiffness.toarray()
        for axis in (AXIS, -AXIS)
    )
    assert_allclose(other[:12, 12], -one[:12, 12])
    assert_allclose(other[:12, :12], one[:12, :12])


@pytest.mark.parametrize(
    ("drive", "at", "error", "message"),
    [
        (DRIVE, {}, ModelError, "expected {node of the train: (node of the structure, axis)}"),
        (
            DRIVE,
            {103: (2, AXIS)},
            ModelError,
            "the train has no DOF 103:RZ (held, or it follows another",
        ),
        (DRIVE, {"102": (2, AXIS)}, ModelError, "mounted: node '102'; expected a whole number"),
        (DRIVE, {102: 2}, ModelError, "node 102: 2; expected (node of the structure, axis)"),
        (
            DRIVE,
            {102: (2, (0, 0, 0))},
            ModelError,
            "expected three numbers that are not all 0",
        ),
        (DRIVE, {102: (9, AXIS)}, DofError, "9:RX"),
        (
            [Shaft("shaft", 1, 102, 5.0), Inertia("wheel", 102, 0.5), Inertia("hub", 1, 0.1)],
            {102: (2, AXIS)},
            ModelError,
            "DOFs in the train and in the structure: 1:RZ; number the nodes of the train otherwise",
        ),
        ([Inertia("frame", 102, 0.5)], {102: (2, AXIS)}, ModelError, "both have a group 'frame'"),
    ],
)
def test_bad_mounts(drive, at, error, message):
    with pytest.raises(error, match=re.escape(message)):
        mounted(drivetrain(drive), STRUCTURE, at)
