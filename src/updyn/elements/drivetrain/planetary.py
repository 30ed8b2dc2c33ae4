"""A planetary stage: sun, ring and carrier, with rigid ratios or with elastic meshes.

All rotations count about the stage's axis in one sense. Seen from the carrier the meshes are an
external and an internal pair, so that with r_r = r_s + 2 r_p (Kahraman, J. Sound and Vibration 173
(1994) 125, the purely rotational
model)::

    delta_s = cos(alpha) (r_s (theta_s - theta_c) + r_p (theta_p - theta_c))
    delta_r = cos(alpha) (r_r (theta_r - theta_c) - r_p (theta_p - theta_c))

Both at 0 give the equation of Willis, z_s theta_s + z_r theta_r = (z_s + z_r) theta_c.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from updyn.elements._mesh import not_negative, positive
from updyn.elements.drivetrain.gears import line_of_action
from updyn.elements.drivetrain.pieces import (
    Mass,
    Piece,
    Spring,
    Tie,
    lump,
    pair,
    quantities,
    relative,
    whole,
)
from updyn.errors import ModelError

__all__ = ["Planetary"]


@dataclass(frozen=True, slots=True)
class Planetary:
    """A planetary stage. The inertias of sun, ring and carrier are parts of their own (`Inertia`).

    Groups: ``NAME sun mesh`` and ``NAME ring mesh`` where the meshes are elastic, ``NAME planets``
    where the planets have inertia or mass.

    Parameters
    ----------
    name : str
        Beginning of the group names.
    sun, ring, carrier : int
        Nodes. Whichever is fixed is held by the train (`held`, `Ground`, `Brake`).
    teeth : tuple of float, shape (2,)
        Of sun and ring, z_s and z_r; the planets have (z_r - z_s) / 2.
    rigid : bool
        Whether the ratios are constraints; the DOF of the carrier then vanishes, or another that it
        is tied to.
    n_planets : int
        Number of planets.
    module : float, optional
        In m: r = module z / 2. Needed for elastic meshes and for `planet_mass`.
    sun_mesh, ring_mesh : float, optional
        Stiffness of each planet's mesh along the line of action, in N/m; both, unless rigid.
    pressure_angle_deg : float
        Working pressure angle of both meshes, in degrees.
    planets : tuple of int, optional
        Nodes of the planets: one (they all turn alike, which leaves out the motions in which they
        differ) or `n_planets`. None: one, numbered after all nodes that the train names. Not for
        rigid ratios.
    planet_inertia : float
        Of each planet about its own axis, in kg m2.
    planet_mass : float
        Of each planet, in kg; turns with the carrier at the radius r_s + r_p.
    loss_factor : float
        Structural loss factor of the meshes.
    viscous : float
        Of each mesh along the line of action, in N s/m.
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

    def pieces(self, new_node: Callable[[], int]) -> list[Piece]:
        """Return the meshes or the rigid ratio, and the planets."""
        what = f"planetary stage {self.name!r}"
        z_s, z_r = pair(what, "teeth", self.teeth)
        if z_r <= z_s:
            raise ModelError(
                f"{what}: teeth {self.teeth!r}; expected more on the ring than on the sun"
            )
        if not isinstance(self.rigid, bool):
            raise ModelError(f"{what}: rigid {self.rigid!r}; expected true or false")
        whole(what, "n_planets", self.n_planets, 1)
        axes, willis = relative(
            what, (self.sun, self.ring, self.carrier), (z_s, z_r, -(z_s + z_r)), None
        )
        out: list[Piece] = self._carried(what, axes[2])
        return out + (
            self._rigid(what, axes, willis) if self.rigid else self._elastic(what, new_node)
        )

    def _carried(self, what: str, carrier: int) -> list[Piece]:
        mass = not_negative(what, "planet_mass", self.planet_mass)
        if not mass:
            return []
        if self.module is None:
            raise ModelError(
                f"{what}: planet_mass asks for module, to know the radius at which it turns"
            )
        arm = positive(what, "module", self.module) * (self.teeth[0] + self.teeth[1]) / 4.0
        return [lump(self._planets, carrier, self.n_planets * mass * arm**2)]

    @property
    def _planets(self) -> str:
        return f"{self.name} planets"

    def _rigid(self, what: str, axes: tuple[int, ...], willis: tuple[float, ...]) -> list[Piece]:
        given = [k for k in ("sun_mesh", "ring_mesh", "planets") if getattr(self, k) is not None]
        given += [k for k in ("loss_factor", "viscous") if getattr(self, k)]
        if given:
            raise ModelError(
                f"{what} is rigid: {', '.join(given)} would have no effect; leave it out"
            )
        out: list[Piece] = [Tie(what, axes, willis, axes[2])]
        if J := not_negative(what, "planet_inertia", self.planet_inertia):
            # theta_p = theta_c + (z_s / z_p) (theta_c - theta_s)
            step = 2.0 * self.teeth[0] / (self.teeth[1] - self.teeth[0])
            turn = np.array([-step, 1.0 + step])
            out.append(
                Mass(self._planets, (axes[0], axes[2]), self.n_planets * J * np.outer(turn, turn))
            )
        return out

    def _elastic(self, what: str, new_node: Callable[[], int]) -> list[Piece]:
        for key in ("sun_mesh", "ring_mesh", "module"):
            if getattr(self, key) is None:
                raise ModelError(
                    f"{what}: {key} is missing; expected sun_mesh, ring_mesh and module, or rigid"
                )
        half = (
            positive(what, "module", self.module)
            / 2.0
            * line_of_action(what, self.pressure_angle_deg)
        )
        r_s, r_r = half * self.teeth[0], half * self.teeth[1]
        r_p = (r_r - r_s) / 2.0
        k_s, k_r = (
            positive(what, "sun_mesh", self.sun_mesh),
            positive(what, "ring_mesh", self.ring_mesh),
        )
        J = not_negative(what, "planet_inertia", self.planet_inertia)
        viscous, loss = quantities(what, self)
        nodes = (new_node(),) if self.planets is None else self._planet_nodes(what)
        alike = self.n_planets // len(nodes)
        out: list[Piece] = []
        meshes = (("sun", self.sun, k_s, (r_s, r_p)), ("ring", self.ring, k_r, (r_r, -r_p)))
        for planet in nodes:
            for wheel, node, k, row in meshes:
                at, seen = relative(what, (node, planet), row, self.carrier)
                mesh = Spring(
                    f"{self.name} {wheel} mesh",
                    at,
                    seen,
                    alike * k,
                    alike * viscous,
                    loss,
                    along=True,
                )
                out.append(mesh)
            if J:
                out.append(lump(self._planets, planet, alike * J))
        return out

    def _planet_nodes(self, what: str) -> tuple[int, ...]:
        nodes = self.planets
        if not isinstance(nodes, tuple | list) or len(nodes) not in (1, self.n_planets):
            raise ModelError(f"{what}: planets {nodes!r}; expected one node, or {self.n_planets}")
        if len(set(nodes)) < len(nodes):
            raise ModelError(f"{what}: planets {nodes!r}; expected different nodes")
        return tuple(whole(what, "planets", n) for n in nodes)
