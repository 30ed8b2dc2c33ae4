"""Outcomes of the commands before and besides a run, each in at most 25 lines.

`updyn.cli.outcome` makes that of a run. A table is cut to its first rows, and to the columns that
fit the width (None: unlimited); the details, with ``--verbose``, hold the rest.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from updyn.cli.describe import describe_identifiability
from updyn.cli.sections import (
    CheckResult,
    StartComparison,
    describe_fit,
    describe_test,
    format_counterparts,
    format_faults,
    format_next_step,
    list_announcements,
)
from updyn.cli.settings import LAYOUT
from updyn.correlation.figures import (
    LEADING_FIGURES,
    SHORT_NAMES,
    capitalized_name,
    figure_text,
)
from updyn.text_table import fit_columns, percent

if TYPE_CHECKING:
    from updyn.candidates.location.result import LocatedNonlinearities, NonlinearityLocation
    from updyn.candidates.result import ModelComparison
    from updyn.comparison import Comparison, Row
    from updyn.correlation.modes import ModeCorrelation
    from updyn.job.prepared import Prepared, PreparedTest
    from updyn.planning.result import Plan
    from updyn.updating.judge.identifiability import Identifiability

__all__ = [
    "brief_candidates",
    "brief_check",
    "brief_comparison",
    "brief_head",
    "brief_location",
    "brief_modes",
    "brief_plan",
    "brief_start",
    "cut_lines",
]

#: Columns that a narrow terminal leaves out, in this order.
_OF_RESPONSES = ("worst", "dB, 95 %", "correlation")
_OF_PAIRS = ("loss factor", "change (%)")
_OF_METHODS = (
    *("cannot update", "rms", "FRAC held out", "solved", "rank", "unknowns", "seconds"),
    *("steps", "FRAC", "min lines", "error"),
)


def cut_lines(text: str, most: int) -> str:
    """Return the first lines of a text, and the number of the others."""
    lines = text.splitlines()
    more = len(lines) - most
    if more < 2:  # a line about one line is no shorter
        return text
    return "\n".join([*lines[:most], f"... and {more} more lines (--verbose)"])


def _cut_rows(rows: Sequence[list[str]], most: int) -> tuple[list[list[str]], str]:
    """Return the first rows of a table, and a line on the number of the others."""
    more = len(rows) - most
    note = f"\n... and {more} more (--verbose)" if more > 0 else ""
    return list(rows[:most]), note


# -- check -----------------------------------------------------------------------------------------
def brief_check(checked: CheckResult) -> str:
    """Return what a job can determine, its agreement at the start, faults, and the next step."""
    ready = checked.ready
    lines = [brief_head(ready)]
    for test in ready.tests:
        lines += _brief_matching(test)
    if checked.selection is not None:
        lines.append(checked.selection.summary().splitlines()[0])
    lines += [cut_lines(text, LAYOUT.notes) for text in list_announcements(ready)]
    lines.append(_brief_identifiability(checked.found))
    for name, figures in checked.agreement.items():
        lines += _brief_agreement(name, figures)
    lines.append(format_counterparts(checked))
    lines.append(_brief_faults(format_faults(ready.tests, checked.faults)))
    lines.append(format_next_step(checked))
    lines.append(f"Next: updyn run {shlex.quote(str(ready.job.path))}")
    return "\n".join(filter(None, lines))


def _brief_identifiability(found: Identifiability) -> str:
    """Return the rank, the first undetermined combinations and the advice."""
    text = describe_identifiability(found).removesuffix(found.advice).rstrip()
    return "\n".join(filter(None, [cut_lines(text, 1 + LAYOUT.combinations), found.advice]))


def brief_head(ready: Prepared) -> str:
    """Return title and method of a job, and the measured and the fitted data of its tests."""
    job = ready.job
    lines = [f"{ready.title}: {job.method.name}"]
    for test in ready.tests:
        data, _, _ = describe_test(test).partition(";")
        lines += [f"{test.name}: {data}".removeprefix(": "), describe_fit(test)]
    return "\n".join(lines)


def _brief_matching(test: PreparedTest) -> list[str]:
    """Return alignment, distances and notes on the sensors of a test, without their table."""
    text, _, _ = str(test.matching).partition("\nsensor  ")
    lines = [cut_lines(f"{test.name}: {text}".removeprefix(": "), LAYOUT.outcome_rows)]
    remarks = [f"{one.sensor}: {one.note}" for one in test.matching.table if one.note]
    if remarks:
        more = f"; and {len(remarks) - 1} more (--verbose)" if len(remarks) > 1 else ""
        lines.append(f"{remarks[0]}{more}")
    return lines


def _brief_agreement(test: str, figures: Mapping[str, float]) -> list[str]:
    """Return the leading figure of agreement of a test at the start."""
    for name in LEADING_FIGURES:
        if name in figures:
            text = f"{capitalized_name(name)}: {figure_text(name, figures[name])} at the start"
            return [f"{test}: {text}".removeprefix(": ")]
    return []


def _brief_faults(text: str) -> str:
    return cut_lines(text, 1 + LAYOUT.outcome_rows)


# -- correlate -------------------------------------------------------------------------------------
def brief_start(compared: StartComparison, width: int | None) -> str:
    """Return agreement of a test at the start, its worst responses, modes and faults."""
    tests = [test for test in compared.ready.tests if test.name == compared.test]
    faults = _brief_faults(format_faults(tests, compared.faults))
    blocks = [
        "\n".join(_brief_agreement(compared.test, compared.figures)),
        _worst_responses(compared, width),
        f"{brief_modes(compared.modes, LAYOUT.outcome_rows, width)}\n{faults}",
    ]
    return "\n\n".join(filter(None, blocks))


def brief_modes(found: ModeCorrelation | str, most: int, width: int | None) -> str:
    """Return the first rows of the table of modes at the start, or why it is missing."""
    from updyn.job.modes import MODES_HEADING

    if isinstance(found, str):
        return found
    header, rows = found.rows()
    shown, note = _cut_rows(rows, most)
    return f"{MODES_HEADING}\n{fit_columns(header, shown, width, _OF_PAIRS)}{note}"


def _worst_responses(compared: StartComparison, width: int | None) -> str:
    """Return a table of the responses with the largest residuals."""
    by_response = compared.found.by_response()
    names = [name for name in SHORT_NAMES if name in next(iter(by_response.values()))]
    ordered = sorted(by_response.items(), key=lambda item: -item[1]["residual_median"])
    rows = []
    for label, values in ordered:
        rows.append([label, *(figure_text(name, values[name]) for name in names)])
    shown, note = _cut_rows(rows, LAYOUT.outcome_rows)
    header = ("response", *(SHORT_NAMES[name] for name in names))
    return fit_columns(header, shown, width, _OF_RESPONSES) + note


# -- compare ---------------------------------------------------------------------------------------
def brief_comparison(found: Comparison, width: int | None) -> str:
    """Return a row for each method, and the method with the smallest misfit."""
    from updyn.comparison.table import cells, columns, reason

    shown = columns(found)
    rows, note = _cut_rows([cells(row, shown) for row in found], LAYOUT.table_rows)
    header = [heading for _, heading, _ in shown]
    lines = [
        found.summary().splitlines()[0],
        "",
        fit_columns(header, rows, width, _OF_METHODS, left=("status", "cannot update")) + note,
        "",
    ]
    if any(reason(row) for row in found):
        lines.append(
            "The page and --verbose give the reasons of methods that do not apply or fail."
        )
    lines += _name_best(found)
    if found.stopped:
        lines.append(found.summary().splitlines()[-1])
    return "\n".join(lines)


def _name_best(found: Comparison) -> list[str]:
    """Return the method with the smallest misfit, of held-out data if there are any."""
    from updyn.comparison.table import COLUMNS

    is_held_out = any(row.held_out for row in found)
    misfits = {}
    for row in found:
        if row.status != "failed" and (misfit := _misfit_of(row, is_held_out)) is not None:
            misfits[row.method] = misfit
    if not misfits:
        return []
    best = min(misfits, key=lambda method: misfits[method])
    data = "the held-out data" if is_held_out else "the data of the fit"
    (content,) = (text for key, _, text in COLUMNS if key == ("held_db" if is_held_out else "db"))
    return [f"Smallest misfit to {data}: {best}, {content(found[best])}"]


def _misfit_of(row: Row, is_held_out: bool) -> float | None:
    figures = row.held_out if is_held_out else row.fitted
    value = (figures.get("after") or {}).get("db_error_median", math.nan)
    return None if math.isnan(value) else value


# -- candidates ------------------------------------------------------------------------------------
def brief_candidates(found: ModelComparison, width: int | None) -> str:
    """Return the outcome, and a row for each candidate model."""
    from updyn.candidates.result import HEADINGS

    rows, note = _cut_rows(found.cells(), LAYOUT.table_rows)
    dropped = ("unknowns", "status", "residual")
    table = fit_columns(HEADINGS, rows, width, dropped, left=("status",)) + note
    return f"{found.statement}\n\n{table}"


def brief_location(found: NonlinearityLocation | LocatedNonlinearities, width: int | None) -> str:
    """Return the outcome, and a row for each candidate of place and kind, or each element."""
    from updyn.candidates.location.result import (
        FOUND_HEADINGS,
        HEADINGS,
        LocatedNonlinearities,
    )

    several = isinstance(found, LocatedNonlinearities)
    headings = FOUND_HEADINGS if several else HEADINGS
    rows, note = _cut_rows(found.cells(), LAYOUT.table_rows)
    left = ("place", "kind", "parameters")
    table = fit_columns(headings, rows, width, ("unknowns", "parameters"), left=left) + note
    return f"{found.statement}\n\n{table}"


# -- plan ------------------------------------------------------------------------------------------
def brief_plan(made: Plan, width: int | None) -> str:
    """Return the layout, the least determined unknowns, and what more sensors would gain."""
    ordered = sorted(made.parameters, key=lambda p: -made.std[p.name])
    rows = [[p.name, f"{p.start:.4g}", f"{made.std[p.name]:.3g}"] for p in ordered]
    shown, note = _cut_rows(rows, LAYOUT.outcome_rows)
    lines = [
        made.summary().splitlines()[0],
        f"Sensors: {', '.join(made.responses)}",
        f"Forces: {', '.join(made.references)}",
        "",
        fit_columns(["unknown", "start", "expected std"], shown, width, ("start",)) + note,
        "",
    ]
    for kind, further in (("sensor", made.further), ("force", made.further_references)):
        if further:
            best = further[0]
            gain = f"standard deviations {percent(best.gain)} smaller"
            lines.append(f"One more {kind}, {best.label}: {gain}")
    return "\n".join(lines)
