"""Figures of the uncertainty of an update: intervals beside those of Laplace, and an FRF with its band."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.errors import UpdynError
from updyn.report.data import EVALUATION_BUDGET, keep_lines
from updyn.report.plots import Figure, error_bars, labels, log_step, numbers, rows_height
from updyn.report.words import quantity_words
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.prediction import Band, predict
from updyn.uncertainty.profile import Profiles
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["band_figure", "ends_of", "intervals_figure", "level_of"]

#: Lines, and draws, that the band of the page is made of.
_LINES, _DRAWS = 400, 200
#: Lines x DOFs x solves beyond which the page has no band.
_AFFORDED = 20 * EVALUATION_BUDGET
#: Intervals are drawn up to so many standard deviations.
_SHOWN = 8.0


def level_of(found: Draws | Profiles) -> float:
    """Return the level of the intervals that are shown: that of profiles; 95 % of draws."""
    return found.level if isinstance(found, Profiles) else float(found.options.get("level", 0.95))


def ends_of(found: Draws | Profiles) -> dict[str, tuple[float, float]]:
    """Return the interval of each unknown; nothing where there are too few draws."""
    if isinstance(found, Profiles):
        return found.intervals()
    return found.intervals(level_of(found)) if len(found) > 1 else {}


def intervals_figure(result: UpdateResult | JointResult, found: Draws | Profiles) -> Figure | None:
    """Return the intervals in standard deviations of Laplace from the estimate, in the logarithm of factors."""
    ends = {
        n: e for n, e in ends_of(found).items() if np.isfinite(result.std[n]) and result.std[n] > 0
    }
    chosen = [p for p in result.parameters if p.name in ends]
    if not chosen:
        return None
    spans = np.array([ends[p.name] for p in chosen])
    value, std = (
        np.array([table[p.name] for p in chosen]) for table in (result.values, result.std)
    )
    factor = np.array([p.is_factor for p in chosen])
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(spans / value[:, None]) * (value / std)[:, None]
    at = np.where(factor[:, None], logs, (spans - value[:, None]) / std[:, None])
    low, high = np.clip(at, -_SHOWN, _SHOWN).T
    z = float(-_quantile(0.5 - 0.5 * level_of(found)))
    rows = np.arange(len(chosen), dtype=np.float64)
    zero = np.zeros(len(chosen))
    names = labels(f"{p.group}: {quantity_words(p.quantity)}" for p in chosen)
    words = "profile" if isinstance(found, Profiles) else found.kind
    return {
        "data": [
            _bars("Laplace", zero, zero + z, zero + z, np.asarray(rows - 0.14), "@before", names),
            _bars(words, zero, -low, high, np.asarray(rows + 0.14), "@after", names),
        ],
        "height": rows_height(len(chosen), extra=130),
        "layout": {
            "xaxis": {"title": {"text": "standard deviations from the estimate"}, "zeroline": True},
            "yaxis": {
                "tickvals": rows.tolist(),
                "ticktext": names,
                "range": [len(chosen) - 0.4, -0.6],
                "zeroline": False,
                "tickfont": {"size": 12 if len(chosen) <= 40 else 9},
            },
            "showlegend": True,
        },
    }


def _quantile(p: float) -> float:
    from scipy.special import ndtri

    return float(ndtri(p))


def _bars(
    name: str,
    at: NDArray[np.float64],
    minus: NDArray[np.float64],
    plus: NDArray[np.float64],
    rows: NDArray[np.float64],
    colour: str,
    names: list[str],
) -> dict[str, Any]:
    return {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "x": numbers(at),
        "y": rows.tolist(),
        "text": names,
        "marker": {
            "symbol": "line-ns-open",
            "color": colour,
            "size": 8,
            "line": {"width": 2, "color": colour},
        },
        "error_x": error_bars(minus, plus, colour),
        "hovertemplate": "%{text}<extra></extra>",
    }


def band_figure(result: UpdateResult, found: Draws | Profiles) -> tuple[Figure, str] | None:
    """Return the measured FRF that is known least with the band of the updated model, and which it is.

    None where the band would take too long, or there is none.
    """
    frf = result.frf
    lines = frf.freq[frf.freq > 0]
    lines = lines[
        keep_lines(frf.select(lines=lines).values, np.ones(len(lines), dtype=np.bool_), _LINES)
    ]
    draws = isinstance(found, Draws) and len(found) > 1
    solves = min(len(found), _DRAWS) if draws else 3
    if solves * len(lines) * result.model.n_dofs > _AFFORDED:
        return None
    source: UpdateResult | Draws = result
    if isinstance(found, Draws) and draws:
        at = np.unique(np.linspace(0, len(found) - 1, solves).round().astype(np.intp))
        source = replace(found, chains=found.values[at][None], result=result)
    try:
        band = predict(source, lines, frf.responses, frf.references, level=level_of(found))
    except UpdynError:
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        width = np.median(np.log(band.upper / band.lower), axis=0)
    i, j = np.unravel_index(int(np.argmax(np.where(np.isfinite(width), width, -1.0))), width.shape)
    if not np.isfinite(width[i, j]):
        return None
    return (
        _drawn(band, result, int(i), int(j)),
        f"{frf.responses[int(i)]} / {frf.references[int(j)]}",
    )


def _drawn(band: Band, result: UpdateResult, i: int, j: int) -> Figure:
    freq = band.frf.freq
    measured = np.abs(result.frf.select(lines=freq).values[:, i, j])
    line = {"type": "scatter", "mode": "lines", "x": numbers(freq), "hoverinfo": "skip"}
    low, high = (
        np.maximum(v[:, i, j], np.finfo(np.float32).tiny) for v in (band.lower, band.upper)
    )
    traces: list[dict[str, Any]] = [
        line | {"y": numbers(low), "line": {"width": 0, "color": "@after"}, "showlegend": False},
        line
        | {
            "name": f"{100 * band.level:g} % band",
            "y": numbers(high),
            "line": {"width": 0, "color": "@after"},
            "fill": "tonexty",
            "fillcolor": "@after-faint",
        },
        line
        | {
            "name": "updated model",
            "y": numbers(np.abs(band.frf.values[:, i, j])),
            "line": {"color": "@after"},
        },
        {
            "type": "scatter",
            "mode": "markers",
            "name": "measured",
            "x": numbers(freq),
            "y": numbers(measured),
            "marker": {"color": "@measured", "size": 3},
            "hovertemplate": "%{x:.5g} Hz: %{y:.4g}<extra></extra>",
        },
    ]
    return {
        "data": traces,
        "height": 380,
        "layout": {
            "xaxis": {"title": {"text": "frequency (Hz)"}},
            "yaxis": {
                "title": {"text": f"|{band.frf.quantity}|"},
                "type": "log",
                "dtick": log_step(measured),
            },
            "showlegend": True,
        },
    }
