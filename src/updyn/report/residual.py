"""The map of what a fit leaves: channels down, frequency across, the misfit over the noise as colour."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.report import words as w
from updyn.report.plots import Figure, categories, colour_bar, label, rows_height
from updyn.updating.judge.adequacy import Adequacy

__all__ = ["MOST_ROWS", "misfit_map", "shown_channels"]

#: Channels that the map shows: of more, the worst.
MOST_ROWS = 60
#: The scale ends here: a misfit of ten times the noise is as wrong as one of a hundred.
_TOP = 10.0


def shown_channels(found: Adequacy) -> NDArray[np.intp]:
    """Return the channels that the map shows, as pairs of response and reference, shape (n, 2), in their order."""
    worst = np.nan_to_num(found.misfit).max(axis=2)
    at = np.argwhere(np.isfinite(found.misfit).any(axis=2))
    if len(at) > MOST_ROWS:
        kept = np.sort(np.argsort(-worst[tuple(at.T)], kind="stable")[:MOST_ROWS])
        at = at[kept]
    return np.asarray(at, dtype=np.intp)


def misfit_map(found: Adequacy | None) -> Figure | None:
    """Heat map of the rms misfit over the noise, channels down, bands across; marks where a test says so."""
    if found is None:
        return None
    at = shown_channels(found)
    if not len(at):
        return None
    names = [f"{found.responses[i]} / {found.references[j]}" for i, j in at]
    misfit = found.misfit[tuple(at.T)]
    edges = _edges(found.bands)
    height = max(rows_height(len(names), extra=110), 190)
    ticks = [0.5, 1.0, 2.0, 5.0, _TOP]
    trace = {
        "type": "heatmap",
        "z": [
            [None if np.isnan(v) else float(np.log10(np.clip(v, 0.3, _TOP))) for v in row]
            for row in misfit
        ],
        "x": edges.tolist(),
        "y": list(range(len(names))),
        "zmin": float(np.log10(0.3)),
        "zmax": float(np.log10(_TOP)),
        "colorscale": "Cividis",
        "xgap": 1,
        "ygap": 1,
        "hovertext": [[_hover(found, i, j, k) for k in range(len(found.bands))] for i, j in at],
        "hoverinfo": "text",
        "colorbar": {
            **colour_bar(
                "misfit / noise" if found.absolute else "misfit / typical",
                np.log10(ticks).tolist(),
                height,
            ),
            "ticktext": [*(f"{t:g}" for t in ticks[:-1]), f"≥ {_TOP:g}"],
        },
    }
    marks = _marks(found, at, edges)
    return {
        "data": [trace, *marks],
        "height": height + (30 if marks else 0),
        "layout": {
            "xaxis": {
                "title": {"text": "frequency (Hz)"},
                "range": [float(edges[0]), float(edges[-1])],
            },
            "yaxis": {
                **categories(names, "response / reference"),
                "range": [len(names) - 0.5, -0.5],
            },
            "showlegend": bool(marks),
        },
    }


def _edges(bands: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the edges of the bands: half way between the last line of one and the first of the next."""
    inner = 0.5 * (bands[:-1, 1] + bands[1:, 0])
    low, high = float(bands[0, 0]), float(bands[-1, 1])
    if low == high:  # of one line
        low, high = 0.99 * low, 1.01 * high + 1e-9
    return np.array([low, *inner, high])


def _hover(found: Adequacy, i: int, j: int, k: int) -> str:
    misfit = found.misfit[i, j, k]
    if np.isnan(misfit):
        return "no data"
    low, high = (w.number(float(v)) for v in found.bands[k])
    return (
        f"response {label(found.responses[i])}<br>reference {label(found.references[j])}<br>{low}"
        f" to {high} Hz<br>misfit {w.number(float(misfit), 3)} times the"
        f" {'noise' if found.absolute else 'typical misfit'}<br>alike over"
        f" {w.number(float(found.alike[i, j, k]), 2)} lines<br>p: size"
        f" {w.number(float(found.chi_square_p[i, j, k]), 2)}, likeness"
        f" {w.number(float(found.whiteness_p[i, j, k]), 2)}"
    )


def _marks(
    found: Adequacy, at: NDArray[np.intp], edges: NDArray[np.float64]
) -> list[dict[str, Any]]:
    middle = 0.5 * (edges[1:] + edges[:-1])
    alike = found.whiteness_p[tuple(at.T)] <= found.level
    large = (found.chi_square_p[tuple(at.T)] <= found.level) & ~alike
    out = []
    for name, where, symbol in (
        ("alike from line to line", alike, "diamond"),
        ("too large", large, "circle"),
    ):
        rows, columns = np.nonzero(where)
        if not rows.size:
            continue
        out.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": name,
                "x": middle[columns].tolist(),
                "y": rows.tolist(),
                "marker": {
                    "symbol": symbol,
                    "size": 7,
                    "color": "#fff",
                    "line": {"color": "#111", "width": 1.2},
                },
                "hoverinfo": "skip",
            }
        )
    return out
