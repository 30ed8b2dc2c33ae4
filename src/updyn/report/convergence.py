"""The section of the report on the iterations of the fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from updyn.arrays import RealArray
from updyn.report.formats import (
    axis_title,
    figure_name,
    quantity_words,
)
from updyn.report.of_unknowns import ParameterSection, group_by_figure, list_kinds
from updyn.report.plots import (
    Figure,
    Trace,
    drop_missing,
    encode_numbers,
    escape_label,
    log_step,
)
from updyn.report.section import PageContent
from updyn.report.settings import REPORT_LIST
from updyn.settings import FIGURES
from updyn.updating.fit.methods import METHODS
from updyn.updating.fit.monitor import Iteration, count_iterations
from updyn.updating.problem.parameters import Parameter
from updyn.updating.result import UpdateResult

__all__ = ["CONVERGENCE", "cost_path", "value_paths"]

#: Explanations of the stages that are not update methods.
_SEARCH = "fits from several starts"
_APPROACH = "minimisation of the log error from the start"
_OTHERS = "searches for other solutions that fit equally well"
#: Largest number of steps that are drawn with a marker each.
_SINGLE_STEPS = 60
#: Smallest relative range of a cost axis; below it, ticks would show rounding errors.
_MIN_RANGE = 0.01
#: Width of the tick labels between panels, as a fraction of the figure width.
_TICKS = 0.09
_PATH_COLOURS = ("@after", "@before", "@third", "@fourth", "@muted", "@text")


class ConvergenceSection(ParameterSection):
    """Cost and unknowns over the iterations."""

    anchor = "convergence"
    name = "Convergence"
    heading = "Convergence"
    place = 800
    template = "updyn.report/convergence.html"

    def figures(self, content: PageContent) -> dict[str, Figure]:
        """Return the figures of the cost and of the paths of each kind of unknown."""
        result = content.result
        made = {"cost": cost_path(result)}
        chosen = group_by_figure(result, "factor-paths", "-paths", "calibration-paths")
        for name, some in chosen.items():
            made[name] = value_paths(result, some)
        return drop_missing(made)

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the stages, the costs of the fit that led to the result, and the figure titles."""
        result = content.result
        stages = list(dict.fromkeys(step.stage for step in result.history))
        titles = [
            ("factor-paths", "Paths of the factors"),
            ("calibration-paths", "Paths of the calibration factors"),
        ]
        for kind in list_kinds(result):
            titles.append((f"{figure_name(kind)}-paths", f"Paths: {quantity_words(kind)}"))
        return {
            "taken": result.iterations,
            "refused": sum(not step.accepted for step in result.history),
            "stages": stages,
            "explained": _explain_stages(stages),
            "n_fits": len(_split_fits(result.history)),
            "last": next(reversed(_find_leading_fits(result)), None),
            "titles": titles,
        }


CONVERGENCE = ConvergenceSection()


def _explain_stages(stages: Sequence[str]) -> list[str]:
    """Return the stages with an explanation, omitting stages without one."""
    words = {"search": _SEARCH, "approach": _APPROACH, "other answers": _OTHERS}
    for stage in stages:
        if stage in METHODS:
            words[stage] = METHODS[stage].label
    return [f"{stage}: {words[stage]}" for stage in stages if words.get(stage)]


@dataclass(frozen=True, slots=True)
class _Fit:
    """A fit within a stage: one start of the search, or the steps under one residual weighting.

    Each step has the number of iterations made so far in all stages; a rejected step has the number
    that it would have had.
    """

    stage: str
    accepted: list[tuple[int, Iteration]]
    rejected: list[tuple[int, Iteration]]

    def iterations_since_start(self, made: int) -> int:
        return made - self.accepted[0][0]

    @property
    def costs(self) -> tuple[float, float]:
        """Cost at the first and at the last accepted step."""
        return self.accepted[0][1].cost, self.accepted[-1][1].cost

    def continues(self, other: _Fit) -> bool:
        """Whether this fit continues another fit of the same stage from its end point."""
        first, last = self.accepted[0][1], other.accepted[-1][1]
        if self.stage != other.stage:
            return False
        return first.step > 0.0 or first.values == last.values


def _split_fits(history: Sequence[Iteration]) -> list[_Fit]:
    # A new fit begins at a change of stage, at a step of zero length, and at an increase of the
    # cost.
    fits: list[_Fit] = []
    for made, step in zip(count_iterations(history), history, strict=True):
        if not np.isfinite(step.cost):
            continue
        is_same_stage = bool(fits) and fits[-1].stage == step.stage
        if is_same_stage and not step.accepted:
            fits[-1].rejected.append((made + 1, step))
            continue
        if not is_same_stage or step.step == 0.0 or step.cost > fits[-1].accepted[-1][1].cost:
            fits.append(_Fit(step.stage, [], []))
        fits[-1].accepted.append((made, step))
    return fits


def cost_path(result: UpdateResult) -> Figure | None:
    """Return the costs of all fits, one panel per stage; rejected steps are crosses."""
    stages: dict[str, list[_Fit]] = {}
    for fit in _split_fits(result.history):
        stages.setdefault(fit.stage, []).append(fit)
    if not stages:
        return None
    traces: list[dict[str, object]] = []
    layout: dict[str, Any] = {
        "showlegend": any(fit.rejected for fits in stages.values() for fit in fits),
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
        costs = np.array([step.cost for fit in fits for _, step in fit.accepted + fit.rejected])
        axes = {"xaxis": f"x{end}", "yaxis": f"y{end}"}
        for trace in _cost_traces(fits, costs):
            traces.append(trace | axes | {"showlegend": trace["name"] not in named})
            named.add(trace["name"])
        layout[f"xaxis{end}"] = _iteration_axis(fits) | {"domain": domain, "anchor": f"y{end}"}
        layout[f"yaxis{end}"] = _cost_axis(costs) | {"anchor": f"x{end}"}
        layout["annotations"].append(
            _panel_title(f"{escape_label(stage)}{_format_fit_count(fits)}", domain)
        )
    layout["yaxis"]["title"] = {"text": "cost"}
    return {"data": traces, "height": 360, "layout": layout}


def _format_fit_count(fits: Sequence[_Fit]) -> str:
    return f" ({len(fits)} fits)" if len(fits) > 1 else ""


def _panel_title(text: str, domain: Sequence[float]) -> dict[str, object]:
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


def _zero_position(costs: RealArray) -> float:
    positive = costs[costs > 0]
    return float(positive.min()) / 10.0 if positive.size else 0.1


def _cost_axis(costs: RealArray) -> dict[str, object]:
    """Return a logarithmic cost axis, or a linear one for costs within a factor of 2."""
    low, high = float(costs.min()), float(costs.max())
    if low > 0.5 * high:
        around, half = 0.5 * (low + high), 0.55 * max(high - low, _MIN_RANGE * high)
        return {
            "exponentformat": "power",
            "nticks": 6,
            "range": [around - half, around + half],
        }
    positive = costs[costs > 0]
    return {"type": "log", "exponentformat": "power", "dtick": log_step(positive)}


def _cost_traces(fits: Sequence[_Fit], costs: RealArray) -> list[Trace]:
    """Return the traces of the fits of a stage over their iteration numbers, separated by gaps."""
    foot = _zero_position(costs)
    x: list[int | None] = []
    y: list[float] = []
    texts = []
    rejected_x, rejected_y = [], []
    for fit in fits:
        for made, step in fit.accepted:
            x.append(fit.iterations_since_start(made))
            y.append(max(step.cost, foot))
            texts.append(f"{made}: cost {step.cost:.4g}, largest step {step.step:.2g}")
        x.append(None)
        y.append(np.nan)
        texts.append("")
        for made, step in fit.rejected:
            rejected_x.append(fit.iterations_since_start(made))
            rejected_y.append(max(step.cost, foot))
    accepted: dict[str, object] = {
        "type": "scatter",
        "mode": "lines+markers",
        "name": "step accepted",
        "legendgroup": "taken",
        "x": x,
        "y": encode_numbers(y, packed=False),
        "text": texts,
        "marker": {"size": 7 if len(x) <= _SINGLE_STEPS else 4, "color": "@after"},
        "line": {"color": "@after", "width": 1.3},
        "hovertemplate": "iteration %{text}<extra></extra>",
    }
    if not rejected_x:
        return [accepted]
    rejected = {
        "type": "scatter",
        "mode": "markers",
        "name": "step rejected",
        "legendgroup": "refused",
        "x": rejected_x,
        "y": encode_numbers(rejected_y, packed=False),
        "marker": {"symbol": "x-thin-open", "color": "@muted", "size": 8, "line": {"width": 2}},
        "hovertemplate": "rejected at cost %{y:.4g}<extra></extra>",
    }
    return [accepted, rejected]


def _iteration_axis(fits: Sequence[_Fit]) -> dict[str, object]:
    """Return the iteration axis of some fits, counted from the start of each fit."""
    last = max(
        fit.iterations_since_start(made) for fit in fits for made, _ in fit.accepted + fit.rejected
    )
    axis: dict[str, object] = {
        "title": {"text": "iteration of the fit"},
        "range": [-0.03 * last - 0.3, 1.03 * last + 0.3],
        "zeroline": False,
    }
    return _with_integer_ticks(axis, last)


def _with_integer_ticks(axis: dict[str, object], last: int) -> dict[str, object]:
    return axis | {"dtick": 1} if last <= 6 else axis


def value_paths(result: UpdateResult, chosen: Sequence[Parameter]) -> Figure | None:
    """Return the values of unknowns of one kind over the iterations; None without any."""
    # Factors are relative to their start. Fits are separated by gaps. If unknowns are many, only
    # those with the largest range are named.
    made, steps = _collect_steps(result)
    if not chosen or not steps:
        return None
    paths = {}
    for p in chosen:
        path = np.array([step.values.get(p.name, np.nan) if step else np.nan for step in steps])
        paths[p.name] = path / p.start if p.is_log else path
    ordered = sorted(paths, key=lambda name: -_find_span(paths[name]))
    named = sorted(ordered[: FIGURES.legend_entries], key=list(paths).index)
    traces = []
    for p in sorted(chosen, key=lambda p: p.name in named):  # draw named paths above the grey ones
        shown = escape_label(f"{p.group}: {quantity_words(p.quantity)}")
        trace: Trace = {
            "type": "scatter",
            "mode": "lines",
            "name": shown,
            "x": made,
            "y": encode_numbers(paths[p.name]),
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
            "xaxis": _with_integer_ticks(
                {"title": {"text": "iteration"}, "zeroline": False}, len(steps)
            ),
            "yaxis": {"title": {"text": axis_title(chosen[0])}},
            "showlegend": True,
            "legend": {"orientation": "v"},
        },
    }


def _collect_steps(result: UpdateResult) -> tuple[list[int | None], list[Iteration | None]]:
    """Return the numbers and steps of the fits that led to the result, with None between fits."""
    made: list[int | None] = []
    steps: list[Iteration | None] = []
    number = 0
    for fit in _find_leading_fits(result):
        for _, step in fit.accepted:
            made.append(number)
            steps.append(step)
            number += 1
        made.append(None)
        steps.append(None)
    return made[:-1], steps[:-1]


def _find_leading_fits(result: UpdateResult) -> list[_Fit]:
    """Return the fits that led to the result, in order."""
    # For each stage, the fit that ended nearest to the result, preceded by the fits that it
    # continues, up to the stage that reached the result. Other starts of a search and descents to
    # alternative solutions are excluded.
    fits = _split_fits(result.history)
    distances = [_distance(result, fit.accepted[-1][1]) for fit in fits]
    nearest: dict[str, int] = {}
    for i, fit in enumerate(fits):
        if fit.stage not in nearest or distances[i] < distances[nearest[fit.stage]]:
            nearest[fit.stage] = i
    least = min(distances, default=0.0)
    leading: list[_Fit] = []
    for last in nearest.values():
        first = last
        while first > 0 and fits[first].continues(fits[first - 1]):
            first -= 1
        leading += fits[first : last + 1]
        if distances[last] <= least + REPORT_LIST.invisible_change:
            break
    return leading


def _distance(result: UpdateResult, step: Iteration) -> float:
    """Return the largest difference of a value from the result, relative to value or start."""
    distances = [0.0]
    for p in result.parameters:
        value = result.values[p.name]
        size = max(abs(value), abs(p.start))
        if size > 0.0:
            distances.append(abs(step.values.get(p.name, value) - value) / size)
    return max(distances)


def _find_span(path: RealArray) -> float:
    finite = path[np.isfinite(path)]
    if not finite.size:
        return 0.0
    return float(np.ptp(finite))
