"""Which points may fit as well as an answer, told from few lines: as all lines tell it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.errors import SolverError
from updyn.updating.fit.screen import Screen
from updyn.updating.problem.noise import Robust, Stated
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import OutputError, OutputErrorSet

FREQ = np.linspace(1.0, 40.0, 61)
TRUTH = np.log([1.2, 0.8, 1.1])


def chain() -> updyn.Model:
    groups = {}
    for i, k in enumerate((2e4, 3e4, 4e4)):
        K = np.zeros((3, 3))
        K[i, i] += k
        if i:
            K[i - 1, i - 1] += k
            K[i, i - 1] = K[i - 1, i] = -k
        groups[f"k{i + 1}"] = updyn.Group(K, np.zeros((3, 3)), loss_factor=0.05)
    groups["masses"] = updyn.Group(np.zeros((3, 3)), np.eye(3))
    return updyn.Model.from_groups(groups, ["1:X", "2:X", "3:X"])


@pytest.fixture(scope="module")
def problem() -> Problem:
    start = chain()
    factors = dict(zip(("k1", "k2", "k3"), np.exp(TRUTH), strict=True))
    true = start.scaled({name: {"stiffness": float(k)} for name, k in factors.items()})
    frf = updyn.response(true, FREQ, ["1:X", "3:X"], ["1:X"])
    rng = np.random.default_rng(0)
    noise = 0.02 / np.sqrt(2.0) * (rng.standard_normal((2, *frf.values.shape)))
    noisy = updyn.FRF(
        FREQ, frf.values * (1.0 + noise[0] + 1j * noise[1]), frf.responses, frf.references,
        "receptance",
    )  # fmt: skip
    unknowns = updyn.parameters(start, stiffness=["k1", "k2", "k3"])
    return Problem.of([FRFPart.build(start, noisy, unknowns)])


def screen_of(problem: Problem, noise: object = None) -> Screen:
    part = problem.parts[0]
    noise = noise or Stated(0.02, 0.0)
    weight = np.sqrt(2.0 / noise.variance(part.responses(TRUTH), part.frf))
    return Screen.of(problem, TRUTH, (noise,), OutputErrorSet((OutputError(weight),)))


def left(problem: Problem, x: np.ndarray) -> float:
    """Sum of squares of all lines in variances, the noise that of the larger of both models."""
    part = problem.parts[0]
    H, known = part.responses(x), part.responses(TRUTH)
    spread = 0.02 * np.maximum(np.abs(H), np.abs(known))
    return float(np.sum(np.abs(H - part.frf.values) ** 2 / spread**2))


def test_its_lines_are_all_lines_once_and_each_few_are_spread_over_the_band(problem: Problem):
    screen = screen_of(problem)
    freq = [piece.part.frf.freq for piece in screen.pieces]
    np.testing.assert_array_equal(np.sort(np.concatenate(freq)), FREQ)
    assert [len(f) for f in freq] == [4, 8, 16, 32, 1]
    assert all(np.diff(f).max() <= 2 * (FREQ[-1] - FREQ[0]) / len(f) for f in freq[:-1])


def test_many_lines_make_few_pieces(problem: Problem):
    """Each is twice as long as the one before: a million lines would be eighteen."""
    part = problem.parts[0]
    many = np.linspace(1.0, 40.0, 20_001)
    frf = updyn.response(chain(), many, ["1:X", "3:X"], ["1:X"])
    whole = Problem.of([replace(part, frf=frf)])
    screen = screen_of(whole)
    assert len(screen.pieces) == 13
    assert sum(len(piece.part.frf.freq) for piece in screen.pieces) == len(many)


def test_what_all_pieces_leave_is_what_the_whole_leaves(problem: Problem):
    x = TRUTH + np.array([0.1, -0.05, 0.02])
    assert sum(piece.squared_error_at(x) for piece in screen_of(problem).pieces) == pytest.approx(
        left(problem, x)
    )


def test_no_point_is_left_out_that_all_lines_leave_in(problem: Problem):
    """The sum over all lines is the second opinion."""
    rng = np.random.default_rng(1)
    points = [TRUTH + far * rng.standard_normal(3) for far in np.geomspace(1e-3, 1.0, 40)]
    limit = np.e * max(left(problem, TRUTH), 2 * FREQ.size)
    near = [x for x in points if left(problem, x) <= limit]
    assert 5 < len(near) < 35
    found = screen_of(problem).select_best(points, len(points))
    assert all(any(x is y for y in found) for x in near)
    assert len(found) < len(points)


def test_points_that_are_all_far_off_are_left_out(problem: Problem):
    points = [TRUTH + 0.5, TRUTH - 0.5, TRUTH + np.array([0.5, 0.0, -0.5])]
    assert screen_of(problem).select_best(points, 1) == []


def test_the_nearest_are_found_without_all_lines(problem: Problem):
    rng = np.random.default_rng(2)
    points = [TRUTH + far * rng.standard_normal(3) for far in np.geomspace(0.02, 1.0, 24)]
    points.insert(11, TRUTH + 1e-4)
    found = screen_of(problem).select_best(points, 2)
    assert len(found) == 2
    assert found[0] is points[11]


def test_heavy_tails_keep_all_points(problem: Problem):
    """A few values that are far off say nothing of the rest."""
    points = [TRUTH, TRUTH + 1.0]
    found = screen_of(problem, Robust(Stated(0.02, 0.0))).select_best(points, 1)
    assert len(found) == 2


def test_points_where_the_model_cannot_be_solved_are_left_out(problem: Problem, monkeypatch):
    def fails(part: FRFPart, x: np.ndarray) -> np.ndarray:
        raise SolverError("singular")

    screen = screen_of(problem)
    monkeypatch.setattr(FRFPart, "responses", fails)
    assert screen.select_best([TRUTH, TRUTH + 0.1], 1) == []


def test_points_are_ranked_by_what_they_leave_for_their_distance(problem: Problem):
    """As all lines rank them, those that are far off included; more than so many are not returned."""
    rng = np.random.default_rng(4)
    points = [TRUTH + d for d in rng.normal(scale=0.6, size=(40, 3))]
    points.append(TRUTH + 1e-3)  # the best fit, but so close that it says nothing
    distances = [100.0 * float(np.linalg.norm(x - TRUTH)) for x in points]
    found = screen_of(problem).rank(points, distances, 3)
    shares = [left(problem, x) / far for x, far in zip(points, distances, strict=True)]
    assert len(found) == 3
    best = np.argsort(shares)[:6]
    assert any(found[0] is points[i] for i in best[:2])
    assert all(any(x is points[i] for i in best) for x in found)
    assert screen_of(problem).select_best(points[:-1], 3) == []  # none fits as well
