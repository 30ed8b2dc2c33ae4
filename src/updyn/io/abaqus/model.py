"""Models from matrix files of Abaqus (``.mtx``), found by a deck or by names, and Abaqus decks.

A deck lists the files: by steps with ``*MATRIX GENERATE``, whose files are named by job and step
(``job_STIF1.mtx``), or by ``*MATRIX INPUT``. With ``ELSET=`` the set is a group, with ``ELEMENT BY
ELEMENT`` each material; groups must add up to an additional step of the whole. Abaqus is not run.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from updyn.arrays import IntArray
from updyn.dofs import DofSet
from updyn.errors import FormatError, UpdynWarning, suggest
from updyn.geometry import Geometry
from updyn.group import VALUES
from updyn.grouping import label_groups
from updyn.io.abaqus.deck import DeckFacts, read_facts
from updyn.io.abaqus.matrices import (
    FIXED_DIAGONAL,
    MATRICES,
    NAME,
    AbaqusEntries,
    AbaqusGroup,
    Labels,
    assemble,
    parse_entries,
    read_entries,
)
from updyn.io.atomic import atomic_path
from updyn.io.consistent_units import UnitSystem, find_units
from updyn.io.damping import refuse_damping
from updyn.io.items import is_file, suggest_file
from updyn.io.keyword_deck.cards import (
    KeywordCard,
    KeywordRow,
    format_number,
    parse_number_field,
    read_cards,
)
from updyn.io.keyword_deck.changes import write_changes
from updyn.io.keyword_deck.structure import label_sets
from updyn.io.settings import MATRIX_FILE
from updyn.model import Group, Matrix, Model

__all__ = [
    "assembled_parts",
    "generated_parts",
    "read_model",
    "write_model",
    "write_properties",
]


def read_model(
    path: str | Path, *, unit: str = "m", internal: str = "keep", job: str | None = None
) -> Model:
    """Read a model in SI from a deck, or a matrix file ``job_STIF1.mtx``, without its fixed DOFs.

    `internal` "keep" changes an internal node -n to node (largest of the others) + n, and is exact.
    "condense" removes it, which requires that it has neither mass nor damping and belongs to one
    group.
    """
    path = Path(path)
    units = find_units(unit)
    if path.suffix.lower() != ".mtx":
        facts = read_facts(path, read_cards(path))
        if facts.assemblies:
            parts = assembled_parts(facts)
            held: IntArray | None = facts.supports()
        else:
            parts = generated_parts(facts, job or path.stem)
            held = None  # matrices written by a step contain its supports
        drawn = facts.read_geometry(units)
        return assemble(
            parts, units, path, geometry=drawn, title=facts.title, internal=internal, held=held
        )
    found = NAME.fullmatch(path.stem)
    if found is None:
        raise FormatError(
            "its name is not that of an Abaqus matrix (job_STIF1.mtx); list the files in a small"
            f' TOML file: [[group]] with name = "...", stiffness = "{path.name}", mass = "..."',
            path,
        )
    name, step = found[1], found[3]
    entries = {}
    for what, letters in MATRICES.items():
        file = path.parent / f"{name}_{letters}{step}.mtx"
        if is_file(file):
            entries[what] = read_entries(file)
        elif what in ("stiffness", "mass"):
            raise FormatError(
                f"no {file.name} in the same folder; *MATRIX GENERATE, STIFFNESS, MASS writes both",
                path,
            )
    geometry = _geometry_of_deck(path.parent / f"{name}.inp", units)
    return assemble([AbaqusGroup(name, entries)], units, path, geometry=geometry, internal=internal)


def _geometry_of_deck(deck: Path, units: UnitSystem) -> Geometry | None:
    if not is_file(deck):
        return None
    return read_facts(deck, read_cards(deck)).read_geometry(units)


def write_properties(
    changes: Mapping[str, Mapping[str, float]], deck: str | Path, path: str | Path
) -> None:
    """Write the changed materials to a file for ``*INCLUDE`` that replaces their cards."""
    deck = Path(deck)
    facts: DeckFacts = read_facts(deck, read_cards(deck))
    write_changes(facts.by_material(changes), facts.properties, deck, Path(path), own_rayleigh=True)


_PARAMETERS = {
    "stiffness": "STIFFNESS",
    "mass": "MASS",
    "viscous": "VISCOUS DAMPING",
    "structural": "STRUCTURAL DAMPING",
}
#: Cards allowed in a deck that consists of matrices.
_USAGE = ("HEADING", "PREPRINT", "NODE", "NSET", "MATRIX INPUT", "MATRIX ASSEMBLE", "BOUNDARY")


# -- *MATRIX GENERATE ---------------------------------------------------------------------------
def generated_parts(facts: DeckFacts, job: str) -> list[AbaqusGroup]:
    """Return the groups whose matrices the steps of a deck wrote to its folder, named by job."""
    whole: dict[str, AbaqusEntries] = {}
    parts: list[AbaqusGroup] = []
    for at, step in enumerate(facts.steps, 1):
        cards = [card for card in step if card.name == "MATRIX GENERATE"]
        if not cards:
            continue
        card = cards[0]
        files = _read_step(facts, card, job, at)
        elset = card.get("ELSET")
        if "ELEMENT BY ELEMENT" in card.parameters:
            parts += _split_by_material(facts, card, files)
        elif elset:
            # A set of an instance is named "instance.set"; group names have no dots.
            parts.append(AbaqusGroup(elset.rpartition(".")[2], files))
        else:
            whole = files
    if not parts and not whole:
        raise FormatError(
            "no step of the deck writes matrices: add *STEP, *MATRIX GENERATE, STIFFNESS, MASS,"
            " ELSET=... and *MATRIX OUTPUT, STIFFNESS, MASS for each set that forms a group, run"
            " the job with Abaqus and read the deck again",
            facts.path,
        )
    if not parts:
        return [AbaqusGroup(job, whole)]
    for what, total in whole.items():
        _check_sum(what, total, [part.files[what] for part in parts if what in part.files])
    return parts


def _read_step(
    facts: DeckFacts, card: KeywordCard, job: str, step: int
) -> dict[str, AbaqusEntries]:
    by_element = "ELEMENT BY ELEMENT" in card.parameters
    files = {}
    for what, parameter in _PARAMETERS.items():
        if parameter not in card.parameters:
            continue
        file = facts.path.parent / f"{job}_{MATRICES[what]}{step}.mtx"
        if not is_file(file):
            near = suggest(file.name, sorted(p.name for p in file.parent.glob("*.mtx")))
            raise card.error(
                f"*MATRIX GENERATE, {parameter} of step {step}: no file {file.name!r}; {near}"
            )
        files[what] = read_entries(file)
        if by_element and files[what].elements is None:
            raise FormatError(
                f"the matrix is not written by element, as the deck states (line {card.line})",
                file,
            )
        if not by_element and files[what].elements is not None:
            raise FormatError(
                f"the matrix is written by element, unlike the deck states (line {card.line})",
                file,
            )
    if not files:
        raise card.error("*MATRIX GENERATE has neither STIFFNESS nor MASS")
    return files


def _split_by_material(
    facts: DeckFacts, card: KeywordCard, files: Mapping[str, AbaqusEntries]
) -> list[AbaqusGroup]:
    if not facts.is_flat:
        raise card.error(
            "ELEMENT BY ELEMENT in a deck with parts, whose elements Abaqus renumbers; write a"
            " flat deck"
        )
    sets = facts.element_sets()
    members: dict[str, list[IntArray]] = {}
    for elset, material in facts.sections.items():
        if elset in sets:
            members.setdefault(material, []).append(sets[elset])
    elements_of = {name: np.unique(np.concatenate(found)) for name, found in members.items()}
    origins = label_groups(
        {name: elements.tolist() for name, elements in elements_of.items()}, label_sets(sets)
    )
    parts = []
    assigned = np.empty(0, dtype=np.int64)
    for material, elements in elements_of.items():
        chosen = {}
        for what, file in files.items():
            of_material = file.of(elements)
            if of_material.values.size:
                chosen[what] = of_material
        assigned = np.union1d(assigned, elements)
        if chosen:
            name = facts.properties[material].name
            parts.append(AbaqusGroup(name, chosen, origin=origins[material]))
    for file in files.values():
        assert file.elements is not None
        lost = np.setdiff1d(file.elements, assigned)
        if lost.size:
            raise FormatError(
                f"element {lost[0]} has no section in the deck ({lost.size} such)", file.path
            )
    return parts


def _check_sum(what: str, total: AbaqusEntries, files: list[AbaqusEntries]) -> None:
    """Refuse groups that do not add up to the whole."""
    if not total.has_labels or not all(f.has_labels for f in files):
        raise FormatError(
            "the rows have no node labels (FORMAT=COORDINATE); write them with FORMAT=MATRIX INPUT",
            total.path,
        )
    labels = Labels.union([total, *files])
    remainder = labels.matrix(total)
    free = np.flatnonzero(remainder.diagonal() < FIXED_DIAGONAL)
    scale = abs(remainder[free][:, free])
    for file in files:
        remainder = remainder - labels.matrix(file)
    rest = remainder[free][:, free].tocoo()
    largest = scale.max(axis=1).toarray().ravel()
    level = np.maximum(largest[rest.row], largest[rest.col])
    beyond = np.abs(rest.data) - MATRIX_FILE.sum_tolerance * level
    if beyond.size and beyond.max() > 0:
        at = int(np.argmax(beyond))
        dofs = labels.dofs
        raise FormatError(
            f"the element sets do not add up to the {what} of the whole: at"
            f" {dofs[int(free[rest.row[at]])]}, {dofs[int(free[rest.col[at]])]} the difference is"
            f" {rest.data[at]:.3g}; a part belongs to no set, or to two",
            total.path,
        )


# -- *MATRIX INPUT and *MATRIX ASSEMBLE ---------------------------------------------------------
def assembled_parts(facts: DeckFacts) -> list[AbaqusGroup]:
    """Return the groups of a deck of matrices; each ``*MATRIX ASSEMBLE`` is a group."""
    for card in facts.cards:
        if card.name not in _USAGE:
            raise card.error(
                f"*{card.name} together with *MATRIX ASSEMBLE is not supported; expected only"
                f" {', '.join('*' + name for name in _USAGE)}: let Abaqus write the whole model"
                " with *MATRIX GENERATE"
            )
    known = {
        card.require("NAME").upper(): card for card in facts.cards if card.name == "MATRIX INPUT"
    }
    parts = []
    for card in facts.assemblies:
        card.check_parameters(*_PARAMETERS.values())
        files = {}
        for what, parameter in _PARAMETERS.items():
            name = card.get(parameter)
            if not name:
                continue
            if name.upper() not in known:
                raise card.error(
                    f"*MATRIX ASSEMBLE: no matrix {name!r}; {suggest(name.upper(), known)}"
                )
            files[what] = _read_matrix_input(known[name.upper()], facts.path.parent)
        if not files:
            raise card.error("*MATRIX ASSEMBLE refers to no matrix")
        parts.append(AbaqusGroup(_group_name(card), files))
    return parts


def _group_name(card: KeywordCard) -> str:
    """Return the name of the first matrix of the assembly, without its suffix."""
    named = [card.parameters[p] for p in _PARAMETERS.values() if card.get(p)]
    name = named[0]
    for ending in ("_STIF", "_MASS", "_DMPV", "_DMPS"):
        if name.upper().endswith(ending) and len(name) > len(ending):
            return name[: -len(ending)]
    return name


def _read_matrix_input(card: KeywordCard, folder: Path) -> AbaqusEntries:
    card.check_parameters("NAME", "INPUT", "SCALE FACTOR", "TYPE", "MATRIX")
    if (card.get("TYPE") or "SYMMETRIC").upper() != "SYMMETRIC":
        raise card.error("*MATRIX INPUT, TYPE=UNSYMMETRIC: expected a symmetric matrix")
    given = card.get("INPUT")
    if "MATRIX" in card.parameters or (given or "").lower().endswith(".sim"):
        raise card.error(
            "*MATRIX INPUT of a .sim file, which only Abaqus can read; write text with *MATRIX"
            " OUTPUT"
        )
    if given is None:
        if not card.rows:
            raise card.error(
                f"*MATRIX INPUT, NAME={card.get('NAME')} has neither INPUT= nor data lines"
            )
        raw = "".join(f"{row.text}\n" for row in card.rows).encode("ascii", "backslashreplace")
        entries = parse_entries(raw, card.path, card.rows[0].line)
    else:
        file = folder / given
        if not is_file(file):
            raise card.error(f"*MATRIX INPUT: no such file {given!r}; {suggest_file(file)}")
        entries = read_entries(file)
    scale = card.get("SCALE FACTOR")
    if scale is None:
        return entries
    factor = parse_number_field(scale, card, KeywordRow(card.line, scale))
    return AbaqusEntries(entries.path, entries.labels, entries.values * factor, entries.elements)


_LARGEST = 10**9 - 1  # node number of Abaqus


def write_model(model: Model, path: str | Path) -> None:
    """Write a model as a deck with matrix files, in SI units.

    Rayleigh damping of a group is added to its viscous matrix. Abaqus reads numbers of up to twenty
    characters, so entries keep at least 13 digits. The deck is written last.
    """
    path = Path(path)
    _check(model, path)
    refuse_damping(model, path, *VALUES)
    folded = []
    for name, group in model.groups.items():
        if group.mass_damping or group.stiffness_damping:
            folded.append(name)
    if folded:
        warnings.warn(
            f"{path}: Rayleigh damping of {', '.join(map(repr, folded[:6]))} is written as viscous"
            " matrices, which no longer depend on mass and stiffness",
            UpdynWarning,
            stacklevel=3,
        )
    lines = ["*HEADING", _one_line(model.title) or "written by updyn"]
    lines += ["** SI units: m, N, kg, s.", *_nodes(model.geometry, path)]
    assemblies = []
    for position, (name, group) in enumerate(model.groups.items(), 1):
        named = []
        for what, matrix in _matrices(group).items():
            if matrix is None:
                continue
            file = f"{path.stem}_{position}_{MATRICES[what]}.mtx"
            with atomic_path(path.parent / file) as temporary:
                _write_matrix(matrix, model.dofs, temporary)
            label = f'"{name}_{MATRICES[what]}"'
            lines.append(f"*MATRIX INPUT, NAME={label}, INPUT={file}")
            named.append(f"{_PARAMETERS[what]}={label}")
        assemblies.append(f"*MATRIX ASSEMBLE, {', '.join(named)}")
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join([*lines, *assemblies]) + "\n", encoding="utf-8")


def _check(model: Model, path: Path) -> None:
    nodes = model.dofs.nodes
    if nodes.min() < 1 or nodes.max() > _LARGEST:
        bad = nodes[(nodes < 1) | (nodes > _LARGEST)][0]
        raise FormatError(f"node {bad}; expected node numbers from 1 to {_LARGEST}", path)
    seen: dict[str, str] = {}
    for name in model.groups:
        if re.search(r'[",=]', name):
            raise FormatError(
                f"group {name!r}: names in a deck cannot contain quotes, commas and equals signs",
                path,
            )
        other = seen.setdefault(name.upper(), name)
        if other != name:
            raise FormatError(
                f"groups {other!r} and {name!r} have the same name in a deck, which ignores case",
                path,
            )


def _one_line(text: str) -> str:
    return " ".join(text.split()).lstrip("*")


def _nodes(geometry: Geometry | None, path: Path) -> list[str]:
    if geometry is None:
        return []
    if geometry.axes is not None:
        warnings.warn(
            f"{path}: a deck cannot hold directions of nodes; written without",
            UpdynWarning,
            stacklevel=4,
        )
    lines = []
    for node, xyz in zip(geometry.nodes.tolist(), geometry.xyz.tolist(), strict=True):
        if 0 < node <= _LARGEST:
            lines.append(f"{node}, {', '.join(map(format_number, xyz))}")
    return ["*NODE", *lines] if lines else []


def _matrices(group: Group) -> dict[str, Matrix | None]:
    damped = None
    if group.stiffness is not None and group.loss_factor:
        damped = group.stiffness * group.loss_factor
    return {
        "stiffness": group.stiffness,
        "mass": group.mass,
        "viscous": group.viscous_part(),
        "structural": damped,
    }


def _write_matrix(matrix: Matrix, dofs: DofSet, path: Path) -> None:
    """Write the lower triangle: node, dof, node, dof, entry."""
    entry: Any = sp.coo_array(sp.tril(matrix))
    labels = []
    for node, axis in zip(dofs.nodes.tolist(), dofs.axes.tolist(), strict=True):
        labels.append(f"{node},{axis + 1}")
    rows = zip(entry.row.tolist(), entry.col.tolist(), entry.data.tolist(), strict=True)
    with path.open("w", encoding="ascii") as file:
        for i, j, value in rows:
            file.write(f"{labels[i]}, {labels[j]}, {format_number(value)}\n")
