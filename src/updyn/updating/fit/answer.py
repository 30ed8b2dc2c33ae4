"""`Answer`: the end of a descent with its likelihood, noise and local problem."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.updating.problem.local import Local
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.residuals import OutputErrorSet

__all__ = ["Answer"]

_Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """End of a descent.

    Attributes
    ----------
    x : ndarray of float, shape (n,)
        The estimate.
    reason : str
        Why the descent ended.
    negative_log_likelihood : float
        Minus the log-likelihood, except for a constant that all answers share.
    noises : sequence of NoiseModel
        Noise model of the last descent, for each part of the problem.
    residual : OutputErrorSet
        The residual whitened by this noise.
    local : Local or None
        The reduced problem at x, including priors; None after a stop.
    fixed_unknown : int or None
        Index of the fixed unknown, at the far end of a valley.
    """

    x: _Vector
    reason: str
    negative_log_likelihood: float
    noises: Sequence[NoiseModel]
    residual: OutputErrorSet
    local: Local | None
    fixed_unknown: int | None = None
