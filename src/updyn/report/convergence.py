"""The section of the report on the iterations of the fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.group import VALUES
from updyn.report.formats import (
    axis_title,
    figure_name,
    quantity_words,
)
from updyn.report.of_unknowns import OfUnknowns, by_figure
from updyn.report.plots import (
    Figure,
    existing,
    label,
    log_step,
    numbers,
)
from updyn.report.section import Content
from updyn.updating.fit.methods import METHODS
from updyn.updating.fit.monitor import Iteration, iterations_made
from updyn.updating.problem.parameters import Parameter
from updyn.updating.result import UpdateResult

__all__ = ["CONVERGENCE", "cost_path", "value_paths"]

#: Explanations of the stages that are not update methods.
_SEARCH = "tries from several starts"
_APPROACH = "descents of the log error from the start"
_OTHERS = "descents to other answers that may fit as well"
#: Largest number of unknowns named in a path figure; the others are drawn grey.
_LEGEND_ENTRIES = 12
#: Relative difference between parameter values that is invisible in the figures.
_THERE = 1e-3
#: Largest number of steps that are drawn with a marker each.
_SINGLE_STEPS = 60
#: Smallest relative range of a cost axis; below it, ticks would show rounding errors.
_ALIKE = 0.01
#: Width of the tick labels between panels, as a fraction of the figure width.
_TICKS = 0.09
_PATH_COLOURS = ("@after", "@before", "@third", "@fourth", "@muted", "@text")


class Convergence(OfUnknowns):
    """Cost and unknowns over the iterations."""

    anchor = "convergence"
    name = "Convergence"
    heading = "Convergence"
    place = 800
    template = "updyn.report/convergence.html"

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return the figures of the cost and of the paths of each kind of unknown."""
        result = content.result
        made = {"cost": cost_path(result)}
        chosen = by_figure(result, "factor-paths", "-paths", "calibration-paths")
        for name, some in chosen.items():
            made[name] = value_paths(result, some)
        return existing(made)

    def context(self, content: Content) -> dict[str, Any]:
        """Return the stages, the costs of the fit that led to the result, and the figure titles."""
        result = content.result
        stages = list(dict.fromkeys(step.stage for step in result.history))
        titles = [
            ("factor-paths", "Paths of the factors"),
            ("calibration-paths", "Paths of the calibration factors"),
        ]
        for kind in VALUES:
            titles.append((f"{figure_name(kind)}-paths", f"Paths: {quantity_words(kind)}"))
        return {
            "taken": result.iterations,
            "refused": sum(not step.accepted for step in result.history),
            "stages": stages,
            "explained": _explained(stages),
            "n_fits": len(_fits(result.history)),
            "last": next(reversed(_leading(result)), None),
            "titles": titles,
        }


CONVERGENCE = Convergence()


def _explained(stages: Sequence[str]) -> list[str]:
    """Return the stages with an explanation, omitting stages without one."""
    words = {"search": _SEARCH, "approach": _APPROACH, "other answers": _OTHERS}
    for stage in stages:
        if stage in METHODS:
            words[stage] = METHODS[stage].label
    return [f"{stage}: {words[stage]}" for stage in stages if words.get(stage)]


@dataclass(frozen=True, slots=True)
class _Fit:
    """A fit within a stage: one start of the search, or the steps under one residual weighting.

    Attributes
    ----------
    stage : str
        Name of the stage.
    taken, refused : list of (int, Iteration)
        Accepted and rejected steps, each with the number of iterations made so far in all stages; a
        rejected step has the number that it would have had.
    """

    stage: str
    taken: list[tuple[int, Iteration]]
    refused: list[tuple[int, Iteration]]

    def own(self, made: int) -> int:
        """Return the number of iterations since the start of this fit."""
        return made - self.taken[0][0]

    @property
    def costs(self) -> tuple[float, float]:
        """Cost at the first and at the last accepted step."""
        return self.taken[0][1].cost, self.taken[-1][1].cost

    def goes_on_from(self, other: _Fit) -> bool:
        """Whether this fit continues another fit of the same stage from its end point."""
        first, last = self.taken[0][1], other.taken[-1][1]
        if self.stage != other.stage:
            return False
        return first.step > 0.0 or first.values == last.values


def _fits(history: Sequence[Iteration]) -> list[_Fit]:
    """Return the fits of a history in order.

    A new fit begins at a change of stage, at a step of zero length, and at an increase of the cost.
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
    """Return the costs of all fits, one panel per stage; rejected steps are crosses."""
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
    """Return the position of zero costs on a logarithmic axis."""
    positive = costs[costs > 0]
    return float(positive.min()) / 10.0 if positive.size else 0.1


def _cost_axis(costs: NDArray[np.float64]) -> dict[str, Any]:
    """Return a logarithmic cost axis, or a linear one for costs within a factor of 2."""
    low, high = float(costs.min()), float(costs.max())
    if low > 0.5 * high:
        around, half = 0.5 * (low + high), 0.55 * max(high - low, _ALIKE * high)
        return {
            "exponentformat": "power",
            "nticks": 6,
            "range": [around - half, around + half],
        }
    positive = costs[costs > 0]
    return {"type": "log", "exponentformat": "power", "dtick": log_step(positive)}


def _cost_traces(fits: Sequence[_Fit], costs: NDArray[np.float64]) -> list[dict[str, Any]]:
    """Return the traces of the fits of a stage over their iteration numbers, separated by gaps."""
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
    """Return the iteration axis of some fits, counted from the start of each fit."""
    last = max(fit.own(made) for fit in fits for made, _ in fit.taken + fit.refused)
    axis: dict[str, Any] = {
        "title": {"text": "iteration of the fit"},
        "range": [-0.03 * last - 0.3, 1.03 * last + 0.3],
        "zeroline": False,
    }
    return _whole(axis, last)


def _whole(axis: dict[str, Any], last: int) -> dict[str, Any]:
    """Return an iteration axis with integer ticks only."""
    return axis | {"dtick": 1} if last <= 6 else axis


def value_paths(result: UpdateResult, chosen: Sequence[Parameter]) -> Figure | None:
    """Return the values of unknowns of one kind over the iterations that led to the result.

    Factors are relative to their start. Fits are separated by gaps. Of many unknowns, those with
    the largest range are named. None without unknowns or steps.
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
    for p in sorted(chosen, key=lambda p: p.name in named):  # draw named paths above the grey ones
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
            "xaxis": _whole({"title": {"text": "iteration"}, "zeroline": False}, len(steps)),
            "yaxis": {"title": {"text": axis_title(chosen[0])}},
            "showlegend": True,
            "legend": {"orientation": "v"},
        },
    }


def _paths(result: UpdateResult) -> tuple[list[int | None], list[Iteration | None]]:
    """Return the numbers and steps of the fits that led to the result, with None between fits."""
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
    """Return the fits that led to the result, in order.

    For each stage, the fit that ended nearest to the result, preceded by the fits that it
    continues, up to the stage that reached the result. Other starts of a search and descents to
    alternative solutions are excluded.
    """
    fits = _fits(result.history)
    off = [_distance(result, fit.taken[-1][1]) for fit in fits]
    nearest: dict[str, int] = {}
    for i, fit in enumerate(fits):
        if fit.stage not in nearest or off[i] < off[nearest[fit.stage]]:
            nearest[fit.stage] = i
    least = min(off, default=0.0)
    leading: list[_Fit] = []
    for last in nearest.values():
        first = last
        while first > 0 and fits[first].goes_on_from(fits[first - 1]):
            first -= 1
        leading += fits[first : last + 1]
        if off[last] <= least + _THERE:
            break
    return leading


def _distance(result: UpdateResult, step: Iteration) -> float:
    """Return the largest difference of a value from the result, relative to value or start."""
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
