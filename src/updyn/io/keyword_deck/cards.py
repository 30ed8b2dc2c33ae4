"""Input decks of the keyword family (CalculiX, Abaqus) as cards, with their files and lines.

A card is a line that starts with ``*``, with parameters, and the following data lines. Case and
blanks are ignored, a trailing comma continues a keyword line, ``**`` starts a comment, and
``INPUT=file`` of an include, nodes, elements and sets is replaced by the content of the file.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from updyn.errors import FormatError, suggest
from updyn.foreign.confinement import check_inside
from updyn.io.inclusion import Inclusions
from updyn.io.items import is_file, suggest_file, unreadable_error
from updyn.io.settings import DECK
from updyn.io.text_numbers import check_last_line, parse_integer, parse_real

__all__ = [
    "KeywordCard",
    "KeywordRow",
    "format_number",
    "parse_integer_field",
    "parse_number_field",
    "read_cards",
]

#: Both programs read the first twenty characters of a field; CalculiX silently drops the rest.
FIELD_WIDTH = 20
#: Last lines that are complete without a line break: a comment, the end of a step or an assembly.
_ENDS = re.compile(rb"(?:\*\*.*|\*END [A-Z]{4,})?", re.IGNORECASE)
#: Keywords that Abaqus can combine with INPUT=, a file with the data lines.
_KEYWORDS_WITH_INPUT = ("NODE", "ELEMENT", "NSET", "ELSET", "EQUATION", "BOUNDARY")


@dataclass(frozen=True, slots=True)
class KeywordRow:
    """A data line as written; `path` is its file if it differs from the file of the keyword."""

    line: int
    text: str
    path: Path | None = None

    @property
    def fields(self) -> list[str]:
        """The texts between the commas, stripped; a trailing comma adds no field."""
        found = [part.strip() for part in self.text.split(",")]
        if len(found) > 1 and not found[-1]:
            found.pop()
        return found


@dataclass(frozen=True, slots=True)
class KeywordCard:
    """A keyword with its parameters and data lines.

    Names are in upper case; the value of a parameter is as written, or an empty text.
    """

    name: str
    parameters: Mapping[str, str]
    rows: tuple[KeywordRow, ...]
    path: Path
    line: int

    def get(self, parameter: str) -> str | None:
        """Return a parameter as written, or None."""
        return self.parameters.get(parameter)

    def require(self, parameter: str) -> str:
        """Return a parameter; raise a FormatError if it is missing or has no value."""
        if not self.parameters.get(parameter):
            message = f"*{self.name} has no {parameter}="
            if self.parameters:
                message += f"; {suggest(parameter, self.parameters)}"
            raise self.error(message)
        return self.parameters[parameter]

    def check_parameters(self, *known: str) -> None:
        """Refuse parameters other than `known`, because each changes the meaning of the card."""
        for name in self.parameters:
            if name not in known:
                raise self.error(
                    f"*{self.name}: parameter {name!r} is not supported; {suggest(name, known)}"
                )

    def error(self, message: str, row: KeywordRow | None = None) -> FormatError:
        """Return an error at the row, by default at the keyword."""
        if row is None:
            return FormatError(message, self.path, self.line)
        return FormatError(message, row.path or self.path, row.line)

    def text(self) -> list[str]:
        """Return the card as lines of a deck."""
        head = f"*{self.name}"
        for name, value in self.parameters.items():
            head += f", {name}={value}" if value else f", {name}"
        return [head, *(row.text for row in self.rows)]


def read_cards(path: str | Path) -> list[KeywordCard]:
    """Read a deck and all files that it includes, relative to its folder."""
    path = Path(path)
    inclusions = Inclusions()
    return _group_lines(_lines(path, _source(path), path.parent, (), inclusions), path)


def _lines(
    path: Path, lines: list[str], folder: Path, within: tuple[Path, ...], inclusions: Inclusions
) -> Iterator[tuple[Path, int, str]]:
    """Yield file, line number and text of every line except comments, with included files."""
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
        if name == "INCLUDE" or (given and name in _KEYWORDS_WITH_INPUT):
            inner = _resolve_include(name, given, path, start, folder)
            chain = (*within, path)
            if inner.resolve() in [p.resolve() for p in chain]:
                raise FormatError(
                    f"*{name}, INPUT={inner.name}: the file includes itself", path, start
                )
            if len(chain) > DECK.inclusion_depth:
                raise FormatError(
                    f"*{name}, INPUT={inner.name}: nested {DECK.inclusion_depth} levels deep;"
                    " expected fewer",
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
            f"the file ends after a keyword line with a trailing comma: {joined!r}", path, start
        )


def _source(path: Path) -> list[str]:
    text = _text(path)
    check_last_line(text, path, harmless=_ENDS)
    return text.splitlines()


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        # Older preprocessors write headings and comments in local code pages.
        text = path.read_text(encoding="latin-1")
        if "\0" in text:
            raise FormatError("not an input deck: the file is binary", path) from None
        return text
    except OSError as error:
        raise unreadable_error(path, error) from error


def _resolve_include(name: str, given: str, path: Path, at: int, folder: Path) -> Path:
    if not given:
        raise FormatError("*INCLUDE has no INPUT=", path, at)
    inner = folder / given
    check_inside(inner)
    if not is_file(inner):
        raise FormatError(f"*{name}: no such file {given!r}; {suggest_file(inner)}", path, at)
    return inner


def _group_lines(lines: Iterator[tuple[Path, int, str]], deck: Path) -> list[KeywordCard]:
    cards: list[KeywordCard] = []
    head: tuple[Path, int, str] | None = None
    rows: list[KeywordRow] = []
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
            rows.append(KeywordRow(at, text, None if path == head[0] else path))
    if head is None:
        raise FormatError("not an input deck: it contains no keyword", deck)
    return [*cards, _card(head, rows)]


def _card(head: tuple[Path, int, str], rows: list[KeywordRow]) -> KeywordCard:
    path, at, text = head
    name = _name(text)
    parameters = _parameters(text)
    if name in _KEYWORDS_WITH_INPUT:
        parameters.pop("INPUT", None)  # its lines are already inserted
    return KeywordCard(name, MappingProxyType(parameters), tuple(rows), path, at)


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
def parse_number_field(text: str, card: KeywordCard, row: KeywordRow) -> float:
    """Return a number of a data line, ``1.5``, ``2.1E11`` or ``2.1D11``."""
    # Numbers longer than the twenty characters that the programs read are refused.
    if len(text) > FIELD_WIDTH:
        raise card.error(
            f"*{card.name}: {text!r} has {len(text)} characters; expected at most"
            f" {FIELD_WIDTH}, because the programs ignore the rest",
            row,
        )
    try:
        return parse_real(text)
    except ValueError:
        raise card.error(f"*{card.name}: {text!r} is not a number", row) from None


def parse_integer_field(text: str, card: KeywordCard, row: KeywordRow) -> int:
    """Return an integer of a data line."""
    try:
        return parse_integer(text)
    except ValueError:
        raise card.error(f"*{card.name}: {text!r} is not a whole number", row) from None


def format_number(value: float) -> str:
    """Format a number with a decimal point in at most twenty characters, as accurately as fits."""
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
