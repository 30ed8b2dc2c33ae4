"""History, progress and the wish to stop."""

import numpy as np
import pytest

import updyn
from updyn.updating.fit.monitor import Monitor, Progress, condition
from updyn.updating.fit.trust_region import Outcome, Step, TrustRegion
from updyn.updating.problem.local import Local
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import LogError


@pytest.fixture
def problem(chain12, chain12_frf):
    unknowns = updyn.parameters(chain12, stiffness=["part1"], loss_factor=["part1"])
    return FRFPart.build(chain12, chain12_frf, unknowns)


def test_a_descent_resumes_with_its_radius_where_it_ran_out_of_steps(problem):
    monitor, x = Monitor(Problem.of([problem])), np.array([0.1, 0.02])
    settings = TrustRegion(radius=0.5)
    assert monitor.restore_radius(settings, x) == settings
    local = LogError().local(Problem.of([problem]), x)
    monitor.store_outcome(Outcome(x, local, "max-iterations", 0.03))
    assert monitor.restore_radius(settings, x.copy()).radius == 0.03
    assert monitor.restore_radius(settings, x + 0.1).radius == 0.5
    monitor.store_outcome(Outcome(x, local, "max-iterations", 3.0))
    assert monitor.restore_radius(settings, x).radius == 0.5
    monitor.store_outcome(Outcome(x, local, "converged"))
    assert monitor.restore_radius(settings, x).radius == 0.5


def test_history_keeps_every_step_with_stage_and_values(problem):
    monitor, x = Monitor(Problem.of([problem])), np.array([np.log(1.5), 0.02])
    with monitor.stage("search"):
        assert not monitor.has_begun
        monitor.start(x, LogError().local(Problem.of([problem]), x))
        assert monitor.has_begun
        monitor.step(Step(x + 0.1, None, 0.1, False))
    with monitor.stage("log"):
        assert not monitor.has_begun
        monitor.start(x, LogError().local(Problem.of([problem]), x))
    assert [(h.stage, h.number, h.step, h.accepted) for h in monitor.history] == [
        ("search", 0, 0.0, True), ("search", 1, 0.1, False), ("log", 2, 0.0, True),
    ]  # fmt: skip
    assert monitor.history[0].values == pytest.approx(
        {"part1.stiffness": 1.5, "part1.loss_factor": 0.02}
    )
    assert monitor.history[0].cost == LogError().local(Problem.of([problem]), x).cost
    assert np.isnan(monitor.history[1].cost)
    assert monitor.timing_s.keys() == {"search", "log"}
    assert all(t >= 0 for t in monitor.timing_s.values())


def test_callback_sees_progress_and_stops(problem):
    seen = []

    def callback(progress):
        seen.append(progress)
        return len(seen) == 2

    monitor, x = Monitor(Problem.of([problem]), callback), np.zeros(2)
    step = Step(x, LogError().local(Problem.of([problem]), x), 0.1, True)
    with monitor.stage("log"):
        assert monitor.step(step) is False
        assert monitor.step(step) is True
        assert monitor.step(step) is True  # once stopped, it stays stopped
    assert all(isinstance(p, Progress) for p in seen)
    assert [p.iteration for p in seen] == [0, 1, 2]
    assert [p.lines_done for p in seen] == [60, 60, 60]  # as many as were solved
    assert {(p.stage, p.n_lines) for p in seen} == {("log", 60)}


def test_progress_counts_the_steps_taken(problem):
    """Not those refused, nor the points where fits begin."""
    seen = []
    monitor, x = Monitor(Problem.of([problem]), seen.append), np.zeros(2)
    local = LogError().local(Problem.of([problem]), x)
    with monitor.stage("search"):
        monitor.start(x, local)
        monitor.step(Step(x, local, 0.1, True))
        monitor.step(Step(x, local, 0.1, False))
        monitor.step(Step(x, local, 0.1, True))
    with monitor.stage("log"):
        monitor.start(x, local)
        monitor.step(Step(x, local, 0.1, True))
    assert [p.accepted for p in seen if not np.isnan(p.cost)][-6:] == [0, 1, 1, 2, 2, 3]


def test_stages_nest_and_times_add_up(problem):
    monitor = Monitor(Problem.of([problem]))
    with monitor.stage("a"):
        with monitor.stage("b"):
            pass
        monitor.start(np.zeros(2), Local(1.0, np.eye(2), np.ones(2)))
    first = monitor.timing_s["a"]
    with monitor.stage("a"):
        pass
    assert monitor.history[0].stage == "a"
    assert monitor.timing_s["a"] >= first


def test_condition_is_that_of_unit_columns():
    R = np.array([[1.0, 1e6], [0.0, 1e6]])
    assert condition(R) == pytest.approx(np.linalg.cond(R / [1.0, np.sqrt(2) * 1e6]), rel=1e-12)
    assert condition(np.array([[1.0, 0.0], [0.0, 0.0]])) == np.inf
    assert condition(np.array([[1.0, 2.0]])) == np.inf
    assert condition(np.array([[np.nan, 1.0], [0.0, 1.0]])) == np.inf
