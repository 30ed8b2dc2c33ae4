"""Exact fits of an element whose start lacks the measured branch at some lines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.candidates.location.exact import ExactProblem
from updyn.candidates.location.locate import begin_search

SPRING, AT = updyn.CubicSpring(-1e4), ["2:X"]
FREQ, SENSORS = np.linspace(1.0, 9.0, 40), ["1:X", "3:X"]
NOISE = {"relative": 0.01, "floor": 0.001}


def chain() -> updyn.Model:
    """Three masses of 1 kg on springs of 1 kN/m, held at one end."""
    K = 1000.0 * np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    groups = {"springs": updyn.Group(K, loss_factor=0.03), "masses": updyn.Group(mass=np.eye(3))}
    return updyn.Model.from_groups(groups, ["1:X", "2:X", "3:X"])


@pytest.fixture(scope="module")
def tests() -> list[updyn.FRF]:
    true = chain().with_elements({"x": (SPRING, AT)})
    return [updyn.response(true, FREQ, SENSORS, ["3:X"], level=F).frf for F in (0.5, 3.0)]


def make_problem(tests: list[updyn.FRF]) -> ExactProblem:
    """The problem of the spring at its place, which starts from the fit to its forces."""
    search = begin_search(chain(), tests, {"p": AT}, {"c": SPRING}, None, NOISE)
    return search.find().best.problem


def start_at(problem: ExactProblem, ratio: float) -> np.ndarray:
    coordinates = problem.likelihood.problem.coordinates
    return coordinates.to_x(np.array([ratio * SPRING.coefficient]))


def test_a_line_far_from_the_data_does_not_hide_the_others(tests):
    """One line is as that of another branch; its weight falls with its residual."""
    values = tests[1].values.copy()
    line = int(np.abs(values[:, 1, 0]).argmax())
    values[line] *= 5.0
    problem = make_problem([tests[0], replace(tests[1], values=values)])
    likelihood = problem.whole.likelihood()
    _, x = problem._fit_most_lines(likelihood, start_at(problem, 1.1))
    found = likelihood.problem.coordinates.to_values(x)[0]
    assert found == pytest.approx(SPRING.coefficient, rel=0.003)


def test_the_measured_branch_is_missing_if_the_spring_is_twice_as_soft(tests):
    problem = make_problem(tests)

    def lacks_branches(ratio: float) -> bool:
        return problem._lacks_branches(problem.whole.likelihood(), start_at(problem, ratio))

    assert not lacks_branches(1.0)
    assert not lacks_branches(1.6)
    assert lacks_branches(2.0)
    assert lacks_branches(3.0)
