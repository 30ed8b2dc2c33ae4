"""Minima beside the estimate: other values of the unknowns that explain the data about as well.

Descents start from random points, by the log error first, whose basins are wide; and from the
estimate with two unknowns of a kind exchanged: data that cannot tell which of two parts is the
stiff one are the usual reason for humps.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from updyn.uncertainty.likelihood import Likelihood, Point
from updyn.uncertainty.progress import WorkCounter
from updyn.updating.fit.search import SEARCH_LINES, SEARCH_STEPS
from updyn.updating.fit.trust_region import TrustRegion
from updyn.updating.problem.local import Local
from updyn.updating.problem.residuals import LogError, with_prior

__all__ = ["STARTS", "find_minima"]

_Vector = NDArray[np.float64]

#: Random starts where none are asked for, how far they lie off (logarithms of factors), and the
#: least loss factor of every other one: inflated damping widens the basin.
STARTS = 8
_SPREAD, _INFLATED = 1.0, 0.1
#: Exchanges that are looked into further, and humps this much less likely (in logarithm) that are
#: still kept.
_EXCHANGES, _FAINT = 3, 12.0


def find_minima(
    likelihood: Likelihood, best: Point, starts: int, seed: int, watch: WorkCounter | None = None
) -> list[Point]:
    """Return the minima that explain the data about as well as the best, that one first.

    Parameters
    ----------
    likelihood : Likelihood
        What is minimised.
    best : Point
        The minimum that is known.
    starts : int
        Random starts; 0 looks nowhere else.
    seed : int
        Of the random starts.
    watch : WorkCounter, optional
        Who waits.

    Returns
    -------
    list of Point
        Different ones, by falling likelihood.

    Raises
    ------
    Stopped
        If the user wants to stop.
    """
    found = [best]
    if starts == 0:
        return found
    problem = likelihood.problem
    items = [*_random(likelihood, best.x, starts, seed), *_exchanged(likelihood, best.x)]
    for top in problem.session.map(_climb, likelihood, items, spread=not problem.spreads):
        if top is not None and not any(_same(top, other) for other in found):
            found.append(top)
        if watch is not None:
            watch.asks()
    found.sort(key=lambda p: p.cost)
    return [p for p in found if p.cost < found[0].cost + _FAINT]


def _random(
    likelihood: Likelihood, x: _Vector, starts: int, seed: int
) -> Iterator[tuple[_Vector, bool]]:
    lower, upper = likelihood.bounds
    factor = likelihood.problem.coordinates.parameters.is_factor
    draws = qmc.LatinHypercube(d=len(x), rng=np.random.default_rng(seed)).random(starts)
    for number, draw in enumerate(draws):
        loss = np.maximum(x, _INFLATED if number % 2 == 0 else 0.0)
        yield np.clip(np.where(factor, x + _SPREAD * (2.0 * draw - 1.0), loss), lower, upper), True


def _exchanged(likelihood: Likelihood, x: _Vector) -> Iterator[tuple[_Vector, bool]]:
    """Yield the estimate with two unknowns of one quantity exchanged, the likeliest few."""
    lower, upper = likelihood.bounds
    items = list(likelihood.problem.coordinates.parameters)
    tries = []
    for i in range(len(x)):
        for j in range(i):
            if (
                items[i].quantity == items[j].quantity
                and not items[i].drives
                and not items[j].drives
            ):
                other = np.array(x)
                other[[i, j]] = x[[j, i]]
                tries.append(np.clip(other, lower, upper))
    costs = [likelihood.cost(t) for t in tries]
    for at in np.argsort(costs, kind="stable")[:_EXCHANGES]:
        if np.isfinite(costs[at]):
            yield tries[at], False


def _climb(likelihood: Likelihood, item: tuple[_Vector, bool]) -> Point | None:
    """Return the minimum that is reached from a start; None where the model cannot be solved there."""
    x, far = item
    if far:
        lower, upper = likelihood.bounds
        rough = likelihood.problem.thinned(SEARCH_LINES)

        def evaluate(at: _Vector) -> Local | None:
            local = LogError().local(rough, at)
            return None if local is None else with_prior(local, rough, at)

        if evaluate(x) is None:
            return None
        settings = TrustRegion(SEARCH_STEPS, 1e-6, radius=0.3, relative_fall=1e-4)
        x = settings.minimise(evaluate, x, rough.coordinates.relaxed_lower, upper).x
        x = np.clip(x, lower, upper)
    return likelihood.descend(x)


def _same(a: Point, b: Point) -> bool:
    """Whether two minima are one: less than a standard deviation apart."""
    return bool(np.linalg.norm(b.local.R @ (a.x - b.x)) < 1.0 or np.abs(a.x - b.x).max() < 1e-6)
