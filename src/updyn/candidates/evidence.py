"""The evidence of a model: the density of the data with the unknowns integrated out.

By Laplace's method (MacKay, Information Theory, Inference, and Learning Algorithms, 2003, chapter
28; Kass & Raftery, J. Am. Stat. Assoc. 90 (1995) 773, eq. 5; for structures Beck & Yuen, J. Eng.
Mech. 130 (2004) 192), at the estimate x with the Jacobian J of the weighted residuals,

    ln Z = ln p(data | x) - 1/2 sum_Gaussian ((x_k - x_k0) / s_k)^2 - 1/2 ln det(1 + S J^T J S),

S = diag(s_k), in the optimiser's coordinates. s_k is the standard deviation of a Gaussian prior. A
prior that is flat over the width W_k between the bounds has s_k = W_k / sqrt(2 pi), the Gaussian
with the same density at its centre, so that a determined unknown contributes ln(sqrt(2 pi) std / W)
as it does for a flat prior. A combination that the data do not determine has J = 0 and contributes
nothing. The formula is exact for linear models with Gaussian priors.

Bounds cut off a part of the density. For each unknown its own marginal density is integrated
between the bounds (`_log_bound_factors`), which is exact for uncorrelated unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from updyn.arrays import BoolArray, RealArray
from updyn.candidates.settings import CANDIDATES
from updyn.updating.problem.coordinates import Coordinates
from updyn.updating.problem.local import Local, join_locals, reduce_blocks

__all__ = ["Prior", "log_evidence", "log_prediction"]


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """Independent priors of the unknowns in the optimiser's coordinates; arrays of shape (n,).

    `centre` and `scale` (standard deviation) are those of the Gaussian ones; where `is_flat`, the
    prior is flat between `lower` and `upper`, and `scale` is that of the equivalent Gaussian.
    """

    centre: RealArray
    scale: RealArray
    lower: RealArray
    upper: RealArray
    is_flat: BoolArray

    @classmethod
    def of(cls, coordinates: Coordinates) -> Prior:
        """Return the priors of the unknowns."""
        centre, weight = coordinates.prior
        lower, upper = coordinates.bounds
        is_flat = weight == 0.0
        width = (upper - lower) / np.sqrt(2.0 * np.pi)
        scale = np.where(is_flat, width, 1.0 / np.where(is_flat, 1.0, weight))
        return cls(centre, scale, lower, upper, is_flat)

    def deviations(self, x: RealArray) -> RealArray:
        """Return distances from the centres in standard deviations; 0 for flat priors."""
        return np.where(self.is_flat, 0.0, (x - self.centre) / self.scale)


def log_evidence(data: Local, x: RealArray, prior: Prior) -> float:
    """Return ln Z for data of unit variance, without the constant of their density.

    `data` is the least-squares problem of the data alone at the estimate x, shape (n,).
    """
    pull = prior.deviations(x)
    s, std = _resolve_posterior(data.R, prior)
    log_volume = -0.5 * float(np.sum(np.log1p(s**2)))
    gradient = data.gradient + pull / prior.scale
    factors = _log_bound_factors(x, std, gradient, prior)
    return -data.cost - 0.5 * float(pull @ pull) + log_volume + float(factors.sum())


def _resolve_posterior(R: RealArray, prior: Prior) -> tuple[RealArray, RealArray]:
    """Return singular values of J S, and marginal standard deviations, each shape (n,)."""
    n = len(prior.scale)
    square = np.vstack([R, np.zeros((max(n - len(R), 0), n))])
    _, s, Vt = np.linalg.svd(square * prior.scale, full_matrices=False)
    spread = np.linalg.norm(Vt / np.sqrt(1.0 + s**2)[:, None], axis=0)
    return s, prior.scale * spread


def _log_bound_factors(
    x: RealArray, std: RealArray, gradient: RealArray, prior: Prior
) -> RealArray:
    """Return the logarithms of the factors by which bounds change the evidence, shape (n,)."""
    # The marginal density of unknown k is proportional to exp(-g t - J^2 t^2 / 2) times the prior
    # at x + t. The gradient g vanishes unless the estimate is at a bound. The factor is its
    # integral between the bounds over sqrt(2 pi / (J^2 + 1 / s^2)), that of the formula.
    scale = prior.scale
    posterior = 1.0 / std**2
    information = np.maximum(posterior - 1.0 / scale**2, CANDIDATES.least_information / scale**2)
    at_bound = (x <= prior.lower) | (x >= prior.upper)
    g = np.where(at_bound, gradient, 0.0)
    low, high = prior.lower - x, prior.upper - x
    curvature = np.where(prior.is_flat, information, posterior)
    integral = _log_integral(g, curvature, low, high)
    width = np.where(prior.is_flat, np.log(high - low), 0.5 * np.log(2.0 * np.pi) + np.log(scale))
    inside = _log_integral((x - prior.centre) / scale**2, 1.0 / scale**2, low, high)
    log_share = inside - 0.5 * ((prior.centre - x) / scale) ** 2 - width  # prior within the bounds
    plain = -0.5 * np.log1p(information * scale**2)
    return np.asarray(integral - width - plain - np.where(prior.is_flat, 0.0, log_share))


def _log_integral(g: RealArray, curvature: RealArray, low: RealArray, high: RealArray) -> RealArray:
    """Return ln of the integral of exp(-g t - c t^2 / 2) from low to high, shape (n,)."""
    root = np.sqrt(curvature)
    a, b = root * low + g / root, root * high + g / root
    mirrored = a > 0.0  # the smaller tail is computed without cancellation
    a, b = np.where(mirrored, -b, a), np.where(mirrored, -a, b)
    log_a, log_b = log_ndtr(a), log_ndtr(b)
    log_mass = log_b + np.log1p(-np.exp(log_a - log_b))
    return np.asarray(0.5 * g**2 / curvature + 0.5 * np.log(2.0 * np.pi / curvature) + log_mass)


def log_prediction(fitted: Local, held_out: Local, prior: Prior, scale: float = 1.0) -> float:
    """Return the log density of held-out data of unit variance, without its constant.

    Both problems are at the estimate from the fitted data. The density is that of all held-out
    values together, with the posterior of the unknowns to first order; `scale` multiplies the
    variance of all data.
    """
    # The unknowns are integrated out: with T the triangle of the posterior precision T^T T, and T'
    # that with the held-out data, ln p = -cost at the best shift + ln|det T| - ln|det T'|.
    n, root = len(prior.scale), np.sqrt(scale)
    rows = np.vstack([fitted.R / root, np.diag(1.0 / prior.scale)])
    before = reduce_blocks([np.column_stack([rows, np.zeros(len(rows))])], n)
    held = Local(held_out.cost / scale, held_out.R / root, held_out.q / root)
    after = join_locals([before, held], n)
    best = after.cost - 0.5 * float(after.q @ after.q)
    return _log_determinant(before.R) - _log_determinant(after.R) - best


def _log_determinant(triangle: RealArray) -> float:
    return float(np.sum(np.log(np.abs(np.diag(triangle)))))
