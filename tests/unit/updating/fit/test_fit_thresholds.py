"""Thresholds of a fit by value: a case just within each, and one just beyond."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from updyn.updating.fit.acceptance import Acceptance
from updyn.updating.fit.answer import Answer
from updyn.updating.fit.answers import (
    has_noise_residual,
    is_within_uncertainty,
    move_uncertain_unknowns,
    restart_uncertain_unknowns,
)
from updyn.updating.fit.null_space import resolve
from updyn.updating.fit.trust_region import Outcome, TrustRegion, _Curvature
from updyn.updating.fit.valley import Valley, find_valleys
from updyn.updating.problem.local import Local
from updyn.updating.problem.residuals import OutputErrorSet


def rotating(correlation: float, rms: float = 0.1, lines: int = 50) -> np.ndarray:
    """A residual, shape (lines, 1, 1), of exactly this serial correlation."""
    angle = np.arccos(correlation)
    return rms * np.exp(1j * angle * np.arange(lines))[:, None, None]


def end_of_cost(cost: float) -> Outcome:
    return Outcome(np.zeros(1), Local(cost, np.eye(1), np.zeros(1)), "converged")


@pytest.fixture
def accepting(monkeypatch):
    """Acceptance of a given residual, where noise alone has the given cost."""

    def make(misfits, expected_cost=1.0, *, noise_known=False):
        monkeypatch.setattr(Acceptance, "_misfits", lambda self, x: [misfits])
        monkeypatch.setattr(Acceptance, "expected_cost", lambda self: expected_cost)
        return Acceptance(None, noise_known)

    return make


@pytest.mark.parametrize(
    ("misfits", "is_noise"),
    [
        (rotating(0.29), True),
        (rotating(0.31), False),
        (rotating(0.0, rms=0.29), True),
        (rotating(0.0, rms=0.31), False),
        (rotating(0.0, lines=8), True),
        (rotating(0.0, lines=7), False),
    ],
)
def test_a_small_uncorrelated_residual_is_noise(accepting, misfits, is_noise):
    assert accepting(misfits).is_noise(np.zeros(1)) == is_noise


@pytest.mark.parametrize(("correlation", "is_plausible"), [(0.09, True), (0.11, False)])
def test_a_plausible_end_has_no_correlation(accepting, correlation, is_plausible):
    assert accepting(rotating(correlation)).is_plausible(end_of_cost(9.0)) == is_plausible


@pytest.mark.parametrize(("cost", "is_plausible"), [(1.49, True), (1.51, False)])
def test_noise_of_known_size_explains_half_more(accepting, cost, is_plausible):
    acceptance = accepting(rotating(0.0), noise_known=True)
    assert acceptance.is_plausible(end_of_cost(cost)) == is_plausible


@pytest.mark.parametrize(("rms", "is_exact"), [(0.9e-7, True), (1.1e-7, False)])
def test_a_residual_of_rounding_is_exact(accepting, rms, is_exact):
    assert accepting(rotating(0.0, rms=rms)).is_exact(end_of_cost(0.0)) == is_exact


@pytest.mark.parametrize(("other", "is_accepted"), [(1.0009, True), (1.0011, False)])
def test_ends_of_nearly_equal_cost_agree(accepting, other, is_accepted):
    ends = [end_of_cost(1.0), end_of_cost(other)]
    assert accepting(rotating(0.0)).is_accepted(ends) == is_accepted


def is_explained(residual: np.ndarray, **noise: object) -> bool:
    """Return whether a residual of unit weight looks like noise."""
    part = SimpleNamespace(responses=lambda x: residual, frf=SimpleNamespace(values=0.0))
    answer = SimpleNamespace(
        x=None,
        residual=SimpleNamespace(of=lambda i: SimpleNamespace(weight=1.0), modal=()),
        noises=[SimpleNamespace(**noise)],
    )
    return has_noise_residual(SimpleNamespace(parts=[part], modal=()), answer)


@pytest.mark.parametrize(
    ("residual", "is_noise"),
    [
        (rotating(0.19), True),
        (rotating(0.21), False),
        (rotating(0.21, lines=7), True),
    ],
)
def test_an_answer_with_a_correlated_residual_is_not_explained(residual, is_noise):
    assert is_explained(residual, size_known=False) == is_noise


@pytest.mark.parametrize(("square", "is_noise"), [(2.98, True), (3.02, False)])
def test_heavy_tails_explain_half_more_than_their_size(square, is_noise):
    residual = rotating(0.0, rms=np.sqrt(square))
    assert is_explained(residual, size_known=True, heavy_tails=True) == is_noise


@pytest.mark.parametrize(
    ("step", "error", "gained_share", "is_used"),
    [
        (0.01, 0.26, 0.01, True),
        (0.01, 0.24, 0.01, False),
        (0.01, 0.26, 0.019, True),
        (0.01, 0.26, 0.021, False),
        (0.049, 0.26, 0.01, True),
        (0.051, 0.26, 0.01, False),
        (0.01, 0.26, 0.9e-12, True),
        (0.01, 0.26, 0.7e-12, False),
    ],
)
def test_the_learnt_curvature_is_used_where_it_predicts_better(step, error, gained_share, is_used):
    """`error` is that of the predicted gain; the learnt curvature predicts it exactly."""
    pull = 1.0
    plain = step * pull - 0.5 * step**2
    gained = (1.0 - error) * plain
    cost = gained / gained_share
    current = Local(cost, np.eye(1), np.array([-pull]))
    reached = Local(cost - gained, np.eye(1), np.array([step - pull]))
    learnt = _Curvature(np.array([[2.0 * error * plain / step**2]]))
    update = learnt.update(np.array([step]), current, reached, accepted=True)
    assert update.is_used == is_used


@pytest.mark.parametrize(
    ("std", "is_undetermined"), [(0.99, False), (1.0 + 0.9e-9, False), (1.0 + 1.1e-9, True)]
)
def test_a_direction_is_undetermined_beyond_a_factor_of_e(std, is_undetermined):
    found = resolve(np.diag([100.0, 1.0 / std]))
    assert found.full_rank
    assert found.involved.tolist() == [False, is_undetermined]


@pytest.mark.parametrize(("difference", "full_rank"), [(1.9e-8, False), (2.1e-8, True)])
def test_nearly_equal_columns_are_dependent(difference, full_rank):
    """The ratio of the singular values is half the difference of the columns."""
    assert resolve(np.array([[1.0, 1.0], [0.0, difference]])).full_rank == full_rank


@pytest.mark.parametrize(("weight", "is_involved"), [(0.9e-3, False), (1.1e-3, True)])
def test_an_unknown_takes_part_in_a_direction_with_a_visible_weight(weight, is_involved):
    """The null space is (1, -1, w) over its length."""
    w = np.sqrt(2.0) * weight
    found = resolve(100.0 * np.array([[1.0, 1.0, 0.0], [w, 0.0, -1.0]]))
    assert found.null_space.shape == (3, 1)
    assert found.involved.tolist() == [True, True, is_involved]


def answer_of(std: list[float]) -> Answer:
    """An answer at zero, with these standard deviations."""
    R = np.diag(1.0 / np.array(std))
    local = Local(0.0, R, np.zeros(len(std)))
    return Answer(np.zeros(len(std)), "converged", 0.0, (), OutputErrorSet(()), local)


def factors(n: int, limit: float = 50.0) -> SimpleNamespace:
    """A problem of `n` factors that start at 0.3, and their bounds in x."""
    bounds = np.full(n, -limit), np.full(n, limit)

    def with_coordinate(x, i, value):
        return np.where(np.arange(n) == i, np.clip(value, -limit, limit), x)

    return SimpleNamespace(
        coordinates=SimpleNamespace(
            start=np.full(n, 0.3),
            bounds=bounds,
            with_coordinate=with_coordinate,
            parameters=SimpleNamespace(is_damping=np.zeros(n, dtype=bool)),
        )
    )


@pytest.mark.parametrize(("distance", "is_within"), [(2.9, True), (3.1, False)])
def test_an_answer_includes_three_standard_deviations(distance, is_within):
    assert is_within_uncertainty(np.array([0.1 * distance]), answer_of([0.1])) == is_within


@pytest.mark.parametrize(("std", "number"), [(0.049, 0), (0.051, 3)])
def test_an_unknown_is_moved_alone_above_five_percent(std, number):
    moved = list(move_uncertain_unknowns(factors(1), answer_of([std])))
    assert len(moved) == number
    if moved:
        assert np.ravel(moved) == pytest.approx([0.3, -8.0 * std, 8.0 * std])


def test_six_unknowns_are_moved():
    assert len(list(move_uncertain_unknowns(factors(8), answer_of([0.1] * 8)))) == 3 * 6


@pytest.mark.parametrize(("std", "number"), [(0.0099, 0), (0.0101, 6)])
def test_unknowns_are_restarted_above_one_percent(std, number):
    points = list(restart_uncertain_unknowns(factors(2), answer_of([std, std]), 0))
    assert len(points) == number


@pytest.mark.parametrize(("std", "number"), [(0.0099, 0), (0.0101, 2)])
def test_valleys_are_followed_above_one_percent(std, number):
    assert len(list(find_valleys(factors(1), answer_of([std])))) == number


def find_end(rise, limit: float = 50.0) -> float | None:
    """Return the distance of the end of a valley in which the misfit rises by rise(distance)."""
    answer = answer_of([1.0])
    valley = Valley(factors(1, limit), answer, 0, 1.0, np.ones(1))

    def refit(x, unknown):
        return Answer(x, "held", rise(float(x[0])), (), OutputErrorSet(()), answer.local)

    end = valley.find_end(refit)
    return None if end is None else float(end.x[0])


@pytest.mark.parametrize(("share", "end"), [(0.24, 4.0), (0.26, None)])
def test_an_open_valley_rises_by_a_quarter_of_the_parabola(share, end):
    """Up to a bound at four standard deviations."""
    assert find_end(lambda distance: share * 0.5 * distance**2, limit=4.0) == end


@pytest.mark.parametrize(("share", "end"), [(0.49, 8.0), (0.51, None)])
def test_a_valley_is_followed_over_a_rise_of_half_the_parabola(share, end):
    """All of the rise is between four and seven standard deviations."""
    assert find_end(lambda d: share * 0.5 * d**2 if 4.5 < d < 7.0 else 0.0) == end


@pytest.mark.parametrize(("limit", "end"), [(2.9, None), (3.1, 3.1)])
def test_a_short_valley_is_no_other_answer(limit, end):
    assert find_end(lambda distance: 0.0, limit=limit) == end


def test_a_valley_is_followed_in_steps_of_two_standard_deviations():
    seen = []

    def rise(distance: float) -> float:
        seen.append(distance)
        return 0.0

    find_end(rise)
    assert seen == [2.0, 4.0, 6.0, 8.0]


@pytest.mark.parametrize(("share", "reason"), [(0.9e-6, "converged"), (1.1e-6, "stalled")])
def test_a_descent_without_a_gain_has_converged_next_to_a_minimum(share, reason):
    """No point has a lower cost; the first step is the last, with a given predicted decrease."""
    pull, tolerance = 0.1, 1e-3
    cost = (tolerance * pull - 0.5 * tolerance**2) / share

    def evaluate(x):
        return Local(cost * (1.0 + np.abs(x).max()), np.eye(1), np.array([pull]))

    far = np.full(1, 9.0)
    outcome = TrustRegion(tolerance=tolerance, radius=tolerance).minimise(
        evaluate, np.zeros(1), -far, far
    )
    assert outcome.reason == reason
