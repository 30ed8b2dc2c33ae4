"""A Nastran deck: its cards by kind, checked against each other, and its groups (one a property).

The groups are called by card and number: ``PSHELL 3``, ``PBAR 12``, and ``CONM2 9``, ``CELAS2 4``
for elements that are their own property.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from updyn.errors import FormatError, suggest
from updyn.io.nastran.cards import Card, Line, lines_of, parse
from updyn.io.nastran.kinds import (
    ELEMENTS,
    LOADS,
    MATERIALS,
    OWN,
    PROPERTIES,
    TIES,
    materials_of,
    values,
)

__all__ = ["Deck", "read_deck"]

SYSTEMS = ("CORD1R", "CORD1C", "CORD1S", "CORD2R", "CORD2C", "CORD2S")
_POINTS = ("GRID", "GRDSET", "SPOINT")
_KNOWN = (*_POINTS, *SYSTEMS, *ELEMENTS, *PROPERTIES, *MATERIALS, *TIES, *LOADS, "PARAM")
_BULK = re.compile(r"\s*BEGIN\s+BULK|\s*BEGIN\s*$", re.IGNORECASE)
_SELECTED = re.compile(r"\s*(SPC|MPC)\s*=\s*(\S+)\s*$", re.IGNORECASE)
#: Two of one kind on one card: number of fields of each.
_DOUBLE = {"PELAS": 4, "PDAMP": 2, "CORD1R": 4, "CORD1C": 4, "CORD1S": 4}


@dataclass(frozen=True)  # no slots: what is derived is kept
class Deck:
    """A deck whose cards fit together.

    Parameters
    ----------
    path : Path
        The main file.
    case : tuple of Line
        Executive and case control.
    cards : tuple of Card
        Bulk data in order, less what has no say in stiffness and mass.
    """

    path: Path
    case: tuple[Line, ...]
    cards: tuple[Card, ...]

    def named(self, *names: str) -> list[Card]:
        """Return the cards of these names, in order."""
        return [card for card in self.cards if card.name in names]

    @cached_property
    def grids(self) -> dict[int, Card]:
        """Grid cards by number."""
        return _by_number(self.named("GRID"), "GRID")

    @cached_property
    def points(self) -> dict[int, Card]:
        """The cards that define the scalar points."""
        out: dict[int, Card] = {}
        for card in self.named("SPOINT"):
            if card.text(1) == "THRU":
                numbers: Iterable[int] = range(card.integer(0), card.integer(2) + 1)
            else:
                numbers = [card.integer(i) for i, cell in enumerate(card.fields) if cell]
            out |= dict.fromkeys(numbers, card)
        return out

    @cached_property
    def materials(self) -> dict[int, Card]:
        """Material cards by number."""
        return _by_number(self.named(*MATERIALS), "material")

    @cached_property
    def properties(self) -> dict[int, Card]:
        """Property cards by number."""
        return _by_number(self.named(*PROPERTIES), "property")

    @cached_property
    def elements(self) -> list[Card]:
        """Element cards."""
        return self.named(*ELEMENTS)

    @cached_property
    def groups(self) -> dict[str, Card]:
        """By name: the property card of a group, or its element where that is its own property."""
        found: dict[str, Card] = {}
        for card in self.elements:
            own = card if card.name in OWN else self.property_of(card)
            found[f"{own.name} {own.integer(0)}"] = own
        return found

    def property_of(self, element: Card) -> Card:
        """Return the property card of an element; a missing number is that of the element."""
        return self.properties[element.integer(1, element.integer(0))]

    def nodes_of(self, element: Card) -> list[int]:
        """Return the grids of an element, those that are there, in order."""
        return [element.integer(i) for i in ELEMENTS[element.name].nodes if element.text(i)]

    def group(self, name: str) -> Card:
        """Return the card of a group.

        Raises
        ------
        FormatError
            If there is none; the nearest names are given.
        """
        if name not in self.groups:
            raise FormatError(
                f"no group {name!r} in the deck; {suggest(name, self.groups)}", self.path
            )
        return self.groups[name]

    def parameter(self, name: str, default: float) -> float:
        """Return a number given by PARAM, the last one."""
        cards = [c for c in self.named("PARAM") if c.text(0) == name]
        return cards[-1].real(1) if cards else default

    def selected(self, what: str, given: int | None) -> int:
        """Return the number of the SPC or MPC set that case control selects, 0 for none.

        Raises
        ------
        FormatError
            If subcases select different sets, the set is not there, or there are sets and none is
            selected.
        """
        kinds = {"SPC": ("SPC", "SPC1", "SPCADD"), "MPC": ("MPC", "MPCADD")}[what]
        sets = {card.integer(0) for card in self.named(*kinds)}
        option = f"{what.lower()}="
        lines = [
            (m, line)
            for line in self.case
            if (m := _SELECTED.match(line.text)) and m[1].upper() == what
        ]
        chosen = {m[2] for m, _ in lines} if given is None else {str(given)}
        if len(chosen) > 1:
            raise lines[-1][1].error(
                f"{what} sets {', '.join(sorted(chosen))} in one deck; say which with {option}"
            )
        if not chosen:
            if sets:
                raise FormatError(
                    f"{what} sets {_list(sets)}, but case control selects none; say which with"
                    f" {option} (0 for none)",
                    self.path,
                )
            return 0
        number = chosen.pop()
        if not number.isdecimal() or (int(number) and int(number) not in sets):
            raise FormatError(
                f"no {what} set {number}; there are: {_list(sets) or 'none'}", self.path
            )
        return int(number)


def read_deck(path: str | Path, ignore: Iterable[str] | None = ()) -> Deck:
    """Read a deck and check that its cards fit together.

    Parameters
    ----------
    path : path
        The main file: a whole deck, or bulk data alone.
    ignore : iterable of str, optional
        Names of cards to leave out although they may change the structure. None: all that are not
        known.

    Returns
    -------
    Deck
        Its cards.

    Raises
    ------
    FormatError
        If an included file is missing, a card is not known, or one points to what is not there; the
        message says file and line.
    """
    path = Path(path)
    left_out = {name.upper() for name in ignore or ()}
    case, bulk = _sections(list(lines_of(path)))
    cards: list[Card] = []
    for card in parse(iter(bulk)):
        if card.name not in _KNOWN and ignore is None:
            continue
        if card.name not in _KNOWN and card.name not in left_out:
            raise card.error(
                f"card {card.name} is not known and may change the structure;"
                f" {suggest(card.name, _KNOWN)} "
                f'(to leave it out: ignore=["{card.name}"])'
            )
        if card.name not in LOADS and card.name not in left_out:
            cards += _single(card)
    deck = Deck(path, tuple(case), tuple(cards))
    _check(deck)
    return deck


def _sections(lines: list[Line]) -> tuple[list[Line], list[Line]]:
    start = next((i for i, line in enumerate(lines) if _BULK.match(line.text)), None)
    case, bulk = ([], lines) if start is None else (lines[:start], lines[start + 1 :])
    end = next(
        (i for i, line in enumerate(bulk) if line.text.strip().upper().startswith("ENDDATA")),
        len(bulk),
    )
    return case, bulk[:end]


def _single(card: Card) -> list[Card]:
    n = _DOUBLE.get(card.name)
    if n is None or len(card.fields) <= n:
        return [card]
    return [
        Card(card.name, card.fields[i : i + n], card.lines) for i in range(0, len(card.fields), n)
    ]


def _by_number(cards: Iterable[Card], what: str) -> dict[int, Card]:
    out: dict[int, Card] = {}
    for card in cards:
        number = card.integer(0)
        if number in out:
            first = out[number].lines[0]
            raise card.error(f"{what} {number} stands twice: also {first.path.name}:{first.number}")
        out[number] = card
    return out


def _list(numbers: Iterable[int]) -> str:
    return ", ".join(str(n) for n in sorted(numbers))


def _near(number: int, known: Mapping[int, Card]) -> str:
    best = sorted(known, key=lambda n: abs(n - number))[:3]
    return f"nearest: {_list(best)}" if best else "there is none"


def _check(deck: Deck) -> None:
    if not deck.grids and not deck.points:
        raise FormatError(
            "no GRID card: not a deck, or bulk data that belongs to another file", deck.path
        )
    places = deck.grids | deck.points
    for card in deck.elements:
        kinds = ELEMENTS[card.name].properties
        number = card.integer(1, card.integer(0)) if kinds else 0
        if kinds and number not in deck.properties:
            raise card.error(
                f"{card.name} {card.text(0)}: no property {number};"
                f" {_near(number, deck.properties)}"
            )
        if kinds and (found := deck.properties[number]).name not in kinds:
            raise card.error(
                f"{card.name} {card.text(0)}: property {number} is a {found.name}; expected"
                f" {' or '.join(kinds)}"
            )
        for node in deck.nodes_of(card):
            if node and node not in places:
                raise card.error(
                    f"{card.name} {card.text(0)}: no grid {node}; {_near(node, deck.grids)}"
                )
    for card in deck.groups.values():
        values(card)
        for field in materials_of(card):
            if (number := card.integer(field)) not in deck.materials:
                raise card.error(
                    f"{card.name} {card.text(0)}: no material {number} among"
                    f" {', '.join(MATERIALS)}; " + _near(number, deck.materials)
                )
    for card in deck.named(*TIES):
        for field, node in _tied(card):
            if node not in places:
                raise card.error(
                    f"{card.name}: field {field + 2} names grid {node}; {_near(node, places)}"
                )


def _tied(card: Card) -> list[tuple[int, int]]:
    """Return (field, grid) of the grids that a tie or a support names."""
    n = len(card.fields)
    if card.name == "MPC":
        at: list[int] = [start + k for start in range(1, n, 8) for k in (0, 3)]
    elif card.name == "SPC":
        at = [1, 4]
    elif card.name == "RBE2":
        last = n - 1 if _is_alpha(card, n - 1, 3) else n
        at = [1, *range(3, last)]
    elif card.name == "RBE3":
        at = _grids_of_rbe3(card)
    elif card.name == "RBAR":
        at = [1, 2]
    elif card.name == "SPC1" and card.text(3) != "THRU":
        at = list(range(2, n))
    else:
        return []
    return [(i, card.integer(i)) for i in at if card.text(i) and card.text(i) != "THRU"]


def _is_alpha(card: Card, last: int, first: int) -> bool:
    return last > first and "." in card.text(last)


def _grids_of_rbe3(card: Card) -> list[int]:
    """RBE3: EID, blank, REFGRID, REFC, then WT, C, grids, the next WT, C, grids, ..., UM or ALPHA and what follows."""
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
