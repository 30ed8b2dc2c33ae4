"""Solid elements: hexahedra of 8 and 20 nodes, tetrahedra of 4 and 10, computed in batches.

Shape functions and quadrature points are those of scikit-fem. Matrices follow Zienkiewicz, Taylor
& Zhu, The Finite Element Method, 6th ed. 2005, chapters 5 and 6. Eight-node hexahedra have the
incompatible modes of Taylor, Beresford & Wilson, Int. J. Numer. Methods Eng. 10 (1976) 1211-1219,
which improve bending; four-node tetrahedra are too stiff and best used for filling only.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from updyn.arrays import IntArray, RealArray
from updyn.elements.checks import check_connectivity, check_material, set_fields
from updyn.elements.structure.bricks import mass_matrices
from updyn.elements.structure.element import TRANSLATIONS, Element, ElementMatrices
from updyn.errors import ModelError
from updyn.shapes import HEXAHEDRON, TETRAHEDRON

__all__ = ["Solid", "inside_out", "solid_matrices"]

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
_CORNERS = {4: 4, 8: 8, 10: 4, 20: 8}
_SHAPES = {4: TETRAHEDRON, 8: HEXAHEDRON}
_ELEMENTS = {4: "ElementTetP1", 8: "ElementHex1", 10: "ElementTetP2", 20: "ElementHexS2"}
#: Orders of the quadrature of stiffness and of mass, by number of nodes.
_ORDERS = {4: (1, 2), 8: (2, 2), 10: (2, 4), 20: (4, 4)}


@dataclass(frozen=True, slots=True, eq=False)
class Solid(Element):
    """Solid elements of one material. Their nodes have X, Y, Z only.

    Parameters
    ----------
    name : str
        Group name; parts of the same name form one group.
    connectivity : array_like of int, shape (m, 4), (m, 8), (m, 10) or (m, 20)
        Node numbers of tetrahedra (4, 10) or hexahedra (8, 20), in the order of VTK and meshio:
        corners, then midpoints of edges (for hexahedra: of the first face, of the second face, and
        between them).
    E, rho : float
        Young's modulus in Pa and density in kg/m3 (0: without mass).
    nu : float
        Poisson's ratio, below 0.5.
    loss_factor : float
        Structural loss factor.
    lumped : bool
        Whether to use a diagonal mass instead of the consistent one.

    Raises
    ------
    ModelError
        If a number is out of range.
    """

    name: str
    connectivity: Any
    E: float
    rho: float
    nu: float = 0.3
    loss_factor: float = 0.0
    lumped: bool = False

    directions: ClassVar[tuple[int, ...]] = TRANSLATIONS
    encloses: ClassVar[bool] = True

    def __post_init__(self) -> None:
        what = self.label
        nodes = check_connectivity(what, self.connectivity, (4, 8, 10, 20))
        set_fields(self, connectivity=nodes, **check_material(what, self))
        if not self.nu < 0.5:
            raise ModelError(f"{what}: nu {self.nu!r}; expected below 0.5")
        if not isinstance(self.lumped, bool):
            raise ModelError(f"{what}: lumped {self.lumped!r}; expected True or False")

    def matrices(self, numbers: IntArray, xyz: RealArray) -> ElementMatrices:
        """Compute stiffness and mass of given elements."""
        bad = inside_out(xyz)
        if bad is not None:
            raise ModelError(
                f"{self.label}: the element of nodes {numbers[bad].tolist()} is turned inside out"
                " or has no volume: its nodes are not in order, or it is too distorted"
            )
        K, M = solid_matrices(xyz, self.E, self.nu, self.rho, self.lumped)
        return ElementMatrices(K, M if self.rho else None)

    def edges(self) -> IntArray:
        """Return the edges, corner to corner, of the outer faces."""
        outer = self.faces()
        return np.stack([outer, np.roll(outer, -1, axis=1)], axis=2).reshape(-1, 2)

    def faces(self) -> IntArray:
        """Return the corners of the outer faces, which belong to one element only."""
        corners = np.array(_SHAPES[_CORNERS[self.connectivity.shape[1]]].faces)
        faces = self.connectivity[:, corners].reshape(-1, corners.shape[1])
        _, first, count = np.unique(
            np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
        )
        return np.asarray(faces[first[count == 1]])


@dataclass(frozen=True, slots=True, eq=False)
class _Shape:
    """Shape functions N (q, k) and slopes (q, 3, k) at points (3, q) of weights w (q,)."""

    w: RealArray
    N: RealArray
    slopes: RealArray
    points: RealArray


def solid_matrices(
    xyz: RealArray, E: float, nu: float, rho: float, lumped: bool = False
) -> tuple[RealArray, RealArray]:
    """Return stiffness and mass of solid elements, each shape (m, 3 k, 3 k), in N/m and kg.

    The nodes are in the order of VTK, and no element may be `inside_out`.
    """
    k = xyz.shape[1]
    at_stiffness = _shape(k, mass=False)
    at_mass = _shape(k, mass=True)
    G, volume = _gradients(at_stiffness, xyz)
    K = _elastic(G, volume, E, nu)
    if k == 8:
        K = _with_bending(K, G, volume, xyz, at_stiffness, E, nu)
    _, volume = _gradients(at_mass, xyz)
    return 0.5 * (K + K.transpose(0, 2, 1)), mass_matrices(volume, at_mass.N, rho, lumped)


def inside_out(xyz: RealArray) -> int | None:
    """Return the index of the first element with a point of non-positive volume, or None."""
    k = xyz.shape[1]
    good = np.ones(len(xyz), dtype=np.bool_)
    for mass in (False, True):
        good &= (np.linalg.det(_shape(k, mass).slopes @ xyz[:, None]) > 0).all(axis=1)
    return None if good.all() else int(np.argmin(good))


def _gradients(shape: _Shape, xyz: RealArray) -> tuple[RealArray, RealArray]:
    """Return slopes (m, q, 3, k) in 1/m and volumes (m, q) in m3 of the quadrature points."""
    J = shape.slopes @ xyz[:, None]
    dN = np.broadcast_to(shape.slopes, (len(xyz), *shape.slopes.shape))
    return np.asarray(np.linalg.solve(J, dN), dtype=np.float64), np.linalg.det(J) * shape.w


def _elastic(G: RealArray, volume: RealArray, E: float, nu: float) -> RealArray:
    """Return the stiffness of isotropic solids, shape (m, 3 k, 3 k), node by node."""
    lame = E * nu / ((1 + nu) * (1 - 2 * nu))
    shear = E / (2 * (1 + nu))
    m, q, _, k = G.shape
    rows = G.transpose(0, 3, 2, 1).reshape(m, 3 * k, q)  # (node, direction) by point
    P = ((rows * volume[:, None]) @ rows.transpose(0, 2, 1)).reshape(m, k, 3, k, 3)
    K = lame * P + shear * P.transpose(0, 1, 4, 3, 2)
    trace = shear * np.einsum("maibi->mab", P)
    for i in range(3):
        K[:, :, i, :, i] += trace
    return np.asarray(K.reshape(m, 3 * k, 3 * k))


def _with_bending(
    K: RealArray,
    G: RealArray,
    volume: RealArray,
    xyz: RealArray,
    shape: _Shape,
    E: float,
    nu: float,
) -> RealArray:
    """Add the three incompatible modes 1 - r^2 of each direction and condense them."""
    centre = _shape_at(8, np.array([[0.5], [0.5], [0.5]]))
    # The Jacobian of the centre, shape (m, 1, 3, 3), at all points, for the patch test to hold.
    J = centre.slopes @ xyz[:, None]
    r = 2 * shape.points - 1  # (3, q)
    slopes = np.zeros((shape.w.size, 3, 3))
    for i in range(3):
        slopes[:, i, i] = -4 * r[i]  # d(1 - r^2)/dx of x = (r + 1) / 2
    bending_gradients = np.linalg.solve(
        np.broadcast_to(J, (len(xyz), len(slopes), 3, 3)),
        np.broadcast_to(slopes, (len(xyz), *slopes.shape)),
    )
    bending_gradients = (
        bending_gradients * (np.linalg.det(J) / (volume / shape.w))[:, :, None, None]
    )
    full = _elastic(np.concatenate([G, bending_gradients], axis=3), volume, E, nu)
    return K - full[:, :24, 24:] @ np.linalg.solve(full[:, 24:, 24:], full[:, 24:, :24])


@lru_cache
def _shape(k: int, mass: bool) -> _Shape:
    fem = _library()
    domain = fem.refdom.RefHex if _CORNERS[k] == 8 else fem.refdom.RefTet
    order = _ORDERS[k][mass]
    points, weights = fem.quadrature.get_quadrature(domain, order)
    found = _shape_at(k, points)
    return _Shape(weights, found.N, found.slopes, points)


def _shape_at(k: int, points: RealArray) -> _Shape:
    """Return the shape functions at points, shape (3, q), in the order of VTK."""
    element = getattr(_library(), _ELEMENTS[k])()
    corners, edges = (_CUBE, _CUBE_EDGES) if _CORNERS[k] == 8 else (_SIMPLEX, _SIMPLEX_EDGES)
    nodes = np.array(corners, dtype=float)
    if k > len(corners):
        first, second = np.array(edges).T
        nodes = np.concatenate([nodes, (nodes[first] + nodes[second]) / 2])
    q = points.shape[1]
    N = np.empty((k, q))
    slopes = np.empty((k, 3, q))
    for i, node in enumerate(nodes):
        # scikit-fem has another node order: the function is identified by its position.
        index = int(np.argmin(np.abs(element.doflocs - node).sum(axis=1)))
        N[i], slopes[i] = element.lbasis(points, index)
    return _Shape(np.ones(q), N.T, slopes.transpose(2, 1, 0), points)


def _library() -> Any:
    try:
        import skfem
    except ImportError as error:
        raise ModelError('solids need scikit-fem: pip install "updyn[structures]"') from error
    return skfem
