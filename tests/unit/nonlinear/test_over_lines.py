"""Forces over a period at many lines against those of each line."""

import numpy as np
import pytest

import updyn
from updyn.nonlinear.over_lines import LineForces

N = 64
TAU = 2.0 * np.pi * np.arange(N) / N
ELEMENTS = [
    updyn.CubicSpring(3.0),
    updyn.PolynomialSpring({1: 1.0, 2: 0.5, 5: -0.1}),
    updyn.Backlash(2.0, 0.5, offset=0.1),
    updyn.JenkinsElement(2.0, 0.7),
    updyn.IwanJoint(0.8, 2.0, -0.4, 0.3),
    updyn.CoulombFriction(0.5, transition=0.3),
    updyn.QuadraticDamper(0.6),
]


@pytest.fixture
def motions():
    """Two smooth loops, one with a mean, and one with more reversals than two."""
    u = np.stack(
        [
            np.cos(TAU - 0.3),
            0.2 + 1.4 * np.cos(TAU + 1.0) + 0.1 * np.cos(3 * TAU),
            np.cos(TAU) + 0.8 * np.cos(3 * TAU + 1.1) - 0.1,
            -0.7 * np.cos(TAU - 2.0),
        ]
    )
    v = np.random.default_rng(0).standard_normal(u.shape)
    return u, v


@pytest.mark.parametrize("element", ELEMENTS, ids=lambda e: type(e).__name__)
def test_forces_and_derivatives_are_those_of_each_line(element, motions) -> None:
    u, v = motions
    found = LineForces.of(element, u, v)
    for i in range(len(u)):
        one = element.over_period(u[i], v[i])
        np.testing.assert_allclose(found.force[i], one.force, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(found.damping[i], one.damping, rtol=1e-12)
        np.testing.assert_allclose(found.parameters[i], one.parameters, rtol=1e-12, atol=1e-13)
        stiffness = np.diag(found.stiffness[i])
        for column, weights in zip(found.earlier[i], found.memory[i].T, strict=True):
            stiffness[:, column] += weights
        np.testing.assert_allclose(stiffness, one.stiffness.toarray(), rtol=1e-12, atol=1e-13)
