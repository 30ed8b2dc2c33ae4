"""The cascade's controller: transfer functions, states, rules, errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import updyn
from servo_cases import masses, rigid, two_masses
from updyn.control.servo.controller import rigid_inertia

NOTCHES = (updyn.Notch(9.0, 0.1, 0.5), updyn.Notch.of_width(40.0, 20.0, 0.2))
S = 2j * np.pi * np.array([0.1, 3.0, 9.0, 40.0, 300.0])


def response(system, s):
    n = system.n_states
    return np.array(
        [
            (system.C @ np.linalg.solve(x * np.eye(n) - system.A, system.B) + system.D)[0, 0]
            for x in s
        ]
    )


@pytest.mark.parametrize("ti", [None, 0.2])
@pytest.mark.parametrize(("corner", "damping"), [(None, None), (80.0, None), (80.0, 0.6)])
def test_states_give_the_same_response(ti, corner, damping):
    controller = updyn.Controller(
        3.0, ti, notches=NOTCHES, low_pass=corner, low_pass_damping=damping
    )
    want = controller.torque(S)
    np.testing.assert_allclose(response(controller.state_space(), S), want, rtol=1e-11)
    late = updyn.Controller(3.0, ti, None, NOTCHES, corner, damping, dead_time=1e-3)
    np.testing.assert_allclose(late.torque(S), want * np.exp(-1e-3 * S), rtol=1e-13)
    np.testing.assert_allclose(response(late.state_space(8), S), late.torque(S), rtol=1e-8)
    np.testing.assert_allclose(
        np.sort_complex(controller.state_space().poles),
        np.sort_complex(controller.poles),
        rtol=1e-9,
        atol=1e-9,
    )
    # poles, zeros and the gain say the same once more
    product = (
        3.0
        * np.prod(S[:, None] - controller.zeros, axis=1)
        / np.prod(S[:, None] - controller.poles, axis=1)
    )
    w = 1.0 if corner is None else 2 * np.pi * corner
    np.testing.assert_allclose(product * (w if damping is None else w**2), want, rtol=1e-11)


def test_notch_has_its_depth_and_width():
    notch = updyn.Notch.of_width(40.0, 20.0, 0.2)
    assert abs(notch.at(2j * np.pi * 40.0)) == pytest.approx(0.2, rel=1e-12)
    assert (notch.width, notch.depth) == (pytest.approx(20.0), pytest.approx(0.2))
    full = updyn.Notch.of_width(40.0, 20.0)
    # |N|^2 = 1/2 where |w^2 - w0^2| = B w: at f0 (sqrt(1 + (B/2f0)^2) +- B/2f0), B apart
    half = np.sqrt(1 + 0.25**2) + np.array([-0.25, 0.25])
    np.testing.assert_allclose(np.abs(full.at(2j * np.pi * 40.0 * half)), np.sqrt(0.5), rtol=1e-12)
    assert np.diff(40 * half)[0] == pytest.approx(20.0)


def test_tuned_has_the_margin_of_its_rule():
    plant = rigid(4.0)
    controller = updyn.Controller.tuned(plant, 3.0, torque="motor", velocity="speed")
    w = 6 * np.pi
    assert controller.kp == pytest.approx(4.0 * w, rel=1e-9)
    assert controller.ti == pytest.approx(2 / w)
    assert controller.kv == pytest.approx(w / 4)
    # symmetrical optimum: with a small time constant 1 / (a w) the phase margin is arctan(a) -
    # arctan(1/a), at w
    for a in (2.0, 4.0):
        lag = a * 3.0
        own = updyn.Controller.tuned(
            plant, 3.0, torque="motor", velocity="speed", ti_ratio=a, kv_ratio=None, low_pass=lag
        )
        m = updyn.servo(plant, own, torque="motor", velocity="speed").velocity_loop.margins
        assert m.crossover == pytest.approx(3.0, rel=1e-9)
        assert m.phase_margin == pytest.approx(
            np.degrees(np.arctan(a) - np.arctan(1 / a)), rel=1e-8
        )
        shifted = updyn.Controller.tuned(
            plant,
            3.0,
            torque="motor",
            velocity="speed",
            ti=0.9 * own.ti,
            kv_ratio=None,
            low_pass=0.9 * lag,
        )
        assert (
            updyn.servo(
                plant, shifted, torque="motor", velocity="speed"
            ).velocity_loop.margins.phase_margin
            < m.phase_margin
        )
    # kv: critical damping of s^2 + w s + w kv
    p = updyn.Controller.tuned(plant, 3.0, torque="motor", velocity="speed", ti_ratio=None)
    poles = updyn.servo(plant, p, torque="motor", velocity="angle").poles
    np.testing.assert_allclose(poles, -w / 2, rtol=1e-5)


def sum_of_inertias(plant):
    return {2: 4.0, 4: 7.0, 6: 7.5}[plant.n_states]


def test_inertia_is_that_of_the_rigid_body():
    assert rigid_inertia(two_masses(), "motor", "speed") == pytest.approx(7.0, rel=1e-9)
    assert rigid_inertia(two_masses(), "wind", "load") == pytest.approx(7.0, rel=1e-9)
    chain = masses((2.0, 5.0, 0.5), (3e3, 1e5), (0.1, 3.0))
    assert rigid_inertia(chain, "motor", "load speed") == pytest.approx(7.5, rel=1e-7)
    assert rigid_inertia(two_masses(ground=1e3), "motor", "speed") is None
    # bearing friction: the rigid body has its pole at -c / J, and its inertia all the same
    for free, friction in ((rigid(4.0), 3.0), (two_masses(), 5.0), (chain, 0.2)):
        A, n = free.A.copy(), free.n_states // 2
        A[n:, n:] -= friction / sum_of_inertias(free) * np.eye(n)
        braked = replace(free, A=A)
        assert rigid_inertia(braked, "motor", "speed") == pytest.approx(
            sum_of_inertias(free), rel=1e-7
        )
    with pytest.raises(updyn.errors.ModelError, match="no rigid-body motion"):
        updyn.Controller.tuned(two_masses(ground=1e3), 3.0, torque="motor", velocity="speed")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"kp": -1.0}, "kp is -1.0.*turn the port round"),
        ({"kp": np.nan}, "kp"),
        ({"ti": 0.0}, "ti is 0.0; expected a number above 0, in s \\(None for none\\)"),
        ({"kv": "3"}, "kv is '3'"),
        ({"dead_time": -1e-3}, "dead_time"),
        ({"feed_forward": 1.5, "kv": 1.0}, "feed_forward is 1.5; expected a share from 0 to 1"),
        ({"feed_forward": 0.5}, "without kv"),
        ({"low_pass_damping": 0.7}, "without low_pass"),
        ({"notches": (9.0,)}, r"notches are \(9.0,\)"),
        ({"notches": 9.0}, "notches are 9.0"),
    ],
)
def test_settings_that_cannot_be_are_told(given, message):
    with pytest.raises(updyn.errors.OptionError, match=message):
        updyn.Controller(**{"kp": 1.0, **given})


def test_notches_that_cannot_be_are_told():
    for given in ({"frequency": 0.0}, {"pole_damping": 0.0}, {"zero_damping": -0.1}):
        with pytest.raises(updyn.errors.OptionError, match=next(iter(given))):
            updyn.Notch(**{"frequency": 5.0, **given})
    for width, depth in ((0.0, 0.0), (1.0, -1.0)):
        with pytest.raises(updyn.errors.OptionError, match=r"width|depth"):
            updyn.Notch.of_width(5.0, width, depth)
    assert updyn.Controller(1.0, notches=updyn.Notch(5.0)).notches == (updyn.Notch(5.0),)
