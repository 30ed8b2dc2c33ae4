"""`write_comparison`: every method side by side, as one self-contained HTML page."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn import __version__
from updyn.comparison import Comparison, Row
from updyn.comparison.table import cells, columns, limits
from updyn.frf import FRF
from updyn.report import formats as w
from updyn.report import markup as m
from updyn.report.data import EVALUATION_BUDGET, computed, keep_lines
from updyn.report.formats import number, unit
from updyn.report.page import assemble
from updyn.report.plots import Figure, existing, label, labels, log_step, numbers, rows_height
from updyn.report.section import Content, Section
from updyn.report.templates import write_page
from updyn.updating.problem.data import Test
from updyn.updating.result import UpdateResult

__all__ = [
    "PAIR",
    "Curves",
    "bar_figures",
    "frf_figures",
    "gather_curves",
    "is_geometric",
    "panel_name",
    "write_comparison",
]

_WORDS = frozenset(("method", "status"))


def write_comparison(comparison: Comparison, path: str | PathLike[str]) -> Path:
    """Write a comparison of methods as one HTML page that needs nothing else: no network, no other file.

    The page shows the table of the methods, the FRF of the channel in which the start is furthest
    off, measured, before, and after by each method, bars of error, misfit, time and work, why
    methods do not apply, and how the fewest lines were sought. The models' FRFs are computed for
    it.

    Parameters
    ----------
    comparison : Comparison
        What `updyn.compare` gave.
    path : str or path-like
        Where to write; an existing file is replaced only once the new page is complete.

    Returns
    -------
    Path
        Where the page is.
    """
    return write_page(render(comparison), path)


def render(comparison: Comparison) -> str:
    """Return the page as text."""
    content = Content(further={"comparison": Compared(comparison, gather_curves(comparison))})
    title = comparison.title or "Comparison of methods"
    return assemble(content, _head(comparison), title, __version__)


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """A comparison with the FRFs that its page draws.

    Attributes
    ----------
    comparison : Comparison
        What `updyn.compare` gave.
    curves : Curves or None
        The FRFs; None where no model could be computed.
    """

    comparison: Comparison
    curves: Curves | None


class ComparisonSection(Section):
    """A section of the page of a comparison."""

    def applies(self, content: Content) -> bool:
        """Whether the page is that of a comparison, not of an update."""
        return content.update is None


class Methods(ComparisonSection):
    """The table of the methods."""

    anchor = "table"
    name = "Methods"
    heading = "Methods"
    place = 100

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return words and table."""
        return _methods(content.further["comparison"].comparison)


class Curve(ComparisonSection):
    """FRFs of one channel, measured, before, and after by each method."""

    anchor = "frfs"
    name = "FRFs"
    heading = "FRFs before and after"
    place = 200

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return the FRFs by method."""
        curves = content.further["comparison"].curves
        return {} if curves is None else frf_figures(curves)

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return words and places of figures; empty where no model could be computed."""
        shown: Compared = content.further["comparison"]
        return _frfs(shown.comparison, shown.curves, figures)


class Bars(ComparisonSection):
    """Error, misfit, time and work by method."""

    anchor = "bars"
    name = "Error, time and work"
    heading = "Error, time and work"
    place = 300

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return the bars."""
        return bar_figures(content.further["comparison"].comparison)

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return places of figures; empty where there is none."""
        return _bars(content.further["comparison"].comparison, figures)


class FewestLines(ComparisonSection):
    """The fewest lines with which each method recovers the unknowns."""

    anchor = "lines"
    name = "Fewest lines"
    heading = "Fewest lines"
    place = 400

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return rule and table; empty where the fewest lines were not sought."""
        return _lines(content.further["comparison"].comparison)


class Limits(ComparisonSection):
    """Limits and sources of the methods."""

    anchor = "limits"
    name = "Limits and sources"
    heading = "Limits and sources"
    place = 500

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return the table."""
        return _limits(content.further["comparison"].comparison)


METHODS = Methods()
FRFS = Curve()
BARS = Bars()
FEWEST_LINES = FewestLines()
LIMITS = Limits()


# -- head --------------------------------------------------------------------------------------------------
def _head(comparison: Comparison) -> str:
    first = comparison.tests[0].frf
    tests = (
        f", {len(comparison.tests)} tests" if len(comparison.tests) > 1 else f"; {w.extent(first)}"
    )
    about = (
        f"{w.counted(len(comparison), 'method')},"
        f" {w.counted(len(comparison.parameters), 'unknown')}{tests}"
    )
    run = [row for row in comparison if row.applies]
    stopped = ""
    if comparison.stopped:
        rest = f" Not run: {', '.join(comparison.not_run)}." if comparison.not_run else ""
        stopped = f"The user stopped the comparison; it holds what had been run.{rest}"
    return (
        f"<header><h1>{m.esc(comparison.title or 'Comparison of methods')}</h1>{m.paragraph(about, 'byline')}"
        f'<section aria-label="Verdict">{m.paragraph(_verdict(comparison, run), "lead")}'
        f"{m.note(stopped)}{_tiles(comparison, run)}</section></header>"
    )


def _verdict(comparison: Comparison, run: Sequence[Row]) -> str:
    said = f"{len(run)} of {w.counted(len(comparison), 'method')} can be used on these data."
    if comparison.truth:
        near = [row.method for row in run if row.error_max <= comparison.tolerance]
        within = f"{100 * comparison.tolerance:g} %"
        said += (
            f" Every unknown comes out within {within} of the truth by {_listed(near)}."
            if near
            else f" None finds every unknown within {within} of the truth."
        )
    else:
        settled = [row.method for row in run if row.status == "converged"]
        said += (
            f" {_listed(settled)} converged with all unknowns determined."
            if settled
            else " None converged with all unknowns determined."
        )
    return said


def _tiles(comparison: Comparison, run: Sequence[Row]) -> str:
    answered = [row for row in run if row.status != "failed"]
    tiles: list[tuple[str, str, str]] = []
    start = comparison.before.get("db_error_median", math.nan)
    tiles.append(("Misfit before", _decibels(start), "median level difference of the start"))
    misfits = {
        row.method: (row.fitted.get("after") or {}).get("db_error_median", math.nan)
        for row in answered
    }
    tiles += _best("Least misfit after", misfits, _decibels)
    if comparison.truth:
        tiles += _best(
            "Least error", {row.method: row.error_max for row in answered}, lambda v: w.number(v, 2)
        )
    enough = {
        row.method: float(row.fewest.count)
        for row in run
        if row.fewest is not None and row.fewest.count
    }
    tiles += _best("Fewest lines", enough, lambda v: f"{v:.0f}")
    found = "".join(
        f"<div><dt>{m.esc(name)}</dt><dd>{m.esc(value)}<small>{m.esc(hint)}</small></dd></div>"
        for name, value, hint in tiles
    )
    return f'<dl class="tiles">{found}</dl>'


def _best(name: str, values: Mapping[str, float], say: object) -> list[tuple[str, str, str]]:
    known = {method: v for method, v in values.items() if math.isfinite(v)}
    if not known:
        return []
    assert callable(say)
    least = min(known.values())
    # Beyond rounding there is no better or worse.
    alike = [method for method, v in known.items() if v <= max(least * (1.0 + 1e-9), 1e-9)]
    return [(name, say(least), _listed(alike))]


def _decibels(value: float) -> str:
    """Return a level difference; what is rounding is 0."""
    return "0 dB" if value < 1e-9 else w.decibels(value)


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:-1]) + f" and {names[-1]}" if len(names) > 1 else "".join(names)


# -- sections ------------------------------------------------------------------------------------------------
def _methods(comparison: Comparison) -> str:
    shown = [column for column in columns(comparison) if column[0] != "limits"]
    kinds = ["text" if key in _WORDS else "" for key, _, _ in shown]
    rows = [
        m.row(cells(row, shown), kinds, "" if row.status == "converged" else "open")
        for row in comparison
    ]
    how = (
        "All methods were given the same model, data, lines and unknowns. Misfit: median level"
        " difference between model and data of the fit; FRAC: median over channels, 1 is the same"
        " shape. Rank: combinations of its unknowns that a method finds the data to determine."
        " Steps, and lines solved, count the work of the fit, its search for a start included."
    )
    truth = (
        "Error: estimate / truth − 1, for loss factors estimate − truth; unknowns left at their"
        " start count with it."
        if comparison.truth
        else ""
    )
    head = [heading for _, heading, _ in shown]
    return (
        m.paragraph(how) + (m.paragraph(truth) if truth else "") + m.table(head, rows, kinds=kinds)
    )


def _frfs(comparison: Comparison, curves: Curves | None, figures: Mapping[str, Figure]) -> str:
    if curves is None:
        return ""
    channel = f"Response at {curves.response}, force at {curves.reference}"
    channel += f", {curves.test}" if curves.test else ""
    why = (
        f"{channel}: the channel in which the start is furthest off, {_decibels(curves.misfit)} in"
        " the median."
    )
    parts = [
        m.paragraph(why),
        m.note(*curves.notes),
    ]
    if "pair" in figures:
        missing = [
            row.method
            for row in comparison
            if row.method in PAIR and row.method not in curves.after
        ]
        caption = (
            "The condensed equation error of Bao, Wang & Cheng (equation-error) and the method with"
            " independently reduced matrices that they compare it with (reduced-frf)."
        )
        caption += "".join(
            f" {name} gave no answer: {comparison[name].message}" for name in missing
        )
        place = m.figure(
            "pair", "FRF measured, before and after by two methods", caption, height=440
        )
        parts.append(f"<h3>The paper's comparison</h3>{place}")
    places = []
    for k, name in enumerate(curves.after):
        misfit = (comparison[name].fitted.get("after") or {}).get("db_error_median", math.nan)
        caption = f"{comparison[name].status}; misfit over all channels {_decibels(misfit)}"
        place = m.figure(
            panel_name(k), f"FRF measured, before and after by {name}", caption, height=290
        )
        places.append(f"<div><h3>{m.esc(name)}</h3>{place}</div>")
    if places:
        parts.append(f'<h3>Method by method</h3><div class="pair wide">{"".join(places)}</div>')
    silent = [row for row in comparison if row.applies and row.method not in curves.after]
    parts += [m.paragraph(f"{row.method} gave no answer: {row.message}", "muted") for row in silent]
    return "".join(parts)


def _bars(comparison: Comparison, figures: Mapping[str, Figure]) -> str:
    mark = f"; dashed: {comparison.tolerance:g}" if comparison.truth else ""
    about = (
        ("error", "Error", f"Largest error of an unknown{mark}."),
        ("misfit", "Misfit", "Median level difference after the update."),
        ("seconds", "Time", "From start to judgement, on one machine at one time."),
        ("work", "Work", "Lines at which the model was solved."),
    )
    places = [
        f"<div><h3>{heading}</h3>{m.figure(name, f'{heading} by method', said, height=figures[name]['height'])}</div>"
        for name, heading, said in about
        if name in figures
    ]
    if not places:
        return ""
    return f'<div class="pair wide">{"".join(places)}</div>'


def _lines(comparison: Comparison) -> str:
    sought = [row for row in comparison if row.fewest is not None]
    if not sought:
        return ""
    numbers = sorted({count for row in sought if row.fewest for count, _ in row.fewest.tried})
    rows = []
    for row in sought:
        assert row.fewest is not None
        tried = dict(row.fewest.tried)
        said = [w.number(comparison.tolerance * tried[n], 2) if n in tried else "" for n in numbers]
        found = "none" if row.fewest.count is None else str(row.fewest.count)
        rows.append(
            m.row(
                [row.method, str(len(row.updated)), found, *said],
                kind="" if row.fewest.count else "open",
            )
        )
    notes = [
        f"{row.method}: {row.fewest.note}"
        for row in sought
        if row.fewest is not None and row.fewest.note
    ]
    caption = (
        "How far the fit was off with so many lines, as what counts as recovered is; ∞: no answer."
        if comparison.truth
        else (
            "How far the fit was from the method's own answer, in units in which the tolerance"
            " stands for recovered."
        )
    )
    return (
        m.paragraph(comparison.rule)
        + m.table(
            ["method", "unknowns", "fewest", *(f"{n}" for n in numbers)], rows, caption=caption
        )
        + "".join(m.paragraph(text, "muted") for text in notes)
    )


def _limits(comparison: Comparison) -> str:
    rows = []
    for row in comparison:
        said = (
            row.message
            if not row.applies
            else f"left at their start: {', '.join(row.left)}"
            if row.left
            else ""
        )
        rows.append(
            m.row([row.method, limits(row), row.reference, said], ("", "text", "text", "note-cell"))
        )
    head = ["method", "cannot update", "reference", "here"]
    return m.table(head, rows, kinds=("", "text", "text", "note-cell"))


#: Points of a curve where the model is small enough for them.
_POINTS = 600
_FEWEST_POINTS = 100


@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """One channel.

    Attributes
    ----------
    test, response, reference, quantity : str
        Which; the test has a name where there are several.
    lines : ndarray of float, shape (n_f,)
        Lines of the data, in Hz.
    measured : ndarray of complex, shape (n_f,)
        The data there.
    fitted : ndarray of bool, shape (n_f,)
        Which of these lines were used in the fits.
    freq : ndarray of float, shape (n,)
        Where the models were computed, in Hz.
    before : ndarray of complex, shape (n,)
        The start.
    after : mapping of str to ndarray of complex, shape (n,)
        By method; those that gave no answer are not there.
    misfit : float
        Median level difference of the start in this channel, in dB: the largest of all channels.
    notes : tuple of str
        What was left out or thinned.
    """

    test: str
    response: str
    reference: str
    quantity: str
    lines: NDArray[np.float64]
    measured: NDArray[np.complex128]
    fitted: NDArray[np.bool_]
    freq: NDArray[np.float64]
    before: NDArray[np.complex128]
    after: Mapping[str, NDArray[np.complex128]]
    misfit: float
    notes: tuple[str, ...]


def gather_curves(comparison: Comparison) -> Curves | None:
    """Compute the channel in which the start is furthest off; None where no model could be computed."""
    notes: list[str] = []
    worst: tuple[float, Test, int, int] | None = None
    for test in comparison.tests:
        seen = _thinned(test)
        answer = computed(test.model, seen, seen.freq, "start model", notes, _how(comparison, test))
        if answer is None:
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            level = np.abs(20.0 * np.log10(np.abs(answer) / np.abs(seen.values)))
        off = np.median(np.where(np.isfinite(level), level, 0.0), axis=0)
        i, j = (int(k) for k in np.unravel_index(int(np.argmax(off)), off.shape))
        if worst is None or off[i, j] > worst[0]:
            worst = float(off[i, j]), test, i, j
    if worst is None:
        return None
    misfit, test, i, j = worst
    channel = test.frf.select(
        responses=test.frf.responses[np.array([i])], references=test.frf.references[np.array([j])]
    )
    channel = channel.select(lines=channel.freq[channel.freq > 0])
    freq = _grid(channel.freq, test.model.n_dofs)
    before = computed(test.model, channel, freq, "start model", notes, _how(comparison, test))
    if before is None:
        return None
    after = {}
    for row in comparison:
        result = _of_test(row, test)
        if result is None or row.status == "failed":
            continue
        values = computed(
            result.model, channel, freq, f"model of {row.method}", notes, result.options
        )
        if values is not None:
            after[row.method] = values[:, 0, 0]
    first = _first(comparison, test)
    used = (
        np.ones(len(channel.freq), dtype=np.bool_)
        if first is None
        else np.isin(channel.freq, first.lines)
    )
    return Curves(
        test.name,
        channel.responses.labels[0],
        channel.references.labels[0],
        channel.quantity,
        channel.freq,
        channel.values[:, 0, 0],
        used,
        freq,
        before[:, 0, 0],
        after,
        misfit,
        tuple(dict.fromkeys(notes)),
    )


def _thinned(test: Test) -> FRF:
    """Return the data at no more lines than are worth computing, 0 Hz left out."""
    frf = test.frf.select(lines=test.frf.freq[test.frf.freq > 0])
    limit = int(np.clip(EVALUATION_BUDGET // test.model.n_dofs, _FEWEST_POINTS, 1000))
    keep = keep_lines(frf.values, np.ones(len(frf.freq), dtype=np.bool_), limit)
    return frf.select(lines=frf.freq[keep])


def _grid(lines: NDArray[np.float64], n_dofs: int) -> NDArray[np.float64]:
    """Return where curves are computed: between the lines, too, where these are few and the model is small."""
    limit = int(np.clip(EVALUATION_BUDGET // n_dofs, _FEWEST_POINTS, 2 * _POINTS))
    if len(lines) > limit:
        at = np.linspace(0, len(lines) - 1, limit).round().astype(np.intp)
        return lines[np.unique(at)]
    if len(lines) < 2 or len(lines) + _POINTS > limit:
        return lines
    between = (np.geomspace if is_geometric(lines) else np.linspace)(lines[0], lines[-1], _POINTS)
    return np.union1d(lines, np.clip(between, lines[0], lines[-1]))


def is_geometric(lines: NDArray[np.float64]) -> bool:
    """Whether lines are spaced more evenly in the logarithm of frequency, over more than a decade."""
    if len(lines) < 3 or lines[-1] < 10.0 * lines[0]:
        return False
    spread = [
        float(np.std(step) / np.mean(step)) for step in (np.diff(lines), np.diff(np.log(lines)))
    ]
    return spread[1] < spread[0]


def _first(comparison: Comparison, test: Test) -> UpdateResult | None:
    return next((r for row in comparison if (r := _of_test(row, test)) is not None), None)


def _how(comparison: Comparison, test: Test) -> Mapping[str, Any]:
    """Return how the model was solved in the fits."""
    first = _first(comparison, test)
    return {} if first is None else first.options


def _of_test(row: Row, test: Test) -> UpdateResult | None:
    if row.result is None:
        return None
    return row.result.results.get(test.name)


#: The paper's method and the one that it compares with; shown together where both gave an answer.
PAIR = ("equation-error", "reduced-frf")
#: Measured lines up to this number are drawn as points: what lies between them was not measured.
_FEW = 150
#: Bars of what is exactly 0 end here.
_FLOOR = 1e-16


def frf_figures(curves: Curves) -> dict[str, Figure]:
    """Return the FRFs by method, by the name of their place in the page."""
    out: dict[str, Figure] = {}
    pair = [name for name in PAIR if name in curves.after]
    if pair:
        out["pair"] = _overlay(curves, pair)
    for k, name in enumerate(curves.after):
        out[panel_name(k)] = _panel(curves, name)
    return out


def bar_figures(comparison: Comparison) -> dict[str, Figure]:
    """Return bars of error, misfit, time and work, by the name of their place in the page."""
    run = [row for row in comparison if row.applies]
    answered = [row for row in run if row.status != "failed"]
    made: dict[str, Figure | None] = {}
    if comparison.truth:
        made["error"] = _bar_chart(
            answered, lambda r: r.error_max, "largest error of an unknown", comparison.tolerance
        )
    made["misfit"] = _bar_chart(
        answered,
        lambda r: (r.fitted.get("after") or {}).get("db_error_median", math.nan),
        "median misfit (dB)",
    )
    made["seconds"] = _bar_chart(run, lambda r: r.seconds, "seconds")
    made["work"] = _bar_chart(run, lambda r: float(r.lines_solved), "lines solved")
    return existing(made)


def panel_name(number: int) -> str:
    """Return the name of the place of one method's FRF."""
    return f"panel-{number}"


# -- FRFs --------------------------------------------------------------------------------------------------
def _overlay(curves: Curves, names: Sequence[str]) -> Figure:
    """Measured, before, and after by some methods, in one figure."""
    colours = ("@after", "@third", "@fourth")
    traces = [_curve(curves, curves.before, "before", "@before", "dot")]
    for name, colour, dash in zip(names, colours, ("solid", "dash", "dashdot"), strict=False):
        traces.append(_curve(curves, curves.after[name], f"after, {name}", colour, dash))
    return _frame(curves, [*_measured(curves), *traces], 440)


def _panel(curves: Curves, name: str) -> Figure:
    traces = [
        _curve(curves, curves.before, "before", "@before", "dot"),
        _curve(curves, curves.after[name], "after", "@after", "solid"),
    ]
    return _frame(curves, [*_measured(curves), *traces], 290)


def _measured(curves: Curves) -> list[dict[str, Any]]:
    few = len(curves.lines) <= _FEW
    style: dict[str, Any] = (
        {"mode": "markers", "marker": {"color": "@measured", "size": 7, "symbol": "circle-open"}}
        if few
        else {"mode": "lines", "line": {"color": "@measured", "width": 3}}
    )
    return [
        {
            "type": "scatter",
            "name": "measured",
            "x": numbers(curves.lines),
            "y": numbers(_size(curves.measured)),
            "hovertemplate": "%{x:.5g} Hz: measured %{y:.4g}<extra></extra>",
            **style,
        }
    ]


def _curve(
    curves: Curves, values: NDArray[np.complex128], name: str, colour: str, dash: str
) -> dict[str, Any]:
    return {
        "type": "scatter",
        "mode": "lines",
        "name": label(name),
        "x": numbers(curves.freq),
        "y": numbers(_size(values)),
        "line": {"color": colour, "width": 1.8, "dash": dash},
        "hovertemplate": f"%{{x:.5g}} Hz: {label(name)} %{{y:.4g}}<extra></extra>",
    }


def _size(values: NDArray[np.complex128]) -> NDArray[np.float64]:
    size = np.abs(values)
    return np.where(size > 0, size, np.nan)


def _frame(curves: Curves, traces: list[dict[str, Any]], height: int) -> Figure:
    x: dict[str, Any] = {"title": {"text": "frequency (Hz)"}}
    if is_geometric(curves.lines):
        x |= {"type": "log", "dtick": log_step(curves.lines)}
    both = np.concatenate(
        [_size(curves.measured), _size(curves.before), *map(_size, curves.after.values())]
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
                "dtick": _step(log_step(both), height),
                "exponentformat": "power",
                "range": _range(both),
            },
            "showlegend": True,
        },
    }


def _step(step: int | str, height: int) -> int | str:
    return 2 * step if isinstance(step, int) and height < 300 else step


def _range(values: NDArray[np.float64]) -> list[float]:
    """Return a common range of all FRFs, in decades."""
    seen = np.log10(values[np.isfinite(values)])
    low, high = (float(v) for v in (seen.min(), seen.max())) if seen.size else (-1.0, 1.0)
    pad = max(0.04 * (high - low), 0.05)
    return [low - pad, high + pad]


# -- bars ----------------------------------------------------------------------------------------------------
def _bar_chart(
    rows: Sequence[Row], value: Callable[[Row], float], title: str, mark: float | None = None
) -> Figure | None:
    """One bar a method on a log axis; a line at `mark`."""
    known = [(row.method, value(row)) for row in rows]
    known = [(name, v) for name, v in known if math.isfinite(v)]
    if not known:
        return None
    sizes = np.maximum([v for _, v in known], _FLOOR)
    whole = all(float(v).is_integer() for _, v in known)
    texts = [f"{v:.0f}" if whole else number(v, 2) for _, v in known]
    low, high = float(np.log10(sizes.min())), float(np.log10(sizes.max()))
    if mark is not None:
        low, high = min(low, math.log10(mark)), max(high, math.log10(mark))
    span = max(high - low, 1.0)
    view = [low - 0.12 * span, high + 0.22 * span]
    at = list(range(len(known)))
    trace = {
        "type": "bar",
        "orientation": "h",
        "x": sizes.tolist(),
        "y": at,
        "text": texts,
        "textposition": "outside",
        "cliponaxis": False,
        "marker": {"color": "@after"},
        "hovertext": [f"{label(name)}: {v:.4g}" for name, v in known],
        "hoverinfo": "text",
    }
    layout: dict[str, Any] = {
        "xaxis": {
            "title": {"text": title},
            "tickangle": 0,
            "type": "log",
            "range": view,
            "dtick": max(1, math.ceil(span / 6.0)) if span > 1.5 else "D2",
            "exponentformat": "power",
        },
        "yaxis": {
            "tickvals": at,
            "ticktext": labels(name for name, _ in known),
            "range": [len(known) - 0.4, -0.6],
            "zeroline": False,
            "showgrid": False,
        },
        "showlegend": False,
        "bargap": 0.35,
    }
    if mark is not None:
        layout["shapes"] = [_line(mark)]
    return {"data": [trace], "height": rows_height(len(known), extra=95), "layout": layout}


def _line(at: float) -> Mapping[str, Any]:
    return {
        "type": "line",
        "x0": at,
        "x1": at,
        "y0": 0,
        "y1": 1,
        "yref": "paper",
        "line": {"color": "@before", "dash": "dash", "width": 1.5},
    }
