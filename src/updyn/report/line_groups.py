"""Which group each line of a geometry belongs to: the one whose stiffness couples its ends most."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from updyn.model import Model

__all__ = ["groups_of_lines", "nodes_of_groups"]


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
    lines = model.geometry.lines
    at = _places(model)
    n = len(model.geometry.nodes)
    order = np.argsort(model.geometry.nodes)
    ends = np.sort(order[np.searchsorted(model.geometry.nodes[order], lines)], axis=1).reshape(
        -1, 2
    )
    wanted, place = np.unique(ends[:, 0] * n + ends[:, 1], return_inverse=True)
    has = np.zeros(n, dtype=np.bool_)
    has[at[at >= 0]] = True
    best, alone = np.zeros(len(wanted)), np.zeros(n)
    chosen, chosen_alone = np.full(len(wanted), -1, dtype=np.intp), np.full(n, -1, dtype=np.intp)
    for number, group in enumerate(model.groups.values()):
        if group.stiffness is None or not len(wanted):
            continue
        K = group.stiffness.tocoo()
        a, b = at[K.row], at[K.col]
        on = (a >= 0) & (b >= a)
        a, b, weight = a[on], b[on], K.data[on] ** 2
        same = a == b
        sums = np.bincount(a[same], weight[same], minlength=n)
        chosen_alone[sums > alone] = number
        alone = np.maximum(alone, sums)
        key = a[~same] * n + b[~same]
        found = np.minimum(np.searchsorted(wanted, key), len(wanted) - 1)
        hit = wanted[found] == key
        sums = np.bincount(found[hit], weight[~same][hit], minlength=len(wanted))
        chosen[sums > best] = number
        best = np.maximum(best, sums)
    out = chosen[place]
    one = (out < 0) & (has[ends].sum(axis=1) == 1)
    out[one] = chosen_alone[np.where(has[ends[one, 0]], ends[one, 0], ends[one, 1])]
    return out


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
        used = [
            A.indices[A.data != 0.0]
            for A in (every[number].stiffness, every[number].mass)
            if A is not None
        ]
        if not used:
            used = [every[number].viscous.indices] if every[number].viscous is not None else []
        nodes = np.unique(at[np.concatenate([np.empty(0, dtype=np.intp), *used])])
        nodes = nodes[nodes >= 0]
        if 0 < len(nodes) <= most:
            out[number] = nodes
    return out


def _places(model: Model) -> NDArray[np.intp]:
    """Return, for each DOF, the position of its node in the geometry; -1 where it has none."""
    assert model.geometry is not None
    nodes = model.geometry.nodes
    if not len(nodes):
        return np.full(model.n_dofs, -1, dtype=np.intp)
    order = np.argsort(nodes)
    found = order[np.minimum(np.searchsorted(nodes[order], model.dofs.nodes), len(nodes) - 1)]
    return np.asarray(np.where(nodes[found] == model.dofs.nodes, found, -1), dtype=np.intp)
