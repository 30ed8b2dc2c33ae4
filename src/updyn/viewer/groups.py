"""Which group of a model each line and each face of its geometry belongs to."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from updyn.group import Group
from updyn.model import Model

__all__ = ["groups_of_faces", "groups_of_lines", "nodes_of_groups"]


def groups_of_lines(model: Model) -> NDArray[np.intp]:
    """Return the group of each line of the model's geometry.

    A line has no group of its own in the model. Its group is the one whose stiffness matrix has the
    largest entries (their norm) between the degrees of freedom of its two nodes. Where one of the
    nodes has none, because it is held or follows others, it is the group with the largest entries
    at the other; where both have none, there is no telling.

    Parameters
    ----------
    model : Model
        With a geometry of m lines.

    Returns
    -------
    ndarray of int, shape (m,)
        Positions among the model's groups; -1: not known.
    """
    assert model.geometry is not None
    return _groups_of_cells(model, model.geometry.line_ends)


def groups_of_faces(model: Model) -> NDArray[np.intp]:
    """Return the group of each face of the model's geometry.

    It is the group whose stiffness matrix ties all nodes of the face, the diagonals among them:
    that whose weakest tie is the strongest. Nodes without degrees of freedom do not count; where
    one node is left it is as for lines, and where none is, there is no telling.

    Parameters
    ----------
    model : Model
        With a geometry of k faces.

    Returns
    -------
    ndarray of int, shape (k,)
        Positions among the model's groups; -1: not known.
    """
    assert model.geometry is not None
    return _groups_of_cells(model, model.geometry.face_corners)


def _groups_of_cells(model: Model, cells: NDArray[np.intp]) -> NDArray[np.intp]:
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


def _ties(
    group: Group, at: NDArray[np.intp], n: int, wanted: NDArray[np.intp]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return squared norms of a stiffness between pairs of nodes (keys a n + b), and of nodes."""
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


def _is_first(cells: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return where a node stands in its cell for the first time: of triangles one stands twice."""
    again = np.zeros(cells.shape, dtype=np.bool_)
    for i, j in combinations(range(cells.shape[1]), 2):
        again[:, j] |= cells[:, i] == cells[:, j]
    return ~again


def nodes_of_groups(
    model: Model, groups: NDArray[np.intp], most: int
) -> dict[int, NDArray[np.intp]]:
    """Return the nodes of groups that are not drawn as lines: lumped masses, springs to the ground.

    Parameters
    ----------
    model : Model
        With a geometry.
    groups : ndarray of int
        Positions among the model's groups.
    most : int
        Groups with more nodes than this are left out.

    Returns
    -------
    dict of int to ndarray of int
        By group, positions among the nodes of the geometry.
    """
    at = _places(model)
    out = {}
    every = list(model.groups.values())
    for number in groups.tolist():
        nodes = np.unique(at[_used_dofs(every[number])])
        nodes = nodes[nodes >= 0]
        if 0 < len(nodes) <= most:
            out[number] = nodes
    return out


def _used_dofs(group: Group) -> NDArray[np.intp]:
    """Return the DOFs with stiffness or mass in a group; without either, those with damping."""
    used = []
    for matrix in (group.stiffness, group.mass):
        if matrix is not None:
            used.append(matrix.indices[matrix.data != 0.0])
    if not used and group.viscous is not None:
        used = [group.viscous.indices]
    return np.concatenate([np.empty(0, dtype=np.intp), *used])


def _places(model: Model) -> NDArray[np.intp]:
    """Return, for each DOF, the position of its node in the geometry; -1 where it has none."""
    assert model.geometry is not None
    nodes = model.geometry.nodes
    if not len(nodes):
        return np.full(model.n_dofs, -1, dtype=np.intp)
    order = np.argsort(nodes)
    found = order[np.minimum(np.searchsorted(nodes[order], model.dofs.nodes), len(nodes) - 1)]
    return np.asarray(np.where(nodes[found] == model.dofs.nodes, found, -1), dtype=np.intp)
