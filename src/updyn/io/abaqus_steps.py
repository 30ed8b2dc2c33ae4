"""Which matrix files belong to which group: by the steps that wrote them, or by the cards that read them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from updyn.errors import FormatError, suggest
from updyn.io.abaqus_deck import DeckFacts
from updyn.io.abaqus_matrix import Entries, Labels, entries_of, read_entries
from updyn.io.abaqus_parts import MATRICES, Part
from updyn.io.keyword_cards import Card, Row, number

__all__ = ["assembled_parts", "generated_parts"]

_PARAMETERS = {
    "stiffness": "STIFFNESS",
    "mass": "MASS",
    "viscous": "VISCOUS DAMPING",
    "structural": "STRUCTURAL DAMPING",
}
#: What a deck that is put together of matrices may hold.
_USAGE = ("HEADING", "PREPRINT", "NODE", "NSET", "MATRIX INPUT", "MATRIX ASSEMBLE", "BOUNDARY")
#: Abaqus writes 15 digits.
_TOLERANCE = 1e-10


# -- *MATRIX GENERATE --------------------------------------------------------------------------------------
def generated_parts(facts: DeckFacts, job: str) -> list[Part]:
    """Return the groups whose matrices the steps of a deck wrote.

    Parameters
    ----------
    facts : DeckFacts
        The deck.
    job : str
        Name of the job; the files stand beside the deck.

    Returns
    -------
    list of Part

    Raises
    ------
    FormatError
        If no step writes matrices, a file is missing, or the groups do not add up to the whole.
    """
    whole: dict[str, Entries] = {}
    parts: list[Part] = []
    for at, step in enumerate(facts.steps, 1):
        card = next((c for c in step if c.name == "MATRIX GENERATE"), None)
        if card is None:
            continue
        files = _written(facts, card, job, at)
        if "ELEMENT BY ELEMENT" in card.parameters:
            parts += _by_material(facts, card, files)
        elif elset := card.get("ELSET"):
            # A set of an instance is called "instance.set"; groups have no dots.
            parts.append(Part(elset.rpartition(".")[2], files))
        else:
            whole = files
    if not parts and not whole:
        raise FormatError(
            "no step of the deck writes matrices. Abaqus has to: add *STEP, *MATRIX GENERATE,"
            " STIFFNESS, MASS, ELSET=... and *MATRIX OUTPUT, STIFFNESS, MASS for each set that is"
            " to be a group, run the job and read the deck again",
            facts.path,
        )
    if not parts:
        return [Part(job, whole)]
    for what, total in whole.items():
        _check_sum(what, total, [p.files[what] for p in parts if what in p.files])
    return parts


def _written(facts: DeckFacts, card: Card, job: str, step: int) -> dict[str, Entries]:
    files = {}
    for what, letters in MATRICES.items():
        if _PARAMETERS[what] in card.parameters:
            file = facts.path.parent / f"{job}_{letters}{step}.mtx"
            if not file.is_file():
                near = suggest(file.name, sorted(p.name for p in file.parent.glob("*.mtx")))
                raise card.error(
                    f"*MATRIX GENERATE, {_PARAMETERS[what]} of step {step}: no file {file.name!r};"
                    f" {near}"
                )
            files[what] = read_entries(file)
            by_element = "ELEMENT BY ELEMENT" in card.parameters
            if by_element != (files[what].elements is not None):
                said, found = ("by element", "whole") if by_element else ("whole", "by element")
                raise FormatError(
                    f"the matrix is {found}, the deck says {said} (line {card.line})", file
                )
    if not files:
        raise card.error("*MATRIX GENERATE says neither STIFFNESS nor MASS")
    return files


def _by_material(facts: DeckFacts, card: Card, files: Mapping[str, Entries]) -> list[Part]:
    if not facts.flat:
        raise card.error(
            "ELEMENT BY ELEMENT in a deck with parts: Abaqus numbers its elements anew; write it"
            " flat"
        )
    sets = facts.element_sets()
    members: dict[str, list[NDArray[np.int64]]] = {}
    for elset, material in facts.sections.items():
        if elset in sets:
            members.setdefault(material, []).append(sets[elset])
    parts, seen = [], np.empty(0, dtype=np.int64)
    for material, found in members.items():
        own = np.unique(np.concatenate(found))
        chosen = {
            what: f.of(own)
            for what, f in files.items()
            if f.elements is not None and np.isin(f.elements, own).any()
        }
        seen = np.union1d(seen, own)
        if chosen:
            parts.append(Part(facts.properties[material].name, chosen))
    for file in files.values():
        assert file.elements is not None
        lost = np.setdiff1d(file.elements, seen)
        if lost.size:
            raise FormatError(
                f"element {lost[0]} is of no section of the deck ({lost.size} such)", file.path
            )
    return parts


def _check_sum(what: str, total: Entries, files: list[Entries]) -> None:
    """Compare the groups with the whole."""
    if not total.labelled or not all(f.labelled for f in files):
        raise FormatError(
            "the rows say no nodes (FORMAT=COORDINATE); write them with FORMAT=MATRIX INPUT",
            total.path,
        )
    labels = Labels.union([total, *files])
    left = labels.matrix(total)
    free = np.flatnonzero(left.diagonal() < 1e35)
    scale = abs(left[free][:, free])
    for file in files:
        left = left - labels.matrix(file)
    rest = left[free][:, free].tocoo()
    largest = scale.max(axis=1).toarray().ravel()
    beyond = np.abs(rest.data) - _TOLERANCE * np.maximum(largest[rest.row], largest[rest.col])
    if beyond.size and beyond.max() > 0:
        at = int(np.argmax(beyond))
        dofs = labels.dofs
        raise FormatError(
            f"the element sets do not add up to the {what} of the whole: at"
            f" {dofs[int(free[rest.row[at]])]}, {dofs[int(free[rest.col[at]])]} {rest.data[at]:.3g}"
            " is left; a part belongs to no set, or to two",
            total.path,
        )


# -- *MATRIX INPUT and *MATRIX ASSEMBLE --------------------------------------------------------------------
def assembled_parts(facts: DeckFacts) -> list[Part]:
    """Return the groups that a deck puts together of matrices; each ``*MATRIX ASSEMBLE`` is one.

    Raises
    ------
    FormatError
        If a matrix is not there, or is not symmetric or not text, or the deck holds more than
        matrices.
    """
    for card in facts.cards:
        if card.name not in _USAGE:
            raise card.error(
                f"*{card.name} beside *MATRIX ASSEMBLE is not read; only"
                f" {', '.join('*' + name for name in _USAGE)}: have Abaqus write all of the model"
                " with *MATRIX GENERATE"
            )
    known = {card.need("NAME").upper(): card for card in facts.cards if card.name == "MATRIX INPUT"}
    parts = []
    for card in facts.assemblies:
        card.only(*_PARAMETERS.values())
        files = {}
        for what, parameter in _PARAMETERS.items():
            if name := card.get(parameter):
                if name.upper() not in known:
                    raise card.error(
                        f"*MATRIX ASSEMBLE: no matrix {name!r}; {suggest(name.upper(), known)}"
                    )
                files[what] = _input(known[name.upper()], facts.path.parent)
        if not files:
            raise card.error("*MATRIX ASSEMBLE names no matrix")
        parts.append(Part(_group_name(card), files))
    return parts


def _group_name(card: Card) -> str:
    """Return the name of the assembly's stiffness (else of its other matrices), without the K or M at its end."""
    name = next(n for p in _PARAMETERS.values() if (n := card.get(p)))
    for ending in ("_STIF", "_MASS", "_DMPV", "_DMPS"):
        if name.upper().endswith(ending) and len(name) > len(ending):
            return name[: -len(ending)]
    return name


def _input(card: Card, folder: Path) -> Entries:
    card.only("NAME", "INPUT", "SCALE FACTOR", "TYPE", "MATRIX")
    if (card.get("TYPE") or "SYMMETRIC").upper() != "SYMMETRIC":
        raise card.error("*MATRIX INPUT, TYPE=UNSYMMETRIC: matrices are symmetric here")
    given = card.get("INPUT")
    if "MATRIX" in card.parameters or (given or "").lower().endswith(".sim"):
        raise card.error(
            "*MATRIX INPUT of a .sim file, which only Abaqus reads; write text with *MATRIX OUTPUT"
        )
    if given is None:
        if not card.rows:
            raise card.error(
                f"*MATRIX INPUT, NAME={card.get('NAME')} has neither INPUT= nor data lines"
            )
        entries = entries_of("\n".join(row.text for row in card.rows), card.path, card.rows[0].line)
    else:
        file = folder / given
        if not file.is_file():
            near = (
                sorted(p.name for p in file.parent.iterdir() if p.is_file())
                if file.parent.is_dir()
                else []
            )
            raise card.error(f"*MATRIX INPUT: no such file {given!r}; {suggest(file.name, near)}")
        entries = read_entries(file)
    scale = card.get("SCALE FACTOR")
    if scale is None:
        return entries
    factor = number(scale, card, Row(card.line, scale))
    return Entries(entries.path, entries.labels, entries.values * factor, entries.elements)
