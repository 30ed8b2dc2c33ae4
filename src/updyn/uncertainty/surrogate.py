"""Reduced models about the estimate, for the uncertainty of large ones, and their error.

Residuals of the full model enrich a basis at a few points about the estimate, at distances typical
of draws; its error is then evaluated at the points furthest from their mean. The full model is not
solved at any line.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from updyn.arrays import RealArray
from updyn.dynamics.kept_basis import begin_reduction
from updyn.dynamics.reduction import Reduction
from updyn.errors import SolverError
from updyn.uncertainty.likelihood import Gaussian, Point, select_furthest
from updyn.uncertainty.restored import RestoredFit
from updyn.uncertainty.settings import SURROGATE
from updyn.updating.fit.reducing import make_reduction
from updyn.updating.problem.problem import Problem
from updyn.updating.result import UpdateResult

__all__ = ["Surrogate", "describe_excess", "reduce_about", "run_about"]


@dataclass(slots=True, eq=False)
class Surrogate:
    """The reduced models of all parts of a problem, from the basis of each update in `results`.

    `accuracy` is the accepted error of a receptance, as a share of the largest of its line.
    """

    exact: Problem
    results: Sequence[UpdateResult]
    accuracy: float
    _reductions: list[Reduction] = field(init=False)

    def __post_init__(self) -> None:
        self._reductions = [make_reduction(part, self.accuracy) for part in self.exact.parts]

    @property
    def size(self) -> int:
        """Number of basis vectors of all parts."""
        return sum(r.basis.size for r in self._reductions)

    def begin(self, x: RealArray) -> None:
        """Begin the bases at the estimate, where the model must be solvable."""
        for part, reduction, result in zip(
            self.exact.parts, self._reductions, self.results, strict=True
        ):
            state, freq = part.state(x), part.solved_lines
            begin_reduction(reduction, result.start, result.kept_basis, state, freq)
            reduction.enrich_until_accurate([state], freq)

    def enrich(self, points: Sequence[RealArray]) -> None:
        """Enrich the bases at some points, as far as the model can be solved."""
        for part, reduction in zip(self.exact.parts, self._reductions, strict=True):
            with suppress(SolverError):
                reduction.enrich_around([part.state(x) for x in points], part.solved_lines)

    def settle(self, points: Sequence[RealArray]) -> None:
        """Enrich the bases at some points, as `enrich`, until they are accurate."""
        for part, reduction in zip(self.exact.parts, self._reductions, strict=True):
            with suppress(SolverError):
                reduction.enrich_until_accurate([part.state(x) for x in points], part.solved_lines)

    def problem(self) -> Problem:
        """Return the problem with the current reduced models."""
        parts = []
        for part, reduction in zip(self.exact.parts, self._reductions, strict=True):
            solver = reduction.solver(f"reduced, {reduction.basis.size}")
            parts.append(part.with_solver(solver))
        return Problem.of(parts)

    def error(self, points: Sequence[RealArray]) -> float:
        """Return the largest error at some points, relative to the peak of its line; maybe inf."""
        errors = []
        for part, reduction in zip(self.exact.parts, self._reductions, strict=True):
            try:
                states = [part.state(x) for x in points]
                errors.append(reduction.errors(states, part.solved_lines))
            except SolverError:
                return np.inf
        return float(np.max(errors))

    def settle_run(self, run: Callable[[Problem], RealArray]) -> dict[str, Any]:
        """Call `run` with the reduced models, and with better ones until they are accurate.

        `run` returns the points of its results, shape (m, n); the error is evaluated at the
        furthest. Return ``"basis"``, its size, ``"error"`` and ``"accuracy"`` for the record; empty
        without points.
        """
        for number in range(SURROGATE.most_enrichments + 1):
            reached = run(self.problem())
            if not len(reached):
                return {}
            far = select_furthest(reached, min(SURROGATE.checked_points, len(reached)))
            error = self.error(list(far))
            if error <= self.accuracy or number == SURROGATE.most_enrichments:
                break
            self.settle(list(far))
        return {"basis": self.size, "error": error, "accuracy": self.accuracy}


def run_about(
    restored: RestoredFit,
    accuracy: float,
    seed: int,
    run: Callable[[Problem], RealArray],
) -> dict[str, Any]:
    """Call `run` near an estimate with a reduced model; return nothing for a small model."""
    surrogate = reduce_about(restored, accuracy, seed)
    if surrogate is None:
        run(restored.problem)
        return {}
    return surrogate.settle_run(run)


def describe_excess(options: Mapping[str, Any], where: str) -> str:
    """Return a remark on the error of a reduced model; empty if it is small enough."""
    if not options.get("error", 0.0) > options.get("accuracy", np.inf):
        return ""
    return (
        f"The error of the reduced model is {options['error']:.1g} at {where}, above the accuracy"
        f" of {options['accuracy']:g}."
    )


def reduce_about(restored: RestoredFit, accuracy: float, seed: int) -> Surrogate | None:
    """Reduce a model too large for dense matrices about its estimate; None for a small one."""
    if all(part.solver.tier == "dense" for part in restored.problem.parts):
        return None
    surrogate = Surrogate(restored.whole, restored.results, accuracy)
    surrogate.begin(restored.x)
    likelihood = restored.with_problem(surrogate.problem()).likelihood()
    local = likelihood.local(restored.x)
    if local is None:
        raise SolverError("the model cannot be solved at the estimate")
    z = np.random.default_rng([seed, 1]).standard_normal((SURROGATE.points, len(restored.x)))
    z *= SURROGATE.distance * np.sqrt(len(restored.x)) / np.linalg.norm(z, axis=1)[:, None]
    points = np.clip(Gaussian(likelihood, Point(restored.x, local)).at(z), *likelihood.bounds)
    surrogate.enrich(list(points))
    return surrogate
