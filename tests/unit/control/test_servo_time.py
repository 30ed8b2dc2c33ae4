"""Steps and wind: against python-control, closed forms, and the spectrum."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

import updyn
from servo_cases import LOAD, MOTOR, STIFFNESS, masses, rigid, speed_over_torque, two_masses
from updyn.control.servo.loops import Cascade, Wiring
from updyn.control.servo.state_space import StateSpace, connect, delay_approximation
from updyn.control.servo.time_response import delayed_response, final_value, linear_response

NAMES = {"torque": "motor", "velocity": "speed"}
BOTH = {**NAMES, "position": "angle"}
FULL = {**BOTH, "disturbance": "wind", "pointing": "load"}
CONTROLLER = updyn.Controller(100.0, 0.3, 3.0, low_pass=60.0)


def closed_loops(controller):
    """x_ref -> angle by python-control, from the transfer functions."""
    s = control.tf("s")
    num, den = speed_over_torque()
    w = 2 * np.pi * controller.low_pass
    K = controller.kp * (1 + 1 / (controller.ti * s)) * w / (s + w)
    G = control.tf(num, den)
    ahead = controller.kv + controller.feed_forward * s
    whole = K * G * (1 + controller.kv / s)
    return control.minreal(ahead * K * G / s / (1 + whole), 1e-6, verbose=False)


def stepped(system, time):
    """The step response of python-control, which wants equal intervals, at other times."""
    even, value = control.step_response(system, np.linspace(0, time[-1], 20_001))
    return CubicSpline(even, value)(time)


def test_step_of_the_reference_is_that_of_python_control():
    found = updyn.servo(two_masses(), CONTROLLER, **BOTH)
    step = found.step
    want = stepped(closed_loops(CONTROLLER), step.time)
    np.testing.assert_allclose(step.value, want, atol=1e-6 * np.abs(want).max())
    info = control.step_info(closed_loops(CONTROLLER), T=np.linspace(0, step.time[-1], 40_001))
    assert step.rise_time == pytest.approx(info["RiseTime"], abs=3e-4)
    assert 100 * step.overshoot == pytest.approx(info["Overshoot"], abs=1e-3)
    assert step.settling_time == pytest.approx(info["SettlingTime"], abs=3e-4)
    assert step.final == pytest.approx(1.0, rel=1e-7)
    assert step.value[-1] == pytest.approx(1.0, abs=5e-3)
    assert step.output_unit == "rad"
    assert (step.of, step.input, step.size) == ("reference", "angle", 1.0)


def test_feed_forward_steps_by_its_impulse_too():
    controller = updyn.Controller(100.0, 0.3, 3.0, low_pass=60.0, feed_forward=0.5)
    found = updyn.servo(two_masses(), controller, **BOTH, step=0.1)
    want = stepped(closed_loops(controller), found.step.time)
    np.testing.assert_allclose(found.step.value, 0.1 * want, atol=1e-7)
    np.testing.assert_allclose(
        found.reference, closed_loops(controller)(2j * np.pi * found.freq), rtol=1e-6, atol=1e-12
    )
    stiff = updyn.servo(two_masses(), updyn.Controller(100.0, 0.3, 3.0, feed_forward=0.5), **BOTH)
    assert stiff.step is None
    assert "unbounded torque" in stiff.notes[-1]


def test_p_position_loop_on_a_rigid_body_in_closed_form():
    # w / (s^2 + ...) with damping 1/2: overshoot exp(-pi zeta / sqrt(1 - zeta^2)), peak at pi / (wn
    # sqrt(1 - zeta^2))
    kp, J, kv = 3.0, 3.0, 1.0
    step = updyn.servo(rigid(J), updyn.Controller(kp, kv=kv), **BOTH).step
    damped = np.sqrt(3) / 2
    assert step.overshoot == pytest.approx(np.exp(-np.pi * 0.5 / damped), rel=1e-6)
    assert step.peak_time == pytest.approx(np.pi / damped, rel=1e-6)
    t = step.time
    want = 1 - np.exp(-t / 2) * (np.cos(damped * t) + 0.5 / damped * np.sin(damped * t))
    np.testing.assert_allclose(step.value, want, atol=1e-11)
    np.testing.assert_allclose(step.torque[0], 3.0, rtol=1e-12)

    def off(
        x,
    ):  # of the trough after the second half turn, 2.7 % deep: the last time that 2 % is left
        return -np.exp(-x / 2) * (np.cos(damped * x) + 0.5 / damped * np.sin(damped * x)) + 0.02

    assert step.settling_time == pytest.approx(
        brentq(off, 2 * np.pi / damped, 2.4 * np.pi / damped), rel=1e-6
    )


def test_velocity_loop_alone_steps_the_velocity():
    step = updyn.servo(
        rigid(4.0), updyn.Controller(8.0), **NAMES, step=5.0
    ).step  # 5 (1 - exp(-2 t))
    np.testing.assert_allclose(step.value, 5 * -np.expm1(-2 * step.time), atol=1e-10)
    assert step.rise_time == pytest.approx(np.log(9) / 2, rel=1e-7)
    assert step.overshoot == 0
    assert step.settling_time == pytest.approx(np.log(50) / 2, rel=1e-7)
    assert step.output_unit == "rad/s"


def test_step_of_the_disturbance():
    # the integral holds the motor; the load goes to 1 / k, the motor comes back to 0
    found = updyn.servo(two_masses(), CONTROLLER, **FULL, disturbance_step=2.0)
    step = found.disturbance_step
    assert step.final == pytest.approx(2.0 / STIFFNESS, rel=1e-6)
    assert step.torque[-1] == pytest.approx(-2.0, rel=1e-2)
    assert (step.input, step.output, step.input_unit) == ("wind", "load", "N m")
    s = control.tf("s")
    K = CONTROLLER.kp * (1 + 1 / (CONTROLLER.ti * s)) * (CONTROLLER.kv + s) / s
    K *= 1 / (1 + s / (2 * np.pi * CONTROLLER.low_pass))
    M11, M22 = np.array([MOTOR, 2.0, STIFFNESS]), np.array([LOAD, 2.0, STIFFNESS])
    D11 = control.tf(M11, [1]) + K * s
    load = D11 / (D11 * control.tf(M22, [1]) - control.tf([2.0, STIFFNESS], [1]) ** 2)
    np.testing.assert_allclose(found.compliance, load(2j * np.pi * found.freq), rtol=1e-7)
    top = np.abs(step.value).max()
    assert abs(step.peak) >= top * (1 - 1e-12)
    assert abs(step.peak) == pytest.approx(top, rel=1e-3)


def test_dead_time_over_time_is_that_of_a_fine_sampled_simulation():
    # torque late by 20 ms in a velocity loop of P on a rigid body: v' = 5 (1 - v(t - T)), by the
    # method of steps
    T, a = 0.02, 5.0
    step = updyn.servo(rigid(2.0), updyn.Controller(2.0 * a, dead_time=T), **NAMES).step
    n = 400  # intervals in T
    h = T / n
    v = np.zeros(n * 60 + 1)
    for k in range(1, len(v)):  # trapezoidal: exact but for h^2, as what is late is known
        late = [v[j - n] if j >= n else None for j in (k - 1, k)]
        slope = [0.0 if x is None else a * (1 - x) for x in late]
        if k == n:
            slope[1] = 0.0
        v[k] = v[k - 1] + 0.5 * h * sum(slope)
    t = np.arange(len(v)) * h
    keep = step.time < t[-1]
    np.testing.assert_allclose(step.value[keep], np.interp(step.time[keep], t, v), atol=2e-6)
    early = step.time <= T
    assert (step.value[early] == 0).all()
    np.testing.assert_allclose(
        step.torque[np.isclose(step.time, T)], 10.0
    )  # as late as it is, all of it
    assert (step.torque[step.time < T - 1e-9] == 0).all()
    between = (step.time > T) & (step.time < 2 * T)
    np.testing.assert_allclose(step.value[between], a * (step.time[between] - T), rtol=1e-9)


@pytest.mark.parametrize("order", range(1, 13))
def test_pade_is_an_all_pass_with_the_phase_of_the_dead_time(order):
    T = 3e-3
    system = delay_approximation(T, order)
    s = 1j * np.linspace(0.01, 0.5 * order, 9) / T
    values = np.array(
        [
            (system.C @ np.linalg.solve(x * np.eye(order) - system.A, system.B) + system.D)[0, 0]
            for x in s
        ]
    )
    np.testing.assert_allclose(np.abs(values), 1.0, rtol=1e-8)
    # error of the diagonal approximation: 2 x^(2n+1) (n! / (2n)!)^2 n! n! / ... : below this in any
    # case
    assert np.abs(values - np.exp(-T * s))[:5].max() < 0.02
    taylor = np.abs(values[0] - np.exp(-T * s[0]))
    assert taylor < 1e-6
    assert (system.poles.real < 0).all()


def test_series_is_exact_between_straight_lines():
    # x' = -2 x + u, u = t: x = (t - (1 - exp(-2 t)) / 2) / 2
    system = StateSpace(np.array([[-2.0]]), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)))
    t = np.linspace(0, 3, 7)
    _, y = linear_response(system, t[:, None], 0.5)
    np.testing.assert_allclose(y[:, 0], 0.5 * (t + 0.5 * np.expm1(-2 * t)), rtol=1e-12, atol=1e-15)
    assert final_value(system, 0, 0) == pytest.approx(0.5, rel=1e-9)
    integrator = StateSpace(np.zeros((1, 1)), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)))
    assert np.isnan(final_value(integrator, 0, 0))


def test_algebraic_loop_without_solution_is_told():
    with pytest.raises(updyn.errors.OptionError, match="algebraic"):
        connect([StateSpace.gain(2.0)], np.array([[0.5]]), np.ones((1, 1)))


# -- wind --------------------------------------------------------------------------------------------------
def test_spectrum_integrates_to_the_stated_turbulence():
    wind = updyn.Wind(12.0, 3.0, turbulence=0.25)
    total = quad(
        lambda x: wind.spectrum(np.exp(x)) * np.exp(x), np.log(1e-9), np.log(1e9), limit=400
    )[0]
    assert total == pytest.approx((0.25 * 12.0) ** 2, rel=1e-6)
    assert wind.variance_below(np.inf) == pytest.approx((0.25 * 12.0) ** 2, rel=1e-12)
    for f in (1e-4, 0.01, 1.0):
        part = quad(wind.spectrum, 0, f, epsabs=0, epsrel=1e-10)[0]
        assert wind.variance_below(f) == pytest.approx(part, rel=1e-8)
    rough = updyn.Wind(12.0, 3.0, roughness=0.005)
    assert rough.intensity == pytest.approx(np.sqrt(0.03))
    f = 0.02  # f S / (roughness V^2) at X = 2: 4 * 4 / 5^(4/3)
    assert f * rough.spectrum(f) / (0.005 * 144) == pytest.approx(16 / 5 ** (4 / 3), rel=1e-12)


def test_series_has_the_variance_of_its_band():
    wind = updyn.Wind(15.0, -2.0, turbulence=0.2, duration=300.0, dt=0.05, seed=3)
    time, torque = wind.series()
    assert len(time) == 6000
    assert time[1] == pytest.approx(0.05)
    assert torque.mean() == pytest.approx(-2.0 * 225, rel=1e-9)
    low, high = 0.5 / 300, 10 - 0.5 / 300
    band = (wind.variance_below(high) - wind.variance_below(low)) * (2 * 2.0 * 15.0) ** 2
    assert torque.var() == pytest.approx(band, rel=1e-9)
    np.testing.assert_array_equal(torque, wind.series()[1])
    other = updyn.Wind(15.0, -2.0, turbulence=0.2, duration=300.0, dt=0.05, seed=4).series()[1]
    assert np.abs(other - torque).max() > 1.0
    # density of the series about one line, averaged: that of the spectrum
    density = 2 * np.abs(np.fft.rfft(torque - torque.mean()) / 6000) ** 2 * 300.0
    np.testing.assert_allclose(
        density[60], (2 * 2.0 * 15.0) ** 2 * wind.spectrum(60 / 300), rtol=1e-3
    )


def test_error_under_wind_is_what_the_spectrum_says():
    wind = updyn.Wind(10.0, 2.0, turbulence=0.2, duration=600.0, seed=1)
    found = updyn.servo(two_masses(), CONTROLLER, **FULL, wind=wind).wind
    assert found.mean == pytest.approx(200.0 / STIFFNESS, rel=2e-2)
    assert found.rms == pytest.approx(np.hypot(found.mean, found.std), rel=1e-9)
    assert found.std == pytest.approx(found.rms_expected, rel=0.05)
    assert found.peak == np.abs(found.error).max()
    assert found.facts["turbulence"] == pytest.approx(0.2)

    # by integration of the closed form: load angle over wind torque, line by line
    s = control.tf("s")
    K = (
        CONTROLLER.kp
        * (1 + 1 / (CONTROLLER.ti * s))
        * (CONTROLLER.kv + s)
        / s
        / (1 + s / (2 * np.pi * 60.0))
    )
    D11 = control.tf([MOTOR, 2.0, STIFFNESS], [1]) + K * s
    load = D11 / (
        D11 * control.tf([LOAD, 2.0, STIFFNESS], [1]) - control.tf([2.0, STIFFNESS], [1]) ** 2
    )

    def density(x):
        f = np.exp(x)
        return abs(load(2j * np.pi * f)) ** 2 * 40.0**2 * wind.spectrum(f) * f

    peaks = np.log(np.abs(load.poles().imag[load.poles().imag > 1]) / (2 * np.pi))
    want = np.sqrt(quad(density, np.log(1e-6), np.log(1e3), points=peaks, limit=500)[0])
    assert found.rms_expected == pytest.approx(want, rel=1e-3)


def test_given_series_of_a_disturbance():
    t = np.linspace(0, 20, 4001)
    torque = np.where(t < 0.005, 0.0, 1.0)
    found = updyn.servo(two_masses(), CONTROLLER, **FULL, wind=(t, torque))
    step = found.disturbance_step
    # a ramp over one interval of 5 ms instead of a step: as late by half of it
    want = np.interp(t - 0.0025, step.time, step.value)
    assert np.abs(found.wind.error - want)[t < step.time[-1]].max() < 3e-4 * abs(step.peak)
    assert found.wind.rms_expected is None
    steady = updyn.servo(two_masses(), CONTROLLER, **FULL, wind=(t, np.full_like(t, 3.0))).wind
    np.testing.assert_allclose(steady.error, 3.0 / STIFFNESS, rtol=1e-6)


@pytest.mark.parametrize(
    ("series", "message"),
    [
        (([0.0, 1.0], [1.0]), "one length"),
        (([0.0, 1.0, 3.0, 4.0], [1.0, 2.0, 3.0, 4.0]), "equally spaced.*1 s is followed by 3 s"),
        (([0.0, 1.0, 2.0], [1.0, np.nan, 3.0]), "not finite"),
        ("gusts", "expected a Wind"),
    ],
)
def test_series_that_cannot_be_used_are_told(series, message):
    with pytest.raises(updyn.errors.DataError, match=message):
        updyn.servo(two_masses(), CONTROLLER, **FULL, wind=series)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mean_speed": 0.0}, "mean_speed is 0.0; expected a number above 0, in m/s"),
        ({"coefficient": 0.0}, "coefficient"),
        ({"roughness": 0.01}, "roughness or turbulence"),
        ({"turbulence": None}, "roughness or turbulence"),
        ({"seed": -1}, "seed"),
        ({"duration": -5}, "duration"),
    ],
)
def test_wind_that_cannot_be_is_told(change, message):
    with pytest.raises(updyn.errors.OptionError, match=message):
        updyn.Wind(**{"mean_speed": 10.0, "coefficient": 1.0, "turbulence": 0.2, **change})


def test_steps_of_size_0_are_told():
    for name in ("step", "disturbance_step", "duration"):
        with pytest.raises(updyn.errors.OptionError, match=name):
            updyn.servo(two_masses(), CONTROLLER, **FULL, **{name: 0.0})


def test_summary_says_what_was_found():
    wind = updyn.Wind(10.0, 2.0, turbulence=0.2, duration=60.0, dt=0.02)
    text = updyn.servo(masses((2.0, 5.0), (3e3,), (2.0,)), CONTROLLER, **FULL, wind=wind).summary()
    for part in (
        "velocity loop",
        "position loop",
        "phase margin",
        "bandwidth",
        "overshoots",
        "rms",
        "inertia 7 ",
    ):
        assert part in text


def test_dead_time_of_the_cascade_is_the_limit_of_a_sampled_one():
    # the same loop on the plant sampled finely: torque held over 0.05 ms, and late by a whole
    # number of intervals
    T, h = 4e-3, 5e-5
    controller = updyn.Controller(100.0, 0.3, 3.0, low_pass=60.0, dead_time=T)
    found = updyn.servo(two_masses(), controller, **FULL)
    assert found.step.time[-1] > 1.0
    plant = updyn.sampled(
        two_masses(band=(0.0, 100.0)), h, delay=T - 0.5 * h
    )  # the hold is half an interval late
    K = control.sample_system(
        control.ss(
            *(getattr(updyn.Controller(100.0, 0.3, low_pass=60.0).state_space(), n) for n in "ABCD")
        ),
        h,
        "tustin",
    )
    x, xc, angle = np.zeros(plant.n_states), np.zeros(K.nstates), np.zeros(int(1.0 / h))
    for k in range(len(angle)):
        y = plant.C @ x
        angle[k] = y[0]
        e = np.array([3.0 * (1.0 - y[0]) - y[1]])
        u = K.C @ xc + K.D @ e
        xc = K.A @ xc + K.B @ e
        x = plant.A @ x + plant.B @ np.array([u[0], 0.0])
    t = np.arange(len(angle)) * h
    # the bilinear filter takes the step for a ramp that began an interval before: half an interval
    # early
    np.testing.assert_allclose(
        angle, np.interp(t + 0.5 * h, found.step.time, found.step.value), atol=1e-6
    )


def test_dead_time_and_feed_through_together():
    # y = G + R with R small: as without R, for both ways over time
    R, names = (
        1e-9,
        {"torque": "motor", "velocity": "angle", "disturbance": "wind", "pointing": "load"},
    )
    plant = two_masses(outputs=("angle", "load"))
    D = np.array([[R, R], [R, R]])
    loose = updyn.Plant(
        plant.A,
        plant.B,
        plant.C,
        D,
        plant.input_ports,
        plant.output_ports,
        plant.quantities,
        plant.band,
        0.02,
        0.0,
        0.0,
        "by hand",
        1,
    )
    for dead_time in (0.0, 4e-3):
        for kv in (3.0, None):
            controller = updyn.Controller(100.0, 0.3, kv, low_pass=60.0, dead_time=dead_time)
            a = updyn.servo(loose, controller, **names, duration=2.0)
            b = updyn.servo(plant, controller, **names, duration=2.0)
            n = min(len(a.step.time), len(b.step.time))
            want = np.interp(a.step.time, b.step.time, b.step.value)
            np.testing.assert_allclose(
                a.step.value[:n], want[:n], atol=3e-6 if kv else 1e-3 if dead_time else 1e-4
            )
            if (
                kv is None and not dead_time
            ):  # the velocity has R times the slope of the torque in it, at once
                jump = R * 100.0 * 2 * np.pi * 60.0
                assert a.step.value[0] == pytest.approx(jump / (1 + jump), rel=1e-9)
            assert a.disturbance_step.peak == pytest.approx(b.disturbance_step.peak, rel=1e-3)


def test_fast_and_slow_motion_are_both_resolved():
    # a drive with friction of its own at 2 kHz, and an integral of 20 s: 5 decades between the
    # fastest and the slowest
    plant = masses((1.0, 0.02), (1e6,), (3.0,))
    controller = updyn.Controller(3e3, 20.0, 100.0)
    step = updyn.servo(plant, controller, **FULL, disturbance_step=1.0).disturbance_step
    assert len(step.time) < 30_000
    s = control.tf("s")
    K = 3e3 * (1 + 1 / (20.0 * s)) * (100.0 + s) / s
    D11 = control.tf([1.0, 3.0, 1e6], [1]) + K * s
    load = control.minreal(
        D11 / (D11 * control.tf([0.02, 3.0, 1e6], [1]) - control.tf([3.0, 1e6], [1]) ** 2),
        1e-9,
        verbose=False,
    )
    poles = load.poles()
    residues = np.array([load.num[0][0] @ p ** np.arange(len(load.num[0][0]))[::-1] for p in poles])
    below = np.array(
        [np.prod(p - np.delete(poles, i)) * load.den[0][0][0] for i, p in enumerate(poles)]
    )
    shares = residues / below / poles  # of exp(p t) in the step response
    want = load.dcgain() + (shares * np.exp(np.outer(step.time, poles))).sum(axis=1).real
    np.testing.assert_allclose(step.value, want, atol=1e-6 * np.abs(want).max())
    assert step.settling_time is not None
    assert np.diff(step.time).max() > 20 * np.diff(step.time).min()


def test_a_response_of_drifting_goes_nowhere():
    # the velocity loop without integral part under a steady torque: the angle drifts
    found = updyn.servo(
        rigid(2.0), updyn.Controller(4.0), **NAMES, disturbance="wind", pointing="angle"
    )
    assert np.isnan(found.disturbance_step.final)
    assert found.disturbance_step.settling_time is None
    stiff = updyn.servo(
        rigid(2e9), updyn.Controller(4e9), **NAMES, disturbance="wind", pointing="angle"
    )
    assert np.isnan(stiff.disturbance_step.final)


def test_jumps_come_back_at_every_dead_time():
    # A step of the disturbance makes the displacement jump by R, the torque by -kp w R with the
    # low-pass w, one dead time later; that by R times it again, and so on.
    R, T, w = 1e-5, 4e-3, 2 * np.pi * 60.0
    plant = two_masses(outputs=("angle", "load"))
    loose = replace(plant, D=np.full((2, 2), R))
    controller = updyn.Controller(100.0, 0.3, 3.0, low_pass=60.0, dead_time=T)
    opened = Cascade(
        loose, controller, Wiring.of(loose, controller, "motor", "angle", None, "load", "wind")
    ).open_at_delay()
    time, outputs, _ = delayed_response(
        opened, np.array([0.0, 0, 0, 1]), np.zeros(opened.n_states), T, T / 400, 1400
    )
    torque = outputs[:, 0]
    for k in (1, 2, 3):
        assert time[400 * k] == pytest.approx(k * T, rel=1e-12)
        jump = torque[400 * k] - torque[400 * k - 1] - (torque[400 * k - 1] - torque[400 * k - 2])
        assert jump == pytest.approx((-100.0 * w * R) ** k, rel=0.05)


@pytest.mark.parametrize("leak", [0.0, 1e-5])
def test_a_velocity_loop_on_a_held_structure_returns_to_zero(leak):
    plant = masses((MOTOR, LOAD), (STIFFNESS,), (5.0,), ground=STIFFNESS)
    torque, speed = plant.inputs.index("motor"), plant.outputs.index("speed")
    D = plant.D.copy()
    D[speed, torque] += leak  # as a fitted plant may have: a gain at rest that is not quite zero
    found = updyn.servo(replace(plant, D=D), updyn.Controller(kp=20.0), **NAMES)
    step = found.step
    assert abs(step.final) < 1e-2 * abs(step.peak)
    assert step.returns
    assert step.rise_time is None
    assert step.overshoot is None
    late = np.abs(step.value - step.final) > 0.02 * abs(step.peak)
    assert step.time[late].max() == pytest.approx(step.settling_time, abs=2e-3)
    text = found.summary()
    assert "returns to zero" in text
    assert "overshoots" not in text
    assert "rises" not in text


def test_a_loop_with_little_gain_at_rest_keeps_its_figures():
    plant = masses((MOTOR, LOAD), (STIFFNESS,), (5.0,), ground=STIFFNESS)
    kp, ti = 20.0, 0.05
    step = updyn.servo(plant, updyn.Controller(kp=kp, ti=ti), **NAMES).step
    gain = kp / ti / STIFFNESS  # of the loop at rest: what the integrator makes of the flexibility
    assert step.final == pytest.approx(gain / (1 + gain), rel=1e-6)
    assert not step.returns
    assert step.overshoot == pytest.approx(step.value.max() / step.final - 1.0, rel=1e-3)
