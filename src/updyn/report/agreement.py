"""Sections on agreement of measured and computed FRFs: FRF correlation, FRAC, CSAC, FDAC."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from updyn.arrays import ComplexArray, IndexArray, RealArray
from updyn.correlation import correlate, csf, fdac
from updyn.correlation.figures import ONE_AT_BEST, figure_text
from updyn.correlation.frfs import nonzero_lines
from updyn.frf import FRF
from updyn.report.data import ReportData
from updyn.report.formats import figure_of_agreement, number, percentage, unit, validation_words
from updyn.report.plots import (
    DIVERGING,
    MODEL_COLOURS,
    SEQUENTIAL,
    Figure,
    categories,
    colour_bar,
    drop_missing,
    encode_numbers,
    escape_label,
    escape_labels,
    linear_frequency,
    rows_height,
)
from updyn.report.section import PageContent, ReportSection
from updyn.report.settings import REPORT_LIST, REPORT_SIZE
from updyn.settings import FIGURES
from updyn.updating.result import UpdateResult

__all__ = [
    "AGREEMENT",
    "VALIDATION",
    "agreement_figures",
    "compute_agreement",
    "correlation_maps",
    "csac_lines",
    "csf_lines",
    "fdac_maps",
    "level_difference",
]


_MAP_HEIGHT = 420


def correlation_maps(data: ReportData) -> dict[str, Figure]:
    """Return FRF correlation maps before and after the update, by name of the figure."""
    made = {}
    for when, correlation, frac, residual in (
        ("before", data.correlation_before, data.frac_before, data.residual_before),
        ("after", data.correlation_after, data.frac_after, data.residual_after),
    ):
        if correlation is not None and frac is not None and residual is not None:
            made[f"frf-correlation-{when}"] = _correlation_map(data, correlation, frac, residual)
    return made


def _correlation_map(
    data: ReportData,
    correlation: RealArray,
    frac: RealArray,
    residual: RealArray,
) -> Figure:
    """Return a heat map from -1 to 1: responses down, references across."""
    rows, hover = [], []
    for i, (response, held) in enumerate(zip(data.responses, data.held_out, strict=True)):
        rows.append(f"{response} ◆" if held else response)
        first = f"response {escape_label(response)}"
        if held:
            first += " (held out)"
        texts = []
        for j, reference in enumerate(data.references):
            texts.append(
                f"{first}<br>reference {escape_label(reference)}"
                f"<br>correlation {correlation[i, j]:.4f}"
                f"<br>FRAC {frac[i, j]:.4f}<br>relative residual {percentage(residual[i, j])}"
            )
        hover.append(texts)
    height = max(rows_height(len(rows), extra=110), 190)
    trace = {
        "type": "heatmap",
        "z": encode_numbers(correlation),
        "x": list(range(len(data.references))),
        "y": list(range(len(rows))),
        "zmin": -1.0,
        "zmax": 1.0,
        "colorscale": DIVERGING,
        "xgap": 1,
        "ygap": 1,
        "hovertext": hover,
        "hoverinfo": "text",
        "colorbar": colour_bar("correlation", (-1, -0.5, 0, 0.5, 1), height),
    }
    if correlation.size == 1:
        trace["showscale"] = False
    if correlation.size <= FIGURES.printed_cells:
        trace["text"] = [escape_labels(map(figure_of_agreement, values)) for values in correlation]
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
    """Return CSAC over frequency, before and after the update."""
    return _plot_by_line(data, "CSAC", data.csac_before, data.csac_after)


def csf_lines(data: ReportData) -> Figure | None:
    """Return CSF over frequency, before and after the update."""
    found = [None if h is None else csf(data.measured, h) for h in (data.before, data.after)]
    return _plot_by_line(data, "CSF", *found)


def _plot_by_line(
    data: ReportData,
    criterion: str,
    before: RealArray | None,
    after: RealArray | None,
) -> Figure | None:
    """Return a criterion between 0 and 1 over frequency, before and after the update."""
    if before is None and after is None:
        return None
    traces: list[dict[str, object]] = []
    x = encode_numbers(data.freq)
    for name, found, computed, dash in (
        ("start", before, data.before, "dot"),
        ("updated", after, data.after, "solid"),
    ):
        if found is None or computed is None:
            continue
        values = np.where(nonzero_lines(data.measured, computed), found, np.nan)
        traces.append(
            {
                "type": "scatter",
                "mode": "lines+markers" if data.freq.size <= FIGURES.measured_points else "lines",
                "marker": {"size": 5, "color": MODEL_COLOURS[name]},
                "name": name,
                "x": x,
                "y": encode_numbers(values),
                "line": {"color": MODEL_COLOURS[name], "dash": dash, "width": 1.6},
                "hovertemplate": f"%{{x:.5g}} Hz: {criterion} {name} %{{y:.3f}}<extra></extra>",
            }
        )
    return {
        "data": traces,
        "height": 300,
        "layout": {
            "xaxis": linear_frequency(data.freq),
            "yaxis": {"title": {"text": criterion}, "range": [-0.02, 1.04]},
            "showlegend": True,
        },
    }


def fdac_maps(data: ReportData) -> dict[str, Figure]:
    """Return FDAC maps before and after the update, by name of the figure."""
    made = {}
    lines = _thin_lines(data)
    if len(data.responses) * len(data.references) >= REPORT_LIST.fdac_channels and len(lines) > 1:
        for when, values in (("before", data.before), ("after", data.after)):
            if values is not None:
                found = fdac(data.measured[lines], values[lines])
                made[f"fdac-{when}"] = _fdac_map(data.freq[lines], found)
    return made


def _thin_lines(data: ReportData) -> IndexArray:
    """Return all compared lines, or the line with the highest level in each of `_LINES` bins."""
    compared = np.arange(len(data.freq))[data.compared]
    if len(compared) <= REPORT_SIZE.fdac_lines:
        return compared
    level = np.sum(np.abs(data.measured[compared]) ** 2, axis=(1, 2))
    edges = np.linspace(0, len(compared), REPORT_SIZE.fdac_lines + 1).astype(int)
    kept = [low + int(np.argmax(level[low:high])) for low, high in pairwise(edges)]
    return np.asarray(compared[kept])


def _fdac_map(freq: RealArray, found: RealArray) -> Figure:
    """Return an FDAC map, measured lines across, computed lines up, with ridge and diagonal."""
    x = encode_numbers(freq, packed=False)
    best = np.argmax(found, axis=0)
    matching = found[best, np.arange(len(freq))] >= REPORT_LIST.fdac_ridge
    ends = [float(freq[0]), float(freq[-1])]
    lines = "measured %{x:.5g} Hz, computed %{y:.5g} Hz"
    traces: list[dict[str, object]] = [
        {
            "type": "heatmap",
            "z": encode_numbers(np.round(found, 3)),
            "x": x,
            "y": x,
            "zmin": 0.0,
            "zmax": 1.0,
            "colorscale": SEQUENTIAL,
            "colorbar": colour_bar("FDAC", (0, 0.5, 1), _MAP_HEIGHT),
            "hovertemplate": f"{lines}<br>FDAC %{{z:.3f}}<extra></extra>",
        },
        {
            "type": "scatter",
            "mode": "lines",
            "x": ends,
            "y": ends,
            "line": {"color": "@muted", "width": 1, "dash": "dot"},
            "hoverinfo": "skip",
        },
        {
            "type": "scatter",
            "mode": "markers",
            "x": encode_numbers(freq[matching], packed=False),
            "y": encode_numbers(freq[best[matching]], packed=False),
            "marker": {"color": "@before", "size": 4},
            "hovertemplate": f"best match: {lines}<extra></extra>",
        },
    ]
    return {
        "data": traces,
        "height": _MAP_HEIGHT,
        "layout": {
            "xaxis": {"title": {"text": "measured (Hz)"}, "range": ends},
            "yaxis": {"title": {"text": "computed (Hz)"}, "range": ends},
            "showlegend": False,
        },
    }


def level_difference(measured: ComplexArray, computed: ComplexArray) -> RealArray:
    """Return 20 log10 abs(computed / measured) in dB as a flat array, omitting zeros."""
    a, b = np.abs(computed).ravel(), np.abs(measured).ravel()
    nonzero = (a > 0) & (b > 0)
    return np.asarray(20.0 * np.log10(a[nonzero] / b[nonzero]))


def agreement_figures(result: UpdateResult, data: ReportData) -> dict[str, dict[str, float]]:
    """Return the figures of agreement ``before``, ``after`` and of the ``validation`` set."""
    # Figures that the result lacks are computed from the FRFs of the page.
    validation = result.correlation.get("validation") or {}
    computed = {"before": data.before, "after": data.after}
    out = {"validation": dict(validation.get("after") or {})}
    for when, values in computed.items():
        out[when] = dict(result.correlation.get(when) or {}) or compute_agreement(data, values)
    return out


def compute_agreement(data: ReportData, values: ComplexArray | None) -> dict[str, float]:
    """Return `Correlation.figures` over the fitted responses of a page; empty without any."""
    fitted = ~np.array(data.held_out, dtype=np.bool_)
    if values is None or not fitted.any():
        return {}
    responses = [label for label, kept in zip(data.responses, fitted, strict=True) if kept]
    measured, computed = (
        FRF(
            data.freq[data.compared],
            given[data.compared][:, fitted],
            responses,
            data.references,
            data.quantity,
        )
        for given in (data.measured, values)
    )
    return correlate(computed, measured).figures()


def _list_scores(
    before: Mapping[str, float] | None, after: Mapping[str, float] | None
) -> list[tuple[str, str, str]]:
    """Return (name, value before, value after) of each figure of agreement."""
    before, after = before or {}, after or {}
    names = dict.fromkeys([*before, *after])
    return [(name, _format_figure(name, before), _format_figure(name, after)) for name in names]


def _format_figure(name: str, figures: Mapping[str, float]) -> str:
    value = figures.get(name)
    if value is None or not math.isfinite(value) or not name.startswith(ONE_AT_BEST):
        return number(value, 3)
    return figure_text(name, value).replace("-", "−")


def _list_units(data: ReportData) -> set[str]:
    return {unit(data.quantity, i, j) for i in data.responses for j in data.references}


class AgreementSection(ReportSection):
    """FRF correlation before and after the update; CSAC and CSF over frequency; FDAC."""

    anchor = "agreement"
    name = "Correlation"
    heading = "Correlation"
    place = 200
    template = "updyn.report/agreement.html"
    needs_frfs = True
    of_start = True

    def figures(self, content: PageContent) -> dict[str, Figure]:
        """Return the FRF correlation maps, CSAC and CSF over frequency, and FDAC maps."""
        data = content.data
        curves = drop_missing({"csac": csac_lines(data), "csf": csf_lines(data)})
        return correlation_maps(data) | curves | fdac_maps(data)

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the compared lines and the figures of agreement of the fit."""
        data = content.data
        correlation = content.result.correlation if data.fitted else {}
        lines = data.freq[data.compared]
        return {
            "n_lines": len(lines),
            "low": lines.min(initial=np.inf),
            "high": lines.max(initial=-np.inf),
            "held_out": any(data.held_out),
            "scores": _list_scores(correlation.get("before"), correlation.get("after")),
            "one_channel": len(data.responses) * len(data.references) == 1,
            "several_units": len(_list_units(data)) > 1,
        }


class ValidationSection(ReportSection):
    """Agreement with the validation set: the data held out of the fit."""

    anchor = "validation"
    name = "Validation"
    heading = "Validation"
    place = 900
    template = "updyn.report/validation.html"
    needs_frfs = True

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the held-out data and the figures of their prediction."""
        result = content.result
        scores = result.correlation.get("validation") or {}
        return {
            "held_out": validation_words(result),
            "scores": _list_scores(scores.get("before"), scores.get("after")),
            "channels": _validation_channels(content.data),
        }


def _validation_channels(data: ReportData) -> list[list[str]]:
    """Return the name and the figures before and after the update of each held-out channel."""
    measures = (
        (data.correlation_before, data.correlation_after, figure_of_agreement),
        (data.frac_before, data.frac_after, figure_of_agreement),
        (data.residual_before, data.residual_after, percentage),
    )
    out = []
    for i in np.flatnonzero(data.held_out).tolist():
        for j, reference in enumerate(data.references):
            cells = [f"{data.responses[i]} / {reference}"]
            for before, after, say in measures:
                shown = ["–" if v is None else say(float(v[i, j])) for v in (before, after)]
                cells.append(" → ".join(shown))
            out.append(cells)
    return out


AGREEMENT = AgreementSection()
VALIDATION = ValidationSection()
