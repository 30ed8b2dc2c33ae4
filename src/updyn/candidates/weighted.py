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

__all__ = ["WeightedProblem", "count_items"]


@dataclass(frozen=True, slots=True, eq=False)
class WeightedProblem:
    """Model and data of a candidate, with the noise common to all candidates.

    The density of FRFs is that of circular complex Gaussian noise with the variance E|dH|^2 of each
    value, which `residual` has as weights sqrt(2 / E|dH|^2). That of modes is Gaussian.
    """

    problem: Problem
    residual: OutputErrorSet

    @property
    def likelihood(self) -> Likelihood:
        """The likelihood of the data with the priors of the unknowns."""
        return Likelihood(self.problem, self.residual)

    def data(self, x: RealArray) -> Local:
        """Return the least-squares problem of the data at x, without priors."""
        local = self.residual.local(self.problem, x)
        if local is None:
            raise SolverError("the model cannot be solved at the estimate")
        return local

    def log_constant(self, x: RealArray) -> float:
        """Return the log density of data that the model reproduces exactly at x."""
        # Of FRFs it is -sum ln(pi E|dH|^2), at any x.
        weights = [error.weight for error in self.residual.errors]
        total = float(sum(np.sum(2.0 * np.log(w) - np.log(2.0 * np.pi)) for w in weights))
        for part, error in zip(self.problem.modal, self.residual.modal, strict=True):
            size = error.negative_log_likelihood(part, x) - error.local(part, x).cost
            total -= size + 0.5 * part.n_numbers * float(np.log(2.0 * np.pi))
        return total

    def select(self, items: Sequence[IndexArray]) -> WeightedProblem:
        """Return the problem on some lines, or modes, of each part."""
        number = len(self.problem.parts)
        parts, errors = [], []
        for part, error, at in zip(
            self.problem.parts, self.residual.errors, items[:number], strict=True
        ):
            parts.append(replace(part, frf=part.frf.select(lines=part.frf.freq[at])))
            errors.append(OutputError(error.weight[at]))
        modal = [
            replace(part, target=part.target.select(at.tolist()))
            for part, at in zip(self.problem.modal, items[number:], strict=True)
        ]
        residual = OutputErrorSet(tuple(errors), self.residual.modal)
        return WeightedProblem(Problem.of(parts, modal), residual)


def count_items(problem: Problem) -> list[int]:
    """Return the number of lines, or of modes, of each part."""
    modes = [len(part.target.value) for part in problem.modal]
    return [part.n_lines for part in problem.parts] + modes
