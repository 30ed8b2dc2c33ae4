"""Descents of the search for place and kind."""

from __future__ import annotations

from updyn.candidates.location.settings import LOCATION
from updyn.updating.fit.trust_region import TrustRegion

__all__ = ["make_descent"]


def make_descent(most_steps: int, tolerance: float = LOCATION.tolerance) -> TrustRegion:
    """Return the iteration of a fit whose residuals are in units of the noise."""
    return TrustRegion(most_steps, tolerance, min_decrease=LOCATION.least_decrease)
