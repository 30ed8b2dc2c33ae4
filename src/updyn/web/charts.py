"""Charts of the pages as options of Apache ECharts: plain data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.style import CATEGORIES, STATES
from updyn.web.look import colour, text_style
from updyn.web.settings import WEB_PAGE

__all__ = [
    "SCALES",
    "coherence_chart",
    "cost_chart",
    "edges",
    "frf_chart",
    "parameter_chart",
    "thin_indices",
    "unused_bands",
]

#: Unit of the FRFs of translations by quantity, in SI, and the reference of their decibels.
_UNITS = {"receptance": "m/N", "mobility": "m/s/N", "accelerance": "m/s²/N"}
#: How magnitudes are drawn.
SCALES = {"log": "logarithmic", "dB": "decibels", "linear": "linear"}
#: Line styles of curves by name: measured data are wide, such that a fitted curve stays visible.
_LOOKS: Mapping[str, dict[str, Any]] = {
    "measured": {"width": 4.5},
    "start": {"width": 1.4, "type": "dotted"},
    "updated": {"width": 1.6},
}
_GRID = {"left": 90, "right": 24, "top": 40, "bottom": 60}


def frf_chart(
    quantity: str,
    curves: Mapping[str, tuple[NDArray[np.float64], NDArray[Any]]],
    *,
    scale: str = "log",
    band: tuple[float, float] | None = None,
    excluded: Iterable[tuple[float, float]] = (),
    brush: bool = False,
    points: int | None = None,
) -> dict[str, Any]:
    """Return the magnitudes of FRFs over frequency in Hz, with at most `points` points a curve.

    The default number is `WEB_PAGE.curve_points`. The first curve is measured; the names ``start``
    and ``updated`` have fixed colours. `band` and `excluded` (Hz) are shaded; with `brush`, a band
    is selected by dragging.
    """
    points = WEB_PAGE.curve_points if points is None else points
    unit = _UNITS.get(quantity, "")
    colours = [STATES["measured"], *CATEGORIES]
    many = len(curves) > len(colours)
    series: list[dict[str, Any]] = []
    for number, (name, (freq, values)) in enumerate(curves.items()):
        token_name = STATES.get(name, colours[number % len(colours)])
        look = _LOOKS.get(name, {"width": 0.8 if many else 1.6})
        series.append(
            {
                "type": "line",
                "name": name,
                "data": _make_points(freq, np.abs(values), scale, points),
                "showSymbol": False,
                "silent": many,
                "lineStyle": {**look, **colour(token_name)},
                "itemStyle": colour(token_name),
            }
        )
    areas = [_mark_area(low, high, "held-band") for low, high in excluded]
    if band is not None:
        areas.append(_mark_area(*band, "fit-band"))
    if series and areas:
        series[0]["markArea"] = {"silent": True, "data": areas}
    chart: dict[str, Any] = {
        "animation": False,
        "grid": _GRID,
        "legend": {"show": not many, "top": 4, "textStyle": text_style()},
        "tooltip": {"trigger": "axis", "show": not many},
        "xAxis": {**_axis("frequency (Hz)", 32), "min": "dataMin", "max": "dataMax"},
        "yAxis": _axis(*_level(quantity, unit, scale)),
        "series": series,
    }
    chart["xAxis"]["axisLabel"] |= {"showMinLabel": False, "showMaxLabel": False}
    if brush:
        chart["brush"] = {"xAxisIndex": 0, "brushType": "lineX", "brushMode": "single"}
        chart["toolbox"] = {"show": False}
    return chart


def coherence_chart(freq: NDArray[np.float64], values: NDArray[Any]) -> dict[str, Any]:
    """Return the coherence of a channel over frequency in Hz; nan is unknown."""
    known = np.asarray(values, dtype=float)
    line = {
        "type": "line",
        "name": "coherence",
        "data": _make_points(freq, known, "linear", WEB_PAGE.curve_points),
        "showSymbol": False,
        "lineStyle": {"width": 1.2, **colour(STATES["measured"])},
        "itemStyle": colour(STATES["measured"]),
    }
    chart: dict[str, Any] = {
        "animation": False,
        "grid": {**_GRID, "top": 10, "bottom": 24},
        "tooltip": {"trigger": "axis"},
        "xAxis": {**_axis("", 0), "min": "dataMin", "max": "dataMax"},
        "yAxis": {**_axis("coherence (1)", 66), "min": 0, "max": 1, "splitNumber": 2},
        "series": [line],
    }
    chart["xAxis"]["axisLabel"] |= {"show": False}
    return chart


def _level(quantity: str, unit: str, scale: str) -> tuple[str, int, str]:
    """Return name, gap and kind of the axis of magnitudes."""
    if scale == "dB":
        of = f" (dB re 1 {unit})" if unit else " (dB)"
        return f"|{quantity}|{of}", 60, "value"
    of = f" ({unit})" if unit else ""
    return f"|{quantity}|{of}", 66, "log" if scale == "log" else "value"


def _axis(name: str, gap: int, kind: str = "value") -> dict[str, Any]:
    return {
        "type": kind,
        "name": name,
        "nameLocation": "middle",
        "nameGap": gap,
        "nameTextStyle": text_style(),
        "axisLabel": text_style(),
        "axisLine": {"lineStyle": colour("muted")},
        "splitLine": {"lineStyle": colour("grid")},
    }


def _make_points(
    freq: NDArray[np.float64], magnitude: NDArray[np.float64], scale: str, points: int
) -> list[list[float | None]]:
    at = thin_indices(magnitude, points)
    shown = magnitude[at].astype(float)
    if scale == "dB":
        with np.errstate(divide="ignore"):
            shown = 20.0 * np.log10(shown)
    drawn = np.isfinite(shown) & ((shown > 0.0) | (scale != "log"))
    return [
        [float(f"{f:.7g}"), float(f"{m:.5g}") if d else None]
        for f, m, d in zip(freq[at], shown, drawn, strict=True)
    ]


def thin_indices(values: NDArray[np.float64], n: int) -> NDArray[np.intp]:
    """Return at most `n` ascending indices of values that preserve the extremes of a curve."""
    m = len(values)
    if m <= n:
        return np.arange(m)
    ends = np.linspace(0, m, max(1, n // 2) + 1).astype(int)
    found: set[int] = set()
    for low, high in pairwise(ends.tolist()):
        part = values[low:high]
        known = ~np.isnan(part)
        smallest = np.argmin(np.where(known, part, np.inf))
        largest = np.argmax(np.where(known, part, -np.inf))
        found |= {low + int(smallest), low + int(largest)}
    return np.array(sorted(found))


def _mark_area(low: float, high: float, token: str) -> list[dict[str, Any]]:
    return [{"xAxis": low, "itemStyle": colour(token)}, {"xAxis": high}]


def edges(freq: NDArray[np.float64], first: int, last: int) -> tuple[float, float]:
    """Return a band in Hz with the lines `first` to `last` and no others, even if rounded."""
    steps = np.diff(freq) if len(freq) > 1 else 1e-3 * freq
    low = freq[first] - 0.5 * steps[max(first - 1, 0)]
    high = freq[last] + 0.5 * steps[min(last, len(steps) - 1)]
    return max(0.0, float(low)), float(high)


def unused_bands(freq: NDArray[np.float64], used: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return the bands (see `edges`) of unused lines between the first and the last used line."""
    at = np.flatnonzero(used)
    gaps = [(a, b) for a, b in pairwise(at.tolist()) if b > a + 1]
    return [edges(freq, before + 1, after - 1) for before, after in gaps]


def cost_chart(steps: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the misfit over the steps of a run, with one curve per stage."""
    stages: dict[str, list[list[float]]] = {}
    for number, step in enumerate(steps):
        if step["cost"] is not None and step["cost"] > 0:
            stages.setdefault(step["stage"], []).append([number, step["cost"]])
    series = [
        {
            "type": "line",
            "name": name,
            "data": rows,
            "symbolSize": 5,
            "lineStyle": colour(token),
            "itemStyle": colour(token),
        }
        for (name, rows), token in zip(stages.items(), _cycle_categories(len(stages)), strict=True)
    ]
    return {
        "animation": False,
        "grid": _GRID,
        "legend": {"top": 4, "textStyle": text_style(), "type": "scroll"},
        "tooltip": {"trigger": "axis"},
        "xAxis": {**_axis("step", 32), "minInterval": 1},
        "yAxis": _axis("misfit of the stage (1)", 66, "log"),
        "series": series,
    }


def _cycle_categories(n: int) -> list[str]:
    return [CATEGORIES[i % len(CATEGORIES)] for i in range(n)]


def parameter_chart(start: Mapping[str, float], now: Mapping[str, float]) -> dict[str, Any]:
    """Return the ratios of the unknowns to their start; unknowns with start 0 are omitted."""
    names = [name for name, value in start.items() if value and name in now]
    return {
        "animation": False,
        "grid": {"left": 200, "right": 24, "top": 16, "bottom": 50},
        "tooltip": {"trigger": "axis"},
        "xAxis": _axis("value / start (1)", 30),
        "yAxis": {"type": "category", "data": names, "inverse": True, "axisLabel": text_style()},
        "series": [
            {
                "type": "bar",
                "name": "value / start",
                "itemStyle": colour(STATES["updated"]),
                "data": [float(f"{now[name] / start[name]:.6g}") for name in names],
            }
        ],
    }
