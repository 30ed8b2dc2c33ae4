"""Regularised linear problems against explicit solves, on Shaw's image restoration problem and on one by hand."""

import numpy as np
import pytest
import scipy.optimize

from updyn.updating.fit.regularisation import SingularSpectrum, corner, discrepancy, minimum

RNG = np.random.default_rng(5)


def shaw(n):
    """Shaw's one-dimensional image restoration (J. Math. Anal. Appl. 37 (1972) 83), by the midpoint rule.

    K(s, t) = (cos s + cos t)^2 (sin u / u)^2, u = pi (sin s + sin t) and f(t) = 2 exp(-6 (t -
    0.8)^2) + exp(-2 (t + 0.5)^2) on [-pi/2, pi/2]: the test problem `shaw` of Hansen's
    Regularization Tools (Numer. Algorithms 6 (1994) 1)."""
    t = (np.arange(n) + 0.5) * np.pi / n - np.pi / 2
    s = t[:, None]
    K = (np.pi / n) * (np.cos(s) + np.cos(t)) ** 2 * np.sinc(np.sin(s) + np.sin(t)) ** 2
    x = 2.0 * np.exp(-6.0 * (t - 0.8) ** 2) + np.exp(-2.0 * (t + 0.5) ** 2)
    return K, x


@pytest.fixture(params=[1e-3, 1e-2, 1e-1])
def problem(request):
    """Shaw's problem with 32 points, its noise scaled to 1; A, b, x."""
    A, x = shaw(32)
    rng = np.random.default_rng(int(1e4 * request.param))
    return A / request.param, A @ x / request.param + rng.standard_normal(32), x


def solve(A, b, strength):
    """Tikhonov's solution by stacking: an independent way."""
    stacked = np.vstack([A, strength * np.eye(A.shape[1])])
    return np.linalg.lstsq(stacked, np.append(b, np.zeros(A.shape[1])))[0]


def gcv(A, b, strength):
    """By its definition, with the influence matrix A (A^T A + strength^2 I)^-1 A^T."""
    influence = A @ np.linalg.solve(A.T @ A + strength**2 * np.eye(A.shape[1]), A.T)
    m = len(b)
    return (np.sum((b - influence @ b) ** 2) / m) / (np.trace(np.eye(m) - influence) / m) ** 2


@pytest.mark.parametrize("strength", [0.03, 1.0, 40.0])
@pytest.mark.parametrize("shape", [(9, 5), (5, 5), (4, 6)])
def test_solution_misfit_distance_and_freedom(shape, strength):
    A, b = 10.0 * RNG.standard_normal(shape), 10.0 * RNG.standard_normal(shape[0])
    spectrum, z = SingularSpectrum.of(A, b), solve(A, b, strength)
    shares = spectrum.tikhonov_filter(strength)
    assert spectrum.solution(shares) == pytest.approx(z, rel=1e-9, abs=1e-12)
    assert spectrum.misfit(shares) == pytest.approx(np.linalg.norm(A @ z - b), rel=1e-9)
    assert spectrum.distance(shares) == pytest.approx(np.linalg.norm(z), rel=1e-9)
    influence = A @ np.linalg.solve(A.T @ A + strength**2 * np.eye(shape[1]), A.T)
    assert spectrum.freedom(shares) == pytest.approx(np.trace(influence), rel=1e-9)
    if shape[0] > shape[1]:
        assert spectrum.gcv(shares) == pytest.approx(gcv(A, b, strength), rel=1e-9)


def test_truncated_singular_values_are_the_pseudo_inverse():
    A, b = RNG.standard_normal((12, 7)), RNG.standard_normal(12)
    spectrum = SingularSpectrum.of(A, b)
    U, s, Vt = np.linalg.svd(A, full_matrices=False)
    for k in range(1, 8):
        Ak = (U[:, :k] * s[:k]) @ Vt[:k]
        z = np.linalg.pinv(Ak, rcond=1e-10) @ b
        assert spectrum.solution(spectrum.truncation_filter(k)) == pytest.approx(
            z, rel=1e-10, abs=1e-12
        )
        assert spectrum.misfit(spectrum.truncation_filter(k)) == pytest.approx(
            np.linalg.norm(A @ z - b), rel=1e-10
        )


def test_a_reduced_problem_is_the_whole_one():
    """R and q of the QR factors, and what they leave."""
    A, b = RNG.standard_normal((30, 4)), RNG.standard_normal(30)
    Q, R = np.linalg.qr(A)
    q = Q.T @ b
    whole, reduced = SingularSpectrum.of(A, b), SingularSpectrum.of(R, q, float(b @ b - q @ q), 30)
    for strength in (0.1, 3.0):
        shares = whole.tikhonov_filter(strength)
        assert reduced.gcv(shares) == pytest.approx(whole.gcv(shares), rel=1e-12)
        assert reduced.curvature(strength) == pytest.approx(whole.curvature(strength), rel=1e-9)


def test_gcv_is_at_the_minimum_of_its_formula(problem):
    A, b, _ = problem
    found = minimum(SingularSpectrum.of(A, b), 1e-3, 1e3)
    grid = np.geomspace(1e-3, 1e3, 300)
    best = grid[np.argmin([gcv(A, b, g) for g in grid])]
    direct = scipy.optimize.minimize_scalar(
        lambda t: gcv(A, b, np.exp(t)), bounds=np.log([best / 1.06, best * 1.06]), method="bounded"
    )
    assert found == pytest.approx(np.exp(direct.x), rel=1e-3)


def test_the_corner_is_where_differences_curve_most(problem):
    """Curvature of (log misfit, log distance) by central differences of explicit solves, on a grid."""
    A, b, _ = problem
    logs = np.linspace(np.log(0.02), np.log(50.0), 800)
    z = [solve(A, b, np.exp(t)) for t in logs]
    X = np.log([np.linalg.norm(A @ v - b) for v in z])
    Y = np.log([np.linalg.norm(v) for v in z])
    dX, dY = np.gradient(X, logs), np.gradient(Y, logs)
    kappa = (dX * np.gradient(dY, logs) - np.gradient(dX, logs) * dY) / (dX**2 + dY**2) ** 1.5
    spectrum = SingularSpectrum.of(A, b)
    middle = slice(20, -20)
    mine = np.array([spectrum.curvature(float(np.exp(t))) for t in logs])
    assert mine[middle] == pytest.approx(kappa[middle], abs=2e-2 * np.abs(kappa).max())
    found = corner(spectrum, float(np.exp(logs[20])), float(np.exp(logs[-20])))
    assert np.log(found) == pytest.approx(logs[middle][np.argmax(kappa[middle])], abs=0.03)


@pytest.mark.parametrize("choice", [minimum, corner, discrepancy])
def test_each_choice_finds_the_image_that_plain_least_squares_loses(choice):
    """Over 20 draws the median error is close to that of the best strength; GCV sometimes misses it, as is known."""
    A, x = shaw(32)
    A, rng, errors = A / 1e-2, np.random.default_rng(0), []
    for _ in range(20):
        b = A @ x + rng.standard_normal(32)
        spectrum = SingularSpectrum.of(A, b)
        best = min(
            np.linalg.norm(spectrum.solution(spectrum.tikhonov_filter(g)) - x)
            for g in np.geomspace(1e-3, 1e3, 60)
        )
        error = np.linalg.norm(
            spectrum.solution(spectrum.tikhonov_filter(choice(spectrum, 1e-3, 1e3))) - x
        )
        errors.append((error, best, np.linalg.norm(np.linalg.lstsq(A, b)[0] - x)))
    error, best, plain = np.median(errors, axis=0)
    assert error < 2.0 * best < 1e-3 * plain


def test_discrepancy_by_hand():
    """One singular value: what is given up holds its noise and a standard deviation more."""
    s, beta = 10.0, 5.0
    spectrum = SingularSpectrum(np.array([s]), np.array([beta]), np.eye(1), 0.0, 1.0)
    strength = discrepancy(spectrum, 1e-3, 1e3)
    g = strength**2 / (s**2 + strength**2)
    assert g * beta**2 == pytest.approx(1.0 + np.sqrt(2.0), rel=1e-6)
    quiet = SingularSpectrum(np.array([s]), np.array([0.5]), np.eye(1), 0.0, 1.0)
    assert discrepancy(quiet, 1e-3, 1e3) == 1e3


def test_unknowns_that_are_not_regularised_take_up_their_freedom():
    A, b = RNG.standard_normal((20, 3)), RNG.standard_normal(20)
    spectrum = SingularSpectrum.of(A, b, fixed=2)
    assert spectrum.freedom(spectrum.truncation_filter(3)) == 5
    assert spectrum.gcv(spectrum.truncation_filter(3)) == pytest.approx(
        20 * spectrum.misfit(spectrum.truncation_filter(3)) ** 2 / 15**2
    )
