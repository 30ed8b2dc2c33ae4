"""The verdict on a servo, and doubts about a crossover: by hand for a rigid body and two masses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import updyn
from servo_cases import BOTH, DAMPING, LOAD, MOTOR, NAMES, PI_, STIFFNESS, masses, quick, rigid
from updyn.control.family import PlantFamily
from updyn.control.servo.verdict import judge_servo

#: The flexible mode of the two masses in Hz: k (1 / J1 + 1 / J2) = w^2.
LOWEST = np.sqrt(STIFFNESS * (1 / MOTOR + 1 / LOAD)) / (2 * np.pi)


def two_masses(**more):
    """Two masses with their natural frequencies."""
    given = {"modes": np.array([0.0, LOWEST]), **more}
    return masses((MOTOR, LOAD), (STIFFNESS,), (DAMPING,), **given)


def family_of(*plants):
    return PlantFamily(plants[0], plants[1:])


# -- verdict ---------------------------------------------------------------------------------------
def test_a_stable_loop():
    found = judge_servo(quick(rigid(), updyn.Controller(12.0), **NAMES))
    assert (found.kind, found.text, found.reasons) == ("good", "stable", ())


def margin_with(dead_time):
    """Smallest |1 + L| of L = exp(-s T) / s, on a dense grid."""
    s = 1j * np.linspace(0.1, 20.0, 200_001)
    return np.abs(1.0 + np.exp(-dead_time * s) / s).min()


@pytest.mark.parametrize(("dead_time", "kind"), [(0.68, "good"), (0.72, "warn")])
def test_a_modulus_margin_below_a_half_is_small(dead_time, kind):
    """|1 + L| of 1 / s with a dead time of 0.68 s is 0.51 at least, with 0.72 s 0.49."""
    margin = margin_with(dead_time)
    assert (margin < 0.5) == (kind == "warn")
    servo = quick(rigid(1.0), updyn.Controller(1.0, dead_time=dead_time), **NAMES)
    found = judge_servo(servo)
    assert found.kind == kind
    if kind == "warn":
        assert found.text == "stable, with a small margin"
        (reason,) = found.reasons
        assert f"The smallest modulus margin is {margin:.3g} (of the velocity loop)" in reason


def test_an_unstable_loop_is_bad():
    """A dead time beyond pi / 2 of 1 / s."""
    servo = quick(rigid(1.0), updyn.Controller(1.0, dead_time=1.6), **NAMES)
    found = judge_servo(servo)
    assert (found.kind, found.text) == ("bad", "not stable: velocity loop")


def test_unstable_members_of_a_family_are_bad():
    """An inertia that is smaller by a third: the dead time is then beyond its limit."""
    family = family_of(rigid(1.0), rigid(1.0), rigid(0.6))
    found = judge_servo(quick(family, updyn.Controller(1.0, dead_time=1.1), **NAMES))
    assert (found.kind, found.text) == ("bad", "not stable on 1 of 2 plants of the family")
    assert found.reasons[0] == "It is stable on the nominal plant."


def test_the_small_margin_of_a_member_is_named():
    """1 / J for 1 / s: the dead time counts in units of J."""
    family = family_of(rigid(1.0), rigid(1.0), rigid(0.8))
    found = judge_servo(quick(family, updyn.Controller(1.0, dead_time=0.65), **NAMES))
    assert found.text == "stable, also on all 2 plants of the family, with a small margin"
    margin = margin_with(0.65 / 0.8)
    assert f"is {margin:.3g} (of the velocity loop, plant 1 of the family)" in found.reasons[0]


# -- doubts about the gains ------------------------------------------------------------------------
@pytest.mark.parametrize(("share", "doubted"), [(0.019, True), (0.021, False)])
def test_a_velocity_crossover_below_a_fiftieth_of_the_lowest_mode_is_questioned(share, doubted):
    """Far below the mode both masses turn together: the crossover is kp / (2 pi J)."""
    inertia = MOTOR + LOAD
    kp = 2 * np.pi * share * LOWEST * inertia
    servo = quick(two_masses(), updyn.Controller(kp), **NAMES)
    assert servo.velocity_loop.margins.crossover == pytest.approx(share * LOWEST, rel=1e-2)
    assert bool(servo.doubts) is doubted
    if doubted:
        (text,) = servo.doubts
        assert f"{share * LOWEST:.2g} Hz, is {1 / share:.2g} times lower than the lowest" in text
        assert f"check the unit of kp = {kp:.3g}" in text
        assert f"(2 pi f J is {kp / share:.2g} at that frequency)" in text
        found = judge_servo(servo)
        assert (found.kind, found.text) == ("warn", "stable, with a doubtful gain")
        assert f"note: {text}" in servo.summary()


@pytest.mark.parametrize(("share", "doubted"), [(0.019, True), (0.021, False)])
def test_a_position_crossover_below_a_fiftieth_of_that_of_the_velocity(share, doubted):
    """The position loop is kv / s below the crossover of the velocity loop."""
    kp = 2 * np.pi * 0.1 * LOWEST * (MOTOR + LOAD)
    inner = quick(two_masses(), updyn.Controller(kp), **NAMES).velocity_loop.margins.crossover
    servo = quick(two_masses(), updyn.Controller(kp, kv=2 * np.pi * share * inner), **BOTH)
    assert servo.position_loop.margins.crossover == pytest.approx(share * inner, rel=1e-2)
    assert bool(servo.doubts) is doubted
    if doubted:
        assert "crossover of the velocity loop" in servo.doubts[0]
        assert "check the unit of kv" in servo.doubts[0]


@pytest.mark.parametrize(("ti", "cause"), [(None, "no integrator; give ti"), (1e3, "free rotor")])
def test_a_held_plant_is_named_as_the_cause(ti, cause):
    plant = replace(masses((2.0, 5.0), (3e3,), (2.0,), ground=1e4), modes=np.array([5.0, 20.0]))
    servo = quick(plant, updyn.Controller(1e-3, ti=ti), **NAMES)
    (text,) = servo.doubts
    assert "The gain of the velocity loop is at most" in text
    assert "the torque moves no rigid body" in text
    assert cause in text


def test_a_mode_below_the_band_does_not_count():
    """Such as that of a rotor on the rounding of its stiffness."""
    kp = 2 * np.pi * 0.019 * LOWEST * (MOTOR + LOAD)
    soft = np.array([0.0, 0.05 * LOWEST, LOWEST])
    for low, doubted in ((0.06, True), (0.04, False)):
        plant = two_masses(modes=soft, band=(low * LOWEST, 100.0))
        assert bool(quick(plant, updyn.Controller(kp), **NAMES).doubts) is doubted


def test_usual_gains_are_not_questioned():
    assert quick(two_masses(), replace(PI_, kv=6.0), **BOTH).doubts == ()
