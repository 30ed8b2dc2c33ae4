"""How often a basin is found until it is believed, and what may be the answer."""

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.updating.fit.acceptance import Acceptance
from updyn.updating.fit.search import thin_problem
from updyn.updating.fit.trust_region import Outcome
from updyn.updating.problem.noise import Stated
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import make_log_error


@pytest.fixture
def searched(chain12, add_noise):
    """A problem that is its own answer: data of its start with 5 % noise, which is stated as 1 %."""
    clean = updyn.response(chain12, np.linspace(0.6, 20.0, 200), ["3:X", "12:X"], ["12:X"])
    data = add_noise(clean, np.random.default_rng(0), 0.05, 0.0)
    unknowns = updyn.parameters(chain12, stiffness="all")
    return lambda stated: thin_problem(
        Problem.of([FRFPart.build(chain12, data, unknowns)]), [Stated(stated, 0.0)]
    )


def end_at(problem, x):
    local = make_log_error(problem).local(problem, x)
    return Outcome(x, local, "converged")


def test_an_end_that_noise_explains_is_believed_when_found_twice(searched):
    rough = searched(0.05)
    acceptance, end = Acceptance(rough, noise_known=True), end_at(rough, rough.coordinates.start)
    assert end.local.cost == pytest.approx(acceptance.expected_cost(), rel=0.1)
    assert acceptance.is_plausible(end)
    assert [acceptance.is_accepted([end] * n) for n in (0, 1, 2)] == [False, False, True]


def test_where_the_noise_is_known_more_misfit_is_believed_when_found_six_times(searched):
    """25 times the misfit that the stated noise explains, not serially correlated all the same."""
    rough = searched(0.01)
    end = end_at(rough, rough.coordinates.start)
    known, not_known = Acceptance(rough, noise_known=True), Acceptance(rough)
    assert end.local.cost == pytest.approx(25.0 * known.expected_cost(), rel=0.1)
    assert not known.is_plausible(end)
    assert not_known.is_plausible(end)
    assert [known.is_accepted([end] * n) for n in (2, 3, 5, 6)] == [False, False, False, True]
    assert not_known.is_accepted([end] * 2)


def test_away_from_the_answer_the_misfit_is_correlated_and_takes_more(searched):
    rough = searched(0.05)
    acceptance = Acceptance(rough)
    near, far = (end_at(rough, rough.coordinates.start + by) for by in (0.02, 1.0))
    assert not acceptance.is_noise(near.x)
    assert [acceptance.is_accepted([near] * n) for n in (2, 3)] == [False, True]
    assert [acceptance.is_accepted([far] * n) for n in (3, 5, 6)] == [False, False, True]


def test_exact_data_are_believed_at_once(chain12):
    clean = updyn.response(chain12, np.linspace(0.6, 20.0, 50), ["3:X"], ["12:X"])
    unknowns = updyn.parameters(chain12, stiffness="all")
    rough = thin_problem(Problem.of([FRFPart.build(chain12, clean, unknowns)]), [Stated(0.01, 0.0)])
    end = end_at(rough, rough.coordinates.start)
    other = replace(end, x=end.x + 1.0, local=end_at(rough, end.x + 1.0).local)
    assert Acceptance(rough).is_accepted([other, end])


def test_only_the_ends_of_the_best_basin_count(searched):
    rough = searched(0.05)
    best, other = (end_at(rough, rough.coordinates.start + by) for by in (0.0, 0.1))
    assert not Acceptance(rough).is_accepted([other, other, other, other, other, other, best])


def test_an_answer_leaves_noise_no_larger_than_what_is_known_of_it(searched):
    rough = searched(0.01)
    known, not_known = Acceptance(rough, noise_known=True), Acceptance(rough)
    x = rough.coordinates.start
    noise = known.expected_cost()
    assert not_known.is_answer(x, 25.0 * noise)
    assert known.is_answer(x, 1.2 * noise)
    assert not known.is_answer(x, 25.0 * noise)
    assert not known.is_answer(x + 0.02, 1.2 * noise)  # serially correlated
