"""Solid elements: hexahedra of 8 and 20 nodes, tetrahedra of 4 and 10, all elements of a batch at once.

Shape functions and quadrature points are those of scikit-fem. Matrices follow Zienkiewicz, Taylor &
Zhu, The Finite Element Method, 6th ed. 2005, chapters 5 and 6. Eight-node hexahedra have the
incompatible modes of Taylor, Beresford & Wilson, Int. J. Numer. Methods Eng. 10 (1976) 1211-1219,
so that they bend; four-node tetrahedra are stiff and are best kept for filling.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.errors import ModelError

__all__ = ["CORNERS", "FACES", "inside_out", "solid_matrices"]

_CUBE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
_CUBE_EDGES = [
    (0, 1),
    (1, 2),
    (2, 3),
    (3, 0),
    (4, 5),
    (5, 6),
    (6, 7),
    (7, 4),
    (0, 4),
    (1, 5),
    (2, 6),
    (3, 7),
]
_SIMPLEX = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
_SIMPLEX_EDGES = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]

#: Number of corners by number of nodes.
CORNERS = {4: 4, 8: 8, 10: 4, 20: 8}
#: Faces by number of corners, as positions in an element, outwards.
FACES: dict[int, list[tuple[int, ...]]] = {
    4: [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)],
    8: [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)],
}


@dataclass(frozen=True, slots=True, eq=False)
class _Shape:
    """Functions N, shape (q, k), and their slopes, shape (q, 3, k), at points of weights w, shape (q,)."""

    w: NDArray[np.float64]
    N: NDArray[np.float64]
    slopes: NDArray[np.float64]
    points: NDArray[np.float64]


def solid_matrices(
    xyz: NDArray[np.float64], E: float, nu: float, rho: float, lumped: bool = False
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return stiffness and mass of solid elements, each shape (m, 3 k, 3 k), in N/m and kg.

    Parameters
    ----------
    xyz : ndarray of float, shape (m, k, 3)
        Positions in m of the k = 4, 8, 10 or 20 nodes of m elements, none of them inside out
        (`inside_out`), in the order of VTK: corners, then the middles of the edges (of hexahedra
        those of the first face, of the second, and between them).
    E, nu, rho : float
        Young's modulus in Pa, Poisson's ratio (below 0.5), density in kg/m3.
    lumped : bool
        A diagonal mass, scaled from the diagonal of the consistent one (Hinton, Rock & Zienkiewicz,
        Earthquake Eng. Struct. Dyn. 4 (1976) 245-249).

    Raises
    ------
    ModelError
        If scikit-fem is missing.
    """
    k = xyz.shape[1]
    stiff, heavy = _shape(k, mass=False), _shape(k, mass=True)
    G, volume = _gradients(stiff, xyz)
    K = _elastic(G, volume, E, nu)
    if k == 8:
        K = _with_bending(K, G, volume, xyz, stiff, E, nu)
    _, volume = _gradients(heavy, xyz)
    m = rho * np.einsum("mq,qa,qb->mab", volume, heavy.N, heavy.N, optimize=True)
    if lumped:
        diagonal = np.einsum("maa->ma", m)
        m = (
            np.eye(k)
            * (diagonal * (m.sum(axis=(1, 2)) / diagonal.sum(axis=1))[:, None])[:, None, :]
        )
    M = np.zeros((len(m), k, 3, k, 3))
    for i in range(3):
        M[:, :, i, :, i] = m
    return 0.5 * (K + K.transpose(0, 2, 1)), M.reshape(len(m), 3 * k, 3 * k)


def inside_out(xyz: NDArray[np.float64]) -> int | None:
    """Return the first element, of shape (m, k, 3), that has no positive volume at some point; None: all have."""
    k = xyz.shape[1]
    good = np.ones(len(xyz), dtype=np.bool_)
    for mass in (False, True):
        good &= (np.linalg.det(_shape(k, mass).slopes @ xyz[:, None]) > 0).all(axis=1)
    return None if good.all() else int(np.argmin(good))


def _gradients(
    shape: _Shape, xyz: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the slopes along x, y, z, shape (m, q, 3, k), and the volume of each point, shape (m, q), in m3."""
    J = shape.slopes @ xyz[:, None]
    dN = np.broadcast_to(shape.slopes, (len(xyz), *shape.slopes.shape))
    return np.asarray(np.linalg.solve(J, dN), dtype=np.float64), np.linalg.det(J) * shape.w


def _elastic(
    G: NDArray[np.float64], volume: NDArray[np.float64], E: float, nu: float
) -> NDArray[np.float64]:
    """Return the stiffness of isotropic solids in the DOFs (node, direction), shape (m, 3 k, 3 k)."""
    lame, shear = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))
    m, q, _, k = G.shape
    rows = G.transpose(0, 3, 2, 1).reshape(m, 3 * k, q)  # (node, direction) by point
    P = ((rows * volume[:, None]) @ rows.transpose(0, 2, 1)).reshape(m, k, 3, k, 3)
    K = lame * P + shear * P.transpose(0, 1, 4, 3, 2)
    trace = shear * np.einsum("maibi->mab", P)
    for i in range(3):
        K[:, :, i, :, i] += trace
    return np.asarray(K.reshape(m, 3 * k, 3 * k))


def _with_bending(
    K: NDArray[np.float64],
    G: NDArray[np.float64],
    volume: NDArray[np.float64],
    xyz: NDArray[np.float64],
    shape: _Shape,
    E: float,
    nu: float,
) -> NDArray[np.float64]:
    """Add the three incompatible modes 1 - r^2 of each direction and condense them."""
    centre = _shape_at(8, np.array([[0.5], [0.5], [0.5]]))
    J = (
        centre.slopes @ xyz[:, None]
    )  # (m, 1, 3, 3): slopes are turned by that of the centre, so that the patch test holds
    r = 2 * shape.points - 1  # (3, q)
    slopes = np.zeros((shape.w.size, 3, 3))
    for i in range(3):
        slopes[:, i, i] = -4 * r[i]  # d(1 - r^2)/dx of x = (r + 1) / 2
    own = np.linalg.solve(
        np.broadcast_to(J, (len(xyz), len(slopes), 3, 3)),
        np.broadcast_to(slopes, (len(xyz), *slopes.shape)),
    )
    own = own * (np.linalg.det(J) / (volume / shape.w))[:, :, None, None]
    full = _elastic(np.concatenate([G, own], axis=3), volume, E, nu)
    return K - full[:, :24, 24:] @ np.linalg.solve(full[:, 24:, 24:], full[:, 24:, :24])


@lru_cache
def _shape(k: int, mass: bool) -> _Shape:
    quadrature = _library().quadrature.get_quadrature
    refdom = _library().refdom
    cube = CORNERS[k] == 8
    order = {4: (1, 2), 8: (2, 2), 10: (2, 4), 20: (4, 4)}[k][mass]
    points, weights = quadrature(refdom.RefHex if cube else refdom.RefTet, order)
    found = _shape_at(k, points)
    return _Shape(weights, found.N, found.slopes, points)


def _shape_at(k: int, points: NDArray[np.float64]) -> _Shape:
    """Return the shape functions at points, shape (3, q), in the order of VTK."""
    fem = _library()
    element = {4: fem.ElementTetP1, 8: fem.ElementHex1, 10: fem.ElementTetP2, 20: fem.ElementHexS2}[
        k
    ]()
    corners, edges = (_CUBE, _CUBE_EDGES) if CORNERS[k] == 8 else (_SIMPLEX, _SIMPLEX_EDGES)
    nodes = np.array(corners, dtype=float)
    if k > len(corners):
        nodes = np.concatenate([nodes, [(nodes[a] + nodes[b]) / 2 for a, b in edges]])
    own = [int(np.argmin(np.abs(element.doflocs - node).sum(axis=1))) for node in nodes]
    both = [element.lbasis(points, i) for i in own]
    N = np.array([np.broadcast_to(value, points.shape[1:]) for value, _ in both]).T
    dN = np.array([np.broadcast_to(slope, points.shape) for _, slope in both]).transpose(2, 1, 0)
    return _Shape(np.ones(points.shape[1]), N, dN, points)


def _library() -> Any:
    try:
        import skfem
    except ImportError as error:
        raise ModelError('solids need scikit-fem: pip install "updyn[structures]"') from error
    return skfem
