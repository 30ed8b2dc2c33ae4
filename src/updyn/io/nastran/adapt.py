"""What MYSTRAN writes differently from Nastran: springs to the ground, scalar points, numbers that are too long."""

from __future__ import annotations

from collections.abc import Iterable

from updyn.io.nastran.cards import Card
from updyn.io.nastran.deck import Deck
from updyn.io.nastran.fields import real, text_of

__all__ = ["adapted"]

_WIDTH = 16
#: Fields of first and second grid, and of their components.
_ENDS = {"CELAS1": ((2, 3), (4, 5)), "CELAS2": ((2, 3), (4, 5)), "CMASS2": ((2, 3), (4, 5))}
#: PARAM cards that only say what is printed or solved for, or that the run sets itself.
_PARAMETERS = (
    "DDRMM", "G", "GRDPNT", "GRIDSEQ", "LMODES", "POST", "PRTMAXIM", "RESVEC", "SOLLIB", "SPARSTOR", "W3", "W4",
)  # fmt: skip


def adapted(deck: Deck, cards: Iterable[Card]) -> list[Card]:
    """Return the cards as MYSTRAN wants them.

    MYSTRAN has no springs with one end: the other is put on a grid of its own that is held.

    Parameters
    ----------
    deck : Deck
        The deck, for its grids.
    cards : iterable of Card
        Its cards, perhaps with new values.

    Returns
    -------
    list of Card
        Cards whose fields fit 16 characters.
    """
    out: list[Card] = []
    grounds = max([*deck.grids, *deck.points], default=0)
    for card in cards:
        if card.name == "PARAM" and card.text(0) in _PARAMETERS:
            continue
        if card.name in _ENDS:
            changed, ground = _spring(deck, card, grounds + 1)
        elif card.name == "CBUSH" and not card.text(3):
            ground = _ground(deck, card, card.integer(2), grounds + 1)
            changed = card.with_fields({3: str(grounds + 1)})
        else:
            changed, ground = card, None
        if ground is not None:
            grounds += 1
            out.append(ground)
        out.append(_short(changed))
    return out


def _spring(deck: Deck, card: Card, number: int) -> tuple[Card, Card | None]:
    one, two = _ENDS[card.name]
    if not card.text(one[0]) or card.text(one[0]) == "0":
        one, two = two, one
    new = {}
    for node, component in (one, two):
        if card.text(node).isdecimal() and card.integer(node) in deck.points:
            new[component] = "1"
    ground = None
    if card.name != "CMASS2" and (not card.text(two[0]) or card.text(two[0]) == "0"):  # a mass has one end
        ground = _ground(deck, card, card.integer(one[0]), number)
        new |= {two[0]: str(number), two[1]: new.get(one[1], card.text(one[1]))}
    return card.with_fields(new), ground


def _ground(deck: Deck, card: Card, node: int, number: int) -> Card:
    """Return a held grid where the given one stands, moving in the same system."""
    if node not in deck.grids:
        return Card("GRID", (str(number), "", "0.", "0.", "0.", "", "123456"), card.lines)
    return deck.grids[node].with_fields({0: str(number), 6: "123456"})


def _short(card: Card) -> Card:
    new = {}
    for at, cell in enumerate(card.fields):
        if len(cell) > _WIDTH:
            try:
                new[at] = text_of(real(cell), _WIDTH)
            except ValueError as error:
                raise card.error(f"{card.name}: field {at + 2} is {cell!r}; expected at most 16 characters") from error
    return card.with_fields(new) if new else card
