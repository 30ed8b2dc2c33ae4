"""Changed property values: the new cards of a deck for changed groups."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from updyn.errors import ModelError
from updyn.io.changes import check_changes
from updyn.io.nastran.cards import NastranCard
from updyn.io.nastran.deck import NastranDeck, Values, materials_of, values
from updyn.io.nastran.fields import format_field

__all__ = ["Revision", "group_loss_factor", "has_mass", "revise"]

_WIDTH = 16


@dataclass(frozen=True, slots=True)
class Revision:
    """The changes of a deck; `added` are copies of materials that several groups share."""

    replaced: dict[NastranCard, NastranCard] = field(default_factory=dict)
    added: list[NastranCard] = field(default_factory=list)

    def cards(self, cards: Iterable[NastranCard]) -> list[NastranCard]:
        """Return cards of a deck after the changes, without the added cards."""
        return [self.replaced.get(card, card) for card in cards]


@dataclass(frozen=True, slots=True)
class _Change:
    """Factors of a group and its new loss factor; None keeps the loss factor."""

    stiffness: float
    mass: float
    viscous: float
    loss: float | None


def revise(deck: NastranDeck, changes: Mapping[str, Mapping[str, float]]) -> Revision:
    """Return the changed cards; a material that other groups use too is copied.

    `changes` are factors, except the new ``loss_factor``, which includes PARAM,G of the deck; a
    `ModelError` is raised if it is below PARAM,G.
    """
    check_changes(changes, deck.path)
    users = _users(deck)
    out = Revision()
    next_number = max(deck.materials, default=0) + 1
    for name, change in changes.items():
        card = deck.group(name)
        change_of_group = _parse_change(deck, name, card, change)
        found = out.replaced.get(card, card)
        new = _scale_card(found, _add_loss_line(found, change_of_group.loss), change_of_group)
        if card.name == "PCOMP":  # the loss factor of a laminate is on its own card
            change_of_group = replace(change_of_group, loss=None)
        for number in dict.fromkeys(card.integers(materials_of(card))):
            material = deck.materials[number]
            scaled = _scale_card(material, material, change_of_group)
            if scaled == material:
                continue
            if len(users[number]) == 1:
                out.replaced[material] = scaled
                continue
            copy = str(next_number)
            out.added.append(scaled.with_fields({0: copy}))
            for at in materials_of(card):
                if card.integer(at) == number:
                    new = new.with_fields({at: copy})
            next_number += 1
        if new != card:
            out.replaced[card] = new
    return out


def group_loss_factor(deck: NastranDeck, name: str) -> float:
    """Return the structural loss factor of a group: GE of its card or materials, plus PARAM,G."""
    card = deck.group(name)
    holders = [card]
    if card.name != "PCOMP":
        holders += deck.materials_of(card)
    found: set[float] = set()
    for holder in holders:
        fields = values(holder)
        if fields.loss and (fields.stiffness or holder.name == "PCOMP"):
            found.update(holder.reals(fields.loss, 0.0))
        elif holder.name == "PBUSH":
            found.add(0.0)
    if len(found) > 1:
        shown = ", ".join(f"{loss:g}" for loss in sorted(found))
        raise card.error(f"group {name}: loss factors {shown}; expected one")
    return sum(found) + deck.parameter("G", 0.0)


def has_mass(deck: NastranDeck, name: str) -> bool:
    """Return whether any density, mass or non-structural mass of the group is not zero."""
    card = deck.group(name)
    for holder in (card, *deck.materials_of(card)):
        if any(holder.reals(values(holder).mass, 0.0)):
            return True
    return False


def _users(deck: NastranDeck) -> dict[int, set[str]]:
    """Return the cards that use each material, by material number."""
    out: dict[int, set[str]] = {number: set() for number in deck.materials}
    # Properties without elements count too: their materials must not change.
    for card in (*deck.groups.values(), *deck.properties.values()):
        for at in materials_of(card):
            if card.text(at).isdecimal() and card.integer(at) in out:
                out[card.integer(at)].add(f"{card.name} {card.text(0)}")
    return out


def _parse_change(
    deck: NastranDeck, name: str, card: NastranCard, change: Mapping[str, float]
) -> _Change:
    stiffness = float(change.get("stiffness", 1.0))
    mass = float(change.get("mass", 1.0))
    viscous = float(change.get("viscous", 1.0))
    if viscous != 1.0 and not values(card).viscous:
        raise card.error(f"group {name} has no viscous damping to change")
    stiff = bool(values(card).stiffness or materials_of(card))
    if not stiff and (stiffness != 1.0 or "loss_factor" in change):
        raise card.error(f"group {name} has no stiffness to change")
    if mass != 1.0 and not has_mass(deck, name):
        raise card.error(f"group {name} has no mass to change: neither density nor mass is given")
    if "loss_factor" not in change or float(change["loss_factor"]) == group_loss_factor(deck, name):
        return _Change(stiffness, mass, viscous, None)
    common = deck.parameter("G", 0.0)
    loss = float(change["loss_factor"]) - common
    if loss < -1e-12:
        raise ModelError(
            f"group {name!r}: loss factor {change['loss_factor']:g} is below PARAM,G of the deck,"
            f" {common:g}, which applies to all groups"
        )
    return _Change(stiffness, mass, viscous, max(loss, 0.0))


def _add_loss_line(card: NastranCard, loss: float | None) -> NastranCard:
    """Return a PBUSH extended by a line of zero loss factors, if it needs one for a new value."""
    if card.name != "PBUSH" or loss is None or values(card).loss:
        return card
    start = len(card.fields) + (-len(card.fields) % 8)
    zeros = dict.fromkeys(range(start + 2, start + 8), "0.")
    return card.with_fields({start + 1: "GE", **zeros})


def _scale_card(card: NastranCard, laid_out: NastranCard, change_of_group: _Change) -> NastranCard:
    fields: Values = values(laid_out)
    new: dict[int, str] = {}
    for places, factor in (
        (fields.stiffness, change_of_group.stiffness),
        (fields.mass, change_of_group.mass),
        (fields.viscous, change_of_group.viscous),
    ):
        if factor == 1.0:
            continue
        for at in laid_out.nonempty(places):
            new[at] = format_field(laid_out.real(at) * factor, _WIDTH)
    if change_of_group.loss is not None:
        new |= dict.fromkeys(fields.loss, format_field(change_of_group.loss, _WIDTH))
    return laid_out.with_fields(new) if new else card
