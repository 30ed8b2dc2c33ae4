"""`reflected`: stiffnesses and inertias of a drive train, reflected to one of its nodes.

With n_i the speed ratio of a shaft to the node, a stiffness k_i is reflected as k_i n_i^2 and an
inertia J_i as J_i n_i^2. The stiffness of a series follows from 1/k = sum 1/(k_i n_i^2) (Friswell,
Penny, Garvey & Lees, Dynamics of Rotating Machines, 2010, section 9.6).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sl

from updyn.arrays import RealArray
from updyn.elements.checks import check_whole
from updyn.elements.drivetrain.build import Train, assemble
from updyn.elements.drivetrain.pieces import (
    InertiaMatrix,
    Part,
    RigidRatio,
    TorsionSpring,
    solve_ratios,
)
from updyn.elements.drivetrain.shafts import Shaft
from updyn.elements.settings import ELEMENT, TRAIN
from updyn.errors import ModelError, suggest
from updyn.text_table import text_table

__all__ = ["Reflected", "ReflectedPart", "reflected"]


@dataclass(frozen=True, slots=True)
class ReflectedPart:
    """A row of the table of reflected parts.

    Attributes
    ----------
    group : str
        Name of its group.
    quantity : {"stiffness", "inertia"}
        The reflected quantity.
    nodes : tuple of int
        Nodes of the part.
    own : float
        Value of the part in `unit`.
    unit : str
        ``N m/rad``, ``N/m`` (along a line) or ``kg m2``.
    ratio : float or None
        For a stiffness, the deformation in rad or m for 1 rad at the node of the table with all
        other parts rigid; for an inertia, the speed ratio of its first node to that node.
    value : float or None
        Value at that node in N m/rad or kg m2; for a stiffness, `own` times `ratio` squared. None
        if undefined (one of several meshes that share the load of a planetary stage).
    share : float or None
        Share of the compliance or the inertia at the node, 0 to 1. None if the node is free to
        turn, or turns no inertia.
    """

    group: str
    quantity: str
    nodes: tuple[int, ...]
    own: float
    unit: str
    ratio: float | None
    value: float | None
    share: float | None

    def cells(self) -> list[str]:
        """Return the cells of a row in the table of `Reflected`."""
        nodes = "-".join(map(str, self.nodes))
        share = "-" if self.share is None else f"{100.0 * self.share:.1f} %"
        ratio = _number(self.ratio)
        return [self.group, nodes, _number(self.own), self.unit, ratio, _number(self.value), share]


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.5g}"


@dataclass(frozen=True, slots=True)
class Reflected:
    """A drive train reflected to one node; `str` gives a table.

    Attributes
    ----------
    node : int
        Node to which all quantities are reflected.
    parts : tuple of ReflectedPart
        Stiffnesses and inertias in the order of the train.
    stiffness : float or None
        Static stiffness at the node in N m/rad; for a simple series of parts 1 / sum(1 / value).
        None if the train is free to turn.
    inertia : float
        Sum of J n^2, in kg m2.
    ratios : mapping of int to float
        Speed ratio of each node to the node.
    """

    node: int
    parts: tuple[ReflectedPart, ...]
    stiffness: float | None
    inertia: float
    ratios: dict[int, float]

    def __str__(self) -> str:
        header = ["part", "nodes", "own", "unit", "ratio", f"at node {self.node}", "share"]
        rows = [part.cells() for part in self.parts if part.quantity == "stiffness"]
        stiffness = "free to turn" if self.stiffness is None else _number(self.stiffness)
        rows.append(["total stiffness", "", "", "N m/rad", "", stiffness, ""])
        rows += [part.cells() for part in self.parts if part.quantity == "inertia"]
        rows.append(["total inertia", "", "", "kg m2", "", _number(self.inertia), ""])
        return text_table(header, rows, left=(0, 1, 3))


def reflected(parts: Iterable[Part], to: int, *, held: Iterable[int] = ()) -> Reflected:
    """Reflect every stiffness and inertia of a drive train to one of its nodes.

    Parameters
    ----------
    parts : iterable of part
        As for `drivetrain`.
    to : int
        The node.
    held : iterable of int
        Further fixed nodes in addition to those fixed by parts: `[1]` for a locked motor at node
        1.

    Returns
    -------
    Reflected
        The table, and the static stiffness and the inertia at the node.

    Raises
    ------
    ModelError
        If the node is unknown or fixed, if the ratios to it are undetermined (a planetary stage
        without a fixed member, separate trains), or as `drivetrain`.
    """
    train = _RigidTrain(assemble(_with_single_shafts(parts), held))
    if check_whole("reflected", "to", to) not in train.nodes:
        near = suggest(str(to), map(str, train.nodes))
        raise ModelError(f"reflected: no part has the node {to}; {near}")
    speeds = train.speeds(to)
    motion = train.under_torque(to)
    inertia = sum(_inertia(mass, speeds) for mass in train.train.masses)
    rows = []
    for _, piece in train.train.pieces:
        if isinstance(piece, TorsionSpring) and piece.stiffness:
            rows.append(_spring_row(train, piece, to, speeds, motion))
        elif isinstance(piece, InertiaMatrix):
            rows.append(_mass_row(piece, speeds, inertia))
    stiffness = None
    if motion is not None:
        stiffness = 1.0 / motion[to]
    return Reflected(to, tuple(rows), stiffness, inertia, speeds)


def _with_single_shafts(parts: Iterable[Part]) -> list[Part]:
    """Return the parts with one element per shaft: its elements in series turn equally."""
    out = []
    for part in parts:
        if isinstance(part, Shaft):
            part = replace(part, n_elements=1)
        out.append(part)
    return out


def _inertia(mass: InertiaMatrix, speeds: Mapping[int, float]) -> float:
    n = np.array([speeds[node] for node in mass.nodes])
    return float(n @ mass.matrix @ n)


def _mass_row(mass: InertiaMatrix, speeds: Mapping[int, float], total: float) -> ReflectedPart:
    value = _inertia(mass, speeds)
    inertia = float(np.trace(mass.matrix))
    if len(mass.nodes) < 3:
        inertia = float(mass.matrix.sum())
    ratio = speeds[mass.nodes[0]]
    share = value / total if total else None
    return ReflectedPart(mass.group, "inertia", mass.nodes, inertia, "kg m2", ratio, value, share)


def _spring_row(
    train: _RigidTrain,
    spring: TorsionSpring,
    to: int,
    speeds: Mapping[int, float],
    motion: Mapping[int, float] | None,
) -> ReflectedPart:
    share = None
    if motion is not None:
        delta = float(np.dot(spring.row, [motion[node] for node in spring.nodes]))
        share = spring.stiffness * delta**2 / motion[to]
    ratio = None
    if motion is not None:
        ratio = train.deformation(spring, to)
    if ratio is None and len(spring.nodes) <= 2:
        # One of several paths to the ground, a branch, or a free train: k n^2 of the part alone.
        ratio = abs(spring.row[0] * speeds[spring.nodes[0]])
    value = None
    if ratio is not None:
        value = spring.stiffness * ratio**2
    unit = "N/m" if spring.along else "N m/rad"
    return ReflectedPart(
        spring.group, "stiffness", spring.nodes, spring.stiffness, unit, ratio, value, share
    )


class _RigidTrain:
    """Motions of a train with rigid parts, and its static deformation."""

    def __init__(self, train: Train) -> None:
        self.train = train
        self.nodes = train.nodes
        self._place = {node: i for i, node in enumerate(train.nodes)}

    def deformation(self, spring: TorsionSpring, to: int) -> float | None:
        """Return the deformation for 1 rad at a node of the rigid train; None if it cannot turn."""
        others = [self._row(s) for s in self.train.springs if s is not spring and s.stiffness]
        others += [self._row(tie) for tie in self.train.rigid_ratios]
        others += [self._unit(hold.node) for hold in self.train.fixed_nodes]
        A = np.array([*others, self._unit(to)])
        b = np.zeros(len(A))
        b[-1] = 1.0
        theta = np.linalg.lstsq(A, b, rcond=ELEMENT.rounding)[0]
        if np.abs(A @ theta - b).max() >= TRAIN.solvable_residual:
            return None
        return abs(float(self._coefficients(spring) @ theta))

    def speeds(self, to: int) -> dict[int, float]:
        """Return the speed ratio of each node to `to`, with rigid parts and all anchors free."""
        rigid = [self._row(s) for s in self.train.springs if not s.anchor and s.stiffness]
        rigid += [self._row(tie) for tie in self.train.rigid_ratios if not tie.anchor]
        motions = self._null_space(rigid)
        for node in self._supports():
            if motions.shape[1] <= 1:
                break
            if np.abs(motions[self._place[node]]).max() > ELEMENT.rounding:
                rigid.append(self._unit(node))
                motions = self._null_space(rigid)
        motion_at_node = motions[self._place[to]]
        if motions.shape[1] == 0 or np.abs(motion_at_node).max() < ELEMENT.rounding:
            raise ModelError(f"reflected: node {to} cannot turn; reflect to one that can")
        if motions.shape[1] > 1:
            raise ModelError(
                f"reflected: with all parts rigid the train has {motions.shape[1]} independent"
                " motions, so that its ratios are not determined; hold the fixed member of each"
                " planetary stage and reflect one train at a time"
            )
        ratios = motions[:, 0] / motion_at_node[0]
        ratios[np.abs(ratios) < ELEMENT.rounding * np.abs(ratios).max()] = 0.0
        return dict(zip(self.nodes, ratios.tolist(), strict=True))

    def _supports(self) -> list[int]:
        """Return nodes to fix until the ratios are determined: housings, then planetary anchors."""
        springs = self.train.springs
        rigid_ratios = self.train.rigid_ratios
        housings = [s.nodes[1] for s in springs if s.anchor and len(s.nodes) == 2]
        housings += [tie.nodes[1] for tie in rigid_ratios if tie.anchor]
        anchored = [s.nodes[0] for s in springs if s.anchor and s.stiffness]
        anchored += [hold.node for hold in self.train.fixed_nodes]
        anchored += [tie.nodes[0] for tie in rigid_ratios if tie.anchor]
        members: set[int] = set()
        passing: list[TorsionSpring | RigidRatio] = [*springs, *rigid_ratios]
        for piece in passing:
            if not piece.anchor and len(piece.nodes) > 2:
                members.update(piece.nodes)
        housings = list(dict.fromkeys(housings))
        return housings + [node for node in dict.fromkeys(anchored) if node in members]

    def under_torque(self, to: int) -> dict[int, float] | None:
        """Return the rotations of all nodes in rad per N m at `to`; None if nothing resists."""
        T, free = self._transformation()
        load = T[self._place[to]]
        if not load.any():
            raise ModelError(f"reflected: node {to} is held; reflect to one that can turn")
        rows = []
        for spring in self.train.springs:
            if spring.stiffness:
                rows.append(self._coefficients(spring) * np.sqrt(spring.stiffness))
        R = np.array(rows).reshape(-1, len(self.nodes)) @ T
        size = np.sqrt((R**2).sum(axis=0))
        size[size == 0.0] = 1.0
        # A motion that no spring resists carries no load: if the load does work on one, nothing
        # resists it.
        loose = np.eye(free)
        if len(R):
            loose = sl.null_space(R / size, rcond=ELEMENT.rounding)
        work = np.abs((load / size) @ loose).max(initial=0.0)
        if work > TRAIN.solvable_residual * np.abs(load / size).max():
            return None
        # Minimise |R q|^2 / 2 - load q by least squares on R itself: R^T R would square the
        # condition number of a stiff train.
        half = np.linalg.lstsq((R / size).T, load / size, rcond=ELEMENT.rounding)[0]
        q = np.linalg.lstsq(R / size, half, rcond=ELEMENT.rounding)[0] / size
        return dict(zip(self.nodes, (T @ q).tolist(), strict=True))

    def _transformation(self) -> tuple[RealArray, int]:
        """Return all rotations from the free ones, shape (nodes, free), and their number."""
        follow = solve_ratios(self.train.rigid_ratios, self.train.fixed_nodes)
        free = [node for node in self.nodes if node not in follow]
        T = np.zeros((len(self.nodes), len(free)))
        for i, node in enumerate(self.nodes):
            for other, coefficient in follow.get(node, {node: 1.0}).items():
                T[i, free.index(other)] = coefficient
        return T, len(free)

    def _coefficients(self, piece: TorsionSpring | RigidRatio) -> RealArray:
        out = np.zeros(len(self.nodes))
        for node, coefficient in zip(piece.nodes, piece.row, strict=True):
            out[self._place[node]] = coefficient
        return out

    def _row(self, piece: TorsionSpring | RigidRatio) -> RealArray:
        """Return the coefficients of a piece, normalised to length 1."""
        row = self._coefficients(piece)
        return row / np.linalg.norm(row)

    def _unit(self, node: int) -> RealArray:
        out = np.zeros(len(self.nodes))
        out[self._place[node]] = 1.0
        return out

    def _null_space(self, rows: Sequence[RealArray]) -> RealArray:
        if not rows:
            return np.eye(len(self.nodes))
        return np.asarray(sl.null_space(np.array(rows), rcond=ELEMENT.rounding))
