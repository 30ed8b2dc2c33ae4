"""All lines of a state from one eigendecomposition: values against solves of the assembled Z."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn import sensitivity
from updyn.dynamics.affine import AffineSystem
from updyn.dynamics.fields import LineSolver
from updyn.dynamics.pencil import saves_time
from updyn.dynamics.reduction import Reduction
from updyn.dynamics.settings import PENCIL
from updyn.errors import SolverError
from updyn.sensitivity import Unknowns
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import LogError

FREQ = np.geomspace(0.5, 60.0, PENCIL.least_lines)
READ, LOADED = np.array([2, 9, 19]), np.array([0, 9])


def spring(n, i, j, k):
    """A spring between two DOFs; j < 0: to ground."""
    K = np.zeros((n, n))
    K[i, i] = k
    if j >= 0:
        K[j, j] = k
        K[i, j] = K[j, i] = -k
    return K


def chain(losses, *, n=20, massless=(), copies=1, free=False, mass_damping=0.0):
    """Masses in a row, in one group for each loss factor; copies do not touch each other."""
    rng = np.random.default_rng(2)
    k, m = rng.uniform(1e4, 1e5, n), rng.uniform(0.5, 2.0, n)
    m[list(massless)] = 0.0
    groups = {}
    for number, part in enumerate(np.array_split(np.arange(n), len(losses))):
        K, M = np.zeros((n, n)), np.zeros((n, n))
        for i in part:
            if i or not free:
                K += spring(n, i, i - 1, k[i])
            M[i, i] = m[i]
        K, M = (np.kron(np.eye(copies), A) for A in (K, M))
        groups[f"g{number}"] = updyn.Group(
            K, M, loss_factor=losses[number], mass_damping=mass_damping
        )
    return updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(copies * n)])


def solver_of(model):
    return LineSolver.choose(AffineSystem.compile(model), "dense")


def pencil_of(model, freq=FREQ):
    solver = solver_of(model)
    return solver.pencil(solver.system.start, freq)


def direct(model, freq, decay=0.0):
    """H of all DOFs, shape (n_f, n, n), from the groups' own matrices and hand-written formulas."""
    s = 2j * np.pi * freq[:, None, None] + decay
    Z = 0.0
    for group in model.groups.values():
        K, M, loss, table = group.stiffness, group.mass, group.loss_factor, group.loss_table
        if table is not None:
            loss = loss * np.interp(freq, table.freq, table.relative)[:, None, None]
        if K is not None:
            Z = Z + (1 + 1j * loss + s * group.stiffness_damping) * K.toarray()
        if M is not None:
            Z = Z + (s**2 + s * group.mass_damping) * M.toarray()
        if group.viscous is not None:
            Z = Z + s * group.viscous.toarray()
    return np.linalg.solve(Z, np.broadcast_to(np.eye(model.n_dofs), Z.shape))


def agree(model, freq=FREQ, decay=0.0, share=1e-9):
    """The response agrees with direct solves, as a share of the largest of each line."""
    labels = [str(d) for d in model.dofs]
    H = updyn.response(model, freq, labels, labels, tier="dense", decay=decay).values
    expected = direct(model, freq, decay)
    level = np.abs(expected).max(axis=(1, 2), keepdims=True)
    np.testing.assert_array_less(np.abs(H - expected) / level, share)


def test_loss_factors_of_several_groups():
    model = chain([0.01, 0.05, 0.0])
    assert np.iscomplexobj(pencil_of(model).V)
    agree(model)


@pytest.mark.parametrize("loss", [0.0, 0.03])
def test_one_loss_factor_needs_real_arithmetic_and_fewer_lines(loss):
    model, few = chain([loss, loss]), np.linspace(1.0, 9.0, PENCIL.least_real_lines)
    pencil = pencil_of(model, few)
    assert np.isrealobj(pencil.V)
    agree(model, few)


@pytest.mark.parametrize("losses", [[0.0], [0.02], [0.02, 0.3]])
def test_masses_of_zero(losses):
    model = chain(losses, massless=(0, 7, 8, 19))
    assert pencil_of(model) is not None
    agree(model)


@pytest.mark.parametrize("losses", [[0.0], [0.02, 0.04, 0.08]])
def test_free_structure(losses):
    model = chain(losses, free=True)
    assert pencil_of(model) is not None
    agree(model)


@pytest.mark.parametrize("losses", [[0.0], [0.02, 0.04, 0.08]])
def test_each_mode_three_times(losses):
    model = chain(losses, n=12, copies=3)
    assert pencil_of(model) is not None
    agree(model)


def test_exponential_window():
    agree(chain([0.01, 0.05]), decay=3.0)


@pytest.mark.parametrize("shift", [0.0, 1e-9, 1e-4])
def test_pencil_without_a_full_set_of_eigenvectors(shift):
    """K + i D = k + i e + e [[1, i], [i, -1]] with M = 1: one eigenvector for a double eigenvalue.

    The second matrix is nilpotent. With a shift there are two, which are almost the same.
    """
    k, e, loss = 4e3, 200.0, 0.25
    joint = e / loss * np.ones((2, 2))
    rest = np.diag([k + e + shift, k - e]) - joint
    model = updyn.Model.from_groups(
        {"joint": updyn.Group(joint, loss_factor=loss), "rest": updyn.Group(rest, np.eye(2))},
        ["1:X", "2:X"],
    )
    near = np.linspace(9.0, 11.0, PENCIL.least_lines)  # around the double eigenvalue, 10.1 Hz
    agree(model, near, share=1e-10)


def test_eigenvectors_that_are_almost_dependent():
    """Damping that grows along a long chain: the condition of the eigenvectors is 1e11."""
    n = 200
    groups = {}
    for i in range(n):
        M = np.zeros((n, n))
        M[i, i] = 1.0
        groups[f"g{i}"] = updyn.Group(spring(n, i, i - 1, 1e5), M, loss_factor=0.01 + 0.09 * i / n)
    model = updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])
    agree(model)


def test_line_close_to_a_natural_frequency():
    """Of k = m omega0^2 in ten copies; the others are far off."""
    omega = 2.0 * np.pi * np.linspace(1.0, 3.0, 40)
    K, M = np.diag(np.arange(1.0, 11.0)) * 4e2, np.eye(10)
    model = updyn.Model.from_groups({"g": updyn.Group(K, M)}, [f"{i + 1}:X" for i in range(10)])
    omega = np.sort(np.append(omega, 20.0 * (1.0 + 1e-9)))
    freq = omega / (2.0 * np.pi)
    H = updyn.response(model, freq, ["1:X", "2:X"], ["1:X"]).values
    s = 2.0 * np.pi * freq
    # The difference of two squares, which does not cancel.
    np.testing.assert_allclose(H[:, 0, 0], 1.0 / ((20.0 - s) * (20.0 + s)), rtol=1e-5)
    np.testing.assert_array_equal(H[:, 1, 0], 0.0)


@pytest.mark.parametrize("losses", [[0.0], [0.02, 0.04]])
def test_singular_line_is_told(losses):
    model = chain(losses, free=True)
    freq = np.concatenate([[0.0], FREQ])
    with pytest.raises(SolverError, match=r"singular at 0 Hz: the structure is free to move"):
        updyn.response(model, freq, ["1:X"], ["1:X"])


TABLE = updyn.LossTable([0.1, 10.0, 100.0], [1.0, 0.5, 2.0])


@pytest.mark.parametrize("decay", [0.0, 3.0])
@pytest.mark.parametrize(
    "common",
    [
        {"loss_factor": 0.02, "stiffness_damping": 1e-4, "mass_damping": 0.5},
        {"stiffness_damping": 1e-4},
        {"mass_damping": 0.5},
        {"loss_factor": 0.1, "loss_table": TABLE},
    ],
    ids=["all", "stiffness", "mass", "table"],
)
def test_proportional_damping_of_all_groups_needs_real_arithmetic(common, decay):
    model = chain([0.0, 0.0])
    groups = {n: updyn.Group(g.stiffness, g.mass, **common) for n, g in model.groups.items()}
    model = updyn.Model.from_groups(groups, model.dofs)
    assert np.isrealobj(pencil_of(model).V)
    agree(model, decay=decay, share=1e-10)


def with_line_terms(losses, table=TABLE, n=40):
    """A chain with a viscous damper and a mount whose loss factor depends on frequency."""
    groups = dict(chain(losses, n=n).groups)
    groups["damper"] = updyn.Group(viscous=spring(n, 3, 4, 40.0))
    groups["mount"] = updyn.Group(
        spring(n, n - 1, -1, 2e4),
        np.diag(np.eye(n)[7]),
        loss_factor=0.3,
        loss_table=table,
        stiffness_damping=1e-3,
        mass_damping=2.0,
    )
    return updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])


@pytest.mark.parametrize("decay", [0.0, 3.0])
@pytest.mark.parametrize("losses", [[0.0], [0.02, 0.06]])
def test_damping_of_small_rank_that_depends_on_the_line_is_a_correction(losses, decay):
    model = with_line_terms(losses)
    assert pencil_of(model) is not None
    agree(model, decay=decay, share=1e-10)


def test_correction_leaves_few_lines_to_separate_solutions():
    """Also without other damping, where Z0 would be singular at natural frequencies."""
    model, freq = with_line_terms([0.0]), np.linspace(0.5, 60.0, 400)
    solver = solver_of(model)
    state, s = solver.system.start, 2j * np.pi * freq
    c = solver.system.coefficients(state, 2 * np.pi * freq)
    _, accepted = solver.pencil(state, freq).solve(c, s**2, np.eye(40)[:, :2])
    assert accepted.mean() > 0.95


def test_correction_of_a_reduced_model():
    system = AffineSystem.compile(with_line_terms([0.01, 0.05], n=80))
    reduction = Reduction(system, READ, LOADED, (0.5, 60.0), "superlu")
    reduction.build(system.start)
    solver = reduction.solver()
    assert solver.system.n < 80
    assert_at_once_as_one_by_one(solver, FREQ)


def test_damping_of_large_rank_that_depends_on_the_line_is_solved_line_by_line():
    base = chain([0.02])
    more = {"g0": base.group("g0"), "damped": updyn.Group(viscous=np.eye(20))}
    tabled = updyn.Group(5.0 * np.eye(20), loss_factor=0.02, loss_table=TABLE)
    for group in (updyn.Group(viscous=np.eye(20)), tabled):
        model = updyn.Model.from_groups({**more, "damped": group}, base.dofs)
        assert pencil_of(model) is None
        agree(model)


def test_choice_depends_on_lines_and_state():
    system = AffineSystem.compile(chain([0.01, 0.02]))
    assert saves_time(system, system.start, PENCIL.least_lines, PENCIL.least_lines)
    assert not saves_time(system, system.start, PENCIL.least_lines - 1, PENCIL.least_lines)
    assert pencil_of(chain([0.01, 0.02]), FREQ[:-1]) is None
    sparse = LineSolver.choose(system, "sparse")
    assert sparse.pencil(system.start, FREQ) is None


def test_indefinite_matrix_has_no_pencil():
    labels = [f"{i + 1}:X" for i in range(4)]
    with pytest.warns(updyn.UpdynWarning, match="indefinite"):
        model = updyn.Model.from_groups({"g": updyn.Group(-np.eye(4))}, labels)
    assert pencil_of(model) is None


def test_state_that_was_asked_for_last_is_kept():
    solver = solver_of(chain([0.01, 0.05]))
    start = solver.system.start
    first = solver.pencil(start, FREQ)
    assert solver.pencil(start, FREQ) is first
    other = solver.pencil(replace(start, factor=2.0 * start.factor), FREQ)
    assert other is not first
    assert solver.pencil(start, FREQ[1:]) is None


@pytest.mark.parametrize("highest", [1.0, 2048.0, 2140.0, 60.0])
def test_lines_that_are_nearly_as_high_share_a_pencil_whatever_was_asked_before(highest):
    """Stretched by a few per cent as a cause stretches them, across a power of 2 as well."""
    freq = np.linspace(0.1, 1.0, PENCIL.least_lines) * highest
    stretched = [factor * freq for factor in (0.93, 1.0, 1.07, 0.95, 1.02)]
    solver = solver_of(chain([0.01, 0.05]))
    start = solver.system.start
    made = [solver.pencil(start, lines) for lines in stretched]
    assert len({id(pencil) for pencil in made}) <= 2
    for lines, pencil in zip(stretched, made, strict=True):
        alone = solver_of(chain([0.01, 0.05])).pencil(start, lines)
        np.testing.assert_array_equal(alone.V, pencil.V)


def test_the_solver_of_data_through_a_window_has_the_same_pencils():
    """Z(s) is that of the same K, D and M at another s."""
    solver = reduction_of_chain().solver()
    start, windowed = solver.system.start, solver.with_decay(2.0)
    assert solver.with_decay(0.0) is solver
    assert windowed.pencil(start, FREQ) is solver.pencil(start, FREQ)
    assert_at_once_as_one_by_one(windowed, FREQ)


def reduction_of_chain():
    system = AffineSystem.compile(chain([0.01, 0.05, 0.02]))
    reduction = Reduction(system, READ, LOADED, (0.5, 60.0), "superlu")
    reduction.build(system.start)
    return reduction


def assert_at_once_as_one_by_one(solver, freq):
    start = solver.system.start
    pencil = solver.pencil(start, freq)
    assert pencil is not None
    c = solver.system.coefficients(start, 2 * np.pi * freq)
    one_by_one = solver.at(solver.solve(c, LOADED, freq), READ)
    at_once = solver.at(solver.solve(c, LOADED, freq, pencil), READ)
    np.testing.assert_allclose(at_once, one_by_one, rtol=1e-8)


def unknowns_of(model):
    return updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")


def test_derivatives_agree_with_those_of_solves_line_by_line():
    model = chain([0.01, 0.05, 0.02])
    system, parameters = AffineSystem.compile(model), unknowns_of(model)
    solver, unknowns = LineSolver.choose(system), Unknowns.find(system, parameters)
    rows, columns = np.array([2, 9, 19]), np.array([0, 9])
    given = solver, unknowns, parameters.start, FREQ, rows, columns
    (H, dH), (exact, d_exact) = (
        sensitivity.receptance(*given, lines=lines) for lines in (FREQ, FREQ[:1])
    )
    np.testing.assert_allclose(H, exact, rtol=1e-8)
    level = np.abs(d_exact).max(axis=(2, 3), keepdims=True)
    np.testing.assert_array_less(np.abs(dH - d_exact) / level, 1e-9)
    assert not np.array_equal(H, exact)  # two ways


def test_reduced_model():
    reduction = reduction_of_chain()
    solver = reduction.solver()
    few = FREQ[: PENCIL.least_reduced_lines]  # its error is larger than that of rounding
    for freq in (FREQ, few):
        assert_at_once_as_one_by_one(solver, freq)
    assert solver.pencil(solver.system.start, few[1:]) is None
    assert len(pickle.dumps(solver)) == len(pickle.dumps(reduction.solver()))


def test_blocks_have_the_same_bits_wherever_they_are_solved():
    """In another order, and each by a copy of the part that has solved nothing before."""
    model = chain([0.01, 0.05, 0.02], n=60)
    at = ["3:X", "10:X", "20:X"]
    freq = np.linspace(0.5, 60.0, 3000)
    data = updyn.response(model, freq, at, at[:2])
    part = FRFPart.build(model, data, unknowns_of(model))
    sent = pickle.dumps(part)
    x = part.coordinates.to_x(unknowns_of(model).start)
    blocks = part.partition()
    assert len(blocks) > 2
    whole = [b.dH for b in part.blocks(x)]
    for i in (len(blocks) - 1, 0):
        there = pickle.loads(sent)  # noqa: S301 (from this test)
        assert there.partition() == blocks
        np.testing.assert_array_equal(there.block(x, blocks[i]).dH, whole[i])


def test_residual_that_is_reduced_is_that_of_the_lines():
    model = chain([0.01, 0.05, 0.02])
    at = ["3:X", "10:X", "20:X"]
    data = updyn.response(model.scaled({"g1": {"stiffness": 1.1}}), FREQ, at, at[:2])
    part = FRFPart.build(model, data, unknowns_of(model))
    x = part.coordinates.to_x(unknowns_of(model).start)
    local = LogError().local(Problem.of([part]), x)
    labels = [int(label.split(":")[0]) - 1 for label in at]
    H = direct(model, FREQ)[:, labels][:, :, labels[:2]]
    assert local.cost == pytest.approx(0.5 * np.sum(np.abs(np.log(H / data.values)) ** 2), rel=1e-8)
