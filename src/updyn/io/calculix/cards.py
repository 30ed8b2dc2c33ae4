"""Which cards a deck may hold that ``ccx`` is to write matrices of, and which of them it is given."""

from __future__ import annotations

from collections.abc import Sequence

from updyn.errors import suggest
from updyn.io.calculix.program import STORAGE
from updyn.io.keyword_cards import Card, number
from updyn.io.keyword_deck import split_steps
from updyn.io.keyword_properties import LINEAR, NONLINEAR

__all__ = ["ABAQUS", "check_model", "storage_deck"]

#: Cards that CalculiX does not have and that tell a deck of Abaqus.
ABAQUS = ("MATRIX INPUT", "MATRIX ASSEMBLE", "MATRIX GENERATE", "PART", "ASSEMBLY", "INSTANCE")
_STRUCTURE = (
    "HEADING",
    "NODE",
    "ELEMENT",
    "NSET",
    "ELSET",
    "SURFACE",
    "MATERIAL",
    "SOLID SECTION",
    "SPRING",
    "MASS",
    "BOUNDARY",
    "EQUATION",
    "MPC",
    "TIE",
    "RIGID BODY",
    "COUPLING",
    "KINEMATIC",
    "TRANSFORM",
    "ORIENTATION",
)
#: Says nothing of stiffness and mass.
_IDLE = ("AMPLITUDE", "TIME POINTS", "PHYSICAL CONSTANTS", "INITIAL CONDITIONS", "PREPRINT")
_EXPANDED = (
    "beams and shells are expanded into solids with hidden nodes, whose DOFs are not those of the"
    " deck"
)
_REFUSED = {
    "DISTRIBUTING": "its reference node has no place in the matrices; use *KINEMATIC or *EQUATION",
    "DISTRIBUTING COUPLING": (
        "its reference node has no place in the matrices; use *COUPLING or *EQUATION"
    ),
    "CONTACT PAIR": "contact is not linear; use *TIE where the faces stick together",
    "SURFACE INTERACTION": "contact is not linear; use *TIE where the faces stick together",
    "GAP": "contact is not linear",
    "DASHPOT": (
        "dashpots stand in no matrix that ccx writes; leave them out and add their damping to the"
        " model later"
    ),
    "CYCLIC SYMMETRY MODEL": "the matrices of a sector are not those of the whole; model the whole",
    "SUBMODEL": "a submodel has no boundary of its own",
    "RESTART": "a deck that goes on from another is not complete",
    "BEAM SECTION": _EXPANDED,
    "BEAM GENERAL SECTION": _EXPANDED,
    "SHELL SECTION": _EXPANDED,
    "MEMBRANE SECTION": _EXPANDED,
}


def check_model(model: Sequence[Card]) -> None:
    """Refuse what ``ccx`` would pass over with a remark, or what its matrices would not show.

    Parameters
    ----------
    model : sequence of Card
        The cards before the first step.

    Raises
    ------
    FormatError
        For the first such card: file, line, why, and the nearest keyword where it is not known at
        all.
    """
    known = (*_STRUCTURE, *LINEAR, *_IDLE)
    below = False  # a *MATERIAL
    for card in model:
        below = card.name == "MATERIAL" or (below and card.name in (*LINEAR, *NONLINEAR))
        if card.name in NONLINEAR:
            raise card.error(
                f"*{card.name}: only linear elastic materials (*ELASTIC) are read; leave it out"
            )
        if card.name in _REFUSED:
            raise card.error(f"*{card.name} is not read: {_REFUSED[card.name]}")
        if card.name not in known:
            raise card.error(f"unknown keyword *{card.name}; {suggest(card.name, known)}")
        if card.name in LINEAR and card.name != "DAMPING" and not below:
            raise card.error(f"*{card.name} stands below no *MATERIAL")
        if card.name == "SPRING":
            card.only("ELSET", "ORIENTATION")
        elif card.name == "MASS":
            card.only("ELSET")
        elif card.name == "MATERIAL":
            card.only("NAME")
        elif card.name == "SOLID SECTION":
            card.only("ELSET", "MATERIAL", "ORIENTATION")
        elif card.name == "BOUNDARY":
            _check_boundary(card)


def _check_boundary(card: Card) -> None:
    for row in card.rows:
        fields = row.fields
        if len(fields) > 3 and fields[3] and number(fields[3], card, row) != 0.0:
            raise card.error(f"*BOUNDARY: found {row.text!r}; a support holds at 0", row)


def storage_deck(cards: Sequence[Card]) -> tuple[list[Card], list[str]]:
    """Return the cards of the model, and the lines of the step that has ``ccx`` write its matrices.

    Supports that stand in the deck's first ``*FREQUENCY`` step, or in its first step if it has no
    such, are taken along; all else that stands in steps (loads, output) has no part in the
    matrices.

    Parameters
    ----------
    cards : sequence of Card
        The deck.

    Returns
    -------
    (list of Card, list of str)

    Raises
    ------
    FormatError
        If that step builds on another (preload), or a support is not one.
    """
    model, steps = split_steps(cards)
    chosen = next(
        (s for s in steps if any(c.name == "FREQUENCY" for c in s)), steps[0] if steps else []
    )
    if chosen and chosen is not steps[0] and "PERTURBATION" in chosen[0].parameters:
        raise chosen[0].error(
            "*STEP, PERTURBATION after another step: stiffness by preload belongs to no material;"
            " leave PERTURBATION out or move the step to the front"
        )
    lines = list(STORAGE[:1])
    for card in chosen:
        if card.name == "BOUNDARY":
            _check_boundary(card)
            lines += card.text()
    return model, [*lines, *STORAGE[1:], "*END STEP"]
