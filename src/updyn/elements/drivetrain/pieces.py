"""Pieces of a drive train: springs, inertias, rigid ratios and holds on the rotations of nodes.

A spring has one deformation, delta = row . theta; its stiffness matrix is k row row^T, which is
positive semi-definite and stores no energy in a motion with row . theta = 0. That motion is the
rigid ratio of the part. `resolve` solves the rigid ratios of a train.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from updyn.elements.checks import not_negative, number, whole
from updyn.errors import ModelError
from updyn.registry import Registry

__all__ = [
    "PARTS",
    "Hold",
    "Mass",
    "Part",
    "Piece",
    "Spring",
    "Tie",
    "lump",
    "quantities",
    "relative",
    "resolve",
    "transmission",
]


_CANCELLED = 1e-9  # of the largest term: what remains of terms that cancel but for rounding


@dataclass(frozen=True, slots=True)
class Spring:
    """A spring and a damper on delta = row . theta.

    Parameters
    ----------
    group : str
        Name of the group.
    nodes : tuple of int
        Nodes whose rotation (rad) deforms it.
    row : tuple of float
        A coefficient for each: 1 for a rotational spring, radii in m for one along a line.
    stiffness, viscous : float
        In N m/rad and N m s/rad, or in N/m and N s/m.
    loss_factor : float
        Structural loss factor.
    anchor : bool
        Whether it ties the train to the ground (or the housing) instead of passing the motion on.
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
    def pattern(self) -> NDArray[np.float64]:
        """Return row row^T, by which stiffness and damping are multiplied."""
        return np.outer(self.row, self.row)


@dataclass(frozen=True, slots=True, eq=False)
class Mass:
    """Inertia of some nodes: kinetic energy theta'^T matrix theta' / 2, the matrix in kg m2."""

    group: str
    nodes: tuple[int, ...]
    matrix: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Tie:
    """A rigid ratio: row . theta = 0, best solved for the node `dependent`."""

    what: str
    nodes: tuple[int, ...]
    row: tuple[float, ...]
    dependent: int
    anchor: bool = False


@dataclass(frozen=True, slots=True)
class Hold:
    """A node that cannot turn."""

    what: str
    node: int

    @property
    def nodes(self) -> tuple[int, ...]:
        """The node."""
        return (self.node,)


Piece: TypeAlias = Spring | Mass | Tie | Hold


class Part(ABC):
    """A part of a drive train: base of `Shaft`, `GearPair` and the others.

    A derived class is a dataclass; its fields are the keys of a row of its table in a job file. It
    is added to `PARTS` by a line ``PARTS.register("table", Kind)``, or by an entry point of the
    group ``updyn.drivetrain_parts``.
    """

    __slots__ = ()

    #: Fields that hold nodes: a number, a sequence of numbers, or None.
    node_fields: ClassVar[tuple[str, ...]] = ("node",)

    name: str

    @property
    def speeds(self) -> tuple[int, int, float] | None:
        """Two nodes and the speed of the first over that of the second; None without a ratio."""
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
            Returns the number of a further node, for each inner node of the part.

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


def lump(group: str, node: int, inertia: float) -> Mass:
    """Return an inertia in kg m2 on one node."""
    return Mass(group, (node,), np.array([[inertia]]))


def quantities(what: str, part: Any) -> tuple[float, float]:
    """Return viscous damping and loss factor of a part after a check.

    Raises
    ------
    ModelError
        If one is not a number of at least 0.
    """
    viscous = not_negative(what, "viscous", part.viscous)
    return viscous, not_negative(what, "loss_factor", part.loss_factor)


def relative(
    what: str,
    nodes: Sequence[int],
    row: Sequence[float],
    housing: int | None,
    housing_factor: float | None = None,
) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Return nodes and row of a deformation relative to a housing that may rotate.

    Parameters
    ----------
    what : str
        The part, for the message.
    nodes : sequence of int
        Its nodes.
    row : sequence of float
        Their coefficients on a housing at rest.
    housing : int or None
        Node of the housing; None: the ground.
    housing_factor : float, optional
        Coefficient of the rotation of the housing that is subtracted. None: the sum of `row`, for
        shafts that are all parallel to its axis.

    Returns
    -------
    nodes, row : tuple
        With the housing, where there is one.

    Raises
    ------
    ModelError
        If a node is not a whole number, or stands twice.
    """
    checked = [whole(what, "node", node) for node in nodes]
    values = [number(what, "coefficient", value) for value in row]
    if housing is not None:
        checked.append(whole(what, "housing", housing))
        if housing_factor is None:
            housing_factor = sum(values)
        values.append(-housing_factor)
    for node in checked:
        if checked.count(node) > 1:
            raise ModelError(f"{what}: node {node} stands twice; expected different nodes")
    return tuple(checked), tuple(values)


def transmission(
    what: str,
    part: Any,
    nodes: Sequence[int],
    row: Sequence[float],
    stiffness: float | None,
    *,
    along: bool = False,
    housing_factor: float | None = None,
) -> Spring | Tie:
    """Return the spring or, without stiffness, the rigid ratio of a part that passes motion on.

    Parameters
    ----------
    what : str
        The part, for messages.
    part : object
        With `name`, `viscous`, `loss_factor` and `housing`.
    nodes, row : sequence
        The deformation; where rigid the second node depends on the others.
    stiffness : float or None
        In N m/rad, or N/m with `along`; None: rigid.
    along : bool
        Whether the deformation is a length.
    housing_factor : float, optional
        See `relative`.

    Returns
    -------
    Spring or Tie

    Raises
    ------
    ModelError
        If a number is not usable, or a rigid part has damping.
    """
    every, values = relative(what, nodes, row, part.housing, housing_factor)
    viscous, loss = quantities(what, part)
    if stiffness is not None:
        return Spring(part.name, every, values, stiffness, viscous, loss, along=along)
    if viscous or loss:
        raise ModelError(
            f"{what} is rigid: its damping would have no effect; leave it out or give a stiffness"
        )
    return Tie(what, every, values, every[1])


def resolve(
    ties: Iterable[Tie], holds: Iterable[Hold], keep: Iterable[int] = ()
) -> dict[int, dict[int, float]]:
    """Solve the rigid ratios for the nodes that follow others.

    Gauss-Jordan elimination in the order of the train: the ratios first, then the holds, so that
    wheels whose ratios contradict each other are told from wheels that a hold stops.

    Parameters
    ----------
    ties : iterable of Tie
        The rigid ratios. One that the others imply is no contradiction.
    holds : iterable of Hold
        Nodes that cannot turn.
    keep : iterable of int
        Nodes that do not follow.

    Returns
    -------
    dict of int to dict of int to float
        For each node that follows, coefficients by node that follows none; empty: it is at rest.

    Raises
    ------
    ModelError
        If ratios contradict each other, or a node to be kept has to follow.
    """
    kept = set(keep)
    known: dict[int, dict[int, float]] = {}
    # Anchors come last: they may stop what the other ratios connect.
    for tie in sorted(ties, key=lambda t: t.anchor):
        row = _substituted(dict(zip(tie.nodes, tie.row, strict=True)), known)
        if len(row) == 1 and not tie.anchor:
            raise ModelError(
                f"{tie.what}: with the rigid ratios before it node {next(iter(row))} cannot turn:"
                " their ratios contradict each other; correct one, or give one a stiffness"
            )
        _eliminate(tie.what, row, tie.dependent, kept, known)
    for hold in holds:
        _eliminate(hold.what, _substituted({hold.node: 1.0}, known), hold.node, kept, known)
    return known


def _substituted(row: dict[int, float], known: dict[int, dict[int, float]]) -> dict[int, float]:
    """Return an equation in the nodes that follow none; terms that cancel are left out."""
    total: dict[int, float] = {}
    largest: dict[int, float] = {}
    for node, factor in row.items():
        for other, coefficient in known.get(node, {node: 1.0}).items():
            term = factor * coefficient
            total[other] = total.get(other, 0.0) + term
            largest[other] = max(largest.get(other, 0.0), abs(term))
    return {node: c for node, c in total.items() if abs(c) > _CANCELLED * largest[node]}


def _eliminate(
    what: str,
    row: dict[int, float],
    wanted: int,
    kept: set[int],
    known: dict[int, dict[int, float]],
) -> None:
    """Solve an equation for one of its nodes, the wanted one if possible, and update `known`."""
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
            known[follower] = _substituted(terms, {node: known[node]})
