"""Bound of the structured singular value: textbook, closed forms, and the largest rho(M U) over phases."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from updyn.control.servo.structured import largest_bound, upper_bound


def by_phases(M: np.ndarray) -> float:
    """mu of scalar blocks: the largest spectral radius of M U, U = diag(exp(i phi)) (Doyle 1982)."""

    def radius(phases: np.ndarray) -> float:
        turned = M * np.exp(1j * np.concatenate([[0.0], phases]))
        return -float(np.abs(np.linalg.eigvals(turned)).max())

    rng = np.random.default_rng(0)
    starts = rng.uniform(-np.pi, np.pi, (24, len(M) - 1))
    return -min(minimize(radius, x, method="Nelder-Mead", tol=1e-10).fun for x in starts)


def random(n: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n))


def test_the_example_of_the_textbook() -> None:
    """Skogestad & Postlethwaite (2005), section 8.8: 3 of a diagonal, sqrt(10) of a full Delta."""
    M = np.array([[2.0, 2.0], [-1.0, -1.0]], dtype=complex)
    assert upper_bound(M, (1, 1)) == pytest.approx(3.0, rel=1e-9)
    assert upper_bound(M, (2,)) == pytest.approx(np.sqrt(10.0), rel=1e-12)


@pytest.mark.parametrize("n", [1, 2, 3, 6])
def test_a_matrix_of_rank_one(n: int) -> None:
    """det(I - a b^T Delta) = 1 - sum a_i b_i delta_i: mu = sum |a_i b_i|."""
    rng = np.random.default_rng(n)
    a, b = rng.standard_normal((2, n)) * 10.0 ** rng.uniform(-4, 4, (2, n))
    M = np.outer(a * np.exp(1j * np.arange(n)), b)
    assert upper_bound(M, (1,) * n) == pytest.approx(np.abs(a * b).sum(), rel=1e-9)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("n", [2, 3])
def test_two_and_three_scalars_are_exact(n: int, seed: int) -> None:
    M = random(n, seed)
    assert upper_bound(M, (1,) * n) == pytest.approx(by_phases(M), rel=2e-3)
    assert upper_bound(M, (1,) * n) >= by_phases(M) * (1.0 - 1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_more_blocks_are_bounded(seed: int) -> None:
    """Between the lower bound by phases and the largest singular value."""
    M = random(5, seed)
    found = upper_bound(M, (1,) * 5)
    assert by_phases(M) * (1.0 - 1e-9) <= found < np.linalg.norm(M, 2)


def test_full_blocks() -> None:
    """Of two full blocks without coupling the larger singular value; scaled, of the same mu."""
    M = np.zeros((5, 5), dtype=complex)
    M[:2, :2], M[2:, 2:] = random(2, 0), random(3, 1)
    own = [np.linalg.norm(M[:2, :2], 2), np.linalg.norm(M[2:, 2:], 2)]
    assert upper_bound(M, (2, 3)) == pytest.approx(max(own), rel=1e-9)
    whole = random(5, 2)
    d = np.repeat([1.0, 300.0], [2, 3])
    scaled = d[:, None] * whole / d
    assert upper_bound(scaled, (2, 3)) == pytest.approx(upper_bound(whole, (2, 3)), rel=1e-4)
    assert upper_bound(whole, (2, 3)) <= np.linalg.norm(whole, 2)


def test_what_no_perturbation_makes_singular() -> None:
    """A triangular M with zeros on its diagonal: det(I - M Delta) = 1."""
    M = np.array([[0.0, 5.0], [0.0, 0.0]], dtype=complex)
    assert upper_bound(M, (1, 1)) < 5.0
    assert upper_bound(np.zeros((2, 2), dtype=complex), (1, 1)) < 1e-200


def test_the_largest_of_a_stack() -> None:
    stack = np.array([random(3, seed) for seed in range(8)])
    every = [upper_bound(M, (1, 1, 1)) for M in stack]
    value, at = largest_bound(stack, (1, 1, 1))
    assert at == int(np.argmax(every))
    assert value == max(every)
