"""The remark on intervals that include noise only, although the model has errors."""

from __future__ import annotations

from updyn.updating.result import UpdateResult

__all__ = ["model_error_of", "model_error_remark"]


def model_error_of(result: UpdateResult) -> float:
    """Return the share of the residual that errors of the model explain; 0 if they show none."""
    return float(result.noise.get("model_error", 0.0))


def model_error_remark(share: float) -> str:
    """Return the remark on intervals without the error of the model; empty if the share is 0."""
    if share == 0.0:
        return ""
    return (
        "These intervals include noise only. The residual shows an error of the model, which the"
        " standard deviations of the update include: use the wider of the two."
    )
