"""Sensors with several directions that were mounted turned about an axis."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import updyn
from updyn.errors import OptionError
from updyn.updating.judge.causes.catalogue import CAUSES, read_fault
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.problem.problem import FRFPart

N = 4
SENSORS = ["1:X", "3:X", "3:Y", "4:X", "4:Y"]
FREQ = np.linspace(3.0, 55.0, 48)


def two_chains(stiffness=()):
    """Masses that move in X and in Y, with unlike springs, coupled at one node by a slanted one."""
    groups = {}
    for direction, factor in (("X", 1.0), ("Y", 1.7)):
        first = 0 if direction == "X" else N
        for i in range(N):
            K = np.zeros((2 * N, 2 * N))
            own = first + i
            K[own, own] = 2e4 * factor
            if i:
                K[own - 1, own - 1] = 2e4 * factor
                K[own, own - 1] = K[own - 1, own] = -2e4 * factor
            groups[f"{direction}{i + 1}"] = updyn.Group(K, loss_factor=0.02)
    K = np.zeros((2 * N, 2 * N))
    K[np.ix_([2, N + 2], [2, N + 2])] = 4e3 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    groups["slanted"] = updyn.Group(K, loss_factor=0.02)
    groups["masses"] = updyn.Group(mass=np.eye(2 * N))
    labels = [f"{i + 1}:{direction}" for direction in "XY" for i in range(N)]
    model = updyn.Model.from_groups(groups, labels)
    return model.scaled({name: {"stiffness": factor} for name, factor in stiffness})


@pytest.fixture(scope="module")
def clean():
    true = two_chains([("X2", 1.3), ("Y4", 0.8)])
    return updyn.response(true, FREQ, SENSORS, ["2:X", "4:Y"], "accelerance")


@pytest.fixture(scope="module")
def unknowns():
    return updyn.parameters(two_chains(), stiffness="[XY]*", loss_factor="[XY]*")


def turned(frf, degrees, rows=(1, 2)):
    """Return data of a sensor whose X axis is at some angle from that of its label."""
    a, b = rows
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    values = frf.values.copy()
    values[:, a] = c * frf.values[:, a] + s * frf.values[:, b]
    values[:, b] = c * frf.values[:, b] - s * frf.values[:, a]
    return replace(frf, values=values)


def triaxial(rng, responses=("5:X", "7:X", "7:Y", "7:Z"), references=("5:X", "7:Z")):
    values = rng.standard_normal((2, 12, len(responses), len(references)))
    frf = updyn.FRF(
        np.arange(1.0, 13.0), values[0] + 1j * values[1], responses, references, "accelerance"
    )
    return replace(frf, variance=0.01 * np.abs(frf.values) ** 2)


@pytest.mark.parametrize("axis", ["X", "Y", "Z"])
def test_directions_are_turned_back_as_a_rotation_of_space_says(axis):
    """The axes of a turned sensor are R e_k, so that it measures R^T u."""
    frf = triaxial(np.random.default_rng(1))
    turn = Rotation.from_euler(axis.lower(), 35.0, degrees=True).as_matrix()
    values = frf.values.copy()
    values[:, 1:] = turn.T @ frf.values[:, 1:]
    repaired = read_fault(f"turned:7:{axis}=35").repair(replace(frf, values=values))
    np.testing.assert_allclose(repaired.values, frf.values, atol=1e-12)


def test_signs_of_labels_and_rotations_of_the_node_are_turned_along():
    labels = ["7:X", "7:-Y", "7:RX", "7:RY"]
    frf = triaxial(np.random.default_rng(2), labels)
    turn = Rotation.from_euler("z", -20.0, degrees=True).as_matrix()[:2, :2]
    sign = np.array([1.0, -1.0, 1.0, 1.0])[:, None]
    true = sign * frf.values
    measured = np.concatenate([turn.T @ true[:, :2], turn.T @ true[:, 2:]], axis=1)
    repaired = read_fault("turned:7:Z=-20").repair(replace(frf, values=sign * measured))
    np.testing.assert_allclose(repaired.values, frf.values, atol=1e-12)


def test_a_force_with_two_directions_is_turned_back():
    """The force that is called X acts along R e_X."""
    frf = triaxial(np.random.default_rng(3), references=("5:X", "7:X", "7:Y"))
    turn = Rotation.from_euler("z", 30.0, degrees=True).as_matrix()[:2, :2]
    values = frf.values.copy()
    values[:, :, 1:] = frf.values[:, :, 1:] @ turn
    repaired = read_fault("turned:force 7:Z=30").repair(replace(frf, values=values))
    np.testing.assert_allclose(repaired.values, frf.values, atol=1e-12)


def test_variance_and_coherence_go_along():
    frf = triaxial(np.random.default_rng(4))
    frf = replace(frf, coherence=np.linspace(0.5, 0.9, frf.values.size).reshape(frf.values.shape))
    repaired = read_fault("turned:7:Z=30").repair(frf)
    v = frf.variance
    np.testing.assert_allclose(repaired.variance[:, 1], 0.75 * v[:, 1] + 0.25 * v[:, 2])
    np.testing.assert_allclose(repaired.variance[:, [0, 3]], v[:, [0, 3]])
    np.testing.assert_allclose(
        repaired.coherence[:, 1], np.minimum(frf.coherence[:, 1], frf.coherence[:, 2])
    )
    np.testing.assert_allclose(repaired.coherence[:, [0, 3]], frf.coherence[:, [0, 3]])


def test_the_slope_is_that_of_a_small_turn(clean):
    frf = replace(clean, variance=1e-12 * np.abs(clean.values) ** 2)
    part = FRFPart.build(two_chains(), frf, updyn.parameters(two_chains(), stiffness="X*"))
    evidence = Evidence(part, part.coordinates.start)
    fault = CAUSES["turned"](("3:Z",), 20.0)
    model = replace(frf, values=evidence.model_response(frf))
    step = 1e-4
    there, back = (turned(model, degrees).values for degrees in (step, -step))
    expected = (np.log(there / model.values) - np.log(back / model.values)) / (2.0 * step)
    np.testing.assert_allclose(fault.slope(evidence), expected, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("degrees", [10.0, -75.0, 180.0])
def test_a_turned_sensor_is_found_by_its_angle(clean, unknowns, add_noise, degrees):
    noisy = add_noise(turned(clean, degrees), np.random.default_rng(5), 0.01)
    (found,) = updyn.diagnose(two_chains(), noisy, unknowns)
    assert (found.kind, found.channels) == ("turned", ("3:Z",))
    assert abs((found.value - degrees + 180.0) % 360.0 - 180.0) < 0.2
    off = found.repair(noisy).values / clean.values - 1.0
    assert np.median(np.abs(off)) < 0.02


def test_a_turn_by_a_right_angle_names_what_is_the_same(clean, unknowns, add_noise):
    noisy = add_noise(turned(clean, 90.0), np.random.default_rng(6), 0.01)
    (found,) = updyn.diagnose(two_chains(), noisy, unknowns)
    assert "3:X and 3:Y exchanged, with the sign of 3:Y changed" in found.statement
    # So it is.
    values = clean.values.copy()
    values[:, 1], values[:, 2] = clean.values[:, 2], -clean.values[:, 1]
    np.testing.assert_allclose(turned(clean, 90.0).values, values, atol=1e-12)


def test_exchanged_cables_are_no_turn(clean, unknowns, add_noise):
    values = clean.values.copy()
    values[:, [1, 2]] = clean.values[:, [2, 1]]
    noisy = add_noise(replace(clean, values=values), np.random.default_rng(7), 0.01)
    (found,) = updyn.diagnose(two_chains(), noisy, unknowns)
    assert (found.kind, found.channels) == ("swapped", ("3:X", "3:Y"))


def test_cross_axis_sensitivity_is_no_turn(clean, unknowns, add_noise):
    """A sensor may answer to motion across its axis with 5 % of its sensitivity: 2.9 degrees."""
    rng = np.random.default_rng(8)
    assert updyn.diagnose(two_chains(), add_noise(turned(clean, 2.0), rng, 0.01), unknowns) == ()
    (found,) = updyn.diagnose(two_chains(), add_noise(turned(clean, 4.0), rng, 0.01), unknowns)
    assert found.written.startswith("turned:3:Z=")


@pytest.mark.parametrize(
    ("written", "said"),
    [
        ("turned:1:Z=30", "needs both 1:X and 1:Y"),
        ("turned:3:RZ=30", "axis X, Y or Z"),
        ("turned=30", "axis X, Y or Z"),
        ("turned:3:Z=much", "no number"),
        ("turned:force 4:Z=30", "needs both 4:X and 4:Y as a reference"),
    ],
)
def test_a_turn_that_the_data_cannot_undo_is_refused(clean, written, said):
    with pytest.raises(OptionError, match=said):
        read_fault(written).repair(clean)
