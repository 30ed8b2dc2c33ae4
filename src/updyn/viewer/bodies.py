"""Bodies of a scene from models and from measured DOFs, and their displacements."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import scipy  # loads scipy.spatial on use
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from updyn.arrays import BoolArray, IndexArray, RealArray
from updyn.dofs import DIRECTIONS, Dof, DofSet
from updyn.errors import InputError
from updyn.geometry import Geometry
from updyn.model import Model
from updyn.settings import FIGURES
from updyn.viewer.groups import (
    groups_of_faces,
    groups_of_lines,
    nodes_of_groups,
)
from updyn.viewer.scene import Arrow, Body, Entries

__all__ = ["arrows_at", "connect_nodes", "entries_of", "model_body", "motions", "sensor_body"]

#: Number of points on the rim of a disc, spacing of its spokes, and its radius as a fraction of the
#: diagonal of the structure.
_RIM = 16
_SPOKE_EVERY = 4
_DISC = 0.03
#: Relative difference up to which two distances are equal, as between nodes of an even grid.
_SAME = 1e-6


def model_body(model: Model, dofs: Iterable[str | Dof] = ()) -> Body:
    """Return the body of a model: lines, faces, lumped parts, and discs at nodes that only rotate.

    Parameters
    ----------
    model : Model
        A model with a geometry.
    dofs : iterable of str or Dof
        DOFs of sensors and forces, whose nodes are kept even if nothing else is drawn there.

    Returns
    -------
    Body
        The body, without the nodes inside solids.

    Raises
    ------
    InputError
        If the model has no geometry.
    """
    geometry = model.geometry
    if geometry is None or not len(geometry.nodes):
        raise InputError("viewer: the model has no geometry; expected positions of its nodes")
    lines, line_group = geometry.line_ends, groups_of_lines(model)
    faces, face_group = _triangles(geometry.face_corners, groups_of_faces(model))
    is_visible = _is_visible(lines, line_group, faces, face_group)
    lines, line_group = lines[is_visible], line_group[is_visible]
    drawn = {*line_group.tolist(), *face_group.tolist()}
    bare = [number for number in range(len(model.groups)) if number not in drawn]
    points, point_group = _make_squares(model, np.array(bare, dtype=np.intp))
    named = np.isin(geometry.nodes, [Dof.parse(dof).node for dof in dofs])
    rotations = _find_rotational_dofs(model.dofs, geometry)
    kept = np.zeros(len(geometry.nodes), dtype=np.bool_)
    for at in (lines, faces, points, np.flatnonzero(named), [node for node, _ in rotations]):
        kept[np.asarray(at, dtype=np.intp)] = True
    if not lines.size and not faces.size:  # draw the nodes, as there is nothing else
        loose = np.setdiff1d(np.arange(len(kept)), points)
        points = np.concatenate([points, loose])
        point_group = np.concatenate([point_group, np.full(len(loose), -1, dtype=np.intp)])
        kept[:] = True
    place = np.cumsum(kept) - 1
    body = Body(
        "model",
        geometry.nodes[kept],
        geometry.xyz[kept],
        place[lines],
        line_group,
        place[faces],
        face_group,
        place[points],
        point_group,
        tuple(model.groups),
        int(kept.sum()),
    )
    return _add_discs(body, [(int(place[node]), axis) for node, axis in rotations])


def sensor_body(geometry: Geometry, dofs: Iterable[str | Dof]) -> Body:
    """Return the body of the measured nodes, with the lines of a geometry between them.

    Parameters
    ----------
    geometry : Geometry
        Geometry of the test or of the model. Nodes without a position are omitted.
    dofs : iterable of str or Dof
        The measured DOFs.

    Returns
    -------
    Body

    Raises
    ------
    InputError
        If none of the nodes has a position.
    """
    measured = DofSet(dict.fromkeys(abs(Dof.parse(dof)) for dof in dofs))
    kept = np.isin(geometry.nodes, measured.nodes)
    if not kept.any():
        raise InputError("viewer: no measured node has a position in the geometry")
    place = np.cumsum(kept) - 1
    ends = geometry.line_ends
    ends = ends[kept[ends].all(axis=1)]
    none = np.empty(0, dtype=np.intp)
    body = Body(
        "test",
        geometry.nodes[kept],
        geometry.xyz[kept],
        place[ends],
        np.full(len(ends), -1, dtype=np.intp),
        np.empty((0, 3), dtype=np.intp),
        none,
        none,
        none,
        (),
        int(kept.sum()),
    )
    rotations = _find_rotational_dofs(measured, geometry)
    return _add_discs(body, [(int(place[node]), axis) for node, axis in rotations])


def connect_nodes(body: Body) -> Body:
    """Return a body of measured nodes in which nodes without a line are connected to neighbours."""
    between = body.lines[(body.lines < body.real).all(axis=1)]  # no spokes of discs
    lines = _find_neighbours(body.xyz[: body.real], between)
    return replace(
        body,
        lines=np.concatenate([body.lines, lines]),
        line_group=np.concatenate([body.line_group, np.full(len(lines), -1, dtype=np.intp)]),
    )


def _find_neighbours(xyz: RealArray, ends: IndexArray) -> IndexArray:
    """Return lines, shape (k, 2), from each node that has none in `ends` to its neighbours."""
    # Two nodes are neighbours if no third one is closer to both of them than they are to each
    # other (relative neighbourhood graph: a chain along a beam, a grid on a plate).
    # G. T. Toussaint, "The relative neighbourhood graph of a finite planar set", Pattern
    # Recognition 12 (1980) 261-268
    loose = np.setdiff1d(np.arange(len(xyz)), ends)
    if not loose.size or len(xyz) < 2:
        return np.empty((0, 2), dtype=np.intp)
    away, near = scipy.spatial.KDTree(xyz).query(
        xyz[loose], k=min(len(xyz), FIGURES.neighbours + 1)
    )
    found = set()
    for node, distances, others in zip(loose.tolist(), away, near, strict=True):
        for distance, other in zip(distances.tolist(), others.tolist(), strict=True):
            closer = others[distances < distance * (1.0 - _SAME)]
            between = np.linalg.norm(xyz[closer] - xyz[other], axis=1) < distance * (1.0 - _SAME)
            if other != node and not between.any():
                found.add((min(node, other), max(node, other)))
    return np.array(sorted(found), dtype=np.intp).reshape(-1, 2)


def _triangles(corners: IndexArray, group: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Return quadrangles, shape (k, 4), as triangles with their groups."""
    halves = corners[:, [[0, 1, 2], [0, 2, 3]]]
    whole = np.ones((len(corners), 2), dtype=np.bool_)
    whole[:, 1] = corners[:, 2] != corners[:, 3]
    return halves[whole], np.repeat(group[:, None], 2, axis=1)[whole]


def _is_visible(
    lines: IndexArray,
    line_group: IndexArray,
    faces: IndexArray,
    face_group: IndexArray,
) -> BoolArray:
    """Return which lines are visible, excluding lines of solids that end at an interior node."""
    on_face = np.isin(lines, faces).all(axis=1)
    return np.asarray(on_face | ~np.isin(line_group, face_group[face_group >= 0]))


def _make_squares(model: Model, groups: IndexArray) -> tuple[IndexArray, IndexArray]:
    found = nodes_of_groups(model, groups, FIGURES.lumped_nodes)
    nodes = [np.empty(0, dtype=np.intp), *found.values()]
    of = [np.full(len(at), number, dtype=np.intp) for number, at in found.items()]
    return np.concatenate(nodes), np.concatenate([np.empty(0, dtype=np.intp), *of])


# -- discs ---------------------------------------------------------------------------------------
def _find_rotational_dofs(dofs: DofSet, geometry: Geometry) -> list[tuple[int, RealArray]]:
    """Return (node, axis) of each rotational DOF at nodes without translational DOFs."""
    moving = set(dofs.nodes[dofs.axes < 3].tolist())
    place = {int(node): at for at, node in enumerate(geometry.nodes)}
    out = []
    for node, axis in zip(dofs.nodes.tolist(), dofs.axes.tolist(), strict=True):
        if axis >= 3 and node not in moving and node in place:
            out.append((place[node], _axes(geometry, place[node])[axis - 3]))
    return out


def _axes(geometry: Geometry, at: int) -> RealArray:
    return np.eye(3) if geometry.axes is None else geometry.axes[at]


def _add_discs(body: Body, rotations: list[tuple[int, RealArray]]) -> Body:
    """Return a body with a disc (a rim with spokes) added around each rotation axis."""
    if not rotations:
        return body
    radius = _DISC * float(np.linalg.norm(np.ptp(body.xyz, axis=0))) or 1.0
    angle = 2.0 * np.pi * np.arange(_RIM) / _RIM
    rims, owners, lines = [], [], []
    for number, (node, axis) in enumerate(rotations):
        across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        across /= np.linalg.norm(across)
        up = np.cross(axis, across)
        rim = np.outer(np.cos(angle), across) + np.outer(np.sin(angle), up)
        rims.append(body.xyz[node] + radius * rim)
        owners += [int(body.nodes[node])] * _RIM
        rim_nodes = len(body.nodes) + number * _RIM + np.arange(_RIM)
        lines += np.column_stack([rim_nodes, np.roll(rim_nodes, -1)]).tolist()
        lines += [[node, int(end)] for end in rim_nodes[::_SPOKE_EVERY]]
    more = np.array(lines, dtype=np.intp)
    return Body(
        body.name,
        np.concatenate([body.nodes, owners]),
        np.concatenate([body.xyz, *rims]),
        np.concatenate([body.lines, more]),
        np.concatenate([body.line_group, np.full(len(more), -1, dtype=np.intp)]),
        body.faces,
        body.face_group,
        body.points,
        body.point_group,
        body.groups,
        body.real,
        radius,
    )


# -- motion --------------------------------------------------------------------------------------
def entries_of(body: Body, geometry: Geometry, dofs: Iterable[str | Dof]) -> Entries:
    """Return the map from DOFs to displacements of a body's nodes.

    Parameters
    ----------
    body : Body
        Result of `model_body` or `sensor_body`.
    geometry : Geometry
        Geometry with the local axes of the nodes.
    dofs : iterable of str or Dof
        Signed DOFs. Those at nodes outside the body have no effect. A rotation moves the rim of a
        disc.

    Returns
    -------
    Entries
    """
    rows = {int(node): at for at, node in enumerate(geometry.nodes)}
    real = {int(node): at for at, node in enumerate(body.nodes[: body.real])}
    rims: dict[int, list[int]] = {}
    for at, node in enumerate(body.nodes[body.real :].tolist(), body.real):
        rims.setdefault(node, []).append(at)
    dof_of, node_of, vectors = [], [], []
    every = DofSet(dofs)
    table = zip(every.nodes.tolist(), every.axes.tolist(), every.signs.tolist(), strict=True)
    for number, (node, axis, sign) in enumerate(table):
        if node not in real or node not in rows:
            continue
        direction = sign * _axes(geometry, rows[node])[axis % 3]
        if axis < 3:
            dof_of.append(number)
            node_of.append(real[node])
            vectors.append(direction)
        for at in rims.get(node, ()) if axis >= 3 else ():
            dof_of.append(number)
            node_of.append(at)
            vectors.append(np.cross(direction, body.xyz[at] - body.xyz[real[node]]))
    return Entries(
        np.array(dof_of, dtype=np.intp),
        np.array(node_of, dtype=np.intp),
        np.array(vectors, dtype=np.float64).reshape(-1, 3),
    )


def motions(body: Body, entries: Entries, shapes: ArrayLike) -> NDArray[np.generic]:
    """Return the displacements of the nodes of a body.

    Parameters
    ----------
    body : Body
        The body.
    entries : Entries
        Result of `entries_of`.
    shapes : array_like of float or complex, shape (d, s)
        Shapes as columns, one row per DOF.

    Returns
    -------
    ndarray of float or complex, shape (s, n, 3)
        Displacements in global components.
    """
    given = np.asarray(shapes)
    n = len(body.nodes)
    rows = (3 * entries.node[:, None] + np.arange(3)).ravel()
    columns = np.repeat(entries.dof, 3)
    P = sp.csr_array((entries.vector.ravel(), (rows, columns)), shape=(3 * n, len(given)))
    return np.asarray((P @ given).T.reshape(-1, n, 3))


def arrows_at(
    body: Body, geometry: Geometry, responses: Iterable[str | Dof], references: Iterable[str | Dof]
) -> tuple[list[Arrow], list[str]]:
    """Return arrows of sensors and forces, and the DOFs without a position.

    Parameters
    ----------
    body : Body
        Body on which the arrows are placed.
    geometry : Geometry
        Geometry with the local axes of the nodes.
    responses, references : iterable of str or Dof
        Signed DOFs of sensors and forces.

    Returns
    -------
    (list of Arrow, list of str)
    """
    rows = {int(node): at for at, node in enumerate(geometry.nodes)}
    real = {int(node): at for at, node in enumerate(body.nodes[: body.real])}
    out: list[Arrow] = []
    missing: dict[str, None] = {}
    for kind, dofs in (("sensor", responses), ("force", references)):
        # Several references may share a sensor: keep each DOF once.
        for dof in dict.fromkeys(Dof.parse(dof) for dof in dofs):
            axis = DIRECTIONS.index(dof.direction)
            if dof.node not in real or dof.node not in rows:
                missing[str(dof)] = None
                continue
            vector = dof.sign * _axes(geometry, rows[dof.node])[axis % 3]
            out.append(Arrow(kind, real[dof.node], vector, axis >= 3, str(dof)))
    return out, list(missing)
