"""`Answer`: the end of a descent with its likelihood, noise and local problem."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from updyn.arrays import RealArray
from updyn.updating.problem.local import Local
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.residuals import OutputErrorSet

__all__ = ["Answer"]


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """End of a descent.

    `negative_log_likelihood` omits a constant that all answers share. `noises` are the noise models
    of the last descent by part, `residual` is whitened by them. `local` is the reduced problem at
    x, including priors; None after a stop. `fixed_unknown` is set at the far end of a valley.
    """

    x: RealArray
    reason: str
    negative_log_likelihood: float
    noises: Sequence[NoiseModel]
    residual: OutputErrorSet
    local: Local | None
    fixed_unknown: int | None = None
