"""The section of the report on parameter selection and regularisation."""

from __future__ import annotations

import numpy as np

from updyn.report.plots import Figure, drop_missing, encode_numbers
from updyn.report.section import PageContent, ReportSection
from updyn.updating.result import UpdateResult

__all__ = ["REGULARISATION", "trade_off"]

#: Descriptions of the choice of the regularisation strength.
_HOW = {
    "gcv": "chosen by generalised cross-validation",
    "l-curve": "chosen at the corner of the curve",
    "discrepancy": "chosen so that the misfit grows no more than the noise explains",
    "stated": "as stated",
}


class RegularisationSection(ReportSection):
    """Unknowns joined or excluded before the fit, and the regularisation of the fit."""

    anchor = "held"
    name = "Selection and regularisation"
    heading = "Selection and regularisation"
    place = 700
    template = "updyn.report/held.html"

    def applies(self, content: PageContent) -> bool:
        """Whether the page shows an update with a parameter selection or regularisation."""
        if content.update is None:
            return False
        options = content.result.options
        return bool(options.get("selection") or options.get("regularisation"))

    def figures(self, content: PageContent) -> dict[str, Figure]:
        """Return the trade-off curve of the regularisation."""
        return drop_missing({"trade-off": trade_off(content.result)})

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the records of selection and regularisation."""
        options = content.result.options
        regularisation = options.get("regularisation") or {}
        return {
            "selection": options.get("selection"),
            "regularisation": regularisation,
            "chosen_how": _HOW.get(regularisation.get("how", ""), ""),
        }


REGULARISATION = RegularisationSection()


def trade_off(result: UpdateResult) -> Figure | None:
    """Return the distance from the start over misfit; None without regularisation."""
    record = result.options.get("regularisation")
    if not record:
        return None
    steps, hover = record.get("strengths"), "strength %{text}"
    if record["how"] == "tsvd":
        steps, hover = record["numbers"], "%{text} directions"
    distance = np.asarray(record["distance"], dtype=np.float64)
    nonzero = np.flatnonzero(distance > 0.0)
    curve = {
        "type": "scatter",
        "mode": "lines+markers",
        "name": "choices",
        "x": encode_numbers(np.asarray(record["misfit"])[nonzero]),
        "y": encode_numbers(distance[nonzero]),
        "text": [f"{steps[i]:.3g}" for i in nonzero],
        "line": {"color": "@before"},
        "marker": {"size": 5},
        "hovertemplate": f"{hover}<br>misfit %{{x:.4g}}, distance %{{y:.3g}}<extra></extra>",
    }
    current = {
        "type": "scatter",
        "mode": "markers",
        "name": "this fit",
        "x": encode_numbers([record["misfit here"]]),
        "y": encode_numbers([record["distance here"]]),
        "marker": {"symbol": "diamond", "size": 12, "color": "@after"},
        "hovertemplate": "this fit: misfit %{x:.4g}, distance %{y:.3g}<extra></extra>",
    }
    return {
        "data": [curve, current],
        "height": 320,
        "layout": {
            "xaxis": {"title": {"text": "misfit"}, "type": "log"},
            "yaxis": {"title": {"text": "distance from the start"}, "type": "log"},
            "showlegend": True,
        },
    }
