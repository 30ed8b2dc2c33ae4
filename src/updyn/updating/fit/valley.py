"""How far the data let an unknown go from an answer, all others following: valleys of the misfit.

The curvature at a minimum says how firmly the data hold an unknown only where the misfit is a
parabola. Along a curved valley it may hardly rise for many of the standard deviations that the
curvature claims. So the valley is followed: the unknown is held at a distance, and all others are
fitted again (profile likelihood; Raue et al., Bioinformatics 25 (2009) 1923).
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

__all__ = ["Valley", "holding", "valleys"]

_Vector = NDArray[np.float64]

#: Unknowns with a smaller standard deviation are not followed: so near, misfits are parabolas.
_SURE = 0.01
#: A valley is followed so far, in standard deviations, by steps of this size.
_FAR, _STEP = 8.0, 2.0
#: It is open if it can be followed at least so far (a bound may end it),
_LEAST = 3.0
#: and the misfit there has risen by less than this share of what a parabola does;
_OPEN = 0.25
#: on the way it may rise by this share.
_SWELL = 0.5


def holding(problem: Problem, x: _Vector, i: int) -> Problem:
    """Return the problem with unknown `i` held where it is at x."""
    lower, upper = (bound.copy() for bound in problem.coordinates.bounds)
    lower[i] = upper[i] = x[i]
    return problem.with_box((lower, upper))


@dataclass(frozen=True, slots=True, eq=False)
class Valley:
    """One unknown and a side of it.

    Attributes
    ----------
    problem : Problem
        Model, data and unknowns.
    answer : Answer
        Where it begins.
    unknown : int
        Which unknown.
    side : float
        1: upwards, -1: downwards.
    ridge : ndarray of float, shape (n,)
        How all unknowns move with this one, to first order, by one standard deviation of it.
    """

    problem: Problem
    answer: Answer
    unknown: int
    side: float
    ridge: _Vector

    @property
    def std(self) -> float:
        """Standard deviation of the unknown, by the curvature at the answer."""
        return float(self.ridge[self.unknown])

    def end(self, refitted: Callable[[_Vector, int], Answer | None]) -> Answer | None:
        """Return its far end, where all along it the data are fitted as well; None: it is closed.

        Parameters
        ----------
        refitted : callable
            Returns the answer from a point with one unknown held; None where there is none.
        """
        last, slope, step, gone = self.answer, self.side * self.ridge, _STEP, 0.0
        while gone < _FAR - 1e-9 and not self._at_bound(last.x):
            x = self._ahead(last.x, slope, min(step, _FAR - gone))
            here = refitted(x, self.unknown)
            far = self.distance(x)
            if here is None or self._rise(here) > max(AS_WELL, _SWELL * _parabola(far)):
                if step < _STEP:
                    return None
                step = 0.5 * _STEP  # the valley may have turned away from the straight line
                continue
            slope, step = (here.x - last.x) / (far - gone), _STEP
            gone, last = far, here
        is_open = self._rise(last) <= min(AS_WELL, _OPEN * _parabola(gone))
        return last if gone >= _LEAST and is_open else None

    def distance(self, x: _Vector) -> float:
        """Return how far the unknown is from the answer on this side, in standard deviations."""
        return self.side * float(x[self.unknown] - self.answer.x[self.unknown]) / self.std

    def is_covered(self, x: _Vector) -> bool:
        """Whether a point is already so far on this side."""
        return self.distance(x) >= _LEAST

    def _rise(self, other: Answer) -> float:
        return other.unlikelihood - self.answer.unlikelihood

    def _ahead(self, x: _Vector, slope: _Vector, step: float) -> _Vector:
        return np.clip(x + step * slope, *self.problem.coordinates.bounds)

    def _at_bound(self, x: _Vector) -> bool:
        lower, upper = self.problem.coordinates.bounds
        return bool(x[self.unknown] in (lower[self.unknown], upper[self.unknown]))


def _parabola(far: float) -> float:
    """Return by how much the log-likelihood falls so many standard deviations off."""
    return 0.5 * far**2


def valleys(problem: Problem, answer: Answer) -> Iterator[Valley]:
    """Yield both sides of each unknown that the data hold, the least sure first."""
    if answer.local is None:
        return
    known = resolve(answer.local.R)
    std = np.where(known.involved, 0.0, np.sqrt(np.diag(known.covariance)))
    for i in np.argsort(-std):
        if std[i] <= _SURE:
            return
        for side in (-1.0, 1.0):
            yield Valley(problem, answer, int(i), side, known.covariance[:, i] / std[i])
