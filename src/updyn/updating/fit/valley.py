"""Valleys of the misfit: how far an unknown can move from an answer while all others follow.

Along a curved valley the misfit may hardly increase over many of the standard deviations that the
curvature gives (profile likelihood; Raue et al., Bioinformatics 25 (2009) 1923).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from updyn.arrays import RealArray
from updyn.updating.fit.answer import Answer
from updyn.updating.fit.null_space import resolve
from updyn.updating.fit.settings import ANSWERS, FURTHER_ANSWERS, VALLEY
from updyn.updating.problem.problem import Problem

__all__ = ["Valley", "find_valleys", "fix_in_box", "fix_unknown"]


def fix_unknown(problem: Problem, x: RealArray, i: int) -> Problem:
    """Return the problem with unknown `i` fixed at its value in x."""
    return problem.with_box(fix_in_box(problem.coordinates.bounds, x, i))


def fix_in_box(
    box: tuple[RealArray, RealArray], x: RealArray, i: int
) -> tuple[RealArray, RealArray]:
    """Return a box in which unknown `i` is fixed at its value in x."""
    lower, upper = (side.copy() for side in box)
    lower[i] = upper[i] = x[i]
    return lower, upper


@dataclass(frozen=True, slots=True, eq=False)
class Valley:
    """One unknown, and the direction in which it moves from an answer: 1 or -1.

    `ridge`, shape (n,), is the first-order change of all unknowns for one standard deviation of
    this one.
    """

    problem: Problem
    answer: Answer
    unknown: int
    side: float
    ridge: RealArray

    @property
    def std(self) -> float:
        """Standard deviation of the unknown from the curvature at the answer."""
        return float(self.ridge[self.unknown])

    def find_end(self, refit: Callable[[RealArray, int], Answer | None]) -> Answer | None:
        """Return the far end if refits with the unknown fixed are as good all along, else None."""
        last, slope, step, distance = self.answer, self.side * self.ridge, VALLEY.step_stds, 0.0
        while distance < FURTHER_ANSWERS.reach_stds - 1e-9 and not self._is_at_bound(last.x):
            x = self._step_along(last.x, slope, min(step, FURTHER_ANSWERS.reach_stds - distance))
            answer = refit(x, self.unknown)
            far = self.distance(x)
            if answer is None or self._misfit_rise(answer) > max(
                ANSWERS.equal_log_odds, VALLEY.rise_share * _parabola(far)
            ):
                if step < VALLEY.step_stds:
                    return None
                step = 0.5 * VALLEY.step_stds  # the valley may curve away from the straight line
                continue
            slope, step = (answer.x - last.x) / (far - distance), VALLEY.step_stds
            distance, last = far, answer
        is_open = self._misfit_rise(last) <= min(
            ANSWERS.equal_log_odds, VALLEY.open_share * _parabola(distance)
        )
        return last if distance >= ANSWERS.distinct_stds and is_open else None

    def distance(self, x: RealArray) -> float:
        """Return the distance of the unknown from the answer, in standard deviations."""
        return self.side * float(x[self.unknown] - self.answer.x[self.unknown]) / self.std

    def is_covered(self, x: RealArray) -> bool:
        """Return whether a point on this side is far enough for a distinct answer."""
        return self.distance(x) >= ANSWERS.distinct_stds

    def _misfit_rise(self, other: Answer) -> float:
        return other.negative_log_likelihood - self.answer.negative_log_likelihood

    def _step_along(self, x: RealArray, slope: RealArray, step: float) -> RealArray:
        return np.clip(x + step * slope, *self.problem.coordinates.bounds)

    def _is_at_bound(self, x: RealArray) -> bool:
        lower, upper = self.problem.coordinates.bounds
        return bool(x[self.unknown] in (lower[self.unknown], upper[self.unknown]))


def _parabola(far: float) -> float:
    """Return the decrease of a parabolic log-likelihood at a number of standard deviations."""
    return 0.5 * far**2


def find_valleys(problem: Problem, answer: Answer) -> Iterator[Valley]:
    """Yield both sides of each determined unknown, the most uncertain first."""
    if answer.local is None:
        return
    known = resolve(answer.local.R)
    std = np.where(known.involved, 0.0, np.sqrt(np.diag(known.covariance)))
    for i in np.argsort(-std):
        if std[i] <= FURTHER_ANSWERS.uncertain_std:
            return
        for side in (-1.0, 1.0):
            yield Valley(problem, answer, int(i), side, known.covariance[:, i] / std[i])
