"""Figures of agreement: FRAC, CSAC, level differences and residuals, before and after."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.report.data import ReportData
from updyn.report.plots import (
    PRINTED_CELLS,
    Figure,
    categories,
    colour_bar,
    label,
    labels,
    log_step,
    numbers,
    rows_height,
)
from updyn.report.words import figure_of_agreement

__all__ = [
    "csac_lines",
    "frac_map",
    "level_difference",
    "level_differences",
    "relative_residual",
    "residual_by_channel",
]


def frac_map(data: ReportData, frac: NDArray[np.float64] | None) -> Figure | None:
    """Heat map of FRAC, responses down, references across, on the scale 0 to 1."""
    if frac is None:
        return None
    rows = [
        r + (" ◆" if held else "") for r, held in zip(data.responses, data.held_out, strict=True)
    ]
    hover = [
        [
            f"response {label(r)}{' (held out)' if held else ''}<br>reference {label(c)}<br>FRAC"
            f" {v:.4f}"
            for c, v in zip(data.references, line, strict=True)
        ]
        for r, held, line in zip(data.responses, data.held_out, frac, strict=True)
    ]
    height = max(rows_height(len(rows), extra=110), 190)
    trace = {
        "type": "heatmap",
        "z": numbers(frac),
        "x": list(range(len(data.references))),
        "y": list(range(len(rows))),
        "zmin": 0.0,
        "zmax": 1.0,
        "colorscale": "Cividis",
        "xgap": 1,
        "ygap": 1,
        "hovertext": hover,
        "hoverinfo": "text",
        "colorbar": colour_bar("FRAC", (0, 0.25, 0.5, 0.75, 1), height),
    }
    if frac.size == 1:
        trace["showscale"] = False
    if frac.size <= PRINTED_CELLS:
        trace["text"] = [[label(figure_of_agreement(v)) for v in line] for line in frac]
        trace["texttemplate"] = "%{text}"
    return {
        "data": [trace],
        "height": height,
        "layout": {
            "xaxis": categories(data.references, "reference"),
            "yaxis": {**categories(rows, "response"), "autorange": "reversed"},
        },
    }


def csac_lines(data: ReportData) -> Figure | None:
    """CSAC over frequency, before and after."""
    if data.csac_before is None and data.csac_after is None:
        return None
    traces: list[dict[str, Any]] = []
    x = numbers(data.freq)
    for name, csac, dash in (
        ("before", data.csac_before, "dot"),
        ("after", data.csac_after, "solid"),
    ):
        if csac is None:
            continue
        traces.append(
            {
                "type": "scatter",
                "mode": "lines",
                "name": name,
                "x": x,
                "y": numbers(csac),
                "line": {"color": f"@{name}", "dash": dash, "width": 1.6},
                "hovertemplate": f"%{{x:.5g}} Hz: CSAC {name} %{{y:.3f}}<extra></extra>",
            }
        )
    return {
        "data": traces,
        "height": 300,
        "layout": {
            "xaxis": {"title": {"text": "frequency (Hz)"}},
            "yaxis": {"title": {"text": "CSAC"}, "range": [-0.02, 1.04]},
            "showlegend": True,
        },
    }


def level_differences(data: ReportData) -> Figure | None:
    """Histogram of 20 log10 |computed / measured| over all lines compared, before and after."""
    edges = np.linspace(-30.0, 30.0, 121)
    traces: list[dict[str, Any]] = []
    for name, computed in (("before", data.before), ("after", data.after)):
        if computed is None:
            continue
        level = level_difference(data.measured[data.compared], computed[data.compared])
        counts, _ = np.histogram(np.clip(level, edges[0], edges[-1]), edges)
        traces.append(
            {
                "type": "scatter",
                "mode": "lines",
                "name": name,
                "x": numbers(0.5 * (edges[1:] + edges[:-1])),
                "y": numbers(100.0 * counts / max(level.size, 1)),
                "line": {
                    "color": f"@{name}",
                    "shape": "hvh",
                    "dash": "dot" if name == "before" else "solid",
                },
                "fill": "tozeroy" if name == "after" else "none",
                "fillcolor": "@after-faint",
                "hovertemplate": (
                    f"{name}: %{{y:.2f}} %% of the values at %{{x:.2f}} dB<extra></extra>".replace(
                        "%%", "%"
                    )
                ),
            }
        )
    if not traces:
        return None
    return {
        "data": traces,
        "height": 300,
        "layout": {
            "xaxis": {
                "title": {"text": "computed over measured level (dB)"},
                "range": _histogram_range(traces),
            },
            "yaxis": {"title": {"text": "share of values (%)"}, "rangemode": "tozero"},
            "showlegend": True,
        },
    }


def _histogram_range(traces: list[dict[str, Any]]) -> list[float]:
    """Frame what is there: the middle 99 % of both histograms, at least +-3 dB."""
    reach = 3.0
    for trace in traces:
        x, share = np.array(trace["x"]), np.array(trace["y"])
        order = np.argsort(np.abs(x))
        inside = np.cumsum(share[order])
        edge = min(int(np.searchsorted(inside, 99.0)), len(x) - 1)
        reach = max(reach, float(np.abs(x[order[edge]])) + 0.5)
    return [-reach, reach]


def level_difference(
    measured: NDArray[np.complex128], computed: NDArray[np.complex128]
) -> NDArray[np.float64]:
    """Return 20 log10 |computed / measured| in dB as a flat array, without values where either is zero."""
    a, b = np.abs(computed).ravel(), np.abs(measured).ravel()
    there = (a > 0) & (b > 0)
    return np.asarray(20.0 * np.log10(a[there] / b[there]))


def relative_residual(
    measured: NDArray[np.complex128], computed: NDArray[np.complex128]
) -> NDArray[np.float64]:
    """Return rms |computed - measured| over rms |measured| of each channel, shape (n_responses, n_references)."""
    misfit = np.sqrt(np.mean(np.abs(computed - measured) ** 2, axis=0))
    size = np.sqrt(np.mean(np.abs(measured) ** 2, axis=0))
    return np.divide(misfit, size, out=np.full(size.shape, np.nan), where=size > 0)


def residual_by_channel(data: ReportData) -> Figure | None:
    """Root mean square residual of each channel in percent of its measured level."""
    names = [
        f"{r}{' ◆' if held else ''} / {c}"
        for r, held in zip(data.responses, data.held_out, strict=True)
        for c in data.references
    ]
    traces: list[dict[str, Any]] = []
    shown: list[float] = []
    for name, computed, symbol in (
        ("before", data.before, "circle-open"),
        ("after", data.after, "circle"),
    ):
        if computed is None:
            continue
        residual = relative_residual(data.measured[data.compared], computed[data.compared]).ravel()
        shown += residual.tolist()
        traces.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": name,
                "x": list(range(len(names))),
                "y": numbers(100.0 * residual),
                "text": labels(names),
                "marker": {
                    "color": f"@{name}",
                    "symbol": symbol,
                    "size": 9 if len(names) <= 60 else 5,
                },
                "hovertemplate": f"%{{text}}: %{{y:.3g}} % {name}<extra></extra>",
            }
        )
    if not traces:
        return None
    few = len(names) <= 24
    axis: dict[str, Any] = {"title": {"text": "channel: response / reference"}, "zeroline": False}
    if few:
        axis |= {"tickvals": list(range(len(names))), "ticktext": labels(names), "tickangle": -50}
        axis["range"] = [-0.6, len(names) - 0.4]
    else:
        axis["title"]["text"] = "channel number (names appear under the pointer)"
    return {
        "data": traces,
        "height": 340 if few else 300,
        "layout": {
            "xaxis": axis,
            "yaxis": {
                "title": {"text": "rms residual (% of rms level)"},
                "type": "log",
                "dtick": log_step(shown),
            },
            "showlegend": True,
        },
    }
