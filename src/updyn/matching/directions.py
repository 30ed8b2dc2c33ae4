"""Sensors that are not along a DOF: rotate the DOFs of their node along the sensors.

At a node with the translations u, sensors and forces along a_1, a_2, a_3 (independent unit
vectors) get the DOFs q_k = a_k . u. Then u = B q, where B is the inverse of the matrix A with rows
a_k. A force f along a_k does the work f q_k, so it acts on q_k alone, whether or not the
directions are at right angles. Each matrix of a group becomes T^T K T, with T = B at that node and
the identity elsewhere (Cook, Malkus, Plesha & Witt, Concepts and Applications of Finite Element
Analysis, 4th ed. 2002, chapter 8). This is exact: nothing is interpolated, and the model remains a
sum of groups.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
import scipy.sparse as sp

from updyn.arrays import BoolArray, RealArray
from updyn.dofs import DIRECTIONS, Dof
from updyn.errors import DofError
from updyn.geometry import Geometry
from updyn.matching.result import MatchError, format_list, vector_text
from updyn.matching.settings import SENSOR_DIRECTION, SENSOR_PLACEMENT
from updyn.model import Group, Matrix, Model

__all__ = ["AssignedDof", "SensorDirection", "assign_dofs"]

_TRANSLATION = 0  # first direction of the translations and of the rotations of a node
_ROTATION = 3


@dataclass(frozen=True, slots=True, eq=False)
class SensorDirection:
    """Node of the model for a sensor, and its direction there.

    `dof` is the node in the model with direction and sign of the label. `vector` is the unit
    direction in the global system of the model, or None for that of `dof`.
    """

    sensor: Dof
    role: str
    dof: Dof
    vector: RealArray | None = None


@dataclass(frozen=True, slots=True)
class AssignedDof:
    """The DOF of a sensor, with the sign of the sensor.

    `angle` in degrees is that between the sensor and the DOF before any rotation; `turned` is True
    if the DOF was rotated.
    """

    dof: Dof
    angle: float
    turned: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Local:
    """A target in the directions of its node; `part` is 0 for translations, 3 for rotations."""

    target: SensorDirection
    part: int
    vector: RealArray
    angle: float

    @property
    def node(self) -> int:
        return self.target.dof.node

    @property
    def oblique(self) -> bool:
        return bool(np.count_nonzero(self.vector) > 1)

    def __str__(self) -> str:
        along = vector_text(self.vector)
        return f"{self.target.role} {self.target.sensor} along {along}"


def assign_dofs(
    model: Model, targets: Sequence[SensorDirection], angle: float
) -> tuple[Model, list[AssignedDof], list[str]]:
    """Assign a DOF to each sensor, rotating the DOFs of nodes with oblique sensors.

    A sensor within `angle` degrees of a DOF is taken to be along it. Returns the model (the same
    object if nothing was rotated), the DOFs in the order of `targets`, and notes. Labels are
    unchanged; `Geometry.axes` has the orthogonal directions of rotated nodes, title and notes give
    others.
    """
    nodes = {target.dof.node for target in targets}
    frames = _node_frames(model, nodes)
    directions = _existing_directions(model, nodes)
    locals_ = _find_local_directions(model, targets, frames, directions, angle)
    at: dict[int, list[_Local]] = {}
    for local in locals_:
        at.setdefault(local.node, []).append(local)
    bases: dict[int, _NodeDirections] = {}
    for node, group in at.items():
        if _any_oblique(group):
            bases[node] = _basis(node, group, directions[node])
    assigned = [_assign_dof(local, bases.get(local.node)) for local in locals_]
    if not bases:
        return model, assigned, []
    turned, notes = _rotate_model(model, bases, frames, directions)
    return turned, assigned, notes


# -- one sensor
def _node_frames(model: Model, nodes: Iterable[int]) -> dict[int, RealArray]:
    out = {node: np.eye(3) for node in nodes}
    if model.geometry is not None and model.geometry.axes is not None:
        for row in np.flatnonzero(np.isin(model.geometry.nodes, list(out))):
            out[int(model.geometry.nodes[row])] = model.geometry.axes[row]
    return out


def _existing_directions(model: Model, nodes: Iterable[int]) -> dict[int, tuple[int, ...]]:
    """Return the existing ones of the six directions of nodes, ascending."""
    out: dict[int, list[int]] = {node: [] for node in nodes}
    for row in np.flatnonzero(np.isin(model.dofs.nodes, list(out))):
        out[int(model.dofs.nodes[row])].append(int(model.dofs.axes[row]))
    return {node: tuple(sorted(axes)) for node, axes in out.items()}


def _mask(directions: Iterable[int], part: int) -> BoolArray:
    """Return a mask of the three directions of a part (translations, rotations) that a node has."""
    return np.isin(part + np.arange(3), list(directions))


def _find_local_directions(
    model: Model,
    targets: Sequence[SensorDirection],
    frames: Mapping[int, RealArray],
    directions: Mapping[int, tuple[int, ...]],
    angle: float,
) -> list[_Local]:
    out: list[_Local] = []
    lost: dict[str, str] = {}
    for target in targets:
        node = target.dof.node
        found = _find_local_direction(model, target, frames[node], directions[node], angle)
        if isinstance(found, str):
            lost[str(target.sensor)] = found
        else:
            out.append(found)
    if lost:
        raise MatchError(
            f"{len(lost)} of the sensors and forces of the measurement are not DOFs of the model:"
            + format_list(list(lost.values())),
            lost=list(lost),
        )
    return out


def _find_local_direction(
    model: Model,
    target: SensorDirection,
    frame: RealArray,
    directions: tuple[int, ...],
    angle: float,
) -> _Local | str:
    """Return the target in the directions of its node, or why it is not a DOF there."""
    axis = DIRECTIONS.index(target.dof.direction)
    part = _ROTATION if axis >= _ROTATION else _TRANSLATION
    present = _mask(directions, part)
    along = np.zeros(3)
    if target.vector is None or not present.any():
        if axis not in directions:
            return _missing_dof(model, target)
        along[axis - part] = target.dof.sign
        return _Local(target, part, along, 0.0)
    components = frame @ target.vector
    k = int(np.argmax(np.where(present, np.abs(components), -1.0)))
    along[k] = np.copysign(1.0, components[k])
    off = _angle_off(components, k)
    if off <= max(angle, SENSOR_DIRECTION.exact_angle):
        return _Local(target, part, along, off)
    lacking = float(np.linalg.norm(components[~present]))
    if lacking > np.sin(np.radians(SENSOR_DIRECTION.exact_angle)):
        node = target.dof.node
        names = ", ".join(f"{node}:{DIRECTIONS[a]}" for a in directions)
        text = (
            f"{target.role} {target.sensor} along {vector_text(target.vector)} is {off:.3g} degrees"
            f" off {node}:{DIRECTIONS[part + k]}, and a part of {lacking:.3g} is along what node"
            f" {node} of the model lacks; it has {names}"
        )
        if off <= SENSOR_DIRECTION.suggested_angle:
            text += f"; with angle = {np.ceil(off):g} it is taken along that"
        return text
    components = np.where(present, components, 0.0)
    return _Local(target, part, components / np.linalg.norm(components), off)


def _angle_off(vector: RealArray, axis: int) -> float:
    """Return the angle between a vector and an axis, regardless of sense, in degrees."""
    across = np.linalg.norm(np.delete(vector, axis))
    return float(np.degrees(np.arctan2(across, abs(vector[axis]))))


def _missing_dof(model: Model, target: SensorDirection) -> str:
    """Return the message about a DOF that the model lacks."""
    dof = abs(target.dof)
    try:
        model.dofs.match([dof], target.role)
    except DofError as error:
        same_label = (dof.node, dof.direction) == (target.sensor.node, target.sensor.direction)
        return str(error) if same_label else f"{target.sensor}: {error}"
    raise AssertionError(target.dof)


# -- one node
@dataclass(frozen=True, slots=True, eq=False)
class _NodeDirections:
    """New directions of a node, as rows in its old ones.

    `same` is True if translations and rotations have the same three orthogonal directions.
    """

    translations: RealArray
    rotations: RealArray
    same: bool

    def of(self, part: int) -> RealArray:
        return self.translations if part == _TRANSLATION else self.rotations

    def row(self, axis: int) -> RealArray:
        rows = self.translations if axis < _ROTATION else self.rotations
        return np.asarray(rows[axis % 3])


def _basis(node: int, found: Sequence[_Local], directions: tuple[int, ...]) -> _NodeDirections:
    translations = _mask(directions, _TRANSLATION)
    rotations = _mask(directions, _ROTATION)
    translating = _select_independent(node, found, _TRANSLATION, translations)
    rotating = _select_independent(node, found, _ROTATION, rotations)
    both = _select_distinct([*translating, *rotating])
    vectors = _vectors(both)
    off = np.abs(vectors @ vectors.T - np.eye(len(both))).max()
    if len(both) <= 3 and off < SENSOR_DIRECTION.orthonormal_error:
        A = _complete_axes(both, np.ones(3, dtype=np.bool_))
        if not _mixes_directions(A, translations) and not _mixes_directions(A, rotations):
            return _NodeDirections(A, A, same=True)
    new_translations = _rotated_rows(translating, translations)
    return _NodeDirections(new_translations, _rotated_rows(rotating, rotations), same=False)


def _vectors(found: Sequence[_Local]) -> RealArray:
    """Return the directions of targets as rows, shape (n, 3)."""
    return np.array([local.vector for local in found]).reshape(-1, 3)


def _any_oblique(found: Sequence[_Local]) -> bool:
    return any(local.oblique for local in found)


def _mixes_directions(A: RealArray, mask: BoolArray) -> bool:
    """Return whether new directions combine directions that a node has with directions it lacks."""
    # Such a combination is not allowed: a planar model remains planar.
    if not mask.any():
        return False
    return bool(A[np.ix_(mask, ~mask)].any() or A[np.ix_(~mask, mask)].any())


def _rotated_rows(found: Sequence[_Local], mask: BoolArray) -> RealArray:
    if _any_oblique(found):
        return _complete_axes(found, mask)
    return np.eye(3)


def _select_distinct(found: Sequence[_Local]) -> list[_Local]:
    """Return one of each set of parallel targets, preferably one along an unchanged DOF."""
    kept: list[_Local] = []
    for local in sorted(found, key=lambda x: x.oblique):
        angles = [_angle_between(local.vector, other.vector) for other in kept]
        if all(angle > SENSOR_DIRECTION.exact_angle for angle in angles):
            kept.append(local)
    return kept


def _angle_between(a: RealArray, b: RealArray) -> float:
    """Return the angle between two lines in degrees."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), abs(a @ b))))


def _select_independent(
    node: int, found: Sequence[_Local], part: int, mask: BoolArray
) -> list[_Local]:
    """Return the distinct directions of a part at a node, after a check of their independence."""
    kept = _select_distinct([local for local in found if local.part == part])
    if not _any_oblique(kept):
        return kept
    _check_angles(node, kept)
    named = format_list(list(map(str, kept)))
    available = int(mask.sum())
    if len(kept) > available:
        raise MatchError(
            f"sensors and forces at node {node} of the model point in {len(kept)} directions, of"
            f" which it has {available}; keep as many, or give the others another"
            f" node:{named}",
            ("directions",),
        )
    smallest = np.linalg.svd(_vectors(kept), compute_uv=False)[-1]
    if smallest < SENSOR_DIRECTION.least_singular_value:
        raise MatchError(
            f"sensors and forces at node {node} of the model point in {len(kept)} directions of one"
            f" plane: the last is a sum of the others; leave one out:{named}",
            ("directions",),
        )
    return kept


def _check_angles(node: int, found: Sequence[_Local]) -> None:
    for i, local in enumerate(found):
        for other in found[:i]:
            apart = _angle_between(local.vector, other.vector)
            if apart < SENSOR_DIRECTION.smallest_angle:
                raise MatchError(
                    f"{local.target.sensor} and {other.target.sensor} at node {node} of the model"
                    f" point {apart:.2g} degrees apart: too close for two DOFs, and more than the"
                    f" {SENSOR_DIRECTION.exact_angle:g} degrees within which they are one; give"
                    " both the same direction, or leave one out",
                    ("directions",),
                )


def _complete_axes(found: Sequence[_Local], mask: BoolArray) -> RealArray:
    """Return the sensors' directions and orthogonal ones as three rows, by nearest axis."""
    vectors = list(_vectors(found))
    labels = [DIRECTIONS.index(local.target.dof.direction) % 3 for local in found]
    axes = np.flatnonzero(mask).tolist()
    span = np.linalg.qr(_vectors(found).T)[0]
    while len(vectors) < len(axes):
        rest = np.eye(3)[axes] - (np.eye(3)[axes] @ span) @ span.T
        size = np.round(np.linalg.norm(rest, axis=1), 12)  # the first of equal values is taken
        largest = rest[int(np.argmax(size))]
        new = largest / np.linalg.norm(largest)
        new[np.abs(new) < 1e-14] = 0.0
        vectors.append(new / np.linalg.norm(new))
        span = np.column_stack([span, new])
    best = max(permutations(axes), key=lambda order: _label_score(vectors, labels, order))
    out = np.eye(3)
    for vector, axis in zip(vectors, best, strict=True):
        out[axis] = vector * (-1.0 if vector[axis] < 0 else 1.0)
    return out


def _label_score(
    vectors: Sequence[RealArray], labels: Sequence[int], order: Sequence[int]
) -> float:
    """Return the closeness of vectors to the axes in an order; sensor labels break ties."""
    near = sum(abs(float(v[axis])) for v, axis in zip(vectors, order, strict=True))
    same = sum(label == axis for label, axis in zip(labels, order, strict=False))
    return round(near, 9) + SENSOR_DIRECTION.label_weight * same


def _assign_dof(local: _Local, basis: _NodeDirections | None) -> AssignedDof:
    rows = np.eye(3) if basis is None else basis.of(local.part)
    axis = int(np.argmin([_angle_between(row, local.vector) for row in rows]))
    dof = Dof(local.node, DIRECTIONS[local.part + axis])
    if rows[axis] @ local.vector < 0:
        dof = -dof
    if np.array_equal(rows[axis], np.eye(3)[axis]):
        return AssignedDof(dof, local.angle, turned=False)
    return AssignedDof(dof, _angle_off(rows[axis], axis), turned=True)


# -- the model
def _rotate_model(
    model: Model,
    bases: Mapping[int, _NodeDirections],
    frames: Mapping[int, RealArray],
    directions: Mapping[int, tuple[int, ...]],
) -> tuple[Model, list[str]]:
    """Return the model in the new DOFs, and notes on those that its geometry cannot represent."""
    model.refuse_nonlinear("sensor directions that turn degrees of freedom of the model")
    T, changed = _transformation(model, bases, directions)
    groups = {name: _transform_group(group, T, changed) for name, group in model.groups.items()}
    geometry, others = _with_axes(model.geometry, bases, frames)
    if not others:
        return Model(groups, model.dofs, geometry, model.title), []
    texts = [
        _describe_rotation(node, bases[node], frames[node], directions[node]) for node in others
    ]
    shown = "; ".join(texts[: SENSOR_PLACEMENT.listed_items])
    if len(texts) > SENSOR_PLACEMENT.listed_items:
        shown += "; ..."
    title = f"{model.title} (turned DOFs: {shown})".strip()
    note = f"Not in the geometry of the model: DOFs {shown}"
    return Model(groups, model.dofs, geometry, title), [note]


def _transformation(
    model: Model, bases: Mapping[int, _NodeDirections], directions: Mapping[int, tuple[int, ...]]
) -> tuple[Matrix, BoolArray]:
    """Return T of u = T q, shape (N, N), and a mask of the DOFs that it changes, shape (N,)."""
    n = model.n_dofs
    place = {}
    for row in np.flatnonzero(np.isin(model.dofs.nodes, list(bases))):
        place[int(model.dofs.nodes[row]), int(model.dofs.axes[row])] = int(row)
    rows: list[int] = []
    columns: list[int] = []
    values: list[float] = []
    for node, basis in bases.items():
        for part in (_TRANSLATION, _ROTATION):
            axes = np.flatnonzero(_mask(directions[node], part))
            A = basis.of(part)[np.ix_(axes, axes)]
            B = np.linalg.solve(A, np.eye(len(axes)))
            index = [place[node, part + axis] for axis in axes.tolist()]
            rows += np.repeat(index, len(axes)).tolist()
            columns += index * len(axes)
            values += B.ravel().tolist()
    changed = np.zeros(n, dtype=np.bool_)
    changed[rows] = True
    rest = np.flatnonzero(~changed)
    entries = np.concatenate([values, np.ones(len(rest))])
    all_rows = np.concatenate([rows, rest]).astype(np.intp)
    all_columns = np.concatenate([columns, rest]).astype(np.intp)
    T = sp.csr_array((entries, (all_rows, all_columns)), shape=(n, n))
    T.eliminate_zeros()
    return T, changed


def _transform_group(group: Group, T: Matrix, changed: BoolArray) -> Group:
    """Return T^T A T of the matrices of a group; the group itself if its DOFs are unchanged."""

    def touches(A: Matrix | None) -> bool:
        return A is not None and bool(changed[A.indices].any())

    def change(A: Matrix) -> Matrix:
        if not touches(A):
            return A
        B = T.T @ A @ T
        return 0.5 * (B + B.T)  # rounding makes the two halves of the products differ

    if not any(map(touches, (group.stiffness, group.mass, group.viscous))):
        return group
    return group.transformed(change, T)


def _with_axes(
    geometry: Geometry | None,
    bases: Mapping[int, _NodeDirections],
    frames: Mapping[int, RealArray],
) -> tuple[Geometry | None, list[int]]:
    """Return the geometry with the new directions, and the nodes that it cannot represent."""
    if geometry is None:
        return None, list(bases)
    known = set(geometry.nodes.tolist())
    new = {n: b.translations @ frames[n] for n, b in bases.items() if b.same and n in known}
    others = [node for node in bases if node not in new]
    if not new:
        return geometry, others
    if geometry.axes is None:
        axes = np.tile(np.eye(3), (len(geometry.nodes), 1, 1))
    else:
        axes = geometry.axes.copy()
    for row in np.flatnonzero(np.isin(geometry.nodes, list(new))):
        axes[row] = new[int(geometry.nodes[row])]
    return Geometry(geometry.nodes, geometry.xyz, geometry.lines, axes, geometry.faces), others


def _describe_rotation(
    node: int, basis: _NodeDirections, frame: RealArray, directions: tuple[int, ...]
) -> str:
    """Return the rotated DOFs of a node with their directions in the global system, as text."""
    texts = []
    for axis in directions:
        row = basis.row(axis)
        if not np.array_equal(row, np.eye(3)[axis % 3]):
            texts.append(f"{node}:{DIRECTIONS[axis]} along {vector_text(row @ frame)}")
    return ", ".join(texts)
