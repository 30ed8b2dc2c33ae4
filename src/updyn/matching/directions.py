"""Sensors that point anywhere: the DOFs of their node are turned until each sensor is one of them.

At a node with the translations u, sensors and forces along a_1, a_2, a_3 (of length 1, independent)
get the DOFs q_k = a_k . u, so that u = B q with B the inverse of the matrix A whose rows are a_k. A
force f along a_k does the work f q_k, so that it is a force on q_k alone: this holds whether or not
the directions are at right angles. All groups follow as T^T K T with T = B at that node, one
elsewhere (Cook, Malkus, Plesha & Witt, Concepts and Applications of Finite Element Analysis, 4th
ed. 2002, chapter 8). It is exact: nothing is interpolated, and the model stays a sum of its groups.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from updyn.dofs import DIRECTIONS, Dof
from updyn.errors import DofError
from updyn.geometry import Geometry
from updyn.matching.result import EXACT, SHOWN, MatchError, listed, vector_text
from updyn.model import Group, Matrix, Model

__all__ = ["Aim", "Seat", "seat"]

_NEARLY = 10.0  # degrees off a DOF up to which a message says how to take a sensor along it
_APART = 1.0  # degrees below which two directions are too much alike to be two DOFs
_INDEPENDENT = 0.01  # smallest singular value of the directions at a node
_RIGHT_ANGLES = 5e-5  # within what a geometry takes for orthonormal


@dataclass(frozen=True, slots=True, eq=False)
class Aim:
    """Where a sensor sits in the model, and where it points.

    Attributes
    ----------
    sensor : Dof
        Its label in the measurement, positive.
    role : str
        What it is there.
    dof : Dof
        Node in the model, with the direction and the sense that the label says.
    vector : ndarray of float, shape (3,), or None
        Direction in the global system of the model, of length 1; None: that of `dof`, as the model
        has it.
    """

    sensor: Dof
    role: str
    dof: Dof
    vector: NDArray[np.float64] | None = None


@dataclass(frozen=True, slots=True)
class Seat:
    """The DOF of a sensor.

    Attributes
    ----------
    dof : Dof
        In the model that `seat` returns, with the sense of the sensor.
    angle : float
        Degrees between the sensor and that DOF before it was turned.
    turned : bool
        Whether it was turned.
    """

    dof: Dof
    angle: float
    turned: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Local:
    """An aim in the directions of its node: `part` 0 for translations, 3 for rotations."""

    aim: Aim
    part: int
    vector: NDArray[np.float64]
    angle: float

    @property
    def oblique(self) -> bool:
        return bool(np.count_nonzero(self.vector) > 1)


def seat(
    model: Model, aims: Sequence[Aim], angle: float = EXACT
) -> tuple[Model, list[Seat], list[str]]:
    """Give each sensor a DOF, turning the DOFs of nodes with oblique ones.

    Parameters
    ----------
    model : Model
        The structure.
    aims : sequence of Aim
        The sensors and forces.
    angle : float
        Degrees within which a sensor is taken to point along a DOF.

    Returns
    -------
    model : Model
        With turned DOFs where that was needed, else the same object. Labels stay; `Geometry.axes`
        tells of turned nodes whose directions are at right angles, the title of the others.
    seats : list of Seat
        As `aims`.
    notes : list of str
        On DOFs that the geometry cannot tell.

    Raises
    ------
    MatchError
        If the model lacks a DOF, or the directions at one node are too many or too much alike.
    """
    frames = _frames(model, {a.dof.node for a in aims})
    have = _present(model, frames)
    locals_: list[_Local] = []
    lost: dict[str, str] = {}
    for aim in aims:
        found = _local(model, aim, frames[aim.dof.node], have[aim.dof.node], angle)
        if isinstance(found, str):
            lost[str(aim.sensor)] = found
        else:
            locals_.append(found)
    if lost:
        raise MatchError(
            f"{len(lost)} of the sensors and forces of the measurement are not DOFs of the model:"
            + listed(list(lost.values())),
            lost=list(lost),
        )
    at: dict[int, list[_Local]] = {}
    for found in locals_:
        at.setdefault(found.aim.dof.node, []).append(found)
    bases = {
        n: _basis(n, group, have[n]) for n, group in at.items() if any(f.oblique for f in group)
    }
    seats = [_seat(f, bases.get(f.aim.dof.node)) for f in locals_]
    if not bases:
        return model, seats, []
    turned, notes = _turned(model, bases, frames, have)
    return turned, seats, notes


# -- one sensor --------------------------------------------------------------------------------------------
def _frames(model: Model, nodes: Iterable[int]) -> dict[int, NDArray[np.float64]]:
    """Return the displacement directions of nodes, as rows."""
    out = {n: np.eye(3) for n in nodes}
    if model.geometry is not None and model.geometry.axes is not None:
        for row in np.flatnonzero(np.isin(model.geometry.nodes, list(out))):
            out[int(model.geometry.nodes[row])] = model.geometry.axes[row]
    return out


def _present(model: Model, nodes: Iterable[int]) -> dict[int, tuple[int, ...]]:
    """Return which of the six directions nodes have."""
    out: dict[int, list[int]] = {n: [] for n in nodes}
    for row in np.flatnonzero(np.isin(model.dofs.nodes, list(out))):
        out[int(model.dofs.nodes[row])].append(int(model.dofs.axes[row]))
    return {n: tuple(sorted(a)) for n, a in out.items()}


def _local(
    model: Model, aim: Aim, frame: NDArray[np.float64], have: tuple[int, ...], angle: float
) -> _Local | str:
    """Return the sensor in the directions of its node, or why it cannot be there."""
    axis = DIRECTIONS.index(aim.dof.direction)
    part = 3 * (axis // 3)
    along = np.zeros(3)
    if aim.vector is None or not any(a // 3 == part // 3 for a in have):
        if axis not in have:
            return _not_there(model, aim)
        along[axis % 3] = aim.dof.sign
        return _Local(aim, part, along, 0.0)
    c = frame @ aim.vector
    here = np.array([part + k in have for k in range(3)])
    k = int(np.argmax(np.where(here, np.abs(c), -1.0)))
    along[k] = np.copysign(1.0, c[k])
    off = float(np.degrees(np.arctan2(np.linalg.norm(np.delete(c, k)), abs(c[k]))))
    if off <= max(angle, EXACT):
        return _Local(aim, part, along, off)
    missing = float(np.linalg.norm(c[~here]))
    if missing > np.sin(np.radians(EXACT)):
        names = ", ".join(f"{aim.dof.node}:{DIRECTIONS[a]}" for a in have)
        return (
            f"{aim.role} {aim.sensor} along {vector_text(aim.vector)} is {off:.3g} degrees off"
            f" {aim.dof.node}:{DIRECTIONS[part + k]}, and a part of {missing:.3g} is along what"
            f" node {aim.dof.node} of the model lacks; it has {names}"
            + (f"; with angle = {np.ceil(off):g} it is taken along that" if off <= _NEARLY else "")
        )
    c = np.where(here, c, 0.0)
    return _Local(aim, part, c / np.linalg.norm(c), off)


def _not_there(model: Model, aim: Aim) -> str:
    try:
        model.dofs.match([aim.dof if aim.dof.sign > 0 else -aim.dof], aim.role)
    except DofError as error:
        moved = (aim.dof.node, aim.dof.direction) != (aim.sensor.node, aim.sensor.direction)
        return f"{aim.sensor}: {error}" if moved else str(error)
    raise AssertionError(aim.dof)


# -- one node ----------------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True, eq=False)
class _Basis:
    """New directions of a node, as rows in its old ones: of translations (0) and rotations (3).

    `one` says whether both are the same three directions at right angles.
    """

    rows: Mapping[int, NDArray[np.float64]]
    one: bool


def _basis(node: int, found: Sequence[_Local], have: tuple[int, ...]) -> _Basis:
    here = {part: np.array([part + k in have for k in range(3)]) for part in (0, 3)}
    parts = {
        part: _distinct(node, [f for f in found if f.part == part], here[part]) for part in (0, 3)
    }
    both = _merged([*parts[0], *parts[3]])
    together = np.array([f.vector for f in both])
    if len(both) <= 3 and np.abs(together @ together.T - np.eye(len(both))).max() < _RIGHT_ANGLES:
        A = _completed(both, np.ones(3, dtype=np.bool_))
        # A direction that the node lacks must not mix with those it has: a planar model stays
        # planar.
        if all(
            not A[np.ix_(h, ~h)].any() and not A[np.ix_(~h, h)].any()
            for h in here.values()
            if h.any()
        ):
            return _Basis({0: A, 3: A}, one=True)
    rows = {
        part: _completed(group, here[part]) if any(f.oblique for f in group) else np.eye(3)
        for part, group in parts.items()
    }
    return _Basis(rows, one=False)


def _merged(found: Sequence[_Local]) -> list[_Local]:
    """Return one of those that are parallel; first the ones along a DOF, which stay as they are."""
    kept: list[_Local] = []
    for one in sorted(found, key=lambda f: f.oblique):
        if all(_between(one.vector, other.vector) > EXACT for other in kept):
            kept.append(one)
    return kept


def _between(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Return the angle between two lines in degrees."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), abs(a @ b))))


def _distinct(node: int, found: Sequence[_Local], here: NDArray[np.bool_]) -> list[_Local]:
    """Return the different directions at a node, checked to be independent."""
    kept = _merged(found)
    if not any(f.oblique for f in kept):
        return kept
    named = listed([f"{f.aim.role} {f.aim.sensor} along {vector_text(f.vector)}" for f in kept])
    for i, one in enumerate(kept):
        for other in kept[:i]:
            if (apart := _between(one.vector, other.vector)) < _APART:
                raise MatchError(
                    f"{one.aim.sensor} and {other.aim.sensor} at node {node} of the model point"
                    f" {apart:.2g} degrees apart: too much alike for two DOFs, and more than the"
                    f" {EXACT:g} degrees within which they are one; give both the same direction,"
                    " or leave one out",
                    ("directions",),
                )
    if len(kept) > here.sum():
        raise MatchError(
            f"sensors and forces at node {node} of the model point in {len(kept)} directions, of"
            f" which it has {int(here.sum())}; keep as many, or give the others another"
            f" node:{named}",
            ("directions",),
        )
    smallest = np.linalg.svd(np.array([f.vector for f in kept]), compute_uv=False)[-1]
    if smallest < _INDEPENDENT:
        raise MatchError(
            f"sensors and forces at node {node} of the model point in {len(kept)} directions of one"
            f" plane: the last is a sum of the others; leave one out:{named}",
            ("directions",),
        )
    return kept


def _completed(kept: Sequence[_Local], here: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return three directions as rows: those given, then what is at right angles to them, each by its nearest name."""
    vectors = [f.vector for f in kept]
    names = [DIRECTIONS.index(f.aim.dof.direction) % 3 for f in kept]
    axes = np.flatnonzero(here).tolist()
    span = np.linalg.qr(np.array(vectors).T)[0] if vectors else np.empty((3, 0))
    while len(vectors) < len(axes):
        rest = np.eye(3)[axes] - (np.eye(3)[axes] @ span) @ span.T
        size = np.round(np.linalg.norm(rest, axis=1), 12)  # a tie goes to the first
        new = rest[int(np.argmax(size))] / np.linalg.norm(rest[int(np.argmax(size))])
        new[np.abs(new) < 1e-14] = 0.0
        vectors.append(new / np.linalg.norm(new))
        span = np.column_stack([span, new])
    out = np.eye(3)
    best = max(permutations(axes), key=lambda order: _likeness(vectors, names, order))
    for vector, axis in zip(vectors, best, strict=True):
        out[axis] = vector * (-1.0 if vector[axis] < 0 else 1.0)
    return out


def _likeness(
    vectors: Sequence[NDArray[np.float64]], names: Sequence[int], order: Sequence[int]
) -> float:
    """Return how well directions are called: along the axis of their name, and where that is a tie as the sensor is."""
    close = sum(abs(float(v[axis])) for v, axis in zip(vectors, order, strict=True))
    return round(close, 9) + 1e-6 * sum(a == b for a, b in zip(names, order, strict=False))


def _seat(found: _Local, basis: _Basis | None) -> Seat:
    rows = np.eye(3) if basis is None else basis.rows[found.part]
    row = int(np.argmin([_between(r, found.vector) for r in rows]))
    dof = Dof(
        found.aim.dof.node, DIRECTIONS[found.part + row], -1 if rows[row] @ found.vector < 0 else 1
    )
    turned = not np.array_equal(rows[row], np.eye(3)[row])
    angle = float(
        np.degrees(np.arctan2(np.linalg.norm(np.delete(rows[row], row)), abs(rows[row][row])))
    )
    return Seat(dof, angle if turned else found.angle, turned)


# -- the model ---------------------------------------------------------------------------------------------
def _turned(
    model: Model,
    bases: Mapping[int, _Basis],
    frames: Mapping[int, NDArray[np.float64]],
    have: Mapping[int, tuple[int, ...]],
) -> tuple[Model, list[str]]:
    """Return the model in the new DOFs, and what its geometry cannot tell of them."""
    n, place = model.n_dofs, {}
    for row in np.flatnonzero(np.isin(model.dofs.nodes, list(bases))):
        place[int(model.dofs.nodes[row]), int(model.dofs.axes[row])] = int(row)
    rows, columns, values = [], [], []
    for node, basis in bases.items():
        for part, A in basis.rows.items():
            axes = [a - part for a in have[node] if a // 3 == part // 3]
            B = np.linalg.solve(A[np.ix_(axes, axes)], np.eye(len(axes)))
            index = [place[node, part + a] for a in axes]
            rows += np.repeat(index, len(axes)).tolist()
            columns += index * len(axes)
            values += B.ravel().tolist()
    touched = np.zeros(n, dtype=np.bool_)
    touched[rows] = True
    rest = np.flatnonzero(~touched)
    T = sp.csr_array(
        (
            np.r_[values, np.ones(len(rest))],
            (np.r_[rows, rest].astype(np.intp), np.r_[columns, rest].astype(np.intp)),
        ),
        shape=(n, n),
    )
    T.eliminate_zeros()
    groups = {name: _moved(group, T, touched) for name, group in model.groups.items()}
    geometry, untold = _told(model.geometry, bases, frames)
    words = [_words(node, bases[node], frames[node], have[node]) for node in untold]
    shown = "; ".join(words[:SHOWN]) + ("; ..." if len(words) > SHOWN else "")
    title = f"{model.title} (turned DOFs: {shown})".strip() if words else model.title
    notes = [f"Not told by the geometry of the model: DOFs {shown}"] if words else []
    return Model(groups, model.dofs, geometry, title), notes


def _moved(group: Group, T: Matrix, touched: NDArray[np.bool_]) -> Group:
    def moved(A: Matrix | None) -> Matrix | None:
        if A is None or not touched[A.indices].any():
            return A
        B = T.T @ A @ T
        return 0.5 * (B + B.T)  # the products round the two halves differently

    matrices = [moved(A) for A in (group.stiffness, group.mass, group.viscous)]
    if all(
        a is b for a, b in zip(matrices, (group.stiffness, group.mass, group.viscous), strict=True)
    ):
        return group
    return group.with_matrices(*matrices)


def _told(
    geometry: Geometry | None,
    bases: Mapping[int, _Basis],
    frames: Mapping[int, NDArray[np.float64]],
) -> tuple[Geometry | None, list[int]]:
    """Return the geometry with the new directions, and the nodes whose directions it cannot hold."""
    known = set() if geometry is None else set(geometry.nodes.tolist())
    tell = {n: b.rows[0] @ frames[n] for n, b in bases.items() if b.one and n in known}
    untold = [n for n in bases if n not in tell]
    if geometry is None or not tell:
        return geometry, untold
    axes = (
        np.tile(np.eye(3), (len(geometry.nodes), 1, 1))
        if geometry.axes is None
        else geometry.axes.copy()
    )
    for row in np.flatnonzero(np.isin(geometry.nodes, list(tell))):
        axes[row] = tell[int(geometry.nodes[row])]
    return Geometry(geometry.nodes, geometry.xyz, geometry.lines, axes), untold


def _words(node: int, basis: _Basis, frame: NDArray[np.float64], have: tuple[int, ...]) -> str:
    along = [
        f"{node}:{DIRECTIONS[a]} along {vector_text(basis.rows[3 * (a // 3)][a % 3] @ frame)}"
        for a in have
        if not np.array_equal(basis.rows[3 * (a // 3)][a % 3], np.eye(3)[a % 3])
    ]
    return ", ".join(along)
