"""Time records of LabVIEW measurement files (.lvm).

The layout is that of National Instruments, "Specification for the LabVIEW Measurement File (.lvm)":
a head of the file and one of each segment, both of lines ``name TAB value`` that end with
``***End_of_Header***``, the lines of a head in any order; then a line of names, ``X_Value`` first,
``Comment`` last; then rows, whose comments are left out, as are special blocks. A segment is a
record. Numbers have the decimal sign that the head names.

With ``Multi_Headings No`` only the first segment has a head, and the rows of the others follow.
Each segment is a record all the same, of as many rows as the head says, unless all times run on
without a gap: then they are one record.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from updyn.errors import FormatError, suggest
from updyn.io.items import existing, placed, utf8_text
from updyn.io.text_numbers import number_rows, real_of, whole_of
from updyn.signals.records import Records

__all__ = ["read_records"]

_T = TypeVar("_T")

_END = re.compile(r"(?m)^\*\*\*End_of_Header\*\*\*[^\n]*\n")
_SPECIAL = re.compile(
    r"(?ms)^\*\*\*Start_Special\*\*\*[^\n]*\n.*?^\*\*\*End_Special\*\*\*[^\n]*(?:\n|\Z)"
)
_TAG = re.compile(r"(?m)^[A-Za-z]")
_SEPARATORS = {"Tab": "\t", "Comma": ",", "Semicolon": ";"}
_X_COLUMNS = ("No", "One", "Multi")
_HEADINGS = ("Yes", "No")
#: What a time may be off by, as it is rounded in the file: a share of the step.
_ROUNDED = 0.5
#: What is read of the head of a record.
_ONCE = ("Channels", "Samples", "Delta_X", "X_Dimension", "Y_Unit_Label")
_NAMES_FROM, _NAMES_TO = "X_Value", "Comment"


def read_records(path: str | Path) -> Records:
    """Read time records.

    Parameters
    ----------
    path : path
        The file, in UTF-8.

    Returns
    -------
    Records
        One record a segment, in the units that the file names.

    Raises
    ------
    FormatError
        If the content is not valid, or its segments have other channels, lengths or steps than the
        first.
    """
    text = _without_special(utf8_text(existing(path)).replace("\r\n", "\n"))
    ends = list(_END.finditer(text))
    if not text.startswith("LabVIEW Measurement") or not ends:
        raise FormatError("no head of a LabVIEW measurement file", path, 1)
    head = _Head.of(text[: ends[0].start()], path)
    if len(ends) < 2:
        raise FormatError("a head without records", path)
    segments = list(_segments(text, ends, head, path))
    first = segments[0]
    for segment in segments[1:]:
        first.check_alike(segment, path)
    with placed(path):
        return Records.of(
            [segment.values for segment in segments],
            first.step,
            first.channels,
            first.units,
            Path(path).name,
        )


@dataclass(frozen=True, slots=True)
class _Head:
    """The head of the file: how its rows are written."""

    separator: str
    decimal: str
    x_columns: str
    has_headings: bool

    @classmethod
    def of(cls, text: str, path: str | Path) -> _Head:
        found: dict[str, str] = {}
        for number, line in enumerate(text.split("\n")[1:], 2):
            name, *value = _SPLIT.split(line, maxsplit=1)
            if line.strip() and not value:
                raise FormatError(
                    f"found {line.strip()[:40]!r}; expected a name and its value", path, number
                )
            if name in found:
                raise FormatError(f"{name} stands twice", path, number)
            if value:
                found[name] = value[0]
        named = found.get("Separator", "Tab").strip()
        decimal = found.get("Decimal_Separator", ".").strip()
        x_columns = found.get("X_Columns", "One").strip()
        if named not in _SEPARATORS:
            raise FormatError(f"Separator {named!r}; {suggest(named, _SEPARATORS)}", path)
        if decimal not in (".", ",") or decimal == _SEPARATORS[named]:
            raise FormatError(f"Decimal_Separator {decimal!r} with columns by {named}", path)
        if x_columns not in _X_COLUMNS:
            raise FormatError(f"X_Columns {x_columns!r}; {suggest(x_columns, _X_COLUMNS)}", path)
        headings = found.get("Multi_Headings", "Yes").strip()
        if headings not in _HEADINGS:
            raise FormatError(f"Multi_Headings {headings!r}; {suggest(headings, _HEADINGS)}", path)
        return cls(_SEPARATORS[named], decimal, x_columns, headings == "Yes")


#: The head of the file may be separated by something else than the file says for its rows.
_SPLIT = re.compile(r"[\t,;]")


@dataclass(frozen=True, slots=True)
class _Segment:
    """One record: samples by channel."""

    line: int
    step: float
    channels: tuple[str, ...]
    units: tuple[str, ...]
    values: NDArray[np.float64]

    def check_alike(self, other: _Segment, path: str | Path) -> None:
        """Refuse another segment whose channels differ from those of this one."""
        for what in ("channels", "units", "step"):
            mine, its = getattr(self, what), getattr(other, what)
            if mine != its:
                raise FormatError(
                    f"this record has {what} {its!r}, the first one {mine!r}; records of a file"
                    " have to be alike",
                    path,
                    other.line,
                )
        lengths = [segment.values.shape[1] for segment in (self, other)]
        if lengths[0] != lengths[1]:
            raise FormatError(
                f"this record has {lengths[1]} samples, the first one {lengths[0]}; records of a"
                " file have to be alike",
                path,
                other.line,
            )


def _segments(
    text: str, ends: list[re.Match[str]], head: _Head, path: str | Path
) -> Iterator[_Segment]:
    """Yield the records: from each head's beginning to the next one's."""
    begins = [ends[0].end()]
    for before, end in pairwise(ends[1:]):
        # The rows before hold numbers; the tags of a head begin with a letter, in any order.
        of_rows = text.index("\n", before.end()) + 1 if before.end() < len(text) else before.end()
        tag = _TAG.search(text, of_rows, end.start())
        begins.append(end.start() if tag is None else tag.start())
    for begin, end, stop in zip(begins, ends[1:], [*begins[1:], len(text)], strict=True):
        skipped = len(text[begin : end.start()]) - len(text[begin : end.start()].lstrip("\n"))
        begin += skipped
        lines = [text.count("\n", 0, place) + 1 for place in (begin, end.end())]
        fields = _fields(text[begin : end.start()], head.separator, path, lines[0])
        yield from _packets(fields, text[end.end() : stop], head, path, lines)


def _without_special(text: str) -> str:
    """Return a text without the special blocks, which other programs put in; lines stay."""
    return _SPECIAL.sub(lambda found: "\n" * found[0].count("\n"), text)


def _without_comments(rows: str, titles: list[str], width: int, separator: str) -> str:
    """Return rows without the column of comments, the last one."""
    if titles[-1:] != [_NAMES_TO]:
        return rows
    kept = [separator.join(row.split(separator)[:width]) for row in rows.split("\n")]
    return "\n".join(kept)


def _fields(text: str, separator: str, path: str | Path, first: int) -> Mapping[str, list[str]]:
    """Return the values of a segment's head, which begins at a line, by name."""
    found: dict[str, list[str]] = {}
    for number, line in enumerate(text.split("\n"), first):
        name, *values = [word.strip() for word in line.split(separator)]
        if name in found and name in _ONCE:
            raise FormatError(f"{name} stands twice", path, number)
        found[name] = values
    return found


def _packets(
    fields: Mapping[str, list[str]],
    body: str,
    head: _Head,
    path: str | Path,
    lines: Sequence[int],
) -> Iterator[_Segment]:
    """Yield the records of a head and its rows, which begin at these lines."""
    first, of_names = lines

    def refused(why: str, line: int = first) -> FormatError:
        return FormatError(why, path, line)

    def each(name: str, n: int, convert: Callable[[str], _T]) -> list[_T]:
        given = fields.get(name, [])[:n]
        if len(given) < n or not all(given):
            raise refused(
                f"{name} of this record: expected {n} values, found {sum(map(bool, given))}"
            )
        try:
            return [convert(value) for value in given]
        except ValueError as error:
            raise refused(f"{name} of this record: {error}") from error

    (n,) = each("Channels", 1, whole_of)
    samples = each("Samples", n, whole_of)
    steps = each("Delta_X", n, lambda text: real_of(text.replace(head.decimal, ".")))
    if fields.get("X_Dimension") and set(each("X_Dimension", n, str)) != {"Time"}:
        raise refused(f"X_Dimension {fields['X_Dimension'][0]!r}: no time record")
    if len(set(samples)) != 1 or len(set(steps)) != 1:
        raise refused("channels of one record with other Samples or Delta_X")
    names, _, rows = body.partition("\n")
    titles = [title.strip() for title in names.split(head.separator)]
    if titles[:1] != [_NAMES_FROM]:
        raise refused(f"expected a line of names from {_NAMES_FROM}", of_names)
    own = [title for title in titles if title and title not in (_NAMES_FROM, _NAMES_TO)]
    if len(own) != n:
        raise refused(f"{len(own)} names for {n} channels", of_names)
    with_x = {"No": 0, "One": 1, "Multi": n}[head.x_columns]
    # Without times there is a blank column in their place.
    rows = _without_comments(rows, titles, n + max(with_x, 1), head.separator)
    if head.decimal != "." and "." in rows:
        at = of_names + 1 + rows[: rows.index(".")].count("\n")
        raise refused(f"a point in numbers with the decimal sign {head.decimal!r}", at)
    blanks = rows.replace(head.separator, " ").replace(head.decimal, ".").encode()
    width = n + with_x
    table = number_rows(blanks, "r" * width, f"{width} numbers", path, of_names + 1)
    count = samples[0]
    is_other = len(table) != count and (head.has_headings or not len(table))
    if count < 1 or is_other:
        hint = ""
        if len(table) > count:
            hint = "; packets without a head of their own need Multi_Headings No"
        raise refused(f"Samples says {count}, found {len(table)} rows{hint}")
    columns = table.T
    if head.x_columns == "Multi":
        times, values = columns[::2], columns[1::2]
    else:
        times, values = columns[:with_x], columns[with_x:]
    if len(table) != count and _runs_on(times, count, steps[0], path, of_names + 1):
        count = len(table)
    if len(table) % count:
        also = ", and their times do not run on" if len(times) else ""
        raise refused(f"{len(table)} rows are no packets of {count} (Samples){also}")
    units = [*fields.get("Y_Unit_Label", []), *[""] * n][:n]
    for start in range(0, len(table), count):
        part = values[:, start : start + count]
        yield _Segment(first, steps[0], tuple(own), tuple(units), part)


def _runs_on(
    times: NDArray[np.float64], count: int, step: float, path: str | Path, first: int
) -> bool:
    """Return whether the times of packets, which begin at a line, run on without a gap.

    Raises
    ------
    FormatError
        If the times of one packet do not, or those of channels differ.
    """
    if not len(times):
        return False
    spread = np.flatnonzero(np.ptp(times, axis=0) > _ROUNDED * abs(step))
    if spread.size:
        low, high = times[:, spread[0]].min(), times[:, spread[0]].max()
        raise FormatError(
            f"times of {low:g} to {high:g} in one row; expected one time", path, first + spread[0]
        )
    time, row = times[0], np.arange(times.shape[1])
    expected = time[row - row % count] + step * (row % count)
    wrong = np.flatnonzero(np.abs(time - expected) > _ROUNDED * abs(step))
    if wrong.size:
        at = int(wrong[0])
        raise FormatError(
            f"a time of {time[at]:g}; expected {expected[at]:g} by Delta_X", path, first + at
        )
    return bool((np.abs(time - time[0] - step * row) <= _ROUNDED * abs(step)).all())
