"""`find_rule`: integrals of functions with kinks and resonances, by bisection of intervals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from updyn.arrays import RealArray
from updyn.nonlinear.settings import QUADRATURE

__all__ = ["Rule", "find_rule", "integrate"]

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(QUADRATURE.points)


@dataclass(frozen=True, slots=True, eq=False)
class Rule:
    """Points (n,) and weights (n,) of an integral, and its value (...)."""

    points: RealArray
    weights: RealArray
    integral: RealArray


def integrate(
    function: Callable[[RealArray], RealArray],
    edges: RealArray,
    most_halvings: int = QUADRATURE.most_halvings,
) -> RealArray:
    """Return the integrals of a function (n,) -> (n, ...) from the first edge to the last."""
    return find_rule(function, edges, most_halvings).integral


def find_rule(
    function: Callable[[RealArray], RealArray],
    edges: RealArray,
    most_halvings: int = QUADRATURE.most_halvings,
    error: float = QUADRATURE.error,
) -> Rule:
    """Return the rule that integrates a function (n,) -> (n, ...) over all edges.

    Intervals between edges are halved until the Gauss-Legendre rule on both halves agrees with that
    on the whole, with an `error` relative to the integral of each component. Values that are not
    finite end it.
    """

    def apply_rule(a: RealArray, b: RealArray) -> RealArray:
        half = 0.5 * (b - a)
        found = function(_place(a, b).ravel())
        found = found.reshape(len(a), len(_POINTS), *found.shape[1:])
        return np.asarray(np.einsum("pn...,n,p->p...", found, _WEIGHTS, half))

    a, b = edges[:-1], edges[1:]
    whole = apply_rule(a, b)
    total, size = np.zeros(whole.shape[1:]), np.zeros(whole.shape[1:])
    done: list[tuple[RealArray, RealArray]] = []
    for _ in range(most_halvings):
        middle = 0.5 * (a + b)
        halves = np.stack([apply_rule(a, middle), apply_rule(middle, b)])
        better = halves.sum(axis=0)
        allowed = error * (size + np.abs(better).sum(axis=0))
        is_accurate = (np.abs(better - whole) <= allowed).reshape(len(a), -1).all(axis=1)
        total += better[is_accurate].sum(axis=0)
        size += np.abs(better[is_accurate]).sum(axis=0)
        done += [(a[is_accurate], middle[is_accurate]), (middle[is_accurate], b[is_accurate])]
        rest = ~is_accurate
        a, b = np.concatenate([a[rest], middle[rest]]), np.concatenate([middle[rest], b[rest]])
        whole = np.concatenate(list(halves[:, rest]))
        if not len(a) or not np.isfinite(whole).all():
            break
    a, b = (np.concatenate(ends) for ends in zip(*done, (a, b), strict=True))
    weights = 0.5 * (b - a)[:, None] * _WEIGHTS
    return Rule(_place(a, b).ravel(), weights.ravel(), total + whole.sum(axis=0))


def _place(a: RealArray, b: RealArray) -> RealArray:
    """Return the points of intervals, (p, n)."""
    half = 0.5 * (b - a)[:, None]
    return np.asarray(a[:, None] + half + half * _POINTS)
