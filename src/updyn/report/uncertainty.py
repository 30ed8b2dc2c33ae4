"""The section on uncertainty: intervals by profile, bootstrap or sampling next to Laplace's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from updyn.arrays import RealArray
from updyn.dynamics.excitation import fix_base
from updyn.dynamics.resonance_lines import even_lines, resonance_lines
from updyn.errors import UpdynError
from updyn.report.data import keep_lines
from updyn.report.formats import estimate, format_padded, number, quantity_words, unit
from updyn.report.plots import (
    Figure,
    encode_numbers,
    error_bars,
    escape_labels,
    linear_frequency,
    log_step,
    names_font,
    rows_height,
)
from updyn.report.section import PageContent, ReportSection
from updyn.report.settings import REPORT_COMPUTATION
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.prediction import Band, predict
from updyn.uncertainty.profile import Profiles
from updyn.updating.result import JointResult, UpdateResult, estimated_gains

__all__ = ["UNCERTAINTY", "band_figure", "find_intervals", "find_level", "intervals_figure"]

#: Intervals are clipped at this number of standard deviations.
_MAX_DEVIATION = 8.0
#: Distance of the two bars of an unknown from the middle of its row.
_OFFSET = 0.14


class UncertaintySection(ReportSection):
    """Intervals by profile, bootstrap or sampling."""

    anchor = "uncertainty"
    name = "Uncertainty"
    heading = "Uncertainty"
    place = 500
    template = "updyn.report/uncertainty.html"

    def applies(self, content: PageContent) -> bool:
        """Whether the page shows an update."""
        return content.update is not None

    def figures(self, content: PageContent) -> dict[str, Figure]:
        """Return the intervals and, for a single test, the band of an FRF."""
        update, found = content.update, content.further["uncertainty"]
        assert update is not None
        out: dict[str, Figure] = {}
        intervals = intervals_figure(update, found)
        if intervals is not None:
            out["uncertainty-intervals"] = intervals
        if content.has_frfs:
            assert isinstance(update, UpdateResult)
            band = band_figure(update, found)
            if band is not None:
                figure, channel = band
                out["uncertainty-band"] = figure | {"channel": channel}
        return out

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the kind of intervals and the rows of their table."""
        found: Draws | Profiles = content.further["uncertainty"]
        percent = f"{100 * find_level(found):g} %"
        diagnosed = isinstance(found, Draws) and "r_hat" in found.diagnostics
        diagnostics = ["R-hat", "effective draws"] if diagnosed else []
        head = ["unknown", "value", "std. dev.", f"{percent}, lower", "upper", *diagnostics, "note"]
        rows = _list_rows(content.result, found)
        if not any(cells[-1] for cells in rows):  # omit an empty column
            head, rows = head[:-1], [cells[:-1] for cells in rows]
        return {
            "kind": _kind(found),
            "message": found.message,
            "percent": percent,
            "head": head,
            "kinds": ["note-cell" if name == "note" else "" for name in head],
            "rows": rows,
        }


UNCERTAINTY = UncertaintySection()


def _list_rows(result: UpdateResult, found: Draws | Profiles) -> list[list[str]]:
    """Return the table cells of each unknown, the note last."""
    out = []
    for name, (low, high) in find_intervals(found).items():
        value, std = result.values[name], result.std[name]
        cells = [name, estimate(value, std), format_padded(std, 2)]
        cells += [estimate(low, std), estimate(high, std)]
        if isinstance(found, Profiles):
            cells.append(found[name].note)
        elif "r_hat" in found.diagnostics:
            k = found.names.index(name)
            figures = (found.diagnostics[key][k] for key in ("r_hat", "ess_bulk"))
            cells += [*(number(float(figure)) for figure in figures), ""]
        else:
            cells.append("")
        out.append(cells)
    return out


def _kind(found: Draws | Profiles) -> str:
    """Return ``"profile"``, ``"bootstrap"`` or ``"sampling"``."""
    if isinstance(found, Profiles):
        return "profile"
    return found.kind


def find_level(found: Draws | Profiles) -> float:
    """Return the level of the intervals, 0.95 by default."""
    if isinstance(found, Profiles):
        return found.level
    return float(found.options.get("level", 0.95))


def find_intervals(found: Draws | Profiles) -> dict[str, tuple[float, float]]:
    """Return the interval of each unknown; empty if there are fewer than two draws."""
    if isinstance(found, Profiles):
        return found.intervals()
    if len(found) < 2:
        return {}
    return found.intervals(find_level(found))


# -- intervals -----------------------------------------------------------------------------------
def intervals_figure(result: UpdateResult | JointResult, found: Draws | Profiles) -> Figure | None:
    """Return the intervals of the unknowns in Laplace standard deviations; None without any."""
    # Intervals of unknowns whose logarithm is estimated are shown on it.
    intervals = find_intervals(found)
    chosen = [
        p for p in result.parameters if p.name in intervals and 0 < result.std[p.name] < np.inf
    ]
    if not chosen:
        return None
    at = np.empty((len(chosen), 2))
    for i, p in enumerate(chosen):
        value, std = result.values[p.name], result.std[p.name]
        span = np.array(intervals[p.name])
        at[i] = (span - value) / std
        if p.is_log:
            with np.errstate(divide="ignore", invalid="ignore"):
                at[i] = np.log(span / value) * (value / std)
    low, high = np.clip(at, -_MAX_DEVIATION, _MAX_DEVIATION).T
    rows = np.arange(len(chosen), dtype=np.float64)
    z = np.full(len(chosen), -_normal_quantile(0.5 - 0.5 * find_level(found)))
    names = escape_labels(f"{p.group}: {quantity_words(p.quantity)}" for p in chosen)
    return {
        "data": [
            _bars("Laplace", z, z, rows - _OFFSET, "@before", names),
            _bars(_kind(found), -low, high, rows + _OFFSET, "@after", names),
        ],
        "height": rows_height(len(chosen), extra=130),
        "layout": {
            "xaxis": {"title": {"text": "standard deviations from the estimate"}, "zeroline": True},
            "yaxis": {
                "tickvals": rows.tolist(),
                "ticktext": names,
                "range": [len(chosen) - 0.4, -0.6],
                "zeroline": False,
                "tickfont": names_font(names),
            },
            "showlegend": True,
        },
    }


def _normal_quantile(p: float) -> float:
    from scipy.special import ndtri

    return float(ndtri(p))


def _bars(
    name: str,
    minus: RealArray,
    plus: RealArray,
    rows: RealArray,
    colour: str,
    names: list[str],
) -> dict[str, object]:
    return {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "x": encode_numbers(np.zeros(len(rows))),
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


# -- band ----------------------------------------------------------------------------------------
def band_figure(result: UpdateResult, found: Draws | Profiles) -> tuple[Figure, str] | None:
    """Return the most uncertain measured FRF with the band of the updated model, and its channel.

    The band is computed from draws, or by Laplace's approximation for profiles. None if it is too
    expensive or not computable.
    """
    frf = result.frf
    lines = frf.freq[frf.freq > 0]
    every = np.ones(len(lines), dtype=np.bool_)
    lines = lines[keep_lines(frf.select(lines=lines).values, every, REPORT_COMPUTATION.band_lines)]
    source: UpdateResult | Draws = result
    solves = 3
    if isinstance(found, Draws) and len(found) > 1:
        solves = min(len(found), REPORT_COMPUTATION.band_draws)
        at = np.unique(np.linspace(0, len(found) - 1, solves).round().astype(np.intp))
        source = replace(found, chains=found.values[at][None], result=result)
    most = REPORT_COMPUTATION.band_cost * REPORT_COMPUTATION.evaluation_budget
    for freq in (_add_resonance_lines(result, lines), lines):
        if solves * len(freq) * result.model.n_dofs > most:
            continue
        try:
            band = predict(source, freq, frf.responses, frf.references, level=find_level(found))
        except UpdynError:  # the model may be singular at an added line only
            continue
        break
    else:
        return None
    measured = np.searchsorted(freq, lines)
    with np.errstate(divide="ignore", invalid="ignore"):
        width = np.median(np.log(band.upper[measured] / band.lower[measured]), axis=0)
    widest = int(np.argmax(np.where(np.isfinite(width), width, -1.0)))
    i, j = map(int, np.unravel_index(widest, width.shape))
    if not np.isfinite(width[i, j]):
        return None
    return _draw_band(band, result, lines, i, j), f"{frf.responses[i]} / {frf.references[j]}"


def _add_resonance_lines(result: UpdateResult, lines: RealArray) -> RealArray:
    """Return the lines together with further lines in Hz that resolve the peaks of the curves."""
    room = REPORT_COMPUTATION.band_lines - len(lines)
    if room < 2 or len(lines) < 2:
        return lines
    low, high = float(lines[0]), float(lines[-1])
    if result.options.get("tier") == "reduced":  # modes of the full model are expensive
        return np.union1d(lines, even_lines(low, high, room))
    return np.union1d(lines, resonance_lines(fix_base(result.model, result.frf), low, high, room))


def _draw_band(band: Band, result: UpdateResult, lines: RealArray, i: int, j: int) -> Figure:
    """Return the band of one channel with the updated model and the data."""
    freq = band.frf.freq
    gains = estimated_gains(result)  # the band is that of the structure, without sensor gains
    measured = np.abs(result.frf.select(lines=lines).values[:, i, j])
    if gains is not None:
        measured = measured / np.abs(gains[i, j])
    unit_of = unit(band.frf.quantity, str(band.frf.responses[i]), str(band.frf.references[j]))
    tiny = np.finfo(np.float32).tiny
    line = {"type": "scatter", "mode": "lines", "x": encode_numbers(freq), "hoverinfo": "skip"}
    edge = {"width": 0, "color": "@after"}
    lower = {
        "y": encode_numbers(np.maximum(band.lower[:, i, j], tiny)),
        "line": edge,
        "showlegend": False,
    }
    upper = {
        "name": f"{100 * band.level:g} % band",
        "y": encode_numbers(np.maximum(band.upper[:, i, j], tiny)),
        "line": edge,
        "fill": "tonexty",
        "fillcolor": "@after-faint",
    }
    model = {
        "name": "updated model",
        "y": encode_numbers(np.abs(band.frf.values[:, i, j])),
        "line": {"color": "@after"},
    }
    data = {
        "type": "scatter",
        "mode": "markers",
        "name": "measured",
        "x": encode_numbers(lines),
        "y": encode_numbers(measured),
        "marker": {"color": "@measured", "size": 3},
        "hovertemplate": f"%{{x:.5g}} Hz: %{{y:.4g}} {unit_of}<extra></extra>",
    }
    return {
        "data": [line | lower, line | upper, line | model, data],
        "height": 380,
        "layout": {
            "xaxis": linear_frequency(lines),
            "yaxis": {
                "title": {"text": f"{band.frf.quantity} ({unit_of})"},
                "type": "log",
                "dtick": log_step(measured),
                "exponentformat": "power",
            },
            "showlegend": True,
        },
    }
