"""Figures of the pages, from the building blocks of the report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import BoolArray, IndexArray, NumberArray, RealArray
from updyn.report.plots import (
    DIVERGING,
    SEQUENTIAL,
    Figure,
    Panel,
    colour_bar,
    curve,
    encode_numbers,
    escape_labels,
    linear_frequency,
    log_range,
    names_font,
    rows_height,
    stack_panels,
    thin_indices,
    wrapped_phase,
)
from updyn.settings import FIGURES
from updyn.style import CATEGORIES, STATES
from updyn.web.settings import WEB_PAGE

__all__ = ["SCALES", "channel_map", "edges", "frf_chart", "level_chart", "unused_bands"]

#: Unit of the FRFs of translations by quantity, in SI, and the reference of their decibels.
_UNITS = {"receptance": "m/N", "mobility": "m/s/N", "accelerance": "m/s²/N"}
#: How magnitudes are drawn.
SCALES = {"log": "logarithmic", "dB": "decibels", "linear": "linear"}
#: Styles of curves by name: measured data are wide, such that a fitted curve stays visible.
_STYLES: Mapping[str, dict[str, Any]] = {
    "measured": {"width": 4.5},
    "start": {"width": 1.4, "dash": "dot"},
}
_SMALL_STYLES = {**_STYLES, "measured": {"width": 2.5}, "start": {"width": 1.2}}
_PHASES: dict[str, Any] = {"range": [-190, 190], "tickvals": [-180, -90, 0, 90, 180]}
#: Roles of the colours of curves with fixed names.
_ROLES = {**STATES, "repaired": "third"}


def frf_chart(
    quantity: str,
    curves: Mapping[str, tuple[RealArray, NumberArray]],
    *,
    scale: str = "log",
    coherence: ArrayLike | None = None,
    phase: bool = False,
    band: tuple[float, float] | None = None,
    excluded: Iterable[tuple[float, float]] = (),
    pickable: bool = False,
    small: bool = False,
    unit: str | None = None,
) -> Figure:
    """Return the magnitudes of FRFs over frequency in Hz, and their phases on request.

    The first curve is measured; the names ``start``, ``updated`` and ``repaired`` have fixed
    colours. `coherence` is that of the first curve, nan if unknown. `band` and `excluded` (Hz) are
    shaded. If `pickable`, a drag selects a band and a click selects a frequency. A `small` figure
    has no titles and no legend. `unit` is by default that of translations.
    """
    unit = _UNITS.get(quantity, "") if unit is None else unit
    shown_unit = "dB" if scale == "dB" else unit
    traces: list[dict[str, Any]] = []
    angles: list[dict[str, Any]] = []
    levels = [np.empty(0)]
    for number, (name, (freq, values)) in enumerate(curves.items()):
        level = _scale_magnitude(np.abs(values), scale)
        at = thin_indices(level, WEB_PAGE.small_points if small else WEB_PAGE.curve_points)
        role = CATEGORIES[(number - 1) % len(CATEGORIES)] if number else STATES["measured"]
        colour = f"@{_ROLES.get(name, role)}"
        style = _SMALL_STYLES if small else _STYLES
        look = style.get(name, {"width": 1.6})
        trace = curve(freq[at], level[at], name, colour, unit=shown_unit, legend=not small, **look)
        if name == "measured" and not small and len(at) <= FIGURES.measured_points:
            trace |= {"mode": "markers", "marker": {"color": colour, "size": 6}}
        traces.append(trace)
        levels.append(level)
        if phase:
            x, degrees = wrapped_phase(freq[at], np.asarray(values[at], dtype=np.complex128))
            angles.append(curve(x, degrees, name, colour, unit="°", legend=False, **look))
    axis = log_range(np.concatenate(levels)) if scale == "log" else {}
    panels = [Panel(_level_title(quantity, unit, scale), traces, axis)]
    if phase:
        panels.append(Panel("phase (°)", angles, _PHASES, 0.45))
    if coherence is not None:
        freq, _ = next(iter(curves.values()))
        panels.append(_coherence_panel(freq, np.asarray(coherence, dtype=np.float64)))
    lines = np.concatenate([np.empty(0), *(freq for freq, _ in curves.values())])
    x_axis: dict[str, Any] = {"title": {"text": "frequency (Hz)"}}
    if lines.size:
        x_axis = linear_frequency([lines.min(), lines.max()])
    figure = stack_panels(panels, x_axis, height=300 + 100 * len(panels))
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
    if small:
        _make_small(figure, len(panels))
    return figure


def _make_small(figure: Figure, n_panels: int) -> None:
    """Remove titles and legend of a figure, and reduce its height and margins."""
    layout = figure["layout"]
    figure["height"] = 120 + 50 * n_panels
    layout |= {"showlegend": False, "margin": {"l": 40, "r": 8, "t": 6, "b": 24}}
    for key, axis in layout.items():
        if key.startswith(("xaxis", "yaxis")):
            axis["title"] = {"text": ""}
            axis["tickfont"] = {"size": WEB_PAGE.small_text}


def _level_title(quantity: str, unit: str, scale: str) -> str:
    if scale == "dB":
        unit = f"dB re 1 {unit}" if unit else "dB"
    if unit.startswith("("):  # (m/s²)/N
        return f"|{quantity}| in {unit}"
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


def channel_map(
    freq: RealArray,
    values: NumberArray,
    names: Sequence[str],
    model: tuple[RealArray, NumberArray] | None = None,
) -> Figure:
    """Return a map of the levels of all channels, or of the differences of a model from them.

    `values` has shape (n_f, n_channels), with one name for each channel. Without `model` (lines in
    Hz and values) the level is relative to the highest of all channels, in dB. Each of at most
    `WEB_PAGE.map_lines` bins has the highest level of its lines.
    """
    n_bins = min(WEB_PAGE.map_lines, len(freq))
    starts = np.linspace(0, len(freq), n_bins, endpoint=False).astype(np.intp)
    level = _find_bin_levels(values, starts)
    if model is None:
        level -= np.nanmax(level, initial=-np.inf)
        title, limits, colours = "level (dB)", (-WEB_PAGE.map_range, 0.0), SEQUENTIAL
    else:
        grid, computed = model
        begins = np.minimum(np.searchsorted(grid, freq[starts]), len(grid) - 1)
        level = _find_bin_levels(computed, begins) - level
        most = WEB_PAGE.map_difference
        title, limits, colours = "model over measured (dB)", (-most, most), DIVERGING
    height = min(max(rows_height(len(names), extra=110), 240), WEB_PAGE.map_height)
    trace = {
        "type": "heatmap",
        "z": encode_numbers(np.round(level.T, 2)),
        "x": encode_numbers(freq[starts]),
        "y": escape_labels(names),
        "zmin": limits[0],
        "zmax": limits[1],
        "colorscale": colours,
        "colorbar": colour_bar(title, np.linspace(*limits, 5).tolist(), height),
        "hovertemplate": "%{y}, %{x:.5g} Hz: %{z:.1f} dB<extra></extra>",
    }
    y = {"type": "category", "autorange": "reversed", "showgrid": False, "tickangle": 0}
    y |= {"tickfont": names_font(names), "nticks": WEB_PAGE.map_names}
    return stack_panels([Panel("", [trace], y)], linear_frequency(freq), height)


def _find_bin_levels(values: NumberArray, starts: IndexArray) -> RealArray:
    """Return the highest magnitude of each bin of lines in dB; nan for zeros."""
    level = np.abs(values)
    highest = np.fmax.reduceat(level, starts, axis=0)
    return 20.0 * np.log10(np.where(highest > 0.0, highest, np.nan))


def level_chart(errors: Mapping[int, float]) -> Figure:
    """Return level errors in dB by step of a run, and the best of all steps so far."""
    steps = sorted(errors)
    found = np.array([errors[step] for step in steps])
    points = curve(steps, found, "step", "@measured") | {
        "mode": "markers",
        "marker": {"size": 5, "color": "@measured"},
        "hovertemplate": "step %{x}: %{y:.3g} dB<extra></extra>",
    }
    best = curve(steps, np.fmin.accumulate(found), "best so far", "@after", width=2.5)
    best["line"] = {**best["line"], "shape": "hv"}  # type: ignore[dict-item]
    best |= {"mode": "lines", "hoverinfo": "skip", "hovertemplate": None}
    x: dict[str, Any] = {"title": {"text": "step"}}
    if not steps or steps[-1] - steps[0] <= 6:
        x["dtick"] = 1
    y = log_range(found) | {"exponentformat": "none"}
    panel = Panel("level error (dB)", [points, best], y)
    return stack_panels([panel], x, height=260)
