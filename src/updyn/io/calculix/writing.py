"""New properties for the deck that a model came from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from updyn.io.calculix.cards import ABAQUS
from updyn.io.calculix.reading import read_parts, read_rayleigh
from updyn.io.keyword_cards import read_cards
from updyn.io.keyword_changes import write_changes

__all__ = ["write_properties"]

_FOLLOWS = (
    "ALPHA and BETA hold for the whole deck: viscous damping follows the new mass and stiffness."
)


def write_properties(
    changes: Mapping[str, Mapping[str, float]], deck: str | Path, path: str | Path
) -> None:
    """Write the materials, springs and masses that changed as a file for ``*INCLUDE``.

    It takes the place of their old cards in the deck: CalculiX uses the first of two materials of
    one name. A deck of Abaqus is handed to `updyn.io.abaqus`.

    Parameters
    ----------
    changes : mapping of str to mapping of str to float
        By group: "stiffness" and "mass" are factors on the deck's moduli, spring constants,
        densities and masses, "loss_factor" is the new ``*DAMPING, STRUCTURAL=``.
    deck : path
        The deck.
    path : path
        The file to write.

    Raises
    ------
    FormatError
        If the deck cannot be read, has no such group (the nearest is named) or no place for the
        change.
    """
    deck = Path(deck)
    cards = read_cards(deck)
    if any(card.name in ABAQUS for card in cards):
        from updyn.io import abaqus

        abaqus.write_properties(changes, deck, path)
        return
    model, _, _, parts = read_parts(deck, cards)
    remarks = [_FOLLOWS] if any(read_rayleigh(model)) else []
    write_changes(changes, parts, deck, Path(path), own_rayleigh=False, remarks=remarks)
