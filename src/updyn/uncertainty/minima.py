"""Local minima of the likelihood, other than the estimate, that fit the data about as well.

They are searched for from random points, first of the log error, whose basins are wide, and from
the estimate with parts of the structure exchanged, because the data may not determine which of two
parts is the stiff one.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from updyn.arrays import RealArray
from updyn.uncertainty.likelihood import Likelihood, Point
from updyn.uncertainty.progress import WorkCounter
from updyn.uncertainty.settings import POSTERIOR_SEARCH
from updyn.updating.fit.answers import exchange_groups
from updyn.updating.fit.search import draw_latin_hypercube
from updyn.updating.fit.settings import SEARCH
from updyn.updating.fit.trust_region import TrustRegion
from updyn.updating.problem.local import Local
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import LogError, add_prior

__all__ = ["find_minima"]


def find_minima(
    likelihood: Likelihood,
    best: Point,
    whole: Problem,
    starts: int,
    seed: int,
    counter: WorkCounter | None = None,
) -> list[Point]:
    """Return the distinct minima that fit about as well as `best`, ascending in cost.

    `whole` has the full models, whose parts are exchanged. Without random `starts`, the known
    minimum only is returned.
    """
    found = [best]
    if starts == 0:
        return found
    problem = likelihood.problem
    items = [
        *_random_starts(likelihood, best.x, starts, seed),
        *_exchange_parts(likelihood, whole, best.x),
    ]
    for minimum in problem.session.map(
        _descend_from_start, likelihood, items, spread=not problem.is_distributed
    ):
        if minimum is not None and not any(_is_same(minimum, other) for other in found):
            found.append(minimum)
        if counter is not None:
            counter.report()
    found.sort(key=lambda p: p.cost)
    return [p for p in found if p.cost < found[0].cost + POSTERIOR_SEARCH.negligible_cost]


def _random_starts(
    likelihood: Likelihood, x: RealArray, starts: int, seed: int
) -> Iterator[tuple[RealArray, bool]]:
    lower, upper = likelihood.bounds
    factor = ~likelihood.problem.coordinates.parameters.is_damping
    draws = draw_latin_hypercube(starts, len(x), seed)
    for number, draw in enumerate(draws):
        least_loss = 0.0
        if number % 2 == 0:
            least_loss = POSTERIOR_SEARCH.inflated_loss
        factors = x + POSTERIOR_SEARCH.start_distance * (2.0 * draw - 1.0)
        start = np.where(factor, factors, np.maximum(x, least_loss))
        yield np.clip(start, lower, upper), True


def _exchange_parts(
    likelihood: Likelihood, whole: Problem, x: RealArray
) -> Iterator[tuple[RealArray, bool]]:
    """Yield the estimate with parts of the structure exchanged, of lowest cost first."""
    tries = list(exchange_groups(whole, x))
    costs = list(map(likelihood.cost, tries))
    for at in np.argsort(costs, kind="stable")[: POSTERIOR_SEARCH.exchanges]:
        if np.isfinite(costs[at]):
            yield tries[at], False


def _descend_from_start(likelihood: Likelihood, item: tuple[RealArray, bool]) -> Point | None:
    """Return the minimum reached from a start, or None if the model cannot be solved there."""
    x, far = item
    if far:
        lower, upper = likelihood.bounds
        rough = likelihood.problem.thin(SEARCH.most_lines)

        def evaluate(at: RealArray) -> Local | None:
            local = LogError().local(rough, at)
            if local is None:
                return None
            return add_prior(local, rough, at)

        if evaluate(x) is None:
            return None
        settings = TrustRegion(SEARCH.steps, 1e-6, radius=0.3, min_relative_decrease=1e-4)
        x = settings.minimise(evaluate, x, rough.coordinates.relaxed_lower, upper).x
        x = np.clip(x, lower, upper)
    return likelihood.descend(x)


def _is_same(a: Point, b: Point) -> bool:
    """Return whether two minima are equal, less than a standard deviation apart."""
    return bool(np.linalg.norm(b.local.R @ (a.x - b.x)) < 1.0 or np.abs(a.x - b.x).max() < 1e-6)
