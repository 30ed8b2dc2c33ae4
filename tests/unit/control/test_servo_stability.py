"""Stability of the loops: unstable ones say so; the turns of L against eigenvalues; anything that may be put in."""

from __future__ import annotations

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import updyn
from servo_cases import BOTH, NAMES, PI_, as_control, compare, masses, quick, rigid, two_masses
from updyn.control.servo.loops import Cascade, Wiring
from updyn.control.servo.stability import count_drifting, count_growing, judge_loops, nyquist_count
from updyn.control.servo.state_space import StateSpace, Transfer, channel_zeros


# -- instability -------------------------------------------------------------------------------------------
def test_an_unstable_loop_says_so():
    # the speed of the load fed back: the resonance turns unstable (noncollocated)
    found = quick(two_masses(), PI_, torque="motor", velocity="load speed")
    m = found.velocity_loop.margins
    assert not m.stable
    assert m.unstable_poles == 2
    for name in (
        "gain_margin",
        "gain_reduction",
        "phase_margin",
        "delay_margin",
        "modulus_margin",
        "gain_margin_db",
        "gain_reduction_db",
    ):
        assert getattr(m, name) is None
    assert len(m.gain_crossings)
    assert found.bandwidth is None
    assert not found.stable
    assert "UNSTABLE" in found.summary()
    assert "no time responses" in found.notes[-1]


def test_a_port_counted_the_wrong_way_is_told():
    plant = two_masses()
    turned = updyn.Plant(
        plant.A,
        -plant.B,
        plant.C,
        plant.D,
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
    found = quick(turned, PI_, **NAMES)
    assert not found.stable
    assert "reverse one of the two ports" in found.notes[0]
    with pytest.raises(updyn.errors.ModelError, match="the negative way"):
        updyn.Controller.tuned(turned, 2.0, **NAMES)


def test_conditionally_stable_loop_has_a_lower_gain_margin():
    # PI on a rigid body begins at -180 deg; a notch below the crossover takes it further down while
    # the gain is high
    def at(kp):
        return updyn.Controller(kp, 2.0, notches=updyn.Notch(0.1, 0.05, 0.5), low_pass=20.0)

    found = quick(rigid(1.0), at(20.0), **NAMES).velocity_loop.margins
    assert found.stable
    compare(found, as_control(at(20.0)) * control.tf([1], [1, 0]))
    assert 0 < found.gain_reduction < 1
    assert found.gain_margin == np.inf
    for factor, steady in ((1.001, False), (0.999, True)):
        lower = quick(
            rigid(1.0), at(20.0 * found.gain_reduction / factor), **NAMES
        ).velocity_loop.margins
        assert lower.stable is steady
    assert f"gain reduction  {found.gain_reduction_db:.4g} dB" in found.summary()


@given(
    J=st.lists(st.floats(0.1, 10.0), min_size=1, max_size=4),
    stiff=st.floats(1e2, 1e5),
    loss=st.floats(1e-4, 1e-2),
    kp=st.floats(0.5, 500.0),
    ti=st.one_of(st.none(), st.floats(0.02, 2.0)),
    kv=st.one_of(st.none(), st.floats(0.1, 40.0)),
    low=st.floats(5.0, 200.0),
    end=st.booleans(),
)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_turns_of_the_loop_function_count_the_eigenvalues(J, stiff, loss, kp, ti, kv, low, end):
    n = len(J) - 1
    plant = masses(J, [stiff] * n, [loss * stiff] * n)
    controller = updyn.Controller(kp, ti, kv, low_pass=low)
    names = {"torque": "motor", "velocity": "load speed" if end else "speed"}
    if kv is not None:
        names["position"] = "angle"
    cascade = Cascade(
        plant,
        controller,
        Wiring.of(
            plant, controller, **{"position": None, **names}, pointing=None, disturbance=None
        ),
    )
    for judged, position in zip(judge_loops(cascade), (False, True), strict=True):
        if judged is None:
            continue
        poles = cascade.closed_loop(0, position=position).poles
        scale = judged.w[0] / 0.02
        if (np.abs(poles.real) < 1e-6 * np.abs(poles))[np.abs(poles) > 1e-5 * scale].any():
            continue  # on the axis, but for rounding
        own = cascade.poles if position else cascade.velocity_poles
        whole = cascade.torque if position else cascade.velocity
        drifting = count_drifting(poles, scale)
        assert nyquist_count(whole, judged.w, own, drifting) == count_growing(poles, scale)


@given(
    dead_time=st.floats(1e-4, 8e-2),
    kp=st.floats(5.0, 800.0),
    kv=st.floats(0.5, 20.0),
    stiff=st.floats(3e2, 3e4),
    low=st.floats(10.0, 200.0),
    end=st.booleans(),
)
@settings(max_examples=40, deadline=None, derandomize=True)
def test_turns_with_dead_time_are_those_of_a_high_approximation(dead_time, kp, kv, stiff, low, end):
    plant = two_masses(stiffness=stiff, damping=1e-3 * stiff)
    controller = updyn.Controller(kp, 0.3, kv, low_pass=low, dead_time=dead_time)
    wiring = Wiring.of(
        plant, controller, "motor", "load speed" if end else "speed", "angle", None, None
    )
    cascade = Cascade(plant, controller, wiring)
    for judged, position in zip(judge_loops(cascade), (False, True), strict=True):
        poles = cascade.closed_loop(12, position=position).poles
        poles = poles[np.abs(poles) > 1e-6]
        slow = np.abs(poles) < 8 / dead_time  # where an approximation of order 12 is exact
        if (np.abs(poles.real) < 1e-5 * np.abs(poles)).any() or (poles[~slow].real > 0).any():
            continue
        assert judged.margins.unstable_poles == (poles[slow].real > 0).sum()


def test_undamped_modes_are_judged():
    found = quick(
        two_masses(damping=0.0), PI_, **NAMES
    ).velocity_loop  # damped by the controller alone
    assert found.margins.stable
    assert len(found.margins.gain_crossings) == 3
    far = quick(two_masses(damping=0.0), PI_, torque="motor", velocity="load speed").velocity_loop
    assert far.margins.unstable_poles == 2


def test_torque_that_moves_nothing_is_told():
    A = np.diag([-1.0, -2.0])
    plant = updyn.Plant(
        A,
        np.eye(2)[:, :1],
        np.eye(2)[1:],
        np.zeros((1, 1)),
        (updyn.Port.at("1:RZ"),),
        (updyn.Port.at("2:RZ"),),
        ("mobility",),
        (0.0, 1.0),
        0.02,
        0.0,
        0.0,
        "by hand",
    )
    with pytest.raises(updyn.errors.ModelError, match="does not move '2:RZ'"):
        quick(plant, PI_, torque="1:RZ", velocity="2:RZ")


@pytest.mark.parametrize("dead_time", [0.0, 2e-3])
@pytest.mark.parametrize("name", ["velocity", "position"])
def test_margins_are_where_the_loop_turns_unstable(name, dead_time):
    def at(kp=100.0, kv=8.0, late=0.0):
        controller = updyn.Controller(kp, 0.3, kv, low_pass=60.0, dead_time=dead_time + late)
        return getattr(quick(two_masses(), controller, **BOTH), f"{name}_loop").margins

    m = at()
    gain = "kp" if name == "velocity" else "kv"
    start = {"kp": 100.0, "kv": 8.0}
    for factor, stable in ((0.9999, True), (1.0001, False)):
        if np.isfinite(m.gain_margin):
            assert at(**{gain: start[gain] * m.gain_margin * factor}).stable is stable
        if name == "velocity":
            assert at(late=m.delay_margin * factor).stable is stable


def test_delay_margin_of_a_resonance_that_lies_beyond_180_degrees():
    # With 110 ms of dead time the peak is passed from -210 to -390 deg: stable, and its phase
    # margin negative. Further dead time has to turn it by 330 deg, or another crossing by less.
    plant = two_masses(damping=0.02)

    def at(late=0.0):
        return quick(
            plant, updyn.Controller(12.0, dead_time=0.112 + late), **NAMES
        ).velocity_loop.margins

    m = at()
    assert m.stable
    beyond = m.phase_margins < 0
    assert beyond.any()
    np.testing.assert_allclose(
        m.delay_margins,
        np.radians(m.phase_margins % 360.0) / (2 * np.pi * m.gain_crossings),
        rtol=1e-9,
    )
    assert m.delay_margin == m.delay_margins.min()
    assert at(0.999 * m.delay_margin).stable
    assert not at(1.001 * m.delay_margin).stable


@pytest.mark.parametrize("units", [1e-9, 1e6, 1e12])
def test_units_change_nothing(units):
    plant = two_masses()
    scaled = updyn.Plant(
        plant.A,
        plant.B / units,
        plant.C,
        plant.D,
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
    names = {**BOTH, "disturbance": "wind", "pointing": "load"}
    for dead_time in (0.0, 2e-3):
        controller = updyn.Controller(100.0, 0.3, 3.0, low_pass=60.0, dead_time=dead_time)
        a = updyn.servo(plant, controller, **names, duration=0.5)
        b = updyn.servo(
            scaled,
            updyn.Controller(100.0 * units, 0.3, 3.0, low_pass=60.0, dead_time=dead_time),
            **names,
            duration=0.5,
        )
        assert b.plant["inertia"] == pytest.approx(7.0 * units, rel=1e-9)
        for one, other in zip(a.loops, b.loops, strict=True):
            assert other.margins.phase_margin == pytest.approx(one.margins.phase_margin, rel=1e-9)
            assert other.margins.gain_margin == pytest.approx(one.margins.gain_margin, rel=1e-9)
            assert other.margins.drifting == one.margins.drifting
        assert b.step.overshoot == pytest.approx(a.step.overshoot, rel=1e-4)
        assert b.disturbance_step.peak * units == pytest.approx(a.disturbance_step.peak, rel=1e-4)
        assert b.disturbance_step.final * units == pytest.approx(a.disturbance_step.final, rel=1e-5)


# -- anything ----------------------------------------------------------------------------------------------
@given(
    J=st.lists(st.floats(0.01, 10.0), min_size=1, max_size=5),
    stiff=st.floats(1e1, 1e6),
    loss=st.sampled_from([1e-6, 1e-4, 1e-2]),
    crossover=st.floats(0.01, 100.0),
    gain=st.floats(0.1, 10.0),
    ti=st.one_of(st.none(), st.floats(0.1, 10.0)),
    kv=st.one_of(st.none(), st.floats(0.01, 1.0)),
    low=st.one_of(st.none(), st.floats(1.0, 100.0)),
    late=st.sampled_from([0.0, 0.01, 0.3]),
    notch=st.one_of(
        st.none(), st.tuples(st.floats(0.1, 1e3), st.sampled_from([0.0, 0.1]), st.floats(0.02, 1.0))
    ),
    velocity=st.sampled_from(["speed", "angle", "load speed"]),
)
@settings(max_examples=30, deadline=None, derandomize=True)
def test_crossings_are_where_they_are_said_to_be(
    J, stiff, loss, crossover, gain, ti, kv, low, late, notch, velocity
):
    n, w = len(J) - 1, 2 * np.pi * crossover
    plant = masses(J, [stiff] * n, [loss * stiff] * n)
    controller = updyn.Controller(
        sum(J) * w * gain,
        ti and ti / w,
        kv and kv * w,
        () if notch is None else updyn.Notch(*notch),
        low and low * crossover,
        dead_time=late / w,
    )
    found = quick(plant, controller, torque="motor", velocity=velocity)
    cascade = Cascade(
        plant, controller, Wiring.of(plant, controller, "motor", velocity, None, None, None)
    )
    for loop, L in zip(found.loops, (cascade.velocity, cascade.position), strict=False):
        m = loop.margins
        at = 2j * np.pi * m.gain_crossings
        sharp = (
            1e-14
            * np.abs(at)
            * np.abs(np.log(np.abs(L(at * (1 + 1e-9)) / L(at))) / (1e-9 * np.abs(at)))
        )
        assert (np.abs(np.abs(L(at)) - 1) < 1e-9 + 10 * sharp).all()
        np.testing.assert_allclose(np.exp(1j * np.radians(m.phase_margins)), -L(at), rtol=1e-6)
        crossed = L(2j * np.pi * m.phase_crossings)
        assert (crossed.real < 0).all()
        assert (np.abs(crossed.imag) < 1e-6 * np.abs(crossed)).all()
        np.testing.assert_allclose(m.gain_margins, 1 / np.abs(crossed), rtol=1e-9)
        # no line of the drawing lies on the other side of gain 1 from its neighbours without a
        # crossing between
        above = np.abs(loop.L) > 1
        assert (above[1:] != above[:-1]).sum() <= len(m.gain_crossings)
        if m.stable:
            assert m.modulus_margin <= np.abs(1 + loop.L).min() * (1 + 1e-7)


def test_undamped_poles_and_zeros_are_no_crossings():
    chain = masses((3.7, 0.088, 0.042, 0.29), (6.7e5, 5.8e4, 2e3), (0.0, 0.0, 0.0))
    controller = updyn.Controller(1987.0, 0.00234, 12.0, low_pass=2812.0, dead_time=6e-5)
    for velocity in ("load speed", "speed"):
        found = updyn.servo(
            chain,
            controller,
            torque="motor",
            velocity=velocity,
            position="angle",
            disturbance="wind",
        )
        for loop in found.loops:
            assert np.isfinite(loop.L).all()
            assert ((loop.margins.gain_margins > 1e-8) & (loop.margins.gain_margins < 1e8)).all()
    A, at = np.array([[0.0, 2 * np.pi], [-2 * np.pi, 0.0]]), (updyn.Port.at("1:RZ"),)
    held = updyn.Plant(
        A, [[0], [1]], [[0, 1]], [[0]], at, at, ("mobility",), (0.0, 2.0), 0.02, 0.0, 0.0, "by hand"
    )  # fmt: skip
    with pytest.raises(updyn.errors.DataError, match="on the imaginary axis"):
        quick(held, PI_, torque="1:RZ", velocity="1:RZ", freq=[0.5, 1.0])


def test_long_dead_time_beside_fast_modes():
    # 31 ms on a drive with a mode at 50 kHz: the phase turns 1500 times up to there, at a gain that
    # has vanished
    plant = masses((3.0, 1e-3), (1e8,), (1.0,))
    found = quick(plant, updyn.Controller(20.0, 1.0, dead_time=0.031), **NAMES)
    assert found.velocity_loop.margins.stable
    assert found.velocity_loop.freq[-1] < 1e4


def test_loops_that_act_one_way_are_balanced_within_bounds():
    # cut at its dead time the loop is a chain without return, which balancing alone would scale
    # without end
    found = updyn.servo(
        rigid(2.12836733), updyn.Controller(29.5, 0.0917, 1.722, feed_forward=0.7, dead_time=1.56e-3),
        torque="motor", velocity="load speed", position="angle", disturbance="wind", pointing="speed")  # fmt: skip
    assert np.isfinite(found.disturbance_step.value).all()
    assert found.disturbance_step.peak > 0


def test_fast_modes_do_not_round_the_slow_rigid_body():
    # real modes to 3 kHz, their damping coupled, beside a rigid body: at 1 mHz the response is 1 /
    # (J s) to 1e-12
    rng, n = np.random.default_rng(0), 21
    omega = 2 * np.pi * np.concatenate([[0.0], np.geomspace(3, 3000, n - 1)])
    root, phi = np.sqrt(np.outer(omega, omega)), rng.normal(size=n)
    Q = rng.normal(size=(n, n))
    damping = 0.01 / n * (Q @ Q.T) * root
    scale = np.where(omega > 0, omega, 1.0)
    zero = np.zeros((n, n))
    A = np.block([[zero, np.diag(scale)], [-np.diag(omega**2 / scale), -damping]])
    system = StateSpace(
        A, np.append(0 * phi, phi)[:, None], np.append(phi / scale, 0 * phi)[None], np.zeros((1, 1))
    )
    s = 2j * np.pi * np.geomspace(1e-3, 3e3, 40)
    want = [phi @ np.linalg.solve(np.diag(omega**2 + x**2) + x * damping, phi) for x in s]
    np.testing.assert_allclose(Transfer.of(system).at(s)[:, 0, 0], want, rtol=1e-9)
    np.testing.assert_allclose(Transfer.of(system).at(s)[:8, 0, 0], want[:8], rtol=1e-12)
    zeros = channel_zeros(system)
    assert len(zeros) == 2 * n - 2
    assert np.abs(Transfer.of(system).at(zeros)).max() < 1e-6 * np.abs(want).min()
