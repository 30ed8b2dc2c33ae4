"""Harmonic balance at one frequency: exact derivatives, mean values, truncation."""

from __future__ import annotations

import numpy as np
import pytest

import updyn
from periodic_cases import balance_of, oscillator, two_masses
from updyn.dynamics.periodic.first import solve_first
from updyn.dynamics.periodic.newton import solve_at

ELEMENTS = {
    "cubic": updyn.CubicSpring(30.0),
    "polynomial": updyn.PolynomialSpring({2: 20.0, 5: 80.0}),
    "backlash": updyn.Backlash(500.0, gap=0.3, offset=0.1),
    "friction": updyn.CoulombFriction(3.0, transition=2.0),
    "Jenkins": updyn.JenkinsElement(100.0, slip_force=8.0),
    "Iwan": updyn.IwanJoint(8.0, 100.0, -0.5, 0.2),
    "damper": updyn.QuadraticDamper(0.7),
}


@pytest.mark.parametrize("name", ELEMENTS)
@pytest.mark.parametrize("damping", [{"loss_factor": 0.1}, {"stiffness_damping": 0.01}])
def test_derivatives_are_exact(name: str, damping) -> None:
    model = two_masses(**damping).with_elements({"a": (ELEMENTS[name], ["1:X", "2:X"])})
    model = model.with_elements({"b": (ELEMENTS["cubic"], "1:X")})
    balance, rng, h = balance_of(model, 4), np.random.default_rng(4), 1e-7
    x, omega = 0.3 * rng.standard_normal((2, 9)), 7.0
    found, direction = balance.evaluate(x, omega), rng.standard_normal((2, 9))

    def change(dx: np.ndarray | float, domega: float) -> np.ndarray:
        more, less = (balance.evaluate(x + s * dx, omega + s * domega).residual for s in (1, -1))
        return (more - less).ravel() / (2 * h)

    exact = found.jacobian @ direction.ravel()
    assert np.abs(change(h * direction, 0.0) - exact).max() < 1e-5 * np.abs(exact).max()
    size = np.abs(found.by_omega).max()
    assert np.abs(change(0.0, h).reshape(2, 9) - found.by_omega).max() < 1e-5 * size


def test_the_mean_meets_the_real_stiffness() -> None:
    """u + c u^2 with structural damping: A_0 + c (A_0^2 + |A_1|^2 / 2) = 0 for one harmonic."""
    c = 0.4
    model = oscillator(loss=0.3).with_elements({"a": (updyn.PolynomialSpring({2: c}), "1:X")})
    found = solve_first(balance_of(model, 1, level=0.3), 0.8)
    assert found is not None
    mean, real, imag = found.x[0]
    assert mean == pytest.approx(-c * (mean**2 + 0.5 * (real**2 + imag**2)), rel=1e-9)
    assert mean < -0.01


def test_a_large_force_is_reached_by_smaller_ones() -> None:
    model = oscillator(viscous=0.02).with_elements({"a": (updyn.Backlash(40.0, gap=0.1), "1:X")})
    balance = balance_of(model, 9, level=30.0)
    found = solve_first(balance, 2.0)
    assert found is not None
    assert np.abs(found.residual).max() < 1e-9 * np.abs(found.x).max()
    assert solve_at(balance, found.x, 2.0) is not None


def test_truncation_error_is_that_of_fewer_harmonics() -> None:
    model = oscillator(viscous=0.1).with_elements({"a": (updyn.CubicSpring(2.0), "1:X")})
    many = solve_first(balance_of(model, 25), 0.6)
    assert many is not None
    for harmonics in (1, 3, 5):
        balance = balance_of(model, harmonics)
        found = solve_first(balance, 0.6)
        assert found is not None
        Q = balance.fourier.to_complex(found.x)
        exact = balance_of(model, 25).fourier.to_complex(many.x)
        Q = np.pad(Q, ((0, 0), (0, exact.shape[1] - Q.shape[1])))
        error = np.linalg.norm(Q - exact) / np.linalg.norm(exact)
        assert 0.3 * error < balance.truncation(found) < 3.0 * error
