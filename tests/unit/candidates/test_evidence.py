"""The evidence by Laplace's method against exact evidences and integrals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm

from updyn.candidates.evidence import Prior, log_evidence, log_prediction
from updyn.updating.problem.local import Local, reduce_blocks

HALF_LOG = 0.5 * np.log(2.0 * np.pi)


def linear_problem(J, y, x):
    """Return the problem of residuals J x - y of unit variance at x."""
    r = J @ x - y
    return reduce_blocks([np.column_stack([J, r])], J.shape[1])


def gaussian(centre, std, width=200.0):
    """Return independent Gaussian priors with bounds far away."""
    centre, std = np.array(centre, float), np.array(std, float)
    return Prior(centre, std, centre - width, centre + width, np.zeros(len(std), bool))


def flat(lower, upper):
    lower, upper = np.array(lower, float), np.array(upper, float)
    scale = (upper - lower) / np.sqrt(2.0 * np.pi)
    return Prior(0.5 * (lower + upper), scale, lower, upper, np.ones(len(lower), bool))


def estimate(J, y, prior):
    """Return the maximum of the posterior within the bounds of a single flat or Gaussian prior."""
    weight = np.where(prior.is_flat, 0.0, 1.0 / prior.scale)
    A = np.vstack([J, np.diag(weight)])
    return np.linalg.lstsq(A, np.concatenate([y, weight * prior.centre]), rcond=None)[0]


@pytest.fixture
def linear():
    rng = np.random.default_rng(3)
    J = rng.standard_normal((9, 3)) * [1.0, 4.0, 0.3]
    y = J @ [0.5, -0.2, 0.1] + rng.standard_normal(9)
    return J, y


def test_linear_gaussian_evidence_is_exact(linear):
    """Z = N(y; J x_0, 1 + J S^2 J^T)."""
    J, y = linear
    prior = gaussian([0.2, 0.0, -0.1], [0.5, 2.0, 1.5])
    x = estimate(J, y, prior)
    covariance = np.eye(len(y)) + (J * prior.scale**2) @ J.T
    exact = multivariate_normal(J @ prior.centre, covariance).logpdf(y)
    found = log_evidence(linear_problem(J, y, x), x, prior) - len(y) * HALF_LOG
    assert found == pytest.approx(exact, abs=1e-9)


def test_flat_prior_contributes_the_width_of_the_posterior_over_that_of_the_prior(linear):
    """The Occam factor sqrt(2 pi) std / W of each unknown (MacKay 2003, eq. 28.9)."""
    J, y = linear
    prior = flat([-40.0] * 3, [40.0] * 3)
    x = estimate(J, y, prior)
    local = linear_problem(J, y, x)
    volume = 3 * HALF_LOG - 0.5 * np.linalg.slogdet(J.T @ J)[1] - 3 * np.log(80.0)
    assert log_evidence(local, x, prior) == pytest.approx(-local.cost + volume, abs=2e-3)


def test_simpler_nested_model_wins_by_the_occam_factor(linear):
    """An unknown that explains noise only costs ln(W / (sqrt(2 pi) std)) less its gain."""
    J, y = linear
    y = y - J[:, 2] * np.linalg.lstsq(J, y, rcond=None)[0][2]  # its best value is 0
    large, small = flat([-50.0] * 3, [50.0] * 3), flat([-50.0] * 2, [50.0] * 2)
    x = estimate(J, y, large)
    both = log_evidence(linear_problem(J, y, x), x, large)
    without = log_evidence(linear_problem(J[:, :2], y, x[:2]), x[:2], small)
    J_rest = J[:, 2] - J[:, :2] @ np.linalg.lstsq(J[:, :2], J[:, 2], rcond=None)[0]
    std = 1.0 / np.linalg.norm(J_rest)
    assert without - both == pytest.approx(np.log(100.0 / (np.sqrt(2 * np.pi) * std)), abs=1e-3)


def test_undetermined_combination_adds_nothing(linear):
    """An unknown, or a combination, without effect leaves the evidence as it is."""
    J, y = linear
    less = gaussian([0.0] * 3, [0.7] * 3)
    x = estimate(J, y, less)
    known = log_evidence(linear_problem(J, y, x), x, less)
    without_effect = np.column_stack([J, np.zeros(len(y))])
    for prior in (
        gaussian([0.0] * 4, [0.7, 0.7, 0.7, 3.0]),
        Prior(
            np.zeros(4),
            np.array([0.7, 0.7, 0.7, 8.0 / np.sqrt(2 * np.pi)]),
            np.array([-200.0, -200.0, -200.0, -1.0]),
            np.array([200.0, 200.0, 200.0, 7.0]),
            np.array([False, False, False, True]),
        ),
    ):
        for free in (-1.0, 0.3):
            at = np.append(x, free if prior.is_flat[3] else 0.0)
            local = linear_problem(without_effect, y, at)
            assert log_evidence(local, at, prior) == pytest.approx(known, abs=1e-7)
    # Two unknowns of which only the sum matters, with the prior of the sum shared out.
    split = np.column_stack([J[:, :2], J[:, 2], J[:, 2]])
    prior = gaussian([0.0] * 4, [0.7, 0.7, *(np.sqrt(0.5) * np.array([0.7, 0.7]))])
    at = np.append(x[:2], [x[2] / 2, x[2] / 2])
    found = log_evidence(linear_problem(split, y, at), at, prior)
    assert found == pytest.approx(known, abs=1e-9)


@pytest.mark.parametrize("information", [0.1, 1.0, 30.0])
@pytest.mark.parametrize("true", [-0.4, 0.05, 0.9, 2.5])
@pytest.mark.parametrize("is_flat", [True, False])
def test_bounds_cut_off_the_density(information, true, is_flat):
    """Against the integral over the prior between the bounds, for one unknown."""
    lower, upper, centre, std = 0.0, 2.0, 0.6, 0.8
    root = np.sqrt(information)
    J, y = np.array([[root]]), np.array([root * true])
    prior = Prior(
        np.array([centre]),
        np.array([2.0 / np.sqrt(2 * np.pi) if is_flat else std]),
        np.array([lower]),
        np.array([upper]),
        np.array([is_flat]),
    )
    x = np.clip(estimate(J, y, prior), lower, upper)
    normal = norm(centre, std)
    share = normal.cdf(upper) - normal.cdf(lower)

    def density(value):
        likelihood = np.exp(-0.5 * (root * (value - true)) ** 2)
        return likelihood * (0.5 if is_flat else normal.pdf(value) / share)

    exact = np.log(quad(density, lower, upper, epsabs=1e-13)[0])
    assert log_evidence(linear_problem(J, y, x), x, prior) == pytest.approx(exact, abs=1e-6)


def test_estimate_on_a_bound_far_from_the_minimum_keeps_its_density():
    """A large gradient at a bound: the density falls as exp(-g t)."""
    root, lower, upper = 1.0, 0.0, 1.0
    prior = flat([lower], [upper])
    y, x = np.array([-30.0]), np.array([0.0])
    local = linear_problem(np.array([[root]]), y, x)
    exact = np.log(quad(lambda t: np.exp(-30.0 * t - 0.5 * t**2), 0.0, 1.0)[0]) - 450.0
    assert log_evidence(local, x, prior) == pytest.approx(exact, abs=1e-9)


@pytest.mark.parametrize("scale", [1.0, 2.5])
def test_prediction_is_the_ratio_of_two_evidences(linear, scale):
    """ln p(b | a) = ln p(a, b) - ln p(a) (chain rule), for a variance of `scale`."""
    J, y = linear
    prior = gaussian([0.0, 0.1, 0.0], [0.5, 2.0, 1.5])
    J, y = J / np.sqrt(scale), y / np.sqrt(scale)
    evidences = []
    for rows in (slice(0, 5), slice(0, 9)):
        x = estimate(J[rows], y[rows], prior)
        evidences.append(log_evidence(linear_problem(J[rows], y[rows], x), x, prior))
    root = np.sqrt(scale)
    x = estimate(J[:5], y[:5], prior)
    fitted, held = (
        linear_problem(root * J[rows], root * y[rows], x) for rows in (slice(0, 5), slice(5, 9))
    )
    found = log_prediction(fitted, held, prior, scale)
    assert found == pytest.approx(evidences[1] - evidences[0], abs=1e-9)


def test_held_out_data_of_undetermined_unknowns_are_predicted_by_the_prior():
    """Fitted data without information: the prediction is that of the prior, N(y; 0, 1 + J s^2 J)."""
    prior = gaussian([0.0], [3.0])
    held = linear_problem(np.array([[2.0]]), np.array([1.5]), np.zeros(1))
    found = log_prediction(Local(0.0, np.zeros((1, 1)), np.zeros(1)), held, prior)
    assert found - HALF_LOG == pytest.approx(norm(0.0, np.sqrt(37.0)).logpdf(1.5), abs=1e-12)
