"""Cosines between computed and measured shapes, and the probabilities that they meet limits.

The measured shape b of unit length is that of the structure plus errors. The length of r = b / (u^T
b) - u is the tangent of its angle with the computed shape u. Errors add to |r|^2 on average: the
measured MAC is too low. With c = r^T S r / |r|^2 and nu = tr S / c, where S is the covariance of r,
|r|^2 / c is approximately noncentral chi-square with nu degrees of freedom and the noncentrality
|rho|^2 / c of the true tangent |rho| (equal mean and, for small errors, equal variance). The
probability that |rho| is below a limit is that of a tangent at the limit to give at least the
measured |r|: the confidence distribution of the noncentrality (M. Xie & K. Singh, Int. Stat. Rev.
81 (2013) 3-39).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chndtr, ndtr

from updyn.acceptance.settings import MODEL_ACCEPTANCE
from updyn.arrays import IndexArray, RealArray
from updyn.correlation.shapes import orthonormalise

__all__ = [
    "PrincipalPair",
    "ShapeSet",
    "probability_between",
    "probability_of_angle",
    "shrink",
]


def probability_between(value: float, std: float, limit: float) -> float:
    """Return the probability that a normal number is between -limit and limit; nan: unknown std."""
    if np.isnan(std):
        return np.nan
    if std == 0.0:
        return float(abs(value) <= limit)
    return float(ndtr((limit - value) / std) - ndtr((-limit - value) / std))


def shrink(values: RealArray, std: RealArray) -> tuple[RealArray, RealArray]:
    """Return values about zero and their standard deviations, given those of all of them.

    Errors increase the sizes of n measured values. The true ones are regarded as drawn from a
    normal distribution about zero, of which they give the variance (C. N. Morris, J. Am. Stat.
    Assoc. 78 (1983) 47-55, with equal variances replaced by those of each).
    """
    n = len(values)
    if n < MODEL_ACCEPTANCE.least_shrunk or np.isnan(std).any():
        return values, std
    total = np.maximum(np.sum(values**2) / (n - 2), std**2)
    share = np.divide((n - 2) / n * std**2, total, out=np.zeros(n), where=total > 0.0)
    variance = std**2 * (1.0 - share) + 2.0 / (n - 3) * (share * values) ** 2
    return (1.0 - share) * values, np.sqrt(variance)


def probability_of_angle(r: RealArray, root: RealArray, limit: float) -> float:
    """Return the probability that a true tangent is at most `limit`; nan: unknown errors.

    `r`, shape (k,), is the measured tangent vector and `root` R, shape (k, q), of its covariance
    R R^T.
    """
    if np.isnan(root).any():
        return np.nan
    length, total = float(np.linalg.norm(r)), float(np.sum(root**2))
    if total == 0.0:
        return float(length <= limit)
    scale = float(np.linalg.svd(root, compute_uv=False)[0] ** 2)
    if length > 0.0:
        scale = float(np.sum((root.T @ r) ** 2)) / length**2
    if scale == 0.0:
        return float(length <= limit)
    if max(length, limit) ** 2 > MODEL_ACCEPTANCE.largest_square * scale:
        return float(ndtr((limit - length) / np.sqrt(scale)))
    return float(1.0 - chndtr(length**2 / scale, total / scale, limit**2 / scale))


@dataclass(frozen=True, slots=True, eq=False)
class PrincipalPair:
    """Two shapes of unit length: of the span of computed shapes, and of that of measured ones.

    `computed` and `measured`, shape (k,), with `by_unknowns` (k, r) and `by_noise` (k, q), factors
    of the covariances of their errors; `span`, shape (k, p), is an orthonormal basis of the
    computed shapes.
    """

    computed: RealArray
    measured: RealArray
    by_unknowns: RealArray
    by_noise: RealArray
    span: RealArray

    @property
    def cosine(self) -> float:
        """Modulus of the cosine of the angle between both."""
        return min(abs(float(self.computed @ self.measured)), 1.0)

    def probability(self, least: float, *, with_unknowns: bool) -> float:
        """Return the probability that the true cosine is at least a limit above 0."""
        cosine = float(self.computed @ self.measured)
        if abs(cosine) < MODEL_ACCEPTANCE.least_cosine:
            return 0.0
        r = self.measured / cosine - self.computed
        noise = self.by_noise / cosine
        across = noise - self.span @ (self.span.T @ noise)
        parts = [across - np.outer(r, self.computed @ noise)]
        if with_unknowns:
            parts.append(-self.by_unknowns - np.outer(r, r @ self.by_unknowns))
        return probability_of_angle(r, np.hstack(parts), float(np.sqrt(1.0 / least**2 - 1.0)))


@dataclass(frozen=True, slots=True, eq=False)
class ShapeSet:
    """Weighted shapes of unit length and factors of the covariances of their errors.

    `shapes`, shape (k, n); `roots`, n factors of shape (k, q) each.
    """

    shapes: RealArray
    roots: tuple[RealArray, ...]

    @classmethod
    def of(cls, shapes: RealArray, roots: Sequence[RealArray], weight: RealArray) -> ShapeSet:
        """Weight shapes (k, n) by a matrix (k, k) and scale them to unit length."""
        weighted = weight @ shapes
        length = np.linalg.norm(weighted, axis=0)
        unit = weighted / length
        scaled = []
        for k, root in enumerate(roots):
            errors = weight @ root / length[k]
            scaled.append(errors - np.outer(unit[:, k], unit[:, k] @ errors))
        return cls(unit, tuple(scaled))

    def cosines(self, measured: ShapeSet) -> RealArray:
        """Return the cosines of the angles between computed and measured shapes, (n, m)."""
        return np.asarray(self.shapes.T @ measured.shapes)

    def std_of_cosines(self, measured: ShapeSet, *, with_unknowns: bool) -> RealArray:
        """Return the standard deviations of the cosines, (n, m)."""
        by_noise = [np.sum((self.shapes.T @ root) ** 2, axis=1) for root in measured.roots]
        variance = np.column_stack(by_noise)
        if with_unknowns:
            variance += [np.sum((measured.shapes.T @ root) ** 2, axis=1) for root in self.roots]
        return np.asarray(np.sqrt(variance))

    def pair(
        self, measured: ShapeSet, computed_modes: IndexArray, measured_modes: IndexArray, n: int
    ) -> PrincipalPair:
        """Return the n-th principal pair between the spans of computed and measured modes."""
        a, b = self.shapes[:, computed_modes], measured.shapes[:, measured_modes]
        span, other = orthonormalise(a), orthonormalise(b)
        left, _, right = np.linalg.svd(span.T @ other, full_matrices=False)
        u, v = span @ left[:, n - 1], other @ right[n - 1]
        of_a, of_b = (np.linalg.lstsq(x, y, rcond=None)[0] for x, y in ((a, u), (b, v)))
        by_unknowns = sum(
            weight * self.roots[j] for weight, j in zip(of_a, computed_modes, strict=True)
        )
        by_unknowns = by_unknowns - span @ (span.T @ by_unknowns)
        noise = [weight * measured.roots[k] for weight, k in zip(of_b, measured_modes, strict=True)]
        return PrincipalPair(u, v, np.asarray(by_unknowns), np.hstack(noise), span)
