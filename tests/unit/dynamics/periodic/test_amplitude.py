"""`updyn.response` with a response that is held at an amplitude."""

from __future__ import annotations

import numpy as np
import pytest

import updyn
from periodic_cases import balance_of, oscillator, two_masses
from updyn.dynamics.periodic.balance import ControlledBalance
from updyn.errors import DofError, ModelError, OptionError, UpdynWarning

FREQ = np.linspace(0.3, 2.5, 45) / (2 * np.pi)
CUBIC, JOINT = updyn.CubicSpring(0.5), updyn.CubicSpring(5e4)


MODEL = two_masses(loss_factor=0.03).with_elements({"joint": (JOINT, ["1:X", "2:X"])})


def held(model: updyn.Model, freq=FREQ, quantity="receptance", **options):
    return updyn.response(model, freq, ["1:X", "2:X"], ["2:X"], quantity, **options)


def test_one_harmonic_is_the_closed_result() -> None:
    """Its force is |1 - w^2 + i d w + 3/4 c A^2| A: Nayfeh & Mook (1979), section 4.1."""
    model = oscillator(viscous=0.05).with_elements({"spring 3": (CUBIC, "1:X")})
    amplitude, w = 1.7, 2 * np.pi * FREQ
    with pytest.warns(UpdynWarning, match="harmonics 1"):
        found = updyn.response(model, FREQ, ["1:X"], ["1:X"], amplitude=amplitude, harmonics=1)
    stiffness = 1 - w**2 + 0.05j * w + 0.75 * 0.5 * amplitude**2
    np.testing.assert_allclose(found.level, np.abs(stiffness) * amplitude, rtol=1e-9)
    np.testing.assert_allclose(found.values[:, 0, 0], 1 / stiffness, rtol=1e-9)
    np.testing.assert_allclose(np.abs(found.harmonics[:, 1, 0, 0]), amplitude, rtol=1e-12)


@pytest.mark.parametrize("control", ["1:X", "2:X"])
def test_the_force_found_gives_the_same_motion(control) -> None:
    freq = np.array([1.0, 2.0, 3.1, 4.5])
    found = held(MODEL, freq, "accelerance", amplitude=2.0, control=control)
    assert np.ptp(found.level) > 0.1 * found.level.max()
    for i, f in enumerate(freq):
        by_force = held(MODEL, [f], "accelerance", level=float(found.level[i]))
        np.testing.assert_allclose(by_force.harmonics[0], found.harmonics[i], rtol=1e-7, atol=1e-9)
    row = ["1:X", "2:X"].index(control)
    np.testing.assert_allclose(np.abs(found.harmonics[:, 1, row, 0]), 2.0, rtol=1e-12)
    assert found.frf.level.tolist() == found.level.tolist()


def test_a_reversed_force_or_sensor_reverses_the_sign() -> None:
    plain = updyn.response(MODEL, [2.0], ["1:X"], ["2:X"], amplitude=0.02)
    for sensor, force in (("1:-X", "2:X"), ("1:X", "2:-X")):
        other = updyn.response(MODEL, [2.0], [sensor], [force], amplitude=0.02)
        np.testing.assert_allclose(other.values, -plain.values, rtol=1e-10)


def test_motion_between_the_turning_points_is_reached() -> None:
    """A constant force jumps over it: Duffing's curve is single-valued over the amplitude."""
    model = oscillator(viscous=0.05).with_elements({"spring 3": (CUBIC, "1:X")})
    found = updyn.response(model, FREQ[15:], ["1:X"], ["1:X"], amplitude=1.7)
    assert not found.stable.all()
    assert found.stable[[0, -1]].all()


@pytest.mark.parametrize("power", [0, 1, 2])
def test_derivatives_are_exact(power) -> None:
    balance = balance_of(MODEL, 3)
    controlled = ControlledBalance(
        balance.elements, balance.transfer, balance.fourier, 0.7, balance.n_elements, power
    )
    rng, omega, step = np.random.default_rng(4), 7.0, 1e-7
    x = 0.05 * rng.standard_normal((1, balance.fourier.size))

    def change(dx, domega):
        ends = [controlled.evaluate(x + s * dx, omega + s * domega).residual for s in (1.0, -1.0)]
        return (ends[0] - ends[1]).ravel() / (2 * step)

    now, direction = controlled.evaluate(x, omega), rng.standard_normal(x.shape)
    exact = now.jacobian @ direction.ravel()
    assert np.abs(change(step * direction, 0.0) - exact).max() < 1e-5 * np.abs(exact).max()
    by_omega = now.by_omega.ravel()
    assert np.abs(change(0.0, step) - by_omega).max() < 1e-5 * np.abs(by_omega).max()


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"amplitude": 0.0}, OptionError, "amplitude 0.0: expected an amplitude of the response"),
        ({"amplitude": np.nan}, OptionError, "amplitude nan: expected"),
        ({"level": 1.0}, OptionError, "level and amplitude are stated"),
        ({"amplitude": None, "level": 1.0, "control": "1:X"}, OptionError, "expected amplitude="),
        ({"control": "3:X"}, OptionError, "control '3:X': not among the responses"),
        ({"control": "3"}, DofError, "3"),
        ({"references": ["1:X", "2:X"]}, OptionError, "2 references; expected one"),
        ({"decay": 1.0}, OptionError, "amplitude: expected no decay"),
        ({"freq": [0.0, 1.0]}, OptionError, "amplitude: a line at 0 Hz"),
        ({"model": two_masses()}, ModelError, "amplitude: the model has no nonlinear elements"),
    ],
)
def test_wrong_options_are_refused(change, error, message) -> None:
    given = {"model": MODEL, "freq": [1.0], "references": ["2:X"], "amplitude": 0.1, **change}
    with pytest.raises(error, match=message):
        updyn.response(responses=["1:X", "2:X"], **given)
