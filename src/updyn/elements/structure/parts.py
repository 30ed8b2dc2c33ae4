"""What a structure is made of: beams, trusses, springs, shells, solids, masses and rigid links, as plain data.

Arrays may be given as lists; a part holds them as read-only arrays.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from updyn.dofs import DIRECTIONS, whole_numbers
from updyn.elements.checks import (
    check_name,
    connectivity,
    floats,
    material,
    node_number,
    not_negative,
    positive,
    six,
    store,
    vector,
)
from updyn.elements.structure.sections import Section
from updyn.errors import ModelError, suggest

__all__ = ["Beam", "Part", "PointMass", "RigidLink", "Shell", "Solid", "Spring", "Truss"]

_ALIKE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Beam:
    """Straight two-node beams of one section and material, one group: bending in two planes, axial, torsion.

    Parameters
    ----------
    name : str
        Group name; parts of the same name form one group.
    connectivity : array_like of int, shape (m, 2)
        Node numbers of each element; local x runs from the first to the second.
    E, rho : float
        Young's modulus in Pa and density in kg/m3 (0: without mass).
    section : Section
        Area, second moments, torsion constant, shear coefficients.
    nu : float
        Poisson's ratio, for G = E / (2 (1 + nu)).
    G : float, optional
        Shear modulus in Pa, instead of that of `nu`.
    orientation : array_like of float, shape (3,), optional
        A vector in the local xy plane, in global components; not parallel to an element. May be
        left out where both bending planes are alike.
    loss_factor : float
        Structural loss factor.

    Raises
    ------
    ModelError
        If a number is out of range, or the orientation is missing although the bending planes
        differ.
    """

    name: str
    connectivity: Any
    E: float
    rho: float
    section: Section
    nu: float = 0.3
    G: float | None = None
    orientation: Any = None
    loss_factor: float = 0.0

    def __post_init__(self) -> None:
        what = f"beam {self.name!r}"
        store(
            self, connectivity=connectivity(what, self.connectivity, (2,)), **material(what, self)
        )
        if not isinstance(self.section, Section):
            raise ModelError(
                f"{what}: section {self.section!r}; expected a Section, a rectangle(...) or a"
                " tube(...)"
            )
        if self.orientation is not None:
            store(self, orientation=vector(what, "orientation", self.orientation))
        elif not self.section.is_round:
            raise ModelError(
                f"{what}: an orientation (a vector in its local xy plane) is needed, as Iyy and Izz"
                " differ"
            )

    @property
    def shear_modulus(self) -> float:
        """G in Pa."""
        return self.E / (2 * (1 + self.nu)) if self.G is None else self.G


@dataclass(frozen=True, slots=True, eq=False)
class Truss:
    """Straight two-node bars that only stretch, one group. Their nodes turn freely.

    Parameters
    ----------
    name : str
        Group name; parts of the same name form one group.
    connectivity : array_like of int, shape (m, 2)
        Node numbers of each bar.
    E, rho : float
        Young's modulus in Pa and density in kg/m3 (0: without mass).
    A : float
        Area in m2.
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
    A: float
    loss_factor: float = 0.0

    def __post_init__(self) -> None:
        what = f"truss {self.name!r}"
        store(
            self, connectivity=connectivity(what, self.connectivity, (2,)), **material(what, self)
        )
        store(self, A=positive(what, "A", self.A))


@dataclass(frozen=True, slots=True, eq=False)
class Shell:
    """Flat shells of three or four nodes, of one thickness and material, one group.

    Parameters
    ----------
    name : str
        Group name; parts of the same name form one group.
    connectivity : array_like of int, shape (m, 3) or (m, 4)
        Node numbers of each element, in order around it. Triangles and quadrilaterals go into two
        parts of one name.
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
        what = f"shell {self.name!r}"
        store(
            self, connectivity=connectivity(what, self.connectivity, (3, 4)), **material(what, self)
        )
        store(self, thickness=positive(what, "thickness", self.thickness))


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """Solid elements of one material, one group. Their nodes have X, Y, Z only.

    Parameters
    ----------
    name : str
        Group name; parts of the same name form one group.
    connectivity : array_like of int, shape (m, 4), (m, 8), (m, 10) or (m, 20)
        Node numbers of tetrahedra (4, 10) or hexahedra (8, 20), in the order of VTK and meshio:
        corners, then the middles of the edges (of hexahedra those of the first face, of the second,
        and between them).
    E, rho : float
        Young's modulus in Pa and density in kg/m3 (0: without mass).
    nu : float
        Poisson's ratio, below 0.5.
    loss_factor : float
        Structural loss factor.
    lumped : bool
        A diagonal mass instead of the consistent one.

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

    def __post_init__(self) -> None:
        what = f"solid {self.name!r}"
        store(
            self,
            connectivity=connectivity(what, self.connectivity, (4, 8, 10, 20)),
            **material(what, self),
        )
        if not self.nu < 0.5:
            raise ModelError(f"{what}: nu {self.nu!r}; expected below 0.5")
        if not isinstance(self.lumped, bool):
            raise ModelError(f"{what}: lumped {self.lumped!r}; expected True or False")


@dataclass(frozen=True, slots=True, eq=False)
class Spring:
    """A spring (and damper) between two nodes, or from a node to ground.

    Between nodes apart from each other it acts half-way, on rigid arms: turning the whole does not
    strain it.

    Parameters
    ----------
    name : str
        Group name; parts of the same name form one group.
    first : int
        Node number.
    second : int, optional
        Node number; None: ground, at the place of `first`.
    stiffness : array_like of float, shape (6,)
        Along and about the axes: three in N/m, three in N m/rad.
    viscous : array_like of float, shape (6,)
        Dampers likewise: three in N s/m, three in N m s/rad.
    axes : array_like of float, shape (2, 3), or "line", optional
        Local x, and a vector in the local xy plane, in global components. None: the global axes.
        ``"line"``: x from the first to the second node; then only the first and fourth of the six
        may differ from 0.
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
        what = f"spring {self.name!r}"
        check_name(what, self.name)
        store(self, first=node_number(what, "first", self.first))
        if self.second is not None:
            store(self, second=node_number(what, "second", self.second))
            if self.second == self.first:
                raise ModelError(
                    f"{what}: both ends are node {self.first}; leave second out for a spring to"
                    " ground"
                )
        store(
            self,
            stiffness=six(what, "stiffness", self.stiffness),
            viscous=six(what, "viscous", self.viscous),
        )
        if not self.stiffness.any() and not self.viscous.any():
            raise ModelError(
                f"{what} has neither stiffness nor viscous damping; give one above 0 or leave"
                " it out"
            )
        store(self, loss_factor=not_negative(what, "loss_factor", self.loss_factor))
        self._check_axes(what)

    def _check_axes(self, what: str) -> None:
        if self.axes is None:
            return
        if isinstance(self.axes, str):
            if self.axes != "line":
                raise ModelError(
                    f"{what}: axes {self.axes!r}; expected 'line', two vectors, or nothing (global"
                    " axes)"
                )
            if self.second is None:
                raise ModelError(f"{what}: axes 'line' needs a second node")
            across = np.array([1, 2, 4, 5])
            if np.any(np.asarray(self.stiffness)[across]) or np.any(
                np.asarray(self.viscous)[across]
            ):
                raise ModelError(
                    f"{what}: axes 'line' leaves y and z open; give two vectors for stiffness"
                    " across it"
                )
            return
        pair = floats(what, "axes", self.axes)
        if pair.shape != (2, 3):
            raise ModelError(f"{what}: axes of shape {pair.shape}; expected two vectors, (2, 3)")
        x, v = pair
        if np.linalg.norm(np.cross(x, v)) <= _ALIKE * np.linalg.norm(x) * np.linalg.norm(v):
            raise ModelError(
                f"{what}: axes {x} and {v} are parallel or 0; expected two that span a plane"
            )
        store(self, axes=pair)


@dataclass(frozen=True, slots=True, eq=False)
class PointMass:
    """A rigid mass at a node.

    Parameters
    ----------
    name : str
        Group name; parts of the same name form one group.
    node : int
        Node number.
    mass : float
        In kg.
    inertia : array_like of float, shape (3,) or (3, 3)
        About the centre of the mass, along global axes, in kg m2: the three moments, or the tensor
        (its off-diagonal entries are minus the products of inertia).
    offset : array_like of float, shape (3,)
        From the node to the centre of the mass, in global components, in m.

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
        what = f"mass {self.name!r}"
        check_name(what, self.name)
        store(
            self,
            node=node_number(what, "node", self.node),
            mass=not_negative(what, "mass", self.mass),
        )
        tensor = floats(what, "inertia", self.inertia)
        if tensor.shape == (3,):
            tensor = np.diag(tensor)
        if tensor.shape != (3, 3) or not np.allclose(tensor, tensor.T, rtol=1e-9, atol=0):
            raise ModelError(
                f"{what}: inertia {self.inertia!r}; expected three moments or a symmetric (3, 3)"
                " tensor"
            )
        if np.linalg.eigvalsh(tensor)[0] < -_ALIKE * np.abs(tensor).max():
            raise ModelError(f"{what}: inertia {self.inertia!r} is negative about some axis")
        offset = floats(what, "offset", self.offset)
        if offset.shape != (3,):
            raise ModelError(f"{what}: offset {self.offset!r}; expected three numbers")
        if not self.mass and not tensor.any():
            raise ModelError(f"{what} has neither mass nor inertia")
        store(self, inertia=tensor, offset=offset)


@dataclass(frozen=True, slots=True, eq=False)
class RigidLink:
    """Nodes that move rigidly with another; their own DOFs vanish.

    Parameters
    ----------
    master : int
        The node that leads.
    slaves : array_like of int, shape (m,)
        The nodes that follow.
    directions : iterable of str, optional
        Which of their DOFs follow. None: all that they have (of solids and trusses X, Y, Z).

    Raises
    ------
    ModelError
        If a node is not a whole number, or a direction is not known.
    """

    master: int
    slaves: Any
    directions: Any = None

    def __post_init__(self) -> None:
        what = f"rigid link of node {self.master!r}"
        slaves = np.atleast_1d(whole_numbers(self.slaves, f"{what}: slaves", ModelError))
        if slaves.ndim != 1 or not slaves.size:
            raise ModelError(f"{what}: slaves {self.slaves!r}; expected at least one node number")
        store(self, master=node_number(what, "master", self.master), slaves=slaves)
        if self.directions is not None:
            wanted = (
                self.directions.split() if isinstance(self.directions, str) else self.directions
            )
            if not isinstance(wanted, Iterable):
                raise ModelError(
                    f"{what}: directions {wanted!r}; expected some of {' '.join(DIRECTIONS)}"
                )
            wanted = tuple(wanted)
            for name in wanted:
                if name not in DIRECTIONS:
                    raise ModelError(
                        f"{what}: direction {name!r}; {suggest(str(name), DIRECTIONS)}"
                    )
            store(self, directions=tuple(wanted))


#: Parts that belong to a group.
Part: TypeAlias = Beam | Truss | Shell | Solid | Spring | PointMass
