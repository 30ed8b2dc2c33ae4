"""Geometry: where the nodes of a test or of a model stand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from updyn.errors import InputError

__all__ = ["Geometry"]


@dataclass(frozen=True, slots=True, eq=False, init=False)
class Geometry:
    """Node positions in the global Cartesian system, and lines to draw between them.

    Parameters
    ----------
    nodes : array_like of int, shape (n,)
        Node numbers, each once.
    xyz : array_like of float, shape (n, 3)
        Positions in m.
    lines : array_like of int, shape (m, 2), optional
        Pairs of node numbers, to draw.
    axes : array_like of float, shape (n, 3, 3), optional
        Displacement directions of each node: rows are its X, Y, Z in the global system. None: global.

    Raises
    ------
    InputError
        If shapes disagree, a number is not finite, a node stands twice or a line names an unknown node.
    """

    nodes: NDArray[np.int64]
    xyz: NDArray[np.float64]
    lines: NDArray[np.int64]
    axes: NDArray[np.float64] | None

    def __init__(
        self, nodes: ArrayLike, xyz: ArrayLike, lines: ArrayLike | None = None, axes: ArrayLike | None = None
    ) -> None:
        ids = np.array(nodes, dtype=np.int64)
        points = np.array(xyz, dtype=np.float64)
        pairs = np.array([] if lines is None else lines, dtype=np.int64).reshape(-1, 2)
        if ids.ndim != 1 or points.shape != (len(ids), 3):
            raise InputError(
                f"geometry: expected n node numbers and (n, 3) positions, found {ids.shape} and {points.shape}"
            )
        if not np.isfinite(points).all():
            raise InputError(f"geometry: the position of node {ids[~np.isfinite(points).all(axis=1)][0]} is not finite")
        values, counts = np.unique(ids, return_counts=True)
        if (counts > 1).any():
            raise InputError(f"geometry: node {values[counts > 1][0]} stands twice")
        if not np.isin(pairs, ids).all():
            raise InputError(f"geometry: a line names node {pairs[~np.isin(pairs, ids)][0]}, which has no position")
        directions = None if axes is None else np.array(axes, dtype=np.float64)
        if directions is not None and directions.shape != (len(ids), 3, 3):
            raise InputError(f"geometry: expected axes of shape {(len(ids), 3, 3)}, found {directions.shape}")
        for name, array in (("nodes", ids), ("xyz", points), ("lines", pairs), ("axes", directions)):
            if array is not None:
                array.flags.writeable = False
            object.__setattr__(self, name, array)

    def position(self, nodes: ArrayLike) -> NDArray[np.float64]:
        """Return the positions, shape (k, 3) in m, of `nodes`.

        Raises
        ------
        InputError
            If a node has no position.
        """
        wanted = np.atleast_1d(np.asarray(nodes, dtype=np.int64))
        order = np.argsort(self.nodes)
        at = np.minimum(np.searchsorted(self.nodes[order], wanted), len(order) - 1) if len(order) else wanted * 0
        if len(order) == 0 or (self.nodes[order][at] != wanted).any():
            missing = [int(w) for w in wanted if w not in self.nodes]
            raise InputError(f"geometry: node {missing[0]} has no position")
        return np.asarray(self.xyz[order[at]])
