"""A reduced model about the estimate, in which draws of a large model are made, and its error at draws.

A basis is made at the estimate and enriched at a few points about it, as far off as draws lie,
until the full residual says that it is accurate there. Afterwards its error is taken at the draws
that lie furthest off.
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

#: Points about the estimate at which the basis is enriched, and how far off, in standard
#: deviations.
_ABOUT, _FAR = 4, 2.0


@dataclass(slots=True, eq=False)
class Surrogate:
    """The reduced models of all parts of a problem.

    Parameters
    ----------
    exact : Problem
        The whole models.
    accuracy : float
        Wanted: the error of a receptance as a share of the largest of its line.
    """

    exact: Problem
    accuracy: float
    _reductions: list[Reduction] = field(init=False)

    def __post_init__(self) -> None:
        self._reductions = [reduction_of(part, self.accuracy) for part in self.exact.parts]

    @property
    def size(self) -> int:
        """Number of motions of all parts."""
        return sum(r.basis.size for r in self._reductions)

    def begin(self, points: Sequence[_Vector]) -> None:
        """Make the bases at the first point and enrich them at all.

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
        """Add what the bases lack at some points; where the model cannot be solved, nothing."""
        for number, x in enumerate(points):
            for part, reduction in zip(self.exact.parts, self._reductions, strict=True):
                try:
                    reduction.certify(part.state(x), part.frf.freq, enrich=True)
                except SolverError:
                    if number == 0:
                        raise

    def task(self) -> Problem:
        """Return the problem with the reduced models as they are."""
        pairs = zip(self.exact.parts, self._reductions, strict=True)
        return Problem.of(
            [replace(p, solver=r.solver(f"reduced, {r.basis.size}")) for p, r in pairs]
        )

    def error(self, x: _Vector) -> float:
        """Return the largest error at a point, as a share of the largest receptance of a line; inf where not solved."""
        try:
            return max(
                reduction.certify(part.state(x), part.frf.freq, enrich=False).error
                for part, reduction in zip(self.exact.parts, self._reductions, strict=True)
            )
        except SolverError:
            return np.inf


def reduced_about(
    setting: RestoredFit, accuracy: float, seed: int
) -> tuple[Surrogate | None, RestoredFit]:
    """Return the setting, a model too large for dense matrices reduced about its estimate.

    Parameters
    ----------
    setting : RestoredFit
        An update that has ended.
    accuracy : float
        Of the reduced model.
    seed : int
        Of the points about the estimate at which it is made.

    Raises
    ------
    SolverError
        If the model cannot be solved at the estimate.
    Stopped
        If the user wants to stop.
    """
    if all(part.solver.tier == "dense" for part in setting.problem.parts):
        return None, setting
    likelihood = setting.likelihood()
    local = likelihood.local(setting.x)
    if local is None:
        raise SolverError("the model cannot be solved at the estimate")
    z = np.random.default_rng([seed, 1]).standard_normal((_ABOUT, len(setting.x)))
    z *= _FAR * np.sqrt(len(setting.x)) / np.linalg.norm(z, axis=1)[:, None]
    points = np.clip(Gaussian(likelihood, Point(setting.x, local)).at(z), *likelihood.bounds)
    surrogate = Surrogate(setting.problem, accuracy)
    surrogate.begin([setting.x, *points])
    return surrogate, setting.with_problem(surrogate.task())
