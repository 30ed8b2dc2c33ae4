"""`reflected`: what each part of a drive train is worth at one of its nodes.

With n_i the speed of a shaft over that of the node, all parts being rigid, a stiffness counts k_i
n_i^2 and an inertia J_i n_i^2 there, and the stiffness of a row of parts follows from 1/k = sum
1/(k_i n_i^2) (Friswell, Penny, Garvey & Lees, Dynamics of Rotating Machines, 2010, section 9.6).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from updyn.elements.checks import whole
from updyn.elements.drivetrain.build import Train, assemble
from updyn.elements.drivetrain.pieces import Mass, Part, Spring, Tie, resolve
from updyn.elements.drivetrain.shafts import Shaft
from updyn.errors import ModelError, suggest

__all__ = ["Reflected", "ReflectedPart", "reflected"]

_RIGID = 1e-9  # singular values below this, of rows of length 1, are motions without deformation


@dataclass(frozen=True, slots=True)
class ReflectedPart:
    """A line of the table.

    Attributes
    ----------
    group : str
        Name of its group.
    quantity : {"stiffness", "inertia"}
        What is reflected.
    nodes : tuple of int
        Its nodes.
    own : float
        In `unit`.
    unit : str
        ``N m/rad``, ``N/m`` (along a line) or ``kg m2``.
    ratio : float or None
        Of a stiffness the deformation, in rad or m, for 1 rad at the node that all is reflected to
        while the rest is rigid; of an inertia the speed of its first node over that of the node.
    value : float or None
        Worth at that node, in N m/rad or kg m2; of a stiffness `own` times `ratio` squared. None:
        there is none (one of several meshes that share a planetary stage's load).
    share : float or None
        Of the compliance at the node, or of the inertia there; 0 to 1. None where the node is free
        to turn.
    """

    group: str
    quantity: str
    nodes: tuple[int, ...]
    own: float
    unit: str
    ratio: float | None
    value: float | None
    share: float | None


@dataclass(frozen=True, slots=True)
class Reflected:
    """A drive train as seen from one node; `str` gives a table.

    Attributes
    ----------
    node : int
        Where all is reflected to.
    parts : tuple of ReflectedPart
        Stiffnesses and inertias in the order of the train.
    stiffness : float or None
        Static stiffness at the node in N m/rad, everything counted; of a plain row of parts that is
        1 / sum(1 / value). None: the train is free to turn.
    inertia : float
        Sum of J n^2, in kg m2.
    ratios : mapping of int to float
        Speed of each node over that of the node.
    """

    node: int
    parts: tuple[ReflectedPart, ...]
    stiffness: float | None
    inertia: float
    ratios: dict[int, float]

    def __str__(self) -> str:
        head = ("part", "nodes", "own", "unit", "ratio", f"at node {self.node}", "share")
        lines = [head]
        for quantity, total, unit in (
            ("stiffness", self.stiffness, "N m/rad"),
            ("inertia", self.inertia, "kg m2"),
        ):
            for p in self.parts:
                if p.quantity == quantity:
                    nodes = "-".join(str(n) for n in p.nodes)
                    lines.append(
                        (
                            p.group,
                            nodes,
                            _g(p.own),
                            p.unit,
                            _g(p.ratio),
                            _g(p.value),
                            _percent(p.share),
                        )
                    )
            shown = "free to turn" if total is None else _g(total)
            lines.append((f"total {quantity}", "", "", unit, "", shown, ""))
        widths = [max(len(line[i]) for line in lines) for i in range(len(head))]
        left = (0, 1, 3)
        return "\n".join(_padded(line, widths, left) for line in lines)


def reflected(parts: Iterable[Part], to: int, *, held: Iterable[int] = ()) -> Reflected:
    """Reflect every stiffness and inertia of a drive train to one of its nodes.

    Parameters
    ----------
    parts : iterable of part
        As for `drivetrain`.
    to : int
        The node.
    held : iterable of int
        Nodes that cannot turn, besides what the parts hold: `[1]` for a locked motor at node 1.

    Returns
    -------
    Reflected
        The table, and the static stiffness and the inertia at the node.

    Raises
    ------
    ModelError
        If the node is not there or held, if the ratios to it are not determined (a planetary stage
        none of whose members is held, separate trains), or as `drivetrain`.
    """
    # A shaft's elements are in a row and turn alike: one line of the table stands for them.
    train = assemble([replace(p, n_elements=1) if isinstance(p, Shaft) else p for p in parts], held)
    if whole("reflected", "to", to) not in train.nodes:
        near = suggest(str(to), [str(n) for n in train.nodes])
        raise ModelError(f"reflected: no part has the node {to}; {near}")
    n = _ratios(train, to)
    motion = _under_torque(train, to)
    stiffness = None if motion is None else 1.0 / float(motion[train.nodes.index(to)])
    inertia = sum(_inertia(p, n) for _, p in train.pieces if isinstance(p, Mass))
    rows = []
    for _, piece in train.pieces:
        if isinstance(piece, Spring) and piece.stiffness:
            rows.append(_spring_row(train, piece, to, n, motion))
        elif isinstance(piece, Mass):
            rows.append(_mass_row(piece, n, inertia))
    return Reflected(to, tuple(rows), stiffness, inertia, n)


def _inertia(mass: Mass, n: dict[int, float]) -> float:
    speeds = np.array([n[node] for node in mass.nodes])
    return float(speeds @ mass.matrix @ speeds)


def _mass_row(mass: Mass, n: dict[int, float], total: float) -> ReflectedPart:
    value = _inertia(mass, n)
    own = float(mass.matrix.sum()) if len(mass.nodes) < 3 else float(np.trace(mass.matrix))
    return ReflectedPart(
        mass.group, "inertia", mass.nodes, own, "kg m2", n[mass.nodes[0]], value, value / total
    )


def _spring_row(
    train: Train, spring: Spring, to: int, n: dict[int, float], motion: NDArray[np.float64] | None
) -> ReflectedPart:
    share = None
    if motion is not None:
        at = [train.nodes.index(node) for node in spring.nodes]
        delta = float(np.dot(spring.row, motion[at]))
        share = spring.stiffness * delta**2 / float(motion[train.nodes.index(to)])
    lever = _lever(train, spring, to, n, motion is not None)
    value = None if lever is None else spring.stiffness * lever**2
    unit = "N/m" if spring.along else "N m/rad"
    return ReflectedPart(
        spring.group, "stiffness", spring.nodes, spring.stiffness, unit, lever, value, share
    )


def _lever(
    train: Train, spring: Spring, to: int, n: dict[int, float], resisted: bool
) -> float | None:
    """Return the deformation of a spring for 1 rad at the node, all other parts being rigid."""
    if resisted:
        others = [_row(train, p) for p in train.springs if p is not spring and p.stiffness]
        others += [_row(train, t) for t in train.ties] + [_unit(train, h.node) for h in train.holds]
        A = np.array([*others, _unit(train, to)])
        b = np.zeros(len(A))
        b[-1] = 1.0
        theta = np.linalg.lstsq(A, b, rcond=_RIGID)[0]
        if np.abs(A @ theta - b).max() < 1e-6:
            return abs(float(_row(train, spring, scaled=False) @ theta))
    # One of several ways to the ground, a branch beside the way, or a train that is free: k n^2 of
    # the part itself.
    if len(spring.nodes) > 2:
        return None
    return abs(spring.row[0] * n[spring.nodes[0]])


def _ratios(train: Train, to: int) -> dict[int, float]:
    """Return the speed of each node over that of `to`, all parts being rigid and what anchors the train let go."""
    rigid = [_row(train, p) for p in train.springs if not p.anchor and p.stiffness]
    rigid += [_row(train, t) for t in train.ties if not t.anchor]
    motions = _null(rigid, len(train.nodes))
    for node in _supports(train):
        if motions.shape[1] <= 1:
            break
        if np.abs(motions[train.nodes.index(node)]).max() > _RIGID:
            motions = _null([*rigid, _unit(train, node)], len(train.nodes))
            rigid.append(_unit(train, node))
    here = motions[train.nodes.index(to)]
    if motions.shape[1] == 0 or np.abs(here).max() < _RIGID:
        raise ModelError(f"reflected: node {to} cannot turn; reflect to one that can")
    if motions.shape[1] > 1:
        raise ModelError(
            f"reflected: with all parts rigid the train has {motions.shape[1]} independent motions,"
            " so that its ratios are not determined; hold the fixed member of each planetary stage"
            " and reflect one train at a time"
        )
    ratios = motions[:, 0] / here[0]
    ratios[np.abs(ratios) < _RIGID * np.abs(ratios).max()] = 0.0
    return dict(zip(train.nodes, ratios.tolist(), strict=True))


def _supports(train: Train) -> list[int]:
    """Return nodes whose rest makes the ratios definite: housings, then anchored members of planetary stages."""
    housings = [p.nodes[1] for p in train.springs if p.anchor and len(p.nodes) == 2]
    housings += [t.nodes[1] for t in train.ties if t.anchor]
    anchored = [p.nodes[0] for p in train.springs if p.anchor and p.stiffness]
    anchored += [h.node for h in train.holds] + [t.nodes[0] for t in train.ties if t.anchor]
    passing: list[Spring | Tie] = [*train.springs, *train.ties]
    members = {n for p in passing if not p.anchor and len(p.nodes) > 2 for n in p.nodes}
    return [*dict.fromkeys(housings), *(n for n in dict.fromkeys(anchored) if n in members)]


def _under_torque(train: Train, to: int) -> NDArray[np.float64] | None:
    """Return the rotations in rad per N m at `to`, shape (nodes,); None where nothing resists."""
    follow = resolve(train.ties, train.holds)
    free = [node for node in train.nodes if node not in follow]
    T = np.zeros((len(train.nodes), len(free)))
    for i, node in enumerate(train.nodes):
        for other, c in follow.get(node, {node: 1.0}).items():
            T[i, free.index(other)] = c
    load = T[train.nodes.index(to)]
    if not load.any():
        raise ModelError(f"reflected: node {to} is held; reflect to one that can turn")
    R = np.array(
        [_row(train, p, scaled=False) * np.sqrt(p.stiffness) for p in train.springs if p.stiffness]
    )
    R = R.reshape(-1, len(train.nodes)) @ T
    # Motions that no spring resists (a branch left free) bear no load; where the load works on one,
    # nothing holds it.
    size = np.sqrt((R**2).sum(axis=0))
    size[size == 0.0] = 1.0
    loose = sl.null_space(R / size, rcond=_RIGID) if len(R) else np.eye(len(free))
    if np.abs((load / size) @ loose).max(initial=0.0) > 1e-6 * np.abs(load / size).max():
        return None
    # min |R q|^2 / 2 - load q by least squares on R itself: R^T R would square the condition of a
    # stiff train
    half = np.linalg.lstsq((R / size).T, load / size, rcond=_RIGID)[0]
    q = np.linalg.lstsq(R / size, half, rcond=_RIGID)[0] / size
    return np.asarray(T @ q)


def _row(train: Train, piece: Spring | Tie, scaled: bool = True) -> NDArray[np.float64]:
    out = np.zeros(len(train.nodes))
    out[[train.nodes.index(n) for n in piece.nodes]] = piece.row
    return out / np.linalg.norm(out) if scaled else out


def _unit(train: Train, node: int) -> NDArray[np.float64]:
    out = np.zeros(len(train.nodes))
    out[train.nodes.index(node)] = 1.0
    return out


def _null(rows: Sequence[NDArray[np.float64]], n: int) -> NDArray[np.float64]:
    return np.asarray(sl.null_space(np.array(rows), rcond=_RIGID)) if rows else np.eye(n)


def _padded(cells: Sequence[str], widths: Sequence[int], left: Sequence[int]) -> str:
    shown = (
        c.ljust(w) if i in left else c.rjust(w)
        for i, (c, w) in enumerate(zip(cells, widths, strict=True))
    )
    return "  ".join(shown).rstrip()


def _g(value: float | None) -> str:
    return "-" if value is None else f"{value:.5g}"


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100.0 * share:.1f} %"
