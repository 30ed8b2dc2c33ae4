"""The structure in a deck of CalculiX or Abaqus: nodes, elements, sets, sections, properties.

Decks have to be flat, as for CalculiX; the parts and instances of Abaqus are not expanded. Only the
cards before the first ``*STEP`` are read. Properties are materials, springs and point masses, each
a group of the model.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from updyn.arrays import IntArray, RealArray
from updyn.errors import FormatError, suggest
from updyn.grouping import GroupOrigin, label_groups
from updyn.io.keyword_deck.cards import (
    KeywordCard,
    KeywordRow,
    format_number,
    parse_integer_field,
    parse_number_field,
)
from updyn.io.keyword_deck.sets import Sets, concatenate, distinct
from updyn.shapes import HEXAHEDRON, PYRAMID, TETRAHEDRON, WEDGE, Shape

__all__ = [
    "ElementCard",
    "KeywordDeck",
    "KeywordProperty",
    "SolidSection",
    "nodes_by_shape",
    "read_deck",
    "read_heading",
    "read_nodes",
    "read_properties",
    "split_steps",
]

#: Number of nodes of the solids, with the shape and its corner nodes.
SOLIDS = {
    "C3D4": (4, TETRAHEDRON),
    "C3D4H": (4, TETRAHEDRON),
    "C3D5": (5, PYRAMID),
    "C3D6": (6, WEDGE),
    "C3D8": (8, HEXAHEDRON),
    "C3D8R": (8, HEXAHEDRON),
    "C3D8I": (8, HEXAHEDRON),
    "C3D10": (10, TETRAHEDRON),
    "C3D10T": (10, TETRAHEDRON),
    "C3D10M": (10, TETRAHEDRON),
    "C3D15": (15, WEDGE),
    "C3D20": (20, HEXAHEDRON),
    "C3D20R": (20, HEXAHEDRON),
}
#: Springs to ground or between nodes, and point masses.
POINTS = {"SPRING1": 1, "SPRING2": 2, "SPRINGA": 2, "MASS": 1}


@dataclass(frozen=True, slots=True, eq=False)
class ElementCard:
    """The elements of one ``*ELEMENT`` card; `nodes` are node numbers, shape (n, k)."""

    type: str
    numbers: IntArray
    nodes: IntArray
    card: KeywordCard


@dataclass(frozen=True, slots=True)
class SolidSection:
    """A section: the material of an element set."""

    elset: str
    material: str
    card: KeywordCard


@dataclass(frozen=True, slots=True, eq=False)
class KeywordDeck:
    """The structure in a deck. Names are in upper case; lengths are in the unit of the deck.

    `cards` are those of the model; cards of sets are as `updyn.io.keyword_deck.sets.Sets.add_card`
    returns them.
    """

    path: Path
    nodes: IntArray
    xyz: RealArray
    elements: tuple[ElementCard, ...]
    nsets: Mapping[str, IntArray]
    elsets: Mapping[str, IntArray]
    sections: tuple[SolidSection, ...]
    cards: tuple[KeywordCard, ...]

    def elements_of(self, material: str) -> IntArray:
        """Return the numbers of the elements made of a material, ascending."""
        sets = [self.elsets[s.elset] for s in self.sections if s.material == material.upper()]
        return distinct(concatenate(sets))

    def origins(self, materials: Iterable[str]) -> dict[str, GroupOrigin]:
        """Return the element sets that contain all or some elements of each material."""
        elements = {name: self.elements_of(name).tolist() for name in materials}
        return label_groups(elements, label_sets(self.elsets))


def label_sets(elsets: Mapping[str, IntArray]) -> dict[str, set[int]]:
    """Return element sets by their labels as patterns of groups."""
    return {f"ELSET {name}": set(members.tolist()) for name, members in elsets.items()}


def split_steps(cards: Sequence[KeywordCard]) -> tuple[list[KeywordCard], list[list[KeywordCard]]]:
    """Return the cards of the model, and those of each step, ``*STEP`` first."""
    model: list[KeywordCard] = []
    steps: list[list[KeywordCard]] = []
    for card in cards:
        if card.name == "STEP":
            steps.append([card])
        elif not steps:
            model.append(card)
        elif card.name != "END STEP":
            steps[-1].append(card)
    return model, steps


def read_heading(model: Sequence[KeywordCard]) -> str:
    """Return the first line of the heading, or an empty text."""
    for card in model:
        if card.name == "HEADING" and card.rows:
            return card.rows[0].text
    return ""


def read_deck(path: str | Path, model: Sequence[KeywordCard]) -> KeywordDeck:
    """Read nodes, elements, sets and solid sections from the cards before the first step."""
    path = Path(path)
    nodes = [read_nodes(card) for card in model if card.name == "NODE"]
    if not nodes:
        raise FormatError("the deck has no *NODE", path)
    numbers, places = map(np.concatenate, zip(*nodes, strict=True))
    blocks = [_elements(card) for card in model if card.name == "ELEMENT"]
    nsets = Sets(numbers)
    elsets = Sets(concatenate([block.numbers for block in blocks]))
    next_nodes, next_block = iter(nodes), iter(blocks)
    sections: list[SolidSection] = []
    cards: list[KeywordCard] = []
    for card in model:
        if card.name == "NODE":
            nsets.add(card.get("NSET"), next(next_nodes)[0])
        elif card.name == "ELEMENT":
            elsets.add(card.get("ELSET"), next(next_block).numbers)
        elif card.name in ("NSET", "ELSET"):
            card = (nsets if card.name == "NSET" else elsets).add_card(card)
        elif card.name == "SOLID SECTION":
            elset = card.require("ELSET").upper()
            sections.append(SolidSection(elset, card.require("MATERIAL").upper(), card))
        cards.append(card)
    deck = KeywordDeck(
        path,
        numbers,
        places,
        tuple(blocks),
        {name: nsets.members(name) for name in nsets},
        {name: elsets.members(name) for name in elsets},
        tuple(sections),
        tuple(cards),
    )
    _check_nodes(deck)
    _check_sections(deck)
    return deck


def nodes_by_shape(deck: KeywordDeck) -> list[tuple[Shape, IntArray]]:
    """Return the solids by shape, with the nodes of each, shape (m, k)."""
    return [(SOLIDS[b.type][1], b.nodes) for b in deck.elements if b.type in SOLIDS]


# -- cards --------------------------------------------------------------------------------------
def read_nodes(card: KeywordCard) -> tuple[IntArray, RealArray]:
    """Return the numbers and positions of a ``*NODE`` card, in the unit of length of the deck."""
    card.check_parameters("NSET")
    numbers = np.zeros(len(card.rows), dtype=np.int64)
    places = np.zeros((len(card.rows), 3))
    for i, row in enumerate(card.rows):
        fields = row.fields
        if not 2 <= len(fields) <= 4:
            raise card.error(f"*NODE: found {row.text!r}; expected node, x, y, z", row)
        numbers[i] = parse_integer_field(fields[0], card, row)
        for k, field in enumerate(fields[1:]):
            if field:
                places[i, k] = parse_number_field(field, card, row)
    return numbers, places


def _elements(card: KeywordCard) -> ElementCard:
    card.check_parameters("TYPE", "ELSET")
    kind = card.require("TYPE").upper()
    if kind in SOLIDS:
        n_nodes, _ = SOLIDS[kind]
    elif kind in POINTS:
        n_nodes = POINTS[kind]
    else:
        raise card.error(_describe_unsupported(kind))
    found: list[list[int]] = []
    pending: list[int] = []  # an element may need several lines
    row = None
    for row in card.rows:
        pending += [parse_integer_field(field, card, row) for field in row.fields]
        if len(pending) > n_nodes + 1:
            break
        if len(pending) == n_nodes + 1:
            found.append(pending)
            pending = []
    if pending:
        raise card.error(f"*ELEMENT: {len(pending) - 1} nodes; {kind} has {n_nodes}", row)
    table = np.array(found, dtype=np.int64).reshape(-1, n_nodes + 1)
    return ElementCard(kind, table[:, 0], table[:, 1:], card)


def _describe_unsupported(kind: str) -> str:
    expanded = (
        "is expanded into solids with hidden nodes and constraints, so that its matrices have no"
        " DOFs of the deck"
    )
    if kind.startswith(("B3", "B2", "T2D", "T3D", "PIPE")):
        return (
            f"*ELEMENT: {kind} is a beam or truss: it {expanded}; model it with solids, or build it"
            " with updyn.elements"
        )
    if kind.startswith(("S3", "S4", "S6", "S8", "STRI", "M3D", "CPS", "CPE", "CAX", "SC")):
        return (
            f"*ELEMENT: {kind} is a shell, membrane or plane element: it {expanded}; model it with"
            " solids"
        )
    if kind.startswith("DASHPOT"):
        return (
            f"*ELEMENT: {kind}: written matrices do not contain dashpots; remove it and add its"
            " damping later"
        )
    return f"*ELEMENT: type {kind!r} is not supported; {suggest(kind, [*SOLIDS, *POINTS])}"


# -- checks -------------------------------------------------------------------------------------
def _check_nodes(deck: KeywordDeck) -> None:
    twice = _first_duplicate(deck.nodes)
    if twice is not None:
        raise FormatError(f"*NODE: node {twice} is defined twice", deck.path)
    for block in deck.elements:
        bad = ~np.isin(block.nodes, deck.nodes)
        if bad.any():
            at = int(np.flatnonzero(bad.any(axis=1))[0])
            raise block.card.error(
                f"*ELEMENT: element {block.numbers[at]} refers to node"
                f" {block.nodes[at][bad[at]][0]}, which is not in the deck",
                _find_row(block.card, int(block.numbers[at])),
            )
    twice = _first_duplicate(concatenate([block.numbers for block in deck.elements]))
    if twice is not None:
        last = [block.card for block in deck.elements if twice in block.numbers][-1]
        raise last.error(f"*ELEMENT: element {twice} is defined twice", _find_row(last, twice))


def _first_duplicate(numbers: IntArray) -> int | None:
    """Return the smallest repeated number, or None."""
    values, counts = np.unique(numbers, return_counts=True)
    again = values[counts > 1]
    return int(again[0]) if len(again) else None


def _find_row(card: KeywordCard, element: int) -> KeywordRow | None:
    """Return the last line that starts with the number of an element."""
    for row in reversed(card.rows):
        if row.fields[0] == str(element):
            return row
    return None


def _check_sections(deck: KeywordDeck) -> None:
    members: list[IntArray] = []
    for section in deck.sections:
        if section.elset not in deck.elsets:
            raise section.card.error(
                f"*SOLID SECTION: no element set {section.elset!r};"
                f" {suggest(section.elset, deck.elsets)}"
            )
        members.append(deck.elsets[section.elset])
    taken = concatenate(members)
    twice = _first_duplicate(taken)
    if twice is not None:
        *_, one, two = [s for s in deck.sections if twice in deck.elsets[s.elset]]
        raise two.card.error(
            f"*SOLID SECTION: element {twice} is in {one.elset!r} (line {one.card.line}) and in"
            f" {two.elset!r}; expected one section per element"
        )
    for block in deck.elements:
        without = block.numbers[~np.isin(block.numbers, taken)]
        if block.type in SOLIDS and without.size:
            raise block.card.error(
                f"*ELEMENT: element {without[0]} has no *SOLID SECTION ({without.size} such)",
                _find_row(block.card, int(without[0])),
            )


#: Cards of a linear ``*MATERIAL``.
LINEAR = ("ELASTIC", "DENSITY", "DAMPING", "EXPANSION", "CONDUCTIVITY", "SPECIFIC HEAT")
#: Cards of a nonlinear ``*MATERIAL``.
NONLINEAR = (
    "PLASTIC",
    "CYCLIC HARDENING",
    "CREEP",
    "DEFORMATION PLASTICITY",
    "HYPERELASTIC",
    "HYPERFOAM",
    "VISCOELASTIC",
    "VISCO",
    "USER MATERIAL",
    "DEPVAR",
    "MOHR COULOMB",
    "MOHR COULOMB HARDENING",
    "MOHR COULOMB TENSION CUTOFF",
    "RATE DEPENDENT",
    "DAMAGE INITIATION",
    "DAMAGE EVOLUTION",
)
_OTHER = (
    "ELECTRICAL CONDUCTIVITY",
    "MAGNETIC PERMEABILITY",
    "FLUID CONSTANTS",
    "SPECIFIC GAS CONSTANT",
)
#: Fields with moduli in each line of ``*ELASTIC``, including continuation lines.
_MODULI = {
    "ISO": ((0,),),
    "ISOTROPIC": ((0,),),
    "ENGINEERING CONSTANTS": ((0, 1, 2, 6, 7), (0,)),
    "ORTHO": (tuple(range(8)), (0,)),
    "ORTHOTROPIC": (tuple(range(8)), (0,)),
    "ANISO": (tuple(range(8)), tuple(range(8)), tuple(range(5))),
    "ANISOTROPIC": (tuple(range(8)), tuple(range(8)), tuple(range(5))),
}


@dataclass(frozen=True, slots=True)
class KeywordProperty:
    """A material, or the springs or masses of an element set, with its consecutive cards.

    `kind` is "material", "spring" or "mass"; `at` is the position of the first card among those of
    the model; `start` is the first line with spring constants, counted from 0 (the lines before it
    are directions).
    """

    name: str
    kind: str
    at: int
    cards: tuple[KeywordCard, ...]
    start: int = 0

    def card(self, name: str) -> KeywordCard | None:
        """Return the card with this name, or None."""
        for card in self.cards:
            if card.name == name:
                return card
        return None

    def damping_parameter(self, parameter: str) -> float:
        """Return STRUCTURAL, ALPHA or BETA of ``*DAMPING`` (at least 0), by default 0."""
        card = self.card("DAMPING")
        if card is None or card.get(parameter) is None:
            return 0.0
        text = card.parameters[parameter]
        value = parse_number_field(text, card, KeywordRow(card.line, text))
        if value < 0:
            raise card.error(f"*DAMPING: {parameter}={text}; expected at least 0")
        return value

    def values(self, what: str) -> list[float]:
        """Return the moduli ("stiffness") or the densities ("mass") in order."""
        found = []
        for card, i, j in self._places(what):
            row = card.rows[i]
            found.append(parse_number_field(row.fields[j], card, row))
        return found

    def first(self, what: str) -> float | None:
        """Return the first modulus or density, or None."""
        return next(iter(self.values(what)), None)

    def scale_cards(self, stiffness: float = 1.0, mass: float = 1.0) -> tuple[KeywordCard, ...]:
        """Return the cards with all moduli and densities multiplied by factors."""
        out = {id(card): card for card in self.cards}
        for what, factor in (("stiffness", stiffness), ("mass", mass)):
            if factor == 1.0:
                continue
            for card, i, j in self._places(what):
                now = out[id(card)]
                rows = list(now.rows)
                fields = rows[i].fields
                fields[j] = format_number(
                    factor * parse_number_field(fields[j], card, card.rows[i])
                )
                rows[i] = replace(rows[i], text=", ".join(fields))
                out[id(card)] = replace(now, rows=tuple(rows))
        return tuple(out[id(card)] for card in self.cards)

    def set_damping(
        self, cards: Sequence[KeywordCard], values: Mapping[str, float]
    ) -> tuple[KeywordCard, ...]:
        """Return cards of this material with new parameters of ``*DAMPING``, added if missing."""
        if not values:
            return tuple(cards)
        texts = {name: format_number(value) for name, value in values.items()}
        damping_card = self.card("DAMPING")
        if damping_card is None:
            last = cards[-1]
            return (
                *cards,
                KeywordCard("DAMPING", MappingProxyType(texts), (), last.path, last.line),
            )
        both = MappingProxyType({**damping_card.parameters, **texts})
        out = []
        for card in cards:
            if card.name == "DAMPING":
                card = replace(card, parameters=both)
            out.append(card)
        return tuple(out)

    def _places(self, what: str) -> list[tuple[KeywordCard, int, int]]:
        """Return card, line and field of every number of a quantity."""
        if self.kind != "material":
            first_card = self.cards[0]
            scaled = "mass" if self.kind == "mass" else "stiffness"
            lines = range(self.start, len(first_card.rows)) if what == scaled else ()
            return [(first_card, i, 0) for i in lines]
        card = self.card("ELASTIC" if what == "stiffness" else "DENSITY")
        if card is None:
            return []
        pattern = _pattern(card) if what == "stiffness" else ((0,),)
        places = []
        for i, row in enumerate(card.rows):
            wanted = pattern[i % len(pattern)]
            if len(row.fields) <= max(wanted):
                raise card.error(
                    f"*{card.name}: found {row.text!r}; expected {max(wanted) + 1} numbers or more",
                    row,
                )
            places += [(card, i, j) for j in wanted]
        if len(card.rows) % len(pattern):
            raise card.error(
                f"*{card.name}: the last of {len(pattern)} lines is missing", card.rows[-1]
            )
        return places


def _pattern(card: KeywordCard) -> tuple[tuple[int, ...], ...]:
    kind = (card.get("TYPE") or "ISO").upper()
    if kind not in _MODULI:
        raise card.error(f"*ELASTIC: TYPE={kind} is not supported; {suggest(kind, _MODULI)}")
    return _MODULI[kind]


def read_properties(
    model: Sequence[KeywordCard],
    springs_between: Mapping[str, str] | None = None,
    *,
    own_rayleigh: bool = True,
) -> dict[str, KeywordProperty]:
    """Return the materials, springs and point masses of a deck, by name in upper case, in order.

    Springs of type SPRINGA have no line of directions; without their type in `springs_between` (by
    element set), a first line of integers is read as directions. `own_rayleigh` is whether ALPHA
    and BETA belong to the preceding material (Abaqus), or to the whole deck (CalculiX).
    """
    out: dict[str, KeywordProperty] = {}
    for at, card in enumerate(model):
        if card.name == "MATERIAL":
            stop = at + 1
            while stop < len(model) and model[stop].name in (*LINEAR, *NONLINEAR, *_OTHER):
                stop += 1
            # ALPHA and BETA of the deck may directly follow a material.
            while not own_rayleigh and _is_rayleigh(model[stop - 1]):
                stop -= 1
            found = KeywordProperty(card.require("NAME"), "material", at, tuple(model[at:stop]))
        elif card.name == "SPRING":
            name = card.require("ELSET")
            kind = (springs_between or {}).get(name.upper())
            found = KeywordProperty(name, "spring", at, (card,), _first_constant(card, kind))
        elif card.name == "MASS":
            found = KeywordProperty(card.require("ELSET"), "mass", at, (card,))
        else:
            continue
        key = found.name.upper()
        if key in out:
            raise card.error(
                f"*{card.name}: {found.name!r} is defined twice, also on line"
                f" {out[key].cards[0].line}"
            )
        out[key] = found
    return out


def _first_constant(card: KeywordCard, kind: str | None) -> int:
    if not card.rows:
        raise card.error("*SPRING has no spring constant")
    if kind is None:
        has_directions = all(field.isdecimal() for field in card.rows[0].fields if field)
    else:
        has_directions = kind != "SPRINGA"
    return 1 if has_directions and len(card.rows) > 1 else 0


def _is_rayleigh(card: KeywordCard) -> bool:
    return card.name == "DAMPING" and not card.get("STRUCTURAL")
