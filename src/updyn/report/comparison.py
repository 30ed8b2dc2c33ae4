"""`write_comparison`: compare update methods side by side on one self-contained HTML page."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from updyn import __version__
from updyn.arrays import BoolArray, ComplexArray, RealArray
from updyn.comparison import Comparison, Row
from updyn.comparison.table import cells, columns, limits, reason
from updyn.dynamics.excitation import fix_base
from updyn.frf import FRF
from updyn.report.data import compute_frfs, fine_grid, keep_lines
from updyn.report.formats import decibels, extent, format_count, number, unit
from updyn.report.page import assemble
from updyn.report.plots import (
    MODEL_COLOURS,
    Figure,
    drop_missing,
    encode_numbers,
    escape_label,
    linear_frequency,
    log_bars,
    log_step,
)
from updyn.report.section import PageContent, ReportSection
from updyn.report.settings import REPORT_COMPUTATION
from updyn.report.templates import render_template, write_page
from updyn.style import OTHERS
from updyn.updating.problem.data import Test
from updyn.updating.result import UpdateResult

__all__ = ["Curves", "gather_curves", "is_geometric", "write_comparison"]

#: The paper's method and its baseline, drawn in one figure.
PAIR = ("equation-error", "reduced-frf")
#: Height in pixels of the FRF figure of the pair, and of the figure of one method.
_PAIR_HEIGHT = 440
_PANEL_HEIGHT = 290


def write_comparison(comparison: Comparison, path: str | PathLike[str]) -> Path:
    """Write a comparison of methods as one HTML page that needs no network and no other file.

    The page shows the table of methods; the FRF of the channel with the largest error at the start,
    measured, before, and after by each method; bars of error, misfit, time and work; the reasons
    why methods do not apply; and the search for the fewest lines. The FRFs of the models are
    computed for the page.

    Parameters
    ----------
    comparison : Comparison
        Result of `updyn.compare`.
    path : str or path-like
        The file. An existing file is replaced only after the new page is complete.

    Returns
    -------
    Path
        The file.
    """
    return write_page(render(comparison), path)


def render(comparison: Comparison) -> str:
    """Return the page as HTML."""
    content = PageContent(
        further={"comparison": ComparisonContent(comparison, gather_curves(comparison))}
    )
    title = f"{comparison.title}: methods" if comparison.title else "Comparison of methods"
    return assemble(content, _head(comparison, title), title, __version__)


@dataclass(frozen=True, slots=True, eq=False)
class ComparisonContent:
    """A comparison and the FRFs drawn on its page; None if no model could be computed."""

    comparison: Comparison
    curves: Curves | None


# -- head ----------------------------------------------------------------------------------------
def _head(comparison: Comparison, title: str) -> str:
    run = [row for row in comparison if row.applies]
    unknowns = format_count(len(comparison.parameters), "unknown")
    about = f"{format_count(len(comparison), 'method')}, {unknowns}"
    if len(comparison.tests) > 1:
        about += f", {len(comparison.tests)} tests"
    else:
        about += f"; {extent(comparison.tests[0].frf)}"
    stopped = ""
    if comparison.stopped:
        stopped = "The user stopped the comparison; it holds the methods completed so far."
        if comparison.not_run:
            stopped += f" Not run: {', '.join(comparison.not_run)}."
    return render_template(
        "updyn.report/comparison_head.html",
        title=title,
        about=about,
        verdict=_format_verdict(comparison, run),
        stopped=stopped,
        key_figures=_key_figures(comparison, run),
    )


def _format_verdict(comparison: Comparison, run: Sequence[Row]) -> str:
    """Return a sentence: how many methods apply, and which recover the unknowns or converged."""
    start = f"{len(run)} of {format_count(len(comparison), 'method')} can be used on these data."
    if comparison.truth:
        within = f"{100 * comparison.tolerance:g} %"
        recovered = [row.method for row in run if row.error_max <= comparison.tolerance]
        if recovered:
            methods = _join_names(recovered)
            return f"{start} Every unknown comes out within {within} of the truth by {methods}."
        return f"{start} None finds every unknown within {within} of the truth."
    converged = [row.method for row in run if row.status == "converged"]
    if converged:
        return f"{start} Converged, with all unknowns determined: {_join_names(converged)}."
    return f"{start} None converged with all unknowns determined."


def _key_figures(comparison: Comparison, run: Sequence[Row]) -> list[tuple[str, str, str]]:
    """Return (name, value, hint) of each key figure."""
    before = comparison.before.get("db_error_median", math.nan)
    misfits, errors, lines = {}, {}, {}
    for row in run:
        if row.status != "failed":
            misfits[row.method] = _median_misfit(row)
            errors[row.method] = row.error_max
        if row.fewest is not None and row.fewest.count:
            lines[row.method] = float(row.fewest.count)
    out = [("Misfit before", _decibels(before), "median level difference of the start")]
    out += _find_best("Least misfit after", misfits, _decibels)
    if comparison.truth:
        out += _find_best("Least error", errors, lambda v: number(v, 2))
    out += _find_best("Fewest lines", lines, lambda v: f"{v:.0f}")
    return out


def _median_misfit(row: Row) -> float:
    """Return the median level difference after the update, in dB; NaN if unknown."""
    return float((row.fitted.get("after") or {}).get("db_error_median", math.nan))


def _find_best(
    name: str, values: Mapping[str, float], say: Callable[[float], str]
) -> list[tuple[str, str, str]]:
    """Return the key figure of the least value, with the names of the methods that reach it."""
    known = {method: v for method, v in values.items() if math.isfinite(v)}
    if not known:
        return []
    least = min(known.values())
    limit = max(least * (1.0 + 1e-9), 1e-9)  # differences within rounding count as equal
    shown = say(least)
    best = [method for method, v in known.items() if v <= limit or say(v) == shown]
    return [(name, shown, _join_names(best))]


def _decibels(value: float) -> str:
    """Return a level difference as text; rounding errors are written as 0."""
    return "0 dB" if value < 1e-9 else decibels(value)


def _join_names(names: Sequence[str]) -> str:
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} and {names[-1]}"


# -- sections ------------------------------------------------------------------------------------
class ComparisonSection(ReportSection):
    """A section of the page of a comparison."""

    def applies(self, content: PageContent) -> bool:
        """Whether the page describes a comparison and not an update."""
        return content.update is None


class MethodsSection(ComparisonSection):
    """The table of the methods."""

    anchor = "table"
    name = "Methods"
    heading = "Methods"
    place = 100
    template = "updyn.report/comparison_methods.html"

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the table."""
        comparison: Comparison = content.further["comparison"].comparison
        shown = [column for column in columns(comparison) if column[0] != "limits"]
        head, kinds = [], []
        for key, heading, _ in shown:
            head.append(heading)
            kinds.append("text" if key in ("method", "status") else "")
        rows = []
        for row in comparison:
            typeset = list(map(_typeset, cells(row, shown)))
            rows.append({"cells": typeset, "converged": row.status == "converged"})
        return {"truth": bool(comparison.truth), "head": head, "kinds": kinds, "methods": rows}


def _typeset(cell: str) -> str:
    """Return a table cell of the terminal with typographic dashes and powers of ten."""
    if cell == "-":
        return "–"
    try:
        value = float(cell)
    except ValueError:
        return cell
    if "e" in cell or not math.isfinite(value):
        return number(value, 2)
    return cell.replace("-", "−")


class FrfsSection(ComparisonSection):
    """FRFs of one channel, measured, before, and after by each method."""

    anchor = "frfs"
    name = "FRFs"
    heading = "FRFs before and after"
    place = 200
    template = "updyn.report/comparison_frfs.html"

    def applies(self, content: PageContent) -> bool:
        """Whether a model could be computed."""
        return content.update is None and content.further["comparison"].curves is not None

    def figures(self, content: PageContent) -> dict[str, Figure]:
        """Return the FRFs by method."""
        return frf_figures(content.further["comparison"].curves)

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the channel, the methods that are drawn, and the methods without a result."""
        shown: ComparisonContent = content.further["comparison"]
        comparison, curves = shown.comparison, shown.curves
        assert curves is not None
        silent = [row for row in comparison if row.method not in curves.after]
        panels = []
        for k, name in enumerate(curves.after):
            row = comparison[name]
            panels.append(
                {
                    "method": name,
                    "figure": panel_name(k),
                    "status": row.status,
                    "misfit": _decibels(_median_misfit(row)),
                }
            )
        return {
            "curves": curves,
            "misfit": _decibels(curves.misfit),
            "pair": PAIR,
            "panels": panels,
            "silent": silent,
        }


class BarsSection(ComparisonSection):
    """Error, misfit, time and work by method."""

    anchor = "bars"
    name = "Error, time and work"
    heading = "Error, time and work"
    place = 300
    template = "updyn.report/comparison_bars.html"

    def figures(self, content: PageContent) -> dict[str, Figure]:
        """Return the bars."""
        return bar_figures(content.further["comparison"].comparison)

    def context(self, content: PageContent) -> dict[str, object]:
        """Return name, heading and caption of the figures."""
        comparison: Comparison = content.further["comparison"].comparison
        error = "Largest error of an unknown"
        if comparison.truth:
            error += f"; dashed: {comparison.tolerance:g}"
        if any(math.isinf(row.error_max) for row in comparison):
            error += "; no bar where an unknown is not determined"
        return {
            "bars": [
                ("error", "Error", f"{error}."),
                ("misfit", "Misfit", "Median level difference after the update."),
                ("seconds", "Time", "From start to judgement, on one machine at one time."),
                ("work", "Work", "Lines at which the model was solved."),
            ]
        }


class FewestLinesSection(ComparisonSection):
    """The fewest lines with which each method recovers the unknowns."""

    anchor = "lines"
    name = "Fewest lines"
    heading = "Fewest lines"
    place = 400
    template = "updyn.report/comparison_lines.html"

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the rule and the table of the methods for which the fewest lines were searched."""
        comparison: Comparison = content.further["comparison"].comparison
        counts = sorted({n for row in comparison if row.fewest for n, _ in row.fewest.tried})
        rows, notes = [], []
        for row in comparison:
            if row.fewest is None:
                continue
            tried = dict(row.fewest.tried)
            found = "none" if row.fewest.count is None else str(row.fewest.count)
            entries = [row.method, str(len(row.updated)), found]
            for n in counts:
                entries.append(number(comparison.tolerance * tried[n], 2) if n in tried else "")
            rows.append({"cells": entries, "found": bool(row.fewest.count)})
            if row.fewest.note:
                notes.append(f"{row.method}: {row.fewest.note}")
        caption = (
            "Distance of the fit from the method's own estimate; up to the tolerance, the unknowns"
            " count as recovered."
        )
        if comparison.truth:
            caption = (
                "Error of the fit with this number of lines; up to the tolerance, the unknowns"
                " count as recovered; ∞: no result."
            )
        return {
            "rule": comparison.rule,
            "head": ["method", "unknowns", "fewest", *map(str, counts)],
            "caption": caption,
            "rows": rows,
            "notes": notes,
        }


class LimitsSection(ComparisonSection):
    """Limits and sources of the methods."""

    anchor = "limits"
    name = "Limits and sources"
    heading = "Limits and sources"
    place = 500
    template = "updyn.report/comparison_limits.html"

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the rows of the table."""
        rows = []
        for row in content.further["comparison"].comparison:
            remarks = []
            if reason(row):
                remarks.append(f"{row.status}: {reason(row)}")
            if row.applies and row.fixed:
                remarks.append(f"kept at their start: {', '.join(row.fixed)}")
            rows.append([row.method, _typeset(limits(row)), row.reference, "; ".join(remarks)])
        return {"rows": rows}


METHODS = MethodsSection()
FRFS = FrfsSection()
BARS = BarsSection()
FEWEST_LINES = FewestLinesSection()
LIMITS = LimitsSection()


# -- data ----------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """Measured and computed FRFs of one channel.

    `measured` and `fitted` (used by the fits) are over `lines`, `before` and `after` (by method,
    without methods that have no result) over `freq`, both in Hz. `misfit` is the median level
    difference of the start in dB. `test` is empty for a single test.
    """

    test: str
    response: str
    reference: str
    quantity: str
    lines: RealArray
    measured: ComplexArray
    fitted: BoolArray
    freq: RealArray
    before: ComplexArray
    after: Mapping[str, ComplexArray]
    misfit: float
    notes: tuple[str, ...]


def gather_curves(comparison: Comparison) -> Curves | None:
    """Return the FRFs of the channel with the largest start error; None if not computable."""
    notes: list[str] = []
    worst = _worst_channel(comparison, notes)
    if worst is None:
        return None
    misfit, test, i, j = worst
    options = _find_options(comparison, test)
    channel = test.frf.select(
        responses=test.frf.responses[np.array([i])],
        references=test.frf.references[np.array([j])],
        lines=test.frf.freq[test.frf.freq > 0],
    )
    results = {}
    for row in comparison:
        result = _find_test_result(row, test)
        if result is not None and row.status != "failed":
            results[row.method] = result
    few = _few_lines(channel.freq, test.model.n_dofs)
    models = [test.model, *(result.model for result in results.values())]
    models = [fix_base(model, channel) for model in models]
    reduced = options.get("tier") == "reduced"
    for freq in (fine_grid(models, few, reduced=reduced), few):
        failures: list[str] = []
        before = compute_frfs(test.model, channel, freq, "start model", failures, options)
        after = {}
        for name, result in results.items():
            what = f"model of {name}"
            values = compute_frfs(result.model, channel, freq, what, failures, result.options)
            if values is not None:
                after[name] = values[:, 0, 0]
        if not failures:  # else try the measured lines: a model may be singular at others
            break
    notes += failures
    if before is None:
        return None
    first = _find_first_result(comparison, test)
    fitted = np.ones(len(channel.freq), dtype=np.bool_)
    if first is not None:
        fitted = np.isin(channel.freq, first.lines)
    return Curves(
        test.name,
        channel.responses.labels[0],
        channel.references.labels[0],
        channel.quantity,
        channel.freq,
        channel.values[:, 0, 0],
        fitted,
        freq,
        before[:, 0, 0],
        after,
        misfit,
        tuple(dict.fromkeys(notes)),
    )


def _worst_channel(comparison: Comparison, notes: list[str]) -> tuple[float, Test, int, int] | None:
    """Return the largest median level difference of the start, in dB, with its test and channel."""
    worst: tuple[float, Test, int, int] | None = None
    for test in comparison.tests:
        frf = _thin_data(test)
        options = _find_options(comparison, test)
        start = compute_frfs(test.model, frf, frf.freq, "start model", notes, options)
        if start is None:
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            level = np.abs(20.0 * np.log10(np.abs(start) / np.abs(frf.values)))
        off = np.median(np.where(np.isfinite(level), level, 0.0), axis=0)
        i, j = map(int, np.unravel_index(int(np.argmax(off)), off.shape))
        if worst is None or off[i, j] > worst[0]:
            worst = float(off[i, j]), test, i, j
    return worst


def _thin_data(test: Test) -> FRF:
    """Return the data without 0 Hz, thinned to a number of lines that is affordable to compute."""
    frf = test.frf.select(lines=test.frf.freq[test.frf.freq > 0])
    affordable = REPORT_COMPUTATION.evaluation_budget // test.model.n_dofs
    limit = int(np.clip(affordable, REPORT_COMPUTATION.least_lines, 1000))
    keep = keep_lines(frf.values, np.ones(len(frf.freq), dtype=np.bool_), limit)
    return frf.select(lines=frf.freq[keep])


def _few_lines(lines: RealArray, n_dofs: int) -> RealArray:
    """Return measured lines for the curves, including both ends; fewer lines for a larger model."""
    affordable = REPORT_COMPUTATION.evaluation_budget // (4 * n_dofs)
    most = max(affordable, REPORT_COMPUTATION.least_lines)
    most = min(most, REPORT_COMPUTATION.comparison_lines)
    at = np.linspace(0, len(lines) - 1, min(most, len(lines))).round().astype(np.intp)
    return lines[np.unique(at)]


def is_geometric(lines: RealArray) -> bool:
    """Whether the lines are closer to geometric than to even spacing and span a decade or more."""
    if len(lines) < 3 or lines[-1] < 10.0 * lines[0]:
        return False
    return _unevenness(np.log(lines)) < _unevenness(lines)


def _unevenness(values: RealArray) -> float:
    """Return the standard deviation of the steps divided by their mean."""
    steps = np.diff(values)
    return float(np.std(steps) / np.mean(steps))


def _find_first_result(comparison: Comparison, test: Test) -> UpdateResult | None:
    for row in comparison:
        result = _find_test_result(row, test)
        if result is not None:
            return result
    return None


def _find_options(comparison: Comparison, test: Test) -> Mapping[str, object]:
    """Return the options with which the fits solved the model."""
    first = _find_first_result(comparison, test)
    if first is None:
        return {}
    return first.options


def _find_test_result(row: Row, test: Test) -> UpdateResult | None:
    if row.result is None:
        return None
    return row.result.results.get(test.name)


# -- figures -------------------------------------------------------------------------------------
def frf_figures(curves: Curves) -> dict[str, Figure]:
    """Return the FRF figures, by their name in the page."""
    out: dict[str, Figure] = {}
    pair = [name for name in PAIR if name in curves.after]
    if pair:
        out["pair"] = _overlay_figure(curves, pair)
    for k, name in enumerate(curves.after):
        out[panel_name(k)] = _panel_figure(curves, name)
    return out


def bar_figures(comparison: Comparison) -> dict[str, Figure]:
    """Return bar charts of error, misfit, time and work, by their name in the page."""
    errors, misfits, seconds, work = {}, {}, {}, {}
    for row in comparison:
        if not row.applies:
            continue
        seconds[row.method] = row.seconds
        work[row.method] = float(row.lines_solved)
        if row.status != "failed":
            errors[row.method] = row.error_max
            misfits[row.method] = _median_misfit(row)
    made = {}
    if comparison.truth:
        made["error"] = log_bars(errors, "largest error of an unknown", comparison.tolerance)
    made["misfit"] = log_bars(misfits, "median misfit (dB)")
    made["seconds"] = log_bars(seconds, "seconds")
    made["work"] = log_bars(work, "lines solved")
    return drop_missing(made)


def panel_name(number: int) -> str:
    """Return the name of the figure of one method's FRF."""
    return f"panel-{number}"


def _overlay_figure(curves: Curves, names: Sequence[str]) -> Figure:
    """Return one figure with the FRF measured, before, and after by some methods."""
    colours = (MODEL_COLOURS["updated"], *(f"@{role}" for role in OTHERS))
    traces = [_curve_trace(curves, curves.before, "before", MODEL_COLOURS["start"], "dot")]
    for name, colour, dash in zip(names, colours, ("solid", "dash", "dashdot"), strict=False):
        traces.append(_curve_trace(curves, curves.after[name], f"after, {name}", colour, dash))
    return _make_figure(curves, [_measured_trace(curves), *traces], _PAIR_HEIGHT)


def _panel_figure(curves: Curves, name: str) -> Figure:
    traces = [
        _curve_trace(curves, curves.before, "before", MODEL_COLOURS["start"], "dot"),
        _curve_trace(curves, curves.after[name], "after", MODEL_COLOURS["updated"], "solid"),
    ]
    return _make_figure(curves, [_measured_trace(curves), *traces], _PANEL_HEIGHT)


def _measured_trace(curves: Curves) -> dict[str, object]:
    """Return the trace of the measured FRF, as points if there are few lines."""
    trace: dict[str, object] = {
        "type": "scatter",
        "name": "measured",
        "x": encode_numbers(curves.lines),
        "y": encode_numbers(_magnitude(curves.measured)),
        "hovertemplate": "%{x:.5g} Hz: measured %{y:.4g}<extra></extra>",
        "mode": "lines",
        "line": {"color": "@measured", "width": 3},
    }
    if len(curves.lines) <= REPORT_COMPUTATION.comparison_points:
        del trace["line"]
        trace["mode"] = "markers"
        trace["marker"] = {"color": "@measured", "size": 7, "symbol": "circle-open"}
    return trace


def _curve_trace(
    curves: Curves, values: ComplexArray, name: str, colour: str, dash: str
) -> dict[str, object]:
    return {
        "type": "scatter",
        "mode": "lines",
        "name": escape_label(name),
        "x": encode_numbers(curves.freq),
        "y": encode_numbers(_magnitude(values)),
        "line": {"color": colour, "width": 1.8, "dash": dash},
        "hovertemplate": f"%{{x:.5g}} Hz: {escape_label(name)} %{{y:.4g}}<extra></extra>",
    }


def _magnitude(values: ComplexArray) -> RealArray:
    size = np.abs(values)
    return np.where(size > 0, size, np.nan)


def _make_figure(curves: Curves, traces: list[dict[str, object]], height: int) -> Figure:
    x = linear_frequency(curves.lines)
    if is_geometric(curves.lines):
        x = {"title": x["title"], "type": "log", "dtick": log_step(curves.lines)}
    both = np.concatenate(
        [
            _magnitude(curves.measured),
            _magnitude(curves.before),
            *map(_magnitude, curves.after.values()),
        ]
    )
    measured = f"|H| ({unit(curves.quantity, curves.response, curves.reference)})"
    return {
        "data": traces,
        "height": height,
        "layout": {
            "xaxis": x,
            "yaxis": {
                "title": {"text": measured},
                "type": "log",
                "dtick": _tick_step(log_step(both), height),
                "exponentformat": "power",
                "range": _axis_range(both),
            },
            "showlegend": True,
        },
    }


def _tick_step(step: int | str, height: int) -> int | str:
    """Return the tick step, doubled for a low figure."""
    if isinstance(step, int) and height < 300:
        return 2 * step
    return step


def _axis_range(values: RealArray) -> list[float]:
    """Return an axis range common to all FRFs, in decades."""
    levels = np.log10(values[np.isfinite(values)])
    if not levels.size:
        return [-1.08, 1.08]
    low, high = float(levels.min()), float(levels.max())
    pad = max(0.04 * (high - low), 0.05)
    return [low - pad, high + pad]
