"""Bulk data as cards: continuations, INCLUDE files and comments, independent of card names.

A continuation without a mark belongs to the preceding line, one with a mark to the line with this
mark in field 10 (MSC Nastran Quick Reference Guide, "Format of Bulk Data Entries", continuations).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from updyn.errors import FormatError, InputError, suggest
from updyn.foreign.confinement import check_inside
from updyn.io.inclusion import Inclusions
from updyn.io.items import is_file, suggest_file, unreadable_error
from updyn.io.nastran.fields import (
    NastranLine,
    NastranRow,
    format_field,
    parse_nastran_real,
    split_fields,
)
from updyn.io.nastran.replication import expand
from updyn.io.settings import DECK
from updyn.io.text_numbers import check_last_line, parse_integer

__all__ = ["NastranCard", "parse", "read_lines"]

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9]{0,7}")
_WIDTH = 16  # of a large field
#: Last lines that are complete without a line break.
_ENDS = re.compile(rb"""(?:\$.*|ENDDATA.*|INCLUDE\s*(?:'[^']+'|"[^"]+"))?""", re.IGNORECASE)
_INCLUDE = re.compile(r"\s*INCLUDE(?=[\s'\"])", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class NastranCard:
    """One bulk data entry, with its name in upper case and without the asterisk of large fields.

    `fields` are stripped, eight per line, without trailing empty ones; `fields[0]` is field 2 of
    the manuals.
    """

    name: str
    fields: tuple[str, ...]
    lines: tuple[NastranLine, ...]

    def error(self, message: str) -> FormatError:
        """Return an error at the first line of the card."""
        return self.lines[0].error(message)

    def text(self, at: int, default: str = "") -> str:
        """Return field `at`, counted from 0 after the name, in upper case; `default` if empty."""
        if at >= len(self.fields):
            return default
        return self.fields[at].upper() or default

    def nonempty(self, fields: Iterable[int]) -> tuple[int, ...]:
        """Return the positions among `fields` that are not empty."""
        return tuple(at for at in fields if self.text(at))

    def integer(self, at: int, default: int | None = None) -> int:
        """Return a field as an integer; raise a FormatError if it is not one or has no default."""
        found = self.text(at)
        if not found and default is not None:
            return default
        try:
            return parse_integer(found)
        except ValueError as error:
            raise self.error(
                f"{self.name}: field {at + 2} is {found!r}; expected a whole number"
            ) from error

    def real(self, at: int, default: float | None = None) -> float:
        """Return a field as a number; raise a FormatError if it is not one or has no default."""
        found = self.text(at)
        if not found and default is not None:
            return default
        try:
            return parse_nastran_real(found)
        except ValueError as error:
            raise self.error(
                f"{self.name}: field {at + 2} is {found!r}; expected a number"
            ) from error

    def integers(self, fields: Iterable[int]) -> list[int]:
        """Return fields as integers."""
        return [self.integer(at) for at in fields]

    def reals(self, fields: Iterable[int], default: float | None = None) -> list[float]:
        """Return fields as numbers."""
        return [self.real(at, default) for at in fields]

    def with_fields(self, changes: dict[int, str]) -> NastranCard:
        """Return a copy with replaced fields, by position as in `text`."""
        fields = [*self.fields, *[""] * (max(changes, default=0) + 1 - len(self.fields))]
        for at, text in changes.items():
            fields[at] = text
        return replace(self, fields=tuple(fields))

    def large(self) -> str:
        """Return the card in large fields; raise a FormatError if a value exceeds 16 characters."""
        # Some readers require both lines of eight fields.
        missing = -len(self.fields) % 8 if self.fields else 8
        fields = [*map(self._large_field, range(len(self.fields))), *[""] * missing]
        head = self.name + "*"
        out = ""
        for start in range(0, len(fields), 4):
            row = "".join(cell.rjust(16) for cell in fields[start : start + 4])
            out += (head.ljust(8) + row).rstrip() + "\n"
            head = "*"
        return out

    def _large_field(self, at: int) -> str:
        """Return a field in at most 16 characters."""
        cell = self.fields[at]
        if len(cell) <= _WIDTH:
            return cell
        try:
            return format_field(parse_nastran_real(cell), _WIDTH)
        except ValueError as error:
            raise self.error(
                f"{self.name}: field {at + 2} is {cell!r}; expected at most 16 characters"
            ) from error


def read_lines(path: Path) -> Iterator[NastranLine]:
    """Yield the lines of a deck with INCLUDE files inserted, without comments and empty lines."""
    # The name in an INCLUDE is relative to the folder of the including file or of the main file.
    yield from _iterate_lines(path, _source(path), (), Inclusions())


def _iterate_lines(
    path: Path, lines: list[str], within: tuple[Path, ...], inclusions: Inclusions
) -> Iterator[NastranLine]:
    """Yield the lines of the last file of `within`, the chain of inclusions from the main file."""
    main = within[0] if within else path
    rest = iter(enumerate(lines, 1))
    for number, raw in rest:
        line = NastranLine(raw.split("$")[0].rstrip().expandtabs(8), path, number)
        if not line.text:
            continue
        if _INCLUDE.match(line.text) is None:
            yield line
            continue
        name = line.text.strip()[len("INCLUDE") :].strip()
        quote = name[0]
        if quote in "'\"":
            while name.count(quote) < 2:  # a long name continues on the next line
                name += next(rest, (0, quote))[1].strip()
            name = name.split(quote)[1]
        target = _target(line, name.strip(), main.parent)
        if target.resolve() in [outer.resolve() for outer in (*within, path)]:
            raise line.error(f"INCLUDE {name!r}: the file includes itself")
        if len(within) >= DECK.inclusion_depth:
            raise line.error(
                f"INCLUDE {name!r}: nested {DECK.inclusion_depth} levels deep; expected fewer"
            )
        inner = _source(target)
        excess = inclusions.excess(target.resolve(), len(inner))
        if excess is not None:
            raise line.error(f"INCLUDE {name!r}: {excess}")
        yield from _iterate_lines(target, inner, (*within, path), inclusions)


def _source(path: Path) -> list[str]:
    try:
        text = path.read_text(encoding="latin-1")
    except OSError as error:
        raise unreadable_error(path, error) from error
    check_last_line(text, path, harmless=_ENDS)
    return text.splitlines()


def _target(line: NastranLine, name: str, main: Path) -> Path:
    """Return the file that an INCLUDE names; `main` is the folder of the main file."""
    refused: InputError | None = None
    found: dict[Path, Path] = {}
    for folder in dict.fromkeys((line.path.parent, main)):
        # Decks written on Windows separate folders by backslashes.
        target = folder / name.replace("\\", "/")
        try:
            check_inside(target)
        except InputError as error:
            refused = error
            continue
        if is_file(target):
            found.setdefault(target.resolve(), target)
    if len(found) > 1:
        raise line.error(
            f"INCLUDE {name!r}: found {' and '.join(map(str, found.values()))}, relative to this"
            " file and to the main file; rename one"
        )
    if found:
        return next(iter(found.values()))
    if refused is not None:
        raise refused
    raise line.error(f"INCLUDE: no such file {name!r}; {suggest_file(line.path.parent / name)}")


def parse(lines: Iterable[NastranLine]) -> Iterator[NastranCard]:
    """Yield the cards of bulk data, in the order of their first lines."""
    rows = list(expand(map(split_fields, lines)))
    following = _continuations(rows)
    unused = set(following.values())
    for at, row in enumerate(rows):
        if row.continues:
            continue
        name = row.head.rstrip("*")
        if _NAME.fullmatch(name) is None:
            raise row.line.error(
                f"{row.line.text.strip()[:40]!r}; expected the name of a card, or a continuation"
            )
        fields = list(row.fields)
        card_lines = [row.line]
        while at in following:
            at = following[at]
            unused.discard(at)
            fields += [""] * (-len(fields) % len(rows[at].fields))
            fields += rows[at].fields
            card_lines.append(rows[at].line)
        while fields and not fields[-1]:
            fields.pop()
        yield NastranCard(name.upper(), tuple(fields), tuple(card_lines))
    for at in sorted(unused):
        raise rows[at].line.error(f"the continuation {rows[at].head!r} continues itself")


def _continuations(rows: Sequence[NastranRow]) -> dict[int, int]:
    parents = _parents(rows)
    found: dict[int, int] = {}
    for at, row in enumerate(rows):
        if not row.continues:
            continue
        before = parents.get(at, at - 1)
        if before < 0:
            raise row.line.error("a continuation without a card before it")
        if before in found:
            raise row.line.error(
                f"a second continuation of line {rows[before].line.number}; the first is line"
                f" {rows[found[before]].line.number}"
            )
        found[before] = at
    return found


def _parents(rows: Sequence[NastranRow]) -> dict[int, int]:
    """Return the positions of the rows with each mark in field 10, by mark."""
    claims: dict[str, list[int]] = {}
    for at, row in enumerate(rows):
        if row.continues and _mark(row.head):
            claims.setdefault(_mark(row.head), []).append(at)
    if not claims:
        return {}
    parents: dict[str, list[int]] = {}
    for at, row in enumerate(rows):
        if row.tail:
            parents.setdefault(_mark(row.tail), []).append(at)
    # Nastran compares the last seven characters only, so "CORD1" in field 10 fits "+ORD1".
    shortened: dict[str, list[int]] = {}
    for at, row in enumerate(rows):
        if row.tail[1:]:
            shortened.setdefault(_mark(row.tail[1:]), []).append(at)
    found: dict[int, int] = {}
    for mark, claimed in claims.items():
        found |= _pair_by_mark(rows, parents.get(mark) or shortened.get(mark, []), claimed)
    return found


def _pair_by_mark(
    rows: Sequence[NastranRow], parents: list[int], claims: list[int]
) -> dict[int, int]:
    """Return the position of the continuation of each row, for the rows that share a mark."""
    first = rows[claims[0]]
    if not parents:
        marks = sorted({row.tail for row in rows if row.tail})
        near = suggest(first.head, marks) if marks else "no line has a mark in field 10"
        raise first.line.error(
            f"continuation {first.head!r}: no line has this mark in field 10; {near}"
        )
    if len(parents) == len(claims) == 1:
        return {claims[0]: parents[0]}
    # If a mark is used several times, each continuation has to follow its line directly.
    adjacent = {at: at - 1 for at in set(claims) & {parent + 1 for parent in parents}}
    cards = {parent for parent in parents if not rows[parent].continues}
    if len(adjacent) < len(claims) or cards - set(adjacent.values()):
        lines = ", ".join(str(rows[parent].line.number) for parent in parents[:6])
        raise first.line.error(
            f"continuation {first.head!r}: the mark is in field 10 of lines {lines} and on"
            f" {len(claims)} continuations; give each pair a different mark"
        )
    return adjacent


def _mark(cell: str) -> str:
    """Return the normalized mark: upper case, without the leading sign."""
    return cell.strip("+* ").upper()
