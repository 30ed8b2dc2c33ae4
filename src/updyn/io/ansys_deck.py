"""The commands of an Ansys input file (APDL, ``.cdb``) that hold properties: MP, MPTEMP, MPDATA, R, RMORE, RLBLOCK, ET.

Numbers only: parameters, loops and included files are not followed. A later definition takes the
place of an earlier one, as in the program.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from updyn.errors import FormatError

__all__ = ["Deck", "Property", "RealSet", "read_deck"]

_TABLES = ("ELAS", "ANEL", "HYPE", "SDAM", "PRON", "AHYP")


@dataclass(frozen=True, slots=True)
class Property:
    """One property of one material.

    Parameters
    ----------
    values : tuple of str
        Coefficients of temperature (command MP), or values at the temperatures (MPDATA), as
        written.
    temperatures : tuple of str
        Those of MPTEMP; empty for MP.
    line : int
        Where it stands in the deck, counted from 1.
    """

    values: tuple[str, ...]
    temperatures: tuple[str, ...]
    line: int


@dataclass(frozen=True, slots=True)
class RealSet:
    """One set of real constants.

    Parameters
    ----------
    values : tuple of str
        The constants in order, as written; "" where blank.
    line : int
        Where it stands in the deck.
    """

    values: tuple[str, ...]
    line: int


@dataclass(slots=True)
class Deck:
    """What a deck says.

    Parameters
    ----------
    path : Path
        The deck.
    materials : dict of int to dict of str to Property
        By material number and label (EX, DENS, BETD).
    reals : dict of int to RealSet
        By number.
    tables : dict of int to int
        Line of a TB command of elasticity or damping, by material number.
    types : dict of int to int
        Element routine by type number.
    users : dict of int to set of int
        Type numbers of the elements (EBLOCK) of each real constant set.
    keys : dict of (int, int) to int
        KEYOPT by type number and key.
    release : float or None
        Release of the program that wrote the deck, 19.4 or 2019.2; None where it does not say.
    """

    path: Path
    materials: dict[int, dict[str, Property]] = field(default_factory=dict)
    reals: dict[int, RealSet] = field(default_factory=dict)
    tables: dict[int, int] = field(default_factory=dict)
    types: dict[int, int] = field(default_factory=dict)
    users: dict[int, set[int]] = field(default_factory=dict)
    keys: dict[tuple[int, int], int] = field(default_factory=dict)
    release: float | None = None

    def number(self, text: str, line: int, what: str) -> float:
        """Return a number that is written out.

        Raises
        ------
        FormatError
            If it is a parameter or an expression.
        """
        try:
            value = float(re.sub(r"[dD]", "e", text))
        except ValueError as error:
            raise FormatError(
                f"{what} is {text!r}; expected a number: parameters and expressions are not"
                " evaluated, write the deck with CDWRITE",
                self.path,
                line,
            ) from error
        if value - value != 0.0:
            raise FormatError(f"{what} is {text!r}; expected a finite number", self.path, line)
        return value


def read_deck(path: str | Path) -> Deck:
    """Read the properties of a deck.

    Parameters
    ----------
    path : path
        The file.

    Raises
    ------
    FormatError
        If it is not text or a block is not complete.
    """
    path = Path(path)
    deck = Deck(path)
    state = _Reading(deck)
    with path.open(encoding="latin-1") as file:
        lines = file.read().splitlines()
    if any("\0" in line for line in lines[:50]):
        raise FormatError("is a binary file, expected a deck (.cdb, or commands)", path)
    at = 0
    while at < len(lines):
        at += state.take(lines, at)
    return deck


class _Reading:
    def __init__(self, deck: Deck) -> None:
        self.deck = deck
        self.temperatures: dict[int, str] = {}
        self.last_real: int | None = None

    def take(self, lines: Sequence[str], at: int) -> int:
        """Take the command at a line; return how many lines it has."""
        line = lines[at]
        found = re.match(
            r"\s*/COM\s*,\s*ANSYS\s+(?:MECHANICAL\s+APDL\s+)?RELEASE\s+([\d.]+)(?:\s*R(\d))?",
            line,
            re.I,
        )
        if found:
            self.deck.release = _release(found[1], found[2])
        if line.lstrip().upper().startswith(("/COM", "/TITLE", "C***")):
            return 1
        for command in line.split("!")[0].split("$"):
            fields = [f.strip() for f in command.split(",")]
            name = fields[0].upper()
            if name in ("NBLOCK", "EBLOCK", "CMBLOCK", "RLBLOCK"):
                return self._block(name, fields, lines, at)
            self._command(name, fields[1:], at + 1)
        return 1

    def _command(self, name: str, fields: list[str], line: int) -> None:
        short = name[:4]
        if name == "MP":
            self._material(
                _at(fields, 0).upper()[:4],
                _at(fields, 1) or "1",
                [v for v in fields[2:] if v],
                (),
                line,
            )
        elif short == "MPTE" and name.startswith("MPTEMP"):
            self._temperatures(fields)
        elif short == "MPDA":
            self._data(fields, line)
        elif (
            name == "TB"
            and fields
            and fields[0].upper()[:4] in _TABLES
            and _whole(_at(fields, 1) or "1") is not None
        ):
            self.deck.tables[_whole(_at(fields, 1) or "1") or 1] = line
        elif name == "ET" and (number := _whole(_at(fields, 0))) is not None:
            routine = re.search(r"(\d+)$", _at(fields, 1))
            self.deck.types[number] = int(routine[1]) if routine else 0
        elif short == "KEYO" and None not in (
            numbers := [_whole(_at(fields, i)) for i in range(3)]
        ):
            self.deck.keys[numbers[0] or 0, numbers[1] or 0] = numbers[2] or 0
        elif name == "R" and (number := _whole(_at(fields, 0))) is not None:
            self.deck.reals[number] = RealSet(tuple(fields[1:7]), line)
            self.last_real = number
        elif short == "RMOR" and self.last_real is not None:
            old = self.deck.reals[self.last_real]
            filled = old.values + ("",) * (-len(old.values) % 6)
            self.deck.reals[self.last_real] = RealSet(filled + tuple(fields[:6]), old.line)

    def _temperatures(self, fields: list[str]) -> None:
        if _at(fields, 0).upper().startswith("R5"):
            fields = fields[2:]
        start = _whole(_at(fields, 0))
        if start is None:
            self.temperatures = {}  # MPTEMP alone erases the table
            return
        if start == 1:
            self.temperatures = {}
        self.temperatures.update({start + i: t for i, t in enumerate(fields[1:]) if t})

    def _data(self, fields: list[str], line: int) -> None:
        if _at(fields, 0).upper().startswith("R5"):
            fields = fields[2:]
        label, number, start = (
            _at(fields, 0).upper()[:4],
            _at(fields, 1) or "1",
            _whole(_at(fields, 2)) or 1,
        )
        values = [v for v in fields[3:] if v]
        old = self.deck.materials.get(_whole(number) or 0, {}).get(label)
        if start > 1 and old is not None and len(old.values) == start - 1:
            values = [*old.values, *values]
        temperatures = tuple(self.temperatures.get(i + 1, "0.0") for i in range(len(values)))
        self._material(label, number, values, temperatures, line)

    def _material(
        self, label: str, number: str, values: list[str], temperatures: tuple[str, ...], line: int
    ) -> None:
        material = _whole(number)
        if material is not None:  # of one that a parameter names, nothing can be said
            self.deck.materials.setdefault(material, {})[label] = Property(
                tuple(values), temperatures, line
            )

    def _block(self, name: str, fields: list[str], lines: Sequence[str], at: int) -> int:
        if name == "RLBLOCK":
            return self._real_block(fields, lines, at)
        if name == "CMBLOCK":
            count = abs(_whole(_at(fields, 3).split("!")[0].strip()) or 0)
            each = _width(lines, at + 1, self.deck.path)[0]
            return 2 + -(-count // each)
        length = 2
        solid = name == "EBLOCK" and len(fields) > 2 and fields[2].upper().startswith("SOL")
        width = _width(lines, at + 1, self.deck.path)[1]
        held = 0  # numbers of the element that its first line left for the next ones
        while at + length < len(lines):
            line = lines[at + length]
            if re.match(r"\s*(-1\b|N,)", line):
                return length + 1
            if not re.match(r"\s*[-\d]", line):
                return length
            if solid:
                held = self._element(line, width, held, at + length + 1)
            length += 1
        return length

    def _element(self, line: str, width: int, held: int, at: int) -> int:
        fields = [line[i : i + width] for i in range(0, len(line.rstrip()), width)]
        try:
            numbers = [int(f) for f in fields if f.strip()]
        except ValueError as error:
            raise FormatError(
                f"EBLOCK: found {line.strip()!r}, expected whole numbers of {width} characters",
                self.deck.path,
                at,
            ) from error
        if held > 0:
            return held - len(numbers)
        if len(numbers) < 11:
            return 0
        self.deck.users.setdefault(numbers[2], set()).add(numbers[1])
        return numbers[8] - (len(numbers) - 11)

    def _real_block(self, fields: list[str], lines: Sequence[str], at: int) -> int:
        """Read RLBLOCK: two lines of format, then each set with its number, how many constants, and these."""
        sets = _whole(_at(fields, 1)) or 0
        path = self.deck.path
        _, width = _width(lines, at + 1, path)
        row = at + 3
        for _ in range(sets):
            if row >= len(lines):
                raise FormatError("RLBLOCK: ends before its last set", path, row)
            text = lines[row]
            number, count = _whole(text[:width].strip()), _whole(text[width : 2 * width].strip())
            if number is None or count is None:
                raise FormatError(
                    f"RLBLOCK: expected the number of a set and of its constants, found {text!r}",
                    path,
                    row + 1,
                )
            values, start = _numbers(text[2 * width :]), row + 1
            while len(values) < count and row + 1 < len(lines):
                row += 1
                values += _numbers(lines[row])
            self.deck.reals[number] = RealSet(tuple(values[:count]), start)
            row += 1
        return row - at


def _release(number: str, half: str | None) -> float:
    """Return 19.4 for "19.4", 2019.2 for "2019 R2"."""
    parts = [p for p in number.split(".") if p] or ["0"]
    return float(f"{parts[0]}.{half or (parts[1] if len(parts) > 1 else 0)}")


def _numbers(text: str) -> list[str]:
    return re.findall(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?", text)


def _width(lines: Sequence[str], at: int, path: Path) -> tuple[int, int]:
    """Return how many whole numbers a line of a block has and how wide each is, from its format, ``(19i10)``."""
    found = re.match(r"\s*\(\s*([1-9]\d*)i([1-9]\d*)", lines[at] if at < len(lines) else "", re.I)
    if found is None:
        raise FormatError("a block without its format, such as (19i10)", path, at + 1)
    return int(found[1]), int(found[2])


def _at(fields: Sequence[str], i: int) -> str:
    return fields[i] if i < len(fields) else ""


def _whole(text: str) -> int | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return int(value) if value.is_integer() else None
