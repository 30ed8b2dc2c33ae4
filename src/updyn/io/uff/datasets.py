"""A universal file as a sequence of datasets.

A dataset lies between two lines ``    -1``. Its first line has the number in columns 1 to 6, and
for a binary dataset 58 ("58b") a ``b`` in column 7, followed by byte order, floating-point format,
number of text lines and number of bytes. The bytes of a 58b may hold anything, the delimiter too:
where they end follows from record 7 and is checked against the byte count and the delimiter behind
them, never searched for.

The file is read dataset by dataset, and the data of a 58b stay on disk until they are asked for
(`Payload`), so that memory does not grow with the file.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from updyn.errors import FormatError
from updyn.io.text_numbers import real_of, whole_of

__all__ = [
    "Dataset",
    "Payload",
    "check_record_7",
    "columns_of",
    "datasets",
    "real_column",
    "real_field",
    "text_of",
    "whole_field",
    "whole_fields",
]

_DELIMITER = re.compile(rb"    -1[ \t\x00]*\r?(?:\n|\Z)")
_AFTER_BYTES = re.compile(rb"[\r\n]*" + _DELIMITER.pattern)
_NUMBER = re.compile(r"\s*([0-9]{1,9})\s*([bB]?)(.*)", re.DOTALL)
_PADDING = b" \t\r\n\x00\x1a"
_TEXT_LINES = 11  # of a dataset 58, before its data
_SIZES = {2: 4, 4: 8, 5: 4, 6: 8}  # bytes a number, by ordinate data type
#: Fortran leaves out the E before an exponent of three digits.
_LONG_EXPONENT = re.compile(r"^(\s*[+-]?[0-9]+\.[0-9]*)([+-][0-9]{3}\s*)$")
#: Bytes read at a time, and more than a closing delimiter takes with its padding.
_CHUNK = 2**20
_WINDOW = 2**12


@dataclass(frozen=True, slots=True)
class Payload:
    """The binary data of a 58b.

    Attributes
    ----------
    path : path
        The file.
    line : int
        Line of the file with the number of the dataset, for messages.
    offset : int
        Where the data start, in bytes.
    points, columns : int
        Number of points, and of numbers a point.
    kinds : (str, str)
        numpy's names of the type of the first number of a point, and of the others.
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

    def read(self, *, swapped: bool = False) -> NDArray[np.float64]:
        """Return the numbers, shape (points, columns).

        Parameters
        ----------
        swapped : bool
            Whether to read them in the byte order that the file does not state.

        Raises
        ------
        FormatError
            If the file has become shorter.
        """
        dtype = self._dtype().newbyteorder("S") if swapped else self._dtype()
        with Path(self.path).open("rb") as file:
            file.seek(self.offset)
            raw = np.fromfile(file, dtype, self.points)
        if len(raw) != self.points:
            raise FormatError("58b: the file was cut short while it was read", self.path, self.line)
        out = np.empty((self.points, self.columns))
        with np.errstate(invalid="ignore"):  # NaN is refused later
            out[:, 0] = raw["first"]
            out[:, 1:] = raw["others"]
        return out


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
    payload : Payload or None
        The binary data of a 58b.
    """

    number: int
    line: int
    body: bytes
    payload: Payload | None = None


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
    with Path(path).open("rb") as file:
        yield from _datasets(_Cursor(file, path))


def _datasets(cursor: _Cursor) -> Iterator[Dataset]:
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
        body = cursor.take_body()
        if body is None:
            raise cursor.error(
                f"dataset {number}, opened on line {opened}, is not closed: no further '    -1';"
                " the file is cut short",
                line,
            )
        yield Dataset(number, line, body)


class _Cursor:
    """A place in a file, with its line number."""

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
        """Go to an offset behind this place, and count the line breaks on the way."""
        left = to - self.at
        self.file.seek(self.at)
        while left > 0:
            chunk = self.file.read(min(left, _CHUNK))
            self.line += chunk.count(b"\n")
            left -= len(chunk)
        self._next = self.file.readline()

    def peek(self) -> bytes:
        return self._next

    def take(self) -> bytes:
        taken, self._next = self._next, self.file.readline()
        self.line += taken.endswith(b"\n")
        return taken

    def take_body(self) -> bytes | None:
        """Take the lines up to a delimiter, and the delimiter; None without a delimiter."""
        lines: list[bytes] = []
        while line := self.take():
            if _DELIMITER.fullmatch(line):
                return b"".join(lines)
            lines.append(line)
        return None

    def closing(self, offset: int) -> int | None:
        """Return the offset behind a closing delimiter at an offset; None without one."""
        place = self.file.tell()
        self.file.seek(offset)
        found = _AFTER_BYTES.match(self.file.read(_WINDOW))
        self.file.seek(place)
        return offset + found.end() if found else None

    def skip_padding(self) -> bool:
        """Pass over empty lines; return whether anything is left."""
        while self._next and not self._next.strip(_PADDING):
            self.take()
        return bool(self._next)

    def error(self, message: str, line: int | None = None) -> FormatError:
        return FormatError(message, self.path, self.line if line is None else line)


def _binary(cursor: _Cursor, line: int, rest: str) -> Dataset:
    """Return a 58b; moves the cursor from its first line of text past its closing delimiter."""
    order, n_bytes = _head_of_binary(cursor, line, rest)
    records = [cursor.take() for _ in range(_TEXT_LINES)]
    if not cursor.peek():
        raise cursor.error("58b: the file ends within the dataset, before its data", line)
    ordinate, points, even = check_record_7(text_of(records[6]), cursor.path, line + 7)
    forms = _forms(cursor, line, order, ordinate, points, even)
    ends = {form: cursor.closing(cursor.at + form.size) for form in forms}
    closed = [form for form in forms if ends[form] is not None]
    if not closed:
        raise cursor.error(_what_is_wrong(cursor, forms[0].size, n_bytes), line)
    payload = next((form for form in closed if form.size == n_bytes), closed[0])
    # Some writers count points times bytes a number, for complex and uneven data as well (pyuff up
    # to 2.5.8).
    if n_bytes not in (payload.size, points * _SIZES[ordinate]):
        raise cursor.error(
            f"58b: says {n_bytes} bytes of data; {payload.size} follow from record 7, and stand"
            " there",
            line,
        )
    end = ends[payload]
    assert end is not None  # of those in `closed`
    cursor.move(end)
    return Dataset(58, line, b"".join(records), payload)


def _head_of_binary(cursor: _Cursor, line: int, rest: str) -> tuple[str, int]:
    """Return byte order, as numpy calls it, and number of bytes that the first line states."""
    try:
        order, floating, text_lines, n_bytes = map(whole_of, rest.split()[:4])
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


def _forms(
    cursor: _Cursor, line: int, order: str, ordinate: int, points: int, even: int
) -> list[Payload]:
    """Return the forms that the data may have.

    By the format the abscissa of uneven lines is of single precision, whatever the ordinate is;
    most programs write both in one precision.
    """
    number = f"{order}f{_SIZES[ordinate]}"
    kinds = [(number, number)]
    if _SIZES[ordinate] == 8 and not even:
        kinds.append((f"{order}f4", number))
    columns = columns_of(ordinate, even)
    return [Payload(cursor.path, line, cursor.at, points, columns, each) for each in kinds]


def _what_is_wrong(cursor: _Cursor, size: int, n_bytes: int) -> str:
    left = cursor.size - cursor.at
    if left < size:
        return (
            f"58b: the file is cut short: {size} bytes of data follow from record 7, {left} are"
            " left"
        )
    if 0 <= n_bytes != size and cursor.closing(cursor.at + n_bytes) is not None:
        return (
            f"58b: {n_bytes} bytes of data stand there; from record 7 (points, type, spacing)"
            f" follow {size}"
        )
    return (
        f"58b: no closing '    -1' after the {size} bytes of data that follow from record 7; the"
        f" line before says {n_bytes}: a wrong count of points or bytes, or a file changed by a"
        " text-mode transfer"
    )


def check_record_7(record: str, path: str | Path, line: int) -> tuple[int, int, int]:
    """Return ordinate data type, number of points and spacing (0 uneven, 1 even).

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
        If one of them has no valid value.
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
    return kind, points, even


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
    """Return a number as Fortran writes it: the exponent after E or D, or three digits without.

    Raises
    ------
    FormatError
        If it is none.
    """
    try:
        return real_of(_LONG_EXPONENT.sub(r"\1E\2", text))
    except ValueError as error:
        raise FormatError(
            f"{what}: expected a number, found {text.strip()!r}", path, line
        ) from error
