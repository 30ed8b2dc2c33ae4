"""The likelihood of a fit with its priors, its minimisation, and its Gaussian about a minimum.

The density is that of circular complex Gaussian noise with the variance of the fit,

    -ln p(x | data) = 1/2 sum |H_A(x) - H_X|^2 / (sigma^2 / 2)
                      + 1/2 sum ((x_k - x_k0) / std_k)^2 + constant,

with sigma^2 = E|dH|^2 times the square of the fit's inflation. It is a density in the optimiser's
coordinates x: the logarithm of a factor, and a loss factor itself. Without a given prior, the prior
is flat in x within the bounds (Jaynes 1968: the prior of a scale).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from updyn.arrays import BoolArray, RealArray
from updyn.errors import SolverError
from updyn.uncertainty.settings import POSTERIOR_SEARCH
from updyn.updating.fit.trust_region import TrustRegion
from updyn.updating.problem.local import Local
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import OutputErrorSet, add_prior

__all__ = [
    "Gaussian",
    "Likelihood",
    "Point",
    "select_furthest",
]


@dataclass(frozen=True, slots=True, eq=False)
class Point:
    """A point of the likelihood, in the optimiser's coordinates, and its local problem."""

    x: RealArray
    local: Local

    @property
    def cost(self) -> float:
        """The negative logarithm of the density, up to a constant."""
        return self.local.cost


@dataclass(frozen=True, slots=True, eq=False)
class Likelihood:
    """Data and priors as one cost: the negative logarithm of the density, up to a constant."""

    problem: Problem
    residual: OutputErrorSet
    #: Bounds in x, each shape (n,).
    bounds: tuple[RealArray, RealArray] = field(init=False, repr=False)
    _prior: tuple[RealArray, RealArray] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        # Computed once: a cost of a small model takes hardly longer.
        object.__setattr__(self, "bounds", self.problem.coordinates.bounds)
        object.__setattr__(self, "_prior", self.problem.coordinates.prior)

    def local(self, x: RealArray) -> Local | None:
        """Return cost and slopes at x, shape (n,), or None if the model cannot be solved."""
        local = self.residual.local(self.problem, x)
        if local is None:
            return None
        return add_prior(local, self.problem, x)

    def cost(self, x: RealArray) -> float:
        """Return the cost at x, shape (n,); inf outside the bounds or without a solution."""
        lower, upper = self.bounds
        if not ((x >= lower) & (x <= upper)).all():
            return np.inf
        total = 0.0
        for i, part in enumerate(self.problem.parts):
            try:
                H = part.responses(x)
            except SolverError:
                return np.inf
            total += float(np.sum(np.abs(self.residual.of(i).weight * (H - part.frf.values)) ** 2))
        centre, weight = self._prior
        prior = weight * (x - centre)
        cost = 0.5 * total + 0.5 * float(prior @ prior)
        if not np.isfinite(cost):
            return np.inf
        return cost

    def descend(self, x: RealArray, fixed: int | None = None) -> Point | None:
        """Minimise the cost within the bounds; None if the model cannot be solved at the start."""
        free = np.ones(len(x), dtype=np.bool_)
        if fixed is not None:
            free[fixed] = False
        lower, upper = self.bounds
        evaluated: dict[bytes, Local] = {}

        def evaluate(y: RealArray) -> Local | None:
            full = np.array(x)
            full[free] = y
            local = self.local(full)
            if local is None:
                return None
            evaluated[y.tobytes()] = local
            return Local(local.cost, local.R[:, free], local.q)

        start = np.clip(x[free], lower[free], upper[free])
        if evaluate(start) is None:
            return None
        settings = TrustRegion(POSTERIOR_SEARCH.descent_steps, 1e-8, min_decrease=1e-6)
        outcome = settings.minimise(
            lambda y: _recall_local(evaluated, free, y) or evaluate(y),
            start,
            lower[free],
            upper[free],
        )
        full = np.array(x)
        full[free] = outcome.x
        return Point(full, evaluated[outcome.x.tobytes()])


def _recall_local(evaluated: dict[bytes, Local], free: BoolArray, y: RealArray) -> Local | None:
    known = evaluated.get(y.tobytes())
    if known is None:
        return None
    return Local(known.cost, known.R[:, free], known.q)


class Gaussian:
    """The Gaussian approximation about a minimum; bounds limit undetermined combinations.

    `mean` is in the optimiser's coordinates, `root` is a root A, shape (n, n), of the covariance A
    A^T, and `log_volume` is ln |det A|.
    """

    def __init__(self, likelihood: Likelihood, top: Point) -> None:
        lower, upper = likelihood.bounds
        # A flat density between bounds has the variance width^2 / 12.
        R = np.vstack([top.local.R, np.diag(np.sqrt(12.0) / (upper - lower))])
        _, s, Vt = np.linalg.svd(R, full_matrices=False)
        self.mean = top.x
        self.root: RealArray = Vt.T / s
        self.log_volume = float(-np.sum(np.log(s)))

    def at(self, z: RealArray) -> RealArray:
        """Return points, shape (m, n), for standard normal numbers of that shape."""
        return np.asarray(self.mean + z @ self.root.T)


def select_furthest(X: RealArray, count: int) -> RealArray:
    """Return the `count` points of largest Mahalanobis distance from their mean, (count, n)."""
    centred = X - X.mean(axis=0)
    _, s, Vt = np.linalg.svd(centred, full_matrices=False)
    keep = s > 1e-10 * max(float(s[0]), np.finfo(float).tiny)
    distance = np.linalg.norm(centred @ (Vt[keep].T / s[keep]), axis=1)
    return np.asarray(X[np.argsort(-distance, kind="stable")[:count]])
