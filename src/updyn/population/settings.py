"""Numbers that decide how the scatter of specimens is estimated."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["SCATTER"]


@dataclass(frozen=True)
class ScatterSettings:
    """Numbers of the estimation of a covariance over specimens."""

    #: [1] Scaled standard deviation from which the search begins. Effort: any positive number; the
    #: gradient vanishes at 0.
    start: float = 0.5
    #: [1] Largest derivative of the log-likelihood by a scaled standard deviation at the end.
    #: Rounding: far below the curvature, of the order of the number of specimens.
    gradient: float = 1e-6
    #: [1] Significance at which specimens are reported to differ. Default: the usual one.
    significance: float = 0.01


SCATTER = ScatterSettings()
