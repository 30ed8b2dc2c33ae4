"""Panels below each other over one frequency axis: Bode diagrams, and what belongs under them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from updyn.report.plots import Figure, label, log_step, numbers

__all__ = [
    "Panel",
    "band_traces",
    "curve",
    "level_line",
    "log_frequency",
    "log_range",
    "phases",
    "stacked",
    "with_peaks",
]

_GAP = 0.035
#: Plotly's own would write 2µ.
_POWERS = {"exponentformat": "power", "showexponent": "all"}


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
    top, traces, layout, shapes = (
        1.0,
        list[dict[str, Any]](),
        dict[str, Any](),
        list[dict[str, Any]](),
    )
    for number, panel in enumerate(panels, 1):
        name = "" if number == 1 else str(number)
        bottom = max(top - room * panel.share / total, 0.0)
        title = {"title": {"text": panel.title, "font": {"size": 12}}}
        layout[f"yaxis{name}"] = {
            "domain": [bottom, top],
            "anchor": "x",
            "zeroline": False,
            **_POWERS,
            **title,
            **panel.axis,
        }
        traces += [trace | {"xaxis": "x", "yaxis": f"y{name}"} for trace in panel.traces]
        shapes += [_across(f"y{name}", at) for at in panel.marks]
        top = bottom - _GAP
    lowest = "y" if len(panels) == 1 else f"y{len(panels)}"
    shapes += [_through(at) for at in marks]
    layout |= {
        "xaxis": {"anchor": lowest, "zeroline": False, **x},
        "showlegend": True,
        "hovermode": "closest",
    }
    if shapes:
        layout["shapes"] = shapes
    return {"data": traces, "height": height, "layout": layout}


def log_frequency(freq: ArrayLike, title: str = "frequency (Hz)") -> dict[str, Any]:
    """Return a logarithmic frequency axis over some lines in Hz."""
    lines = np.asarray(freq, dtype=np.float64)
    lines = lines[lines > 0]
    low, high = (float(v) for v in np.log10([lines[0], lines[-1]]))
    marks = (1.0, 2.0, 5.0) if high - low <= 2.3 else (1.0,)
    every = max(1, int(np.ceil((high - low) / 8.0)))
    decades = range(int(np.floor(low)), int(np.ceil(high)) + 1, every)
    ticks = [
        m * 10.0**d for d in decades for m in marks if low - 1e-9 <= np.log10(m) + d <= high + 1e-9
    ]
    axis: dict[str, Any] = {"title": {"text": title}, "type": "log", "range": [low, high]}
    if len(ticks) < 2:  # a narrow band
        return axis | {"dtick": log_step(lines)}
    return axis | {"tickvals": ticks, "ticktext": [f"{t:g}" for t in ticks]}


def log_range(values: ArrayLike, decades: float = 9.0) -> dict[str, Any]:
    """Return a logarithmic y axis that holds all values above 0, of the largest so many decades at most."""
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
    elif high - low < 0.7:
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
    """Return a line that says its name, place and value; what is not finite leaves a gap."""
    said = f"%{{x:.5g}} Hz: {label(name)} %{{y:.4g}} {label(unit)}".rstrip()
    return {
        "type": "scatter",
        "mode": "lines",
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
    """Return a band between two curves, both finite and above the smallest number of the page's arrays."""
    tiny = float(np.finfo(np.float32).tiny)
    edge: dict[str, Any] = {
        "type": "scatter",
        "mode": "lines",
        "x": numbers(x),
        "hoverinfo": "skip",
        "line": {"width": 0, "color": "@after"},
        "legendgroup": label(name),
    }
    low, high = (np.where(np.abs(v) < tiny, tiny, v) for v in (np.asarray(low), np.asarray(high)))
    return [
        edge | {"y": numbers(low), "showlegend": False},
        edge
        | {
            "name": label(name),
            "y": numbers(high),
            "showlegend": legend,
            "fill": "tonexty",
            "fillcolor": "@after-faint",
        },
    ]


def with_peaks(values: ArrayLike, limit: int) -> NDArray[np.intp]:
    """Return which of many values to draw so that no peak is lost: the least and the greatest of each stretch.

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
    found = [f(array[a:b]) + a for a, b in pairwise(edges) for f in (np.argmin, np.argmax)]
    return np.unique([0, *found, len(array) - 1])


def phases(
    first: NDArray[np.complex128], *others: NDArray[np.complex128]
) -> list[NDArray[np.float64]]:
    """Return phases in degrees: of the first one without jumps along the lines, of the others those nearest to it."""
    with np.errstate(invalid="ignore"):
        base = np.unwrap(np.angle(first))
        out = [np.degrees(base)]
        for other in others:
            out.append(np.degrees(base + np.angle(other * np.conj(first))))
    return out


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
