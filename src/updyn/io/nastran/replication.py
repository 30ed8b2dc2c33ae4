"""Replicators of bulk data: lines that copy the preceding line, with increments.

``=`` copies a field, ``==`` all following fields, ``*x`` and ``*(x)`` add x; ``=n`` and ``=(n)``
alone on a line repeat the preceding copy n times (MSC Nastran Quick Reference Guide, "Bulk Data
Entries", replication). ``%`` and copies of cards of several lines are not supported.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from updyn.io.nastran.fields import NastranRow, format_field, parse_nastran_real
from updyn.io.settings import DECK
from updyn.io.text_numbers import parse_integer

__all__ = ["expand", "is_replicator"]

_COUNT = re.compile(r"=\s*(?:\((\d{1,9})\)|(\d{1,9}))")
_STEP = re.compile(r"\*\s*(?:\(([^()]+)\)|([^()]+))")
_WHOLE = re.compile(r"[+-]?\d+")


def is_replicator(text: str) -> bool:
    """Return whether a line copies the preceding line."""
    return text.lstrip().startswith("=")


def expand(rows: Iterable[NastranRow]) -> Iterator[NastranRow]:
    """Yield rows of bulk data, with copies in place of the replicators."""
    last: NastranRow | None = None  # the row to copy
    steps: dict[int, str] = {}
    copies = 0
    for row in rows:
        if not row.head.startswith("="):
            last, steps = row, {}
            yield row
            continue
        if last is None or last.continues or last.tail:
            raise row.line.error(
                f"{row.head!r} copies the preceding line; expected a card of one line there,"
                " without a continuation"
            )
        if row.head == "=":
            last, steps = _copy_row(last, row)
            count, images = 1, iter([last])
        else:
            count = _count(row, steps)
            images = _images(last, steps, count, row)
        copies += count
        if copies > DECK.copies:
            raise row.line.error(f"more than {DECK.copies} copies in a deck; expected fewer")
        for last in images:
            yield last


def _count(row: NastranRow, steps: dict[int, str]) -> int:
    found = _COUNT.fullmatch(row.head)
    if found is None or any(row.fields) or row.tail:
        raise row.line.error(
            f"{row.line.text.strip()[:40]!r}; expected = (a copy of the preceding line), or only"
            " =(n)"
        )
    if not steps:
        raise row.line.error(
            f"{row.head!r} repeats a copy with increments; expected such a copy before it, for"
            " instance =,*(1),=="
        )
    return int(found[1] or found[2])


def _copy_row(last: NastranRow, row: NastranRow) -> tuple[NastranRow, dict[int, str]]:
    """Return the copy that a row defines, and the increments of its fields."""
    if len(row.fields) != len(last.fields):
        raise row.line.error(
            "the fields of a copy need the width of the preceding line; write a full card instead"
        )
    fields = list(last.fields)
    steps: dict[int, str] = {}
    for at, cell in enumerate(row.fields):
        if cell == "==":
            if any(row.fields[at + 1 :]):
                raise row.line.error("== copies all following fields; expected no field after it")
            break
        step = _STEP.fullmatch(cell)
        if step is not None:
            steps[at] = (step[1] or step[2]).strip()
            fields[at] = _increment(last.fields, at, steps[at], 1, row)
        elif cell.startswith(("=", "%", "*")) and cell != "=":
            raise row.line.error(f"field {at + 2} is {cell!r}; expected =, ==, *(x) or a value")
        elif not cell and fields[at]:
            raise row.line.error(
                f"field {at + 2} is blank, but {fields[at]!r} in the preceding line; expected = for"
                " a copy, or == to copy all following fields"
            )
        elif cell != "=":
            fields[at] = cell
    return replace(last, line=row.line, fields=tuple(fields)), steps


def _images(
    last: NastranRow, steps: dict[int, str], count: int, row: NastranRow
) -> Iterator[NastranRow]:
    """Yield copies of a row, each with the increments added to the previous one."""
    for k in range(1, count + 1):
        fields = list(last.fields)
        for at, step in steps.items():
            fields[at] = _increment(last.fields, at, step, k, row)
        yield replace(last, line=row.line, fields=tuple(fields))


def _increment(fields: Sequence[str], at: int, step: str, times: int, row: NastranRow) -> str:
    """Return a field plus `times` increments; both integers, or both with a decimal point."""
    cell = fields[at]
    n_whole = sum(_WHOLE.fullmatch(text) is not None for text in (cell, step))
    try:
        if n_whole == 2:
            return str(parse_integer(cell) + times * parse_integer(step))
        if n_whole == 0:
            return format_field(parse_nastran_real(cell) + times * parse_nastran_real(step))
    except ValueError:
        pass
    raise row.line.error(
        f"field {at + 2}: {cell!r} plus {step!r}; expected two integers, or two numbers with a"
        " decimal point"
    )
