"""The evidence near a point, against a linear problem whose evidence is known in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from updyn.updating.judge.causes.quadratic import QuadraticMisfit
from updyn.updating.judge.causes.settings import HELD_QUANTITIES
from updyn.updating.judge.causes.trial import Trial


@pytest.fixture
def linear():
    """J, and the quadratic of e about its best point with the whole spread of what is held."""
    rng = np.random.default_rng(0)
    J = rng.standard_normal((400, 5))
    spread = np.array([0.4, 0.4, 0.05, 0.05, 0.05])
    held = np.array([False, False, True, True, True])
    return rng, J, spread, held


def none(x):
    """Return the slope without a fault."""
    return np.zeros(len(x)), 0.0, 0.0


def quadratic(J, e, x, spread, held):
    return QuadraticMisfit(J.T @ J, J.T @ e, float(e @ e), x, spread, held, len(e), none(x))


def solved(J, y, sigma, spread):
    """Return the best x, and ln p(y) of y = J x + noise, x in its prior."""
    x = np.linalg.solve(J.T @ J / sigma**2 + np.diag(spread**-2.0), J.T @ y / sigma**2)
    covariance = sigma**2 * np.eye(len(y)) + (J * spread**2) @ J.T
    return x, float(multivariate_normal(np.zeros(len(y)), covariance).logpdf(y))


@pytest.mark.parametrize("true", [[0.0, 0.0, 0.0], [0.04, -0.05, 0.03]])
def test_the_evidence_of_what_is_held_is_that_of_a_linear_problem(linear, true):
    """All of its spread against a tenth: the same odds as the marginal likelihood's."""
    rng, J, spread, held = linear
    sigma = 0.1
    y = J @ np.array([0.2, -0.3, *true]) + sigma * rng.standard_normal(len(J))
    x, whole = solved(J, y, sigma, spread)
    narrow = np.where(held, 0.1 * spread, spread)
    _, tenth = solved(J, y, sigma, narrow)
    about = quadratic(J, y - J @ x, x, spread, held)
    level = about.evaluate_share(1.0, len(y), 1.0).mean_square
    assert level == pytest.approx(2.0 * sigma**2, rel=0.15)
    found = [about.evaluate_share(share, len(y), level).log_evidence for share in (1.0, 0.1)]
    assert found[0] - found[1] == pytest.approx(whole - tenth, rel=0.15, abs=0.5)


def test_what_is_right_is_held_tight_and_what_is_off_is_not(linear):
    rng, J, spread, held = linear
    for off, expected in (
        (0.0, HELD_QUANTITIES.std_shares[0]),
        (1.0, HELD_QUANTITIES.std_shares[-1]),
    ):
        y = J @ np.array([0.2, -0.3, *(off * 0.05 * np.array([1.0, -1.0, 1.2]))])
        y += 0.02 * rng.standard_normal(len(J))
        x, _ = solved(J, y, 0.02, spread)
        about = quadratic(J, y - J @ x, x, spread, held)
        share, best = about.find_best_share(len(y), 2.0 * 0.02**2)
        assert share == expected
        assert best.log_evidence >= about.evaluate_share(1.0, len(y), 2.0 * 0.02**2).log_evidence


def test_without_held_values_there_is_the_plain_likelihood_and_prior(linear):
    rng, J, spread, _ = linear
    y = J @ np.array([0.2, -0.3, 0.0, 0.0, 0.0]) + 0.1 * rng.standard_normal(len(J))
    x, _ = solved(J, y, 0.1, spread)
    e = y - J @ x
    about = quadratic(J, e, x, spread, np.zeros(5, dtype=bool))
    share, best = about.find_best_share(300.0, 0.02)
    power = 2.0 * float(e @ e) / len(e)
    assert share == 1.0
    assert best.mean_square == pytest.approx(power)
    far = float(np.sum((x / spread) ** 2))
    assert best.log_evidence == pytest.approx(-150.0 * np.log(power + 1e-6) - 0.5 * far)


def test_a_comparison_with_what_leaves_nothing_says_that_nothing_is_explained(linear):
    """To second order, far from its end, a fit without a fault may leave less than nothing."""
    _, J, spread, held = linear
    nothing = quadratic(J, np.zeros(len(J)), np.zeros(5), spread, held)
    one = Trial(None, np.zeros(5), 1e-4, 0.0, 0.0, len(J), 0, nothing)
    assert one.compare(one) == (0.0, 0.0)
    exact = replace(one, mean_square=0.0, quadratic=None)
    assert exact.compare(exact) == (0.0, 0.0)


def test_a_step_does_not_promise_more_than_the_end_of_a_fit_left(linear):
    """What is left at a poor end is not explained by holding something tighter."""
    _, J, spread, held = linear
    poor = quadratic(J, J @ np.array([0.3, 0.3, 0.0, 0.0, 0.0]), np.zeros(5), spread, held)
    there = poor.evaluate_share(1.0, 400.0, 1e-4).mean_square
    assert poor.evaluate_share(0.1, 400.0, 1e-4).mean_square < there
    assert poor.evaluate_share(0.1, 400.0, 1e-4, there).mean_square == there
    assert poor.find_best_share(400.0, 1e-4, there)[1].mean_square >= there


def test_a_worse_fit_far_from_what_is_known_is_not_the_likelier_one(linear):
    """Whatever the second order says of a step from there."""
    rng, J, spread, held = linear
    noise = 0.01 * rng.standard_normal(400)
    good = quadratic(J, noise, np.zeros(5), spread, held)
    poor = quadratic(J, J @ np.full(5, 0.3), np.array([0.0, 0.0, 0.6, 0.6, 0.6]), spread, held)
    ends = [
        Trial(
            None,
            np.zeros(5),
            one.evaluate_share(1.0, 400.0, 1e-4).mean_square,
            far,
            0.0,
            400,
            quadratic=one,
        )
        for one, far in ((good, 0.0), (poor, 432.0))
    ]
    assert ends[0].mean_square < ends[1].mean_square
    assert (
        ends[0].gain(ends[1])
        > 0.5 * 400.0 * np.log(ends[1].mean_square / ends[0].mean_square) * 0.9
    )


def test_directions_that_the_data_fix_by_far_leave_the_others_to_their_priors():
    """Rounding of the one is more than the priors of the others; no matrix is singular."""
    direction = np.array([1.0, 1.0 / 3.0, 0.7])
    spread, held = np.array([0.4, 0.05, 0.05]), np.array([False, True, True])
    normal = 1e24 * np.outer(direction, direction)
    about = QuadraticMisfit(
        normal, 1e11 * direction, 1.0, np.zeros(3), spread, held, 400, none(spread)
    )
    found = about.evaluate_share(0.5, 400.0, 1e-6)
    assert np.isfinite([found.mean_square, found.log_evidence]).all()


def test_the_size_of_a_fault_is_one_more_unknown(linear):
    """Two faults at once, each against a problem with one more column."""
    rng, J, spread, held = linear
    y, x = 0.02 * rng.standard_normal(len(J)), np.array([0.1, -0.1, 0.02, 0.0, -0.03])
    D = rng.standard_normal((2, len(J)))
    y = y + 0.01 * D[0]
    same = np.ones((2, 1))
    slope = (D @ J, np.sum(D**2, axis=1), D @ y)
    about = QuadraticMisfit(
        J.T @ J, same * (J.T @ y), np.full(2, y @ y), x, spread, held, len(y), slope
    )
    for i, d in enumerate(D):
        wide = np.column_stack([J, d])
        alone = quadratic(wide, y, np.append(x, 0.0), np.append(spread, 1.0), np.append(held, 0))
        alone = replace(alone, is_held=alone.is_held.astype(bool))
        for share in HELD_QUANTITIES.std_shares:
            both, one = (q.evaluate_share(share, 300.0, 8e-4) for q in (about, alone))
            assert both.mean_square[i] == pytest.approx(float(one.mean_square), rel=1e-9)
            assert both.log_evidence[i] == pytest.approx(float(one.log_evidence), rel=1e-9)
