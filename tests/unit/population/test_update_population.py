"""`updyn.update_population`: specimens with known stiffness, and its errors."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2, t

import updyn
from updyn.demos import chain

FACTORS = {"a": (0.9, 1.1), "b": (1.0, 0.8), "c": (1.15, 1.0), "d": (1.05, 1.2), "e": (0.8, 0.95)}
NAMES = ["part1.stiffness", "part3.stiffness"]
STD = 1e-3


def measure(model, factors, n_modes=4):
    part1, part3 = factors
    specimen = model.scaled({"part1": {"stiffness": part1}, "part3": {"stiffness": part3}})
    frequency = updyn.modes(specimen, n_modes).frequency
    return updyn.ModeSet(frequency, std_frequency=STD * frequency)


@pytest.fixture(scope="module")
def model():
    return chain.build()


@pytest.fixture(scope="module")
def unknowns(model):
    return updyn.parameters(model, stiffness=["part1", "part3"])


@pytest.fixture(scope="module")
def tests(model):
    return [updyn.Test(model, measure(model, one), name) for name, one in FACTORS.items()]


@pytest.fixture(scope="module")
def population(tests, unknowns):
    return updyn.update_population(tests, unknowns, starts=0)


def test_mean_and_covariance_are_those_of_the_specimens(population):
    """Without noise the estimates are the truth; the stated noise is small next to the scatter."""
    true = np.array(list(FACTORS.values()))
    np.testing.assert_allclose(list(population.mean.values()), true.mean(axis=0), rtol=2e-3)
    np.testing.assert_allclose(population.covariance, np.cov(true, rowvar=False), atol=1e-4)
    assert list(population.mean) == NAMES
    assert population.correlated
    assert population.differs
    for name, one in population.specimens.items():
        np.testing.assert_allclose(list(one.values.values()), FACTORS[name], rtol=2e-3)
        assert one.deviation[NAMES[0]] == one.values[NAMES[0]] - population.mean[NAMES[0]]


def test_intervals_are_those_of_normal_samples(population):
    """Textbook intervals for mean, deviation and a further value of a normal sample of five."""
    true = np.array([one[0] for one in FACTORS.values()])
    mean, std = true.mean(), true.std(ddof=1)
    half = t.ppf(0.975, 4) * std / np.sqrt(5)
    close = {"rel": 5e-3}
    assert population.intervals()[NAMES[0]] == pytest.approx((mean - half, mean + half), **close)
    ends = std * np.sqrt(4.0 / chi2.ppf([0.975, 0.025], 4))
    assert population.std_intervals()[NAMES[0]] == pytest.approx(tuple(ends), **close)
    half *= np.sqrt(6)
    further = population.prediction_intervals()[NAMES[0]]
    assert further == pytest.approx((mean - half, mean + half), **close)


def test_equal_specimens_do_not_differ(model, unknowns):
    rng = np.random.default_rng(1)
    true = measure(model, (1.1, 0.9)).frequency
    tests = []
    for number in range(6):
        noisy = true * (1.0 + STD * rng.standard_normal(len(true)))
        tests.append(
            updyn.Test(model, updyn.ModeSet(noisy, std_frequency=STD * true), f"s{number}")
        )
    found = updyn.update_population(tests, unknowns, starts=0)
    assert not found.differs
    assert "the noise of the tests explains their differences" in found.summary()
    assert np.sqrt(found.covariance[0, 0]) < 5e-3
    assert found.std_intervals()[NAMES[0]][0] == 0.0


def test_a_specimen_with_missing_modes_follows_the_population(tests, model, unknowns, population):
    few = updyn.Test(model, measure(model, (1.02, 1.01), n_modes=1), "few")
    known = {name: one.result for name, one in population.specimens.items()}
    found = updyn.update_population([*tests, few], unknowns, starts=0, known=known)
    one = found.specimens["few"]
    assert not np.isfinite(one.result.std[NAMES[1]])
    low, high = found.prediction_intervals()[NAMES[1]]
    assert low < one.values[NAMES[1]] < high
    assert one.std[NAMES[1]] == pytest.approx(found.std[NAMES[1]], rel=0.2)


def test_an_outlier_is_named(model, unknowns):
    rng = np.random.default_rng(0)
    factors = {f"s{i}": tuple(1.0 + 0.01 * rng.standard_normal(2)) for i in range(15)}
    factors["cracked"] = (0.7, 1.0)
    tests = [updyn.Test(model, measure(model, one), name) for name, one in factors.items()]
    assert list(updyn.update_population(tests, unknowns, starts=0).outliers()) == ["cracked"]


def test_more_unknowns_than_specimens_have_no_correlation(tests, unknowns, population):
    known = {name: one.result for name, one in population.specimens.items()}
    found = updyn.update_population(tests[:2], unknowns, starts=0, known={"a": known["a"]})
    assert not found.correlated
    assert found.covariance[0, 1] == 0.0
    true = np.array([FACTORS["a"], FACTORS["b"]])
    assert list(found.std.values()) == pytest.approx(true.std(axis=0, ddof=1), rel=2e-2)


def test_known_results_are_not_fitted_again(tests, unknowns, population):
    known = {name: one.result for name, one in population.specimens.items()}
    found = updyn.update_population(tests, unknowns, known=known)
    assert found.mean == population.mean
    assert all(found.specimens[name].result is result for name, result in known.items())


def test_a_stop_states_what_is_done(tests, unknowns):
    with pytest.raises(updyn.errors.StoppedError, match=r"after a$"):
        updyn.update_population(tests, unknowns, starts=0, callback=lambda _: True)


def test_an_update_that_ended_early_is_excluded_and_stated(tests, unknowns, population):
    known = {name: one.result for name, one in population.specimens.items()}
    known["b"] = dataclasses.replace(known["b"], status="max-iterations")
    with pytest.warns(updyn.UpdynWarning, match="b is not used: its update ended as 'max-iter"):
        found = updyn.update_population(tests, unknowns, known=known)
    assert list(found.specimens) == ["a", "c", "d", "e"]
    assert list(found.excluded) == ["b"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda tests: {"tests": tests[:1]}, "at least two Test"),
        (lambda tests: {"tests": [tests[0], tests[0]]}, "two tests are called 'a'"),
        (lambda tests: {"known": {"aa": None}}, "no test 'aa'; did you mean 'a'"),
    ],
)
def test_errors(tests, unknowns, change, message):
    with pytest.raises(updyn.UpdynError, match=message):
        updyn.update_population(**{"tests": tests, "parameters": unknowns, **change(tests)})


def test_an_unknown_that_no_specimen_determines(model):
    unknowns = updyn.parameters(model, stiffness=["part1", "part2", "part3"])
    tests = [updyn.Test(model, measure(model, FACTORS[name], n_modes=1), name) for name in "ab"]
    with pytest.raises(updyn.errors.DataError, match="together do not determine"):
        updyn.update_population(tests, unknowns, starts=0)
