"""Updated properties for an Ansys deck, as commands that it can include (APDL).

Groups are those of `updyn.io.ansys.emat`, by material. The loss factor gamma of a material, K (1 +
i gamma), is MP,DMPS = gamma; releases without DMPS add 2 i DMPR K, so there DMPR = gamma / 2 (Ansys
18.2, command DMPSTR: "MP,DMPR adds the contribution on a per-material basis as 2gK"). Commands are
not executed, so properties that one may change are refused.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from updyn.errors import FormatError, suggest
from updyn.io.ansys.attributes import find_neighbour
from updyn.io.ansys.commands import FORMATTED, MATERIAL, REAL, find_affected_kinds, is_harmless
from updyn.io.atomic import atomic_path
from updyn.io.changes import check_changes
from updyn.io.items import unreadable_error
from updyn.io.settings import DECK
from updyn.io.text_numbers import check_last_line, parse_integer, parse_real

__all__ = [
    "AnsysDeck",
    "AnsysProperty",
    "Doubt",
    "RealSet",
    "read_deck",
    "write_properties",
]

_MODULI = ("EX", "EY", "EZ", "GXY", "GYZ", "GXZ")
#: Positions of real constants, counted from 1, by element routine (Ansys Element Reference).
_REALS: Mapping[int, Mapping[str, tuple[int, ...]]] = {
    14: {"stiffness": (1,), "viscous": (2, 3)},
    21: {"mass": (1, 2, 3, 4, 5, 6)},
    40: {"stiffness": (1, 6), "viscous": (2,), "mass": (3,)},
    214: {"stiffness": (1, 2, 3, 4), "viscous": (5, 6, 7, 8)},
}
_NAMES = {14: "COMBIN14", 21: "MASS21", 40: "COMBIN40", 214: "COMBI214"}
#: First release with DMPS, 2020 R1; earlier releases are numbered by years, or as 15.0 to 19.5.
_WITH_DMPS = 2020
_LAST_BEFORE_YEARS = 20


def write_properties(changes: Mapping[str, Mapping[str, float]], deck: Path, path: Path) -> None:
    """Write the commands for the changed groups.

    For an ``.emat`` or ``.full`` file as `deck`, the ``.cdb`` of the same name in the same folder
    is used.
    """
    deck = _find_deck(deck)
    check_changes(changes, deck)
    found = read_deck(deck)
    numbers = sorted({*found.materials, *found.tables})
    materials = {f"material {number}": number for number in numbers}
    reals = {f"real {number}": number for number in sorted(found.reals)}
    blocks: list[str] = []
    for name, change in changes.items():
        if name in materials:
            found.check(MATERIAL, materials[name])
            lines = _material(found, materials[name], change)
        elif name in reals:
            found.check(REAL, reals[name])
            lines = _real(found, reals[name], change)
        else:
            hint = "MP, MPDATA; R, RLBLOCK"
            if re.fullmatch(r"(material|real) (\d+)", name) is None:
                hint = "a component, type or section has no single property: group by material"
            found.check(REAL if name.startswith("real ") else MATERIAL)
            near = suggest(name, [*materials, *reals])
            raise FormatError(f"the deck has no properties of {name!r} ({hint}); {near}", deck)
        blocks += ["!", f"! {name}: {_describe_change(change)}", *lines]
    heading = [
        f"! New properties for {deck.name}: {', '.join(changes)}.",
        f"! Read them in /PREP7 after the deck: /INPUT,{path.stem},{path.suffix.lstrip('.')}",
    ]
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join([*heading, *blocks]) + "\n", encoding="utf-8")


def _describe_change(change: Mapping[str, float]) -> str:
    parts = []
    for quantity, value in change.items():
        sign = "=" if quantity == "loss_factor" else "x"
        parts.append(f"{quantity} {sign} {value!r}")
    return ", ".join(parts) or "unchanged"


def _find_deck(deck: Path) -> Path:
    """Return the deck; for a binary file, the ``.cdb`` of the same name."""
    if deck.suffix.lower() not in (".emat", ".full"):
        return deck
    found = find_neighbour(deck, ".cdb")
    if found is None:
        raise FormatError(
            f"changed properties need the deck: {deck.with_suffix('.cdb').name} (CDWRITE) is not in"
            " the same folder",
            deck,
        )
    return found


# -- materials ----------------------------------------------------------------------------------
def _material(deck: AnsysDeck, number: int, change: Mapping[str, float]) -> list[str]:
    has = deck.materials.get(number, {})
    stiffness = change.get("stiffness", 1.0)
    mass = change.get("mass", 1.0)
    viscous = change.get("viscous", 1.0)
    if number in deck.tables and (stiffness != 1.0 or viscous != 1.0 or "loss_factor" in change):
        raise FormatError(
            f"material {number} has a table (TB) of elasticity or damping, which is not supported;"
            " expected MP or MPDATA",
            deck.path,
            deck.tables[number],
        )
    moduli = [label for label in _MODULI if label in has]
    _require_property(deck, number, has, stiffness != 1.0, moduli, "EX")
    _require_property(deck, number, has, mass != 1.0, "DENS" in has, "DENS")
    _require_property(
        deck, number, has, viscous != 1.0, "ALPD" in has or "BETD" in has, "ALPD or BETD"
    )
    factors = dict.fromkeys(moduli, stiffness)
    # C = ALPD M + BETD K with the new M and K has to be `viscous` times the old C.
    factors |= {"DENS": mass, "ALPD": viscous / mass, "BETD": viscous / stiffness}
    out = []
    for label, factor in factors.items():
        if label in has and factor != 1.0:
            out += _scaled_commands(deck, number, label, has[label], factor)
    if "loss_factor" in change:
        out += _loss_factor(deck, number, has, change["loss_factor"])
    return out


def _require_property(
    deck: AnsysDeck,
    number: int,
    has: Mapping[str, AnsysProperty],
    is_changed: bool,
    is_present: object,
    label: str,
) -> None:
    if is_changed and not is_present:
        lines = [found.line for found in has.values()] or [deck.tables[number]]
        held = ", ".join(sorted(has)) or "a table (TB) only"
        raise FormatError(
            f"material {number} has no {label} to change; it has {held}", deck.path, lines[0]
        )


def _scaled_commands(
    deck: AnsysDeck, number: int, label: str, old: AnsysProperty, factor: float
) -> list[str]:
    what = f"{label} of material {number}"
    before = [deck.number(v, old.line, what) for v in old.values]
    values = [repr(v * factor) for v in before]
    out = [f"! old {label} (line {old.line}): {', '.join(map(repr, before))}"]
    if len(set(old.temperatures)) < 2:
        return [*out, f"MP,{label},{number},{','.join(values)}"]
    temperatures = [repr(deck.number(t, old.line, "MPTEMP")) for t in old.temperatures]
    out.append("MPTEMP")
    for i in range(0, len(values), 6):
        out.append(f"MPTEMP,{i + 1},{','.join(temperatures[i : i + 6])}")
    for i in range(0, len(values), 6):
        out.append(f"MPDATA,{label},{number},{i + 1},{','.join(values[i : i + 6])}")
    return out


def _loss_factor(
    deck: AnsysDeck, number: int, has: Mapping[str, AnsysProperty], gamma: float
) -> list[str]:
    out = []
    for name in ("DMPR", "DMPS"):
        if name in has:
            out.append(f"! old {name} (line {has[name].line}): {', '.join(has[name].values)}")
    # DMPR is a damping ratio, half the loss factor.
    if not _has_dmps(deck):
        return [*out, f"MP,DMPR,{number},{gamma / 2!r}"]
    out.append(f"! in a release without DMPS: MP,DMPR,{number},{gamma / 2!r}")
    if "DMPR" in has:  # it would be added to DMPS
        out.append(f"MP,DMPR,{number},0.0")
    return [*out, f"MP,DMPS,{number},{gamma * 1.0!r}"]


def _has_dmps(deck: AnsysDeck) -> bool:
    """Return whether the release of the deck supports the label DMPS for structural damping."""
    if any("DMPS" in has for has in deck.materials.values()):
        return True
    if deck.release is None:
        return True
    is_year = deck.release > 1000
    return deck.release >= (_WITH_DMPS if is_year else _LAST_BEFORE_YEARS)


# -- real constants -----------------------------------------------------------------------------
def _real(deck: AnsysDeck, number: int, change: Mapping[str, float]) -> list[str]:
    """Return the commands for a set of real constants."""
    old = deck.reals[number]
    routine = _routine(deck, number, old)
    element = _NAMES[routine]
    places = _REALS[routine]
    values = list(old.values)
    for quantity, factor in change.items():
        if quantity == "loss_factor":
            if factor:
                raise FormatError(
                    f"real {number}: {element} has no loss factor", deck.path, old.line
                )
            continue
        if quantity not in places:
            if factor != 1.0:
                raise FormatError(
                    f"real {number}: {element} has no {quantity}", deck.path, old.line
                )
            continue
        is_there = False
        for place in places[quantity]:
            if place <= len(values) and values[place - 1]:
                what = f"constant {place} of real {number}"
                before = deck.number(values[place - 1], old.line, what)
                values[place - 1] = repr(before * factor)
                is_there = is_there or before != 0.0
        if factor != 1.0 and not is_there:
            raise FormatError(
                f"real {number}: {element} has no {quantity} to change", deck.path, old.line
            )
    shown = ", ".join(value or "-" for value in old.values)
    out = [f"! {element}, old constants (line {old.line}): {shown}"]
    command = f"R,{number}"
    for start in range(0, max(len(values), 1), 6):
        out.append(",".join([command, *values[start : start + 6]]))
        command = "RMORE"
    return out


def _routine(deck: AnsysDeck, number: int, old: RealSet) -> int:
    """Return the routine of the elements that use a set, by default the only one of the deck."""
    users = deck.users.get(number)
    routines = {deck.types.get(t, 0) for t in users or deck.types}
    if not users:
        routines &= set(_REALS)
    if len(routines) == 1 and routines <= set(_REALS):
        return routines.pop()
    found = ", ".join(_NAMES.get(r, str(r)) for r in sorted(routines)) or "none"
    raise FormatError(
        f"real {number}: its constants belong to elements {found}; expected one of"
        f" {', '.join(_NAMES.values())}, whose constants are known",
        deck.path,
        old.line,
    )


_PLURAL = {MATERIAL: "properties of materials", REAL: "real constants"}
_TABLES = ("ELAS", "ANEL", "HYPE", "SDAM", "PRON", "AHYP")


#: Last lines that are complete without a line break.
_ENDS = re.compile(rb"(?:FINI(?:SH)?|/GO|/EOF|!.*)?", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class AnsysProperty:
    """A property of a material, as written in the deck.

    `values` are coefficients of temperature (command MP), or values at `temperatures` (MPDATA).
    """

    values: tuple[str, ...]
    temperatures: tuple[str, ...]
    line: int


@dataclass(frozen=True, slots=True)
class RealSet:
    """A set of real constants in order, as written; "" if blank."""

    values: tuple[str, ...]
    line: int


@dataclass(frozen=True, slots=True)
class Doubt:
    """A command after which properties ("material" and "real") may differ from the values read.

    `number` is the only material that may differ; None for all.
    """

    kinds: tuple[str, ...]
    line: int
    reason: str
    number: int | None = None


@dataclass(slots=True)
class AnsysDeck:
    """The properties and elements of a deck.

    `materials` is by material number and label (EX, DENS, BETD), `reals` by number; `tables` has
    the line of a TB command of elasticity or damping by material, `types` the element routine by
    type number, `users` the types of the elements (EBLOCK) of each real constant set. `release` is
    that of the program that wrote the deck, 19.4 or 2019.2, None if unknown; `doubts` are
    uninterpreted commands.
    """

    path: Path
    materials: dict[int, dict[str, AnsysProperty]] = field(default_factory=dict)
    reals: dict[int, RealSet] = field(default_factory=dict)
    tables: dict[int, int] = field(default_factory=dict)
    types: dict[int, int] = field(default_factory=dict)
    users: dict[int, set[int]] = field(default_factory=dict)
    release: float | None = None
    doubts: list[Doubt] = field(default_factory=list)

    def check(self, kind: str, number: int | None = None) -> None:
        """Refuse properties that may differ from the values read, with the first such command."""
        for doubt in self.doubts:
            if kind in doubt.kinds and doubt.number in (None, number):
                raise FormatError(
                    f"{doubt.reason}: {_PLURAL[kind]} are not known; write the deck"
                    " with CDWRITE, which has their final values",
                    self.path,
                    doubt.line,
                )

    def number(self, text: str, line: int, what: str) -> float:
        """Return a number; raise a FormatError if it is a parameter or an expression."""
        try:
            return parse_real(text)
        except ValueError as error:
            raise FormatError(
                f"{what} is {text!r}; expected a number: parameters and expressions are not"
                " evaluated, write the deck with CDWRITE",
                self.path,
                line,
            ) from error


def read_deck(path: str | Path) -> AnsysDeck:
    """Read the properties of a deck."""
    path = Path(path)
    deck = AnsysDeck(path)
    state = _Parser(deck)
    try:
        text = path.read_text(encoding="latin-1")
    except OSError as error:
        raise unreadable_error(path, error) from error
    lines = text.splitlines()
    if "\0" in "".join(lines[:50]):
        raise FormatError("is a binary file, expected a deck (.cdb, or commands)", path)
    check_last_line(text, path, harmless=_ENDS)
    at = 0
    while at < len(lines):
        at += state.take(lines, at)
    return deck


#: Command forms of CDWRITE with the number of values before the values.
_UNBLOCKED = ("R5", "UNBL")
_OPENING = ("*DO", "*DOWHILE", "*CREATE")
_CLOSING = ("*ENDDO", "*ENDIF", "*END")
_BRANCHES = ("*ELSE", "*ELSEIF")
_ENDING = ("/EOF", "/EXIT", "/QUIT")
_DATA = re.compile(r"\s*[-+.(]?\s*\d|\s*\(")
_COMPONENT_LABELS = ("MAT", "MP", "REAL", "TYPE", "ALL", "")


class _Parser:
    """State of the parser of a deck: the table of temperatures and the last set of constants."""

    def __init__(self, deck: AnsysDeck) -> None:
        self.deck = deck
        self.temperatures: dict[int, str] = {}
        self.last_real: int | None = None
        self.open = 0  # blocks of *IF and *DO
        self.last = ""  # command
        self.ending: tuple[str, int] | None = None  # /EOF

    def take(self, lines: Sequence[str], at: int) -> int:
        """Parse the command at a line; return its number of lines."""
        line = lines[at]
        found = re.match(
            r"\s*/COM\s*,\s*ANSYS\s+(?:MECHANICAL\s+APDL\s+)?RELEASE\s+([\d.]+)(?:\s*R(\d))?",
            line,
            re.I,
        )
        if found:
            self.deck.release = _release(found[1], found[2])
        if line.lstrip().upper().startswith(("/COM", "/TITLE", "C***")) or _DATA.match(line):
            return 1
        length = 1
        for command in line.split("!")[0].split("$"):
            fields = [f.strip() for f in command.split(",")]
            name = fields[0].upper()
            if not name:
                continue
            self._note_effects(name, fields[1:], at + 1)
            if name in ("NBLOCK", "EBLOCK", "CMBLOCK", "RLBLOCK", "ETBLOCK"):
                return self._block(name, fields, lines, at)
            self._command(name, fields[1:], at + 1)
            if name in FORMATTED:
                length = 2
                while lines[at + length - 1 : at + length] and lines[at + length - 1].endswith("&"):
                    length += 1
        return length

    def _note_effects(self, name: str, fields: Sequence[str], line: int) -> None:
        """Record the possible changes by an uninterpreted command."""
        if self.ending is not None:
            end, at = self.ending
            self._doubt((MATERIAL, REAL), at, f"{end} ends the deck, but commands follow")
            self.ending = None
        kinds = _changed_by(name)
        if name in _ENDING:
            self.ending = (name, line)
        elif name in _OPENING or (name == "*IF" and "THEN" in map(str.upper, fields)):
            self.open += 1
        elif name in _CLOSING:
            self.open = max(self.open - 1, 0)
        elif name == "*IF":
            self._doubt((MATERIAL, REAL), line, "*IF without THEN skips commands")
        elif name[:4] == "*REP":
            self._doubt(_changed_by(self.last), line, f"*REPEAT repeats {self.last}")
        elif name[:4] in ("NUMM", "NUMC", "NUMO"):
            has_any = self.deck.materials or self.deck.reals or self.deck.types
            if has_any and _field_at(fields, 0).upper() in _COMPONENT_LABELS:
                self._doubt((MATERIAL, REAL), line, f"{name} renumbers properties")
        elif kinds:
            if self.open:
                self._doubt(kinds, line, f"{name} is within *IF or *DO")
        elif reason := find_affected_kinds(name):
            self._doubt(reason[0], line, f"{name} {reason[1]}")
        elif not ("=" in name or name.startswith(":") or name in _BRANCHES or is_harmless(name)):
            self._doubt((MATERIAL, REAL), line, f"{name[:40]} is not a known command")
        self.last = name

    def _doubt(
        self, kinds: tuple[str, ...], line: int, reason: str, number: int | None = None
    ) -> None:
        self.deck.doubts.append(Doubt(kinds, line, reason, number))

    def _command(self, name: str, fields: list[str], line: int) -> None:
        short = name[:4]
        first = _whole(_field_at(fields, 0))
        if name == "MP":
            label = _field_at(fields, 0).upper()[:4]
            values = _strip_blank_fields(fields[2:])
            if label and not values:
                number = _whole(_field_at(fields, 1) or "1")
                self._doubt((MATERIAL,), line, f"MP,{label} has no value", number)
            self._material(label, _field_at(fields, 1) or "1", values, (), line)
        elif short == "MPTE" and name.startswith("MPTEMP"):
            self._temperatures(fields, line)
        elif short == "MPDA":
            self._data(fields, line)
        elif short == "MPDE":
            self._delete(fields, line)
        elif name == "TB":
            self._table(fields, line)
        elif name == "ET" and first is not None:
            routine = re.search(r"(\d+)$", _field_at(fields, 1))
            self.deck.types[first] = (_whole(routine[1]) or 0) if routine else 0
        elif name == "R" and first is not None:
            self.deck.reals[first] = RealSet(tuple(fields[1:7]), line)
            self.last_real = first
        elif short == "RMOD" and first is not None and first in self.deck.reals:
            old = self.deck.reals[first]
            start = self._place(_field_at(fields, 1), line)
            self.deck.reals[first] = RealSet(_overlay(old.values, start, fields[2:8]), old.line)
        elif short == "RMOR" and self.last_real is not None:
            old = self.deck.reals[self.last_real]
            filled = old.values + ("",) * (-len(old.values) % 6)
            self.deck.reals[self.last_real] = RealSet(filled + tuple(fields[:6]), old.line)
        elif name in ("ET", "R") or short in ("RMOD", "RMOR"):
            self._doubt((REAL,), line, f"{name},{_field_at(fields, 0)} has no known number")

    def _table(self, fields: list[str], line: int) -> None:
        """Record a table of elasticity or damping."""
        if _field_at(fields, 0).upper()[:4] not in _TABLES:
            return
        material = _whole(_field_at(fields, 1) or "1")
        if material is None:
            self._doubt((MATERIAL,), line, f"TB refers to material {_field_at(fields, 1)!r}")
        else:
            self.deck.tables[material or 1] = line

    def _delete(self, fields: list[str], line: int) -> None:
        """Delete properties: MPDELE, label, first material, last one, step."""
        label = _field_at(fields, 0).upper()[:4]
        first, last, step = (
            _whole(_field_at(fields, i) or d) for i, d in ((1, "1"), (2, "0"), (3, "1"))
        )
        meant = list(self.deck.materials)
        if not meant:
            return
        if _field_at(fields, 1).upper() != "ALL":
            if first is None or last is None or step is None or step < 1:
                self._doubt(
                    (MATERIAL,), line, f"MPDELE refers to material {_field_at(fields, 1)!r}"
                )
                return
            numbers = range(first, max(last, first) + 1, step)
            meant = [number for number in meant if number in numbers]
        for number in meant:
            if label == "ALL":
                del self.deck.materials[number]
            else:
                self.deck.materials[number].pop(label, None)

    def _temperatures(self, fields: list[str], line: int) -> None:
        if _field_at(fields, 0).upper().startswith(_UNBLOCKED):
            fields = fields[2:]
        start = _whole(_field_at(fields, 0))
        if start is None:
            if _field_at(fields, 0):
                self._doubt((MATERIAL,), line, f"MPTEMP starts at {_field_at(fields, 0)!r}")
            self.temperatures = {}  # MPTEMP without values deletes the table
            return
        if start == 1:
            self.temperatures = {}
        for place, temperature in enumerate(fields[1:], start):
            if temperature:
                self.temperatures[place] = temperature

    def _data(self, fields: list[str], line: int) -> None:
        if _field_at(fields, 0).upper().startswith(_UNBLOCKED):
            fields = fields[2:]
        label = _field_at(fields, 0).upper()[:4]
        number = _field_at(fields, 1) or "1"
        start = self._place(_field_at(fields, 2), line)
        values = _strip_blank_fields(fields[3:])
        old = self.deck.materials.get(_whole(number) or 0, {}).get(label)
        if start > 1:
            values = list(_overlay(() if old is None else old.values, start, values))
        places = range(1, len(values) + 1)
        temperatures = tuple(self.temperatures.get(place, "0.0") for place in places)
        self._material(label, number, values, temperatures, line)

    def _place(self, text: str, line: int) -> int:
        """Return the position of the first number in a set or a table, by default 1."""
        place = _whole(text) or 1
        if not 1 <= place <= DECK.property_values:
            raise FormatError(
                f"numbers from position {place} on; expected 1 to {DECK.property_values}",
                self.deck.path,
                line,
            )
        return place

    def _material(
        self, label: str, number: str, values: list[str], temperatures: tuple[str, ...], line: int
    ) -> None:
        material = _whole(number)
        if material is None:
            self._doubt((MATERIAL,), line, f"{label} refers to material {number!r}")
            return
        found = AnsysProperty(tuple(values), temperatures, line)
        self.deck.materials.setdefault(material, {})[label] = found

    def _block(self, name: str, fields: list[str], lines: Sequence[str], at: int) -> int:
        if name == "RLBLOCK":
            return self._real_block(fields, lines, at)
        if name == "ETBLOCK":
            return self._type_block(fields, lines, at)
        if name == "CMBLOCK":
            count = abs(_whole(_field_at(fields, 3).split("!")[0].strip()) or 0)
            each = _width(lines, at + 1, self.deck.path)[0]
            stop = at + 2 + -(-count // each)
            for row in range(at + 2, stop):
                if re.fullmatch(r"[\s\d-]+", _field_at(lines, row)) is None:
                    raise FormatError(
                        f"CMBLOCK: found {_field_at(lines, row).strip()[:40]!r}; expected {count}"
                        " numbers in all",
                        self.deck.path,
                        row + 1,
                    )
            return stop - at
        length = 2
        solid = name == "EBLOCK" and len(fields) > 2 and fields[2].upper().startswith("SOL")
        width = _width(lines, at + 1, self.deck.path)[1]
        held = 0  # numbers of the element on its following lines
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
            numbers = [parse_integer(f) for f in fields if f.strip()]
        except ValueError as error:
            raise FormatError(
                f"EBLOCK: found {line.strip()!r}, expected integers of {width} characters",
                self.deck.path,
                at,
            ) from error
        if held > 0:
            return held - len(numbers)
        if len(numbers) < 11:
            return 0
        self.deck.users.setdefault(numbers[2], set()).add(numbers[1])
        return numbers[8] - (len(numbers) - 11)

    def _type_block(self, fields: list[str], lines: Sequence[str], at: int) -> int:
        """Read ETBLOCK, whose rows are number and routine of a type; return its number of lines."""
        _, width = _width(lines, at + 1, self.deck.path)
        row = at + 2
        while row < len(lines) and not re.match(r"\s*-1\b", lines[row]):
            number = _whole(lines[row][:width])
            routine = _whole(lines[row][width : 2 * width])
            if number is None or routine is None:
                raise FormatError(
                    f"ETBLOCK: found {lines[row].strip()[:40]!r}; expected number and routine of a"
                    " type",
                    self.deck.path,
                    row + 1,
                )
            self.deck.types[number] = routine
            row += 1
        return row + 1 - at

    def _real_block(self, fields: list[str], lines: Sequence[str], at: int) -> int:
        """Read RLBLOCK; return its number of lines."""
        # Two lines of format, then each set: its number, the number of its constants, and these.
        sets = _whole(_field_at(fields, 1)) or 0
        path = self.deck.path
        _, width = _width(lines, at + 1, path)
        row = at + 3
        for _ in range(sets):
            if row >= len(lines):
                raise FormatError("RLBLOCK: ends before its last set", path, row)
            text = lines[row]
            number = _whole(text[:width].strip())
            count = _whole(text[width : 2 * width].strip())
            if number is None or count is None:
                raise FormatError(
                    f"RLBLOCK: expected the number of a set and the number of its constants,"
                    f" found {text!r}",
                    path,
                    row + 1,
                )
            values = _numbers(text[2 * width :])
            start = row + 1
            while len(values) < count and row + 1 < len(lines):
                row += 1
                values += _numbers(lines[row])
            self.deck.reals[number] = RealSet(tuple(values[:count]), start)
            row += 1
        return row - at


def _changed_by(name: str) -> tuple[str, ...]:
    """Return the kinds of property that an interpreted command changes."""
    if name in ("MP", "TB") or name[:4] in ("MPTE", "MPDA", "MPDE"):
        return (MATERIAL,)
    if name in ("R", "ET", "RLBLOCK", "ETBLOCK") or name[:4] in ("RMOD", "RMOR"):
        return (REAL,)
    return ()


def _release(number: str, half: str | None) -> float:
    major, _, minor = number.strip(".").partition(".")
    minor = minor.partition(".")[0]
    return float(f"{major or 0}.{half or minor or 0}")


def _numbers(text: str) -> list[str]:
    return re.findall(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?", text)


def _width(lines: Sequence[str], at: int, path: Path) -> tuple[int, int]:
    """Return number and width of the integers on a line of a block, from its format ``(19i10)``."""
    found = re.match(r"\s*\(\s*([1-9]\d{0,3})i([1-9]\d{0,3})", _field_at(lines, at), re.I)
    if found is None:
        raise FormatError("a block without its format, such as (19i10)", path, at + 1)
    return int(found[1]), int(found[2])


def _field_at(fields: Sequence[str], i: int) -> str:
    """Return a field, or an empty text if missing."""
    return fields[i] if i < len(fields) else ""


def _strip_blank_fields(fields: Sequence[str]) -> list[str]:
    """Return fields without trailing blank ones."""
    out = list(fields)
    while out and not out[-1]:
        out.pop()
    return out


def _overlay(old: Sequence[str], start: int, new: Sequence[str]) -> tuple[str, ...]:
    """Return `old` with `new` from position `start` (from 1) on; blank numbers change nothing."""
    kept = _strip_blank_fields(new)
    out = [*old, *[""] * (start - 1 + len(kept) - len(old))]
    for place, value in enumerate(kept, start - 1):
        out[place] = value or out[place]
    return tuple(out)


def _whole(text: str) -> int | None:
    try:
        value = parse_real(text)
    except ValueError:
        return None
    return int(value) if value.is_integer() else None
