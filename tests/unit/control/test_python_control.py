"""Plants as objects of python-control and scipy.signal: responses, simulation and margins agree."""

from __future__ import annotations

import sys

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import signal

import updyn
from plants_by_hand import double_integrator, oscillator, simulate, two_masses
from updyn.control.plant import Plant
from updyn.control.ports import Port
from updyn.control.sampled import sampled
from updyn.errors import DataError, OptionError

LINES = np.array([0.06, 0.4, 1.5, 2.4])


@pytest.mark.parametrize(
    "one", [two_masses(), sampled(two_masses(), 0.05, delay=0.08)], ids=["s", "z"]
)
def test_the_response_is_that_of_the_plant(one: Plant) -> None:
    found = updyn.to_control(one)
    response = control.frequency_response(found, 2 * np.pi * LINES)
    expected = np.moveaxis(one.response(LINES).values, 0, -1)
    assert_allclose(response.complex, expected, rtol=1e-8)
    assert (found.dt, found.isctime(strict=True)) == (
        (0, True) if one.dt is None else (0.05, False)
    )
    assert found.input_labels == ["1:RZ", "pair of forces"]
    assert found.output_labels == ["1:RZ", 'second "angle" ??/ */ \\', "2:RZ / -92_5"]
    for name in "ABCD":
        np.testing.assert_array_equal(getattr(found, name), getattr(one, name))


def test_the_timebase_is_stated_whatever_the_default() -> None:
    before = control.config.defaults["control.default_dt"]
    control.config.defaults["control.default_dt"] = None
    try:
        assert updyn.to_control(oscillator()).dt == 0
        assert updyn.to_frd(oscillator(), LINES).dt == 0
    finally:
        control.config.defaults["control.default_dt"] = before


def test_a_channel_is_found_by_name() -> None:
    one = two_masses()
    channel = updyn.to_control(one)["1:RZ", "pair of forces"]
    s = 2j * np.pi * LINES
    assert_allclose(channel(s), one.channel("1:RZ", "pair of forces").at(s)[:, 0, 0], rtol=1e-9)


def test_margins_of_a_loop_about_a_double_integrator() -> None:
    """Lead of 10 about 1 / s^2: crossover where |C| = omega^2, phase margin asin(9 / 11) at its middle."""
    middle = 4.0
    lead = (
        control.tf([np.sqrt(10) / middle, 1], [1 / (np.sqrt(10) * middle), 1])
        * middle**2
        / np.sqrt(10)
    )
    _, margin, _, _, crossover, _ = control.stability_margins(
        lead * updyn.to_control(double_integrator(1.0))
    )
    assert_allclose([margin, crossover], [np.degrees(np.arcsin(9 / 11)), middle], rtol=1e-9)


@pytest.mark.filterwarnings(
    "ignore::scipy.signal.BadCoefficients"
)  # python-control goes by polynomials,
@pytest.mark.filterwarnings("ignore:stability_margins")  # and by lines where these are not accurate
def test_a_delay_costs_the_phase_that_it_should() -> None:
    """Phase margin of a sampled loop with delay: less by 360 f tau degrees, whole intervals exactly."""
    one = oscillator(0.05, 1.0, band=(0.001, 0.5))
    loop = 9.0
    margins = [
        control.stability_margins(loop * updyn.to_control(sampled(one, 0.2, delay=d)))[1]
        for d in (0.0, 0.2, 0.6)
    ]
    crossover = control.stability_margins(loop * updyn.to_control(sampled(one, 0.2)))[4]
    assert_allclose(
        margins[0] - np.array(margins), np.degrees(crossover * np.array([0.0, 0.2, 0.6])), atol=1e-5
    )


def test_frd() -> None:
    one = two_masses()
    found = updyn.to_frd(one, LINES)
    assert_allclose(found.frdata, np.moveaxis(one.response(LINES).values, 0, -1), rtol=1e-15)
    assert_allclose(found.omega, 2 * np.pi * LINES)
    assert (found.dt, found.input_labels) == (0, ["1:RZ", "pair of forces"])
    digital = updyn.to_frd(sampled(one, 0.05), LINES)
    assert digital.dt == 0.05
    with pytest.raises(DataError, match="above half the sampling rate"):
        updyn.to_frd(sampled(one, 0.05), [11.0])


def test_scipy() -> None:
    one = two_masses()
    found = updyn.to_scipy(one)
    assert isinstance(found, signal.lti)
    inputs = np.random.default_rng(0).normal(size=(30, 2))
    held = signal.lsim(found, inputs, 0.05 * np.arange(30), interp=False)[1]
    assert_allclose(held, simulate(sampled(one, 0.05), inputs), rtol=1e-9, atol=1e-12)
    digital = sampled(one, 0.05, delay=0.08)
    theirs = updyn.to_scipy(digital)
    assert isinstance(theirs, signal.dlti)
    assert theirs.dt == 0.05
    assert_allclose(
        signal.dlsim(theirs, inputs)[1], simulate(digital, inputs), rtol=1e-10, atol=1e-12
    )


def test_two_names_that_are_one_to_it() -> None:
    ports = (Port.at("1:RZ", "a.b"), Port.at("2:RZ", "a_b"), Port.at("1:RZ", "c"))
    with pytest.raises(OptionError, match=r"'a\.b' and 'a_b' become the same name"):
        updyn.to_control(two_masses(output_ports=ports))


def test_without_python_control(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(OptionError, match=r'pip install "updyn\[control\]"'):
        updyn.to_control(oscillator())
    with pytest.raises(OptionError, match=r'pip install "updyn\[control\]"'):
        updyn.to_frd(oscillator(), LINES)
