"""The sections of the report about the unknowns: their values, identifiability, convergence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.group import VALUES
from updyn.report.formats import (
    axis_title,
    change,
    estimate,
    figure_name,
    interval,
    number,
    quantity_words,
)
from updyn.report.plots import (
    DIVERGING,
    PRINTED_CELLS,
    Figure,
    colour_bar,
    error_bars,
    existing,
    label,
    labels,
    log_range,
    log_step,
    names_font,
    numbers,
    rows_height,
)
from updyn.report.section import Content, Section
from updyn.report.start import Start
from updyn.updating.fit.methods import METHODS
from updyn.updating.fit.monitor import Iteration, iterations_made
from updyn.updating.judge.alternatives import differences
from updyn.updating.judge.identifiability import Identifiability
from updyn.updating.problem.parameters import Parameter, ParameterSet
from updyn.updating.result import UpdateResult

__all__ = [
    "CONVERGENCE",
    "IDENTIFIABILITY",
    "UNKNOWNS",
    "combinations_map",
    "correlation_map",
    "correlations",
    "cost_path",
    "estimates",
    "singular_values",
    "value_paths",
]

#: Explanation of the search for a start.
_SEARCH = "tries from several starts"
_OTHERS = "descents to other answers that may fit as well"
#: Unknowns that a figure of paths names; the rest are grey.
_LEGEND_ENTRIES = 12
#: Relative difference of values that no figure shows.
_THERE = 1e-3
#: Steps up to which each is drawn as a point of its own.
_SINGLE_STEPS = 60
#: Room for the tick labels of a panel beside another, as a share of the width.
_TICKS = 0.09
_PATH_COLOURS = ("@after", "@before", "@third", "@fourth", "@muted", "@text")


class _OfUnknowns(Section):
    """A section that one test and several tests have alike."""

    def applies(self, content: Content) -> bool:
        """Whether the page shows an update, or what is known before one."""
        return content.update is not None or (self.of_start and content.start is not None)


def _by_figure(
    result: UpdateResult, factors: str, end: str, calibrations: str
) -> dict[str, list[Parameter]]:
    """Return the unknowns of each figure, by its name: factors, each kind of value, sensors."""
    out: dict[str, list[Parameter]] = {factors: []}
    for kind in VALUES:
        out[figure_name(kind) + end] = []
    out[calibrations] = []
    for p in result.parameters:
        if p.is_channel:
            out[calibrations].append(p)
        elif p.value_of is None:
            out[factors].append(p)
        else:
            out[figure_name(p.value_of) + end].append(p)
    return out


def _names(chosen: Sequence[Parameter]) -> list[str]:
    """Return names of unknowns for the axis of a figure."""
    return labels(f"{p.group}: {quantity_words(p.quantity)}" for p in chosen)


# -- values --------------------------------------------------------------------------------------
class Unknowns(_OfUnknowns):
    """The values of the unknowns, with their uncertainty."""

    anchor = "unknowns"
    name = "Unknowns"
    heading = "Unknowns"
    place = 400
    template = "updyn.report/unknowns.html"

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return the estimates of each kind that the figure of the changes leaves out."""
        result = content.result
        made = {}
        for name, chosen in _by_figure(result, "factors", "s", "calibrations").items():
            if any(p.start == 0.0 for p in chosen):  # no change in percent
                made[name] = estimates(result, chosen)
        return existing(made)

    def context(self, content: Content) -> dict[str, Any]:
        """Return the rows of the tables, and the titles of the figures."""
        parts: list[dict[str, Any]] = []
        sensors: list[dict[str, Any]] = []
        for parameter in content.result.parameters:
            rows = sensors if parameter.is_channel else parts
            rows.append(_parameter_row(content.result, parameter))
        titles = [("factors", "Factors, relative to their start")]
        for kind in VALUES:
            titles.append((f"{figure_name(kind)}s", quantity_words(kind).capitalize()))
        head = [
            "quantity",
            "start",
            "value",
            "change",
            "std. dev.",
            "95 % interval",
            "bounds",
            "note",
        ]
        if not any(row["cells"][-1] for row in (*parts, *sensors)):  # no column of blanks
            head.pop()
            for row in (*parts, *sensors):
                row["cells"].pop()
        return {
            "head": head,
            "kinds": ("", "text", "", "", "", "", "", "", "note-cell"),
            "parts": parts,
            "sensors": sensors,
            "titles": titles,
        }


UNKNOWNS = Unknowns()


def _parameter_row(result: UpdateResult, parameter: Parameter) -> dict[str, Any]:
    """Return the cells of an unknown, and the class of its row."""
    p = parameter
    value, std = result.values[p.name], result.std[p.name]
    determined = math.isfinite(std)
    quantity = quantity_words(p.quantity)
    if p.value_unit:
        quantity += f" ({p.value_unit})"
    span = interval(p, value, std, result.noise.get("degrees_of_freedom"))
    spanned = "open"
    if span is not None:
        spanned = f"{estimate(span[0], std)} to {estimate(span[1], std)}"
    cells = [
        p.group,
        quantity,
        number(p.start),
        estimate(value, std),
        change(p, value),
        number(std, 2) if determined else "–",
        spanned,
        f"{number(p.lower, 3)} to {number(p.upper, 3)}",
        "; ".join(_parameter_notes(result, p)),
    ]
    marked = p.name in result.at_bound or not determined
    return {"cells": cells, "kind": "open" if marked else ""}


def _parameter_notes(result: UpdateResult, parameter: Parameter) -> list[str]:
    """Return the remarks on an unknown."""
    p = parameter
    value, std = result.values[p.name], result.std[p.name]
    notes = []
    if p.nominal is not None:
        notes.append(f"{p.physical(value, std)}, from {p.physical(p.start)}")
    if p.name in result.at_bound:
        notes.append(f"at its {result.at_bound[p.name]} bound")
    if not math.isfinite(std):
        notes.append("not determined by the data")
    if p.drives:
        notes.append(f"acts on {p.law}")
    if p.prior_std is not None:
        notes.append(f"prior standard deviation {number(p.prior_std, 3)}")
    return notes


def estimates(result: UpdateResult, chosen: Sequence[Parameter]) -> Figure | None:
    """Return the estimates of one kind of unknown with 95 % intervals and bounds.

    Factors are shown relative to their start, on a logarithmic axis.

    Parameters
    ----------
    result : UpdateResult
        The result.
    chosen : sequence of Parameter
        Unknowns of one kind.

    Returns
    -------
    Figure or None
        None without unknowns.
    """
    if not chosen:
        return None
    relative = chosen[0].is_factor
    rows = np.arange(len(chosen))
    start, values, low, high = np.full((4, len(chosen)), np.nan)
    limits = np.empty((len(chosen), 2))
    bound = np.empty(len(chosen), dtype=np.bool_)
    freedom = result.noise.get("degrees_of_freedom")
    for i, p in enumerate(chosen):
        start[i] = p.start
        values[i] = result.values[p.name]
        limits[i] = p.lower, p.upper
        bound[i] = p.name in result.at_bound
        span = interval(p, result.values[p.name], result.std[p.name], freedom)
        if span is not None:
            low[i], high[i] = span
    known = ~np.isnan(low)
    unit = start.copy() if relative else np.ones(len(chosen))
    values, low, high = values / unit, low / unit, high / unit
    limits /= unit[:, None]
    names = _names(chosen)
    view = _view(np.concatenate([values, low, high, start / unit]), log=relative)
    traces = [_start_trace(start / unit), _bound_trace(limits, view, rows)]
    styles = (
        ("estimate, 95 % interval", known & ~bound, "circle"),
        ("estimate at a bound", known & bound, "diamond"),
        ("not determined by the data", ~known, "x-thin-open"),
    )
    for name, where, symbol in styles:
        if where.any():
            at = np.flatnonzero(where)
            traces.append(_estimate_trace(name, values, low, high, at, symbol, names))
    title = axis_title(chosen[0])
    axis: dict[str, Any] = {"title": {"text": title}, "range": list(view)}
    if relative:
        axis = {
            "title": {"text": f"{title} (log scale)"},
            "range": np.log10(view).tolist(),
            "type": "log",
            "tickvals": _log_ticks(view),
        }
    return {
        "data": traces,
        "height": rows_height(len(chosen), extra=130),
        "layout": {
            "xaxis": axis,
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


def _start_trace(start: NDArray[np.float64]) -> dict[str, Any]:
    return {
        "type": "scatter",
        "mode": "markers",
        "name": "start",
        "x": numbers(start),
        "y": list(range(len(start))),
        "marker": {
            "symbol": "line-ns-open",
            "color": "@before",
            "size": 14,
            "line": {"width": 2},
        },
        "hovertemplate": "start %{x:.4g}<extra></extra>",
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
        "text": np.take(names, at).tolist(),
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


def _bound_trace(
    limits: NDArray[np.float64], view: tuple[float, float], rows: NDArray[np.intp]
) -> dict[str, Any]:
    inside = (limits > view[0]) & (limits < view[1])
    return {
        "type": "scatter",
        "mode": "markers",
        "name": "bound",
        "x": limits[inside].tolist(),
        "y": rows[np.nonzero(inside)[0]].tolist(),
        "marker": {"symbol": "line-ns-open", "color": "@muted", "size": 20, "line": {"width": 3}},
        "hovertemplate": "bound %{x:.4g}<extra></extra>",
    }


def _view(shown: NDArray[np.float64], *, log: bool) -> tuple[float, float]:
    """Return the range of the axis, with a margin; a logarithmic one is cut at 0.001 and 1000."""
    finite = shown[np.isfinite(shown)]
    if log:
        finite = finite[finite > 0]
    if not finite.size:
        return (0.5, 2.0) if log else (0.0, 1.0)
    low, high = float(finite.min()), float(finite.max())
    if log:
        low, high = max(low, 1e-3), min(high, 1e3)
        margin = max((high / low) ** 0.06, 1.03)
        return low / margin, high * margin
    margin = max(0.06 * (high - low), 1e-6 + 0.03 * abs(high))
    return low - margin, high + margin


def _log_ticks(view: tuple[float, float]) -> list[float]:
    """Return round values to mark on a logarithmic axis, about 5 to 12 of them."""
    low, high = view
    if high / low < 2.0:  # nearly linear
        return _even_ticks(low, high)
    steps: tuple[float, ...] = (1,)
    if high / low < 12:
        steps = (1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8)
    elif high / low < 1e3:
        steps = (1, 2, 5)
    ticks = []
    for power in range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1):
        for step in steps:
            tick = float(f"{step * 10.0**power:.6g}")
            if low <= tick <= high:
                ticks.append(tick)
    return ticks


def _even_ticks(low: float, high: float) -> list[float]:
    """Return multiples of 1, 2 or 5 times a power of 10, about six of them."""
    rough = (high - low) / 6.0
    unit = 10.0 ** np.floor(np.log10(rough))
    step = unit * next(s for s in (1, 2, 5, 10) if s * unit >= rough)
    first, last = np.ceil(low / step), np.floor(high / step)
    return np.round(np.arange(first, last + 1) * step, 10).tolist()  # type: ignore[no-any-return]


# -- identifiability -----------------------------------------------------------------------------
class IdentifiabilitySection(_OfUnknowns):
    """Which unknowns, or combinations of them, the data determine."""

    anchor = "identifiability"
    name = "Identifiability"
    heading = "Identifiability"
    place = 600
    template = "updyn.report/identifiability.html"
    of_start = True

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return singular values, undetermined combinations as a matrix, and correlations."""
        found: UpdateResult | Start = content.start or content.result
        return existing(
            {
                "singular-values": singular_values(found.identifiability),
                "combinations": combinations_map(found.identifiability),
                "correlation": correlation_map(found.parameters, found.covariance),
            }
        )

    def context(self, content: Content) -> dict[str, Any]:
        """Return the identifiability of the unknowns."""
        if content.start is not None:  # the head says the advice
            return {"ident": content.start.identifiability, "advice": "", "answers": None}
        result = content.result
        advice = result.identifiability.advice
        return {
            "ident": result.identifiability,
            "advice": "" if advice in result.remedy else advice,
            "answers": _answers(result),
        }


def _answers(result: UpdateResult) -> dict[str, Any] | None:
    """Return the table of the answers that fit equally well; None where there is one only."""
    others = result.alternatives
    if not others:
        return None
    rows = []
    for name, values in differences(result.values, result.std, others):
        group, _, quantity = name.rpartition(".")
        shown = [estimate(value, result.std[name]) for value in values]
        rows.append([group, quantity_words(quantity), *shown])
    odds = [f"{number(other.odds, 2)} to 1" for other in others]
    sensors = [other.sensor or "none" for other in others]
    apart = [
        f"{number(100.0 * other.difference, 2)} %" if other.sensor else "–" for other in others
    ]
    return {
        "count": 1 + len(others),
        "head": ["group", "quantity", "this result", *_numbered(len(others))],
        "kinds": ("", "text", *[""] * (1 + len(others))),
        "rows": rows,
        "about": [
            ["odds of this result over it", "", "–", *odds],
            ["sensor that tells it from this result", "", "–", *sensors],
            ["typical difference of the FRFs there", "", "–", *apart],
        ],
    }


def _numbered(n_others: int) -> list[str]:
    return [f"answer {i + 2}" for i in range(n_others)]


IDENTIFIABILITY = IdentifiabilitySection()


def singular_values(ident: Identifiability) -> Figure | None:
    """Return the singular values of the scaled Jacobian, determined and undetermined ones apart.

    Zeros stand at the foot of the logarithmic axis.
    """
    values = np.array(ident.singular_values, dtype=np.float64)
    values = values[np.isfinite(values)]
    if values.size < 2:
        return None
    foot = 1e-16
    if (values > 0).any():
        foot = max(float(values[values > 0].min()) / 10.0, 1e-18)
    determined = np.arange(values.size) < ident.rank
    lost = "undetermined: lost in the noise, or exactly"
    traces = []
    if determined.any():
        traces.append(_singular_trace("determined", values, determined, foot, "@after", "circle"))
    if not determined.all():
        traces.append(_singular_trace(lost, values, ~determined, foot, "@before", "x"))
    axis: dict[str, Any] = {
        "title": {"text": "combination number, best determined first"},
        "zeroline": False,
    }
    if values.size <= 20:
        axis |= {"tickmode": "linear", "tick0": 1, "dtick": 1}
    return {
        "data": traces,
        "height": 320,
        "layout": {
            "xaxis": axis,
            "yaxis": {
                "title": {"text": "singular value"},
                **log_range(np.maximum(values, foot), decades=18.0),
            },
            "showlegend": True,
        },
    }


def _singular_trace(
    name: str,
    values: NDArray[np.float64],
    where: NDArray[np.bool_],
    foot: float,
    colour: str,
    symbol: str,
) -> dict[str, Any]:
    return {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "x": (np.flatnonzero(where) + 1).tolist(),
        "y": numbers(np.maximum(values[where], foot)),
        "text": [f"{v:.3g}" for v in values[where]],
        "marker": {"color": colour, "symbol": symbol, "size": 9},
        "hovertemplate": "number %{x}: %{text}<extra></extra>",
    }


def correlations(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return correlation coefficients from a covariance.

    Parameters
    ----------
    covariance : ndarray of float, shape (n, n)
        Of n unknowns.

    Returns
    -------
    ndarray of float, shape (n, n)
        Between -1 and 1; NaN in rows that are not finite or have no variance.
    """
    variance = np.diag(covariance)
    known = np.isfinite(variance) & (variance > 0)
    out = np.full(covariance.shape, np.nan)
    at = np.ix_(known, known)
    std = np.sqrt(variance[known])
    out[at] = covariance[at] / std[:, None] / std[None, :]
    return np.where(np.isfinite(out), np.clip(out, -1.0, 1.0), np.nan)


def correlation_map(parameters: ParameterSet, covariance: NDArray[np.float64]) -> Figure | None:
    """Return the correlation of the unknowns, blank where an unknown is not determined.

    Parameters
    ----------
    parameters : ParameterSet
        The n unknowns.
    covariance : ndarray of float, shape (n, n)
        Of them.

    Returns
    -------
    Figure or None
        None of a single unknown, and where no correlation is known.
    """
    names = _names(tuple(parameters))
    if len(names) < 2 or covariance.shape != (len(names), len(names)):
        return None
    matrix = correlations(np.asarray(covariance, dtype=np.float64))
    if not np.isfinite(matrix).any():
        return None
    return _signed_map(matrix, names, names, "correlation")


def combinations_map(ident: Identifiability) -> Figure | None:
    """Return the undetermined combinations as a matrix: unknowns down, combinations across.

    Parameters
    ----------
    ident : Identifiability
        With its undetermined combinations.

    Returns
    -------
    Figure or None
        None where the data determine every unknown.
    """
    directions = ident.null_directions
    if not directions:
        return None
    involved = list(dict.fromkeys(name for weights in directions for name in weights))
    matrix = np.array([[weights.get(name, 0.0) for weights in directions] for name in involved])
    rows = [f"{group}: {quantity_words(quantity)}" for group, _, quantity in map(_split, involved)]
    columns = [f"combination {number}" for number in range(1, len(directions) + 1)]
    return _signed_map(matrix, labels(rows), columns, "weight")


def _split(name: str) -> tuple[str, str, str]:
    return name.rpartition(".")


def _signed_map(
    matrix: NDArray[np.float64], rows: Sequence[str], columns: Sequence[str], what: str
) -> Figure:
    """Return a heat map on the scale -1 to 1, with the values in its cells where these are few."""
    height = max(rows_height(len(rows), extra=220), 320)
    trace = {
        "type": "heatmap",
        "z": numbers(matrix),
        "x": list(columns),
        "y": list(rows),
        "zmin": -1.0,
        "zmax": 1.0,
        "colorscale": DIVERGING,
        "xgap": 1,
        "ygap": 1,
        "hovertemplate": "%{y}<br>%{x}<br>%{z:.3f}<extra></extra>",
        "colorbar": colour_bar(what, (-1, -0.5, 0, 0.5, 1), height - 100),
    }
    if matrix.size <= PRINTED_CELLS:
        trace["text"] = [list(map(_coefficient, row)) for row in matrix]
        trace["texttemplate"] = "%{text}"
    axis: dict[str, Any] = {
        "type": "category",
        "showgrid": False,
        "zeroline": False,
    }
    across = axis | {"tickangle": -50, "tickfont": names_font(columns)}
    if len(columns) <= 40:
        across["dtick"] = 1
    down = axis | {"autorange": "reversed", "dtick": 1, "tickfont": names_font(rows)}
    return {"data": [trace], "height": height, "layout": {"xaxis": across, "yaxis": down}}


def _coefficient(value: float) -> str:
    """Return a correlation coefficient as text, blank where there is none."""
    if not np.isfinite(value):
        return ""
    return f"{value:.2f}".replace("-0.00", "0.00").replace("-", "−")


# -- convergence ---------------------------------------------------------------------------------
class Convergence(_OfUnknowns):
    """Cost and unknowns over the iterations."""

    anchor = "convergence"
    name = "Convergence"
    heading = "Convergence"
    place = 800
    template = "updyn.report/convergence.html"

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return the cost and the path of each kind of unknown."""
        result = content.result
        made = {"cost": cost_path(result)}
        chosen = _by_figure(result, "factor-paths", "-paths", "calibration-paths")
        for name, some in chosen.items():
            made[name] = value_paths(result, some)
        return existing(made)

    def context(self, content: Content) -> dict[str, Any]:
        """Return the stages, the costs of the last one, and the titles of the figures."""
        history = content.result.history
        stages: dict[str, list[float]] = {}
        refused = 0
        for step in history:
            costs = stages.setdefault(step.stage, [])
            if step.accepted:
                costs.append(step.cost)
            else:
                refused += 1
        last = list(stages.values())[-1:]
        titles = [
            ("factor-paths", "Paths of the factors"),
            ("calibration-paths", "Paths of the calibration factors"),
        ]
        for kind in VALUES:
            titles.append((f"{figure_name(kind)}-paths", f"Paths: {quantity_words(kind)}"))
        return {
            "taken": content.result.iterations,
            "refused": refused,
            "stages": list(stages),
            "explained": _explained(list(stages)),
            "last_costs": last[0] if last else [],
            "titles": titles,
        }


CONVERGENCE = Convergence()


def _explained(stages: Sequence[str]) -> list[str]:
    """Return the stages with what each minimises, where that is stated."""
    words = {"search": _SEARCH, "other answers": _OTHERS}
    for stage in stages:
        if stage in METHODS:
            words[stage] = METHODS[stage].label
    return [f"{stage}: {words[stage]}" for stage in stages if words.get(stage)]


@dataclass(frozen=True, slots=True)
class _Fit:
    """A fit within a stage: a try of the search, or the steps under one weighting of the residuals.

    Attributes
    ----------
    stage : str
        The stage.
    taken, refused : list of (int, Iteration)
        Its steps, with the iterations made until then through all stages; of a refused one those
        that it would have made.
    """

    stage: str
    taken: list[tuple[int, Iteration]]
    refused: list[tuple[int, Iteration]]

    def own(self, made: int) -> int:
        """Return the iterations made since the fit began."""
        return made - self.taken[0][0]


def _fits(history: Sequence[Iteration]) -> list[_Fit]:
    """Return the fits of a history in order.

    An accepted step lowers the cost; where it does not, or has no length, or the stage is another
    one, another fit has begun.
    """
    fits: list[_Fit] = []
    for made, step in zip(iterations_made(history), history, strict=True):
        if not np.isfinite(step.cost):
            continue
        begun = bool(fits) and fits[-1].stage == step.stage
        if begun and not step.accepted:
            fits[-1].refused.append((made + 1, step))
            continue
        if not begun or step.step == 0.0 or step.cost > fits[-1].taken[-1][1].cost:
            fits.append(_Fit(step.stage, [], []))
        fits[-1].taken.append((made, step))
    return fits


def cost_path(result: UpdateResult) -> Figure | None:
    """Return the costs of all fits, in a panel for each stage; refused steps as crosses."""
    stages: dict[str, list[_Fit]] = {}
    for fit in _fits(result.history):
        stages.setdefault(fit.stage, []).append(fit)
    if not stages:
        return None
    traces: list[dict[str, Any]] = []
    layout: dict[str, Any] = {
        "showlegend": any(fit.refused for fits in stages.values() for fit in fits),
        "legend": {"y": 1.1},
        "margin": {"l": 60, "r": 16, "t": 60, "b": 48},
        "annotations": [],
    }
    named: set[str] = set()
    width = (1.0 - (len(stages) - 1) * _TICKS) / len(stages)
    for i, (stage, fits) in enumerate(stages.items()):
        end = "" if i == 0 else str(i + 1)
        left = i * (width + _TICKS)
        domain = [left, min(left + width, 1.0)]
        costs = np.array([step.cost for fit in fits for _, step in fit.taken + fit.refused])
        axes = {"xaxis": f"x{end}", "yaxis": f"y{end}"}
        for trace in _cost_traces(fits, costs):
            traces.append(trace | axes | {"showlegend": trace["name"] not in named})
            named.add(trace["name"])
        layout[f"xaxis{end}"] = _iterations(fits) | {"domain": domain, "anchor": f"y{end}"}
        layout[f"yaxis{end}"] = _cost_axis(costs) | {"anchor": f"x{end}"}
        layout["annotations"].append(_panel_title(f"{label(stage)}{_tries(fits)}", domain))
    layout["yaxis"]["title"] = {"text": "cost"}
    return {"data": traces, "height": 360, "layout": layout}


def _tries(fits: Sequence[_Fit]) -> str:
    return f" ({len(fits)} fits)" if len(fits) > 1 else ""


def _panel_title(text: str, domain: Sequence[float]) -> dict[str, Any]:
    return {
        "text": f"<b>{text}</b>",
        "x": domain[0],
        "xref": "paper",
        "xanchor": "left",
        "y": 1.0,
        "yref": "paper",
        "yanchor": "bottom",
        "showarrow": False,
        "font": {"size": 12},
    }


def _foot(costs: NDArray[np.float64]) -> float:
    """Return where costs of zero stand on a logarithmic axis."""
    positive = costs[costs > 0]
    return float(positive.min()) / 10.0 if positive.size else 0.1


def _cost_axis(costs: NDArray[np.float64]) -> dict[str, Any]:
    """Return a logarithmic axis; a linear one where the costs are nearly alike."""
    if costs.min() > 0.5 * costs.max():
        return {"exponentformat": "power", "nticks": 6}
    positive = costs[costs > 0]
    return {"type": "log", "exponentformat": "power", "dtick": log_step(positive)}


def _cost_traces(fits: Sequence[_Fit], costs: NDArray[np.float64]) -> list[dict[str, Any]]:
    """Return the fits of a stage over their own iterations, with gaps between them."""
    foot = _foot(costs)
    x: list[int | None] = []
    y: list[float] = []
    texts = []
    refused_x, refused_y = [], []
    for fit in fits:
        for made, step in fit.taken:
            x.append(fit.own(made))
            y.append(max(step.cost, foot))
            texts.append(f"{made}: cost {step.cost:.4g}, largest step {step.step:.2g}")
        x.append(None)
        y.append(np.nan)
        texts.append("")
        for made, step in fit.refused:
            refused_x.append(fit.own(made))
            refused_y.append(max(step.cost, foot))
    taken: dict[str, Any] = {
        "type": "scatter",
        "mode": "lines+markers",
        "name": "step taken",
        "legendgroup": "taken",
        "x": x,
        "y": numbers(y, packed=False),
        "text": texts,
        "marker": {"size": 7 if len(x) <= _SINGLE_STEPS else 4, "color": "@after"},
        "line": {"color": "@after", "width": 1.3},
        "hovertemplate": "iteration %{text}<extra></extra>",
    }
    if not refused_x:
        return [taken]
    refused = {
        "type": "scatter",
        "mode": "markers",
        "name": "step refused",
        "legendgroup": "refused",
        "x": refused_x,
        "y": numbers(refused_y, packed=False),
        "marker": {"symbol": "x-thin-open", "color": "@muted", "size": 8, "line": {"width": 2}},
        "hovertemplate": "refused at cost %{y:.4g}<extra></extra>",
    }
    return [taken, refused]


def _iterations(fits: Sequence[_Fit]) -> dict[str, Any]:
    """Return the axis of the iterations of some fits, each from its own beginning."""
    last = max(fit.own(made) for fit in fits for made, _ in fit.taken + fit.refused)
    axis: dict[str, Any] = {
        "title": {"text": "iteration of the fit"},
        "range": [-0.03 * last - 0.3, 1.03 * last + 0.3],
        "zeroline": False,
    }
    if last <= 6:
        axis["dtick"] = 1
    return axis


def value_paths(result: UpdateResult, chosen: Sequence[Parameter]) -> Figure | None:
    """Return the values of the unknowns on the way to the answer, with gaps between fits.

    Of many unknowns, the most moved are named.

    Parameters
    ----------
    result : UpdateResult
        The result.
    chosen : sequence of Parameter
        Unknowns of one kind; factors are shown relative to their start.

    Returns
    -------
    Figure or None
        None without unknowns or steps.
    """
    made, steps = _paths(result)
    if not chosen or not steps:
        return None
    paths = {}
    for p in chosen:
        path = np.array([step.values.get(p.name, np.nan) if step else np.nan for step in steps])
        paths[p.name] = path / p.start if p.is_factor else path
    moved = sorted(paths, key=lambda name: -_excursion(paths[name]))
    named = sorted(moved[:_LEGEND_ENTRIES], key=list(paths).index)
    traces = []
    for p in sorted(chosen, key=lambda p: p.name in named):  # named ones above the grey ones
        shown = label(f"{p.group}: {quantity_words(p.quantity)}")
        trace: dict[str, Any] = {
            "type": "scatter",
            "mode": "lines",
            "name": shown,
            "x": made,
            "y": numbers(paths[p.name]),
            "marker": {"size": 5},
            "line": {"color": "@faint", "width": 1},
            "showlegend": p.name in named,
            "hovertemplate": f"{shown}: %{{y:.5g}}<extra></extra>",
        }
        if p.name in named:
            dash, colour = divmod(named.index(p.name), len(_PATH_COLOURS))
            trace["line"] = {"color": _PATH_COLOURS[colour], "dash": ("solid", "dash")[dash]}
            trace["marker"]["color"] = _PATH_COLOURS[colour]
            if len(steps) <= _SINGLE_STEPS:
                trace["mode"] = "lines+markers"
        traces.append(trace)
    return {
        "data": traces,
        "height": 380,
        "layout": {
            "xaxis": {"title": {"text": "iteration"}, "zeroline": False},
            "yaxis": {"title": {"text": axis_title(chosen[0])}},
            "showlegend": True,
            "legend": {"orientation": "v"},
        },
    }


def _paths(result: UpdateResult) -> tuple[list[int | None], list[Iteration | None]]:
    """Return the steps of the fits that led to the answer, None between them, and their numbers."""
    made: list[int | None] = []
    steps: list[Iteration | None] = []
    number = 0
    for fit in _leading(result):
        for _, step in fit.taken:
            made.append(number)
            steps.append(step)
            number += 1
        made.append(None)
        steps.append(None)
    return made[:-1], steps[:-1]


def _leading(result: UpdateResult) -> list[_Fit]:
    """Return of each stage the fit that ended nearest to the answer, up to where that is reached.

    Other tries of a search, and descents that look for other answers, are not its way.
    """
    nearest: dict[str, tuple[float, _Fit]] = {}
    for fit in _fits(result.history):
        off = _distance(result, fit.taken[-1][1])
        if fit.stage not in nearest or off < nearest[fit.stage][0]:
            nearest[fit.stage] = off, fit
    least = min((off for off, _ in nearest.values()), default=0.0)
    leading = []
    for off, fit in nearest.values():
        leading.append(fit)
        if off <= least + _THERE:
            break
    return leading


def _distance(result: UpdateResult, step: Iteration) -> float:
    """Return the largest difference of a value from the answer's, relative to it or its start."""
    off = [0.0]
    for p in result.parameters:
        value = result.values[p.name]
        size = max(abs(value), abs(p.start))
        if size > 0.0:
            off.append(abs(step.values.get(p.name, value) - value) / size)
    return max(off)


def _excursion(path: NDArray[np.float64]) -> float:
    finite = path[np.isfinite(path)]
    if not finite.size:
        return 0.0
    return float(np.ptp(finite))
