"""Answers of a fit, and where to look for another that fits as well.

A minimum of the misfit is an answer; whether it is the only one, its curvature cannot say. Further
answers are looked for where they are known to hide: at the other ends of the search, along unknowns
that the data hardly hold, where an unknown is put back to its start, and where parts of the
structure are exchanged, as in the mirror image of a symmetric one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from updyn.updating.fit.null_space import resolve
from updyn.updating.problem.local import Local
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import Each

__all__ = ["AS_WELL", "Answer", "elsewhere", "equals", "preferred", "weakly_held"]

_Vector = NDArray[np.float64]

#: Answers whose log-likelihoods differ by less than this fit equally well: odds of 100 to 1.
AS_WELL = float(np.log(100.0))
#: Spread of the unknowns about their start that decides between answers that fit equally well: a
#: factor of e, or a loss factor of 0.3.
_USUAL_FACTOR, _USUAL_LOSS = 1.0, 0.3
#: Two answers are one below this distance, in standard deviations.
_APART = 3.0
#: Unknowns with a larger standard deviation than this are moved,
_UNSURE = 0.05
#: at most so many,
_HOPS = 6
#: by so many standard deviations, and at most a factor of e.
_FAR = 8.0
#: Largest number of exchanges, and of points that are tried because they fit fairly well.
_EXCHANGES, _PROMISING = 200, 4


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """Where a descent ended.

    Attributes
    ----------
    x : ndarray of float, shape (n,)
        The estimate.
    reason : str
        Why it ended.
    unlikelihood : float
        Minus the logarithm of the likelihood, but for a constant that all answers share.
    noises : sequence of NoiseModel
        For each part of the problem, the noise of the last descent.
    residual : Each
        The residual, whitened by it.
    local : Local or None
        The reduced problem at x, priors included; None after a stop.
    """

    x: _Vector
    reason: str
    unlikelihood: float
    noises: Sequence[NoiseModel]
    residual: Each
    local: Local | None


def preferred(problem: Problem, answers: Sequence[Answer]) -> Answer:
    """Return the best answer; of those that fit equally well, the one nearest to the start."""
    best = min(answer.unlikelihood for answer in answers)
    equal = [answer for answer in answers if answer.unlikelihood <= best + AS_WELL]
    coordinates = problem.coordinates
    home = coordinates.to_x(coordinates.parameters.start)
    usual = np.where(coordinates.parameters.is_factor, _USUAL_FACTOR, _USUAL_LOSS)

    def implausible(answer: Answer) -> float:
        far = (answer.x - home) / usual
        return answer.unlikelihood + 0.5 * float(far @ far)

    return min(equal, key=implausible)


def equals(chosen: Answer, others: Sequence[Answer]) -> list[Answer]:
    """Return the other answers that fit as well and differ in what the data seem to determine."""
    found: list[Answer] = []
    for other in sorted(others, key=lambda answer: answer.unlikelihood):
        as_well = other.unlikelihood <= chosen.unlikelihood + AS_WELL
        if as_well and other.reason == "converged" and _differ(chosen, other):
            if all(_differ(known, other) for known in found):
                found.append(other)
    return found


def _differ(a: Answer, b: Answer) -> bool:
    """Whether some unknown differs by more than both answers allow it."""
    if a.local is None or b.local is None:
        return False
    std = np.maximum(_std(a.local), _std(b.local))
    return bool((np.abs(a.x - b.x) > _APART * std + 1e-6).any())


def _std(local: Local) -> _Vector:
    """Return the standard deviations that a whitened Jacobian gives; inf for what it leaves open."""
    found = resolve(local.R)
    return np.where(found.involved, np.inf, np.sqrt(np.diag(found.covariance)))


def weakly_held(problem: Problem, answer: Answer) -> Iterator[_Vector]:
    """Yield points, shape (n,), with an unknown moved alone that the data hardly hold.

    Moving one unknown by itself leaves the ridge of the misfit; steps along the ridge were measured
    to fall back.
    """
    if answer.local is None:
        return
    lower, upper = problem.coordinates.bounds
    home = problem.coordinates.to_x(problem.coordinates.parameters.start)
    std = _std(answer.local)
    for i in np.argsort(-std)[:_HOPS]:
        if std[i] <= _UNSURE:
            return
        step = min(_FAR * std[i], 1.0)
        for value in (home[i], answer.x[i] - step, answer.x[i] + step):
            moved = answer.x.copy()
            moved[i] = value
            moved = np.clip(moved, lower, upper)
            if abs(moved[i] - answer.x[i]) > 1e-3 * step:
                yield moved


def elsewhere(
    problem: Problem, answer: Answer, unlikelihood: Callable[[_Vector], float], most: int
) -> list[_Vector]:
    """Return points, shape (n,), away from an answer that fit fairly well as they stand.

    Each unknown is put back to its start, alone, and parts of the structure are exchanged.

    Parameters
    ----------
    problem : Problem
        Model, data and unknowns.
    answer : Answer
        Where they are away from.
    unlikelihood : callable
        Minus the log-likelihood at a point.
    most : int
        Largest number of points that are looked at.
    """
    tries = [*_exchanged(problem, answer.x), *_returned(problem, answer.x)][:most]
    worse = np.array([unlikelihood(x) for x in tries]) - answer.unlikelihood
    # The misfit is doubled at most.
    promising = [i for i in np.argsort(worse) if worse[i] <= max(problem.n_values, 50)]
    return [tries[i] for i in promising[:_PROMISING]]


def _returned(problem: Problem, x: _Vector) -> Iterator[_Vector]:
    home = problem.coordinates.to_x(problem.coordinates.parameters.start)
    for i in np.flatnonzero(np.abs(x - home) > _UNSURE):
        moved = x.copy()
        moved[i] = home[i]
        yield moved


def _exchanged(problem: Problem, x: _Vector) -> Iterator[_Vector]:
    """Yield points with the unknowns of two groups exchanged, or of all in reverse order."""
    own: dict[str, dict[str, int]] = {}
    for i, p in enumerate(problem.coordinates.parameters):
        if not p.drives and not p.is_channel:
            own.setdefault(p.group, {})[p.quantity] = i
    names = list(own)
    size = _sizes(problem)
    pairs = [(i, j) for i, j in combinations(range(len(names)), 2)]
    reverse = [(i, len(names) - 1 - i) for i in range(len(names) // 2)]
    for swaps in [reverse] * (len(reverse) > 1) + [[pair] for pair in pairs[:_EXCHANGES]]:
        moved = x.copy()
        for i, j in swaps:
            a, b = own[names[i]], own[names[j]]
            for quantity in a.keys() & b.keys():
                p, q = a[quantity], b[quantity]
                moved[p] = x[q] + size[q] - size[p]
                moved[q] = x[p] + size[p] - size[q]
        if (moved != x).any():
            yield np.clip(moved, *problem.coordinates.bounds)


def _sizes(problem: Problem) -> _Vector:
    """Return the logarithm of what a factor of 1 stands for, shape (n,); 0 for other unknowns."""
    system, parameters = problem.parts[0].solver.system, problem.coordinates.parameters
    sizes = np.zeros(problem.n)
    for i, p in enumerate(parameters):
        if p.is_factor and not p.drives and system.has(p.group, p.quantity):
            sizes[i] = np.log(np.abs(system.terms[system.find(p.group, p.quantity)].data).sum())
    return sizes
