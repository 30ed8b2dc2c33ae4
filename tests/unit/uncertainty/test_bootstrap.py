"""Bootstrap: agrees with Laplace where that is right, follows curvature where it is not, counts what fails."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

import updyn
from uncertain_cases import in_series, one_spring, without_loss
from updyn.errors import OptionError, SolverError
from updyn.updating.fit.methods.maximum_likelihood import MaximumLikelihood


@pytest.fixture(scope="module")
def fit() -> updyn.UpdateResult:
    return without_loss(seed=1, relative=0.01)


@pytest.fixture(scope="module")
def drawn(fit) -> updyn.uncertainty.draws.Draws:
    return updyn.bootstrap(fit, 120)


def away_from_bounds(fit) -> list[str]:
    return [n for n in fit.parameters.names if n != "top.loss_factor"]


def test_its_spread_is_that_of_laplace(fit, drawn) -> None:
    """The deviation of a sample of 120 is known to 6.5 %."""
    for name in away_from_bounds(fit):
        assert drawn.deviation[name] == pytest.approx(fit.std[name], rel=0.2)
        assert drawn.mean[name] == pytest.approx(
            fit.values[name], abs=4 * fit.std[name] / np.sqrt(120)
        )
    names = away_from_bounds(fit)
    at = [drawn.names.index(n) for n in names]
    C = fit.covariance[np.ix_(at, at)]
    std = np.sqrt(np.diag(C))
    np.testing.assert_allclose(drawn.correlation[np.ix_(at, at)], C / np.outer(std, std), atol=0.25)
    assert drawn.converged
    assert drawn.failed == {}


def test_residuals_drawn_again_give_the_same_spread(fit) -> None:
    found = updyn.bootstrap(fit, 60, kind="residual")
    ratio = [found.deviation[n] / fit.std[n] for n in away_from_bounds(fit)]
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.25)
    assert found.options["resampling"] == "residual"


@pytest.mark.filterwarnings("ignore:.*the model has no mass")
def test_intervals_follow_a_curved_likelihood() -> None:
    """1 / kappa is normal: every kind of interval lies within the error of 250 draws about 1 / (mean +- 1.96 std)."""
    result = one_spring(floor=0.4)
    found = updyn.bootstrap(result, 250)
    sigma = 0.4 * np.sqrt(np.mean(np.abs(result.frf.values) ** 2)) * result.noise["inflation"]
    mean, half = 1 / (50 * result.values["spring.stiffness"]), 1.6449 * sigma / np.sqrt(12)
    low, high = 1 / (50 * (mean + half)), 1 / (50 * (mean - half))
    for kind in ("percentile", "bca"):
        ends = found.intervals(0.9, kind)["spring.stiffness"]
        assert np.log(ends) == pytest.approx(np.log([low, high]), abs=0.05)
    lower, upper = found.intervals(0.9, "basic")["spring.stiffness"]
    value = result.values["spring.stiffness"]
    plain = found.intervals(0.9)["spring.stiffness"]
    assert (lower, upper) == pytest.approx((value**2 / plain[1], value**2 / plain[0]))


def test_bca_corrects_bias_as_its_formula_says() -> None:
    values = np.random.default_rng(0).normal(0.3, 1.0, 4001)
    draws = updyn.uncertainty.draws.Draws(
        "bootstrap", ("a",), values[None, :, None], np.zeros(1), np.ones(1), np.full(1, -9.0), np.full(1, 9.0),
        np.zeros(1, bool), {"acceleration": np.array([0.05])},
    )  # fmt: skip
    z0 = norm.ppf((values < 0).mean())
    expected = [
        np.quantile(values, norm.cdf(z0 + (z0 + z) / (1 - 0.05 * (z0 + z))))
        for z in (-1.95996, 1.95996)
    ]
    assert draws.intervals(0.95, "bca")["a"] == pytest.approx(expected, abs=1e-5)


def test_draws_stay_within_bounds_and_the_bound_is_told() -> None:
    result = next(r for r in map(without_loss, range(20)) if r.at_bound)
    found = updyn.bootstrap(result, 60)
    assert found["top.loss_factor"].min() == 0.0
    assert 0.2 < (found["top.loss_factor"] == 0.0).mean() < 0.8
    assert "use a profile for top.loss_factor" in found.message


def test_a_prior_is_drawn_as_data() -> None:
    """What the data leave open is spread as its prior, not stuck at its centre."""
    result = in_series(prior=0.05)
    found = updyn.bootstrap(result, 80)
    assert np.log(found["a.stiffness"]).std() == pytest.approx(0.05, rel=0.25)
    assert found.deviation["b.stiffness"] == pytest.approx(result.std["b.stiffness"], rel=0.25)


@pytest.mark.parametrize("method", ["log", "output-error"])
def test_other_methods(method) -> None:
    known = without_loss(seed=1, relative=0.01)
    unknowns = updyn.parameters(known.start, stiffness="all")
    result = updyn.update(known.start, known.frf, unknowns, method=method)
    found = updyn.bootstrap(result, 60)
    ratio = [found.deviation[n] / result.std[n] for n in result.parameters.names]
    if method == "log":
        assert ratio == pytest.approx([1.0, 1.0], abs=0.3)
    assert found.converged


def test_refits_that_fail_are_counted(fit, monkeypatch) -> None:
    plain, calls = MaximumLikelihood.fit, iter(range(100))

    def sometimes(self, *about):
        if next(calls) % 4 == 0:
            raise SolverError("singular at 3 Hz")
        return plain(self, *about)

    monkeypatch.setattr(MaximumLikelihood, "fit", sometimes)
    found = updyn.bootstrap(fit, 20)
    assert (len(found), dict(found.failed), found.converged) == (
        15,
        {"not solved: singular at 3 Hz": 5},
        False,
    )
    assert "5 of 20 refits failed: not solved: singular at 3 Hz (5)" in found.message
    assert "not reliable" in found.summary()


def test_draws_do_not_depend_on_workers_nor_on_their_number(fit, drawn) -> None:
    np.testing.assert_array_equal(updyn.bootstrap(fit, 6, engine=2).values, drawn.values[:6])
    assert not np.array_equal(updyn.bootstrap(fit, 3, seed=1).values, drawn.values[:3])


def test_the_caller_may_stop(fit) -> None:
    found = updyn.bootstrap(fit, 10, callback=lambda p: p.done == 4)
    assert len(found) == 4
    assert "Stopped after 4 of 10 refits" in found.message
    none = updyn.bootstrap(fit, 10, callback=lambda _: True)
    assert len(none) <= 1
    assert not none.converged
    assert none.summary()


def test_the_words(fit, drawn) -> None:
    text = drawn.summary(0.9)
    assert text.startswith("Bootstrap: 120 draws")
    assert "90 % intervals" in text
    assert repr(drawn) == "Draws(bootstrap, 120 of 4 unknowns)"


def test_what_is_not_understood_is_refused(fit, drawn) -> None:
    with pytest.raises(OptionError, match="n = 1: expected"):
        updyn.bootstrap(fit, 1)
    with pytest.raises(OptionError, match="kind 'parametrik': did you mean 'parametric'"):
        updyn.bootstrap(fit, 10, kind="parametrik")
    with pytest.raises(OptionError, match="of kind 'bac': did you mean 'basic' or 'bca'"):
        drawn.intervals(kind="bac")
    with pytest.raises(OptionError, match="level = 2"):
        drawn.intervals(2)
    with pytest.raises(OptionError, match=r"no draws of 'top\.stifness'; did you mean"):
        drawn["top.stifness"]


@pytest.mark.parametrize(("n", "reliable"), [(21, True), (19, False)])
def test_draws_are_reliable_up_to_a_twentieth_of_failed_refits(fit, monkeypatch, n, reliable):
    plain, calls = MaximumLikelihood.fit, iter(range(100))

    def fail_once(self, *about):
        if next(calls) == 0:
            raise SolverError("singular at 3 Hz")
        return plain(self, *about)

    monkeypatch.setattr(MaximumLikelihood, "fit", fail_once)
    assert updyn.bootstrap(fit, n).converged is reliable


# -- parts of a bootstrap --------------------------------------------------------------------------
def test_parts_give_the_draws_of_one_bootstrap(fit, tmp_path) -> None:
    whole = updyn.bootstrap(fit, 7, seed=4)
    parts = [updyn.bootstrap(fit, n, seed=4, first=first) for first, n in ((5, 2), (0, 3), (3, 2))]
    for number, part in enumerate(parts):
        updyn.write_uncertainty(part, tmp_path / f"{number}.nc")
    read = [updyn.read_uncertainty(tmp_path / f"{number}.nc", fit) for number in range(3)]
    merged = updyn.merge_draws(read)
    np.testing.assert_array_equal(merged.values, whole.values)
    assert merged.diagnostics.keys() == whole.diagnostics.keys()
    for name, values in whole.diagnostics.items():
        np.testing.assert_array_equal(merged.diagnostics[name], values)
    assert (merged.message, merged.converged, merged.failed) == (whole.message, True, {})
    assert merged.options["n"] == 7
    assert merged.options["ranges"] == [[4, 0, 3], [4, 3, 2], [4, 5, 2]]
    again = updyn.merge_draws([updyn.merge_draws(read[:2]), read[2]])
    np.testing.assert_array_equal(np.sort(again.values, axis=0), np.sort(whole.values, axis=0))
    other_seed = updyn.merge_draws([*parts, updyn.bootstrap(fit, 2, seed=5)])
    assert len(other_seed) == 9


def test_failed_and_stopped_refits_of_parts_are_counted(fit) -> None:
    parts = [updyn.bootstrap(fit, 2, first=2 * k) for k in range(2)]
    broken = replace(parts[1], chains=parts[1].chains[:, :1], failed={"stalled": 1})
    merged = updyn.merge_draws([parts[0], broken])
    assert not merged.converged
    assert "1 of 4 refits failed: stalled (1)" in merged.message
    stopped = replace(parts[1], chains=parts[1].chains[:, :1])
    assert "Stopped after 3 of 4 refits." in updyn.merge_draws([parts[0], stopped]).message


def test_parts_that_do_not_belong_together_are_refused(fit) -> None:
    part = updyn.bootstrap(fit, 3)
    cases: dict[str, list[object]] = {
        "at least one bootstrap, found none": [],
        "refit 2 of seed 0 is in parts 1 and 2": [part, updyn.bootstrap(fit, 2, first=2)],
        r"part 2 was read without its update": [part, replace(part, result=None)],
        "parts 1 and 2 are of a different update": [
            part,
            replace(part, estimate=part.estimate + 1),
        ],
        "parts 1 and 2 are of a different resampling": [
            part,
            updyn.bootstrap(fit, 2, first=9, kind="residual"),
        ],
        "part 1, .* is no bootstrap": [replace(part, kind="sampling")],
    }
    for message, parts in cases.items():
        with pytest.raises(OptionError, match=message):
            updyn.merge_draws(parts)
    with pytest.raises(OptionError, match="first = -1: expected a number of refits from 0 up"):
        updyn.bootstrap(fit, 2, first=-1)
