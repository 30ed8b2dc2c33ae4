"""Figures of the pages, from the building blocks of the report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import BoolArray, NumberArray, RealArray
from updyn.report.plots import (
    MODEL_COLOURS,
    Figure,
    Panel,
    categories,
    curve,
    encode_numbers,
    escape_labels,
    linear_frequency,
    log_range,
    rows_height,
    stack_panels,
    thin_indices,
)
from updyn.style import CATEGORIES, STATES
from updyn.web.settings import WEB_PAGE

__all__ = ["SCALES", "cost_chart", "edges", "frf_chart", "parameter_chart", "unused_bands"]

#: Unit of the FRFs of translations by quantity, in SI, and the reference of their decibels.
_UNITS = {"receptance": "m/N", "mobility": "m/s/N", "accelerance": "m/s²/N"}
#: How magnitudes are drawn.
SCALES = {"log": "logarithmic", "dB": "decibels", "linear": "linear"}
#: Styles of curves by name: measured data are wide, such that a fitted curve stays visible.
_STYLES: Mapping[str, dict[str, Any]] = {
    "measured": {"width": 4.5},
    "start": {"width": 1.4, "dash": "dot"},
}


def frf_chart(
    quantity: str,
    curves: Mapping[str, tuple[RealArray, NumberArray]],
    *,
    scale: str = "log",
    coherence: ArrayLike | None = None,
    band: tuple[float, float] | None = None,
    excluded: Iterable[tuple[float, float]] = (),
    pickable: bool = False,
    points: int | None = None,
) -> Figure:
    """Return the magnitudes of FRFs over frequency in Hz.

    The first curve is measured; the names ``start`` and ``updated`` have fixed colours. `coherence`
    is that of the first curve, nan if unknown. `band` and `excluded` (Hz) are shaded. If
    `pickable`, a drag selects a band and a click selects a frequency. A curve has at most `points`
    points, by default `WEB_PAGE.curve_points`.
    """
    points = WEB_PAGE.curve_points if points is None else points
    colours = [STATES["measured"], *CATEGORIES]
    many = len(curves) > len(colours)
    unit = "dB" if scale == "dB" else _UNITS.get(quantity, "")
    traces: list[dict[str, Any]] = []
    levels = [np.empty(0)]
    for number, (name, (freq, values)) in enumerate(curves.items()):
        level = _scale_magnitude(np.abs(values), scale)
        at = thin_indices(level, points)
        colour = f"@{STATES.get(name, colours[number % len(colours)])}"
        style = _STYLES.get(name, {"width": 0.8 if many else 1.6})
        traces.append(curve(freq[at], level[at], name, colour, unit=unit, legend=not many, **style))
        levels.append(level)
    axis = log_range(np.concatenate(levels)) if scale == "log" else {}
    panels = [Panel(_level_title(quantity, scale), traces, axis)]
    if coherence is not None:
        freq, _ = next(iter(curves.values()))
        panels.append(_coherence_panel(freq, np.asarray(coherence, dtype=np.float64)))
    lines = np.concatenate([np.empty(0), *(freq for freq, _ in curves.values())])
    x: dict[str, Any] = {"title": {"text": "frequency (Hz)"}}
    if lines.size:
        x = linear_frequency([lines.min(), lines.max()])
    figure = stack_panels(panels, x, height=400 if coherence is None else 500)
    shapes = [_shade(low, high, "@held-band") for low, high in excluded]
    if band is not None:
        shapes.append(_shade(*band, "@fit-band"))
    figure["layout"]["shapes"] = shapes
    if pickable:
        figure["layout"] |= {
            "dragmode": "select",
            "selectdirection": "h",
            "newselection": {"line": {"color": "@link"}},
            "clickanywhere": True,
        }
    return figure


def _level_title(quantity: str, scale: str) -> str:
    unit = _UNITS.get(quantity, "")
    if scale == "dB":
        unit = f"dB re 1 {unit}" if unit else "dB"
    return f"|{quantity}| ({unit})" if unit else f"|{quantity}|"


def _scale_magnitude(magnitude: RealArray, scale: str) -> RealArray:
    """Return magnitudes as drawn; nan, a gap, for zeros on a logarithmic scale."""
    if scale == "linear":
        return magnitude
    level = np.where(magnitude > 0.0, magnitude, np.nan)
    return 20.0 * np.log10(level) if scale == "dB" else level


def _coherence_panel(freq: RealArray, values: RealArray) -> Panel:
    at = thin_indices(values, WEB_PAGE.curve_points)
    trace = curve(freq[at], values[at], "coherence", "@muted", legend=False, width=1.2)
    return Panel("coherence (1)", [trace], {"range": [0, 1.05], "tickvals": [0, 0.5, 1]}, 0.3)


def _shade(low: float, high: float, colour: str) -> dict[str, Any]:
    return {
        "type": "rect",
        "xref": "x",
        "x0": low,
        "x1": high,
        "yref": "paper",
        "y0": 0,
        "y1": 1,
        "layer": "below",
        "fillcolor": colour,
        "line": {"width": 0},
    }


def edges(freq: RealArray, first: int, last: int) -> tuple[float, float]:
    """Return a band in Hz with the lines `first` to `last` and no others, even if rounded."""
    steps = np.diff(freq) if len(freq) > 1 else 1e-3 * freq
    low = freq[first] - 0.5 * steps[max(first - 1, 0)]
    high = freq[last] + 0.5 * steps[min(last, len(steps) - 1)]
    return max(0.0, float(low)), float(high)


def unused_bands(freq: RealArray, used: BoolArray) -> list[tuple[float, float]]:
    """Return the bands (see `edges`) of unused lines between the first and the last used line."""
    at = np.flatnonzero(used)
    gaps = [(a, b) for a, b in pairwise(at.tolist()) if b > a + 1]
    return [edges(freq, before + 1, after - 1) for before, after in gaps]


def cost_chart(steps: Sequence[Mapping[str, Any]]) -> Figure:
    """Return the misfit over the steps of a run, with one curve per stage."""
    stages: dict[str, dict[int, float]] = {}
    for number, step in enumerate(steps):
        if step["cost"] is not None and step["cost"] > 0:
            stages.setdefault(step["stage"], {})[number] = step["cost"]
    look = {"mode": "lines+markers", "hovertemplate": "step %{x}: %{y:.4g}"}
    traces = [
        curve(list(costs), list(costs.values()), name, f"@{CATEGORIES[i % len(CATEGORIES)]}") | look
        for i, (name, costs) in enumerate(stages.items())
    ]
    axis = log_range([cost for costs in stages.values() for cost in costs.values()])
    panel = Panel("misfit of the stage (1)", traces, axis)
    x: dict[str, Any] = {"title": {"text": "step"}}
    if len(steps) <= 6:
        x["dtick"] = 1
    return stack_panels([panel], x, height=300)


def parameter_chart(start: Mapping[str, float], now: Mapping[str, float]) -> Figure:
    """Return the ratios of the unknowns to their start; unknowns with start 0 are omitted."""
    names = [name for name, value in start.items() if value and name in now]
    bars = {
        "type": "bar",
        "orientation": "h",
        "x": encode_numbers([now[name] / start[name] for name in names], packed=False),
        "y": list(range(len(names))),
        "marker": {"color": MODEL_COLOURS["updated"]},
        "showlegend": False,
        "hovertext": escape_labels(names),
        "hovertemplate": "%{hovertext}: %{x:.6g}<extra></extra>",
    }
    axis = categories(names, "") | {"range": [len(names) - 0.4, -0.6]}
    x = {"title": {"text": "value / start (1)"}}
    return stack_panels([Panel("", [bars], axis)], x, rows_height(len(names), extra=100))
