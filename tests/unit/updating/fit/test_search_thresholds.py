"""Thresholds of searches and methods by value: a case just within each, and one just beyond."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from updyn.errors import SolverError
from updyn.updating.fit import search
from updyn.updating.fit.methods import linear, maximum_likelihood
from updyn.updating.fit.methods.least_squares import _note
from updyn.updating.fit.methods.maximum_likelihood import MaximumLikelihood
from updyn.updating.fit.methods.reduced_frf import _describe_error
from updyn.updating.fit.screen import Screen, _Piece
from updyn.updating.fit.search import Search, _select_distinct, _select_few_lines
from updyn.updating.fit.trust_region import Outcome
from updyn.updating.problem.local import Local
from updyn.updating.problem.residuals import LogError


def end_at(x: float, cost: float) -> Outcome:
    """The end of a try; a distance of one is far beyond its basin."""
    return Outcome(np.array([x]), Local(cost, np.eye(1), np.zeros(1)), "converged")


def test_ends_within_half_more_than_the_least_cost_are_fitted():
    found = _select_distinct([end_at(0.0, 1.0), end_at(1.0, 1.49), end_at(2.0, 1.51)])
    assert [float(end.x[0]) for end in found] == [0.0, 1.0]


def test_four_ends_are_fitted():
    assert len(_select_distinct([end_at(float(i), 1.0) for i in range(6)])) == 4


@pytest.mark.parametrize(("number", "is_doubted"), [(2, False), (3, True)])
def test_data_are_doubted_after_three_tries(number, is_doubted):
    acceptance = SimpleNamespace(is_plausible=lambda end: False)
    monitor = SimpleNamespace(has_data_fault=lambda: True)
    ends = [end_at(0.0, 1.0)] * number
    assert Search._has_data_fault(acceptance, monitor, ends) == is_doubted


@pytest.mark.parametrize(
    ("n_lines", "n_unknowns", "expected"),
    [(63, 1, None), (64, 1, 32), (200, 16, 32), (200, 17, 34), (67, 17, None)],
)
def test_a_try_begins_on_few_lines(n_lines, n_unknowns, expected):
    """Of one channel: two numbers a line, and four for each unknown."""
    problem = SimpleNamespace(
        n=n_unknowns,
        parts=[SimpleNamespace(n_values=n_lines, n_lines=n_lines)],
        thin=lambda few: few,
    )
    assert _select_few_lines(problem) == (problem if expected is None else expected)


def screen_of(squares: list[list[float]], limit: float = math.inf) -> Screen:
    """Screen whose pieces have given sums of squares at the points 0, 1, 2, ..."""
    pieces = tuple(SimpleNamespace(squared_error_at=lambda x, s=s: s[int(x[0])]) for s in squares)
    return Screen(pieces, limit)


def test_a_quarter_of_the_points_is_ranked_on_further_lines():
    """The best of all lines is the fifth of sixteen on the first lines; then the fourth is."""
    points = [np.array([float(i)]) for i in range(16)]
    first = [float(i) for i in range(16)]
    for best, expected in ((4, 0.0), (3, 3.0)):
        second = [100.0] * 16
        second[best] = 0.0
        found = screen_of([first, second]).rank(points, [1.0] * 16, 1)
        assert [float(x[0]) for x in found] == [expected]


@pytest.mark.parametrize(
    ("total", "n_values", "least"), [(10.0, 20, 50.0), (10.0, 70, 70.0), (90.0, 70, 90.0)]
)
def test_a_point_is_far_off_beyond_e_times_the_squares(monkeypatch, total, n_values, least):
    piece = SimpleNamespace(H=None, squared_error=lambda H: total)
    monkeypatch.setattr("updyn.updating.fit.screen._split_lines", lambda *about: [piece])
    residual = SimpleNamespace(of=lambda i: SimpleNamespace(weight=np.ones(1)))
    problem = SimpleNamespace(parts=[None], n_values=n_values)
    noises = [SimpleNamespace(heavy_tails=False)]
    assert Screen.of(problem, np.zeros(1), noises, residual).limit == pytest.approx(math.e * least)


@pytest.mark.parametrize(("worse", "is_fitted"), [(14.9, True), (15.1, False)])
def test_a_promising_end_is_fitted(monkeypatch, worse, is_fitted):
    monkeypatch.setattr(
        maximum_likelihood, "_descend_with_weights", lambda models, x, *about: (None, x)
    )
    monkeypatch.setattr(maximum_likelihood, "_weigh", lambda *about: (None, None))
    monkeypatch.setattr(maximum_likelihood, "_negative_log_likelihood", lambda *about: 3.0 + worse)
    monkeypatch.setattr(MaximumLikelihood, "_fit_answer", lambda self, *about: "fitted")
    found = MaximumLikelihood()._fit_promising(
        SimpleNamespace(exact=None, is_known=lambda x, at: False),
        [],
        [np.zeros(1)],
        SimpleNamespace(history=[], stopped=False),
        SimpleNamespace(negative_log_likelihood=3.0),
    )
    assert found == (["fitted"] if is_fitted else [])


def step_to(value: float, condition: float = 10.0) -> np.ndarray:
    """Return x after a step of one loss factor to a value; the columns of R are nearly equal."""
    coordinates = SimpleNamespace(
        parameters=SimpleNamespace(is_factor=np.zeros(1, dtype=bool)), to_x=lambda values: values
    )
    current = Local(1.0, np.array([[1.0, 1.0], [0.0, 2.0 / condition]]), np.zeros(2))
    problem = SimpleNamespace(coordinates=coordinates)
    return linear._apply_step(problem, np.zeros(1), np.array([value]), current, 1)


def test_values_beyond_a_billion_have_diverged():
    assert step_to(0.9e9) == pytest.approx([0.9e9])
    with pytest.raises(SolverError, match="without limit"):
        step_to(1.1e9)


@pytest.mark.parametrize(
    ("condition", "text"), [(0.9e12, "has condition number 9e"), (1.1e12, "is singular")]
)
def test_a_linear_problem_without_exact_digits_is_singular(condition, text):
    with pytest.raises(SolverError, match=text):
        step_to(np.inf, condition)


@pytest.mark.parametrize(("error", "is_correct"), [(0.09, True), (0.11, False)])
def test_reduced_frfs_are_correct_to_ten_percent(error, is_correct):
    text = _describe_error(np.array([1.0, 2.0]), np.array([0.01, error]))
    assert ("only up to" not in text) == is_correct


@pytest.mark.parametrize(("share", "has_note"), [(0.019, False), (0.021, True)])
def test_a_log_error_of_many_loud_values_has_a_note(share, has_note):
    assert bool(_note(LogError(), [0.0, share])) == has_note


def test_pieces_have_squares_of_the_larger_response():
    """Noise grows with the response, so a larger one of the model at a point has less weight."""
    part = SimpleNamespace(frf=SimpleNamespace(values=np.ones((1, 1, 1))))
    piece = _Piece(part, np.ones((1, 1, 1), dtype=complex), np.full((1, 1, 1), 10.0))
    assert piece.squared_error(np.full((1, 1, 1), 2.0 + 0.0j)) == pytest.approx(25.0)


@pytest.mark.parametrize(("halvings", "is_found"), [(20, True), (21, False)])
def test_a_step_is_halved_twenty_times(monkeypatch, halvings, is_found):
    monkeypatch.setattr(linear, "_apply_step", lambda problem, x, moved, *about: moved)
    longest = 1000.0 * 0.5**halvings

    def evaluate(x):
        return Local(0.5 if np.abs(x).max() <= longest else 2.0, np.eye(1), np.zeros(1))

    problem = SimpleNamespace(coordinates=SimpleNamespace(to_x=lambda values: values))
    step = linear.PlainIteration(100, 1e-6, halving=True)
    current = Local(1.0, np.eye(1), np.zeros(1))
    found = step.next_point(problem, evaluate, np.zeros(1), np.full(1, 1000.0), current, 1)
    assert (found is not None) == is_found


def searched(n: int = 2) -> SimpleNamespace:
    """A problem of one factor and loss factors, of 60 lines with one value each."""
    freq = np.arange(60.0)
    frf = SimpleNamespace(freq=freq, select=lambda lines: SimpleNamespace(freq=lines))
    return SimpleNamespace(
        n=n,
        parts=[_Lines(60, 60, frf)],
        with_parts=lambda parts: parts,
        coordinates=SimpleNamespace(
            start=np.full(n, 0.05),
            bounds=(np.full(n, -9.0), np.full(n, 9.0)),
            parameters=SimpleNamespace(is_damping=np.arange(n) > 0),
        ),
    )


@dataclass(frozen=True)
class _Lines:
    n_values: int
    n_lines: int
    frf: SimpleNamespace


@pytest.mark.parametrize(("number", "n_lines"), [(0, 30), (1, 20)])
def test_a_try_near_an_end_has_half_the_lines_or_a_third(number, n_lines):
    (part,) = search._select_some_lines(searched(), number, 0)
    assert len(part.frf.freq) == n_lines


def tries_near(monkeypatch, problem, x: np.ndarray, numbers, **options) -> np.ndarray:
    """Return the points, shape (numbers, n), at which tries near x begin on the usual lines."""
    starts = []
    monkeypatch.setattr(
        Search, "_try_from", lambda self, problem, lines, start, monitor: starts.append(start)
    )
    for number in numbers:
        Search(**options)._try_nearby(problem, problem, x, 2 * number, None)
    return np.array(starts)


def test_tries_near_an_end_begin_at_a_tenth_and_two_tenths(monkeypatch):
    """Factors in turn; loss factors within 0.02. No unknown is far from its start."""
    problem = searched()
    x = problem.coordinates.start
    starts = tries_near(monkeypatch, problem, x, range(200), inflate=False)
    for turn, far in ((0, 0.1), (1, 0.2)):
        moved = np.abs(starts[turn::2] - x).max(axis=0)
        assert (moved <= [far, 0.02]).all()
        assert (moved > [0.95 * far, 0.019]).all()


@pytest.mark.parametrize(("distance", "is_far"), [(0.9, False), (1.1, True)])
def test_every_third_try_resets_an_unknown_that_is_far_from_its_start(
    monkeypatch, distance, is_far
):
    """Farther than 0.1 in the logarithm of a factor, or 0.02 of a loss factor."""
    problem = searched()
    home = problem.coordinates.start

    def with_coordinate(x, i, value):
        return np.where(np.arange(len(x)) == i, value, x)

    problem.coordinates.with_coordinate = with_coordinate
    for i, unit in ((0, 0.1), (1, 0.02)):
        x = home.copy()
        x[i] += distance * unit
        starts = tries_near(monkeypatch, problem, x, range(9), inflate=False)
        is_reset = (starts == home).all(axis=1)
        assert is_reset.tolist() == ([False, False, is_far] * 3)


def test_the_first_tries_have_three_levels_of_loss_factors():
    starts = list(Search(starts=3)._draw_starts(searched()))
    assert [float(x[1]) for x in starts] == [0.3, 0.1, 1.0]
