"""Predictive distribution, by posterior and noise, of data that were held out of a fit."""

from __future__ import annotations

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.frf import FRF
from updyn.updating.problem.noise import EstimatedByChannel, NoiseModel, Stated
from updyn.updating.problem.problem import FRFPart

__all__ = ["predictive_figures"]


def predictive_figures(
    part: FRFPart, x: RealArray, covariance: RealArray, noise: NoiseModel, scale: float = 1.0
) -> dict[str, float]:
    """Return ``residual_expected`` and ``residual_deviations`` of held-out data."""
    # Both are medians over channels. The predictive variance of a value is that of its noise plus
    # J C J^T (Gelman et al., Bayesian Data Analysis, 3rd ed. 2013, section 6.3). The first is its
    # root over the level, at most 1; the second is the rms residual in predicted standard
    # deviations.
    frf = part.frf
    responses, posterior = [], []
    for block in part.blocks(x):
        assert block.dH is not None
        responses.append(block.H)
        posterior.append(_posterior_variance(block.dH, covariance))
    H = np.concatenate(responses)
    variance = np.concatenate(posterior) + scale * _adapt_noise(noise, frf).variance(H, frf)
    level = np.mean(np.abs(frf.values) ** 2, axis=0)
    has_level = level > 0.0
    with np.errstate(invalid="ignore", divide="ignore"):
        standard = np.mean(np.abs(frf.values - H) ** 2 / variance, axis=0)
        expected = np.mean(variance, axis=0) / level
    if not has_level.any():
        return {}
    return {
        "residual_expected": min(1.0, float(np.sqrt(np.median(expected[has_level])))),
        "residual_deviations": float(np.sqrt(np.median(standard[has_level]))),
    }


def _posterior_variance(dH: ComplexArray, covariance: RealArray) -> RealArray:
    """Return the variance of a block of FRFs due to that of the unknowns, shape (n_f, n_i, n_j)."""
    flat = dH.reshape(len(dH), -1)
    is_open = ~np.isfinite(np.diag(covariance))
    known = np.where(is_open[:, None] | is_open[None], 0.0, covariance)
    squared = np.sum(flat.conj() * (known @ flat), axis=0).real
    # The variance is infinite for all values that depend on an undetermined unknown.
    squared[np.any(flat[is_open] != 0.0, axis=0)] = np.inf
    return np.asarray(squared.reshape(dH.shape[1:]))


def _adapt_noise(noise: NoiseModel, frf: FRF) -> NoiseModel:
    """Return the noise model of the fitted data for data of other channels."""
    known = noise.bulk
    if not isinstance(known, EstimatedByChannel) or known.relative is None or known.floor is None:
        return known
    if known.names == tuple(frf.responses.labels):
        return known
    # Sensors without fitted data are assumed to have the median noise.
    return Stated(float(np.median(known.relative)), float(np.median(known.floor)))
