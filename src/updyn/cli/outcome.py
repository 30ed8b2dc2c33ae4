"""The outcome of a run: verdict, agreement, largest changes and next step in few lines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from updyn.cli.layout import fit_text
from updyn.cli.settings import LAYOUT
from updyn.correlation.figures import LEADING_FIGURES, capitalized_name, figure_text
from updyn.text_table import fit_columns

if TYPE_CHECKING:
    from updyn.updating.problem.parameters import Parameter
    from updyn.updating.result import JointResult, UpdateResult

__all__ = ["describe_agreement", "describe_outcome", "list_largest_changes"]

#: Columns of the table of changes, in the order in which they are left out of a narrow terminal.
_DROPPED = ("start", "value", "95 % interval")


def describe_outcome(
    result: UpdateResult | JointResult, closing: Sequence[str], width: int | None
) -> str:
    """Return verdict, agreement, largest changes, next step and closing lines of a run as text.

    The numbers of rows of the table and of reasons of the verdict are the largest with which the
    text has at most `LAYOUT.outcome_lines` lines of `width` columns (None: unlimited).
    """
    most = LAYOUT.outcome_rows
    sizes = [(rows, most) for rows in range(most, 0, -1)]
    sizes += [(1, reasons) for reasons in range(most - 1, -1, -1)]
    for rows, reasons in sizes:
        blocks = (
            "\n".join([*_describe_verdict(result, reasons), *describe_agreement(result)]),
            _format_changes(result, rows, width),
            "\n".join([*_format_next_step(result), *closing]),
        )
        text = "\n\n".join(filter(None, blocks))
        shown = text if width is None else fit_text(text, width)
        if len(shown.splitlines()) <= LAYOUT.outcome_lines:
            break
    return text


def _describe_verdict(result: UpdateResult | JointResult, most: int) -> list[str]:
    """Return the verdict, its parts in a line, and the first reasons of those not known to hold."""
    from updyn.updating.result import describe_ending

    lines = [describe_ending(result)]
    if result.trust is None:
        return [*lines, result.first.message]
    parts = [f"{name} {claim.answer}" for name, claim in result.trust.items()]
    lines.append(f"  {', '.join(parts)}")
    reasons = []
    for name, claim in result.trust.items():
        if claim.asked and claim.holds is not True:
            reasons.append(f"  {name}: {claim.statement}")
    return [*lines, *reasons[:most]]


def _format_next_step(result: UpdateResult | JointResult) -> list[str]:
    """Return advice and the lines to paste, which are indented."""
    from updyn.updating.next_step import choose_next_step

    step = choose_next_step(result)
    place = f", {step.place}" if step.place else ""
    lines = [f"What to do next{place}: {step.advice}".removesuffix(": ")]
    lines += [f"  {line}" for line in step.lines]
    return [*lines, step.remark] if step.remark else lines


def describe_agreement(result: UpdateResult | JointResult) -> list[str]:
    """Return the leading figure of agreement before and after as a line; empty if none is known."""
    from updyn.comparison.table import figures_of

    fitted, held_out = figures_of(result)
    for name in LEADING_FIGURES:
        texts = []
        for prefix, figures in (("", fitted), ("held out: ", held_out)):
            values = [figures.get(when, {}).get(name) for when in ("before", "after")]
            if None not in values:
                before, after = (_format_figure(name, v) for v in values if v is not None)
                texts.append(f"{prefix}{before} at the start, {after} updated")
        if texts:
            return [f"{capitalized_name(name)}: {'; '.join(texts)}"]
    return []


def _format_figure(name: str, value: float) -> str:
    """Return a figure of agreement as text; rounding of an exact fit as a limit."""
    least = LAYOUT.least_level
    return f"<{least:g}" if name.startswith("db_") and value < least else figure_text(name, value)


def list_largest_changes(result: UpdateResult | JointResult, most: int) -> list[Parameter]:
    """Return the unknowns that changed most: from zero, then relative to their start.

    Changes that are not significant come last.
    """
    from updyn.report.changes import is_significant, order_by_change

    first = result.first
    grown = [p for p in first.parameters if p.start == 0.0 and is_significant(first, p)]
    return [*grown, *order_by_change(first)][:most]


def _format_changes(result: UpdateResult | JointResult, most: int, width: int | None) -> str:
    """Return a table of the largest changes with their intervals."""
    from updyn.report.formats import change, number

    first = result.first
    intervals = result.intervals()
    rows = []
    for p in list_largest_changes(result, most):
        value = first.values[p.name]
        low, high = intervals.get(p.name, (math.nan, math.nan))
        span = f"{number(low)} to {number(high)}" if math.isfinite(low) else "-"
        start = number(p.start)
        cells = [p.name, start, number(value), change(p, value), span, _describe_doubt(first, p)]
        rows.append([cell.replace("\N{MINUS SIGN}", "-") for cell in cells])
    if not rows:
        return ""
    header = ["unknown", "start", "value", "change", "95 % interval", "note"]
    if not any(row[-1] for row in rows):
        header, rows = header[:-1], [row[:-1] for row in rows]
    more = len(first.parameters) - len(rows)
    table = fit_columns(header, rows, width, _DROPPED, left=("note",))
    return table + (f"\n... and {more} that changed less (--verbose)" if more > 0 else "")


def _describe_doubt(result: UpdateResult, p: Parameter) -> str:
    """Return unit of a value and why it is doubtful: a bound, missing information; may be empty."""
    from updyn.report.changes import is_significant

    notes = [f"in {p.value_unit}"] if p.value_unit else []
    if not math.isfinite(result.std[p.name]):
        notes.append(result.why_open(p.name))
    elif p.name in result.at_bound:
        notes.append(f"at its {result.at_bound[p.name]} bound")
    elif not is_significant(result, p):
        notes.append("not significant")
    return "; ".join(notes)
