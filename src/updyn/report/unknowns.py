"""The section of the report on the values of the unknowns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from updyn.arrays import IndexArray, RealArray
from updyn.report.formats import (
    axis_title,
    change,
    estimate,
    figure_name,
    format_padded,
    interval,
    number,
    quantity_words,
)
from updyn.report.of_unknowns import ParameterSection, group_by_figure, list_kinds, name_unknowns
from updyn.report.plots import (
    MODEL_COLOURS,
    Figure,
    drop_missing,
    encode_numbers,
    error_bars,
    names_font,
    rows_height,
)
from updyn.report.section import PageContent
from updyn.updating.problem.parameters import Parameter
from updyn.updating.result import UpdateResult

__all__ = ["UNKNOWNS", "estimates"]


class UnknownsSection(ParameterSection):
    """The values of the unknowns with their uncertainty."""

    anchor = "unknowns"
    name = "Unknowns"
    heading = "Unknowns"
    place = 400
    template = "updyn.report/unknowns.html"

    def figures(self, content: PageContent) -> dict[str, Figure]:
        """Return the estimates of the kinds of unknowns that the figure of changes omits."""
        result = content.result
        made = {}
        for name, chosen in group_by_figure(result, "factors", "s", "calibrations").items():
            if any(p.start == 0.0 for p in chosen):  # a start of zero has no change in percent
                made[name] = estimates(result, chosen)
        return drop_missing(made)

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the rows of the tables and the titles of the figures."""
        parts: list[dict[str, Any]] = []
        sensors: list[dict[str, Any]] = []
        for parameter in content.result.parameters:
            rows = sensors if parameter.is_channel else parts
            rows.append(_parameter_row(content.result, parameter))
        titles = [("factors", "Factors, relative to their start")]
        for kind in list_kinds(content.result):
            titles.append((f"{figure_name(kind)}s", quantity_words(kind).capitalize()))
        head = [
            "quantity",
            "start",
            "value",
            "change",
            "std. dev.",
            "95 % interval",
            "bounds",
            "note",
        ]
        if not any(row["cells"][-1] for row in (*parts, *sensors)):  # omit an empty column
            head.pop()
            for row in (*parts, *sensors):
                row["cells"].pop()
        return {
            "head": head,
            "kinds": ("", "word", "", "", "", "", "", "", "note-cell"),
            "parts": parts,
            "sensors": sensors,
            "titles": titles,
        }


UNKNOWNS = UnknownsSection()


def _parameter_row(result: UpdateResult, parameter: Parameter) -> dict[str, object]:
    """Return the table cells of an unknown and the CSS class of its row."""
    p = parameter
    value, std = result.values[p.name], result.std[p.name]
    determined = math.isfinite(std)
    quantity = quantity_words(p.quantity)
    if p.value_unit:
        quantity += f" ({p.value_unit})"
    span = interval(p, value, std, result.noise.get("degrees_of_freedom"))
    interval_text = "open"
    if span is not None:
        interval_text = f"{estimate(span[0], std)} to {estimate(span[1], std)}"
    cells = [
        p.group,
        quantity,
        number(p.start),
        estimate(value, std),
        change(p, value),
        format_padded(std, 2) if determined else "–",
        interval_text,
        f"{number(p.lower, 3)} to {number(p.upper, 3)}",
        "; ".join(_parameter_notes(result, p)),
    ]
    marked = p.name in result.at_bound or not determined
    return {"cells": cells, "kind": "open" if marked else ""}


def _parameter_notes(result: UpdateResult, parameter: Parameter) -> list[str]:
    p = parameter
    value, std = result.values[p.name], result.std[p.name]
    notes = []
    if p.nominal is not None:
        notes.append(f"{p.physical(value, std)}, from {p.physical(p.start)}")
    if p.name in result.at_bound:
        notes.append(f"at its {result.at_bound[p.name]} bound")
    if not math.isfinite(std):
        notes.append(result.why_open(p.name))
    if p.drives:
        notes.append(f"acts on {p.law}")
    if p.prior_std is not None:
        notes.append(f"prior standard deviation {number(p.prior_std, 3)}")
    return notes


def estimates(result: UpdateResult, chosen: Sequence[Parameter]) -> Figure | None:
    """Return estimates of one kind of unknown with intervals and bounds; None without unknowns."""
    # Factors are shown relative to their start, on a logarithmic axis.
    if not chosen:
        return None
    relative = chosen[0].is_log
    rows = np.arange(len(chosen))
    start, values, low, high = np.full((4, len(chosen)), np.nan)
    limits = np.empty((len(chosen), 2))
    bound = np.empty(len(chosen), dtype=np.bool_)
    freedom = result.noise.get("degrees_of_freedom")
    for i, p in enumerate(chosen):
        start[i] = p.start
        values[i] = result.values[p.name]
        limits[i] = p.lower, p.upper
        bound[i] = p.name in result.at_bound
        span = interval(p, result.values[p.name], result.std[p.name], freedom)
        if span is not None:
            low[i], high[i] = span
    known = ~np.isnan(low)
    unit = start.copy() if relative else np.ones(len(chosen))
    values, low, high = values / unit, low / unit, high / unit
    limits /= unit[:, None]
    names = name_unknowns(chosen)
    view = _find_range(np.concatenate([values, low, high, start / unit]), log=relative)
    traces = [_start_trace(start / unit), _bound_trace(limits, view, rows)]
    styles = (
        ("estimate, 95 % interval", known & ~bound, "circle"),
        ("estimate at a bound", known & bound, "diamond"),
        ("not determined by the data", ~known, "x-thin-open"),
    )
    for name, where, symbol in styles:
        if where.any():
            at = np.flatnonzero(where)
            traces.append(_estimate_trace(name, values, low, high, at, symbol, names))
    title = axis_title(chosen[0])
    axis: dict[str, object] = {"title": {"text": title}, "range": list(view)}
    if relative:
        axis = {
            "title": {"text": f"{title} (log scale)"},
            "range": np.log10(view).tolist(),
            "type": "log",
            "tickvals": _log_ticks(view),
        }
    return {
        "data": traces,
        "height": rows_height(len(chosen), extra=130),
        "layout": {
            "xaxis": axis,
            "yaxis": {
                "tickvals": rows.tolist(),
                "ticktext": names,
                "range": [len(chosen) - 0.4, -0.6],
                "zeroline": False,
                "tickfont": names_font(names),
            },
            "showlegend": True,
        },
    }


def _start_trace(start: RealArray) -> dict[str, object]:
    return {
        "type": "scatter",
        "mode": "markers",
        "name": "start",
        "x": encode_numbers(start),
        "y": list(range(len(start))),
        "marker": {
            "symbol": "line-ns-open",
            "color": MODEL_COLOURS["start"],
            "size": 14,
            "line": {"width": 2},
        },
        "hovertemplate": "start %{x:.4g}<extra></extra>",
    }


def _estimate_trace(
    name: str,
    values: RealArray,
    low: RealArray,
    high: RealArray,
    at: IndexArray,
    symbol: str,
    names: list[str],
) -> dict[str, object]:
    colour = MODEL_COLOURS["updated"]
    trace: dict[str, object] = {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "x": encode_numbers(values[at]),
        "y": at.tolist(),
        "text": np.take(names, at).tolist(),
        "marker": {
            "symbol": symbol,
            "color": colour,
            "size": 10,
            "line": {"width": 2, "color": colour},
        },
        "hovertemplate": "%{text}: %{x:.5g}<extra></extra>",
    }
    if np.isfinite(low[at]).all():
        trace["error_x"] = error_bars(values[at] - low[at], high[at] - values[at], colour)
    return trace


def _bound_trace(
    limits: RealArray, view: tuple[float, float], rows: IndexArray
) -> dict[str, object]:
    inside = (limits > view[0]) & (limits < view[1])
    return {
        "type": "scatter",
        "mode": "markers",
        "name": "bound",
        "x": limits[inside].tolist(),
        "y": rows[np.nonzero(inside)[0]].tolist(),
        "marker": {"symbol": "line-ns-open", "color": "@muted", "size": 20, "line": {"width": 3}},
        "hovertemplate": "bound %{x:.4g}<extra></extra>",
    }


def _find_range(shown: RealArray, *, log: bool) -> tuple[float, float]:
    """Return the axis range with a margin; a logarithmic range is limited to 0.001 to 1000."""
    finite = shown[np.isfinite(shown)]
    if log:
        finite = finite[finite > 0]
    if not finite.size:
        return (0.5, 2.0) if log else (0.0, 1.0)
    low, high = float(finite.min()), float(finite.max())
    if log:
        low, high = max(low, 1e-3), min(high, 1e3)
        margin = max((high / low) ** 0.06, 1.03)
        return low / margin, high * margin
    margin = max(0.06 * (high - low), 1e-6 + 0.03 * abs(high))
    return low - margin, high + margin


def _log_ticks(view: tuple[float, float]) -> list[float]:
    """Return about 5 to 12 round ticks for a logarithmic axis."""
    low, high = view
    if high / low < 2.0:  # nearly linear
        return _even_ticks(low, high)
    steps: tuple[float, ...] = (1,)
    if high / low < 12:
        steps = (1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8)
    elif high / low < 1e3:
        steps = (1, 2, 5)
    ticks = []
    for power in range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1):
        for step in steps:
            tick = float(f"{step * 10.0**power:.6g}")
            if low <= tick <= high:
                ticks.append(tick)
    return ticks


def _even_ticks(low: float, high: float) -> list[float]:
    """Return about six ticks at multiples of 1, 2 or 5 times a power of 10."""
    rough = (high - low) / 6.0
    unit = 10.0 ** np.floor(np.log10(rough))
    step = unit * next(s for s in (1, 2, 5, 10) if s * unit >= rough)
    first, last = np.ceil(low / step), np.floor(high / step)
    return np.round(np.arange(first, last + 1) * step, 10).tolist()  # type: ignore[no-any-return]
