"""Valleys of the misfit: how far an unknown can move from an answer while all others follow.

Along a curved valley the misfit may hardly increase over many of the standard deviations that the
curvature gives (profile likelihood; Raue et al., Bioinformatics 25 (2009) 1923).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.updating.fit.answer import Answer
from updyn.updating.fit.answers import AS_WELL
from updyn.updating.fit.null_space import resolve
from updyn.updating.problem.problem import Problem

__all__ = ["Valley", "find_valleys", "fix_in_box", "fix_unknown"]

_Vector = NDArray[np.float64]

#: Unknowns with a smaller standard deviation are not followed: misfits are parabolas so near.
_SURE = 0.01
#: Distance over which a valley is followed, and size of a step, in standard deviations.
_FAR, _STEP = 8.0, 2.0
#: Least distance at which a valley counts as open (a bound may end it there).
_LEAST = 3.0
#: Largest rise of the misfit at the end of an open valley, as a share of that of the parabola.
_OPEN = 0.25
#: Largest rise of the misfit on the way, as a share of that of the parabola.
_SWELL = 0.5


def fix_unknown(problem: Problem, x: _Vector, i: int) -> Problem:
    """Return the problem with unknown `i` fixed at its value in x."""
    return problem.with_box(fix_in_box(problem.coordinates.bounds, x, i))


def fix_in_box(box: tuple[_Vector, _Vector], x: _Vector, i: int) -> tuple[_Vector, _Vector]:
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
    ridge: _Vector

    @property
    def std(self) -> float:
        """Standard deviation of the unknown from the curvature at the answer."""
        return float(self.ridge[self.unknown])

    def find_end(self, refit: Callable[[_Vector, int], Answer | None]) -> Answer | None:
        """Return the far end if refits with the unknown fixed are as good all along, else None."""
        last, slope, step, distance = self.answer, self.side * self.ridge, _STEP, 0.0
        while distance < _FAR - 1e-9 and not self._is_at_bound(last.x):
            x = self._step_along(last.x, slope, min(step, _FAR - distance))
            answer = refit(x, self.unknown)
            far = self.distance(x)
            if answer is None or self._misfit_rise(answer) > max(AS_WELL, _SWELL * _parabola(far)):
                if step < _STEP:
                    return None
                step = 0.5 * _STEP  # the valley may curve away from the straight line
                continue
            slope, step = (answer.x - last.x) / (far - distance), _STEP
            distance, last = far, answer
        is_open = self._misfit_rise(last) <= min(AS_WELL, _OPEN * _parabola(distance))
        return last if distance >= _LEAST and is_open else None

    def distance(self, x: _Vector) -> float:
        """Return the distance of the unknown from the answer, in standard deviations."""
        return self.side * float(x[self.unknown] - self.answer.x[self.unknown]) / self.std

    def is_covered(self, x: _Vector) -> bool:
        """Return whether a point is at least `_LEAST` away from the answer on this side."""
        return self.distance(x) >= _LEAST

    def _misfit_rise(self, other: Answer) -> float:
        return other.negative_log_likelihood - self.answer.negative_log_likelihood

    def _step_along(self, x: _Vector, slope: _Vector, step: float) -> _Vector:
        return np.clip(x + step * slope, *self.problem.coordinates.bounds)

    def _is_at_bound(self, x: _Vector) -> bool:
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
        if std[i] <= _SURE:
            return
        for side in (-1.0, 1.0):
            yield Valley(problem, answer, int(i), side, known.covariance[:, i] / std[i])
