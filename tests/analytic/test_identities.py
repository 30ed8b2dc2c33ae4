"""The identities of docs/proofs.md, by numbers, on random models that have nothing special."""

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg

N, RETAINED, OMEGA = 9, 4, 3.0


def symmetric(rng, shift=0.0):
    A = rng.standard_normal((N, N))
    return A @ A.T / N + shift * np.eye(N)


@pytest.fixture
def rng():
    return np.random.default_rng(5)


@pytest.fixture
def parts(rng):
    """Two stiffnesses, two masses; loss factors of 0.1 and 0.3."""
    return [symmetric(rng, 1.0) for _ in range(4)]


def stiffness(parts, p):
    K1, K2, M1, M2 = parts
    return p[0] * (1 + 0.1j) * K1 + (1 + 1j * p[3]) * K2 - OMEGA**2 * (p[1] * M1 + p[2] * M2)


P = np.array([1.2, 0.8, 0.9, 0.3])


def receptance(Z):
    return np.linalg.solve(Z, np.eye(N))


def condensed(Z):
    n = slice(RETAINED)
    s = slice(RETAINED, None)
    T = np.vstack([np.eye(RETAINED), -np.linalg.solve(Z[s, s], Z[s, n])])
    return T.T @ Z @ T, T


def slopes(parts):
    K1, K2, M1, M2 = parts
    return [(1 + 0.1j) * K1, -(OMEGA**2) * M1, -(OMEGA**2) * M2, 1j * K2]


def central(function, i, step=1e-6):
    moved = np.eye(4)[i] * step
    return (function(P + moved) - function(P - moved)) / (2 * step)


def test_condensed_is_the_inverse_of_the_measured_receptance(parts):
    Z = stiffness(parts, P)
    Z_red, T = condensed(Z)
    H = receptance(Z)[:RETAINED, :RETAINED]
    assert Z_red @ H == pytest.approx(np.eye(RETAINED), abs=1e-11)
    assert (Z @ T)[RETAINED:] == pytest.approx(0.0, abs=1e-11)


@pytest.mark.parametrize("i", range(4))
def test_derivatives(parts, i):
    Z, dZ = stiffness(parts, P), slopes(parts)[i]
    _, T = condensed(Z)
    found = central(lambda p: condensed(stiffness(parts, p))[0], i)
    assert T.T @ dZ @ T == pytest.approx(found, rel=1e-6, abs=1e-6 * np.abs(found).max())
    H = receptance(Z)
    found = central(lambda p: receptance(stiffness(parts, p)), i)
    assert -H @ dZ @ H == pytest.approx(found, rel=1e-6, abs=1e-6 * np.abs(found).max())


def test_equation_error_is_output_error_multiplied(parts):
    Z_A, Z_X = stiffness(parts, P), stiffness(parts, P * [2.0, 0.5, 1.5, 0.1])
    H_A, H_X = receptance(Z_A), receptance(Z_X)
    product = H_A @ (Z_X - Z_A) @ H_X
    assert product == pytest.approx(H_A - H_X, rel=1e-9, abs=1e-12)
    Z_red, _ = condensed(Z_A)
    h_A, h_X = H_A[:RETAINED, 0], H_X[:RETAINED, 0]
    assert Z_red @ h_X - np.eye(RETAINED)[0] == pytest.approx(Z_red @ (h_X - h_A), abs=1e-11)


def test_error_of_a_reduced_model(parts, rng):
    Z, V = stiffness(parts, P), rng.standard_normal((N, 5))
    i, j = 1, 6
    q = np.linalg.solve(V.T @ Z @ V, V.T)
    R = np.eye(N) - Z @ V @ q
    in_basis = V.T @ R
    assert in_basis == pytest.approx(0.0, abs=1e-10)
    error = receptance(Z) - V @ q
    assert R.T @ np.linalg.solve(Z, R) == pytest.approx(error, rel=1e-8, abs=1e-11)
    y = rng.standard_normal(N)
    assert R[:, i] @ y == pytest.approx(y[i] - q[:, i] @ (V.T @ (Z @ y)), abs=1e-10)
    assert np.abs(error[i, j]) > 1e-6  # there was something to find


def test_inertia_counts_natural_frequencies(parts):
    K, M = parts[0], parts[2]
    squares = scipy.linalg.eigvalsh(K, M)
    for shift in (0.5 * squares[0], 0.5 * (squares[3] + squares[4]), 2.0 * squares[-1]):
        _, D, _ = scipy.linalg.ldl(K - shift * M)
        assert (np.linalg.eigvalsh(D) < 0).sum() == (squares < shift).sum()


def test_drives_by_powers(parts):
    """A thickness: membrane stiffness and mass by its first power, bending by its third."""
    membrane, bending, mass, _ = parts

    def Z(v):
        return v * membrane + v**3 * bending - OMEGA**2 * v * mass

    v, h = 1.3, 1e-6
    terms = [(1, v * membrane), (3, v**3 * bending), (1, -(OMEGA**2) * v * mass)]
    slope = sum(p * term / v for p, term in terms)
    assert slope == pytest.approx((Z(v + h) - Z(v - h)) / (2 * h), rel=1e-7, abs=1e-6)


def test_a_scaled_axis_is_a_scaled_stiffness(parts):
    K, M = (1 + 0.1j) * parts[0], parts[2]
    b = 1.07
    read_at_b = receptance(K - (b * OMEGA) ** 2 * M)
    softer = receptance(K / b**2 - OMEGA**2 * M)
    assert read_at_b == pytest.approx(softer / b**2, rel=1e-10)


def test_an_exponential_window_moves_the_frequency():
    m, c, k, a, omega = 2.0, 0.8, 50.0, 0.7, 4.0
    damped = np.sqrt(k / m - (c / (2 * m)) ** 2)

    def h(t):
        return np.exp(-c / (2 * m) * t) * np.sin(damped * t) / (m * damped)

    parts = [
        scipy.integrate.quad(
            lambda t, wave=wave: h(t) * np.exp(-a * t) * wave(omega * t), 0.0, 60.0, limit=500
        )[0]
        for wave in (np.cos, np.sin)
    ]
    s = a + 1j * omega
    assert parts[0] - 1j * parts[1] == pytest.approx(1.0 / (m * s**2 + c * s + k), rel=1e-8)
