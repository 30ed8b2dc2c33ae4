"""Sampling: Laplace where the likelihood is Gaussian, both modes where there are two, closed forms, bounds."""

from __future__ import annotations

import builtins
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

import updyn
from uncertain_cases import in_series, one_spring, seen_from_the_middle, without_loss
from updyn.errors import OptionError

pytest.importorskip("emcee")
pytest.importorskip("arviz_stats")

from updyn.uncertainty.sampling import _SamplingRun, compute_diagnostics


@pytest.fixture(scope="module")
def sure() -> updyn.UpdateResult:
    """Four unknowns with so little noise that their likelihood is Gaussian."""
    return without_loss(seed=2, relative=1e-4)


def test_a_gaussian_posterior_is_that_of_laplace(sure) -> None:
    """Means within 3 Monte-Carlo errors, deviations within 5 %, correlations within 0.06."""
    unknowns = [n for n in sure.parameters.names if n != "top.loss_factor"]
    inside = updyn.parameters(sure.start, stiffness="all", loss_factor=["base"])
    result = updyn.update(sure.start, sure.frf, inside, noise={"relative": 1e-4}, starts=0)
    found = updyn.sample(result, 1500, starts=0)
    assert found.converged
    assert found.names == tuple(unknowns)
    for k, name in enumerate(found.names):
        mcse = found.diagnostics["mcse_mean"][k]
        assert found.mean[name] == pytest.approx(result.values[name], abs=3 * mcse)
        assert mcse < 0.03 * result.std[name]
        assert found.deviation[name] == pytest.approx(result.std[name], rel=0.05)
    std = np.sqrt(np.diag(result.covariance))
    np.testing.assert_allclose(found.correlation, result.covariance / np.outer(std, std), atol=0.06)
    assert (found.diagnostics["r_hat"] < 1.01).all()
    assert (found.diagnostics["ess_bulk"] >= 1500).all()
    assert found.options["acceptance"] > 0.4


def test_two_modes_have_their_shares() -> None:
    """Which wall is the stiff one cannot be seen: half of the draws each way, and none between."""
    found = updyn.sample(seen_from_the_middle(), 400)
    assert found.converged
    assert found.options["n_modes"] == 2
    left, right = found["left wall.stiffness"], found["right wall.stiffness"]
    one_way = left < right
    assert 0.42 < one_way.mean() < 0.58
    for soft, stiff in ((left[one_way], right[one_way]), (right[~one_way], left[~one_way])):
        assert soft.mean() == pytest.approx(0.7, abs=0.004)
        assert stiff.mean() == pytest.approx(1.5, abs=0.006)
        assert soft.std() < 0.002
    assert "2 separate ranges" in found.message
    assert found.correlation[0, 1] < -0.99


def test_one_mode_alone_is_what_laplace_sees() -> None:
    result = seen_from_the_middle()
    found = updyn.sample(result, 400, starts=0)
    assert found.deviation["left wall.stiffness"] == pytest.approx(
        result.std["left wall.stiffness"], rel=0.1
    )


@pytest.mark.filterwarnings("ignore:.*the model has no mass")
def test_a_curved_posterior_is_its_closed_form() -> None:
    """1 / kappa is normal, flat in ln kappa: its density in c = 1 / kappa is the normal one over c."""
    result = one_spring()
    found = updyn.sample(result, 1500, starts=0)
    sigma = 0.5 * np.sqrt(np.mean(np.abs(result.frf.values) ** 2)) * result.noise["inflation"] * 50
    mean, std = 50 * result.frf.values.real.mean(), sigma / np.sqrt(12)
    c = np.linspace(1 / 20, min(mean + 8 * std, 20), 20001)
    density = norm.pdf(c, mean, std) / c
    share = np.cumsum(density) / density.sum()
    drawn = 1 / found["spring.stiffness"]
    for p in (0.05, 0.25, 0.5, 0.75, 0.95):
        expected = float(np.interp(p, share, c))
        assert (drawn <= expected).mean() == pytest.approx(p, abs=4 * np.sqrt(p * (1 - p) / 1500))
    low, high = found.intervals(0.9, "highest")["spring.stiffness"]
    plain = found.intervals(0.9)["spring.stiffness"]
    assert high - low <= plain[1] - plain[0]


def test_a_bound_cuts_the_posterior() -> None:
    """At a bound the density is a truncated normal; no draw lies outside."""
    result = without_loss(seed=3)
    assert result.at_bound == {"top.loss_factor": "lower"}
    found = updyn.sample(result, 800, starts=0)
    loss = found["top.loss_factor"]
    assert loss.min() >= 0.0
    assert found.converged
    # Where the others are Gaussian, what is left after they are integrated out is their profile.
    one = updyn.profile(result, "top.loss_factor", starts=0, level=0.9999)["top.loss_factor"]
    at = np.linspace(0.0, one.upper, 2001)
    density = np.exp(-np.interp(at, one.values, one.drop))
    share = np.cumsum(density) / density.sum()
    assert np.quantile(loss, [0.5, 0.9]) == pytest.approx(
        np.interp([0.5, 0.9], share, at), rel=0.12
    )


def test_a_prior_is_the_posterior_of_what_is_open() -> None:
    found = updyn.sample(in_series(prior=0.01), 400, starts=0, max_evaluations=20_000)
    logs = np.log(found["a.stiffness"])
    assert (logs.mean(), logs.std()) == pytest.approx((0.0, 0.01), abs=0.0015)


def test_too_few_evaluations_are_told() -> None:
    """A thin curved ridge: the ensembles do not agree within so few evaluations, and the draws say so."""
    found = updyn.sample(in_series(), 1000, starts=0, max_evaluations=5_000)
    assert not found.converged
    assert "allow more by max_evaluations" in found.message
    assert repr(found).endswith("not converged)")


def test_draws_do_not_depend_on_workers(sure) -> None:
    here, there = (
        updyn.sample(sure, 50, 3, starts=0, max_evaluations=4000, engine=e) for e in (None, 2)
    )
    np.testing.assert_array_equal(here.values, there.values)
    assert not np.array_equal(
        here.values[:5], updyn.sample(sure, 50, 4, starts=0, max_evaluations=4000).values[:5]
    )


def test_the_caller_may_stop_and_see(sure) -> None:
    notes: list[str] = []

    def watch(progress) -> bool:
        notes.append(progress.note)
        return "R-hat" in progress.note

    found = updyn.sample(sure, 100_000, starts=0, callback=watch)
    assert "effective draws, R-hat" in notes[-1]
    assert not found.converged
    assert "Stopped by the caller" in found.message
    assert len(found) > 0
    nothing = updyn.sample(sure, 100, starts=0, callback=lambda _: True)
    assert (len(nothing), nothing.converged) == (0, False)


def test_diagnosis_sees_ensembles_that_disagree() -> None:
    """Walkers of one ensemble agree among themselves; only the ensembles tell."""
    rng = np.random.default_rng(0)
    same = rng.standard_normal((40, 100, 2))
    found = compute_diagnostics(same, 4)
    assert (np.abs(found["r_hat"] - 1.0) < 0.005).all()
    assert found["ess_bulk"] == pytest.approx([4000, 4000], rel=0.15)
    assert found["mcse_mean"] == pytest.approx([1 / np.sqrt(4000)] * 2, rel=0.15)
    apart = same.copy()
    apart[:10, :, 1] += 0.5
    shifted = compute_diagnostics(apart, 4)
    assert shifted["r_hat"][0] < 1.005
    assert shifted["r_hat"][1] > 1.01


def test_without_the_sampler_there_is_a_hint(sure, monkeypatch) -> None:
    plain = builtins.__import__

    def without(name, *about):
        if name.split(".")[0] == "emcee":
            raise ImportError(name)
        return plain(name, *about)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(OptionError, match=r'pip install "updyn\[sampling\]"'):
        updyn.sample(sure)


@pytest.mark.filterwarnings("ignore:.*the model has no mass")
def test_what_is_not_understood_is_refused(sure) -> None:
    with pytest.raises(OptionError, match="n = 0: expected"):
        updyn.sample(sure, 0)
    draws = updyn.sample(sure, 20, starts=0, max_evaluations=3000)
    with pytest.raises(OptionError, match="of kind 'bca'"):
        draws.intervals(kind="bca")
    with pytest.raises(OptionError, match="about another update"):
        draws.of(one_spring())
    assert draws.of(sure).result is sure


@pytest.mark.parametrize(
    ("r_hat", "effective", "n", "problem"),
    [
        (1.009, 410.0, 1000, ""),
        (1.011, 410.0, 1000, "independent ensembles disagree on a"),
        (1.009, 390.0, 1000, "Too few effective draws of a"),
        (1.009, 390.0, 380, ""),
    ],
)
def test_draws_are_used_from_400_and_an_r_hat_of_1_01(r_hat, effective, n, problem) -> None:
    run = SimpleNamespace(
        n=n,
        counter=SimpleNamespace(stopped=False),
        evaluations=0,
        max_evaluations=1,
        reduction={},
    )
    numbers = {"r_hat": r_hat, "ess_bulk": effective, "ess_tail": effective}
    diagnostics = {name: np.array([value]) for name, value in numbers.items()}
    found = _SamplingRun._problems(run, diagnostics, ["a"])
    assert len(found) == bool(problem)
    assert problem in " ".join(found)
