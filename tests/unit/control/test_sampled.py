"""Sampled plants against closed forms, step responses, aliased sums, scipy and python-control."""

from __future__ import annotations

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.signal import cont2discrete

from plants_by_hand import double_integrator, oscillator, plant, simulate, two_masses
from updyn.control.plant import Plant
from updyn.control.sampled import sampled
from updyn.errors import OptionError


def held(dt: float, s: complex | np.ndarray) -> complex | np.ndarray:
    return (1 - np.exp(-s * dt)) / (s * dt)


# -- zero-order hold ---------------------------------------------------------------------------------------
def test_double_integrator() -> None:
    """Franklin, Powell & Workman, section 4.3: T^2 (z + 1) / (2 J (z - 1)^2)."""
    T, J = 0.04, 2.0
    found = sampled(double_integrator(J), T)
    assert_allclose(found.A, [[1, T], [0, 1]], rtol=1e-15, atol=1e-17)
    assert_allclose(found.B, [[T**2 / (2 * J)], [T / J]], rtol=1e-15)
    assert_allclose(found.poles, [1, 1])
    z = np.exp(2j * np.pi * np.array([0.3, 1.0, 4.0]) * T)
    assert_allclose(found.at(z)[:, 0, 0], T**2 * (z + 1) / (2 * J * (z - 1) ** 2), rtol=1e-11)
    assert (found.dt, found.delay, found.rigid, found.error) == (T, 0, 1, 0.013)


@pytest.mark.parametrize("frequency", [3.0, 4000.0])
def test_damped_oscillator(frequency: float) -> None:
    """Closed form of exp(A T), and of its integral with the static solution as reference."""
    zeta, omega = 0.05, 2 * np.pi * frequency
    T = 0.11 / frequency
    sigma, damped = zeta * omega, omega * np.sqrt(1 - zeta**2)
    c, s, decay = np.cos(damped * T), np.sin(damped * T), np.exp(-sigma * T)
    A = decay * np.array(
        [[c + sigma / damped * s, s / damped], [-(omega**2) / damped * s, c - sigma / damped * s]]
    )
    found = sampled(oscillator(frequency, zeta, band=(0.1, 0.6 * frequency)), T)
    assert_allclose(found.A, A, rtol=1e-12)
    assert_allclose(found.B, [[1 - A[0, 0]], [-A[1, 0]]], rtol=1e-11)


@pytest.mark.parametrize("delay", [0.0, 0.3, 1.0, 2.7, 2.9999])
def test_the_response_to_a_step_is_the_late_step_response(delay: float) -> None:
    T, J = 0.04, 2.0
    found = sampled(double_integrator(J), T, delay=delay * T)
    assert found.delay == int(np.ceil(delay))
    assert found.n_states == 2 + found.delay
    time = np.maximum(np.arange(12) - delay, 0) * T
    assert_allclose(
        simulate(found, np.ones((12, 1)))[:, 0], time**2 / (2 * J), rtol=1e-12, atol=1e-15
    )


@pytest.mark.parametrize("delay", [0.25, 1.0, 3.6])
def test_a_feedthrough_is_late_too(delay: float) -> None:
    """y' + y = u' + 2 u: the step response is 2 - exp(-t), 1 at once."""
    T = 0.2
    found = sampled(plant([[-1.0]], [[1.0]], [[1.0]], [[1.0]]), T, delay=delay * T)
    time = (np.arange(15) - delay) * T
    expected = np.where(time > -1e-12, 2 - np.exp(-time), 0.0)
    assert_allclose(simulate(found, np.ones((15, 1)))[:, 0], expected, rtol=1e-12, atol=1e-14)


def test_a_part_of_an_interval() -> None:
    """Franklin, Powell & Workman, section 4.3: a / (s + a), late by f intervals, with m = 1 - f."""
    a, T, f = 3.0, 0.1, 0.3
    m, z = 1 - f, np.exp(2j * np.pi * np.array([0.0, 0.4, 1.9]) * T)
    alpha = (np.exp(-a * m * T) - np.exp(-a * T)) / (1 - np.exp(-a * m * T))
    expected = (1 - np.exp(-a * m * T)) * (z + alpha) / (z * (z - np.exp(-a * T)))
    found = sampled(plant([[-a]], [[a]], [[1.0]]), T, delay=f * T)
    assert_allclose(found.at(z)[:, 0, 0], expected, rtol=1e-13)


@pytest.mark.parametrize("delay", [0.0, 0.013, 0.04, 0.25])
def test_the_response_is_the_sum_over_all_aliases(delay: float) -> None:
    """Of hold x plant x exp(-s tau), which is what the delay is without sampling."""
    T, lines = 0.05, np.array([0.4, 1.7, 3.0, 6.0])
    continuous = oscillator(3.0, 0.05)
    found = sampled(continuous, T, delay=delay).response(lines).values[:, 0, 0]
    s = 2j * np.pi * (lines[:, None] + np.arange(-3000, 3001) / T)
    whole = continuous.at(s.ravel())[:, 0, 0].reshape(s.shape)
    assert_allclose(found, (held(T, s) * whole * np.exp(-s * delay)).sum(axis=1), rtol=1e-6)


def test_whole_intervals_of_delay_are_powers_of_z() -> None:
    lines = np.array([0.1, 0.7, 2.0])
    one, late = (sampled(two_masses(), 0.01, delay=d) for d in (0.0, 0.03))
    z = np.exp(2j * np.pi * lines * 0.01)
    assert_allclose(
        late.response(lines).values, one.response(lines).values * z[:, None, None] ** -3, rtol=1e-9
    )
    assert (late.delay, late.n_states) == (3, 4 + 3 * 2)


def test_a_delay_that_is_whole_but_for_rounding_is_whole() -> None:
    found = sampled(double_integrator(), 0.001, delay=0.003)  # 0.003 / 0.001 is 3 but for rounding
    assert (found.delay, found.n_states) == (3, 5)
    assert sampled(double_integrator(), 0.1, delay=0.1 + 0.2).delay == 3


# -- Tustin ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("prewarp", [None, 1.5])
def test_tustin_is_the_substitution(prewarp: float | None) -> None:
    T, continuous = 0.05, two_masses()
    found = sampled(continuous, T, "tustin", prewarp=prewarp)
    lines = np.array([0.2, 1.5, 2.2, 9.0])
    z = np.exp(2j * np.pi * lines * T)
    omega = 2 * np.pi * (prewarp or 1.0)
    factor = 2 / T if prewarp is None else omega / np.tan(omega * T / 2)
    assert_allclose(
        found.response(lines).values, continuous.at(factor * (z - 1) / (z + 1)), rtol=1e-9
    )
    if prewarp is not None:
        assert_allclose(
            found.response([prewarp]).values, continuous.response([prewarp]).values, rtol=1e-9
        )


def test_tustin_with_whole_intervals_of_delay() -> None:
    T, lines = 0.05, np.array([0.2, 1.5, 2.2])
    found, late = sampled(two_masses(), T, "tustin"), sampled(two_masses(), T, "tustin", delay=0.1)
    shift = np.exp(-2j * np.pi * lines * 0.1)[:, None, None]
    assert_allclose(late.response(lines).values, found.response(lines).values * shift, rtol=1e-9)
    assert late.delay == 2


# -- other programs ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(("method", "theirs"), [("zoh", "zoh"), ("tustin", "bilinear")])
def test_as_scipy_does(method: str, theirs: str) -> None:
    one = two_masses()
    found = sampled(one, 0.02, method)
    for ours, other in zip(
        (found.A, found.B, found.C, found.D),
        cont2discrete((one.A, one.B, one.C, one.D), 0.02, theirs),
        strict=False,
    ):
        assert_allclose(ours, other, rtol=1e-10, atol=1e-14)


def test_as_python_control_does() -> None:
    one = two_masses()
    theirs = control.ss(one.A, one.B, one.C, one.D)
    warped = control.c2d(theirs, 0.05, "tustin", prewarp_frequency=2 * np.pi * 1.5)
    found = sampled(one, 0.05, "tustin", prewarp=1.5)
    for name in "ABCD":
        assert_allclose(getattr(found, name), getattr(warped, name), rtol=1e-10, atol=1e-14)


# -- what it says of itself --------------------------------------------------------------------------------
def test_the_deviation_is_measured_in_the_band() -> None:
    T, one = 0.05, oscillator(1.3, 0.02)
    found = sampled(one, T, delay=0.02)
    facts = found.facts["sampling"]
    assert (facts["method"], facts["dt"], facts["delay"], facts["prewarp"]) == (
        "zoh",
        T,
        0.02,
        None,
    )
    lines = np.linspace(0.1, 2.0, 4001)
    s = 2j * np.pi * lines
    exact = one.response(lines).values[:, 0, 0] * np.exp(-s * 0.02)
    off = found.response(lines).values[:, 0, 0]
    peak = np.abs(held(T, s) * exact).max()
    assert_allclose(facts["deviation"], np.abs(off - held(T, s) * exact).max() / peak, rtol=0.02)
    without = np.abs(off - exact).max() / np.abs(exact).max()
    assert_allclose(facts["deviation_without_hold"], without, rtol=0.02)
    assert facts["deviation"] < 1e-2 < facts["deviation_without_hold"]
    fine = sampled(one, T / 10, delay=0.02).facts["sampling"]["deviation"]
    assert fine < facts["deviation"] / 50  # aliases of omega^2 / s^2, held: third order in T


@pytest.mark.parametrize(("method", "delay"), [("zoh", 0.13), ("zoh", 0.1), ("tustin", 0.15)])
def test_the_deviation_is_that_of_the_plant_with_all_its_delay(method: str, delay: float) -> None:
    one = two_masses()
    found = sampled(one, 0.05, method, delay)
    lines = np.linspace(0.05, 2.5, 5001)
    s = 2j * np.pi * lines
    exact = one.response(lines).values * np.exp(-s * delay)[:, None, None]
    for name, target in (
        ("deviation", held(0.05, s)[:, None, None] * exact),
        ("deviation_without_hold", exact),
    ):
        off = np.abs(found.response(lines).values - target).max(axis=0) / np.abs(target).max(axis=0)
        assert_allclose(found.facts["sampling"][name], off.max(), rtol=0.02)


def test_tustin_has_no_hold() -> None:
    facts = sampled(oscillator(1.3, 0.02), 0.005, "tustin").facts["sampling"]
    assert facts["deviation_without_hold"] < facts["deviation"]


def test_modes_above_half_the_sampling_rate_are_named() -> None:
    one = oscillator(7.0, 0.02)
    assert sampled(one, 0.1).facts["sampling"]["above_nyquist"] == [7.0]
    assert sampled(one, 0.05).facts["sampling"]["above_nyquist"] == []


def test_what_the_continuous_one_says_is_kept() -> None:
    one = two_masses()
    found = sampled(one, 0.01, delay=0.004)
    for name in (
        "input_ports",
        "output_ports",
        "quantities",
        "band",
        "tolerance",
        "error",
        "peak_error",
        "route",
    ):
        assert getattr(found, name) == getattr(one, name)
    assert_allclose(found.modes, one.modes)
    assert {k for k in found.facts if k != "sampling"} == set(one.facts)
    assert one.dt is None
    assert "sampling" not in one.facts


# -- what is refused ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("dt", [0.0, -0.1, np.nan, np.inf, "fast", True])
def test_an_interval_that_is_none(dt: object) -> None:
    with pytest.raises(OptionError, match="expected a sampling interval in s, above 0"):
        sampled(double_integrator(), dt)  # type: ignore[arg-type]


@pytest.mark.parametrize("delay", [-0.1, np.nan, "late"])
def test_a_delay_that_is_none(delay: object) -> None:
    with pytest.raises(OptionError, match="expected a time in s, 0 or above"):
        sampled(double_integrator(), 0.1, delay=delay)  # type: ignore[arg-type]


@pytest.mark.parametrize("prewarp", [0.0, 5.0, np.nan, "x"])
def test_a_prewarping_that_is_none(prewarp: object) -> None:
    with pytest.raises(OptionError, match="below half the sampling rate, 5 Hz"):
        sampled(double_integrator(), 0.1, "tustin", prewarp=prewarp)  # type: ignore[arg-type]


def test_what_cannot_be_sampled() -> None:
    one = double_integrator()
    with pytest.raises(OptionError, match=r"already sampled, every 0\.1 s"):
        sampled(sampled(one, 0.1), 0.1)
    with pytest.raises(
        OptionError, match=r"extends to 2 Hz, but half the sampling rate is 1\.66667 Hz"
    ):
        sampled(one, 0.3)
    with pytest.raises(OptionError, match="did you mean 'tustin'"):
        sampled(one, 0.1, "tustn")
    with pytest.raises(OptionError, match="belongs to method 'tustin'"):
        sampled(one, 0.1, prewarp=1.0)
    with pytest.raises(OptionError, match=r"1\.7 intervals of 0\.1 s.*nearest 0\.2 s"):
        sampled(one, 0.1, "tustin", delay=0.17)
    with pytest.raises(OptionError, match="expected a delay in s"):
        sampled(one, 1e-4, delay=5.0)
    with pytest.raises(OptionError, match="a pole at s = 20 rad/s"):
        sampled(plant([[20.0]], [[1.0]], [[1.0]]), 0.1, "tustin")


# -- properties --------------------------------------------------------------------------------------------
@st.composite
def stable(draw: st.DrawFn) -> Plant:
    frequencies = draw(st.lists(st.floats(0.05, 30.0), min_size=1, max_size=4))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    omega = 2 * np.pi * np.array(frequencies)
    n = len(omega)
    zeta = rng.uniform(0.005, 0.2, n)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(omega**2), -np.diag(2 * zeta * omega)]])
    B, C = (
        np.vstack([np.zeros((n, 2)), rng.normal(size=(n, 2))]),
        np.hstack([rng.normal(size=(2, n)), np.zeros((2, n))]),
    )
    return plant(A, B, C, rng.normal(size=(2, 2)))


@settings(max_examples=25, deadline=None, derandomize=True)
@given(stable(), st.floats(0.01, 0.2), st.floats(0.0, 3.5))
def test_static_gain_poles_and_two_intervals(one: Plant, dt: float, delay: float) -> None:
    static = one.at([0.0])[0]
    scale = np.abs(static).max()
    found = sampled(one, dt, delay=delay * dt)
    assert_allclose(found.at([1.0])[0], static, rtol=0, atol=1e-8 * scale)
    poles = sampled(one, dt).poles
    expected = np.exp(one.poles * dt)
    assert max(np.abs(poles - p).min() for p in expected) < 1e-7
    assert np.abs(found.poles).max() < 1
    tustin = sampled(one, dt, "tustin")
    assert np.abs(tustin.poles).max() < 1
    assert_allclose(tustin.at([1.0])[0], static, rtol=0, atol=1e-8 * scale)
    # A held step seen every second sample of half the interval.
    half = sampled(one, dt / 2, delay=delay * dt)
    assert_allclose(
        simulate(found, np.ones((8, 2))), simulate(half, np.ones((15, 2)))[::2], atol=1e-9 * scale
    )
