"""Margins of sampled loops: by hand for a rigid body, by scipy's discretisation and roots of |L| = 1 for two masses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.signal import cont2discrete

import updyn
from servo_cases import BOTH, NAMES, NOTCHED, PI_, quick, rigid, two_masses
from updyn.control.servo.controller import Notch
from updyn.errors import OptionError

DT = 2e-3


def sampled_margins(plant, controller, dt, names, delay=0.0):
    digital = updyn.sampled(plant, dt, delay=delay)
    return quick(plant, controller, sampled=digital, **names).sampled


# -- a rigid body, by hand ---------------------------------------------------------------------------------
def narrow(plant):
    """The plant for a band below half the sampling rate."""
    return replace(plant, band=(0.0, 100.0))


def test_a_held_torque_on_a_rigid_body():
    # L = a / (z - 1), a = kp dt / J: |L| = 1 at sin(w dt / 2) = a / 2; at z = -1 it is -a / 2
    kp, J = 300.0, 3.0
    a = kp * DT / J
    m = sampled_margins(narrow(rigid(J)), updyn.Controller(kp), DT, NAMES).velocity_loop.margins
    w = 2.0 * np.arcsin(0.5 * a) / DT
    assert m.stable
    assert m.crossover == pytest.approx(w / (2 * np.pi), rel=1e-9)
    assert m.phase_margin == pytest.approx(90 - np.degrees(0.5 * w * DT), rel=1e-9)
    assert m.gain_margin == pytest.approx(2.0 / a, rel=1e-9)
    assert m.gain_margin_at == pytest.approx(0.5 / DT, rel=1e-9)
    assert m.drifting == 1


def test_a_late_torque_on_a_rigid_body():
    # L = a / (z (z - 1)): -180 degrees at w dt = pi / 3, where |L| = a; stable for a < 1
    kp, J = 300.0, 3.0
    found = sampled_margins(narrow(rigid(J)), updyn.Controller(kp), DT, NAMES, delay=DT)
    m = found.velocity_loop.margins
    assert found.delay == 1
    assert m.gain_margin == pytest.approx(J / (kp * DT), rel=1e-9)
    assert m.gain_margin_at == pytest.approx(1.0 / (6.0 * DT), rel=1e-9)


@pytest.mark.parametrize(("share", "delay"), [(0.99, 0.0), (1.01, 0.0), (0.99, DT), (1.01, DT)])
def test_where_it_becomes_unstable(share, delay):
    limit = (2.0 if delay == 0.0 else 1.0) * 3.0 / DT
    controller = updyn.Controller(share * limit)
    found = sampled_margins(narrow(rigid(3.0)), controller, DT, NAMES, delay)
    assert found.stable == (share < 1)
    assert (np.abs(found.poles).max() > 1.0 + 1e-6) == (share > 1)


def test_the_speed_as_a_difference_of_the_angle():
    # angle: dt^2 (z + 1) / (2 J (z - 1)^2), its difference (z - 1) / (z dt): a (z + 1) / (2 z (z - 1))
    kp, J = 120.0, 3.0
    a = kp * DT / J
    plant = narrow(rigid(J, outputs=("angle",)))
    m = sampled_margins(plant, updyn.Controller(kp), DT, {"torque": "motor", "velocity": "angle"})
    loop = m.velocity_loop
    z = np.exp(2j * np.pi * loop.freq * DT)
    exact = 0.5 * a * (z + 1) / (z * (z - 1))
    np.testing.assert_allclose(loop.L, exact, rtol=1e-6, atol=1e-12)


# -- two masses, by scipy ----------------------------------------------------------------------------------
def as_scipy(controller, dt):
    """Numerators and denominators of the controller's factors in z, by scipy and prewarping by hand."""
    factors = [(np.array([controller.kp]), np.array([1.0]))]
    if controller.ti:
        num, den, _ = cont2discrete(([controller.ti, 1.0], [controller.ti, 0.0]), dt, "bilinear")
        factors.append((num.ravel(), den))

    def at(w, num, den):
        # s / w -> its own interval, at which Tustin's rule has the response at w
        own = 2.0 / w * np.tan(0.5 * w * dt)
        num, den, _ = cont2discrete((num, den), own, "bilinear")
        factors.append((num.ravel(), den))

    for notch in controller.notches:
        w = 2 * np.pi * notch.frequency
        at(w, [1, 2 * notch.zero_damping * w, w**2], [1, 2 * notch.pole_damping * w, w**2])
    if controller.low_pass:
        w, d = 2 * np.pi * controller.low_pass, controller.low_pass_damping
        at(w, [w] if d is None else [w**2], [1, w] if d is None else [1, 2 * d * w, w**2])
    return factors


def loops_of(plant, controller, dt, delay, kv):
    """Velocity loop, position loop and the loop at the torque as functions of the frequency in Hz."""
    A, B, C, D, _ = cont2discrete((plant.A, plant.B, plant.C, plant.D), dt, "zoh")
    column = plant.inputs.index("motor")
    rows = [plant.outputs.index("speed"), plant.outputs.index("angle")]
    factors = as_scipy(controller, dt)

    def parts(freq):
        z = np.exp(2j * np.pi * freq * dt)
        G = C[rows] @ np.linalg.solve(z * np.eye(len(A)) - A, B[:, column]) + D[rows, column]
        K = np.prod([np.polyval(num, z) / np.polyval(den, z) for num, den in factors])
        return K * G / z**delay

    def velocity(freq):
        return parts(freq)[0]

    def position(freq):
        inner, outer = parts(freq)
        return kv * outer / (1 + inner)

    def torque(freq):
        inner, outer = parts(freq)
        return inner + kv * outer

    return velocity, position, torque


def crossings(L, freq, of):
    values = np.array([of(L(f)) for f in freq])
    at = np.flatnonzero(values[1:] * values[:-1] < 0)
    return np.array([brentq(lambda f: of(L(f)), freq[i], freq[i + 1], xtol=1e-12) for i in at])


@pytest.mark.parametrize("controller", [NOTCHED, replace(NOTCHED, low_pass_damping=None)])
@pytest.mark.parametrize("delay", [0, 1, 3])
def test_two_masses(controller, delay):
    plant = replace(two_masses(), band=(0.0, 200.0))
    found = sampled_margins(plant, controller, DT, BOTH, delay=delay * DT)
    freq = np.geomspace(0.05, 0.5 / DT * (1 - 1e-4), 900)
    exact = loops_of(plant, controller, DT, delay, controller.kv)
    for loop, L in zip(found.loops, exact, strict=True):
        m = loop.margins
        gains = crossings(L, freq, lambda value: abs(value) - 1.0)
        inside = m.gain_crossings > freq[0]
        assert m.gain_crossings[inside] == pytest.approx(gains, rel=1e-7)
        phases = np.degrees(np.angle([-L(f) for f in gains]))
        assert m.phase_margins[inside] == pytest.approx(phases, rel=1e-5, abs=1e-5)
        turns = [f for f in crossings(L, freq, lambda value: value.imag) if L(f).real < 0]
        inner = (m.phase_crossings > freq[0]) & (m.phase_crossings < freq[-1])
        assert m.phase_crossings[inner] == pytest.approx(turns, rel=1e-6)
        if m.stable:
            least = min(abs(1.0 + L(f)) for f in freq)
            assert m.modulus_margin == pytest.approx(least, rel=5e-3)
            assert m.modulus_margin <= least * (1 + 1e-9)


@pytest.mark.parametrize("delay", [0, 1, 2, 3, 5, 8])
def test_stability_is_that_of_the_recursion(delay):
    """The loop is run in time, sample by sample, from a disturbed state."""
    plant = replace(two_masses(), band=(0.0, 200.0))
    found = sampled_margins(plant, PI_, DT, NAMES, delay=delay * DT)
    A, B, C, _, _ = cont2discrete((plant.A, plant.B, plant.C, plant.D), DT, "zoh")
    row, column = plant.outputs.index("speed"), plant.inputs.index("motor")
    x, waiting, sums, last, sizes = np.array([0.0, 0.0, 1.0, -0.5]), [0.0] * delay, 0.0, 0.0, []
    for _ in range(6000):
        error = -C[row] @ x
        sums += 0.5 * DT / PI_.ti * (error + last)
        last = error
        waiting.append(PI_.kp * (error + sums))
        x = A @ x + B[:, column] * waiting.pop(0)
        sizes.append(abs(error))
    assert found.velocity_loop.margins.stable == (max(sizes[-500:]) < 1e-3 * max(sizes[:500]))


def test_fast_sampling_is_the_continuous_loop():
    """With the hold as half an interval of dead time."""
    dt = 2e-5
    plant = replace(two_masses(), band=(0.0, 200.0))
    found = quick(
        plant, replace(NOTCHED, dead_time=0.5 * dt), sampled=updyn.sampled(plant, dt), **BOTH
    )
    for own, other in zip((*found.loops, found.torque_loop), found.sampled.loops, strict=True):
        for name in ("crossover", "phase_margin", "gain_margin", "modulus_margin"):
            assert getattr(other.margins, name) == pytest.approx(
                getattr(own.margins, name), rel=1e-3
            )


def test_what_is_left_out_is_said():
    controller = replace(
        NOTCHED, dead_time=1e-3, notches=(Notch(240.0), Notch(260.0)), low_pass=300.0
    )
    plant = replace(two_masses(), band=(0.0, 200.0))
    found = sampled_margins(plant, controller, DT, BOTH, delay=DT)
    said = "\n".join(found.notes)
    assert "dead time of 1 ms is omitted" in said
    assert "2 ms, replace it" in said
    assert "notch at 260 Hz is omitted" in said
    assert "240" not in said
    assert "low-pass at 300 Hz is omitted" in said


def test_the_summary_has_it_and_so_does_stable():
    plant = replace(two_masses(), band=(0.0, 200.0))
    late = updyn.sampled(plant, DT, delay=20 * DT)
    servo = quick(plant, NOTCHED, sampled=late, **BOTH)
    assert "sampled every 2 ms, with the hold and a delay of 20 intervals" in servo.summary()
    assert all(loop.margins.stable for loop in servo.loops)
    assert not servo.sampled.stable
    assert not servo.stable


def test_what_cannot_be_used():
    plant = replace(two_masses(), band=(0.0, 200.0))
    with pytest.raises(OptionError, match=r"plant is continuous; make it with updyn\.sampled"):
        quick(plant, NOTCHED, sampled=plant, **BOTH)
    other = updyn.sampled(plant.channel("speed", "motor"), DT)
    with pytest.raises(OptionError, match="no output 'angle'"):
        quick(plant, NOTCHED, sampled=other, **BOTH)
    wrong = replace(updyn.sampled(plant, DT), quantities=("accelerance",) * len(plant.outputs))
    with pytest.raises(OptionError, match="output 'speed' is an acceleration"):
        quick(plant, NOTCHED, sampled=wrong, **BOTH)


# -- the error of the plant --------------------------------------------------------------------------------
@pytest.mark.parametrize("signs", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_the_modulus_margin_of_what_is_off_lies_within_the_range(signs):
    """Of plants whose outputs are off by the relative error, to either side."""
    error = 0.05
    plant = replace(two_masses(), band=(0.0, 1e4), relative_error=error)
    servo = quick(plant, NOTCHED, **BOTH)
    scale = np.ones(len(plant.outputs))
    for name, sign in zip(("speed", "angle"), signs, strict=True):
        scale[plant.outputs.index(name)] = 1.0 + sign * error
    other = quick(replace(plant, C=plant.C * scale[:, None]), NOTCHED, **BOTH)
    for own, off in zip(
        (*servo.loops, servo.torque_loop), (*other.loops, other.torque_loop), strict=True
    ):
        low, high = own.modulus_range
        assert low <= off.margins.modulus_margin <= high
        assert low < own.margins.modulus_margin < high
        m = own.margins.modulus_margin
        assert high - low < 6.0 * error * (1.0 + m)


def test_a_plant_of_unknown_error_has_no_range():
    assert quick(two_masses(), NOTCHED, **BOTH).velocity_loop.modulus_range is None
