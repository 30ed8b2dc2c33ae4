"""Predictive distribution, by posterior and noise, of data that were held out of a fit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from updyn.frf import FRF
from updyn.updating.problem.noise import EstimatedByChannel, NoiseModel, Stated
from updyn.updating.problem.problem import FRFPart

__all__ = ["predictive_figures"]

_Real = NDArray[np.float64]


def predictive_figures(
    part: FRFPart, x: _Real, covariance: _Real, noise: NoiseModel, scale: float = 1.0
) -> dict[str, float]:
    """Return the predicted size of the residual of held-out data, and its actual size.

    The predictive variance of a value is that of its noise plus J C J^T, with the derivatives J of
    the model with respect to the unknowns and their covariance C (Gelman et al., Bayesian Data
    Analysis, 3rd ed. 2013, section 6.3).

    Parameters
    ----------
    part : FRFPart
        The updated model with the held-out data.
    x : ndarray of float, shape (n,)
        The estimate.
    covariance : ndarray of float, shape (n, n)
        Covariance of x; inf for undetermined unknowns.
    noise : NoiseModel
        Noise model of the fitted data.
    scale : float
        Factor on its variance.

    Returns
    -------
    dict
        ``residual_expected``: root of the mean predictive variance of a channel over its level, the
        median over channels, at most 1. ``residual_deviations``: rms residual of a channel in
        predicted standard deviations, the median over channels.
    """
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


def _posterior_variance(dH: NDArray[np.complex128], covariance: _Real) -> _Real:
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
