"""Numbers that decide how a model is compared with the limits of acceptance."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["MODEL_ACCEPTANCE"]


@dataclass(frozen=True)
class AcceptanceSettings:
    """Numbers of probabilities and effective masses."""

    #: [1] Largest square of a deviation, in standard deviations, for which the noncentral
    #: chi-square distribution is evaluated; above it, the deviation is normal. Rounding: the series
    #: of the distribution converges up to about 1e8, and both agree to 1e-4 at this value.
    largest_square: float = 1e6
    #: [1] Cosine below which two shapes are orthogonal. Rounding: far below every limit.
    least_cosine: float = 1e-6
    #: [values] Least number of similarities with other modes that are shrunk together. Why: the
    #: estimate by Morris (1983) is defined from 4 values on.
    least_shrunk: int = 4
    #: [modes] Number of lowest measured modes that are fundamental unless stated. Default: one
    #: mode is fundamental in any case.
    fundamental_modes: int = 1


MODEL_ACCEPTANCE = AcceptanceSettings()
