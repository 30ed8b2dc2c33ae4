"""Judgement of the fit of a run: its assessment, noise by sensor, and causes of the residual."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from updyn.errors import SolverError
from updyn.updating.assembly import Assembly
from updyn.updating.fit.checkpoint import Checkpoint
from updyn.updating.fit.method import Fit, Method
from updyn.updating.fit.monitor import JUDGE, Monitor
from updyn.updating.fitted import Fitted
from updyn.updating.judge.assessment import Judgement, judge_fit
from updyn.updating.judge.causes.of_run import Causes, CauseSearch
from updyn.updating.own_noise import SensorNoiseFit
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.session import Stopped

__all__ = ["Judged", "judge_tests"]


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """A fit on the fitted lines with its assessment, and the causes of its residual."""

    problem: Problem
    judgement: Judgement
    causes: Causes

    @property
    def fit(self) -> Fit:
        """The fit."""
        return self.judgement.fit


def judge_tests(
    assembly: Assembly, fitted: Fitted, search: CauseSearch, monitor: Monitor
) -> Judged:
    """Assess a fit, try separate noise for each sensor, and search for causes of the residual."""
    setup, problem = assembly.setup, fitted.problem
    reduced = assembly.reduced
    start_solvers = None if reduced is None else reduced.start_solvers

    def judge(fit: Fit, noises: Sequence[NoiseModel]) -> Judgement:
        return judge_fit(
            problem,
            setup.all_splits,
            fit,
            noises,
            start_solvers,
            is_likelihood=setup.method.is_likelihood,
        )

    with monitor.stage(JUDGE):
        found = judge(_with_cause(setup.method, fitted), setup.noises)
    chosen = [test.noise for test in setup.frf_tests]
    by_sensor = SensorNoiseFit(problem, setup.driver, setup.noises, chosen, monitor, reduced)
    found = by_sensor.continue_fit(found, judge)
    if reduced is not None:
        reduced.release()
    causes = search.search_after_fit(found, monitor) if setup.options.seek_causes else Causes()
    if monitor.stopped:
        found = replace(found, fit=replace(found.fit, reason="stopped"))
    if found.fit.reason == "stopped" and isinstance(assembly.session.cache, Checkpoint):
        assembly.session.cache.keep()
    return Judged(problem, found, causes)


def _with_cause(method: Method, fitted: Fitted) -> Fit:
    """Return a fit with the cause of its failure, as far as the method knows it."""
    fit = fitted.fit
    if fit.reason not in ("failed", "stalled", "unsolvable", "max-iterations"):
        return fit
    try:
        cause = method.describe_obstacle(fitted.problem)
    except (SolverError, Stopped):
        cause = ""
    return replace(fit, cause=cause, remedy=method.failure_remedy)
