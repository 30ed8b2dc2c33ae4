"""Large models are judged in reduced ones about the estimate, and for few evaluations."""

import numpy as np
import pytest

import updyn
from overriding import override
from updyn.updating.judge import advice
from updyn.updating.judge import localise as localise_module
from updyn.updating.judge.identifiability import analyse_identifiability
from updyn.updating.judge.localise import localise_error
from updyn.updating.judge.nearby import ReducedPart
from updyn.updating.judge.settings import EFFORT, SIGNIFICANCE
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import OutputError, OutputErrorSet
from updyn.updating.problem.session import Session

LAYERS, PARTS = 150, 6


@pytest.fixture(scope="module")
def tower():
    """Masses in space on springs of three directions, in six parts: 450 DOFs."""
    n = 3 * LAYERS
    K, M = np.zeros((PARTS, n, n)), np.zeros((PARTS, n, n))
    link = np.array([[4.0, 1.0, 0.0], [1.0, 3.0, 0.5], [0.0, 0.5, 2.0]]) * 1e7
    for i in range(LAYERS):
        part, at = i * PARTS // LAYERS, slice(3 * i, 3 * i + 3)
        K[part, at, at] += link
        M[part, at, at] += np.eye(3)
        if i:
            below = slice(3 * i - 3, 3 * i)
            K[part, below, below] += link
            K[part, at, below] -= link
            K[part, below, at] -= link
    groups = {
        f"part{p + 1}": updyn.Group(K[p], M[p], loss_factor=0.01 + 0.005 * p) for p in range(PARTS)
    }
    return updyn.Model.from_groups(groups, [f"{i + 1}:{d}" for i in range(LAYERS) for d in "XYZ"])


def data_of(true, lines=40):
    at = ["150:X", "150:Y", "100:X", "60:Y", "30:Z"]
    return updyn.response(true, np.linspace(2.0, 30.0, lines), at, at[:2], tier="sparse")


def part_of(model, frf, **unknowns):
    return FRFPart.build(model, frf, updyn.parameters(model, **unknowns), tier="sparse")


def test_the_reduced_model_answers_and_has_the_derivatives_of_the_whole_one(tower):
    frf = data_of(tower)
    part = part_of(tower, frf, stiffness="all", mass="all", loss_factor="all")
    x = part.coordinates.start
    nearby = ReducedPart.of(part, x)
    assert tower.n_dofs > EFFORT.small_model_dofs
    assert nearby.part.solver.system.n < 150
    whole, small = part.block(x, slice(0, 40)), nearby.part.block(x, slice(0, 40))
    assert np.abs(small.H - whole.H).max() < 1e-3 * np.abs(whole.H).max()
    assert np.abs(small.dH - whole.dH).max() < 2e-2 * np.abs(whole.dH).max()


def test_the_reduced_model_holds_where_it_was_extended_to(tower):
    part = part_of(tower, data_of(tower), stiffness="all", mass="all")
    x = part.coordinates.start
    away = x + 0.3 * np.where(np.arange(part.n) % 2 == 0, 1.0, -1.0)
    nearby = ReducedPart.of(part, x)
    H = part.responses(away)
    held = nearby.extend_basis([part.state(x), part.state(away)])
    for at, expected in ((x, part.responses(x)), (away, H)):
        assert np.abs(held.responses(at) - expected).max() < 2e-3 * np.abs(expected).max()


def test_small_and_reduced_models_are_judged_as_they_are(tower, chain12_true):
    at = ["2:X", "5:X"]
    small = updyn.response(chain12_true, np.linspace(2.0, 22.0, 10), at, at)
    own = part_of(chain12_true, small, stiffness="all")
    assert ReducedPart.of(own, own.coordinates.start) is None
    part = part_of(tower, data_of(tower), stiffness="all")
    reduced = ReducedPart.of(part, part.coordinates.start).part
    assert ReducedPart.of(reduced, reduced.coordinates.start) is None


def wrong_mass(tower):
    """The part of a model whose third mass is 2 % too small, and what it leaves."""
    model = tower.scaled({"part3": {"mass": 0.98}})
    part = part_of(model, data_of(tower), stiffness=["part1", "part5"])
    x = part.coordinates.start
    H = part.responses(x)
    weight = np.sqrt(2.0) / (0.01 * np.abs(H))
    whitened = weight * (part.frf.values - H)
    return part, x, OutputErrorSet((OutputError(weight),)), [whitened]


def test_the_wrong_group_of_a_large_model_is_named_at_the_cost_of_few_evaluations(tower):
    part, x, residual, whitened = wrong_mass(tower)
    solved = {}

    class Counting(Session):
        def map(self, function, shared, items, **how):
            label = shared.solver.label
            solved[label] = solved.get(label, 0) + sum(i[-1].stop - i[-1].start for i in items)
            return super().map(function, shared, items, **how)

    problem = Problem.of([part]).with_session(Counting())
    beyond = float(np.sum(np.abs(whitened[0]) ** 2))
    best, *_ = localise_error(problem, x, residual, whitened, beyond)
    assert best.name == "part3.mass"
    assert best.confirmed
    assert best.change == pytest.approx(-np.log(0.98), rel=0.05)
    assert best.explains > 0.95
    assert solved["sparse"] <= 3 * part.n_lines


def test_a_reduced_model_that_is_off_by_what_is_to_be_explained_is_not_used(tower, monkeypatch):
    part, x, residual, whitened = wrong_mass(tower)
    override(monkeypatch, SIGNIFICANCE, negligible_error=0.0)
    problem, nearby = localise_module._replace_by_reduced(Problem.of([part]), x, residual, whitened)
    assert nearby == []
    assert problem.parts[0].solver.tier == "sparse"


@pytest.mark.parametrize("allowed", [1e9, 1e10, 1e12])
def test_short_fits_keep_to_what_they_are_allowed(tower, allowed):
    part = part_of(tower, data_of(tower, 120), stiffness="all", mass="all")
    problem = Problem.of([part])
    number, lines, steps = localise_module._plan_short_fits(problem, allowed, 5)
    work = number * steps * localise_module._evaluation_work(problem.thin(lines or 1))
    assert work <= allowed * 20 / 12
    assert number >= 5 or allowed < 1e12


def test_advice_that_a_reduced_model_finds_is_as_good_as_that_of_the_whole_one(tower, monkeypatch):
    """One line, one sensor, two forces: four numbers for four stiffnesses, two of them open."""
    frf = updyn.response(tower, np.array([6.0]), ["150:X"], ["150:X", "60:Y"], tier="sparse")
    part = part_of(tower, frf, stiffness=["part1", "part3", "part4", "part6"])
    x = part.coordinates.start
    local = OutputError(100.0 / np.abs(frf.values)).local(Problem.of([part]), x)
    analysis = analyse_identifiability(local.R, part.coordinates.parameters.names)
    assert 0 < analysis.null_space.shape[1] <= 2
    name, share = advice._find_best_line(analysis, part, x)
    monkeypatch.setattr(advice.ReducedPart, "of", lambda *given: None)
    whole = advice._find_best_line(analysis, part, x)[1]
    assert 0.5 * whole < share < 1.001 * whole
    assert name.endswith(" Hz")
