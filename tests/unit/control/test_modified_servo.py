"""Margins before and after a change: by plants of explicitly changed models, and by exact FRFs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

import updyn
from updyn.control.servo.modified import MarginChange
from updyn.errors import OptionError

NAMED = {"torque": "1:RZ", "velocity": "1:RZ"}
PORTS = {"inputs": "1:RZ", "outputs": "1:RZ", "band": (1.0, 60.0), "tolerance": 1e-3}
FIGURES = ("modulus_margin", "phase_margin", "gain_margin_db", "crossover")
CONTROLLER = updyn.Controller(kp=25.0, ti=0.2, low_pass=60.0, dead_time=2e-3)


def free_drive() -> updyn.Model:
    spring = np.array([[1.0, -1.0], [-1.0, 1.0]])
    groups = {
        "rotors": updyn.Group(mass=np.diag([0.5, 2.0])),
        "shaft": updyn.Group(1e4 * spring, viscous=4.0 * spring),
    }
    return updyn.Model.from_groups(groups, ["1:RZ", "2:RZ"])


def add_disc(model: updyn.Model) -> updyn.Model:
    return model.with_element("disc", ["1:RZ"], mass=0.3)


def fit(true: updyn.Model, **unknowns) -> updyn.UpdateResult:
    frf = updyn.response(true, np.linspace(5.0, 50.0, 60), ["1:RZ", "2:RZ"], ["1:RZ"])
    draw = np.random.default_rng(0).standard_normal((2, *frf.values.shape))
    frf = replace(frf, values=frf.values * (1.0 + 0.02 * (draw[0] + 1j * draw[1]) / np.sqrt(2)))
    sought = updyn.parameters(free_drive(), stiffness=["shaft"], mass=["rotors"], **unknowns)
    return updyn.update(free_drive(), frf, sought, noise={"relative": 0.02}, starts=0)


@pytest.fixture(scope="module")
def result() -> updyn.UpdateResult:
    return fit(free_drive().scaled({"shaft": {"stiffness": 1.2, "viscous": 1.3}}), viscous="shaft")


@pytest.fixture(scope="module")
def found(result):
    return updyn.modify_servo(updyn.modify(result, add_disc, 1), CONTROLLER, **PORTS, **NAMED)


def find_margins(model: updyn.Model):
    plant = updyn.plant(model, *PORTS.values())
    return updyn.servo(plant, CONTROLLER, **NAMED, step=None).velocity_loop.margins


def test_values_are_those_of_plants_of_both_models(result, found) -> None:
    before, after = find_margins(result.model), find_margins(add_disc(result.model))
    for figure in FIGURES:
        one = found.margin(figure.removesuffix("_db"))
        assert one.before == pytest.approx(getattr(before, figure), rel=5e-3)
        assert one.after == pytest.approx(getattr(after, figure), rel=5e-3)
        assert one.change == pytest.approx(one.after - one.before)
    assert found.margin("gain_margin").unit == "dB"
    assert found.before.velocity_loop.margins.crossover == found.margin("crossover").before


def test_draws_are_those_of_plants_of_models_at_the_same_values(result, found) -> None:
    family = updyn.plant_family(result, **PORTS, n=3)
    for number, values in enumerate(family.values):
        model = result.parameters.apply(result.start, values)
        before, after = find_margins(model), find_margins(add_disc(model))
        for figure in FIGURES:
            expected = [getattr(before, figure), getattr(after, figure)]
            drawn = found.margin(figure.removesuffix("_db")).draws[number]
            assert drawn == pytest.approx(expected, rel=5e-3)


def solve_loop(model: updyn.Model, freq) -> np.ndarray:
    """The exact loop function of the model, from its mobility."""
    H = updyn.response(model, np.atleast_1d(freq), ["1:RZ"], ["1:RZ"], quantity="mobility")
    return CONTROLLER.torque(2j * np.pi * np.atleast_1d(freq)) * H.values[:, 0, 0]


def solve_margins(model: updyn.Model) -> np.ndarray:
    """Crossover in Hz, phase margin there in degrees, and modulus margin, by exact FRFs."""
    lines = np.linspace(1.0, 60.0, 3000)
    level = np.abs(solve_loop(model, lines)) - 1.0
    at = int(np.flatnonzero((level[:-1] > 0.0) & (level[1:] < 0.0))[0])
    crossover = brentq(
        lambda f: float(np.abs(solve_loop(model, f))[0]) - 1.0, lines[at], lines[at + 1]
    )
    size = np.abs(1.0 + solve_loop(model, lines))
    k = int(np.argmin(size))
    curve = np.polynomial.Polynomial.fit(lines[k - 1 : k + 2], size[k - 1 : k + 2], 2)
    levels = [i for i in range(len(level) - 1) if level[i] * level[i + 1] < 0.0]
    crossings = [
        brentq(lambda f: float(np.abs(solve_loop(model, f))[0]) - 1.0, lines[i], lines[i + 1])
        for i in levels
    ]
    phase = np.degrees(np.angle(-solve_loop(model, crossings)))
    return np.array([crossover, phase[np.argmin(np.abs(phase))], curve(curve.deriv().roots()[0])])


def test_deviations_are_those_of_differences_of_exact_margins(result, found) -> None:
    """Delta method with central differences, by FRFs of the models instead of plants."""
    estimate = np.array([result.values[p.name] for p in result.parameters])
    slopes = []
    for k, std in enumerate(np.sqrt(np.diag(result.covariance))):
        ends = []
        for sign in (1.0, -1.0):
            model = result.parameters.apply(
                result.start, estimate + sign * 0.1 * std * np.eye(3)[k]
            )
            ends.append(solve_margins(add_disc(model)) - solve_margins(model))
        slopes.append((ends[0] - ends[1]) / (0.2 * std))
    expected = np.sqrt(np.einsum("im,ij,jm->m", slopes, result.covariance, np.array(slopes)))
    figures = [found.margin(name) for name in ("crossover", "phase_margin", "modulus_margin")]
    change = solve_margins(add_disc(result.model)) - solve_margins(result.model)
    assert [one.change for one in figures] == pytest.approx(change, rel=0.02)
    # Of 100 draws: 7 % is the standard deviation.
    assert [one.std_change for one in figures] == pytest.approx(expected, rel=0.25)
    for one, std in zip(figures, expected, strict=True):
        low, high = one.interval()
        assert high - low == pytest.approx(2.0 * 1.96 * std, rel=0.3)
        assert low < one.change < high


def test_summary_names_each_loop_and_figure(result, found) -> None:
    text = found.summary()
    assert "velocity  crossover" in text
    assert "Of 100 draws of the unknowns, 0 are unstable before the change and 0 after it." in text
    modified = updyn.modify(result, add_disc, 1)
    few = updyn.modify_servo(modified, CONTROLLER, **PORTS, **NAMED, n=2)
    assert repr(few) == "ServoChange(2 draws)"
    assert "too few draws" in few.summary()
    assert "<table" in few._repr_html_()


def test_a_position_loop_is_compared_too(result) -> None:
    cascade = replace(CONTROLLER, kv=8.0)
    modified = updyn.modify(result, add_disc, 1)
    found = updyn.modify_servo(modified, cascade, **PORTS, **NAMED, position="1:RZ", n=2)
    assert {one.loop for one in found.margins} == {"velocity", "position", "torque"}
    expected = updyn.servo(
        updyn.plant(add_disc(result.model), *PORTS.values()),
        cascade,
        **NAMED,
        position="1:RZ",
        step=None,
    )
    one = found.margin("modulus_margin")
    assert one.loop == "position"
    assert one.after == pytest.approx(expected.position_loop.margins.modulus_margin, rel=5e-3)


def test_an_unstable_loop_has_no_change(result) -> None:
    """A dead time that the lighter drive bears only with the disc."""
    fast = replace(CONTROLLER, kp=400.0)
    modified = updyn.modify(result, add_disc, 1)
    found = updyn.modify_servo(modified, fast, **PORTS, **NAMED, n=40)
    one = found.margin("phase_margin")
    assert one.before is None
    assert np.isnan(one.change)
    assert np.isnan(one.interval()).all()
    assert found.unstable[0] == 40
    assert 0 < found.unstable[1] == np.isnan(one.draws[:, 1]).sum() < 40
    assert "none" in found.summary()


def test_a_stated_value_replaces_its_unknown() -> None:
    """The shaft is replaced by one with a stated loss factor."""
    result = fit(free_drive().scaled({"shaft": {"loss_factor": 0.01}}), loss_factor="shaft")

    def state(model: updyn.Model) -> updyn.Model:
        return model.scaled({"shaft": {"loss_factor": 0.03}})

    modified = updyn.modify(result, state, 1)
    assert "shaft.loss_factor" not in modified.updates[1].parameters.names
    ports = {**PORTS, "tolerance": 0.01}
    found = updyn.modify_servo(modified, CONTROLLER, **ports, **NAMED, n=2)
    values = updyn.plant_family(result, **ports, n=2).values
    for number in range(2):
        model = state(result.parameters.apply(result.start, values[number]))
        plant = updyn.plant(model, *ports.values())
        expected = updyn.servo(plant, CONTROLLER, **NAMED, step=None).velocity_loop.margins
        drawn = found.margin("modulus_margin").draws[number, 1]
        assert drawn == pytest.approx(expected.modulus_margin, rel=0.01)


def test_quantiles_hold_a_further_draw_with_their_probability() -> None:
    """Order statistics of n draws enclose (rank difference) / (n + 1)."""
    draws = np.zeros((39, 2))
    draws[:, 1] = np.random.default_rng(0).permutation(39) + 1.0
    one = MarginChange("velocity", "crossover", "Hz", 0.0, 20.0, draws)
    assert one.interval() == pytest.approx((1.0, 39.0))  # ranks 1 and 39 of 40
    assert one.interval(0.5) == pytest.approx((10.0, 30.0))
    with pytest.raises(OptionError, match=r"level = 0.99: 39 draws; expected at least 199"):
        one.interval(0.99)
    draws[3, 0] = np.nan
    assert np.isnan(replace(one, draws=draws).interval()).all()


def test_unknown_names_are_refused(found) -> None:
    with pytest.raises(OptionError, match="no loop 'position'"):
        found.margin("crossover", "position")
    with pytest.raises(OptionError, match="no figure 'phase'"):
        found.margin("phase")
