"""Parts that change the speed: gear pairs, dual drives, worms, belts and planetary stages.

Rotations of parallel shafts are positive about the same direction: an external pair turns its
shafts in opposite senses, and an internal pair in the same sense.

The deflection of a mesh along the line of action is delta = cos(alpha) (r_a theta_a + r_b theta_b)
for an external and cos(alpha) (r_a theta_a - r_b theta_b) for an internal pair, with the base
radii r cos(alpha) (Ozguven & Houser, J. Sound and Vibration 121 (1988) 383).

All rotations of a planetary stage are positive in one sense about its axis. Relative to the
carrier, its meshes are an external and an internal pair. With r_r = r_s + 2 r_p (Kahraman, J. Sound
and Vibration 173 (1994) 125, the purely rotational model)::

    delta_s = cos(alpha) (r_s (theta_s - theta_c) + r_p (theta_p - theta_c))
    delta_r = cos(alpha) (r_r (theta_r - theta_c) - r_p (theta_p - theta_c))

If both are 0, the equation of Willis follows, z_s theta_s + z_r theta_r = (z_s + z_r) theta_c.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, TypeVar

import numpy as np

from updyn.elements.checks import (
    check_not_negative,
    check_number,
    check_pair,
    check_positive,
    check_positive_or_none,
    check_whole,
)
from updyn.elements.drivetrain.pieces import (
    InertiaMatrix,
    Part,
    Piece,
    RigidRatio,
    TorsionSpring,
    check_damping,
    lump_inertia,
    make_transmission,
    relative_deformation,
)
from updyn.elements.drivetrain.shafts import half_inertias
from updyn.errors import ModelError, suggest

__all__ = [
    "Belt",
    "DualDrive",
    "GearPair",
    "Planetary",
    "Worm",
    "line_of_action",
]

_SENSES = {"external": 1.0, "internal": -1.0}


@dataclass(frozen=True, slots=True)
class GearPair(Part):
    """Two gear wheels in mesh: theta_b = -theta_a / ratio (external) or theta_a / ratio (internal).

    Give the ratio by one of `ratio`, `teeth` and `radii`, and the mesh by one of `mesh_stiffness`,
    `torsional_stiffness` and `rigid`.

    Parameters
    ----------
    name : str
        Group name.
    a, b : int
        Nodes of the two wheels.
    ratio : float, optional
        r_b / r_a = z_b / z_a, the speed ratio of a to b.
    teeth : tuple of float, shape (2,), optional
        Numbers of teeth z_a, z_b.
    module : float, optional
        Transverse module in m, with `teeth`: r = module z / 2.
    radii : tuple of float, shape (2,), optional
        Pitch radii r_a, r_b, in m.
    mesh_stiffness : float, optional
        Stiffness along the line of action in N/m; requires `radii`, or `teeth` and `module`.
    torsional_stiffness : float, optional
        Stiffness at b with a fixed, in N m/rad: mesh_stiffness (r_b cos alpha)^2.
    rigid : bool
        Whether the ratio is a constraint. It eliminates the DOF of b, or another DOF tied to it.
    pressure_angle_deg : float
        Transverse working pressure angle alpha, in degrees.
    kind : {"external", "internal"}
        Whether the shafts turn in opposite senses or in the same sense. For shafts that are not
        parallel (bevel gears), relative to the chosen positive senses.
    inertia_a, inertia_b : float
        Inertias of the wheels in kg m2.
    loss_factor : float
        Structural loss factor of the mesh.
    viscous : float
        Damping of the mesh in N s/m along the line of action; with `torsional_stiffness`, in N m
        s/rad at b.
    housing : int, optional
        Node that carries both shafts, with a parallel axis; by default the ground.
    """

    name: str
    a: int
    b: int
    ratio: float | None = None
    teeth: tuple[float, float] | None = None
    module: float | None = None
    radii: tuple[float, float] | None = None
    mesh_stiffness: float | None = None
    torsional_stiffness: float | None = None
    rigid: bool = False
    pressure_angle_deg: float = 20.0
    kind: str = "external"
    inertia_a: float = 0.0
    inertia_b: float = 0.0
    loss_factor: float = 0.0
    viscous: float = 0.0
    housing: int | None = None

    node_fields: ClassVar[tuple[str, ...]] = ("a", "b", "housing")

    @property
    def speeds(self) -> tuple[int, int, float]:
        """Both nodes, and the speed ratio of a to b."""
        return self.a, self.b, _wheel_sizes(f"gear pair {self.name!r}", self)[0]

    def inverted(self) -> GearPair:
        """Return the part with the inverse of its ratio."""
        return _invert_wheels(self)

    def pieces(self, new_node: Callable[[], int]) -> list[Piece]:
        """Return the mesh and the two wheels."""
        what = f"gear pair {self.name!r}"
        row, k, along = _mesh_deformation(
            what, self, self.mesh_stiffness, self.torsional_stiffness, self.rigid
        )
        mesh = make_transmission(what, self, (self.a, self.b), row, k, along=along)
        return [mesh, *half_inertias(what, self, mesh.nodes)]


@dataclass(frozen=True, slots=True)
class DualDrive(Part):
    """Two pinions on one gear, preloaded against each other so that the gear has no backlash.

    While the preload keeps both meshes in contact, both act on the gear as linear springs. Beyond
    `opening_torque`, one of them opens and the train is nonlinear.

    Parameters
    ----------
    name : str
        Group name.
    first, second : int
        Nodes of the pinions.
    gear : int
        Node of the gear.
    ratio, teeth, module, radii
        As for `GearPair`, with a for either pinion and b for the gear.
    mesh_stiffness : float, optional
        Stiffness of each mesh along the line of action in N/m.
    torsional_stiffness : float, optional
        Alternatively, stiffness at the gear of one mesh with a fixed pinion, in N m/rad.
    second_factor : float
        Stiffness ratio of the second mesh to the first.
    preload : float, optional
        Preload torque of each pinion in N m; None if unknown.
    pressure_angle_deg, kind
        As for `GearPair`.
    inertia_a, inertia_b : float
        Inertias of each pinion and of the gear in kg m2.
    loss_factor : float
        Structural loss factor of the meshes.
    viscous : float
        Damping of each mesh, as for `GearPair`.
    housing : int, optional
        Node that carries all three shafts, with a parallel axis; by default the ground.
    """

    name: str
    first: int
    second: int
    gear: int
    ratio: float | None = None
    teeth: tuple[float, float] | None = None
    module: float | None = None
    radii: tuple[float, float] | None = None
    mesh_stiffness: float | None = None
    torsional_stiffness: float | None = None
    second_factor: float = 1.0
    preload: float | None = None
    pressure_angle_deg: float = 20.0
    kind: str = "external"
    inertia_a: float = 0.0
    inertia_b: float = 0.0
    loss_factor: float = 0.0
    viscous: float = 0.0
    housing: int | None = None

    node_fields: ClassVar[tuple[str, ...]] = ("first", "second", "gear", "housing")

    @property
    def speeds(self) -> tuple[int, int, float]:
        """Pinion and gear, and the speed ratio of pinion to gear."""
        return self.first, self.gear, _wheel_sizes(f"dual drive {self.name!r}", self)[0]

    def inverted(self) -> DualDrive:
        """Return the part with the inverse of its ratio."""
        return _invert_wheels(self)

    def pieces(self, new_node: Callable[[], int]) -> list[Piece]:
        """Return both meshes, the pinions and the gear."""
        what = f"dual drive {self.name!r}"
        row, k, along = _mesh_deformation(
            what, self, self.mesh_stiffness, self.torsional_stiffness, False
        )
        factor = check_positive(what, "second_factor", self.second_factor)
        if self.preload is not None:
            check_positive(what, "preload", self.preload)
        if self.first == self.second:
            raise ModelError(f"{what}: node {self.first} is both pinions; expected two nodes")
        out: list[Piece] = []
        for pinion, stiffness in ((self.first, k or 0.0), (self.second, (k or 0.0) * factor)):
            out.append(
                make_transmission(what, self, (pinion, self.gear), row, stiffness, along=along)
            )
            out += half_inertias(what, self, (pinion,))
        J = check_not_negative(what, "inertia_b", self.inertia_b)
        if J:
            out.append(lump_inertia(self.name, self.gear, J))
        return out

    @property
    def opening_torque(self) -> float:
        """Load torque on the gear in N m at which one mesh opens, with fixed pinions.

        The meshes share a load torque T in proportion to their stiffness; the stiffer one is
        unloaded first, at T k / (k_1 + k_2) = ratio preload.

        Raises
        ------
        ModelError
            If no preload is given, or a number is invalid.
        """
        what = f"dual drive {self.name!r}"
        if self.preload is None:
            raise ModelError(f"{what}: preload is not stated")
        ratio, _ = _wheel_sizes(what, self)
        factor = check_positive(what, "second_factor", self.second_factor)
        return (
            ratio
            * check_positive(what, "preload", self.preload)
            * (1.0 + factor)
            / max(1.0, factor)
        )


@dataclass(frozen=True, slots=True)
class Worm(Part):
    """A worm and its wheel: theta_wheel = theta_worm / ratio.

    The linear model transmits motion both ways, without the friction of self-locking worms.

    Parameters
    ----------
    name : str
        Group name.
    worm, wheel : int
        Nodes.
    ratio : float
        Speed ratio of worm to wheel: teeth of the wheel over starts of the worm. Negative if a
        positive rotation of the worm turns the wheel in the negative sense (such as a left-hand
        worm with senses chosen for a right-hand worm).
    stiffness : float, optional
        Stiffness at the wheel with a fixed worm, in N m/rad; by default rigid, which eliminates
        the DOF of the wheel.
    inertia_a, inertia_b : float
        Inertias of worm and wheel in kg m2.
    loss_factor : float
        Structural loss factor.
    viscous : float
        Damping at the wheel in N m s/rad.
    housing : int, optional
        Node that carries both and rotates about the wheel's axis; by default the ground.
    """

    name: str
    worm: int
    wheel: int
    ratio: float
    stiffness: float | None = None
    inertia_a: float = 0.0
    inertia_b: float = 0.0
    loss_factor: float = 0.0
    viscous: float = 0.0
    housing: int | None = None

    node_fields: ClassVar[tuple[str, ...]] = ("worm", "wheel", "housing")

    @property
    def speeds(self) -> tuple[int, int, float]:
        """Worm and wheel, and the speed ratio of worm to wheel."""
        return self.worm, self.wheel, self.ratio

    def inverted(self) -> Worm:
        """Return the part with the inverse of its ratio."""
        return replace(self, ratio=1.0 / self.ratio)

    def pieces(self, new_node: Callable[[], int]) -> list[Piece]:
        """Return the mesh, the worm and the wheel."""
        what = f"worm {self.name!r}"
        if check_number(what, "ratio", self.ratio) == 0.0:
            raise ModelError(f"{what}: ratio 0; expected a number other than 0")
        k = check_positive_or_none(what, "stiffness", self.stiffness)
        row = (-1.0 / self.ratio, 1.0)
        mesh = make_transmission(what, self, (self.worm, self.wheel), row, k, housing_factor=1.0)
        return [mesh, *half_inertias(what, self, mesh.nodes)]


@dataclass(frozen=True, slots=True)
class Belt(Part):
    """A belt, a rope or a chain on two pulleys: theta_b = theta_a r_a / r_b.

    Parameters
    ----------
    name : str
        Group name.
    a, b : int
        Nodes of the pulleys.
    radii : tuple of float, shape (2,)
        Effective radii r_a, r_b, in m.
    stiffness : float, optional
        Force over elongation in N/m: of both strands of a pretensioned belt, 2 E A / L, or of the
        taut strand of a chain. By default rigid, which eliminates the DOF of b.
    crossed : bool
        Whether it is crossed, which reverses the rotation of b.
    inertia_a, inertia_b : float
        Inertias of the pulleys in kg m2.
    loss_factor : float
        Structural loss factor.
    viscous : float
        Damping in N s/m.
    housing : int, optional
        Node that carries both pulleys, with a parallel axis; by default the ground.
    """

    name: str
    a: int
    b: int
    radii: tuple[float, float]
    stiffness: float | None = None
    crossed: bool = False
    inertia_a: float = 0.0
    inertia_b: float = 0.0
    loss_factor: float = 0.0
    viscous: float = 0.0
    housing: int | None = None

    node_fields: ClassVar[tuple[str, ...]] = ("a", "b", "housing")

    @property
    def speeds(self) -> tuple[int, int, float]:
        """Both nodes, and the speed ratio of a to b."""
        return self.a, self.b, self.radii[1] / self.radii[0]

    def inverted(self) -> Belt:
        """Return the part with the inverse of its ratio."""
        return replace(self, radii=(self.radii[1], self.radii[0]))

    def pieces(self, new_node: Callable[[], int]) -> list[Piece]:
        """Return the belt and the pulleys."""
        what = f"belt {self.name!r}"
        if not isinstance(self.crossed, bool):
            raise ModelError(f"{what}: crossed {self.crossed!r}; expected true or false")
        r_a, r_b = check_pair(what, "radii", self.radii)
        k = check_positive_or_none(what, "stiffness", self.stiffness)
        row = (r_a, r_b if self.crossed else -r_b)
        belt = make_transmission(what, self, (self.a, self.b), row, k, along=True)
        return [belt, *half_inertias(what, self, belt.nodes)]


_Wheels = TypeVar("_Wheels", GearPair, DualDrive)


def _invert_wheels(part: _Wheels) -> _Wheels:
    """Return two wheels with the inverse of their ratio."""
    if part.ratio is not None:
        return replace(part, ratio=1.0 / part.ratio)
    if part.teeth is not None:
        return replace(part, teeth=(part.teeth[1], part.teeth[0]))
    assert part.radii is not None
    return replace(part, radii=(part.radii[1], part.radii[0]))


def line_of_action(what: str, pressure_angle_deg: float) -> float:
    """Return cos(alpha), the ratio of base to pitch radius, for an angle from 0 to 60 degrees."""
    if not 0.0 <= check_number(what, "pressure_angle_deg", pressure_angle_deg) < 60.0:
        raise ModelError(
            f"{what}: pressure_angle_deg {pressure_angle_deg!r}; expected 0 up to 60 degrees"
        )
    return math.cos(math.radians(pressure_angle_deg))


def _mesh_deformation(
    what: str, part: Any, mesh: float | None, torsional: float | None, rigid: bool
) -> tuple[tuple[float, float], float | None, bool]:
    """Return row, stiffness (None if rigid), and whether the deformation is a length."""
    if part.kind not in _SENSES:
        raise ModelError(f"{what}: kind {part.kind!r}; {suggest(str(part.kind), _SENSES)}")
    if not isinstance(rigid, bool):
        raise ModelError(f"{what}: rigid {rigid!r}; expected true or false")
    ways = {
        "mesh_stiffness": mesh is not None,
        "torsional_stiffness": torsional is not None,
        "rigid": rigid,
    }
    given = [way for way, is_given in ways.items() if is_given]
    if len(given) != 1:
        offered = [way for way in ways if hasattr(part, way)]
        raise ModelError(
            f"{what}: {' and '.join(given) or 'none'} given; expected one of {', '.join(offered)}"
        )
    sense = _SENSES[part.kind]
    ratio, radii = _wheel_sizes(what, part)
    cosine = line_of_action(what, part.pressure_angle_deg)
    if mesh is None:
        k = check_positive_or_none(what, "torsional_stiffness", torsional)
        return (1.0 / ratio, sense), k, False
    if radii is None:
        raise ModelError(f"{what}: mesh_stiffness requires radii, or teeth and module")
    row = (cosine * radii[0], sense * cosine * radii[1])
    return row, check_positive(what, "mesh_stiffness", mesh), True


def _wheel_sizes(what: str, part: Any) -> tuple[float, tuple[float, float] | None]:
    """Return r_b / r_a and, if known, the pitch radii in m."""
    given = [key for key in ("ratio", "teeth", "radii") if getattr(part, key) is not None]
    if len(given) != 1:
        raise ModelError(
            f"{what}: {' and '.join(given) or 'none'} given; expected one of ratio, teeth, radii"
        )
    if part.module is not None and part.teeth is None:
        raise ModelError(f"{what}: module requires teeth")
    if part.ratio is not None:
        return check_positive(what, "ratio", part.ratio), None
    if part.radii is not None:
        r_a, r_b = check_pair(what, "radii", part.radii)
        return r_b / r_a, (r_a, r_b)
    z_a, z_b = check_pair(what, "teeth", part.teeth)
    if part.module is None:
        return z_b / z_a, None
    half = check_positive(what, "module", part.module) / 2.0
    return z_b / z_a, (half * z_a, half * z_b)


@dataclass(frozen=True, slots=True)
class Planetary(Part):
    """A planetary stage without the inertias of sun, ring and carrier, which are `Inertia` parts.

    Groups: ``NAME sun mesh`` and ``NAME ring mesh`` for elastic meshes, ``NAME planets`` for
    planets with inertia or mass.

    Parameters
    ----------
    name : str
        Prefix of the group names.
    sun, ring, carrier : int
        Nodes. The train fixes one of them if needed (`held`, `Ground`, `Brake`).
    teeth : tuple of float, shape (2,)
        Numbers of teeth of sun and ring, z_s and z_r; the planets have (z_r - z_s) / 2.
    rigid : bool
        Whether the ratios are constraints. They eliminate the DOF of the carrier, or another DOF
        tied to it.
    n_planets : int
        Number of planets.
    module : float, optional
        Module in m: r = module z / 2. Required for elastic meshes and for `planet_mass`.
    sun_mesh, ring_mesh : float, optional
        Stiffness of each planet's mesh along the line of action, in N/m; both, unless rigid.
    pressure_angle_deg : float
        Working pressure angle of both meshes, in degrees.
    planets : tuple of int, optional
        Nodes of the planets: one for all, without differential motions of planets, or `n_planets`.
        By default one, numbered after all nodes of the train. Not for rigid ratios.
    planet_inertia : float
        Inertia of each planet about its axis in kg m2.
    planet_mass : float
        Mass of each planet in kg, at the radius r_s + r_p of the carrier.
    loss_factor : float
        Structural loss factor of the meshes.
    viscous : float
        Damping of each mesh along the line of action in N s/m.
    """

    name: str
    sun: int
    ring: int
    carrier: int
    teeth: tuple[float, float]
    rigid: bool = False
    n_planets: int = 3
    module: float | None = None
    sun_mesh: float | None = None
    ring_mesh: float | None = None
    pressure_angle_deg: float = 20.0
    planets: tuple[int, ...] | None = None
    planet_inertia: float = 0.0
    planet_mass: float = 0.0
    loss_factor: float = 0.0
    viscous: float = 0.0

    node_fields: ClassVar[tuple[str, ...]] = ("sun", "ring", "carrier", "planets")

    def pieces(self, new_node: Callable[[], int]) -> list[Piece]:
        """Return the meshes or the rigid ratio, and the planets."""
        what = f"planetary stage {self.name!r}"
        z_s, z_r = check_pair(what, "teeth", self.teeth)
        if z_r <= z_s:
            raise ModelError(
                f"{what}: teeth {self.teeth!r}; expected more on the ring than on the sun"
            )
        if not isinstance(self.rigid, bool):
            raise ModelError(f"{what}: rigid {self.rigid!r}; expected true or false")
        check_whole(what, "n_planets", self.n_planets, 1)
        axes, willis = relative_deformation(
            what, (self.sun, self.ring, self.carrier), (z_s, z_r, -(z_s + z_r)), None
        )
        out = self._planet_inertia(what, axes[2])
        if self.rigid:
            out += self._rigid(what, axes, willis)
        else:
            out += self._elastic(what, new_node)
        return out

    def _planet_inertia(self, what: str, carrier: int) -> list[Piece]:
        mass = check_not_negative(what, "planet_mass", self.planet_mass)
        if not mass:
            return []
        if self.module is None:
            raise ModelError(
                f"{what}: planet_mass requires module, for the radius of the planet axes"
            )
        arm = check_positive(what, "module", self.module) * (self.teeth[0] + self.teeth[1]) / 4.0
        return [lump_inertia(self._planets, carrier, self.n_planets * mass * arm**2)]

    @property
    def _planets(self) -> str:
        return f"{self.name} planets"

    def _rigid(self, what: str, axes: tuple[int, ...], willis: tuple[float, ...]) -> list[Piece]:
        given = [
            key for key in ("sun_mesh", "ring_mesh", "planets") if getattr(self, key) is not None
        ]
        given += [key for key in ("loss_factor", "viscous") if getattr(self, key)]
        if given:
            raise ModelError(
                f"{what} is rigid: {', '.join(given)} would have no effect; leave it out"
            )
        out: list[Piece] = [RigidRatio(what, axes, willis, axes[2])]
        J = check_not_negative(what, "planet_inertia", self.planet_inertia)
        if J:
            # theta_p = theta_c + (z_s / z_p) (theta_c - theta_s)
            step = 2.0 * self.teeth[0] / (self.teeth[1] - self.teeth[0])
            turn = np.array([-step, 1.0 + step])
            matrix = self.n_planets * J * np.outer(turn, turn)
            out.append(InertiaMatrix(self._planets, (axes[0], axes[2]), matrix))
        return out

    def _elastic(self, what: str, new_node: Callable[[], int]) -> list[Piece]:
        for key in ("sun_mesh", "ring_mesh", "module"):
            if getattr(self, key) is None:
                raise ModelError(
                    f"{what}: {key} is missing; expected sun_mesh, ring_mesh and module, or rigid"
                )
        half = check_positive(what, "module", self.module) / 2.0
        half *= line_of_action(what, self.pressure_angle_deg)
        r_s = half * self.teeth[0]
        r_r = half * self.teeth[1]
        r_p = (r_r - r_s) / 2.0
        k_s = check_positive(what, "sun_mesh", self.sun_mesh)
        k_r = check_positive(what, "ring_mesh", self.ring_mesh)
        J = check_not_negative(what, "planet_inertia", self.planet_inertia)
        viscous, loss = check_damping(what, self)
        planets = self._planet_nodes(what) or (new_node(),)
        count = self.n_planets // len(planets)  # planets represented by one node
        meshes = (("sun", self.sun, k_s, (r_s, r_p)), ("ring", self.ring, k_r, (r_r, -r_p)))
        out: list[Piece] = []
        for planet in planets:
            for wheel, node, k, coefficients in meshes:
                nodes, row = relative_deformation(what, (node, planet), coefficients, self.carrier)
                group = f"{self.name} {wheel} mesh"
                out.append(
                    TorsionSpring(group, nodes, row, count * k, count * viscous, loss, along=True)
                )
            if J:
                out.append(lump_inertia(self._planets, planet, count * J))
        return out

    def _planet_nodes(self, what: str) -> tuple[int, ...]:
        nodes = self.planets
        if nodes is None:
            return ()
        if not isinstance(nodes, tuple | list) or len(nodes) not in (1, self.n_planets):
            raise ModelError(f"{what}: planets {nodes!r}; expected one node, or {self.n_planets}")
        if len(set(nodes)) < len(nodes):
            raise ModelError(f"{what}: planets {nodes!r}; expected different nodes")
        return tuple([check_whole(what, "planets", node) for node in nodes])
