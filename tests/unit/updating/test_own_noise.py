"""Sensors of unlike noise: each counts by its own, unless the model is what is wrong there."""

import dataclasses

import numpy as np
import pytest

import updyn
from updyn.updating.problem.noise import Estimated, EstimatedByChannel

SENSORS = [f"{i}:X" for i in (2, 5, 7, 10, 12)]
FREQ = np.linspace(2.0, 22.0, 60)
BAD = 3  # 10:X


@pytest.fixture(scope="module")
def clean(chain12_true):
    return updyn.response(chain12_true, FREQ, SENSORS, SENSORS[:2])


@pytest.fixture(scope="module")
def measured(clean, add_noise):
    """Return data of which one sensor has ten times the noise of the others, by seed."""

    def make(seed, times=10.0):
        rng = np.random.default_rng(seed)
        values = add_noise(clean, rng, 0.01).values.copy()
        values[:, BAD] = add_noise(clean, rng, 0.01 * times).values[:, BAD]
        return dataclasses.replace(clean, values=values)

    return make


@pytest.fixture(scope="module")
def unknowns(chain12_true):
    return updyn.parameters(chain12_true, stiffness="all", loss_factor="all")


def test_each_sensor_counts_by_its_own_noise(chain12_true, measured, unknowns):
    """Errors fall to those of the right weights, and with them the standard deviations."""
    truth = np.array([p.start for p in unknowns])
    squares = {"estimated": 0.0, "estimated-by-channel": 0.0, None: 0.0}
    for seed in range(6):
        data = measured(seed)
        for noise in squares:
            result = updyn.update(chain12_true, data, unknowns, starts=0, noise=noise)
            squares[noise] += (np.array(list(result.values.values())) - truth) ** 2
        assert result.status == "converged"
        assert result.remedy == ""
        assert result.noise["kind"] == EstimatedByChannel.kind
        found = result.adequacy
        assert (found.outcome, [one.response for one in found.noisy]) == ("noise", ["10:X"])
        assert found.noisy[0].times == pytest.approx(10.0, rel=0.3)
        assert "sensor by sensor: " in result.summary()
    assert squares[None] == pytest.approx(squares["estimated-by-channel"], rel=0.05)
    assert np.median(np.sqrt(squares[None] / squares["estimated"])) < 0.7


def test_the_reduced_tier_finds_the_same(chain12_true, measured, unknowns):
    whole, reduced = (
        updyn.update(chain12_true, measured(0), unknowns, starts=0, tier=tier)
        for tier in (None, "reduced")
    )
    assert reduced.status == "converged"
    assert reduced.noise["kind"] == whole.noise["kind"] == EstimatedByChannel.kind
    assert [one.response for one in reduced.adequacy.noisy] == ["10:X"]
    for found, expected in ((reduced.values, whole.values), (reduced.std, whole.std)):
        assert list(found.values()) == pytest.approx(list(expected.values()), rel=1e-5)


def test_sensors_alike_and_noise_that_was_chosen_stay_as_they_are(chain12_true, measured, unknowns):
    alike = updyn.update(chain12_true, measured(0, 1.0), unknowns, starts=0)
    assert alike.noise["kind"] == Estimated.kind
    assert alike.adequacy.noisy == ()
    stated = updyn.update(chain12_true, measured(1), unknowns, starts=0, noise={"relative": 0.02})
    assert stated.noise["kind"] == "stated"
    forced = updyn.update(chain12_true, measured(1), unknowns, starts=0, noise="estimated")
    assert forced.noise["kind"] == Estimated.kind
    assert [one.response for one in forced.adequacy.noisy] == ["10:X"]
    assert forced.remedy.startswith('Estimate the noise of each sensor: noise = "estimated-')


def test_where_the_model_is_wrong_no_sensor_is_believed_less(chain12_true, clean, add_noise):
    """Part 3 is 10 % stiffer than the model that is held; the sensors differ by what it does."""
    data = add_noise(clean, np.random.default_rng(7), 0.01)
    start = chain12_true.scaled({"part3": {"stiffness": 0.9}})
    others = ["part1", "part2", "part4"]
    unknowns = updyn.parameters(start, stiffness=others, loss_factor=others)
    default, forced = (
        updyn.update(start, data, unknowns, starts=0, noise=noise) for noise in (None, "estimated")
    )
    assert default.adequacy.outcome == "structure"
    assert default.noise["kind"] == Estimated.kind
    assert default.values == forced.values
    assert default.std == forced.std
    assert len(default.history) == len(forced.history)


def test_of_several_tests_the_one_whose_sensors_differ_is_weighted_so(
    chain12_true, clean, measured, unknowns, add_noise
):
    alike = add_noise(clean, np.random.default_rng(9), 0.01)
    tests = [
        updyn.Test(chain12_true, data, name=name)
        for name, data in (("alike", alike), ("unlike", measured(2)))
    ]
    joint = updyn.update_jointly(tests, unknowns, starts=0)
    own = joint.results
    kinds = {name: own[name].noise["kind"] for name in own}
    assert kinds == {"alike": Estimated.kind, "unlike": EstimatedByChannel.kind}
    assert [bool(own[name].adequacy.noisy) for name in own] == [False, True]


def test_what_follows_takes_the_noise_of_each_sensor(chain12_true, measured, unknowns):
    result = updyn.update(chain12_true, measured(3), unknowns, starts=0)
    draws = updyn.bootstrap(result, 40, seed=0)
    std = draws.values.std(axis=0, ddof=1)
    # The scatter of 40 draws is known to 11 %; the largest of eight ratios to about three of that.
    assert std / np.array(list(result.std.values())) == pytest.approx(1.0, abs=0.4)


def test_robust_alone_leaves_it_open(chain12_true, measured, unknowns):
    noise = {"robust": "student-t"}
    result = updyn.update(chain12_true, measured(4), unknowns, starts=0, noise=noise)
    assert result.noise["kind"] == EstimatedByChannel.kind
    assert result.noise["robust"] == "student-t"


def test_it_can_be_stopped_and_keeps_the_fit_before(chain12_true, measured, unknowns):
    """Whenever the user stops, the answer is one of the two fits, and said to be stopped."""

    def run(last):
        shown = []

        def callback(progress):
            shown.append(progress.stage)
            return len(shown) > last

        return updyn.update(chain12_true, measured(5), unknowns, starts=0, callback=callback), len(
            shown
        )

    whole, number = run(np.inf)
    assert whole.noise["kind"] == EstimatedByChannel.kind
    for last in range(number - 8, number - 1):
        result, _ = run(last)
        assert result.status == "stopped"
        assert all(np.isfinite(list(result.values.values())))


@pytest.mark.parametrize("lines", [FREQ, FREQ[::5]])
@pytest.mark.parametrize("fault", ["gain", "delay"])
def test_a_wrong_sensor_is_not_taken_for_a_noisy_one(
    chain12_true, clean, unknowns, add_noise, lines, fault
):
    """Not even on lines so far apart that what it leaves is not serially correlated."""
    data = add_noise(clean, np.random.default_rng(3), 0.01)
    values = data.values.copy()
    wrong = 1.08 if fault == "gain" else np.exp(-2j * np.pi * FREQ[:, None] * 1e-3)
    values[:, BAD] *= wrong
    data = dataclasses.replace(data, values=values).select(lines=lines)
    result = updyn.update(chain12_true, data, unknowns, starts=0)
    assert result.noise["kind"] == Estimated.kind
    assert result.adequacy.outcome == "structure" or result.findings
    assert not result.adequacy.noisy


def test_on_lines_far_apart_noise_is_not_told_from_what_a_wrong_model_leaves(
    chain12_true, measured, unknowns
):
    few = measured(1).select(lines=FREQ[::5])
    result = updyn.update(chain12_true, few, unknowns, starts=0)
    assert result.noise["kind"] == Estimated.kind
