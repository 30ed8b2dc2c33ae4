"""Comparison of the size of a fault in the two halves of the band."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from updyn.updating.judge.causes.evidence import SMALLEST, Evidence, stacked
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.misfit import n_seen

__all__ = ["halves_apart"]

_Real = NDArray[np.float64]

#: Sine of the angle between the effect of a fault in one half and those of the unknowns, above
#: which the half determines its size.
_DISTINCT = 1e-6


def halves_apart(freed: Evidence, fault: Fault, alike: float) -> float:
    """Return the difference between the sizes of a fault in the lower and the upper lines.

    It is in standard deviations; 0 if a half does not determine the size. One size for each half
    and all unknowns are fitted together, to first order. The residual counts as at least that of a
    perfect fit (`SMALLEST`), because the last steps of a fit are arbitrary. `freed` is the evidence
    at the end of a fit that takes account of the fault, `alike` the correlation of the residual of
    neighbouring lines, from 0 to below 1.
    """
    slope = replace(fault, value=0.0).slope(freed)
    lower = np.arange(len(slope)) < len(slope) // 2
    still = np.zeros_like(freed.home)
    effects = [
        np.append(stacked(freed.weight * half[:, None, None] * slope), still)
        for half in (lower, ~lower)
    ]
    D = np.stack(effects, axis=1) / freed.unit
    size = np.linalg.norm(D, axis=0)
    b = np.append(freed.misfit(freed.frf) / freed.unit, freed.home)
    D, b = freed.left(freed.frf, D), freed.left(freed.frf, b)
    Q, R = np.linalg.qr(D)
    if (np.abs(np.diag(R)) <= _DISTINCT * size).any():
        return 0.0
    sizes = np.linalg.solve(R, Q.T @ b)
    residual = (b - Q @ (Q.T @ b))[: -len(still)]
    least = 0.5 * (SMALLEST / freed.unit) ** 2
    variance = max(float(residual @ residual) / max(n_seen(freed.frf), 1), least)
    variance *= (1.0 + alike) / (1.0 - alike)
    difference = np.linalg.solve(R.T, np.array([1.0, -1.0]))
    deviation = np.sqrt(variance * float(difference @ difference))
    return float(abs(sizes[0] - sizes[1]) / max(deviation, np.finfo(np.float64).tiny))
