"""Thresholds of a fit by maximum likelihood by value: a case just within each, and one beyond."""

from __future__ import annotations

import itertools
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest

from updyn.errors import OptionError
from updyn.updating.fit import answers
from updyn.updating.fit.answer import Answer
from updyn.updating.fit.answers import are_distinct, find_promising_points
from updyn.updating.fit.method import Fit, Starts
from updyn.updating.fit.methods import maximum_likelihood
from updyn.updating.fit.methods.maximum_likelihood import MaximumLikelihood, _evaluate_point
from updyn.updating.fit.search import Search
from updyn.updating.problem.local import Local
from updyn.updating.problem.residuals import OutputErrorSet

NO_MODES = SimpleNamespace(modal=(), parts=("part",))


def make_monitor() -> SimpleNamespace:
    return SimpleNamespace(stopped=False, history=[], stage=lambda *about: nullcontext())


def answer_at(misfit: float, x: float = 0.0, std: float = 1.0) -> Answer:
    """An answer of one unknown, with minus its log-likelihood."""
    local = Local(0.0, np.eye(1) / std, np.zeros(1))
    return Answer(np.array([x]), "converged", misfit, (), OutputErrorSet(()), local)


def fit_with_moves(monkeypatch, moves) -> tuple[str, list]:
    """Return the reason of the end, and the settings of each descent, of a fit that moves so far.

    The standard deviation of the unknown is one.
    """
    settings = []
    moving = iter(moves)

    def descend(problem, residual, x, monitor, used, relax):
        settings.append(used)
        local = Local(0.0, np.eye(1), np.zeros(1))
        return SimpleNamespace(x=x + next(moving), reason="converged", local=local)

    monkeypatch.setattr(maximum_likelihood, "descend", descend)
    monkeypatch.setattr(maximum_likelihood, "_weigh", lambda problem, noises, x: (noises, None))
    monkeypatch.setattr(maximum_likelihood, "_negative_log_likelihood", lambda *about: 0.0)
    answer = MaximumLikelihood()._fit_answer(NO_MODES, (), np.zeros(1), make_monitor())
    return answer.reason, settings


@pytest.mark.parametrize(("move", "reason"), [(0.9, "converged"), (1.1, "unsettled")])
def test_weights_that_move_the_estimate_by_its_std_have_not_settled(monkeypatch, move, reason):
    assert fit_with_moves(monkeypatch, itertools.repeat(move))[0] == reason


@pytest.mark.parametrize(("move", "number"), [(0.009, 3), (0.011, 4)])
def test_weights_have_settled_at_a_hundredth_of_a_std(monkeypatch, move, number):
    _, settings = fit_with_moves(monkeypatch, [5.0, 5.0, move, 0.0])
    assert len(settings) == number
    assert {used.min_decrease for used in settings} == {0.5 * 0.01**2}


@pytest.mark.parametrize(("starts", "reason"), [(2, "converged"), (3, "unsettled")])
def test_three_tries_have_to_agree(monkeypatch, starts, reason):
    fit = Fit(np.zeros(1), "converged", np.eye(1), ())
    for name, value in {
        "_fit_answer": answer_at(0.0),
        "_fit_promising": [],
        "_has_data_fault": False,
        "_search_nearby": [],
        "_find_starting_points": [],
        "_follow_valleys": ([], []),
        "_finish_fit": fit,
        "_has_noise_residual": False,
    }.items():
        monkeypatch.setattr(MaximumLikelihood, name, lambda *about, v=value: v)
    monkeypatch.setattr(maximum_likelihood, "choose_answer", lambda problem, found: found[0])
    found = MaximumLikelihood(starts=starts).fit_best(
        NO_MODES, (), make_monitor(), Starts((np.zeros(1),), False, False, False)
    )
    assert found.reason == reason


def test_the_first_descent_ends_at_a_tenth():
    assert MaximumLikelihood()._further_descent(7).min_decrease == 0.1


@pytest.mark.parametrize(("worse", "tries"), [(0.49, 6), (0.51, 16), (-0.49, 6), (-0.51, 7)])
def test_an_end_returns_to_the_answer_within_half_a_log_odds(monkeypatch, worse, tries):
    """Every end is so much worse, or the first one so much better, to which the others return.

    Of eight starts, sixteen tries without a better answer are enough, or six that return.
    """
    made = []
    monkeypatch.setattr(maximum_likelihood, "thin_problem", lambda problem, noises: problem)
    monkeypatch.setattr(Search, "try_nearby", lambda self, problem, x, number, monitor: x)
    monkeypatch.setattr(
        MaximumLikelihood, "_has_noise_residual", staticmethod(lambda *about: False)
    )
    ends = itertools.chain([worse] if worse < 0 else [], itertools.repeat(max(worse, 0.0)))

    def fit_promising(self, models, noises, points, monitor, best):
        made.append(best)
        first = next(ends)
        return [answer_at(best.negative_log_likelihood + first)]

    monkeypatch.setattr(MaximumLikelihood, "_fit_promising", fit_promising)
    monkeypatch.setattr(maximum_likelihood, "Models", lambda problem: None)
    MaximumLikelihood(starts=8)._search_nearby(
        NO_MODES, (), make_monitor(), answer_at(3.0), agreed=True
    )
    assert len(made) == tries


@pytest.mark.parametrize(("ratio", "number"), [(0.79, 5), (0.81, 1)])
def test_a_point_is_evaluated_again_while_its_misfit_falls(monkeypatch, ratio, number):
    """In at most five more exact models."""
    problems = [SimpleNamespace(number=i) for i in range(6)]
    left = iter(problems[1:])
    latest = [problems[0]]

    def near(x):
        latest[0] = next(left, latest[0])
        return latest[0]

    monkeypatch.setattr(
        maximum_likelihood,
        "_negative_log_likelihood",
        lambda problem, *about: 7.0 + 1000.0 * ratio**problem.number,
    )
    models = SimpleNamespace(
        rough=problems[0],
        is_rough=lambda x: True,
        near=near,
        leads_back=lambda x, at, misfit: False,
    )
    misfit = _evaluate_point(models, np.zeros(1), answer_at(7.0))
    assert misfit == pytest.approx(7.0 + 1000.0 * ratio**number)


def test_modes_alone_are_searched_from_twenty_tries_for_each_start(monkeypatch):
    """Factors within a factor of five, loss factors within 0.3."""
    starts = []

    def descend(models, x, *about):
        starts.append(x)
        return None, x

    monkeypatch.setattr(maximum_likelihood, "_descend_with_weights", descend)
    monkeypatch.setattr(maximum_likelihood, "_weigh", lambda *about: (None, None))
    monkeypatch.setattr(maximum_likelihood, "_negative_log_likelihood", lambda *about: np.inf)
    coordinates = SimpleNamespace(
        start=np.zeros(2),
        bounds=(np.full(2, -9.0), np.full(2, 9.0)),
        parameters=SimpleNamespace(is_damping=np.array([False, True])),
    )
    exact = SimpleNamespace(coordinates=coordinates, n=2, n_numbers=2, system=SimpleNamespace(n=10))
    MaximumLikelihood(starts=4)._search_globally(
        SimpleNamespace(exact=exact), (), make_monitor(), answer_at(0.0), 10
    )
    farthest = np.abs(starts).max(axis=0)
    assert len(starts) == 80
    assert (farthest <= [np.log(5.0), 0.3]).all()
    assert (farthest > [0.95 * np.log(5.0), 0.95 * 0.3]).all()


@pytest.mark.parametrize(("worse", "is_kept"), [(49.0, True), (51.0, False)])
def test_a_point_that_fits_fairly_well_is_promising(monkeypatch, worse, is_kept):
    """Of ten values; of 104, half as many are permitted."""
    point = np.array([1.0])
    monkeypatch.setattr(answers, "exchange_groups", lambda problem, x: [point])
    monkeypatch.setattr(answers, "_move_each_unknown", lambda problem, x: [])
    screen = SimpleNamespace(select_best=lambda tries, number: tries)
    monkeypatch.setattr(answers.Screen, "of", lambda *about: screen)
    for n_numbers, expected in ((10, is_kept), (104, True)):
        models = SimpleNamespace(
            exact=SimpleNamespace(n_numbers=n_numbers), rough=None, only_ranks=False
        )
        found = find_promising_points(models, answer_at(3.0), lambda x: 3.0 + worse, 9)
        assert bool(found) == expected


@pytest.mark.parametrize(("difference", "is_distinct"), [(0.9e-6, False), (1.1e-6, True)])
def test_answers_without_scatter_are_distinct_beyond_rounding(difference, is_distinct):
    a, b = answer_at(0.0, 0.0, 1e-12), answer_at(0.0, difference, 1e-12)
    assert are_distinct(a, b) == is_distinct


def test_ten_thousand_tries_can_be_requested():
    assert MaximumLikelihood(starts=10_000).starts == 10_000
    with pytest.raises(OptionError, match="at most 10,000 tries"):
        MaximumLikelihood(starts=10_001)
