"""A 4 m antenna, generated: shell pedestal, yoke, backup truss, reflector, and two drive trains with motors.

Everything is in SI units. X points where the dish looks at the horizon, Y along the elevation axis,
Z up; the dish stands at 45 degrees of elevation.

Dimensions and weights are of a common design, 4 m of aluminium skin on a welded truss of steel
tubes, 0.87 t above the pedestal; no built antenna was copied. What holds the frequencies to what is
usual: with its drives held a dish of D metres has its first mode at some 20 D^-0.7 Hz (W.
Gawronski, Modeling and Control of Antennas and Telescopes, Springer
2008), here 7.6; this one has 7.1. Stiffnesses of bearings, foundation and gears were chosen, each so that it matters in
some mode. That of a mesh has bearings and carrier of its pinion in it; the teeth alone would be ten
times as stiff.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from updyn.elements.constraints import Equation, constrain, join
from updyn.elements.drivetrain import GearPair, Inertia, Motor, Shaft, drivetrain, mounted
from updyn.elements.structure import (
    Beam,
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

__all__ = ["AZIMUTH", "ELEVATION", "NODES", "antenna", "locked", "trains"]

STEEL = {"E": 210e9, "rho": 7850.0, "nu": 0.3}
ALUMINIUM = {"E": 70e9, "rho": 2700.0, "nu": 0.33}
DIAMETER, FOCUS = 4.0, 1.5
SKIN = 0.0015  # m, thickness of the reflector
_AXIS_HEIGHT, _HALF_WIDTH = 2.9, 0.75  # of the elevation axis; half the width of the yoke
_RADII = np.array([0.45, 0.76, 1.07, 1.38, 1.69, 2.0])  # rings of the reflector
_RIBS = 12
_AROUND = 24  # nodes around each ring of the reflector
_VERTEX = 0.55  # of the paraboloid, in front of the elevation axis

#: Nodes with a place in the text: what is measured, struck or driven.
NODES = {"foundation": 1, "pedestal top": 2, "turntable": 3, "hub": 4, "feed": 5, "tube": 200}

#: Nodes of the drive trains: rotor against its housing, rotor, first stage, second stage, pinion,
#: ring, housing.
AZIMUTH = {
    "motor": 2001,
    "rotor": 2002,
    "input": 2003,
    "stage 1": 2004,
    "stage 2": 2005,
    "pinion": 2006,
}
AZIMUTH |= {"ring": 2007, "housing": 2008}
ELEVATION = {name: node + 1000 for name, node in AZIMUTH.items()}
_RATIO = 800.0  # of both drives: two stages of 10, pinion on ring 8


def antenna() -> Model:
    """Return the antenna as the drawings have it, rotors free.

    Returns
    -------
    Model
        The rotation of a motor (nodes 2001 and 3001) is that of its rotor against its housing: what
        its encoder reads and its torque acts on, so that a rotor is locked by holding this DOF.
    """
    body = _split(_structure(SKIN), _structure(2.0 * SKIN))
    y, z = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    model = body
    for train, name, ring, housing, axis in (
        (AZIMUTH, "azimuth", NODES["turntable"], NODES["pedestal top"], z),
        (ELEVATION, "elevation", NODES["tube"] + 6, _yoke_top(1), y),
    ):
        drive = drivetrain(trains(name))
        model = mounted(
            drive, model, {train["ring"]: (ring, axis), train["housing"]: (housing, axis)}
        )
        drag = Model.from_groups(
            {f"{name} drag": Group(viscous=[[2e-3]])}, [f"{train['motor']}:RZ"]
        )
        turning = {f"{train['motor']}:RZ": 1.0, f"{housing}:R{'YZ'[axis == z]}": 1.0}
        model = constrain(
            join([model, drag], title="Antenna of 4 m"), [Equation(f"{train['rotor']}:RZ", turning)]
        )
    assert body.geometry is not None
    return Model.from_groups(
        model.groups, model.dofs, geometry=_with_drives(body.geometry), title=model.title
    )


def locked(model: Model) -> Model:
    """Return the antenna with both rotors held against their housings."""
    return constrain(model, grounded=[f"{train['motor']}:RZ" for train in (AZIMUTH, ELEVATION)])


# -- drives ------------------------------------------------------------------------------------------------
def trains(which: str) -> list[Any]:
    """Return the parts of a drive train.

    Parameters
    ----------
    which : {"azimuth", "elevation"}
        The axis.

    Returns
    -------
    list of part
        Motor, input shaft, two stages of 10, pinion shaft, pinion on ring of ratio 8.
    """
    at = AZIMUTH if which == "azimuth" else ELEVATION
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


def _with_drives(geometry: Geometry) -> Geometry:
    """Return the geometry with the drives beside what they turn, to be seen."""
    nodes, xyz, lines = [geometry.nodes], [geometry.xyz], [geometry.lines]
    azimuth = np.array(
        [[0.75, 0.0, 1.0], [0.75, 0.0, 1.2], [0.75, 0.0, 1.4], [0.75, 0.0, 1.6], [0.45, 0.0, 1.85]]
    )
    start = np.array([-0.55, 1.15, _AXIS_HEIGHT - 0.55])
    elevation = start + np.outer([0.0, 0.25, 0.5, 0.75, 1.0], [0.4, -0.35, 0.5])
    for train, places, ring in (
        (AZIMUTH, azimuth, NODES["turntable"]),
        (ELEVATION, elevation, NODES["tube"] + 6),
    ):
        chain = [train[name] for name in ("motor", "input", "stage 1", "stage 2", "pinion")]
        nodes.append(np.array(chain))
        xyz.append(places)
        lines.append(np.array(list(pairwise([*chain, ring]))))
    axes = np.tile(np.eye(3), (sum(len(some) for some in nodes), 1, 1))
    axes[-len(elevation) :] = [
        [0, 0, 1],
        [1, 0, 0],
        [0, 1, 0],
    ]  # its shafts turn about Y: that is their RZ
    return Geometry(np.concatenate(nodes), np.concatenate(xyz), np.concatenate(lines), axes)


# -- structure ---------------------------------------------------------------------------------------------
class _Nodes:
    """Positions by node number, given out in order."""

    def __init__(self) -> None:
        self.xyz: dict[int, NDArray[np.float64]] = {}

    def row(self, first: int, points: Iterable[Any]) -> list[int]:
        """Place points at numbers from `first` on; return the numbers."""
        out = []
        for number, point in enumerate(points, first):
            self.xyz[number] = np.asarray(point, dtype=np.float64)
            out.append(number)
        return out


def _structure(thickness: float) -> Model:
    nodes = _Nodes()
    for name, place in {
        "foundation": (0, 0, 0),
        "pedestal top": (0, 0, 1.8),
        "turntable": (0, 0, 1.9),
        "hub": _dish(0.2),
        "feed": _dish(_VERTEX + FOCUS - 0.05),
    }.items():
        nodes.row(NODES[name], [place])
    made = [
        *_pedestal(nodes),
        *_yoke(nodes),
        *_tube(nodes),
        *_reflector(nodes, thickness),
        *_feed(nodes),
    ]
    links = [part for part in made if isinstance(part, RigidLink)]
    parts = [part for part in made if not isinstance(part, RigidLink)]
    return structure(nodes.xyz, parts, links=links, title="Antenna of 4 m")


def _split(single: Model, double: Model) -> Model:
    """Return the model with the bending of the reflector in a group of its own.

    With t its thickness K = t A + t^3 B, and K(2 t) - 2 K(t) = 6 t^3 B: membrane and shear go with
    t, bending with its cube.
    """
    skin, thick = single.group("reflector"), double.group("reflector")
    assert skin.stiffness is not None
    assert thick.stiffness is not None
    bending = sp.csr_array(thick.stiffness - 2.0 * skin.stiffness) / 6.0
    groups = dict(single.groups) | {
        "reflector": Group(skin.stiffness - bending, skin.mass, skin.loss_factor),
        "reflector bending": Group(bending, loss_factor=skin.loss_factor),
    }
    return Model(groups, single.dofs, single.geometry, single.title)


def _box(height: float, width: float, wall: float) -> Section:
    """Return a thin-walled box; J by Bredt's formula, 4 A_m^2 t / s."""
    h, b = height - wall, width - wall
    Iyy = (height * width**3 - (height - 2 * wall) * (width - 2 * wall) ** 3) / 12
    Izz = (width * height**3 - (width - 2 * wall) * (height - 2 * wall) ** 3) / 12
    A = height * width - (height - 2 * wall) * (width - 2 * wall)
    return Section(
        A, Iyy, Izz, 2 * (h * b) ** 2 * wall / (h + b), h / (2 * (h + b)) * 2, b / (2 * (h + b)) * 2
    )


def _pedestal(nodes: _Nodes) -> Iterator[Any]:
    around, up = 16, np.linspace(0.0, 1.8, 7)
    angle = 2 * np.pi * np.arange(around) / around
    circle = 0.35 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    rings = [nodes.row(1001 + 20 * i, circle + np.array([0.0, 0.0, z])) for i, z in enumerate(up)]
    yield Shell("pedestal", _quads(rings), thickness=0.008, loss_factor=0.01, **STEEL)
    yield RigidLink(NODES["foundation"], rings[0])
    yield RigidLink(NODES["pedestal top"], rings[-1])
    yield Spring(
        "foundation",
        NODES["foundation"],
        stiffness=[6e8, 6e8, 1.2e9, 1.5e8, 1.5e8, 1.5e8],
        loss_factor=0.04,
    )
    yield Spring(
        "azimuth bearing",
        NODES["pedestal top"],
        NODES["turntable"],
        stiffness=[8e8, 8e8, 1.6e9, 2.5e7, 2.5e7, 0],
        loss_factor=0.03,
    )


def _yoke_top(side: int) -> int:
    return 108 if side > 0 else 118


def _yoke(nodes: _Nodes) -> Iterator[Any]:
    for side in (1, -1):
        first = 101 if side > 0 else 111
        out = [(0, side * _HALF_WIDTH * s, 1.9) for s in (1 / 3, 2 / 3, 1)]
        up = [(0, side * _HALF_WIDTH, z) for z in np.linspace(1.9, _AXIS_HEIGHT, 6)[1:]]
        line = [NODES["turntable"], *nodes.row(first, [*out, *up])]
        yield Beam(
            "yoke",
            list(pairwise(line)),
            section=_box(0.28, 0.22, 0.008),
            orientation=[1, 0, 0],
            loss_factor=0.01,
            **STEEL,
        )


def _tube(nodes: _Nodes) -> Iterator[Any]:
    """Torque tube on its bearings, counterweight, hub carrier."""
    first = NODES["tube"]
    line = nodes.row(first, [(0, y, _AXIS_HEIGHT) for y in np.linspace(-0.66, 0.66, 7)])
    yield Beam("tube", list(pairwise(line)), section=tube(0.27, 0.25), loss_factor=0.01, **STEEL)
    for side, end, along in (
        (1, line[-1], 3e8),
        (-1, line[0], 0.0),
    ):  # the other end floats along the axis
        stiffness = [1.5e8, along, 1.5e8, 0, 0, 0]
        yield Spring(
            "elevation bearings", _yoke_top(side), end, stiffness=stiffness, loss_factor=0.03
        )
    for start, at in ((211, line[1]), (221, line[-2])):
        y = float(nodes.xyz[at][1])
        arm = nodes.row(start, [_dish(-s, 0.0, y) for s in (0.3, 0.6, 0.9)])
        yield Beam(
            "counterweight arms",
            list(pairwise([at, *arm])),
            section=_box(0.16, 0.10, 0.006),
            orientation=[0, 1, 0],
            loss_factor=0.01,
            **STEEL,
        )
        yield PointMass("counterweight", arm[-1], 130.0, inertia=[2.0, 2.0, 2.0])
    for at in line[2:5]:
        yield Beam(
            "hub carrier",
            [[at, NODES["hub"]]],
            section=tube(0.16, 0.14),
            loss_factor=0.01,
            **STEEL,
        )


def _dish(along: float, up: float = 0.0, across: float = 0.0) -> NDArray[np.float64]:
    """Return a point `along` the axis of the dish, `up` and `across` from it; the elevation is 45 degrees."""
    s = math.sqrt(0.5)
    return np.array([s * along - s * up, across, _AXIS_HEIGHT + s * along + s * up])


def _paraboloid(r: float) -> float:
    return _VERTEX + r**2 / (4 * FOCUS)


def _ring(r: float, along: float) -> list[NDArray[np.float64]]:
    angle = 2 * np.pi * np.arange(_AROUND) / _AROUND
    return [_dish(along, r * math.cos(a), r * math.sin(a)) for a in angle]


def _reflector(nodes: _Nodes, thickness: float) -> Iterator[Any]:
    rings = [nodes.row(301 + 30 * i, _ring(r, _paraboloid(r))) for i, r in enumerate(_RADII)]
    inner = _RADII[0]
    drum = [nodes.row(501 + 30 * i, _ring(inner, a)) for i, a in enumerate((0.2, 0.33, 0.46))]
    yield Shell("reflector", _quads(rings), thickness=thickness, loss_factor=0.01, **ALUMINIUM)
    yield Shell("hub drum", _quads([*drum, rings[0]]), thickness=0.005, loss_factor=0.01, **STEEL)
    yield RigidLink(NODES["hub"], drum[0])
    chords, webs, bottoms = [], [], []
    for rib in range(_RIBS):
        i = rib * _AROUND // _RIBS
        top = [ring[i] for ring in rings]
        a = 2 * np.pi * i / _AROUND
        places = [
            _dish(_paraboloid(r) - depth, r * math.cos(a), r * math.sin(a))
            for r, depth in zip(_RADII[1:], np.linspace(0.20, 0.06, 5), strict=True)
        ]
        bottom = [drum[0][i], *nodes.row(601 + 10 * rib, places)]
        bottoms.append(bottom)
        chords += [*pairwise(top), *pairwise(bottom)]
        webs += [*zip(top[1:], bottom[1:], strict=True), *zip(top[:-1], bottom[1:], strict=True)]
    hoops = [pair for ring in (rings[2], rings[5]) for pair in pairwise([*ring, ring[0]])]
    for level in (2, 4):
        around = [bottom[level] for bottom in bottoms]
        hoops += list(pairwise([*around, around[0]]))
    for name, pairs, section in (
        ("truss chords", chords, tube(0.030, 0.026)),
        ("truss webs", webs, tube(0.020, 0.017)),
        ("truss hoops", hoops, tube(0.025, 0.022)),
    ):
        yield Beam(name, pairs, section=section, loss_factor=0.01, **STEEL)


def _feed(nodes: _Nodes) -> Iterator[Any]:
    for leg in range(4):
        foot = 361 + 3 + 6 * leg  # on the third ring, between its supports at 45 degrees
        to = nodes.xyz[NODES["feed"]] - nodes.xyz[foot]
        inside = nodes.row(801 + 10 * leg, [nodes.xyz[foot] + s * to for s in (1 / 3, 2 / 3)])
        line = [foot, *inside, NODES["feed"]]
        yield Beam(
            "feed legs", list(pairwise(line)), section=tube(0.045, 0.040), loss_factor=0.01, **STEEL
        )
    yield PointMass("feed", NODES["feed"], 18.0, inertia=[0.4, 0.4, 0.4])


def _quads(rings: list[list[int]]) -> list[list[int]]:
    """Return the quadrilaterals between closed rings of as many nodes each."""
    return [
        [low[i], low[(i + 1) % len(low)], high[(i + 1) % len(high)], high[i]]
        for low, high in pairwise(rings)
        for i in range(len(low))
    ]
