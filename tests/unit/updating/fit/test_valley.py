"""Valleys of the misfit: what the curvature at a minimum does not say of how firmly unknowns are held."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.updating.fit.answer import Answer
from updyn.updating.fit.methods.maximum_likelihood import MaximumLikelihood
from updyn.updating.fit.settings import ANSWERS
from updyn.updating.fit.valley import find_valleys, fix_unknown
from updyn.updating.problem.local import Local
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import OutputError, OutputErrorSet

FREQ = np.linspace(2.0, 30.0, 60)


def carried_mass(stiff: float) -> updyn.Model:
    """A mass on a spring, and a tenth of it on a mount that is stiff within the band."""
    ground, mount = np.diag([1e4, 0.0]), stiff * np.array([[1.0, -1.0], [-1.0, 1.0]])
    groups = {
        "ground": updyn.Group(ground, np.diag([1.0, 0.0]), loss_factor=0.05),
        "mount": updyn.Group(mount, np.diag([0.0, 0.1]), loss_factor=0.05),
    }
    return updyn.Model.from_groups(groups, ["1:X", "2:X"])


def measured(floor: float) -> updyn.FRF:
    """What a sensor on the large mass reads: exact values, with the variance of their noise."""
    clean = updyn.response(carried_mass(2e4), FREQ, ["1:X"], ["1:X"])
    level = np.sqrt(np.mean(np.abs(clean.values) ** 2))
    variance = np.full(clean.values.shape, (floor * level) ** 2)
    return updyn.FRF(clean.freq, clean.values, ["1:X"], ["1:X"], "receptance", variance=variance)


def problem_of(frf: updyn.FRF) -> Problem:
    model = carried_mass(2e4)
    return Problem.of([FRFPart.build(model, frf, updyn.parameters(model, stiffness="all"))])


def weighted(frf: updyn.FRF) -> OutputErrorSet:
    assert frf.variance is not None
    return OutputErrorSet((OutputError(np.sqrt(2.0 / frf.variance)),))


def answer_at_truth(problem: Problem, residual: OutputErrorSet) -> Answer:
    local = residual.local(problem, np.zeros(2))
    assert local is not None
    return Answer(np.zeros(2), "converged", 0.0, (), residual, local)


def best_beside(problem: Problem, residual: OutputErrorSet):
    """The ground spring refitted by a fine search in one variable, the mount held: a second method."""
    from scipy.optimize import minimize_scalar

    part = problem.parts[0]

    def refitted(x: np.ndarray, held: int) -> Answer:
        def cost(free: float) -> float:
            at = x.copy()
            at[1 - held] = free
            e = residual.of(0).weight * (part.responses(at) - part.frf.values)
            return 0.5 * float(np.sum(np.abs(e) ** 2))

        found = minimize_scalar(cost, bracket=(x[1 - held] - 0.01, x[1 - held]), tol=1e-10)
        end = x.copy()
        end[1 - held] = found.x
        return Answer(end, "held", float(found.fun), (), residual, None)

    return refitted


def ends(floor: float) -> dict[tuple[str, float], Answer | None]:
    frf = measured(floor)
    problem, residual = problem_of(frf), weighted(frf)
    names = problem.coordinates.parameters.names
    at = answer_at_truth(problem, residual)
    found = find_valleys(problem, at)
    return {(names[v.unknown], v.side): v.find_end(best_beside(problem, residual)) for v in found}


def std_of_mount(floor: float) -> float:
    frf = measured(floor)
    problem = problem_of(frf)
    (first, *_) = find_valleys(problem, answer_at_truth(problem, weighted(frf)))
    assert problem.coordinates.parameters.names[first.unknown] == "mount.stiffness"
    return first.std


def test_a_stiffness_beyond_the_band_is_open_upwards_and_not_downwards():
    """Above its resonance a mount may be as stiff as it will: the misfit rises to that of a rigid one."""
    assert std_of_mount(0.04) == pytest.approx(0.3, abs=0.1)
    found = ends(0.04)
    stiffer, softer = found["mount.stiffness", 1.0], found["mount.stiffness", -1.0]
    assert softer is None
    assert stiffer is not None
    assert stiffer.x[1] > 6.0 * std_of_mount(0.04)
    assert 0.0 < stiffer.negative_log_likelihood <= ANSWERS.equal_log_odds


def test_the_end_of_a_valley_fits_as_a_rigid_mount_does():
    """The rise to a rigid mount is found by a model that has none: one mass on the spring."""
    frf = measured(0.04)
    stiffer = ends(0.04)["mount.stiffness", 1.0]
    assert stiffer is not None
    assert frf.variance is not None
    omega = 2.0 * np.pi * FREQ

    def misfit(log_factor: float) -> float:
        rigid = 1.0 / (1e4 * np.exp(log_factor) * (1 + 0.05j) - 1.1 * omega**2)
        return float(np.sum(np.abs(rigid - frf.values[:, 0, 0]) ** 2 / frf.variance[:, 0, 0]))

    rigid = min(misfit(step) for step in np.linspace(-0.05, 0.05, 2001))
    assert stiffer.negative_log_likelihood == pytest.approx(rigid, rel=0.2)


def test_what_the_data_hold_firmly_is_closed_on_both_sides():
    assert std_of_mount(0.003) == pytest.approx(0.02, abs=0.01)
    assert all(end is None for end in ends(0.003).values())


def test_what_the_data_know_to_less_than_a_hundredth_is_not_followed():
    frf = measured(1e-4)
    problem = problem_of(frf)
    assert not list(find_valleys(problem, answer_at_truth(problem, weighted(frf))))


def test_an_unknown_is_held_where_it_is_and_the_others_are_not():
    problem = fix_unknown(problem_of(measured(0.04)), np.array([0.1, 0.7]), 1)
    for coordinates in (problem.coordinates, problem.parts[0].coordinates):
        lower, upper = coordinates.bounds
        assert lower[1] == upper[1] == 0.7
        assert lower[0] < -1.0 < 1.0 < upper[0]


def test_without_a_local_model_there_is_nothing_to_follow():
    frf = measured(0.04)
    blind = Answer(np.zeros(2), "stopped", 0.0, (), weighted(frf), None)
    assert not list(find_valleys(problem_of(frf), blind))


def test_a_far_end_counts_as_another_answer_of_the_update():
    """Noise and start as in a test: the status says that one of the stiffnesses is open."""
    clean, start = measured(0.06), carried_mass(1.2e4)
    draw = np.random.default_rng(1).standard_normal((2, *clean.values.shape)) / np.sqrt(2.0)
    assert clean.variance is not None
    noisy = clean.values + np.sqrt(clean.variance) * (draw[0] + 1j * draw[1])
    frf = updyn.FRF(clean.freq, noisy, ["1:X"], ["1:X"], "receptance", variance=clean.variance)
    result = updyn.update(start, frf, updyn.parameters(start, stiffness="all"))
    assert result.status == "not-identifiable"
    assert "mount.stiffness" in result.message


def test_local_model_is_of_the_whole_problem():
    """Standard deviations are those of the inverse of the information, both unknowns free."""
    frf = measured(0.04)
    problem, residual = problem_of(frf), weighted(frf)
    local = residual.local(problem, np.zeros(2))
    assert isinstance(local, Local)
    information = local.R.T @ local.R
    (first, *_) = find_valleys(problem, answer_at_truth(problem, residual))
    assert first.std == pytest.approx(
        np.sqrt(np.linalg.solve(information, [0.0, 1.0])[1]), rel=1e-6
    )


def test_an_end_that_a_better_answer_leaves_behind_is_no_rival(monkeypatch):
    """Valleys of the first answer reach a better one, to which its ends are unlikely."""
    behind: list[np.ndarray] = []

    def reached(self, problem, noises, monitor, at, most=None):
        better = replace(
            at, negative_log_likelihood=at.negative_log_likelihood - 10.0 * ANSWERS.equal_log_odds
        )
        end = replace(at, x=at.x + 0.5)
        behind.append(end.x)
        return [end], [better]

    monkeypatch.setattr(MaximumLikelihood, "_follow_valleys", reached)
    start = carried_mass(1.9e4)
    result = updyn.update(start, measured(1e-3), updyn.parameters(start, stiffness="all"))
    assert behind
    assert result.status == "converged"
