"""Margins of the loops: by hand for a rigid body, by python-control for two masses; Bode and Nichols; families."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import updyn
from servo_cases import (
    BOTH,
    DAMPING,
    LOAD,
    MOTOR,
    NAMES,
    NOTCHED,
    PI_,
    SETS_SHAPES,
    STIFFNESS,
    as_control,
    compare,
    masses,
    quick,
    rigid,
    speed_over_torque,
    two_masses,
)
from updyn.control.family import PlantFamily


# -- a rigid body, by hand ---------------------------------------------------------------------------------
@pytest.mark.parametrize(("kp", "ti", "J"), [(7.0, 0.3, 3.0), (0.02, 40.0, 5.0), (4e4, 1e-2, 0.1)])
def test_pi_on_a_rigid_body(kp, ti, J):
    # L = kp (1 + 1/(ti s)) / (J s): |L| = 1 at w^2 = (a^2 + sqrt(a^4 + 4 a^2 / ti^2)) / 2 with a =
    # kp / J
    a = kp / J
    w = np.sqrt(0.5 * (a**2 + np.sqrt(a**4 + 4 * a**2 / ti**2)))
    m = quick(rigid(J), updyn.Controller(kp, ti), **NAMES).velocity_loop.margins
    assert m.stable
    assert m.drifting == 1
    assert m.crossover == pytest.approx(w / (2 * np.pi), rel=1e-12)
    assert m.phase_margin == pytest.approx(np.degrees(np.arctan(w * ti)), rel=1e-10)
    assert m.delay_margin == pytest.approx(np.arctan(w * ti) / w, rel=1e-10)
    assert m.gain_margin == np.inf
    assert m.gain_reduction == 0
    assert len(m.phase_crossings) == 0


def test_dead_time_takes_phase_and_gives_a_gain_margin():
    kp, J, T = (
        40.0,
        3.0,
        0.05,
    )  # L = kp exp(-s T) / (J s): phase -90 deg - w T, -180 deg at w = pi / (2 T)
    loop = quick(rigid(J), updyn.Controller(kp, dead_time=T), **NAMES).velocity_loop
    m, w = loop.margins, kp / J
    assert m.judged_by == "Nyquist count"
    assert m.phase_margin == pytest.approx(90 - np.degrees(w * T), rel=1e-10)
    assert m.delay_margin == pytest.approx(np.pi / 2 / w - T, rel=1e-10)
    first = 0.25 / T
    turns = np.arange(len(m.phase_crossings))
    assert len(turns) > 1
    np.testing.assert_allclose(m.phase_crossings, first * (1 + 4 * turns), rtol=1e-12)
    np.testing.assert_allclose(m.gain_margins, 2 * np.pi * m.phase_crossings * J / kp, rtol=1e-10)
    assert m.gain_margin == pytest.approx(np.pi / (2 * T) * J / kp, rel=1e-10)
    limit = m.delay_margin + T
    for share, stable in ((0.999, True), (1.001, False)):
        again = quick(
            rigid(J), updyn.Controller(kp, dead_time=share * limit), **NAMES
        ).velocity_loop.margins
        assert again.stable is stable


def test_p_on_a_rigid_body_has_a_position_loop_of_second_order():
    # x_ref -> x: w kv / (s^2 + w s + w kv) with w = kp / J
    kp, J, kv = 12.0, 3.0, 1.0
    found = quick(rigid(J), updyn.Controller(kp, kv=kv), **BOTH)
    w = kp / J
    s = 2j * np.pi * found.freq
    np.testing.assert_allclose(found.reference, w * kv / (s**2 + w * s + w * kv), rtol=1e-10)
    np.testing.assert_allclose(found.position_loop.L, w * kv / (s * (s + w)), rtol=1e-10)
    zeta, wn = 0.5 * np.sqrt(w / kv), np.sqrt(w * kv)
    below = 1 - 2 * zeta**2
    bandwidth = wn * np.sqrt(
        below + np.sqrt(below**2 + 1)
    )  # Franklin, Powell & Emami-Naeini: of (s^2 + 2 zeta wn s)
    assert found.bandwidth == pytest.approx(bandwidth / (2 * np.pi), rel=1e-11)
    assert found.position_loop.bandwidth == pytest.approx(found.bandwidth, rel=1e-12)
    assert found.velocity_loop.bandwidth == pytest.approx(w / (2 * np.pi), rel=1e-7)  # w / (s + w)
    np.testing.assert_allclose(np.sort(found.poles.real), [-2, -2], rtol=1e-6)


# -- two masses, by python-control -------------------------------------------------------------------------
@pytest.mark.parametrize(
    "controller", [PI_, NOTCHED, updyn.Controller(60.0), updyn.Controller(400.0, 0.05, low_pass=30)]
)
def test_velocity_loop_is_that_of_python_control(controller):
    found = quick(
        two_masses(),
        updyn.Controller(
            controller.kp,
            controller.ti,
            None,
            controller.notches,
            controller.low_pass,
            controller.low_pass_damping,
        ),
        **NAMES,
    )
    loop = found.velocity_loop
    L = as_control(controller) * control.tf(*speed_over_torque())
    np.testing.assert_allclose(loop.L, L(2j * np.pi * loop.freq), rtol=1e-9)
    compare(loop.margins, L)


@SETS_SHAPES
@pytest.mark.parametrize("kv", [1.0, 6.0])
@pytest.mark.parametrize("ti", [None, 0.2])
def test_position_loop_is_that_of_python_control(kv, ti):
    controller = updyn.Controller(170.0, ti, kv, low_pass=80.0)
    loop = quick(two_masses(), controller, **BOTH).position_loop
    num, den = speed_over_torque()
    forward = control.tf2ss(as_control(controller) * control.tf(num, den))
    closed = control.ss2tf(control.feedback(forward, 1))
    L = control.minreal(closed * control.tf([kv], [1, 0]), 1e-8, verbose=False)
    np.testing.assert_allclose(loop.L, L(2j * np.pi * loop.freq), rtol=1e-6)
    compare(loop.margins, L, 1e-6)


def test_every_crossing_of_a_resonance_is_found():
    plant = two_masses(damping=0.02)  # 0.02 % of damping: a peak of 5 mHz at half its height
    found = quick(plant, PI_, **NAMES)
    m = found.velocity_loop.margins
    assert len(m.gain_crossings) == 3
    peak = np.sqrt(STIFFNESS * (1 / MOTOR + 1 / LOAD)) / (2 * np.pi)
    assert m.gain_crossings[1] < peak < m.gain_crossings[2]
    w = 2j * np.pi * m.gain_crossings
    exact = (
        PI_.torque(w)
        * (LOAD * w**2 + 0.02 * w + STIFFNESS)
        / (w * (MOTOR * LOAD * w**2 + (MOTOR + LOAD) * (0.02 * w + STIFFNESS)))
    )
    np.testing.assert_allclose(np.abs(exact), 1.0, rtol=1e-9)
    assert m.phase_margin == pytest.approx(
        np.degrees(np.angle(-exact))[np.argmin(np.abs(np.angle(-exact)))], rel=1e-7
    )


def test_a_resonance_that_only_just_reaches_gain_1_is_found():
    # The largest |L| of the peak is set to 1 + 1e-6: two crossings that lie closer together than
    # any lines.
    plant, low = two_masses(), 1.0
    loop = quick(plant, updyn.Controller(low), **NAMES).velocity_loop
    near = loop.freq > 5

    def size(f):
        s = 2j * np.pi * f
        num, den = speed_over_torque()
        return -abs(np.polyval(num, s) / np.polyval(den, s))

    top = loop.freq[near][np.argmax(np.abs(loop.L[near]))]
    best = minimize_scalar(
        size, bounds=(0.99 * top, 1.01 * top), method="bounded", options={"xatol": 1e-12}
    )
    for excess, crossings in ((1e-6, 3), (-1e-6, 1)):
        m = quick(plant, updyn.Controller((1 + excess) / -best.fun), **NAMES).velocity_loop.margins
        assert len(m.gain_crossings) == crossings


# -- Bode and Nichols --------------------------------------------------------------------------------------
def test_phase_goes_through_every_resonance():
    # collocated: P of the velocity starts at -90 deg; zero +180, pole -180, at the end -90 deg less
    # the low-pass
    plant = masses((2.0, 5.0, 1.0), (3e3, 9e3), (0.01, 0.01))
    loop = quick(plant, updyn.Controller(5.0), **NAMES).velocity_loop
    assert loop.phase[0] == pytest.approx(-90, abs=0.1)
    assert loop.phase[-1] == pytest.approx(-90, abs=0.1)
    assert (np.abs(loop.phase) < 90.1).all()
    assert loop.phase.max() > 89
    # noncollocated, with PI: -180 deg, then -180 deg for each of two resonances (and their small
    # zeros at c / k)
    far = quick(
        plant, updyn.Controller(5.0, 2.0), torque="motor", velocity="load speed"
    ).velocity_loop
    assert far.phase[0] == pytest.approx(-180, abs=3)
    past = np.flatnonzero(far.freq > 30)[0]
    assert far.phase[past] == pytest.approx(-450, abs=2)
    np.testing.assert_allclose(
        10 ** (far.magnitude_db / 20) * np.exp(1j * np.radians(far.phase)), far.L, rtol=1e-10
    )
    assert np.abs(np.diff(far.phase)).max() < 60


def test_lines_that_are_given_have_the_same_phase_and_margins():
    plant = masses((2.0, 5.0, 1.0), (3e3, 9e3), (0.01, 0.01))
    controller = updyn.Controller(50.0, 2.0, kv=1.0, dead_time=1e-3, low_pass=200.0)
    own = quick(plant, controller, **BOTH)
    few = quick(plant, controller, **BOTH, freq=own.freq[50::97])
    for a, b in zip(own.loops, few.loops, strict=True):
        np.testing.assert_allclose(b.phase, a.phase[50::97], rtol=1e-9)
        np.testing.assert_allclose(b.L, a.L[50::97], rtol=1e-9)
        assert a.margins.phase_margin == b.margins.phase_margin
    np.testing.assert_allclose(own.position_loop.S + own.position_loop.T, 1.0, rtol=1e-12)


# -- which outputs -----------------------------------------------------------------------------------------
def test_velocity_and_position_from_one_output():
    want = quick(two_masses(), NOTCHED, **BOTH)
    angle = quick(two_masses(), NOTCHED, torque="motor", velocity="angle")
    speed = quick(two_masses(), NOTCHED, torque="motor", velocity="speed")
    for found in (angle, speed):
        for a, b in zip(found.loops, want.loops, strict=True):
            np.testing.assert_allclose(
                b.margins.gain_crossings, a.margins.gain_crossings, rtol=1e-8
            )
            assert a.margins.stable
            assert b.margins.modulus_margin == pytest.approx(a.margins.modulus_margin, rel=1e-8)
    assert angle.position == "angle"
    assert want.position_loop.margins.drifting == 0


def test_residual_flexibility_under_a_derived_velocity():
    # A displacement with feed-through R: u -> y = G + R; the velocity s (G + R) with a low-pass of
    # first order
    plant, R = two_masses(outputs=("angle",)), 1e-6
    loose = updyn.Plant(
        plant.A,
        plant.B,
        plant.C,
        plant.D + R,
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
    names = {"torque": "motor", "velocity": "angle"}
    with pytest.raises(updyn.errors.OptionError, match="low_pass"):
        quick(loose, PI_, **names)
    controller = updyn.Controller(170.0, 0.2, 3.0, low_pass=80.0)
    found = quick(loose, controller, **names)
    num, den = speed_over_torque()
    G = control.tf(num, np.append(den, 0.0)) + R
    L = as_control(controller) * control.tf([1, 0], [1]) * G
    whole = L * (1 + control.tf([3.0], [1, 0]))
    want = np.sort_complex(control.minreal(1 / (1 + whole), 1e-6, verbose=False).poles())
    np.testing.assert_allclose(np.sort_complex(found.poles), want, rtol=1e-5)
    np.testing.assert_allclose(found.velocity_loop.L, L(2j * np.pi * found.freq), rtol=1e-7)


# -- families ----------------------------------------------------------------------------------------------
def test_family_has_its_worst_member():
    k = STIFFNESS * np.array([0.5, 0.8, 1.3, 2.0])
    family = PlantFamily(
        two_masses(), tuple(two_masses(stiffness=x, damping=x * DAMPING / STIFFNESS) for x in k)
    )
    found = quick(family, updyn.Controller(170.0, 0.2, 6.0, dead_time=2e-3), **BOTH)
    for at, loop in enumerate(found.loops):
        single = [quick(m, found.controller, **BOTH).loops[at].margins for m in family.members]
        for name in ("phase_margin", "gain_margin", "modulus_margin", "delay_margin", "crossover"):
            values = [getattr(m, name) for m in single]
            spread = loop.worst[name]
            assert spread.smallest == min(values)
            assert spread.smallest_member == int(np.argmin(values))
            assert spread.largest_member == int(np.argmax(values))
        assert loop.family.shape == (4, len(loop.freq))
        own = quick(family.members[2], found.controller, **BOTH, freq=loop.freq).loops[at]
        np.testing.assert_allclose(loop.family[2], own.L, rtol=1e-10)
        np.testing.assert_allclose(loop.family_phase[2], own.phase, atol=1e-6)
        assert loop.unstable_members == ()
    assert "over 4 members" in found.summary()
    tuned = updyn.Controller.tuned(family, 2.0, **NAMES)
    assert tuned == updyn.Controller.tuned(family.nominal, 2.0, **NAMES)
    harsh = quick(family, updyn.Controller(4000.0, 0.2, 6.0, dead_time=4e-3), **BOTH)
    assert harsh.velocity_loop.unstable_members
    assert "UNSTABLE for 4 of them (0, 1, 2, 3)\n" in harsh.summary()
    plain = quick(family, updyn.Controller(170.0, 0.2, 6.0), **BOTH).summary()
    assert "gain margin     unlimited (all members)" in plain
    assert " dB to unlimited (members 0 and 3)" in plain


# -- errors ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"torque": "moter"}, "no input 'moter'; did you mean 'motor'"),
        ({"velocity": "sped"}, "did you mean 'speed'"),
        ({"position": "angel"}, "did you mean 'angle'"),
        ({"disturbance": "speed"}, "no input 'speed'"),
        ({"freq": [0.0, 1.0]}, "0 Hz"),
        ({"wind": updyn.Wind(10.0, 1.0, turbulence=0.2)}, "name the input"),
    ],
)
def test_wrong_names_are_told(change, message):
    with pytest.raises(updyn.UpdynError, match=message):
        updyn.servo(two_masses(), NOTCHED, **{**BOTH, **change})


def test_plants_that_cannot_serve_are_told():
    with pytest.raises(updyn.errors.OptionError, match="dead_time"):
        quick(updyn.sampled(two_masses(band=(0.0, 10.0)), 1e-3), PI_, **NAMES)
    with pytest.raises(updyn.errors.OptionError, match="without a position loop"):
        quick(two_masses(), PI_, **BOTH)
    accelerance = two_masses(outputs=("speed",), quantities=("accelerance",))
    with pytest.raises(updyn.errors.OptionError, match="is an acceleration"):
        quick(accelerance, PI_, **NAMES)
    with pytest.raises(updyn.errors.OptionError, match="expected a Plant"):
        quick("plant", PI_, **NAMES)
    with pytest.raises(updyn.errors.OptionError, match="expected a Controller"):
        quick(two_masses(), "pi", **NAMES)


def test_what_lies_above_the_band_is_noted():
    found = quick(two_masses(band=(0.1, 5.0)), updyn.Controller(300.0), **NAMES)
    assert any("above 5 Hz, the end of the band" in note for note in found.notes)


# -- broken at the torque -----------------------------------------------------------------------------
def test_broken_at_the_torque_a_rigid_body_by_hand():
    """kp (v + kv x) on J s^2: |L| = 1 as of a PI with ti = 1 / kv, phase margin arctan(w / kv)."""
    kp, kv, J = 7.0, 2.0, 3.0
    a = kp / J
    w = np.sqrt(0.5 * (a**2 + np.sqrt(a**4 + 4 * a**2 * kv**2)))
    found = quick(rigid(J), updyn.Controller(kp, kv=kv), **NAMES)
    m = found.torque_loop.margins
    assert m.stable
    assert m.crossover == pytest.approx(w / (2 * np.pi), rel=1e-10)
    assert m.phase_margin == pytest.approx(np.degrees(np.arctan(w / kv)), rel=1e-9)
    assert m.delay_margin == pytest.approx(np.arctan(w / kv) / w, rel=1e-9)
    assert "both loops, broken at the torque" in found.summary()
    assert quick(rigid(J), updyn.Controller(kp), **NAMES).torque_loop is None


@pytest.mark.parametrize("dead_time", [0.0, 4e-3])
def test_margins_at_the_torque_are_where_the_closed_loop_becomes_unstable(dead_time):
    plant = two_masses()
    controller = replace(PI_, kv=3.0, dead_time=dead_time, low_pass=60.0, low_pass_damping=0.7)
    m = quick(plant, controller, **NAMES).torque_loop.margins
    assert m.stable
    assert 1.0 < m.gain_margin < np.inf
    for share, stable in ((0.998, True), (1.002, False)):
        more = replace(controller, kp=controller.kp * m.gain_margin * share)
        assert quick(plant, more, **NAMES).stable == stable
        later = replace(controller, dead_time=dead_time + m.delay_margin * share)
        assert quick(plant, later, **NAMES).stable == stable


def test_steps_of_the_members_are_those_of_each_plant_alone():
    plants = [masses((MOTOR, f * LOAD), (STIFFNESS,), (DAMPING,)) for f in (1.0, 0.8, 1.5)]
    family = PlantFamily(plants[0], tuple(plants[1:]))
    controller = replace(PI_, kv=10.0)
    found = updyn.servo(family, controller, **NAMES, duration=4.0, family_steps=True)
    assert len(found.family_steps) == 2
    for plant, step in zip(plants[1:], found.family_steps, strict=True):
        alone = updyn.servo(plant, controller, **NAMES, duration=4.0).step
        for name in ("rise_time", "overshoot", "peak", "final"):
            assert getattr(step, name) == pytest.approx(getattr(alone, name), rel=1e-9)
    peaks = [step.peak for step in found.family_steps]
    assert abs(peaks[1] / peaks[0] - 1.0) > 0.01
    assert "step over 2 stable members" in found.summary()
    assert updyn.servo(family, controller, **NAMES, duration=4.0).family_steps == ()
