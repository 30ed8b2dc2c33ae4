"""The section of the report on parameter selection and regularisation."""

from __future__ import annotations

from typing import Any

import numpy as np

from updyn.report.plots import Figure, existing, numbers
from updyn.report.section import Content, Section
from updyn.updating.result import UpdateResult

__all__ = ["HELD", "trade_off"]

#: Descriptions of the choice of the regularisation strength.
_HOW = {
    "gcv": "chosen by generalised cross-validation",
    "l-curve": "chosen at the corner of the curve",
    "discrepancy": "chosen so that the misfit grows no more than the noise explains",
    "stated": "as stated",
}


class Held(Section):
    """Unknowns joined or excluded before the fit, and the regularisation of the fit."""

    anchor = "held"
    name = "Selection and regularisation"
    heading = "Selection and regularisation"
    place = 700
    template = "updyn.report/held.html"

    def applies(self, content: Content) -> bool:
        """Whether the page shows an update with a parameter selection or regularisation."""
        if content.update is None:
            return False
        options = content.result.options
        return bool(options.get("selection") or options.get("regularisation"))

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return the trade-off curve of the regularisation."""
        return existing({"trade-off": trade_off(content.result)})

    def context(self, content: Content) -> dict[str, Any]:
        """Return the records of selection and regularisation."""
        options = content.result.options
        regularisation = options.get("regularisation") or {}
        return {
            "selection": options.get("selection"),
            "regularisation": regularisation,
            "chosen_how": _HOW.get(regularisation.get("how", ""), ""),
        }


HELD = Held()


def trade_off(result: UpdateResult) -> Figure | None:
    """Return the trade-off curve: distance from the start over misfit, with the chosen point.

    None without regularisation.
    """
    record = result.options.get("regularisation")
    if not record:
        return None
    steps, said = record.get("strengths"), "strength %{text}"
    if record["how"] == "tsvd":
        steps, said = record["numbers"], "%{text} directions"
    distance = np.asarray(record["distance"], dtype=np.float64)
    moved = np.flatnonzero(distance > 0.0)
    curve = {
        "type": "scatter",
        "mode": "lines+markers",
        "name": "choices",
        "x": numbers(np.asarray(record["misfit"])[moved]),
        "y": numbers(distance[moved]),
        "text": [f"{steps[i]:.3g}" for i in moved],
        "line": {"color": "@before"},
        "marker": {"size": 5},
        "hovertemplate": f"{said}<br>misfit %{{x:.4g}}, distance %{{y:.3g}}<extra></extra>",
    }
    here = {
        "type": "scatter",
        "mode": "markers",
        "name": "this fit",
        "x": numbers([record["misfit here"]]),
        "y": numbers([record["distance here"]]),
        "marker": {"symbol": "diamond", "size": 12, "color": "@after"},
        "hovertemplate": "this fit: misfit %{x:.4g}, distance %{y:.3g}<extra></extra>",
    }
    return {
        "data": [curve, here],
        "height": 320,
        "layout": {
            "xaxis": {"title": {"text": "misfit"}, "type": "log"},
            "yaxis": {"title": {"text": "distance from the start"}, "type": "log"},
            "showlegend": True,
        },
    }
