"""The trust region against closed forms, against an independent bounded solver, and on known hard functions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from updyn.updating.fit.trust_region import Step, TrustRegion
from updyn.updating.problem.local import Local, reduce_blocks

FREE = np.array([-np.inf, -np.inf]), np.array([np.inf, np.inf])


def linear(A, b):
    """|A x - b|^2 / 2 in reduced form."""
    return lambda x: reduce_blocks([np.column_stack([A, A @ x - b])], A.shape[1])


def rosenbrock(x):
    """r = (10 (x2 - x1^2), 1 - x1): a curved valley with its minimum, zero, at (1, 1)."""
    r = np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])
    J = np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])
    return reduce_blocks([np.column_stack([J, r])], 2)


def test_gradient_of_the_reduced_problem():
    A, b = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.5]]), np.array([1.0, -1.0, 2.0])
    x = np.array([0.3, -0.2])
    local = linear(A, b)(x)
    assert local.gradient == pytest.approx(A.T @ (A @ x - b), rel=1e-13)
    assert local.cost == pytest.approx(0.5 * np.sum((A @ x - b) ** 2), rel=1e-13)


def test_linear_problem_in_one_step_of_sufficient_radius():
    A, b = np.array([[3.0, 1.0], [1.0, 2.0], [0.0, 1.0]]), np.array([1.0, 2.0, 3.0])
    steps = []
    outcome = TrustRegion(radius=100.0).minimise(
        linear(A, b), np.zeros(2), *FREE, observe=steps.append
    )
    assert outcome.x == pytest.approx(np.linalg.lstsq(A, b)[0], rel=1e-12)
    assert outcome.reason == "converged"
    assert len(steps) <= 2
    assert isinstance(steps[0], Step)


def test_steps_stay_within_the_radius():
    A, b = np.diag([1.0, 1e-3]), np.array([10.0, 10.0])
    lengths = []
    TrustRegion(max_iterations=1, radius=0.25).minimise(
        linear(A, b),
        np.zeros(2),
        *FREE,
        observe=lambda s: bool(lengths.append(np.linalg.norm(s.x))),
    )
    assert lengths[0] == pytest.approx(0.25, rel=0.05)
    assert lengths[0] <= 0.25 * (1 + 1e-12)


def test_rosenbrock_valley():
    outcome = TrustRegion().minimise(rosenbrock, np.array([-1.2, 1.0]), *FREE)
    assert outcome.x == pytest.approx([1.0, 1.0], abs=1e-9)
    assert outcome.reason == "converged"


def brown_and_dennis(x):
    t = np.arange(1, 21) / 5.0
    a, b = x[0] + t * x[1] - np.exp(t), x[2] + x[3] * np.sin(t) - np.cos(t)
    return a**2 + b**2, np.column_stack([2 * a, 2 * a * t, 2 * b, 2 * b * np.sin(t)])


def jennrich_and_sampson(x):
    i = np.arange(1, 11)
    e, f = np.exp(i * x[0]), np.exp(i * x[1])
    return 2.0 + 2.0 * i - e - f, np.column_stack([-i * e, -i * f])


def freudenstein_and_roth(x):
    a, b = x
    r = np.array([-13 + a + ((5 - b) * b - 2) * b, -29 + a + ((b + 1) * b - 14) * b])
    return r, np.array([[1.0, 10 * b - 3 * b**2 - 2], [1.0, 3 * b**2 + 2 * b - 14]])


@pytest.mark.parametrize("radius", [0.5, 100.0])
@pytest.mark.parametrize(
    ("function", "start", "least"),
    [
        (brown_and_dennis, [25.0, 5.0, -5.0, -1.0], 85822.2),
        (jennrich_and_sampson, [0.3, 0.4], 124.362),
        (freudenstein_and_roth, [0.5, -2.0], 48.9842),
    ],
)
def test_minima_of_large_residual(function, start, least, radius):
    """Sums of squares as More, Garbow & Hillstrom, ACM Trans. Math. Softw. 7 (1981) 17, list them."""

    def local(x):
        r, J = function(x)
        return reduce_blocks([np.column_stack([J, r])], len(x))

    outcome = TrustRegion(1000, radius=radius).minimise(local, np.array(start), -np.inf, np.inf)
    assert outcome.reason == "converged"
    assert 2.0 * outcome.local.cost == pytest.approx(least, rel=1e-5)


def test_rosenbrock_with_the_minimum_on_a_bound():
    """With x1 <= 0.5 the minimum is (0.5, 0.25), cost 1/8."""
    outcome = TrustRegion().minimise(
        rosenbrock, np.array([-1.2, 1.0]), FREE[0], np.array([0.5, np.inf])
    )
    assert outcome.x == pytest.approx([0.5, 0.25], abs=1e-9)
    assert outcome.local.cost == pytest.approx(0.125, rel=1e-9)
    assert outcome.reason == "converged"


def test_rank_deficient_problem_ends_at_least_squares_with_the_least_motion():
    A, b = np.array([[1.0, 1.0], [2.0, 2.0]]), np.array([2.0, 4.0])
    outcome = TrustRegion().minimise(linear(A, b), np.zeros(2), *FREE)
    assert outcome.x == pytest.approx([1.0, 1.0], abs=1e-12)
    assert outcome.reason == "converged"


def test_unknown_without_effect_stays_where_it_is():
    A, b = np.array([[2.0, 0.0], [1.0, 0.0]]), np.array([2.0, 4.0])
    outcome = TrustRegion().minimise(linear(A, b), np.array([0.0, 0.7]), *FREE)
    assert outcome.x == pytest.approx([8.0 / 5.0, 0.7], abs=1e-12)


@settings(max_examples=60)
@given(
    st.integers(0, 10**6), st.integers(2, 6), st.floats(-4.0, 0.0), st.sampled_from([0.5, 100.0])
)
def test_bounded_linear_problems_against_an_independent_solver(seed, n, closeness, radius):
    """Correlated unknowns whose bounds act: the minimum within the bounds, as scipy's BVLS finds it."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n + 3, n))
    A[:, -1] = A[:, 0] + 10.0**closeness * A[:, -1]
    b = 5.0 * rng.standard_normal(n + 3)
    lower, upper = -(10.0 ** rng.uniform(-2, 1, n)), 10.0 ** rng.uniform(-2, 1, n)
    outcome = TrustRegion(1000, 1e-10, radius).minimise(linear(A, b), np.zeros(n), lower, upper)
    best = lsq_linear(A, b, (lower, upper), method="bvls", tol=1e-14, max_iter=1000)
    assert outcome.local.cost <= best.cost * (1.0 + 1e-8) + 1e-12
    assert (outcome.x >= lower).all()
    assert (outcome.x <= upper).all()
    assert outcome.reason == "converged"


def test_short_step_of_a_small_radius_is_not_convergence():
    """A small radius limits what a step can gain; that says nothing about the minimum."""
    A, b = np.diag([1.0, 2.0]), np.array([3.0, 4.0])
    outcome = TrustRegion(200, radius=1e-7, min_relative_decrease=1e-6).minimise(
        linear(A, b), np.zeros(2), *FREE
    )
    assert outcome.x == pytest.approx([3.0, 2.0], rel=1e-6)


def valley(far, slope=0.3):
    """r = (30 (x2 - x1^2), slope (x1 - far)): x1 is known to 1 / slope, along a curved valley."""

    def local(x):
        r = np.array([30.0 * (x[1] - x[0] ** 2), slope * (x[0] - far)])
        J = np.array([[-60.0 * x[0], 30.0], [slope, 0.0]])
        return reduce_blocks([np.column_stack([J, r])], 2)

    return local


def test_an_undetermined_combination_within_the_noise_stays_where_it_is():
    """x1 is 1.5 standard deviations (of 3.3) from its best: only what is determined is fitted."""
    begin = np.array([0.0, 0.1])
    outcome = TrustRegion(noise=lambda local: 1.0).minimise(valley(5.0), begin, *FREE)
    assert outcome.reason == "converged"
    assert outcome.x == pytest.approx([0.0, 0.0], abs=1e-6)
    # Where the noise is not known, or smaller, the minimum is sought.
    for noise in (0.0, 1e-3):
        outcome = TrustRegion(1000, noise=lambda local, n=noise: n).minimise(
            valley(5.0), begin, *FREE
        )
        assert outcome.x == pytest.approx([5.0, 25.0], rel=1e-6)


def test_an_undetermined_combination_beyond_the_noise_comes_within_it():
    """Six standard deviations off: the iteration goes on until two are left, and says converged."""
    outcome = TrustRegion(1000, noise=lambda local: 1.0).minimise(valley(20.0), np.zeros(2), *FREE)
    assert outcome.reason == "converged"
    assert 0.0 < 0.3 * (20.0 - outcome.x[0]) < 2.0
    assert outcome.x[1] == pytest.approx(outcome.x[0] ** 2, rel=1e-6)


def test_a_whole_step_that_gains_little_ends_the_iteration_whatever_the_radius():
    A, b = np.diag([1.0, 2.0]), np.array([3.0, 4.0])
    steps = []
    outcome = TrustRegion(radius=1e-7, min_decrease=1e-3).minimise(
        linear(A, b), np.array([3.03, 2.0]), *FREE, observe=steps.append
    )
    assert outcome.reason == "converged"
    assert not steps


def test_a_descent_that_is_cut_goes_on_with_its_radius():
    """Cut after four steps it takes those that it takes in one go."""
    start, seen, parts = np.array([-1.2, 1.0]), [], []

    def steps_into(found):
        return lambda step: found.append(step.x) or False

    TrustRegion(8, radius=0.1).minimise(rosenbrock, start, *FREE, observe=steps_into(seen))
    first = TrustRegion(4, radius=0.1).minimise(rosenbrock, start, *FREE, observe=steps_into(parts))
    assert first.reason == "max-iterations"
    TrustRegion(4, radius=first.radius).minimise(
        rosenbrock, first.x, *FREE, observe=steps_into(parts)
    )
    np.testing.assert_allclose(parts, seen, rtol=1e-12)


def test_points_that_cannot_be_evaluated_are_stepped_around():
    def walled(x):
        return None if x[0] > 1.5 else linear(np.eye(2), np.array([1.0, 1.0]))(x)

    outcome = TrustRegion(radius=10.0).minimise(
        lambda x: None if x[0] > 1.5 else linear(np.eye(2), np.ones(2))(x),
        np.array([-30.0, 0.0]),
        *FREE,
    )
    assert walled(np.array([2.0, 0.0])) is None
    assert outcome.x == pytest.approx([1.0, 1.0], abs=1e-9)


def test_an_end_beside_points_that_cannot_be_evaluated_is_no_minimum():
    outcome = TrustRegion().minimise(
        lambda x: None if x[0] > 0.5 else linear(np.eye(2), np.array([1.0, 0.0]))(x),
        np.zeros(2),
        *FREE,
    )
    assert outcome.reason == "unsolvable"
    assert 0.0 <= outcome.x[0] <= 0.5


def test_points_with_infinite_cost_are_refused():
    def explode(x):
        local = linear(np.eye(2), np.ones(2))(x)
        return Local(np.inf, local.R, local.q) if np.linalg.norm(x) > 2 else local

    steps = []
    outcome = TrustRegion(radius=0.5).minimise(
        explode, np.array([-1.0, -1.5]), *FREE, observe=steps.append
    )
    assert outcome.x == pytest.approx([1.0, 1.0], abs=1e-9)


def test_max_iterations_and_stop():
    start = np.array([-1.2, 1.0])
    assert (
        TrustRegion(max_iterations=3).minimise(rosenbrock, start, *FREE).reason == "max-iterations"
    )
    count = []

    def stop(step):
        count.append(step)
        return len(count) == 2

    assert TrustRegion().minimise(rosenbrock, start, *FREE, observe=stop).reason == "stopped"
    assert len(count) == 2


def test_gradient_that_contradicts_the_cost_is_said_to_stall():
    def liar(x):
        return Local(1.0 + float(x @ x), 1e5 * np.eye(2), np.ones(2))

    assert TrustRegion().minimise(liar, np.zeros(2), *FREE).reason == "stalled"


def test_start_that_cannot_be_evaluated_is_a_programming_error():
    with pytest.raises(ArithmeticError, match="start"):
        TrustRegion().minimise(lambda x: None, np.zeros(2), *FREE)
