"""Flat shells in space: frames of their own, warped quadrilaterals, and the transverse shear of four-node shells.

Membrane, bending and drilling come from pyfe3d. Of four-node shells the transverse shear is that of
Dvorkin & Bathe, Engineering Computations 1 (1984) 77-88 (MITC4): tied at the middles of the edges,
free of locking and of motions without energy. A node that stands off the mean plane of its
quadrilateral is carried by a rigid arm along the normal, so that turning the whole does not strain
it (MacNeal, Finite Elements: Their Design and Performance, 1994, ch. 10).
"""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray

from updyn.elements.structure import pyfe
from updyn.elements.structure.parts import Shell
from updyn.errors import ModelError, UpdynWarning

__all__ = ["shell_matrices"]

_FLAT = 1e-9  # of the size: nodes closer than this to the plane are in it
_WARPED = 0.1  # of the size: beyond it flat elements are a poor choice
_CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def shell_matrices(
    part: Shell, xyz: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return stiffness and consistent mass of shells, each shape (m, 6 k, 6 k) with k of 3 or 4 nodes.

    Parameters
    ----------
    part : Shell
        Thickness and material.
    xyz : ndarray of float, shape (m, k, 3)
        Positions of the nodes in m.

    Raises
    ------
    ModelError
        If an element is not convex, or has no area.

    Warns
    -----
    UpdynWarning
        If a quadrilateral is far from flat.
    """
    axes = _frames(part, xyz)
    local = np.einsum("mij,mkj->mki", axes, xyz - xyz.mean(axis=1, keepdims=True))
    height = local[:, :, 2].copy()
    size = np.sqrt(_areas(part, local))
    _check_warp(part, np.abs(height).max(axis=1) / size)
    height[np.abs(height) < _FLAT * size[:, None]] = 0.0
    local[:, :, 2] = 0.0
    K, M = pyfe.plate_matrices(part, local)
    if xyz.shape[1] == 4:
        K = K + _shear(part, local[:, :, :2])
    T = _transformation(axes, height)
    return T.transpose(0, 2, 1) @ K @ T, T.transpose(0, 2, 1) @ M @ T


def _frames(part: Shell, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return local x, y and normal as rows, shape (m, 3, 3): x along the first edge, or between the diagonals."""
    if xyz.shape[1] == 3:
        x, other = xyz[:, 1] - xyz[:, 0], xyz[:, 2] - xyz[:, 0]
        normal = np.cross(x, other)
    else:
        a, b = xyz[:, 2] - xyz[:, 0], xyz[:, 1] - xyz[:, 3]
        x, normal = a + b, np.cross(b, a)
    length = np.linalg.norm(normal, axis=1)
    small = length <= 1e-12 * np.square(np.ptp(xyz, axis=1)).sum(axis=1)
    if small.any():
        raise ModelError(f"{_which(part, int(np.argmax(small)))} has no area")
    normal = normal / length[:, None]
    x = x - np.einsum("mi,mi->m", x, normal)[:, None] * normal
    x = x / np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(normal, x), normal], axis=1)


def _areas(part: Shell, local: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y = local[:, :, 0], local[:, :, 1]
    if local.shape[1] == 4:  # twice the area of the triangle at each corner
        a, b = np.roll(local, -1, axis=1) - local, np.roll(local, 1, axis=1) - local
        corner = a[:, :, 0] * b[:, :, 1] - a[:, :, 1] * b[:, :, 0]
        bad = (corner <= 0).any(axis=1)
        if bad.any():
            raise ModelError(
                f"{_which(part, int(np.argmax(bad)))} is not convex, or its nodes are not in order"
                " around it"
            )
    return np.asarray(
        0.5 * np.abs((x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)).sum(axis=1))
    )


def _which(part: Shell, at: int) -> str:
    return f"shell {part.name!r}: the element of nodes {part.connectivity[at].tolist()}"


def _check_warp(part: Shell, warp: NDArray[np.float64]) -> None:
    if warp.max() > _WARPED:
        warnings.warn(
            f"{_which(part, int(np.argmax(warp)))} is warped: a node stands {warp.max():.0%} of its"
            f" size off the plane ({int((warp > _WARPED).sum())} such); two triangles, or a finer"
            " mesh, would follow the surface better",
            UpdynWarning,
            stacklevel=2,
        )


def _transformation(axes: NDArray[np.float64], height: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return local DOFs in the plane from global DOFs of the nodes, shape (m, 6 k, 6 k)."""
    m, k = height.shape
    T = np.zeros((m, k, 6, k, 6))
    for i in range(k):
        T[:, i, :3, i, :3] = T[:, i, 3:, i, 3:] = axes
        # The point in the plane stands -h along the normal: u + theta x (0, 0, -h).
        T[:, i, 0, i, 3:] -= height[:, i, None] * axes[:, 1]
        T[:, i, 1, i, 3:] += height[:, i, None] * axes[:, 0]
    return T.reshape(m, 6 * k, 6 * k)


def _shear(part: Shell, xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the transverse shear stiffness of quadrilaterals, shape (m, 24, 24), of the corners, shape (m, 4, 2)."""
    shear = 5 / 6 * part.E / (2 * (1 + part.nu)) * part.thickness
    along = {side: _covariant(xy, 0, (0.0, side)) for side in (-1.0, 1.0)}
    across = {side: _covariant(xy, 1, (side, 0.0)) for side in (-1.0, 1.0)}
    out = np.zeros((len(xy), 24, 24))
    for p, q in _CORNERS / np.sqrt(3.0):
        J = np.einsum("ai,mij->maj", _gradients(p, q), xy)
        B = np.stack(
            [
                0.5 * ((1 - q) * along[-1.0] + (1 + q) * along[1.0]),
                0.5 * ((1 - p) * across[-1.0] + (1 + p) * across[1.0]),
            ],
            axis=1,
        )
        B = np.linalg.solve(J, B)
        out += shear * np.linalg.det(J)[:, None, None] * (B.transpose(0, 2, 1) @ B)
    return out


def _covariant(xy: NDArray[np.float64], axis: int, at: tuple[float, float]) -> NDArray[np.float64]:
    """Return the covariant shear strain w,a + x,a ry - y,a rx at a point, shape (m, 24), in the local DOFs."""
    slope = _gradients(*at)[axis]
    N = (1 + _CORNERS[:, 0] * at[0]) * (1 + _CORNERS[:, 1] * at[1]) / 4
    tangent = np.einsum("i,mij->mj", slope, xy)
    row = np.zeros((len(xy), 4, 6))
    row[:, :, 2] = slope
    row[:, :, 3] = -tangent[:, 1, None] * N
    row[:, :, 4] = tangent[:, 0, None] * N
    return row.reshape(len(xy), 24)


def _gradients(p: float, q: float) -> NDArray[np.float64]:
    """Return the derivatives of the four bilinear functions by both coordinates, shape (2, 4)."""
    return (
        np.stack(
            [_CORNERS[:, 0] * (1 + _CORNERS[:, 1] * q), _CORNERS[:, 1] * (1 + _CORNERS[:, 0] * p)]
        )
        / 4
    )
