"""Parts that change the speed: gear pairs, worms, belts, and two pinions preloaded against each other.

Parallel shafts count their rotation about the same direction, so that an external pair turns its
shafts in opposite senses and an internal one in the same.

The deflection of a mesh along the line of action is delta = cos(alpha) (r_a theta_a + r_b theta_b)
of an external and cos(alpha) (r_a theta_a - r_b theta_b) of an internal pair, r cos(alpha) being
the base radii (Ozguven & Houser, J. Sound and Vibration 121 (1988) 383).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from updyn.elements._mesh import not_negative, number, positive
from updyn.elements.drivetrain.pieces import Piece, lump, pair, transmission
from updyn.elements.drivetrain.shafts import halves
from updyn.errors import ModelError, suggest

__all__ = ["Belt", "DualDrive", "GearPair", "Worm", "line_of_action"]

_SENSES = {"external": 1.0, "internal": -1.0}


@dataclass(frozen=True, slots=True)
class GearPair:
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
        r_b / r_a = z_b / z_a, the speed of a over that of b.
    teeth : tuple of float, shape (2,), optional
        Numbers of teeth z_a, z_b.
    module : float, optional
        Transverse module in m, with `teeth`: r = module z / 2.
    radii : tuple of float, shape (2,), optional
        Pitch radii r_a, r_b, in m.
    mesh_stiffness : float, optional
        Along the line of action, in N/m; asks for `radii`, or `teeth` and `module`.
    torsional_stiffness : float, optional
        Of b while a is held, in N m/rad: mesh_stiffness (r_b cos alpha)^2.
    rigid : bool
        Whether the ratio is a constraint. The DOF of b then vanishes from the model, or another
        that it is tied to.
    pressure_angle_deg : float
        Transverse working pressure angle alpha, in degrees.
    kind : {"external", "internal"}
        Whether the shafts turn in opposite senses or the same. Of shafts that are not parallel
        (bevel gears) it says so for the senses that you count as positive.
    inertia_a, inertia_b : float
        Of the wheels, in kg m2.
    loss_factor : float
        Structural loss factor of the mesh.
    viscous : float
        Of the mesh, in N s/m along the line of action; with `torsional_stiffness` in N m s/rad at
        b.
    housing : int, optional
        Node that carries both shafts, parallel to its axis; None: the ground.
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

    def pieces(self, new_node: Callable[[], int]) -> list[Piece]:
        """Return the mesh and the two wheels."""
        what = f"gear pair {self.name!r}"
        row, k, along = _mesh(what, self, self.mesh_stiffness, self.torsional_stiffness, self.rigid)
        mesh = transmission(what, self, (self.a, self.b), row, k, along=along)
        return [mesh, *halves(what, self, mesh.nodes)]


@dataclass(frozen=True, slots=True)
class DualDrive:
    """Two pinions on one gear, biased against each other so that the gear has no backlash.

    As long as the bias keeps both meshes in contact each is a spring for either sense, and the gear
    sees both. Beyond `opening_torque` one of them opens and the train is no longer linear.

    Parameters
    ----------
    name : str
        Group name.
    first, second : int
        Nodes of the pinions.
    gear : int
        Node of the gear.
    ratio, teeth, module, radii
        As of `GearPair`, a being either pinion and b the gear.
    mesh_stiffness : float, optional
        Of each mesh along the line of action, in N/m.
    torsional_stiffness : float, optional
        Instead: of the gear on one mesh, its pinion held, in N m/rad.
    second_factor : float
        Stiffness of the second mesh over that of the first.
    preload : float, optional
        Torque in N m with which each pinion is biased; None: not stated.
    pressure_angle_deg, kind
        As of `GearPair`.
    inertia_a, inertia_b : float
        Of each pinion and of the gear, in kg m2.
    loss_factor : float
        Structural loss factor of the meshes.
    viscous : float
        Of each mesh, as of `GearPair`.
    housing : int, optional
        Node that carries all three shafts, parallel to its axis; None: the ground.
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

    def pieces(self, new_node: Callable[[], int]) -> list[Piece]:
        """Return both meshes, the pinions and the gear."""
        what = f"dual drive {self.name!r}"
        row, k, along = _mesh(what, self, self.mesh_stiffness, self.torsional_stiffness, False)
        factor = positive(what, "second_factor", self.second_factor)
        if self.preload is not None:
            positive(what, "preload", self.preload)
        if self.first == self.second:
            raise ModelError(f"{what}: node {self.first} is both pinions; expected two nodes")
        out: list[Piece] = []
        for pinion, stiffness in ((self.first, k or 0.0), (self.second, (k or 0.0) * factor)):
            out.append(transmission(what, self, (pinion, self.gear), row, stiffness, along=along))
            out += halves(what, self, (pinion,))
        if J := not_negative(what, "inertia_b", self.inertia_b):
            out.append(lump(self.name, self.gear, J))
        return out

    @property
    def opening_torque(self) -> float:
        """Load torque on the gear, in N m, at which one mesh opens while both pinions are held.

        The meshes share a load torque T in proportion to their stiffness; the stiffer one is
        unloaded first, at T k / (k_1 + k_2) = ratio preload.

        Raises
        ------
        ModelError
            If no preload is stated, or a number is not usable.
        """
        what = f"dual drive {self.name!r}"
        if self.preload is None:
            raise ModelError(f"{what}: preload is not stated")
        ratio, _ = _sizes(what, self)
        factor = positive(what, "second_factor", self.second_factor)
        return ratio * positive(what, "preload", self.preload) * (1.0 + factor) / max(1.0, factor)


@dataclass(frozen=True, slots=True)
class Worm:
    """A worm and its wheel: theta_wheel = theta_worm / ratio.

    The linear model drives both ways; friction that makes a worm self-locking is not in it.

    Parameters
    ----------
    name : str
        Group name.
    worm, wheel : int
        Nodes.
    ratio : float
        Speed of the worm over that of the wheel: teeth of the wheel over starts of the worm.
        Negative: they turn in opposite of the senses that you count as positive (a left-hand worm
        where those are of a right-hand one).
    stiffness : float, optional
        Of the wheel while the worm is held, in N m/rad; None: rigid, and the DOF of the wheel
        vanishes.
    inertia_a, inertia_b : float
        Of worm and wheel, in kg m2.
    loss_factor : float
        Structural loss factor.
    viscous : float
        In N m s/rad at the wheel.
    housing : int, optional
        Node that carries both and turns about the wheel's axis; None: the ground.
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

    def pieces(self, new_node: Callable[[], int]) -> list[Piece]:
        """Return the mesh, the worm and the wheel."""
        what = f"worm {self.name!r}"
        if number(what, "ratio", self.ratio) == 0.0:
            raise ModelError(f"{what}: ratio 0; expected a number other than 0")
        k = None if self.stiffness is None else positive(what, "stiffness", self.stiffness)
        mesh = transmission(
            what, self, (self.worm, self.wheel), (-1.0 / self.ratio, 1.0), k, counts=1.0
        )
        return [mesh, *halves(what, self, mesh.nodes)]


@dataclass(frozen=True, slots=True)
class Belt:
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
        Force over stretch, in N/m: of a pretensioned belt both strands, 2 E A / L, of a chain the
        taut one alone. None: rigid, and the DOF of b vanishes.
    crossed : bool
        Whether it is crossed and turns b the other way.
    inertia_a, inertia_b : float
        Of the pulleys, in kg m2.
    loss_factor : float
        Structural loss factor.
    viscous : float
        In N s/m.
    housing : int, optional
        Node that carries both pulleys, parallel to its axis; None: the ground.
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

    def pieces(self, new_node: Callable[[], int]) -> list[Piece]:
        """Return the belt and the pulleys."""
        what = f"belt {self.name!r}"
        if not isinstance(self.crossed, bool):
            raise ModelError(f"{what}: crossed {self.crossed!r}; expected true or false")
        r_a, r_b = pair(what, "radii", self.radii)
        k = None if self.stiffness is None else positive(what, "stiffness", self.stiffness)
        row = (r_a, r_b if self.crossed else -r_b)
        belt = transmission(what, self, (self.a, self.b), row, k, along=True)
        return [belt, *halves(what, self, belt.nodes)]


def line_of_action(what: str, pressure_angle_deg: float) -> float:
    """Return cos(alpha), base radius over pitch radius.

    Raises
    ------
    ModelError
        If the angle is not between 0 and 60 degrees.
    """
    if not 0.0 <= number(what, "pressure_angle_deg", pressure_angle_deg) < 60.0:
        raise ModelError(
            f"{what}: pressure_angle_deg {pressure_angle_deg!r}; expected 0 up to 60 degrees"
        )
    return math.cos(math.radians(pressure_angle_deg))


def _mesh(
    what: str, part: Any, mesh: float | None, torsional: float | None, rigid: bool
) -> tuple[tuple[float, float], float | None, bool]:
    """Return row, stiffness (None: rigid) and whether it is along a line."""
    if part.kind not in _SENSES:
        raise ModelError(f"{what}: kind {part.kind!r}; {suggest(str(part.kind), _SENSES)}")
    if not isinstance(rigid, bool):
        raise ModelError(f"{what}: rigid {rigid!r}; expected true or false")
    ways = ("mesh_stiffness", "torsional_stiffness", "rigid")
    given = [
        w
        for w, there in zip(ways, (mesh is not None, torsional is not None, rigid), strict=True)
        if there
    ]
    offered = [w for w in ways if hasattr(part, w)]
    if len(given) != 1:
        raise ModelError(
            f"{what}: {' and '.join(given) or 'none'} given; expected one of {', '.join(offered)}"
        )
    sense = _SENSES[part.kind]
    ratio, radii = _sizes(what, part)
    cosine = line_of_action(what, part.pressure_angle_deg)
    if mesh is None:
        k = None if torsional is None else positive(what, "torsional_stiffness", torsional)
        return (1.0 / ratio, sense), k, False
    if radii is None:
        raise ModelError(f"{what}: mesh_stiffness asks for radii, or teeth and module")
    return (
        (cosine * radii[0], sense * cosine * radii[1]),
        positive(what, "mesh_stiffness", mesh),
        True,
    )


def _sizes(what: str, part: Any) -> tuple[float, tuple[float, float] | None]:
    """Return r_b / r_a and, where they are known, the pitch radii in m."""
    given = [key for key in ("ratio", "teeth", "radii") if getattr(part, key) is not None]
    if len(given) != 1:
        raise ModelError(
            f"{what}: {' and '.join(given) or 'none'} given; expected one of ratio, teeth, radii"
        )
    if part.module is not None and part.teeth is None:
        raise ModelError(f"{what}: module goes with teeth")
    if part.ratio is not None:
        return positive(what, "ratio", part.ratio), None
    first, second = pair(what, given[0], part.radii if part.teeth is None else part.teeth)
    if part.teeth is None:
        return second / first, (first, second)
    half = None if part.module is None else positive(what, "module", part.module) / 2.0
    return second / first, None if half is None else (half * first, half * second)
