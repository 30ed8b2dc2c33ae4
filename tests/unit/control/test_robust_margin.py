"""Robust margins of a servo: closed forms, and plants just within and beyond what they allow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import updyn
from servo_cases import BOTH, NAMES, NOTCHED, PI_, quick, two_masses
from updyn.control.family import PlantFamily
from updyn.control.plant import Plant

APART = {**NAMES, "position": "load"}
DENSE = (
    2
    * np.pi
    * np.unique(np.concatenate([np.geomspace(1e-2, 1e3, 15_000), np.linspace(4, 12, 20_000)]))
)


def scaled(plant: Plant, gain: float) -> Plant:
    """The plant with its torques multiplied."""
    return replace(plant, B=gain * plant.B)


def gains(*shares: float) -> PlantFamily:
    plant = two_masses()
    return PlantFamily(plant, tuple(scaled(plant, 1.0 + share) for share in shares))


def parts(controller, names) -> tuple[np.ndarray, np.ndarray]:
    """What velocity and position add to L at the torque, at `DENSE`, from the masses' own equations."""
    plant, s = two_masses(), 1j * DENSE
    G = plant.at(s)[:, :, 0]
    K = controller.torque(s)
    velocity = K * G[:, plant.outputs.index(names["velocity"])]
    if controller.kv is None:
        return velocity, np.zeros(len(s))
    return velocity, controller.kv * K * G[:, plant.outputs.index(names["position"])]


LATE = replace(NOTCHED, kv=None, dead_time=2e-3)


@pytest.mark.parametrize("share", [0.1, 0.4])
def test_gain_of_a_velocity_loop(share: float) -> None:
    """G (1 + a delta): 1 / (a max |T|); along a member's own gain, by the gain margin."""
    found = quick(gains(share / 2, share), LATE, **NAMES)
    (margin,) = found.robust
    L, _ = parts(LATE, NAMES)
    T = np.abs(L / (1 + L))
    assert margin.of == "family"
    assert margin.margin == pytest.approx(1.0 / (share * T.max()), rel=1e-4)
    assert margin.at == pytest.approx(DENSE[T.argmax()] / (2 * np.pi), rel=1e-3)
    gain = found.velocity_loop.margins.gain_margin
    assert margin.member_margin == pytest.approx((gain - 1.0) / share, rel=1e-6)
    assert margin.member == 1
    assert margin.member_margin >= margin.margin


@pytest.mark.parametrize(("largest", "finite"), [(1.1e-6, True), (0.9e-6, False)])
def test_a_perturbation_below_a_millionth_is_rounding(largest: float, finite: bool) -> None:
    """The largest mu is the share times the largest |T|."""
    L, _ = parts(LATE, NAMES)
    share = largest / np.abs(L / (1 + L)).max()
    (margin,) = quick(gains(share), LATE, **NAMES).robust
    assert np.isfinite(margin.margin) == finite


def test_a_gain_that_vanishes() -> None:
    """No gain above 0 makes a PI loop unstable: without any it is so at rest."""
    (margin,) = quick(gains(-0.05), PI_, **NAMES).robust
    assert margin.member_margin == pytest.approx(20.0, rel=2e-3)
    assert margin.member == 0


def test_one_channel_for_velocity_and_position() -> None:
    """Read from one output, both are off together: max |L| / |1 + L| at the torque."""
    names = {**NAMES, "position": "speed"}
    (margin,) = quick(gains(0.1), NOTCHED, **names).robust
    v, _ = parts(replace(NOTCHED, kv=None), NAMES)
    L = v * (1.0 + NOTCHED.kv / (1j * DENSE))
    assert margin.margin == pytest.approx(1.0 / (0.1 * np.abs(L / (1 + L)).max()), rel=1e-4)


@pytest.mark.parametrize("names", [BOTH, APART])
def test_two_channels_off_on_their_own(names) -> None:
    """M of rank one: mu = sum |c_i| / |1 + L|."""
    plant = two_masses(relative_error=0.03)
    family, error = quick(replace(gains(0.1), nominal=plant), NOTCHED, **names).robust
    v, p = parts(NOTCHED, names)
    mu = (np.abs(v) + np.abs(p)) / np.abs(1 + v + p)
    assert family.margin == pytest.approx(10.0 / mu.max(), rel=1e-4)
    assert error.margin == pytest.approx(1.0 / (0.03 * mu.max()), rel=1e-4)
    assert error.of == "plant error"


def test_the_error_counts_in_the_band_only() -> None:
    band = (0.2, 2.0)
    (error,) = quick(two_masses(relative_error=0.03, band=band), NOTCHED, **APART).robust
    v, p = parts(NOTCHED, APART)
    mu = ((np.abs(v) + np.abs(p)) / np.abs(1 + v + p))[
        (2 * np.pi * band[0] <= DENSE) & (2 * np.pi * band[1] >= DENSE)
    ]
    assert error.margin == pytest.approx(1.0 / (0.03 * mu.max()), rel=1e-3)
    assert band[0] <= error.at <= band[1]


def turned(plant: Plant, size: dict[str, float], phase: dict[str, float], w: float) -> Plant:
    """Outputs times 1 + size a(s), a an all-pass of first order with a phase at w."""
    A, B, C = plant.A, plant.B, plant.C.copy()
    n, k = len(A), len(size)
    A = np.block([[A, np.zeros((n, k))], [np.zeros((k, n)), np.zeros((k, k))]])
    C = np.hstack([C, np.zeros((len(C), k))])
    for j, name in enumerate(size):
        i, angle = plant.outputs.index(name), np.mod(phase[name], 2 * np.pi)
        sign = 1.0 if angle < np.pi else -1.0
        z = w / np.tan(0.5 * (np.pi - angle % np.pi))  # (s - z) / (s + z) at i w
        A[n + j, :n], A[n + j, n + j] = C[i, :n], -z
        own = C[i].copy()
        C[i] += sign * size[name] * own
        C[i, n + j] -= sign * size[name] * 2.0 * z
    return replace(plant, A=A, B=np.vstack([B, np.zeros((k, B.shape[1]))]), C=C)


@pytest.mark.parametrize(("share", "stable"), [(0.999, True), (1.001, False)])
@pytest.mark.parametrize("controller", [NOTCHED, replace(NOTCHED, dead_time=2e-3)])
def test_the_worst_perturbation_is_stable_up_to_the_margin(controller, share, stable) -> None:
    (margin,) = quick(gains(0.2), controller, **APART).robust
    w = 2 * np.pi * margin.at
    plant = two_masses()
    G = plant.at([1j * w])[0, :, 0]
    K = complex(controller.torque(np.array([1j * w]))[0])
    c = {"speed": K * G[1], "load": controller.kv * K * G[2]}
    away = -(1.0 + sum(c.values()))  # what the perturbed channels have to add up to
    phase = {name: float(np.angle(away / value)) for name, value in c.items()}
    size = dict.fromkeys(c, 0.2 * share * margin.margin)
    worst = turned(plant, size, phase, w)
    ratio = worst.at([1j * w])[0, :, 0] / G - 1.0
    np.testing.assert_allclose(np.abs(ratio[[1, 2]]), list(size.values()), rtol=1e-9)
    found = quick(worst, controller, **APART).torque_loop.margins
    assert found.stable is stable


def test_where_there_is_nothing_to_say() -> None:
    plant = two_masses()
    assert quick(plant, NOTCHED, **APART).robust == ()  # no family, no stated error
    unstable = updyn.Controller(170.0, ti=0.2, kv=500.0)
    assert not quick(gains(0.1), unstable, **APART).stable
    assert quick(gains(0.1), unstable, **APART).robust == ()
    (same,) = quick(PlantFamily(plant, (plant,)), NOTCHED, **APART).robust
    assert (same.margin, same.at, same.member) == (np.inf, None, None)
    assert "no perturbation" in same.summary()


def test_the_words() -> None:
    found = quick(replace(gains(0.2), nominal=two_masses(relative_error=0.03)), NOTCHED, **APART)
    family, error = found.robust
    text = found.summary()
    assert f"robust margin, family: {family.margin:.4g} at {family.at:.6g} Hz: stable for" in text
    assert f"{family.member_margin:.3g} times the deviation of member {family.member}." in text
    assert f"robust margin, plant error: {error.margin:.4g} at" in text
    assert error.meaning.endswith("times the plant's relative error, in its band.")
