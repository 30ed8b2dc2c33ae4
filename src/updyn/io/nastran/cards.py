"""Numbers as Nastran writes them: exponents with D or without a letter (``1.5-3``), in 8 or 16 characters."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from updyn.errors import FormatError, suggest

__all__ = [
    "Card",
    "Line",
    "lines_of",
    "parse",
    "real",
    "text_of",
]

_PLAIN = 8  # characters up to which 0.001 is nicer than 1.-3
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
    if value != value or value in (float("inf"), float("-inf")):
        raise ValueError(f"{value!r} has no text in a deck")
    significant = (
        len(repr(float(value)).split("e")[0].strip("-0.").replace(".", "").rstrip("0")) or 1
    )
    for digits in range(max(significant, 1), 0, -1):
        scientific = f"{value:.{digits - 1}e}"
        plain = _with_point(repr(float(scientific)))
        if len(plain) <= min(width, _PLAIN):
            return plain
        if len(short := _with_point(scientific)) <= width:
            return short
    raise ValueError(f"{value!r} does not fit {width} characters")


def _with_point(text: str) -> str:
    """Write a number as a deck has it: with a point, and an exponent without letter and zeros."""
    mantissa, _, exponent = text.partition("e")
    if "." not in mantissa:
        mantissa += "."
    return mantissa + (f"{int(exponent):+d}" if exponent else "")


_NAME = re.compile(r"[A-Za-z][A-Za-z0-9]{0,7}")
_INCLUDE = re.compile(r"\s*INCLUDE(?=[\s'\"])", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Line:
    """One line of a deck, without comment and trailing blanks, and where it stands."""

    text: str
    path: Path
    number: int

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
        """Return a field (counted from 0, behind the name), upper case; `default` where it is empty."""
        return (self.fields[at].upper() if at < len(self.fields) else "") or default

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
            return int(found)
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

    def with_fields(self, changes: dict[int, str]) -> Card:
        """Return a copy with fields replaced; positions as in `text`."""
        fields = [*self.fields, *[""] * (max(changes, default=0) + 1 - len(self.fields))]
        for at, text in changes.items():
            fields[at] = text
        return replace(self, fields=tuple(fields))

    def large(self) -> str:
        """Return the card in large fields, to be written."""
        fields = list(self.fields) + [""] * (-len(self.fields) % 4)
        rows = [fields[i : i + 4] for i in range(0, len(fields), 4)] or [[""] * 4]
        if len(rows) % 2:  # some readers want the two lines of eight fields, always
            rows.append([""] * 4)
        heads = [f"{self.name + '*':<8}", *["*       "] * (len(rows) - 1)]
        return "".join(
            (head + "".join(f"{c:>16}" for c in row)).rstrip() + "\n"
            for head, row in zip(heads, rows, strict=True)
        )


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
        raise FormatError(f"cannot be read: {error.strerror}", path) from error
    rest = iter(enumerate(text.splitlines(), 1))
    for number, raw in rest:
        line = Line(raw.split("$")[0].rstrip().expandtabs(8), path, number)
        if not line.text:
            continue
        if _INCLUDE.match(line.text) is None:
            yield line
            continue
        name = line.text.split(None, 1)[1] if " " in line.text.strip() else line.text.strip()[7:]
        quote = name[0]
        if quote in "'\"":
            while name.count(quote) < 2:  # a long name goes on in the next line
                name += next(rest, (0, quote))[1].strip()
            name = name.split(quote)[1]
        target = _target(line, name.strip())
        if target.resolve() in {p.resolve() for p in (*within, path)}:
            raise line.error(f"INCLUDE {name!r}: the file includes itself")
        yield from lines_of(target, (*within, path))


def _target(line: Line, name: str) -> Path:
    # Decks written on Windows name folders with backslashes.
    target = line.path.parent / name.replace("\\", "/")
    if target.is_file():
        return target
    near = (
        sorted(p.name for p in target.parent.iterdir() if p.is_file())
        if target.parent.is_dir()
        else []
    )
    raise line.error(
        f"INCLUDE: no such file {name!r}; "
        + (suggest(target.name, near) if near else "its folder is not there")
    )


def parse(lines: Iterator[Line]) -> Iterator[Card]:
    """Yield the cards of bulk data.

    Raises
    ------
    FormatError
        If a line is neither a card nor the continuation of the one before it.
    """
    held: dict[str, Any] | None = None
    for line in lines:
        first = line.text[:8] if "," not in line.text else line.text.split(",")[0]
        mark = first.strip()
        continues = not mark or mark[0] in "+*"
        if not continues:
            if held is not None:
                yield _card(held)
            name = mark.rstrip("*")
            if _NAME.fullmatch(name) is None:
                raise line.error(
                    f"{line.text.strip()[:40]!r}; expected the name of a card, or a continuation"
                )
            held = {"name": name.upper(), "fields": [], "lines": [], "next": ""}
        elif held is None:
            raise line.error("a continuation without a card before it")
        data, tail, large = _data(line)
        if continues:
            _check_order(line, held["next"], mark)
            held["fields"] += [""] * (-len(held["fields"]) % (4 if large else 8))
        held["fields"] += data
        held["lines"].append(line)
        held["next"] = tail
    if held is not None:
        yield _card(held)


def _data(line: Line) -> tuple[list[str], str, bool]:
    """Return the data fields of a line, its mark for the continuation, and whether fields are large."""
    text = line.text
    if "," in text:
        cells = [c.strip() for c in text.split(",")]
        large = cells[0].startswith("*") or cells[0].endswith("*")
        n = 4 if large else 8
        if len(cells) > n + 2:
            raise line.error(f"{len(cells)} fields; at most {n + 2} stand on a line")
        tail = cells[n + 1] if len(cells) == n + 2 else ""
        if tail and _is_number(tail) and tail[0] not in "+*":
            raise line.error(
                f"{tail!r} in field {n + 2}; at most {n} data fields stand on a line, then a"
                " continuation"
            )
        cells = cells[1 : n + 1]
        if not tail and cells and cells[-1][:1] in ("+", "*") and not _is_number(cells[-1]):
            tail = cells.pop()  # the mark may stand right behind the last field that is there
    else:
        large = text[:1] == "*" or text[:8].rstrip().endswith("*")
        width, n = (16, 4) if large else (8, 8)
        if len(text) > 80:
            raise line.error(
                f"{len(text)} characters; a line has at most 80, comments after $ apart"
            )
        cells = [text[8 + i * width : 8 + (i + 1) * width].strip() for i in range(n)]
        tail = text[72:80].strip()
    return cells + [""] * (n - len(cells)), tail, large


def _is_number(cell: str) -> bool:
    try:
        real(cell)
    except ValueError:
        return False
    return True


def _check_order(line: Line, expected: str, mark: str) -> None:
    wanted, found = expected.strip("+* "), mark.strip("+* ")
    if wanted and found and wanted.upper() != found.upper():
        raise line.error(
            f"continuation {mark!r} follows a line that goes on at {expected!r}; sort the deck"
        )


def _card(held: dict[str, Any]) -> Card:
    fields = held["fields"]
    while fields and not fields[-1]:
        fields.pop()
    return Card(held["name"], tuple(fields), tuple(held["lines"]))
