"""`integrate`: integrals of functions with kinks and resonances, by bisection of intervals."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from updyn.arrays import RealArray
from updyn.nonlinear.settings import QUADRATURE

__all__ = ["integrate"]

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(QUADRATURE.points)


def integrate(
    function: Callable[[RealArray], RealArray],
    edges: RealArray,
    most_halvings: int = QUADRATURE.most_halvings,
) -> RealArray:
    """Return the integrals of a function (n,) -> (n, ...) from the first edge to the last.

    Intervals between edges are halved until the Gauss-Legendre rule on both halves agrees with that
    on the whole, relative to the integral of each component. Values that are not finite end it.
    """

    def apply_rule(a: RealArray, b: RealArray) -> RealArray:
        half = 0.5 * (b - a)
        at = (a + half)[:, None] + half[:, None] * _POINTS
        found = function(at.ravel())
        found = found.reshape(*at.shape, *found.shape[1:])
        return np.asarray(np.einsum("pn...,n,p->p...", found, _WEIGHTS, half))

    a, b = edges[:-1], edges[1:]
    whole = apply_rule(a, b)
    total, size = np.zeros(whole.shape[1:]), np.zeros(whole.shape[1:])
    for _ in range(most_halvings):
        middle = 0.5 * (a + b)
        halves = np.stack([apply_rule(a, middle), apply_rule(middle, b)])
        better = halves.sum(axis=0)
        allowed = QUADRATURE.error * (size + np.abs(better).sum(axis=0))
        is_accurate = (np.abs(better - whole) <= allowed).reshape(len(a), -1).all(axis=1)
        total += better[is_accurate].sum(axis=0)
        size += np.abs(better[is_accurate]).sum(axis=0)
        rest = ~is_accurate
        a, b = np.concatenate([a[rest], middle[rest]]), np.concatenate([middle[rest], b[rest]])
        whole = np.concatenate(list(halves[:, rest]))
        if not len(a) or not np.isfinite(whole).all():
            break
    return np.asarray(total + whole.sum(axis=0))
