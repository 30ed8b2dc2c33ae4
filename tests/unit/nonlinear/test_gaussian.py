"""Statistical linearisation of elements against closed forms and against definitions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import erf, erfc

from updyn.errors import OptionError
from updyn.nonlinear import ELEMENTS
from updyn.nonlinear.backlash import Backlash
from updyn.nonlinear.cubic import CubicSpring
from updyn.nonlinear.damper import QuadraticDamper
from updyn.nonlinear.element import AmplitudeElement
from updyn.nonlinear.friction import CoulombFriction
from updyn.nonlinear.gaussian import derive_linear_force, linearise
from updyn.nonlinear.iwan import IwanJoint
from updyn.nonlinear.jenkins import JenkinsElement
from updyn.nonlinear.parameters import change_parameters, list_parameters
from updyn.nonlinear.polynomial import PolynomialSpring

CASES = {
    "cubic-spring": CubicSpring(-3.0),
    "polynomial-spring": PolynomialSpring({1: 2.0, 2: -1.0, 3: 0.5, 5: 4.0}),
    "backlash": Backlash(stiffness=40.0, gap=0.3, offset=0.04),
    "coulomb-friction": CoulombFriction(2.0, transition=0.3),
    "jenkins": JenkinsElement(stiffness=7.0, slip_force=1.1),
    "iwan": IwanJoint(slip_force=3.0, stiffness=20.0, chi=-0.4, beta=0.3),
    "quadratic-damper": QuadraticDamper(0.7),
}


def phi(x):
    """Return the normal density."""
    return np.exp(-(x**2) / 2) / np.sqrt(2 * np.pi)


def same(found, mean, stiffness, damping, rtol=1e-8):
    values = found.mean, found.stiffness, found.damping
    np.testing.assert_allclose(values, (mean, stiffness, damping), rtol=rtol, atol=1e-300)


@pytest.mark.parametrize("sigma", [0.03, 1.0, 40.0])
def test_a_cubic_spring_has_three_times_the_variance(sigma):
    same(linearise(CubicSpring(-3.0), sigma, 2.0), 0.0, -9.0 * sigma**2, 0.0)


@pytest.mark.parametrize("sigma", [0.03, 1.0, 40.0])
@pytest.mark.parametrize("mean", [0.0, 0.2])
def test_a_polynomial_has_gaussian_moments(sigma, mean):
    """The stiffness is the mean slope (Stein's identity)."""
    x, s = mean, sigma
    spring = PolynomialSpring({1: 2.0, 2: -1.0, 3: 0.5, 5: 4.0})
    force = 2 * x - (x**2 + s**2) + 0.5 * (x**3 + 3 * x * s**2)
    force += 4.0 * (x**5 + 10 * x**3 * s**2 + 15 * x * s**4)
    slope = 2 - 2 * x + 1.5 * (x**2 + s**2) + 20 * (x**4 + 6 * x**2 * s**2 + 3 * s**4)
    same(linearise(spring, s, 2.0, x), force, slope, 0.0)


@pytest.mark.parametrize("sigma", [0.05, 0.15, 3.0])
def test_a_centred_gap_is_the_share_of_time_in_contact(sigma):
    """The force begins at half the gap, as in the class."""
    gap = Backlash(stiffness=40.0, gap=0.3)
    same(linearise(gap, sigma, 2.0), 0.0, 40.0 * erfc(0.15 / sigma / np.sqrt(2)), 0.0)


@pytest.mark.parametrize("offset", [0.04, 0.4])
def test_a_gap_with_an_offset_has_a_mean_force(offset):
    s, k = 0.2, 40.0
    high, low = (offset + 0.15) / s, (offset - 0.15) / s
    share = 1 - 0.5 * (erf(high / np.sqrt(2)) - erf(low / np.sqrt(2)))
    # The mean of (s z - s high) above `high`, and of (s z - s low) below `low`.
    above = phi(high) - high * 0.5 * erfc(high / np.sqrt(2))
    below = -phi(low) - low * 0.5 * erfc(-low / np.sqrt(2))
    found = linearise(Backlash(k, gap=0.3, offset=offset), s, 2.0)
    same(found, k * s * (above + below), k * share, 0.0)


@pytest.mark.parametrize("sigma_v", [0.01, 1.0, 50.0])
def test_dampers_have_their_closed_forms(sigma_v):
    dry = 5.0 * np.sqrt(2 / np.pi) / sigma_v
    same(linearise(CoulombFriction(5.0), 0.3, sigma_v), 0.0, 0.0, dry)
    quadratic = np.sqrt(8 / np.pi) * 0.7 * sigma_v
    same(linearise(QuadraticDamper(0.7), 0.3, sigma_v), 0.0, 0.0, quadratic)


@pytest.mark.parametrize("width", [1e-3, 0.3, 3.0])
def test_friction_with_a_transition_is_the_mean_slope(width):
    def slope(z):
        return phi(z) * 5.0 / width / np.cosh(z / width) ** 2

    half, _ = quad(slope, 0.0, min(10.0, 300 * width), epsabs=0.0, epsrel=1e-12, points=[width])
    same(linearise(CoulombFriction(5.0, transition=width), 0.3, 1.0), 0.0, 0.0, 2 * half)


def test_a_slider_that_sticks_and_one_that_slips():
    """Without slip it is its spring; with much slip, it dissipates as dry friction does."""
    k, F, s, s_v = 7.0, 1.1, 0.4, 2.0
    sticks = linearise(JenkinsElement(k, 100.0), s, s_v)
    assert sticks.stiffness == pytest.approx(k, rel=1e-10)
    assert abs(sticks.damping) < 1e-10 * k * s / s_v
    slips = linearise(JenkinsElement(k * 1e4, F), s, s_v)
    assert slips.damping == pytest.approx(F * np.sqrt(2 / np.pi) / s_v, rel=1e-3)


@pytest.mark.parametrize("ratio", [0.05, 1.0, 4.0])
def test_a_slider_is_its_describing_function_over_rayleigh_amplitudes(ratio):
    k, F, w = 7.0, 1.1, 3.0
    s, element = ratio * F / k, JenkinsElement(k, F)

    def moment(r, part):
        return (
            0.5
            * r**3
            * np.exp(-(r**2) / 2)
            * getattr(complex(element.describing(s * r, 1.0)), part)
        )

    def expected(part):
        ends = [(1e-9, min(1 / ratio, 10.0)), (min(1 / ratio, 10.0), 12.0)]
        return sum(quad(moment, *one, (part,), epsabs=0.0, epsrel=1e-11)[0] for one in ends)

    found = linearise(element, s, w * s)
    assert found.stiffness == pytest.approx(expected("real"), rel=1e-8)
    assert found.damping * w == pytest.approx(expected("imag"), rel=1e-8, abs=1e-10 * k)


@pytest.mark.parametrize("element", [JenkinsElement(7.0, 1.1), IwanJoint(3.0, 20.0, -0.4, 0.3)])
def test_elements_with_memory_have_the_least_error_over_sines(element):
    """Least squares over sines whose amplitudes have the Rayleigh distribution."""
    s, w, n = 0.25, 3.0, 256
    A = s * np.sqrt(-2 * np.log((np.arange(400) + 0.5) / 400))
    t = 2 * np.pi * np.arange(n) / n
    u, v = A[:, None] * np.cos(t), -w * A[:, None] * np.sin(t)
    f = np.array([element.over_period(*line).force for line in zip(u, v, strict=True)])
    fit, *_ = np.linalg.lstsq(np.stack([u.ravel(), v.ravel()], axis=1), f.ravel(), rcond=None)
    found = linearise(element, s, w * s)
    np.testing.assert_allclose([found.stiffness, found.damping], fit, rtol=5e-3)


def test_a_narrow_band_gives_the_same_result_without_memory():
    """The average of the describing function over amplitudes is the Gaussian integral."""
    s = 0.25
    for element in (CubicSpring(-3.0), Backlash(40.0, gap=0.3)):
        r = np.linspace(1e-9, 10.0, 200_001)
        N = element.describing(s * r, 1.0).real
        stiffness = np.trapezoid(0.5 * r**3 * np.exp(-(r**2) / 2) * N, r)
        assert linearise(element, s, 1.0).stiffness == pytest.approx(stiffness, rel=1e-8)


@pytest.mark.parametrize("name", ELEMENTS)
def test_every_element_can_be_linearised(name):
    found = linearise(CASES[name], 0.3, 1.2)
    assert np.isfinite([found.mean, found.stiffness, found.damping]).all()
    assert (found.stiffness, found.damping) != (0.0, 0.0)


def test_a_force_of_deformation_and_velocity_is_refused():
    @dataclass(frozen=True, slots=True)
    class Mixed(AmplitudeElement):
        has_memory, quantity, is_odd, parameters = False, "receptance", True, ()

        def over_period(self, u, v):
            spring = CubicSpring(1.0).over_period(u, v)
            damper = QuadraticDamper(1.0).over_period(u, v)
            force = spring.force + damper.force
            return type(spring)(force, spring.stiffness, damper.damping, spring.parameters)

        def _describe(self, A):
            raise NotImplementedError

    with pytest.raises(OptionError, match="depends on deformation and velocity"):
        linearise(Mixed(), 1.0, 1.0)


@pytest.mark.parametrize(
    ("name", "mean"),
    [*((name, 0.0) for name in ELEMENTS), ("polynomial-spring", 0.05), ("backlash", 0.05)],
)
def test_derivatives_are_central_differences(name, mean):
    """Those by parameters included; forces with kinks have derivatives that jump."""
    element, at = CASES[name], np.array([mean, 0.3, 1.2])
    known = list_parameters(element)
    names, values = list(known), np.array(list(known.values()))

    def force(y):
        other = change_parameters(element, dict(zip(names, y[3:].tolist(), strict=True)))
        found = linearise(other, y[1], y[2], y[0])
        return np.array([found.mean, found.stiffness, found.damping])

    y = np.concatenate([at, values])
    steps = 1e-4 * np.maximum(np.abs(y), 0.1)
    columns = [(force(y + h) - force(y - h)) / (2 * h.max()) for h in np.diag(steps)]
    expected = np.stack(columns, axis=1)
    found = derive_linear_force(element, 0.3, 1.2, mean)
    size = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6 * size)
