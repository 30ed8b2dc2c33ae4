"""A universal file as a sequence of datasets.

A 58b may contain the delimiter ``    -1`` in its data, so their end follows from record 7, and is
checked against the byte count. The data of a 58b stay on disk until they are needed (`Payload`),
which keeps memory independent of the size of the file.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from updyn.arrays import RealArray
from updyn.errors import FormatError
from updyn.foreign.settings import READING
from updyn.io.settings import MEASURED_FILE
from updyn.io.text_numbers import parse_integer, parse_real

__all__ = [
    "Dataset",
    "Payload",
    "check_record_7",
    "count_columns",
    "datasets",
    "decode_line",
    "parse_real_field",
    "read_integer_field",
    "read_integer_fields",
    "read_real_column",
]

_DELIMITER = re.compile(rb"    -1[ \t\x00]*\r?(?:\n|\Z)")
_AFTER_BYTES = re.compile(rb"[\r\n]*" + _DELIMITER.pattern)
_NUMBER = re.compile(r"\s*([0-9]{1,9})\s*([bB]?)(.*)", re.DOTALL)
_PADDING = b" \t\r\n\x00\x1a"
_TEXT_LINES = 11  # of a dataset 58, before its data
_SIZES = {2: 4, 4: 8, 5: 4, 6: 8}  # bytes per number, by ordinate data type
#: Fortran omits the E before an exponent of three digits.
_LONG_EXPONENT = re.compile(r"^(\s*[+-]?[0-9]+\.[0-9]*)([+-][0-9]{3}\s*)$")


@dataclass(frozen=True, slots=True)
class Payload:
    """The binary data of a 58b, read on request.

    `line` has the number of the dataset; `offset` is the start of the data in bytes; `kinds` are
    the NumPy types of the first number of a point and of the others.
    """

    path: str | Path
    line: int
    offset: int
    points: int
    columns: int
    kinds: tuple[str, str]

    @property
    def size(self) -> int:
        """Number of bytes."""
        return self.points * self._dtype().itemsize

    def _dtype(self) -> np.dtype[Any]:
        first, others = self.kinds
        return np.dtype([("first", first), ("others", others, (self.columns - 1,))])

    def read(self, *, swapped: bool = False) -> RealArray:
        """Return the numbers, shape (points, columns); `swapped` reads the opposite byte order."""
        dtype = self._dtype().newbyteorder("S") if swapped else self._dtype()
        with Path(self.path).open("rb") as file:
            file.seek(self.offset)
            raw = np.fromfile(file, dtype, self.points)
        if len(raw) != self.points:
            raise FormatError("58b: the file became shorter during reading", self.path, self.line)
        out = np.empty((self.points, self.columns))
        with np.errstate(invalid="ignore"):  # NaN is refused later
            out[:, 0] = raw["first"]
            out[:, 1:] = raw["others"]
        return out


@dataclass(frozen=True, slots=True)
class Dataset:
    """A dataset of a universal file, with the line of its number.

    `body` are the lines between the number and the delimiter; only the 11 lines of text of a 58b.
    """

    number: int
    line: int
    body: bytes
    payload: Payload | None = None


def datasets(path: str | Path) -> Iterator[Dataset]:
    """Yield the datasets of a universal file in order, including unknown numbers."""
    with Path(path).open("rb") as file:
        yield from _datasets(_Cursor(file, path))


def _datasets(cursor: _Cursor) -> Iterator[Dataset]:
    while cursor.skip_padding():
        if not _DELIMITER.match(cursor.peek()):
            raise cursor.error(
                "expected '    -1', the start of a dataset, found"
                f" {decode_line(cursor.peek()).strip()[:40]!r}: not a universal file, or a"
                " delimiter is missing or superfluous"
            )
        opened = cursor.line
        cursor.take()
        line = cursor.line
        found = _NUMBER.fullmatch(decode_line(cursor.peek()))
        if found is None:
            raise cursor.error(
                "expected the number of a dataset, found"
                f" {decode_line(cursor.peek()).strip()[:40]!r}"
            )
        cursor.take()
        number = int(found[1])
        if number == 58 and found[2]:
            yield _binary(cursor, line, found[3])
            continue
        body = cursor.take_body()
        if body is None:
            raise cursor.error(
                f"dataset {number}, started on line {opened}, has no closing '    -1';"
                " the file is truncated",
                line,
            )
        yield Dataset(number, line, body)


class _Cursor:
    """A position in a file, with its line number."""

    def __init__(self, file: BinaryIO, path: str | Path) -> None:
        self.file = file
        self.path = path
        self.line = 1
        self.size = file.seek(0, 2)
        file.seek(0)
        self._next = file.readline()

    @property
    def at(self) -> int:
        """Offset of the next line, in bytes."""
        return self.file.tell() - len(self._next)

    def move(self, to: int) -> None:
        """Move forward to an offset, and count the line breaks on the way."""
        remaining = to - self.at
        self.file.seek(self.at)
        while remaining > 0:
            chunk = self.file.read(min(remaining, READING.block_bytes))
            self.line += chunk.count(b"\n")
            remaining -= len(chunk)
        self._next = self.file.readline()

    def peek(self) -> bytes:
        return self._next

    def take(self) -> bytes:
        taken, self._next = self._next, self.file.readline()
        self.line += taken.endswith(b"\n")
        return taken

    def take_body(self) -> bytes | None:
        """Return the lines before the next delimiter and move past it; None without a delimiter."""
        lines: list[bytes] = []
        while line := self.take():
            if _DELIMITER.fullmatch(line):
                return b"".join(lines)
            lines.append(line)
        return None

    def end_of_delimiter(self, offset: int) -> int | None:
        """Return the offset after a closing delimiter that starts at `offset`, or None."""
        place = self.file.tell()
        self.file.seek(offset)
        found = _AFTER_BYTES.match(self.file.read(MEASURED_FILE.delimiter_window))
        self.file.seek(place)
        return offset + found.end() if found else None

    def skip_padding(self) -> bool:
        """Skip empty lines; return whether the file continues."""
        while self._next and not self._next.strip(_PADDING):
            self.take()
        return bool(self._next)

    def error(self, message: str, line: int | None = None) -> FormatError:
        return FormatError(message, self.path, self.line if line is None else line)


def _binary(cursor: _Cursor, line: int, rest: str) -> Dataset:
    """Return a 58b; moves the cursor from its first line of text past its closing delimiter."""
    order, n_bytes = _parse_binary_header(cursor, line, rest)
    records = [cursor.take() for _ in range(_TEXT_LINES)]
    if not cursor.peek():
        raise cursor.error("58b: the file ends within the dataset, before its data", line)
    ordinate, points, even = check_record_7(decode_line(records[6]), cursor.path, line + 7)
    forms = _possible_payloads(cursor, line, order, ordinate, points, even)
    ends = {form: cursor.end_of_delimiter(cursor.at + form.size) for form in forms}
    closed = [form for form in forms if ends[form] is not None]
    if not closed:
        raise cursor.error(_describe_length_error(cursor, forms[0].size, n_bytes), line)
    payload = next((form for form in closed if form.size == n_bytes), closed[0])
    # Some programs write points times bytes per number, even for complex and uneven data (pyuff up
    # to 2.5.8).
    if n_bytes not in (payload.size, points * _SIZES[ordinate]):
        raise cursor.error(
            f"58b: the first line declares {n_bytes} bytes of data, but the file has"
            f" {payload.size}, as required by record 7",
            line,
        )
    end = ends[payload]
    assert end is not None  # true for all in `closed`
    cursor.move(end)
    return Dataset(58, line, b"".join(records), payload)


def _parse_binary_header(cursor: _Cursor, line: int, rest: str) -> tuple[str, int]:
    """Return byte order, in NumPy's notation, and number of bytes stated in the first line."""
    try:
        order, floating, text_lines, n_bytes = map(parse_integer, rest.split()[:4])
    except ValueError as error:
        raise cursor.error(
            "58b: expected byte order, floating-point format, lines of text and bytes of data,"
            f" found {rest.strip()!r}",
            line,
        ) from error
    if order not in (1, 2):
        raise cursor.error(
            f"58b: byte order {order}; expected 1 (little-endian) or 2 (big-endian)", line
        )
    if floating != 2:
        raise cursor.error(f"58b: floating-point format {floating}; expected 2 (IEEE 754)", line)
    if text_lines != _TEXT_LINES:
        raise cursor.error(
            f"58b: {text_lines} lines of text before the data; expected {_TEXT_LINES}", line
        )
    return "<>"[order - 1], n_bytes


def _possible_payloads(
    cursor: _Cursor, line: int, order: str, ordinate: int, points: int, even: int
) -> list[Payload]:
    # The format requires an abscissa of single precision for uneven spacing, whatever the ordinate
    # is; most programs write both in the same precision.
    number = f"{order}f{_SIZES[ordinate]}"
    kinds = [(number, number)]
    if _SIZES[ordinate] == 8 and not even:
        kinds.append((f"{order}f4", number))
    columns = count_columns(ordinate, even)
    return [Payload(cursor.path, line, cursor.at, points, columns, each) for each in kinds]


def _describe_length_error(cursor: _Cursor, size: int, n_bytes: int) -> str:
    remaining = cursor.size - cursor.at
    if remaining < size:
        return (
            f"58b: the file is truncated: record 7 requires {size} bytes of data, {remaining}"
            " remain"
        )
    if 0 <= n_bytes != size and cursor.end_of_delimiter(cursor.at + n_bytes) is not None:
        return (
            f"58b: found {n_bytes} bytes of data; record 7 (points, type, spacing) requires {size}"
        )
    return (
        f"58b: no closing '    -1' after the {size} bytes of data required by record 7; the first"
        f" line declares {n_bytes}: a wrong count of points or bytes, or a file changed by a"
        " text-mode transfer"
    )


def check_record_7(record: str, path: str | Path, line: int) -> tuple[int, int, int]:
    """Return ordinate data type, number of points and spacing (0 uneven, 1 even) of record 7."""
    kind = read_integer_field(record, 0, 10, "record 7, ordinate data type", path, line)
    points = read_integer_field(record, 10, 10, "record 7, number of points", path, line)
    even = read_integer_field(record, 20, 10, "record 7, abscissa spacing", path, line)
    if kind not in _SIZES:
        raise FormatError(
            f"record 7: ordinate data type {kind}; expected 2 or 4 (real), 5 or 6 (complex, single"
            " or double)",
            path,
            line,
        )
    if points < 1:
        raise FormatError(f"record 7: {points} points; expected at least 1", path, line)
    if even not in (0, 1):
        raise FormatError(
            f"record 7: abscissa spacing {even}; expected 0 (uneven) or 1 (even)", path, line
        )
    return kind, points, even


def count_columns(ordinate: int, even: int) -> int:
    """Return the count of numbers per point of dataset 58, by ordinate data type and spacing."""
    is_complex = ordinate in (5, 6)
    has_abscissa = not even
    return 1 + is_complex + has_abscissa


# -- fields of a line ---------------------------------------------------------------------------
def decode_line(line: bytes) -> str:
    """Decode a line: UTF-8 if valid, else Latin-1."""
    try:
        return line.decode("utf-8")
    except UnicodeDecodeError:
        return line.decode("latin-1")


def read_integer_field(
    text: str, start: int, width: int, what: str, path: str | Path, line: int
) -> int:
    """Return the integer in columns `start` + 1 to `start` + `width`; `what` is for messages."""
    field = text[start : start + width].strip()
    where = f"columns {start + 1} to {start + width}"
    _check_edges(text, start, width, what, path, line)
    try:
        return parse_integer(field)
    except ValueError as error:
        raise FormatError(
            f"{what}: expected a whole number in {where}, found {field!r}", path, line
        ) from error


def _check_edges(text: str, start: int, width: int, what: str, path: str | Path, line: int) -> None:
    """Refuse a line with a number that extends beyond its columns."""
    if _extends_over(text, start) or _extends_over(text, start + width):
        raise FormatError(
            f"{what}: expected a number in columns {start + 1} to {start + width}, found one that"
            f" extends beyond them in {text.rstrip()!r}: shifted columns",
            path,
            line,
        )


def _extends_over(text: str, edge: int) -> bool:
    """Return whether a number extends over the edge between two fields."""
    # A completely filled field of ten columns after the edge may be a separate number.
    pair = text[max(edge - 1, 0) : edge + 1]
    return len(pair) == 2 and pair.isdigit() and " " in text[edge : edge + 10].ljust(10)


def read_integer_fields(text: str, count: int, what: str, path: str | Path, line: int) -> list[int]:
    """Return the integers in the first `count` fields of ten columns."""
    return [read_integer_field(text, 10 * i, 10, what, path, line) for i in range(count)]


def read_real_column(
    text: str, start: int, width: int, what: str, path: str | Path, line: int
) -> float:
    """Return the number in columns `start` + 1 to `start` + `width`; 0 if the line ends earlier."""
    _check_edges(text, start, width, what, path, line)
    return parse_real_field(text[start : start + width] or "0", what, path, line)


def parse_real_field(text: str, what: str, path: str | Path, line: int) -> float:
    """Parse a number in Fortran notation: exponent after E, D or only its sign."""
    try:
        return parse_real(_LONG_EXPONENT.sub(r"\1E\2", text))
    except ValueError as error:
        raise FormatError(
            f"{what}: expected a number, found {text.strip()!r}", path, line
        ) from error
