"""Pairing of modes and their correlation, against eigenvalues of SciPy and definitions."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import scipy.linalg

import updyn
from updyn.correlation.model_modes import ModelModes
from updyn.dynamics.guyan import reduced_mass
from updyn.errors import DataError, DofError
from updyn.modal import ModeSet

N = 6


def matrices(k=(3e4, 2e4, 2.5e4, 3e4, 1e4, 2e4), m=(1.0, 2.0, 1.5, 1.0, 2.5, 1.2)):
    """A chain from the ground: stiffness in N/m and mass in kg."""
    K = np.diag(np.append(np.add(k[:-1], k[1:]), k[-1])) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    return K, np.diag(m)


def model(K, M, loss=0.0):
    n = len(K)
    group = updyn.Group(K, M, loss_factor=loss)
    return updyn.Model.from_groups({"all": group}, [f"{i + 1}:Z" for i in range(n)])


def truth(K, M):
    """Frequencies in Hz and shapes by SciPy."""
    value, shapes = scipy.linalg.eigh(K, M)
    return np.sqrt(value) / (2 * np.pi), shapes


def mac_of(a, b):
    return abs(np.vdot(a, b)) ** 2 / (np.vdot(a, a).real * np.vdot(b, b).real)


def test_a_model_against_modes_of_scipy():
    K, M = matrices()
    f, shapes = truth(K, M)
    at = [4, 0, 2, 3]
    seen = shapes[at] * np.array([1, -1, 1, 1])[:, None] * np.exp(1j * np.arange(N))
    measured = updyn.ModeSet(f[:4], seen[:, :4], ["5:Z", "1:-Z", "3:Z", "4:Z"], [0.02] * 4)
    found = updyn.correlate(model(K, M), measured)
    assert found.pairs.first.tolist() == found.pairs.second.tolist() == [0, 1, 2, 3]
    assert found.pairs.mac == pytest.approx(np.ones(4))
    assert found.frequency_change == pytest.approx(np.zeros(4), abs=1e-6)
    expected = [[mac_of(shapes[at, i], shapes[at, j]) for j in range(4)] for i in range(4)]
    assert found.mac == pytest.approx(np.array(expected), abs=1e-9)
    assert found.auto_mac == pytest.approx(np.array(expected), abs=1e-9)
    assert found.comac() == pytest.approx(np.ones(4))
    assert found.ecomac() == pytest.approx(np.zeros(4), abs=1e-6)
    assert len(found.unpaired_computed) == len(found.unpaired_measured) == 0


def test_change_of_frequency_and_figures():
    K, M = matrices()
    f, shapes = truth(K, M)
    measured = updyn.ModeSet(f, shapes, [f"{i + 1}:Z" for i in range(N)])
    found = updyn.correlate(model(1.1 * K, M), measured)
    assert found.frequency_change == pytest.approx(np.full(N, 100 * (np.sqrt(1.1) - 1)))
    figures = found.figures()
    assert figures["frequency_change_max"] == pytest.approx(100 * (np.sqrt(1.1) - 1))
    assert figures["pairs"] == N
    assert figures["mac_min"] == pytest.approx(1.0)
    assert f"{f[0]:#.5g}" in found.table()


def test_modes_in_swapped_order_are_paired_by_shape():
    f = np.array([10.0, 10.6, 30.0])
    shapes = scipy.linalg.qr(np.random.default_rng(2).standard_normal((5, 3)), mode="economic")[0]
    dofs = ["1:X", "2:X", "3:X", "4:X", "5:X"]
    first = updyn.ModeSet(f, shapes, dofs)
    swapped = updyn.ModeSet(f, shapes[:, [1, 0, 2]], dofs)
    found = updyn.correlate(first, swapped)
    assert found.pairs.first.tolist() == [1, 0, 2]
    assert found.pairs.second.tolist() == [0, 1, 2]
    assert found.frequency_change == pytest.approx([6.0, 100 * (10 / 10.6 - 1), 0.0])


def test_sensors_that_cannot_tell_shapes_apart_leave_it_to_frequency():
    alike = np.ones((1, 3))
    a = updyn.ModeSet([10.0, 20.0, 40.0], alike, ["1:Z"])
    b = updyn.ModeSet([11.0, 19.0, 41.0], alike, ["1:-Z"])
    assert updyn.correlate(a, b).pairs.first.tolist() == [0, 1, 2]


def test_a_mode_that_one_set_lacks_is_unpaired():
    K, M = matrices()
    f, shapes = truth(K, M)
    dofs = [f"{i + 1}:Z" for i in range(N)]
    gap = np.delete(np.arange(N), 2)
    measured = updyn.ModeSet(f[gap], shapes[:, gap], dofs)
    found = updyn.correlate(model(K, M), measured)
    assert found.unpaired_computed.tolist() == [2]
    assert found.pairs.first.tolist() == gap.tolist()
    other = updyn.correlate(measured, updyn.ModeSet(f, shapes, dofs))
    assert other.unpaired_measured.tolist() == [2]
    assert len(other.table().splitlines()) == 1 + N


def test_a_foreign_shape_is_no_pair_whatever_its_frequency():
    K, M = matrices()
    f, shapes = truth(K, M)
    dofs = [f"{i + 1}:Z" for i in range(N)]
    measured = updyn.ModeSet(f[:2], shapes[:, [0, 5]], dofs)
    found = updyn.correlate(model(K, M), measured)
    assert found.unpaired_measured.tolist() == [1]
    # ... and neither is an equal shape at a far frequency
    far = updyn.ModeSet(f[:2] * [1.0, 1.8], shapes[:, :2], dofs)
    assert updyn.correlate(updyn.ModeSet(f[:2], shapes[:, :2], dofs), far).unpaired_measured == [1]
    wide = updyn.correlate(updyn.ModeSet(f[:2], shapes[:, :2], dofs), far, gate=1.0)
    assert len(wide.unpaired_measured) == 0


def test_the_pairs_are_the_best_of_all_assignments():
    rng = np.random.default_rng(8)
    for _ in range(20):
        A, B = rng.standard_normal((3, 4)), rng.standard_normal((3, 4))
        dofs = ["1:X", "1:Y", "1:Z"]
        found = updyn.correlate(
            updyn.ModeSet([10, 11, 12, 13], A, dofs), updyn.ModeSet([10, 11, 12, 13], B, dofs)
        )
        score = np.zeros((4, 4))
        for i, j in itertools.product(range(4), range(4)):
            value, f, g = mac_of(A[:, i], B[:, j]), 10.0 + i, 10.0 + j
            of_pair = value - 0.4 * ((f - g) / (0.3 * min(f, g))) ** 2
            if of_pair >= 0.5 and abs(f - g) <= 0.3 * min(f, g):
                score[i, j] = of_pair
        best = max(
            sum(score[i, j] for i, j in enumerate(order))
            for order in itertools.permutations(range(4))
        )
        assert score[found.pairs.first, found.pairs.second].sum() == pytest.approx(best)
        assert len(set(found.pairs.first)) == len(found.pairs.first)


def test_modes_of_the_model_in_the_band_are_listed_and_no_others():
    K, M = matrices()
    f, shapes = truth(K, M)
    dofs = [f"{i + 1}:Z" for i in range(N)]
    measured = updyn.ModeSet(f[2:4], shapes[:, 2:4], dofs)
    assert updyn.correlate(model(K, M), measured).computed.frequency == pytest.approx(f[2:4])
    band = (0.9 * f[1], 1.1 * f[3])
    found = updyn.correlate(model(K, M), measured, band=band)
    assert found.computed.frequency == pytest.approx(f[(f > band[0]) & (f < band[1])])


def test_rigid_body_modes_and_modes_at_rest_are_left_out():
    k = 1e4
    K = np.array([[k, -k, 0.0], [-k, k, 0.0], [0.0, 0.0, 2 * k]])  # free; the third by itself
    frequencies = ModelModes(model(K, np.eye(3))).damped(1e3).frequency
    assert frequencies == pytest.approx([np.sqrt(2 * k) / (2 * np.pi)] * 2)
    measured = updyn.ModeSet([22.0], [[1.0], [-1.0]], ["1:Z", "2:Z"])
    found = updyn.correlate(model(K, np.eye(3)), measured, band=(1.0, 50.0))
    assert len(found.computed) == 1
    assert found.pairs.mac == pytest.approx([1.0])


def test_a_damped_model_has_the_damping_of_its_poles():
    K, M = matrices()
    groups = {
        "a": updyn.Group(0.4 * K, M, loss_factor=0.1),
        "b": updyn.Group(np.diag(np.diag(K)) * 0.6, loss_factor=0.01),
    }
    damped = updyn.Model.from_groups(groups, [f"{i + 1}:Z" for i in range(N)])
    whole = 0.4 * (1 + 0.1j) * K + 0.6 * (1 + 0.01j) * np.diag(np.diag(K))
    value = np.sort_complex(scipy.linalg.eigvals(whole, M))
    found = ModelModes(damped).damped(1e6)
    assert found.frequency == pytest.approx(np.sqrt(value.real) / (2 * np.pi))
    assert found.loss_factor == pytest.approx(value.imag / value.real)


def test_modes_identified_from_the_responses_of_a_model_are_its_own():
    K, M = matrices()
    structure = model(K, M, loss=0.02)
    f = truth(K, M)[0]
    lines = np.linspace(0.5 * f[0], 1.2 * f[-1], 800)
    frf = updyn.response(structure, lines, ["1:-Z", "3:Z", "4:Z", "6:Z"], ["3:Z"], "accelerance")
    found = updyn.correlate(structure, updyn.identify_modes(frf))
    assert len(found.pairs.mac) == N
    assert found.pairs.mac == pytest.approx(np.ones(N), abs=1e-6)
    assert found.frequency_change == pytest.approx(np.zeros(N), abs=1e-4)
    assert found.measured.loss_factor == pytest.approx(np.full(N, 0.02), rel=1e-4)


def test_cross_orthogonality_with_all_dofs_is_that_of_the_mass():
    K, M = matrices()
    f, shapes = truth(K, M)
    dofs = [f"{i + 1}:Z" for i in range(N)]
    found = updyn.correlate(model(K, M), updyn.ModeSet(f, shapes, dofs))
    mass = reduced_mass(model(K, M), dofs)
    assert mass == pytest.approx(M)
    assert np.abs(found.cross_orthogonality(mass)) == pytest.approx(np.eye(N), abs=1e-7)


def test_the_reduced_mass_is_that_of_guyan():
    K, M = matrices()
    T = np.zeros((N, 2))
    T[[4, 1], [0, 1]] = -1.0, 1.0  # 5:-Z and 2:Z
    rest = [0, 2, 3, 5]
    T[rest] = -np.linalg.solve(K[np.ix_(rest, rest)], K[np.ix_(rest, [4, 1])] * [-1.0, 1.0])
    assert reduced_mass(model(K, M), ["5:-Z", "2:Z"]) == pytest.approx(T.T @ M @ T)


def test_a_mass_cannot_be_reduced_to_dofs_that_leave_a_mechanism():
    K = np.diag([1e4, 0.0])
    with pytest.raises(updyn.UpdynError, match="can still move without stiffness"):
        reduced_mass(model(K, np.eye(2)), ["1:Z"])


def test_what_cannot_be_compared_is_refused():
    K, M = matrices()
    f, shapes = truth(K, M)
    dofs = [f"{i + 1}:Z" for i in range(N)]
    modes = updyn.ModeSet(f, shapes, dofs)
    frf = updyn.response(model(K, M), [5.0], ["1:Z"], ["1:Z"])
    with pytest.raises(DataError, match="expected a Model or modes, found FRF"):
        updyn.correlate(frf, modes)
    with pytest.raises(DataError, match="expected a measured FRF, found Model"):
        updyn.correlate(modes, model(K, M))
    with pytest.raises(DataError, match="gate is an option for modes"):
        updyn.correlate(model(K, M), frf, gate=0.2)
    with pytest.raises(DataError, match="least_mac"):
        updyn.correlate(modes, modes, last_mac=0.2)
    with pytest.raises(DataError, match="expected a gate above 0"):
        updyn.correlate(modes, modes, gate=0.0)
    elsewhere = updyn.ModeSet(f, shapes, [f"{i + 2}:Z" for i in range(N)])
    with pytest.raises(DofError, match="7:Z is not among the 6 DOFs"):
        updyn.correlate(modes, elsewhere)
    found = updyn.correlate(modes, elsewhere, dofs=["2:Z", "4:Z"])
    assert found.dofs.labels == ["2:Z", "4:Z"]


def test_without_a_pair_figures_are_not_known():
    a = updyn.ModeSet([10.0], [[1.0], [0.0]], ["1:Z", "2:Z"])
    b = updyn.ModeSet([10.0], [[0.0], [1.0]], ["1:Z", "2:Z"])
    found = updyn.correlate(a, b)
    assert np.isnan(found.figures()["mac_median"])
    assert np.isnan(found.comac()).all()
    assert len(found.table().splitlines()) == 3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"band": (20.0, 1.0)}, "band 20 to 1 Hz: the first must be below the second"),
        ({"band": "20 to 1"}, "band: expected real numbers"),
        ({"gate": "wide"}, "gate = 'wide', least_mac = 0.5; expected a gate above 0"),
        ({"band": (1e3, 2e3)}, "no mode from 1000 to 2000 Hz that moves at the DOFs of the meas"),
    ],
)
def test_what_is_no_band_or_has_no_mode_is_refused(chain12, options, message):
    measured = updyn.ModeSet([900.0], np.ones((2, 1)), ["2:X", "5:X"])
    with pytest.raises(DataError, match=message):
        updyn.correlate(chain12, measured, **options)


def test_a_model_at_rest_at_the_sensors_is_refused(chain12):
    def beside(stiffness):
        """The chain, and 1 kg on a spring of its own."""
        groups = {}
        for name, group in chain12.groups.items():
            K, M = (np.pad(A.toarray(), (0, 1)) for A in (group.stiffness, group.mass))
            groups[name] = updyn.Group(K, M)
        only = np.diag([0.0] * 12 + [1.0])
        groups["beside"] = updyn.Group(stiffness * only, only)
        return updyn.Model.from_groups(groups, [*chain12.dofs.labels, "99:Y"])

    measured = updyn.ModeSet([5.0], [[1.0]], ["99:Y"])
    found = updyn.correlate(beside((2 * np.pi * 5.0) ** 2), measured)
    assert found.computed.frequency[found.pairs.first] == pytest.approx([5.0])
    with pytest.raises(DataError, match=r"none of the 2 modes of the model up to .* Hz moves at"):
        updyn.correlate(beside((2 * np.pi * 500.0) ** 2), measured)


def test_the_unit_of_rotations_does_not_matter():
    rng = np.random.default_rng(4)
    A, B = rng.standard_normal((2, 4, 3))
    B = A + 0.3 * B
    dofs = ["1:X", "2:X", "1:RZ", "2:RZ"]

    def found(unit):
        scale = np.array([1.0, 1.0, unit, unit])[:, None]
        a = updyn.ModeSet([10, 20, 30], A * scale, dofs)
        return updyn.correlate(a, updyn.ModeSet([10, 20, 30], B * scale, dofs))

    radians, degrees = found(1.0), found(180 / np.pi)
    assert degrees.mac == pytest.approx(radians.mac)
    assert degrees.auto_mac == pytest.approx(radians.auto_mac)
    assert degrees.comac() == pytest.approx(radians.comac())
    # translations count as they stand: of them alone it is the plain MAC
    alone = updyn.correlate(
        updyn.ModeSet([10, 20, 30], A, dofs), updyn.ModeSet([10, 20, 30], B, dofs), dofs=dofs[:2]
    )
    assert alone.mac[0, 1] == pytest.approx(mac_of(A[:2, 0], B[:2, 1]))


def test_modes_without_shapes_are_paired_in_the_order_of_frequencies() -> None:
    """Within the gate, as many as there are; MAC is not known."""
    computed = ModeSet([8.0, 12.0, 18.0, 31.0], np.eye(4), ["1:X", "2:X", "3:X", "4:X"])
    found = updyn.correlate(computed, ModeSet([9.0, 11.0, 17.0]))
    assert found.pairs.first.tolist() == [0, 1, 2]
    assert found.pairs.second.tolist() == [0, 1, 2]
    assert np.isnan(found.pairs.mac).all()
    assert np.isnan(found.mac).all()
    assert found.mac.shape == (4, 3)
    assert found.frequency_change == pytest.approx([-100 / 9, 100 / 11, 100 / 17])
    assert "paired in the order of their frequencies" in found.table()
    far = updyn.correlate(computed, ModeSet([20.0, 100.0]))
    assert far.pairs.second.tolist() == [0]
    assert far.unpaired_measured.tolist() == [1]


def test_crossing_pairs_of_equal_sum_are_not_taken() -> None:
    """|ln| of both pairings of 12 and 13 with 10 and 11 Hz have one sum; squares do not."""
    computed = ModeSet([12.0, 13.0], np.eye(2), ["1:X", "2:X"])
    found = updyn.correlate(computed, ModeSet([10.0, 11.0]), gate=0.4)
    assert found.pairs.first.tolist() == [0, 1]
