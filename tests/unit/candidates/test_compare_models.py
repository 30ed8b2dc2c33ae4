"""`updyn.compare_models`: the right model first, its evidence by quadrature, model errors, refusals."""

from __future__ import annotations

import json

import numpy as np
import pytest

import updyn
from updyn.demos import chain
from updyn.errors import DataError, DofError, OptionError, StoppedError
from updyn.report import write_candidates
from updyn.store.values import plain

FLOOR = 0.02
BOUNDS = {"stiffness": (0.5, 2.0)}


@pytest.fixture(scope="module")
def model():
    return chain.build()


@pytest.fixture(scope="module")
def frf(model):
    """Data of a chain with another stiffness of one part, with a known floor of noise."""
    true = model.scaled({"part2": {"stiffness": 1.2}})
    freq = np.linspace(1.0, 20.0, 40)
    clean = updyn.response(true, freq, ["5:X", "12:X"], ["12:X"])
    rng = np.random.default_rng(1)
    std = FLOOR * np.sqrt(np.mean(np.abs(clean.values) ** 2) / 2.0)
    noise = rng.standard_normal((2, *clean.values.shape)) * std
    values = clean.values + noise[0] + 1j * noise[1]
    return updyn.FRF(freq, values, clean.responses, clean.references, clean.quantity)


@pytest.fixture(scope="module")
def found(model, frf):
    pairs = {
        "part 3": (model, updyn.parameters(model, stiffness="part3", bounds=BOUNDS)),
        "both": (model, updyn.parameters(model, stiffness=["part2", "part3"], bounds=BOUNDS)),
        "part 2": (model, updyn.parameters(model, stiffness="part2", bounds=BOUNDS)),
    }
    return updyn.compare_models(pairs, frf, noise={"floor": FLOOR}, starts=0, bands=5)


def test_simplest_right_model_is_first(found):
    assert [row.name for row in found] == ["part 2", "both", "part 3"]
    assert found.best == "part 2"
    assert found.criterion == "evidence"
    assert found["part 2"].adequate
    assert not found["part 3"].adequate
    assert found["part 2"].residual == pytest.approx(1.0, abs=0.15)
    assert found["part 3"].residual > 2.0
    assert found.is_distinguishable("part 3")
    assert found.probabilities["part 2"] > 0.7
    assert sum(found.probabilities.values()) == pytest.approx(1.0)


def test_evidence_is_the_integral_of_the_density(model, frf, found):
    """By quadrature over the logarithm of the factor, whose prior is flat between the bounds."""
    variance = FLOOR**2 * np.mean(np.abs(frf.values) ** 2)

    def log_density(x):
        H = updyn.response(
            model.scaled({"part2": {"stiffness": float(np.exp(x))}}),
            frf.freq,
            frf.responses,
            frf.references,
        ).values
        return float(np.sum(-np.log(np.pi * variance) - np.abs(frf.values - H) ** 2 / variance))

    result = found["part 2"].result
    best = result.values["part2.stiffness"]
    std = result.std["part2.stiffness"] / best
    x = np.log(best) + std * np.linspace(-6.0, 6.0, 49)
    logs = np.array([log_density(one) for one in x])
    low, high = np.log(BOUNDS["stiffness"])
    integral = np.trapezoid(np.exp(logs - logs.max()), x)
    exact = logs.max() + np.log(integral / (high - low))
    assert found["part 2"].log_evidence == pytest.approx(exact, abs=0.03)


def test_unknown_that_is_not_needed_costs_its_occam_factor(found):
    """ln(W / (sqrt(2 pi) std)) of the further unknown, less the gain of fitting it."""
    both, alone = found["both"].result, found["part 2"].result
    std = both.std["part3.stiffness"] / both.values["part3.stiffness"]
    widening = np.log(
        both.std["part2.stiffness"]
        / both.values["part2.stiffness"]
        / (alone.std["part2.stiffness"] / alone.values["part2.stiffness"])
    )
    correlation = both.covariance[0, 1] / np.sqrt(np.prod(np.diag(both.covariance)))
    occam = np.log(np.log(4.0) / (np.sqrt(2.0 * np.pi) * std)) - widening
    occam -= 0.5 * np.log(1.0 - correlation**2)
    n = 2 * 40 * 2
    gain = 0.5 * n * (found["part 2"].residual ** 2 - found["both"].residual ** 2)
    assert found.log_odds("both") == pytest.approx(gain - occam, abs=0.05)


def test_scores_are_those_of_the_bands(found):
    assert len(found.bands) == 5
    assert found.bands[0][0] == 1.0
    assert found.bands[-1][1] == 20.0
    difference, error = found.score_difference("part 3")
    each = np.subtract(found["part 3"].band_scores, found["part 2"].band_scores)
    assert difference == pytest.approx(each.sum())
    assert error == pytest.approx(np.sqrt(5) * each.std(ddof=1))
    assert difference < 0.0
    assert found.score_difference("part 2") == (0.0, 0.0)


def test_score_of_the_right_model_is_that_of_its_noise(frf, found):
    """The expected log density of a value of noise is -ln(pi V) - 1; unknowns cost little."""
    variance = FLOOR**2 * np.mean(np.abs(frf.values) ** 2)
    expected = -frf.values.size * (np.log(np.pi * variance) + 1.0)
    assert found["part 2"].score == pytest.approx(expected, abs=3.0 * np.sqrt(frf.values.size))


def test_texts_and_records(found, tmp_path):
    text = str(found)
    assert text.startswith("part 2 is first by evidence")
    assert all(name in text for name in ("part 2", "both", "part 3"))
    record = json.loads(json.dumps(plain(found.to_dict())))
    assert record["best"] == "part 2"
    assert [one["name"] for one in record["candidates"]] == ["part 2", "both", "part 3"]
    frame = found.to_pandas()
    assert frame.loc["both", "log_evidence"] == found["both"].log_evidence
    assert frame.loc["part 3", "score_difference"] == found.score_difference("part 3")[0]
    assert "part 3" in found._repr_html_()
    page = write_candidates(found, tmp_path / "compare.html").read_text(encoding="utf-8")
    assert "part 2 is first by evidence" in page
    assert "Bands held out" in page
    with pytest.raises(OptionError, match="did you mean 'both'"):
        found["bothh"]


def test_undetermined_combination_adds_nothing(model, frf):
    """Two halves of one part: their sum alone matters, and the whole part is first."""
    group = model.groups["part2"]
    halves = {name: one for name, one in model.groups.items() if name != "part2"}
    half = updyn.Group(0.5 * group.stiffness, 0.5 * group.mass, group.loss_factor)
    halves |= {"upper": half, "lower": half}
    split = updyn.Model.from_groups(halves, model.dofs)
    pairs = {
        "halves": (split, updyn.parameters(split, stiffness=["upper", "lower"], bounds=BOUNDS)),
        "whole": (model, updyn.parameters(model, stiffness="part2", bounds=BOUNDS)),
    }
    found = updyn.compare_models(pairs, frf, noise={"floor": FLOOR}, starts=0, bands=3)
    assert found.best == "whole"
    assert found["halves"].undetermined == 1
    assert found["whole"].undetermined == 0
    assert abs(found.log_odds("halves")) < 1.0
    assert not found.distinguishable
    assert "not distinguishable from halves" in found.statement
    assert found.score_difference("halves")[0] == pytest.approx(0.0, abs=0.5)


@pytest.mark.parametrize("is_stated", [True, False])
def test_modes_have_the_evidence_of_their_frequencies(model, is_stated):
    """By quadrature over the logarithm of the factor; the noise is stated, or that of the data."""
    true = model.scaled({"part2": {"stiffness": 1.2}})
    share = 2e-3
    frequency = updyn.modes(true, 6).frequency
    frequency = frequency * (1.0 + share * np.random.default_rng(4).standard_normal(6))
    modes = updyn.ModeSet(frequency, std_frequency=None if is_stated else share * frequency)
    names = {"part 3": "part3", "both": ["part2", "part3"], "part 2": "part2"}
    pairs = {
        name: (model, updyn.parameters(model, stiffness=groups, bounds=BOUNDS))
        for name, groups in names.items()
    }
    noise = {"frequency": share} if is_stated else None
    found = updyn.compare_models(pairs, modes, noise=noise, starts=0)
    assert [row.name for row in found] == ["part 2", "both", "part 3"]
    assert found.criterion == "evidence"
    assert found["part 2"].adequate
    assert not found["part 3"].adequate
    assert len(found.bands) == 6
    x = np.linspace(np.log(1.17), np.log(1.23), 61)
    logs = []
    for one in np.exp(x):
        there = updyn.modes(model.scaled({"part2": {"stiffness": one}}), 6).frequency
        squares = np.sum((np.log(there / frequency) / share) ** 2)
        logs.append(-0.5 * squares - 6 * np.log(np.sqrt(2.0 * np.pi) * share))
    width = np.log(4.0)
    exact = max(logs) + np.log(np.trapezoid(np.exp(np.array(logs) - max(logs)), x) / width)
    assert found["part 2"].log_evidence == pytest.approx(exact, abs=0.02)


def test_measured_damping_is_data_of_all_candidates_or_of_none(model):
    measured = updyn.modes(model, 3)
    modes = updyn.ModeSet(measured.frequency, loss_factor=measured.loss_factor)
    pairs = {
        "stiffness": (model, updyn.parameters(model, stiffness="part2")),
        "damping": (model, updyn.parameters(model, stiffness="part2", loss_factor="all")),
    }
    with pytest.raises(DataError, match=r"6 numbers .* 3 of 'stiffness': measured damping"):
        updyn.compare_models(pairs, modes)


def test_fit_that_runs_out_of_steps_goes_on(model, frf, found):
    """Its evidence is that of the minimum."""
    pairs = {
        "part 2": (model, updyn.parameters(model, stiffness="part2", bounds=BOUNDS)),
        "part 3": (model, updyn.parameters(model, stiffness="part3", bounds=BOUNDS)),
    }
    options = {"noise": {"floor": FLOOR}, "starts": 0, "bands": 2}
    early = updyn.compare_models(pairs, frf, **options, max_iterations=2)
    assert early["part 2"].status == "max-iterations"
    assert early["part 2"].log_evidence == pytest.approx(found["part 2"].log_evidence, abs=0.01)


def test_predictive_score_decides_between_wrong_models(model, frf):
    """Neither reproduces the data; by the noise alone the odds would be beyond any doubt."""
    pairs = {
        "part 3": (model, updyn.parameters(model, stiffness="part3")),
        "part 4": (model, updyn.parameters(model, stiffness="part4")),
    }
    found = updyn.compare_models(pairs, frf, noise={"floor": FLOOR}, starts=0, bands=4)
    assert found.criterion == "predictive score"
    assert "overstates the evidence" in found.statement
    assert not any(row.adequate for row in found)


def test_lines_without_a_response_of_a_free_model_are_left_out_of_all(model, frf):
    """The free model has no response at 0 Hz, so that the held one is not fitted there either."""
    K = model.groups["part1"].stiffness.toarray()
    K[0, 0] -= 10e3  # the spring to the ground
    groups = dict(model.groups)
    groups["part1"] = updyn.Group(K, groups["part1"].mass, groups["part1"].loss_factor)
    free = updyn.Model.from_groups(groups, model.dofs)
    freq = np.append(0.0, frf.freq)
    values = np.concatenate([np.full((1, *frf.values.shape[1:]), 1e-3), frf.values])
    data = updyn.FRF(freq, values, frf.responses, frf.references, frf.quantity)
    pairs = {
        "held": (model, updyn.parameters(model, stiffness="part2")),
        "free": (free, updyn.parameters(free, stiffness="part2")),
    }
    with pytest.warns(updyn.UpdynWarning, match="0 Hz"):
        found = updyn.compare_models(pairs, data, noise={"floor": FLOOR}, starts=0, bands=4)
    assert found.best == "held"
    for row in found:
        np.testing.assert_array_equal(row.result.lines, frf.freq)


@pytest.mark.parametrize("lines", ["d-optimal:8", [2.0, 5.0]])
def test_lines_are_chosen_once(model, frf, lines):
    if not isinstance(lines, str):
        lines = frf.freq[[3, 9, 20, 31]]
    pairs = {
        "part 2": (model, updyn.parameters(model, stiffness="part2")),
        "part 3": (model, updyn.parameters(model, stiffness="part3")),
    }
    found = updyn.compare_models(pairs, frf, lines, {"floor": FLOOR}, starts=0)
    first, second = (row.result.lines for row in found)
    np.testing.assert_array_equal(first, second)
    assert len(first) == (8 if isinstance(lines, str) else 4)
    assert len(found.bands) == len(first)  # fewer lines than the default number of bands


def test_wrong_inputs_are_refused(model, frf):
    pair = (model, updyn.parameters(model, stiffness="part2"))
    with pytest.raises(OptionError, match="at least two by name"):
        updyn.compare_models({"one": pair}, frf)
    with pytest.raises(OptionError, match=r"candidate 'b': expected \(model, unknowns\)"):
        updyn.compare_models({"a": pair, "b": model}, frf)
    with pytest.raises(OptionError, match="bands = 1: expected"):
        updyn.compare_models({"a": pair, "b": pair}, frf, bands=1)
    with pytest.raises(OptionError, match="bands = 41: expected at most 40"):
        updyn.compare_models({"a": pair, "b": pair}, frf, bands=41)
    with pytest.raises(DataError, match="one line or mode is too few"):
        updyn.compare_models({"a": pair, "b": pair}, frf, frf.freq[:1])
    other = updyn.Model.from_groups(model.groups, [f"{n}:Y" for n in range(1, 13)])
    with pytest.raises(DofError):
        updyn.compare_models(
            {"a": pair, "b": (other, updyn.parameters(other, stiffness="part1"))}, frf
        )


def test_callback_stops_in_a_fit_and_in_a_band(model, frf):
    pairs = {
        "a": (model, updyn.parameters(model, stiffness="part2")),
        "b": (model, updyn.parameters(model, stiffness="part3")),
    }
    seen = []

    def stop_at(prefix):
        def callback(progress):
            seen.append(progress.stage)
            return progress.stage.startswith(prefix)

        return callback

    options = {"noise": {"floor": FLOOR}, "starts": 0}
    for prefix, name in (("a (1 of 2)", "'a'"), ("bands: b", "'b'")):
        with pytest.raises(StoppedError, match=name):
            updyn.compare_models(pairs, frf, callback=stop_at(prefix), **options)
    assert "bands: a" in seen
