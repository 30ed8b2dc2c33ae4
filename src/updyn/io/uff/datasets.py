"""A universal file as a sequence of datasets.

A dataset stands between two lines ``    -1``. Its first line has the number in columns 1 to 6, and
for a binary dataset 58 ("58b") a ``b`` in column 7, with byte order, floating-point format, number
of text lines and number of bytes after it. The bytes of a 58b may hold anything, the delimiter too:
where they end follows from record 7 and is checked against the byte count and against what stands
there, never searched for.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from updyn.errors import FormatError
from updyn.io.text_numbers import real_of, whole_of

__all__ = [
    "Dataset",
    "bytes_expected",
    "columns_of",
    "datasets",
    "real_column",
    "real_field",
    "text_of",
    "whole_field",
    "whole_fields",
]

_DELIMITER = re.compile(rb"^    -1[ \t\x00]*\r?(?:\n|\Z)", re.MULTILINE)
_AFTER_BYTES = re.compile(rb"[\r\n]*    -1[ \t\x00]*\r?(?:\n|\Z)")
_NUMBER = re.compile(r"\s*([0-9]{1,9})\s*([bB]?)(.*)", re.DOTALL)
_PADDING = b" \t\r\n\x00\x1a"
_TEXT_LINES = 11  # of a dataset 58, before its data
_SIZES = {2: 4, 4: 8, 5: 4, 6: 8}  # bytes a number, by ordinate data type


@dataclass(frozen=True, slots=True)
class Dataset:
    """One dataset.

    Attributes
    ----------
    number : int
        What it holds, for instance 58.
    line : int
        Line of the file, from 1, on which the number stands.
    body : bytes
        The lines after that one, up to the delimiter; of a 58b only the 11 lines of text.
    payload : bytes or None
        The binary data of a 58b.
    big_endian : bool
        Byte order of the payload.
    """

    number: int
    line: int
    body: bytes
    payload: bytes | None = None
    big_endian: bool = False


def datasets(path: str | Path) -> Iterator[Dataset]:
    """Yield the datasets of a universal file in order, unknown numbers included.

    Parameters
    ----------
    path : path
        The file.

    Yields
    ------
    Dataset
        The next one.

    Raises
    ------
    FormatError
        If a delimiter, a number or a byte count is missing or wrong; the message says on which
        line.
    """
    cursor = _Cursor(Path(path).read_bytes(), path)
    while cursor.skip_padding():
        if not _DELIMITER.match(cursor.peek()):
            raise cursor.error(
                "expected '    -1', which opens a dataset, found"
                f" {text_of(cursor.peek()).strip()[:40]!r}: not a universal file, or a delimiter is"
                " missing or superfluous"
            )
        opened = cursor.line
        cursor.take()
        line = cursor.line
        found = _NUMBER.fullmatch(text_of(cursor.peek()))
        if found is None:
            raise cursor.error(
                f"expected the number of a dataset, found {text_of(cursor.peek()).strip()[:40]!r}"
            )
        cursor.take()
        number = int(found[1])
        if number == 58 and found[2]:
            yield _binary(cursor, line, found[3])
            continue
        end = _DELIMITER.search(cursor.raw, cursor.at)
        if end is None:
            raise cursor.error(
                f"dataset {number}, opened on line {opened}, is not closed: no further '    -1';"
                " the file is cut short",
                line,
            )
        body = cursor.raw[cursor.at : end.start()]
        cursor.move(end.end())
        yield Dataset(number, line, body)


class _Cursor:
    """A place in the bytes of a file, with its line number."""

    def __init__(self, raw: bytes, path: str | Path) -> None:
        self.raw = raw
        self.path = path
        self.at = 0
        self.line = 1

    def move(self, to: int) -> None:
        self.line += self.raw.count(b"\n", self.at, to)
        self.at = to

    def _end(self) -> int:
        end = self.raw.find(b"\n", self.at)
        return len(self.raw) if end < 0 else end + 1

    def peek(self) -> bytes:
        return self.raw[self.at : self._end()]

    def take(self) -> bytes:
        taken = self.peek()
        self.move(self._end())
        return taken

    def skip_padding(self) -> bool:
        """Pass over empty lines; return whether anything is left."""
        while self.at < len(self.raw) and not self.peek().strip(_PADDING):
            self.take()
        return self.at < len(self.raw)

    def error(self, message: str, line: int | None = None) -> FormatError:
        return FormatError(message, self.path, self.line if line is None else line)


def _binary(cursor: _Cursor, line: int, rest: str) -> Dataset:
    """Return a 58b; moves the cursor from its first line of text past its closing delimiter."""
    words = rest.split()
    try:
        order, floating, text_lines, n_bytes = map(whole_of, words[:4])
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
    start = cursor.at
    records = []
    for _ in range(_TEXT_LINES):
        records.append(cursor.take())
    if cursor.at >= len(cursor.raw):
        raise cursor.error("58b: the file ends within the dataset, before its data", line)
    body = cursor.raw[start : cursor.at]
    size, unit = bytes_expected(text_of(records[6]), cursor.path, line + 7)
    end = _AFTER_BYTES.match(cursor.raw, cursor.at + size)
    if end is None:
        raise cursor.error(_what_is_wrong(cursor, size, n_bytes), line)
    # Some writers count points times bytes a number, for complex and uneven data as well (pyuff up
    # to 2.5.8).
    if n_bytes not in (size, unit):
        raise cursor.error(
            f"58b: says {n_bytes} bytes of data; {size} follow from record 7, and stand there", line
        )
    payload = cursor.raw[cursor.at : cursor.at + size]
    cursor.move(end.end())
    return Dataset(58, line, body, payload, order == 2)


def _what_is_wrong(cursor: _Cursor, size: int, n_bytes: int) -> str:
    left = len(cursor.raw) - cursor.at
    if left < size:
        return (
            f"58b: the file is cut short: {size} bytes of data follow from record 7, {left} are"
            " left"
        )
    if n_bytes != size and _AFTER_BYTES.match(cursor.raw, cursor.at + n_bytes):
        return (
            f"58b: {n_bytes} bytes of data stand there; from record 7 (points, type, spacing)"
            f" follow {size}"
        )
    return (
        f"58b: no closing '    -1' after the {size} bytes of data that follow from record 7; the"
        f" line before says {n_bytes}: a wrong count of points or bytes, or a file changed by a"
        " text-mode transfer"
    )


def bytes_expected(record: str, path: str | Path, line: int) -> tuple[int, int]:
    """Return the number of bytes of the data of a 58b, and that of one number a point.

    Parameters
    ----------
    record : str
        Record 7.
    path : path
        The file, for messages.
    line : int
        Its line, for messages.

    Raises
    ------
    FormatError
        If the ordinate type, the number of points or the spacing is none.
    """
    kind = whole_field(record, 0, 10, "record 7, ordinate data type", path, line)
    points = whole_field(record, 10, 10, "record 7, number of points", path, line)
    even = whole_field(record, 20, 10, "record 7, abscissa spacing", path, line)
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
    numbers = columns_of(kind, even)
    return points * numbers * _SIZES[kind], points * _SIZES[kind]


def columns_of(ordinate: int, even: int) -> int:
    """Return the number of numbers a point of dataset 58, by ordinate data type and spacing."""
    is_complex = ordinate in (5, 6)
    has_abscissa = not even
    return 1 + is_complex + has_abscissa


# -- fields of a line ---------------------------------------------------------------------------
def text_of(line: bytes) -> str:
    """Return a line as text: UTF-8 where it is valid, else Latin-1."""
    try:
        return line.decode("utf-8")
    except UnicodeDecodeError:
        return line.decode("latin-1")


def whole_field(text: str, start: int, width: int, what: str, path: str | Path, line: int) -> int:
    """Return the whole number in columns `start` + 1 to `start` + `width`.

    Raises
    ------
    FormatError
        If there is none; the message says which columns hold what instead.
    """
    field = text[start : start + width].strip()
    where = f"columns {start + 1} to {start + width}"
    _check_edges(text, start, width, what, path, line)
    try:
        return whole_of(field)
    except ValueError as error:
        raise FormatError(
            f"{what}: expected a whole number in {where}, found {field!r}", path, line
        ) from error


def _check_edges(text: str, start: int, width: int, what: str, path: str | Path, line: int) -> None:
    """Refuse a line with a number that stands in some columns and beyond them."""
    if _goes_on(text, start) or _goes_on(text, start + width):
        raise FormatError(
            f"{what}: expected a number in columns {start + 1} to {start + width}, found one that"
            f" goes on beyond them in {text.rstrip()!r}: shifted columns",
            path,
            line,
        )


def _goes_on(text: str, edge: int) -> bool:
    """Return whether a number stands on both sides of an edge between two fields.

    Ten columns that are full behind the edge may be a number of their own.
    """
    beside = text[max(edge - 1, 0) : edge + 1]
    return len(beside) == 2 and beside.isdigit() and " " in text[edge : edge + 10].ljust(10)


def whole_fields(text: str, count: int, what: str, path: str | Path, line: int) -> list[int]:
    """Return the whole numbers in the first `count` fields of ten columns.

    Raises
    ------
    FormatError
        If there is none in one of them; the message says which columns hold what instead.
    """
    return [whole_field(text, 10 * i, 10, what, path, line) for i in range(count)]


def real_column(text: str, start: int, width: int, what: str, path: str | Path, line: int) -> float:
    """Return the number in columns `start` + 1 to `start` + `width`; 0 where the line ends before.

    Raises
    ------
    FormatError
        If there is none, or it goes on beyond these columns.
    """
    _check_edges(text, start, width, what, path, line)
    return real_field(text[start : start + width] or "0", what, path, line)


def real_field(text: str, what: str, path: str | Path, line: int) -> float:
    """Return a number as Fortran writes it, with E or D before the exponent.

    Raises
    ------
    FormatError
        If it is none.
    """
    try:
        return real_of(text)
    except ValueError as error:
        raise FormatError(
            f"{what}: expected a number, found {text.strip()!r}", path, line
        ) from error
