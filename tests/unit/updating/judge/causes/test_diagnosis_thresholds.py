"""Thresholds of the steps of the search for causes by value: just inside, and just outside."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from updyn.frf import FRF
from updyn.updating.judge.causes import (
    candidates,
    diagnosis,
    drive_point,
    mains,
    missing_mode,
    ranking,
    reciprocity,
    reduced,
)
from updyn.updating.judge.causes.channel_factor import Calibration, Delay
from updyn.updating.judge.causes.drive_point import DrivePoint
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.missing_mode import MissingMode
from updyn.updating.judge.causes.ranking import RankedFault
from updyn.updating.judge.causes.reduced import ReducedModels
from updyn.updating.judge.causes.settings import CAUSE_SEARCH
from updyn.updating.judge.causes.trial import Trial


def make_trial(rms=1.0, fault=None, quadratic=None):
    return Trial(fault, np.zeros(1), rms**2, 0.0, 0.0, 1000, quadratic=quadratic)


@dataclass
class Model:
    """The part of a test, which is its own model at every point."""

    name: str = "part"
    n: int = 1
    solver: str = "solver"
    coordinates: object = None

    def prepare_part(self, part, points):
        return part


@pytest.mark.parametrize(("share", "number"), [(0.91, 1), (0.89, CAUSE_SEARCH.most_refinements)])
def test_a_fit_is_refined_until_it_gains_less_than_a_tenth(monkeypatch, share, number):
    """From a log misfit of 9 %."""
    ends = []

    def run_trial(current, fault, points):
        ends.append(make_trial(0.09 * np.sqrt(share ** (1 + len(ends)))))
        return ends[-1]

    monkeypatch.setattr(diagnosis, "run_trial", run_trial)
    part = Model()
    diagnosis._refine_fit(part, part, part, make_trial(0.09))
    assert len(ends) == number


@pytest.mark.parametrize(("odds", "better"), [(95.0, False), (105.0, True)])
def test_a_fit_is_better_at_odds_of_a_hundred(monkeypatch, odds, better):
    """Of 1000 values: the logarithm of the odds is 500 times that of the ratio of mean squares."""
    usual = make_trial(0.1)
    other = make_trial(np.sqrt(0.01 * np.exp(-np.log(odds) / 500.0)))
    monkeypatch.setattr(diagnosis, "run_trial", lambda part, fault, points: points[0])
    monkeypatch.setattr(diagnosis, "raise_loss_factors", lambda *about: usual)
    monkeypatch.setattr(diagnosis._SearchedPart, "_complete", lambda self, points: list(points))
    part = Model(coordinates=SimpleNamespace(start=np.zeros(1)))
    searched = diagnosis._SearchedPart(part, part, np.zeros(0), part, None, [])
    assert searched.is_fitted_better([other]) is better
    assert not searched.is_fitted_better([])


@pytest.mark.parametrize(("error", "value"), [(1.19, 0.2), (1.21, 0.1)])
def test_the_size_from_all_lines_is_used_if_its_error_is_similar(monkeypatch, error, value):
    fault = Calibration(("2:X",), 0.1)
    fitted = make_trial(fault=replace(fault, value=0.2))
    part, whole = Model(), Model("whole", coordinates=SimpleNamespace(start=np.zeros(1)))
    monkeypatch.setattr(diagnosis, "run_trial", lambda *about: fitted)
    monkeypatch.setattr(diagnosis, "weight_by_noise", lambda whole, *about: whole)
    monkeypatch.setattr(diagnosis, "_evaluate_corrected", lambda *about: (None, None))
    monkeypatch.setattr(
        diagnosis, "_mean_square_error", lambda one, *about: error if one is whole else 1.0
    )
    noise = SimpleNamespace(refit=lambda *about: None)
    found = RankedFault(make_trial(fault=fault), fault, 9.0, 0.5, 0.5)
    assert diagnosis._fit_size(part, whole, part, found, noise).fault.value == value


def find_causes(monkeypatch, *, remaining=0.1, with_symptom=1.0, above_noise=0.0) -> list:
    """Return the findings of a test with a symptom in its data, which can be left out.

    `remaining` is the mean square misfit after the faults that are found with the symptom, and
    `with_symptom` that of the other values, over that of the faults that are found without it.
    """
    frf, masked = "data", "masked"

    def explain(name, mean_square):
        fit = SimpleNamespace(mean_square=mean_square)
        return SimpleNamespace(
            findings=(name,),
            part=SimpleNamespace(frf=None),
            fit_remaining=lambda frf: fit,
            fit_mean_square=lambda frf: with_symptom,
            mean_square_above_noise=lambda *about: above_noise,
        )

    explanations = iter([explain("with", remaining), explain("without", 1.0)])
    part = SimpleNamespace(frf=frf, name="")
    part.with_data = lambda frf: part
    part.thin = lambda number: part
    for name, value in {
        "with_variance": frf,
        "detect_data_faults": [],
        "drop_expected": [],
        "find_obstacle": None,
        "count_search_lines": 1,
        "free_held_quantities": (part, np.zeros(0)),
        "choose_trial_models": Model(),
        "mask_symptoms": masked,
        "_restrict_weights": None,
        "drop_explained_symptoms": [],
        "_try_other_units": ["unit"],
    }.items():
        monkeypatch.setattr(diagnosis, name, lambda *about, v=value: v)
    monkeypatch.setattr(diagnosis, "_explain_data", lambda *about: next(explanations))
    monkeypatch.setattr(diagnosis.RigidShapes, "of", lambda part: None)
    return diagnosis.find_causes(part, None)


@pytest.mark.parametrize(("mean_square", "found"), [(0.9e-3, "with"), (1.1e-3, "without")])
def test_faults_that_leave_three_percent_explain_a_symptom(monkeypatch, mean_square, found):
    assert find_causes(monkeypatch, remaining=mean_square, with_symptom=9.0) == [found]


@pytest.mark.parametrize(("ratio", "found"), [(1.49, "with"), (1.51, "without")])
def test_a_symptom_is_separate_if_the_other_values_fit_better_without(monkeypatch, ratio, found):
    assert find_causes(monkeypatch, with_symptom=ratio) == [found]


@pytest.mark.parametrize(("rms", "found"), [(0.49, "with"), (0.51, "unit")])
def test_no_fault_is_reported_of_a_model_with_little_in_common(monkeypatch, rms, found):
    assert find_causes(monkeypatch, above_noise=rms**2) == [found]


@pytest.mark.parametrize(("share", "explains_all"), [(0.009, True), (0.011, False)])
def test_a_fault_of_all_data_explains_all_but_a_hundredth(share, explains_all):
    end = make_trial(np.sqrt(share), SimpleNamespace(affects_all_data=True))
    assert candidates._explains_all(end, make_trial()) == explains_all


def score(monkeypatch, gains) -> None:
    """Let faults have these gains to first order; the key of each is its number."""
    scored = [
        SimpleNamespace(gain=gain, fault=SimpleNamespace(key=i), x=None)
        for i, gain in enumerate(gains)
    ]
    monkeypatch.setattr(candidates, "score_faults", lambda *about, **options: scored)
    monkeypatch.setattr(candidates, "select_likeliest", lambda found: found)
    monkeypatch.setattr(candidates, "_drop_covered", lambda found, stated: found)


def test_a_fault_is_fitted_from_odds_of_minus_five(monkeypatch):
    score(monkeypatch, [-4.9, -5.1])
    found = candidates._select_by_gain(None, make_trial(), ())
    assert [fault.key for fault, _ in found] == [0]


def test_faults_within_fifty_of_one_that_explains_all_are_tried(monkeypatch):
    score(monkeypatch, [100.0, 51.0, 49.0])
    found = candidates._list_rivals(None, make_trial(fault=SimpleNamespace(key=0)), [])
    assert [fault.key for fault, _ in found] == [1]


@pytest.mark.parametrize(("reduction", "share"), [(0.29, 0.1), (0.31, 0.31)])
def test_a_fault_explains_the_distance_of_held_quantities(reduction, share):
    without = SimpleNamespace(squared_distance=0.0, squared_distance_held=1e6, n_held=1, x=[0.0])
    trial = SimpleNamespace(fault=None, squared_distance_held=1e6 * (1.0 - reduction))
    assert ranking._compute_share(trial, without, 0.1) == pytest.approx(share)


def test_the_second_order_is_trusted_down_to_half_of_the_misfit():
    trusted = []

    class Quadratic:
        def find_best_share(self, count, least, limit):
            trusted.append(limit)
            return 0.5, SimpleNamespace(log_evidence=0.0, mean_square=1.0)

        def evaluate_share(self, share, count, least, limit):
            return self.find_best_share(count, least, limit)[1]

    a, b = (make_trial(rms, quadratic=Quadratic()) for rms in (2.0, 3.0))
    a.compare(b)
    assert trusted == [2.0, 4.5, 4.5]


def test_a_line_at_0_hz_is_a_thousandth_of_the_lowest_other_line():
    """Derivatives have a relative step of 1e-5."""
    seen = []

    def responses(frf):
        seen.append(frf.freq[0])
        return np.ones(frf.values.shape, dtype=complex)

    frf = FRF(np.array([0.0, 0.5, 4.0]), np.ones((3, 1, 1)), ["1:X"], ["1:X"], "mobility")
    part = SimpleNamespace(
        with_data=lambda frf: SimpleNamespace(responses=lambda x: responses(frf))
    )
    Evidence.slope_by_frequency.func(SimpleNamespace(frf=frf, part=part, x=None))
    assert seen == pytest.approx([5e-4 * (1.0 - 1e-5), 5e-4 * (1.0 + 1e-5)], rel=1e-9)


@pytest.mark.parametrize(("distance", "is_certified"), [(0.049, True), (0.051, False)])
def test_a_certificate_is_valid_within_five_percent(monkeypatch, distance, is_certified):
    enriched = []
    monkeypatch.setattr(ReducedModels, "_enrich", lambda self, x: enriched.append(x))
    models = ReducedModels.__new__(ReducedModels)
    models._certified, models._error, models._solver = [np.zeros(1)], np.zeros(1), None
    part = SimpleNamespace(frf=FRF(np.ones(1), np.ones((1, 1, 1)), ["1:X"], ["1:X"], "mobility"))
    monkeypatch.setattr(reduced, "replace", lambda part, **changes: part)
    part.with_solver = lambda solver: part
    models.prepare_part(part, [np.full(1, distance)])
    assert bool(enriched) != is_certified


def test_the_error_at_points_of_decisions_is_a_thousandth(monkeypatch):
    class Made(Exception):  # noqa: N818
        pass

    def make(*about):
        raise Made(*about)

    monkeypatch.setattr(reduced, "Reduction", make)
    monkeypatch.setattr(reduced, "list_all_places", lambda part: [])
    system = SimpleNamespace(system=None, backend=None)
    part = SimpleNamespace(
        frf=SimpleNamespace(freq=np.ones(2)),
        solver=system,
        receptance_dofs=(None, None),
        session=SimpleNamespace(check=None),
    )
    with pytest.raises(Made) as made:
        ReducedModels(part)
    assert 1e-3 in made.value.args


@pytest.mark.parametrize(
    ("others", "height", "is_peak"),
    [(1.0, 2.9, False), (1.0, 3.1, True), (1e-3, 0.09, False), (1e-3, 0.11, True)],
)
def test_a_mode_may_be_missing_at_a_peak_of_three_times_the_misfit_and_a_tenth(
    monkeypatch, others, height, is_peak
):
    misfit = np.full((40, 1, 1), others)
    misfit[20] = height
    monkeypatch.setattr(missing_mode, "compute_log_misfit", lambda *about: (misfit, None))
    monkeypatch.setattr(MissingMode, "adapt_to", lambda self, evidence: self)
    evidence = SimpleNamespace(
        frf=SimpleNamespace(freq=np.arange(40.0)), model_response=lambda frf: None
    )
    assert bool(list(MissingMode.propose_faults(evidence))) == is_peak


@pytest.mark.parametrize(
    ("freq", "number"), [(np.arange(0.3, 200.0), 30), (np.arange(3.0, 200.0, 10.0), 9)]
)
def test_a_mode_is_fitted_to_the_lines_within_fifteen_percent(freq, number):
    """At least to nine."""
    ones = np.ones((len(freq), 1, 1))
    frf = FRF(freq, ones, ["1:X"], ["1:X"], "receptance", variance=ones)
    evidence = SimpleNamespace(frf=frf, model_response=lambda frf: frf.values)
    assert len(missing_mode._LocalResidual.near(evidence, 100.0).freq) == number


def test_the_least_loss_factor_is_that_of_metal(monkeypatch):
    """The error decreases with the loss factor."""
    local = SimpleNamespace(
        freq=np.arange(20.0), squared_error=lambda mode: mode.loss, channel_share=lambda mode: 1.0
    )
    monkeypatch.setattr(missing_mode._LocalResidual, "near", lambda *about: local)
    assert MissingMode((), 9.0, loss=2e-4).adapt_to(None).loss == 1e-4


def test_sixty_lines_of_a_drive_point_are_independent(monkeypatch):
    square = SimpleNamespace(labels=["1:X"])
    monkeypatch.setattr(drive_point.CollocatedFrfs, "of", lambda frf: square)
    monkeypatch.setattr(drive_point, "_count_lines", lambda square, i: (100, 100, 50))
    monkeypatch.setattr(drive_point, "_iter_explanations", lambda frf, channels: ())
    (found,) = DrivePoint.detect_faults(None)
    expected = 60.0 * drive_point._log_likelihood_ratio(0.5) + np.log(DrivePoint.odds)
    assert found.log_odds == pytest.approx(expected)


def test_delays_of_drive_points_are_up_to_a_period(monkeypatch):
    tried = []

    def is_passive(fault, frf, channels):
        if isinstance(fault, Delay):
            tried.append(fault.value * frf.freq[-1])
        return False

    monkeypatch.setattr(drive_point, "_is_passive", is_passive)
    monkeypatch.setattr(drive_point, "_iter_other_force_places", lambda *about: ())
    frf = SimpleNamespace(freq=np.array([10.0, 80.0]), quantity="mobility")
    assert list(drive_point._iter_explanations(frf, ["1:X"])) == []
    assert tried[:2] == pytest.approx([0.02, -0.02])
    assert tried[-2:] == pytest.approx([1.0, -1.0])


def test_sound_reciprocal_frfs_differ_by_seven_percent(monkeypatch):
    """The log odds of a difference of ten times as much, without noise."""
    difference = SimpleNamespace(
        freq=np.arange(20.0), size=0.7, noise=np.zeros(20), explain=lambda: ""
    )
    monkeypatch.setattr(reciprocity._Difference, "of", lambda *about: difference)
    square = SimpleNamespace(labels=["1:X", "2:X"], iter_pairs=lambda: iter([(0, 1)]))
    monkeypatch.setattr(reciprocity.CollocatedFrfs, "of", lambda frf: square)
    (found,) = reciprocity.Reciprocity.detect_faults(None)
    expected = 99.0 - np.log(100.0) + np.log(reciprocity.Reciprocity.odds)
    assert found.log_odds == pytest.approx(expected)


@pytest.mark.parametrize(("remaining", "is_explained"), [(0.29, True), (0.31, False)])
def test_a_difference_is_explained_if_less_than_a_third_remains(remaining, is_explained):
    difference = SimpleNamespace(
        log_ratio=np.zeros(3, dtype=complex),
        freq=np.arange(3.0),
        size=1.0,
        estimate_delay=lambda: 0.0,
        divide_by=lambda factor: SimpleNamespace(size=remaining),
    )
    text = reciprocity._Difference.explain(difference)
    assert text.startswith("; the sign explains it" if is_explained else "; neither sign")


@pytest.mark.parametrize(("spacing", "is_tested"), [(4.9, True), (5.1, False)])
def test_hum_is_found_on_lines_closer_than_a_tenth_of_its_frequency(
    monkeypatch, spacing, is_tested
):
    tested = []

    def detect(frf, frequency, is_multiple):
        tested.append(frequency)
        return []

    monkeypatch.setattr(mains.MainsHum, "_detect_at", detect)
    freq = 50.0 + spacing * np.arange(-9.0, 40.0)
    assert list(mains.MainsHum.detect_faults(SimpleNamespace(freq=freq))) == []
    assert (50.0 in tested) is is_tested


@pytest.mark.parametrize(("distance", "is_found"), [(0.39, True), (0.41, False)])
def test_hum_affects_lines_within_two_fifths_of_the_spacing(monkeypatch, distance, is_found):
    freq = 50.0 + np.arange(-20.0, 20.0) + distance
    at = freq == freq[20]
    neighbours = SimpleNamespace(
        deviation_ratio=np.where(at, 1e3, 0.0)[:, None],
        pole_ratio=np.zeros((40, 1)),
        bandwidth=np.zeros(40),
    )
    monkeypatch.setattr(mains._Neighbours, "of", lambda *about: neighbours)
    found = list(mains.MainsHum._detect_at(SimpleNamespace(freq=freq), 50.0, at))
    assert bool(found) == is_found
