"""Nastran decks (``.bdf``, ``.nas``, ``.dat``): models, geometry, updated properties.

Groups are properties (``PSHELL 3``), and elements without a property card (``CONM2 9``). Decks of
springs, masses, rods and simple solids are assembled by `assembly`, all others by MYSTRAN: group
matrices are half the result of a run of the group alone with doubled moduli and densities; the
check of their sum detects properties that are not proportional to these. Ties and supports are
applied afterwards, as MYSTRAN reports them.
"""

from __future__ import annotations

import hashlib
import tempfile
import warnings
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from updyn.dofs import DIRECTIONS, Dof, DofSet
from updyn.elements.constraints import Equation, constrain
from updyn.errors import FormatError, ModelError, UpdynWarning, in_all, suggest
from updyn.exchanged import AxisExchange, StiffnessAndMass
from updyn.geometry import Geometry
from updyn.group import MATRICES
from updyn.io.atomic import atomic_path
from updyn.io.consistent_units import check_materials, find_units
from updyn.io.differences import groups_by_difference
from updyn.io.items import locate_errors
from updyn.io.nastran.assembly import DeckMatrices, assemble, is_simple
from updyn.io.nastran.assembly_elements import GroupMatrices
from updyn.io.nastran.bars import exchanged_bar, fields_to_exchange
from updyn.io.nastran.cards import NastranCard, read_lines
from updyn.io.nastran.changes import Revision, group_loss_factor, has_mass, revise
from updyn.io.nastran.deck import (
    ELEMENTS,
    PUNCHED_MATRICES,
    TIES,
    NastranDeck,
    build_geometry,
    find_enddata,
    materials_of,
    read_deck,
    read_points,
    values,
)
from updyn.io.nastran.fields import NastranLine
from updyn.io.nastran.mystran import (
    LUMPED,
    MystranMatrices,
    MystranProgram,
    adapt_cards,
    find_executable,
    run,
)
from updyn.io.nastran.neutral import describe_neutral
from updyn.io.nastran.replication import is_replicator
from updyn.model import Group, Matrix, Model

__all__ = [
    "read_geometry",
    "read_model",
    "write_deck",
    "write_properties",
]


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
    """Read a model in SI; MYSTRAN assembles decks that are not `is_simple`.

    `spc` and `mpc` are 0 for no set, by default the selection of case control. `ignore` are cards
    to ignore although they may change the structure, `massless` groups with stiffness but
    intentionally without mass. MYSTRAN also assembles simple decks if `executable` is given;
    `timeout` is in s a run. Loss factors are GE plus PARAM,G; PARAM,ALPHA1 and ALPHA2 are mass
    and stiffness damping. DOFs are in the displacement systems of the grids.
    """
    ignore = tuple(ignore)
    deck = read_deck(path, ignore)
    _note_neutral_cards(deck)
    units = find_units(unit)
    check_materials(_materials(deck), units, deck.path)
    _check_masses(deck, list(massless))
    sets = {"spc": deck.select_set("SPC", spc), "mpc": deck.select_set("MPC", mpc)}
    losses = {name: group_loss_factor(deck, name) for name in deck.groups}
    geometry = build_geometry(deck, unit)
    if executable is None and is_simple(deck):
        assembled = assemble(deck, sets["spc"])
        bars = None
    else:
        _note_lumped_masses(deck)
        _note_soft_bricks(deck)
        program = MystranProgram(find_executable(deck.path, executable), timeout)
        assembled = _assemble_by_mystran(deck, program, sets)
        bars = _Bars.of(deck, ignore, program, units, assembled.dofs)
    groups = {}
    for name in deck.groups:
        found = assembled.groups[name]
        matrices: dict[str, Matrix] = {}
        for what in MATRICES:
            matrix = getattr(found, what)
            if matrix is not None:
                matrices[what] = units.to_si(matrix, assembled.dofs)
        if not matrices:
            raise deck.group(name).error(f"group {name} has neither stiffness, mass nor damping")
        damping: dict[str, Any] = {}
        if found.stiffness is not None:
            damping["loss_factor"] = losses[name]
            damping["stiffness_damping"] = deck.parameter("ALPHA2", 0.0)
        if found.mass is not None:
            damping["mass_damping"] = deck.parameter("ALPHA1", 0.0)
        group = Group(**matrices, **damping).with_origin(deck.origins[name])
        groups[name] = group
        if bars is not None:
            groups[name] = group.with_exchanged(bars.exchange_axes(name))
    with locate_errors(deck.path):
        free = Model(groups, assembled.dofs, geometry, _title(deck))
        held, ties = _constraints(deck, assembled, units.length)
        tied = constrain(free, ties, held)
        return Model.from_groups(tied.groups, tied.dofs, geometry=geometry, title=tied.title)


def _note_neutral_cards(deck: NastranDeck) -> None:
    """Warn which cards are passed over because they change neither stiffness nor mass."""
    passed_over = describe_neutral(deck.neutral)
    if passed_over:
        warnings.warn(
            f"{deck.path}: passed over, because they change neither stiffness nor mass:"
            f" {passed_over}",
            UpdynWarning,
            stacklevel=3,
        )


def _note_lumped_masses(deck: NastranDeck) -> None:
    """Warn that MYSTRAN ignores PARAM,COUPMASS, if it requests coupled masses."""
    kinds = dict.fromkeys(card.name for card in deck.elements if card.name in LUMPED)
    if deck.parameter("COUPMASS", -1.0) > 0 and kinds:
        warnings.warn(
            f"{deck.path}: PARAM,COUPMASS requests coupled masses, but MYSTRAN lumps those of"
            f" {', '.join(kinds)}; for coupled ones, {PUNCHED_MATRICES}",
            UpdynWarning,
            stacklevel=3,
        )


def _note_soft_bricks(deck: NastranDeck) -> None:
    """Warn that bricks of 20 grids with reduced integration are too soft in MYSTRAN."""
    bricks = [card for card in deck.elements if card.name == "CHEXA" and card.text(10)]
    soft = [card for card in bricks if deck.group_of(card).text(5) in ("", "0", "REDUCED")]
    if soft:
        warnings.warn(
            f"{deck.path}: CHEXA {soft[0].text(0)}{in_all(len(soft))} has 20 grids and reduced"
            " integration, the default of PSOLID, which is too soft in MYSTRAN (frequencies up to"
            f" 17 % low on a coarse mesh): state FULL in field 7 (ISOP) of PSOLID"
            f" {deck.group_of(soft[0]).text(0)}, or {PUNCHED_MATRICES}",
            UpdynWarning,
            stacklevel=3,
        )


def _assemble_by_mystran(
    deck: NastranDeck, program: MystranProgram, sets: Mapping[str, int]
) -> DeckMatrices:
    with tempfile.TemporaryDirectory(prefix="updyn-mystran-") as folder:
        runs = _MystranRuns(deck, program, Path(folder))
        total = runs.run_deck(sets)

        def double_group(name: str) -> tuple[Any, Any]:
            # A run of the group alone, doubled, gives the same difference as a run of the whole
            # deck, in a fraction of the time.
            alone = runs.run_cards(_isolate_group(deck, name))
            if alone.dofs != total.dofs:
                raise FormatError(
                    f"group {name!r}: its run of MYSTRAN has other degrees of freedom", deck.path
                )
            return total.stiffness + alone.stiffness / 2.0, total.mass + alone.mass / 2.0

        solid = []
        viscous = {}
        for name, card in deck.groups.items():
            if _is_stiff(deck, name) or values(card).mass:
                solid.append(name)
            if any(card.reals(values(card).viscous)):
                viscous[name] = _viscous_matrix(deck, name, total, runs)
        sums = total.stiffness, total.mass
        parts = groups_by_difference(solid, sums, double_group, total.dofs, deck.path)
    groups = {
        name: GroupMatrices(*parts.get(name, (None, None)), viscous.get(name))
        for name in deck.groups
    }
    return DeckMatrices(total.dofs, groups, total.held, total.ties, total.tied)


def read_geometry(path: str | Path, *, unit: str = "m", ignore: Iterable[str] = ()) -> Geometry:
    """Read the grid positions of a deck, or of a file with bulk data only, in m.

    Positions are in the basic system, with the displacement directions of grids that define them.
    """
    return build_geometry(read_points(path, ignore), unit)


def write_properties(
    changes: Mapping[str, Mapping[str, float]], deck: str | Path, path: str | Path
) -> None:
    """Write the changed cards of a deck to a file that the deck can include.

    Nastran accepts each card only once: a comment before each new card gives file and line of the
    card to delete from the deck. A `ModelError` is raised if a loss factor is below PARAM,G, which
    applies to all groups.
    """
    source = read_deck(deck, None)
    revision = revise(source, changes)
    text = (
        f"$ New values of properties of {_to_ascii(source.path.name)}; comments give the replaced"
        " cards.\n"
    )
    copies = _replicators(read_lines(source.path))
    for cards in _group_by_lines(source, revision):
        for line in cards[0].lines:
            if line in copies:
                raise line.error(
                    f"{cards[0].name} {cards[0].text(0)} is copied by a replicator (=), so a new"
                    " card would change the copies: replace the replicator by cards, or write the"
                    " whole deck (updyn.io.nastran.bdf.write_deck)"
                )
        text += _format_with_comment(cards, revision)
    for card in revision.added:
        text += "$ New: a copy of a material that other groups share\n" + card.large()
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="ascii")


def write_deck(
    changes: Mapping[str, Mapping[str, float]], deck: str | Path, path: str | Path
) -> None:
    """Write a whole deck with changed properties, INCLUDE files inserted and comments removed.

    By group, ``stiffness`` and ``mass`` are factors on the values of the deck, ``loss_factor`` is
    the new value. A `ModelError` is raised if a loss factor is below PARAM,G.
    """
    source = read_deck(deck, None)
    revision = revise(source, changes)
    deck_lines = list(read_lines(source.path))
    instead: dict[NastranLine, str] = {}  # by line of the deck; empty for deleted lines
    # Copies become cards, because a replicator would copy the new card.
    for cards in _group_by_lines(source, revision, _replicators(deck_lines)):
        lines = cards[0].lines
        instead |= dict.fromkeys(lines, "")
        instead[lines[0]] = _format_cards(revision.cards(cards))
    end = find_enddata(deck_lines)
    text = ""
    for line in deck_lines[:end]:
        text += instead.get(line, line.text + "\n")
    text += _format_cards(revision.added)
    for line in deck_lines[end:]:
        text += line.text + "\n"
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="latin-1")


def _group_by_lines(
    deck: NastranDeck, revision: Revision, lines: Collection[NastranLine] = ()
) -> list[list[NastranCard]]:
    """Return the changed cards and those that start on `lines`, with all cards of these lines."""
    touched: dict[tuple[NastranLine, ...], list[NastranCard]] = {
        old.lines: [] for old in revision.replaced
    }
    for card in deck.cards:
        if card.lines in touched or card.lines[0] in lines:
            touched.setdefault(card.lines, []).append(card)
    return list(touched.values())


def _replicators(lines: Iterable[NastranLine]) -> set[NastranLine]:
    """Return the lines that copy the preceding line, and the copied lines."""
    found: set[NastranLine] = set()
    for before, line in pairwise(lines):
        if is_replicator(line.text):
            found |= {before, line}
    return found


def _format_cards(cards: Iterable[NastranCard]) -> str:
    return "".join(card.large() for card in cards)


def _format_with_comment(cards: list[NastranCard], revision: Revision) -> str:
    line = cards[0].lines[0]
    was = "".join(f"$   {_to_ascii(part.text)}\n" for part in cards[0].lines)
    return (
        f"$ Instead of {cards[0].name} {cards[0].text(0)} ({_to_ascii(line.path.name)}, line"
        f" {line.number}):\n{was}{_format_cards(revision.cards(cards))}"
    )


def _to_ascii(text: str) -> str:
    return text.encode("ascii", "backslashreplace").decode("ascii")


class _MystranRuns:
    """Runs MYSTRAN on a deck, each run in a separate folder, for all grids and scalar points."""

    def __init__(self, deck: NastranDeck, program: MystranProgram, folder: Path) -> None:
        self._deck = deck
        self._program = program
        self._folder = folder

    def run_deck(self, sets: Mapping[str, int]) -> MystranMatrices:
        return self._run(adapt_cards(self._deck, self._deck.cards), 2, sets)

    def run_cards(self, cards: list[NastranCard]) -> MystranMatrices:
        """Run some cards without supports and ties."""
        return self._run(cards, 1, {})

    def _run(
        self, cards: list[NastranCard], links: int, sets: Mapping[str, int]
    ) -> MystranMatrices:
        path = self._deck.path
        with tempfile.TemporaryDirectory(dir=self._folder) as folder:
            found = run(self._program, cards, Path(folder), path, links=links, **sets)
        return _restrict_to_grids(self._deck, found)


@dataclass(frozen=True, slots=True, eq=False)
class _Bars:
    """The deck of a model, to be read again where its bars are to have exchanged section axes."""

    path: Path
    ignore: tuple[str, ...]
    program: MystranProgram
    units: Any
    dofs: DofSet
    turned: Mapping[str, str]
    digest: bytes

    @classmethod
    def of(
        cls,
        deck: NastranDeck,
        ignore: tuple[str, ...],
        program: MystranProgram,
        units: Any,
        dofs: DofSet,
    ) -> _Bars:
        """Return the bars of a deck whose section axes differ: their fields by name."""
        turned = {
            name: fields_to_exchange(card)
            for name, card in deck.groups.items()
            if exchanged_bar(card) is not None
        }
        digest = _digest(deck) if turned else b""
        return cls(deck.path.resolve(), ignore, program, units, dofs, turned, digest)

    def exchange_axes(self, name: str) -> AxisExchange | None:
        """Return a group with exchanged section axes; None without any to exchange."""
        if name not in self.turned:
            return None
        turn = "the orientation vectors of its CBAR by 90 degrees about the bars"
        return AxisExchange(_TurnedBar(self, name), self.turned[name], turn)

    def matrices(self, name: str) -> StiffnessAndMass:
        """Run MYSTRAN on a group with exchanged section axes; refuse a deck that has changed."""
        deck = read_deck(self.path, self.ignore)
        if _digest(deck) != self.digest:
            raise ModelError(f"{self.path} has changed since the model was read")
        group_card = deck.group(name)
        cards = [
            (exchanged_bar(card) or card) if _is_same(card, group_card) else card
            for card in _isolate_group(deck, name, 1.0)
        ]
        with tempfile.TemporaryDirectory(prefix="updyn-mystran-") as folder:
            found = _MystranRuns(deck, self.program, Path(folder)).run_cards(cards)
        if found.dofs != self.dofs:
            raise ModelError(f"{self.path}: group {name!r} has other degrees of freedom")
        K, M = (
            self.units.to_si(A, self.dofs) if A.nnz else None for A in (found.stiffness, found.mass)
        )
        return StiffnessAndMass(K, M)


@dataclass(frozen=True, slots=True, eq=False)
class _TurnedBar:
    """The recipe of a group of bars: a run of MYSTRAN."""

    bars: _Bars
    name: str

    def matrices(self) -> StiffnessAndMass:
        return self.bars.matrices(self.name)


def _is_same(card: NastranCard, other: NastranCard) -> bool:
    return (card.name, card.text(0)) == (other.name, other.text(0))


def _digest(deck: NastranDeck) -> bytes:
    found = hashlib.blake2b()
    for card in deck.cards:
        found.update("\0".join((card.name, *card.fields, "\n")).encode())
    return found.digest()


def _isolate_group(deck: NastranDeck, name: str, factor: float = 2.0) -> list[NastranCard]:
    """Return the cards of one group, its stiffness and mass scaled by `factor`, and all grids."""
    change = {}
    if _is_stiff(deck, name):
        change["stiffness"] = factor
    if has_mass(deck, name):
        change["mass"] = factor
    chosen = deck.group(name)
    kept = []
    for card in deck.cards:
        is_other = card.name in ELEMENTS and deck.group_of(card) != chosen
        if not is_other and card.name not in TIES:
            kept.append(card)
    revision = revise(deck, {name: change})
    cards = adapt_cards(deck, [*revision.cards(kept), *revision.added])
    # A spring between two additional grids, because MYSTRAN rejects decks without stiffness.
    last = max(deck.points, default=0)
    for card in cards:
        if card.name == "GRID":
            last = max(last, card.integer(0))
    spring = max([card.integer(0) for card in cards if card.name in ELEMENTS], default=0) + 1
    ends = str(last + 1), str(last + 2)
    for end in ends:
        cards.append(NastranCard("GRID", (end, "", "0.", "0.", "0."), chosen.lines))
    fields = (str(spring), "1.", ends[0], "1", ends[1], "1")
    return [*cards, NastranCard("CELAS2", fields, chosen.lines)]


def _viscous_matrix(
    deck: NastranDeck, name: str, total: MystranMatrices, runs: _MystranRuns
) -> Matrix:
    """Return the viscous matrix of a group, shape (N, N)."""
    card = deck.group(name)
    if card.name == "PBUSH":
        return _damping_of_pbush(deck, name, runs)
    n = len(total.dofs)
    damping = sp.dok_array((n, n))
    for element in deck.elements:
        if deck.group_of(element) != card:
            continue
        labels = []
        for at in element.nonempty((2, 4)):
            node = element.integer(at)
            component = max(element.integer(at + 1, 1), 1)
            if node:
                labels.append(Dof(node, DIRECTIONS[component - 1]))
        with locate_errors(deck.path, f"{element.name} {element.text(0)}"):
            ends = total.dofs.match(labels).index.tolist()
        b = card.real(1)
        for i, sign in zip(ends, (1.0, -1.0), strict=False):
            for j, other in zip(ends, (1.0, -1.0), strict=False):
                damping[i, j] += sign * other * b
    return sp.csr_array(damping)


def _damping_of_pbush(deck: NastranDeck, name: str, runs: _MystranRuns) -> Matrix:
    """Return the viscous matrix of a bushing: its stiffness matrix with B in place of K."""
    bush = deck.group(name)
    fields = values(bush)
    flag = 1  # the field with the keyword K; its values follow
    for at in range(1, len(bush.fields), 8):
        if bush.text(at) == "K":
            flag = at
            break
    replacement = dict.fromkeys(fields.stiffness, "")
    for at in fields.viscous:
        replacement[flag + 1 + (at - 2) % 8] = bush.text(at)
    replacement[flag] = "K"
    cards = []
    for card in _isolate_group(deck, name, 1.0):
        is_bush = (card.name, card.text(0)) == (bush.name, bush.text(0))
        cards.append(card.with_fields(replacement) if is_bush else card)
    return runs.run_cards(cards).stiffness


def _restrict_to_grids(deck: NastranDeck, found: MystranMatrices) -> MystranMatrices:
    """Return matrices restricted to the grids of the deck; additional grids are uncoupled."""
    mine = np.isin(found.dofs.nodes, [*deck.grids, *deck.points])
    keep = np.flatnonzero(mine)
    new = np.cumsum(mine) - 1
    return MystranMatrices(
        found.stiffness[keep][:, keep],
        found.mass[keep][:, keep],
        found.dofs[keep],
        sp.csr_array(found.ties)[:, keep],
        new[found.tied],
        new[found.held[mine[found.held]]],
    )


def _is_stiff(deck: NastranDeck, name: str) -> bool:
    card = deck.group(name)
    return bool(values(card).stiffness or materials_of(card))


def _title(deck: NastranDeck) -> str:
    for line in deck.case:
        key, _, rest = line.text.partition("=")
        if key.strip().upper() == "TITLE":
            return rest.strip()
    return ""


def _materials(deck: NastranDeck) -> list[tuple[str, float | None, float | None]]:
    """Return name, modulus and mass density of the isotropic materials that groups use."""
    used: set[int] = set()
    for card in deck.groups.values():
        used.update(card.integers(materials_of(card)))
    factor = deck.parameter("WTMASS", 1.0)
    found = []
    for number, card in deck.materials.items():
        if number in used and card.name == "MAT1":
            modulus = card.real(1, 0.0)
            density = card.real(4, 0.0) * factor
            found.append((f"MAT1 {number}", modulus or None, density or None))
    return found


def _check_masses(deck: NastranDeck, massless: list[str]) -> None:
    for name in massless:
        if name not in deck.groups:
            raise FormatError(
                f"massless: no group {name!r}; {suggest(name, deck.groups)}", deck.path
            )
    for name, card in deck.groups.items():
        springs = bool(values(card).stiffness or values(card).viscous)
        if not springs and name not in massless and not has_mass(deck, name):
            raise card.error(
                f"group {name} has no mass: neither its material nor its card gives one; if this is"
                f' intended, pass massless=["{name}"]'
            )


def _constraints(
    deck: NastranDeck, found: DeckMatrices, scale: float
) -> tuple[list[str], list[Equation]]:
    """Return the fixed DOFs, and the equations of the tied DOFs."""
    labels = found.dofs.labels
    held = [labels[i] for i in found.held]
    if found.tied is None or not len(found.tied):
        return held, []
    ties = sp.csc_array(found.ties)
    coefficients = sp.csc_array(ties[:, found.tied])
    rest = np.setdiff1d(np.arange(len(labels)), found.tied)
    try:
        factors = splu(coefficients)
    except RuntimeError as error:
        raise FormatError(
            "the ties (MPC, RBE2, RBE3, ...) are dependent or contradict each other: their matrix"
            " is singular",
            deck.path,
        ) from error
    # Coefficients between translations and rotations have the unit of length or its inverse.
    units = np.where(found.dofs.axes < 3, scale, 1.0)
    solved = -_solve_sparse(factors, sp.csc_array(ties[:, rest]))
    solved = sp.diags_array(units[found.tied]) @ solved @ sp.diags_array(1.0 / units[rest])
    equations = []
    for k, i in enumerate(found.tied):
        row = slice(solved.indptr[k], solved.indptr[k + 1])
        terms = zip(solved.indices[row].tolist(), solved.data[row].tolist(), strict=True)
        others = {labels[rest[j]]: factor for j, factor in terms}
        equations.append(Equation(labels[i], others))
    return held, equations


def _solve_sparse(factors: Any, right: Any, block: int = 256) -> Any:
    """Solve for sparse right-hand sides, `block` columns at a time."""
    used = np.flatnonzero(np.diff(right.indptr))
    if not len(used):
        return sp.csr_array(right.shape)
    parts = []
    for start in range(0, len(used), block):
        dense = factors.solve(right[:, used[start : start + block]].toarray())
        dense[np.abs(dense) < 1e-13] = 0.0  # rounding
        parts.append(sp.coo_array(dense))
    entries = (np.ones(len(used)), (np.arange(len(used)), used))
    placed_at = sp.coo_array(entries, shape=(len(used), right.shape[1]))
    return sp.csr_array(sp.hstack(parts) @ placed_at)
