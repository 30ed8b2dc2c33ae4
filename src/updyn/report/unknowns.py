"""The sections of the report about the unknowns: their values, what the data determine, the way of the fit."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.group import VALUES
from updyn.report import formats as w
from updyn.report import markup as m
from updyn.report.formats import axis_title, interval, quantity_words
from updyn.report.plots import (
    PRINTED_CELLS,
    Figure,
    colour_bar,
    error_bars,
    existing,
    label,
    labels,
    log_step,
    numbers,
    rows_height,
)
from updyn.report.section import Content, Section
from updyn.updating.fit.methods import METHODS
from updyn.updating.problem.parameters import Parameter
from updyn.updating.result import UpdateResult

__all__ = [
    "CONVERGENCE",
    "IDENTIFIABILITY",
    "UNKNOWNS",
    "correlation_map",
    "correlations",
    "cost_path",
    "estimates",
    "singular_values",
    "value_paths",
]

_SEARCH = "trials from several starts, each jump up is the next"


def _stage_label(stage: str) -> str:
    """Return what a stage of the fit minimises, in words; empty where nothing is stated."""
    if stage == "search":
        return _SEARCH
    return METHODS[stage].label if stage in METHODS else ""


class Unknowns(Section):
    """The values of the unknowns."""

    anchor = "unknowns"
    name = "Unknowns"
    heading = "Unknowns"
    place = 400

    def applies(self, content: Content) -> bool:
        """Whether the page shows an update."""
        return content.update is not None

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return the estimates of each kind of unknown."""
        result = content.result
        return existing(
            {
                name: estimates(result, chosen)
                for name, chosen in _by_figure(result, "factors", "s", "calibrations").items()
            }
        )

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return table and figures of the unknowns."""
        kinds = ("", "text", "", "", "", "", "", "", "note-cell")
        sensors = [
            _parameter_row(content.result, p, kinds)
            for p in content.result.parameters
            if p.is_channel
        ]
        rows = [
            _parameter_row(content.result, p, kinds)
            for p in content.result.parameters
            if not p.is_channel
        ]
        caption = (
            "Stiffness, mass and viscous damping are factors on the start model (1 = unchanged); loss"
            " factors, mass damping (1/s) and stiffness damping (s) are values, relative to the updated"
            " stiffness or mass. The 95 % interval is symmetric in the logarithm for factors and cut at"
            " 0 for values; it covers the noise in the data, not errors of the model's form."
        )
        head = [
            "group",
            "quantity",
            "start",
            "value",
            "change",
            "std. dev.",
            "95 % interval",
            "bounds",
            "note",
        ]
        parts = []
        if rows:
            parts.append(m.table(head, rows, caption=caption, kinds=kinds))
        legend = (
            "Points: estimates with 95 % interval; short ticks: start; long grey ticks: bounds, where"
            " they lie in the range drawn; crosses: not determined by the data."
        )
        for name, title in (("factors", "Factors, relative to their start"), *_kinds("s")):
            parts += _estimates(figures, name, title, legend)
        if sensors:
            caption = (
                "Factors on what a sensor reads: above 1 it reads too much. They belong to the"
                " measurement: the updated model is without them, and its FRFs are shown and scored as"
                " the sensors would read them."
            )
            parts.append("<h3>Calibration of the sensors</h3>")
            parts.append(m.table(["sensor", *head[1:]], sensors, caption=caption, kinds=kinds))
            parts += _estimates(figures, "calibrations", "", legend)
        return "".join(parts)


UNKNOWNS = Unknowns()


def _by_figure(
    result: UpdateResult, factors: str, end: str, calibrations: str
) -> dict[str, list[Parameter]]:
    """Return the unknowns of each figure, by its name: factors, each kind of value, sensors."""
    out = {factors: [p for p in result.parameters if p.is_factor and not p.is_channel]}
    for kind in VALUES:
        out[w.figure_name(kind) + end] = [p for p in result.parameters if p.value_of == kind]
    out[calibrations] = [p for p in result.parameters if p.is_channel]
    return out


def _kinds(end: str) -> list[tuple[str, str]]:
    """Return name and title of the figures of each kind of value."""
    return [(w.figure_name(kind) + end, w.quantity_words(kind).capitalize()) for kind in VALUES]


def _estimates(figures: Mapping[str, Figure], name: str, title: str, legend: str) -> list[str]:
    if name not in figures:
        return []
    what = f"{title or 'Calibration factors'}: estimates, intervals and bounds"
    plot = m.figure(name, what, legend, height=figures[name]["height"])
    return [f"<h3>{title}</h3>", plot] if title else [plot]


def _parameter_row(result: UpdateResult, p: Parameter, kinds: tuple[str, ...]) -> str:
    value, std = result.values[p.name], result.std[p.name]
    span = w.interval(p, value, std)
    notes = []
    if p.name in result.at_bound:
        notes.append(f"at its {result.at_bound[p.name]} bound")
    if not math.isfinite(std):
        notes.append("not determined by the data")
    if p.nominal is not None:
        notes.insert(0, f"{p.physical(value, std)}, from {p.physical(p.start)}")
    if p.drives:
        notes.append(f"acts on {p.law}")
    if p.prior_std is not None:
        notes.append(f"prior standard deviation {w.number(p.prior_std, 3)}")
    cells = [
        p.group,
        w.quantity_words(p.quantity) + (f" ({p.value_unit})" if p.value_unit else ""),
        w.number(p.start),
        w.estimate(value, std),
        w.change(p, value),
        w.number(std, 2) if math.isfinite(std) else "–",
        f"{w.estimate(span[0], std)} to {w.estimate(span[1], std)}" if span else "open",
        f"{w.number(p.lower, 3)} to {w.number(p.upper, 3)}",
        "; ".join(notes),
    ]
    return m.row(
        cells,
        kinds,
        "open" if notes and (p.name in result.at_bound or not math.isfinite(std)) else "",
    )


class DeterminedUnknowns(Section):
    """The combinations of unknowns that the data determine."""

    anchor = "identifiability"
    name = "What is determined"
    heading = "What the data determine"
    place = 600

    def applies(self, content: Content) -> bool:
        """Whether the page shows an update."""
        return content.update is not None

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return singular values and correlations."""
        return existing(
            {
                "singular-values": singular_values(content.result),
                "correlation": correlation_map(content.result),
            }
        )

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return what the data determine, in words and figures."""
        ident = content.result.identifiability
        parts = [
            m.paragraph(
                f"The data determine all of the {w.counted(ident.n_parameters, 'unknown')}."
                if ident.complete
                else (
                    f"The data determine {ident.rank} independent combinations of the"
                    f" {ident.n_parameters} unknowns. The rest is open: the fit left it where it"
                    " happened to be."
                )
            ),
        ]
        if ident.advice:
            parts.append(m.note(ident.advice))
        if ident.null_directions:
            parts.append(
                "<h3>Open combinations</h3><p>These move together without changing anything measured."
                " In brackets: how far, against the first (relative to itself for a factor; for damping"
                " in the loss factor that it amounts to in the middle of the band).</p>"
            )
            parts.append(_directions(ident.null_directions, w.combination))
        if ident.determined_directions:
            parts.append(
                "<h3>What is still known about them</h3><p>Of these unknowns the data determine, by"
                " weights too:</p>"
            )
            parts.append(_directions(ident.determined_directions, w.weighted_sum))
        if "singular-values" in figures:
            caption = (
                "Singular values of the Jacobian with columns scaled to unit length: how strongly the"
                " data react to each independent combination of unknowns. Condition number"
                f" {w.number(ident.condition, 3)}, collinearity index {w.number(ident.collinearity, 3)}"
                " (above 10 to 15 the unknowns are hard to tell apart)."
            )
            parts.append("<h3>How strongly</h3>")
            parts.append(
                m.figure(
                    "singular-values",
                    "Singular values, falling",
                    caption,
                    height=figures["singular-values"]["height"],
                )
            )
        if "correlation" in figures:
            caption = (
                "Correlation of the estimates: near +1 or −1 the data see two unknowns together and"
                " hardly tell them apart. Blank: not determined, so there is no correlation to give."
            )
            plot = m.figure(
                "correlation",
                "Correlation matrix of the unknowns",
                caption,
                height=figures["correlation"]["height"],
            )
            title = "Which unknowns the data confuse"
            parts.append(
                f"<h3>{title}</h3>{plot}"
                if len(content.result.parameters) <= 24
                else m.details(title, plot)
            )
        return "".join(parts)


IDENTIFIABILITY = DeterminedUnknowns()


def _directions(directions: list[dict[str, float]], say: Callable[[dict[str, float]], str]) -> str:
    items = "".join(f"<li>{m.esc(say(d))}</li>" for d in directions)
    return f'<ol class="directions">{items}</ol>'


class Convergence(Section):
    """Cost and unknowns over the iterations."""

    anchor = "convergence"
    name = "Convergence"
    heading = "Convergence"
    place = 800

    def applies(self, content: Content) -> bool:
        """Whether the page shows an update."""
        return content.update is not None

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return the cost and the path of each kind of unknown."""
        result = content.result
        paths = {
            name: value_paths(result, chosen)
            for name, chosen in _by_figure(
                result, "factor-paths", "-paths", "calibration-paths"
            ).items()
        }
        return existing({"cost": cost_path(result), **paths})

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return cost and unknowns over the iterations."""
        parts: list[str] = []
        if "cost" not in figures:
            return "".join(parts) + m.paragraph("No iterations were recorded.", "muted")
        stages = list(dict.fromkeys(h.stage for h in content.result.history))
        last = [h for h in content.result.history if h.accepted and h.stage == stages[-1]]
        refused = sum(not h.accepted for h in content.result.history)
        said = f"{w.counted(content.result.iterations, 'step')} taken, {refused} refused."
        if last:
            where = f"In the last stage, {stages[-1]}, the" if len(stages) > 1 else "The"
            said += f" {where} cost went from {w.number(last[0].cost, 3)} to {w.number(last[-1].cost, 3)}."
        parts.append(m.paragraph(said))
        caption = "Cost: half the sum of squared weighted residuals."
        if len(stages) > 1:
            labels = {stage: _stage_label(stage) for stage in stages}
            explained = "; ".join(f"{stage}: {label}" for stage, label in labels.items() if label)
            caption += (
                " Each stage weighs the residuals in its own way: compare costs within a stage only. "
                + explained
            )
            caption = caption.strip().removesuffix(".") + "."
        parts.append(
            m.figure("cost", "Cost by iteration", caption, height=figures["cost"]["height"])
        )
        paths = [
            ("factor-paths", "Paths of the factors"),
            ("calibration-paths", "Paths of the calibration factors"),
        ]
        for name, title in (
            *paths,
            *((name, f"Paths: {title.lower()}") for name, title in _kinds("-paths")),
        ):
            if name in figures:
                parts.append(f"<h3>{title}</h3>")
                parts.append(
                    m.figure(
                        name, f"{title} over the iterations", "", height=figures[name]["height"]
                    )
                )
        return "".join(parts)


CONVERGENCE = Convergence()


_LEGEND_ENTRIES = 12
_DIVERGING = [
    [0.0, "#b35806"],
    [0.25, "#f1a340"],
    [0.5, "#f7f7f7"],
    [0.75, "#6a9fd4"],
    [1.0, "#08519c"],
]
_STAGE_SYMBOLS = ("circle", "square", "diamond", "triangle-up", "star")
_PATH_COLOURS = ("@after", "@before", "@third", "@fourth", "@muted", "@text")
_STAGE_COLOURS = ("@after", "@before", "@third", "@fourth", "@measured")


# -- unknowns ----------------------------------------------------------------------------------------------
def estimates(result: UpdateResult, chosen: Sequence[Parameter]) -> Figure | None:
    """Estimates of one kind with 95 % intervals and bounds; factors relative to their start on a log axis."""
    if not chosen:
        return None
    relative = chosen[0].is_factor
    unit = np.array([p.start if relative else 1.0 for p in chosen])
    values = np.array([result.values[p.name] for p in chosen]) / unit
    spans = [interval(p, result.values[p.name], result.std[p.name]) for p in chosen]
    low = np.array([np.nan if s is None else s[0] for s in spans]) / unit
    high = np.array([np.nan if s is None else s[1] for s in spans]) / unit
    rows = np.arange(len(chosen))
    known = np.array([s is not None for s in spans])
    bound = np.array([p.name in result.at_bound for p in chosen])
    names = labels(f"{p.group}: {quantity_words(p.quantity)}" for p in chosen)
    traces: list[dict[str, Any]] = [
        {
            "type": "scatter",
            "mode": "markers",
            "name": "start",
            "x": numbers(np.array([p.start for p in chosen]) / unit),
            "y": rows.tolist(),
            "marker": {
                "symbol": "line-ns-open",
                "color": "@before",
                "size": 14,
                "line": {"width": 2},
            },
            "hovertemplate": "start %{x:.4g}<extra></extra>",
        }
    ]
    styles = (
        ("estimate, 95 % interval", known & ~bound, "circle"),
        ("estimate at a bound", known & bound, "diamond"),
        ("not determined by the data", ~known, "x-thin-open"),
    )
    for name, where, symbol in styles:
        if where.any():
            traces.append(
                _estimate_trace(name, values, low, high, np.flatnonzero(where), symbol, names)
            )
    limits = np.array([[p.lower, p.upper] for p in chosen]) / unit[:, None]
    view = _view(
        np.concatenate([values, low, high, [p.start for p in chosen] / unit]), log=relative
    )
    traces.insert(1, _bound_trace(limits, view, rows))
    title = axis_title(chosen[0]) + (" (log scale)" if relative else "")
    axis: dict[str, Any] = {
        "title": {"text": title},
        "range": np.log10(view).tolist() if relative else list(view),
    }
    return {
        "data": traces,
        "height": rows_height(len(chosen), extra=130),
        "layout": {
            "xaxis": axis | ({"type": "log", "tickvals": _log_ticks(view)} if relative else {}),
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


def _estimate_trace(
    name: str,
    values: NDArray[np.float64],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    at: NDArray[np.intp],
    symbol: str,
    names: list[str],
) -> dict[str, Any]:
    trace: dict[str, Any] = {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "x": numbers(values[at]),
        "y": at.tolist(),
        "text": [names[i] for i in at],
        "marker": {
            "symbol": symbol,
            "color": "@after",
            "size": 10,
            "line": {"width": 2, "color": "@after"},
        },
        "hovertemplate": "%{text}: %{x:.5g}<extra></extra>",
    }
    if np.isfinite(low[at]).all():
        trace["error_x"] = error_bars(values[at] - low[at], high[at] - values[at], "@after")
    return trace


def _view(shown: NDArray[np.float64], *, log: bool) -> tuple[float, float]:
    """Return the range of the axis: what is shown, with a margin; intervals beyond 100 times are cut."""
    finite = shown[np.isfinite(shown) & ((shown > 0) | (not log))]
    low, high = float(finite.min(initial=np.inf)), float(finite.max(initial=-np.inf))
    if not low <= high:
        return (0.5, 2.0) if log else (0.0, 1.0)
    if log:
        low, high = max(low, 1e-3), min(high, 1e3)
        margin = max((high / low) ** 0.06, 1.03)
        return low / margin, high * margin
    margin = max(0.06 * (high - low), 1e-6 + 0.03 * abs(high))
    return low - margin, high + margin


def _log_ticks(view: tuple[float, float]) -> list[float]:
    """Return round values to mark on a log axis, about 5 to 12 of them whatever its range."""
    low, high = view
    if high / low < 2.0:  # nearly linear: steps of 1, 2 or 5
        rough = (high - low) / 6.0
        unit = 10.0 ** np.floor(np.log10(rough))
        step = unit * next(s for s in (1, 2, 5, 10) if s * unit >= rough)
        return [
            float(round(v, 10))
            for v in np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step
        ]
    per_decade = (
        (1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8)
        if high / low < 12
        else (1, 2, 5)
        if high / low < 1e3
        else (1,)
    )
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    ticks = [float(f"{s * 10.0**p:.6g}") for p in powers for s in per_decade]
    return [t for t in ticks if low <= t <= high]


def _bound_trace(
    limits: NDArray[np.float64], view: tuple[float, float], rows: NDArray[np.intp]
) -> dict[str, Any]:
    inside = (limits > view[0]) & (limits < view[1])
    x = [
        float(v)
        for pair, keep in zip(limits, inside, strict=True)
        for v, k in zip(pair, keep, strict=True)
        if k
    ]
    y = [int(row) for row, keep in zip(rows, inside, strict=True) for k in keep if k]
    return {
        "type": "scatter",
        "mode": "markers",
        "name": "bound",
        "x": x,
        "y": y,
        "marker": {"symbol": "line-ns-open", "color": "@muted", "size": 20, "line": {"width": 3}},
        "hovertemplate": "bound %{x:.4g}<extra></extra>",
    }


# -- what the data determine -------------------------------------------------------------------------------
def singular_values(result: UpdateResult) -> Figure | None:
    """Singular values of the scaled Jacobian, determined and open ones apart; zeros at the foot of the axis."""
    ident = result.identifiability
    values = np.array(ident.singular_values, dtype=np.float64)
    values = values[np.isfinite(values)]
    if values.size < 2:
        return None
    positive = values[values > 0]
    foot = float(max(positive.min() / 10.0, 1e-18)) if positive.size else 1e-16
    order = np.arange(1, values.size + 1)
    shown = np.maximum(values, foot)
    traces = []
    for name, where, colour, symbol in (
        ("determined", order <= ident.rank, "@after", "circle"),
        ("open: lost in the noise or exactly undetermined", order > ident.rank, "@before", "x"),
    ):
        if where.any():
            traces.append(
                {
                    "type": "scatter",
                    "mode": "markers",
                    "name": name,
                    "x": order[where].tolist(),
                    "y": numbers(shown[where]),
                    "text": [f"{v:.3g}" for v in values[where]],
                    "marker": {"color": colour, "symbol": symbol, "size": 9},
                    "hovertemplate": "number %{x}: %{text}<extra></extra>",
                }
            )
    ticks: dict[str, Any] = (
        {"tickmode": "linear", "tick0": 1, "dtick": 1} if values.size <= 20 else {}
    )
    return {
        "data": traces,
        "height": 320,
        "layout": {
            "xaxis": (
                {
                    "title": {"text": "combination number, best determined first"},
                    "zeroline": False,
                }
                | ticks
            ),
            "yaxis": {
                "title": {"text": "singular value"},
                "type": "log",
                "exponentformat": "power",
            },
            "showlegend": True,
        },
    }


def correlations(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return correlation coefficients from a covariance; NaN in rows that are not finite or have no variance."""
    variance = np.diag(covariance)
    known = np.isfinite(variance) & (variance > 0)
    out = np.full(covariance.shape, np.nan)
    at = np.ix_(known, known)
    std = np.sqrt(variance[known])
    out[at] = covariance[at] / std[:, None] / std[None, :]
    return np.where(np.isfinite(out), np.clip(out, -1.0, 1.0), np.nan)


def correlation_map(result: UpdateResult) -> Figure | None:
    """Correlation coefficients of the unknowns, blank where an unknown is not determined."""
    names = result.parameters.names
    if len(names) < 2 or result.covariance.shape != (len(names), len(names)):
        return None
    matrix = correlations(np.asarray(result.covariance, dtype=np.float64))
    if not np.isfinite(matrix).any():
        return None
    shown = labels(f"{p.group}: {quantity_words(p.quantity)}" for p in result.parameters)
    height = max(rows_height(len(names), extra=220), 320)
    trace = {
        "type": "heatmap",
        "z": numbers(matrix),
        "x": shown,
        "y": shown,
        "zmin": -1.0,
        "zmax": 1.0,
        "colorscale": _DIVERGING,
        "xgap": 1,
        "ygap": 1,
        "hovertemplate": "%{y}<br>%{x}<br>%{z:.3f}<extra></extra>",
        "colorbar": colour_bar("correlation", (-1, -0.5, 0, 0.5, 1), height - 100),
    }
    if matrix.size <= PRINTED_CELLS:
        trace["text"] = [
            [
                (
                    f"{v + 0.0:.2f}".replace("-0.00", "0.00").replace("-", "−")
                    if np.isfinite(v)
                    else ""
                )
                for v in row
            ]
            for row in matrix
        ]
        trace["texttemplate"] = "%{text}"
    font = {"size": 12 if len(names) <= 40 else 9}
    axis: dict[str, Any] = {
        "type": "category",
        "showgrid": False,
        "zeroline": False,
        "tickfont": font,
    }
    rows = {**axis, "autorange": "reversed", "dtick": 1}
    columns = {**axis, "tickangle": -50} | ({"dtick": 1} if len(names) <= 40 else {})
    return {"data": [trace], "height": height, "layout": {"xaxis": columns, "yaxis": rows}}


# -- convergence -------------------------------------------------------------------------------------------
def cost_path(result: UpdateResult) -> Figure | None:
    """Cost of each iteration, by stage; refused steps as crosses."""
    steps = [h for h in result.history if np.isfinite(h.cost)]
    if not steps:
        return None
    positive = [h.cost for h in steps if h.cost > 0]
    foot = min(positive, default=1.0) / 10.0
    traces: list[dict[str, Any]] = []
    for i, stage in enumerate(dict.fromkeys(h.stage for h in steps)):
        taken = [h for h in steps if h.stage == stage and h.accepted]
        traces.append(
            {
                "type": "scatter",
                "mode": "lines+markers",
                "name": label(stage),
                "x": [h.number for h in taken],
                "y": numbers([max(h.cost, foot) for h in taken]),
                "text": [f"{h.cost:.4g}, largest step {h.step:.2g}" for h in taken],
                "marker": {"symbol": _STAGE_SYMBOLS[i % 5], "size": 8 if len(steps) <= 60 else 5},
                "line": {"color": _STAGE_COLOURS[i % 5]},
                "hovertemplate": "iteration %{x}: cost %{text}<extra></extra>",
            }
        )
    refused = [h for h in steps if not h.accepted]
    if refused:
        traces.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": "step refused",
                "x": [h.number for h in refused],
                "y": numbers([max(h.cost, foot) for h in refused]),
                "marker": {
                    "symbol": "x-thin-open",
                    "color": "@muted",
                    "size": 9,
                    "line": {"width": 2},
                },
                "hovertemplate": "iteration %{x}: refused at cost %{y:.4g}<extra></extra>",
            }
        )
    return {
        "data": traces,
        "height": 320,
        "layout": {
            "xaxis": _iterations(result),
            "yaxis": {
                "title": {"text": "cost"},
                "type": "log",
                "exponentformat": "power",
                "dtick": log_step(positive),
            },
            "showlegend": True,
        },
    }


def _iterations(result: UpdateResult) -> dict[str, Any]:
    last = max(h.number for h in result.history)
    return {
        "title": {"text": "iteration"},
        "range": [-0.02 * last - 0.2, 1.02 * last + 0.2],
        "zeroline": False,
    }


def value_paths(result: UpdateResult, chosen: Sequence[Parameter]) -> Figure | None:
    """Values of the unknowns over the iterations; of many, those that moved most are named, the rest are grey."""
    steps = [h for h in result.history if h.accepted and h.values]
    if not chosen or not steps:
        return None
    relative = chosen[0].is_factor
    paths = {
        p.name: (
            np.array([h.values.get(p.name, np.nan) for h in steps]) / (p.start if relative else 1.0)
        )
        for p in chosen
    }
    moved = sorted(paths, key=lambda n: -_excursion(paths[n]))
    named = set(moved[:_LEGEND_ENTRIES])
    traces = []
    style = {p.name: i for i, p in enumerate(p for p in chosen if p.name in named)}
    for p in sorted(chosen, key=lambda p: p.name in named):
        shown = label(f"{p.group}: {quantity_words(p.quantity)}")
        trace: dict[str, Any] = {
            "type": "scatter",
            "mode": "lines+markers" if p.name in named and len(steps) <= 60 else "lines",
            "name": shown,
            "x": [h.number for h in steps],
            "y": numbers(paths[p.name]),
            "marker": {"size": 5},
            "showlegend": p.name in named,
            "hovertemplate": f"{shown}: %{{y:.5g}}<extra></extra>",
        }
        if p.name in named:
            at = style[p.name]
            trace["line"] = {"color": _PATH_COLOURS[at % 6], "dash": ("solid", "dash")[at // 6]}
            trace["marker"]["color"] = _PATH_COLOURS[at % 6]
        else:
            trace["line"] = {"color": "@faint", "width": 1}
        traces.append(trace)
    return {
        "data": traces,
        "height": 380,
        "layout": {
            "xaxis": _iterations(result),
            "yaxis": {"title": {"text": axis_title(chosen[0])}},
            "showlegend": True,
            "legend": {"orientation": "v"},
        },
    }


def _excursion(path: NDArray[np.float64]) -> float:
    finite = path[np.isfinite(path)]
    return float(np.ptp(finite)) if finite.size else 0.0
