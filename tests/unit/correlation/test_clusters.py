"""Close modes as subspaces, against closed forms, SciPy's principal angles and turned bases."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st

import updyn
from updyn.correlation import ecomac, mac, principal_cosines
from updyn.correlation.clusters import cluster_modes
from updyn.correlation.settings import MODE_PAIRING
from updyn.errors import DataError

STOREYS = 4
LABELS = [f"{i + 1}:X" for i in range(STOREYS)] + [f"{i + 1}:Y" for i in range(STOREYS)]
FACTORS = (1.3, 1.0, 0.8, 1.0)


def storeys(factors=FACTORS):
    """Stiffness of a chain from the ground, in N/m."""
    K = np.zeros((STOREYS, STOREYS))
    for i, factor in enumerate(factors):
        K[i, i] += 2e4 * factor
        if i:
            K[i - 1 : i + 1, i - 1 : i + 1] += 2e4 * factor * np.array([[1, -1], [-1, 0]])
    return K


def mast(in_y=1.0, loss=0.01):
    """A mast with equal bending in X and Y: every mode is there twice."""
    K = scipy.linalg.block_diag(storeys(), in_y * storeys())
    group = updyn.Group(K, np.eye(2 * STOREYS), loss_factor=loss)
    return updyn.Model.from_groups({"mast": group}, LABELS)


def measured(turn=0.0, split=0.0, noise=0.0, which=slice(None)):
    """Modes of the mast in another basis of the same planes, turned by an angle in degrees."""
    value, bending = scipy.linalg.eigh(storeys())
    c, s = np.cos(np.deg2rad(turn)), np.sin(np.deg2rad(turn))
    frequency, shapes = [], []
    for f, shape in zip(np.sqrt(value) / (2 * np.pi), bending.T, strict=True):
        frequency += [f, f * (1 + split)]
        shapes += [np.append(c * shape, s * shape), np.append(-s * shape, c * shape)]
    found = np.array(shapes).T
    found = found + noise * np.random.default_rng(7).standard_normal(found.shape)
    return updyn.ModeSet(np.array(frequency)[which], found[:, which], LABELS)


@pytest.mark.parametrize("split", [0.0, 1e-4])
@pytest.mark.parametrize("turn", [0, 10, 30, 45])
def test_an_exact_model_of_a_symmetric_mast_agrees_in_any_basis(turn, split):
    found = updyn.correlate(mast(), measured(turn, split))
    assert found.pairs.mac == pytest.approx(np.ones(2 * STOREYS), abs=1e-12)
    assert [s.computed.tolist() for s in found.subspaces] == [[0, 1], [2, 3], [4, 5], [6, 7]]
    assert [s.measured.tolist() for s in found.subspaces] == [[0, 1], [2, 3], [4, 5], [6, 7]]
    for one in found.subspaces:
        assert one.cosines == pytest.approx(np.ones(2), abs=1e-12)
        assert one.close == "both"
        assert not one.vacuous
    assert found.comac() == pytest.approx(np.ones(2 * STOREYS))
    assert found.ecomac() == pytest.approx(np.zeros(2 * STOREYS), abs=1e-7)
    assert found.figures()["mac_min"] == pytest.approx(1.0)


def test_the_mac_of_single_shapes_is_stated_with_that_of_the_subspace():
    # computed shapes along X and Y, so the single MAC is the square of the cosine of the turn
    found = updyn.correlate(measured(), measured(30.0))
    assert [s.mac for s in found.subspaces] == pytest.approx([1.0] * 4)
    assert [s.mac_single for s in found.subspaces] == pytest.approx([0.75] * 4)
    text = found.table()
    assert text.count("1.000*") == 8
    assert "subspace MAC 1.000, MAC of single shapes at best 0.750" in text
    assert f"within {100 * MODE_PAIRING.close_frequencies:g} % of frequency" in text


def planes(*angles, n=6):
    """Two planes whose principal angles are given, in degrees; as shapes of any scale."""
    cosine, sine = np.cos(np.deg2rad(angles)), np.sin(np.deg2rad(angles))
    a, b = np.zeros((n, 2)), np.zeros((n, 2))
    a[0, 0] = a[1, 1] = 1.0
    b[[0, 2], 0] = cosine[0], sine[0]
    b[[1, 3], 1] = cosine[1], sine[1]
    turn = scipy.linalg.qr(np.random.default_rng(3).standard_normal((n, n)))[0]
    return turn @ a @ [[2.0, 1.0], [0.0, -3.0]], turn @ b @ [[1.0, -0.4], [0.5, 1.0]]


SENSORS = [f"{i}:Z" for i in range(1, 7)]


def test_two_planes_of_known_angles():
    a, b = planes(10.0, 35.0)
    assert principal_cosines(a, b) == pytest.approx(np.cos(np.deg2rad([10.0, 35.0])))
    found = updyn.correlate(
        updyn.ModeSet([20.0, 20.0], a, SENSORS), updyn.ModeSet([20.0, 20.0], b, SENSORS)
    )
    (one,) = found.subspaces
    assert one.cosines == pytest.approx(np.cos(np.deg2rad([10.0, 35.0])))
    assert one.mac == pytest.approx(np.cos(np.deg2rad(35.0)) ** 2)
    assert found.pairs.mac == pytest.approx([one.mac] * 2)


def test_planes_that_share_one_direction_only_give_one_pair():
    a, b = planes(5.0, 80.0)
    found = updyn.correlate(
        updyn.ModeSet([20.0, 20.0], a, SENSORS), updyn.ModeSet([20.1, 20.1], b, SENSORS)
    )
    assert found.pairs.mac == pytest.approx([np.cos(np.deg2rad(5.0)) ** 2])
    assert len(found.unpaired_computed) == len(found.unpaired_measured) == 1
    assert found.subspaces[0].cosines == pytest.approx(np.cos(np.deg2rad([5.0, 80.0])))


def test_cosines_are_those_of_scipy():
    rng = np.random.default_rng(5)
    for n_a, n_b in ((1, 1), (2, 3), (3, 2), (4, 4)):
        a, b = rng.standard_normal((9, n_a)), rng.standard_normal((9, n_b))
        b[:, 0] = a[:, 0] + 0.2 * b[:, 0]
        angles = scipy.linalg.subspace_angles(a, b)
        assert principal_cosines(a, b) == pytest.approx(np.cos(angles)[::-1], abs=1e-12)
        a, b = a + 1j * rng.standard_normal(a.shape), b + 0j
        angles = scipy.linalg.subspace_angles(a, b)
        assert principal_cosines(a, b) == pytest.approx(np.cos(angles)[::-1], abs=1e-12)
    assert principal_cosines(a[:, 0], b[:, 0]) ** 2 == pytest.approx(mac(a[:, 0], b[:, 0])[0])


@given(st.lists(st.floats(0, 360), min_size=4, max_size=4), st.floats(0.0, 1e-4))
def test_turning_shapes_within_clusters_changes_nothing(angles, split):
    """Noisy measured shapes, of which each pair is turned, and computed ones turned otherwise."""
    given_modes = measured(20.0, split, noise=0.03)
    computed = measured()
    one, two = given_modes.shapes.copy(), computed.shapes.copy()
    for k, angle in enumerate(np.deg2rad(angles)):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        one[:, 2 * k : 2 * k + 2] = one[:, 2 * k : 2 * k + 2] @ turn
        two[:, 2 * k : 2 * k + 2] = two[:, 2 * k : 2 * k + 2] @ turn.T
    plain = updyn.correlate(computed, given_modes)
    turned = updyn.correlate(
        updyn.ModeSet(computed.frequency, two, LABELS),
        updyn.ModeSet(given_modes.frequency, one, LABELS),
    )
    assert turned.pairs.mac == pytest.approx(plain.pairs.mac, abs=1e-10)
    assert turned.figures() == pytest.approx(plain.figures(), abs=1e-10)
    for a, b in zip(turned.subspaces, plain.subspaces, strict=True):
        assert a.cosines == pytest.approx(b.cosines, abs=1e-10)
    assert turned.comac() == pytest.approx(plain.comac(), abs=1e-8)


def test_the_value_is_the_lowest_mac_of_a_shape_of_one_span_with_the_other():
    """By search over all shapes of one plane, with the S2MAC formula of D'Ambrogio & Fregolent."""
    found = updyn.correlate(measured(), measured(20.0, noise=0.2))
    one = found.subspaces[2]
    a = found.computed.shapes[:, one.computed].real
    b = found.measured.shapes[:, one.measured].real
    b = scipy.linalg.orth(b)
    p, q = (a / np.linalg.norm(a, axis=0)).T
    lowest = 1.0
    for angle in np.linspace(0, np.pi, 20001):
        shape = b @ [np.cos(angle), np.sin(angle)]
        x, y, z = shape @ p, shape @ q, p @ q
        lowest = min(lowest, (x**2 - 2 * x * y * z + y**2) / (1 - z**2))
    assert one.mac == pytest.approx(lowest, abs=1e-6)
    assert one.mac < 0.95


def test_one_measured_mode_is_compared_with_the_plane_of_two_computed_ones():
    found = updyn.correlate(mast(), measured(30.0, noise=0.02, which=[0, 2, 4, 6]))
    assert len(found.pairs.mac) == len(found.unpaired_computed) == 4
    for one, pair_mac in zip(found.subspaces, found.pairs.mac, strict=True):
        assert (len(one.computed), len(one.measured), one.close) == (2, 1, "computed")
        plane = scipy.linalg.orth(found.computed.shapes[:, one.computed])
        shape = found.measured.shapes[:, one.measured[0]]
        expected = np.linalg.norm(plane.conj().T @ shape) ** 2 / np.linalg.norm(shape) ** 2
        assert pair_mac == one.mac == pytest.approx(expected)
        assert 0.99 < expected < 1.0


def test_a_cluster_in_the_test_that_faces_separate_modes_is_stated():
    """The model bends 6 % stiffer in Y: the spans agree, but the model has no cluster."""
    found = updyn.correlate(mast(in_y=1.06), measured(45.0))
    assert found.pairs.mac == pytest.approx(np.ones(8), abs=1e-12)
    assert np.abs(found.frequency_change).max() == pytest.approx(100 * (np.sqrt(1.06) - 1))
    for one in found.subspaces:
        assert one.close == "measured"
        assert one.mac_single == pytest.approx(0.5)
    spread = f"{100 * (np.sqrt(1.06) - 1):.2g}"
    assert f"only the measured modes are close, the others are {spread} % apart" in found.table()


def test_a_wrong_model_is_not_hidden_by_a_cluster():
    """A plane of other shapes at the same frequency has the MAC of its angles, not 1."""
    wrong = scipy.linalg.eigh(storeys((1.0, 1.0, 1.0, 4.0)))[1]
    right = scipy.linalg.eigh(storeys())[1]
    at = measured(30.0)
    shapes = np.kron(np.eye(2), wrong)[:, [0, 4, 1, 5, 2, 6, 3, 7]]
    found = updyn.correlate(updyn.ModeSet(at.frequency, shapes, LABELS), at)
    single = (wrong[:, 0] @ right[:, 0]) ** 2
    assert single < 0.999
    assert found.subspaces[0].mac == pytest.approx(single)


@pytest.mark.parametrize("gap", [0.0062, 0.02, 0.2])
def test_separate_modes_have_the_mac_of_single_shapes(gap):
    rng = np.random.default_rng(9)
    frequency = 20.0 * (1 + gap) ** np.arange(5)
    A = rng.standard_normal((12, 5))
    B = A + 0.4 * rng.standard_normal((12, 5))
    dofs = [f"{i}:X" for i in range(1, 13)]
    found = updyn.correlate(
        updyn.ModeSet(frequency, A, dofs), updyn.ModeSet(frequency[::-1] * 1.001, B, dofs)
    )
    assert found.subspaces == ()
    assert (found.pairs.mac == found.mac[found.pairs.first, found.pairs.second]).all()
    assert (found.mac == mac(A + 0j, B[:, ::-1] + 0j)).all()
    assert "*" not in found.table()


def test_close_modes_are_as_close_as_stated_and_no_chain():
    step = 0.4 * MODE_PAIRING.close_frequencies
    chain = 20.0 * (1 + step) ** np.arange(7)
    chain[3:] *= 1.0 + 0.1 * step  # the largest gap is between the third and the fourth mode
    clusters = cluster_modes(chain)
    assert np.concatenate(clusters).tolist() == list(range(7))
    for cluster in clusters:
        assert chain[cluster[-1]] <= chain[cluster[0]] * (1 + MODE_PAIRING.close_frequencies)
    assert [0, 1, 2] in [cluster.tolist() for cluster in clusters]
    assert [c.tolist() for c in cluster_modes(np.array([0.0, 0.0, 1.0]))] == [[0, 1], [2]]
    assert [len(c) for c in cluster_modes(np.array([20.0, 20.0 * (1 + 1e-9)]), 0.0)] == [1, 1]


def test_the_limit_of_close_modes_is_where_a_usual_perturbation_leaves_a_mac_of_nine_tenths():
    """Two modes at that gap, coupled by the change of frequency of a structure assembled anew."""
    coupling = 0.0022
    K = np.diag([1.0, (1 + MODE_PAIRING.close_frequencies) ** 2])
    coupled = K + 2 * coupling * np.array([[0.0, 1.0], [1.0, 0.0]])
    left = mac(scipy.linalg.eigh(K)[1], scipy.linalg.eigh(coupled)[1])[0, 0]
    assert left == pytest.approx(0.9, abs=0.005)


def test_errors_of_shapes_are_no_direction_of_a_span():
    """Sensors along X see one shape of both modes of a pair: noise does not make it a plane."""
    at = measured(30.0, noise=0.02)
    found = updyn.correlate(measured(50.0), at, dofs=LABELS[:STOREYS])
    assert [len(one.cosines) for one in found.subspaces] == [1] * STOREYS
    assert len(found.pairs.mac) == 2 * STOREYS
    assert found.pairs.mac.min() > 0.99


def test_a_span_of_all_that_sensors_see_is_stated_to_prove_nothing():
    rng = np.random.default_rng(1)
    a, b = (updyn.ModeSet([9.0, 9.0], rng.standard_normal((2, 2)), ["1:X", "1:Y"]) for _ in "ab")
    found = updyn.correlate(a, b)
    assert found.subspaces[0].vacuous
    assert found.subspaces[0].mac == pytest.approx(1.0)
    assert "1 for any shapes, as there are no more sensors than modes" in found.table()


def test_rotations_count_as_in_mac():
    rng = np.random.default_rng(4)
    A, B = rng.standard_normal((2, 6, 2))
    B = A + 0.3 * B
    dofs = ["1:X", "2:X", "3:X", "1:RZ", "2:RZ", "3:RZ"]
    values = []
    for unit in (1.0, 180 / np.pi):
        scale = np.where(np.arange(6) < 3, 1.0, unit)[:, None]
        a, b = (updyn.ModeSet([10.0, 10.0], C * scale, dofs) for C in (A, B))
        values.append(updyn.correlate(a, b).subspaces[0].cosines)
    assert values[1] == pytest.approx(values[0])
    assert (values[0] < 0.9999).all()


def test_three_modes_of_one_frequency_in_the_test_and_two_of_them_in_the_model():
    """A plane and torsion at one frequency; torsion of the model is elsewhere."""
    basis = scipy.linalg.qr(np.random.default_rng(6).standard_normal((8, 8)))[0][:, :3]
    turn = scipy.linalg.qr(np.random.default_rng(8).standard_normal((3, 3)))[0]
    dofs = [f"{i}:X" for i in range(1, 9)]
    computed = updyn.ModeSet([20.0, 20.0, 23.0], basis, dofs)
    found = updyn.correlate(computed, updyn.ModeSet([20.0, 20.0, 20.0], basis @ turn, dofs))
    (one,) = found.subspaces
    assert one.computed.tolist() == one.measured.tolist() == [0, 1, 2]
    assert one.cosines == pytest.approx(np.ones(3))
    assert len(found.pairs.mac) == 3


def test_the_clusters_of_a_model_are_whole_at_the_edge_of_the_band():
    at = measured(10.0, which=[0, 2, 4])
    found = updyn.correlate(mast(loss=0.0), at)
    assert len(found.computed) == 6
    assert [s.computed.tolist() for s in found.subspaces] == [[0, 1], [2, 3], [4, 5]]
    assert ecomac(found.computed.shapes, found.computed.shapes) == pytest.approx(np.zeros(8))


def test_the_order_of_modes_does_not_matter():
    at = measured(30.0, noise=0.02)
    computed = updyn.modes(mast(), 8)
    order = [5, 0, 3, 7, 2, 1, 6, 4]
    plain, mixed = (updyn.correlate(one, at) for one in (computed, computed.select(order)))
    assert mixed.pairs.mac == pytest.approx(plain.pairs.mac)
    assert sorted(s.mac for s in mixed.subspaces) == pytest.approx(
        sorted(s.mac for s in plain.subspaces)
    )
    for one in mixed.subspaces:
        assert np.ptp(one.frequency_computed) < 1e-6


@pytest.mark.parametrize("close", [-0.1, 1.0, "near", True])
def test_what_is_no_share_is_refused(close):
    with pytest.raises(DataError, match="expected a share of the frequency from 0 to below 1"):
        updyn.correlate(measured(), measured(), close=close)


def test_an_own_limit_of_close_modes():
    at = measured(30.0, split=0.01)
    assert updyn.correlate(measured(), at, close=0.0).subspaces[0].close == "computed"
    apart = updyn.correlate(measured(split=0.01), at)
    assert apart.subspaces == ()
    assert apart.pairs.mac == pytest.approx(np.full(8, 0.75))
    wide = updyn.correlate(measured(split=0.01), at, close=0.02)
    assert wide.pairs.mac == pytest.approx(np.ones(8))
