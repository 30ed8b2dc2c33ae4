"""Time records as a text table with one line per sample.

The header may state units in brackets or on the line below the names. The optional column
``record`` contains the number of the record, whose rows are consecutive. Comments that state a unit
or a scale are refused.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from updyn.arrays import RealArray
from updyn.errors import FormatError, OptionError, suggest
from updyn.io.csv_text import check_comments, plain_numbers, split_axis
from updyn.io.items import locate_errors, read_windows_text, require_file
from updyn.io.text_numbers import find_rounding, parse_rows
from updyn.signals.records import Records, find_step, find_time_unit
from updyn.units import CHANNEL, Unit, find_unit, strip_brackets, suggest_unit

__all__ = ["read_records"]

_SQUARE = re.compile(r"(.*?)\s*\[([^\[\]]*)\]")
_ROUND = re.compile(r"(.*?)\s*\(([^()]*|\([^()]*\)[^()]*)\)")
_RECORD = "record"
#: Names of the time column, in any case; the second only with a unit.
_TIME, _TIMES = "time", ("time", "t")


@dataclass(frozen=True, slots=True)
class _RecordColumn:
    """A column: its cell of the header, and the name and unit in it (empty if not stated)."""

    cell: str
    name: str
    unit: str

    @property
    def is_time(self) -> bool:
        return find_unit(self.unit, "time") is not None


def read_records(
    path: str | Path, *, time: str | None = None, rate: float | None = None
) -> Records:
    """Read time records in the units of the header; `rate` is for a table without times."""
    text = read_windows_text(require_file(path))
    first, header, body = _split_header(text, path)
    separator = next((sign for sign in ("\t", ";") if sign in header), ",")
    columns = _parse_columns(header, separator, path, first)
    columns, body = _read_units_below(columns, body, separator, path, first + 1)
    body = plain_numbers(body, separator)
    rows = parse_rows(
        body.encode(),
        "r" * len(columns),
        f"{len(columns)} numbers, one for each name in the header",
        path,
        first + 1,
        separator=separator.encode(),
    )
    if not len(rows):
        raise FormatError("a header without lines of numbers", path, first)
    numbers = {column.name: values for column, values in zip(columns, rows.T, strict=True)}
    spans = _split_records(numbers.pop(_RECORD, np.ones(len(rows))), path)
    clock = _time_column(columns, time, rate, path, first)
    if clock is None:
        step = 1.0 / float(rate or 0.0)
    else:
        texts = [
            row.split(separator)[columns.index(clock)] for row in body.split("\n") if row.strip()
        ]
        step = _step(numbers.pop(clock.name), texts, _factor(clock, path, first), spans, path)
    if not numbers:
        raise FormatError("no channel in addition to time and record", path, first)
    values = [[channel[span] for channel in numbers.values()] for span in spans]
    units = [column.unit for column in columns if column.name in numbers]
    with locate_errors(path):
        return Records.of(values, step, list(numbers), units, Path(path).name)


def _split_header(text: str, path: str | Path) -> tuple[int, str, str]:
    """Return the line of the header, the header, and the remaining lines with comments blanked."""
    lines = text.split("\n")
    comments = [(n, line) for n, line in enumerate(lines, 1) if line.lstrip().startswith("#")]
    check_comments(comments, (), "write units in the header, such as 'time [ms]'", path)
    for number, _ in comments:
        lines[number - 1] = ""
    for number, line in enumerate(lines, 1):
        if line.strip():
            return number, line, "\n".join(lines[number:])
    raise FormatError("no header: expected names such as 'time,hammer [N],3:Z [g]'", path)


def _parse_columns(header: str, separator: str, path: str | Path, line: int) -> list[_RecordColumn]:
    """Return the columns; refuse repeated names."""
    found: dict[str, _RecordColumn] = {}
    for number, cell in enumerate(header.split(separator), 1):
        column = _parse_column(cell.strip().strip('"').strip())
        if not column.name:
            raise FormatError(
                f"header: column {number} is {cell.strip()[:40]!r}; expected a name, optionally"
                " with a unit in square brackets",
                path,
                line,
            )
        if column.name in found:
            raise FormatError(f"header: column {column.name!r} occurs twice", path, line)
        found[column.name] = column
    return list(found.values())


def _parse_column(cell: str) -> _RecordColumn:
    """Return a column from its cell in the header, with an empty name if the cell is not valid."""
    axis = split_axis(cell, _TIMES, "time")
    if axis is not None:
        return _RecordColumn(cell, *axis)
    square = _SQUARE.fullmatch(cell)
    if square is not None:
        return _RecordColumn(cell, square[1], square[2].strip())
    if "[" in cell or "]" in cell:
        return _RecordColumn(cell, "", "")
    bracket = _ROUND.fullmatch(cell)
    if bracket is not None and _known_unit(bracket[2]):
        return _RecordColumn(cell, bracket[1], bracket[2].strip())
    return _RecordColumn(cell, cell, "")


def _known_unit(label: str) -> Unit | None:
    """Return the unit of channels or times with this label, or None."""
    return find_unit(label, "time", *CHANNEL)


def _read_units_below(
    columns: list[_RecordColumn], body: str, separator: str, path: str | Path, line: int
) -> tuple[list[_RecordColumn], str]:
    """Return the columns with units from the line below their names, and the rows without it."""
    row, _, rest = body.partition("\n")
    cells = [cell.strip().strip('"').strip() for cell in row.split(separator)]
    units = [_known_unit(cell) for cell in cells]
    if len(cells) != len(columns) or not any(units):
        return columns, body
    if not all(unit or not cell for cell, unit in zip(cells, units, strict=True)):
        return columns, body
    out = []
    for column, cell, unit in zip(columns, cells, units, strict=True):
        if column.unit and cell and unit != _known_unit(column.unit):
            raise FormatError(
                f"column {column.name!r}: unit {cell!r}, in the header {column.unit!r}", path, line
            )
        out.append(replace(column, unit=column.unit or strip_brackets(cell)))
    return out, "\n" + rest


def _time_column(
    columns: Sequence[_RecordColumn],
    time: str | None,
    rate: float | None,
    path: str | Path,
    line: int,
) -> _RecordColumn | None:
    if rate is not None and not (np.isfinite(rate) and rate > 0.0):
        raise OptionError(f"rate {rate!r}: expected samples per second, above 0", key=("rate",))
    if time is not None:
        found = [column for column in columns if time in (column.cell, column.name)]
    else:
        found = [column for column in columns if column.name.casefold() == _TIME]
        found = found or [column for column in columns if column.is_time]
    if len(found) > 1:
        names = " and ".join(repr(column.name) for column in found)
        raise FormatError(f"columns {names} have units of time; select one with time=", path, line)
    if rate is not None:
        if found or time is not None:
            name = found[0].cell if found else time
            raise OptionError(
                f"rate and a column {name!r} of times; expected one of the two", key=("rate",)
            )
        return None
    if not found:
        name = _TIME if time is None else time
        raise FormatError(
            f"no column {name!r} of times; {suggest(name, [column.name for column in columns])}"
            " give time= or rate=",
            path,
            line,
            key=("time",) if time is not None else (),
        )
    return found[0]


def _factor(clock: _RecordColumn, path: str | Path, line: int) -> float:
    """Return the factor that converts times to s."""
    unit = find_unit(clock.unit, "time") if clock.unit else find_time_unit(clock.name)
    if unit is None:
        raise FormatError(
            f"header: column {clock.cell!r} of times: unit {clock.unit!r};"
            f" {suggest_unit(clock.unit, 'time')}",
            path,
            line,
        )
    return unit.factor


def _split_records(numbers: RealArray, path: str | Path) -> list[slice]:
    edges = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(numbers)]
    spans = [slice(a, b) for a, b in pairwise(edges)]
    seen: set[float] = set()
    lengths = {span.stop - span.start for span in spans}
    for span in spans:
        number = float(numbers[span.start])
        if number in seen or number != round(number):
            raise FormatError(
                f"record {number:g}: expected whole numbers, with consecutive rows of each record",
                path,
            )
        seen.add(number)
    if len(lengths) > 1:
        raise FormatError(
            f"records of {min(lengths)} to {max(lengths)} samples; expected records of the same"
            " length",
            path,
        )
    return spans


def _step(
    times: RealArray,
    texts: Sequence[str],
    factor: float,
    spans: list[slice],
    path: str | Path,
) -> float:
    """Return the common step of all records in s, checked within rounding."""
    rounding = factor * find_rounding(texts, times)
    times = factor * times
    with locate_errors(path, "time"):
        steps = [find_step(times[span], rounding[span]) for span in spans]
    allowed = 1e-6 * steps[0] + 2.0 * rounding.max() / max(spans[0].stop - spans[0].start - 1, 1)
    for number, step in enumerate(steps, 1):
        if abs(step - steps[0]) > allowed:
            raise FormatError(
                f"record {number} has {step:g} s between samples, the first record {steps[0]:g} s",
                path,
            )
    return steps[0]
