"""A position that is read behind a gear: rule, loops, feed-forward, processor, time and limit cycles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

import updyn
from nonlinear_plants import two_inertias
from servo_cases import two_masses
from updyn.control.job.tables import ControllerTable
from updyn.control.nonlinear.balance import limit_cycles
from updyn.control.plant import Plant
from updyn.control.servo.controller import rigid_ratio
from updyn.elements.drivetrain import GearPair, Inertia, Motor, Shaft, drivetrain
from updyn.errors import ModelError, OptionError
from updyn.nonlinear.backlash import Backlash

LOAD = {"torque": "motor", "velocity": "speed", "position": "load"}
#: External gears turn the load the other way; a ratio below 1 speeds it up.
RATIOS = pytest.mark.parametrize("n", [50.0, -50.0, 0.02])


def geared(plant: Plant, n: float, *outputs: str) -> Plant:
    """Return a plant with some of its outputs read behind a gear of ratio n."""
    C, D = plant.C.copy(), plant.D.copy()
    for name in outputs:
        C[plant.outputs.index(name)] /= n
        D[plant.outputs.index(name)] /= n
    return replace(plant, C=C, D=D)


@RATIOS
def test_rule_counts_the_ratio(n: float) -> None:
    direct = updyn.Controller.tuned(two_masses(), 2.0, **LOAD)
    found = updyn.Controller.tuned(geared(two_masses(), n, "load"), 2.0, **LOAD)
    assert direct.ratio == pytest.approx(1.0, rel=1e-9)
    assert found.ratio == pytest.approx(n, rel=1e-9)
    assert (found.kp, found.ti, found.kv) == (direct.kp, direct.ti, direct.kv)


def test_rule_of_a_job_counts_the_ratio() -> None:
    behind = geared(two_masses(), 50.0, "load")
    ports = ("motor", "speed", "load")
    assert ControllerTable(crossover=2.0).controller(behind, *ports).ratio == pytest.approx(50.0)
    assert ControllerTable(crossover=2.0, ratio=40.0).controller(behind, *ports).ratio == 40.0
    assert ControllerTable(kp=2.0, kv=1.0).controller(behind, *ports).ratio == 1.0


@RATIOS
def test_loops_behind_a_gear_are_those_without(n: float) -> None:
    controller = updyn.Controller(170.0, 0.2, 2.0, feed_forward=0.8, low_pass=30.0, dead_time=1e-3)
    plant = two_masses(band=(0.0, 300.0))
    behind = geared(plant, n, "load")
    alone = updyn.servo(plant, controller, sampled=updyn.sampled(plant, 1e-3), **LOAD)
    found = updyn.servo(
        behind, replace(controller, ratio=n), sampled=updyn.sampled(behind, 1e-3), **LOAD
    )
    for one, other in zip(found.loops, alone.loops, strict=True):
        np.testing.assert_allclose(one.L, other.L, rtol=1e-9)
    np.testing.assert_allclose(found.reference, alone.reference, rtol=1e-9)
    np.testing.assert_allclose(
        np.sort_complex(found.poles), np.sort_complex(alone.poles), rtol=1e-6
    )
    np.testing.assert_allclose(found.step.value, alone.step.value, atol=1e-9)
    for one, other in zip(found.sampled.loops, alone.sampled.loops, strict=True):
        np.testing.assert_allclose(one.L, other.L, rtol=1e-7)
    assert found.notes == alone.notes


def test_feed_forward_of_all_the_velocity_leaves_no_lag() -> None:
    """With P control of a rigid body, v follows v_ref at rest: a ramp is followed without error."""
    behind = geared(two_masses(), 40.0, "load")
    controller = updyn.Controller(700.0, 0.5, 1.0, feed_forward=1.0, ratio=40.0)
    found = updyn.servo(behind, controller, freq=[1e-4], step=None, **LOAD)
    s = 2j * np.pi * 1e-4
    assert abs((1.0 - found.reference[0]) / s) < 1e-3  # s of lag; 1 / kv = 1 without


def test_velocity_at_the_load_sizes_its_gain_by_the_torque_at_the_motor() -> None:
    behind = geared(two_masses(), 50.0, "load", "load speed")
    names = {"torque": "motor", "velocity": "load speed", "position": "load"}
    found = updyn.Controller.tuned(behind, 0.2, **names)
    assert found.kp == pytest.approx(7.0 * 50.0 * 0.4 * np.pi, rel=1e-8)
    assert found.ratio == pytest.approx(1.0, rel=1e-9)
    loop = updyn.servo(behind, found, step=None, **names).velocity_loop
    assert loop.margins.crossover == pytest.approx(0.2, rel=0.2)  # with the integral part


def test_stated_gains_stay_as_they_are() -> None:
    behind = geared(two_masses(), 50.0, "load")
    found = updyn.Controller.tuned(behind, 2.0, kv=7.0, **LOAD)
    assert (found.kv, found.ratio) == (7.0, 1.0)
    servo = updyn.servo(behind, found, step=None, **LOAD)
    (note,) = [note for note in servo.notes if "ratio" in note]
    assert "'speed' moves 50 times as fast as 'load'" in note
    assert "the effective kv is 0.14 1/s" in note
    assert "ratio = 50" in note
    given = updyn.Controller.tuned(behind, 2.0, kv=7.0, ratio=50.0, **LOAD)
    assert not [n for n in updyn.servo(behind, given, step=None, **LOAD).notes if "ratio" in n]


def test_ratios_that_are_nearly_those_of_the_plant() -> None:
    """The rule takes a ratio within 0.1 % of 1 as 1; a note names one that is off by 5 % or more."""
    for n, expected in ((1.0009, 1.0), (1.0011, pytest.approx(1.0011, rel=1e-9))):
        assert (
            updyn.Controller.tuned(geared(two_masses(), n, "load"), 2.0, **LOAD).ratio == expected
        )
    for ratio, count in ((52.4, 0), (52.6, 1)):
        behind = geared(two_masses(), 50.0, "load")
        controller = updyn.Controller.tuned(behind, 2.0, ratio=ratio, **LOAD)
        notes = updyn.servo(behind, controller, step=None, **LOAD).notes
        assert sum("ratio" in note for note in notes) == count


def test_limit_cycles_behind_a_gear_are_those_without() -> None:
    names = {"velocity": "speed", "position": "load", "torque": "torque"}
    law = Backlash(4.0 * (20.0 * np.pi) ** 2, gap=1e-3)
    controller = updyn.Controller(60.0, ti=0.05, kv=15.0)
    plant = two_inertias()
    (*_, alone) = limit_cycles(plant, controller, law, "gap", **names)
    (*_, found) = limit_cycles(
        geared(plant, 30.0, "load"), replace(controller, ratio=30.0), law, "gap", **names
    )
    assert found.amplitude == pytest.approx(alone.amplitude, rel=1e-6)
    assert found.frequency == pytest.approx(alone.frequency, rel=1e-6)


def test_drive_with_gears() -> None:
    """The crossover of the position loop is that of the rigid body under the rule's gains."""
    model = drivetrain(
        [
            Motor("motor", 1, 3e-3),
            GearPair("gearbox", 1, 2, 50, kind="internal", torsional_stiffness=2e5, inertia_b=0.5),
            Shaft("shaft", 2, 3, stiffness=9e4),
            Inertia("load", 3, 6.0),
        ]
    )
    plant = updyn.plant(
        model, ["1:RZ"], ["1:RZ", "3:RZ"], (1.0, 100.0), quantity=["mobility", "receptance"]
    )
    names = {"torque": "1:RZ", "velocity": "1:RZ", "position": "3:RZ"}
    controller = updyn.Controller.tuned(plant, 4.0, **names)
    assert rigid_ratio(plant, "1:RZ", "1:RZ", "3:RZ") == pytest.approx(50.0, rel=1e-4)
    found = updyn.servo(plant, controller, step=None, **names)

    def excess(x: float) -> float:
        """|L| - 1 at x times the crossover of the velocity loop; 1 / ti is a half of it."""
        return abs(0.25 / x * (0.5 + 1j * x) / (0.5 - x**2 + 1j * x)) - 1.0

    expected = 4.0 * brentq(excess, 0.2, 0.5)
    assert 1.0 < expected < 1.25
    assert found.position_loop.margins.crossover == pytest.approx(expected, rel=0.02)
    assert "times the gear ratio 50" in controller.summary()


def test_a_position_that_does_not_turn_with_the_torque() -> None:
    plant = two_masses()
    C = plant.C.copy()
    C[plant.outputs.index("load")] -= C[plant.outputs.index("angle")]
    twist = replace(plant, C=C)
    assert rigid_ratio(twist, "motor", "speed", "load") is None
    with pytest.raises(
        ModelError, match=r"no rigid-body motion from 'motor' to 'load'.*kv and ratio"
    ):
        updyn.Controller.tuned(twist, 2.0, **LOAD)
    assert updyn.Controller.tuned(twist, 2.0, kv=3.0, **LOAD).ratio == 1.0


@pytest.mark.parametrize("ratio", [0.0, np.inf, np.nan, "50", True])
def test_ratio_has_to_be_a_number(ratio: object) -> None:
    with pytest.raises(
        OptionError, match=r"controller: ratio is .*; expected a number other than 0"
    ):
        updyn.Controller(1.0, kv=1.0, ratio=ratio)


def test_ratio_belongs_to_the_position_loop() -> None:
    with pytest.raises(OptionError, match="ratio without kv"):
        updyn.Controller(1.0, ratio=50.0)
