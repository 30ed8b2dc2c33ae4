"""Reduced models about the estimate, for sampling and refitting large models, and their error.

A basis is built at the estimate and enriched at a few points about it, as far from it as draws are,
until the residual of the full model certifies its accuracy there. Afterwards its error is evaluated
at the draws furthest from the mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from updyn.dynamics.reduced import Reduction
from updyn.errors import SolverError
from updyn.uncertainty.likelihood import Gaussian, Point
from updyn.uncertainty.restored import RestoredFit
from updyn.updating.fit.reducing import reduction_of
from updyn.updating.problem.problem import Problem

__all__ = ["Surrogate", "reduced_about"]

_Vector = NDArray[np.float64]

#: Points about the estimate at which the basis is enriched.
_POINTS = 4
#: Their distance from the estimate, in standard deviations.
_DISTANCE = 2.0


@dataclass(slots=True, eq=False)
class Surrogate:
    """The reduced models of all parts of a problem.

    Parameters
    ----------
    exact : Problem
        The problem with the full models.
    accuracy : float
        Largest error of a receptance, as a share of the largest receptance of its line.
    """

    exact: Problem
    accuracy: float
    _reductions: list[Reduction] = field(init=False)

    def __post_init__(self) -> None:
        self._reductions = [reduction_of(part, self.accuracy) for part in self.exact.parts]

    @property
    def size(self) -> int:
        """Number of basis vectors of all parts."""
        return sum(r.basis.size for r in self._reductions)

    def begin(self, points: Sequence[_Vector]) -> None:
        """Build the bases at the first point and enrich them at all points.

        Parameters
        ----------
        points : sequence of ndarray of float, shape (n,)
            In the optimiser's coordinates, the estimate first.

        Raises
        ------
        SolverError
            If the model cannot be solved at the estimate.
        Stopped
            If the user wants to stop.
        """
        for part, reduction in zip(self.exact.parts, self._reductions, strict=True):
            reduction.build(part.state(points[0]))
        self.enrich(points)

    def enrich(self, points: Sequence[_Vector]) -> None:
        """Enrich the bases at some points; skip those where the model cannot be solved."""
        for number, x in enumerate(points):
            for part, reduction in zip(self.exact.parts, self._reductions, strict=True):
                try:
                    reduction.settle(part.state(x), part.frf.freq)
                except SolverError:
                    if number == 0:
                        raise

    def problem(self) -> Problem:
        """Return the problem with the current reduced models."""
        parts = []
        for part, reduction in zip(self.exact.parts, self._reductions, strict=True):
            solver = reduction.solver(f"reduced, {reduction.basis.size}")
            parts.append(replace(part, solver=solver))
        return Problem.of(parts)

    def error(self, x: _Vector) -> float:
        """Return the largest error at a point, relative to the largest receptance of its line.

        It is inf where the model cannot be solved.
        """
        errors = []
        for part, reduction in zip(self.exact.parts, self._reductions, strict=True):
            try:
                found = reduction.certify(part.state(x), part.frf.freq, enrich=False)
            except SolverError:
                return np.inf
            errors.append(found.error)
        return max(errors)


def reduced_about(
    restored: RestoredFit, accuracy: float, seed: int
) -> tuple[Surrogate | None, RestoredFit]:
    """Reduce a model that is too large for dense matrices about its estimate.

    Parameters
    ----------
    restored : RestoredFit
        The fit.
    accuracy : float
        Largest error of the reduced model, as of `Surrogate`.
    seed : int
        Seed of the points about the estimate at which it is enriched.

    Returns
    -------
    surrogate : Surrogate or None
        None for a small model.
    restored : RestoredFit
        The fit with the reduced model.

    Raises
    ------
    SolverError
        If the model cannot be solved at the estimate.
    Stopped
        If the user wants to stop.
    """
    if all(part.solver.tier == "dense" for part in restored.problem.parts):
        return None, restored
    likelihood = restored.likelihood()
    local = likelihood.local(restored.x)
    if local is None:
        raise SolverError("the model cannot be solved at the estimate")
    z = np.random.default_rng([seed, 1]).standard_normal((_POINTS, len(restored.x)))
    z *= _DISTANCE * np.sqrt(len(restored.x)) / np.linalg.norm(z, axis=1)[:, None]
    points = np.clip(Gaussian(likelihood, Point(restored.x, local)).at(z), *likelihood.bounds)
    surrogate = Surrogate(restored.problem, accuracy)
    surrogate.begin([restored.x, *points])
    return surrogate, restored.with_problem(surrogate.problem())
