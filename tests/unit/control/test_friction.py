"""Coulomb friction: motion with an end, sticking, and limit cycles with a closed form."""

import copy

import numpy as np
import pytest
import scipy.linalg
from numpy.testing import assert_allclose
from scipy.optimize import fsolve

from nonlinear_plants import one_inertia, two_inertias
from updyn.control.nonlinear.balance import limit_cycles
from updyn.control.nonlinear.simulate import simulate
from updyn.control.servo.controller import Controller
from updyn.errors import ModelError, OptionError, SolverError
from updyn.nonlinear.backlash import Backlash
from updyn.nonlinear.friction import CoulombFriction

TWO_PI = 2 * np.pi
AXIS = {"measured": ["angle", "drag"], "torque": "torque"}


def pid(kp, ki, kd, kii=0.0):
    """-kp x - kd v - ki int x - kii int int x as (A, B, C, D) of angle and speed."""
    return (
        np.array([[0, 1.0], [0, 0]]),
        np.array([[0, 0], [1.0, 0]]),
        np.array([[-kii, -ki]]),
        np.array([[-kp, -kd]]),
    )


def test_relay_of_the_textbook():
    assert_allclose(CoulombFriction(2.0).describing([0.5, 4.0], 3.0), [16 / np.pi, 2 / np.pi])
    assert_allclose(CoulombFriction(2.0).amplitude(16 / np.pi, 3.0), 0.5)


def test_coasting_inertia_stops_and_stays():
    run = simulate(one_inertia(2.0), None, CoulombFriction(0.5), 5.0, "drag", start=[0.0, 0.6])
    stop = 2.0 * 0.6 / 0.5
    assert_allclose(run.switches, [stop], rtol=1e-9)
    moving = run.time < stop
    assert_allclose(run["drag"][moving], 0.6 - 0.25 * run.time[moving], atol=1e-12)
    assert_allclose(run["angle"][-1], 0.5 * 0.6 * stop, rtol=1e-9)
    assert_allclose(run["drag"][~moving], 0.0, atol=1e-12)
    assert (run.phase[-1], run.verdict) == ("stick", "at rest")


def test_breakaway():
    law = CoulombFriction(0.5, breakaway=0.8)
    held = simulate(one_inertia(), None, law, 3.0, "drag", constant={"torque": 0.79})
    assert set(held.phase) == {"stick"}
    assert_allclose(held.torque, 0.79, rtol=1e-12)
    assert_allclose(held["angle"], 0.0)
    away = simulate(one_inertia(), None, law, 3.0, "drag", constant={"torque": -0.81})
    assert_allclose(away["drag"][-1], -(0.81 - 0.5) * away.time[-1], rtol=1e-9)
    assert away.torque[-1] == -0.5


def test_stick_and_slip_on_a_belt_by_the_closed_form():
    """Spring pulled at a steady speed: slip lasts 2 (pi - atan(df / (v sqrt(k m)))) / omega, stick 2 df / (k v)."""
    k, speed, law = 9.0, 0.05, CoulombFriction(0.5, breakaway=0.9)
    # The end of the spring runs away: two integrals, of which one begins with its speed.
    belt = (
        np.array([[0, 1.0], [0, 0]]),
        np.zeros((2, 2)),
        np.array([[k, 0.0]]),
        np.array([[-k, 0.0]]),
    )
    run = simulate(one_inertia(), belt, law, 60.0, "drag", start=[0, 0, 0, speed], **AXIS)
    slips = run.switches[
        run.phase[np.searchsorted(run.time, run.switches, side="right") - 1] == "slip +"
    ]
    omega, drop = np.sqrt(k), 0.4
    period = 2 * drop / (k * speed) + 2 / omega * (np.pi - np.arctan(drop / (speed * np.sqrt(k))))
    assert_allclose(np.diff(slips), period, rtol=1e-6)
    assert run.verdict == "limit cycle"
    assert_allclose(run.frequency, 1 / period, rtol=1e-3)


@pytest.mark.parametrize("kd", [12.0, 15.0])
def test_limit_cycle_of_a_loop_with_two_integrals(kd):
    """Conditionally stable. By Routh with D = kd + N: kii D^2 - kp ki D + ki^2 = 0, omega^2 = ki / D."""
    kp, ki, kii = 10.0, 12.0, 6.0
    D = max(np.roots([kii, -kp * ki, ki**2]))
    law, control = CoulombFriction(1.0), pid(kp, ki, kd, kii)
    (cycle,) = limit_cycles(one_inertia(), control, law, "drag", **AXIS)
    assert cycle.stable
    assert cycle.doubt == ""
    assert_allclose(cycle.amplitude, 4 / (np.pi * (D - kd)), rtol=1e-8)
    assert_allclose(cycle.frequency, np.sqrt(ki / D) / TWO_PI, rtol=1e-8)
    for scale in (0.7, 1.3):
        run = simulate(one_inertia(), control, law, 300.0, "drag", start=cycle, scale=scale, **AXIS)
        assert run.verdict == "limit cycle"
        assert_allclose(run.amplitude, cycle.amplitude, rtol=0.1)
        assert_allclose(run.frequency, cycle.frequency, rtol=0.1)


def test_every_limit_cycle_is_found():
    """Too little damping for the two integrals: between the roots of Routh's condition the loop is stable."""
    kp, ki, kii, kd = 10.0, 12.0, 6.0, 0.5
    D = np.sort(np.roots([kii, -kp * ki, ki**2]))
    found = limit_cycles(one_inertia(), pid(kp, ki, kd, kii), CoulombFriction(1.0), "drag", **AXIS)
    assert_allclose([c.frequency for c in found], np.sqrt(ki / D[::-1]) / TWO_PI, rtol=1e-8)
    assert_allclose([c.amplitude for c in found], 4 / np.pi / (D[::-1] - kd), rtol=1e-8)
    assert [c.stable for c in found] == [
        True,
        False,
    ]  # what grows beyond the outer one does so without end
    assert not found.linear_stable
    again = copy.copy(found)
    assert (again, again.band, again.linear_stable) == (found, found.band, False)


def test_unstable_limit_cycle_is_a_border():
    """PID beyond its limit: friction holds what is small; N = ki / kp - kd and omega^2 = kp by hand."""
    kp, ki, kd = 10.0, 12.0, 0.5
    control, law = pid(kp, ki, kd), CoulombFriction(1.0)
    found = limit_cycles(one_inertia(), control, law, "drag", **AXIS)
    (cycle,) = found
    assert_allclose(
        [cycle.amplitude, cycle.frequency], [4 / np.pi / 0.7, np.sqrt(kp) / TWO_PI], rtol=1e-8
    )
    assert not cycle.stable
    assert not found.linear_stable
    inside, outside = (
        simulate(one_inertia(), control, law, 30.0, "drag", start=cycle, scale=s, **AXIS)
        for s in (0.85, 1.15)
    )
    assert inside.verdict in ("decays", "at rest")
    assert outside.verdict == "grows"
    # The exact border, without describing functions: half a turn under constant friction maps a
    # state to its opposite.
    A = np.array([[0, 1, 0], [-kp, -kd, -ki], [1, 0, 0]], dtype=float)
    b = np.array([0.0, -1.0, 0.0])

    def turned(unknown):
        x0, half = np.array([unknown[0], 0.0, unknown[1]]), unknown[2]
        M = scipy.linalg.expm(np.block([[A, b[:, None]], [np.zeros((1, 4))]]) * half)
        return M[:3, :3] @ x0 + M[:3, 3] + x0

    omega = TWO_PI * cycle.frequency
    x, s, half = fsolve(turned, [-cycle.amplitude / omega, 0.0, np.pi / omega])
    assert_allclose(0.5 / half, cycle.frequency, rtol=0.02)
    for scale, verdict in ((0.97, ("decays", "at rest")), (1.03, ("grows",))):
        start = np.array([x, 0.0, 0.0, s]) * scale
        assert (
            simulate(one_inertia(), control, law, 40.0, "drag", start=start, **AXIS).verdict
            in verdict
        )


def test_growth_beyond_all_numbers():
    with pytest.raises(SolverError, match=r"overflows at .* unstable"):
        simulate(
            one_inertia(),
            pid(10, 500, 0.1),
            CoulombFriction(1.0),
            500.0,
            "drag",
            start=[1e3, 0],
            **AXIS,
        )


def test_no_limit_cycle_without_an_integral_and_both_say_so():
    control, law = Controller(2.0, kv=3.0), CoulombFriction(1.0)
    names = {"velocity": "drag", "position": "angle", "torque": "torque"}
    found = limit_cycles(one_inertia(), control, law, "drag", **names)
    assert len(found) == 0
    assert found.linear_stable
    assert "predicts no limit cycle" in found.summary()
    run = simulate(one_inertia(), control, law, 20.0, "drag", start=[1.0, 0.0], **names)
    assert run.verdict == "at rest"
    # It sticks where the loop's torque is within the friction.
    assert abs(run["angle"][-1]) <= 1.0 / 6.0
    assert "no limit cycle" in run.summary()


def test_reference_step_ends_within_the_band_of_friction():
    names = {"velocity": "drag", "position": "angle", "torque": "torque"}
    run = simulate(
        one_inertia(),
        Controller(2.0, kv=3.0),
        CoulombFriction(0.3),
        30.0,
        "drag",
        constant={"reference": 1.0},
        **names,
    )
    assert abs(run["angle"][-1] - 1.0) <= 0.3 / 6.0 * (1 + 1e-9)
    assert run.phase[-1] == "stick"


@pytest.mark.parametrize(
    ("plant", "at", "error", "said"),
    [
        (
            two_inertias,
            "gap",
            OptionError,
            "CoulombFriction acts on velocities, but output 'gap' .* make the plant with 'mob",
        ),
        (two_inertias, ("speed", "wind"), ModelError, "does not accelerate 'speed'"),
    ],
)
def test_friction_needs_a_port_of_its_own(plant, at, error, said):
    with pytest.raises(error, match=said):
        limit_cycles(plant(), None, CoulombFriction(1.0), at)


def test_bad_numbers():
    with pytest.raises(OptionError, match="breakaway 1 is below level 2"):
        CoulombFriction(2.0, breakaway=1.0)
    with pytest.raises(OptionError, match="friction: level"):
        CoulombFriction(0.0)
    with pytest.raises(OptionError, match="expected measured="):
        limit_cycles(one_inertia(), pid(1, 1, 1), CoulombFriction(1.0), "drag", torque="torque")
    with pytest.raises(OptionError, match=r"2 inputs and 1 outputs; expected 1 \(measured\)"):
        limit_cycles(
            one_inertia(),
            pid(1, 1, 1),
            CoulombFriction(1.0),
            "drag",
            torque="torque",
            measured="angle",
        )
    with pytest.raises(OptionError, match="Backlash acts on twists"):
        limit_cycles(one_inertia(), pid(1, 1, 1), Backlash(1.0, 1.0), "drag", **AXIS)
