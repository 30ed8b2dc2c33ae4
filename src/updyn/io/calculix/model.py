"""Decks of CalculiX: models, with materials as groups by difference, and updated properties.

``ccx`` keeps the rotations of a rigid body as translations of an additional node; the model has
them as rotations of its reference node.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from updyn.dofs import DofSet
from updyn.errors import FormatError, UpdynWarning, suggest
from updyn.geometry import Geometry
from updyn.io.abaqus import model as abaqus
from updyn.io.calculix.program import (
    ABAQUS,
    CalculixMatrices,
    check_model,
    find_program,
    storage_deck,
)
from updyn.io.consistent_units import check_materials, find_units
from updyn.io.differences import groups_by_difference
from updyn.io.items import locate_errors
from updyn.io.keyword_deck.cards import (
    KeywordCard,
    KeywordRow,
    parse_integer_field,
    parse_number_field,
    read_cards,
)
from updyn.io.keyword_deck.changes import write_changes
from updyn.io.keyword_deck.structure import (
    KeywordDeck,
    KeywordProperty,
    nodes_by_shape,
    read_deck,
    read_heading,
    read_properties,
)
from updyn.model import Group, Matrix, Model
from updyn.shapes import unique_edges, unique_faces

__all__ = [
    "Rotations",
    "read_model",
    "read_parts",
    "read_rayleigh",
    "read_rotations",
    "write_properties",
]


def read_model(
    path: str | Path,
    *,
    unit: str = "m",
    ccx: str = "ccx",
    timeout: float = 600.0,
) -> Model:
    """Read a deck of solids in SI by running ``ccx`` on it, once and once more for each material.

    DOFs are those of the nodes that are neither fixed nor tied, and rotations of the reference
    nodes of rigid bodies. A deck with ``*MATRIX INPUT``, ``*MATRIX GENERATE`` or parts is read by
    `updyn.io.abaqus.model`.
    """
    path = Path(path)
    cards = read_cards(path)
    if any(card.name in ABAQUS for card in cards):
        return abaqus.read_model(path, unit=unit)
    units = find_units(unit)
    model, step, deck, parts = read_parts(path, cards)
    alpha, beta = read_rayleigh(model)
    rotations = read_rotations(model, path)
    program = find_program(ccx, timeout, path)
    materials = [p for p in parts.values() if p.kind == "material"]
    moduli = [(p.name, p.first("stiffness"), p.first("mass")) for p in materials]
    check_materials(moduli, units, path)

    def run(changed: KeywordProperty | None = None) -> CalculixMatrices:
        return program.run_deck([*_lines(model, changed), *step], remarks=changed is None)

    total = run()
    dofs = rotations.move_rotations(total.dofs, deck)

    def double_part(name: str) -> tuple[Matrix, Matrix]:
        one = run(parts[name])
        if one.dofs != total.dofs:
            raise FormatError(
                f"group {name!r}: the degrees of freedom change with its stiffness", path
            )
        return one.stiffness, one.mass

    sums = total.stiffness, total.mass
    split = groups_by_difference(parts, sums, double_part, dofs, path)
    groups = {}
    for key, (K, M) in split.items():
        name = parts[key].name
        if K is None and M is None:
            _warn(path, f"{name!r} has neither stiffness nor mass at the free DOFs: removed")
            continue
        gamma = 0.0
        viscous = []
        if M is not None:
            M = units.to_si(M, dofs)
            if alpha:
                viscous.append(alpha * M)
        if K is not None:
            K = units.to_si(K, dofs)
            gamma = parts[key].damping_parameter("STRUCTURAL")
            if beta:
                viscous.append(beta * K)
        C = sum(viscous) if viscous else None
        with locate_errors(path, f"group {name!r}"):
            groups[name] = Group(K, M, loss_factor=gamma, viscous=C)
    for name, origin in deck.origins(groups).items():
        groups[name] = groups[name].with_origin(origin)
    heading = read_heading(model)
    with locate_errors(path):
        solids = nodes_by_shape(deck)
        geometry = Geometry(
            deck.nodes, deck.xyz * units.length, unique_edges(solids), faces=unique_faces(solids)
        )
        return Model.from_groups(groups, dofs, geometry=geometry, title=heading)


def read_parts(
    path: Path, cards: Sequence[KeywordCard]
) -> tuple[list[KeywordCard], list[str], KeywordDeck, dict[str, KeywordProperty]]:
    """Return model cards, lines of the storing step, structure, and groups by upper-case name."""
    model, step = storage_deck(cards)
    check_model(model)
    deck = read_deck(path, model)
    model = list(deck.cards)
    types = {}
    for block in deck.elements:
        elset = block.card.get("ELSET")
        if elset:
            types[elset.upper()] = block.type
    found = read_properties(model, types, own_rayleigh=False)
    for part in found.values():
        bad = sorted(set(part.name) & set(".*?[]"))
        if bad:
            raise part.cards[0].error(
                f"{part.kind} {part.name!r} contains {bad[0]!r}, which is reserved in names of"
                " unknowns (name.quantity, selected by glob); rename it in the deck"
            )
    materials = [name for name, p in found.items() if p.kind == "material"]
    for section in deck.sections:
        if section.material not in materials:
            raise section.card.error(
                f"*SOLID SECTION: no material {section.card.get('MATERIAL')!r};"
                f" {suggest(section.material, materials)}"
            )
    parts = {}
    for name, part in found.items():
        if part.kind == "material":
            if not len(deck.elements_of(name)):
                _warn(path, f"no element is made of material {part.name!r}: removed")
                continue
            if part.card("ELASTIC") is None:
                raise part.cards[0].error(f"material {part.name!r} has no *ELASTIC")
            if part.card("DENSITY") is None:
                _warn(path, f"material {part.name!r} has no *DENSITY: its group has no mass")
        parts[name] = part
    return model, step, deck, parts


def _lines(model: Sequence[KeywordCard], changed: KeywordProperty | None) -> list[str]:
    """Return the lines of a deck, with doubled stiffness and density of a part."""
    cards = list(model)
    if changed is not None:
        cards[changed.at : changed.at + len(changed.cards)] = changed.scale_cards(2.0, 2.0)
    lines = []
    for card in cards:
        lines += card.text()
    return lines


def read_rayleigh(model: Sequence[KeywordCard]) -> tuple[float, float]:
    """Return ALPHA (1/s) and BETA (s) of the deck; ccx applies them to the whole deck."""
    found = [c for c in model if c.name == "DAMPING" and {"ALPHA", "BETA"} & set(c.parameters)]
    if len(found) > 1:
        raise found[1].error(
            f"*DAMPING with ALPHA and BETA occurs twice, also on line {found[0].line}"
        )
    if not found:
        return 0.0, 0.0
    card = found[0]
    row = KeywordRow(card.line, "")
    alpha = parse_number_field(card.get("ALPHA") or "0.", card, row)
    beta = parse_number_field(card.get("BETA") or "0.", card, row)
    return alpha, beta


def _warn(path: Path, message: str) -> None:
    warnings.warn(f"{path}: {message}", UpdynWarning, stacklevel=3)


@dataclass(frozen=True, slots=True)
class Rotations:
    """The nodes whose translations are the rotations of rigid bodies.

    `named` has ROT NODE and REF NODE of each rigid body that specifies both, `unnamed` the REF NODE
    of the others: ``ccx`` adds a node after the largest one for each, in the order of the deck.
    """

    named: tuple[tuple[int, int], ...]
    unnamed: tuple[int, ...]
    path: Path

    def move_rotations(self, dofs: DofSet, deck: KeywordDeck) -> DofSet:
        """Return the DOFs of ``ccx`` with rotations at the reference nodes, in the same order."""
        added_nodes = np.setdiff1d(dofs.nodes, deck.nodes)
        # C3D8I has three internal generalised displacements, which ccx keeps (with mass) as nodes.
        inner = 0
        for block in deck.elements:
            if block.type == "C3D8I":
                inner += 3 * block.numbers.size
        if len(added_nodes) != inner + len(self.unnamed) or (inner and self.unnamed):
            raise FormatError(
                f"ccx adds {len(added_nodes)} nodes to those of the deck, {inner} of them inside"
                f" C3D8I, but there are {len(self.unnamed)} rigid bodies or couplings without a"
                " node for their rotations: give each *RIGID BODY a ROT NODE",
                self.path,
            )
        bodies = list(self.named)
        if not inner:
            bodies += zip(added_nodes.tolist(), self.unnamed, strict=True)
        nodes = dofs.nodes.copy()
        axes = dofs.axes.astype(np.int64)
        for rotation, reference in bodies:
            at_rotation = dofs.nodes == rotation
            nodes[at_rotation] = reference
            axes[at_rotation] += 3
        return DofSet.from_arrays(nodes, axes)


def read_rotations(model: Sequence[KeywordCard], path: Path) -> Rotations:
    """Return the rotation nodes of rigid bodies and couplings before the first step."""
    named = []
    unnamed = []
    for card in model:
        if card.name in ("RIGID BODY", "COUPLING"):
            row = KeywordRow(card.line, "")
            reference = parse_integer_field(card.require("REF NODE"), card, row)
            rotation = card.get("ROT NODE")
            if rotation:
                named.append((parse_integer_field(rotation, card, row), reference))
            else:
                unnamed.append(reference)
    return Rotations(tuple(named), tuple(unnamed), path)


_FOLLOWS = (
    "ALPHA and BETA apply to the whole deck: viscous damping changes with mass and stiffness."
)


def write_properties(
    changes: Mapping[str, Mapping[str, float]], deck: str | Path, path: str | Path
) -> None:
    """Write the changed materials, springs and masses to a file for ``*INCLUDE``.

    It has to replace their cards in the deck, because CalculiX uses the first of two materials of
    the same name. A deck of Abaqus is handled by `updyn.io.abaqus.model`.
    """
    deck = Path(deck)
    cards = read_cards(deck)
    if any(card.name in ABAQUS for card in cards):
        abaqus.write_properties(changes, deck, path)
        return
    model, _, _, parts = read_parts(deck, cards)
    remarks = [_FOLLOWS] if any(read_rayleigh(model)) else []
    write_changes(changes, parts, deck, Path(path), own_rayleigh=False, remarks=remarks)
