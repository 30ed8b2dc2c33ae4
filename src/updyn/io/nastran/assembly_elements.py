"""Matrices of the elements that are assembled without MYSTRAN, by group.

Springs, dampers and scalar masses act on single degrees of freedom, in the displacement systems of
the grids. Rods, solids and point masses are computed in the basic system (MSC Nastran Quick
Reference Guide, entries CELAS1, CMASS1, CROD, CONM2, CHEXA, CPENTA, MAT1).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from updyn.arrays import IntArray, RealArray
from updyn.elements.structure.bricks import brick_matrices, find_inside_out
from updyn.group import MATRICES, Matrix
from updyn.io.nastran.cards import NastranCard
from updyn.io.nastran.deck import NastranDeck
from updyn.io.settings import DECK

__all__ = ["SIMPLE_ELEMENTS", "GridMap", "GroupMatrices", "build_group", "is_isotropic_solid"]

#: Elements on single degrees of freedom, and the matrix that they add to.
_SCALAR = {
    "CELAS1": "stiffness",
    "CELAS2": "stiffness",
    "CMASS1": "mass",
    "CMASS2": "mass",
    "CDAMP1": "viscous",
    "CDAMP2": "viscous",
}
_RODS = ("CROD", "CONROD")
_SOLIDS = {"CHEXA": 8, "CPENTA": 6}
#: Elements that are assembled without MYSTRAN.
SIMPLE_ELEMENTS = (*_SCALAR, *_RODS, *_SOLIDS, "CONM2")

#: Coupled mass of a rod along its axis: the mean of the lumped and the consistent mass.
_ALONG = np.array([[5.0, 1.0], [1.0, 5.0]]) / 12.0
_ACROSS = np.eye(2) / 2.0
_PAIR = np.array([[1.0, -1.0], [-1.0, 1.0]])


@dataclass(frozen=True, slots=True, eq=False)
class GridMap:
    """First degree of freedom and basic position (3,) of each grid, and those of scalar points.

    `size` is the number of degrees of freedom: six by grid, one by scalar point.
    """

    size: int
    first: Mapping[int, int]
    position: Mapping[int, RealArray]

    def list_axes(self) -> IntArray:
        """Return the translations and, in the next row, the rotations of each grid, (2 g, 3)."""
        starts = np.array([self.first[node] for node in self.position], dtype=np.int64)
        return np.asarray((starts[:, None] + [0, 3]).reshape(-1, 1) + np.arange(3), dtype=np.int64)

    def find_dof(self, card: NastranCard, node_field: int) -> int | None:
        """Return the degree of freedom at one end of a scalar element; None for the ground."""
        node = card.integer(node_field, 0)
        if not node:
            return None
        component = card.integer(node_field + 1, 0)
        is_grid = node in self.position
        if is_grid and not 1 <= component <= 6:
            expected = "1 to 6 at a grid"
        elif not is_grid and component not in (0, 1):
            expected = "0 or 1 at a scalar point"
        else:
            return self.first[node] + max(component, 1) - 1
        raise card.error(
            f"{card.name} {card.text(0)}: component {component} (field {node_field + 3}); expected"
            f" {expected}"
        )

    def find_grid(self, card: NastranCard, node_field: int) -> int:
        """Return the number of a grid; raise a FormatError for a scalar point."""
        node = card.integer(node_field)
        if node not in self.position:
            raise card.error(
                f"{card.name} {card.text(0)}: {node} is a scalar point; expected a grid"
            )
        return node


@dataclass(slots=True)
class _Entries:
    """Entries of a matrix, added by blocks of degrees of freedom."""

    rows: list[IntArray] = field(default_factory=list)
    columns: list[IntArray] = field(default_factory=list)
    values: list[RealArray] = field(default_factory=list)

    def add(self, dofs: IntArray, blocks: RealArray) -> None:
        """Add blocks (m, k, k) at degrees of freedom (m, k)."""
        self.rows.append(np.broadcast_to(dofs[:, :, None], blocks.shape).ravel())
        self.columns.append(np.broadcast_to(dofs[:, None, :], blocks.shape).ravel())
        self.values.append(blocks.ravel())

    def to_matrix(self, size: int) -> Matrix:
        """Return the sum as a sparse matrix, shape (size, size)."""
        if not self.values:
            return sp.csr_array((size, size))
        places = np.concatenate(self.rows), np.concatenate(self.columns)
        entries = sp.coo_array((np.concatenate(self.values), places), shape=(size, size))
        found = sp.csr_array(entries)
        found.eliminate_zeros()
        return found


@dataclass(slots=True)
class _Parts:
    stiffness: _Entries = field(default_factory=_Entries)
    mass: _Entries = field(default_factory=_Entries)
    viscous: _Entries = field(default_factory=_Entries)


@dataclass(frozen=True, slots=True, eq=False)
class GroupMatrices:
    """Matrices of a group, shape (n, n), in the displacement systems; None for zero matrices."""

    stiffness: Matrix | None
    mass: Matrix | None
    viscous: Matrix | None


def build_group(
    deck: NastranDeck, cards: Iterable[NastranCard], grids: GridMap, turn: Matrix | None
) -> GroupMatrices:
    """Return the matrices of the elements of one group, without damping by loss factors.

    `turn` (n, n) turns displacements of the basic system into those of the grids; None if equal.
    """
    local, basic = _Parts(), _Parts()
    by_kind: dict[str, list[NastranCard]] = {}
    for card in cards:
        by_kind.setdefault(card.name, []).append(card)
    is_coupled = deck.parameter("COUPMASS", -1.0) > 0
    for kind, alike in by_kind.items():
        if kind in _SCALAR:
            _add_scalar(deck, alike, grids, getattr(local, _SCALAR[kind]))
        elif kind in _RODS:
            for card in alike:
                _add_rod(deck, card, grids, basic, is_coupled)
        elif kind in _SOLIDS:
            _add_solids(deck, alike, grids, basic, is_coupled)
        else:
            for card in alike:
                _add_point_mass(card, grids, basic.mass)
    factor = deck.parameter("WTMASS", 1.0)
    found = {}
    for what in MATRICES:
        A = getattr(local, what).to_matrix(grids.size)
        B = getattr(basic, what).to_matrix(grids.size)
        if turn is not None and B.nnz:
            B = turn @ B @ turn.T
        A = sp.csr_array(A + B)
        if what == "mass":
            A = A * factor
        found[what] = A if A.nnz else None
    return GroupMatrices(**found)


def _add_scalar(
    deck: NastranDeck, cards: Iterable[NastranCard], grids: GridMap, to: _Entries
) -> None:
    for card in cards:
        # The elements without a property card hold their value in the same field.
        value = deck.group_of(card).real(1)
        found = [grids.find_dof(card, 2), grids.find_dof(card, 4)]
        ends = [at for at in found if at is not None]
        if not ends:
            raise card.error(f"{card.name} {card.text(0)}: no grid; expected one or two")
        block = value * (_PAIR if len(ends) == 2 else np.ones((1, 1)))
        to.add(np.array([ends]), block[None])


def _add_rod(
    deck: NastranDeck, card: NastranCard, grids: GridMap, to: _Parts, is_coupled: bool
) -> None:
    fields = (1, 2) if card.name == "CONROD" else (2, 3)
    ends = [grids.find_grid(card, at) for at in fields]
    span = grids.position[ends[1]] - grids.position[ends[0]]
    length = float(np.linalg.norm(span))
    if not length:
        raise card.error(f"{card.name} {card.text(0)}: its grids coincide; expected a length")
    holder = deck.group_of(card)
    start = 4 if card.name == "CONROD" else 2
    area, torsion, _, added = holder.reals(range(start, start + 4), 0.0)
    material = deck.materials_of(holder)[0]
    solid = _read_isotropic(material)
    along = np.outer(span, span) / length**2
    across = np.eye(3) - along
    mass = (solid.rho * area + added) * length
    first = np.array([grids.first[node] for node in ends])
    dofs = (first[:, None] + np.arange(3)).reshape(1, 6)
    to.stiffness.add(dofs, np.kron(_PAIR, solid.E * area / length * along)[None])
    to.stiffness.add(dofs + 3, np.kron(_PAIR, solid.G * torsion / length * along)[None])
    axial = _ALONG if is_coupled else _ACROSS
    to.mass.add(dofs, mass * (np.kron(axial, along) + np.kron(_ACROSS, across))[None])


def _add_point_mass(card: NastranCard, grids: GridMap, to: _Entries) -> None:
    """Add a CONM2 whose offset and inertia are in the basic system."""
    first = grids.first[grids.find_grid(card, 1)]
    mass = card.real(3, 0.0)
    x, y, z = card.reals((4, 5, 6), 0.0)
    i11, i21, i22, i31, i32, i33 = card.reals(range(8, 14), 0.0)
    motion = np.hstack([np.eye(3), [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]])
    block = mass * motion.T @ motion
    block[3:, 3:] += [[i11, -i21, -i31], [-i21, i22, -i32], [-i31, -i32, i33]]
    to.add(first + np.arange(6)[None], block[None])


def _add_solids(
    deck: NastranDeck, cards: Sequence[NastranCard], grids: GridMap, to: _Parts, is_coupled: bool
) -> None:
    solid = _read_isotropic(deck.materials_of(deck.group_of(cards[0]))[0])
    for batch in _split(cards, DECK.solids_per_batch):
        nodes = [[grids.find_grid(card, at) for at in _corner_fields(card)] for card in batch]
        xyz = np.array([[grids.position[node] for node in row] for row in nodes])
        bad = find_inside_out(xyz)
        if bad is not None:
            card = batch[bad]
            raise card.error(
                f"{card.name} {card.text(0)} is turned inside out or has no volume: its grids are"
                " not in order, or it is too distorted"
            )
        try:
            K, M = brick_matrices(xyz, solid.E, solid.nu, solid.rho, lumped=not is_coupled)
        except np.linalg.LinAlgError as error:
            raise batch[0].error(
                f"{batch[0].name} {batch[0].text(0)}, or a later one of its property, is too"
                " distorted: its stiffness is singular"
            ) from error
        first = np.array([[grids.first[node] for node in row] for row in nodes])
        dofs = (first[:, :, None] + np.arange(3)).reshape(len(batch), -1)
        to.stiffness.add(dofs, K)
        to.mass.add(dofs, M)


def _split(cards: Sequence[NastranCard], size: int) -> Iterator[Sequence[NastranCard]]:
    for start in range(0, len(cards), size):
        yield cards[start : start + size]


def _corner_fields(card: NastranCard) -> range:
    return range(2, 2 + _SOLIDS[card.name])


@dataclass(frozen=True, slots=True)
class _Isotropic:
    E: float
    G: float
    nu: float
    rho: float


def _read_isotropic(material: NastranCard) -> _Isotropic:
    """Return the constants of a MAT1; one of E, G and NU that is blank follows from the others."""
    E, G, nu, rho = material.reals((1, 2, 3, 4), 0.0)
    has_E, has_G, has_nu = (bool(material.text(at)) for at in (1, 2, 3))
    if nu == -1:
        raise material.error(f"MAT1 {material.text(0)}: NU (field 5) is -1; expected above -1")
    if has_E and has_nu and not has_G:
        G = E / (2 * (1 + nu))
    elif has_E and has_G and not has_nu and G:
        nu = E / (2 * G) - 1
    elif has_G and has_nu and not has_E:
        E = 2 * (1 + nu) * G
    return _Isotropic(E, G, nu, rho)


def is_isotropic_solid(deck: NastranDeck, card: NastranCard) -> bool:
    """Return whether a solid has corner grids only, default integration and an isotropic MAT1."""
    if len(card.nonempty(range(2, len(card.fields)))) != len(_corner_fields(card)):
        return False
    holder = deck.group_of(card)
    options = [holder.text(at) for at in (3, 5, 6)]  # IN, ISOP, FCTN
    defaults = (("", "0", "BUBBLE"), ("", "0", "REDUCED"), ("", "SMECH"))
    if any(option not in known for option, known in zip(options, defaults, strict=True)):
        return False
    materials = deck.materials_of(holder)
    if not materials or materials[0].name != "MAT1":
        return False
    solid = _read_isotropic(materials[0])
    if not (solid.E > 0 and solid.G > 0 and -1 < solid.nu < 0.5):
        return False
    return _has_isotropic_shear(solid.E, solid.nu, solid.G)


def _has_isotropic_shear(E: float, nu: float, G: float) -> bool:
    """Return whether a shear modulus is that of an isotropic material."""
    return abs(E / (2 * (1 + nu) * G) - 1) <= DECK.shear_tolerance
