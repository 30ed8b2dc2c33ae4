"""Answers of a fit: where others are looked for, which is taken, and which count as different ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, f

import updyn
from updyn.updating.fit.answer import Answer
from updyn.updating.fit.answers import (
    are_distinct,
    choose_answer,
    distance,
    exchange_groups,
    find_promising_points,
    find_rivals,
    has_noise_residual,
    is_better,
    is_same,
    is_within_uncertainty,
    move_uncertain_unknowns,
    reset_far_unknowns,
)
from updyn.updating.fit.methods.maximum_likelihood import MaximumLikelihood
from updyn.updating.fit.models import Models
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.search import Search
from updyn.updating.fit.settings import ANSWERS
from updyn.updating.problem.local import Local
from updyn.updating.problem.noise import Stated, Variance
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import OutputError, OutputErrorSet

FREQ = np.linspace(1.0, 45.0, 40)


def spring(n: int, i: int, j: int | None, k: float) -> updyn.Group:
    """A spring between two masses, or from one to the ground."""
    K = np.zeros((n, n))
    if j is None:
        K[i, i] = k
    else:
        K[np.ix_([i, j], [i, j])] = [[k, -k], [-k, k]]
    return updyn.Group(K, np.zeros((n, n)), loss_factor=0.02)


def row_of_masses(springs: dict[str, tuple[int, int | None, float]], n: int) -> updyn.Model:
    """Equal masses, and springs by name: between which, and how stiff."""
    groups = {name: spring(n, *about) for name, about in springs.items()}
    groups["masses"] = updyn.Group(np.zeros((n, n)), np.eye(n))
    return updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])


def symmetric_three() -> updyn.Model:
    """Three masses between two walls; nominal stiffness of the outer springs is not the same."""
    return row_of_masses(
        {
            "left": (0, None, 2e4),
            "first": (0, 1, 4e4),
            "second": (1, 2, 4e4),
            "right": (2, None, 5e4),
        },
        3,
    )


def problem_of(model: updyn.Model, frf: updyn.FRF, unknowns: object) -> Problem:
    return Problem.of([FRFPart.build(model, frf, unknowns)])


def answer_at(x: np.ndarray, negative_log_likelihood: float = 0.0, std: object = 0.01) -> Answer:
    """A converged answer whose unknowns have these standard deviations, independent of each other."""
    R = np.diag(1.0 / np.broadcast_to(std, len(x)))
    return Answer(
        np.asarray(x),
        "converged",
        negative_log_likelihood,
        (),
        OutputErrorSet(()),
        Local(0.0, R, R[0] * 0),
    )


def weighted_at(problem: Problem, x: np.ndarray) -> Answer:
    """The same of data with 1 % noise."""
    weight = np.sqrt(2.0) / (0.01 * np.abs(problem.parts[0].frf.values))
    known = (Stated(0.01, 0.0),), OutputErrorSet((OutputError(weight),))
    return replace(answer_at(x), noises=known[0], residual=known[1])


def misfit(problem: Problem):
    """Half the sum of squares against the data, each value with 1 % noise."""
    part = problem.parts[0]

    def cost(x: np.ndarray) -> float:
        e = (part.responses(x) - part.frf.values) / (0.01 * np.abs(part.frf.values))
        return 0.5 * float(np.sum(np.abs(e) ** 2))

    return cost


def test_a_point_within_what_an_answer_allows_is_that_answer():
    answer = answer_at(np.zeros(2), std=[0.01, 0.1])
    assert is_within_uncertainty(np.array([0.02, 0.2]), answer)
    assert not is_within_uncertainty(np.array([0.04, 0.2]), answer)
    assert not is_within_uncertainty(np.zeros(2), replace(answer, local=None))


def test_the_distance_from_an_answer_counts_standard_deviations():
    answer = answer_at(np.array([1.0, 2.0]), std=[0.01, 0.1])
    assert distance(answer, np.array([1.03, 2.4])) == pytest.approx(5.0)
    assert distance(replace(answer, local=None), np.zeros(2)) == np.inf


# -- where to look ------------------------------------------------------------------------------
def test_stiffnesses_are_exchanged_and_not_their_factors():
    """Seen from the middle, 30 and 35 kN/m at the ends are 35 and 30: factors 1.75 and 0.6."""
    start = symmetric_three()
    factors = {"left.stiffness": 1.5, "right.stiffness": 0.7}
    true = start.scaled({"left": {"stiffness": 1.5}, "right": {"stiffness": 0.7}})
    mirrored = start.scaled({"left": {"stiffness": 1.75}, "right": {"stiffness": 0.6}})
    frf = updyn.response(true, FREQ, ["2:X"], ["2:X"])
    seen = updyn.response(mirrored, FREQ, ["2:X"], ["2:X"])
    np.testing.assert_allclose(seen.values, frf.values, rtol=1e-12)
    unknowns = updyn.parameters(start, stiffness=["left", "right"])
    problem = problem_of(start, frf, unknowns)
    x = np.log([factors[name] for name in unknowns.names])
    found = find_promising_points(Models(problem), weighted_at(problem, x), misfit(problem), 100)
    np.testing.assert_allclose(np.exp(found[0]), [1.75, 0.6], rtol=1e-12)


def test_like_groups_change_places_all_at_once_where_the_structure_is_mirrored():
    """Of four springs the outer two are alike and the inner two: the image exchanges both pairs."""
    start = symmetric_three()
    true = start.scaled(
        {
            "left": {"stiffness": 1.5},
            "first": {"stiffness": 0.8},
            "second": {"stiffness": 1.3},
            "right": {"stiffness": 0.7},
        }
    )
    frf = updyn.response(true, FREQ, ["2:X"], ["2:X"])
    unknowns = updyn.parameters(start, stiffness=["left", "first", "second", "right"])
    problem = problem_of(start, frf, unknowns)
    cost = misfit(problem)
    x = np.log([1.5, 0.8, 1.3, 0.7])
    image = np.log([1.75, 1.3, 0.8, 0.6])
    assert cost(image) == pytest.approx(0.0, abs=1e-12)
    best = find_promising_points(Models(problem), weighted_at(problem, x), cost, 100)[0]
    np.testing.assert_allclose(best, image, atol=1e-12)
    for only in ([1.75, 0.8, 1.3, 0.6], [1.5, 1.3, 0.8, 0.7]):  # one pair alone fits badly
        assert cost(np.log(only)) > 1e3


def test_points_that_fit_badly_as_they_stand_are_left_out():
    """From another sensor the exchanged springs are seen."""
    start = symmetric_three()
    true = start.scaled({"left": {"stiffness": 1.5}, "right": {"stiffness": 0.7}})
    frf = updyn.response(true, FREQ, ["1:X"], ["2:X"])
    problem = problem_of(start, frf, updyn.parameters(start, stiffness=["left", "right"]))
    found = find_promising_points(
        Models(problem), weighted_at(problem, np.log([1.5, 0.7])), misfit(problem), 100
    )
    assert not any(np.allclose(np.exp(x), [1.75, 0.6]) for x in found)


def test_exchanged_unknowns_stay_within_their_bounds():
    start = symmetric_three()
    true = start.scaled({"left": {"stiffness": 1.5}, "right": {"stiffness": 0.7}})
    frf = updyn.response(true, FREQ, ["2:X"], ["2:X"])
    unknowns = updyn.parameters(
        start, stiffness=["left", "right"], bounds={"left.stiffness": (0.5, 1.6)}
    )
    problem = problem_of(start, frf, unknowns)
    found = list(exchange_groups(problem, np.log([1.5, 0.7])))
    assert len(found) == 2  # all like groups at once, and two alone
    lower, upper = problem.coordinates.bounds
    assert all(((x >= lower) & (x <= upper)).all() for x in found)


def test_only_unknowns_that_the_data_hardly_hold_are_moved():
    start = symmetric_three()
    frf = updyn.response(start, FREQ, ["2:X"], ["2:X"])
    unknowns = updyn.parameters(start, stiffness=["left", "first", "right"])
    problem = problem_of(start, frf, unknowns)
    x = np.log([1.5, 1.2, 0.7])
    assert list(move_uncertain_unknowns(problem, answer_at(x, std=[0.01, 0.02, 0.03]))) == []
    moved = list(move_uncertain_unknowns(problem, answer_at(x, std=[0.01, 0.1, 0.03])))
    # back to its start, and to either side by eight standard deviations
    np.testing.assert_allclose([at[1] for at in moved], [0.0, x[1] - 0.8, x[1] + 0.8])
    assert all(at[0] == x[0] and at[2] == x[2] for at in moved)


def test_unknowns_are_put_back_the_farthest_first_where_one_is_hardly_held():
    """One, two and four of four, of which one has not moved: one and two."""
    start = symmetric_three()
    frf = updyn.response(start, FREQ, ["2:X"], ["2:X"])
    springs = ["left", "first", "second", "right"]
    problem = problem_of(start, frf, updyn.parameters(start, stiffness=springs))
    x = np.array([0.3, -1.0, 0.0, 0.6])
    assert list(reset_far_unknowns(problem, answer_at(x, std=[0.01, 0.02, 0.04, 0.04]))) == []
    found = list(reset_far_unknowns(problem, answer_at(x, std=[0.01, 0.02, 0.06, 0.04])))
    np.testing.assert_array_equal(found, [[0.3, 0.0, 0.0, 0.6], [0.3, 0.0, 0.0, 0.0]])


# -- which is taken -----------------------------------------------------------------------------
@pytest.fixture
def two_factors() -> Problem:
    """Two factors that start at 1: at the origin of x."""
    start = symmetric_three()
    frf = updyn.response(start, FREQ, ["2:X"], ["2:X"])
    return problem_of(start, frf, updyn.parameters(start, stiffness=["left", "right"]))


def test_the_better_likelihood_is_taken_however_far_it_is(two_factors):
    far, near = (
        answer_at(np.array([2.0, 2.0])),
        answer_at(np.zeros(2), 1.01 * ANSWERS.equal_log_odds),
    )
    assert choose_answer(two_factors, [near, far]) is far


def test_of_answers_that_fit_equally_well_the_one_nearest_to_the_start_is_taken(two_factors):
    far, near = (
        answer_at(np.array([2.0, 2.0])),
        answer_at(np.array([0.1, 0.0]), 0.9 * ANSWERS.equal_log_odds),
    )
    assert choose_answer(two_factors, [far, near]) is far  # 2^2 / 2 twice is 4: less than 4.1
    nearer = answer_at(np.array([0.1, 0.0]), 0.5 * ANSWERS.equal_log_odds)
    assert choose_answer(two_factors, [far, near, nearer]) is nearer


# -- which are others ---------------------------------------------------------------------------
def test_distinct_answers_that_fit_as_well_are_kept():
    chosen = answer_at(np.zeros(2))
    same = answer_at(np.array([0.02, 0.0]))  # two standard deviations away
    image = answer_at(np.array([0.3, -0.3]), 1.0)
    image_again = answer_at(np.array([0.31, -0.3]), 1.5)
    third = answer_at(np.array([-0.3, 0.0]), 0.5)
    worse = answer_at(np.array([0.8, 0.0]), 1.01 * ANSWERS.equal_log_odds)
    found = find_rivals(chosen, [chosen, same, image_again, worse, image, third])
    assert [id(one) for one in found] == [id(third), id(image)]


def test_an_answer_counts_that_contradicts_the_chosen_one_though_it_reaches_it_itself():
    """A gear train: the chosen answer claimed 7 of its standard deviations that the other denied."""
    firm, loose = answer_at(np.zeros(2)), answer_at(np.array([0.07, 0.0]), 1.0, std=[0.05, 0.01])
    assert find_rivals(firm, [loose]) == [loose]
    # Seen from the other, what it claims holds for both.
    loose, firm = (
        replace(loose, negative_log_likelihood=0.0),
        replace(firm, negative_log_likelihood=1.0),
    )
    assert find_rivals(loose, [firm]) == []


def test_answers_that_differ_only_in_what_the_data_leave_open_are_one():
    """The first unknown is not determined: its standard deviation is above 1."""
    chosen, other = (answer_at(np.array([x, 0.0]), std=[30.0, 0.01]) for x in (0.0, 2.0))
    assert find_rivals(chosen, [other]) == []


def test_the_open_directions_of_a_worse_fit_hide_no_better_one():
    """At a fold between two answers the Jacobian is singular, and the misfit far above the noise."""
    fold = answer_at(np.zeros(2), 1.01 * ANSWERS.equal_log_odds, std=[30.0, 0.01])
    answer = answer_at(np.array([0.5, 0.0]))
    near = answer_at(
        np.array([0.5, 0.0]), 0.02 * ANSWERS.equal_log_odds
    )  # fits no better than the fold
    assert is_better(answer, fold)
    assert are_distinct(answer, fold)
    assert are_distinct(fold, answer)
    assert not is_same(answer, fold)
    assert find_rivals(fold, [answer], tolerance=15.0) == [answer]
    assert not is_better(near, fold)
    assert not are_distinct(near, fold)
    assert is_same(near, fold)
    assert find_rivals(fold, [near], tolerance=15.0) == []
    # One that fits better where the worse one ended is the same, more exactly.
    again = answer_at(np.array([0.02, 0.0]))
    assert is_better(again, fold)
    assert not are_distinct(again, fold)
    assert is_same(again, fold)


def test_an_answer_that_ran_out_of_steps_counts_and_one_that_was_stopped_does_not():
    chosen, other = answer_at(np.zeros(2)), answer_at(np.ones(2))
    cut = Answer(other.x, "max-iterations", 0.0, (), OutputErrorSet(()), other.local)
    lost = Answer(other.x, "stopped", np.inf, (), OutputErrorSet(()), other.local)
    blind = Answer(other.x, "converged", 0.0, (), OutputErrorSet(()), None)
    assert find_rivals(chosen, [cut, lost, blind]) == [cut]


# -- whether an answer explains the data --------------------------------------------------------
def looked_at(
    added: np.ndarray,
    relative: float = 0.01,
    freq: np.ndarray = FREQ,
    averages: int | None = None,
) -> bool:
    """Whether the true model explains its FRF with something added, in shares of |H|.

    With averages, its noise is that of the data, estimated from as many.
    """
    start = symmetric_three()
    clean = updyn.response(start, freq, ["1:X", "2:X"], ["2:X"])
    values = clean.values + np.abs(clean.values) * added[:, None, None]
    known = {}
    if averages is not None:
        known = {"variance": (relative * np.abs(clean.values)) ** 2, "averages": averages}
    frf = updyn.FRF(clean.freq, values, clean.responses, clean.references, clean.quantity, **known)
    problem = problem_of(start, frf, updyn.parameters(start, stiffness=["left", "right"]))
    noise = Stated(relative, 0.0) if averages is None else Variance()
    weight = np.sqrt(2.0 / noise.variance(clean.values, frf))
    residual = OutputErrorSet((OutputError(weight),))
    return has_noise_residual(
        problem, Answer(np.zeros(2), "converged", 0.0, (noise,), residual, None)
    )


def white(size: float, lines: int = len(FREQ)) -> np.ndarray:
    """Independent circular noise of a size; its sign alternates, so no correlation is by chance."""
    phase = np.random.default_rng(3).uniform(0.0, 2.0 * np.pi, lines // 2)
    pairs = np.stack([np.exp(1j * phase), -np.exp(1j * phase)], axis=1)
    return size * pairs.ravel()


def test_a_residual_like_noise_is_explained():
    assert looked_at(white(0.01))


def test_a_serially_correlated_residual_is_not():
    assert not looked_at(0.01 * np.exp(2j * np.pi * FREQ / 40.0))


def test_a_residual_above_noise_that_is_known_is_not():
    """160 real values, two unknowns: noise leaves as much once in a thousand times."""
    most = 0.01 * np.sqrt(chi2.isf(1e-3, 158) / 160)
    assert 0.011 < most < 0.012
    assert looked_at(white(0.999 * most))
    assert not looked_at(white(1.001 * most))
    assert not looked_at(white(0.013))


def test_of_more_values_a_smaller_excess_is_more_than_noise():
    """Seen: 1,200 real values with 1.47 times the noise, far from the truth, said to be explained."""
    freq = np.linspace(1.0, 45.0, 300)
    most = 0.01 * np.sqrt(chi2.isf(1e-3, 1198) / 1200)
    assert most < 0.0107
    assert looked_at(white(0.999 * most, 300), freq=freq)
    assert not looked_at(white(1.001 * most, 300), freq=freq)


@pytest.mark.parametrize("averages", [4, 50])
def test_noise_that_was_estimated_from_averages_may_be_off(averages):
    """The ratio of two estimates has the F distribution: more excess is allowed, the fewer they are."""
    most = 0.01 * np.sqrt(f.isf(1e-3, 158, 32 * (averages - 1)) * 158 / 160)
    assert most > 1.005 * 0.01 * np.sqrt(chi2.isf(1e-3, 158) / 160)
    assert looked_at(white(0.999 * most), averages=averages)
    assert not looked_at(white(1.001 * most), averages=averages)


def test_a_better_answer_is_not_agreed_on_before_tries_come_back_to_it(two_factors, monkeypatch):
    """A beam with light boxes: the search agreed on an answer, the first better one looked like
    noise, too, and a third, 55 better in chi-square, was never looked for."""
    x = np.zeros(2)
    first, better, best = (answer_at(x, negative_log_likelihood=u) for u in (200.0, 50.0, 20.0))
    found = [first, better, best, best, best]

    def further(self, models, noises, points, monitor, at, most=None):
        return [found.pop(0)]

    monkeypatch.setattr(Search, "try_nearby", lambda self, *given: x)
    monkeypatch.setattr(MaximumLikelihood, "_fit_promising", further)
    monkeypatch.setattr(
        MaximumLikelihood,
        "_has_noise_residual",
        staticmethod(lambda problem, answer: answer is not first),
    )
    noises, monitor = [Stated(0.01, 0.0)], Monitor(two_factors)
    answers = MaximumLikelihood()._search_nearby(two_factors, noises, monitor, first, True)
    assert best in answers
    assert not found
