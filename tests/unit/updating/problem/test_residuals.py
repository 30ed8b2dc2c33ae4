"""Residuals by their definitions, their reduction by QR, and priors."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import updyn
from overriding import override
from updyn.dynamics.settings import LINE_SOLVER
from updyn.errors import DataError
from updyn.updating.problem.local import reduce_blocks
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import (
    EquationError,
    LogError,
    OutputError,
    add_prior,
    noise_weights,
)
from updyn.updating.problem.settings import SEARCH_DATA

FREQ = np.linspace(1.5, 18.0, 7)


@pytest.fixture
def true(chain12):
    return chain12.scaled(
        {"part1": {"stiffness": 0.9, "loss_factor": 0.05}, "part3": {"mass": 1.2}}
    )


@pytest.fixture
def problem(chain12, true):
    """Three sensors, one turned round; two hammer points, one turned round; accelerances."""
    data = updyn.response(true, FREQ, ["2:X", "5:-X", "12:X"], ["5:X", "2:-X"], "accelerance")
    unknowns = updyn.parameters(
        chain12, stiffness=["part1", "part2"], mass=["part3"], loss_factor=["part1"]
    )
    return FRFPart.build(chain12, data, unknowns)


def changed(chain12, problem, x):
    return problem.coordinates.parameters.apply(chain12, problem.coordinates.to_values(x))


def stacked(r):
    return np.concatenate([r.real.ravel(), r.imag.ravel()])


def residual_by_hand(name, chain12, problem, x):
    data, model = problem.frf, changed(chain12, problem, x)
    H = updyn.response(model, FREQ, data.responses, data.references, data.quantity).values
    if name == "log":
        return stacked(np.log(np.abs(H / data.values)) + 1j * np.angle(H / data.values))
    if name == "output-error":
        return stacked(WEIGHT * (H - data.values))
    # In the sense of the sensors: a hammer against a sensor's sense makes a unit force of -1 there.
    Z = updyn.condense(model, FREQ, data.responses).Z
    h = data.values / -((2 * np.pi * FREQ[:, None, None]) ** 2)
    return stacked(Z @ h - np.array([[0.0, -1.0], [-1.0, 0.0], [0.0, 0.0]]))


WEIGHT = np.random.default_rng(5).uniform(1.0, 3.0, (7, 3, 2))
RESIDUALS = [LogError(), OutputError(WEIGHT), EquationError()]


@pytest.mark.parametrize("residual", RESIDUALS, ids=lambda r: r.name)
def test_cost_is_that_of_the_definition(chain12, problem, residual):
    x = np.array([0.1, 0.06, -0.2, 0.15])
    expected = residual_by_hand(residual.name, chain12, problem, x)
    assert residual.local(Problem.of([problem]), x).cost == pytest.approx(
        0.5 * expected @ expected, rel=1e-9
    )


@pytest.mark.parametrize("residual", RESIDUALS, ids=lambda r: r.name)
def test_jacobian_and_gradient_equal_central_differences(chain12, problem, residual):
    x, step = np.array([0.1, 0.06, -0.2, 0.15]), 1e-6
    local = residual.local(Problem.of([problem]), x)
    J = np.empty((len(residual_by_hand(residual.name, chain12, problem, x)), 4))
    for i in range(4):
        e = step * np.eye(4)[i]
        up, down = (residual_by_hand(residual.name, chain12, problem, x + s * e) for s in (1, -1))
        J[:, i] = (up - down) / (2 * step)
    r = residual_by_hand(residual.name, chain12, problem, x)
    assert pytest.approx(J.T @ J, rel=1e-6, abs=1e-7 * np.abs(J.T @ J).max()) == local.R.T @ local.R
    assert local.gradient == pytest.approx(J.T @ r, rel=1e-5, abs=1e-6 * np.abs(J.T @ r).max())


@pytest.mark.parametrize("residual", RESIDUALS, ids=lambda r: r.name)
def test_zero_at_the_truth(problem, residual):
    truth = problem.coordinates.to_x(np.array([0.9, 0.05, 1.0, 1.2]))
    assert problem.coordinates.parameters.names[1] == "part1.loss_factor"
    assert residual.local(Problem.of([problem]), truth).cost < 1e-18


@pytest.mark.parametrize("residual", RESIDUALS, ids=lambda r: r.name)
def test_blocks_of_lines_change_nothing(problem, residual, monkeypatch):
    x = np.array([0.1, 0.06, -0.2, 0.15])
    whole = residual.local(Problem.of([problem]), x)
    override(monkeypatch, LINE_SOLVER, block_bytes=16 * 12 * 12 * 5)
    parts = residual.local(Problem.of([problem]), x)
    assert parts.cost == pytest.approx(whole.cost, rel=1e-12)
    assert parts.gradient == pytest.approx(whole.gradient, rel=1e-9)
    assert pytest.approx(whole.R.T @ whole.R, rel=1e-9) == parts.R.T @ parts.R


def test_log_residual_leaves_out_exact_zeros(problem):
    values = problem.frf.values.copy()
    values[2, 1, 0] = 0.0
    data = updyn.FRF(FREQ, values, problem.frf.responses, problem.frf.references, "accelerance")
    holed = type(problem)(
        problem.solver,
        problem.unknowns,
        problem.coordinates,
        data,
        problem.rows,
        problem.columns,
        problem.sign,
    )
    x = np.array([0.1, 0.06, -0.2, 0.15])
    r = np.log(problem.responses(x) / problem.frf.values)
    r[2, 1, 0] = 0.0
    found = LogError().local(Problem.of([holed]), x)
    assert found.cost == pytest.approx(0.5 * np.sum(np.abs(r) ** 2), rel=1e-10)


def test_model_that_cannot_be_solved_gives_none(chain12, problem):
    """An undamped natural frequency on a line."""
    free = updyn.Model.from_groups(
        {
            "g": updyn.Group(
                (2 * np.pi) ** 2 * np.array([[2.0, -1.0], [-1.0, 2.0]]), np.eye(2), loss_factor=0.1
            )
        },
        ["1:X", "2:X"],
    )
    data = updyn.response(free, [0.5, 1.0], ["1:X"], ["1:X"])
    unknowns = updyn.parameters(free, loss_factor="all")
    single = FRFPart.build(free, data, unknowns)
    for residual in (LogError(), OutputError(np.ones((2, 1, 1)))):
        assert residual.local(Problem.of([single]), np.array([0.0])) is None
        assert residual.local(Problem.of([single]), np.array([0.1])).cost == pytest.approx(
            0.0, abs=1e-20
        )


def test_equation_error_needs_the_drive_point(chain12, true):
    data = updyn.response(true, FREQ, ["2:X", "5:X"], ["5:X", "9:-X"])
    problem = FRFPart.build(chain12, data, updyn.parameters(chain12, stiffness="all"))
    with pytest.raises(DataError, match="reference 9:-X is not among the responses"):
        EquationError().local(Problem.of([problem]), np.zeros(4))


def test_equation_error_has_no_receptance_in_an_accelerance_at_rest(chain12, true):
    data = updyn.response(true, [0.0, 2.0], ["2:X"], ["2:X"], "accelerance")
    problem = FRFPart.build(chain12, data, updyn.parameters(chain12, stiffness="all"))
    with pytest.raises(DataError, match="0 Hz line of accelerance holds no receptance"):
        EquationError().local(Problem.of([problem]), np.zeros(4))


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.integers(1, 5), st.integers(1, 12), st.integers(1, 4))
def test_reduce_keeps_cost_gradient_and_information(seed, n, m, cuts):
    """However the rows are cut into blocks, and even if there are fewer rows than unknowns."""
    rng = np.random.default_rng(seed)
    J, r = rng.standard_normal((m, n)), rng.standard_normal(m)
    local = reduce_blocks(np.array_split(np.column_stack([J, r]), cuts), n)
    assert local.cost == pytest.approx(0.5 * r @ r, rel=1e-12)
    assert local.gradient == pytest.approx(J.T @ r, abs=1e-12)
    assert pytest.approx(J.T @ J, abs=1e-12) == local.R.T @ local.R
    assert local.R.shape[1] == n


def test_prior_adds_its_residual_to_cost_gradient_and_information(chain12, true):
    unknowns = updyn.parameters(
        chain12,
        stiffness=["part1", "part2"],
        loss_factor=["part1"],
        prior_std={"part1.*": 0.2, "part2.stiffness": 2.0},
    )
    bare = updyn.parameters(chain12, stiffness=["part1", "part2"], loss_factor=["part1"])
    data = updyn.response(true, FREQ, ["2:X"], ["5:X"])
    problem, x = FRFPart.build(chain12, data, unknowns), np.array([0.1, 0.08, -0.3])
    local = LogError().local(Problem.of([problem]), x)
    joined = add_prior(local, Problem.of([problem]), x)
    pull, weight = np.array([0.1, 0.05, -0.3]), 1 / np.array([0.2, 0.2, 2.0])
    assert joined.cost == pytest.approx(local.cost + 0.5 * np.sum((pull * weight) ** 2), rel=1e-12)
    assert joined.gradient == pytest.approx(local.gradient + pull * weight**2, rel=1e-10)
    assert (
        pytest.approx(local.R.T @ local.R + np.diag(weight**2), rel=1e-10) == joined.R.T @ joined.R
    )
    without = FRFPart.build(chain12, data, bare)
    assert add_prior(local, Problem.of([without]), x) is local


# -- weights of the log error ----------------------------------------------------------------------
def with_variance(part, variance):
    data = part.frf
    frf = updyn.FRF(
        data.freq,
        data.values,
        data.responses,
        data.references,
        data.quantity,
        variance=np.broadcast_to(variance, data.values.shape),
    )
    return replace(part, frf=frf)


@pytest.mark.parametrize(
    ("share", "weight"),
    [
        (0.0, 1.0),
        (0.01, (0.9991 / 1.0091) ** 0.5),
        (0.1, (0.91 / 1.91) ** 0.5),
        (0.3, (0.19 / 9.19) ** 0.5),
        (0.34, 0.0),
        (100.0, 0.0),
    ],
)
def test_weight_by_noise_over_level(problem, share, weight):
    """The square of a level, less nine variances, over that and 100 variances."""
    noisy = with_variance(problem, (share * np.abs(problem.frf.values)) ** 2)
    found = LogError.of_noisy_data(noisy).weight
    assert found == pytest.approx(np.full(found.shape, weight), rel=1e-9)


def test_weights_are_those_of_each_value(problem):
    variance = np.random.default_rng(0).uniform(0.0, 4.0, problem.frf.values.shape)
    variance *= np.abs(problem.frf.values[3, 1, 0]) ** 2
    found = noise_weights(problem.frf.values, variance, problem.frf)
    for at in np.ndindex(found.shape):
        size = abs(problem.frf.values[at])
        own = max(size**2 - SEARCH_DATA.subtracted_variances * variance[at], 0.0)
        assert found[at] == pytest.approx(np.sqrt(own / (own + 100.0 * variance[at])))


def test_rounding_and_zero_weigh_nothing_even_without_noise():
    """Below 1e-11 of the largest of its line, each channel as a share of its unit."""
    values = np.ones((3, 2, 2), dtype=complex)
    values[0] = [[5.0, 1e-17], [1e-10, 0.0]]
    values[1] = 0.0
    values[2] = [[2e-16, 1e-16], [3e-28, 1e-16]]  # a faint line, all of it real but one value
    frf = updyn.FRF([1.0, 2.0, 3.0], values, ["1:X", "2:X"], ["1:X", "2:X"], "receptance")
    found = noise_weights(values, np.zeros(values.shape), frf)
    expected = [[[1, 0], [1, 0]], [[0, 0], [0, 0]], [[1, 1], [0, 1]]]
    assert found == pytest.approx(np.array(expected, dtype=float), abs=1e-12)


def test_small_units_are_not_rounding():
    """Rotations of 1e-15 rad/N beside translations of 1 m/N are 1 of their own unit."""
    values = np.array([1.0, 1e-15])[None, :, None] * (1.0 + np.arange(4.0))[:, None, None]
    frf = updyn.FRF(1.0 + np.arange(4.0), values, ["1:X", "1:RZ"], ["1:X"], "receptance")
    found = noise_weights(values, np.zeros(values.shape), frf)
    assert found == pytest.approx(np.ones(values.shape))


def test_weighted_log_error_by_its_definition_and_central_differences(problem, monkeypatch):
    """With one value zero and one at rounding; over all lines at once and in blocks."""
    values = problem.frf.values.copy()
    values[2, 1, 0] = 0.0
    values[4, 0, 1] *= 1e-14
    level = np.sqrt(np.mean(np.abs(values) ** 2))
    holed = replace(problem, frf=replace(problem.frf, values=values))
    part = with_variance(holed, (0.05 * level) ** 2)
    size = np.abs(values)
    own = np.maximum(size**2 - SEARCH_DATA.subtracted_variances * (0.05 * level) ** 2, 0.0)
    weight = np.sqrt(own / (own + (0.5 * level) ** 2))
    weight[4, 0, 1] = 0.0
    error, x, step = LogError.of_noisy_data(part), np.array([0.1, 0.06, -0.2, 0.15]), 1e-6

    def by_hand(x):
        ratio = part.responses(x) / np.where(values == 0.0, 1.0, values)
        return weight * (np.log(np.abs(ratio)) + 1j * np.angle(ratio))

    r, J = error.block(part, x, slice(0, len(FREQ)))
    assert r == pytest.approx(by_hand(x), rel=1e-9, abs=1e-12)
    for i in range(4):
        e = step * np.eye(4)[i]
        expected = (by_hand(x + e) - by_hand(x - e)) / (2 * step)
        assert J[i] == pytest.approx(expected, rel=1e-5, abs=1e-7)
    expected = 0.5 * np.sum(np.abs(by_hand(x)) ** 2)
    assert error.local(Problem.of([part]), x).cost == pytest.approx(expected, rel=1e-10)
    override(monkeypatch, LINE_SOLVER, block_bytes=16 * 12 * 12 * 5)
    assert error.local(Problem.of([part]), x).cost == pytest.approx(expected, rel=1e-10)


def test_noise_below_a_value_changes_little_and_above_it_nearly_all(problem):
    """Two tries of unlike noise are not taken for one another in memory."""
    x, costs = np.array([0.1, 0.06, -0.2, 0.15]), []
    for share in (0.0, 0.01, 10.0):
        part = with_variance(problem, (share * np.abs(problem.frf.values)) ** 2)
        costs.append(LogError.of_noisy_data(part).local(Problem.of([part]), x).cost)
    assert costs[0] == pytest.approx(LogError().local(Problem.of([problem]), x).cost, rel=1e-12)
    own = 1.0 - SEARCH_DATA.subtracted_variances * 1e-4
    assert costs[1] == pytest.approx(costs[0] * own / (own + 0.01), rel=1e-10)
    assert costs[2] == 0.0
