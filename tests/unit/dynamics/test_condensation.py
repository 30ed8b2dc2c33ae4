"""Exact dynamic condensation: the gear train against 60 digits, and by hand."""

import numpy as np
import pytest

import updyn
from updyn.errors import DataError, DofError

KEPT = [f"{i}:RZ" for i in range(1, 5)]


@pytest.mark.parametrize("tier", ["dense", "sparse"])
def test_gear_train_at_50_rad_s_against_sixty_digits(gear_train, gear_train_reference, tier):
    (key,) = [k for k in gear_train_reference if k.lower().startswith("z_red")]
    exact = np.array([[complex(*c) for c in row] for row in gear_train_reference[key]])
    found = updyn.condense(gear_train, [50.0 / (2 * np.pi)], KEPT, tier=tier).Z[0]
    assert np.abs(found - exact).max() < 1e-12 * np.abs(exact).max()
    large = np.abs(exact) > 1e-30  # the others are zero in exact arithmetic
    assert found[large] == pytest.approx(exact[large], rel=1e-12)


@pytest.mark.parametrize("tier", ["dense", "sparse"])
def test_transformation_reproduces_z_red_and_motion(gear_train, tier):
    """Z_red = T^T Z T, and T maps the retained motion of any receptance column onto all DOFs."""
    freq = np.array([1.0, 8.0])
    kept = ["4:RZ", "2:-RZ", "1:RZ"]
    c = updyn.condense(gear_train, freq, kept, tier=tier)
    every = [f"{i}:RZ" for i in range(1, 8)]
    h = updyn.response(gear_train, freq, every, ["2:-RZ"]).values[:, :, 0]
    signs, at = np.array([1, -1, 1]), [3, 1, 0]
    for i in range(2):
        K, M = gear_train.stiffness.toarray(), gear_train.mass.toarray()
        D = sum(g.loss_factor * g.stiffness.toarray() for g in gear_train.groups.values())
        Z = K + 1j * D - (2 * np.pi * freq[i]) ** 2 * M
        assert c.T[i].T @ Z @ c.T[i] == pytest.approx(c.Z[i], abs=1e-9 * np.abs(c.Z[i]).max())
        assert c.T[i] @ (signs * h[i, at]) == pytest.approx(h[i], abs=1e-10 * np.abs(h[i]).max())
        # The force stands on the second retained DOF, in its sense.
        assert c.Z[i] @ (signs * h[i, at]) == pytest.approx([0, 1, 0], abs=1e-8)


def test_all_dofs_retained_is_the_dynamic_stiffness():
    group = updyn.Group([[3.0, -1.0], [-1.0, 2.0]], np.eye(2), loss_factor=0.1)
    model = updyn.Model.from_groups({"g": group}, ["1:X", "2:X"])
    for tier in ("dense", "sparse"):
        Z = updyn.condense(model, [1 / (2 * np.pi)], ["2:X", "1:-X"], tier=tier).Z[0]
        assert (
            pytest.approx(
                np.array([[2 * (1 + 0.1j) - 1, 1 + 0.1j], [1 + 0.1j, 3 * (1 + 0.1j) - 1]]),
                rel=1e-14,
            )
            == Z
        )


def test_static_condensation_of_two_springs_in_series():
    """At 0 Hz the inner DOF of two springs k1, k2 in series leaves k1 k2 / (k1 + k2)."""
    K = np.array([[300.0 + 200.0, -200.0], [-200.0, 200.0]])
    model = updyn.Model.from_groups({"g": updyn.Group(K, np.diag([5.0, 1.0]))}, ["1:X", "2:X"])
    assert updyn.condense(model, [0.0], ["2:X"]).Z[0, 0, 0] == pytest.approx(
        300.0 * 200.0 / 500.0, rel=1e-14
    )


@pytest.mark.parametrize("tier", ["dense", "sparse"])
def test_where_nothing_damps_the_answer_is_real(tier):
    """Z_nn - Z_ns Z_ss^-1 Z_sn of full matrices, beside a group of few entries, in real numbers."""
    A = np.random.default_rng(2).standard_normal((2, 9, 9))
    K, M = (B @ B.T for B in A)
    spring = np.zeros((9, 9))
    spring[0, 0] = 40.0
    groups = {"full": updyn.Group(1e3 * K, M), "spring": updyn.Group(spring)}
    model = updyn.Model.from_groups(groups, [f"{i}:X" for i in range(1, 10)])
    freq = np.array([0.5, 3.0])
    found = updyn.condense(model, freq, ["7:X", "2:X"], tier=tier)
    kept, rest = np.array([6, 1]), np.array([0, 2, 3, 4, 5, 7, 8])
    for Z_red, f in zip(found.Z, freq, strict=True):
        Z = 1e3 * K + spring - (2 * np.pi * f) ** 2 * M
        inner = np.linalg.solve(Z[np.ix_(rest, rest)], Z[np.ix_(rest, kept)])
        expected = Z[np.ix_(kept, kept)] - Z[np.ix_(kept, rest)] @ inner
        assert Z_red == pytest.approx(expected, rel=1e-9)
    assert found.Z.dtype == found.T.dtype == np.complex128
    assert not found.Z.imag.any()


def test_refusals(gear_train):
    with pytest.raises(DofError, match="retained DOF 8:RZ is not among"):
        updyn.condense(gear_train, [1.0], ["8:RZ"])
    with pytest.raises(DataError, match="line 1 is not finite"):
        updyn.condense(gear_train, [np.inf], KEPT)
