"""Scatter of measured values about a smooth curve through neighbouring lines."""

from __future__ import annotations

import numpy as np
import scipy.sparse
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
    # The rows of D are orthonormal, and orthogonal to all parabolas over a window.
    basis = np.linalg.qr(at[:, :, None] ** np.arange(degree + 1), mode="complete")[0]
    free = width - degree - 1
    complement = basis[:, :, degree + 1 :].transpose(0, 2, 1).ravel()
    columns = np.repeat(sliding_window_view(np.arange(len(values)), width), free, axis=0).ravel()
    D = scipy.sparse.csr_array((complement, columns, np.arange(0, len(columns) + 1, width)))
    residual = D @ np.ascontiguousarray(values).view(np.float64)
    shape = (len(lines), free, values.shape[1], 2)
    squared = np.sum(np.square(residual, out=residual).reshape(shape), axis=(1, 3)) / free
    edge = width // 2
    return np.pad(squared, ((edge, edge), (0, 0)), mode="edge").reshape(frf.values.shape)
