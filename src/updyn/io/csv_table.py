"""Text tables of any layout: rows of numbers below any number of other lines.

The columns are separated by semicolons, tabs, commas or blanks. The separator and the number of
columns are those of most lines at the end of the file; the rows begin at the first line like these.
The line above is the header if it has as many cells; between both may be a line of units. Names
that repeat get those of a line above them. A header may be a comment (``#`` or ``%``). Separator
and first row may be stated.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from updyn.arrays import NumberArray
from updyn.errors import FormatError, OptionError, suggest
from updyn.io.channels import OTHER_ANGLES, Key
from updyn.io.csv_text import plain_numbers
from updyn.io.items import format_key
from updyn.io.pulse_text import isolate_rows
from updyn.io.settings import FILE_TEXT, MATRIX_FILE
from updyn.io.text_numbers import parse_real
from updyn.units import find_ratio, find_unit, strip_brackets

__all__ = ["SEPARATORS", "Line", "TextTable", "find_table", "format_cell"]

#: A line of a text: its number from 1 and its content.
Line = tuple[int, str]

#: The separators and their names.
SEPARATORS = {";": "semicolons", "\t": "tabs", ",": "commas", " ": "blanks"}
_COMPLEX = re.compile(r"(.*[0-9.])\s*([+-])\s*([^+-]*(?:[eEdD][+-]?[0-9]+)?)\s*\*?\s*[ij]")
_BRACKET = re.compile(r"\[([^\[\]]*)\]|\(([^()]*(?:\([^()]*\)[^()]*)?)\)")
_BEFORE_ENDING = re.compile(r"(?<=\S)[ _/]+")
_SIGNS = ("db", "deg", "rad", "°")
_PLAIN_UNITS = (*_SIGNS, "degree", "degrees", "grad", "-", "1", "%", *OTHER_ANGLES)

#: Units of channels that are not converted, such as a voltage or "engineering units".
_OTHER_UNITS = ("V", "mV", "EU", "Pa")


@dataclass(frozen=True, slots=True)
class TextTable:
    """A table of a text file; `header` and `units` are empty, or have one text per column."""

    path: str | Path
    separator: str
    header: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[tuple[int, tuple[str, ...]], ...]
    preamble: tuple[Line, ...]

    @property
    def n_columns(self) -> int:
        """Number of columns."""
        return len(self.rows[0][1])

    def column(self, name: object, key: Key) -> int:
        """Return the position of a column, from its name in the header or its number from 1."""
        if isinstance(name, int) and not isinstance(name, bool):
            if not 1 <= name <= self.n_columns:
                raise FormatError(
                    f"no column {name}; the table has {self.n_columns}: {self.format_columns()}",
                    self.path,
                    key=key,
                )
            return name - 1
        if not isinstance(name, str):
            raise OptionError(
                f"{format_key(key)} = {name!r}: expected the name or the number of a column",
                key=key,
            )
        if self.header.count(name) > 1:
            at = [str(i) for i, cell in enumerate(self.header, 1) if cell == name]
            raise FormatError(
                f"column {name!r} occurs {len(at)} times; state its number: {' or '.join(at)}",
                self.path,
                key=key,
            )
        if name not in self.header:
            found = suggest(name, [cell for cell in self.header if cell])
            if not self.header:
                found = "the table has no header; state numbers of columns"
            raise FormatError(
                f"no column {name!r}; {found}; columns: {self.format_columns()}",
                self.path,
                key=key,
            )
        return self.header.index(name)

    def numbers(self, name: Any, key: Key, *, is_complex: bool = False) -> NumberArray:
        """Return the numbers of a column."""
        at = self.column(name, key)
        read = _parse_complex if is_complex else parse_real
        out = np.empty(len(self.rows), dtype=np.complex128 if is_complex else np.float64)
        for i, (line, cells) in enumerate(self.rows):
            if len(cells) != self.n_columns:
                raise FormatError(
                    f"{len(cells)} cell(s); expected {self.n_columns}", self.path, line
                )
            try:
                out[i] = read(cells[at])
            except ValueError as error:
                hint = "; a comma may separate thousands here" if "," in cells[at] else ""
                raise FormatError(
                    f"{self._describe_column(at)}: {format_cell(cells[at])!r} is not a"
                    f" {'complex ' if is_complex else ''}number{hint}",
                    self.path,
                    line,
                    key=key,
                ) from error
        return out

    def unit(self, name: Any) -> str:
        """Return the unit of a column in the line of units or the header, or an empty text."""
        at = self.column(name, ())
        if self.units and self.units[at]:
            return strip_brackets(self.units[at])
        return _find_label(self.header[at]) if self.header else ""

    def is_complex(self, at: int) -> bool:
        """Return whether the first value of a column is a complex number, such as ``1+2i``."""
        cell = self.rows[0][1][at]
        return _is_number(cell) and _COMPLEX.fullmatch(_strip_brackets(cell)) is not None

    def title(self, name: Any) -> str:
        """Return the name of a column in the header, or an empty text."""
        return self.header[self.column(name, ())] if self.header else ""

    def line(self, index: int) -> int:
        """Return the line of the file of a row."""
        return self.rows[index][0]

    def format_columns(self) -> str:
        """Return the names or numbers of the columns with their first values, for messages."""
        texts = []
        for at, cell in enumerate(self.rows[0][1][: FILE_TEXT.listed_columns]):
            name = f"{at + 1} {self.header[at]!r}" if self.header else f"{at + 1}"
            texts.append(f"{name} ({format_cell(cell)})")
        more = ", ..." if self.n_columns > len(texts) else ""
        return ", ".join(texts) + more

    def _describe_column(self, at: int) -> str:
        return f"column {self.header[at]!r}" if self.header else f"column {at + 1}"


def find_table(
    text: str, path: str | Path, separator: str | None = None, first_row: int | None = None
) -> TextTable | None:
    """Return the table of a text with line feeds; None if no two lines look like rows.

    `separator` is one of `SEPARATORS`, `first_row` the number of the first line with numbers; by
    default both are found.
    """
    text = isolate_rows(text, path)
    lines = [(n, line) for n, line in enumerate(text.split("\n"), 1) if line.strip()]
    plain = [line for line in lines if not _is_comment(line[1]) and line[0] >= (first_row or 1)]
    separators = tuple(SEPARATORS) if separator is None else (separator,)
    shape = _find_shape([line for _, line in plain[-MATRIX_FILE.sampled_rows :]], separators)
    if shape is None:
        return None
    if first_row is not None:
        is_row = shape.fits(plain[0][1])
        return _build_table(lines, plain, shape.separator, path, is_stated=True) if is_row else None
    for i, (_, line) in enumerate(plain):
        if shape.fits(line):
            return _build_table(lines, plain[i:], shape.separator, path)
    return None


@dataclass(frozen=True, slots=True)
class _Shape:
    """The separator of rows, and their numbers of cells and of cells with a number."""

    separator: str
    width: int
    n_numbers: int

    def fits(self, line: str) -> bool:
        """Return whether a line is a row; cells of rows may be empty or texts."""
        cells = _split_numbers(line, self.separator)
        numbers = sum(map(_is_number, cells))
        if len(cells) != self.width:
            return False
        return numbers == self.n_numbers or (numbers >= 2 and _is_number(cells[0]))


def _find_shape(lines: Sequence[str], separators: Sequence[str]) -> _Shape | None:
    """Return the shape of most lines, with the separator that gives the most numbers per cell."""
    found: list[_Shape] = []
    for separator in separators:
        shapes: Counter[tuple[int, int]] = Counter()
        for line in lines:
            cells = _split_numbers(line, separator)
            n_numbers = sum(map(_is_number, cells))
            if n_numbers >= 2:
                shapes[len(cells), n_numbers] += 1
        for (width, n_numbers), times in shapes.most_common(1):
            if times >= 2:
                found.append(_Shape(separator, width, n_numbers))
    return max(found, key=lambda shape: shape.n_numbers / shape.width, default=None)


def _split_numbers(line: str, separator: str) -> tuple[str, ...]:
    """Return the cells of a line, in which commas may be decimal commas."""
    return _split(line if separator == "," else line.replace(",", "."), separator)


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(("#", "%"))


def _split(line: str, separator: str) -> tuple[str, ...]:
    cells = line.split() if separator == " " else line.split(separator)
    return tuple(cell.strip().strip('"').strip() for cell in cells)


def _split_header(line: str, separator: str) -> tuple[str, ...]:
    """Return the cells of a header, in which commas in brackets do not separate."""
    if '"' in line and separator != " ":
        (parts,) = csv.reader([line], delimiter=separator)
        return tuple(cell.strip() for cell in parts)
    if separator == ",":
        parts = re.split(r",(?![^(\[]*[)\]])", line)
        return tuple(cell.strip().strip('"').strip() for cell in parts)
    if separator == " ":  # names may contain single blanks
        parts = re.split(r"\s{2,}|\t|;|,", line.strip())
        if len(parts) > 1:
            return tuple(cell.strip().strip('"').strip() for cell in parts)
    return _split(line, separator)


def _is_number(cell: str) -> bool:
    if cell.lstrip("+-").casefold() in ("nan", "inf"):
        return True
    try:
        _parse_complex(cell)
    except ValueError:
        return False
    return True


def _strip_brackets(cell: str) -> str:
    return cell.strip().removeprefix("(").removesuffix(")").strip()


def format_cell(cell: str) -> str:
    """Return a cell for messages and forms, a number with six digits."""
    try:
        return f"{parse_real(cell):.6g}"
    except ValueError:
        return cell[: FILE_TEXT.quoted_characters]


def _parse_complex(cell: str) -> complex:
    """Return the number in a text such as ``1.5-2e-3i``; raise a ValueError for another text."""
    text = _strip_brackets(cell)
    found = _COMPLEX.fullmatch(text)
    if found is None:
        return complex(parse_real(text))
    return complex(parse_real(found[1]), float(f"{found[2]}1") * parse_real(found[3]))


def _build_table(
    lines: Sequence[Line],
    body: Sequence[Line],
    separator: str,
    path: str | Path,
    *,
    is_stated: bool = False,
) -> TextTable:
    """Return the table whose rows are `body`; `is_stated`: the user states the first row."""
    numbers = plain_numbers("\n".join(line for _, line in body), separator).split("\n")
    rows = tuple(
        (number, _split(row, separator)) for (number, _), row in zip(body, numbers, strict=True)
    )
    if separator != "," and any("," in row for row in numbers):
        rows = _replace_decimal_commas(rows, separator)
    if all(len(cells) == len(rows[0][1]) and not cells[-1] for _, cells in rows):
        rows = tuple((number, cells[:-1]) for number, cells in rows)  # a separator ends each row
    width = len(rows[0][1])
    above = [line for line in lines if line[0] < rows[0][0]]
    header: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    if above:
        cells = _cells_of(above[-1][1], separator, width)
        if len(above) > 1 and cells and all(map(_is_unit, cells)):
            units = cells
            above.pop()
            if len(above) > 1 and above[-1][1].strip().endswith(":"):  # the title of the units
                above.pop()
            cells = _cells_of(above[-1][1], separator, width)
        over = _cells_of(above[-2][1], separator, width) if len(above) > 1 else ()
        if not is_stated:
            _refuse_row(above[-1], separator, width, bool(over), path)
        if cells:
            above.pop()
            higher = [found for _, line in above if (found := _cells_of(line, separator, width))]
            header = _qualify_names(cells, higher)
            units = units or _find_axis_units(higher)
    return TextTable(path, separator, header, units, rows, tuple(above))


def _qualify_names(names: tuple[str, ...], above: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """Return names that repeat with those of a line above, such as ``FRF`` before ``Magnitude``."""
    # A name above holds for the following columns up to the next one. Names are unchanged if no
    # line makes them unique.
    if len(set(names)) == len(names):
        return names
    for over in reversed(above):
        if any(map(_is_number, over)):
            continue
        qualified = [names[0]]
        last = ""
        for cell, name in zip(over[1:], names[1:], strict=True):
            last = cell or last
            qualified.append(f"{last} {name}".strip())
        if len(set(qualified)) == len(qualified):
            return tuple(qualified)
    return names


def _find_axis_units(above: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """Return the units by column from lines named axis units, as in text of QuickDAQ."""
    axes = {cells[0].casefold(): cells[1:] for cells in above}
    if "y axis units" not in axes:
        return ()
    abscissa = {cell for cell in axes.get("x axis units", ()) if cell}
    return (abscissa.pop() if len(abscissa) == 1 else "", *axes["y axis units"])


def _replace_decimal_commas(
    rows: tuple[tuple[int, tuple[str, ...]], ...], separator: str
) -> tuple[tuple[int, tuple[str, ...]], ...]:
    """Return rows with decimal points, if the cells with numbers show that commas are decimal."""
    # Points in other cells, such as dates, do not count.
    numbers = [c for _, cells in rows for c in cells if _is_number(c.replace(",", "."))]
    if "," in plain_numbers(separator.join(numbers), separator):
        return rows
    return tuple((line, tuple(c.replace(",", ".") for c in cells)) for line, cells in rows)


def _cells_of(line: str, separator: str, width: int) -> tuple[str, ...]:
    """Return the cells of a line above the rows; none if it has another number of cells."""
    text = line.strip().lstrip("#%").strip() if _is_comment(line) else line
    cells = _split_header(text, separator)
    if len(cells) > width and not any(cells[width:]):
        cells = cells[:width]
    return cells if len(cells) == width else ()


def _refuse_row(line: Line, separator: str, width: int, has_header: bool, path: str | Path) -> None:
    """Refuse the line above the rows if it is a damaged row and not a header."""
    if _is_comment(line[1]):
        return
    cells = _split_numbers(line[1], separator)
    numbers = [cell for cell in cells if _is_number(cell)]
    is_row = _is_number(cells[0]) or has_header or any("." in cell for cell in numbers)
    if len(numbers) >= 2 and is_row:
        raise FormatError(
            f"{line[1].strip()[: FILE_TEXT.quoted_characters]!r} has {len(numbers)} numbers in"
            f" {len(cells)} cell(s); expected {width} cells, as in the rows below",
            path,
            line[0],
        )


def _is_unit(cell: str) -> bool:
    """Return whether a cell of a line of units is empty or a unit."""
    label = strip_brackets(cell)
    return not label or _names_unit(label)


def _names_unit(label: str) -> bool:
    if label.casefold() in _PLAIN_UNITS or "db" in label.casefold().split():
        return True
    if label in _OTHER_UNITS:
        return True
    if find_ratio(label) or find_unit(label) or find_unit(label, "frequency", "time", "length"):
        return True
    # Units of other quantities, such as (m/s^2)/V, but not pairs such as 3/1 or 3:Z/1:Z
    return "/" in label and ":" not in label and not label[:1].isdigit()


def _find_label(cell: str) -> str:
    """Return the unit in a cell of the header, or an empty text."""
    in_brackets = [str(one[1] or one[2] or "").strip() for one in _BRACKET.finditer(cell)]
    if in_brackets and cell.rstrip()[-1:] in ("]", ")") and _names_unit(in_brackets[-1]):
        return in_brackets[-1]
    if find_unit(cell, "frequency"):
        return cell
    # The longest ending is first, because a unit may contain a separator (g/N). A unit may also
    # precede a label in brackets, or be in brackets before a label.
    texts = (cell, _BRACKET.sub("", cell).strip())
    endings = [text[sign.end() :] for text in texts for sign in _BEFORE_ENDING.finditer(text)]
    return next(filter(_is_known_unit, (*endings, *in_brackets)), "")


def _is_known_unit(label: str) -> bool:
    """Return whether a text is a unit of FRFs, of frequencies or of phases, or decibels."""
    known = find_ratio(label) or find_unit(label, "frequency")
    return bool(known) or label.casefold() in _SIGNS or "db" in label.casefold().split()
