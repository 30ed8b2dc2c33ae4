"""Correlation of mode shapes and of frequency response functions."""

from __future__ import annotations

from updyn.correlation.clusters import Subspace
from updyn.correlation.frfs import (
    Correlation,
    csac,
    csf,
    db_error,
    fdac,
    frac,
    frf_correlation,
    relative_residual,
)
from updyn.correlation.kinds import correlate
from updyn.correlation.modes import ModeCorrelation
from updyn.correlation.shapes import (
    ModePairs,
    auto_mac,
    comac,
    cross_orthogonality,
    ecomac,
    mac,
    pair_modes,
    principal_cosines,
)

__all__ = [
    "Correlation",
    "ModeCorrelation",
    "ModePairs",
    "Subspace",
    "auto_mac",
    "comac",
    "correlate",
    "cross_orthogonality",
    "csac",
    "csf",
    "db_error",
    "ecomac",
    "fdac",
    "frac",
    "frf_correlation",
    "mac",
    "pair_modes",
    "principal_cosines",
    "relative_residual",
]
