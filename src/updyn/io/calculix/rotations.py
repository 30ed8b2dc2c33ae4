"""Rotations of rigid bodies: ``ccx`` keeps them as the translations of a node of their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from updyn.dofs import DofSet
from updyn.errors import FormatError
from updyn.io.keyword_cards import Card, Row, whole
from updyn.io.keyword_deck import Deck

__all__ = ["Rotations", "read_rotations"]


@dataclass(frozen=True, slots=True)
class Rotations:
    """Which node holds whose rotations.

    Parameters
    ----------
    named : tuple of (int, int)
        ROT NODE and REF NODE of each rigid body that names both.
    unnamed : tuple of int
        REF NODE of the others, in the order of the deck: ``ccx`` makes a node beyond the largest
        for each.
    path : Path
        The deck, for messages.
    """

    named: tuple[tuple[int, int], ...]
    unnamed: tuple[int, ...]
    path: Path

    def renamed(self, dofs: DofSet, deck: Deck) -> DofSet:
        """Return the degrees of freedom with rotations as those of the reference nodes.

        Parameters
        ----------
        dofs : DofSet
            As ``ccx`` names them, all along X, Y and Z.
        deck : Deck
            The structure.

        Returns
        -------
        DofSet
            In the same order.

        Raises
        ------
        FormatError
            If there are nodes that the deck does not have and that no rigid body explains.
        """
        made = np.setdiff1d(dofs.nodes, deck.nodes)
        # C3D8I has three generalised displacements of its own, which ccx keeps (with mass) as
        # nodes.
        inner = 3 * sum(block.numbers.size for block in deck.elements if block.type == "C3D8I")
        if len(made) != inner + len(self.unnamed) or (inner and self.unnamed):
            raise FormatError(
                f"ccx makes {len(made)} nodes that the deck does not have, {inner} of them inside"
                f" C3D8I, and there are {len(self.unnamed)} rigid bodies or couplings without a"
                " node for their rotations: give each *RIGID BODY a ROT NODE",
                self.path,
            )
        bodies = zip(made.tolist(), self.unnamed, strict=True) if not inner else ()
        nodes, axes = dofs.nodes.copy(), dofs.axes.astype(np.int64)
        for rotation, reference in (*self.named, *bodies):
            own = dofs.nodes == rotation
            nodes[own], axes[own] = reference, axes[own] + 3
        return DofSet.from_arrays(nodes, axes)


def read_rotations(model: Sequence[Card], path: Path) -> Rotations:
    """Look for rigid bodies and couplings.

    Parameters
    ----------
    model : sequence of Card
        The cards before the first step.
    path : Path
        The deck, for messages.

    Returns
    -------
    Rotations

    Raises
    ------
    FormatError
        If a node is no whole number.
    """
    named, unnamed = [], []
    for card in model:
        if card.name in ("RIGID BODY", "COUPLING"):
            row = Row(card.line, "")
            reference = whole(card.need("REF NODE"), card, row)
            if rotation := card.get("ROT NODE"):
                named.append((whole(rotation, card, row), reference))
            else:
                unnamed.append(reference)
    return Rotations(tuple(named), tuple(unnamed), path)
