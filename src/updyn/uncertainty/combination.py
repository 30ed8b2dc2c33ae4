"""`Combination`: a measured shape as a least-squares combination of modes at the sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from scipy.optimize import brentq

from updyn.arrays import IndexArray, RealArray
from updyn.correlation.clusters import cluster_modes
from updyn.errors import DataError
from updyn.text_table import format_count
from updyn.uncertainty.settings import EXPANSION

__all__ = ["Combination", "choose_columns", "combine", "order_by_distance"]


@dataclass(frozen=True, slots=True, eq=False)
class Combination:
    """A shape as combination of some columns of a matrix of modes, both at k sensors.

    Attributes
    ----------
    columns : ndarray of int, shape (c,)
        The combined modes.
    amplitudes : ndarray of float, shape (c,)
        Their amplitudes.
    root : ndarray of float, shape (c, c)
        Root of the covariance of the amplitudes, root @ root.T.
    gain : ndarray of float, shape (c, k)
        Derivatives of the amplitudes by the shape.
    residual_share : ndarray of float, shape (k,)
        The residual over its variance.
    chi_square : float
        Sum of squares of the residual over its variance.
    error : float
        Norm of the errors of the sensors, each predicted from all others.
    excess : float
        Variance of the residual in excess of the noise.
    """

    columns: IndexArray
    amplitudes: RealArray
    root: RealArray
    gain: RealArray
    residual_share: RealArray
    chi_square: float
    error: float
    excess: float

    @classmethod
    def of(
        cls, A: RealArray, shape: RealArray, noise: RealArray, columns: IndexArray, excess: float
    ) -> Combination:
        """Return the least-squares combination with the variances `noise` + `excess`, (k,)."""
        variance = np.maximum(noise + excess, EXPANSION.least_variance * (shape @ shape))
        weight = 1.0 / np.sqrt(variance)
        Q, R = np.linalg.qr(A[:, columns] * weight[:, None])
        root = scipy.linalg.solve_triangular(R, np.eye(len(R)))
        gain = root @ Q.T * weight
        amplitudes = gain @ shape
        residual = shape - A[:, columns] @ amplitudes
        # A sensor with a leverage of 1 determines an amplitude alone: no other predicts it.
        free = np.maximum(1.0 - np.sum(Q**2, axis=1), np.finfo(np.float64).eps)
        return cls(
            columns,
            amplitudes,
            root,
            gain,
            residual / variance,
            float(np.sum(residual**2 / variance)),
            float(np.linalg.norm(residual / free)),
            excess,
        )


def combine(A: RealArray, shape: RealArray, noise: RealArray, columns: IndexArray) -> Combination:
    """Return a shape, (k,), as combination of columns of A, (k, n), with estimated excess.

    `noise`, shape (k,), are the variances of the sensors, 0 if unknown. The excess makes the sum of
    squares of the residual, over its variance, as large as the number of degrees of freedom (R. C.
    Paule & J. Mandel, J. Res. Natl. Bur. Stand. 87 (1982) 377). Raises DataError if there are not
    more sensors than columns.
    """
    freedom = len(shape) - len(columns)
    if freedom < 1:
        raise DataError(
            f"expand_modes: {format_count(len(shape), 'sensor')} for a combination of"
            f" {format_count(len(columns), 'mode')}; expected more sensors than modes"
        )

    def surplus(excess: float) -> float:
        return Combination.of(A, shape, noise, columns, excess).chi_square - freedom

    unweighted = Combination.of(A, shape, np.ones_like(noise), columns, 0.0)
    most = unweighted.chi_square / freedom
    if not noise.any():
        return Combination.of(A, shape, noise, columns, most)
    if surplus(0.0) <= 0.0 or surplus(most) >= 0.0:
        return Combination.of(A, shape, noise, columns, 0.0)
    excess = brentq(surplus, 0.0, most, xtol=EXPANSION.least_variance)
    return Combination.of(A, shape, noise, columns, float(excess))


def order_by_distance(frequency: RealArray, mode: int) -> list[IndexArray]:
    """Return clusters of close modes by distance in frequency from a mode in the first one."""
    clusters = cluster_modes(frequency)
    distances = [np.abs(frequency[one] - frequency[mode]).min() for one in clusters]
    return [clusters[i] for i in np.argsort(distances, kind="stable")]


def choose_columns(A: RealArray, shape: RealArray, near: Sequence[IndexArray]) -> IndexArray:
    """Return the columns of as many of the first clusters as reduce the leave-one-out error."""
    # Close modes are added together.
    best, least = near[0], np.inf
    rounding = np.sqrt(EXPANSION.least_variance) * np.linalg.norm(shape)
    for count in range(1, len(near) + 1):
        columns = np.sort(np.concatenate(near[:count]))
        if count > 1 and len(columns) > len(shape) - EXPANSION.spare_sensors:
            break
        if not _are_distinct(A[:, columns]):
            continue
        error = max(combine(A, shape, np.zeros_like(shape), columns).error, rounding)
        if error < EXPANSION.least_gain * least:
            best, least = columns, error
    return best


def _are_distinct(shapes: RealArray) -> bool:
    """Return whether shapes at the sensors, (k, c), are linearly independent."""
    sizes = np.linalg.norm(shapes, axis=0)
    values = np.linalg.svd(shapes / np.where(sizes > 0, sizes, 1.0), compute_uv=False)
    return bool(values[-1] > EXPANSION.rank_tolerance * values[0])
