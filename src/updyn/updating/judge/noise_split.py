"""Covariance from few data, which do not determine the ratio of relative noise and noise floor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg

from updyn.arrays import RealArray
from updyn.updating.judge.settings import NOISE_RATIOS
from updyn.updating.problem.noise import level_by_unit
from updyn.updating.problem.noise.estimated import ratio_range
from updyn.updating.problem.noise.settings import NOISE_LIMITS
from updyn.updating.problem.problem import FRFPart, Problem

__all__ = ["covariance_over_ratios"]


def covariance_over_ratios(
    problem: Problem, x: RealArray, floors: Sequence[float], within: RealArray
) -> RealArray | None:
    """Return the largest covariance (n, n) over the likely ratios of relative noise and floor."""
    # At each ratio, the linear model gives a step d, s^2 (J^T W J)^-1 and a restricted likelihood
    # |W|^(1/2) |J^T W J|^(-1/2) S^(-nu/2) (Harville, Biometrika 61 (1974) 383); the mean square
    # error is d d^T + s^2 (J^T W J)^-1. Variances are the largest over the ratios, correlations
    # those at the most likely one. `within` is an orthonormal basis of the determined directions.
    # None without degrees of freedom.
    found = [
        _weighted_rows(part, x, floor) for part, floor in zip(problem.parts, floors, strict=True)
    ]
    J, r, size, level = (np.concatenate(rows) for rows in zip(*found, strict=True))
    J, k = J @ within, within.shape[1]
    centre, weight = problem.coordinates.prior
    spare = len(r) - k
    if spare <= 0 or k == 0:
        return None
    low, high = ratio_range(size, level)
    far = float(np.log(NOISE_RATIOS.dominance))
    logs, errors = [], []
    for ratio in np.exp(np.linspace(low - far, high + far, NOISE_RATIOS.n_ratios)):
        root = 1.0 / np.hypot(ratio * size, level)
        Q, R = np.linalg.qr(root[:, None] * J)
        along = Q.T @ (root * r)
        square = max(float(np.sum((root * r) ** 2) - along @ along), NOISE_LIMITS.least_noise**2)
        diagonal, std = np.abs(np.diag(R)), np.sqrt(square / spare)
        if not diagonal.min() > NOISE_LIMITS.least_noise * diagonal.max():
            return None
        prior = std * weight
        stacked = np.column_stack([R, along])
        stacked = np.vstack(
            [stacked, np.column_stack([prior[:, None] * within, prior * (centre - x)])]
        )
        triangle = np.linalg.qr(stacked, mode="r")[:k]
        step = scipy.linalg.solve_triangular(triangle[:, :k], triangle[:, k])
        spread = scipy.linalg.solve_triangular(triangle[:, :k], np.eye(k))
        errors.append(std**2 * spread @ spread.T + np.outer(step, step))
        logs.append(np.log(root).sum() - np.log(diagonal).sum() - 0.5 * spare * np.log(square))
    covariances = within @ np.array(errors) @ within.T
    likeliest = covariances[int(np.argmax(logs))]
    admissible = covariances[np.array(logs) >= max(logs) - NOISE_RATIOS.admissible_deficit]
    largest_variance = np.diagonal(admissible, axis1=1, axis2=2).max(axis=0)
    variance = np.diag(likeliest)
    scale = np.sqrt(largest_variance / np.where(variance > 0.0, variance, 1.0))
    return np.asarray(likeliest * scale[:, None] * scale)


def _weighted_rows(
    part: FRFPart, x: RealArray, floor: float
) -> tuple[RealArray, RealArray, RealArray, RealArray]:
    """Return derivatives, residual, |H| and level times floor, real before imaginary parts."""
    blocks = list(part.blocks(x))
    H = np.concatenate([block.H for block in blocks])
    dH = np.concatenate([block.dH for block in blocks if block.dH is not None], axis=1)
    level = np.broadcast_to(level_by_unit(part.frf), H.shape)
    is_above_rounding = (
        np.maximum(np.abs(H), np.abs(part.frf.values)) > NOISE_LIMITS.least_noise * level
    )
    J, r = dH[:, is_above_rounding].T, (part.frf.values - H)[is_above_rounding]
    size, level = floor * np.abs(H[is_above_rounding]), floor * level[is_above_rounding]
    return (
        np.concatenate([J.real, J.imag]),
        np.concatenate([r.real, r.imag]),
        np.concatenate([size, size]),
        np.concatenate([level, level]),
    )
