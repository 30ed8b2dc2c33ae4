"""What a deck of Abaqus says that goes with its matrices: nodes, sets, sections, materials and matrix cards."""

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
from updyn.io.keyword_deck.structure import (
    Property,
    read_members,
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
    """A deck of Abaqus as far as its matrices need it. Names are in capitals where they are looked up.

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
        materials = [p for p in self.properties.values() if p.kind == "material"]
        check_materials(
            [(p.name, p.first("stiffness"), p.first("mass")) for p in materials], units, self.path
        )
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
        sets: dict[str, list[NDArray[np.int64]]] = {}
        for card in self.cards:
            name = card.get("ELSET")
            if name and card.name == "ELEMENT":
                sets.setdefault(name.upper(), []).append(_element_numbers(card))
            elif name and card.name == "ELSET":
                sets.setdefault(name.upper(), []).append(read_members(card, sets))
        return {name: np.unique(np.concatenate(parts)) for name, parts in sets.items()}

    def held(self) -> list[tuple[int, int]]:
        """Return node and dof (1 to 6) of every support of the model and of its first step.

        Raises
        ------
        FormatError
            If a line cannot be read, names a node set that is not there, or does not hold at 0.
        """
        sets: dict[str, list[NDArray[np.int64]]] = {}
        out: list[tuple[int, int]] = []
        for card in (*self.cards, *(self.steps[0] if self.steps else ())):
            if card.name == "NODE" and (name := card.get("NSET")):
                sets.setdefault(name.upper(), []).append(read_nodes(card)[0])
            elif card.name == "NSET":
                sets.setdefault(card.need("NSET").upper(), []).append(read_members(card, sets))
            elif card.name == "BOUNDARY":
                out += [pair for row in card.rows for pair in _held(card, row, sets)]
        return out

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
        out: dict[str, Mapping[str, float]] = {}
        for name, change in changes.items():
            material = None if name.upper() in self.properties else self.sections.get(name.upper())
            if material is None:
                if name.upper() not in self.properties:
                    near = suggest(name.upper(), [*self.properties, *self.sections])
                    raise FormatError(
                        f"the deck has no material or element set {name!r}; {near}", self.path
                    )
                out[name] = change
                continue
            alike = {s for s, m in self.sections.items() if m == material}
            others = [
                s
                for s in sorted(alike)
                if dict(changes.get(_as_given(s, changes), {})) != dict(change)
            ]
            if others:
                raise FormatError(
                    f"group {name!r} is made of material {material!r}, as is {others[0]!r}, which"
                    " changes otherwise; give each a material of its own in the deck",
                    self.path,
                )
            out[material] = change
        return out


def _as_given(name: str, changes: Mapping[str, Mapping[str, float]]) -> str:
    return next((given for given in changes if given.upper() == name), name)


def read_facts(path: Path, cards: Sequence[Card]) -> DeckFacts:
    """Look through a deck.

    Raises
    ------
    FormatError
        If a card that is looked at cannot be read.
    """
    model, steps = split_steps(cards)
    title = next(
        (row.text for card in model if card.name == "HEADING" for row in card.rows[:1]), ""
    )
    types = {
        name.upper(): (card.get("TYPE") or "").upper()
        for card in model
        if card.name == "ELEMENT" and (name := card.get("ELSET"))
    }
    sections = {
        elset.upper(): material.upper()
        for card in model
        if card.name in _SECTIONS
        and (elset := card.get("ELSET"))
        and (material := card.get("MATERIAL"))
    }
    properties = read_properties(model, types)
    for card in model:
        if (
            card.name in _SECTIONS
            and (material := card.get("MATERIAL"))
            and material.upper() not in properties
        ):
            near = suggest(
                material.upper(), [n for n, p in properties.items() if p.kind == "material"]
            )
            raise card.error(f"*{card.name}: no material {material!r}; {near}")
    return DeckFacts(path, title, tuple(model), tuple(map(tuple, steps)), properties, sections)


def _held(
    card: Card, row: Row, sets: Mapping[str, list[NDArray[np.int64]]]
) -> list[tuple[int, int]]:
    fields = row.fields
    if fields[0].upper() in sets:
        nodes = np.unique(np.concatenate(sets[fields[0].upper()])).tolist()
    elif fields[0].isdecimal():
        nodes = [int(fields[0])]
    else:
        raise card.error(
            f"*BOUNDARY: no node set {fields[0]!r}; {suggest(fields[0].upper(), sets)}", row
        )
    if len(fields) == 2 and fields[1].upper() in _SUPPORTS:
        directions: tuple[int, ...] = _SUPPORTS[fields[1].upper()]
    elif len(fields) > 1 and all(f.isdecimal() for f in fields[1:3] if f):
        first = whole(fields[1], card, row)
        last = whole(fields[2], card, row) if len(fields) > 2 and fields[2] else first
        if not 1 <= first <= last <= 6:
            raise card.error(f"*BOUNDARY: found {row.text!r}; expected directions from 1 to 6", row)
        directions = tuple(range(first, last + 1))
    else:
        raise card.error(
            f"*BOUNDARY: found {row.text!r}; expected node, first direction, last direction", row
        )
    if len(fields) > 3 and fields[3] and number(fields[3], card, row) != 0.0:
        raise card.error(f"*BOUNDARY: found {row.text!r}; a support holds at 0", row)
    return [(node, direction) for node in nodes for direction in directions]


def _element_numbers(card: Card) -> NDArray[np.int64]:
    """Return the numbers of the elements; a line that ends with a comma goes on in the next."""
    numbers, goes_on = [], False
    for row in card.rows:
        if not goes_on:
            numbers.append(whole(row.fields[0], card, row))
        goes_on = row.text.endswith(",")
    return np.array(numbers, dtype=np.int64)
