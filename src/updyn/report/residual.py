"""Sections on the residual of a fit: noise or model error, level differences, misfit by channel."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, IndexArray, RealArray
from updyn.report.agreement import level_difference
from updyn.report.data import ReportData
from updyn.report.formats import format_count, noise_is_fitted, number, option_words, unknown_words
from updyn.report.plots import (
    MODEL_COLOURS,
    SEQUENTIAL,
    Figure,
    Trace,
    categories,
    colour_bar,
    drop_missing,
    encode_numbers,
    escape_label,
    escape_labels,
    log_step,
    rows_height,
)
from updyn.report.section import PageContent, ReportSection
from updyn.report.settings import REPORT_LIST
from updyn.updating.judge.adequacy import Adequacy, Misfit, Suspect

__all__ = ["NOISE", "RESIDUAL", "misfit_map", "residual_tile", "shown_channels"]

#: Value and hint of the key figure, by the outcome of the residual test.
_TILES = {
    "noise": ("noise", "consistent with the model"),
    "structure": ("model error", "the model cannot follow the data everywhere"),
    "excess": ("more than noise", "but not serially correlated"),
    "exact": ("none", "the model fits the data exactly"),
    "untested": ("not tested", "too few measured numbers"),
}
#: Colour range of the misfit over the noise, and the ticks of the colour bar.
_BOTTOM = 0.3
_TOP = 10.0
_TICKS = (0.5, 1.0, 2.0, 5.0, _TOP)
_LARGE_POINTS = 60


def residual_tile(found: Adequacy) -> tuple[str, str, str]:
    """Return (name, value, hint) of the key figure on the residual."""
    return ("Residual", *_TILES[found.outcome])


# -- residual ------------------------------------------------------------------------------------
class ResidualSection(ReportSection):
    """The residual: its size, tests of it against noise, and parameters that would explain it."""

    anchor = "residual"
    name = "Residual"
    heading = "Residual"
    place = 1000
    template = "updyn.report/residual.html"
    needs_frfs = True

    def figures(self, content: PageContent) -> dict[str, Figure]:
        """Return the misfit map, the level differences and the residual by channel."""
        return drop_missing(
            {
                "misfit-map": misfit_map(content.result.adequacy),
                "level-differences": level_differences(content.data),
                "residual-by-channel": residual_by_channel(content.data),
            }
        )

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the outcome of the tests, the worst channels and bands, and the suspects."""
        found = content.result.adequacy
        if found is None:
            return {"found": None}
        return {
            "found": found,
            "verdict": "" if found.verdict in content.result.message else found.verdict,
            "n_channels": found.misfit.shape[0] * found.misfit.shape[1],
            "n_shown": len(shown_channels(found)),
            "places": list(map(_format_misfit, found.worst)),
            "suspects": list(map(_format_suspect, found.explained_by)),
            "confirmed": all(suspect.confirmed for suspect in found.explained_by),
        }


RESIDUAL = ResidualSection()


def _format_misfit(place: Misfit) -> list[str]:
    """Return the table cells of a channel and band with a suspicious residual."""
    correlated = "–"
    if place.kind == "structure":
        correlated = format_count(round(place.correlation_length), "line")
    return [
        f"{place.response} / {place.reference}",
        f"{number(place.low)} to {number(place.high)}",
        number(place.near),
        number(place.misfit, 3),
        correlated,
        _format_p_value(place.chi_square_p),
        _format_p_value(place.whiteness_p),
    ]


def _format_p_value(value: float) -> str:
    return "< 10⁻⁹" if value < 1e-9 else number(value, 2)


def _format_suspect(suspect: Suspect) -> list[str]:
    """Return the table cells of a quantity that would explain the residual."""
    if suspect.quantity == "loss_factor":
        change = f"{suspect.change:+.2g}".replace("-", "−")
    else:
        way = "up" if suspect.change > 0 else "down"
        change = f"{way} by {number(100.0 * abs(math.expm1(suspect.change)), 2)} %"
    return [
        unknown_words(suspect.name),
        f"{100.0 * suspect.explains:.0f} %",
        change,
        f"{100.0 * suspect.energy:.0f} %",
    ]


def shown_channels(found: Adequacy) -> IndexArray:
    """Return the (response, reference) positions of the channels in the map, shape (n, 2)."""
    worst = np.nan_to_num(found.misfit).max(axis=2)
    at = np.argwhere(np.isfinite(found.misfit).any(axis=2))
    if len(at) > REPORT_LIST.misfit_channels:
        order = np.argsort(-worst[tuple(at.T)], kind="stable")
        at = at[np.sort(order[: REPORT_LIST.misfit_channels])]
    return np.asarray(at, dtype=np.intp)


def misfit_map(found: Adequacy | None) -> Figure | None:
    """Return a heat map of the rms misfit over the noise: channels down, bands across."""
    # Channels and bands that a test finds suspicious are marked.
    if found is None:
        return None
    at = shown_channels(found)
    if not len(at):
        return None
    names = [f"{found.responses[i]} / {found.references[j]}" for i, j in at]
    edges = _find_edges(found.bands)
    height = max(rows_height(len(names), extra=110), 190)
    marks = _mark_traces(found, at, edges)
    trace = {
        "type": "heatmap",
        "z": encode_numbers(
            np.log10(np.clip(found.misfit[tuple(at.T)], _BOTTOM, _TOP)), packed=False
        ),
        "x": edges.tolist(),
        "y": list(range(len(names))),
        "zmin": float(np.log10(_BOTTOM)),
        "zmax": float(np.log10(_TOP)),
        "colorscale": SEQUENTIAL,
        "xgap": 1,
        "ygap": 1,
        "hovertext": [_hover_row(found, i, j) for i, j in at.tolist()],
        "hoverinfo": "text",
        "colorbar": _colour_bar(found, height),
    }
    return {
        "data": [trace, *marks],
        "height": height + 30 * bool(marks),
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


def _colour_bar(found: Adequacy, height: int) -> dict[str, object]:
    title = "misfit / noise" if found.absolute else "misfit / typical"
    texts = [f"{tick:g}" for tick in _TICKS]
    texts[-1] = f"≥ {texts[-1]}"
    return colour_bar(title, np.log10(_TICKS).tolist(), height) | {"ticktext": texts}


def _find_edges(bands: RealArray) -> RealArray:
    """Return the edges of the bands, halfway between neighbouring bands, shape (n_bands + 1,)."""
    inner = 0.5 * (bands[:-1, 1] + bands[1:, 0])
    low, high = float(bands[0, 0]), float(bands[-1, 1])
    if low == high:  # a single line
        low, high = 0.99 * low, 1.01 * high + 1e-9
    return np.array([low, *inner, high])


def _hover_row(found: Adequacy, i: int, j: int) -> list[str]:
    response, reference = escape_label(found.responses[i]), escape_label(found.references[j])
    where = f"response {response}<br>reference {reference}"
    unit = "noise" if found.absolute else "typical misfit"
    out = []
    for k, (low, high) in enumerate(found.bands.tolist()):
        misfit = float(found.misfit[i, j, k])
        if np.isnan(misfit):
            out.append("no data")
            continue
        length = number(float(found.correlation_length[i, j, k]), 2)
        size = number(float(found.chi_square_p[i, j, k]), 2)
        correlation = number(float(found.whiteness_p[i, j, k]), 2)
        out.append(
            f"{where}<br>{number(low)} to {number(high)} Hz"
            f"<br>misfit {number(misfit, 3)} times the {unit}<br>correlated over {length} lines"
            f"<br>p: size {size}, correlation {correlation}"
        )
    return out


def _mark_traces(found: Adequacy, at: IndexArray, edges: RealArray) -> list[dict[str, object]]:
    """Return marks on the cells that fail the test of correlation or the test of size."""
    correlated = found.whiteness_p[tuple(at.T)] <= found.level
    large = (found.chi_square_p[tuple(at.T)] <= found.level) & ~correlated
    marks = []
    if correlated.any():
        marks.append(_mark_trace("serially correlated", correlated, "diamond", edges))
    if large.any():
        marks.append(_mark_trace("too large", large, "circle", edges))
    return marks


def _mark_trace(name: str, where: BoolArray, symbol: str, edges: RealArray) -> dict[str, object]:
    middle = 0.5 * (edges[1:] + edges[:-1])
    rows, columns = np.nonzero(where)
    return {
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


# -- noise ---------------------------------------------------------------------------------------
_NOISE_WORDS = {
    "kind": "source of the noise model",
    "relative": "part proportional to the level",
    "floor": "floor",
    "relative_by_channel": "part proportional to the level, by response",
    "floor_by_channel": "floor, by response",
    "spread": "residual, all values weighted equally",
    "modes": "modes fitted",
    "frequency": "frequencies, standard deviation as a share",
    "shape": "shapes, standard deviation as a share of their rms",
    "loss_factor": "loss factors, standard deviation as a share",
    "scale": "size of shapes, standard deviation as a share",
    "by_ratio": "of the usual size",
    "frequency_rms": "frequencies, rms of model over measured less 1",
    "shape_rms": "shapes, root of the mean of 1 - MAC",
    "lowest_mac": "lowest MAC of a pair",
    "left_out": "measured modes without a counterpart in the model",
    "chi_square": "reduced chi-square",
    "degrees_of_freedom": "degrees of freedom of the estimate",
    "correlation_length": "lines over which the residual is correlated",
    "inflation": "factor on the standard deviations",
    "model_error": "share of the residual that local errors of the model explain",
    "not_known": "unknowns without an interval, for errors of the model",
    "robust": "outliers",
    "down_weighted": "share of values with less than a tenth of their weight",
    "down_weighted_lines": "lines with at least half of the values so weighted, Hz",
    "down_weighted_channels": "channels with at least half of the values so weighted",
}


class NoiseSection(ReportSection):
    """The noise model."""

    anchor = "noise"
    name = "Noise"
    heading = "Noise"
    place = 1100
    template = "updyn.report/noise.html"

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the noise model, and sentences that compare it with the residual."""
        noise = content.result.noise
        chi = noise.get("chi_square")
        sentences = []
        if isinstance(chi, int | float) and math.isfinite(chi):
            sentences.append(_chi_sentence(float(chi), noise))
        if "down_weighted" in noise:
            sentences.append(_outlier_sentence(noise))
        items = []
        for key, value in noise.items():
            text = number(value) if isinstance(value, float) else option_words(value)
            items.append((_NOISE_WORDS.get(key, key), text))
        return {"sentences": sentences, "items": items}


NOISE = NoiseSection()


def _chi_sentence(chi: float, noise: Mapping[str, object]) -> str:
    """Return a sentence that interprets the reduced chi-square."""
    start = f"Reduced chi-square {number(chi, 3)}"
    if noise_is_fitted(noise):
        return (
            f"{start}, by construction: the noise is estimated from the residual, model error"
            " included."
        )
    if chi > 2.0:
        return (
            f"{start}: the residual is {number(math.sqrt(chi), 2)} times what the noise explains."
            " Part of it is an error of the model's form (or the noise is larger than stated)."
        )
    if chi < 0.5:
        return f"{start}: the residual is smaller than the noise stated, which is stated too large."
    return f"{start}: the noise explains the residual."


def _outlier_sentence(noise: Mapping[str, Any]) -> str:
    """Return a sentence on the values that the robust weights nearly exclude."""
    share = float(noise["down_weighted"])
    if share == 0.0:
        return "No outliers: all values keep more than a tenth of their weight."
    lines = noise.get("down_weighted_lines", ())
    channels = noise.get("down_weighted_channels", ())
    whole = []
    if lines:
        whole.append(f"the lines {option_words(lines)} Hz")
    if channels:
        whole.append(f"the channels {option_words(channels)}")
    among = ""
    if whole:
        among = f" Among them at least half of {' and '.join(whole)}."
    return (
        f"{number(100.0 * share, 2)} % of the values stand out and have less than a tenth of"
        f" their weight.{among} Look at them: a hum, an overload or a loose sensor makes outliers;"
        " a resonance that the model lacks does, too."
    )


def level_differences(data: ReportData) -> Figure | None:
    """Return a histogram of 20 log10 |computed / measured| in dB, before and after."""
    traces = []
    if data.before is not None:
        trace = _histogram(data, data.before, "start")
        trace["line"]["dash"] = "dot"
        traces.append(trace)
    if data.after is not None:
        traces.append(_histogram(data, data.after, "updated") | {"fill": "tozeroy"})
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


def _histogram(data: ReportData, computed: ComplexArray, name: str) -> Trace:
    edges = np.linspace(-30.0, 30.0, 121)
    level = level_difference(data.measured[data.compared], computed[data.compared])
    counts, _ = np.histogram(np.clip(level, edges[0], edges[-1]), edges)
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": encode_numbers(0.5 * (edges[1:] + edges[:-1])),
        "y": encode_numbers(100.0 * counts / max(level.size, 1)),
        "line": {"color": MODEL_COLOURS[name], "shape": "hvh", "dash": "solid"},
        "fill": "none",
        "fillcolor": "@after-faint",
        "hovertemplate": f"{name}: %{{y:.2f}} % of the values at %{{x:.2f}} dB<extra></extra>",
    }


def _histogram_range(traces: list[Trace]) -> list[float]:
    """Return the range that contains the middle 99 % of each histogram, at least -3 to 3 dB."""
    reach = 3.0
    for trace in traces:
        x, share = np.array(trace["x"]), np.array(trace["y"])
        order = np.argsort(np.abs(x))
        inside = np.cumsum(share[order])
        edge = min(int(np.searchsorted(inside, 99.0)), len(x) - 1)
        reach = max(reach, float(np.abs(x[order[edge]])) + 0.5)
    return [-reach, reach]


def residual_by_channel(data: ReportData) -> Figure | None:
    """Return the relative residual of each channel in percent."""
    names = []
    for response, held in zip(data.responses, data.held_out, strict=True):
        mark = " ◆" if held else ""
        names += [f"{response}{mark} / {reference}" for reference in data.references]
    traces, shown = [], []
    if data.residual_before is not None:
        shown.append(100.0 * data.residual_before.ravel())
        traces.append(_channel_trace(shown[-1], names, "start", "circle-open"))
    if data.residual_after is not None:
        shown.append(100.0 * data.residual_after.ravel())
        traces.append(_channel_trace(shown[-1], names, "updated", "circle"))
    if not traces:
        return None
    axis: dict[str, Any] = {
        "title": {"text": "channel: response / reference"},
        "zeroline": False,
        "tickvals": list(range(len(names))),
        "ticktext": escape_labels(names),
        "tickangle": -50,
        "range": [-0.6, len(names) - 0.4],
    }
    height = 340
    if len(names) > REPORT_LIST.named_channels:
        axis = {
            "title": {"text": "channel number (names appear under the pointer)"},
            "zeroline": False,
        }
        height = 300
    return {
        "data": traces,
        "height": height,
        "layout": {
            "xaxis": axis,
            "yaxis": {
                "title": {"text": "relative residual (%)"},
                "type": "log",
                "dtick": log_step(np.concatenate(shown)),
                "exponentformat": "power",
            },
            "showlegend": True,
        },
    }


def _channel_trace(
    percent: RealArray, names: list[str], name: str, symbol: str
) -> dict[str, object]:
    return {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "x": list(range(len(names))),
        "y": encode_numbers(percent),
        "text": escape_labels(names),
        "marker": {
            "color": MODEL_COLOURS[name],
            "symbol": symbol,
            "size": 9 if len(names) <= _LARGE_POINTS else 5,
        },
        "hovertemplate": f"%{{text}}: %{{y:.3g}} % {name}<extra></extra>",
    }
