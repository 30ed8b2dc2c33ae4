"""Derivatives: closed forms, the gear train's Jacobian against 60 digits, agreement of tiers."""

import numpy as np
import pytest

import updyn
from updyn import sensitivity
from updyn.dynamics.affine import AffineSystem
from updyn.dynamics.fields import LineSolver
from updyn.sensitivity import Unknowns


def everything(model):
    return updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")


def test_single_oscillator_by_hand():
    """H = 1/Z, dH/dp = -Z'/Z^2 with Z = kappa k (1 + i gamma) + i omega c C - omega^2 mu m."""
    k, m, c, gamma = 900.0, 1.5, 4.0, 0.07
    model = updyn.Model.from_groups({"o": updyn.Group([[k]], [[m]], gamma, [[c]])}, ["1:X"])
    unknowns = updyn.parameters(
        model, stiffness="all", mass="all", loss_factor="all", viscous="all"
    )
    assert unknowns.names == ["o.mass", "o.stiffness", "o.loss_factor", "o.viscous"]
    solver = LineSolver.choose(AffineSystem.compile(model))
    at = Unknowns.find(solver.system, unknowns)
    freq, values = np.array([0.0, 2.0, 9.0]), np.array([1.2, 0.8, 0.11, 2.5])
    w, one = 2 * np.pi * freq, np.array([0])
    H, dH = sensitivity.receptance(solver, at, values, freq, one, one)
    Z = 0.8 * k * (1 + 0.11j) + 2.5j * w * c - 1.2 * w**2 * m
    slopes = np.array([-(w**2) * m, k * (1 + 0.11j) + 0 * w, 0.8j * k + 0 * w, 1j * w * c])
    assert H[:, 0, 0] == pytest.approx(1 / Z, rel=1e-14)
    assert dH[:, :, 0, 0] == pytest.approx(-slopes / Z**2, rel=1e-14)
    motion = np.full((3, 1, 1), 2.0 + 1j)
    product, d_product = sensitivity.condensed_product(solver, at, values, freq, one, motion)
    assert product[:, 0, 0] == pytest.approx((2 + 1j) * Z, rel=1e-14)
    assert d_product[:, :, 0, 0] == pytest.approx((2 + 1j) * slopes, rel=1e-14)


def test_values_alone_cost_no_derivatives(gear_train):
    solver = LineSolver.choose(AffineSystem.compile(gear_train))
    at = Unknowns.find(solver.system, everything(gear_train))
    freq, rows, columns = np.array([1.0, 3.0]), np.array([0, 2]), np.array([1])
    with_, without = (
        sensitivity.receptance(
            solver, at, everything(gear_train).start, freq, rows, columns, derivatives=d
        )
        for d in (True, False)
    )
    assert without[1] is None
    assert without[0] == pytest.approx(with_[0], rel=1e-12)
    retained, motion = np.arange(4), np.ones((2, 4, 1), dtype=complex)
    with_, without = (
        sensitivity.condensed_product(
            solver, at, everything(gear_train).start, freq, retained, motion, derivatives=d
        )
        for d in (True, False)
    )
    assert without[1] is None
    assert without[0] == pytest.approx(with_[0], rel=1e-12)


@pytest.mark.parametrize("tier", ["dense", "sparse"])
@pytest.mark.parametrize("derivatives", [True, False])
def test_responses_and_references_in_any_order_and_twice(gear_train, tier, derivatives):
    """Each DOF is loaded once; the answer is picked entry by entry from that of all DOFs in order."""
    solver = LineSolver.choose(AffineSystem.compile(gear_train), tier)
    at = Unknowns.find(solver.system, everything(gear_train))
    freq, every = np.array([1.0, 3.0]), np.arange(7)
    H, dH = sensitivity.receptance(solver, at, everything(gear_train).start, freq, every, every)
    for rows, columns in (([5, 2, 5, 0], [3, 2]), ([4, 1], [1]), ([6], [0, 6, 0])):
        some, slopes = sensitivity.receptance(
            solver,
            at,
            everything(gear_train).start,
            freq,
            np.array(rows),
            np.array(columns),
            derivatives=derivatives,
        )
        assert some == pytest.approx(H[:, rows][:, :, columns], rel=1e-9)
        assert (slopes is not None) == derivatives
        if derivatives:
            assert slopes == pytest.approx(
                dH[:, :, rows][..., columns], rel=1e-8, abs=1e-10 * np.abs(dH).max()
            )


@pytest.mark.parametrize("tier", ["dense", "sparse"])
def test_fields_along_directions_are_those_of_central_differences(gear_train, tier):
    unknowns = everything(gear_train)
    solver = LineSolver.choose(AffineSystem.compile(gear_train), tier)
    at = Unknowns.find(solver.system, unknowns)
    freq, columns = np.array([1.0, 3.0, 7.0]), np.array([1, 4])
    rng = np.random.default_rng(4)
    values = unknowns.start * rng.uniform(0.8, 1.2, len(unknowns))
    directions = rng.standard_normal((len(unknowns), 3)) * values[:, None]
    U, dU = sensitivity.fields_along(solver, at, values, freq, columns, directions)

    def fields(at_values):
        c = solver.system.coefficients(at.state(solver.system, at_values), 2 * np.pi * freq)
        return solver.solve(c, columns, freq)

    np.testing.assert_allclose(U, fields(values), rtol=1e-9)
    assert dU.shape == (7, 3, 3, 2)
    for k in range(3):
        step = 1e-5 * directions[:, k]
        differences = (fields(values + step) - fields(values - step)) / 2e-5
        np.testing.assert_allclose(dU[:, :, k], differences, atol=1e-6 * np.abs(differences).max())


@pytest.mark.parametrize("tier", ["dense", "sparse"])
@pytest.mark.parametrize(
    "key", ["4_lines_10_20_50_100", "5_lines_10_20_50_100_150", "8_lines_5_10_20_30_50_75_100_150"]
)
def test_gear_train_singular_values_against_sixty_digits(
    gear_train, gear_train_reference, key, tier
):
    """Of the paper's real-stacked S at the truth, columns scaled to unit norm."""
    omega = np.array([float(w) for w in key.split("lines_")[1].split("_")])
    solver = LineSolver.choose(AffineSystem.compile(gear_train), tier)
    at = Unknowns.find(solver.system, everything(gear_train))
    freq, kept = omega / (2 * np.pi), np.arange(4)
    values = everything(gear_train).start
    H, _ = sensitivity.receptance(solver, at, values, freq, kept, np.array([1]), derivatives=False)
    _, S = sensitivity.condensed_product(solver, at, values, freq, kept, H)
    S = S.reshape(18, -1).T
    S = np.vstack([S.real, S.imag])
    found = np.linalg.svd(S / np.linalg.norm(S, axis=0), compute_uv=False)
    exact = np.array(gear_train_reference["singular_values"][key])
    # Singular values are known to a few roundings of the largest (Weyl); H adds its own, about
    # 1e-13.
    assert found == pytest.approx(exact, abs=2e-12)
    assert found[exact > 1e-3] == pytest.approx(exact[exact > 1e-3], rel=1e-10)


def test_free_free_chain_with_massless_dof():
    """A spring pair with a massless middle: dH/dkappa of the first spring against the series formula."""
    k1, k2, m1, m2 = 500.0, 800.0, 2.0, 3.0
    spring = (
        k1 * np.array([[1.0, -1, 0], [-1, 1, 0], [0, 0, 0]]),
        k2 * np.array([[0, 0, 0], [0, 1.0, -1], [0, -1, 1]]),
    )
    model = updyn.Model.from_groups(
        {
            "a": updyn.Group(spring[0], np.diag([m1, 0, 0])),
            "b": updyn.Group(spring[1], np.diag([0, 0, m2])),
        },
        ["1:X", "2:X", "3:X"],
    )
    solver = LineSolver.choose(AffineSystem.compile(model))
    at = Unknowns.find(solver.system, updyn.parameters(model, stiffness=["a"]))
    freq = np.array([0.7])
    w2 = (2 * np.pi * 0.7) ** 2

    def h31(kappa):
        k = kappa * k1 * k2 / (kappa * k1 + k2)
        return k / ((k - w2 * m1) * (k - w2 * m2) - k**2)

    H, dH = sensitivity.receptance(solver, at, np.ones(1), freq, np.array([2]), np.array([0]))
    assert H[0, 0, 0] == pytest.approx(h31(1.0), rel=1e-12)
    step = 1e-5
    assert dH[0, 0, 0, 0] == pytest.approx((h31(1 + step) - h31(1 - step)) / (2 * step), rel=1e-8)
