"""Thresholds of servos: a case just inside and just outside of each."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import updyn
from nonlinear_plants import one_inertia
from updyn.control.job import servo as servo_job
from updyn.control.servo import controller, doubts, grid, robust, time_response, verdict
from updyn.control.servo.stability import count_drifting, count_growing
from updyn.control.servo.state_space import StateSpace, balance, bilinear
from updyn.control.servo.time_response import schedule_intervals, step_figures
from updyn.errors import DataError, OptionError

NO_ROOTS = np.zeros(0, dtype=complex)


# -- poles ----------------------------------------------------------------------------------------
def test_a_pole_is_at_zero_below_a_hundred_thousandth_of_the_crossover():
    poles = 20.0 * np.array([0.9e-5, 1.1e-5j, -1.0])
    assert count_drifting(poles, 20.0) == 1


def test_a_pole_is_unstable_above_a_billionth_of_its_modulus():
    assert count_growing(np.array([0.9e-9 + 1j, 0.9e-9 - 1j]), 1.0) == 0
    assert count_growing(np.array([1.1e-9 + 1j, 1.1e-9 - 1j]), 1.0) == 2


def test_scales_of_states_are_limited():
    """Weakly coupled states would have scales of 2^50 and 2^-50."""
    A = np.array([[0.0, 1e-30], [1e30, 0.0]])
    np.testing.assert_array_equal(np.sort(np.log2(balance(A)[1])), [-40.0, 40.0])


# -- lines ----------------------------------------------------------------------------------------
def test_lines_of_a_loop_are_eighty_per_decade():
    assert len(grid.frequencies(NO_ROOTS, 1.0, 100.0)) == 162


def test_lines_around_a_resonance_reach_25_half_widths():
    w = grid.frequencies(np.array([-0.01 + 10j]), 9.0, 11.0)
    assert np.isclose(w[:, None], [9.75, 9.9985, 10.0, 10.25], rtol=0.0, atol=1e-12).any(0).all()
    w = grid.frequencies(np.array([10j]), 9.0, 11.0)
    assert (
        np.isclose(w[:, None], 10.0 * (1.0 + np.array([-25e-7, 0.15e-7])), rtol=1e-12).any(0).all()
    )


def test_dead_time_has_a_line_for_each_seven_tenths_of_a_radian():
    w = grid.frequencies(NO_ROOTS, 1.0, 2.0, delay=100.0)
    assert np.diff(w).max() <= 0.7 / 100.0 + 1e-12
    assert len(w) >= 142
    grid.frequencies(NO_ROOTS, 1.0, 2.0, delay=0.35 * 59_000)
    with pytest.raises(DataError, match="dead time"):
        grid.frequencies(NO_ROOTS, 1.0, 2.0, delay=0.35 * 61_000)


@pytest.mark.parametrize(("turn", "lines"), [(0.69, 2), (0.71, 3)])
def test_lines_are_added_where_the_phase_turns(turn, lines):
    w, _ = grid.resolve(lambda s: np.exp(-s), np.array([1.0, 1.0 + turn]))
    assert len(w) == lines


@pytest.mark.parametrize(("size", "number"), [(0.9e8, 1), (1.1e8, 0), (1.1e-8, 1), (0.9e-8, 0)])
def test_a_phase_crossing_at_an_infinite_gain_is_ignored(size, number):
    def loop(s):
        return -size * (1.0 + 1j * (np.asarray(s).imag - 1.0))

    w = np.array([0.5, 1.5])
    assert len(grid.crossings_of_phase(loop, w, loop(1j * w))) == number


# -- step response --------------------------------------------------------------------------------
@pytest.mark.parametrize(("end", "settles"), [(1.019, True), (1.021, False)])
def test_a_response_settles_within_two_per_cent(end, settles):
    time = np.linspace(0.0, 1.0, 11)
    figures = step_figures(time, end * time, np.full(11, end), 1.0, reference=True)
    assert (figures.settling_time is not None) == settles


@pytest.mark.parametrize(("final", "rises"), [(0.011, True), (0.009, False)])
def test_a_response_returns_below_a_hundredth_of_its_peak(final, rises):
    time = np.linspace(0.0, 1.0, 101)
    value, slope = np.sin(np.pi * time), np.pi * np.cos(np.pi * time)
    figures = step_figures(time, value, slope, final, reference=True)
    assert (figures.overshoot is not None) == rises


def lags(*rates, shares=None):
    """Return first-order lags in parallel with gains of a step response."""
    rates = np.array(rates)
    shares = np.ones(len(rates)) if shares is None else np.array(shares)
    return StateSpace(
        np.diag(-rates), np.ones((len(rates), 1)), (rates * shares)[None], np.zeros((1, 1))
    )


def test_a_record_ends_when_the_slowest_mode_has_settled_to_a_fifth_of_a_per_cent():
    ((n, dt),) = schedule_intervals(lags(1.0), 0, 0)
    assert n == 1000
    assert n * dt == pytest.approx(np.log(500.0))


def test_intervals_resolve_the_fastest_mode():
    (n, dt), _ = schedule_intervals(lags(1.0, 1e4), 0, 0)
    assert dt == pytest.approx(1.0 / 12e4)
    assert n * dt == pytest.approx(np.log(1000.0) / 1e4, rel=0.02)


@pytest.mark.parametrize(("share", "parts"), [(1.1e-3, 2), (0.9e-3, 1)])
def test_a_mode_contributes_from_a_thousandth(share, parts):
    """Rates whose intervals differ."""
    assert len(schedule_intervals(lags(1.0, 1e4, shares=(1.0, share)), 0, 0)) == parts


def test_a_record_has_at_most_20000_intervals():
    parts = schedule_intervals(lags(1.0, 1e4), 0, 0, duration=1e4)
    assert sum(n for n, _ in parts) <= 20_000
    A = np.array([[0.0, 1.0], [-1.0, -2e-5]])
    oscillator = StateSpace(A, np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]]), np.zeros((1, 1)))
    ((n, dt), *_) = schedule_intervals(oscillator, 0, 0)
    assert (n, dt) == (20_000, pytest.approx(1.0 / 12.0))


@pytest.mark.parametrize(("intervals", "exact"), [(16.5, True), (15.5, False)])
def test_dead_time_of_sixteen_intervals_is_exact(monkeypatch, intervals, exact):
    """A record of 1 s has at most 60,000 intervals with exact dead time."""
    one = StateSpace(*(np.zeros((1, 1)),) * 4)
    controller = SimpleNamespace(dead_time=intervals / 60_000)
    cascade = SimpleNamespace(controller=controller, open_at_delay=lambda: one)
    parts = [(1, 1e-9), (1, 1.0)]
    record = np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3))
    called = []
    for name in ("delayed_response", "simulate_step"):
        monkeypatch.setattr(
            time_response, name, lambda *_, name=name: called.append(name) or record
        )
    monkeypatch.setattr(time_response, "schedule_intervals", lambda *_: parts)
    time_response._simulate_step_record(cascade, one, 0, 0, 1.0, None, None)
    assert called == ["delayed_response" if exact else "simulate_step"]


def test_a_series_of_wind_has_at_most_two_to_the_20_samples():
    wind = updyn.Wind(10.0, 2.0, turbulence=0.2, duration=0.1 * (2**20 + 2), dt=0.1)
    with pytest.raises(OptionError, match="16 to 1048576"):
        wind.series()
    exact = replace(wind, duration=0.1 * 2**20)
    assert len(exact.series()[0]) == 2**20


# -- discretisation -------------------------------------------------------------------------------
def test_the_bilinear_substitution_is_that_of_s():
    """G(2 (z - 1) / (dt (z + 1))) at points on the unit circle."""
    rng = np.random.default_rng(0)
    A, B, C, D = (rng.standard_normal(shape) for shape in ((3, 3), (3, 2), (2, 3), (2, 2)))
    made, dt = bilinear(StateSpace(A, B, C, D), 0.1), 0.1
    for z in np.exp(1j * np.array([0.3, 1.0, 2.0])):
        s = 2.0 * (z - 1.0) / (dt * (z + 1.0))
        exact = C @ np.linalg.solve(s * np.eye(3) - A, B) + D
        found = made.C @ np.linalg.solve(z * np.eye(3) - made.A, made.B) + made.D
        np.testing.assert_allclose(found, exact, rtol=1e-9)
    assert bilinear(StateSpace.gain(3.0), dt).D == 3.0


# -- ends of the lines ----------------------------------------------------------------------------
def line_ends(controller, friction=0.0, through=0.0):
    """Return the first and last line in rad/s of a velocity loop on an inertia of 1 kg m2."""
    D = np.array([[0.0, 0.0], [through, 0.0]])
    plant = replace(one_inertia(), A=np.array([[0.0, 1.0], [0.0, -friction]]), D=D)
    found = updyn.servo(plant, controller, torque="torque", velocity="drag", step=None)
    return 2 * np.pi * found.velocity_loop.freq[[0, -1]]


def test_the_first_line_is_a_fiftieth_of_the_lowest_pole():
    """The closed-loop pole is at -1 rad/s."""
    assert line_ends(updyn.Controller(1.0))[0] == pytest.approx(0.02)
    assert line_ends(updyn.Controller(1.0), friction=0.9e-7)[0] == pytest.approx(0.02)
    assert line_ends(updyn.Controller(1.0), friction=1.1e-7)[0] == pytest.approx(0.02 * 1.1e-7)


def test_the_last_line_is_ten_times_the_highest_zero_if_the_gain_remains():
    """L = 1 / (s + 1) + 1 / 2, with a zero at -3 rad/s."""
    last = line_ends(updyn.Controller(1.0), friction=1.0, through=0.5)[1]
    assert last == pytest.approx(30.0)


def test_the_gain_has_vanished_at_the_last_line():
    """L = 1 / s + 0.1 / s^2, with a closed-loop pole at -0.887 rad/s: a gain of 0.028."""
    assert line_ends(updyn.Controller(1.0, 10.0))[1] == pytest.approx(40 * 0.8873, rel=1e-4)


def test_with_dead_time_lines_end_at_four_times_the_last_gain_of_a_twentieth():
    """A gain of 0.05 at 20 rad/s, and a low-pass at 1000 rad/s."""
    controller = updyn.Controller(1.0, low_pass=1e3 / (2 * np.pi), dead_time=1e-3)
    assert 4 * 19.3 < line_ends(controller)[1] <= 4 * 20.0


@pytest.mark.parametrize(
    ("cycle", "duration", "scale"), [(SimpleNamespace(frequency=2.0), 20.0, 1.2), (None, 3.0, None)]
)
def test_forty_periods_of_a_cycle_or_six_of_the_bandwidth_are_simulated(
    monkeypatch, cycle, duration, scale
):
    """The simulation of a cycle of 2 Hz begins a fifth above it."""
    seen = {}

    def simulate(plant, controller, law, duration, name, **how):
        seen.update(how, duration=duration)

    monkeypatch.setattr(servo_job, "simulate", simulate)
    monkeypatch.setattr(servo_job, "_largest_stable_cycle", lambda cycles: cycle)
    loop = SimpleNamespace(margins=SimpleNamespace(crossover=3.0))
    servo = SimpleNamespace(step=None, loops=[loop], bandwidth=2.0, controller=None)
    servo_job._simulate(
        SimpleNamespace(duration=None),
        SimpleNamespace(band=(0.1, 100.0)),
        servo,
        None,
        SimpleNamespace(linear_stable=True),
        "",
        {},
    )
    assert seen["duration"] == pytest.approx(duration)
    assert seen.get("scale") == scale


# -- rigid-body motion and robust margins ----------------------------------------------------------
@pytest.mark.parametrize(("pole", "number"), [(1.49, 1), (1.51, 2)])
def test_a_circle_is_between_poles_that_differ_by_half(pole, number):
    """The first pole is at a thousandth of the oscillation."""
    assert len(controller._radii(np.array([1.0, pole, 1000.0j]))) == number


@pytest.mark.parametrize(("positive", "is_free"), [(191, False), (193, True)])
def test_a_structure_turns_freely_if_slow_poles_are_half_of_its_mobility(
    monkeypatch, positive, is_free
):
    """Of 256 points of a circle, these have a mobility of 1 and the others of -1."""
    mobility = np.where(np.arange(256) < positive, 1.0, -1.0)
    transfer = SimpleNamespace(at=lambda points: (mobility / points)[:, None, None])
    monkeypatch.setattr(controller, "require_continuous", lambda plant: None)
    monkeypatch.setattr(controller, "to_velocity", lambda *about: 0)
    monkeypatch.setattr(controller, "StateSpace", lambda *about: None)
    monkeypatch.setattr(controller.Transfer, "of", lambda system: transfer)
    monkeypatch.setattr(controller, "_radii", lambda poles: [1.0])
    channel = SimpleNamespace(A=None, B=None, C=None, D=None)
    plant = SimpleNamespace(channel=lambda *about: channel, poles=None)
    assert (controller.rigid_inertia(plant, "", "") is not None) == is_free


@pytest.mark.parametrize(("deviation", "factor"), [(0.9e-3, 2.0), (1.1e-3, np.inf)])
def test_a_change_of_a_loop_is_real_at_rest(monkeypatch, deviation, factor):
    """Its size is a half, and it is negative."""
    change = 0.5 * np.exp(1j * np.arccos(-(1.0 - deviation)))
    monkeypatch.setattr(robust.grid, "crossings_of_phase", lambda *about: [])
    member = SimpleNamespace(feedback_channels=lambda s: np.full((len(s), 1), change))
    cascade = SimpleNamespace(feedback_channels=lambda s: np.zeros((len(s), 1)))
    judged = SimpleNamespace(loop=lambda s: 0.0)
    found = robust._critical_factor(cascade, judged, member, np.ones(3), np.inf)
    assert found == pytest.approx(factor)


# -- verdict --------------------------------------------------------------------------------------
def judged_loop(**margins):
    return SimpleNamespace(name="velocity", worst={}, margins=SimpleNamespace(**margins))


@pytest.mark.parametrize(("margin", "is_small"), [(0.49, True), (0.51, False)])
def test_a_modulus_margin_of_a_half_is_usual(margin, is_small):
    assert bool(verdict._small_margin([judged_loop(modulus_margin=margin)])) == is_small


@pytest.mark.parametrize(("crossover", "is_low"), [(0.19, True), (0.21, False)])
def test_a_crossover_is_questioned_below_a_fiftieth_of_the_lowest_mode(crossover, is_low):
    text = doubts._describe(judged_loop(crossover=crossover), 10.0, "the lowest mode")
    assert bool(text) == is_low
