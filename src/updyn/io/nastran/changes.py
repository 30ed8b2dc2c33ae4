"""New values of properties: the cards of a deck that change when stiffness, mass or damping of groups do."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from updyn.errors import ModelError
from updyn.io.nastran.cards import Card, text_of
from updyn.io.nastran.deck import Deck, Values, materials_of, values

__all__ = ["Revision", "has_mass", "loss_factor_of", "revise"]

_WIDTH = 16
_QUANTITIES = ("stiffness", "mass", "viscous", "loss_factor")


@dataclass(frozen=True, slots=True)
class Revision:
    """What to do to a deck.

    Parameters
    ----------
    replaced : dict of Card to Card
        Cards of the deck, and what stands in their place.
    added : list of Card
        New cards: copies of materials that several groups share.
    """

    replaced: dict[Card, Card] = field(default_factory=dict)
    added: list[Card] = field(default_factory=list)

    def cards(self, cards: Iterable[Card], added: Iterable[Card] | None = None) -> list[Card]:
        """Return cards of a deck as they are after this; `added` stands in for those that are new."""
        return [self.replaced.get(card, card) for card in cards] + list(
            self.added if added is None else added
        )


@dataclass(frozen=True, slots=True)
class _Asked:
    """Factors on a group, and the loss factor that its cards are to give; None: as they do."""

    stiffness: float
    mass: float
    viscous: float
    loss: float | None


def revise(deck: Deck, changes: Mapping[str, Mapping[str, float]]) -> Revision:
    """Work out which cards change.

    Parameters
    ----------
    deck : Deck
        The deck.
    changes : mapping of str to mapping of str to float
        By group: ``stiffness``, ``mass`` and ``viscous`` are factors on what the deck has,
        ``loss_factor`` is the new value (PARAM,G of the deck counts as part of it).

    Returns
    -------
    Revision
        A material that other groups use too is copied under a new number, to which the property
        then points.

    Raises
    ------
    FormatError
        If there is no such group, or it has nothing of what is to change.
    ModelError
        If a quantity is not known or a loss factor is below what PARAM,G gives to all.
    """
    users = _users(deck)
    out = Revision()
    next_number = max(deck.materials, default=0) + 1
    for name, change in changes.items():
        card = deck.group(name)
        asked = _asked(deck, name, card, change)
        found = out.replaced.get(card, card)
        new = _changed(found, _spread(found, asked.loss), asked)
        for number in dict.fromkeys(card.integer(i) for i in materials_of(card)):
            material = deck.materials[number]
            # The loss factor of a laminate is on its own card.
            own = replace(asked, loss=None) if card.name == "PCOMP" else asked
            scaled = _changed(material, material, own)
            if scaled == material:
                continue
            if len(users[number]) == 1:
                out.replaced[material] = scaled
                continue
            out.added.append(scaled.with_fields({0: str(next_number)}))
            new = new.with_fields(
                {i: str(next_number) for i in materials_of(card) if card.integer(i) == number}
            )
            next_number += 1
        if new != card:
            out.replaced[card] = new
    return out


def loss_factor_of(deck: Deck, name: str) -> float:
    """Return the structural loss factor of a group: GE of its card or its materials, plus PARAM,G.

    Raises
    ------
    FormatError
        If its cards give several values.
    """
    card = deck.group(name)
    holders = [card]
    if card.name != "PCOMP":
        holders += [deck.materials[card.integer(i)] for i in materials_of(card)]
    found = set()
    for holder in holders:
        fields = values(holder)
        if fields.loss and (fields.stiffness or holder.name == "PCOMP"):
            found |= {holder.real(i, 0.0) for i in fields.loss}
        elif holder.name == "PBUSH":
            found.add(0.0)
    if len(found) > 1:
        raise card.error(
            f"group {name}: loss factors {', '.join(f'{g:g}' for g in sorted(found))}; expected one"
        )
    return (found.pop() if found else 0.0) + deck.parameter("G", 0.0)


def has_mass(deck: Deck, name: str) -> bool:
    """Return whether a density, a mass or a non-structural mass of the group is not zero."""
    card = deck.group(name)
    holders = [card, *(deck.materials[card.integer(i)] for i in materials_of(card))]
    return any(h.text(i) and h.real(i) != 0.0 for h in holders for i in values(h).mass)


def _users(deck: Deck) -> dict[int, set[str]]:
    out: dict[int, set[str]] = {number: set() for number in deck.materials}
    for card in deck.groups.values():
        for i in materials_of(card):
            out[card.integer(i)].add(f"{card.name} {card.text(0)}")
    # A property that no element uses still names its material: it must not change under it.
    for card in deck.properties.values():
        for i in materials_of(card):
            if card.text(i).isdecimal() and card.integer(i) in out:
                out[card.integer(i)].add(f"{card.name} {card.text(0)}")
    return out


def _asked(deck: Deck, name: str, card: Card, change: Mapping[str, float]) -> _Asked:
    for quantity in change:
        if quantity not in _QUANTITIES:
            raise ModelError(
                f"group {name!r}: no quantity {quantity!r} in a deck; expected stiffness, mass,"
                " viscous or loss_factor"
            )
    stiffness, mass, viscous = (float(change.get(q, 1.0)) for q in ("stiffness", "mass", "viscous"))
    if viscous != 1.0 and not values(card).viscous:
        raise card.error(f"group {name} has no viscous damping to change")
    stiff = bool(values(card).stiffness or materials_of(card))
    if not stiff and (stiffness != 1.0 or "loss_factor" in change):
        raise card.error(f"group {name} has no stiffness to change")
    if mass != 1.0 and not has_mass(deck, name):
        raise card.error(f"group {name} has no mass to change: neither density nor mass is given")
    if "loss_factor" not in change or float(change["loss_factor"]) == loss_factor_of(deck, name):
        return _Asked(stiffness, mass, viscous, None)
    common = deck.parameter("G", 0.0)
    loss = float(change["loss_factor"]) - common
    if loss < -1e-12:
        raise ModelError(
            f"group {name!r}: loss factor {change['loss_factor']:g} is below PARAM,G of the deck,"
            f" {common:g}, which all groups have"
        )
    return _Asked(stiffness, mass, viscous, max(loss, 0.0))


def _spread(card: Card, loss: float | None) -> Card:
    """Give a PBUSH without a line of loss factors one."""
    if card.name != "PBUSH" or loss is None or values(card).loss:
        return card
    start = len(card.fields) + (-len(card.fields) % 8)
    return card.with_fields({start + 1: "GE", **{start + 2 + k: "0." for k in range(6)}})


def _changed(card: Card, laid_out: Card, asked: _Asked) -> Card:
    fields: Values = values(laid_out)
    new: dict[int, str] = {}
    for places, factor in (
        (fields.stiffness, asked.stiffness),
        (fields.mass, asked.mass),
        (fields.viscous, asked.viscous),
    ):
        if factor != 1.0:
            new |= {
                at: text_of(laid_out.real(at) * factor, _WIDTH)
                for at in places
                if laid_out.text(at)
            }
    if asked.loss is not None:
        new |= {at: text_of(asked.loss, _WIDTH) for at in fields.loss}
    return laid_out.with_fields(new) if new else card
