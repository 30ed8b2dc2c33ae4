"""The section of the report on model error: is what is left noise, where not, and what would explain it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.report import formats as w
from updyn.report import markup as m
from updyn.report.agreement import level_difference
from updyn.report.data import ReportData
from updyn.report.plots import (
    Figure,
    categories,
    colour_bar,
    existing,
    label,
    labels,
    log_step,
    numbers,
    rows_height,
)
from updyn.report.section import Content, Section
from updyn.updating.judge.adequacy import Adequacy, Misfit, Suspect

__all__ = [
    "MODEL_ERROR",
    "MOST_ROWS",
    "NOISE",
    "misfit_map",
    "relative_residual",
    "shown_channels",
    "tile",
]

_TILES = {
    "noise": ("noise", "nothing speaks against the model"),
    "structure": ("model error", "the model cannot follow the data everywhere"),
    "excess": ("more than noise", "but not alike from line to line"),
    "exact": ("nothing", "the model answers the data exactly"),
    "untested": ("not tested", "too few measured numbers"),
}
_UNEXPLAINED = (
    "No change of one quantity that is not an unknown would explain a tenth of it: look at the"
    " sensors, at joints and parts that the model lacks, and at what is not linear."
)
_EXPLAINED = (
    "Of the quantities that are not unknowns, a change of these would take away most of what is"
    " left, the unknowns adapting to it; to first order, so that the sign can be trusted more than"
    " the size. What the sensors cannot tell apart has nearly the same share. Free what can be"
    " wrong, and run again."
)


def tile(found: Adequacy) -> tuple[str, str, str]:
    """Return name, value and hint of the tile in the head."""
    return ("What is left", *_TILES[found.outcome])


class ModelError(Section):
    """Tests of the residual, and what would explain it."""

    anchor = "model-error"
    name = "Model error"
    heading = "Model error"
    place = 1000

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return the map of the misfit."""
        return existing({"misfit-map": misfit_map(content.result.adequacy)})

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return verdict, map, worst places and suspects; nothing where the residual was not tested."""
        found = content.result.adequacy
        if found is None:
            return ""
        parts = [m.paragraph(found.verdict)]
        if "misfit-map" in figures:
            parts.append(_map(figures, found))
        if found.worst:
            parts.append(_places(found))
        if found.explained_by:
            parts.append(_suspects(found))
        elif found.outcome == "structure":
            parts.append(m.paragraph(_UNEXPLAINED))
        parts.append(m.details("How it was tested", m.paragraph(_how(found))))
        return "".join(parts)


MODEL_ERROR = ModelError()


def _map(figures: Mapping[str, Figure], found: Adequacy) -> str:
    channels = found.misfit.shape[0] * found.misfit.shape[1]
    some = (
        f" The {MOST_ROWS} worst of {channels} channels are shown."
        if len(shown_channels(found)) < channels
        else ""
    )
    taken = "; 1 is noise" if found.absolute else ", as the size of the noise was taken from it"
    caption = (
        f"Root mean square misfit over {_unit(found)}{taken}, by channel and band about each"
        " resonance. Marked: alike from line to line (an error of the model), and only too"
        f" large.{some}"
    )
    height = figures["misfit-map"]["height"]
    return m.figure("misfit-map", "Misfit of every channel in every band", caption, height=height)


def _places(found: Adequacy) -> str:
    head = [
        "response / reference",
        "band (Hz)",
        "most near (Hz)",
        "misfit",
        "alike over",
        "p of size",
        "p of likeness",
    ]
    caption = (
        f"Places that stand out, the worst first. Misfit as a multiple of {_unit(found)}; p-values"
        f" adjusted for the number of tests, suspect below {w.number(found.level)}"
    )
    return m.table(head, [m.row(_place(p)) for p in found.worst], caption=caption)


def _unit(found: Adequacy) -> str:
    return "the noise" if found.absolute else "the typical misfit"


def _place(p: Misfit) -> list[str]:
    return [
        f"{p.response} / {p.reference}",
        f"{w.number(p.low)} to {w.number(p.high)}",
        w.number(p.near),
        w.number(p.misfit, 3),
        w.counted(round(p.alike), "line") if p.kind == "structure" else "–",
        _p(p.chi_square_p),
        _p(p.whiteness_p),
    ]


def _p(value: float) -> str:
    return "< 10⁻⁹" if value < 1e-9 else w.number(value, 2)


def _suspects(found: Adequacy) -> str:
    head = ["quantity", "would explain", "change", "share of the energy of the error"]
    rows = [m.row(_suspect(s)) for s in found.explained_by]
    return f"<h3>What would explain it</h3>{m.paragraph(_EXPLAINED)}{m.table(head, rows)}"


def _suspect(s: Suspect) -> list[str]:
    if s.quantity == "loss_factor":
        change = f"{s.change:+.2g}".replace("-", "−")
    else:
        change = (
            ("up by " if s.change > 0 else "down by ")
            + w.number(100.0 * abs(math.expm1(s.change)), 2)
            + " %"
        )
    return [w.unknown(s.name), f"{100.0 * s.explains:.0f} %", change, f"{100.0 * s.energy:.0f} %"]


def _how(found: Adequacy) -> str:
    if found.absolute:
        size = (
            "The sum of squares of each channel in each band is compared with what the noise gives"
            " (chi-square or F)."
        )
    else:
        size = (
            "The size of the noise was taken from this residual, so the sum of squares of each"
            " channel in each band is compared with that of all the rest (F): a misfit that is the"
            " same everywhere does not show by its size."
        )
    return (
        f"{size} Likeness from line to line is tested by the autocorrelation at lags 1 to 3, which"
        " needs no size of the noise. All p-values are adjusted for their number such that at most"
        f" {w.number(100.0 * found.level)} % of fits to pure noise are suspected."
    )


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


_NOISE_WORDS = {
    "kind": "how the noise is known",
    "relative": "part proportional to the level",
    "floor": "floor",
    "relative_by_channel": "part proportional to the level, by response",
    "floor_by_channel": "floor, by response",
    "spread": "residual, as if all values were equally sure",
    "modes": "modes fitted",
    "frequency_rms": "frequencies, rms of model over measured less 1",
    "shape_rms": "shapes, root of the mean of 1 - MAC",
    "lowest_mac": "lowest MAC of a pair",
    "left_out": "measured modes like none of the model",
    "chi_square": "reduced chi-square",
    "correlation_length": "lines over which the residual is correlated",
    "inflation": "factor on the standard deviations",
    "robust": "outliers",
    "down_weighted": "share of values with less than a tenth of their weight",
    "down_weighted_lines": "lines half of whose values do, Hz",
    "down_weighted_channels": "channels half of whose values do",
}


class Noise(Section):
    """Noise model and residual."""

    anchor = "noise"
    name = "Noise and residual"
    heading = "Noise and residual"
    place = 1100

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return level differences and the residual by channel."""
        return existing(
            {
                "level-differences": level_differences(content.data),
                "residual-by-channel": residual_by_channel(content.data),
            }
        )

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return noise model and what is left over."""
        items = [
            (_NOISE_WORDS.get(k, k), w.number(v) if isinstance(v, float) else w.plain(v))
            for k, v in content.result.noise.items()
        ]
        chi = content.result.noise.get("chi_square")
        parts = []
        if isinstance(chi, int | float) and math.isfinite(chi):
            parts.append(m.paragraph(_chi_words(float(chi), content.result.noise)))
        if "down_weighted" in content.result.noise:
            parts.append(m.paragraph(_outlier_words(content.result.noise)))
        parts.append(
            m.definition_table(items)
            if items
            else m.paragraph("The method used no noise model.", "muted")
        )
        if "level-differences" in figures:
            caption = (
                "How often the computed level lies above (positive) or below the measured one, over all"
                " channels and the lines compared; values beyond ±30 dB are counted at the ends."
            )
            parts.append("<h3>Level differences</h3>")
            parts.append(
                m.figure(
                    "level-differences",
                    "Histogram of level differences",
                    caption,
                    height=figures["level-differences"]["height"],
                )
            )
        if "residual-by-channel" in figures:
            caption = (
                "Root mean square of computed minus measured (magnitude and phase) over the lines"
                " compared, in percent of the channel's measured level: a channel that stands out"
                " points to a sensor or a place in the model."
            )
            parts.append("<h3>Residual by channel</h3>")
            parts.append(
                m.figure(
                    "residual-by-channel",
                    "Residual of every channel",
                    caption,
                    height=figures["residual-by-channel"]["height"],
                )
            )
        return "".join(parts)


NOISE = Noise()


def _chi_words(chi: float, noise: Mapping[str, Any]) -> str:
    shown = w.number(chi, 3)
    if w.noise_is_fitted(noise):
        return (
            f"Reduced chi-square {shown}, by construction: the noise is taken from what is left,"
            " model error included."
        )
    if chi > 2.0:
        return (
            f"Reduced chi-square {shown}: the residual is {w.number(math.sqrt(chi), 2)} times what"
            " the noise explains. Part of it is an error of the model's form (or the noise is"
            " larger than stated)."
        )
    if chi < 0.5:
        return (
            f"Reduced chi-square {shown}: the residual is smaller than the noise stated, which is"
            " stated too large."
        )
    return f"Reduced chi-square {shown}: the noise explains what is left."


def _outlier_words(noise: Mapping[str, Any]) -> str:
    """Return what counted next to nothing, as it did not fit the rest."""
    share = float(noise["down_weighted"])
    if share == 0.0:
        return "No value stands out: all keep more than a tenth of their weight."
    lines, channels = noise.get("down_weighted_lines", ()), noise.get("down_weighted_channels", ())
    whole = [f"the lines {w.plain(lines)} Hz"] if lines else []
    whole += [f"the channels {w.plain(channels)}"] if channels else []
    among = f" Among them at least half of {' and '.join(whole)}." if whole else ""
    return (
        f"{w.number(100.0 * share, 2)} % of the values stand out and have less than a tenth of"
        f" their weight.{among} Look at them: a hum, an overload or a loose sensor makes outliers;"
        " a resonance that the model lacks does, too."
    )


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
