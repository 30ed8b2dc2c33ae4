"""`WeightedProblem`: model and data of a candidate, with the noise common to all candidates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from updyn.arrays import IndexArray, RealArray
from updyn.errors import SolverError
from updyn.uncertainty.likelihood import Likelihood
from updyn.updating.problem.local import Local
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import OutputError, OutputErrorSet

__all__ = ["WeightedProblem"]


@dataclass(frozen=True, slots=True, eq=False)
class WeightedProblem:
    """Model and data of a candidate, with the noise common to all candidates.

    The density of the data is that of circular complex Gaussian noise with the variance E|dH|^2 of
    each value, which `residual` has as weights sqrt(2 / E|dH|^2).
    """

    problem: Problem
    residual: OutputErrorSet

    @classmethod
    def of(cls, problem: Problem, variances: Sequence[RealArray]) -> WeightedProblem:
        """Return the problem with the variance of each value, shape (n_f, n_i, n_j) by part."""
        errors = tuple(OutputError(np.sqrt(2.0 / variance)) for variance in variances)
        return cls(problem, OutputErrorSet(errors))

    @property
    def likelihood(self) -> Likelihood:
        """The likelihood of the data with the priors of the unknowns."""
        return Likelihood(self.problem, self.residual)

    @property
    def log_constant(self) -> float:
        """Log density of data that the model reproduces exactly, -sum ln(pi E|dH|^2)."""
        weights = [error.weight for error in self.residual.errors]
        return float(sum(np.sum(2.0 * np.log(w) - np.log(2.0 * np.pi)) for w in weights))

    def data(self, x: RealArray) -> Local:
        """Return the least-squares problem of the data at x, without priors."""
        local = self.residual.local(self.problem, x)
        if local is None:
            raise SolverError("the model cannot be solved at the estimate")
        return local

    def select(self, lines: Sequence[IndexArray]) -> WeightedProblem:
        """Return the problem on some lines of each part."""
        parts, errors = [], []
        for part, error, at in zip(self.problem.parts, self.residual.errors, lines, strict=True):
            parts.append(replace(part, frf=part.frf.select(lines=part.frf.freq[at])))
            errors.append(OutputError(error.weight[at]))
        return WeightedProblem(Problem.of(parts), OutputErrorSet(tuple(errors)))
