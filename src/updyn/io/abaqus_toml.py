"""A TOML file whose groups name matrix files of Abaqus, as `updyn.io.matrix_market` describes it for its own.

::

    unit = "mm"                        # of all files; "m" where absent
    deck = "wing.inp"                  # optional: where the nodes stand; element sets
    internal = "keep"                  # or "condense", see updyn.io.abaqus

    [[group]]
    name = "spar"
    stiffness = "spar_STIF2.mtx"       # stiffness, mass, viscous, structural: at least one
    mass = "spar_MASS2.mtx"
    loss_factor = 0.02                 # optional, instead of structural

Files written with FORMAT=COORDINATE have no labels; ``dofs`` gives them, in the order of the rows. Of files written
with ELEMENT BY ELEMENT ``elset`` picks the elements of a group by the sets of the deck.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from updyn.dofs import DofSet
from updyn.errors import FormatError, suggest
from updyn.geometry import Geometry
from updyn.io.abaqus_deck import DeckFacts, read_facts
from updyn.io.abaqus_matrix import Entries, is_abaqus, read_entries
from updyn.io.abaqus_parts import MATRICES, Part, assemble
from updyn.io.consistent_units import system
from updyn.io.keyword_cards import read_cards
from updyn.model import Model

if TYPE_CHECKING:
    from updyn.io.matrix_market import Entry

__all__ = ["names_abaqus_files", "read_table"]

_TOP = ("title", "dofs", "geometry", "group", "unit", "deck", "internal")
_GROUP = ("name", *MATRICES, "loss_factor", "elset")


def names_abaqus_files(table: Mapping[str, Any], folder: Path) -> bool:
    """Say whether the first matrix file that a group names and that is there is one of Abaqus."""
    for group in table.get("group", ()):
        given = (
            [group[what] for what in MATRICES if isinstance(group.get(what), str)]
            if isinstance(group, dict)
            else []
        )
        for file in (folder / name for name in given):
            if file.is_file():
                return is_abaqus(file)
    return False


def read_table(
    entry: Entry, table: Mapping[str, Any], dofs: DofSet | None, geometry: Geometry | None
) -> Model:
    """Build the model of a TOML file.

    Parameters
    ----------
    entry : Entry
        The file, for messages.
    table : mapping
        What it holds.
    dofs : DofSet, optional
        What its ``dofs`` say.
    geometry : Geometry, optional
        What its ``[geometry]`` says.

    Returns
    -------
    Model

    Raises
    ------
    FormatError
        If a key is unknown, a file is missing or not valid, or files do not fit each other.
    """
    entry.only_known(table, _TOP, "")
    units = system(entry.text(table, "unit") if "unit" in table else "m")
    facts = None
    if "deck" in table:
        deck = entry.file(table, "deck")
        facts = read_facts(deck, read_cards(deck))
        geometry = facts.drawn(units) if geometry is None else geometry
    parts = [_part(entry, group, number, facts) for number, group in enumerate(table["group"])]
    title = entry.text(table, "title") if "title" in table else ""
    internal = entry.text(table, "internal") if "internal" in table else "keep"
    return assemble(
        parts, units, entry.path, dofs=dofs, geometry=geometry, title=title, internal=internal
    )


def _part(entry: Entry, group: Mapping[str, Any], number: int, facts: DeckFacts | None) -> Part:
    entry.only_known(group, _GROUP, "group", number)
    if "name" not in group:
        raise FormatError(
            f"[[group]] number {number + 1} has no name",
            entry.path,
            entry.line("name", "group", number),
        )
    name = entry.text(group, "name", "group", number)
    files = {
        what: read_entries(entry.file(group, what, "group", number))
        for what in MATRICES
        if what in group
    }
    if "elset" in group:
        elset = entry.text(group, "elset", "group", number)
        files = _of_set(files, elset, facts, entry, number)
    elif any(f.elements is not None for f in files.values()):
        raise FormatError(
            f"group {name!r}: its files are written element by element; say of which elements it"
            " is: elset = '...', with deck = '...' above",
            entry.path,
            entry.line("name", "group", number),
        )
    return Part(name, files, group.get("loss_factor"))


def _of_set(
    files: Mapping[str, Entries], elset: str, facts: DeckFacts | None, entry: Entry, number: int
) -> dict[str, Entries]:
    line = entry.line("elset", "group", number)
    if facts is None:
        raise FormatError("elset needs deck = '...', which says its elements", entry.path, line)
    sets = facts.element_sets()
    if elset.upper() not in sets:
        raise FormatError(
            f"the deck has no element set {elset!r}; {suggest(elset.upper(), sets)}",
            entry.path,
            line,
        )
    whole = next((f for f in files.values() if f.elements is None), None)
    if whole is not None:
        raise FormatError(
            f"{whole.path.name} is not written element by element; leave elset out",
            entry.path,
            line,
        )
    out = {what: f.of(np.asarray(sets[elset.upper()])) for what, f in files.items()}
    if empty := next((f for f in out.values() if not f.values.size), None):
        raise FormatError(f"{empty.path.name} has no element of set {elset!r}", entry.path, line)
    return out
