"""Claims on a result from modes: whether it is plausible and predicts held-out modes.

docs/verdict.md gives the rules and the reasons for them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from updyn.correlation.figures import figure_text
from updyn.text_table import counted
from updyn.updating.judge.claim import Claim

__all__ = ["BAD", "HARM", "SMALL", "modes_plausible", "modes_predicted", "modes_said"]

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


def modes_said(after: _Figures) -> str:
    """Return a sentence on the agreement of modes of model and test after the fit."""
    paired, measured = int(after["modes_paired"]), int(after["modes_measured"])
    if "mac_min" not in after:
        off = after["frequency_error_rms"]
        return (
            f"{paired} of {measured} measured frequencies are paired with one of the model, in"
            f" their order, with an rms error of {off:.2g} %."
        )
    said = f"{paired} of {measured} measured modes resemble one of the model"
    if not paired:
        return said + "."
    off = after["frequency_error_rms"]
    least = figure_text("mac_min", after["mac_min"])
    close = int(after.get("modes_close", 0))
    of = f", that of {counted(close, 'close mode')} by subspaces" if close else ""
    lowest = f"; the lowest MAC is {least}{of}" if paired == measured else ""
    return f"{said}, with an rms error of frequency of {off:.2g} %{lowest}."


def modes_plausible(before: _Figures, after: _Figures) -> Claim:
    """Return whether the residual of modes permits a result.

    Parameters
    ----------
    before, after : mapping of str to float
        Figures of agreement before and after the fit.
    """
    paired, measured = after["modes_paired"], after["modes_measured"]
    said = modes_said(after)
    if paired < _MOST * measured or paired < before["modes_paired"]:
        fewer = f" (before the fit {int(before['modes_paired'])})" if paired else ""
        return Claim(False, f"Only {said.rstrip('.')}{fewer}.")
    off = after["frequency_error_rms"]
    was = before.get("frequency_error_rms", off)
    alike = paired == before["modes_paired"]
    if off > _GROSS or (alike and off > HARM * was and off > SMALL):
        return Claim(False, f"{said.rstrip('.')}; before the fit it was {was:.2g} %.")
    return Claim(True, said)


def modes_predicted(one: Mapping[str, Any]) -> Claim:
    """Return whether an updated model predicts held-out modes.

    Parameters
    ----------
    one : mapping
        Figures of a test, with ``after`` and ``validation``.
    """
    held, fitted = one["validation"]["after"], one.get("after", {})
    said = f"Of the held-out modes, {modes_said(held)}"
    if held["modes_paired"] < held["modes_measured"]:
        return Claim(False, said)
    off = held["frequency_error_rms"]
    if off > BAD and off > FAR_WORSE * fitted.get("frequency_error_rms", off):
        return Claim(
            False, f"{said.rstrip('.')}, of the fitted ones {fitted['frequency_error_rms']:.2g} %."
        )
    return Claim(True, said)
