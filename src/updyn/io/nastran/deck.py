"""A Nastran deck: its cards by kind with checked references, its groups and its geometry.

The tables define the fields that hold stiffness and mass. Fields are counted from 0 after the name
of the card: field 2 of the manuals is 0 (MSC Nastran Quick Reference Guide, bulk data entries).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from updyn.arrays import IntArray, RealArray
from updyn.errors import FormatError, nearest, suggest
from updyn.geometry import Geometry
from updyn.grouping import GroupOrigin, label_groups
from updyn.io.consistent_units import find_units
from updyn.io.items import locate_errors
from updyn.io.nastran.cards import NastranCard, parse, read_lines
from updyn.io.nastran.fields import NastranLine
from updyn.io.nastran.neutral import NEUTRAL, check_neutral, split_equations
from updyn.io.nastran.sets import read_sets
from updyn.io.settings import DECK
from updyn.shapes import (
    HEXAHEDRON,
    LINE,
    QUADRANGLE,
    TETRAHEDRON,
    TRIANGLE,
    WEDGE,
    Shape,
    unique_edges,
    unique_faces,
)

__all__ = [
    "ELEMENTS",
    "MATERIALS",
    "PROPERTIES",
    "PUNCHED_MATRICES",
    "SELF_CONTAINED",
    "TIES",
    "NastranDeck",
    "NastranElement",
    "Values",
    "build_geometry",
    "build_points_deck",
    "find_enddata",
    "materials_of",
    "read_deck",
    "read_points",
    "section_fields",
    "values",
]


@dataclass(frozen=True, slots=True)
class NastranElement:
    """Layout of an element card: fields of its grids, and property cards of its second field.

    `properties` is empty if the element holds its properties itself.
    """

    nodes: tuple[int, ...]
    properties: tuple[str, ...] = ()
    shape: Shape | None = None


def _fields(n: int, start: int = 2) -> tuple[int, ...]:
    return tuple(range(start, start + n))


_SHELL = ("PSHELL", "PCOMP")
_SOLID = ("PSOLID",)

ELEMENTS = {
    "CBAR": NastranElement((2, 3), ("PBAR", "PBARL"), LINE),
    "CBEAM": NastranElement((2, 3), ("PBEAM", "PBEAML"), LINE),
    "CROD": NastranElement((2, 3), ("PROD",), LINE),
    "CTUBE": NastranElement((2, 3), ("PTUBE",), LINE),
    "CONROD": NastranElement((1, 2), (), LINE),
    "CBUSH": NastranElement((2, 3), ("PBUSH",), LINE),
    "CELAS1": NastranElement((2, 4), ("PELAS",), LINE),
    "CELAS2": NastranElement((2, 4), (), LINE),
    "CQUAD4": NastranElement(_fields(4), _SHELL, QUADRANGLE),
    "CQUADR": NastranElement(_fields(4), _SHELL, QUADRANGLE),
    "CQUAD8": NastranElement(_fields(8), _SHELL, QUADRANGLE),
    "CTRIA3": NastranElement(_fields(3), _SHELL, TRIANGLE),
    "CTRIAR": NastranElement(_fields(3), _SHELL, TRIANGLE),
    "CTRIA6": NastranElement(_fields(6), _SHELL, TRIANGLE),
    "CSHEAR": NastranElement(_fields(4), ("PSHEAR",), QUADRANGLE),
    "CTETRA": NastranElement(_fields(10), _SOLID, TETRAHEDRON),
    "CPENTA": NastranElement(_fields(15), _SOLID, WEDGE),
    "CHEXA": NastranElement(_fields(20), _SOLID, HEXAHEDRON),
    "CONM2": NastranElement((1,)),
    "CMASS1": NastranElement((2, 4), ("PMASS",)),
    "CMASS2": NastranElement((2, 4)),
    "CDAMP1": NastranElement((2, 4), ("PDAMP",), LINE),
    "CDAMP2": NastranElement((2, 4), (), LINE),
}
#: Elements that hold their properties themselves: a group each.
SELF_CONTAINED = tuple(name for name, e in ELEMENTS.items() if not e.properties)
PROPERTIES = tuple(dict.fromkeys(p for e in ELEMENTS.values() for p in e.properties))
MATERIALS = ("MAT1", "MAT2", "MAT8", "MAT9")
#: Ties between grids, and supports; they belong to no group.
TIES = ("RBAR", "RBE1", "RBE2", "RBE3", "MPC", "MPCADD", "SPC", "SPC1", "SPCADD")
#: Number of dimensions of the sections of PBARL and PBEAML (Quick Reference Guide, PBARL, figure of
#: sections).
_SECTIONS = {
    "ROD": 1, "TUBE": 2, "TUBE2": 2, "I": 6, "CHAN": 4, "T": 4, "BOX": 4, "BAR": 2, "CROSS": 4,
    "H": 4, "T1": 4, "I1": 4, "CHAN1": 4, "Z": 4, "CHAN2": 4, "T2": 4, "BOX1": 6, "HEXA": 3,
    "HAT": 4, "HAT1": 5, "DBOX": 10, "L": 4,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Values:
    """Fields of a card that hold stiffness, mass, loss factor GE and viscous damping."""

    stiffness: tuple[int, ...] = ()
    mass: tuple[int, ...] = ()
    loss: tuple[int, ...] = ()
    viscous: tuple[int, ...] = ()


_VALUES = {
    "MAT1": Values((1, 2), (4,), (7,)),
    "MAT2": Values(tuple(range(1, 7)), (7,), (12,)),
    "MAT8": Values((1, 2, 4, 5, 6), (7,), (16,)),
    "MAT9": Values(tuple(range(1, 22)), (22,), (30,)),
    "PBAR": Values((), (6,)),
    "PROD": Values((), (5,)),
    "PTUBE": Values((), (4,)),
    "CONROD": Values((), (7,)),
    "PSHEAR": Values((), (3,)),
    "PSHELL": Values((), (7,)),
    "PCOMP": Values((), (2,), (6,)),
    "PSOLID": Values(),
    "PELAS": Values((1,), (), (2,)),
    "CELAS2": Values((1,), (), (6,)),
    "CONM2": Values((), (3, 8, 9, 10, 11, 12, 13)),
    "PMASS": Values((), (1,)),
    "CMASS2": Values((), (1,)),
    "PDAMP": Values(viscous=(1,)),
    "CDAMP2": Values(viscous=(1,)),
}


#: Largest number of fields of the cards of fixed length (Quick Reference Guide). Lists (SPC1, RBE2,
#: PCOMP, ...) and MAT8, which ends with failure theories, have no limit.
_MOST_FIELDS = {
    "GRID": 8, "GRDSET": 8, "SPOINT": 8,
    "CORD1R": 8, "CORD1C": 8, "CORD1S": 8, "CORD2R": 11, "CORD2C": 11, "CORD2S": 11,
    "CBAR": 16, "CBEAM": 18, "CROD": 4, "CTUBE": 4, "CONROD": 8, "CBUSH": 13, "CELAS1": 6,
    "CELAS2": 8, "CQUAD4": 14, "CQUADR": 14, "CQUAD8": 17, "CTRIA3": 13, "CTRIAR": 13,
    "CTRIA6": 14, "CSHEAR": 6, "CTETRA": 12, "CPENTA": 17, "CHEXA": 22, "CONM2": 14, "CMASS1": 6,
    "CMASS2": 6, "CDAMP1": 6, "CDAMP2": 6,
    "PBAR": 19, "PROD": 6, "PTUBE": 6, "PSHEAR": 6, "PELAS": 8, "PDAMP": 8, "PMASS": 8,
    "PSHELL": 11, "PSOLID": 8, "MAT1": 12, "MAT2": 17, "MAT9": 31,
    "RBAR": 9, "SPC": 7, "PARAM": 8,
}  # fmt: skip


def _check_length(card: NastranCard) -> None:
    """Refuse a card with more fields than its kind has, because one of them is misplaced."""
    most = _MOST_FIELDS.get(card.name)
    if most is None or len(card.fields) <= most:
        return
    at = next(i for i in range(most, len(card.fields)) if card.fields[i])
    raise card.error(
        f"{card.name} {card.text(0)}: field {at + 2} is {card.fields[at]!r}; {card.name} ends with"
        f" field {most + 1}"
    )


def values(card: NastranCard) -> Values:
    """Return the fields of a property or material card that hold stiffness, mass and damping."""
    if card.name == "PBARL":
        return Values((), (8 + section_fields(card),))
    if card.name == "PBEAML":
        # Each station has its dimensions and its mass, preceded by SO and X/XB from the second on.
        n = section_fields(card) + 1
        return Values((), (8 + n - 1, *range(8 + 2 * n + 1, len(card.fields), n + 2)))
    if card.name == "PBEAM":
        return Values((), _masses_of_pbeam(card))
    if card.name == "PBUSH":
        return _values_of_pbush(card)
    return _VALUES[card.name]


def section_fields(card: NastranCard) -> int:
    """Return the number of dimensions of the section of a PBARL or PBEAML."""
    kind = card.text(3)
    if kind not in _SECTIONS:
        raise card.error(
            f"{card.name} {card.text(0)}: section {kind!r}; known: {', '.join(_SECTIONS)}"
        )
    return _SECTIONS[kind]


def _masses_of_pbeam(card: NastranCard) -> tuple[int, ...]:
    stations = ("YES", "YESA", "NO")
    at = 8 if card.text(8) in stations else 16  # the line of stress points is optional
    found = [7]
    while card.text(at) in stations:
        found.append(at + 7)
        # A station has a line of stress points only if SO = YES.
        at += 16 if card.text(at) == "YES" else 8
    return (*found, at + 4, at + 5)


def _values_of_pbush(card: NastranCard) -> Values:
    stiffness: tuple[int, ...] = ()
    loss: tuple[int, ...] = ()
    viscous: tuple[int, ...] = ()
    for at in range(1, len(card.fields), 8):
        kind = card.text(at)
        six = card.nonempty(range(at + 1, at + 7))
        if kind == "K":
            stiffness = six
        elif kind == "GE":
            loss = six
        elif kind == "B":
            viscous = six
        elif kind == "M" and any(card.reals(six)):
            raise card.error(
                f"PBUSH {card.text(0)}: M (field {at + 2}) is not supported; expected only K, B and"
                " GE"
            )
        elif kind not in ("M", "RCV", "T", ""):
            raise card.error(
                f"PBUSH {card.text(0)}: field {at + 2} is {kind!r}; expected K, B or GE"
            )
    return Values(stiffness, (), loss, viscous)


def materials_of(card: NastranCard) -> tuple[int, ...]:
    """Return the fields of a property card (or a CONROD) that refer to materials."""
    if card.name == "PSHELL":
        fields: tuple[int, ...] = (1, 3, 5, 10)
    elif card.name == "PCOMP":
        fields = tuple(range(8, len(card.fields), 4))
    elif card.name == "CONROD":
        fields = (3,)
    elif card.name in ("PBUSH", "PDAMP", "PELAS", "PMASS", *SELF_CONTAINED):
        fields = ()
    else:
        fields = (1,)
    return card.nonempty(fields)


SYSTEMS = ("CORD1R", "CORD1C", "CORD1S", "CORD2R", "CORD2C", "CORD2S")
_POINTS = ("GRID", "GRDSET", "SPOINT")
_STRUCTURAL = (*_POINTS, *SYSTEMS, *ELEMENTS, *PROPERTIES, *MATERIALS, *TIES, "PARAM")
_KNOWN = NEUTRAL.union(_STRUCTURAL)
#: Cards of superelements.
_SUPERELEMENTS = (
    *("CSUPER", "CSUPEXT", "EXTRN", "RELEASE", "SEBNDRY", "SEBSET", "SEBSET1", "SEBULK"),
    *("SECONCT", "SECSET", "SECSET1", "SEELT", "SEEXCLD", "SELABEL", "SELOAD", "SELOC", "SEMPLN"),
    *("SENQSET", "SEQSET", "SEQSET1", "SESET", "SESUP", "SETREE", "SEUSET", "SEUSET1"),
)
#: Remedy for decks that cannot be assembled here (MSC Nastran Quick Reference Guide, parameter
#: EXTOUT and case control command EXTSEOUT).
PUNCHED_MATRICES = (
    "let Nastran punch the matrices, and read the .pch file: PARAM,EXTOUT,DMIGPCH in bulk data, or"
    " EXTSEOUT(STIFFNESS,MASS,DMIGPCH) in case control"
)
_BULK = re.compile(r"\s*BEGIN\s+BULK|\s*BEGIN\s*$", re.IGNORECASE)
_SUPER = re.compile(r"\s*BEGIN\s+(?:BULK\s+)?SUPER", re.IGNORECASE)
_SELECTED = re.compile(r"\s*(SPC|MPC)\s*=\s*(\S+)\s*$", re.IGNORECASE)
#: Cards that can hold several entries: number of fields of each entry.
_DOUBLE = {"PELAS": 4, "PDAMP": 2, "PMASS": 2, "CORD1R": 4, "CORD1C": 4, "CORD1S": 4}


@dataclass(frozen=True)  # no slots, for the cached properties
class NastranDeck:
    """A deck whose cards are consistent.

    `case` is executive and case control; `cards` are without those that change neither stiffness
    nor mass, whose names are `neutral`.
    """

    path: Path
    case: tuple[NastranLine, ...]
    cards: tuple[NastranCard, ...]
    neutral: tuple[str, ...] = ()

    def cards_named(self, *names: str) -> list[NastranCard]:
        """Return the cards with these names, in order."""
        return [card for card in self.cards if card.name in names]

    @cached_property
    def grids(self) -> dict[int, NastranCard]:
        """Grid cards by number."""
        return _by_number(self.cards_named("GRID"), "GRID")

    @cached_property
    def points(self) -> dict[int, NastranCard]:
        """Scalar points: the defining card by number."""
        out: dict[int, NastranCard] = {}
        for card in self.cards_named("SPOINT"):
            if card.text(1) == "THRU":
                numbers: Sequence[int] = range(card.integer(0), card.integer(2) + 1)
            else:
                numbers = card.integers(card.nonempty(range(len(card.fields))))
            if len(out) + len(numbers) > DECK.scalar_points:
                raise card.error(
                    f"SPOINT: more than {DECK.scalar_points} scalar points in the deck; expected"
                    " fewer"
                )
            out |= dict.fromkeys(numbers, card)
        return out

    @cached_property
    def materials(self) -> dict[int, NastranCard]:
        """Material cards by number."""
        return _by_number(self.cards_named(*MATERIALS), "material")

    @cached_property
    def properties(self) -> dict[int, NastranCard]:
        """Property cards by number."""
        return _by_number(self.cards_named(*PROPERTIES), "property")

    @cached_property
    def elements(self) -> list[NastranCard]:
        """Element cards."""
        return self.cards_named(*ELEMENTS)

    @cached_property
    def groups(self) -> dict[str, NastranCard]:
        """Groups by name: the property card, or the element if it holds its properties itself."""
        found: dict[str, NastranCard] = {}
        for card in self.elements:
            found[self.group_name_of(card)] = self.group_of(card)
        return found

    @cached_property
    def origins(self) -> dict[str, GroupOrigin]:
        """Materials of each group, and sets with all or some of its elements, by group."""
        elements: dict[str, list[int]] = {name: [] for name in self.groups}
        for card in self.elements:
            elements[self.group_name_of(card)].append(card.integer(0))
        numbers = sorted(card.integer(0) for card in self.elements)
        sets = {found.label: found.select(numbers) for found in read_sets(self.case)}
        origins = label_groups(elements, sets)
        for name, card in self.groups.items():
            materials = [f"{m.name} {m.integer(0)}" for m in self.materials_of(card)]
            labels = dict.fromkeys([*materials, *origins[name].labels])
            origins[name] = replace(origins[name], labels=tuple(labels))
        return origins

    def group_name_of(self, element: NastranCard) -> str:
        """Return the name of the group of an element."""
        defining_card = self.group_of(element)
        return f"{defining_card.name} {defining_card.integer(0)}"

    def group_of(self, element: NastranCard) -> NastranCard:
        """Return the card that defines the group of an element: its property, or the element."""
        if element.name in SELF_CONTAINED:
            return element
        # The default number of the property is the number of the element.
        return self.properties[element.integer(1, element.integer(0))]

    def materials_of(self, card: NastranCard) -> list[NastranCard]:
        """Return the material cards that a property card (or a CONROD) refers to."""
        return [self.materials[number] for number in card.integers(materials_of(card))]

    def nodes_of(self, element: NastranCard) -> list[int]:
        """Return the numbers of the grids of an element, in order."""
        return element.integers(element.nonempty(ELEMENTS[element.name].nodes))

    def group(self, name: str) -> NastranCard:
        """Return the card that defines a group; raise a FormatError if it does not exist."""
        if name not in self.groups:
            raise FormatError(
                f"no group {name!r} in the deck; {suggest(name, self.groups)}", self.path
            )
        return self.groups[name]

    @cached_property
    def _parameters(self) -> list[NastranCard]:
        return self.cards_named("PARAM")

    def parameter(self, name: str, default: float) -> float:
        """Return the value of the last PARAM card with this name."""
        value = default
        for card in self._parameters:
            if card.text(0) == name:
                value = card.real(1)
        return value

    def select_set(self, what: str, given: int | None) -> int:
        """Return the number of the SPC or MPC set in use (`what`), 0 for no set."""
        kinds = {"SPC": ("SPC", "SPC1", "SPCADD"), "MPC": ("MPC", "MPCADD")}[what]
        sets = {card.integer(0) for card in self.cards_named(*kinds)}
        option = f"{what.lower()}="
        chosen: dict[str, NastranLine] = {}
        for line in self.case:
            found = _SELECTED.match(line.text)
            if found and found[1].upper() == what:
                chosen[found[2]] = line
        if given is not None:
            number = str(given)
        elif len(chosen) > 1:
            raise next(reversed(chosen.values())).error(
                f"{what} sets {', '.join(sorted(chosen))} in one deck; select one with {option}"
            )
        elif chosen:
            number = next(iter(chosen))
        elif sets:
            raise FormatError(
                f"{what} sets {_list(sets)}, but case control selects none; select one with"
                f" {option} (0 for none)",
                self.path,
            )
        else:
            return 0
        if not number.isdecimal() or (int(number) and int(number) not in sets):
            raise FormatError(
                f"no {what} set {number}; available: {_list(sets) or 'none'}", self.path
            )
        return int(number)


def read_deck(path: str | Path, ignore: Iterable[str] | None = ()) -> NastranDeck:
    """Read a deck and check its cards; `ignore` None ignores all unknown cards."""
    path = Path(path)
    left_out = {name.upper() for name in ignore or ()}
    case, lines = _split_sections(list(read_lines(path)))
    bulk, n_equations = split_equations(lines)
    cards: list[NastranCard] = []
    neutral = ["DEQATN"] * n_equations
    for card in parse(iter(bulk)):
        if card.name not in _KNOWN and ignore is None:
            continue
        if card.name not in _KNOWN and card.name not in left_out:
            raise _unknown_card_error(card)
        if card.name in left_out:
            continue
        if card.name in NEUTRAL:
            check_neutral(card)
            neutral.append(card.name)
        else:
            cards += _split_entries(card)
    deck = NastranDeck(path, tuple(case), tuple(cards), tuple(neutral))
    _check(deck)
    return deck


def _unknown_card_error(card: NastranCard) -> FormatError:
    """Return the error for a card that may change the structure."""
    near = nearest(card.name, _STRUCTURAL)
    remedy = f"did you mean {' or '.join(map(repr, near))}?"
    if card.name in _SUPERELEMENTS or not near:
        remedy = PUNCHED_MATRICES
    kind = "belongs to superelements, which are not assembled"
    if card.name not in _SUPERELEMENTS:
        kind = "is not known and may change the structure"
    return card.error(
        f'card {card.name} {kind}; {remedy} (to ignore the card: ignore=["{card.name}"])'
    )


def read_points(path: str | Path, ignore: Iterable[str] = ()) -> NastranDeck:
    """Read the grids, scalar points, coordinate systems and elements of a deck.

    Properties and materials may be missing. Unknown cards that may define points are refused.
    """
    path = Path(path)
    left_out = {name.upper() for name in ignore}
    case, lines = _split_sections(list(read_lines(path)))
    bulk, _ = split_equations(lines)
    points = (*_POINTS, *SYSTEMS)
    cards: list[NastranCard] = []
    for card in parse(iter(bulk)):
        if card.name in left_out:
            continue
        if card.name in points or card.name in ELEMENTS:
            cards += _split_entries(card)
        elif card.name not in _KNOWN and nearest(card.name, points):
            raise card.error(
                f"card {card.name} is not known and may define positions of points;"
                f" {suggest(card.name, points)} "
                f'(to ignore it: ignore=["{card.name}"])'
            )
    return build_points_deck(path, cards, case)


def build_points_deck(
    path: Path, cards: Iterable[NastranCard], case: Iterable[NastranLine] = ()
) -> NastranDeck:
    """Return a deck of grids, points, coordinate systems and elements."""
    deck = NastranDeck(path, tuple(case), tuple(cards))
    _check_points(deck)
    for card in deck.elements:
        _check_grids(deck, card)
    return deck


def _split_sections(lines: list[NastranLine]) -> tuple[list[NastranLine], list[NastranLine]]:
    """Return the lines of executive and case control, and the lines of bulk data."""
    case: list[NastranLine] = []
    bulk = lines
    for i, line in enumerate(lines):
        if _BULK.match(line.text):
            case, bulk = lines[:i], lines[i + 1 :]
            break
    bulk = bulk[: find_enddata(bulk)]
    for line in bulk:
        if _SUPER.match(line.text):
            raise line.error(
                f"{line.text.strip()!r}: superelements are not assembled; {PUNCHED_MATRICES}"
            )
    return case, bulk


def find_enddata(lines: Sequence[NastranLine]) -> int:
    """Return the position of the line ENDDATA, or the number of lines without it."""
    for i, line in enumerate(lines):
        if line.text.strip().upper().startswith("ENDDATA"):
            return i
    return len(lines)


def _split_entries(card: NastranCard) -> list[NastranCard]:
    """Return the separate entries of a card; some kinds hold several."""
    _check_length(card)
    n = _DOUBLE.get(card.name)
    if n is None or len(card.fields) <= n:
        return [card]
    starts = range(0, len(card.fields), n)
    return [NastranCard(card.name, card.fields[i : i + n], card.lines) for i in starts]


def _by_number(cards: Iterable[NastranCard], what: str) -> dict[int, NastranCard]:
    out: dict[int, NastranCard] = {}
    for card in cards:
        number = card.integer(0)
        if number in out:
            raise card.error(f"{what} {number} is defined twice: also {out[number].lines[0].place}")
        out[number] = card
    return out


def _list(numbers: Iterable[int]) -> str:
    return ", ".join(map(str, sorted(numbers)))


def _nearest_numbers(number: int, known: Mapping[int, NastranCard]) -> str:
    best = sorted(known, key=lambda n: abs(n - number))[:3]
    return f"nearest: {_list(best)}" if best else "the deck has none"


def _check_points(deck: NastranDeck) -> None:
    if not deck.grids and not deck.points:
        raise FormatError(
            "no GRID card: not a deck, or a part of the bulk data of another file", deck.path
        )


def _check_grids(deck: NastranDeck, element: NastranCard) -> None:
    for node in deck.nodes_of(element):
        if node and node not in deck.grids and node not in deck.points:
            raise element.error(
                f"{element.name} {element.text(0)}: no grid {node};"
                f" {_nearest_numbers(node, deck.grids)}"
            )


def _check(deck: NastranDeck) -> None:
    _check_points(deck)
    places = deck.grids | deck.points
    for card in deck.elements:
        _check_property(deck, card)
        _check_grids(deck, card)
    for card in deck.groups.values():
        values(card)
        for number in card.integers(materials_of(card)):
            if number not in deck.materials:
                raise card.error(
                    f"{card.name} {card.text(0)}: no material {number} among"
                    f" {', '.join(MATERIALS)}; " + _nearest_numbers(number, deck.materials)
                )
    for card in deck.cards_named(*TIES):
        for field, node in _find_tied_grids(card):
            if node not in places:
                raise card.error(
                    f"{card.name}: field {field + 2} names grid {node};"
                    f" {_nearest_numbers(node, places)}"
                )


def _check_property(deck: NastranDeck, element: NastranCard) -> None:
    kinds = ELEMENTS[element.name].properties
    if not kinds:
        return
    number = element.integer(1, element.integer(0))
    found = deck.properties.get(number)
    if found is None:
        raise element.error(
            f"{element.name} {element.text(0)}: no property {number};"
            f" {_nearest_numbers(number, deck.properties)}"
        )
    if found.name not in kinds:
        raise element.error(
            f"{element.name} {element.text(0)}: property {number} is a {found.name}; expected"
            f" {' or '.join(kinds)}"
        )


def _find_tied_grids(card: NastranCard) -> list[tuple[int, int]]:
    """Return (field, grid) of the grids that a tie or a support refers to."""
    n = len(card.fields)
    if card.name == "MPC":
        at = [*range(1, n, 8), *range(4, n, 8)]
    elif card.name == "SPC":
        at = [1, 4]
    elif card.name == "RBE2":
        has_alpha = n > 4 and "." in card.text(n - 1)  # the coefficient of expansion, a real number
        at = [1, *range(3, n - has_alpha)]
    elif card.name == "RBE3":
        at = _grids_of_rbe3(card)
    elif card.name == "RBAR":
        at = [1, 2]
    elif card.name == "SPC1" and card.text(3) != "THRU":
        at = list(range(2, n))
    else:
        return []
    return [(i, card.integer(i)) for i in card.nonempty(at) if card.text(i) != "THRU"]


def _grids_of_rbe3(card: NastranCard) -> list[int]:
    """Return the fields of an RBE3 that refer to grids."""
    # EID, blank, REFGRID, REFC, then WT, C, grids, the next WT, C, grids, ..., UM or ALPHA and
    # their values.
    found = [2]
    at = 4
    while at < len(card.fields):
        cell = card.text(at)
        if cell in ("UM", "ALPHA"):
            break
        if "." in cell:
            at += 2  # a weight and its components
            continue
        if cell:
            found.append(at)
        at += 1
    return found


@dataclass(frozen=True, slots=True)
class _NastranSystem:
    """A coordinate system: kind R, C or S, origin and axes (rows) in the basic system."""

    kind: str
    origin: RealArray
    axes: RealArray

    def basic(self, given: RealArray) -> RealArray:
        """Return the basic position of coordinates in this system; angles in degrees."""
        a, b, c = given
        if self.kind == "C":
            given = np.array([a * np.cos(np.radians(b)), a * np.sin(np.radians(b)), c])
        elif self.kind == "S":
            polar = np.radians(b)
            turn = np.radians(c)
            given = a * np.array(
                [np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)]
            )
        return self.origin + given @ self.axes

    def directions(self, position: RealArray) -> RealArray:
        """Return the unit vectors (rows) along the coordinates at a basic position."""
        if self.kind == "R":
            return self.axes
        x, y, z = self.axes @ (position - self.origin)
        reach = float(np.hypot(x, y))
        # The angle is undefined on the axis; Nastran uses the direction of the x axis.
        cos, sin = 1.0, 0.0
        if reach > 1e-9 * max(abs(z), 1e-30):
            cos, sin = x / reach, y / reach
        outward = np.array([cos, sin, 0.0])
        around = np.array([-sin, cos, 0.0])
        if self.kind == "C":
            local_axes = np.array([outward, around, [0.0, 0.0, 1.0]])
        else:
            size = float(np.hypot(reach, z)) or 1.0
            up = z / size
            flat = reach / size
            local_axes = np.array(
                [flat * outward + [0, 0, up], up * outward - [0, 0, flat], around]
            )
        return np.asarray(local_axes @ self.axes)


_BASIC = _NastranSystem("R", np.zeros(3), np.eye(3))


class _NastranSystems:
    """Coordinate systems and grid positions of a deck, each computed on first use."""

    def __init__(self, deck: NastranDeck) -> None:
        self._deck = deck
        self._cards: dict[int, NastranCard] = {}
        for card in deck.cards_named(*SYSTEMS):
            number = card.integer(0)
            if number in self._cards:
                raise card.error(f"coordinate system {number} is defined twice")
            self._cards[number] = card
        self._systems: dict[int, _NastranSystem] = {0: _BASIC}
        self._positions: dict[int, RealArray] = {}
        self._open: set[int] = set()
        self._default_position = 0
        self._default_motion = 0
        for card in deck.cards_named("GRDSET")[:1]:
            self._default_position = card.integer(1, 0)
            self._default_motion = card.integer(5, 0)

    def position(self, node: int, asker: NastranCard) -> RealArray:
        if node not in self._positions:
            card = self._deck.grids.get(node)
            if card is None:
                raise asker.error(f"{asker.name} {asker.text(0)}: no grid {node}")
            system = self.system(card.integer(1, self._default_position), card)
            self._positions[node] = system.basic(np.array(card.reals((2, 3, 4), 0.0)))
        return self._positions[node]

    def motion(self, card: NastranCard) -> _NastranSystem:
        number = card.integer(5, self._default_motion)
        if number == -1:
            raise card.error(
                f"GRID {card.text(0)}: a fluid point (field 7 is -1) has no displacements"
            )
        return self.system(number, card)

    def system(self, number: int, asker: NastranCard) -> _NastranSystem:
        if number not in self._systems:
            if number not in self._cards:
                known = [str(n) for n in self._cards]
                raise asker.error(
                    f"{asker.name} {asker.text(0)}: no coordinate system {number};"
                    f" {suggest(str(number), known)}"
                )
            if number in self._open:
                raise asker.error(f"the definition of coordinate system {number} refers to itself")
            self._open.add(number)
            self._systems[number] = self._build_system(self._cards[number])
            self._open.discard(number)
        return self._systems[number]

    def _build_system(self, card: NastranCard) -> _NastranSystem:
        if card.name.startswith("CORD1"):
            A, B, C = (self.position(node, card) for node in card.integers((1, 2, 3)))
        else:
            within = self.system(card.integer(1, 0), card)
            points = np.array(card.reals(range(2, 11), 0.0)).reshape(3, 3)
            A, B, C = (within.basic(point) for point in points)
        up = B - A
        side = C - A
        across = np.cross(up, side)
        if np.linalg.norm(across) <= 1e-9 * np.linalg.norm(up) * np.linalg.norm(side):
            raise card.error(f"{card.name} {card.text(0)}: its three points are collinear")
        z = up / np.linalg.norm(up)
        y = across / np.linalg.norm(across)
        return _NastranSystem(card.name[-1], A, np.array([np.cross(y, z), y, z]))


def build_geometry(deck: NastranDeck, unit: str = "m") -> Geometry:
    """Return positions (m, basic system), displacement directions, edges and faces."""
    scale = find_units(unit).length
    systems = _NastranSystems(deck)
    nodes = sorted(deck.grids)
    with np.errstate(all="ignore"):  # Geometry reports positions that are not finite
        positions = [systems.position(node, deck.grids[node]) for node in nodes]
        motions = [systems.motion(deck.grids[node]) for node in nodes]
        axes = None
        if any(motion is not _BASIC for motion in motions):
            pairs = zip(motions, positions, strict=True)
            axes = np.array([motion.directions(position) for motion, position in pairs])
    with locate_errors(deck.path):
        drawn = _corners_by_shape(deck)
        xyz = np.array(positions).reshape(-1, 3) * scale
        return Geometry(nodes, xyz, unique_edges(drawn), axes, unique_faces(drawn))


def _corners_by_shape(deck: NastranDeck) -> list[tuple[Shape, IntArray]]:
    """Return the corner grids of the elements, by shape."""
    found: dict[Shape, list[list[int]]] = {}
    for card in deck.elements:
        shape = ELEMENTS[card.name].shape
        if shape is not None:
            corners = deck.nodes_of(card)[: shape.n_corners]
            if len(corners) == shape.n_corners and all(node in deck.grids for node in corners):
                found.setdefault(shape, []).append(corners)
    return [(shape, np.array(nodes, dtype=np.int64)) for shape, nodes in found.items()]
