"""Watching a fit: the history of its steps, progress to the caller, and what may end it early."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from updyn.progress import asks_to_stop
from updyn.updating.fit.trust_region import Outcome, Step, TrustRegion
from updyn.updating.problem.local import Local
from updyn.updating.problem.problem import Problem

__all__ = [
    "CAUSES",
    "JUDGE",
    "Iteration",
    "Monitor",
    "Progress",
    "condition",
    "iterations_made",
]

#: Stages after a fit, whatever the method: what the data determine, and why a misfit is left.
JUDGE, CAUSES = "judge", "causes"


@dataclass(frozen=True, slots=True)
class Progress:
    """What a callback is shown after every step, and within a step between blocks of lines.

    Attributes
    ----------
    stage : str
        Part of the method.
    iteration : int
        The latest step, counted from 0 through all stages.
    cost : float
        Half the sum of squared weighted residuals after that step; nan before the first.
    lines_done, n_lines : int
        Lines solved so far in the whole run, and lines that a step solves.
    accepted : int
        Accepted steps so far, as `UpdateResult.iterations` counts them.
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
    """Collects history and timing; the only object of a fit that changes.

    Parameters
    ----------
    problem : Problem
        What is fitted.
    callback : callable, optional
        Called with a `Progress` after every step and between blocks of lines; returning True stops
        the fit.

    Attributes
    ----------
    overrule : callable, optional
        Looks at the data, and returns whether a fault of theirs leaves nothing to search for.
    history : list of Iteration
        Every step so far.
    timing_s : dict of str to float
        Seconds by stage.
    """

    problem: Problem
    callback: Callable[[Progress], bool | None] | None = None
    overrule: Callable[[], bool] | None = field(default=None, init=False)
    history: list[Iteration] = field(default_factory=list, init=False)
    timing_s: dict[str, float] = field(default_factory=dict, init=False)
    _stage: str = field(default="", init=False)
    _n_lines: int = field(default=0, init=False)
    _accepted: int = field(default=0, init=False)
    _in_vain: bool | None = field(default=None, init=False)
    _latest: Outcome | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        if self.callback is not None:
            self.problem.session.wants_stop = self._shown

    @property
    def stopped(self) -> bool:
        """Whether the callback has asked to stop."""
        return self.problem.session.stopped

    def is_in_vain(self) -> bool:
        """Return whether there is nothing to search for, as a fault of the data explains them.

        It is looked for when this is first asked: a search that arrives at once need not ask.
        """
        if self._in_vain is None:
            self._in_vain = self.overrule is not None and self.overrule()
        return self._in_vain

    def ended(self, outcome: Outcome) -> None:
        """Remember where a descent has ended."""
        self._latest = outcome

    def resumed(self, settings: TrustRegion, x: NDArray[np.float64]) -> TrustRegion:
        """Return settings with the radius of the latest descent, where it ran out of steps at x."""
        latest = self._latest
        if latest is None or not np.array_equal(latest.x, x):
            return settings
        return replace(settings, radius=min(settings.radius, latest.radius))

    @contextmanager
    def stage(self, name: str, problem: Problem | None = None) -> Iterator[None]:
        """Name the steps made inside, and time them.

        Parameters
        ----------
        name : str
            Part of the method.
        problem : Problem, optional
            What is fitted inside, where it is not the whole.
        """
        before, start = (self._stage, self._n_lines), time.perf_counter()
        self._stage, self._n_lines = name, (problem or self.problem).n_lines
        try:
            yield
        finally:
            self.timing_s[name] = self.timing_s.get(name, 0.0) + time.perf_counter() - start
            self._stage, self._n_lines = before

    @property
    def begun(self) -> bool:
        """Whether the current stage has recorded a step."""
        return bool(self.history) and self.history[-1].stage == self._stage

    def start(self, x: NDArray[np.float64], local: Local) -> None:
        """Record where a stage starts."""
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
        self._shown()
        return self.stopped

    def _shown(self) -> bool:
        """Show where the fit is; return whether it should stop."""
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


def condition(R: NDArray[np.float64]) -> float:
    """Return the condition number of a Jacobian with its columns scaled to unit norm.

    Parameters
    ----------
    R : ndarray of float, shape (k, n)
        Jacobian, or the triangle of its QR factors.
    """
    norms = np.linalg.norm(R, axis=0)
    if not norms.all() or not np.isfinite(norms).all():
        return np.inf
    s = np.linalg.svd(R / norms, compute_uv=False)
    return float(s[0] / s[-1]) if len(s) == R.shape[1] and s[-1] > 0 else np.inf


@dataclass(frozen=True, slots=True)
class Iteration:
    """One accepted or refused step.

    Attributes
    ----------
    stage : str
        Which part of the method made it (``"log"``, ``"maximum-likelihood"``, ``"equation-error"``,
        ...).
    number : int
        Counted from 0 (the start) through all stages.
    cost : float
        Half the sum of squared weighted residuals.
    step : float
        Largest change of an unknown (of its logarithm for a factor).
    condition : float
        Condition number of the Jacobian with columns scaled to unit norm.
    accepted : bool
        Whether the step was taken.
    values : dict of str to float
        The unknowns after the step.
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
        """Whether it is an accepted step, and not a start."""
        return self.accepted and self.number > 0 and self.step > 0


def iterations_made(history: Sequence[Iteration]) -> list[int]:
    """Return how many iterations had been made at each entry of a history.

    An iteration is a step that was taken. Refused steps, and the points where stages and tries
    begin, are entries too, but no iterations.
    """
    made, out = 0, []
    for step in history:
        made += step.counts
        out.append(made)
    return out
