"""Solutions of the balance at the lines of a measurement: further ones next to known ones."""

from __future__ import annotations

import numpy as np
import pytest

import updyn
from updyn.dynamics.periodic.at_lines import LineBalance
from updyn.dynamics.periodic.balance import make_fourier

OMEGA, LEVEL, VISCOUS = 1.6, 0.5, 0.1


@pytest.fixture
def lines() -> LineBalance:
    """A Duffing oscillator at a line at which it has three motions."""
    H = np.full((1, 1, 2, 2), 1.0 / (1.0 - OMEGA**2 + 1j * VISCOUS * OMEGA))
    fourier = make_fourier(is_free=True, harmonics=1, samples=64)
    return LineBalance([updyn.CubicSpring(1.0)], fourier, np.array([OMEGA]), np.array([LEVEL]), H)


def list_motions() -> np.ndarray:
    """Motions by increasing amplitude: ((1 - w^2 + 3/4 A^2)^2 + (c w)^2) A^2 = F^2."""
    k, c = 1.0 - OMEGA**2, VISCOUS * OMEGA
    squares = np.roots([0.5625, 1.5 * k, k**2 + c**2, -(LEVEL**2)])
    A = np.sqrt(np.sort(squares.real))
    assert np.abs(squares.imag).max() == 0.0
    return LEVEL / (k + 0.75 * A**2 + 1j * c)


def test_iterations_do_not_end_at_a_known_motion(lines):
    low, middle, high = (lines.to_coordinates(q.reshape(1, 1, 1)) for q in list_motions())
    at, start = np.array([0]), 1.02 * middle
    found, is_found = lines.solve(start, at)
    assert is_found[0]
    np.testing.assert_allclose(found, middle, rtol=1e-6)
    assert not lines.is_stable(lines.evaluate(found, at))[0]

    other, is_found = lines.deflate(middle, at).solve(start, at)
    assert is_found[0]
    assert lines.is_stable(lines.evaluate(other, at))[0]
    assert min(np.abs(other - one).max() / np.abs(one).max() for one in (low, high)) < 1e-6


def test_the_derivative_of_a_deflated_balance_is_that_of_differences(lines):
    low, middle, _ = (lines.to_coordinates(q.reshape(1, 1, 1)) for q in list_motions())
    at, share = np.array([0]), np.ones(1)
    deflated, x = lines.deflate(middle, at), low + 0.3 * (middle - low)
    _, J, _ = deflated._balance(x, at, share)
    for n, step in enumerate(np.eye(2).reshape(2, 1, 1, 2) * 1e-6):
        R = [deflated._balance(x + sign * step, at, share)[0][0] for sign in (1.0, -1.0)]
        np.testing.assert_allclose(J[0, :, n], (R[0] - R[1]) / 2e-6, rtol=1e-6)
