"""Comparison of the size of a fault in the two halves of the band."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from updyn.updating.judge.causes.evidence import Evidence, stack_real_imag
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.misfit import count_values
from updyn.updating.judge.causes.settings import CAUSE_MISFIT

__all__ = ["compare_band_halves"]


def compare_band_halves(evidence: Evidence, fault: Fault, correlation: float) -> float:
    """Return the difference between sizes in lower and upper lines in stds; 0 if undetermined."""
    # Both sizes and all unknowns are fitted, to first order. The residual counts as at least
    # `PERFECT_FIT`, because the last steps of a fit are arbitrary.
    slope = replace(fault, value=0.0).slope(evidence)
    lower = np.arange(len(slope)) < len(slope) // 2
    zeros = np.zeros_like(evidence.offset_to_start)
    effects = [
        np.append(stack_real_imag(evidence.weight * half[:, None, None] * slope), zeros)
        for half in (lower, ~lower)
    ]
    D = np.stack(effects, axis=1) / evidence.rms_misfit
    size = np.linalg.norm(D, axis=0)
    D = evidence.project_out_unknowns(D)
    b = evidence.adapted_misfit
    Q, R = np.linalg.qr(D)
    if (np.abs(np.diag(R)) <= CAUSE_MISFIT.dependent_share * size).any():
        return 0.0
    sizes = np.linalg.solve(R, Q.T @ b)
    residual = (b - Q @ (Q.T @ b))[: -len(zeros)]
    least = 0.5 * (CAUSE_MISFIT.perfect_rms / evidence.rms_misfit) ** 2
    variance = max(float(residual @ residual) / max(count_values(evidence.frf), 1), least)
    variance *= (1.0 + correlation) / (1.0 - correlation)
    difference = np.linalg.solve(R.T, np.array([1.0, -1.0]))
    deviation = np.sqrt(variance * float(difference @ difference))
    return float(abs(sizes[0] - sizes[1]) / max(deviation, np.finfo(np.float64).tiny))
