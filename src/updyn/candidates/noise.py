"""The noise common to all candidates: that of the candidate with the largest likelihood."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from updyn.arrays import RealArray
from updyn.candidates.settings import CANDIDATES
from updyn.candidates.weighted import WeightedProblem
from updyn.uncertainty.restored import RestoredFit
from updyn.updating.problem.modal import ModalError
from updyn.updating.problem.noise import level_by_unit
from updyn.updating.problem.noise.modes import ModalNoise
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import OutputError, OutputErrorSet

__all__ = ["CommonNoise"]


@dataclass(frozen=True, slots=True, eq=False)
class CommonNoise:
    """Variance E|dH|^2 of each part with FRFs, (n_f, n_i, n_j), and noise of each with modes."""

    variances: tuple[RealArray, ...]
    modal: tuple[ModalNoise, ...]

    @classmethod
    def of(cls, fits: Sequence[RestoredFit]) -> CommonNoise:
        """Return the noise of the fit with the largest likelihood, each with its own noise."""
        found = [_find_noise(fit) for fit in fits]
        return min(found, key=lambda pair: pair[0])[1]

    def weigh(self, problem: Problem) -> WeightedProblem:
        """Return the data of a candidate with this noise."""
        errors = tuple(OutputError(np.sqrt(2.0 / variance)) for variance in self.variances)
        return WeightedProblem(problem, OutputErrorSet(errors, tuple(map(ModalError, self.modal))))


def _find_noise(fit: RestoredFit) -> tuple[float, CommonNoise]:
    """Return the negative log-likelihood of a fit with its own noise, and this noise."""
    problem, cost = fit.whole, 0.0
    variances: list[RealArray] = []
    for noise, part in zip(fit.noises() if problem.parts else (), problem.parts, strict=True):
        H = part.responses(fit.x)
        least = (CANDIDATES.least_noise * level_by_unit(part.frf)) ** 2
        cost += noise.negative_log_likelihood(H, part.frf)
        variances.append(np.maximum(noise.variance(H, part.frf), least))
    modal: list[ModalNoise] = []
    priors = np.diag(problem.coordinates.prior[1])
    for one in problem.modal:
        modal.append(one.noise.refit(one.rows(fit.x), priors))
        cost += ModalError(modal[-1]).negative_log_likelihood(one, fit.x)
    return cost, CommonNoise(tuple(variances), tuple(modal))
