"""Claims on a result from modes, by the rules of docs/verdict.md."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from updyn.correlation.figures import figure_text
from updyn.text_table import format_count
from updyn.updating.judge.claim import Claim
from updyn.updating.judge.settings import HELD_OUT, MODAL_TRUST, PLAUSIBILITY

__all__ = [
    "claim_modes_plausible",
    "claim_modes_predicted",
    "describe_modes",
]

_Figures = Mapping[str, float]


def describe_modes(after: _Figures) -> str:
    """Return a sentence on the agreement of modes of model and test after the fit."""
    paired, measured = int(after["modes_paired"]), int(after["modes_measured"])
    if "mac_min" not in after:
        error = after["frequency_error_rms"]
        return (
            f"{paired} of {measured} measured frequencies are paired with one of the model, in"
            f" their order, with an rms error of {error:.2g} %."
        )
    text = f"{paired} of {measured} measured modes resemble one of the model"
    if not paired:
        return text + "."
    error = after["frequency_error_rms"]
    least = figure_text("mac_min", after["mac_min"])
    close = int(after.get("modes_close", 0))
    in_subspaces = f", that of {format_count(close, 'close mode')} by subspaces" if close else ""
    lowest = f"; the lowest MAC is {least}{in_subspaces}" if paired == measured else ""
    return f"{text}, with an rms error of frequency of {error:.2g} %{lowest}."


def claim_modes_plausible(before: _Figures, after: _Figures) -> Claim:
    """Return whether the residual of modes permits a result."""
    paired, measured = after["modes_paired"], after["modes_measured"]
    text = describe_modes(after)
    if paired < MODAL_TRUST.least_paired_share * measured or paired < before["modes_paired"]:
        fewer = f" (before the fit {int(before['modes_paired'])})" if paired else ""
        return Claim(False, f"Only {text.rstrip('.')}{fewer}.")
    error = after["frequency_error_rms"]
    error_before = before.get("frequency_error_rms", error)
    is_worse = (
        paired == before["modes_paired"]
        and error > PLAUSIBILITY.harm_ratio * error_before
        and error > MODAL_TRUST.small_error
    )
    if is_worse or error > MODAL_TRUST.gross_error:
        return Claim(False, f"{text.rstrip('.')}; before the fit it was {error_before:.2g} %.")
    return Claim(True, text)


def claim_modes_predicted(figures: Mapping[str, Any]) -> Claim:
    """Return whether an updated model predicts held-out modes."""
    held, fitted = figures["validation"]["after"], figures.get("after", {})
    text = f"Of the held-out modes, {describe_modes(held)}"
    if held["modes_paired"] < held["modes_measured"]:
        return Claim(False, text)
    error = held["frequency_error_rms"]
    fitted_error = fitted.get("frequency_error_rms", error)
    if error > MODAL_TRUST.most_error and error > HELD_OUT.most_ratio * fitted_error:
        return Claim(False, f"{text.rstrip('.')}, of the fitted ones {fitted_error:.2g} %.")
    return Claim(True, text)
