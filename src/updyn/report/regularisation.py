"""The section of the report on what was held: unknowns joined or left out before the fit, and its regularisation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from updyn.report import formats as w
from updyn.report import markup as m
from updyn.report.plots import Figure, existing, numbers
from updyn.report.section import Content, Section
from updyn.updating.result import UpdateResult

__all__ = ["HELD", "trade_off"]

_HOW = {
    "gcv": "chosen by generalised cross-validation",
    "l-curve": "chosen at the corner of the curve",
    "discrepancy": "chosen so that the misfit grows no more than the noise explains",
    "stated": "as stated",
}


class Held(Section):
    """Selection before the fit, and its regularisation."""

    anchor = "held"
    name = "What was held"
    heading = "What was held"
    place = 700

    def applies(self, content: Content) -> bool:
        """Whether the page shows an update."""
        return content.update is not None

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return the trade-off of the regularisation."""
        return existing({"trade-off": trade_off(content.result)})

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return the section; empty where all unknowns were fitted freely."""
        selection, pull = (
            content.result.options.get(key) for key in ("selection", "regularisation")
        )
        if not selection and not pull:
            return ""
        parts = []
        if selection:
            parts.append(_selection(selection))
        if pull:
            parts.append(_pull(figures, pull))
        return "".join(parts)


HELD = Held()


def _selection(record: Mapping[str, Any]) -> str:
    parts = ["<h3>Selected before the fit</h3>"]
    if record["merged"]:
        rows = [
            m.row([name, ", ".join(members), w.number(float(record["cosines"][name]), 5)])
            for name, members in record["merged"].items()
        ]
        caption = (
            "Unknowns whose effects on the data are alike were joined. Cosine: the least between"
            " two of them."
        )
        parts.append(
            m.table(
                ["unknown", "stands for", "cosine"], rows, caption=caption, kinds=("", "text", "")
            )
        )
    if record["left out"]:
        rows = [m.row([name, why]) for name, why in record["left out"].items()]
        caption = (
            "These stay at their start, which the standard deviations of the others take for"
            " certain."
        )
        parts.append(m.table(["left out", "because"], rows, caption=caption, kinds=("", "text")))
    parts += [m.paragraph(f"{remark[0].upper()}{remark[1:]}.") for remark in record["remarks"]]
    return "".join(parts)


def _pull(figures: Mapping[str, Figure], record: Mapping[str, Any]) -> str:
    if record["how"] == "tsvd":
        said = (
            f"Truncated singular values: {record['kept']} of {record['of']} directions were fitted."
            " Along the others the unknowns stay at their start, which the standard deviations"
            " take for certain."
        )
    else:
        said = (
            "All unknowns without a prior of their own are pulled to their start as by one of"
            f" standard deviation {w.number(float(record['prior_std']), 3)} (strength"
            f" {w.number(float(record['strength']), 3)}, {_HOW[record['how']]}). The fit spends"
            f" {w.number(float(record['effective unknowns']), 3)} effective unknowns. Standard"
            " deviations count the pull as prior knowledge; the bias is not in them."
        )
    parts = ["<h3>Regularisation</h3>", m.paragraph(said)]
    if "trade-off" in figures:
        caption = (
            "Misfit in standard deviations of the noise against the distance of the unknowns from"
            " their start, for all strengths (or numbers of directions), on the problem linearised"
            " where the fit ended; the choice is marked."
        )
        height = figures["trade-off"]["height"]
        parts.append(
            m.figure("trade-off", "Distance from the start over misfit", caption, height=height)
        )
    return "".join(parts)


def trade_off(result: UpdateResult) -> Figure | None:
    """Distance from the start over misfit, with the choice; None where nothing was regularised."""
    record = result.options.get("regularisation")
    if not record:
        return None
    axis, said = (
        ("numbers", "%{text} directions")
        if record["how"] == "tsvd"
        else ("strengths", "strength %{text}")
    )
    shown = [i for i, d in enumerate(record["distance"]) if d > 0.0]
    curve = {
        "type": "scatter",
        "mode": "lines+markers",
        "name": "choices",
        "x": numbers([record["misfit"][i] for i in shown]),
        "y": numbers([record["distance"][i] for i in shown]),
        "text": [f"{record[axis][i]:.3g}" for i in shown],
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
