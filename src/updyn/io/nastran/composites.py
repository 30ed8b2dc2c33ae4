"""Laminates for MYSTRAN, whose mass matrix takes the density of each ply from the ply before it.

In version 18.0.0 the first ply of an element has the density of the previous element. Here the
masses of all plies become non-structural mass of the PCOMP, the plies get materials without
density, and a ply of negligible thickness comes first.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

from updyn.io.nastran.cards import NastranCard
from updyn.io.nastran.deck import MATERIALS, materials_of, values
from updyn.io.nastran.fields import format_field

__all__ = ["move_ply_masses"]

_NSM, _LAM, _PLIES = 2, 7, 8  # fields of a PCOMP
_WIDTH = 16
#: Thickness of the additional ply relative to that of the first one.
_NEGLIGIBLE = 1e-12


def move_ply_masses(cards: Iterable[NastranCard]) -> list[NastranCard]:
    """Return cards with the masses of plies as non-structural masses."""
    given = list(cards)
    if not any(card.name == "PCOMP" for card in given):
        return given
    materials = {card.integer(0): card for card in given if card.name in MATERIALS}
    last = max(materials, default=0)
    light: dict[int, int] = {}  # numbers of the materials without density
    out = []
    for card in given:
        if card.name != "PCOMP":
            out.append(card)
            continue
        mass = card.real(_NSM, 0.0) + _mass_of_plies(card, materials)
        changes = {_NSM: format_field(mass, _WIDTH)}
        for at in materials_of(card):
            number = light.setdefault(card.integer(at), last + 1 + len(light))
            changes[at] = str(number)
        out.append(_add_ply(card.with_fields(changes)))
    for old, new in light.items():
        density = values(materials[old]).mass[0]
        out.append(materials[old].with_fields({0: str(new), density: ""}))
    return out


@dataclass(frozen=True, slots=True)
class _Ply:
    """Material and thickness of a ply."""

    material: int
    thickness: float


def _list_plies(card: NastranCard) -> Iterator[_Ply]:
    """Yield the plies of a PCOMP; a blank material or thickness is that of the ply before."""
    material, thickness = 0, 0.0
    for at in range(_PLIES, len(card.fields), 4):
        if not card.nonempty(range(at, at + 4)):
            continue
        material = card.integer(at, material)
        thickness = card.real(at + 1, thickness)
        yield _Ply(material, thickness)


def _add_ply(card: NastranCard) -> NastranCard:
    """Return a PCOMP with a negligible ply of the first material before its plies."""
    first = next(_list_plies(card))
    thickness = format_field(first.thickness * _NEGLIGIBLE, _WIDTH)
    ply = (str(first.material), thickness, "", "")
    return replace(card, fields=(*card.fields[:_PLIES], *ply, *card.fields[_PLIES:]))


def _mass_of_plies(card: NastranCard, materials: Mapping[int, NastranCard]) -> float:
    """Return the mass per area of the plies, both halves of a symmetric laminate."""
    mass = 0.0
    for ply in _list_plies(card):
        material = materials[ply.material]
        mass += material.real(values(material).mass[0], 0.0) * ply.thickness
    return 2.0 * mass if card.text(_LAM) == "SYM" else mass
