"""Independent proposals: a mixture of Student's t, one for each hump of the posterior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, logsumexp

from updyn.uncertainty.gaussian import Gaussian
from updyn.uncertainty.likelihood import Likelihood, Point

__all__ = ["Mixture"]

_Vector = NDArray[np.float64]
_Matrix = NDArray[np.float64]

#: Degrees of freedom: tails heavier than those of any posterior in bounds, at little cost near the
#: middle.
_FREEDOM = 6.0
#: Least share of a hump; more draws than this many times the unknowns are needed to learn its
#: covariance from them.
_LEAST, _ENOUGH = 0.1, 10


@dataclass(frozen=True, slots=True, eq=False)
class Mixture:
    """A density to propose from.

    Attributes
    ----------
    means : ndarray of float, shape (h, n)
        Middles of the humps.
    roots : ndarray of float, shape (h, n, n)
        Roots A of their scale matrices A A^T.
    log_volumes : ndarray of float, shape (h,)
        ln |det A|.
    shares : ndarray of float, shape (h,)
        Their weights; the sum is 1.
    """

    means: _Matrix
    roots: NDArray[np.float64]
    log_volumes: _Vector
    shares: _Vector

    @classmethod
    def of(cls, likelihood: Likelihood, tops: Sequence[Point]) -> Mixture:
        """Return the mixture of what the likelihood looks like about its minima."""
        parts = [Gaussian(likelihood, top) for top in tops]
        volumes = np.array([part.log_volume for part in parts])
        weight = np.array([-top.cost for top in tops]) + volumes
        return cls(
            np.array([part.mean for part in parts]),
            np.array([part.root for part in parts]),
            volumes,
            _floored(np.exp(weight - logsumexp(weight))),
        )

    def adapted(self, X: _Matrix) -> Mixture:
        """Return the mixture with middles, scales and shares as draws X, shape (m, n), say."""
        nearest = np.argmin(
            [_distances(X, m, A) for m, A in zip(self.means, self.roots, strict=True)], axis=0
        )
        means, roots, volumes, shares = [], [], [], []
        for k in range(len(self.means)):
            own = X[nearest == k]
            mean, root, volume = self.means[k], self.roots[k], float(self.log_volumes[k])
            if len(np.unique(own, axis=0)) > _ENOUGH * X.shape[1]:
                mean = own.mean(axis=0)
                _, s, Vt = np.linalg.svd((own - mean) / np.sqrt(len(own) - 1), full_matrices=False)
                if s[-1] > 1e-8 * s[0]:
                    root, volume = Vt.T * s, float(np.sum(np.log(s)))
            means.append(mean)
            roots.append(root)
            volumes.append(volume)
            shares.append(len(own) / len(X))
        return Mixture(
            np.array(means), np.array(roots), np.array(volumes), _floored(np.array(shares))
        )

    def draw(self, random: Any, count: int) -> _Matrix:
        """Return draws, shape (count, n), with numbers from a `numpy.random.RandomState`."""
        n = self.means.shape[1]
        hump = random.choice(len(self.shares), size=count, p=self.shares)
        stretch = np.sqrt(_FREEDOM / random.chisquare(_FREEDOM, size=count))
        z = random.standard_normal((count, n)) * stretch[:, None]
        return np.asarray(self.means[hump] + np.einsum("mij,mj->mi", self.roots[hump], z))

    def log_density(self, X: _Matrix) -> _Vector:
        """Return the logarithm of the density at points X, shape (m, n), up to a constant."""
        n = X.shape[1]
        power = 0.5 * (_FREEDOM + n)
        constant = gammaln(power) - gammaln(0.5 * _FREEDOM)
        terms = [
            np.log(share) - volume - power * np.log1p(_distances(X, mean, root) / _FREEDOM)
            for mean, root, volume, share in zip(
                self.means, self.roots, self.log_volumes, self.shares, strict=True
            )
        ]
        return np.asarray(constant + logsumexp(terms, axis=0))

    def propose(self, X: _Matrix, random: Any) -> tuple[_Matrix, _Vector]:
        """Return new points for walkers at X, shape (m, n), and ln q(X) - ln q(new), as emcee asks for it."""
        new = self.draw(random, len(X))
        return new, self.log_density(X) - self.log_density(new)


def _distances(X: _Matrix, mean: _Vector, root: _Matrix) -> _Vector:
    """Return squared distances in units of the scale, shape (m,)."""
    return np.asarray(np.sum(np.linalg.solve(root, (X - mean).T) ** 2, axis=0))


def _floored(shares: _Vector) -> _Vector:
    """Return shares of which none is so small that its hump is hardly ever proposed."""
    kept = np.maximum(shares, _LEAST / len(shares))
    return np.asarray(kept / kept.sum())
