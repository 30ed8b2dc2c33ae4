"""Check that a ``.cdb`` archive is complete: its blocks, their end marks and their counts.

ansys-mapdl-reader does not check its input: for a truncated file it returns a part or writes beyond
its arrays. Layout: Ansys Mechanical APDL, Programmer's Reference, "Coded Database File Commands"
(NBLOCK, EBLOCK, CMBLOCK, RLBLOCK).
"""

from __future__ import annotations

import re
from pathlib import Path

from updyn.errors import FormatError
from updyn.io.items import unreadable_error
from updyn.io.text_numbers import check_last_line, parse_integer, parse_real

__all__ = ["check_archive"]

_BLOCKS = ("NBLOCK", "EBLOCK", "CMBLOCK", "RLBLOCK")
#: ``(3i9,6e21.13e3)``, ``(19i10)``, ``(7g16.9)``: number and width of integers, then of reals.
_FORMAT = re.compile(
    r"\s*\((?:([1-9]\d?)i([1-9]\d?))?,?(?:([1-9]\d?)[eg]([1-9]\d?)(?:\.\d\d?(?:e\d)?)?)?\)\s*", re.I
)
_ENDS_NODES = re.compile(r"\s*(?:-1|N,.*,\s*-1\s*,?)\s*", re.I)
_ENDS_ELEMENTS = re.compile(r"\s*-1\s*")
_HEAD = 11  # numbers of an element before its nodes
_FIRST = 8  # nodes on the first line of an element
_COUNT_AT = 8  # position of the number of its nodes
_WRITTEN = re.compile(rb"\s*/COM,\s*ANSYS\s+(?:MECHANICAL\s+APDL\s+)?RELEASE", re.I)
_FINISH = re.compile(rb"(?:FINISH|/GO|!.*)?", re.I)


def check_archive(path: Path) -> None:
    """Refuse an archive that is truncated or whose blocks contradict their first lines."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise unreadable_error(path, error) from error
    check_last_line(raw, path, harmless=_FINISH)
    lines = raw.decode("latin-1").splitlines()
    reading = _Archive(lines, path)
    blocks = set()
    while reading.at < len(lines):
        line = lines[reading.at].split("!")[0]
        fields = [field.strip() for field in line.split(",")]
        reading.at += 1
        if fields[0].upper() in _BLOCKS:
            blocks.add(fields[0].upper())
            getattr(reading, fields[0].lower())(fields)
    if "NBLOCK" not in blocks:
        raise FormatError("holds no nodes (NBLOCK); write them with CDWRITE", path)
    if _WRITTEN.match(raw) and "FINISH" not in (line.strip().upper() for line in lines[-5:]):
        raise FormatError(
            "no FINISH at the end, which CDWRITE always writes: the file is truncated",
            path,
            len(lines),
        )


class _Archive:
    """The lines of an archive and the current position."""

    def __init__(self, lines: list[str], path: Path) -> None:
        self.lines = lines
        self.path = path
        self.at = 0
        self.name = ""

    def nblock(self, fields: list[str]) -> None:
        """Check nodes: number and two solid-model entities, position, angles."""
        self.name = "NBLOCK"
        n, width, reals, real_width = self.format()
        count = 0
        while not _ENDS_NODES.fullmatch(line := self.next("its end mark")):
            self.wholes(line[: n * width], n, width, least=n)
            self.reals(line[n * width :], reals, real_width)
            count += 1
        self.check_count(count, fields, 4, "nodes")

    def eblock(self, fields: list[str]) -> None:
        """Check elements: eleven numbers, the ninth is the number of nodes, then the nodes."""
        self.name = "EBLOCK"
        n, width = self.format()[:2]
        is_solid = len(fields) > 2 and fields[2].upper().startswith("SOL")
        count = 0
        while not _ENDS_ELEMENTS.fullmatch(line := self.next("its end mark, -1")):
            numbers = self.wholes(line, n, width)
            count += 1
            if not is_solid:
                continue
            nodes = numbers[_COUNT_AT] if len(numbers) > _COUNT_AT else -1
            if nodes < 0 or len(numbers) != _HEAD + min(nodes, _FIRST):
                raise self.error(
                    f"an element of {len(numbers)} numbers on its first line; expected {_HEAD} and"
                    f" its nodes, at most {_FIRST}"
                )
            missing = nodes - min(nodes, _FIRST)
            while missing > 0:
                more = self.wholes(self.next("the nodes of an element"), n, width)
                if len(more) != min(missing, n):
                    raise self.error(f"{len(more)} nodes on the line; expected {min(missing, n)}")
                missing -= len(more)
        if is_solid:
            self.check_count(count, fields, 4, "elements")

    def cmblock(self, fields: list[str]) -> None:
        """Check a component: its entities; a negative number ends a range."""
        self.name = "CMBLOCK"
        count = self.declared_number(fields, 3)
        n, width = self.format()[:2]
        if count is None:
            raise self.error("no number of entities")
        found = 0
        while found < count:
            found += len(self.wholes(self.next(f"{count} entities"), n, width))
        if found != count:
            raise self.error(f"{found} entities; its first line declares {count}")

    def rlblock(self, fields: list[str]) -> None:
        """Check sets of real constants: number, count, first constants, then further constants."""
        self.name = "RLBLOCK"
        sets = self.declared_number(fields, 1)
        n, width, first, real_width = self.format()
        if sets is None or n != 2:
            raise self.error("expected the number of sets, and a format such as (2i8,6g16.9)")
        further = self.format("(7g16.9)")[2]
        for _ in range(sets):
            line = self.next(f"{sets} sets")
            items = self.wholes(line[: n * width], n, width, least=n)[1]
            missing = items - self.reals(line[n * width :], first, real_width)
            while missing > 0:
                found = self.reals(self.next("the values of a set"), further, real_width)
                if not found:
                    raise self.error(f"an empty line; {missing} values of the set are missing")
                missing -= found

    # -- lines and fields -----------------------------------------------------------------------
    def next(self, what: str) -> str:
        """Return the next line; raise a FormatError at the end of the file."""
        if self.at >= len(self.lines):
            raise self.error(f"the file ends before {what}: it is truncated")
        self.at += 1
        return self.lines[self.at - 1]

    def format(self, like: str = "(19i10)") -> tuple[int, int, int, int]:
        """Return number and width of the integers and of the reals of each line."""
        line = self.next("its format")
        found = _FORMAT.fullmatch(line)
        if found is None or not found[1 if "i" in like else 3]:
            raise self.error(f"found {line.strip()[:40]!r}; expected a format such as {like}")
        n, width, reals, real_width = (int(number or 0) for number in found.groups())
        return n, width, reals, real_width

    def wholes(self, line: str, most: int, width: int, least: int = 1) -> list[int]:
        """Return the integers of a line, in fields of `width` characters."""
        text = line.rstrip()
        fields = [text[i : i + width] for i in range(0, len(text), width)]
        if not least <= len(fields) <= most or len(fields[-1]) < width:
            raise self.mismatch(line, f"{least} to {most} integers of {width} characters")
        try:
            return [parse_integer(field) for field in fields]
        except ValueError as error:
            raise self.mismatch(
                line, f"{least} to {most} integers of {width} characters"
            ) from error

    def reals(self, line: str, most: int, width: int) -> int:
        """Return the count of numbers on a line, in fields of `width` characters."""
        text = line.rstrip()
        fields = [text[i : i + width] for i in range(0, len(text), width or 1)]
        try:
            for field in fields:
                parse_real(field)
        except ValueError as error:
            raise self.mismatch(line, f"numbers of {width} characters") from error
        if len(fields) > most:
            raise self.mismatch(line, f"at most {most} numbers of {width} characters")
        return len(fields)

    def declared_number(self, fields: list[str], at: int) -> int | None:
        """Return a number in the first line of a block, or None."""
        if at >= len(fields) or not fields[at]:
            return None
        try:
            return abs(parse_integer(fields[at]))
        except ValueError as error:
            raise self.error(f"found {fields[at][:40]!r}; expected an integer") from error

    def check_count(self, count: int, fields: list[str], at: int, what: str) -> None:
        """Compare a number of rows with the number in the first line of the block."""
        declared = self.declared_number(fields, at)
        if declared not in (None, 0, count):
            raise self.error(f"{count} {what}; its first line declares {declared}")

    def mismatch(self, line: str, expected: str) -> FormatError:
        return self.error(f"found {line.strip()[:60]!r}; expected {expected}")

    def error(self, message: str) -> FormatError:
        """Return an error in the current block, at the current line."""
        return FormatError(f"{self.name}: {message}", self.path, self.at)
