"""Claims on a result from modes, by the rules of docs/verdict.md."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from updyn.correlation.figures import figure_text
from updyn.text_table import format_count
from updyn.updating.judge.claim import Claim

__all__ = [
    "BAD",
    "HARM",
    "SMALL",
    "claim_modes_plausible",
    "claim_modes_predicted",
    "describe_modes",
]

_Figures = Mapping[str, float]

#: Least share of the measured modes with a counterpart in the model.
_MOST = 0.5
#: Rms frequency error in % above which no result is plausible; neighbouring modes of structures are
#: often this close.
_GROSS = 10.0
#: Ratio of the frequency error after to that before, above which an update did harm; and largest
#: error in % to which this does not apply.
HARM, SMALL = 1.1, 1.0
#: Ratio of the frequency error of held-out to fitted modes, and error of held-out modes in %, which
#: must both be exceeded for a failed prediction.
FAR_WORSE, BAD = 3.0, 3.0


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
    if paired < _MOST * measured or paired < before["modes_paired"]:
        fewer = f" (before the fit {int(before['modes_paired'])})" if paired else ""
        return Claim(False, f"Only {text.rstrip('.')}{fewer}.")
    error = after["frequency_error_rms"]
    error_before = before.get("frequency_error_rms", error)
    same_number_paired = paired == before["modes_paired"]
    if error > _GROSS or (same_number_paired and error > HARM * error_before and error > SMALL):
        return Claim(False, f"{text.rstrip('.')}; before the fit it was {error_before:.2g} %.")
    return Claim(True, text)


def claim_modes_predicted(figures: Mapping[str, Any]) -> Claim:
    """Return whether an updated model predicts held-out modes."""
    held, fitted = figures["validation"]["after"], figures.get("after", {})
    text = f"Of the held-out modes, {describe_modes(held)}"
    if held["modes_paired"] < held["modes_measured"]:
        return Claim(False, text)
    error = held["frequency_error_rms"]
    if error > BAD and error > FAR_WORSE * fitted.get("frequency_error_rms", error):
        return Claim(
            False, f"{text.rstrip('.')}, of the fitted ones {fitted['frequency_error_rms']:.2g} %."
        )
    return Claim(True, text)
