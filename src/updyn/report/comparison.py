"""`write_comparison`: every method side by side, as one self-contained HTML page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from updyn import __version__
from updyn.comparison import Comparison, Row
from updyn.comparison.table import cells, columns, limits
from updyn.report import markup as m
from updyn.report import words as w
from updyn.report.comparison_data import Curves, gather_curves
from updyn.report.comparison_figures import PAIR, bar_figures, frf_figures, panel_name
from updyn.report.page import assemble
from updyn.report.plots import Figure
from updyn.report.section import Content, Section

__all__ = ["write_comparison"]

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
    return m.write_page(render(comparison), path)


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
    for number, name in enumerate(curves.after):
        misfit = (comparison[name].fitted.get("after") or {}).get("db_error_median", math.nan)
        caption = f"{comparison[name].status}; misfit over all channels {_decibels(misfit)}"
        place = m.figure(
            panel_name(number), f"FRF measured, before and after by {name}", caption, height=290
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
