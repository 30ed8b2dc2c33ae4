"""Flat shells: local axes, warped quadrilaterals, and the transverse shear of four-node shells.

Membrane, bending and drilling come from pyfe3d. Transverse shear: MITC4 of Dvorkin & Bathe,
Engineering Computations 1 (1984) 77-88. A rigid arm connects a node off the mean plane of its
quadrilateral, which keeps rigid rotations free of strain (MacNeal, Finite Elements: Their Design
and Performance, 1994, ch. 10).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from updyn.arrays import IntArray, RealArray
from updyn.elements.checks import check_connectivity, check_material, check_positive, set_fields
from updyn.elements.settings import ELEMENT
from updyn.elements.structure import pyfe
from updyn.elements.structure.element import Element, ElementMatrices
from updyn.errors import ModelError, UpdynWarning

__all__ = ["Shell"]

_CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


@dataclass(frozen=True, slots=True, eq=False)
class Shell(Element):
    """Flat shells with three or four nodes, of one thickness and material.

    Parameters
    ----------
    name : str
        Group name; parts of the same name form one group.
    connectivity : array_like of int, shape (m, 3) or (m, 4)
        Node numbers around each element. Triangles and quadrilaterals are two parts, possibly with
        the same name.
    E, rho : float
        Young's modulus in Pa and density in kg/m3 (0: without mass).
    thickness : float
        In m.
    nu : float
        Poisson's ratio.
    loss_factor : float
        Structural loss factor.

    Raises
    ------
    ModelError
        If a number is out of range.
    """

    name: str
    connectivity: Any
    E: float
    rho: float
    thickness: float
    nu: float = 0.3
    loss_factor: float = 0.0

    def __post_init__(self) -> None:
        what = self.label
        nodes = check_connectivity(what, self.connectivity, (3, 4))
        set_fields(self, connectivity=nodes, **check_material(what, self))
        set_fields(self, thickness=check_positive(what, "thickness", self.thickness))

    def matrices(self, numbers: IntArray, xyz: RealArray) -> ElementMatrices:
        """Compute stiffness and consistent mass of given shells.

        Parameters
        ----------
        numbers : ndarray of int, shape (m, k)
            Node numbers, k of 3 or 4.
        xyz : ndarray of float, shape (m, k, 3)
            Positions of the nodes in m.

        Returns
        -------
        ElementMatrices

        Raises
        ------
        ModelError
            If an element is not convex, or has no area.

        Warns
        -----
        UpdynWarning
            If a quadrilateral is far from flat.
        """
        axes = self._axes(numbers, xyz)
        local = np.einsum("mij,mkj->mki", axes, xyz - xyz.mean(axis=1, keepdims=True))
        height = local[:, :, 2].copy()
        size = np.sqrt(self._areas(numbers, local))
        self._check_warp(numbers, np.abs(height).max(axis=1) / size)
        height[np.abs(height) < ELEMENT.rounding * size[:, None]] = 0.0
        local[:, :, 2] = 0.0
        K, M = pyfe.plate_matrices(self.label, self.thickness, self.E, self.nu, self.rho, local)
        if xyz.shape[1] == 4:
            K = K + self._shear_stiffness(local[:, :, :2])
        T = _transformation(axes, height)
        K = T.transpose(0, 2, 1) @ K @ T
        M = T.transpose(0, 2, 1) @ M @ T
        return ElementMatrices(K, M if self.rho else None)

    def edges(self) -> IntArray:
        """Return the edges of the shells."""
        following = np.roll(self.connectivity, -1, axis=1)
        return np.stack([self.connectivity, following], axis=2).reshape(-1, 2)

    def faces(self) -> IntArray:
        """Return the node numbers of the shells."""
        return np.asarray(self.connectivity)

    def _axes(self, numbers: IntArray, xyz: RealArray) -> RealArray:
        """Return local x, local y and the normal as rows, shape (m, 3, 3).

        Local x is along the first edge of a triangle, and between the diagonals of a quadrilateral.
        """
        if xyz.shape[1] == 3:
            x = xyz[:, 1] - xyz[:, 0]
            normal = np.cross(x, xyz[:, 2] - xyz[:, 0])
        else:
            a = xyz[:, 2] - xyz[:, 0]
            b = xyz[:, 1] - xyz[:, 3]
            x = a + b
            normal = np.cross(b, a)
        length = np.linalg.norm(normal, axis=1)
        small = length <= 1e-12 * np.square(np.ptp(xyz, axis=1)).sum(axis=1)
        if small.any():
            raise ModelError(f"{self._element(numbers, small)} has no area")
        normal = normal / length[:, None]
        x = x - np.einsum("mi,mi->m", x, normal)[:, None] * normal
        x = x / np.linalg.norm(x, axis=1, keepdims=True)
        return np.stack([x, np.cross(normal, x), normal], axis=1)

    def _areas(self, numbers: IntArray, local: RealArray) -> RealArray:
        x = local[:, :, 0]
        y = local[:, :, 1]
        if local.shape[1] == 4:  # twice the area of the triangle at each corner
            a = np.roll(local, -1, axis=1) - local
            b = np.roll(local, 1, axis=1) - local
            corner = a[:, :, 0] * b[:, :, 1] - a[:, :, 1] * b[:, :, 0]
            bad = (corner <= 0).any(axis=1)
            if bad.any():
                raise ModelError(
                    f"{self._element(numbers, bad)} is not convex,"
                    " or its nodes are not in order around it"
                )
        twice = x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)
        return np.asarray(0.5 * np.abs(twice.sum(axis=1)))

    def _check_warp(self, numbers: IntArray, warp: RealArray) -> None:
        worst = warp.max()
        if worst > ELEMENT.warned_warp:
            count = int((warp > ELEMENT.warned_warp).sum())
            warnings.warn(
                f"{self._element(numbers, warp == worst)} is warped: a node is {worst:.0%} of its"
                f" size off the plane ({count} such elements); two triangles, or a finer mesh,"
                " would follow the surface better",
                UpdynWarning,
                stacklevel=2,
            )

    def _element(self, numbers: IntArray, chosen: Any) -> str:
        """Return the name of the first of given elements for messages."""
        return f"{self.label}: the element of nodes {numbers[int(np.argmax(chosen))].tolist()}"

    def _shear_stiffness(self, xy: RealArray) -> RealArray:
        """Return the transverse shear stiffness of quadrilaterals, shape (m, 24, 24)."""
        shear = 5 / 6 * self.E / (2 * (1 + self.nu)) * self.thickness
        bottom = _covariant(xy, 0, (0.0, -1.0))
        top = _covariant(xy, 0, (0.0, 1.0))
        left = _covariant(xy, 1, (-1.0, 0.0))
        right = _covariant(xy, 1, (1.0, 0.0))
        out = np.zeros((len(xy), 24, 24))
        for p, q in _CORNERS / np.sqrt(3.0):
            J = np.einsum("ai,mij->maj", _gradients(p, q), xy)
            along = 0.5 * ((1 - q) * bottom + (1 + q) * top)
            across = 0.5 * ((1 - p) * left + (1 + p) * right)
            B = np.linalg.solve(J, np.stack([along, across], axis=1))
            out += shear * np.linalg.det(J)[:, None, None] * (B.transpose(0, 2, 1) @ B)
        return out


def _transformation(axes: RealArray, height: RealArray) -> RealArray:
    """Return local DOFs in the plane from global DOFs of the nodes, shape (m, 6 k, 6 k)."""
    m, k = height.shape
    T = np.zeros((m, k, 6, k, 6))
    for i in range(k):
        T[:, i, :3, i, :3] = axes
        T[:, i, 3:, i, 3:] = axes
        # The point in the plane is at -h along the normal: u + theta x (0, 0, -h).
        T[:, i, 0, i, 3:] -= height[:, i, None] * axes[:, 1]
        T[:, i, 1, i, 3:] += height[:, i, None] * axes[:, 0]
    return T.reshape(m, 6 * k, 6 * k)


def _covariant(xy: RealArray, axis: int, at: tuple[float, float]) -> RealArray:
    """Return the covariant shear strain w,a + x,a ry - y,a rx at a point, shape (m, 24)."""
    slope = _gradients(*at)[axis]
    N = (1 + _CORNERS[:, 0] * at[0]) * (1 + _CORNERS[:, 1] * at[1]) / 4
    tangent = np.einsum("i,mij->mj", slope, xy)
    row = np.zeros((len(xy), 4, 6))
    row[:, :, 2] = slope
    row[:, :, 3] = -tangent[:, 1, None] * N
    row[:, :, 4] = tangent[:, 0, None] * N
    return row.reshape(len(xy), 24)


def _gradients(p: float, q: float) -> RealArray:
    """Return the derivatives of the four bilinear functions by both coordinates, shape (2, 4)."""
    by_p = _CORNERS[:, 0] * (1 + _CORNERS[:, 1] * q)
    by_q = _CORNERS[:, 1] * (1 + _CORNERS[:, 0] * p)
    return np.stack([by_p, by_q]) / 4
