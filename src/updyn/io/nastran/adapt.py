"""What MYSTRAN reads otherwise than Nastran, or not at all.

Seen with version 18.0.0, which passes over cards that it does not know with no more than a warning.
"""

from __future__ import annotations

from collections.abc import Iterable

from updyn.io.nastran.cards import Card
from updyn.io.nastran.deck import Deck
from updyn.io.nastran.fields import real, text_of

__all__ = ["adapted"]

_WIDTH = 16
#: Fields of first and second grid, and of their components.
_ENDS = {"CELAS1": ((2, 3), (4, 5)), "CELAS2": ((2, 3), (4, 5)), "CMASS2": ((2, 3), (4, 5))}
#: Cards that MYSTRAN passes over or has no code for, and what would do.
_NOT_READ = {
    "CBEAM": (
        "a CBAR, where its section is constant and shear centre and neutral axis fall together"
    ),
    "CTUBE": "a CROD or a CBAR",
    "CQUADR": "a CQUAD4",
    "CTRIAR": "a CTRIA3",
    "CTRIA6": "four CTRIA3",
    "RBE1": "RBE2, RBE3 or MPC cards",
}
#: Viscous dampers, which MYSTRAN does not know, and which are neither stiffness nor mass.
_DAMPERS = ("CDAMP1", "CDAMP2", "PDAMP")
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

    Raises
    ------
    FormatError
        If MYSTRAN has no such element; the message names what would do.
    """
    out: list[Card] = []
    grounds = max([*deck.grids, *deck.points], default=0)
    for card in cards:
        if card.name in _DAMPERS or (card.name == "PARAM" and card.text(0) in _PARAMETERS):
            continue
        if card.name in _NOT_READ:
            raise card.error(
                f"{card.name} {card.text(0)}: MYSTRAN has no {card.name}; {_NOT_READ[card.name]}"
                " would do, or the matrices from Nastran itself (OUTPUT4, DMIG)"
            )
        if card.name in _ENDS:
            changed, ground = _spring(deck, card, grounds + 1)
        elif card.name == "CBUSH" and not card.text(3):
            ground = _ground(deck, card, card.integer(2), grounds + 1)
            changed = card.with_fields({3: str(grounds + 1)})
        elif card.name == "RBAR":
            changed, ground = _bar(card), None
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
    if card.name != "CMASS2" and (
        not card.text(two[0]) or card.text(two[0]) == "0"
    ):  # a mass has one end
        ground = _ground(deck, card, card.integer(one[0]), number)
        new |= {two[0]: str(number), two[1]: new.get(one[1], card.text(one[1]))}
    return card.with_fields(new), ground


def _bar(card: Card) -> Card:
    """Return a rigid bar, all of whose independent components are at one end, as an RBE2."""
    own, other = card.text(3), card.text(4)
    ends = ((1, 2, 6), (2, 1, 5))  # independent grid, dependent grid, dependent components
    if {own, other} != {"123456", ""}:
        raise card.error(
            f"RBAR {card.text(0)}: independent components {own or 'none'} and {other or 'none'};"
            " expected 123456 at one end, as MYSTRAN has RBE2 only"
        )
    independent, dependent, components = ends[0] if own else ends[1]
    fields = (
        card.text(0),
        card.text(independent),
        card.text(components, "123456"),
        card.text(dependent),
    )
    return Card("RBE2", fields, card.lines)


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
                raise card.error(
                    f"{card.name}: field {at + 2} is {cell!r}; expected at most 16 characters"
                ) from error
    return card.with_fields(new) if new else card
