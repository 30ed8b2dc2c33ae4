"""Geometry: positions of the nodes of a test or of a model, with lines and faces between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import IndexArray, IntArray, RealArray
from updyn.dofs import whole_numbers
from updyn.errors import InputError, in_all

__all__ = ["Geometry"]


@dataclass(frozen=True, slots=True, eq=False, init=False)
class Geometry:
    """Node positions in the global Cartesian system, with lines and faces to draw between them.

    Parameters
    ----------
    nodes : array_like of int, shape (n,)
        Node numbers, each once.
    xyz : array_like of float, shape (n, 3)
        Positions in m.
    lines : array_like of int, shape (m, 2), optional
        Pairs of node numbers of lines to draw.
    axes : array_like of float, shape (n, 3, 3), optional
        Displacement directions of each node: rows are its X, Y, Z, orthonormal (to 1e-4), in the
        global system. By default, the global axes.
    faces : array_like of int, shape (k, 4), optional
        Quadrangles to draw (shells and outer faces of solids), by node numbers around each. The
        last node of a triangle is repeated.

    Raises
    ------
    InputError
        If shapes disagree, a node is not a whole number or occurs twice, a position is not finite,
        a line or a face names an unknown node, or the directions of a node are not orthonormal.

    Examples
    --------
    >>> geometry = updyn.Geometry([1, 2], [[0, 0, 0], [1, 0, 0]], [[1, 2]])
    >>> geometry.position([2])
    array([[1., 0., 0.]])
    """

    nodes: IntArray
    xyz: RealArray
    lines: IntArray
    axes: RealArray | None
    faces: IntArray

    def __init__(
        self,
        nodes: ArrayLike,
        xyz: ArrayLike,
        lines: ArrayLike | None = None,
        axes: ArrayLike | None = None,
        faces: ArrayLike | None = None,
    ) -> None:
        ids = whole_numbers(nodes, "geometry: nodes", InputError)
        points = _floats(xyz, "positions")
        if ids.ndim != 1 or points.shape != (len(ids), 3):
            raise InputError(
                f"geometry: expected n node numbers and (n, 3) positions, found {ids.shape} and"
                f" {points.shape}"
            )
        pairs = _node_numbers(lines, "lines", "m", 2)
        quadrangles = _node_numbers(faces, "faces", "k", 4)
        if not np.isfinite(points).all():
            raise InputError(
                f"geometry: the position of node {ids[~np.isfinite(points).all(axis=1)][0]} is not"
                " finite"
            )
        values, counts = np.unique(ids, return_counts=True)
        if (counts > 1).any():
            raise InputError(f"geometry: node {values[counts > 1][0]} occurs twice")
        for what, named in (("line", pairs), ("face", quadrangles)):
            if not np.isin(named, ids).all():
                raise InputError(
                    f"geometry: a {what} names node {named[~np.isin(named, ids)][0]}, which has no"
                    " position"
                )
        directions = None
        if axes is not None:
            directions = _directions(axes, ids)
        for name, array in (
            ("nodes", ids),
            ("xyz", points),
            ("lines", pairs),
            ("axes", directions),
            ("faces", quadrangles),
        ):
            if array is not None:
                array.flags.writeable = False
            object.__setattr__(self, name, array)

    def __reduce__(self) -> tuple[object, ...]:
        return Geometry, (self.nodes, self.xyz, self.lines, self.axes, self.faces)

    @property
    def line_ends(self) -> IndexArray:
        """The ends of each line as indices of `nodes`, shape (m, 2)."""
        return self._places(self.lines)

    @property
    def face_corners(self) -> IndexArray:
        """The corners of each face as indices of `nodes`, shape (k, 4)."""
        return self._places(self.faces)

    def _places(self, numbers: IntArray) -> IndexArray:
        order = np.argsort(self.nodes)
        return np.asarray(order[np.searchsorted(self.nodes, numbers, sorter=order)])

    def position(self, nodes: ArrayLike) -> RealArray:
        """Return the positions of nodes.

        Parameters
        ----------
        nodes : array_like of int, shape (k,)
            Node numbers.

        Returns
        -------
        ndarray of float, shape (k, 3)
            Positions in m.

        Raises
        ------
        InputError
            If a node has no position.
        """
        wanted = np.atleast_1d(whole_numbers(nodes, "geometry: nodes", InputError))
        missing = wanted[~np.isin(wanted, self.nodes)]
        if missing.size:
            raise InputError(
                f"geometry: node {missing[0]} has no position{in_all(missing.size)};"
                f" {_near(self.nodes, missing[0])}"
            )
        order = np.argsort(self.nodes)
        at = np.searchsorted(self.nodes, wanted, sorter=order)
        return np.asarray(self.xyz[order[at]])


def _floats(given: ArrayLike, what: str) -> RealArray:
    try:
        return np.array(given, dtype=np.float64)
    except (TypeError, ValueError) as cause:
        raise InputError(f"geometry: {what} are not an array of numbers ({cause})") from cause


def _node_numbers(given: ArrayLike | None, what: str, rows: str, columns: int) -> IntArray:
    if given is None:
        given = np.empty((0, columns))
    numbers = whole_numbers(given, f"geometry: {what}", InputError)
    if numbers.size == 0:
        numbers = numbers.reshape(0, columns)
    if numbers.ndim != 2 or numbers.shape[1] != columns:
        raise InputError(
            f"geometry: expected {what} as ({rows}, {columns}) node numbers, found {numbers.shape}"
        )
    return numbers


def _directions(given: ArrayLike, ids: IntArray) -> RealArray:
    axes = _floats(given, "axes")
    if axes.shape != (len(ids), 3, 3):
        raise InputError(f"geometry: expected axes of shape {(len(ids), 3, 3)}, found {axes.shape}")
    with np.errstate(invalid="ignore", over="ignore"):
        fits = (
            (np.abs(axes @ axes.transpose(0, 2, 1) - np.eye(3)) < 1e-4)
            .reshape(len(ids), 9)
            .all(axis=1)
        )
    if not fits.all():
        raise InputError(
            f"geometry: the axes of node {ids[~fits][0]} are not three perpendicular directions of"
            " length 1"
        )
    return axes


def _near(nodes: IntArray, node: np.int64) -> str:
    if not nodes.size:
        return "the geometry is empty"
    best = nodes[np.argsort(np.abs(nodes - node), kind="stable")[:3]]
    return "nearest: " + ", ".join(map(str, best))
