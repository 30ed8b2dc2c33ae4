"""Bars with exchanged section axes: the cards PBAR and PBARL (a solid rectangle)."""

from __future__ import annotations

from updyn.io.nastran.cards import NastranCard

__all__ = ["exchanged_bar", "fields_to_exchange"]

#: Positions of fields that change places, after the name: I1 and I2, K1 and K2 of a PBAR; DIM1 and
#: DIM2 of a PBARL.
_PBAR, _PBARL = ((3, 4), (16, 17)), ((8, 9),)
#: Position of the product of inertia of a PBAR.
_PRODUCT = 18


def exchanged_bar(card: NastranCard) -> NastranCard | None:
    """Return the property of a bar with exchanged section axes, or None.

    None if exchanging changes nothing, the section has a product of inertia, or the card is neither
    a PBAR nor a PBARL of section BAR.
    """
    pairs: tuple[tuple[int, int], ...] = ()
    if card.name == "PBAR" and not card.real(_PRODUCT, 0.0):
        pairs = _PBAR
    elif card.name == "PBARL" and card.text(3) == "BAR":
        pairs = _PBARL
    changes: dict[int, str] = {}
    for a, b in pairs:
        if card.real(a, 0.0) != card.real(b, 0.0):
            changes |= {a: card.text(b), b: card.text(a)}
    return card.with_fields(changes) if changes else None


def fields_to_exchange(card: NastranCard) -> str:
    """Return the fields of a property that `exchanged_bar` exchanges, with file and line."""
    line = card.lines[0]
    fields = "I1 and I2 (fields 5 and 6)" if card.name == "PBAR" else "DIM1 and DIM2"
    return f"{fields} of {card.name} {card.text(0)} ({line.path.name}, line {line.number})"
