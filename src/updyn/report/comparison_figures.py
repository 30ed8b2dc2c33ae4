"""The figures of a comparison of methods: FRFs by method, bars of error, time and work; data for plotly."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.comparison import Comparison, Row
from updyn.report.comparison_data import Curves, is_geometric
from updyn.report.plots import Figure, existing, label, labels, log_step, numbers, rows_height
from updyn.report.words import number, unit

__all__ = ["PAIR", "bar_figures", "frf_figures", "panel_name"]

#: The paper's method and the one that it compares with; shown together where both gave an answer.
PAIR = ("equation-error", "reduced-frf")
#: Measured lines up to this number are drawn as points: what lies between them was not measured.
_POINTS = 150
#: Bars of what is exactly 0 end here.
_FLOOR = 1e-16


def frf_figures(curves: Curves) -> dict[str, Figure]:
    """Return the FRFs by method, by the name of their place in the page."""
    out: dict[str, Figure] = {}
    pair = [name for name in PAIR if name in curves.after]
    if pair:
        out["pair"] = _overlay(curves, pair)
    for k, name in enumerate(curves.after):
        out[panel_name(k)] = _panel(curves, name)
    return out


def bar_figures(comparison: Comparison) -> dict[str, Figure]:
    """Return bars of error, misfit, time and work, by the name of their place in the page."""
    run = [row for row in comparison if row.applies]
    answered = [row for row in run if row.status != "failed"]
    made: dict[str, Figure | None] = {}
    if comparison.truth:
        made["error"] = _bars(
            answered, lambda r: r.error_max, "largest error of an unknown", comparison.tolerance
        )
    made["misfit"] = _bars(
        answered,
        lambda r: (r.fitted.get("after") or {}).get("db_error_median", math.nan),
        "median misfit (dB)",
    )
    made["seconds"] = _bars(run, lambda r: r.seconds, "seconds")
    made["work"] = _bars(run, lambda r: float(r.lines_solved), "lines solved")
    return existing(made)


def panel_name(number: int) -> str:
    """Return the name of the place of one method's FRF."""
    return f"panel-{number}"


# -- FRFs --------------------------------------------------------------------------------------------------
def _overlay(curves: Curves, names: Sequence[str]) -> Figure:
    """Measured, before, and after by some methods, in one figure."""
    colours = ("@after", "@third", "@fourth")
    traces = [_curve(curves, curves.before, "before", "@before", "dot")]
    for name, colour, dash in zip(names, colours, ("solid", "dash", "dashdot"), strict=False):
        traces.append(_curve(curves, curves.after[name], f"after, {name}", colour, dash))
    return _frame(curves, [*_measured(curves), *traces], 440)


def _panel(curves: Curves, name: str) -> Figure:
    traces = [
        _curve(curves, curves.before, "before", "@before", "dot"),
        _curve(curves, curves.after[name], "after", "@after", "solid"),
    ]
    return _frame(curves, [*_measured(curves), *traces], 290)


def _measured(curves: Curves) -> list[dict[str, Any]]:
    few = len(curves.lines) <= _POINTS
    style: dict[str, Any] = (
        {"mode": "markers", "marker": {"color": "@measured", "size": 7, "symbol": "circle-open"}}
        if few
        else {"mode": "lines", "line": {"color": "@measured", "width": 3}}
    )
    return [
        {
            "type": "scatter",
            "name": "measured",
            "x": numbers(curves.lines),
            "y": numbers(_size(curves.measured)),
            "hovertemplate": "%{x:.5g} Hz: measured %{y:.4g}<extra></extra>",
            **style,
        }
    ]


def _curve(
    curves: Curves, values: NDArray[np.complex128], name: str, colour: str, dash: str
) -> dict[str, Any]:
    return {
        "type": "scatter",
        "mode": "lines",
        "name": label(name),
        "x": numbers(curves.freq),
        "y": numbers(_size(values)),
        "line": {"color": colour, "width": 1.8, "dash": dash},
        "hovertemplate": f"%{{x:.5g}} Hz: {label(name)} %{{y:.4g}}<extra></extra>",
    }


def _size(values: NDArray[np.complex128]) -> NDArray[np.float64]:
    size = np.abs(values)
    return np.where(size > 0, size, np.nan)


def _frame(curves: Curves, traces: list[dict[str, Any]], height: int) -> Figure:
    x: dict[str, Any] = {"title": {"text": "frequency (Hz)"}}
    if is_geometric(curves.lines):
        x |= {"type": "log", "dtick": log_step(curves.lines)}
    both = np.concatenate(
        [_size(curves.measured), _size(curves.before), *map(_size, curves.after.values())]
    )
    measured = f"|H| ({unit(curves.quantity, curves.response, curves.reference)})"
    return {
        "data": traces,
        "height": height,
        "layout": {
            "xaxis": x,
            "yaxis": {
                "title": {"text": measured},
                "type": "log",
                "dtick": _step(log_step(both), height),
                "exponentformat": "power",
                "range": _range(both),
            },
            "showlegend": True,
        },
    }


def _step(step: int | str, height: int) -> int | str:
    return 2 * step if isinstance(step, int) and height < 300 else step


def _range(values: NDArray[np.float64]) -> list[float]:
    """Return a common range of all FRFs, in decades."""
    seen = np.log10(values[np.isfinite(values)])
    low, high = (float(v) for v in (seen.min(), seen.max())) if seen.size else (-1.0, 1.0)
    pad = max(0.04 * (high - low), 0.05)
    return [low - pad, high + pad]


# -- bars ----------------------------------------------------------------------------------------------------
def _bars(
    rows: Sequence[Row], value: Callable[[Row], float], title: str, mark: float | None = None
) -> Figure | None:
    """One bar a method on a log axis; a line at `mark`."""
    known = [(row.method, value(row)) for row in rows]
    known = [(name, v) for name, v in known if math.isfinite(v)]
    if not known:
        return None
    sizes = np.maximum([v for _, v in known], _FLOOR)
    whole = all(float(v).is_integer() for _, v in known)
    texts = [f"{v:.0f}" if whole else number(v, 2) for _, v in known]
    low, high = float(np.log10(sizes.min())), float(np.log10(sizes.max()))
    if mark is not None:
        low, high = min(low, math.log10(mark)), max(high, math.log10(mark))
    span = max(high - low, 1.0)
    view = [low - 0.12 * span, high + 0.22 * span]
    at = list(range(len(known)))
    trace = {
        "type": "bar",
        "orientation": "h",
        "x": sizes.tolist(),
        "y": at,
        "text": texts,
        "textposition": "outside",
        "cliponaxis": False,
        "marker": {"color": "@after"},
        "hovertext": [f"{label(name)}: {v:.4g}" for name, v in known],
        "hoverinfo": "text",
    }
    layout: dict[str, Any] = {
        "xaxis": {
            "title": {"text": title},
            "tickangle": 0,
            "type": "log",
            "range": view,
            "dtick": max(1, math.ceil(span / 6.0)) if span > 1.5 else "D2",
            "exponentformat": "power",
        },
        "yaxis": {
            "tickvals": at,
            "ticktext": labels(name for name, _ in known),
            "range": [len(known) - 0.4, -0.6],
            "zeroline": False,
            "showgrid": False,
        },
        "showlegend": False,
        "bargap": 0.35,
    }
    if mark is not None:
        layout["shapes"] = [_line(mark)]
    return {"data": [trace], "height": rows_height(len(known), extra=95), "layout": layout}


def _line(at: float) -> Mapping[str, Any]:
    return {
        "type": "line",
        "x0": at,
        "x1": at,
        "y0": 0,
        "y1": 1,
        "yref": "paper",
        "line": {"color": "@before", "dash": "dash", "width": 1.5},
    }
