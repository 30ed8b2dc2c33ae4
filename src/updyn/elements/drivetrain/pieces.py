"""Pieces of a drive train: springs, inertias, rigid ratios and fixed nodes.

A spring has one deformation, delta = row . theta; its stiffness matrix is k row row^T. Motions with
row . theta = 0 satisfy the rigid ratio of the part.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias

import numpy as np

from updyn.arrays import RealArray
from updyn.elements.checks import check_not_negative, check_number, check_whole
from updyn.elements.settings import ELEMENT
from updyn.errors import ModelError
from updyn.registry import Registry

__all__ = [
    "PARTS",
    "FixedNode",
    "InertiaMatrix",
    "Part",
    "Piece",
    "RigidRatio",
    "TorsionSpring",
    "check_damping",
    "lump_inertia",
    "make_transmission",
    "relative_deformation",
    "solve_ratios",
]


@dataclass(frozen=True, slots=True)
class TorsionSpring:
    """A spring and a damper on delta = row . theta.

    Parameters
    ----------
    group : str
        Name of the group.
    nodes : tuple of int
        Nodes whose rotation (rad) deforms it.
    row : tuple of float
        Coefficient of each node: 1 for a rotational spring, radii in m for a spring along a line.
    stiffness, viscous : float
        Stiffness and damping in N m/rad and N m s/rad, or in N/m and N s/m.
    loss_factor : float
        Structural loss factor.
    anchor : bool
        Whether it connects the train to the ground (or housing) instead of transmitting motion.
    along : bool
        Whether delta is a length in m.
    """

    group: str
    nodes: tuple[int, ...]
    row: tuple[float, ...]
    stiffness: float
    viscous: float = 0.0
    loss_factor: float = 0.0
    anchor: bool = False
    along: bool = False

    @property
    def pattern(self) -> RealArray:
        """Matrix row row^T, which stiffness and damping multiply."""
        return np.outer(self.row, self.row)


@dataclass(frozen=True, slots=True, eq=False)
class InertiaMatrix:
    """Inertia of nodes: kinetic energy theta'^T matrix theta' / 2, with the matrix in kg m2."""

    group: str
    nodes: tuple[int, ...]
    matrix: RealArray


@dataclass(frozen=True, slots=True)
class RigidRatio:
    """A rigid ratio: row . theta = 0, solved for the node `dependent` if possible."""

    what: str
    nodes: tuple[int, ...]
    row: tuple[float, ...]
    dependent: int
    anchor: bool = False


@dataclass(frozen=True, slots=True)
class FixedNode:
    """A node with fixed rotation."""

    what: str
    node: int

    @property
    def nodes(self) -> tuple[int, ...]:
        """The node."""
        return (self.node,)


Piece: TypeAlias = TorsionSpring | InertiaMatrix | RigidRatio | FixedNode


class Part(ABC):
    """A part of a drive train: base of `Shaft`, `GearPair` and the others.

    A derived class is a dataclass; its fields are the keys of a row of its table in a job file.
    Register it with ``PARTS.register("table", Kind)``, or by an entry point of the group
    ``updyn.drivetrain_parts``.
    """

    __slots__ = ()

    #: Fields with nodes: a number, a sequence of numbers, or None.
    node_fields: ClassVar[tuple[str, ...]] = ("node",)

    name: str

    @property
    def speeds(self) -> tuple[int, int, float] | None:
        """Two nodes and the speed ratio of the first to the second; None without a ratio."""
        return None

    def inverted(self) -> Part:
        """Return the part with the inverse of its ratio; a part without a ratio is unchanged."""
        return self

    @abstractmethod
    def pieces(self, new_node: Callable[[], int]) -> list[Piece]:
        """Return the pieces of the part.

        Parameters
        ----------
        new_node : callable
            Function that returns the number of a new node, for each inner node of the part.

        Returns
        -------
        list of Piece
        """


#: Kinds of parts by the name of their array of tables in a job file.
PARTS: Registry[type[Part]] = Registry(
    "part",
    "updyn.drivetrain_parts",
    {
        "motors": "updyn.elements.drivetrain.shafts:Motor",
        "brakes": "updyn.elements.drivetrain.shafts:Brake",
        "inertias": "updyn.elements.drivetrain.shafts:Inertia",
        "shafts": "updyn.elements.drivetrain.shafts:Shaft",
        "couplings": "updyn.elements.drivetrain.shafts:Coupling",
        "gear_pairs": "updyn.elements.drivetrain.gears:GearPair",
        "planetaries": "updyn.elements.drivetrain.gears:Planetary",
        "worms": "updyn.elements.drivetrain.gears:Worm",
        "belts": "updyn.elements.drivetrain.gears:Belt",
        "dual_drives": "updyn.elements.drivetrain.gears:DualDrive",
        "grounds": "updyn.elements.drivetrain.shafts:Ground",
    },
)


def lump_inertia(group: str, node: int, inertia: float) -> InertiaMatrix:
    """Return an inertia in kg m2 on one node."""
    return InertiaMatrix(group, (node,), np.array([[inertia]]))


def check_damping(what: str, part: Any) -> tuple[float, float]:
    """Return viscous damping and loss factor of a part, checked to be numbers of at least 0."""
    viscous = check_not_negative(what, "viscous", part.viscous)
    return viscous, check_not_negative(what, "loss_factor", part.loss_factor)


def relative_deformation(
    what: str,
    nodes: Sequence[int],
    row: Sequence[float],
    housing: int | None,
    housing_factor: float | None = None,
) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Return nodes and row of a deformation relative to a housing that may rotate.

    `row` are the coefficients for a housing at rest; `housing_factor` is by default their sum, for
    shafts parallel to the axis of the housing.
    """
    checked = [check_whole(what, "node", node) for node in nodes]
    values = [check_number(what, "coefficient", value) for value in row]
    if housing is not None:
        checked.append(check_whole(what, "housing", housing))
        if housing_factor is None:
            housing_factor = sum(values)
        values.append(-housing_factor)
    for node in checked:
        if checked.count(node) > 1:
            raise ModelError(f"{what}: node {node} occurs twice; expected different nodes")
    return tuple(checked), tuple(values)


def make_transmission(
    what: str,
    part: Any,
    nodes: Sequence[int],
    row: Sequence[float],
    stiffness: float | None,
    *,
    along: bool = False,
    housing_factor: float | None = None,
) -> TorsionSpring | RigidRatio:
    """Return the spring or, without stiffness, the rigid ratio of a part that transmits motion."""
    # The second node of a rigid ratio is the dependent one.
    every, values = relative_deformation(what, nodes, row, part.housing, housing_factor)
    viscous, loss = check_damping(what, part)
    if stiffness is not None:
        return TorsionSpring(part.name, every, values, stiffness, viscous, loss, along=along)
    if viscous or loss:
        raise ModelError(
            f"{what} is rigid: its damping would have no effect; leave it out or give a stiffness"
        )
    return RigidRatio(what, every, values, every[1])


def solve_ratios(
    ties: Iterable[RigidRatio], holds: Iterable[FixedNode], keep: Iterable[int] = ()
) -> dict[int, dict[int, float]]:
    """Solve the rigid ratios for the dependent nodes: their coefficients by independent node.

    Nodes in `keep` remain independent. A node at rest has no coefficients.
    """
    # Gauss-Jordan elimination, first the ratios, then the fixed nodes, to distinguish
    # contradicting ratios from wheels that are fixed.
    kept = set(keep)
    known: dict[int, dict[int, float]] = {}
    # Anchors come last: they may fix nodes that the other ratios connect.
    for tie in sorted(ties, key=lambda t: t.anchor):
        row = _substitute(dict(zip(tie.nodes, tie.row, strict=True)), known)
        if len(row) == 1 and not tie.anchor:
            raise ModelError(
                f"{tie.what}: with the rigid ratios before it node {next(iter(row))} cannot turn:"
                " their ratios contradict each other; correct one, or give one a stiffness"
            )
        _eliminate(tie.what, row, tie.dependent, kept, known)
    for hold in holds:
        _eliminate(hold.what, _substitute({hold.node: 1.0}, known), hold.node, kept, known)
    return known


def _substitute(row: dict[int, float], known: dict[int, dict[int, float]]) -> dict[int, float]:
    """Return an equation in the independent nodes, without terms that cancel."""
    total: dict[int, float] = {}
    largest: dict[int, float] = {}
    for node, factor in row.items():
        for other, coefficient in known.get(node, {node: 1.0}).items():
            term = factor * coefficient
            total[other] = total.get(other, 0.0) + term
            largest[other] = max(largest.get(other, 0.0), abs(term))
    return {node: c for node, c in total.items() if abs(c) > ELEMENT.rounding * largest[node]}


def _eliminate(
    what: str,
    row: dict[int, float],
    wanted: int,
    kept: set[int],
    known: dict[int, dict[int, float]],
) -> None:
    """Solve an equation for one of its nodes, preferably the wanted one, and update `known`."""
    if not row:
        return
    free = [node for node in row if node not in kept]
    if not free:
        nodes = ", ".join(map(str, sorted(row)))
        raise ModelError(
            f"{what} ties node {nodes}, all of which are to be kept; leave one out of keep"
        )
    node = wanted if wanted in free else free[-1]
    pivot = row.pop(node)
    known[node] = {other: -c / pivot for other, c in row.items()}
    for follower, terms in list(known.items()):
        if node in terms:
            known[follower] = _substitute(terms, {node: known[node]})
