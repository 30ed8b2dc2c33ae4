"""Output errors in standard deviations of the noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import OutputError, OutputErrorSet

__all__ = ["whiten_residual", "whitening_weights"]


def whiten_residual(problem: Problem, noises: Sequence[NoiseModel], x: RealArray) -> OutputErrorSet:
    """Return the output errors of the tests at x, in standard deviations of the noise."""
    errors = []
    for part, noise in zip(problem.parts, noises, strict=True):
        H = part.responses(x)
        known = noise.refit(H, part.frf, problem.share(part))
        errors.append(OutputError(whitening_weights(known, H, part)))
    return OutputErrorSet(tuple(errors))


def whitening_weights(known: NoiseModel, H: ComplexArray, part: FRFPart) -> RealArray:
    """Return 1 / sigma of the real (and of the imaginary) part, shape (n_f, n_i, n_j).

    Values without a finite variance have weight 0. `known` must be the noise model after its refit
    to the residual.
    """
    variance = np.broadcast_to(known.variance(H, part.frf), H.shape)
    usable = np.isfinite(variance) & (variance > 0.0)
    return np.where(usable, np.sqrt(2.0 / np.where(usable, variance, 1.0)), 0.0)
