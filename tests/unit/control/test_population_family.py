"""Families of plants of a population: members at further structures of the design."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import kstest, t

import updyn
from updyn.control import family as family_module
from updyn.control.family import plant_family
from updyn.errors import OptionError

STIFFNESS = 1e4
PORTS = {"inputs": "2:RZ", "outputs": ["1:RZ", "2:RZ"], "band": (2.0, 60.0), "error": "peak"}
FREQ = np.linspace(2.0, 60.0, 200)


def drive(inertia: float = 2.0) -> updyn.Model:
    """A rotor on a shaft to a rotor on a spring to the ground."""
    groups = {
        "rotors": updyn.Group(mass=np.diag([0.5, inertia])),
        "shaft": updyn.Group(STIFFNESS * np.array([[1.0, -1.0], [-1.0, 1.0]]), loss_factor=0.02),
        "mount": updyn.Group(np.diag([0.0, 3e4]), loss_factor=0.03),
    }
    return updyn.Model.from_groups(groups, ["1:RZ", "2:RZ"])


def measure(model: updyn.Model, seed: int) -> list[updyn.Test]:
    """Five specimens with known scatter of both stiffnesses, natural frequencies at 0.1 %."""
    rng, tests = np.random.default_rng(seed), []
    for name in "abcde":
        shaft, mount = 1.0 + np.array([0.08, 0.05]) * rng.standard_normal(2)
        one = model.scaled({"shaft": {"stiffness": shaft}, "mount": {"stiffness": mount}})
        frequency = updyn.modes(one, 2).frequency
        tests.append(
            updyn.Test(model, updyn.ModeSet(frequency, std_frequency=1e-3 * frequency), name)
        )
    return tests


@pytest.fixture(scope="module")
def population() -> updyn.PopulationResult:
    model = drive()
    unknowns = updyn.parameters(model, stiffness=["shaft", "mount"])
    return updyn.update_population(measure(model, 1), unknowns, starts=0)


@pytest.fixture(scope="module")
def family(population) -> updyn.PlantFamily:
    return plant_family(population, **PORTS, n=5, seed=3)


def solve(population, values) -> np.ndarray:
    model = population.parameters.apply(drive(), values)
    return updyn.response(model, FREQ, ["1:RZ", "2:RZ"], ["2:RZ"]).values


def test_members_are_the_plants_of_models_at_the_draws(population, family) -> None:
    assert family.names == ("shaft.stiffness", "mount.stiffness")
    assert family.facts["source"] == "population"
    for member, values in zip(family.members, family.values, strict=True):
        exact = solve(population, values)
        error = np.abs(member.response(FREQ).values - exact) / np.abs(exact).max(axis=0)
        assert error.max() < 0.02
        pole = np.sort(np.abs(member.poles))[[0, -1]] / (2.0 * np.pi)
        model = population.parameters.apply(drive(), values)
        assert pole == pytest.approx(updyn.modes(model, 2).frequency, rel=1e-3)
    assert np.ptp(family.values, axis=0).min() > 0.02


def test_the_nominal_plant_is_at_the_mean(population, family) -> None:
    exact = solve(population, list(population.mean.values()))
    error = np.abs(family.nominal.response(FREQ).values - exact) / np.abs(exact).max(axis=0)
    assert error.max() < 0.02
    model = population.parameters.apply(drive(), list(population.mean.values()))
    assert family.nominal.modes == pytest.approx(updyn.modes(model, 2).frequency, rel=1e-9)


def test_draws_follow_the_prediction_of_a_further_structure(population) -> None:
    """Student's distribution with four degrees of freedom, as the prediction intervals."""
    drawn = family_module._draw_from_population(population, 4000, 0)
    total = population.covariance + population.mean_covariance
    mean = np.array(list(population.mean.values()))
    for k, name in enumerate(population.mean):
        score = (drawn.values[:, k] - mean[k]) / np.sqrt(total[k, k])
        assert kstest(score, t(4).cdf).pvalue > 0.01
        low, high = population.prediction_intervals()[name]
        inside = (drawn.values[:, k] > low) & (drawn.values[:, k] < high)
        assert inside.mean() == pytest.approx(0.95, abs=0.012)  # 3.5 standard errors
    rank = np.argsort(np.argsort(drawn.values, axis=0), axis=0)
    expected = total[0, 1] / np.sqrt(total[0, 0] * total[1, 1])
    sine = 6.0 / np.pi * np.arcsin(0.5 * expected)  # Spearman's correlation of a normal pair
    assert np.corrcoef(rank, rowvar=False)[0, 1] == pytest.approx(sine, abs=0.06)
    assert not drawn.cut


def test_draws_beyond_a_bound_are_clipped_and_stated(population) -> None:
    """With two specimens Student's distribution is that of Cauchy, which leaves the bounds."""
    names = list(population.specimens)[:2]
    some = {name: population.specimens[name].result for name in names}
    tests = [test for test in measure(drive(), 1) if test.name in names]
    few = updyn.update_population(tests, population.parameters, known=some)
    drawn = family_module._draw_from_population(few, 2000, 0)
    lower, upper = few.parameters.lower, few.parameters.upper
    at_bound = (drawn.values == lower) | (drawn.values == upper)
    assert dict(zip(few.mean, at_bound.mean(axis=0), strict=True)) == pytest.approx(drawn.cut)
    assert (drawn.values >= lower).all()
    assert (drawn.values <= upper).all()


def test_the_model_is_that_of_a_named_specimen(population) -> None:
    model, heavier = drive(), drive(2.5)
    tests = measure(model, 1)
    tests[1] = updyn.Test(heavier, tests[1].data, tests[1].name)
    mixed = updyn.update_population(tests, population.parameters, starts=0)
    with pytest.raises(OptionError, match=r"several models; test= names .* such as 'a'"):
        plant_family(mixed, **PORTS, n=1)
    with pytest.raises(OptionError, match="no specimen 'x'"):
        plant_family(mixed, **PORTS, n=1, test="x")
    found = plant_family(mixed, **PORTS, n=1, test="b")
    expected = mixed.parameters.apply(heavier, list(mixed.mean.values()))
    assert found.nominal.modes == pytest.approx(updyn.modes(expected, 2).frequency, rel=1e-9)


def test_draws_of_an_update_are_refused(population) -> None:
    with pytest.raises(OptionError, match="draws are those of an update, not of a population"):
        plant_family(population, **PORTS, n=1, draws=object())


def test_a_servo_takes_the_family(family) -> None:
    controller = updyn.Controller(kp=2.0)
    named = {"torque": "2:RZ", "velocity": "2:RZ"}
    margins = [
        updyn.servo(member, controller, **named, step=None).velocity_loop.margins.modulus_margin
        for member in family.members
    ]
    found = updyn.servo(family, controller, **named, step=None).velocity_loop
    worst = found.worst["modulus_margin"]
    assert worst.smallest == pytest.approx(min(margins), rel=1e-6)
    assert worst.smallest_member == int(np.argmin(margins))
