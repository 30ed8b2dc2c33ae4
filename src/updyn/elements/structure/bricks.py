"""Hexahedra of eight nodes and wedges of six in the formulation of Nastran, computed in batches.

Hexahedra have internal functions 1 - r^2 (Taylor, Beresford & Wilson, Int. J. Numer. Methods Eng.
10 (1976) 1211-1219) and reduced shear integration, the defaults of PSOLID (MSC Nastran Quick
Reference Guide, PSOLID): the shear strain of two natural axes is constant along both. Its value is
the mean over the volume (Hughes, Int. J. Numer. Methods Eng. 15 (1980) 1413-1418), so the patch
test holds. Wedges are isoparametric. scikit-fem is not needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from updyn.arrays import RealArray

__all__ = ["brick_matrices", "find_inside_out", "mass_matrices"]

#: Corners of the hexahedron in natural coordinates, in the order of VTK and Nastran.
_BOTTOM = [(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1)]
_CORNERS = np.array([*_BOTTOM, *((x, y, 1) for x, y, _ in _BOTTOM)], dtype=np.float64)
_GAUSS = 1 / 3**0.5
#: Points of a triangle, exact for polynomials of order 2, each of weight 1/6.
_TRIANGLE = ((1 / 6, 1 / 6), (2 / 3, 1 / 6), (1 / 6, 2 / 3))
#: Slopes of the three triangle coordinates 1 - x - y, x, y.
_SLOPES = np.array([[-1.0, 1.0, 0.0], [-1.0, 0.0, 1.0]])
#: The two axes of each shear strain, in the order of the third axis.
_SHEARS = ((1, 2), (2, 0), (0, 1))


@dataclass(frozen=True, slots=True, eq=False)
class _BrickShape:
    """Shape functions N (q, k) and slopes (q, 3, k) at points (q, 3), all of weight w."""

    w: float
    N: RealArray
    slopes: RealArray
    points: RealArray


def brick_matrices(
    xyz: RealArray, E: float, nu: float, rho: float, lumped: bool = False
) -> tuple[RealArray, RealArray]:
    """Return stiffness and mass, each shape (m, 3 k, 3 k), of hexahedra or wedges.

    `xyz` has shape (m, k, 3) with k = 8 or 6, in the order of VTK; no element may be inside out
    (`find_inside_out`). For a lumped mass see `mass_matrices`.
    """
    shape = _shape(xyz.shape[1])
    n = 3 * xyz.shape[1]
    strain, volume = _strains(shape, xyz)
    full = _integrate(strain, volume, _elasticity(E, nu))
    K = full[:, :n, :n]
    if full.shape[1] > n:  # condense the internal functions
        K = K - full[:, :n, n:] @ np.linalg.solve(full[:, n:, n:], full[:, n:, :n])
    return 0.5 * (K + K.transpose(0, 2, 1)), mass_matrices(volume, shape.N, rho, lumped)


def mass_matrices(volume: RealArray, N: RealArray, rho: float, lumped: bool) -> RealArray:
    """Return the mass of solids, shape (m, 3 k, 3 k), node by node.

    `volume` (m, q) and the shape functions `N` (q, k) are those of the quadrature points.
    """
    # A lumped mass is scaled from the diagonal of the consistent one (Hinton, Rock & Zienkiewicz,
    # Earthquake Eng. Struct. Dyn. 4 (1976) 245-249).
    mass = rho * np.einsum("mq,qa,qb->mab", volume, N, N, optimize=True)
    m, k = mass.shape[:2]
    if lumped:
        diagonal = np.einsum("maa->ma", mass)
        total = mass.sum(axis=(1, 2))
        scale = np.divide(total, diagonal.sum(axis=1), out=np.zeros_like(total), where=total != 0)
        mass = np.eye(k) * (diagonal * scale[:, None])[:, None, :]
    M = np.zeros((m, k, 3, k, 3))
    for i in range(3):
        M[:, :, i, :, i] = mass
    return M.reshape(m, 3 * k, 3 * k)


def find_inside_out(xyz: RealArray) -> int | None:
    """Return the index of the first element with a point of non-positive volume, or None."""
    good = (np.linalg.det(_shape(xyz.shape[1]).slopes @ xyz[:, None]) > 0).all(axis=1)
    return None if good.all() else int(np.argmin(good))


def _strains(shape: _BrickShape, xyz: RealArray) -> tuple[RealArray, RealArray]:
    """Return strains by displacements, (m, q, 6, 3 k + internal), and volumes (m, q)."""
    J = shape.slopes @ xyz[:, None]
    slopes = np.broadcast_to(shape.slopes, (len(xyz), *shape.slopes.shape))
    volume = np.linalg.det(J) * shape.w
    found = _strains_of_gradients(np.linalg.solve(J, slopes))
    if xyz.shape[1] == 8:
        centre = shape.slopes.mean(axis=0) @ xyz
        _reduce_shear(found, volume, centre, shape)
        found = np.concatenate([found, _internal_strains(shape, volume, centre)], axis=3)
    return found, volume


def _strains_of_gradients(gradients: RealArray) -> RealArray:
    """Return strains (m, q, 6, 3 k) of functions with gradients (m, q, 3, k)."""
    m, q, _, k = gradients.shape
    out = np.zeros((m, q, 6, k, 3))
    for i in range(3):
        out[:, :, i, :, i] = gradients[:, :, i]
    for row, (i, j) in enumerate(_SHEARS, 3):
        out[:, :, row, :, i], out[:, :, row, :, j] = gradients[:, :, j], gradients[:, :, i]
    return out.reshape(m, q, 6, 3 * k)


def _internal_strains(shape: _BrickShape, volume: RealArray, centre: RealArray) -> RealArray:
    """Return the strains of the functions 1 - r^2, (m, q, 6, 9); their mean is zero."""
    # `centre` is the Jacobian at the centre, (m, 3, 3), used at all points for the patch test to
    # hold.
    slopes = np.zeros((len(volume), len(shape.points), 3, 3))
    for i in range(3):
        slopes[:, :, i, i] = -2 * shape.points[:, i]
    ratio = np.linalg.det(centre)[:, None] * shape.w / volume
    gradients = np.linalg.solve(centre[:, None], slopes) * ratio[:, :, None, None]
    return _strains_of_gradients(gradients)


def _reduce_shear(
    strain: RealArray, volume: RealArray, centre: RealArray, shape: _BrickShape
) -> None:
    """Replace natural shear strains by their means over points with the same third coordinate."""
    axes = centre / np.linalg.norm(centre, axis=2, keepdims=True)
    to_natural = _strain_transformation(axes)
    natural = to_natural[:, None, 3:] @ strain  # (m, q, 3, n)
    change = -natural
    for axis in range(3):
        for side in (-1.0, 1.0):
            layer = np.flatnonzero(shape.points[:, axis] * side > 0)
            weight = volume[:, layer] / volume[:, layer].sum(axis=1, keepdims=True)
            mean = np.einsum("mq,mqn->mn", weight, natural[:, layer, axis])
            change[:, layer, axis] += mean[:, None]
    shears = np.broadcast_to(np.eye(6)[:, 3:], (len(strain), 6, 3))
    strain += np.linalg.solve(to_natural, shears)[:, None] @ change


def _strain_transformation(J: RealArray) -> RealArray:
    """Return the matrices (m, 6, 6) from strains to those along the rows of J (m, 3, 3)."""
    T = np.zeros((len(J), 6, 6))
    for row, (a, b) in enumerate([(0, 0), (1, 1), (2, 2), *_SHEARS]):
        factor = 1.0 if a == b else 2.0
        for i in range(3):
            T[:, row, i] = factor * J[:, a, i] * J[:, b, i]
        for column, (i, j) in enumerate(_SHEARS, 3):
            T[:, row, column] = factor / 2 * (J[:, a, i] * J[:, b, j] + J[:, a, j] * J[:, b, i])
    return T


def _elasticity(E: float, nu: float) -> RealArray:
    D = np.zeros((6, 6))
    D[:3, :3] = E * nu / ((1 + nu) * (1 - 2 * nu))
    shear = E / (2 * (1 + nu))
    D += np.diag([2 * shear] * 3 + [shear] * 3)
    return D


def _integrate(strain: RealArray, volume: RealArray, D: RealArray) -> RealArray:
    m, q, _, n = strain.shape
    stress = ((D @ strain) * volume[:, :, None, None]).reshape(m, 6 * q, n)
    return np.asarray(strain.reshape(m, 6 * q, n).transpose(0, 2, 1) @ stress)


@lru_cache
def _shape(k: int) -> _BrickShape:
    return _hexahedron() if k == 8 else _wedge()


def _hexahedron() -> _BrickShape:
    points = _CORNERS * _GAUSS
    terms = 1 + points[:, None] * _CORNERS  # (q, k, 3)
    slopes = np.empty((8, 3, 8))
    for i in range(3):
        j, other = _SHEARS[i]
        slopes[:, i] = _CORNERS[:, i] * terms[:, :, j] * terms[:, :, other] / 8
    return _BrickShape(1.0, terms.prod(axis=2) / 8, slopes, points)


def _wedge() -> _BrickShape:
    heights = (0.5 - 0.5 * _GAUSS, 0.5 + 0.5 * _GAUSS)
    points = np.array([(x, y, z) for z in heights for x, y in _TRIANGLE])
    x, y, z = points.T[:, :, None]
    triangle = np.concatenate([1 - x - y, x, y], axis=1)
    N = np.concatenate([triangle * (1 - z), triangle * z], axis=1)
    slopes = np.empty((6, 3, 6))
    slopes[:, :2, :3] = _SLOPES * (1 - z)[:, None]
    slopes[:, :2, 3:] = _SLOPES * z[:, None]
    slopes[:, 2, :3], slopes[:, 2, 3:] = -triangle, triangle
    return _BrickShape(1 / 12, N, slopes, points)
