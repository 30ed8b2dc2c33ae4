"""Parts of plotly figures: arrays, labels and axes as data; panels over one frequency axis."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from updyn import style
from updyn.report.formats import number
from updyn.style import colour_scale

__all__ = [
    "DIVERGING",
    "MODEL_COLOURS",
    "PRINTED_CELLS",
    "SEQUENTIAL",
    "Figure",
    "Panel",
    "band_traces",
    "categories",
    "colour_bar",
    "curve",
    "error_bars",
    "existing",
    "label",
    "labels",
    "level_line",
    "linear_frequency",
    "log_bars",
    "log_frequency",
    "log_range",
    "log_step",
    "names_font",
    "numbers",
    "phases",
    "rows_height",
    "stacked",
    "with_peaks",
    "wrapped_phase",
]

#: ``{"data": ..., "layout": ..., "height": ...}`` of plain lists, ready for JSON.
Figure = dict[str, Any]

#: Bars of what is exactly 0 end here.
_FLOOR = 1e-16
#: Gap between panels, as a share of the height.
_GAP = 0.035
#: Ticks as powers of 10, where plotly would write 2µ.
_POWERS = {"exponentformat": "power", "showexponent": "all"}
#: Colours of the two models.
MODEL_COLOURS = {name: f"@{style.STATES[name]}" for name in ("start", "updated")}
#: Colours of a scale from -1 to 1, orange below zero and blue above, and of one from 0 to 1.
DIVERGING = colour_scale(style.DIVERGING)
SEQUENTIAL = colour_scale(style.SEQUENTIAL)
#: Heat maps with up to this many cells have their values printed.
PRINTED_CELLS = 150


def existing(made: Mapping[str, Figure | None]) -> dict[str, Figure]:
    """Return the figures that have something to show, by name."""
    return {name: figure for name, figure in made.items() if figure is not None}


def label(text: str) -> str:
    """Return `text` escaped for plotly, which interprets HTML in labels."""
    return html.escape(text, quote=False)


def labels(texts: Iterable[str]) -> list[str]:
    """Return each of `texts` as `label` does."""
    return list(map(label, texts))


def numbers(values: ArrayLike, *, packed: bool = True) -> Any:
    """Return an array for plotly.

    Parameters
    ----------
    values : array_like of float
        The numbers.
    packed : bool
        Whether a long array may be packed.

    Returns
    -------
    list or dict
        A list, with None for what is not finite; of a long array float32 as base64.
    """
    array = np.asarray(values, dtype=np.float64)
    if array.size <= 400 or not packed:
        listed = array.astype(object)
        listed[~np.isfinite(array)] = None
        return listed.tolist()
    text = base64.b64encode(np.ascontiguousarray(array, dtype="<f4").tobytes()).decode("ascii")
    out = {"dtype": "f4", "bdata": text}
    if array.ndim > 1:
        out["shape"] = ", ".join(map(str, array.shape))
    return out


def error_bars(minus: ArrayLike, plus: ArrayLike, colour: str) -> dict[str, Any]:
    """Return error bars along x, of different lengths either way."""
    return {
        "type": "data",
        "symmetric": False,
        "array": numbers(plus),
        "arrayminus": numbers(minus),
        "color": colour,
        "thickness": 1.6,
        "width": 4,
    }


def colour_bar(title: str, ticks: Sequence[float], height: int) -> dict[str, Any]:
    """Return a colour bar beside the top of a heat map, of a readable length."""
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
    """Return the marks of a log axis: at most ten decades; over two or fewer, also 2 and 5."""
    array = np.asarray(values, dtype=np.float64)
    array = array[np.isfinite(array) & (array > 0)]
    if not array.size or array.max() <= 100.0 * array.min():
        return "D2"
    return int(np.ceil(np.log10(array.max() / array.min()) / 10.0))


def rows_height(n: int, extra: int) -> int:
    """Return the height in pixels of a figure with `n` rows, closer together when many."""
    row = 34
    if n > 12:
        row = 22
    if n > 40:
        row = 14
    return extra + n * row


def names_font(names: Sequence[str]) -> dict[str, Any]:
    """Return the font of names along an axis, smaller where there are many."""
    return {"size": 12 if len(names) <= 40 else 9}


def categories(names: Sequence[str], title: str) -> dict[str, Any]:
    """Return an axis with one named place for each of `names`, counted from 0."""
    return {
        "title": {"text": title},
        "tickvals": list(range(len(names))),
        "ticktext": labels(names),
        "showgrid": False,
        "zeroline": False,
        "tickfont": names_font(names),
    }


# -- panels --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Panel:
    """One of the panels.

    Attributes
    ----------
    title : str
        Of its y axis, with the unit.
    traces : list of dict
        What it shows.
    axis : dict
        Further keys of its y axis.
    share : float
        Of the height, relative to the others.
    marks : tuple of float
        Where horizontal lines are drawn across it.
    """

    title: str
    traces: list[dict[str, Any]]
    axis: dict[str, Any] = field(default_factory=dict)
    share: float = 1.0
    marks: tuple[float, ...] = ()


def stacked(
    panels: Sequence[Panel], x: dict[str, Any], height: int, marks: Sequence[float] = ()
) -> Figure:
    """Return panels as one figure.

    Parameters
    ----------
    panels : sequence of Panel
        From the top down.
    x : dict
        The x axis that they share.
    height : int
        In pixels.
    marks : sequence of float
        Where vertical lines are drawn through all.
    """
    total = sum(p.share for p in panels)
    room = 1.0 - _GAP * (len(panels) - 1)
    traces: list[dict[str, Any]] = []
    layout: dict[str, Any] = {"showlegend": True, "hovermode": "closest"}
    shapes: list[dict[str, Any]] = []
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
            shapes.append(_across(axis, at))
        top = bottom - _GAP
    shapes += map(_through, marks)
    layout["xaxis"] = {"anchor": axis, "zeroline": False, **x}
    if shapes:
        layout["shapes"] = shapes
    return {"data": traces, "height": height, "layout": layout}


def linear_frequency(freq: ArrayLike) -> dict[str, Any]:
    """Return a frequency axis over some lines in Hz, with room for markers at both ends."""
    lines = np.asarray(freq, dtype=np.float64)
    low, high = float(lines[0]), float(lines[-1])
    margin = 0.01 * (high - low) or 0.01 * high
    return {
        "title": {"text": "frequency (Hz)"},
        "range": [low - margin, high + margin],
        "zeroline": False,
    }


def log_frequency(freq: ArrayLike, title: str = "frequency (Hz)") -> dict[str, Any]:
    """Return a logarithmic frequency axis over some lines in Hz."""
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
    axis: dict[str, Any] = {"title": {"text": title}, "type": "log", "range": [low, high]}
    if len(ticks) < 2:  # a narrow band
        return axis | {"dtick": log_step(lines)}
    return axis | {"tickvals": ticks, "ticktext": [f"{t:g}" for t in ticks]}


def log_range(values: ArrayLike, decades: float = 9.0) -> dict[str, Any]:
    """Return a logarithmic y axis for the values above 0, the largest `decades` of them at most."""
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
) -> dict[str, Any]:
    """Return a curve with name and values under the pointer; it has gaps where not finite.

    Of a single line it is a point, as there is nothing to connect.
    """
    drawn: dict[str, Any] = {"mode": "lines"}
    if np.size(x) == 1:
        drawn = {"mode": "markers", "marker": {"color": colour, "size": 7}}
    said = f"%{{x:.5g}} Hz: {label(name)} %{{y:.4g}} {label(unit)}".rstrip()
    return {
        "type": "scatter",
        **drawn,
        "name": label(name),
        "legendgroup": label(name),
        "showlegend": legend,
        "x": numbers(x),
        "y": numbers(y),
        "line": {"color": colour, "width": width, "dash": dash},
        "hovertemplate": f"{said}<extra></extra>",
    }


def band_traces(
    x: ArrayLike, low: ArrayLike, high: ArrayLike, name: str, *, legend: bool = True
) -> list[dict[str, Any]]:
    """Return a band between two finite curves, kept off 0 for a logarithmic axis."""
    tiny = float(np.finfo(np.float32).tiny)
    edge: dict[str, Any] = {
        "type": "scatter",
        "mode": "lines",
        "x": numbers(x),
        "hoverinfo": "skip",
        "line": {"width": 0, "color": "@after"},
        "legendgroup": label(name),
    }
    lower = {"y": numbers(_off_zero(low, tiny)), "showlegend": False}
    upper = {
        "name": label(name),
        "y": numbers(_off_zero(high, tiny)),
        "showlegend": legend,
        "fill": "tonexty",
        "fillcolor": "@after-faint",
    }
    return [edge | lower, edge | upper]


def _off_zero(values: ArrayLike, tiny: float) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=np.float64)
    return np.where(np.abs(array) < tiny, tiny, array)


def with_peaks(values: ArrayLike, limit: int) -> NDArray[np.intp]:
    """Choose of many values the least and the greatest of each stretch, so that no peak is lost.

    Parameters
    ----------
    values : array_like of float, shape (n,)
        In order.
    limit : int
        How many at most.

    Returns
    -------
    ndarray of int
        Positions, ascending; all where they are not more.
    """
    array = np.asarray(values, dtype=np.float64)
    if len(array) <= limit:
        return np.arange(len(array))
    edges = np.linspace(0, len(array), limit // 2).round().astype(np.intp)
    found = [0, len(array) - 1]
    for a, b in pairwise(edges):
        found += [int(a + np.argmin(array[a:b])), int(a + np.argmax(array[a:b]))]
    return np.unique(found)


def phases(
    first: NDArray[np.complex128], *others: NDArray[np.complex128]
) -> list[NDArray[np.float64]]:
    """Return phases in degrees, without jumps along the lines.

    Parameters
    ----------
    first, *others : ndarray of complex, shape (n_f,)
        FRFs of one channel.

    Returns
    -------
    list of ndarray of float, shape (n_f,)
        Of the first one unwrapped, of the others those nearest to it.
    """
    with np.errstate(invalid="ignore"):
        base = np.unwrap(np.angle(first))
        out = [np.degrees(base)]
        for other in others:
            out.append(np.degrees(base + np.angle(other * np.conj(first))))
    return out


def wrapped_phase(
    x: ArrayLike, H: NDArray[np.complex128]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return lines and phase in -180 to 180 degrees, with gaps where it goes round and at zeros.

    Parameters
    ----------
    x : array_like of float, shape (n_f,)
        Lines in Hz.
    H : ndarray of complex, shape (n_f,)
        An FRF.

    Returns
    -------
    lines, degrees : ndarray of float, shape (n_f + number of gaps,)
    """
    lines = np.asarray(x, dtype=np.float64)
    degrees = np.where(H == 0.0, np.nan, np.degrees(np.angle(H)))
    after = np.flatnonzero(np.abs(np.diff(degrees)) > 180.0) + 1
    return np.insert(lines, after, lines[after]), np.insert(degrees, after, np.nan)


def level_line(x: ArrayLike, at: float, name: str) -> dict[str, Any]:
    """Return a dashed line over all lines at one level."""
    ends = np.asarray(x, dtype=np.float64)[[0, -1]]
    return curve(ends, [at, at], name, "@before", dash="dash", width=1.5)


def _across(axis: str, at: float) -> dict[str, Any]:
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


def _through(at: float) -> dict[str, Any]:
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
    """Return one horizontal bar for each of some named values on a logarithmic axis.

    Parameters
    ----------
    values : mapping of str to float
        By name, from the top down; those that are not finite are left out.
    title : str
        Of the axis.
    mark : float, optional
        Where a line is drawn across.

    Returns
    -------
    Figure or None
        None where there is no finite value.
    """
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
        step = math.ceil(span / 2.5)  # three or four labels: on paper there are 130 px
    elif span > 1.5:
        step = 1
    rows = list(range(len(known)))
    trace = {
        "type": "bar",
        "orientation": "h",
        "x": sizes.tolist(),
        "y": rows,
        "text": _bar_texts(list(known.values())),
        "textposition": "outside",
        "cliponaxis": False,
        "marker": {"color": "@after"},
        "hovertext": [f"{label(name)}: {v:.4g}" for name, v in known.items()],
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
            "ticktext": labels(known),
            "range": [len(known) - 0.4, -0.6],
            "zeroline": False,
            "showgrid": False,
        },
        "showlegend": False,
        "bargap": 0.35,
    }
    if mark is not None:
        layout["shapes"] = [_mark(mark)]
    return {"data": [trace], "height": rows_height(len(known), extra=95), "layout": layout}


def _bar_texts(values: Sequence[float]) -> list[str]:
    """Return the values as texts, without decimals where all are whole."""
    if all(float(v).is_integer() for v in values):
        return [f"{v:.0f}" for v in values]
    return [number(v, 2) for v in values]


def _mark(at: float) -> Mapping[str, Any]:
    return {
        "type": "line",
        "x0": at,
        "x1": at,
        "y0": 0,
        "y1": 1,
        "yref": "paper",
        "line": {"color": "@before", "dash": "dash", "width": 1.5},
    }
