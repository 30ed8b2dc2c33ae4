"""Nonlinear elements: force, derivatives and describing function over one period."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.integrate
from scipy.special import roots_jacobi

from updyn.errors import OptionError
from updyn.nonlinear import ELEMENTS
from updyn.nonlinear.backlash import Backlash
from updyn.nonlinear.cubic import CubicSpring
from updyn.nonlinear.damper import QuadraticDamper
from updyn.nonlinear.friction import CoulombFriction
from updyn.nonlinear.iwan import IwanJoint
from updyn.nonlinear.jenkins import JenkinsElement
from updyn.nonlinear.polynomial import PolynomialSpring

IWAN = IwanJoint(slip_force=3.0, stiffness=20.0, chi=-0.4, beta=0.3)
CASES = {
    "cubic-spring": CubicSpring(-3.0),
    "polynomial-spring": PolynomialSpring({1: 2.0, 2: -1.0, 3: 0.5, 5: 4.0}),
    "backlash": Backlash(stiffness=40.0, gap=0.3, offset=0.04),
    "coulomb-friction": CoulombFriction(2.0, transition=0.3),
    "jenkins": JenkinsElement(stiffness=7.0, slip_force=1.1),
    "iwan": IWAN,
    "quadratic-damper": QuadraticDamper(0.7),
}
OMEGA = 1.7


def period(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return a motion with inner loops, and its velocity."""
    t = 2 * np.pi * np.arange(n) / n
    u, v = np.full(n, 0.05), np.zeros(n)
    for k, size in ((1, 0.5), (2, 0.2), (3, 0.3), (5, 0.1)):
        a, b = size * rng.standard_normal(2)
        u += a * np.cos(k * t) + b * np.sin(k * t)
        v += OMEGA * k * (b * np.cos(k * t) - a * np.sin(k * t))
    return u, v


def test_every_element_is_registered_and_tested() -> None:
    assert {name: ELEMENTS[name] for name in ELEMENTS} == {n: type(e) for n, e in CASES.items()}


@pytest.mark.parametrize("name", CASES)
def test_derivatives_are_those_of_the_force(name: str) -> None:
    element, rng, n, h = CASES[name], np.random.default_rng(3), 64, 1e-6
    u, v = period(n, rng)
    found = element.over_period(u, v)
    du, dv = rng.standard_normal((2, n))
    more, less = (element.over_period(u + s * h * du, v + s * h * dv).force for s in (1, -1))
    exact = found.stiffness @ du + found.damping * dv
    assert np.abs((more - less) / (2 * h) - exact).max() < 1e-6 * np.abs(exact).max()


@pytest.mark.parametrize("name", CASES)
def test_parameter_derivatives_are_those_of_the_force(name: str) -> None:
    element, n = CASES[name], 64
    u, v = period(n, np.random.default_rng(5))
    found, h = element.over_period(u, v), 1e-6
    if name == "polynomial-spring":
        c = element.coefficients
        changed = [[PolynomialSpring({**c, p: c[p] + s * h}) for s in (1, -1)] for p in c]
    else:
        changed = [
            [replace(element, **{p: getattr(element, p) + s * h}) for s in (1, -1)]
            for p in element.parameters
        ]
    assert found.parameters.shape == (n, len(changed))
    for column, (more, less) in zip(found.parameters.T, changed, strict=True):
        force = more.over_period(u, v).force - less.over_period(u, v).force
        assert np.abs(force / (2 * h) - column).max() < 1e-6 * max(1.0, np.abs(column).max())


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("size", [0.1, 0.14, 0.4])
def test_describing_function_is_the_first_harmonic(name: str, size: float) -> None:
    element, n = CASES[name], 2**15
    t = 2 * np.pi * np.arange(n) / n
    u, v = size * np.cos(t), -size * OMEGA * np.sin(t)
    if element.quantity == "mobility":
        u, v = size / OMEGA * np.sin(t), size * np.cos(t)
    force = element.over_period(u, v).force
    first = 2.0 * np.mean(force * np.exp(-1j * t)) / size
    closed = complex(element.describing(size, OMEGA))
    if name == "iwan" and size > element.largest_slip:
        assert np.isnan(closed)
    elif name == "coulomb-friction":  # the closed form is that of the exact law
        sharp = replace(element, transition=1e-3 * size)
        first = 2.0 * np.mean(sharp.over_period(u, v).force * np.exp(-1j * t)) / size
        assert abs(first - closed) < 1e-5 * abs(closed)
    else:
        assert abs(first - closed) < 1e-7 * (1.0 + abs(closed))


def slide(u: np.ndarray, k: float, most: float, periods: int) -> np.ndarray:
    """Return the last period of a slider in series with a spring, which starts without force."""
    force, before, out = 0.0, 0.0, []
    for now in np.tile(u, periods):
        force = float(np.clip(force + k * (now - before), -most, most))
        before = now
        out.append(force)
    return np.array(out[-len(u) :])


def test_jenkins_is_a_slider_in_series_with_a_spring() -> None:
    element = CASES["jenkins"]
    for seed in range(20):
        u, v = period(97, np.random.default_rng(seed))
        expected = slide(u, element.stiffness, element.slip_force, 3)
        if np.ptp(u) > 2.0 * element.slip_force / element.stiffness:
            assert np.abs(element.over_period(u, v).force - expected).max() < 1e-12


def test_iwan_joint_is_a_sum_of_sliders() -> None:
    """The density of slip deformations in Gauss-Jacobi points, each a Jenkins element."""
    u, v = period(150, np.random.default_rng(8))
    y, w = roots_jacobi(400, 0.0, IWAN.chi)
    slip = IWAN.largest_slip * 0.5 * (y + 1.0)
    before = IWAN.stiffness / (1.0 + IWAN.beta)  # stiffness of all but the last to slip
    k = before * w / w.sum()
    last = IWAN.stiffness - before
    force = slide(u, last, last * IWAN.largest_slip, 3)
    for stiffness, at in zip(k, slip, strict=True):
        force += slide(u, stiffness, stiffness * at, 3)
    found = IWAN.over_period(u, v).force
    assert np.abs(found - force).max() < 1e-4 * np.abs(force).max()


def test_iwan_joint_has_the_given_stiffness_and_slip_force() -> None:
    force, slope, _ = IWAN._load(np.array([1e-9, IWAN.largest_slip, 1.0]))
    assert force[1:] == pytest.approx(IWAN.slip_force, rel=1e-14)
    assert force[0] / 1e-9 == pytest.approx(IWAN.stiffness, rel=1e-4)
    assert slope[-1] == 0.0


def test_iwan_joint_loses_the_energy_of_segalman() -> None:
    """Segalman 2005: 4 R A^(chi + 3) / ((chi + 3) (chi + 2)) in a period of microslip."""
    A = 0.5 * IWAN.largest_slip
    density = (
        IWAN.stiffness / (1 + IWAN.beta) * (IWAN.chi + 1) / IWAN.largest_slip ** (IWAN.chi + 1)
    )
    lost = 4 * density * A ** (IWAN.chi + 3) / ((IWAN.chi + 3) * (IWAN.chi + 2))
    assert np.pi * A**2 * complex(IWAN.describing(A, 1.0)).imag == pytest.approx(lost, rel=1e-12)


def test_polynomial_describing_function_by_quadrature() -> None:
    element = PolynomialSpring({1: 2.0, 3: 0.5, 7: 4.0})

    def work(t: float) -> float:
        return sum(c * (0.8 * np.cos(t)) ** p for p, c in element.coefficients.items()) * np.cos(t)

    expected = scipy.integrate.quad(work, 0, 2 * np.pi)[0] / np.pi / 0.8
    assert complex(element.describing(0.8, 1.0)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("element", "expected"),
    [
        (CASES["cubic-spring"], (0.0, 0.0)),
        (CASES["polynomial-spring"], (2.0, 0.0)),
        (CASES["backlash"], (0.0, 0.0)),
        (Backlash(40.0, gap=0.3, damping=2.0, offset=0.16), (40.0, 2.0)),
        (CASES["coulomb-friction"], (0.0, 2.0 / 0.3)),
        (CASES["jenkins"], (7.0, 0.0)),
        (IWAN, (20.0, 0.0)),
        (CASES["quadratic-damper"], (0.0, 0.0)),
    ],
)
def test_at_rest(element, expected: tuple[float, float]) -> None:
    assert element.at_rest() == pytest.approx(expected)


@pytest.mark.parametrize(
    ("name", "odd"), [("polynomial-spring", False), ("backlash", False), ("iwan", True)]
)
def test_oddness(name: str, odd: bool) -> None:
    element = CASES[name]
    u, v = period(64, np.random.default_rng(1))
    reverse = -element.over_period(-u, -v).force
    assert np.allclose(reverse, element.over_period(u, v).force, atol=1e-12) == odd
    assert element.is_odd == odd


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: CubicSpring(np.inf), "cubic spring: coefficient is inf; expected a number that"),
        (lambda: PolynomialSpring({}), "expected a mapping of powers to numbers"),
        (lambda: PolynomialSpring({1.5: 1.0}), "power 1.5; expected a whole number of at least 1"),
        (lambda: JenkinsElement(0.0, 1.0), "stiffness is 0.0; expected a number above 0, in N/m"),
        (lambda: IwanJoint(1.0, 1.0, -1.0, 0.0), "chi + 1 is 0.0; expected a number above 0"),
        (lambda: CoulombFriction(1.0, transition=-1.0), "of at least 0, in rad/s"),
        (
            lambda: CoulombFriction(1.0).over_period(np.zeros(4), np.zeros(4)),
            "expected transition above 0, in rad/s (m/s), or a JenkinsElement",
        ),
        (
            lambda: CoulombFriction(1.0, 2.0, 0.1).over_period(np.zeros(4), np.zeros(4)),
            "breakaway 2 acts in time responses of loops only",
        ),
        (lambda: CoulombFriction(1.0).at_rest(), "expected transition above 0"),
        (
            lambda: Backlash(1.0, 1.0, 0.5).over_period(np.zeros(4), np.zeros(4)),
            "damping 0.5 acts in loops only",
        ),
    ],
)
def test_bad_numbers_are_refused(make, message: str) -> None:
    with pytest.raises(OptionError) as error:
        make()
    assert message in str(error.value)
