"""OUTPUT4 files in text: numbers in fields of fixed width. See `updyn.io.nastran.op4`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from updyn.errors import FormatError
from updyn.io.nastran.fields import real
from updyn.io.nastran.op4 import ROWS_OF_BIGMAT, Collector, Layout, OP4Matrix, check_header, runs

__all__ = ["read", "write"]

_FORMAT = re.compile(r"(\d+)\s*[EDed]\s*(\d+)\s*\.\s*(\d+)")
_DIGITS = {False: (3, 26, 16), True: (5, 16, 8)}  # values a line, width, digits behind the point


def read(path: Path) -> Iterator[tuple[str, Any, int]]:
    """Yield name, entries (sparse) and form of each matrix."""
    with path.open(encoding="latin-1") as file:
        lines = _Lines(path, file)
        while (header := lines.next()) is not None:
            if header.strip():
                yield _matrix(lines, header)


class _Lines:
    def __init__(self, path: Path, file: Iterable[str]) -> None:
        self.path, self._file, self.number = path, iter(file), 0

    def next(self) -> str | None:
        line = next(self._file, None)
        self.number += line is not None
        return None if line is None else line.rstrip("\r\n")

    def wanted(self, what: str) -> str:
        line = self.next()
        if line is None:
            raise FormatError(
                f"the file ends where {what} was expected: it is cut short", self.path, self.number
            )
        return line

    def error(self, what: str) -> FormatError:
        return FormatError(what, self.path, self.number)

    def integers(self, line: str, n: int, width: int, what: str) -> list[int]:
        try:
            found = [int(line[i * width : (i + 1) * width]) for i in range(n)]
        except ValueError as error:
            raise self.error(f"{line.strip()[:60]!r}; expected {what}") from error
        return found


def _matrix(lines: _Lines, header: str) -> tuple[str, Any, int]:
    letter = re.search(r"[A-Za-z]", header)
    if letter is None or letter.start() not in (32, 40, 64):
        raise lines.error(
            f"{header.strip()[:60]!r}; expected the header of an OUTPUT4 matrix: columns, rows,"
            " form, type, name"
        )
    width = letter.start() // 4
    columns, rows, form, kind = lines.integers(header, 4, width, "columns, rows, form and type")
    name = header[4 * width : 4 * width + 8].strip().upper()
    check_header(lines.path, lines.number, name, columns, rows, kind)
    told = _FORMAT.search(header, 4 * width + 8)
    if told is None:
        raise lines.error(f"matrix {name!r}: no format such as '1P,5E16.9' behind the name")
    a_line, field = int(told[1]), int(told[2])
    head = 2 if rows < 0 or rows >= ROWS_OF_BIGMAT else 1
    out = Collector(lines.path, name, abs(rows), columns)
    while True:
        line = lines.wanted(f"a column of matrix {name!r}")
        column, row, n_words = lines.integers(
            line, 3, width, f"column, row and number of words in matrix {name!r}"
        )
        if column > columns:
            _values(lines, n_words, a_line, field)
            return name, out.matrix(), form
        if row:  # dense: here, and only here, what is counted is numbers, not words
            out.add(row, column, _values(lines, n_words, a_line, field), lines.number)
            continue
        while n_words > 0:
            row, length = _string_head(lines, head, column)
            if length < 1 or length + head > n_words:
                raise lines.error(
                    f"column {column}: a string of {length} words; {n_words} are left in the column"
                )
            out.add(row, column, _values(lines, length // kind, a_line, field), lines.number)
            n_words -= length + head


def _string_head(lines: _Lines, head: int, column: int) -> tuple[int, int]:
    """Return row and number of words of a string."""
    line = lines.wanted(f"a string of column {column}")
    try:
        found = [int(word) for word in line.split()]
    except ValueError:
        found = []
    if len(found) != head:
        raise lines.error(
            f"{line.strip()[:60]!r}; expected the head of a string of column {column}: {head}"
            " integer(s)"
        )
    return (found[1], found[0] - 1) if head == 2 else (found[0] & 0xFFFF, (found[0] >> 16) - 1)


def _values(lines: _Lines, n: int, a_line: int, width: int) -> Any:
    out = np.empty(n)
    for first in range(0, n, a_line):
        line = lines.wanted("values")
        if line[min(a_line, n - first) * width :].strip():
            raise lines.error(
                f"more than {min(a_line, n - first)} value(s) of {width} characters on the line"
            )
        for k in range(min(a_line, n - first)):
            cell = line[k * width : (k + 1) * width].strip()
            try:
                out[first + k] = real(cell)
            except ValueError as error:
                raise lines.error(
                    f"{cell!r} is not a number; expected {n} values of {width} characters"
                ) from error
    return out


def write(matrices: Iterable[OP4Matrix], path: Path, layout: Layout, single: bool) -> None:
    """Write checked matrices."""
    a_line, width, digits = _DIGITS[single]
    kind = 1 if single else 2
    with path.open("w", encoding="ascii", newline="\n") as file:
        for m in matrices:
            rows, columns = m.matrix.shape
            sign = -1 if layout == "bigmat" else 1
            file.write(
                f"{columns:8}{sign * rows:8}{m.form:8}{kind:8}{m.name:<8}1P,{a_line}E{width}.{digits}\n"
            )
            for j in range(columns):
                some = slice(m.matrix.indptr[j], m.matrix.indptr[j + 1])
                if len(m.matrix.indices[some]):
                    _write_column(
                        file, j + 1, m.matrix.indices[some], m.matrix.data[some], layout, single
                    )
            file.write(f"{columns + 1:8}{1:8}{1:8}\n" + _cells([1.0], single))


def _write_column(
    file: Any, column: int, rows: Any, values: Any, layout: Layout, single: bool
) -> None:
    kind = 1 if single else 2
    if layout == "dense":
        full = np.zeros(rows[-1] - rows[0] + 1)
        full[rows - rows[0]] = values
        file.write(f"{column:8}{rows[0] + 1:8}{len(full):8}\n" + _cells(full, single))
        return
    strings = runs(rows)
    head = 2 if layout == "bigmat" else 1
    file.write(f"{column:8}{0:8}{head * len(strings) + kind * len(rows):8}\n")
    for start, end in strings:
        words, row = kind * (end - start) + 1, int(rows[start]) + 1
        file.write(f"{words:8}{row:8}\n" if head == 2 else f"{row + (words << 16):12}\n")
        file.write(_cells(values[start:end], single))


def _cells(values: Any, single: bool) -> str:
    a_line, width, digits = _DIGITS[single]
    cells = [f"{x:{width}.{digits}E}" for x in values]
    return "".join("".join(cells[i : i + a_line]) + "\n" for i in range(0, len(cells), a_line))
