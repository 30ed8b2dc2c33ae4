"""Quantiles of the magnitude of a complex value with an additive and a relative error."""

from __future__ import annotations

import numpy as np

from updyn.arrays import RealArray
from updyn.uncertainty.settings import RICE_TABLE
from updyn.updating.result import interval_quantile

__all__ = ["magnitude_limits"]


def magnitude_limits(
    size: RealArray, std: RealArray, log_std: RealArray, level: float, freedom: int | None
) -> tuple[RealArray, RealArray]:
    """Return the limits of |H| at a level, in the shape of `size`, the magnitude without error.

    `std` is the standard deviation of the real and of the imaginary part of an additive error, and
    `log_std` that of the logarithm of a factor. `freedom` are the degrees of freedom of Student's
    distribution; None for the normal one.
    """
    z = interval_quantile(level, freedom)
    additive = std * (z / interval_quantile(level, None))
    low, high = _rice_limits(size, additive, level)
    spread = z * log_std
    # The two errors are independent: the distances of a limit from |H| are added in quadrature.
    with np.errstate(over="ignore"):
        below, above = -size * np.expm1(-spread), size * np.expm1(spread)
    low = low - (np.hypot(size - low, below) - np.abs(size - low))
    high = high + (np.hypot(high - size, above) - (high - size))
    return np.maximum(low, 0.0), high


def _rice_limits(size: RealArray, std: RealArray, level: float) -> tuple[RealArray, RealArray]:
    """Return the limits of the magnitude of a value with a circular normal error."""
    # Rice, Bell Syst. Tech. J. 24 (1945) 46, section 3.10. Between the values of the table the
    # quantiles in standard deviations are linear; beyond it they are those of a normal variable of
    # mean size + std^2 / (2 size) to 2e-3 of a standard deviation.
    from scipy.stats import norm, rice

    table = np.linspace(0.0, RICE_TABLE.largest_ratio, RICE_TABLE.n_ratios)
    has_error = std > 0.0
    safe = np.where(has_error, std, 1.0)
    ratio = size / safe
    limits = []
    for tail in (0.5 - 0.5 * level, 0.5 + 0.5 * level):
        near = np.interp(ratio, table, rice.ppf(tail, table))
        far = ratio + norm.ppf(tail) + 0.5 / np.maximum(ratio, RICE_TABLE.largest_ratio)
        in_stds = np.where(ratio < RICE_TABLE.largest_ratio, near, far)
        limits.append(np.where(has_error, in_stds * safe, size))
    return limits[0], limits[1]
