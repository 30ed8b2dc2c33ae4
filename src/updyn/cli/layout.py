"""Layout of text for the width of a terminal: wrapped sentences, tables split by columns.

Rows of tables are lines with two blanks between their columns. A table that is too wide is split
into parts, each with the first column; its last column, if it holds sentences, is wrapped.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, zip_longest

from updyn.cli.settings import LAYOUT
from updyn.text_table import display_width

__all__ = ["fit_text"]

_GAP = 2  # blanks between columns


def fit_text(text: str, width: int) -> str:
    """Return text whose lines have at most `width` columns, except words that are longer."""
    lines: list[str] = []
    for is_table, rows in groupby(text.split("\n"), _is_row):
        block = list(rows)
        if max(map(display_width, block)) <= width:
            lines += block
        elif is_table and len(columns := _find_columns(block)) > 1:
            lines += _fit_table(columns, width)
        else:
            for line in block:
                lines += _wrap_line(line, width)
    return "\n".join(lines)


def _is_row(line: str) -> bool:
    return "  " in line.strip()


# -- sentences -------------------------------------------------------------------------------------
def _wrap_line(line: str, width: int) -> list[str]:
    """Return a line broken at blanks, with the indentation of its first line."""
    indent = line[: len(line) - len(line.lstrip())]
    room = max(width - display_width(indent), 1)
    return [f"{indent}{part}" for part in _wrap_words(line.strip(), room)] or [""]


def _wrap_words(text: str, width: int) -> list[str]:
    """Return text broken at blanks into lines of at most `width` columns."""
    lines: list[str] = []
    for word in text.split():
        if lines and display_width(f"{lines[-1]} {word}") <= width:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines


# -- tables ----------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True)
class _Column:
    """A column of a table: its cells with their alignment, and the width at which it is shown."""

    cells: tuple[str, ...]
    width: int

    @property
    def is_text(self) -> bool:
        """Whether cells are aligned left and contain several words."""
        filled = [cell for cell in self.cells if cell.strip()]
        return all(cell[0] != " " for cell in filled) and any(" " in c.strip() for c in filled)

    def narrow(self, width: int) -> _Column:
        """Return the column with its cells wrapped to a width, as narrow as their lines."""
        if self.width <= width:
            return self
        lines = [line for cell in self.cells for line in _wrap_words(cell, width)]
        return _Column(self.cells, max(map(display_width, lines), default=0))

    def lines(self, row: int) -> list[str]:
        """Return the lines of a cell."""
        cell = self.cells[row]
        return [cell] if display_width(cell) <= self.width else _wrap_words(cell, self.width)


def _find_columns(rows: Sequence[str]) -> list[_Column]:
    """Return the columns of a table: they have two positions between them that are always blank."""
    # A wide character is followed by an empty position.
    expanded = [_expand(row) for row in rows]
    length = max(map(len, expanded))
    padded = [row + [" "] * (length - len(row)) for row in expanded]
    filled = [any(row[at] != " " for row in padded) for at in range(length)]
    columns = []
    for start, end in _find_runs(filled):
        cells = tuple("".join(row[start:end]).rstrip() for row in padded)
        columns.append(_Column(cells, end - start))
    if columns and (indent := " " * filled.index(True)):
        first = columns[0]
        cells = tuple(f"{indent}{cell}" for cell in first.cells)
        columns[0] = _Column(cells, first.width + len(indent))
    return columns


def _expand(line: str) -> list[str]:
    """Return the content of each position of a line on the terminal."""
    positions: list[str] = []
    for character in line:
        width = display_width(character)
        if width or not positions:
            positions += [character, *[""] * (width - 1)]
        else:
            positions[-1] += character
    return positions


def _find_runs(filled: Sequence[bool]) -> Iterator[tuple[int, int]]:
    """Yield start and end of the runs of filled positions; a single blank does not end one."""
    start = end = -1
    for at, is_filled in enumerate(filled):
        if not is_filled:
            continue
        if start >= 0 and at - end >= _GAP:
            yield start, end
            start = at
        elif start < 0:
            start = at
        end = at + 1
    if start >= 0:
        yield start, end


def _fit_table(columns: Sequence[_Column], width: int) -> list[str]:
    """Return the lines of the parts of a table, separated by blank lines."""
    key, *rest = columns
    if key.is_text:
        key = _narrow_key(key, rest, width)
    lines: list[str] = []
    for number, part in enumerate(_split_columns(key, rest, width)):
        lines += [""] * bool(number) + _format_rows([key, *part])
    return lines


def _narrow_key(key: _Column, rest: Sequence[_Column], width: int) -> _Column:
    """Return the first column so narrow that all others, or at least each, fit next to it."""
    least = LAYOUT.least_text_width
    room = width - sum(_GAP + column.width for column in rest)
    if room < least:
        room = width - max(_GAP + column.width for column in rest)
        if key.width <= room:
            return key
    return key.narrow(max(room, least))


def _split_columns(key: _Column, columns: Sequence[_Column], width: int) -> list[list[_Column]]:
    """Return the columns of each part, without the key, which all parts have."""
    parts: list[list[_Column]] = [[]]
    used = key.width
    for column in columns:
        room = width - used - _GAP
        if column.width > room and not (column.is_text and room >= LAYOUT.least_text_width):
            if parts[-1]:
                parts.append([])
            used, room = key.width, width - key.width - _GAP
        chosen = column
        if column.width > room and column.is_text:
            chosen = column.narrow(max(room, LAYOUT.least_text_width))
        parts[-1].append(chosen)
        used += _GAP + chosen.width
    return parts


def _format_rows(columns: Sequence[_Column]) -> list[str]:
    lines = []
    for row in range(len(columns[0].cells)):
        for cells in zip_longest(*(column.lines(row) for column in columns), fillvalue=""):
            padded = []
            for cell, column in zip(cells, columns, strict=True):
                padded.append(cell + " " * (column.width - display_width(cell)))
            lines.append((" " * _GAP).join(padded).rstrip())
    return lines
