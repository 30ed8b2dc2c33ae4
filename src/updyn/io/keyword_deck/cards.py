"""Input decks of the keyword family (CalculiX, Abaqus) as cards, with their files and lines.

A card is a line that starts with ``*``, with parameters between commas, and the data lines below
it. ``**`` starts a comment. Case and blanks do not matter, a keyword line that ends with a comma
goes on in the next line, and ``*INCLUDE, INPUT=file`` is replaced by what is in that file, as is
``INPUT=file`` of nodes, elements and sets.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from updyn.errors import FormatError, suggest
from updyn.foreign.confinement import check_inside
from updyn.io.inclusion import DEEPEST, Inclusions
from updyn.io.items import is_file, nearest, unreadable
from updyn.io.text_numbers import check_last_line, real_of, whole_of

__all__ = ["Card", "Row", "number", "read_cards", "short_number", "whole"]

#: Both programs read the first twenty characters of a field; CalculiX drops what follows without a
#: word.
FIELD_WIDTH = 20
#: Last lines that need no line break: a comment, the end of a step or of an assembly.
_ENDS = re.compile(rb"(?:\*\*.*|\*END [A-Z]{4,})?", re.IGNORECASE)
#: Keywords whose data lines Abaqus may read from another file, INPUT=.
_DATA_ELSEWHERE = ("NODE", "ELEMENT", "NSET", "ELSET", "EQUATION", "BOUNDARY")


@dataclass(frozen=True, slots=True)
class Row:
    """A data line.

    Parameters
    ----------
    line : int
        Where it stands in its file.
    text : str
        As it is written.
    path : Path, optional
        The file, where it is not that of its keyword.
    """

    line: int
    text: str
    path: Path | None = None

    @property
    def fields(self) -> list[str]:
        """The texts between the commas, stripped; a comma at the end starts no further one."""
        found = [part.strip() for part in self.text.split(",")]
        if len(found) > 1 and not found[-1]:
            found.pop()
        return found


@dataclass(frozen=True, slots=True)
class Card:
    """A keyword with its parameters and data lines.

    Parameters
    ----------
    name : str
        The keyword in capitals, one blank between its words, without the star.
    parameters : mapping of str to str
        By name in capitals; the value as written, empty where there is none.
    rows : tuple of Row
        The data lines, without comments and empty lines.
    path : Path
        The file it stands in.
    line : int
        The line of the keyword.
    """

    name: str
    parameters: Mapping[str, str]
    rows: tuple[Row, ...]
    path: Path
    line: int

    def get(self, parameter: str) -> str | None:
        """Return a parameter as it is written, or None."""
        return self.parameters.get(parameter)

    def need(self, parameter: str) -> str:
        """Return a parameter that has to be there.

        Raises
        ------
        FormatError
            If it is not, or has no value.
        """
        if not self.parameters.get(parameter):
            message = f"*{self.name} has no {parameter}="
            if self.parameters:
                message += f"; {suggest(parameter, self.parameters)}"
            raise self.error(message)
        return self.parameters[parameter]

    def only(self, *known: str) -> None:
        """Refuse parameters that are not known: each of them changes what the card means.

        Raises
        ------
        FormatError
            If there is another; the nearest known one is named.
        """
        for name in self.parameters:
            if name not in known:
                raise self.error(
                    f"*{self.name}: parameter {name!r} is not read; {suggest(name, known)}"
                )

    def error(self, message: str, row: Row | None = None) -> FormatError:
        """Return an error that names file and line: of the row, else of the keyword."""
        if row is None:
            return FormatError(message, self.path, self.line)
        return FormatError(message, row.path or self.path, row.line)

    def text(self) -> list[str]:
        """Return the card as lines of a deck."""
        head = f"*{self.name}"
        for name, value in self.parameters.items():
            head += f", {name}={value}" if value else f", {name}"
        return [head, *(row.text for row in self.rows)]


def read_cards(path: str | Path) -> list[Card]:
    """Read a deck and all files that it includes.

    Parameters
    ----------
    path : path
        The deck. Names of included files are relative to the folder it stands in.

    Returns
    -------
    list of Card
        In order.

    Raises
    ------
    FormatError
        If a file is missing, includes itself or is not a text, or data stand before the first
        keyword; the message says file and line.
    """
    path = Path(path)
    inclusions = Inclusions()
    return _grouped(_lines(path, _source(path), path.parent, (), inclusions), path)


def _lines(
    path: Path, lines: list[str], folder: Path, within: tuple[Path, ...], inclusions: Inclusions
) -> Iterator[tuple[Path, int, str]]:
    """Yield file, line number and text of every line that is no comment.

    Included files stand in their place, and keyword lines that continue are joined.
    """
    joined = ""
    start = 0
    for at, line in enumerate(lines, 1):
        text = line.strip()
        if not text or text.startswith("**"):
            continue
        if joined:
            joined += " " + text
        elif text.startswith("*"):
            joined, start = text, at
        else:
            yield path, at, text
            continue
        if joined.endswith(","):
            continue
        name = _name(joined)
        given = _parameters(joined).get("INPUT", "")
        if name != "INCLUDE":
            yield path, start, joined
        joined = ""
        if name == "INCLUDE" or (given and name in _DATA_ELSEWHERE):
            inner = _included(name, given, path, start, folder)
            chain = (*within, path)
            if inner.resolve() in [p.resolve() for p in chain]:
                raise FormatError(
                    f"*{name}, INPUT={inner.name}: the file includes itself", path, start
                )
            if len(chain) > DEEPEST:
                raise FormatError(
                    f"*{name}, INPUT={inner.name}: files include files {DEEPEST} deep; expected"
                    " less",
                    path,
                    start,
                )
            source = _source(inner)
            excess = inclusions.excess(inner.resolve(), len(source))
            if excess is not None:
                raise FormatError(f"*{name}, INPUT={inner.name}: {excess}", path, start)
            yield from _lines(inner, source, folder, chain, inclusions)
    if joined:
        raise FormatError(
            f"the keyword line ends with a comma and the file ends there: {joined!r}", path, start
        )


def _source(path: Path) -> list[str]:
    """Return the lines of a file."""
    text = _text(path)
    check_last_line(text, path, harmless=_ENDS)
    return text.splitlines()


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        # Older preprocessors write headings and comments in the code page of their machine.
        text = path.read_text(encoding="latin-1")
        if "\0" in text:
            raise FormatError("not an input deck: the file is binary", path) from None
        return text
    except OSError as error:
        raise unreadable(path, error) from error


def _included(name: str, given: str, path: Path, at: int, folder: Path) -> Path:
    if not given:
        raise FormatError("*INCLUDE has no INPUT=", path, at)
    inner = folder / given
    check_inside(inner)
    if not is_file(inner):
        raise FormatError(f"*{name}: no such file {given!r}; {nearest(inner)}", path, at)
    return inner


def _grouped(lines: Iterator[tuple[Path, int, str]], deck: Path) -> list[Card]:
    cards: list[Card] = []
    head: tuple[Path, int, str] | None = None
    rows: list[Row] = []
    for path, at, text in lines:
        if text.startswith("*"):
            if head is not None:
                cards.append(_card(head, rows))
            head = (path, at, text)
            rows = []
        elif head is None:
            raise FormatError(
                f"found {text[:40]!r} before the first keyword; expected a line that starts with *",
                path,
                at,
            )
        else:
            rows.append(Row(at, text, None if path == head[0] else path))
    if head is None:
        raise FormatError("not an input deck: there is no keyword in it", deck)
    return [*cards, _card(head, rows)]


def _card(head: tuple[Path, int, str], rows: list[Row]) -> Card:
    path, at, text = head
    name = _name(text)
    parameters = _parameters(text)
    if name in _DATA_ELSEWHERE:
        parameters.pop("INPUT", None)  # whose lines are here now
    return Card(name, MappingProxyType(parameters), tuple(rows), path, at)


def _name(text: str) -> str:
    return " ".join(text.split(",")[0].lstrip("*").upper().split())


def _parameters(text: str) -> dict[str, str]:
    out = {}
    for part in text.split(",")[1:]:
        name, _, value = part.partition("=")
        if name.strip():
            out[" ".join(name.upper().split())] = value.strip().strip('"').strip()
    return out


# -- numbers ------------------------------------------------------------------------------------
def number(text: str, card: Card, row: Row) -> float:
    """Read a number of a data line, ``1.5``, ``2.1E11`` or ``2.1D11``.

    Raises
    ------
    FormatError
        If it is not a finite number, or is longer than the twenty characters that the programs
        read.
    """
    if len(text) > FIELD_WIDTH:
        raise card.error(
            f"*{card.name}: {text!r} has {len(text)} characters; the programs read the first"
            f" {FIELD_WIDTH} and drop the rest, write it shorter",
            row,
        )
    try:
        return real_of(text)
    except ValueError:
        raise card.error(f"*{card.name}: {text!r} is not a number", row) from None


def whole(text: str, card: Card, row: Row) -> int:
    """Read a whole number of a data line.

    Raises
    ------
    FormatError
        If it is not one.
    """
    try:
        return whole_of(text)
    except ValueError:
        raise card.error(f"*{card.name}: {text!r} is not a whole number", row) from None


def short_number(value: float) -> str:
    """Write a number in at most twenty characters and with a decimal point, as exactly as fits."""
    text = _with_point(repr(float(value)))
    digits = 17
    while len(text) > FIELD_WIDTH:
        text = _with_point(f"{value:.{digits}g}")
        digits -= 1
    return text


def _with_point(text: str) -> str:
    mantissa, e, exponent = text.upper().partition("E")
    if "." not in mantissa:
        mantissa += "."
    return mantissa + e + exponent
