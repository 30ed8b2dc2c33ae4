"""Figures of the unknowns: changes with their intervals, identifiability."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from updyn.arrays import RealArray
from updyn.errors import OptionError
from updyn.plots.canvas import (
    Canvas,
    WhichAxes,
    canvas,
    heat_map,
    legend_above,
    log_axis,
    name_rows,
)
from updyn.report.formats import axis_title, quantity_words
from updyn.report.identifiability import correlations
from updyn.style import PAPER
from updyn.updating.fit.settings import NULL_SPACE
from updyn.updating.judge.identifiability import Identifiability
from updyn.updating.problem.parameters import Parameter
from updyn.updating.result import JointResult, UpdateResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["identifiability", "parameters"]

#: Legend entry and marker by outcome of an unknown.
_OUTCOMES: dict[str, tuple[str, dict[str, Any]]] = {
    "determined": ("estimate with its interval", {"marker": "o", "color": PAPER["after"]}),
    "bound": ("estimate at a bound", {"marker": "D", "color": PAPER["before"]}),
    "open": (
        "not determined by the data",
        {"marker": "x", "color": PAPER["muted"], "markeredgewidth": 1.6},
    ),
}


def parameters(
    result: UpdateResult | JointResult, *, level: float = 0.95, ax: WhichAxes | None = None
) -> Figure:
    """Draw the changes of the unknowns from their start, with confidence intervals.

    Unknowns that start at 0 have no change in percent; their values are drawn in further panels,
    one for each kind.

    Parameters
    ----------
    result : UpdateResult or JointResult
        Result of `updyn.update`.
    level : float
        Probability that an interval covers the true value.
    ax : matplotlib.axes.Axes or sequence of them, optional
        Axes, one for each panel; None for a new figure.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    OptionError
        If matplotlib is not installed, `result` is not the result of an update, the level is not
        between 0 and 1, or `ax` does not have one axes object per panel.
    """
    _check_result(result, "parameters")
    if not 0.0 < level < 1.0:
        raise OptionError(f"plots.parameters: level {level!r}; expected a number between 0 and 1")
    kinds: dict[str, list[Parameter]] = {}
    for p in result.parameters:
        title = "change from the start (%)" if p.start > 0.0 else _value_title(p)
        kinds.setdefault(title, []).append(p)
    shares = {title: len(chosen) + 1.6 for title, chosen in kinds.items()}
    height = 110 + 26 * len(result.parameters) + 70 * len(kinds)
    with canvas(ax, shares, (960, height), share_x=False) as made:
        if len(made.axes) < len(kinds):
            raise OptionError(
                f"ax: {len(made.axes)} axes for {len(kinds)} panels ({', '.join(kinds)})"
            )
        intervals = result.intervals(level)
        for title, chosen in kinds.items():
            axes = made.axes[title]
            _estimates(axes, result, chosen, intervals, percent=chosen[0].start > 0.0)
            axes.set_xlabel(title)
        legend_above(made.first, f"{100.0 * level:g} % intervals")
    return made.figure


def _value_title(p: Parameter) -> str:
    title = axis_title(p)
    return title if p.value_unit else f"{title} (–)"


def _estimates(
    axes: Axes,
    result: UpdateResult | JointResult,
    chosen: Sequence[Parameter],
    intervals: dict[str, tuple[float, float]],
    *,
    percent: bool,
) -> None:
    outcomes: dict[str, list[int]] = {}
    x = np.empty(len(chosen))
    spans = np.full((len(chosen), 2), np.nan)
    limits = np.empty((len(chosen), 2))
    for row, p in enumerate(chosen):
        x[row] = _to_plotted(p, result.values[p.name], percent)
        limits[row] = _to_plotted(p, p.lower, percent), _to_plotted(p, p.upper, percent)
        span = intervals.get(p.name)
        outcome = "open"
        if span is not None:
            outcome = "bound" if p.name in result.first.at_bound else "determined"
            spans[row] = [_to_plotted(p, end, percent) for end in span]
        outcomes.setdefault(outcome, []).append(row)
    axes.set_xmargin(0.05)
    for outcome, (name, look) in _OUTCOMES.items():
        rows = np.array(outcomes.get(outcome, []), dtype=np.intp)
        if len(rows):
            if outcome != "open":
                off = np.abs(spans[rows] - x[rows, None]).T
                axes.errorbar(x[rows], rows, xerr=off, fmt="none", ecolor=look["color"], capsize=3)
            axes.plot(x[rows], rows, linestyle="none", markersize=6, label=name, **look)
    axes.axvline(
        _to_plotted(chosen[0], chosen[0].start, percent), color=PAPER["text"], linewidth=0.8
    )
    _bounds(axes, limits)
    name_rows(axes, [f"{p.group}: {quantity_words(p.quantity)}" for p in chosen])


def _to_plotted(p: Parameter, value: float, percent: bool) -> float:
    """Return a value as drawn: the change in percent, or the value itself."""
    return 100.0 * (value / p.start - 1.0) if percent else value


def _bounds(axes: Axes, limits: RealArray) -> None:
    """Draw the bounds inside the current limits of the x axis, and keep these limits."""
    low, high = axes.get_xlim()
    rows, _ = np.nonzero((limits > low) & (limits < high))
    inside = limits[(limits > low) & (limits < high)]
    if inside.size:
        look: dict[str, Any] = {
            "marker": "|",
            "markersize": 13,
            "markeredgewidth": 2.4,
            "zorder": 1,
        }
        axes.plot(inside, rows, linestyle="none", color=PAPER["measured"], label="bound", **look)
    axes.set_xlim(low, high)


def _check_result(result: object, what: str) -> None:
    if not isinstance(result, UpdateResult | JointResult):
        raise OptionError(
            f"plots.{what}: expected the result of an update, found {type(result).__name__}"
        )


# -- identifiability -------------------------------------------------------------------------------
def identifiability(
    found: UpdateResult | JointResult | Identifiability, *, ax: WhichAxes | None = None
) -> Figure:
    """Draw which combinations of the unknowns the data determine.

    The panels show the singular values of the scaled Jacobian; the undetermined combinations as
    weights by unknown, if there are any; and, for a result, the correlation of the estimates.

    Parameters
    ----------
    found : UpdateResult, JointResult or Identifiability
        A result, or its ``identifiability``.
    ax : matplotlib.axes.Axes or sequence of them, optional
        Axes, assigned to the panels in order; None for a new figure.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    OptionError
        If matplotlib is not installed, or `found` is none of these types.
    """
    matrix = None
    names: list[str] = []
    ident = found
    if not isinstance(found, Identifiability):
        _check_result(found, "identifiability")
        ident = found.identifiability
        names = [f"{p.group}: {quantity_words(p.quantity)}" for p in found.parameters]
        matrix = correlations(np.asarray(found.first.covariance, dtype=np.float64))
        if len(names) < 2 or not np.isfinite(matrix).any():
            matrix = None
    assert isinstance(ident, Identifiability)
    involved = list(dict.fromkeys(name for d in ident.null_directions for name in d))
    sizes = {"values": 230.0}
    if involved:
        sizes["null"] = 150.0 + 26.0 * len(ident.null_directions)
    if matrix is not None:
        sizes["correlation"] = 170.0 + 26.0 * len(names)
    with canvas(ax, sizes, (960, sum(sizes.values())), share_x=False) as made:
        _draw_panels(made, ident, involved, names, matrix)
    return made.figure


def _draw_panels(
    made: Canvas,
    ident: Identifiability,
    involved: Sequence[str],
    names: Sequence[str],
    matrix: RealArray | None,
) -> None:
    _singular_values(made.axes["values"], ident)
    if "null" in made.axes:
        weights = [[d.get(name, np.nan) for name in involved] for d in ident.null_directions]
        rows = [f"combination {number}" for number in range(1, len(weights) + 1)]
        columns = list(map(_format_name, involved))
        title = "weight (–)"
        heat_map(made, np.array(weights), (rows, columns), title, signed=True, panel="null")
        made.axes["null"].set_title("undetermined: moved together, nothing measured changes")
    if matrix is not None and "correlation" in made.axes:
        title = "correlation (–)"
        heat_map(made, matrix, (names, names), title, signed=True, panel="correlation")
        made.axes["correlation"].set_title("correlation of the estimates")


def _format_name(name: str) -> str:
    group, _, quantity = name.rpartition(".")
    return f"{group}: {quantity_words(quantity)}" if group else name


def _singular_values(axes: Axes, ident: Identifiability) -> None:
    """Draw the singular values, determined and undetermined ones with different markers."""
    values = np.array(ident.singular_values, dtype=np.float64)
    positive = values[values > 0]
    foot = float(positive.min()) / 10.0 if positive.size else 1e-16
    number, height = np.arange(1, len(values) + 1), np.maximum(values, foot)
    known = number <= ident.rank
    for chosen, name, marker, role in (
        (known, "determined", "o", "after"),
        (~known, "undetermined: lost in the noise, or exactly", "x", "before"),
    ):
        if chosen.any():
            look: dict[str, Any] = {"marker": marker, "markersize": 6, "color": PAPER[role]}
            axes.plot(number[chosen], height[chosen], linestyle="none", label=name, **look)
    log_axis(axes, "y")
    limit = NULL_SPACE.rank_tolerance * float(values.max(initial=0.0))
    if limit >= axes.get_ylim()[0]:
        axes.axhline(limit, color=PAPER["muted"], linestyle=":", label="zero by arithmetic")
    axes.set_xlabel("combination, best determined first (–)")
    axes.set_ylabel("singular value (–)")
    step = max(1, math.ceil(len(values) / 20))
    axes.set_xticks(number[::step])
    axes.set_xlim(0.4, len(values) + 0.6)
    legend_above(axes, f"the data determine {ident.rank} of {ident.n_parameters} unknowns")
