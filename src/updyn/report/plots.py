"""Building blocks of plotly figures as plain data: arrays, labels, axes, and stacked panels."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from updyn import style
from updyn.arrays import ComplexArray, IndexArray, NumberArray, RealArray
from updyn.report.formats import number
from updyn.style import colour_scale

__all__ = [
    "DIVERGING",
    "MODEL_COLOURS",
    "SEQUENTIAL",
    "Figure",
    "Panel",
    "Trace",
    "band_traces",
    "categories",
    "colour_bar",
    "curve",
    "drop_missing",
    "encode_array",
    "encode_numbers",
    "error_bars",
    "escape_label",
    "escape_labels",
    "level_line",
    "linear_frequency",
    "log_bars",
    "log_frequency",
    "log_range",
    "log_step",
    "names_font",
    "phases",
    "rows_height",
    "stack_panels",
    "thin_indices",
    "wrapped_phase",
]

#: Keys ``data``, ``layout`` and ``height``, built from plain lists and ready for JSON.
Figure = dict[str, Any]
#: A curve of a figure.
Trace = dict[str, Any]

#: Length of the bar for an exact 0 on a logarithmic axis.
_FLOOR = 1e-16
#: Gap between panels, as a fraction of the height.
_GAP = 0.035
#: Write tick labels as powers of 10 (plotly's default is SI prefixes such as 2µ).
_POWERS = {"exponentformat": "power", "showexponent": "all"}
#: Colours of the start and the updated model.
MODEL_COLOURS = {name: f"@{style.STATES[name]}" for name in ("start", "updated")}
#: Colour scale from -1 to 1, orange below zero and blue above, and colour scale from 0 to 1.
DIVERGING = colour_scale(style.DIVERGING)
SEQUENTIAL = colour_scale(style.SEQUENTIAL)


def drop_missing(made: Mapping[str, Figure | None]) -> dict[str, Figure]:
    """Return the figures that are not None, by name."""
    return {name: figure for name, figure in made.items() if figure is not None}


def escape_label(text: str) -> str:
    """Return `text` escaped for plotly, which interprets HTML in labels."""
    return html.escape(text, quote=False)


def escape_labels(texts: Iterable[str]) -> list[str]:
    """Return `texts` escaped for plotly."""
    return list(map(escape_label, texts))


def encode_numbers(values: ArrayLike, *, packed: bool = True) -> object:
    """Return an array for plotly: a list (None if not finite), or base64 float32 if long."""
    array = np.asarray(values, dtype=np.float64)
    if array.size <= 400 or not packed:
        listed = array.astype(object)
        listed[~np.isfinite(array)] = None
        return listed.tolist()
    out = {"dtype": "f4", "bdata": encode_array(array, "<f4")}
    if array.ndim > 1:
        out["shape"] = ", ".join(map(str, array.shape))
    return out


def encode_array(array: NumberArray, dtype: str) -> str:
    """Return an array as base64 text of a number type."""
    return base64.b64encode(np.ascontiguousarray(array, dtype=dtype).tobytes()).decode("ascii")


def error_bars(minus: ArrayLike, plus: ArrayLike, colour: str) -> dict[str, object]:
    """Return asymmetric error bars along x."""
    return {
        "type": "data",
        "symmetric": False,
        "array": encode_numbers(plus),
        "arrayminus": encode_numbers(minus),
        "color": colour,
        "thickness": 1.6,
        "width": 4,
    }


def colour_bar(title: str, ticks: Sequence[float], height: int) -> dict[str, object]:
    """Return a colour bar at the top right of a heat map, with a length of 110 to 280 pixels."""
    return {
        "title": {"text": title, "side": "right", "font": {"size": style.FIGURE_TEXT}},
        "thickness": 12,
        "tickvals": list(ticks),
        "lenmode": "pixels",
        "len": min(max(height - 80, 110), 280),
        "y": 1.0,
        "yanchor": "top",
    }


def log_step(values: ArrayLike) -> int | str:
    """Return the tick step of a log axis: decades, or 1, 2, 5 if it spans two decades or less."""
    array = np.asarray(values, dtype=np.float64)
    array = array[np.isfinite(array) & (array > 0)]
    if not array.size or array.max() <= 100.0 * array.min():
        return "D2"
    return int(np.ceil(np.log10(array.max() / array.min()) / 10.0))


def rows_height(n: int, extra: int) -> int:
    """Return the height in pixels of a figure with `n` rows; many rows are spaced more closely."""
    row = 34
    if n > 12:
        row = 22
    if n > 40:
        row = 14
    return extra + n * row


def names_font(names: Sequence[str]) -> dict[str, object]:
    """Return the font of the names along an axis; smaller for more than 40 names."""
    return {"size": 12 if len(names) <= 40 else 9}


def categories(names: Sequence[str], title: str) -> dict[str, object]:
    """Return an axis with one named tick for each of `names`, at 0, 1, 2, ..."""
    return {
        "title": {"text": title},
        "tickvals": list(range(len(names))),
        "ticktext": escape_labels(names),
        "showgrid": False,
        "zeroline": False,
        "tickfont": names_font(names),
    }


# -- panels --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Panel:
    """One panel of a stacked figure.

    `axis` holds settings of the y axis, `share` the relative height, `marks` the positions of
    horizontal lines.
    """

    title: str
    traces: list[Trace]
    axis: dict[str, Any] = field(default_factory=dict)
    share: float = 1.0
    marks: tuple[float, ...] = ()


def stack_panels(
    panels: Sequence[Panel], x: dict[str, Any], height: int, marks: Sequence[float] = ()
) -> Figure:
    """Return panels over a common x axis, `height` in pixels, with vertical lines at `marks`."""
    total = sum(p.share for p in panels)
    room = 1.0 - _GAP * (len(panels) - 1)
    traces: list[Trace] = []
    layout: dict[str, Any] = {"showlegend": True, "hovermode": "closest"}
    shapes: list[dict[str, object]] = []
    top = 1.0
    axis = "y"
    for place, panel in enumerate(panels, 1):
        axis = "y" if place == 1 else f"y{place}"
        bottom = max(top - room * panel.share / total, 0.0)
        layout[f"yaxis{axis[1:]}"] = {
            "domain": [bottom, top],
            "anchor": "x",
            "zeroline": False,
            **_POWERS,
            "title": {"text": panel.title, "font": {"size": 12}},
            **panel.axis,
        }
        for trace in panel.traces:
            traces.append(trace | {"xaxis": "x", "yaxis": axis})
        for at in panel.marks:
            shapes.append(_horizontal_line(axis, at))
        top = bottom - _GAP
    shapes += map(_vertical_line, marks)
    layout["xaxis"] = {"anchor": axis, "zeroline": False, **x}
    if shapes:
        layout["shapes"] = shapes
    return {"data": traces, "height": height, "layout": layout}


def linear_frequency(freq: ArrayLike) -> dict[str, object]:
    """Return a linear frequency axis over lines in Hz, with a margin for markers at both ends."""
    lines = np.asarray(freq, dtype=np.float64)
    low, high = float(lines[0]), float(lines[-1])
    margin = 0.01 * (high - low) or 0.01 * high
    return {
        "title": {"text": "frequency (Hz)"},
        "range": [low - margin, high + margin],
        "zeroline": False,
    }


def log_frequency(freq: ArrayLike, title: str = "frequency (Hz)") -> dict[str, object]:
    """Return a logarithmic frequency axis over lines in Hz."""
    lines = np.asarray(freq, dtype=np.float64)
    lines = lines[lines > 0]
    low, high = float(np.log10(lines[0])), float(np.log10(lines[-1]))
    marks = (1.0, 2.0, 5.0) if high - low <= 2.3 else (1.0,)
    every = max(1, int(np.ceil((high - low) / 8.0)))
    ticks = []
    for decade in range(int(np.floor(low)), int(np.ceil(high)) + 1, every):
        for mark in marks:
            if low - 1e-9 <= np.log10(mark) + decade <= high + 1e-9:
                ticks.append(mark * 10.0**decade)
    axis: dict[str, object] = {"title": {"text": title}, "type": "log", "range": [low, high]}
    if len(ticks) < 2:  # a narrow band
        return axis | {"dtick": log_step(lines)}
    return axis | {"tickvals": ticks, "ticktext": [f"{t:g}" for t in ticks]}


def log_range(values: ArrayLike, decades: float = 9.0) -> dict[str, Any]:
    """Return a logarithmic y axis for the positive values, limited to the upper `decades`."""
    array = np.asarray(values, dtype=np.float64)
    array = array[np.isfinite(array) & (array > 0)]
    if not array.size:
        return {"type": "log"}
    low, high = np.log10([array.min(), array.max()])
    low = max(low, high - decades)
    pad = max(0.05 * (high - low), 0.08)
    step = log_step(array)
    if isinstance(step, int):
        step = max(1, int(np.ceil((high - low) / 5.0)))
    elif high - low + 2.0 * pad < 0.7:
        step = "D1"
    return {
        "type": "log",
        "range": [low - pad, high + pad],
        "dtick": step,
        "exponentformat": "power",
    }


def curve(
    x: ArrayLike,
    y: ArrayLike,
    name: str,
    colour: str,
    *,
    unit: str = "",
    dash: str = "solid",
    legend: bool = True,
    width: float = 1.8,
) -> dict[str, object]:
    """Return the trace of a curve with gaps at non-finite values; a single line is a marker."""
    drawn: dict[str, Any] = {"mode": "lines"}
    if np.size(x) == 1:
        drawn = {"mode": "markers", "marker": {"color": colour, "size": 7}}
    hover = f"%{{x:.5g}} Hz: {escape_label(name)} %{{y:.4g}} {escape_label(unit)}".rstrip()
    return {
        "type": "scatter",
        **drawn,
        "name": escape_label(name),
        "legendgroup": escape_label(name),
        "showlegend": legend,
        "x": encode_numbers(x),
        "y": encode_numbers(y),
        "line": {"color": colour, "width": width, "dash": dash},
        "hovertemplate": f"{hover}<extra></extra>",
    }


def band_traces(
    x: ArrayLike, low: ArrayLike, high: ArrayLike, name: str, *, legend: bool = True
) -> list[dict[str, object]]:
    """Return the traces of a band between two finite curves, with zeros replaced for log axes."""
    tiny = float(np.finfo(np.float32).tiny)
    edge: dict[str, object] = {
        "type": "scatter",
        "mode": "lines",
        "x": encode_numbers(x),
        "hoverinfo": "skip",
        "line": {"width": 0, "color": "@after"},
        "legendgroup": escape_label(name),
    }
    lower = {"y": encode_numbers(_avoid_zeros(low, tiny)), "showlegend": False}
    upper = {
        "name": escape_label(name),
        "y": encode_numbers(_avoid_zeros(high, tiny)),
        "showlegend": legend,
        "fill": "tonexty",
        "fillcolor": "@after-faint",
    }
    return [edge | lower, edge | upper]


def _avoid_zeros(values: ArrayLike, tiny: float) -> RealArray:
    array = np.asarray(values, dtype=np.float64)
    return np.where(np.abs(array) < tiny, tiny, array)


def thin_indices(values: ArrayLike, limit: int) -> IndexArray:
    """Return ascending positions of the minimum and maximum of each interval, at most `limit`."""
    # An interval with nan has the position of one in addition, such that gaps are preserved.
    array = np.asarray(values, dtype=np.float64)
    if len(array) <= limit:
        return np.arange(len(array))
    edges = np.linspace(0, len(array), limit // 2).round().astype(np.intp)
    missing = np.isnan(array)
    low, high = np.where(missing, np.inf, array), np.where(missing, -np.inf, array)
    found = [0, len(array) - 1]
    for a, b in pairwise(edges):
        found += [int(a + np.argmin(low[a:b])), int(a + np.argmax(high[a:b]))]
        found += (a + np.flatnonzero(missing[a:b])[:1]).tolist()
    return np.unique(found)


def phases(first: ComplexArray, *others: ComplexArray) -> list[RealArray]:
    """Return the unwrapped phase of `first` and the nearest phases of `others`, in degrees."""
    with np.errstate(invalid="ignore"):
        base = np.unwrap(np.angle(first))
        out = [np.degrees(base)]
        for other in others:
            out.append(np.degrees(base + np.angle(other * np.conj(first))))
    return out


def wrapped_phase(x: ArrayLike, H: ComplexArray) -> tuple[RealArray, RealArray]:
    """Return lines and phase within ±180 degrees, with gaps at wraps and zeros of the FRF."""
    lines = np.asarray(x, dtype=np.float64)
    degrees = np.where(H == 0.0, np.nan, np.degrees(np.angle(H)))
    after = np.flatnonzero(np.abs(np.diff(degrees)) > 180.0) + 1
    return np.insert(lines, after, lines[after]), np.insert(degrees, after, np.nan)


def level_line(x: ArrayLike, at: float, name: str) -> dict[str, object]:
    """Return a dashed horizontal line over all lines."""
    ends = np.asarray(x, dtype=np.float64)[[0, -1]]
    return curve(ends, [at, at], name, "@before", dash="dash", width=1.5)


def _horizontal_line(axis: str, at: float) -> dict[str, object]:
    line = {"color": "@muted", "dash": "dot", "width": 1}
    return {
        "type": "line",
        "xref": "paper",
        "x0": 0,
        "x1": 1,
        "yref": axis,
        "y0": at,
        "y1": at,
        "line": line,
    }


def _vertical_line(at: float) -> dict[str, object]:
    line = {"color": "@muted", "dash": "dot", "width": 1}
    return {
        "type": "line",
        "xref": "x",
        "x0": at,
        "x1": at,
        "yref": "paper",
        "y0": 0,
        "y1": 1,
        "line": line,
    }


# -- bars ----------------------------------------------------------------------------------------


def log_bars(values: Mapping[str, float], title: str, mark: float | None = None) -> Figure | None:
    """Return logarithmic bars of the finite values with a line at `mark`; None without any."""
    known = {name: v for name, v in values.items() if math.isfinite(v)}
    if not known:
        return None
    sizes = np.maximum(list(known.values()), _FLOOR)
    ends = sizes
    if mark is not None:
        ends = np.append(sizes, mark)
    low, high = float(np.log10(ends.min())), float(np.log10(ends.max()))
    span = max(high - low, 1.0)
    step: int | str = "D2"
    if span > 3.0:
        step = math.ceil(span / 2.5)  # three or four labels fit the 130 px in print
    elif span > 1.5:
        step = 1
    rows = list(range(len(known)))
    trace = {
        "type": "bar",
        "orientation": "h",
        "x": sizes.tolist(),
        "y": rows,
        "text": _format_bars(list(known.values())),
        "textposition": "outside",
        "cliponaxis": False,
        "marker": {"color": "@after"},
        "hovertext": [f"{escape_label(name)}: {v:.4g}" for name, v in known.items()],
        "hoverinfo": "text",
    }
    layout: dict[str, Any] = {
        "xaxis": {
            "title": {"text": title},
            "tickangle": 0,
            "type": "log",
            "range": [low - 0.12 * span, high + 0.22 * span],
            "dtick": step,
            "exponentformat": "power",
        },
        "yaxis": {
            "tickvals": rows,
            "ticktext": escape_labels(known),
            "range": [len(known) - 0.4, -0.6],
            "zeroline": False,
            "showgrid": False,
        },
        "showlegend": False,
        "bargap": 0.35,
    }
    if mark is not None:
        layout["shapes"] = [_mark_line(mark)]
    return {"data": [trace], "height": rows_height(len(known), extra=95), "layout": layout}


def _format_bars(values: Sequence[float]) -> list[str]:
    """Return the values as text, without decimals if all are integers."""
    if all(float(v).is_integer() for v in values):
        return [f"{v:.0f}" for v in values]
    return [number(v, 2) for v in values]


def _mark_line(at: float) -> Mapping[str, object]:
    return {
        "type": "line",
        "x0": at,
        "x1": at,
        "y0": 0,
        "y1": 1,
        "yref": "paper",
        "line": {"color": "@before", "dash": "dash", "width": 1.5},
    }
