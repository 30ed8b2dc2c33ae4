"""Each threshold by value: a case just inside and a case just outside."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import updyn
from updyn.remedy import Remedy
from updyn.updating.judge.causes.candidates import has_small_residual
from updyn.updating.judge.causes.channel_factor import Calibration, Delay, LowPass, WrongSign
from updyn.updating.judge.causes.dead_channel import DeadChannel
from updyn.updating.judge.causes.diagnosis import (
    count_search_lines,
    find_obstacle,
    is_far_from_start,
)
from updyn.updating.judge.causes.drive_point import (
    DrivePoint,
    _count_lines,
    _log_likelihood_ratio,
)
from updyn.updating.judge.causes.evidence import Evidence, compute_spread
from updyn.updating.judge.causes.fault import divide_odds
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.judge.causes.frequency_scale import FrequencyScale
from updyn.updating.judge.causes.holding import list_ground_springs
from updyn.updating.judge.causes.loss_over_frequency import LossOverFrequency
from updyn.updating.judge.causes.misfit import (
    WeightedData,
    add_perfect_fit,
    compute_log_misfit,
    count_values,
    remove_weight,
)
from updyn.updating.judge.causes.missing_mode import MissingMode
from updyn.updating.judge.causes.no_support import NoSupport
from updyn.updating.judge.causes.other_test import OtherTest
from updyn.updating.judge.causes.ranking import (
    RankedFault,
    is_as_likely,
    is_in_reach,
    is_worth_reporting,
)
from updyn.updating.judge.causes.reduced import WholeModel, choose_trial_models
from updyn.updating.judge.causes.scale import WrongUnit
from updyn.updating.judge.causes.square import CollocatedFrfs
from updyn.updating.judge.causes.support import Suspension
from updyn.updating.judge.causes.suspects import ScoredFault, select_likeliest
from updyn.updating.judge.causes.swapped import SwappedChannels
from updyn.updating.judge.causes.trial import (
    Trial,
    free_held_quantities,
    limit_correlation,
    raise_loss_factors,
)
from updyn.updating.judge.causes.turned import TurnedSensor
from updyn.updating.problem.noise import Stated
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.problem import FRFPart


def make_part(model, n_lines=20, **unknowns):
    frf = updyn.response(model, np.linspace(0.6, 22.0, n_lines), ["2:X", "7:X"], ["12:X"])
    frf = replace(frf, variance=1e-4 * np.abs(frf.values) ** 2)
    return FRFPart.build(model, frf, updyn.parameters(model, **unknowns))


def make_trial(fault=None, rms=1.0, correlation=0.0, n_values=1000):
    return Trial(fault, np.zeros(1), rms**2, 0.0, correlation, n_values)


def make_ranked(log_odds=10.0, explains=0.5, fault=None, rms=1.0):
    fault = WrongSign(("2:X",)) if fault is None else fault
    return RankedFault(make_trial(fault, rms, 0.05), fault, log_odds, explains, explains)


@pytest.mark.parametrize(
    ("fault", "plausible"),
    [
        (Calibration(("2:X",), 0.0155), True),
        (Calibration(("2:X",), -0.0145), False),
        (Calibration(("2:X",), 3.3), True),
        (Calibration(("2:X",), 3.5), False),
        (FrequencyScale((), 1.1e-3), True),
        (FrequencyScale((), 0.9e-3), False),
        (FrequencyScale((), -0.9), True),
        (FrequencyScale((), 1.1), False),
        (OtherTest(("2:X",), 5.5e-3), True),
        (OtherTest(("2:X",), 4.5e-3), False),
        (OtherTest(("2:X",), 0.29), True),
        (OtherTest(("2:X",), 0.31), False),
        (TurnedSensor(("2:Z",), 3.1), True),
        (TurnedSensor(("2:Z",), 2.9), False),
        (TurnedSensor(("2:Z",), 182.0), True),
        (TurnedSensor(("2:Z",), 184.0), False),
        (LowPass((), 1e-9), True),
        (LowPass((), 0.0), False),
        (NoSupport(("base",), float(np.log(0.29))), True),
        (NoSupport(("base",), float(np.log(0.31))), False),
        (LossOverFrequency(("all.loss_factor",), 1.4), True),
        (LossOverFrequency(("all.loss_factor",), -1.6), False),
        (MissingMode((), 9.0, loss=0.49), True),
        (MissingMode((), 9.0, loss=0.51), False),
        (MissingMode((), 9.0, bandwidth=0.032), True),
        (MissingMode((), 9.0, bandwidth=0.028), False),
        (MissingMode((), 9.0, channel_share=0.62), True),
        (MissingMode((), 9.0, channel_share=0.58), False),
    ],
)
def test_sizes_that_are_plausible(fault, plausible):
    assert fault.is_plausible() is plausible


@pytest.mark.parametrize(
    ("ranked", "reported"),
    [
        (make_ranked(explains=0.11), True),
        (make_ranked(explains=0.09), False),
        (make_ranked(explains=0.05, rms=0.048), True),
        (make_ranked(explains=0.05, rms=0.052), False),
        (make_ranked(explains=0.0236, rms=0.01), True),  # 0.5 * 1000 * explains + ln(1e-3)
        (make_ranked(explains=0.0226, rms=0.01), False),
    ],
)
def test_a_fault_worth_reporting(ranked, reported):
    assert is_worth_reporting(ranked) is reported


def test_faults_that_the_data_do_not_distinguish():
    best = make_ranked(10.0)
    assert [is_as_likely(make_ranked(10.0 - off), best) for off in (2.9, 3.1)] == [True, False]
    assert [is_in_reach(make_ranked(10.0 - off), best) for off in (5.9, 6.1)] == [True, False]


def test_sensors_of_other_tests_that_explain_all_are_as_likely():
    fault = OtherTest(("2:X",), 0.1)
    pairs = [
        (make_ranked(0.0, share, fault), make_ranked(10.0, 1.0, fault)) for share in (0.94, 0.96)
    ]
    assert [is_as_likely(*pair) for pair in pairs] == [False, True]


@pytest.mark.parametrize(
    ("explains", "kind", "value", "grave"),
    [
        (0.51, "sign", 0.0, True),
        (0.49, "sign", 0.0, False),
        (0.9, "calibration", 0.31, True),
        (0.9, "calibration", -0.29, False),
    ],
)
def test_a_cause_that_makes_an_answer_implausible(explains, kind, value, grave):
    found = Finding(kind, ("2:X",), value, 1e3, explains, "", Remedy(""), "")
    assert found.grave is grave


@pytest.mark.parametrize(("share", "overruling"), [(0.94, False), (0.96, True)])
def test_a_cause_that_explains_all_ends_the_search(share, overruling):
    found = Finding("sign", ("2:X",), 0.0, 1e3, 0.9, "", Remedy(""), "", of_misfit=share)
    assert found.overruling is overruling


def test_odds_are_shared_by_ten_places_at_least():
    assert divide_odds(1e-2, 3) == divide_odds(1e-2, 10) == pytest.approx(1e-3)
    assert divide_odds(1e-2, 11) == pytest.approx(1e-2 / 11)


@pytest.mark.parametrize(
    ("rms", "correlation", "small", "noise"),
    [
        (0.049, 0.09, True, True),
        (0.051, 0.09, True, False),
        (0.049, 0.11, True, False),
        (0.099, 0.29, True, False),
        (0.101, 0.29, False, False),
        (0.099, 0.31, False, False),
    ],
)
def test_residuals_that_are_small_or_noise(rms, correlation, small, noise):
    trial = make_trial(rms=rms, correlation=correlation)
    assert (has_small_residual(trial), trial.is_noise) == (small, noise)


def test_the_correlation_that_reduces_the_number_of_values():
    assert [limit_correlation(one) for one in (-0.5, 0.5, 0.99)] == [0.0, 0.5, 0.95]


def test_the_size_of_a_perfect_fit():
    assert add_perfect_fit(0.0) == pytest.approx(1e-6)


def test_values_below_three_deviations_of_the_noise_do_not_count(chain12):
    part = make_part(chain12, stiffness="all")
    frf = replace(part.frf, values=np.ones_like(part.frf.values))
    counts = [
        count_values(replace(frf, variance=np.full(frf.values.shape, (1.0 / stds) ** 2)))
        for stds in (3.1, 2.9)
    ]
    assert counts == [2 * frf.values.size, 0]


def test_the_weight_of_a_value_falls_at_three_percent_of_noise(chain12):
    frf = make_part(chain12, stiffness="all").frf
    noisy = replace(frf, variance=(0.03 * np.abs(frf.values)) ** 2 + 1e-300)
    _, weight = compute_log_misfit(frf.values, noisy)
    assert np.max(weight) == pytest.approx(np.sqrt(0.5), rel=5e-3)


def test_exact_data_have_the_noise_of_sensors(chain12):
    frf = make_part(chain12, stiffness="all").frf
    level = np.sqrt(np.mean(np.abs(frf.values) ** 2))
    data = WeightedData.of(frf, np.zeros(frf.values.shape), 1.0)
    assert data.misfit_scale == pytest.approx(1e5 / level, rel=1e-6)


def test_the_weight_by_likelihood_is_one_for_the_tenth_of_most_exact_values(chain12):
    frf = make_part(chain12, stiffness="all").frf
    share = np.linspace(0.0, 1.0, frf.values.size).reshape(frf.values.shape)
    data = WeightedData.near_response(frf.values, frf, (share * np.abs(frf.values)) ** 2)
    assert data.relative_noise == pytest.approx(0.1)


def test_values_without_weight(chain12):
    frf = make_part(chain12, stiffness="all").frf
    mask = np.array([[True], [False]])
    variance = remove_weight(frf, mask).variance
    assert variance[:, 0] == pytest.approx(1e6 * np.abs(frf.values).max() ** 2)
    assert (variance[:, 1] == frf.variance[:, 1]).all()


@pytest.mark.parametrize(("n_lines", "searched"), [(7, False), (8, True)])
def test_causes_are_searched_on_eight_lines(chain12, n_lines, searched):
    obstacle = find_obstacle(make_part(chain12, n_lines, stiffness="all"), Stated(0.01, 1e-3))
    assert (not obstacle) is searched


def test_the_usual_distance_of_unknowns_from_their_start(chain12):
    part = make_part(chain12, stiffness="all", loss_factor="all")
    spread = compute_spread(part)
    is_factor = part.coordinates.parameters.is_factor
    assert spread == pytest.approx(np.where(is_factor, 0.4, 0.2))
    far = [is_far_from_start(part, part.coordinates.start + n * spread) for n in (1.9, 2.1)]
    assert far == [False, True]


def test_loss_factors_at_the_start_of_a_trial(chain12):
    part = make_part(chain12, loss_factor="all")
    low = np.full(part.n, 1e-3)
    assert raise_loss_factors(part, low) == pytest.approx(np.full(part.n, 0.1))


def test_the_priors_of_held_quantities(chain12):
    damping = {"part1": {"loss_factor": 0.01}, "part2": {"loss_factor": 0.2}}
    model = chain12.with_damping(damping)
    whole, held = free_held_quantities(make_part(model, stiffness=["part3"]))
    priors = {one.name: one.prior_std for one in whole.coordinates.parameters}
    assert len(held) == len(priors) - 1
    assert priors["part1.stiffness"] == priors["part1.mass"] == 0.05
    assert priors["part1.loss_factor"] == pytest.approx(0.05)
    assert priors["part2.loss_factor"] == pytest.approx(0.1)


def test_the_faults_that_are_tried_from_a_point():
    def score(fault):
        return ScoredFault(fault, np.zeros(1), 0.0, 0.0)

    signs = [score(WrongSign((f"{i}:X",))) for i in range(4)]
    others = [
        score(kind((f"{i}:X",), 0.1)) for kind in (Calibration, Delay, LowPass) for i in range(2)
    ]
    chosen = select_likeliest([*signs, *others])
    assert [one.fault.kind for one in chosen[:3]] == ["sign", "sign", "calibration"]
    assert len(chosen) == 6


def test_units_near_a_calibration():
    near = [list(WrongUnit.near((), 1e3 * np.exp(off))) for off in (0.11, 0.13)]
    assert [len(one) for one in near] == [1, 0]


def test_a_factor_between_units_is_named():
    named = [WrongUnit((), 1e3 * (1.0 + off)).statement() for off in (0.9e-6, 1.1e-6)]
    assert ["mm instead of m" in one for one in named] == [True, False]


def test_starting_values(chain12):
    part = make_part(chain12, stiffness="all")
    evidence, highest = Evidence(part, part.coordinates.start), part.frf.freq[-1]
    delays = [one.value * highest for one in Delay.propose_faults(evidence) if not one.channels]
    assert max(delays) == -min(delays) == pytest.approx(2.0)
    passes = [one.value for one in LowPass.propose_faults(evidence) if not one.channels]
    corners = 1.0 / (2.0 * np.pi * np.array(passes) * highest)
    assert corners == pytest.approx([0.25, 0.5, 1.0, 2.0, 4.0])
    shifts = [one.value for one in OtherTest.propose_faults(evidence)]
    assert (min(shifts), max(shifts)) == (-0.07, 0.07)


def test_starting_values_of_a_suspension(chain12):
    labels = list(chain12.dofs)
    spring = updyn.Group(np.zeros((12, 12)), np.eye(12))
    K = np.diff(np.eye(12), axis=0).T @ np.diff(np.eye(12), axis=0) * 1e4
    free = updyn.Model({"bar": replace(spring, stiffness=K)}, labels)
    part = make_part(free, stiffness="all")
    found = [one.value for one in Suspension.propose_faults(Evidence(part, part.coordinates.start))]
    low, high = part.frf.freq[0], part.frf.freq[-1]
    assert found == pytest.approx([0.4 * low, 1.1 * low, 3.0 * low, 0.13 * high, 0.4 * high])


def test_pairs_of_the_first_eighty_sensors():
    labels = [f"{i}:X" for i in range(1, 83)]
    frf = updyn.FRF([1.0, 2.0], np.ones((2, 82, 1)), labels, ["1:X"], "receptance")
    found = SwappedChannels.propose_faults(SimpleNamespace(frf=frf))
    assert len(list(found)) == 80 * 79 // 2


@pytest.mark.parametrize(("n", "whole"), [(100, True), (101, False)])
def test_models_that_are_not_reduced(monkeypatch, n, whole):
    monkeypatch.setattr("updyn.updating.judge.causes.reduced.ReducedModels", lambda part: None)
    part = SimpleNamespace(solver=SimpleNamespace(system=SimpleNamespace(n=n)))
    assert isinstance(choose_trial_models(part), WholeModel) is whole


@pytest.mark.parametrize(("std", "known"), [(0.09, True), (0.11, False)])
def test_a_ground_spring_of_known_stiffness(chain12, std, known):
    labels = list(chain12.dofs)
    base = np.zeros((12, 12))
    base[0, 0] = 1e4
    groups = {**{k: chain12.group(k) for k in chain12.groups}, "base": updyn.Group(base, 0 * base)}
    model = updyn.Model(groups, labels)
    part = make_part(model, stiffness=["base"])
    items = [replace(one, prior_std=std) for one in part.coordinates.parameters]
    held = replace(part.coordinates, parameters=ParameterSet(tuple(items)))
    assert ("base" in list_ground_springs(replace(part, coordinates=held))) is known


def make_square(values, noise, freq=None):
    """Return the FRFs at one drive point, with mobilities and their deviation."""
    freq = np.linspace(1.0, 10.0, len(values)) if freq is None else freq
    index, shape = np.zeros(1, dtype=np.intp), (len(values), 1, 1)
    values = np.reshape(values, shape).astype(complex)
    noise = np.full(shape, noise)
    return CollocatedFrfs(
        ("2:X",), index, index, values, noise, freq, 2j * np.pi * freq, "mobility"
    )


def test_lines_of_a_drive_point_that_count():
    """Of values above five deviations, a real part counts beyond 4 / sqrt(2) and 3 degrees."""
    assert _count_lines(make_square([-5.1, -4.9], 1.0), 0) == (1, 1, 1)
    doubt = 4.0 / np.sqrt(2.0) + 0.05 * 20.0
    values = [-(doubt + 0.01) + 19.6j, -(doubt - 0.2) + 19.6j]
    assert _count_lines(make_square(values, 1.0), 0) == (2, 1, 1)
    flat = [-0.051 + 1j, -0.049 + 1j]
    assert _count_lines(make_square(flat, 1e-9), 0) == (2, 1, 1)


@pytest.mark.parametrize(("share", "positive"), [(0.0195, False), (0.0205, True)])
def test_negative_lines_by_chance(share, positive):
    assert (_log_likelihood_ratio(share) > 0.0) is positive


@pytest.mark.parametrize(("negative", "found"), [(9, False), (11, True)])
def test_a_tenth_of_the_lines_makes_a_drive_point_active(monkeypatch, negative, found):
    values = np.where(np.arange(100) < negative, -1.0, 1j)
    monkeypatch.setattr(CollocatedFrfs, "of", lambda frf: make_square(values, 1e-6))
    monkeypatch.setattr("updyn.updating.judge.causes.drive_point._iter_explanations", list_nothing)
    assert bool(list(DrivePoint.detect_faults(None))) is found


def list_nothing(*_):
    return []


@pytest.mark.parametrize(("level", "expected"), [(0.9e-8, True), (1.1e-8, False)])
def test_a_channel_without_response(level, expected):
    frf = updyn.FRF([1.0, 2.0], np.ones((2, 2, 1)), ["1:X", "2:X"], ["1:X"], "receptance")
    part = SimpleNamespace(
        frf=frf,
        thin=lambda n_lines: part,
        responses=lambda x: np.array([[[1.0], [level]]]),
        coordinates=SimpleNamespace(start=None),
    )
    assert DeadChannel(("2:X",)).is_expected(part) is expected


def test_lines_that_the_repair_of_a_mode_omits(chain12):
    frf = make_part(chain12, 600, stiffness="all").frf
    kept = MissingMode((), 10.0).repair(frf).freq
    omitted = np.setdiff1d(frf.freq, kept)
    assert (omitted.min(), omitted.max()) == pytest.approx((9.5, 10.5), abs=0.04)


@pytest.mark.parametrize(("size", "n_kept"), [(2.9, 1), (3.1, 0)])
def test_lines_at_which_a_mode_dominates(size, n_kept):
    shape = (("1:X", complex(size)), ("force 1:X", 1.0 + 0j))
    mode = MissingMode((), 10.0, loss=1.0, shape=shape)
    term = size / (1.0 + 1j - (5.0 / 10.0) ** 2)
    values = np.array([term * (1.0 + 1.0 / size), 1e9]).reshape(2, 1, 1)
    frf = updyn.FRF([5.0, 100.0], values, ["1:X"], ["1:X"], "receptance")
    assert len(mode.repair(frf).freq) == 1 + n_kept


@pytest.mark.parametrize(("entries", "subtracted"), [(12, True), (13, False)])
def test_a_remedy_with_the_shape_of_a_mode(entries, subtracted):
    shape = tuple((f"{i}:X", 1.0 + 0j) for i in range(entries))
    assert ("subtract it" in MissingMode((), 10.0, shape=shape).remedy.advice) is subtracted


def test_the_table_of_a_varying_loss_factor():
    freq = tuple(np.linspace(1.0, 10.0, 10))
    fault = LossOverFrequency(("all.loss_factor",), 0.5, (), 10.0**0.5, freq)
    (damping,) = tomllib.loads("\n".join(fault.remedy.lines))["damping"]
    lines, factors = damping["loss_table"]
    assert len(lines) == len(factors) == 9
    assert (lines[0], lines[-1]) == (pytest.approx(0.9995), pytest.approx(11.12))
    assert factors[-1] == pytest.approx((11.12 / 10.0**0.5) ** 0.5, rel=5e-4)
    assert max(len(str(one).replace(".", "").lstrip("0")) for one in factors) == 4


@pytest.mark.parametrize(("angle", "same"), [(92.9, True), (93.1, False), (-87.1, True)])
def test_a_turn_by_a_right_angle_is_an_exchange(angle, same):
    assert ("exchanged" in TurnedSensor(("2:Z",), angle).statement()) is same


def test_a_missing_support_is_an_unknown_with_a_wide_prior(chain12):
    part = make_part(chain12, stiffness="all")
    fault = NoSupport(("part1",), -20.0)
    (wide, *_) = fault.correct_part(part, part.coordinates.start).coordinates.parameters
    assert (wide.lower, wide.prior_std) == (1e-4, 5.0)


def test_a_suspension_of_soft_springs(chain12):
    part = make_part(chain12, stiffness="all")
    evidence = Evidence(part, part.coordinates.start)
    omega = 2.0 * np.pi * part.frf.freq[:, None, None]
    K, M = chain12.stiffness.toarray().astype(complex), chain12.mass.toarray()
    for group in chain12.groups.values():
        K += 1j * group.loss_factor * group.stiffness.toarray()
    lifted = K + (2.0 * np.pi * 3.0) ** 2 * (1.0 + 0.05j) * M
    H = [np.linalg.solve(one - omega**2 * M, np.eye(12)[:, 11]) for one in (K, lifted)]
    expected = np.log(H[1] / H[0])[:, [1, 6]]
    found = evidence.log_ratio_on_suspension(3.0)[:, :, 0]
    assert np.exp(found) == pytest.approx(np.exp(expected), rel=1e-9)


def test_a_first_loss_factor_of_a_mode():
    assert MissingMode((), 10.0).loss == 0.01


@pytest.mark.parametrize(
    ("responses", "references", "lines"),
    [(12, 1, 60), (83, 4, 60), (100, 4, 50), (100, 9, 22), (500, 10, 20)],
)
def test_the_search_has_fewer_lines_if_channels_are_many(responses, references, lines):
    labels = [f"{i + 1}:X" for i in range(responses)]
    values = np.ones((80, responses, references), dtype=complex)
    frf = updyn.FRF(np.arange(1.0, 81.0), values, labels, labels[:references], "accelerance")
    assert count_search_lines(frf) == lines
