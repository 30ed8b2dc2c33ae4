"""Monitoring of a fit: history of steps, progress callback, and conditions that end it early."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np

from updyn.arrays import RealArray
from updyn.progress import asks_to_stop
from updyn.updating.fit.trust_region import Outcome, Step, TrustRegion
from updyn.updating.problem.local import Local
from updyn.updating.problem.problem import Problem

__all__ = [
    "CAUSES",
    "FAULTS",
    "JUDGE",
    "Iteration",
    "Monitor",
    "Progress",
    "condition",
    "count_iterations",
]

#: Stages of any method: faults of the data that a fit from the start shows, and after the fit
#: identifiability and causes of the residual.
FAULTS, JUDGE, CAUSES = "faults of the data", "judge", "causes"


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress passed to a callback after every step, and within a step between blocks of lines.

    Attributes
    ----------
    stage : str
        Part of the method.
    iteration : int
        Number of the latest step, counted from 0 through all stages.
    cost : float
        Half the sum of squared weighted residuals after that step; nan before the first.
    lines_done, n_lines : int
        Number of lines solved so far in the whole run, and that of a step.
    accepted : int
        Number of accepted steps so far, as counted by `UpdateResult.iterations`.
    values : mapping of str to float
        The unknowns after that step; empty before the first.
    """

    stage: str
    iteration: int
    cost: float
    lines_done: int
    n_lines: int
    accepted: int = 0
    values: Mapping[str, float] = field(default_factory=dict)


@dataclass(slots=True)
class Monitor:
    """Collects history and durations; the only mutable object of a fit.

    `callback` is called with a `Progress`; a return value of True stops the fit.
    `detect_data_fault` examines the data and returns whether a fault makes a search pointless.
    `timing_s` has the duration of each stage in seconds.
    """

    problem: Problem
    callback: Callable[[Progress], bool | None] | None = None
    detect_data_fault: Callable[[Monitor], bool] | None = None
    history: list[Iteration] = field(default_factory=list, init=False)
    timing_s: dict[str, float] = field(default_factory=dict, init=False)
    _stage: str = field(default="", init=False)
    _n_lines: int = field(default=0, init=False)
    _accepted: int = field(default=0, init=False)
    _data_fault: bool | None = field(default=None, init=False)
    _latest: Outcome | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        if self.callback is not None:
            self.problem.session.wants_stop = self._report_progress

    @property
    def stopped(self) -> bool:
        """Whether the callback has requested a stop."""
        return self.problem.session.stopped

    def has_data_fault(self) -> bool:
        """Return whether a fault of the data, examined once, makes a search pointless."""
        if self._data_fault is None:
            self._data_fault = self.detect_data_fault is not None and self.detect_data_fault(self)
        return self._data_fault

    def store_outcome(self, outcome: Outcome) -> None:
        """Store the outcome of the latest descent."""
        self._latest = outcome

    def restore_radius(self, settings: TrustRegion, x: RealArray) -> TrustRegion:
        """Return settings with the radius of the latest descent if it ran out of steps at x."""
        latest = self._latest
        if latest is None or not np.array_equal(latest.x, x):
            return settings
        return replace(settings, radius=min(settings.radius, latest.radius))

    @contextmanager
    def stage(self, name: str, problem: Problem | None = None) -> Iterator[None]:
        """Assign the steps made inside (on `problem`, or the whole one) to a stage; time them."""
        before, start = (self._stage, self._n_lines), time.perf_counter()
        self._stage, self._n_lines = name, (problem or self.problem).n_lines
        try:
            yield
        finally:
            self.timing_s[name] = self.timing_s.get(name, 0.0) + time.perf_counter() - start
            self._stage, self._n_lines = before

    @property
    def has_begun(self) -> bool:
        """Whether the current stage has recorded a step."""
        return bool(self.history) and self.history[-1].stage == self._stage

    def start(self, x: RealArray, local: Local) -> None:
        """Record the starting point of a stage."""
        self.step(Step(x, local, 0.0, True))

    def step(self, step: Step) -> bool:
        """Record a step; return whether the fit should stop."""
        names = self.problem.coordinates.parameters.names
        values = self.problem.coordinates.to_values(step.x)
        cost = np.nan if step.local is None else step.local.cost
        self.history.append(
            Iteration(
                self._stage,
                len(self.history),
                cost,
                step.length,
                np.nan if step.local is None else condition(step.local.R),
                step.accepted,
                dict(zip(names, values.tolist(), strict=True)),
            )
        )
        self._accepted += self.history[-1].counts
        self._report_progress()
        return self.stopped

    def _report_progress(self) -> bool:
        """Call the callback with the current progress; return whether the fit should stop."""
        session = self.problem.session
        if self.callback is not None:
            number, cost = 0, np.nan
            values: Mapping[str, float] = {}
            if self.history:
                last = self.history[-1]
                number, cost, values = last.number, last.cost, last.values
            lines = session.lines_solved, self._n_lines
            progress = Progress(self._stage, number, cost, *lines, self._accepted, values)
            session.stopped = asks_to_stop(self.callback(progress)) or session.stopped
        return session.stopped


def condition(R: RealArray) -> float:
    """Return the condition number of a Jacobian R with its columns scaled to unit norm."""
    norms = np.linalg.norm(R, axis=0)
    if not norms.all() or not np.isfinite(norms).all():
        return np.inf
    s = np.linalg.svd(R / norms, compute_uv=False)
    return float(s[0] / s[-1]) if len(s) == R.shape[1] and s[-1] > 0 else np.inf


@dataclass(frozen=True, slots=True)
class Iteration:
    """One accepted or rejected step, numbered from 0 (the start) through all stages.

    `cost` is half the sum of squared weighted residuals, `step` the largest change of an unknown
    (of its logarithm for a factor), `condition` that of the Jacobian with columns scaled to unit
    norm; `values` are the unknowns after the step.
    """

    stage: str
    number: int
    cost: float
    step: float
    condition: float
    accepted: bool
    values: Mapping[str, float] = field(default_factory=dict)

    @property
    def counts(self) -> bool:
        """Whether the entry is an accepted step and not a start."""
        return self.accepted and self.number > 0 and self.step > 0


def count_iterations(history: Sequence[Iteration]) -> list[int]:
    """Return the number of iterations (accepted steps) up to each entry of a history."""
    made, out = 0, []
    for step in history:
        made += step.counts
        out.append(made)
    return out
