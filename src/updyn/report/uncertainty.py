"""The section of the report on uncertainty: intervals by profile, bootstrap or sampling beside those of Laplace."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.errors import UpdynError
from updyn.report import formats as w
from updyn.report import markup as m
from updyn.report.data import EVALUATION_BUDGET, keep_lines
from updyn.report.formats import quantity_words
from updyn.report.plots import Figure, error_bars, labels, log_step, numbers, rows_height
from updyn.report.section import Content, Section
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.prediction import Band, predict
from updyn.uncertainty.profile import Profiles
from updyn.updating.result import JointResult, UpdateResult

__all__ = [
    "UNCERTAINTY",
    "band_figure",
    "ends_of",
    "intervals_figure",
    "level_of",
]

_ABOUT = {
    "profile": (
        "Profile likelihood: each unknown is held at one value after the other and all others are"
        " fitted again; the interval holds the values at which the fit is not clearly worse. It"
        " follows curvature, and keeps within the bounds."
    ),
    "bootstrap": (
        "Bootstrap: data are made anew from the updated model and the noise, and the unknowns are"
        " fitted to each; the interval holds the middle of what comes out."
    ),
    "sampling": (
        "Sampling of the posterior: the interval holds the middle of all values that data and"
        " priors leave, by their probability."
    ),
}


class Uncertainty(Section):
    """Intervals by profile, bootstrap or sampling."""

    anchor = "uncertainty"
    name = "Uncertainty"
    heading = "Uncertainty"
    place = 500

    def applies(self, content: Content) -> bool:
        """Whether the page shows an update."""
        return content.update is not None

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return the intervals and, of one test, the band of an FRF."""
        update, found = content.update, content.further["uncertainty"]
        assert update is not None
        out: dict[str, Figure] = {}
        intervals = intervals_figure(update, found)
        if intervals is not None:
            out["uncertainty-intervals"] = intervals
        band = band_figure(update, found) if isinstance(update, UpdateResult) else None
        if band is not None:
            out["uncertainty-band"] = band[0] | {"channel": band[1]}
        return out

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return words, intervals and the band."""
        found: Draws | Profiles = content.further["uncertainty"]
        kind = "profile" if isinstance(found, Profiles) else found.kind
        parts = [
            m.paragraph(_ABOUT[kind]),
            m.note(found.message),
        ]
        if "uncertainty-intervals" in figures:
            caption = (
                f"{100 * level_of(found):g} % intervals about the estimate, in units of its standard"
                " deviation (in the logarithm of a factor): where both bars are alike, the standard"
                " deviation says it all."
            )
            height = figures["uncertainty-intervals"]["height"]
            parts.append(
                m.figure(
                    "uncertainty-intervals",
                    "Intervals beside those of Laplace",
                    caption,
                    height=height,
                )
            )
        parts.append(_table(content, found))
        if "uncertainty-band" in figures:
            figure = figures["uncertainty-band"]
            caption = (
                f"{figure['channel']}: of what was measured, the FRF that the updated model knows"
                " least. The band is about the structure, without the noise of a measurement."
            )
            parts.append(
                m.figure("uncertainty-band", "FRF with its band", caption, height=figure["height"])
            )
        return "".join(parts)


UNCERTAINTY = Uncertainty()


def _table(c: Content, found: Draws | Profiles) -> str:
    ends = ends_of(found)
    percent = f"{100 * level_of(found):g} %"
    head = ["unknown", "value", "std. dev.", f"{percent}, lower", "upper"]
    head += ["R-hat", "effective draws"] if _diagnosed(found) else []
    head.append("note")
    kinds = ("", *[""] * (len(head) - 2), "note-cell")
    rows = [m.row(_row(c, found, name, span, len(head)), kinds) for name, span in ends.items()]
    return m.table(head, rows, caption=f"{percent} intervals", kinds=kinds) if rows else ""


def _diagnosed(found: Draws | Profiles) -> bool:
    return isinstance(found, Draws) and "r_hat" in found.diagnostics


def _row(
    c: Content, found: Draws | Profiles, name: str, span: tuple[float, float], columns: int
) -> list[str]:
    cells = [
        name,
        w.number(c.result.values[name]),
        w.number(c.result.std[name]),
        *(w.number(e) for e in span),
    ]
    note = found[name].note if isinstance(found, Profiles) else ""
    if isinstance(found, Draws) and _diagnosed(found):
        k = found.names.index(name)
        cells += [w.number(float(found.diagnostics[key][k])) for key in ("r_hat", "ess_bulk")]
    return [*cells, *[""] * (columns - 1 - len(cells)), note]


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
