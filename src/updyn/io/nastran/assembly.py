"""Assembly of decks of springs, masses, rods and simple solids, without MYSTRAN.

Supports are those of SPC cards and of grids. As in Nastran (Quick Reference Guide, PARAM,AUTOSPC),
degrees of freedom without stiffness are fixed too: at each grid the principal stiffnesses of
translations and of rotations are compared with the largest one.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from updyn.arrays import BoolArray, IndexArray, RealArray
from updyn.dofs import DofSet
from updyn.errors import UpdynWarning
from updyn.geometry import Geometry
from updyn.group import MATRICES, Matrix
from updyn.io.nastran.assembly_elements import (
    SIMPLE_ELEMENTS,
    GridMap,
    GroupMatrices,
    build_group,
    is_isotropic_solid,
)
from updyn.io.nastran.cards import NastranCard
from updyn.io.nastran.deck import (
    MATERIALS,
    PROPERTIES,
    SYSTEMS,
    NastranDeck,
    build_geometry,
)
from updyn.io.nastran.neutral import NEUTRAL_PARAMETERS
from updyn.io.settings import DECK

__all__ = ["DeckMatrices", "assemble", "is_simple"]

_SUPPORTS = ("SPC", "SPC1", "SPCADD")
_CARDS = {
    *("GRID", "GRDSET", "SPOINT", "PARAM"),
    *(*SIMPLE_ELEMENTS, *PROPERTIES, *MATERIALS, *SYSTEMS, *_SUPPORTS),
}
#: PARAM cards that are applied, or that change no matrix of these elements.
_PARAMETERS = {
    *NEUTRAL_PARAMETERS,
    *("AUTOSPC", "COUPMASS", "ITERATE", "K6ROT", "MAXRATIO", "SNORM", "WTMASS"),
}
_PER_GRID = 6


@dataclass(frozen=True, slots=True, eq=False)
class DeckMatrices:
    """Matrices of the groups of a deck, before supports and ties, in the units of the deck.

    The n `dofs` are in the displacement systems of the grids. `held` are positions of the fixed
    ones, shape (s,), `tied` of the dependent ones, shape (m,), in the order of the rows of `ties`,
    (m, n): ties u = 0.
    """

    dofs: DofSet
    groups: dict[str, GroupMatrices]
    held: IndexArray
    ties: Matrix | None = None
    tied: IndexArray | None = None


def is_simple(deck: NastranDeck) -> bool:
    """Return whether a deck can be assembled without MYSTRAN."""
    if any(card.name not in _CARDS for card in deck.cards):
        return False
    for card in deck.cards_named("PARAM"):
        if card.text(0) not in _PARAMETERS:
            return False
        if card.text(0) == "AUTOSPC" and card.text(1) not in ("YES", "Y", "1"):
            return False
    return all(_is_simple_element(deck, card) for card in deck.elements)


def _is_simple_element(deck: NastranDeck, card: NastranCard) -> bool:
    if card.name in ("CHEXA", "CPENTA"):
        return is_isotropic_solid(deck, card)
    if card.name == "CONM2":
        return card.text(2) in ("", "0")
    if card.name in ("CROD", "CONROD"):
        return [m.name for m in deck.materials_of(deck.group_of(card))] == ["MAT1"]
    return True


def assemble(deck: NastranDeck, spc: int) -> DeckMatrices:
    """Return the matrices of the groups of a deck that `is_simple`; `spc` is the support set."""
    geometry = build_geometry(deck)  # in the unit of the deck
    grids = _map_grids(deck, geometry)
    dofs = _list_dofs(deck, grids)
    turn = _turn_matrix(geometry, grids)
    groups = _build_groups(deck, grids, turn)
    held = np.zeros(grids.size, dtype=np.bool_)
    held[list(_find_supports(deck, grids, spc))] = True
    singular = _find_singular(_sum_stiffness(groups, grids.size), held, grids)
    _report_singular(deck, groups, singular, dofs)
    return DeckMatrices(dofs, groups, np.flatnonzero(held | singular))


def _build_groups(
    deck: NastranDeck, grids: GridMap, turn: Matrix | None
) -> dict[str, GroupMatrices]:
    members: dict[str, list[NastranCard]] = {}
    for card in deck.elements:
        members.setdefault(deck.group_name_of(card), []).append(card)
    groups = {}
    for name, cards in members.items():
        with np.errstate(all="ignore"):  # numbers that are not finite are reported below
            found = build_group(deck, cards, grids, turn)
        for what in MATRICES:
            matrix = getattr(found, what)
            if matrix is not None and not np.isfinite(matrix.data).all():
                raise deck.group(name).error(
                    f"group {name}: its {what} is not finite; expected smaller numbers"
                )
        groups[name] = found
    return groups


def _map_grids(deck: NastranDeck, geometry: Geometry) -> GridMap:
    first = {}
    size = 0
    for node in sorted({*deck.grids, *deck.points}):
        first[node] = size
        size += _PER_GRID if node in deck.grids else 1
    position = dict(zip(geometry.nodes.tolist(), geometry.xyz, strict=True))
    return GridMap(size, first, position)


def _list_dofs(deck: NastranDeck, grids: GridMap) -> DofSet:
    counts = [_PER_GRID if node in deck.grids else 1 for node in grids.first]
    nodes = np.repeat(list(grids.first), counts)
    return DofSet.from_arrays(nodes, np.concatenate([np.arange(n) for n in counts]))


def _turn_matrix(geometry: Geometry, grids: GridMap) -> Matrix | None:
    """Return the matrix that turns basic displacements into those of the grids; None if equal."""
    if geometry.axes is None:
        return None
    places = grids.list_axes()  # in the order of geometry.axes
    rows, columns = np.broadcast_arrays(places[:, :, None], places[:, None, :])
    values = np.repeat(geometry.axes, 2, axis=0)
    scalar = np.setdiff1d(np.arange(grids.size), places)
    entries = np.concatenate([values.ravel(), np.ones(len(scalar))])
    where = [np.concatenate([at.ravel(), scalar]) for at in (rows, columns)]
    return sp.csr_array(sp.coo_array((entries, tuple(where)), shape=(grids.size, grids.size)))


def _sum_stiffness(groups: dict[str, GroupMatrices], size: int) -> Matrix:
    found = sp.csr_array((size, size))
    for group in groups.values():
        if group.stiffness is not None:
            found = found + group.stiffness
    return found


def _find_supports(deck: NastranDeck, grids: GridMap, spc: int) -> Iterator[int]:
    """Yield the degrees of freedom that grids and the selected SPC set fix."""
    default = next((card.text(6) for card in deck.cards_named("GRDSET")), "")
    for node, card in deck.grids.items():
        yield from _components(card, grids, node, card.text(6, default))
    chosen = _supports_of_set(deck, spc) if spc else set()
    for card in deck.cards_named("SPC", "SPC1"):
        if card.integer(0) not in chosen:
            continue
        if card.name == "SPC":
            for at in card.nonempty((1, 4)):
                yield from _components(card, grids, card.integer(at), card.text(at + 1))
        else:
            for node in _nodes_of_spc1(card, grids):
                yield from _components(card, grids, node, card.text(1))


def _supports_of_set(deck: NastranDeck, spc: int) -> set[int]:
    """Return the sets of SPC and SPC1 cards in a set; SPCADD joins several."""
    known = {card.integer(0) for card in deck.cards_named("SPC", "SPC1")}
    chosen = {spc}
    for card in deck.cards_named("SPCADD"):
        if card.integer(0) != spc:
            continue
        joined = set(card.integers(card.nonempty(range(1, len(card.fields)))))
        if joined - known:
            raise card.error(
                f"SPCADD {spc}: no SPC or SPC1 card of set {min(joined - known)}; available:"
                f" {', '.join(map(str, sorted(known))) or 'none'}"
            )
        chosen |= joined
    return chosen


def _nodes_of_spc1(card: NastranCard, grids: GridMap) -> Iterable[int]:
    if card.text(3) == "THRU":
        ends = card.integer(2), card.integer(4)
        return [node for node in grids.first if ends[0] <= node <= ends[1]]
    return card.integers(card.nonempty(range(2, len(card.fields))))


def _components(card: NastranCard, grids: GridMap, node: int, text: str) -> Iterator[int]:
    """Yield the degrees of freedom of the components of a support."""
    if node not in grids.position:
        yield grids.first[node]
        return
    if set(text) - set("0123456"):
        raise card.error(
            f"{card.name}: components {text!r} of grid {node}; expected digits from 1 to 6"
        )
    for digit in text.replace("0", ""):
        yield grids.first[node] + int(digit) - 1


def _find_singular(K: Matrix, held: BoolArray, grids: GridMap) -> BoolArray:
    """Return a mask of the degrees of freedom that have no stiffness, the fixed ones left out."""
    diagonal = K.diagonal()
    singular: BoolArray = (diagonal == 0.0) & ~held
    places = grids.list_axes()
    blocks = _blocks(K, places, grids.size)
    free = ~(held | singular)[places]
    scale = np.where(free, diagonal[places], 0.0).max(axis=1)
    # Rows of other degrees of freedom are those of a unit matrix, so they are not singular.
    both = free[:, :, None] & free[:, None, :]
    scaled = np.where(both, blocks / np.where(scale > 0, scale, 1.0)[:, None, None], 0.0)
    scaled += np.eye(3) * ~free[:, :, None]
    values, vectors = np.linalg.eigh(scaled)
    for block in np.flatnonzero(values[:, 0] < DECK.singular_stiffness * values[:, -1]):
        is_null = values[block] < DECK.singular_stiffness * values[block, -1]
        # Fix the components that move most in the directions without stiffness.
        order = scipy.linalg.qr(vectors[block][:, is_null].T, pivoting=True, mode="r")[1]
        singular[places[block][order[: is_null.sum()]]] = True
    return singular


def _blocks(K: Matrix, places: IndexArray, size: int) -> RealArray:
    """Return the diagonal blocks (m, 3, 3) of a matrix at places (m, 3)."""
    block_of, at = np.full(size, -1), np.zeros(size, dtype=np.int64)
    block_of[places] = np.arange(len(places))[:, None]
    at[places] = np.arange(3)
    entry = sp.coo_array(K)
    inner = (block_of[entry.row] == block_of[entry.col]) & (block_of[entry.row] >= 0)
    rows, columns = entry.row[inner], entry.col[inner]
    out = np.zeros((len(places), 3, 3))
    out[block_of[rows], at[rows], at[columns]] = entry.data[inner]
    return out


def _report_singular(
    deck: NastranDeck, groups: dict[str, GroupMatrices], singular: BoolArray, dofs: DofSet
) -> None:
    """Warn how many degrees of freedom are fixed because they have no stiffness."""
    if not singular.any():
        return
    translations = singular & (dofs.axes < 3)
    text = f"{singular.sum()} degrees of freedom without stiffness are fixed (AUTOSPC)"
    if translations.any():
        text += f", {translations.sum()} of them translations: {_first_labels(dofs, translations)}"
    heavy = np.zeros(len(dofs), dtype=np.bool_)
    for group in groups.values():
        if group.mass is not None:
            heavy |= group.mass.diagonal() > 0
    if (heavy & singular).any():
        text += f"; with mass: {_first_labels(dofs, heavy & singular)}"
    warnings.warn(f"{deck.path}: {text}", UpdynWarning, stacklevel=2)


def _first_labels(dofs: DofSet, mask: BoolArray) -> str:
    found = [str(dofs[int(at)]) for at in np.flatnonzero(mask)]
    more = ", ..." if len(found) > DECK.named_dofs else ""
    return ", ".join(found[: DECK.named_dofs]) + more
