"""The figures of the report, as data for plotly: what is drawn, not how the page looks.

Each function returns a figure ``{"data": ..., "layout": ..., "height": ...}`` of plain lists, ready
for JSON, or None where there is nothing to draw. A colour is given by its part in the story
(``"@before"``); the style sheet says which it is on light and dark ground.
"""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.group import VALUES
from updyn.report.agreement import csac_lines, frac_map, level_differences, residual_by_channel
from updyn.report.data import ReportData, keep_lines
from updyn.report.plots import Figure, label, numbers
from updyn.report.residual import misfit_map
from updyn.report.sections_held import trade_off
from updyn.report.unknowns import (
    correlation_map,
    cost_path,
    estimates,
    singular_values,
    value_paths,
)
from updyn.report.words import figure_name, unit
from updyn.updating.result import UpdateResult

__all__ = ["DRAWING_BUDGET", "all_figures", "overlay"]

#: Bytes of FRFs that the page carries at most, before base64: about two thirds of the size of the
#: largest page.
DRAWING_BUDGET = 16_000_000


def all_figures(result: UpdateResult, data: ReportData) -> dict[str, Figure]:
    """Return every figure that has something to show, by the name of its place in the page."""
    factors = [p for p in result.parameters if p.is_factor and not p.is_channel]
    sensors = [p for p in result.parameters if p.is_channel]
    values = {kind: [p for p in result.parameters if p.value_of == kind] for kind in VALUES}
    made = {
        "frac-before": frac_map(data, data.frac_before),
        "frac-after": frac_map(data, data.frac_after),
        "csac": csac_lines(data),
        "factors": estimates(result, factors),
        **{f"{figure_name(kind)}s": estimates(result, chosen) for kind, chosen in values.items()},
        "calibrations": estimates(result, sensors),
        "singular-values": singular_values(result),
        "correlation": correlation_map(result),
        "trade-off": trade_off(result),
        "cost": cost_path(result),
        "factor-paths": value_paths(result, factors),
        **{
            f"{figure_name(kind)}-paths": value_paths(result, chosen)
            for kind, chosen in values.items()
        },
        "calibration-paths": value_paths(result, sensors),
        "level-differences": level_differences(data),
        "residual-by-channel": residual_by_channel(data),
        "misfit-map": misfit_map(result.adequacy),
    }
    return {name: figure for name, figure in made.items() if figure is not None}


def overlay(
    result: UpdateResult, data: ReportData, budget: int = DRAWING_BUDGET
) -> tuple[dict[str, Any], str]:
    """Return what the FRF overlay draws, and a note where lines were thinned to keep the page small.

    Parameters
    ----------
    result : UpdateResult
        The result.
    data : ReportData
        What `gather` made of it.
    budget : int
        Bytes of arrays at most.

    Returns
    -------
    dict
        ``freq`` (Hz) and ``measured``, ``before``, ``after``, ``coherence`` as base64 of
        little-endian float32, channel by channel (response, then reference), real and imaginary
        parts in turn; labels, units and bands.
    str
        The note, or an empty text.
    """
    n_channels = len(data.responses) * len(data.references)
    n_sets = 1 + (data.before is not None) + (data.after is not None)
    line_bytes = n_channels * (8 * n_sets + 4 * (data.coherence is not None))
    limit = max(budget // line_bytes, 50)
    keep = keep_lines(data.measured, data.used, limit)
    note = ""
    if keep.size < len(data.freq):
        note = (
            f"To keep this page small, {keep.size} of {len(data.freq)} lines are drawn in the"
            " overlay; the highest peaks are among them."
        )
    used = data.used[keep]
    payload: dict[str, Any] = {
        "freq": _packed(data.freq[keep], "<f8"),
        "measured": _channels(data.measured, keep),
        "before": _channels(data.before, keep),
        "after": _channels(data.after, keep),
        "coherence": (
            None
            if data.coherence is None
            else _packed(data.coherence[keep].transpose(1, 2, 0), "<f4")
        ),
        "responses": [label(r) for r in data.responses],
        "references": [label(r) for r in data.references],
        "fracBefore": None if data.frac_before is None else numbers(data.frac_before, packed=False),
        "fracAfter": None if data.frac_after is None else numbers(data.frac_after, packed=False),
        "heldOut": list(data.held_out),
        "quantity": data.quantity,
        "units": [[unit(data.quantity, r, c) for c in data.references] for r in data.responses],
        "used": np.flatnonzero(used).tolist(),
        "fitBand": (
            [float(result.lines.min()), float(result.lines.max())] if len(result.lines) else None
        ),
        "everyLineUsed": _every_line(data),
        "validationBand": (
            None if result.validation_band is None else list(map(float, result.validation_band))
        ),
    }
    return payload, note


def _every_line(data: ReportData) -> bool:
    """Whether the lines of the fit are all lines between the first and the last of them."""
    at = np.flatnonzero(data.used)
    return bool(at.size > 1 and at[-1] - at[0] + 1 == at.size)


def _channels(values: NDArray[np.complex128] | None, keep: NDArray[np.intp]) -> str | None:
    return None if values is None else _packed(values[keep].transpose(1, 2, 0), "<c8")


def _packed(array: NDArray[Any], dtype: str) -> str:
    return base64.b64encode(np.ascontiguousarray(array, dtype=dtype).tobytes()).decode("ascii")
