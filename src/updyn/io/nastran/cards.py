"""Bulk data as cards: small, large and free fields, continuations, INCLUDE, comments.

Numbers are read and written as Nastran does: exponents with D or without a letter (``1.5-3``), in 8
or 16 characters. No card is known here by name.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from updyn.errors import FormatError
from updyn.foreign.confinement import check_inside
from updyn.io.items import is_file, nearest, unreadable
from updyn.io.text_numbers import check_last_line, whole_of

__all__ = [
    "Card",
    "Line",
    "lines_of",
    "parse",
    "real",
    "text_of",
]

_PLAIN = 8  # characters up to which 0.001 is preferred to 1.-3
_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+))(?:[EeDd]?([+-]\d+)|[EeDd](\d+))?")


def real(cell: str) -> float:
    """Read a number.

    Raises
    ------
    ValueError
        If the text is not a number.
    """
    found = _NUMBER.fullmatch(cell.strip())
    if found is None:
        raise ValueError(f"{cell!r} is not a number")
    number = float(f"{found[1]}e{found[2] or found[3] or 0}")
    if math.isinf(number):
        raise ValueError(f"{cell!r} is too large a number")
    return number


def text_of(value: float, width: int = 16) -> str:
    """Write a number with a decimal point in at most `width` characters, as many digits as fit.

    Raises
    ------
    ValueError
        If the number is not finite.
    """
    if not math.isfinite(value):
        raise ValueError(f"{value!r} has no text in a deck")
    mantissa = repr(float(value)).split("e")[0]
    significant = len(mantissa.strip("-0.").replace(".", "").rstrip("0"))
    for digits in range(max(significant, 1), 0, -1):
        scientific = f"{value:.{digits - 1}e}"
        plain = _with_point(repr(float(scientific)))
        if len(plain) <= min(width, _PLAIN):
            return plain
        short = _with_point(scientific)
        if len(short) <= width:
            return short
    raise ValueError(f"{value!r} does not fit {width} characters")


def _with_point(text: str) -> str:
    """Write a number as a deck has it: with a point, and an exponent without letter and zeros."""
    mantissa, _, exponent = text.partition("e")
    if "." not in mantissa:
        mantissa += "."
    if exponent:
        mantissa += f"{int(exponent):+d}"
    return mantissa


_NAME = re.compile(r"[A-Za-z][A-Za-z0-9]{0,7}")
#: Last lines that need no line break.
_ENDS = re.compile(rb"(?:\$.*|ENDDATA.*)?", re.IGNORECASE)
_INCLUDE = re.compile(r"\s*INCLUDE(?=[\s'\"])", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Line:
    """One line of a deck, without comment and trailing blanks, and where it stands.

    What stands in a binary file has no number.
    """

    text: str
    path: Path
    number: int | None

    @property
    def place(self) -> str:
        """File and line, for a message."""
        return self.path.name if self.number is None else f"{self.path.name}:{self.number}"

    def error(self, message: str) -> FormatError:
        """Return an error at this line."""
        return FormatError(message, self.path, self.number)


@dataclass(frozen=True, slots=True)
class Card:
    """One bulk data entry.

    Parameters
    ----------
    name : str
        Upper case, without the asterisk of large fields.
    fields : tuple of str
        What stands behind the name, eight a line, stripped; trailing empty ones left out.
        `fields[0]` is field 2 of the manuals.
    lines : tuple of Line
        The lines it stands on.
    """

    name: str
    fields: tuple[str, ...]
    lines: tuple[Line, ...]

    def error(self, message: str) -> FormatError:
        """Return an error at the line where the card starts."""
        return self.lines[0].error(message)

    def text(self, at: int, default: str = "") -> str:
        """Return a field, counted from 0 behind the name, in upper case; `default` if empty."""
        if at >= len(self.fields):
            return default
        return self.fields[at].upper() or default

    def filled(self, fields: Iterable[int]) -> tuple[int, ...]:
        """Return those of some fields that are not empty."""
        return tuple(at for at in fields if self.text(at))

    def integer(self, at: int, default: int | None = None) -> int:
        """Return a field as a whole number.

        Raises
        ------
        FormatError
            If it is not one, or empty without a default.
        """
        found = self.text(at)
        if not found and default is not None:
            return default
        try:
            return whole_of(found)
        except ValueError as error:
            raise self.error(
                f"{self.name}: field {at + 2} is {found!r}; expected a whole number"
            ) from error

    def real(self, at: int, default: float | None = None) -> float:
        """Return a field as a number.

        Raises
        ------
        FormatError
            If it is not one, or empty without a default.
        """
        found = self.text(at)
        if not found and default is not None:
            return default
        try:
            return real(found)
        except ValueError as error:
            raise self.error(
                f"{self.name}: field {at + 2} is {found!r}; expected a number"
            ) from error

    def integers(self, fields: Iterable[int]) -> list[int]:
        """Return some fields as whole numbers; errors as `integer`."""
        return [self.integer(at) for at in fields]

    def reals(self, fields: Iterable[int], default: float | None = None) -> list[float]:
        """Return some fields as numbers; errors as `real`."""
        return [self.real(at, default) for at in fields]

    def with_fields(self, changes: dict[int, str]) -> Card:
        """Return a copy with fields replaced; positions as in `text`."""
        fields = [*self.fields, *[""] * (max(changes, default=0) + 1 - len(self.fields))]
        for at, text in changes.items():
            fields[at] = text
        return replace(self, fields=tuple(fields))

    def large(self) -> str:
        """Return the card in large fields, to be written."""
        # Some readers always want both lines of eight fields.
        missing = -len(self.fields) % 8 if self.fields else 8
        fields = [*self.fields, *[""] * missing]
        head = self.name + "*"
        out = ""
        for start in range(0, len(fields), 4):
            row = "".join(cell.rjust(16) for cell in fields[start : start + 4])
            out += (head.ljust(8) + row).rstrip() + "\n"
            head = "*"
        return out


def lines_of(path: Path, within: tuple[Path, ...] = ()) -> Iterator[Line]:
    """Yield the lines of a deck, INCLUDE files put in, comments and empty lines left out.

    Raises
    ------
    FormatError
        If an included file is not there, or includes itself.
    """
    try:
        text = path.read_text(encoding="latin-1")
    except OSError as error:
        raise unreadable(path, error) from error
    check_last_line(text, path, harmless=_ENDS)
    rest = iter(enumerate(text.splitlines(), 1))
    for number, raw in rest:
        line = Line(raw.split("$")[0].rstrip().expandtabs(8), path, number)
        if not line.text:
            continue
        if _INCLUDE.match(line.text) is None:
            yield line
            continue
        name = line.text.strip()[len("INCLUDE") :].strip()
        quote = name[0]
        if quote in "'\"":
            while name.count(quote) < 2:  # a long name goes on in the next line
                name += next(rest, (0, quote))[1].strip()
            name = name.split(quote)[1]
        target = _target(line, name.strip())
        if target.resolve() in [outer.resolve() for outer in (*within, path)]:
            raise line.error(f"INCLUDE {name!r}: the file includes itself")
        yield from lines_of(target, (*within, path))


def _target(line: Line, name: str) -> Path:
    # Decks written on Windows name folders with backslashes.
    target = line.path.parent / name.replace("\\", "/")
    check_inside(target)
    if is_file(target):
        return target
    raise line.error(f"INCLUDE: no such file {name!r}; {nearest(target)}")


@dataclass(slots=True)
class _Open:
    """A card whose lines are being read."""

    name: str
    fields: list[str] = field(default_factory=list)
    lines: list[Line] = field(default_factory=list)
    mark: str = ""  # of the continuation, as the last line has it

    def card(self) -> Card:
        while self.fields and not self.fields[-1]:
            self.fields.pop()
        return Card(self.name, tuple(self.fields), tuple(self.lines))


def parse(lines: Iterator[Line]) -> Iterator[Card]:
    """Yield the cards of bulk data.

    Raises
    ------
    FormatError
        If a line is neither a card nor the continuation of the one before it.
    """
    held: _Open | None = None
    for line in lines:
        first = line.text[:8]
        if "," in line.text:
            first = line.text.split(",")[0]
        mark = first.strip()
        continues = not mark or mark[0] in "+*"
        if not continues:
            if held is not None:
                yield held.card()
            name = mark.rstrip("*")
            if _NAME.fullmatch(name) is None:
                raise line.error(
                    f"{line.text.strip()[:40]!r}; expected the name of a card, or a continuation"
                )
            held = _Open(name.upper())
        elif held is None:
            raise line.error("a continuation without a card before it")
        data, tail, width = _data(line)
        if continues:
            _check_order(line, held.mark, mark)
            held.fields += [""] * (-len(held.fields) % width)
        held.fields += data
        held.lines.append(line)
        held.mark = tail
    if held is not None:
        yield held.card()


def _data(line: Line) -> tuple[list[str], str, int]:
    """Return the data fields of a line, its mark for the continuation, and their number."""
    if "," in line.text:
        cells, tail, n = _free_fields(line)
    else:
        cells, tail, n = _fixed_fields(line)
    return cells + [""] * (n - len(cells)), tail, n


def _free_fields(line: Line) -> tuple[list[str], str, int]:
    """Return the cells of a line with commas, its continuation mark, and the number of fields."""
    cells = [cell.strip() for cell in line.text.split(",")]
    is_large = cells[0].startswith("*") or cells[0].endswith("*")
    n = 4 if is_large else 8
    if len(cells) > n + 2:
        raise line.error(f"{len(cells)} fields; at most {n + 2} stand on a line")
    tail = ""
    if len(cells) == n + 2:
        tail = cells[n + 1]
    if tail and _is_number(tail) and tail[0] not in "+*":
        raise line.error(
            f"{tail!r} in field {n + 2}; at most {n} data fields stand on a line, then a"
            " continuation"
        )
    cells = cells[1 : n + 1]
    if not tail and cells and cells[-1][:1] in ("+", "*") and not _is_number(cells[-1]):
        tail = cells.pop()  # the mark may stand right behind the last field that is there
    return cells, tail, n


def _fixed_fields(line: Line) -> tuple[list[str], str, int]:
    """Return the cells of a line in columns, its continuation mark, and the number of fields."""
    text = line.text
    if len(text) > 80:
        raise line.error(f"{len(text)} characters; a line has at most 80, comments after $ apart")
    is_large = text[:1] == "*" or text[:8].rstrip().endswith("*")
    width = 16 if is_large else 8
    cells = [text[start : start + width].strip() for start in range(8, 72, width)]
    return cells, text[72:80].strip(), len(cells)


def _is_number(cell: str) -> bool:
    try:
        real(cell)
    except ValueError:
        return False
    return True


def _check_order(line: Line, expected: str, mark: str) -> None:
    wanted = expected.strip("+* ")
    found = mark.strip("+* ")
    if wanted and found and wanted.upper() != found.upper():
        raise line.error(
            f"continuation {mark!r} follows a line that goes on at {expected!r}; sort the deck"
        )
