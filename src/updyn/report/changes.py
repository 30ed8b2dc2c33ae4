"""The section on parameter changes: change of each unknown from its start, with 95 % interval."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import nan

import numpy as np

from updyn.report.formats import change, interval, number, quantity_words, unknown_words
from updyn.report.plots import (
    Figure,
    drop_missing,
    encode_numbers,
    error_bars,
    escape_label,
    escape_labels,
    names_font,
)
from updyn.report.section import PageContent, ReportSection
from updyn.report.settings import REPORT_LIST
from updyn.style import CATEGORIES
from updyn.text_table import FACTORS
from updyn.updating.problem.parameters import Parameter
from updyn.updating.result import UpdateResult

__all__ = [
    "CHANGES",
    "Change",
    "changes_figure",
    "changes_of_fits",
    "find_outcomes",
    "is_significant",
    "judge_change",
    "largest_changes",
    "order_by_change",
]

#: Limits of the axis, as ratios to the start; longer bars are clipped.
_LEAST, _MOST = 0.02, 50.0
#: Candidates for axis ticks, changes in percent.
_TICKS = (
    *(-98, -95, -90, -80, -70, -60, -50, -40, -30, -20, -10, -5, -2, -1, -0.5, -0.2, -0.1),
    *(0, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 40, 50, 75, 100, 150, 200, 300, 400, 600, 900),
    *(1400, 1900, 2900, 3900, 4900),
)
#: Smallest distance between ticks, as a fraction of the axis length.
_MIN_TICK_GAP = 0.07
#: The same for the small figure of the largest changes.
_SMALL_TICK_GAP = 0.25
#: Order of the quantities; other quantities follow.
_ORDER = ("stiffness", "mass", "viscous", "loss_factor")
#: Legend entry, colour and symbol by outcome of an unknown.
_STYLES = {
    "changed": ("changed: the 95 % interval excludes the start", "@after", "circle"),
    "insignificant": (
        "not significant: the 95 % interval includes the start",
        "@muted",
        "circle-open",
    ),
    "bound": ("ended at a bound", "@before", "diamond"),
    "undetermined": ("not determined by the data", "@muted", "x-thin-open"),
    "preliminary": ("at this step", "@after", "circle"),
}


@dataclass(frozen=True, slots=True)
class Change:
    """The value of an unknown that starts above zero, its 95 % interval, and its outcome.

    `span` is None without an interval; `outcome` is a key of `_STYLES`.
    """

    parameter: Parameter
    value: float
    span: tuple[float, float] | None
    outcome: str


def judge_change(
    p: Parameter, value: float, std: float, freedom: int | None, *, at_bound: bool
) -> Change:
    """Return the change of an unknown with its outcome; `freedom` as in `formats.interval`."""
    span = interval(p, value, std, freedom)
    outcome = "insignificant"
    if at_bound:
        outcome = "bound"
    elif span is None:
        outcome = "undetermined"
    elif _excludes_start(p, span):
        outcome = "changed"
    return Change(p, value, span, outcome)


def _excludes_start(p: Parameter, span: tuple[float, float] | None) -> bool:
    return span is not None and not span[0] <= p.start <= span[1]


def is_significant(result: UpdateResult, parameter: Parameter) -> bool:
    """Whether the 95 % interval of an unknown excludes its start; False without an interval."""
    return _excludes_start(parameter, _change_of(result, parameter).span)


def _change_of(result: UpdateResult, p: Parameter) -> Change:
    freedom = result.noise.get("degrees_of_freedom")
    value, std = result.values[p.name], result.std[p.name]
    return judge_change(p, value, std, freedom, at_bound=p.name in result.at_bound)


class ChangesSection(ReportSection):
    """The changes of the unknowns from their start."""

    anchor = "changes"
    name = "Changes"
    heading = "Parameter changes"
    place = 20
    template = "updyn.report/changes.html"

    def applies(self, content: PageContent) -> bool:
        """Whether the page shows an update."""
        return content.update is not None

    def figures(self, content: PageContent) -> dict[str, Figure]:
        """Return the figure of the changes."""
        return drop_missing({"changes": changes_figure(content.result)})

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the unknowns that the figure omits."""
        result = content.result
        percents = [p for p in result.parameters if _has_percent(result, p)]
        from_zero = [p for p in result.parameters if p.start == 0.0]
        grown, still = [], []
        for p in from_zero:
            if is_significant(result, p):
                grown.append(f"{unknown_words(p.name)} now {_value_words(_change_of(result, p))}")
            else:
                still.append(unknown_words(p.name))
        left_out = max(len(percents) - REPORT_LIST.changed_unknowns, 0)
        return {"grown": grown, "still": still, "left_out": left_out}


CHANGES = ChangesSection()


def _value_words(found: Change) -> str:
    value = number(found.value)
    if found.span is None:
        return value if found.outcome == "preliminary" else f"{value} (not determined)"
    low, high = map(number, found.span)
    if low == high:
        return value
    return f"{value} (95 % interval {low} to {high})"


def _has_percent(result: UpdateResult, p: Parameter) -> bool:
    return p.start > 0.0 and math.isfinite(result.values[p.name])


@dataclass(frozen=True, slots=True)
class _ChangeRow:
    """A row of the figure: place from the top, change, and ratios to the start."""

    place: float
    change: Change
    ratio: float
    low: float
    high: float

    @classmethod
    def of(cls, found: Change, place: float) -> _ChangeRow:
        low, high = found.span or (nan, nan)
        ratios = np.array([found.value, low, high]) / found.parameter.start
        return cls(place, found, *ratios.tolist())

    @property
    def parameter(self) -> Parameter:
        return self.change.parameter

    @property
    def outcome(self) -> str:
        return self.change.outcome

    @property
    def name(self) -> str:
        return escape_label(f"{self.parameter.group}: {quantity_words(self.parameter.quantity)}")

    @property
    def text(self) -> str:
        return change(self.parameter, self.change.value)


def order_by_change(result: UpdateResult) -> list[Parameter]:
    """Return the unknowns with a change in percent: significant ones first, then by size."""

    def size(p: Parameter) -> tuple[bool, float]:
        ratio = max(result.values[p.name] / p.start, _LEAST)
        return is_significant(result, p), abs(math.log(ratio))

    return sorted((p for p in result.parameters if _has_percent(result, p)), key=size, reverse=True)


def _select_parameters(result: UpdateResult) -> list[Parameter]:
    """Return the unknowns to show, in order; of too many, those that changed most."""
    kept = {p.name for p in order_by_change(result)[: REPORT_LIST.changed_unknowns]}
    return [p for p in result.parameters if p.name in kept]


def _arrange_rows(result: UpdateResult) -> tuple[list[_ChangeRow], dict[int, str]]:
    """Return the rows ordered by quantity, and the headings between them by place."""
    by_quantity: dict[str, list[Parameter]] = {quantity: [] for quantity in _ORDER}
    for p in _select_parameters(result):
        by_quantity.setdefault(p.quantity, []).append(p)
    rows: list[_ChangeRow] = []
    headings = {}
    place = 0
    for quantity, members in by_quantity.items():
        if not members:
            continue
        headings[place] = quantity_words(quantity)
        place += 1
        for p in members:
            rows.append(_ChangeRow.of(_change_of(result, p), place))
            place += 1
    return rows, headings


def changes_figure(result: UpdateResult) -> Figure | None:
    """Return the change of each unknown from its start with its 95 % interval, by quantity."""
    # The axis is logarithmic in the ratio to the start and labelled in percent, so half and double
    # are equally far from no change. None if no unknown starts above zero.
    rows, headings = _arrange_rows(result)
    if not rows:
        return None
    view = _find_range(rows)
    traces = [_bounds_trace(rows, view)]
    for outcome, (name, colour, symbol) in _STYLES.items():
        chosen = [row for row in rows if row.outcome == outcome]
        if chosen:
            traces.append(_estimates_trace(chosen, view, name, colour, symbol))
    ticks: list[float] = [*headings, *(row.place for row in rows)]
    names = [f"<b>{escape_label(text)}</b>" for text in headings.values()]
    names += escape_labels(row.parameter.group for row in rows)
    height = 22 if len(rows) > 8 else 26
    traces.append(_invisible_trace(rows))
    right = [(row.place, row.text) for row in rows]
    figure = _lay_out(rows[-1].place, view, (ticks, names), right)
    figure["layout"] |= {"showlegend": True}
    figure["layout"]["xaxis"]["title"] = {"text": "change from the start"}
    return {"data": traces, "height": 110 + height * int(rows[-1].place + 1)} | figure


def _lay_out(
    last: float,
    view: tuple[float, float],
    left: tuple[list[float], list[str]],
    right: Sequence[tuple[float, str]],
    gap: float = _MIN_TICK_GAP,
) -> Figure:
    """Return the layout: an axis in percent, names and texts at `left` and `right` places.

    `last` is the last place.
    """
    marks = _choose_ticks(view, gap)
    common = {"range": [last + 0.7, -0.7], "zeroline": False, "showgrid": False}
    font = names_font(left[1])
    return {
        "layout": {
            "xaxis": {
                "type": "log",
                "range": np.log10(view).tolist(),
                "tickvals": [1.0 + mark / 100.0 for mark in marks],
                "ticktext": [_format_tick(mark) for mark in marks],
                "tickangle": 0,
                "zeroline": False,
            },
            "yaxis": {"tickvals": left[0], "ticktext": left[1], "tickfont": font, **common},
            "yaxis2": {
                "overlaying": "y",
                "side": "right",
                "tickvals": [place for place, _ in right],
                "ticktext": escape_labels(text for _, text in right),
                "tickfont": font,
                **common,
            },
            "shapes": [_start_line(last)],
        },
    }


def largest_changes(result: UpdateResult) -> Figure | None:
    """Return bars of the largest changes with their 95 % intervals; None without any."""
    # The axis contains all estimates and the intervals of the significant ones; others are cut off.
    rows = _list_largest(result)
    if not rows:
        return None
    short = [row if row.outcome == "changed" else replace(row, low=nan, high=nan) for row in rows]
    view = _find_range(short)
    margin = (view[1] / view[0]) ** 0.1
    view = view[0] / margin, view[1] * margin
    beyond = view[0] / margin, view[1] * margin
    traces: list[dict[str, object]] = []
    for outcome, (name, colour, symbol) in _STYLES.items():
        alike = [row for row in rows if row.outcome == outcome]
        if alike:
            traces.append(_bars_trace(alike, view, colour))
            traces.append(_estimates_trace(alike, beyond, name, colour, symbol))
    traces.append(_invisible_trace(rows))
    left = [row.place for row in rows], [row.name for row in rows]
    right = [(row.place, _describe_outcome(row, result)) for row in rows]
    figure = _lay_out(rows[-1].place, view, left, right, gap=_SMALL_TICK_GAP)
    figure["layout"] |= {"showlegend": False, "margin": {"l": 60, "r": 8, "t": 4, "b": 26}}
    return {"data": traces, "height": 40 + 26 * len(rows)} | figure


def _list_largest(result: UpdateResult) -> list[_ChangeRow]:
    chosen = order_by_change(result)[: REPORT_LIST.largest_changes]
    return [_ChangeRow.of(_change_of(result, p), place) for place, p in enumerate(chosen)]


def find_outcomes(result: UpdateResult) -> set[str]:
    """Return the outcomes (keys of `_STYLES`) of the unknowns in `largest_changes`."""
    return {row.outcome for row in _list_largest(result)}


def changes_of_fits(fits: Mapping[str, Sequence[Change]]) -> Figure | None:
    """Return bars of the changes of the unknowns in fits, by name of the fit; None without any.

    The bars of one fit are coloured by outcome, those of several by fit. Of too many unknowns,
    those that changed most in any fit are shown.
    """
    places = _order_unknowns([one for found in fits.values() for one in found])
    rows: list[tuple[str, _ChangeRow]] = []
    share = 0.8 / max(len(fits), 1)
    for fit, (name, found) in enumerate(fits.items()):
        offset = (fit - 0.5 * (len(fits) - 1)) * share
        for one in found:
            if one.parameter.name in places:
                rows.append((name, _ChangeRow.of(one, places[one.parameter.name] + offset)))
    if not rows:
        return None
    view = _find_range([row for _, row in rows])
    traces: list[dict[str, object]] = [_bounds_trace([row for _, row in rows], view)]
    width = max(int(12 * share / 0.8), 4)
    for label, colour, symbol, chosen in _divide_rows(rows, list(fits)):
        traces.append(_bars_trace(chosen, view, colour, width))
        traces.append(_estimates_trace(chosen, view, label, colour, symbol))
    names = {places[row.parameter.name]: row.name for _, row in rows}
    left: tuple[list[float], list[str]] = [*names], [*names.values()]
    right: list[tuple[float, str]] = []
    if len(fits) == 1:
        right = [(row.place, row.text) for _, row in rows]
        traces.append(_invisible_trace([row for _, row in rows]))
    figure = _lay_out(len(places) - 1, view, left, right, gap=REPORT_LIST.tick_gap)
    margin = {"l": 60, "r": 16, "t": 48, "b": 48}  # with a row of the legend above the data
    figure["layout"] |= {"showlegend": True, "margin": margin}
    figure["layout"]["xaxis"]["title"] = {"text": "change from the start"}
    each = max(24, 12 * len(fits))
    return {"data": traces, "height": 128 + each * len(places)} | figure


def _order_unknowns(changes: Iterable[Change]) -> dict[str, int]:
    """Return the rows of the unknowns by name, in order; of too many, those that changed most."""
    sizes: dict[str, float] = {}
    for one in changes:
        if one.parameter.start > 0.0 and math.isfinite(one.value):
            size = abs(math.log(max(one.value / one.parameter.start, _LEAST)))
            sizes[one.parameter.name] = max(size, sizes.get(one.parameter.name, 0.0))
    most = sorted(sizes, key=lambda name: -sizes[name])[: REPORT_LIST.changed_unknowns]
    return {name: place for place, name in enumerate(name for name in sizes if name in most)}


def _divide_rows(
    rows: Sequence[tuple[str, _ChangeRow]], fits: Sequence[str]
) -> Iterator[tuple[str, str, str, list[_ChangeRow]]]:
    """Yield label, colour, symbol and rows: by outcome for one fit, by fit for several."""
    if len(fits) == 1:
        for outcome, (label, colour, symbol) in _STYLES.items():
            chosen = [row for _, row in rows if row.outcome == outcome]
            if chosen:
                yield label, colour, symbol, chosen
        return
    for place, fit in enumerate(fits):
        chosen = [row for name, row in rows if name == fit]
        if chosen:
            yield escape_label(fit), f"@{CATEGORIES[place % len(CATEGORIES)]}", "circle", chosen


def _describe_outcome(row: _ChangeRow, result: UpdateResult) -> str:
    """Return the change of a row as text, with its outcome if it is at a bound or open."""
    p = row.parameter
    if row.outcome == "undetermined":
        return result.why_open(p.name).partition(":")[0].removesuffix(" by the data")
    return f"{row.text}, bound" if row.outcome == "bound" else row.text


def _bars_trace(
    rows: Sequence[_ChangeRow], view: tuple[float, float], colour: str, width: int = 12
) -> dict[str, object]:
    """Return bars from no change to the estimates, with a width in pixels."""
    x: list[float | None] = []
    y: list[float | None] = []
    for row in rows:
        x += [1.0, float(np.clip(row.ratio, *view)), None]
        y += [row.place, row.place, None]
    return {
        "type": "scatter",
        "mode": "lines",
        "x": x,
        "y": y,
        "line": {"color": colour, "width": width},
        "opacity": 0.35,
        "showlegend": False,
        "hoverinfo": "skip",
    }


def _find_range(rows: Sequence[_ChangeRow]) -> tuple[float, float]:
    """Return the axis range that contains estimates, intervals and no change, with a margin."""
    shown = np.array([[row.ratio, row.low, row.high] for row in rows]).ravel()
    shown = np.append(shown[np.isfinite(shown)], 1.0)
    low = max(float(shown.min()), _LEAST)
    high = min(float(shown.max()), _MOST)
    margin = max((high / low) ** 0.06, 1.0005)
    return low / margin, high * margin


def _choose_ticks(view: tuple[float, float], gap: float) -> list[float]:
    """Return the changes in percent to label: 0 first, then the roundest values that fit."""
    low, high = np.log(view)
    apart = gap * (high - low)
    taken: list[float] = []
    for mark in sorted(_TICKS, key=_roundness):
        at = math.log1p(mark / 100.0)
        if low <= at <= high and all(abs(at - math.log1p(t / 100.0)) >= apart for t in taken):
            taken.append(mark)
    return sorted(taken)


def _roundness(mark: float) -> tuple[bool, int]:
    """Return a sort key: 0 first, then values whose first digit is 1, 5, 2, then the rest.

    The digit is that of the change in percent or, below half and above five times, of the factor.
    """
    if mark == 0.0:
        return False, 0
    digits = abs(mark) if -50 < mark < 400 else 100 + mark
    return True, "152".find(f"{digits:.0e}"[0]) % 10


def _format_tick(mark: float) -> str:
    """Return a change in percent for an axis; large ones as factors."""
    factor = 1.0 + mark / 100.0
    text = f"×{factor:g}" if factor >= FACTORS else f"{mark:+g} %"
    return text.replace("-", "−").replace("+0 ", "0 ")


def _estimates_trace(
    rows: Sequence[_ChangeRow],
    view: tuple[float, float],
    name: str,
    colour: str,
    symbol: str,
) -> dict[str, object]:
    """Return estimates with their intervals, clipped at the ends of the axis."""
    x = np.clip([row.ratio for row in rows], *view)
    texts = [
        f"{row.name} {escape_label(row.text)}, {escape_label(_value_words(row.change))}"
        for row in rows
    ]
    trace: dict[str, object] = {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "x": encode_numbers(x),
        "y": [row.place for row in rows],
        "text": texts,
        "marker": {
            "symbol": symbol,
            "color": colour,
            "size": 9,
            "line": {"width": 2, "color": colour},
        },
        "hovertemplate": "%{text}<extra></extra>",
    }
    low = np.clip([row.low for row in rows], *view)
    high = np.clip([row.high for row in rows], *view)
    if np.isfinite(low).any():
        trace["error_x"] = error_bars(
            np.nan_to_num(x - low, nan=0.0), np.nan_to_num(high - x, nan=0.0), colour
        )
    return trace


def _bounds_trace(rows: Sequence[_ChangeRow], view: tuple[float, float]) -> dict[str, object]:
    """Return the bounds inside the axis range."""
    x: list[float] = []
    y: list[float] = []
    for row in rows:
        p = row.parameter
        for ratio in (p.lower / p.start, p.upper / p.start):
            if view[0] < ratio < view[1]:
                x.append(ratio)
                y.append(row.place)
    return {
        "type": "scatter",
        "mode": "markers",
        "name": "bound",
        "x": x,
        "y": y,
        "showlegend": bool(x),
        "marker": {"symbol": "line-ns-open", "color": "@muted", "size": 14, "line": {"width": 3}},
        "hovertemplate": "bound<extra></extra>",
    }


def _invisible_trace(rows: Sequence[_ChangeRow]) -> dict[str, object]:
    """Return a trace without visible markers, needed to draw the axis on the right."""
    return {
        "type": "scatter",
        "mode": "markers",
        "x": [1.0],
        "y": [rows[0].place],
        "yaxis": "y2",
        "marker": {"opacity": 0},
        "showlegend": False,
        "hoverinfo": "skip",
    }


def _start_line(last: float) -> dict[str, object]:
    return {
        "type": "line",
        "xref": "x",
        "x0": 1.0,
        "x1": 1.0,
        "yref": "y",
        "y0": -0.7,
        "y1": last + 0.7,
        "layer": "below",
        "line": {"color": "@text", "width": 1},
    }
