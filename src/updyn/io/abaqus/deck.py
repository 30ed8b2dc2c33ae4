"""Facts of an Abaqus deck about its matrices: nodes, sets, sections, materials, matrix cards."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from updyn.errors import FormatError, UpdynWarning, suggest
from updyn.geometry import Geometry
from updyn.io.consistent_units import System, check_materials
from updyn.io.items import placed
from updyn.io.keyword_deck.cards import Card, Row, number, whole
from updyn.io.keyword_deck.sets import Sets, joined
from updyn.io.keyword_deck.structure import (
    Property,
    heading_of,
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
    """A deck of Abaqus as far as its matrices need it. Names are looked up in capitals.

    Parameters
    ----------
    path : Path
        The deck.
    title : str
        Its heading.
    cards : tuple of Card
        Those of the model.
    steps : tuple of tuple of Card
        Those of each step.
    properties : mapping of str to Property
        Materials, springs and masses.
    sections : mapping of str to str
        Material by element set.
    """

    path: Path
    title: str
    cards: tuple[Card, ...]
    steps: tuple[tuple[Card, ...], ...]
    properties: Mapping[str, Property]
    sections: Mapping[str, str]

    @property
    def assemblies(self) -> list[Card]:
        """The ``*MATRIX ASSEMBLE`` cards."""
        return [card for card in self.cards if card.name == "MATRIX ASSEMBLE"]

    @property
    def flat(self) -> bool:
        """Whether the deck has no parts; only then are its node numbers those of the matrices."""
        return not any(card.name in _PARTS for card in self.cards)

    def drawn(self, units: System) -> Geometry | None:
        """Return where the nodes stand, in m; None where the deck has none of its own.

        Raises
        ------
        FormatError
            If a node cannot be read or stands twice.
        """
        own = [card for card in self.cards if card.name == "NODE"]
        materials = []
        for part in self.properties.values():
            if part.kind == "material":
                materials.append((part.name, part.first("stiffness"), part.first("mass")))
        check_materials(materials, units, self.path)
        if not own:
            return None
        if not self.flat:
            warnings.warn(
                f"{self.path}: the deck has parts, whose nodes Abaqus numbers anew: no geometry is"
                " read",
                UpdynWarning,
                stacklevel=3,
            )
            return None
        numbers, places = zip(*(read_nodes(card) for card in own), strict=True)
        with placed(self.path):
            return Geometry(np.concatenate(numbers), np.concatenate(places) * units.length)

    def element_sets(self) -> dict[str, NDArray[np.int64]]:
        """Return the members of each element set.

        Raises
        ------
        FormatError
            If a card cannot be read.
        """
        sets = Sets()
        for card in self.cards:
            name = card.get("ELSET")
            if name and card.name == "ELEMENT":
                sets.add(name, _element_numbers(card))
            elif name and card.name == "ELSET":
                sets.read(card)
        return {name: sets.members(name) for name in sets}

    def held(self) -> NDArray[np.int64]:
        """Return node and dof (1 to 6) of every support of the model and its first step, (n, 2).

        Raises
        ------
        FormatError
            If a line cannot be read, names a node set that is not there, or does not hold at 0.
        """
        sets = Sets()
        found = []
        first_step = self.steps[0] if self.steps else ()
        for card in (*self.cards, *first_step):
            name = card.get("NSET")
            if card.name == "NODE" and name:
                sets.add(name, read_nodes(card)[0])
            elif card.name == "NSET":
                sets.read(card)
            elif card.name == "BOUNDARY":
                found += [_held(card, row, sets) for row in card.rows]
        return joined([part.reshape(-1) for part in found]).reshape(-1, 2)

    def by_material(
        self, changes: Mapping[str, Mapping[str, float]]
    ) -> dict[str, Mapping[str, float]]:
        """Return changes by material, of groups that are called as element sets or as materials.

        Raises
        ------
        FormatError
            If an element set shares its material with another one that does not change alike.
        """
        if self.assemblies:
            raise FormatError(
                "the deck is put together of matrices and has no materials; write the updated model"
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
                        f"group {name!r} is made of material {material!r}, as is {elset!r}, which"
                        " changes otherwise; give each a material of its own in the deck",
                        self.path,
                    )
            out[material] = change
        return out


def read_facts(path: Path, cards: Sequence[Card]) -> DeckFacts:
    """Read from a deck what its matrices need.

    Raises
    ------
    FormatError
        If a card that is looked at cannot be read.
    """
    model, steps = split_steps(cards)
    types: dict[str, str] = {}
    sections: dict[str, str] = {}
    made_of: list[tuple[Card, str]] = []
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
    title = heading_of(model)
    return DeckFacts(path, title, tuple(model), tuple(map(tuple, steps)), properties, sections)


def _held(card: Card, row: Row, sets: Sets) -> NDArray[np.int64]:
    """Return node and dof of the supports of a line, shape (n, 2)."""
    fields = row.fields
    if fields[0].upper() in sets:
        nodes = sets.members(fields[0].upper())
        sets.count(len(nodes), card, row)
    elif fields[0].isdecimal():
        nodes = np.array([whole(fields[0], card, row)], dtype=np.int64)
    else:
        raise card.error(
            f"*BOUNDARY: no node set {fields[0]!r}; {suggest(fields[0].upper(), [*sets])}", row
        )
    if len(fields) == 2 and fields[1].upper() in _SUPPORTS:
        directions: tuple[int, ...] = _SUPPORTS[fields[1].upper()]
    elif len(fields) > 1 and "".join(fields[1:3]).isdecimal():
        first = last = whole(fields[1], card, row)
        if len(fields) > 2 and fields[2]:
            last = whole(fields[2], card, row)
        if not 1 <= first <= last <= 6:
            raise card.error(f"*BOUNDARY: found {row.text!r}; expected directions from 1 to 6", row)
        directions = tuple(range(first, last + 1))
    else:
        raise card.error(
            f"*BOUNDARY: found {row.text!r}; expected node, first direction, last direction", row
        )
    if len(fields) > 3 and fields[3] and number(fields[3], card, row) != 0.0:
        raise card.error(f"*BOUNDARY: found {row.text!r}; a support holds at 0", row)
    both = np.repeat(nodes, len(directions)), np.tile(directions, len(nodes))
    return np.stack(both, axis=1).astype(np.int64)


def _element_numbers(card: Card) -> NDArray[np.int64]:
    """Return the numbers of the elements; a line that ends with a comma goes on in the next."""
    numbers, goes_on = [], False
    for row in card.rows:
        if not goes_on:
            numbers.append(whole(row.fields[0], card, row))
        goes_on = row.text.endswith(",")
    return np.array(numbers, dtype=np.int64)
