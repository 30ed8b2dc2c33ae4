"""Profile likelihood against closed forms, against Laplace, on bounds, on open ends and on two separate ranges."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import updyn
from uncertain_cases import in_series, one_spring, seen_from_the_middle, without_loss
from updyn.errors import OptionError
from updyn.uncertainty import profile
from updyn.uncertainty.restored import restore


@pytest.fixture(scope="module")
def sure(chain12_true, chain12_frf, add_noise) -> updyn.UpdateResult:
    """The chain with so little noise that its likelihood is Gaussian."""
    data = add_noise(
        chain12_frf.select(references=["2:X", "12:X"]), np.random.default_rng(0), 0.001
    )
    unknowns = updyn.parameters(
        chain12_true, stiffness=["part1", "part3"], loss_factor=["part1", "part2"]
    )
    return updyn.update(chain12_true, data, unknowns, noise={"relative": 0.001}, starts=0)


def laplace(result: updyn.UpdateResult, name: str, z: float) -> tuple[float, float]:
    value, std = result.values[name], result.std[name]
    if name.endswith("loss_factor"):
        return value - z * std, value + z * std
    return value * np.exp(-z * std / value), value * np.exp(z * std / value)


@pytest.mark.parametrize(("level", "z"), [(0.95, 1.959964), (0.6826895, 1.0)])
def test_a_gaussian_likelihood_gives_the_interval_of_laplace(sure, level, z) -> None:
    found = updyn.profile(sure, level=level, starts=0)
    assert list(found) == sure.parameters.names
    for name, one in found.items():
        low, high = laplace(sure, name, z)
        half = 0.5 * (high - low)
        assert (one.lower, one.upper) == pytest.approx((low, high), abs=0.01 * half)
        assert one.estimate == pytest.approx(sure.values[name], abs=0.01 * half)
        assert (one.lower_end, one.upper_end, one.note) == ("level", "level", "")


@pytest.mark.filterwarnings("ignore:.*the model has no mass")
def test_a_curved_likelihood_gives_its_own_interval() -> None:
    """H = 1 / (kappa k): in 1 / kappa the cost is a parabola, so that the ends are 1 / (mean +- 1.96 std)."""
    result = one_spring()
    k, frf = 50.0, result.frf
    sigma = 0.5 * np.sqrt(np.mean(np.abs(frf.values) ** 2)) * result.noise["inflation"]
    mean = frf.values.real.mean()
    half = np.sqrt(3.841459) * sigma / np.sqrt(2 * len(frf.freq))
    (one,) = updyn.profile(result).values()
    assert one.estimate == pytest.approx(1 / (k * mean), rel=1e-4)
    assert (one.lower, one.upper) == pytest.approx(
        (1 / (k * (mean + half)), 1 / (k * (mean - half))), rel=1e-4
    )
    # Lopsided, as Laplace in the logarithm is not.
    assert np.log(one.upper / one.estimate) > 1.2 * np.log(one.estimate / one.lower)
    compliance = 1 / (k * one.values)
    expected = len(frf.freq) * ((compliance - mean) / sigma) ** 2
    np.testing.assert_allclose(one.drop, expected - expected.min(), atol=1e-6 * expected.max())


def test_a_loss_factor_on_its_bound_gets_a_one_sided_interval() -> None:
    result = next(
        r for r in map(without_loss, range(20)) if r.at_bound == {"top.loss_factor": "lower"}
    )
    one = updyn.profile(result)["top.loss_factor"]
    assert (one.lower, one.lower_end, one.upper_end) == (0.0, "zero", "level")
    # The end is where the likelihood of the other unknowns fitted again has fallen by 1.92: checked
    # by another way.
    held = result.start.scaled({"top": {"loss_factor": one.upper}})
    rest = updyn.parameters(held, stiffness="all", loss_factor=["base"])
    again = updyn.update(held, result.frf, rest, noise={"relative": 0.02}, starts=0)
    cost = {}
    for name, fit in (("free", result), ("held", again)):
        values = [fit.values.get(n, one.upper) for n in result.parameters.names]
        setting = restore(result)
        cost[name] = setting.likelihood().cost(setting.problem.coordinates.to_x(np.array(values)))
    assert cost["held"] - cost["free"] == pytest.approx(1.92, rel=0.03)


def test_true_zeros_are_covered_as_often_as_said() -> None:
    """The one-sided interval covers a zero in 97.5 % of draws (Self & Liang 1987); symmetric bars cannot say so."""
    covered = [
        updyn.profile(without_loss(s), "top.loss_factor", starts=0)["top.loss_factor"]
        for s in range(40)
    ]
    assert sum(c.lower == 0.0 for c in covered) >= 36
    assert all(c.upper > 0.0 for c in covered)


def test_open_ends_are_said() -> None:
    found = updyn.profile(in_series())
    a = found["a.stiffness"]
    assert (a.upper, a.upper_end, a.lower_end) == (5.0, "bound", "level")
    assert "no upper end within its bounds: the data do not limit it" in a.note
    # What holds it from below: the other spring may not be stiffer than its bound.
    series = 1 / (1 / 3000 + 1 / (1.4 * 1500))
    assert a.lower == pytest.approx(1 / (1 / series - 1 / (5 * 1500)) / 3000, rel=0.02)
    assert "no upper end" in found.summary()


def test_a_prior_closes_them() -> None:
    found = updyn.profile(in_series(prior=0.05))
    a = found["a.stiffness"]
    assert np.log([a.lower / a.estimate, a.upper / a.estimate]) == pytest.approx(
        [-0.098, 0.098], rel=0.02
    )


def test_two_separate_ranges_are_both_found() -> None:
    result = seen_from_the_middle()
    found = updyn.profile(result)
    for one in found.values():
        assert len(one.intervals) == 2
        for own, true in zip(one.intervals, (0.7, 1.5), strict=True):
            assert own.lower < true < own.upper
            assert own.best == pytest.approx(true, rel=0.03)
        assert max(h.drop for h in one.intervals) == pytest.approx(0.0, abs=1e-3)
        assert "2 separate ranges fit the data" in one.note
    narrow = updyn.profile(result, "left wall.stiffness", starts=0)["left wall.stiffness"]
    assert len(narrow.intervals) == 1


def test_a_better_fit_on_the_way_is_told() -> None:
    """A fit that was left in a worse minimum: the profile finds the better one, and is about it."""
    whole = seen_from_the_middle()
    model = whole.start
    true = model.scaled({"left wall": {"stiffness": 0.7}, "right wall": {"stiffness": 1.5}})
    frf = updyn.response(true, np.linspace(2.0, 12.0, 60), ["2:X", "1:X"], ["2:X"])
    variance = np.empty(frf.values.shape)
    variance[:, 0], variance[:, 1] = (
        (0.05 * np.abs(frf.values[:, 0])) ** 2,
        (2.0 * np.abs(frf.values[:, 1])) ** 2,
    )
    data = updyn.FRF(
        frf.freq, frf.values, frf.responses, frf.references, frf.quantity, variance=variance
    )
    swapped = whole.parameters.with_start([1.45, 0.72])
    worse = updyn.update(model, data, swapped, starts=0)
    assert worse.values["left wall.stiffness"] > 1.0
    found = updyn.profile(worse)
    assert found.better == pytest.approx(
        {"left wall.stiffness": 0.7, "right wall.stiffness": 1.5}, rel=1e-3
    )
    assert "better fit" in found.summary()
    assert found["left wall.stiffness"].estimate == pytest.approx(0.7, rel=1e-3)


@pytest.mark.filterwarnings("ignore:.*the model has no mass")
def test_several_tests_are_profiled_together() -> None:
    """Two tests of one spring narrow the interval by the root of two."""
    one, other = one_spring(0, 0.02), one_spring(1, 0.02)
    tests = [
        updyn.Test(r.start, r.frf, name, noise={"floor": 0.02})
        for name, r in (("1", one), ("2", other))
    ]
    joint = updyn.update_jointly(tests, one.parameters, starts=0)
    widths = [
        np.log(p.upper / p.lower)
        for p in (updyn.profile(r)["spring.stiffness"] for r in (one, joint))
    ]
    inflation = joint.first.noise["inflation"] / one.noise["inflation"]
    assert widths[1] / widths[0] == pytest.approx(inflation / np.sqrt(2), rel=0.02)


def test_workers_change_nothing(sure) -> None:
    names = sure.parameters.names[:2]
    here, there = (updyn.profile(sure, names, starts=0, engine=e) for e in (None, 2))
    for name in names:
        np.testing.assert_array_equal(here[name].values, there[name].values)
        np.testing.assert_array_equal(here[name].drop, there[name].drop)


def test_the_caller_may_stop(sure) -> None:
    seen: list[updyn.uncertainty.progress.WorkProgress] = []

    def stop(progress) -> bool:
        seen.append(progress)
        return progress.done == 1

    found = updyn.profile(sure, starts=0, callback=stop)
    assert (list(found), found.missing) == (
        sure.parameters.names[:1],
        tuple(sure.parameters.names[1:]),
    )
    assert (seen[-1].stage, seen[-1].done, seen[-1].total) == ("profile", 1, 4)
    assert "Stopped before" in found.message


def test_what_cannot_be_profiled_is_refused(sure, chain12, chain12_frf) -> None:
    with pytest.raises(
        OptionError, match=r"no unknown 'part1.stifness'; did you mean 'part1.stiffness'"
    ):
        updyn.profile(sure, ["part1.stifness"])
    with pytest.raises(OptionError, match="level = 95"):
        updyn.profile(sure, level=95)
    with pytest.raises(OptionError, match="expected the result of an update, found Model"):
        updyn.profile(chain12)
    unknowns = updyn.parameters(chain12, stiffness="all")
    biased = updyn.update(chain12, chain12_frf, unknowns, method="equation-error")
    with pytest.raises(OptionError, match="'equation-error' does not minimise a likelihood"):
        updyn.profile(biased)
    with pytest.raises(OptionError, match="no profile of 'part2"):
        updyn.profile(sure, "part1.stiffness", starts=0)["part2.stiffness"]


@pytest.mark.parametrize(("decrease", "is_better"), [(0.0049, False), (0.0051, True)])
def test_another_minimum_is_better_by_a_tenth_of_a_standard_deviation(
    monkeypatch, decrease, is_better
):
    """Half the square of a tenth."""
    ends = [SimpleNamespace(cost=7.0), SimpleNamespace(cost=7.0 - decrease, x=np.ones(1))]
    monkeypatch.setattr(profile, "find_minima", lambda *about: ends)
    monkeypatch.setattr(profile, "_trace_profiles", lambda *about: ({}, ends[1]))
    likelihood = SimpleNamespace(descend=lambda x: ends[0])
    restored = SimpleNamespace(
        x=None, whole=None, names=["part.stiffness"], likelihood=lambda: likelihood
    )
    restored.with_problem = lambda problem: restored
    problem = SimpleNamespace(n=1, coordinates=SimpleNamespace(to_values=lambda x: x))
    run = profile._ProfileRun(restored, [], 1.92, 0, 0, None)
    run.compute(problem)
    assert bool(run.better) == is_better
