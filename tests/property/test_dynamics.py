"""Random structures: condensation is exact, receptances are reciprocal, derivatives are derivatives, tiers agree."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import updyn
from updyn import sensitivity
from updyn.dynamics import fields
from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.fields import LineSolver
from updyn.sensitivity import Unknowns

DIRECTIONS = ["X", "Y", "Z", "RX", "RY", "RZ"]


def chain_groups(rng, n, massless, free):
    """Springs between neighbours, masses on all DOFs or on all but some; two groups, the second from the middle on."""
    K, M = np.zeros((2, n, n)), np.zeros((2, n, n))
    for i in range(n - 1):
        g = int(i >= n // 2)
        K[g, i : i + 2, i : i + 2] += 10 ** rng.uniform(3, 5) * np.array([[1, -1], [-1, 1]])
    for i in range(n):
        M[int(i >= n // 2), i, i] = rng.uniform(0.5, 3.0)
    if massless:
        M[:, n // 2, n // 2] = 0.0
    if not free:
        K[0, 0, 0] += 10 ** rng.uniform(3, 5)
    return K, M


def full_groups(rng, n, massless, free):
    """Two overlapping groups with full matrices, positive definite or with a rigid mode."""
    K, M = np.zeros((2, n, n)), np.zeros((2, n, n))
    for g, own in enumerate((np.arange(n // 2 + 1), np.arange(n // 2, n))):
        at, k = np.ix_(own, own), len(own)
        A, B = rng.standard_normal((k, k)), rng.standard_normal((k, k))
        P = np.eye(k) - (1.0 / k if free else 0.0)
        K[g][at] = 1e4 * P @ (A @ A.T + 0.1 * np.eye(k)) @ P
        M[g][at] = 0.1 * B @ B.T + np.eye(k)
    if massless:
        M[:, n // 2, :] = M[:, :, n // 2] = 0.0
    return (K + K.transpose(0, 2, 1)) / 2, (M + M.transpose(0, 2, 1)) / 2


@st.composite
def structures(draw):
    """A model with damping of both kinds, lines, and a split of its DOFs; free-free ones have no line at rest."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n, free = draw(st.integers(3, 9)), draw(st.booleans())
    make = draw(st.sampled_from([chain_groups, full_groups]))
    K, M = make(rng, n, draw(st.booleans()), free)
    C = np.zeros((n, n))
    C[0, 0] = rng.uniform(1.0, 5.0)
    groups = {
        "a": updyn.Group(K[0], M[0], loss_factor=rng.uniform(0.005, 0.1), viscous=C),
        "b": updyn.Group(K[1], M[1], loss_factor=rng.uniform(0.005, 0.1)),
    }
    labels = [f"{i // 6 + 1}:{DIRECTIONS[i % 6]}" for i in range(n)]
    freq = np.sort(rng.uniform(0.5, 60.0, 4))
    if not free:
        freq[0] = 0.0
    order = rng.permutation(n)
    retained = order[: draw(st.integers(1, n))]
    return updyn.Model.from_groups(groups, labels), freq, retained


def labels(model, at):
    return [model.dofs.labels[i] for i in at]


@settings(max_examples=40)
@given(structures(), st.sampled_from(fields.EXACT_TIERS))
def test_condensed_frf_equals_full_frf_and_is_reciprocal(structure, tier):
    model, freq, retained = structure
    kept = labels(model, retained)
    Z = updyn.condense(model, freq, kept, tier=tier).Z
    H = updyn.response(model, freq, kept, kept, tier=tier).values
    for z, h in zip(Z, H, strict=True):
        scale = np.sqrt(np.abs(np.diag(h)))
        assert np.linalg.solve(z, np.eye(len(z))) == pytest.approx(
            h, rel=1e-7, abs=1e-7 * scale.max() ** 2
        )
        assert h == pytest.approx(h.T, rel=1e-9, abs=1e-10 * scale.max() ** 2)
        assert z == pytest.approx(z.T, rel=1e-9, abs=1e-10 * np.abs(z).max())


@settings(max_examples=30)
@given(structures())
def test_dense_and_sparse_agree(structure):
    model, freq, retained = structure
    every = model.dofs.labels
    H = [
        updyn.response(model, freq, every, labels(model, retained), tier=t).values
        for t in fields.EXACT_TIERS
    ]
    assert H[0] == pytest.approx(H[1], rel=1e-7, abs=1e-9 * np.abs(H[1]).max())
    c = [updyn.condense(model, freq, labels(model, retained), tier=t) for t in fields.EXACT_TIERS]
    assert pytest.approx(c[1].Z, rel=1e-7, abs=1e-9 * np.abs(c[1].Z).max()) == c[0].Z
    assert pytest.approx(c[1].T, rel=1e-7, abs=1e-9 * np.abs(c[1].T).max()) == c[0].T


@settings(max_examples=30)
@given(structures(), st.integers(0, 2**32 - 1))
def test_dynamic_stiffness_is_affine_in_each_coefficient(structure, seed):
    """Z at the middle of two states that differ in factors only (or in loss factors only) is the mean of theirs."""
    model, freq, _ = structure
    system, rng = AffineSystem.compile(model), np.random.default_rng(seed)
    omega, n = 2 * np.pi * freq, len(system.terms)
    loss, rate = system.start.loss, system.start.rate
    one, two = (State(rng.uniform(0.5, 2.0, n), loss, rate) for _ in range(2))
    middle = State((one.factor + two.factor) / 2, loss, rate)
    Z = [system.values(system.coefficients(s, omega)) for s in (one, two, middle)]
    assert (Z[0] + Z[1]) / 2 == pytest.approx(Z[2], rel=1e-12, abs=1e-12 * np.abs(Z[2]).max())
    three = State(one.factor, loss * rng.uniform(0.0, 3.0, n), rate)
    middle = State(one.factor, (loss + three.loss) / 2, rate)
    Z = [system.values(system.coefficients(s, omega)) for s in (one, three, middle)]
    assert (Z[0] + Z[1]) / 2 == pytest.approx(Z[2], rel=1e-12, abs=1e-12 * np.abs(Z[2]).max())


@settings(max_examples=30)
@given(structures(), st.sampled_from(fields.EXACT_TIERS), st.integers(0, 2**32 - 1))
def test_derivatives_equal_central_differences(structure, tier, seed):
    """Of the receptance and of Z_red h, for unknowns of every kind, off the start."""
    model, freq, retained = structure
    rng = np.random.default_rng(seed)
    unknowns = updyn.parameters(
        model, stiffness="all", mass="all", loss_factor="all", viscous="all"
    )
    solver = LineSolver.choose(AffineSystem.compile(model), tier)
    at = Unknowns.find(solver.system, unknowns)
    values = np.where(
        unknowns.is_factor,
        rng.uniform(0.7, 1.4, len(unknowns)),
        rng.uniform(0.02, 0.1, len(unknowns)),
    )
    rows, columns = retained, rng.permutation(model.n_dofs)[:2]
    motion = rng.standard_normal((4, len(rows), 2)) + 1j * rng.standard_normal((4, len(rows), 2))

    def both(v, derivatives=False):
        H = sensitivity.receptance(solver, at, v, freq, rows, columns, derivatives=derivatives)
        P = sensitivity.condensed_product(
            solver, at, v, freq, retained, motion, derivatives=derivatives
        )
        return H, P

    (H, dH), (P, dP) = both(values, derivatives=True)
    # Differences are good only away from resonances: skip what is sharper than the step can follow.
    assume(np.abs(dH).max() < 1e4 * np.abs(H).max())
    assume(np.abs(dP).max() < 1e4 * np.abs(P).max())
    for i in range(len(unknowns)):
        step = 3e-5 * np.eye(len(unknowns))[i]
        sides = [both(values + s * step) for s in (2, 1, -1, -2)]
        for exact, level, k in ((dH[i], H, 0), (dP[i], P, 1)):
            f = [side[k][0] for side in sides]
            difference = (-f[0] + 8 * f[1] - 8 * f[2] + f[3]) / (12 * 3e-5)
            assert exact == pytest.approx(
                difference, rel=1e-4, abs=1e-6 * np.abs(exact).max() + 1e-8 * np.abs(level).max()
            )


@settings(max_examples=20)
@given(structures(), st.integers(1, 3))
def test_blocks_of_lines_change_nothing(structure, lines_a_block):
    model, freq, retained = structure
    kept = labels(model, retained)
    H, c = updyn.response(model, freq, kept, kept).values, updyn.condense(model, freq, kept)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(LineSolver, "block_size", lambda self, n: lines_a_block)
        assert updyn.response(model, freq, kept, kept).values == pytest.approx(H, rel=1e-12)
        assert pytest.approx(c.Z, rel=1e-12) == updyn.condense(model, freq, kept).Z


@settings(max_examples=20)
@given(structures(), st.integers(0, 2**32 - 1))
def test_signs_of_sensors_flip_values(structure, seed):
    model, freq, retained = structure
    rng = np.random.default_rng(seed)
    plus = labels(model, retained)
    signs = rng.choice([-1, 1], len(plus))
    turned = [p if s > 0 else p.replace(":", ":-") for p, s in zip(plus, signs, strict=True)]
    H = updyn.response(model, freq, plus, plus).values
    flipped = updyn.response(model, freq, turned, plus).values
    assert flipped == pytest.approx(signs[:, None] * H, rel=1e-12)
    Z, Z_turned = updyn.condense(model, freq, plus), updyn.condense(model, freq, turned)
    assert pytest.approx(signs[:, None] * Z.Z * signs, rel=1e-12) == Z_turned.Z
    assert pytest.approx(Z.T * signs, rel=1e-12) == Z_turned.T
