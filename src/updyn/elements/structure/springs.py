"""Springs and rigid masses at nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from updyn.arrays import BoolArray, IntArray, RealArray
from updyn.elements.checks import (
    check_floats,
    check_name,
    check_node_number,
    check_not_negative,
    check_six,
    set_fields,
)
from updyn.elements.settings import ELEMENT
from updyn.elements.structure.element import Element, ElementMatrices
from updyn.errors import ModelError

__all__ = ["PointMass", "Spring"]


@dataclass(frozen=True, slots=True, eq=False)
class Spring(Element):
    """A spring (and damper) between two nodes, or from a node to ground.

    Between distant nodes it acts half-way, on rigid arms, and is not strained by rigid rotations.

    Parameters
    ----------
    name : str
        Group name; parts of the same name form one group.
    first : int
        Node number.
    second : int, optional
        Node number; by default ground, at the place of `first`.
    stiffness : array_like of float, shape (6,)
        Stiffness along and about the axes: three in N/m, three in N m/rad.
    viscous : array_like of float, shape (6,)
        Damping along and about the axes: three in N s/m, three in N m s/rad.
    axes : array_like of float, shape (2, 3), or "line", optional
        Local x, and a vector in the local xy plane, in global components; by default the global
        axes. ``"line"``: x from the first to the second node; then only the first and fourth of
        the six values may differ from 0.
    loss_factor : float
        Structural loss factor.

    Raises
    ------
    ModelError
        If a number is out of range, or all of them are 0.
    """

    name: str
    first: int
    second: int | None = None
    stiffness: Any = (0.0,) * 6
    viscous: Any = (0.0,) * 6
    axes: Any = None
    loss_factor: float = 0.0

    def __post_init__(self) -> None:
        what = self.label
        check_name(what, self.name)
        set_fields(self, first=check_node_number(what, "first", self.first))
        if self.second is not None:
            set_fields(self, second=check_node_number(what, "second", self.second))
            if self.second == self.first:
                raise ModelError(
                    f"{what}: both ends are node {self.first}; leave second out for a spring to"
                    " ground"
                )
        set_fields(self, stiffness=check_six(what, "stiffness", self.stiffness))
        set_fields(self, viscous=check_six(what, "viscous", self.viscous))
        if not self.stiffness.any() and not self.viscous.any():
            raise ModelError(
                f"{what} has neither stiffness nor viscous damping; give one above 0 or leave it"
                " out"
            )
        set_fields(self, loss_factor=check_not_negative(what, "loss_factor", self.loss_factor))
        self._check_axes(what)

    def _check_axes(self, what: str) -> None:
        if self.axes is None:
            return
        if isinstance(self.axes, str):
            self._check_line(what)
            return
        pair = check_floats(what, "axes", self.axes)
        if pair.shape != (2, 3):
            raise ModelError(f"{what}: axes of shape {pair.shape}; expected two vectors, (2, 3)")
        x, v = pair
        product = np.linalg.norm(x) * np.linalg.norm(v)
        if np.linalg.norm(np.cross(x, v)) <= ELEMENT.rounding * product:
            raise ModelError(
                f"{what}: axes {x} and {v} are parallel or 0; expected two that span a plane"
            )
        set_fields(self, axes=pair)

    def _check_line(self, what: str) -> None:
        if self.axes != "line":
            raise ModelError(
                f"{what}: axes {self.axes!r}; expected 'line', two vectors, or nothing (global"
                " axes)"
            )
        if self.second is None:
            raise ModelError(f"{what}: axes 'line' needs a second node")
        across = np.array([1, 2, 4, 5])
        if self.stiffness[across].any() or self.viscous[across].any():
            raise ModelError(
                f"{what}: axes 'line' leaves y and z open; give two vectors for stiffness across it"
            )

    @property
    def node_numbers(self) -> IntArray:
        """Node numbers of the ends, shape (1, 1) or (1, 2)."""
        ends = [self.first]
        if self.second is not None:
            ends.append(self.second)
        return np.array([ends])

    def matrices(self, numbers: IntArray, xyz: RealArray) -> ElementMatrices:
        """Compute stiffness and viscous damping of the spring."""
        ends = xyz[0]
        R = np.kron(np.eye(2), self._local_axes(ends))
        middle = ends.mean(axis=0)
        # Elongation and rotation at the middle, along local axes, from the DOFs of the ends.
        if self.second is None:
            G = R @ _rigid_arm(middle - ends[0])
        else:
            G = np.hstack([-R @ _rigid_arm(middle - ends[0]), R @ _rigid_arm(middle - ends[1])])
        G[np.abs(G) < ELEMENT.rotation_rounding * np.abs(G).max()] = 0.0
        return ElementMatrices(_quadratic(self.stiffness, G), C=_quadratic(self.viscous, G))

    def used_dofs(self, xyz: RealArray) -> BoolArray:
        """Return a mask of the end DOFs with stiffness or damping, shape (1, k, 6)."""
        return self.matrices(self.node_numbers, xyz).nonzero.reshape(1, -1, 6)

    def edges(self) -> IntArray:
        """Return the line between the ends; empty for a spring to ground."""
        if self.second is None:
            return np.empty((0, 2), dtype=np.int64)
        return self.node_numbers

    def _local_axes(self, ends: RealArray) -> RealArray:
        """Return the local axes as rows, shape (3, 3)."""
        if self.axes is None:
            return np.eye(3)
        if isinstance(self.axes, str):
            x = ends[1] - ends[0]
            if not x.any():
                raise ModelError(f"{self.label}: axes 'line', but its nodes coincide")
            v = np.eye(3)[int(np.argmin(np.abs(x)))]
        else:
            x, v = self.axes
        x = x / np.linalg.norm(x)
        z = np.cross(x, v)
        z = z / np.linalg.norm(z)
        return np.array([x, np.cross(z, x), z])


@dataclass(frozen=True, slots=True, eq=False)
class PointMass(Element):
    """A rigid mass at a node.

    Parameters
    ----------
    name : str
        Group name; parts of the same name form one group.
    node : int
        Node number.
    mass : float
        Mass in kg.
    inertia : array_like of float, shape (3,) or (3, 3)
        Inertia about the centre of mass along global axes in kg m2: the three moments, or the
        tensor (its off-diagonal entries are minus the products of inertia).
    offset : array_like of float, shape (3,)
        Vector from the node to the centre of mass, in global components in m.

    Raises
    ------
    ModelError
        If a number is out of range, or the inertia is not symmetric and positive semidefinite.
    """

    name: str
    node: int
    mass: float
    inertia: Any = (0.0, 0.0, 0.0)
    offset: Any = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        what = self.label
        check_name(what, self.name)
        set_fields(self, node=check_node_number(what, "node", self.node))
        set_fields(self, mass=check_not_negative(what, "mass", self.mass))
        tensor = check_floats(what, "inertia", self.inertia)
        if tensor.shape == (3,):
            tensor = np.diag(tensor)
        if tensor.shape != (3, 3) or not _is_symmetric(tensor):
            raise ModelError(
                f"{what}: inertia {self.inertia!r}; expected three moments or a symmetric (3, 3)"
                " tensor"
            )
        if np.linalg.eigvalsh(tensor)[0] < -ELEMENT.rounding * np.abs(tensor).max():
            raise ModelError(f"{what}: inertia {self.inertia!r} is negative about some axis")
        offset = check_floats(what, "offset", self.offset)
        if offset.shape != (3,):
            raise ModelError(f"{what}: offset {self.offset!r}; expected three numbers")
        if not self.mass and not tensor.any():
            raise ModelError(f"{what} has neither mass nor inertia")
        set_fields(self, inertia=tensor, offset=offset)

    @property
    def label(self) -> str:
        """Kind and name, for messages."""
        return f"mass {self.name!r}"

    @property
    def node_numbers(self) -> IntArray:
        """Number of the node, shape (1, 1)."""
        return np.array([[self.node]])

    def matrices(self, numbers: IntArray, xyz: RealArray) -> ElementMatrices:
        """Compute the mass at the node from that at the centre of mass."""
        centre = np.zeros((6, 6))
        centre[:3, :3] = self.mass * np.eye(3)
        centre[3:, 3:] = self.inertia
        T = _rigid_arm(self.offset)
        return ElementMatrices(M=(T.T @ centre @ T)[None])

    def used_dofs(self, xyz: RealArray) -> BoolArray:
        """Return a mask of the node DOFs with mass or inertia, shape (1, 1, 6)."""
        return self.matrices(self.node_numbers, xyz).nonzero.reshape(1, 1, 6)


def _quadratic(diagonal: RealArray, G: RealArray) -> RealArray | None:
    """Return G^T diag G with a leading axis of 1; None if the diagonal is 0."""
    if not diagonal.any():
        return None
    return np.asarray((G.T @ (diagonal[:, None] * G))[None])


def _rigid_arm(arm: RealArray) -> RealArray:
    """Return the (6, 6) matrix of a rigid arm, whose end moves by u + theta x arm."""
    x, y, z = arm
    out = np.eye(6)
    out[:3, 3:] = -np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return out


def _is_symmetric(tensor: RealArray) -> bool:
    return np.allclose(tensor, tensor.T, rtol=ELEMENT.rounding, atol=0)
