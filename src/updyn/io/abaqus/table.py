"""Models of a TOML file (`updyn.io.model_table`) whose groups refer to matrix files of Abaqus.

Its additional keys are ``unit``, ``deck`` and ``internal``, and ``structural`` and ``elset`` of a
group. ``dofs`` lists the rows of files written with FORMAT=COORDINATE, which have no labels.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from updyn.errors import FormatError, suggest
from updyn.io.abaqus.deck import DeckFacts, read_facts
from updyn.io.abaqus.matrices import (
    MATRICES,
    AbaqusEntries,
    AbaqusGroup,
    assemble,
    is_abaqus,
    read_entries,
)
from updyn.io.consistent_units import find_units
from updyn.io.items import is_file
from updyn.io.keyword_deck.cards import read_cards
from updyn.io.model_table import GENERAL, ModelFile
from updyn.model import Model

__all__ = ["names_abaqus_files", "read_table"]

_TOP = (*GENERAL, "unit", "deck", "internal")
_GROUP = ("name", *MATRICES, "loss_factor", "elset")


def names_abaqus_files(table: ModelFile) -> bool:
    """Return whether the first existing matrix file of a group is an Abaqus file."""
    for group in table.content["group"]:
        for what in MATRICES:
            given = group.get(what)
            if not isinstance(given, str):
                continue
            file = table.path.parent / given
            if is_file(file):
                return is_abaqus(file)
    return False


def read_table(table: ModelFile) -> Model:
    """Build the model of a TOML file whose groups refer to matrix files of Abaqus."""
    content = table.content
    dofs, geometry = table.dofs(), table.geometry()
    table.check_keys(content, _TOP)
    units = find_units(table.optional("unit", "m"))
    facts = None
    if "deck" in content:
        deck = table.file(content, "deck")
        facts = read_facts(deck, read_cards(deck))
        geometry = facts.read_geometry(units) if geometry is None else geometry
    parts = [_part(table, group, number, facts) for number, group in enumerate(content["group"])]
    return assemble(
        parts,
        units,
        table.path,
        dofs=dofs,
        geometry=geometry,
        title=table.title,
        internal=table.optional("internal", "keep"),
    )


def _part(
    table: ModelFile, group: Mapping[str, Any], number: int, facts: DeckFacts | None
) -> AbaqusGroup:
    table.check_keys(group, _GROUP, "group", number)
    name = table.group_name(group, number)
    files = {}
    for what in MATRICES:
        if what in group:
            files[what] = read_entries(table.file(group, what, "group", number))
    if "elset" in group:
        elset = table.text(group, "elset", "group", number)
        files = _of_set(files, elset, facts, table, number)
    elif any(f.elements is not None for f in files.values()):
        raise FormatError(
            f"group {name!r}: its files are written element by element; select its elements:"
            " elset = '...', with deck = '...' above",
            table.path,
            table.line("name", "group", number),
        )
    return AbaqusGroup(name, files, group.get("loss_factor"))


def _of_set(
    files: Mapping[str, AbaqusEntries],
    elset: str,
    facts: DeckFacts | None,
    table: ModelFile,
    number: int,
) -> dict[str, AbaqusEntries]:
    line = table.line("elset", "group", number)
    if facts is None:
        raise FormatError("elset needs deck = '...', which defines it", table.path, line)
    sets = facts.element_sets()
    if elset.upper() not in sets:
        raise FormatError(
            f"the deck has no element set {elset!r}; {suggest(elset.upper(), sets)}",
            table.path,
            line,
        )
    out = {}
    for what, file in files.items():
        if file.elements is None:
            raise FormatError(
                f"{file.path.name} is not written element by element; remove elset",
                table.path,
                line,
            )
        out[what] = file.of(sets[elset.upper()])
        if not out[what].values.size:
            raise FormatError(f"{file.path.name} has no element of set {elset!r}", table.path, line)
    return out
