"""Assignment of the lines and faces of a model's geometry to its groups."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from updyn.arrays import BoolArray, IndexArray, RealArray
from updyn.group import Group
from updyn.model import Model

__all__ = ["groups_of_faces", "groups_of_lines", "nodes_of_groups"]


def groups_of_lines(model: Model) -> IndexArray:
    """Return the group of each line of the model's geometry, shape (m,); -1 if unknown."""
    # The model does not store it. It is the group whose stiffness matrix has the largest norm of
    # the entries between the DOFs of the two nodes; if only one node has DOFs (the other is fixed
    # or dependent), the largest entries at that node; if neither has, it is unknown.
    assert model.geometry is not None
    return _groups_of_cells(model, model.geometry.line_ends)


def groups_of_faces(model: Model) -> IndexArray:
    """Return the group of each face of the model's geometry, shape (k,); -1 if unknown."""
    # It is the group whose stiffness matrix couples all pairs of nodes of the face, diagonals
    # included, and whose weakest coupling is the strongest of all groups. Nodes without DOFs are
    # ignored; with one other node the rule for lines applies; without any the group is unknown.
    assert model.geometry is not None
    return _groups_of_cells(model, model.geometry.face_corners)


def _groups_of_cells(model: Model, cells: IndexArray) -> IndexArray:
    """Return the group of each line or face, shape (m,), from its nodes, shape (m, k)."""
    assert model.geometry is not None
    at = _places(model)
    n = len(model.geometry.nodes)
    has = np.zeros(n, dtype=np.bool_)
    has[at[at >= 0]] = True
    first, second = np.array(list(combinations(range(cells.shape[1]), 2))).T
    a, b = cells[:, first], cells[:, second]
    counts = has[a] & has[b] & (a != b)
    low, high = np.minimum(a, b), np.maximum(a, b)
    wanted, place = np.unique(low * n + high, return_inverse=True)
    place = place.reshape(a.shape)
    best, chosen = np.zeros(len(cells)), np.full(len(cells), -1, dtype=np.intp)
    best_alone, chosen_alone = np.zeros(n), np.full(n, -1, dtype=np.intp)
    for number, group in enumerate(model.groups.values()):
        if group.stiffness is None or not len(wanted):
            continue
        between, alone = _ties(group, at, n, wanted)
        chosen_alone[alone > best_alone] = number
        best_alone = np.maximum(best_alone, alone)
        weakest = np.where(counts, between[place], np.inf).min(axis=1)
        better = counts.any(axis=1) & (weakest > best)
        chosen[better] = number
        best[better] = weakest[better]
    one = (chosen < 0) & ((has[cells] & _is_first(cells)).sum(axis=1) == 1)
    chosen[one] = chosen_alone[cells[one, np.argmax(has[cells[one]], axis=1)]]
    return chosen


def _ties(group: Group, at: IndexArray, n: int, wanted: IndexArray) -> tuple[RealArray, RealArray]:
    """Return squared norms of the stiffness between pairs of nodes (keys a n + b) and at nodes."""
    assert group.stiffness is not None
    K = group.stiffness.tocoo()
    a, b = at[K.row], at[K.col]
    on = (a >= 0) & (b >= a)
    a, b, weight = a[on], b[on], K.data[on] ** 2
    same = a == b
    alone = np.bincount(a[same], weight[same], minlength=n)
    key = a[~same] * n + b[~same]
    found = np.minimum(np.searchsorted(wanted, key), len(wanted) - 1)
    hit = wanted[found] == key
    between = np.bincount(found[hit], weight[~same][hit], minlength=len(wanted))
    return between.astype(np.float64), alone.astype(np.float64)


def _is_first(cells: IndexArray) -> BoolArray:
    """Return which corners are the first occurrence of their node; triangles repeat one node."""
    again = np.zeros(cells.shape, dtype=np.bool_)
    for i, j in combinations(range(cells.shape[1]), 2):
        again[:, j] |= cells[:, i] == cells[:, j]
    return ~again


def nodes_of_groups(model: Model, groups: IndexArray, most: int) -> dict[int, IndexArray]:
    """Return positions of nodes of groups without lines (lumped masses, springs to the ground)."""
    # Groups with more than `most` nodes are omitted.
    at = _places(model)
    out = {}
    every = list(model.groups.values())
    for number in groups.tolist():
        nodes = np.unique(at[_used_dofs(every[number])])
        nodes = nodes[nodes >= 0]
        if 0 < len(nodes) <= most:
            out[number] = nodes
    return out


def _used_dofs(group: Group) -> IndexArray:
    """Return the DOFs with stiffness or mass in a group, or with damping if it has neither."""
    used = []
    for matrix in (group.stiffness, group.mass):
        if matrix is not None:
            used.append(matrix.indices[matrix.data != 0.0])
    if not used and group.viscous is not None:
        used = [group.viscous.indices]
    return np.concatenate([np.empty(0, dtype=np.intp), *used])


def _places(model: Model) -> IndexArray:
    """Return the position in the geometry of the node of each DOF; -1 if it has none."""
    assert model.geometry is not None
    nodes = model.geometry.nodes
    if not len(nodes):
        return np.full(model.n_dofs, -1, dtype=np.intp)
    order = np.argsort(nodes)
    found = order[np.minimum(np.searchsorted(nodes[order], model.dofs.nodes), len(nodes) - 1)]
    return np.asarray(np.where(nodes[found] == model.dofs.nodes, found, -1), dtype=np.intp)
