"""Facts about the matrices of an Abaqus deck: nodes, sets, sections, materials, matrix cards."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from updyn.arrays import IntArray
from updyn.errors import FormatError, UpdynWarning, suggest
from updyn.geometry import Geometry
from updyn.io.consistent_units import UnitSystem, check_materials
from updyn.io.items import locate_errors
from updyn.io.keyword_deck.cards import (
    KeywordCard,
    KeywordRow,
    parse_integer_field,
    parse_number_field,
)
from updyn.io.keyword_deck.sets import Sets, concatenate
from updyn.io.keyword_deck.structure import (
    KeywordProperty,
    read_heading,
    read_nodes,
    read_properties,
    split_steps,
)

__all__ = ["DeckFacts", "read_facts"]

_SECTIONS = ("SOLID SECTION", "SHELL SECTION", "MEMBRANE SECTION", "BEAM SECTION")
_PARTS = ("PART", "INSTANCE", "ASSEMBLY")
_SUPPORTS = {
    "ENCASTRE": (1, 2, 3, 4, 5, 6),
    "PINNED": (1, 2, 3),
    "XSYMM": (1, 5, 6),
    "YSYMM": (2, 4, 6),
    "ZSYMM": (3, 4, 5),
    "XASYMM": (2, 3, 4),
    "YASYMM": (1, 3, 5),
    "ZASYMM": (1, 2, 6),
}


@dataclass(frozen=True, slots=True, eq=False)
class DeckFacts:
    """The parts of an Abaqus deck that its matrices need, with names in upper case.

    `sections` is the material by element set; `steps` are the cards of each step.
    """

    path: Path
    title: str
    cards: tuple[KeywordCard, ...]
    steps: tuple[tuple[KeywordCard, ...], ...]
    properties: Mapping[str, KeywordProperty]
    sections: Mapping[str, str]

    @property
    def assemblies(self) -> list[KeywordCard]:
        """The ``*MATRIX ASSEMBLE`` cards."""
        return [card for card in self.cards if card.name == "MATRIX ASSEMBLE"]

    @property
    def is_flat(self) -> bool:
        """Whether the deck has no parts; only then its node numbers are those of the matrices."""
        return not any(card.name in _PARTS for card in self.cards)

    def read_geometry(self, units: UnitSystem) -> Geometry | None:
        """Return the node positions in m, or None if the deck has none; refuse repeated nodes."""
        node_cards = [card for card in self.cards if card.name == "NODE"]
        materials = []
        for part in self.properties.values():
            if part.kind == "material":
                materials.append((part.name, part.first("stiffness"), part.first("mass")))
        check_materials(materials, units, self.path)
        if not node_cards:
            return None
        if not self.is_flat:
            warnings.warn(
                f"{self.path}: the deck has parts, whose nodes Abaqus renumbers: no geometry is"
                " read",
                UpdynWarning,
                stacklevel=3,
            )
            return None
        numbers, places = zip(*(read_nodes(card) for card in node_cards), strict=True)
        with locate_errors(self.path):
            return Geometry(np.concatenate(numbers), np.concatenate(places) * units.length)

    def element_sets(self) -> dict[str, IntArray]:
        """Return the members of each element set."""
        sets = Sets()
        for card in self.cards:
            name = card.get("ELSET")
            if name and card.name == "ELEMENT":
                sets.add(name, _element_numbers(card))
            elif name and card.name == "ELSET":
                sets.add_card(card)
        return {name: sets.members(name) for name in sets}

    def supports(self) -> IntArray:
        """Return node and dof (1 to 6) of all supports of model and first step, shape (n, 2)."""
        sets = Sets()
        found = []
        first_step = self.steps[0] if self.steps else ()
        for card in (*self.cards, *first_step):
            name = card.get("NSET")
            if card.name == "NODE" and name:
                sets.add(name, read_nodes(card)[0])
            elif card.name == "NSET":
                sets.add_card(card)
            elif card.name == "BOUNDARY":
                found += [_support_dofs(card, row, sets) for row in card.rows]
        return concatenate([part.reshape(-1) for part in found]).reshape(-1, 2)

    def by_material(
        self, changes: Mapping[str, Mapping[str, float]]
    ) -> dict[str, Mapping[str, float]]:
        """Return the changes by material; groups are named by element set or by material."""
        if self.assemblies:
            raise FormatError(
                "the deck consists of matrices and has no materials; write the updated model"
                " instead: updyn.write_model(result.model, 'updated.inp')",
                self.path,
            )
        by_elset = {name.upper(): dict(change) for name, change in changes.items()}
        out: dict[str, Mapping[str, float]] = {}
        for name, change in changes.items():
            if name.upper() in self.properties:
                out[name] = change
                continue
            material = self.sections.get(name.upper())
            if material is None:
                near = suggest(name.upper(), [*self.properties, *self.sections])
                raise FormatError(
                    f"the deck has no material or element set {name!r}; {near}", self.path
                )
            for elset in sorted(self.sections):
                is_alike = self.sections[elset] == material
                if is_alike and by_elset.get(elset, {}) != dict(change):
                    raise FormatError(
                        f"group {name!r} shares material {material!r} with {elset!r}, which has"
                        " different changes; give each a separate material in the deck",
                        self.path,
                    )
            out[material] = change
        return out


def read_facts(path: Path, cards: Sequence[KeywordCard]) -> DeckFacts:
    """Read the parts of a deck that its matrices need."""
    model, steps = split_steps(cards)
    types: dict[str, str] = {}
    sections: dict[str, str] = {}
    made_of: list[tuple[KeywordCard, str]] = []
    for card in model:
        elset = card.get("ELSET")
        if elset and card.name == "ELEMENT":
            types[elset.upper()] = (card.get("TYPE") or "").upper()
        material = card.get("MATERIAL")
        if material and card.name in _SECTIONS:
            made_of.append((card, material))
            if elset:
                sections[elset.upper()] = material.upper()
    properties = read_properties(model, types)
    for card, material in made_of:
        if material.upper() not in properties:
            known = [name for name, part in properties.items() if part.kind == "material"]
            near = suggest(material.upper(), known)
            raise card.error(f"*{card.name}: no material {material!r}; {near}")
    title = read_heading(model)
    return DeckFacts(path, title, tuple(model), tuple(map(tuple, steps)), properties, sections)


def _support_dofs(card: KeywordCard, row: KeywordRow, sets: Sets) -> IntArray:
    """Return node and dof of the supports of a line, shape (n, 2)."""
    fields = row.fields
    if fields[0].upper() in sets:
        nodes = sets.members(fields[0].upper())
        sets.count(len(nodes), card, row)
    elif fields[0].isdecimal():
        nodes = np.array([parse_integer_field(fields[0], card, row)], dtype=np.int64)
    else:
        raise card.error(
            f"*BOUNDARY: no node set {fields[0]!r}; {suggest(fields[0].upper(), [*sets])}", row
        )
    if len(fields) == 2 and fields[1].upper() in _SUPPORTS:
        directions: tuple[int, ...] = _SUPPORTS[fields[1].upper()]
    elif len(fields) > 1 and "".join(fields[1:3]).isdecimal():
        first = last = parse_integer_field(fields[1], card, row)
        if len(fields) > 2 and fields[2]:
            last = parse_integer_field(fields[2], card, row)
        if not 1 <= first <= last <= 6:
            raise card.error(f"*BOUNDARY: found {row.text!r}; expected directions from 1 to 6", row)
        directions = tuple(range(first, last + 1))
    else:
        raise card.error(
            f"*BOUNDARY: found {row.text!r}; expected node, first direction, last direction", row
        )
    if len(fields) > 3 and fields[3] and parse_number_field(fields[3], card, row) != 0.0:
        raise card.error(f"*BOUNDARY: found {row.text!r}; expected a support at 0", row)
    both = np.repeat(nodes, len(directions)), np.tile(directions, len(nodes))
    return np.stack(both, axis=1).astype(np.int64)


def _element_numbers(card: KeywordCard) -> IntArray:
    """Return the numbers of the elements; a trailing comma continues the line."""
    numbers, continues = [], False
    for row in card.rows:
        if not continues:
            numbers.append(parse_integer_field(row.fields[0], card, row))
        continues = row.text.endswith(",")
    return np.array(numbers, dtype=np.int64)
