"""Decks of CalculiX: models, with materials as groups by difference, and updated properties.

``ccx`` keeps the rotations of a rigid body as the translations of a node of their own; here they
are rotations of its reference node.
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
from updyn.io.calculix.program import ABAQUS, Matrices, check_model, find_program, storage_deck
from updyn.io.consistent_units import check_materials, system
from updyn.io.differences import groups_by_difference
from updyn.io.items import placed
from updyn.io.keyword_deck.cards import Card, Row, number, read_cards, whole
from updyn.io.keyword_deck.changes import write_changes
from updyn.io.keyword_deck.structure import (
    KeywordDeck,
    Property,
    drawn,
    heading_of,
    read_deck,
    read_properties,
)
from updyn.model import Group, Matrix, Model
from updyn.shapes import edges_of, faces_of

__all__ = [
    "Rotations",
    "read_model",
    "read_parts",
    "read_rayleigh",
    "read_rotations",
    "write_properties",
]

#: ccx prints 14 digits: an entry is off by up to 5e-14 of itself, a difference of two by 1e-13 of
#: the larger.
_TOLERANCE = 1e-10


def read_model(
    path: str | Path,
    *,
    unit: str = "m",
    ccx: str = "ccx",
    timeout: float = 600.0,
) -> Model:
    """Read a deck of solids by running ``ccx`` on it.

    A deck that holds ``*MATRIX INPUT``, ``*MATRIX GENERATE`` or parts is one of Abaqus and is
    handed to `updyn.io.abaqus.model`.

    Parameters
    ----------
    path : path
        The deck, ``.inp``.
    unit : {"m", "mm", "in"}
        The deck's consistent units by their length: m, N, kg; mm, N, t; in, lbf, lbf s2/in. The
        model is in SI.
    ccx : str
        The program: its name or its path.
    timeout : float
        Longest time of one run, in s. There is one run for the deck and one for each material.

    Returns
    -------
    Model
        Groups: the materials, the springs and the point masses, by name; DOFs: those of the nodes
        that are neither held nor tied, and rotations of the reference nodes of rigid bodies;
        geometry: all nodes, with edges and faces of the solids. ``*DAMPING, STRUCTURAL=`` is the
        loss factor of a material, ALPHA and BETA (of the whole deck) the viscous damping of each
        group.

    Raises
    ------
    FormatError
        If a card cannot be read or is of a kind that has no place in the matrices, or ``ccx``
        fails; the message says file and line, or what ``ccx`` said.
    OptionError
        If there is no ``ccx``, with what to install, or no such unit.

    Warns
    -----
    UpdynWarning
        If materials do not look like solids in the unit stated, a material has no density, or no
        element.
    """
    path = Path(path)
    cards = read_cards(path)
    if any(card.name in ABAQUS for card in cards):
        return abaqus.read_model(path, unit=unit)
    units = system(unit)
    model, step, deck, parts = read_parts(path, cards)
    alpha, beta = read_rayleigh(model)
    rotations = read_rotations(model, path)
    program = find_program(ccx, timeout, path)
    materials = [p for p in parts.values() if p.kind == "material"]
    moduli = [(p.name, p.first("stiffness"), p.first("mass")) for p in materials]
    check_materials(moduli, units, path)

    def run(changed: Property | None = None) -> Matrices:
        return program.matrices([*_lines(model, changed), *step], remarks=changed is None)

    total = run()
    dofs = rotations.renamed(total.dofs, deck)

    def doubled(name: str) -> tuple[Matrix, Matrix]:
        one = run(parts[name])
        if one.dofs != total.dofs:
            raise FormatError(
                f"group {name!r}: the degrees of freedom change with its stiffness", path
            )
        return one.stiffness, one.mass

    sums = total.stiffness, total.mass
    split = groups_by_difference(parts, sums, doubled, dofs, path, _TOLERANCE)
    groups = {}
    for key, (K, M) in split.items():
        name = parts[key].name
        if K is None and M is None:
            _warn(path, f"{name!r} has neither stiffness nor mass at the free DOFs: left out")
            continue
        gamma = 0.0
        viscous = []
        if M is not None:
            M = units.to_si(M, dofs)
            if alpha:
                viscous.append(alpha * M)
        if K is not None:
            K = units.to_si(K, dofs)
            gamma = parts[key].damping("STRUCTURAL")
            if beta:
                viscous.append(beta * K)
        C = sum(viscous) if viscous else None
        with placed(path, f"group {name!r}"):
            groups[name] = Group(K, M, loss_factor=gamma, viscous=C)
    heading = heading_of(model)
    with placed(path):
        solids = drawn(deck)
        geometry = Geometry(
            deck.nodes, deck.xyz * units.length, edges_of(solids), faces=faces_of(solids)
        )
        return Model.from_groups(groups, dofs, geometry=geometry, title=heading)


def read_parts(
    path: Path, cards: Sequence[Card]
) -> tuple[list[Card], list[str], KeywordDeck, dict[str, Property]]:
    """Return the cards of the model, the lines of the storing step, the structure and its groups.

    Groups are by name in capitals.

    Raises
    ------
    FormatError
        If a card cannot be read, or a material is not linear or not there.
    """
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
                f"{part.kind} {part.name!r} holds {bad[0]!r}: unknowns are called name.quantity and"
                " chosen by glob; rename it in the deck"
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
                _warn(path, f"no element is made of material {part.name!r}: left out")
                continue
            if part.card("ELASTIC") is None:
                raise part.cards[0].error(f"material {part.name!r} has no *ELASTIC")
            if part.card("DENSITY") is None:
                _warn(path, f"material {part.name!r} has no *DENSITY: its group has no mass")
        parts[name] = part
    return model, step, deck, parts


def _lines(model: Sequence[Card], changed: Property | None) -> list[str]:
    """Return the lines of a deck, with stiffness and density of a part doubled."""
    cards = list(model)
    if changed is not None:
        cards[changed.at : changed.at + len(changed.cards)] = changed.scaled(2.0, 2.0)
    lines = []
    for card in cards:
        lines += card.text()
    return lines


def read_rayleigh(model: Sequence[Card]) -> tuple[float, float]:
    """Return ALPHA (1/s) and BETA (s), which ccx applies to the whole deck wherever they stand.

    Raises
    ------
    FormatError
        If two cards say them, or one is not a number.
    """
    found = [c for c in model if c.name == "DAMPING" and {"ALPHA", "BETA"} & set(c.parameters)]
    if len(found) > 1:
        raise found[1].error(
            f"*DAMPING with ALPHA and BETA stands twice, also on line {found[0].line}"
        )
    if not found:
        return 0.0, 0.0
    card = found[0]
    row = Row(card.line, "")
    alpha = number(card.get("ALPHA") or "0.", card, row)
    beta = number(card.get("BETA") or "0.", card, row)
    return alpha, beta


def _warn(path: Path, message: str) -> None:
    warnings.warn(f"{path}: {message}", UpdynWarning, stacklevel=3)


@dataclass(frozen=True, slots=True)
class Rotations:
    """The nodes that hold the rotations of rigid bodies.

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

    def renamed(self, dofs: DofSet, deck: KeywordDeck) -> DofSet:
        """Return the degrees of freedom with rotations as those of the reference nodes.

        Parameters
        ----------
        dofs : DofSet
            As ``ccx`` names them, all along X, Y and Z.
        deck : KeywordDeck
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
        inner = 0
        for block in deck.elements:
            if block.type == "C3D8I":
                inner += 3 * block.numbers.size
        if len(made) != inner + len(self.unnamed) or (inner and self.unnamed):
            raise FormatError(
                f"ccx makes {len(made)} nodes that the deck does not have, {inner} of them inside"
                f" C3D8I, and there are {len(self.unnamed)} rigid bodies or couplings without a"
                " node for their rotations: give each *RIGID BODY a ROT NODE",
                self.path,
            )
        bodies = list(self.named)
        if not inner:
            bodies += zip(made.tolist(), self.unnamed, strict=True)
        nodes = dofs.nodes.copy()
        axes = dofs.axes.astype(np.int64)
        for rotation, reference in bodies:
            own = dofs.nodes == rotation
            nodes[own] = reference
            axes[own] += 3
        return DofSet.from_arrays(nodes, axes)


def read_rotations(model: Sequence[Card], path: Path) -> Rotations:
    """Return the rotation nodes of rigid bodies and couplings.

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
    named = []
    unnamed = []
    for card in model:
        if card.name in ("RIGID BODY", "COUPLING"):
            row = Row(card.line, "")
            reference = whole(card.need("REF NODE"), card, row)
            rotation = card.get("ROT NODE")
            if rotation:
                named.append((whole(rotation, card, row), reference))
            else:
                unnamed.append(reference)
    return Rotations(tuple(named), tuple(unnamed), path)


_FOLLOWS = (
    "ALPHA and BETA hold for the whole deck: viscous damping follows the new mass and stiffness."
)


def write_properties(
    changes: Mapping[str, Mapping[str, float]], deck: str | Path, path: str | Path
) -> None:
    """Write the materials, springs and masses that changed as a file for ``*INCLUDE``.

    It takes the place of their old cards in the deck: CalculiX uses the first of two materials of
    one name. A deck of Abaqus is handed to `updyn.io.abaqus.model`.

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
        abaqus.write_properties(changes, deck, path)
        return
    model, _, _, parts = read_parts(deck, cards)
    remarks = [_FOLLOWS] if any(read_rayleigh(model)) else []
    write_changes(changes, parts, deck, Path(path), own_rayleigh=False, remarks=remarks)
