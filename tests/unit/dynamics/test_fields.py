"""Solving at lines: tiers agree, blocks do not matter, singular lines are named."""

from types import SimpleNamespace

import numpy as np
import pytest

import updyn
from overriding import override
from updyn.dynamics import fields
from updyn.dynamics.affine import AffineSystem
from updyn.dynamics.fields import LineSolver, split_into_blocks
from updyn.dynamics.settings import LINE_SOLVER
from updyn.errors import OptionError, SolverError


def chain(n, *, free=False, loss=0.02, seed=0):
    """n masses in a row, random springs; free: not tied to ground."""
    rng = np.random.default_rng(seed)
    k = rng.uniform(1e3, 1e5, n)
    K = np.zeros((n, n))
    for i in range(n - 1):
        K[i : i + 2, i : i + 2] += k[i] * np.array([[1, -1], [-1, 1]])
    if not free:
        K[0, 0] += k[-1]
    group = updyn.Group(K, np.diag(rng.uniform(1, 2, n)), loss_factor=loss)
    return updyn.Model.from_groups({"chain": group}, [f"{i + 1}:X" for i in range(n)])


def test_blocks_cover_all_lines_in_order():
    assert [list(range(7))[b] for b in split_into_blocks(7, 3)] == [[0, 1, 2], [3, 4, 5], [6]]
    assert list(split_into_blocks(2, 100)) == [slice(0, 2)]


def test_tier_by_size_and_by_force():
    small = AffineSystem.compile(chain(5))
    assert LineSolver.choose(small).tier == "dense"
    assert LineSolver.choose(small, "sparse").tier == "sparse"
    assert LineSolver.choose(AffineSystem.compile(chain(LINE_SOLVER.dense_dofs))).tier == "dense"
    assert (
        LineSolver.choose(AffineSystem.compile(chain(LINE_SOLVER.dense_dofs + 1))).tier == "sparse"
    )
    with pytest.raises(OptionError, match=r"tier 'spares': .*sparse"):
        LineSolver.choose(small, "spares")
    with pytest.raises(OptionError, match="backend 'mumps'"):
        LineSolver.choose(small, "sparse", "mumps")


@pytest.mark.parametrize(("share", "tier"), [(0.7, "dense"), (0.5, "sparse")])
def test_tier_by_fill(share, tier):
    """A full block of 70 % of the DOFs fills half of the matrix, one of 50 % a quarter."""
    n = LINE_SOLVER.dense_dofs + 50
    K = np.eye(n)
    K[: int(share * n), : int(share * n)] += 1.0
    system = AffineSystem.compile(
        updyn.Model.from_groups({"g": updyn.Group(K)}, [f"{i + 1}:X" for i in range(n)])
    )
    assert LineSolver.choose(system).tier == tier


@pytest.mark.parametrize(
    ("n", "fill", "tier"),
    [
        (150, 0.01, "dense"),
        (151, 0.01, "sparse"),
        (2000, 0.31, "dense"),
        (2000, 0.29, "sparse"),
        (2001, 1.0, "sparse"),
    ],
)
def test_limits_of_dense_models(n, fill, tier):
    system = SimpleNamespace(n=n, indices=range(int(fill * n**2)))
    assert LineSolver.choose(system).tier == tier


def full(n):
    """Masses that are all tied to each other."""
    A = np.random.default_rng(3).standard_normal((n, n))
    return updyn.Model.from_groups(
        {"g": updyn.Group(1e4 * A @ A.T, np.eye(n), loss_factor=0.02)},
        [f"{i + 1}:X" for i in range(n)],
    )


@pytest.mark.parametrize("tier", fields.EXACT_TIERS)
@pytest.mark.parametrize("make", [chain, full])
def test_solve_against_the_full_inverse(make, tier):
    model, freq = make(9), np.array([0.0, 3.0, 40.0])
    solver = LineSolver.choose(AffineSystem.compile(model), tier)
    omega = 2 * np.pi * freq
    X = solver.solve(solver.system.coefficients(solver.system.start, omega), np.array([4, 0]), freq)
    assert X.shape == (9, 3, 2)
    K, M, D = model.stiffness.toarray(), model.mass.toarray(), 0.02 * model.stiffness.toarray()
    for i, w in enumerate(omega):
        assert X[:, i] == pytest.approx(
            np.linalg.solve(K + 1j * D - w**2 * M, np.eye(9)[:, [4, 0]]), rel=1e-10
        )


@pytest.mark.parametrize("tier", fields.EXACT_TIERS)
@pytest.mark.parametrize("n", [3, 6, 20, 200])
def test_rest_line_of_a_free_structure_is_refused(tier, n):
    """Rounding makes K just not singular; the 1e10 m/N that it would answer are noise."""
    model = chain(n, free=True)
    with pytest.raises(SolverError, match="singular at 0 Hz: the structure is free to move"):
        updyn.response(model, [0.0, 1.0], ["1:X"], ["1:X"], tier=tier)
    assert np.isfinite(updyn.response(model, [0.01, 1.0], ["1:X"], ["1:X"], tier=tier).values).all()


@pytest.mark.parametrize("tier", fields.EXACT_TIERS)
def test_undamped_natural_frequency_is_named(tier):
    K, M = np.array([[2.0, -1.0], [-1.0, 2.0]]), np.eye(2)
    model = updyn.Model.from_groups({"g": updyn.Group(K * (2 * np.pi) ** 2, M)}, ["1:X", "2:X"])
    with pytest.raises(SolverError, match="singular at 1 Hz: a natural frequency without damping"):
        updyn.response(model, [0.5, 1.0], ["1:X"], ["1:X"], tier=tier)


@pytest.mark.parametrize("tier", fields.EXACT_TIERS)
def test_natural_frequency_with_retained_dofs_held_is_named(tier):
    """DOF 2 alone, DOF 1 held: k/m = (2 pi)^2 2, so f = sqrt(2) Hz. The receptance itself is finite there."""
    K, M = np.array([[2.0, -1.0], [-1.0, 2.0]]), np.eye(2)
    model = updyn.Model.from_groups({"g": updyn.Group(K * (2 * np.pi) ** 2, M)}, ["1:X", "2:X"])
    with pytest.raises(
        SolverError, match=r"with the retained DOFs held is singular at 1\.41421 Hz"
    ):
        updyn.condense(model, [np.sqrt(2.0)], ["1:X"], tier=tier)
    assert np.isfinite(
        updyn.response(model, [np.sqrt(2.0)], ["1:X"], ["1:X"], tier=tier).values
    ).all()


@pytest.mark.parametrize("tier", fields.EXACT_TIERS)
def test_block_size_is_bounded_memory_and_at_least_one_line(tier, monkeypatch):
    solver = LineSolver.choose(AffineSystem.compile(chain(20)), tier)
    override(monkeypatch, LINE_SOLVER, block_bytes=10**6)
    many = solver.block_size(2)
    assert 1 < many <= 10**6 / (16 * 20 * 2)
    override(monkeypatch, LINE_SOLVER, block_bytes=1)
    assert solver.block_size(2) == 1


@pytest.mark.parametrize("tier", fields.EXACT_TIERS)
def test_motion_at_some_dofs(tier):
    """Reciprocity: motion of DOFs 3 and 0 for forces on 4 and 1 is that of 4 and 1 for forces on 3 and 0."""
    solver = LineSolver.choose(AffineSystem.compile(chain(9)), tier)
    freq, one, other = np.array([3.0, 40.0]), np.array([3, 0]), np.array([4, 1])
    c = solver.system.coefficients(solver.system.start, 2 * np.pi * freq)
    there, back = (solver.at(solver.solve(c, a, freq), b) for a, b in ((one, other), (other, one)))
    assert there.shape == (2, 2, 2)
    assert there == pytest.approx(back.transpose(2, 1, 0), rel=1e-10)


@pytest.mark.parametrize("loss", [0.0, 0.02])
def test_solves_without_damping_are_real_and_agree_with_those_of_complex_numbers(monkeypatch, loss):
    """Lines solved one by one, and condensed, against `numpy.linalg.solve` of the assembled Z."""
    model, freq = chain(9, loss=loss), np.array([3.0, 11.0, 17.0])
    kinds = []
    solve = np.linalg.solve

    def watched(A, B):
        kinds.append(np.iscomplexobj(A))
        return solve(A, B)

    monkeypatch.setattr(np.linalg, "solve", watched)
    labels = [str(d) for d in model.dofs]
    H = updyn.response(model, freq, labels, labels).values
    Z_red = updyn.condense(model, freq, labels[:4]).Z
    assert set(kinds) == {loss > 0.0}
    w = 2 * np.pi * freq[:, None, None]
    Z = (model.stiffness + 1j * model.structural).toarray() - w**2 * model.mass.toarray()
    expected = solve(Z, np.broadcast_to(np.eye(9), Z.shape))
    np.testing.assert_allclose(H, expected, rtol=0, atol=1e-11 * np.abs(expected).max())
    np.testing.assert_allclose(
        Z_red @ expected[:, :4, :4], np.broadcast_to(np.eye(4), (3, 4, 4)), atol=1e-9
    )
    assert np.iscomplexobj(H)
