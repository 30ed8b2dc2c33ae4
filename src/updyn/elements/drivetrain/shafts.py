"""Parts on one shaft: inertias, shafts, couplings, motors, brakes and springs to ground."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from updyn.elements.checks import (
    check_not_negative,
    check_positive,
    check_positive_or_none,
    check_whole,
)
from updyn.elements.drivetrain.pieces import (
    FixedNode,
    InertiaMatrix,
    Part,
    Piece,
    RigidRatio,
    TorsionSpring,
    check_damping,
    lump_inertia,
    relative_deformation,
)
from updyn.errors import ModelError, suggest

__all__ = ["Brake", "Coupling", "Ground", "Inertia", "Motor", "Shaft"]

_ELEMENT = np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0  # consistent mass of a rod of two nodes
_ROTORS = ("free", "locked")


@dataclass(frozen=True, slots=True)
class Inertia(Part):
    """A rigid body on a shaft: a disc, a load, a gear wheel.

    Parameters
    ----------
    name : str
        Group name.
    node : int
        Node of the body.
    value : float, optional
        Moment of inertia about the shaft in kg m2. Alternatively from the geometry of a disc or a
        ring, J = pi rho L (D^4 - d^4) / 32:
    rho : float, optional
        Density, in kg/m3.
    outer_diameter, inner_diameter : float
        Diameters in m.
    length : float, optional
        Thickness along the shaft, in m.
    """

    name: str
    node: int
    value: float | None = None
    rho: float | None = None
    outer_diameter: float | None = None
    inner_diameter: float = 0.0
    length: float | None = None

    def pieces(self, new_node: Callable[[], int]) -> list[Piece]:
        """Return the inertia."""
        what = f"inertia {self.name!r}"
        node = check_whole(what, "node", self.node)
        if not _is_from_geometry(what, self, "value", ("rho", "outer_diameter", "length")):
            return [lump_inertia(self.name, node, check_positive(what, "value", self.value))]
        rho = check_positive(what, "rho", self.rho)
        length = check_positive(what, "length", self.length)
        return [lump_inertia(self.name, node, rho * length * _polar_moment(what, self))]


@dataclass(frozen=True, slots=True)
class Shaft(Part):
    """A shaft in torsion, given by stiffness or geometry, with or without mass.

    From geometry, k = G I_p / L and J = rho I_p L with I_p = pi (D^4 - d^4) / 32. The inertia is
    uniform (linear twist in each element, consistent mass: Cook, Malkus, Plesha & Witt 2002,
    section 11.3). A stepped shaft is a series of shafts.

    Parameters
    ----------
    name : str
        Name of the group of stiffness and inertia.
    a, b : int
        Nodes at its ends.
    stiffness : float, optional
        Stiffness in N m/rad. Alternatively the geometry:
    G : float, optional
        Shear modulus, in Pa.
    outer_diameter, inner_diameter, length : float
        Dimensions in m.
    rho : float, optional
        Density in kg/m3; by default massless.
    inertia : float, optional
        Total, uniform moment of inertia in kg m2 of a shaft given by stiffness; by default
        massless.
    n_elements : int
        Number of equal elements; inner nodes are numbered after all nodes of the train.
    loss_factor : float
        Structural loss factor.
    viscous : float
        Damping of the twist between its ends, in N m s/rad.
    """

    name: str
    a: int
    b: int
    stiffness: float | None = None
    G: float | None = None
    outer_diameter: float | None = None
    inner_diameter: float = 0.0
    length: float | None = None
    rho: float | None = None
    inertia: float | None = None
    n_elements: int = 1
    loss_factor: float = 0.0
    viscous: float = 0.0

    node_fields: ClassVar[tuple[str, ...]] = ("a", "b")

    def pieces(self, new_node: Callable[[], int]) -> list[Piece]:
        """Return the springs and inertias of its elements."""
        what = f"shaft {self.name!r}"
        count = check_whole(what, "n_elements", self.n_elements, 1)
        ends, _ = relative_deformation(what, (self.a, self.b), (1.0, -1.0), None)
        stiffness, J = self._totals(what)
        viscous, loss = check_damping(what, self)
        if count > 1 and not J:
            raise ModelError(
                f"{what}: {count} elements of a shaft without mass; give rho or inertia, or one"
                " element"
            )
        inner = [new_node() for _ in range(count - 1)]
        out: list[Piece] = []
        for two in itertools.pairwise([ends[0], *inner, ends[1]]):
            out.append(
                TorsionSpring(self.name, two, (1.0, -1.0), stiffness * count, viscous * count, loss)
            )
            if J:
                out.append(InertiaMatrix(self.name, two, J / count * _ELEMENT))
        return out

    def _totals(self, what: str) -> tuple[float, float]:
        """Return stiffness in N m/rad and inertia in kg m2."""
        if _is_from_geometry(what, self, "stiffness", ("G", "outer_diameter", "length")):
            if self.inertia is not None:
                raise ModelError(
                    f"{what}: inertia requires a stiffness; with the geometry, give rho"
                )
            G = check_positive(what, "G", self.G)
            length = check_positive(what, "length", self.length)
            section = _polar_moment(what, self)
            rho = 0.0
            if self.rho is not None:
                rho = check_not_negative(what, "rho", self.rho)
            return G * section / length, rho * section * length
        if self.rho is not None:
            raise ModelError(f"{what}: rho requires the geometry; with a stiffness, give inertia")
        J = 0.0
        if self.inertia is not None:
            J = check_not_negative(what, "inertia", self.inertia)
        return check_positive(what, "stiffness", self.stiffness), J


@dataclass(frozen=True, slots=True)
class Coupling(Part):
    """A flexible coupling between two shaft ends.

    Parameters
    ----------
    name : str
        Group name.
    a, b : int
        Nodes.
    stiffness : float
        Stiffness in N m/rad.
    inertia_a, inertia_b : float
        Inertias of its halves in kg m2.
    loss_factor : float
        Structural loss factor.
    viscous : float
        Damping in N m s/rad.
    """

    name: str
    a: int
    b: int
    stiffness: float
    inertia_a: float = 0.0
    inertia_b: float = 0.0
    loss_factor: float = 0.0
    viscous: float = 0.0

    node_fields: ClassVar[tuple[str, ...]] = ("a", "b")

    def pieces(self, new_node: Callable[[], int]) -> list[Piece]:
        """Return the spring and the two halves."""
        what = f"coupling {self.name!r}"
        nodes, row = relative_deformation(what, (self.a, self.b), (1.0, -1.0), None)
        k = check_positive(what, "stiffness", self.stiffness)
        viscous, loss = check_damping(what, self)
        spring = TorsionSpring(self.name, nodes, row, k, viscous, loss)
        return [spring, *half_inertias(what, self, nodes)]


@dataclass(frozen=True, slots=True)
class Motor(Part):
    """A motor: its rotor, free or locked, with stiffness and damping of its drive.

    Locked-rotor and free-rotor tests are two data sets of one train: only `rotor` differs; the
    groups are the same.

    Parameters
    ----------
    name : str
        Group name.
    node : int
        Node of the rotor.
    inertia : float
        Inertia of the rotor in kg m2.
    rotor : {"free", "locked"}
        Whether it can turn relative to the stator.
    stiffness : float, optional
        Stiffness between rotor and stator in N m/rad: detent torque, or a position loop.
    viscous : float
        Damping between rotor and stator in N m s/rad: back EMF (k_t k_e / R), bearings.
    loss_factor : float
        Structural loss factor of `stiffness`.
    housing : int, optional
        Node that carries the stator; by default the ground.
    """

    name: str
    node: int
    inertia: float
    rotor: str = "free"
    stiffness: float | None = None
    viscous: float = 0.0
    loss_factor: float = 0.0
    housing: int | None = None

    node_fields: ClassVar[tuple[str, ...]] = ("node", "housing")

    def pieces(self, new_node: Callable[[], int]) -> list[Piece]:
        """Return the rotor, its spring and its fixed node."""
        what = f"motor {self.name!r}"
        if self.rotor not in _ROTORS:
            raise ModelError(f"{what}: rotor {self.rotor!r}; {suggest(str(self.rotor), _ROTORS)}")
        out: list[Piece] = [
            lump_inertia(
                self.name,
                check_whole(what, "node", self.node),
                check_positive(what, "inertia", self.inertia),
            )
        ]
        if self.rotor == "locked":
            out.append(_lock(what, self))
        return out + _anchors(what, self)


@dataclass(frozen=True, slots=True)
class Brake(Part):
    """A brake between a shaft and the ground or a housing.

    Parameters
    ----------
    name : str
        Group name.
    node : int
        Node of the shaft.
    stiffness : float, optional
        Stiffness of the closed brake in N m/rad; by default rigid.
    closed : bool
        Whether the brake is closed; a released brake has only inertia and drag.
    inertia : float
        Inertia of parts that turn with the shaft in kg m2.
    viscous : float
        Drag in N m s/rad.
    loss_factor : float
        Structural loss factor of `stiffness`.
    housing : int, optional
        Node that carries the brake; by default the ground.
    """

    name: str
    node: int
    stiffness: float | None = None
    closed: bool = True
    inertia: float = 0.0
    viscous: float = 0.0
    loss_factor: float = 0.0
    housing: int | None = None

    node_fields: ClassVar[tuple[str, ...]] = ("node", "housing")

    def pieces(self, new_node: Callable[[], int]) -> list[Piece]:
        """Return its disc and, if it is closed, its spring or fixed node."""
        what = f"brake {self.name!r}"
        if not isinstance(self.closed, bool):
            raise ModelError(f"{what}: closed {self.closed!r}; expected true or false")
        out: list[Piece] = []
        node = check_whole(what, "node", self.node)
        if check_not_negative(what, "inertia", self.inertia):
            out.append(lump_inertia(self.name, node, self.inertia))
        if self.closed and self.stiffness is None:
            out.append(_lock(what, self))
        return out + _anchors(what, self, has_spring=self.closed)


@dataclass(frozen=True, slots=True)
class Ground(Part):
    """A spring and a damper between a shaft and the ground or a housing, such as bearing drag.

    Parameters
    ----------
    name : str
        Group name.
    node : int
        Node of the shaft.
    stiffness : float, optional
        Stiffness in N m/rad; by default none.
    viscous : float
        Damping in N m s/rad.
    loss_factor : float
        Structural loss factor.
    housing : int, optional
        Node of the housing; by default the ground.
    """

    name: str
    node: int
    stiffness: float | None = None
    viscous: float = 0.0
    loss_factor: float = 0.0
    housing: int | None = None

    node_fields: ClassVar[tuple[str, ...]] = ("node", "housing")

    def pieces(self, new_node: Callable[[], int]) -> list[Piece]:
        """Return the spring."""
        what = f"ground {self.name!r}"
        out = _anchors(what, self)
        if not out:
            raise ModelError(
                f"{what} has neither stiffness nor viscous damping; give one or leave it out"
            )
        return out


def half_inertias(what: str, part: Any, nodes: tuple[int, ...]) -> list[Piece]:
    """Return the inertias `inertia_a` and `inertia_b` of the two sides of a part in kg m2."""
    out: list[Piece] = []
    for node, key in zip(nodes, ("inertia_a", "inertia_b"), strict=False):
        J = check_not_negative(what, key, getattr(part, key))
        if J:
            out.append(lump_inertia(part.name, node, J))
    return out


def _lock(what: str, part: Any) -> Piece:
    if part.housing is None:
        return FixedNode(what, check_whole(what, "node", part.node))
    nodes, row = relative_deformation(what, (part.node,), (1.0,), part.housing)
    return RigidRatio(what, nodes, row, nodes[0], anchor=True)


def _anchors(what: str, part: Any, has_spring: bool = True) -> list[Piece]:
    """Return the spring and damper of a part to the ground or its housing, if it has any."""
    nodes, row = relative_deformation(what, (part.node,), (1.0,), part.housing)
    viscous, loss = check_damping(what, part)
    if part.stiffness is None and loss:
        raise ModelError(f"{what}: a loss factor without stiffness has no effect")
    k = check_positive_or_none(what, "stiffness", part.stiffness)
    if k is None or not has_spring:
        k = 0.0
        loss = 0.0
    if not k and not viscous:
        return []
    return [TorsionSpring(part.name, nodes, row, k, viscous, loss, anchor=True)]


def _is_from_geometry(what: str, part: Any, name: str, dimensions: Sequence[str]) -> bool:
    """Return whether a quantity comes from the geometry; exactly one of the two must be given."""
    value = getattr(part, name)
    given = [key for key in dimensions if getattr(part, key) is not None]
    missing = [key for key in dimensions if key not in given]
    if part.inner_diameter != 0.0:
        given.append("inner_diameter")
    if value is not None and given:
        raise ModelError(
            f"{what}: {name} and {', '.join(given)} are given; expected one or the other"
        )
    if value is None and missing:
        raise ModelError(
            f"{what}: {', '.join(missing)} missing; expected {name}, or {', '.join(dimensions)}"
        )
    return value is None


def _polar_moment(what: str, part: Any) -> float:
    """Return the polar second moment of area pi (D^4 - d^4) / 32, in m4."""
    D = check_positive(what, "outer_diameter", part.outer_diameter)
    d = check_not_negative(what, "inner_diameter", part.inner_diameter)
    if d >= D:
        raise ModelError(
            f"{what}: inner_diameter {d:g} m; expected less than outer_diameter {D:g} m"
        )
    return math.pi * (D**4 - d**4) / 32.0
