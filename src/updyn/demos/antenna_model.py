"""A generated 4 m antenna: pedestal, yoke, truss, reflector, and two drive trains with motors.

SI units; X along the horizontal direction of view, Y along the elevation axis, Z up. With fixed
drives, the first mode of a dish of D metres is at about 20 D^-0.7 Hz (W. Gawronski, Modeling and
Control of Antennas and Telescopes, Springer 2008), here 7.6 Hz; this model has 7.1 Hz. The
stiffness of a gear mesh includes bearings and carrier of its pinion; the teeth alone would be ten
times as stiff.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from updyn.arrays import IntArray, RealArray
from updyn.elements.constraints import Equation, constrain, join
from updyn.elements.drivetrain import GearPair, Inertia, Motor, Part, Shaft, drivetrain, mounted
from updyn.elements.structure import (
    Beam,
    Element,
    PointMass,
    RigidLink,
    Section,
    Shell,
    Spring,
    structure,
    tube,
)
from updyn.geometry import Geometry
from updyn.model import Group, Model

__all__ = ["AZIMUTH", "ELEVATION", "NODES", "antenna", "lock_rotors", "trains"]

STEEL = {"E": 210e9, "rho": 7850.0, "nu": 0.3}
ALUMINIUM = {"E": 70e9, "rho": 2700.0, "nu": 0.33}
DIAMETER = 4.0  # m
FOCUS = 1.5  # m
SKIN = 0.0015  # m, thickness of the reflector
_AXIS_HEIGHT = 2.9  # height of the elevation axis
_HALF_WIDTH = 0.75  # half width of the yoke
_RADII = np.array([0.45, 0.76, 1.07, 1.38, 1.69, DIAMETER / 2])  # rings of the reflector
_RIBS = 12
_AROUND = 24  # nodes around each ring of the reflector
_VERTEX = 0.55  # vertex of the paraboloid, in front of the elevation axis

#: Nodes that are measured, struck or driven.
NODES = {"foundation": 1, "pedestal top": 2, "turntable": 3, "hub": 4, "feed": 5, "tube": 200}

#: Nodes of the azimuth drive; "motor" is the rotation of the rotor relative to its housing.
AZIMUTH = {
    "motor": 2001,
    "rotor": 2002,
    "input": 2003,
    "stage 1": 2004,
    "stage 2": 2005,
    "pinion": 2006,
    "ring": 2007,
    "housing": 2008,
}
ELEVATION = {name: node + 1000 for name, node in AZIMUTH.items()}
_TRAINS = {"azimuth": AZIMUTH, "elevation": ELEVATION}


def antenna() -> Model:
    """Return the antenna of the drawings, rotors free."""
    # The rotation of a motor (nodes 2001 and 3001) is that of its rotor relative to its housing,
    # so fixing this DOF locks the rotor.
    body = _split(_structure(SKIN), _structure(2.0 * SKIN))
    assert body.geometry is not None
    model = _with_drive(body, "azimuth", NODES["turntable"], NODES["pedestal top"], "Z")
    model = _with_drive(model, "elevation", NODES["tube"] + 6, _yoke_top(1), "Y")
    geometry = _geometry_with_drives(body.geometry)
    return Model.from_groups(model.groups, model.dofs, geometry=geometry, title=model.title)


def _with_drive(model: Model, name: str, ring: int, housing: int, axis: str) -> Model:
    """Mount a drive train between two nodes of the structure, with a drag on its motor."""
    train = _TRAINS[name]
    vector = np.eye(3)["XYZ".index(axis)].tolist()
    places = {train["ring"]: (ring, vector), train["housing"]: (housing, vector)}
    mounted_model = mounted(drivetrain(trains(name)), model, places)
    motor = f"{train['motor']}:RZ"
    drag = Model.from_groups({f"{name} drag": Group(viscous=[[2e-3]])}, [motor])
    joined = join([mounted_model, drag], title="Antenna of 4 m")
    rotor = Equation(f"{train['rotor']}:RZ", {motor: 1.0, f"{housing}:R{axis}": 1.0})
    return constrain(joined, [rotor])


def lock_rotors(model: Model) -> Model:
    """Return the antenna with both rotors locked to their housings."""
    return constrain(model, grounded=[f"{AZIMUTH['motor']}:RZ", f"{ELEVATION['motor']}:RZ"])


# -- drives
def trains(which: str) -> list[Part]:
    """Return the parts of the drive train of an axis, "azimuth" or "elevation"."""
    at = _TRAINS[which]
    loss: dict[str, Any] = {"loss_factor": 0.03, "housing": at["housing"]}
    stage: dict[str, Any] = {"ratio": 10.0, "inertia_a": 2e-4, "inertia_b": 2e-3} | loss
    return [
        Motor(f"{which} motor", at["rotor"], inertia=2.5e-3),
        Shaft(f"{which} input shaft", at["rotor"], at["input"], stiffness=8e3, loss_factor=0.03),
        GearPair(f"{which} stage 1", at["input"], at["stage 1"], torsional_stiffness=4e4, **stage),
        GearPair(
            f"{which} stage 2", at["stage 1"], at["stage 2"], torsional_stiffness=1.5e5, **stage
        ),
        Shaft(
            f"{which} pinion shaft", at["stage 2"], at["pinion"], stiffness=9e4, loss_factor=0.03
        ),
        Inertia(f"{which} pinion", at["pinion"], 4e-3),
        GearPair(
            f"{which} mesh",
            at["pinion"],
            at["ring"],
            radii=(0.04, 0.32),
            mesh_stiffness=6e7,
            **loss,
        ),
    ]


def _geometry_with_drives(geometry: Geometry) -> Geometry:
    """Return the geometry with nodes for drawing the drives next to the structure."""
    azimuth = np.array(
        [[0.75, 0.0, 1.0], [0.75, 0.0, 1.2], [0.75, 0.0, 1.4], [0.75, 0.0, 1.6], [0.45, 0.0, 1.85]]
    )
    start = np.array([-0.55, 1.15, _AXIS_HEIGHT - 0.55])
    elevation = start + np.outer([0.0, 0.25, 0.5, 0.75, 1.0], [0.4, -0.35, 0.5])
    names = ("motor", "input", "stage 1", "stage 2", "pinion")
    nodes = [*geometry.nodes.tolist()]
    lines = [*geometry.lines.tolist()]
    for train, ring in ((AZIMUTH, NODES["turntable"]), (ELEVATION, NODES["tube"] + 6)):
        drive_nodes = [train[name] for name in names]
        nodes += drive_nodes
        lines += pairwise([*drive_nodes, ring])
    axes = np.tile(np.eye(3), (len(nodes), 1, 1))
    # The shafts of the elevation drive rotate about Y, which is their RZ.
    axes[-len(elevation) :] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    xyz = np.concatenate([geometry.xyz, azimuth, elevation])
    return Geometry(nodes, xyz, lines, axes, geometry.faces)


# -- structure
class _Body:
    """Nodes, parts and rigid links of the structure while it is assembled."""

    def __init__(self) -> None:
        self.xyz: dict[int, RealArray] = {}
        self.parts: list[Element] = []
        self.links: list[RigidLink] = []

    def place(self, first: int, points: Iterable[ArrayLike]) -> list[int]:
        """Place nodes at points, numbered from `first` on; return the numbers."""
        numbers = []
        for number, point in enumerate(points, first):
            self.xyz[number] = np.asarray(point, dtype=np.float64)
            numbers.append(number)
        return numbers

    def line(self, name: str, nodes: Sequence[int], section: Section, **more: Any) -> None:
        """Add steel beams between successive nodes."""
        pairs = list(pairwise(nodes))
        self.parts.append(Beam(name, pairs, section=section, loss_factor=0.01, **STEEL, **more))


def _structure(thickness: float) -> Model:
    body = _Body()
    body.place(NODES["foundation"], [(0, 0, 0)])
    body.place(NODES["pedestal top"], [(0, 0, 1.8)])
    body.place(NODES["turntable"], [(0, 0, 1.9)])
    body.place(NODES["hub"], [_dish(0.2)])
    body.place(NODES["feed"], [_dish(_VERTEX + FOCUS - 0.05)])
    _add_pedestal(body)
    _add_yoke(body)
    _add_tube(body)
    _add_reflector(body, thickness)
    _add_feed(body)
    return structure(body.xyz, body.parts, links=body.links, title="Antenna of 4 m")


def _split(single: Model, double: Model) -> Model:
    """Return the model with the bending of the reflector as a separate group."""
    # K(t) = t A + t^3 B, so K(2 t) - 2 K(t) = 6 t^3 B: membrane and shear stiffness are
    # proportional to t, bending stiffness to its cube.
    skin = single.group("reflector")
    thick = double.group("reflector")
    assert skin.stiffness is not None
    assert thick.stiffness is not None
    bending = sp.csr_array(thick.stiffness - 2.0 * skin.stiffness) / 6.0
    groups = dict(single.groups) | {
        "reflector": Group(skin.stiffness - bending, skin.mass, skin.loss_factor),
        "reflector bending": Group(bending, loss_factor=skin.loss_factor),
    }
    return Model(groups, single.dofs, single.geometry, single.title)


def _box(height: float, width: float, wall: float) -> Section:
    """Return a thin-walled box section; J by Bredt's formula, 4 A_m^2 t / s."""
    h = height - wall
    b = width - wall
    Iyy = (height * width**3 - (height - 2 * wall) * (width - 2 * wall) ** 3) / 12
    Izz = (width * height**3 - (width - 2 * wall) * (height - 2 * wall) ** 3) / 12
    A = height * width - (height - 2 * wall) * (width - 2 * wall)
    J = 2 * (h * b) ** 2 * wall / (h + b)
    return Section(A, Iyy, Izz, J, h / (2 * (h + b)) * 2, b / (2 * (h + b)) * 2)


def _add_pedestal(body: _Body) -> None:
    around = 16
    angle = 2 * np.pi * np.arange(around) / around
    circle = 0.35 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    rings = []
    for i, z in enumerate(np.linspace(0.0, 1.8, 7)):
        rings.append(body.place(1001 + 20 * i, circle + np.array([0.0, 0.0, z])))
    shell = Shell("pedestal", _quads(rings), thickness=0.008, loss_factor=0.01, **STEEL)
    foundation = Spring(
        "foundation",
        NODES["foundation"],
        stiffness=[6e8, 6e8, 1.2e9, 1.5e8, 1.5e8, 1.5e8],
        loss_factor=0.04,
    )
    bearing = Spring(
        "azimuth bearing",
        NODES["pedestal top"],
        NODES["turntable"],
        stiffness=[8e8, 8e8, 1.6e9, 2.5e7, 2.5e7, 0],
        loss_factor=0.03,
    )
    body.parts += [shell, foundation, bearing]
    body.links.append(RigidLink(NODES["foundation"], rings[0]))
    body.links.append(RigidLink(NODES["pedestal top"], rings[-1]))


def _yoke_top(side: int) -> int:
    return 108 if side > 0 else 118


def _add_yoke(body: _Body) -> None:
    heights = np.linspace(1.9, _AXIS_HEIGHT, 6)[1:]
    for side in (1, -1):
        points = []
        for share in (1 / 3, 2 / 3, 1):
            points.append((0, side * _HALF_WIDTH * share, 1.9))
        for z in heights:
            points.append((0, side * _HALF_WIDTH, z))
        first = _yoke_top(side) - len(points) + 1
        nodes = [NODES["turntable"], *body.place(first, points)]
        body.line("yoke", nodes, _box(0.28, 0.22, 0.008), orientation=[1, 0, 0])


def _add_tube(body: _Body) -> None:
    """Add the torque tube on its bearings, the counterweights and the hub carrier."""
    points = np.zeros((7, 3))
    points[:, 1] = np.linspace(-0.66, 0.66, 7)
    points[:, 2] = _AXIS_HEIGHT
    nodes = body.place(NODES["tube"], points)
    body.line("tube", nodes, tube(0.27, 0.25))
    # Only one bearing is fixed along the axis.
    for side, end, along in ((1, nodes[-1], 3e8), (-1, nodes[0], 0.0)):
        stiffness = [1.5e8, along, 1.5e8, 0, 0, 0]
        bearing = Spring(
            "elevation bearings", _yoke_top(side), end, stiffness=stiffness, loss_factor=0.03
        )
        body.parts.append(bearing)
    for first, at in ((211, nodes[1]), (221, nodes[-2])):
        y = float(body.xyz[at][1])
        arm = body.place(first, map(_dish, (-0.3, -0.6, -0.9), [0.0] * 3, [y] * 3))
        section = _box(0.16, 0.10, 0.006)
        body.line("counterweight arms", [at, *arm], section, orientation=[0, 1, 0])
        body.parts.append(PointMass("counterweight", arm[-1], 130.0, inertia=[2.0, 2.0, 2.0]))
    for at in nodes[2:5]:
        body.line("hub carrier", [at, NODES["hub"]], tube(0.16, 0.14))


def _dish(along: float, up: float = 0.0, across: float = 0.0) -> RealArray:
    """Return a point `along` the axis of the dish, `up` and `across` from it, at 45 degrees."""
    s = math.sqrt(0.5)
    return np.array([s * along - s * up, across, _AXIS_HEIGHT + s * along + s * up])


def _paraboloid(r: float) -> float:
    """Return the position of the paraboloid along the axis of the dish, at a radius."""
    return _VERTEX + r**2 / (4 * FOCUS)


def _ring_points(r: float, along: float) -> Iterator[RealArray]:
    for angle in 2 * np.pi * np.arange(_AROUND) / _AROUND:
        yield _dish(along, r * math.cos(angle), r * math.sin(angle))


def _add_reflector(body: _Body, thickness: float) -> None:
    rings = []
    for i, r in enumerate(_RADII):
        rings.append(body.place(301 + 30 * i, _ring_points(r, _paraboloid(r))))
    drum = []
    for i, along in enumerate((0.2, 0.33, 0.46)):
        drum.append(body.place(501 + 30 * i, _ring_points(_RADII[0], along)))
    skin = Shell("reflector", _quads(rings), thickness=thickness, loss_factor=0.01, **ALUMINIUM)
    drum_quads = _quads([*drum, rings[0]])
    body.parts.append(skin)
    body.parts.append(Shell("hub drum", drum_quads, thickness=0.005, loss_factor=0.01, **STEEL))
    body.links.append(RigidLink(NODES["hub"], drum[0]))
    _add_truss(body, rings, drum[0])


def _add_truss(body: _Body, rings: Sequence[Sequence[int]], inner: Sequence[int]) -> None:
    """Add the ribs and hoops behind the reflector, from the inner ring of the drum outwards."""
    chords: list[tuple[int, int]] = []
    webs: list[tuple[int, int]] = []
    hoops: list[tuple[int, int]] = []
    bottoms = []
    for rib in range(_RIBS):
        i = rib * _AROUND // _RIBS
        angle = 2 * np.pi * i / _AROUND
        top = [ring[i] for ring in rings]
        points = []
        for r, depth in zip(_RADII[1:], np.linspace(0.20, 0.06, 5), strict=True):
            along = _paraboloid(r) - depth
            points.append(_dish(along, r * math.cos(angle), r * math.sin(angle)))
        bottom = [inner[i], *body.place(601 + 10 * rib, points)]
        bottoms.append(bottom)
        chords += [*pairwise(top), *pairwise(bottom)]
        webs += [*zip(top[1:], bottom[1:], strict=True), *zip(top[:-1], bottom[1:], strict=True)]
    for ring in (rings[2], rings[5], [b[2] for b in bottoms], [b[4] for b in bottoms]):
        hoops += pairwise([*ring, ring[0]])
    for name, pairs, section in (
        ("truss chords", chords, tube(0.030, 0.026)),
        ("truss webs", webs, tube(0.020, 0.017)),
        ("truss hoops", hoops, tube(0.025, 0.022)),
    ):
        body.parts.append(Beam(name, pairs, section=section, loss_factor=0.01, **STEEL))


def _add_feed(body: _Body) -> None:
    for leg in range(4):
        foot = 361 + 3 + 6 * leg  # on the third ring, between its supports at 45 degrees
        start = body.xyz[foot]
        to_feed = body.xyz[NODES["feed"]] - start
        inner = body.place(801 + 10 * leg, (start + 1 / 3 * to_feed, start + 2 / 3 * to_feed))
        body.line("feed legs", [foot, *inner, NODES["feed"]], tube(0.045, 0.040))
    body.parts.append(PointMass("feed", NODES["feed"], 18.0, inertia=[0.4, 0.4, 0.4]))


def _quads(rings: Sequence[Sequence[int]]) -> IntArray:
    """Return the quadrilaterals between closed rings of equal size, shape (m, 4)."""
    low = np.array(rings[:-1])
    high = np.array(rings[1:])
    corners = [low, np.roll(low, -1, axis=1), np.roll(high, -1, axis=1), high]
    return np.stack(corners, axis=2).reshape(-1, 4)
