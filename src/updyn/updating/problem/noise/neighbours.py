"""Scatter of measured values about a smooth curve through neighbouring lines."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from updyn.arrays import RealArray
from updyn.frf import FRF
from updyn.updating.problem.noise.settings import LINE_SCATTER

__all__ = ["estimate_scatter"]


def estimate_scatter(frf: FRF) -> RealArray:
    """Return the scatter of data about a parabola through five neighbouring lines, an E|dH|^2."""
    # It has 2 complex degrees of freedom, includes the curvature of the FRF between the lines, and
    # is 0 for fewer than five lines (local polynomial without the transient; Pintelon & Schoukens,
    # System Identification, 2nd ed. 2012, chapter 7).
    width, degree = LINE_SCATTER.window_lines, LINE_SCATTER.polynomial_degree
    values = frf.values.reshape(len(frf.freq), -1)
    if len(values) < width:
        return np.zeros(frf.values.shape)
    lines = sliding_window_view(frf.freq, width)
    at = lines - lines[:, width // 2, None]
    at /= np.abs(at).max(axis=1, keepdims=True)
    basis = np.linalg.qr(at[:, :, None] ** np.arange(degree + 1))[0]
    windows = sliding_window_view(values, width, axis=0).transpose(0, 2, 1)
    residual = windows - basis @ (basis.transpose(0, 2, 1) @ windows)
    squared = np.sum(np.abs(residual) ** 2, axis=1) / (width - degree - 1)
    edge = width // 2
    return np.pad(squared, ((edge, edge), (0, 0)), mode="edge").reshape(frf.values.shape)
