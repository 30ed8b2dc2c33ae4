"""Mean and covariance over specimens, against closed results and another maximiser."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize
from scipy.stats import chi2, multivariate_normal

from updyn.population.scatter import estimate_scatter


def draw(m, S, C, seed=0, mean=None):
    """Return estimates of m specimens with errors of the covariances C, shape (m, n, n)."""
    rng = np.random.default_rng(seed)
    n = len(S)
    b = rng.multivariate_normal(np.zeros(n), S, m)
    e = np.array([rng.multivariate_normal(np.zeros(n), one) for one in C])
    return (np.zeros(n) if mean is None else mean) + b + e


def test_equal_errors_give_the_sample_covariance_less_the_error():
    """Balanced one-way layout (Searle, Casella & McCulloch, Variance Components, 1992, ch. 3)."""
    C = np.array([[0.02, 0.01], [0.01, 0.03]])
    x = draw(12, np.array([[0.3, 0.1], [0.1, 0.2]]), [C] * 12, mean=[1.0, 2.0])
    found = estimate_scatter(x, np.array([invert(C)] * 12), is_full=True)
    sample = np.cov(x, rowvar=False)
    np.testing.assert_allclose(found.mean, x.mean(axis=0), rtol=1e-9)
    np.testing.assert_allclose(found.covariance, sample - C, rtol=1e-5)
    np.testing.assert_allclose(found.mean_covariance, sample / 12, rtol=1e-5)
    shrunk = x.mean(axis=0) + (x - x.mean(axis=0)) @ np.linalg.solve(sample, sample - C)
    np.testing.assert_allclose(found.values, shrunk, rtol=1e-5)


def test_units_do_not_matter():
    C = np.array([np.diag([0.02, 0.05]) * f for f in (0.5, 1.0, 2.0, 1.0, 3.0, 0.2)])
    x = draw(6, np.diag([0.3, 0.2]), C, mean=[1.0, 2.0])
    unit = np.array([1e-9, 1e6])
    a = estimate_scatter(x, invert(C), is_full=True)
    b = estimate_scatter(x * unit, invert(C) / unit / unit[:, None], is_full=True)
    np.testing.assert_allclose(b.mean, a.mean * unit, rtol=1e-6)
    np.testing.assert_allclose(b.covariance, a.covariance * unit * unit[:, None], rtol=1e-5)


def invert(C):
    return np.linalg.solve(C, np.broadcast_to(np.eye(C.shape[-1]), C.shape))


def restricted(theta, x, C):
    """-2 log of the restricted likelihood of log variances, by its definition: contrasts of x."""
    m, n = x.shape
    V = np.zeros((m * n, m * n))
    for i in range(m):
        V[i * n : (i + 1) * n, i * n : (i + 1) * n] = np.diag(np.exp(theta)) + C[i]
    contrasts = np.kron(np.linalg.svd(np.ones((1, m)))[2][1:], np.eye(n))
    return -2.0 * multivariate_normal(cov=contrasts @ V @ contrasts.T).logpdf(contrasts @ x.ravel())


def test_unequal_errors_maximise_the_restricted_likelihood():
    rng = np.random.default_rng(4)
    C = np.array([np.diag(size) for size in rng.uniform(0.01, 0.3, (15, 2))])
    x = draw(15, np.diag([0.2, 0.4]), C, seed=5)
    found = estimate_scatter(x, invert(C), is_full=False)
    best = scipy.optimize.minimize(
        restricted, np.log([0.2, 0.4]), (x, C), method="Nelder-Mead", options={"xatol": 1e-7}
    )
    np.testing.assert_allclose(np.diag(found.covariance), np.exp(best.x), rtol=1e-4)
    assert found.covariance[0, 1] == 0.0


def test_a_combination_that_a_specimen_does_not_determine_has_no_weight():
    """The second quantity of half of the specimens is unknown: an enormous error says the same."""
    C = np.array([np.diag([0.02, 0.05])] * 10)
    x = draw(10, np.array([[0.3, 0.1], [0.1, 0.2]]), C, seed=2)
    information = invert(C)
    information[::2, 1, 1] = 0.0
    known = estimate_scatter(x, information, is_full=True)
    C[::2, 1, 1] = 1e10
    far = estimate_scatter(x, invert(C), is_full=True)
    np.testing.assert_allclose(known.covariance, far.covariance, rtol=1e-4)
    np.testing.assert_allclose(known.values, far.values, rtol=1e-4, atol=1e-6)


def test_equal_specimens_have_no_scatter_and_a_uniform_p_value():
    C = np.array([np.eye(2)] * 8)
    p_values = []
    for seed in range(300):
        x = draw(8, np.zeros((2, 2)), C, seed=seed)
        square = np.sum((x - x.mean(axis=0)) ** 2)
        found = estimate_scatter(x, C, is_full=False)
        assert found.p_value == pytest.approx(chi2.sf(square, 14))
        p_values.append(found.p_value)
    assert 0.2 < np.mean(np.array(p_values) < 0.25) < 0.3
