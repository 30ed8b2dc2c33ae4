"""Structures of `accuracy.py`: each true one, what was measured on it, and what is unknown."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
import trains
from cases import HERE, Case, chain12, gear_train
from models import footbridge, solid

import updyn
from updyn.elements.structure import Beam, PointMass, Spring, rectangle, structure
from updyn.frf import FRF
from updyn.model import Group, Model
from updyn.updating.problem.noise import Stated
from updyn.updating.problem.parameters import Parameter, ParameterSet
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import OutputError

#: How far off starts are, as a share.
FAR = {"stiffness": 0.7, "mass": 0.3}


@dataclass(frozen=True)
class Noise:
    """E|dH|^2 = (relative |H|)^2 + (floor rms)^2, independent and circular (`Stated`).

    The rms is that of all data of one unit, without noise.
    """

    relative: float
    floor: float = 0.0

    def __bool__(self) -> bool:
        return bool(self.relative or self.floor)

    def variance(self, clean: FRF) -> np.ndarray:
        return Stated(self.relative, self.floor).variance(clean.values, clean)

    def added(self, clean: FRF, rng: np.random.Generator) -> FRF:
        """Return data with noise; with a floor the relative part is that without."""
        draw = rng.standard_normal((2, *clean.values.shape))
        values = clean.values * (1.0 + self.relative * np.sqrt(0.5) * (draw[0] + 1j * draw[1]))
        if self.floor:
            draw = rng.standard_normal((2, *clean.values.shape))
            std = np.sqrt(0.5 * Stated(0.0, self.floor).variance(clean.values, clean))
            values = values + std * (draw[0] + 1j * draw[1])
        return FRF(clean.freq, values, clean.responses, clean.references, clean.quantity)


def everything(model: Model) -> ParameterSet:
    return updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")


def springs_and_masses(model: Model) -> ParameterSet:
    return updyn.parameters(model, stiffness="all", mass="all")


@dataclass(frozen=True, eq=False)
class Bench:
    """A true structure, what was measured on it, and what is unknown.

    Parameters
    ----------
    case : Case
        Truth and data without noise.
    sought : callable
        The unknowns of a model.
    spread : mapping of str to float
        By quantity, how far off starts are.
    stated : bool
        Whether the fit is told the size of the noise.
    mirrored : mapping of str to str
        Of a symmetric structure, group by group, the one in its mirror image that has its place:
        with their unknowns exchanged, it answers the measurement just as well.
    turned : callable, optional
        Of a structure with oblong sections: returns it with the section axes of some groups
        exchanged.
    """

    case: Case
    sought: Callable[[Model], ParameterSet]
    spread: Mapping[str, float] = field(default_factory=lambda: FAR)
    stated: bool = False
    mirrored: Mapping[str, str] = field(default_factory=dict)
    turned: Callable[[Collection[str]], Model] | None = None

    def start(self, rng: np.random.Generator, off: float = 1.0) -> Model:
        """A model that is off by up to `spread` times `off`, undamped where damping is sought."""
        changes: dict[str, dict[str, float]] = {}
        for p in self.sought(self.case.true):
            spread = off * self.spread.get(p.quantity, 0.0)
            value = 0.0 if p.quantity == "loss_factor" else 1.0 + rng.uniform(-spread, spread)
            changes.setdefault(p.group, {})[p.quantity] = value
        return self.case.true.scaled(changes)

    def truth(self, p: Parameter, start: Model) -> float:
        """True value of an unknown of a model."""
        true = self._amount(p)
        return (
            true if p.quantity == "loss_factor" else true / size(start.group(p.group), p.quantity)
        )

    def in_mirror(self, error: np.ndarray) -> np.ndarray:
        """Errors, shape (n,), of the estimate that answers alike: itself without a mirror image."""
        unknowns = list(self.sought(self.case.true))
        place = {(p.group, p.quantity): i for i, p in enumerate(unknowns)}
        out = np.empty(len(unknowns))
        for i, p in enumerate(unknowns):
            other = place[self.mirrored.get(p.group, p.group), p.quantity]
            own, true = self._amount(p), self._amount(unknowns[other])
            if p.quantity == "loss_factor":
                out[i] = true + error[other] - own
            else:
                out[i] = true * (1.0 + error[other]) / own - 1.0
        return out

    def _amount(self, p: Parameter) -> float:
        group = self.case.true.group(p.group)
        return group.loss_factor if p.quantity == "loss_factor" else size(group, p.quantity)

    @cache  # noqa: B019
    def bound(self, noise: Noise) -> np.ndarray:
        """Standard deviation of each unknown by the Cramer-Rao bound at known noise."""
        unknowns = self.sought(self.case.true)
        part = FRFPart.build(self.case.true, self.case.clean, unknowns)
        # An FRF between motions that are not coupled is exactly 0: without a floor no noise, no
        # information.
        size, std = np.abs(self.case.clean.values), np.sqrt(noise.variance(self.case.clean))
        weight = np.zeros(size.shape)
        np.divide(np.sqrt(2.0), std, out=weight, where=(size > 0) | (noise.floor > 0))
        x = part.coordinates.to_x(unknowns.start)
        R = OutputError(weight).local(Problem.of([part]), x).R
        return np.linalg.norm(np.linalg.solve(R.T, np.eye(len(R))), axis=0)


def size(group: Group, quantity: str) -> float:
    return float(np.abs(getattr(group, quantity).data).sum())


def building() -> Bench:
    """IASC-ASCE phase I without the braces of storey 1: storey stiffnesses and loss factors."""
    data = json.loads((HERE.parent / "tests/data/cases/iasc_asce.json").read_text(encoding="utf-8"))
    labels = [f"{floor}:{d}" for floor in range(1, 5) for d in ("X", "Y", "RZ")]
    brace = 4.0 * data["one_brace_N_m"]
    groups = {}
    for storey in range(4):
        for i, (name, key) in enumerate(
            (("x", "x_N_m"), ("y", "y_N_m"), ("theta", "theta_Nm_rad"))
        ):
            k = data["storey_stiffness"][key]
            if storey == 0 and name != "theta":
                k -= brace
            K = np.zeros((12, 12))
            upper, lower = 3 * storey + i, 3 * (storey - 1) + i
            K[upper, upper] = k
            if storey:
                K[lower, lower] = k
                K[lower, upper] = K[upper, lower] = -k
            groups[f"storey {storey + 1} {name}"] = Group(K, loss_factor=0.02)
        mass = np.zeros(12)
        m, inertia = data["mass_kg"][storey], data["inertia_kg_m2"][storey]
        mass[3 * storey : 3 * storey + 3] = [m, m, inertia]
        groups[f"floor {storey + 1}"] = Group(mass=np.diag(mass))
    true = Model.from_groups(groups, labels)
    sensors, forces = ["2:X", "4:X", "2:Y", "4:Y"], ["4:X", "4:Y"]
    clean = updyn.response(true, np.linspace(2.0, 65.0, 120), sensors, forces, "accelerance")
    storeys = ["storey ? x", "storey ? y"]

    def sought(model: Model) -> ParameterSet:
        return updyn.parameters(model, stiffness=storeys, loss_factor=storeys)

    return Bench(Case("building", true, true, clean), sought)


def block() -> Bench:
    """A clamped solid of 4 x 4 x 27 bricks in six layers: ten sensors, two forces, six modes."""
    true = solid((4, 4, 27), parts=6)
    at = [f"{25 * layer + 13}:{d}" for layer in (6, 13, 20, 26) for d in "XY"] + ["651:X", "651:Z"]
    modes = updyn.modes(true, 8).frequency
    clean = updyn.response(
        true, np.linspace(0.4 * modes[0], 1.05 * modes[5], 60), at, ["651:X", "651:Z"]
    )
    return Bench(Case("solid", true, true, clean), everything)


def bridge() -> Bench:
    """A space frame of four spans: three sensors a span, two forces, eight modes."""
    true = footbridge(4, 19)
    middle = [5 * (19 * span + x) + 2 for span in range(4) for x in (6, 9)]
    sensors = [f"{node}:Z" for node in middle] + [f"{node}:Y" for node in middle[1::2]]
    modes = updyn.modes(true, 8).frequency
    clean = updyn.response(
        true, np.linspace(0.5 * modes[0], 1.05 * modes[7], 30), sensors, sensors[0:8:4]
    )
    return Bench(Case("space frame", true, true, clean), everything)


def train(
    true: Model,
    sensors: Sequence[int],
    torques: Sequence[int],
    spread: Mapping[str, float] = FAR,
    lines: int = 120,
) -> Bench:
    """Angles over torques of a train, from half its first elastic mode to beyond its last."""
    modes = updyn.modes(true, true.n_dofs).frequency
    elastic = modes[modes > 1e-3 * modes[-1]]
    freq = np.geomspace(0.5 * elastic[0], 1.2 * elastic[-1], lines)
    clean = updyn.response(true, freq, [f"{n}:RZ" for n in sensors], [f"{n}:RZ" for n in torques])
    case = Case(true.title, true, true, clean)
    return Bench(case, springs_and_masses, spread=spread, stated=True)


def three_outputs() -> Bench:
    """Twelve inertias, eleven springs; stiffnesses off by up to 30 %, inertias by 20 %."""
    drawn = {"stiffness": 0.3, "mass": 0.2}
    return train(trains.three_outputs(), [1, 3, 6, 9, 12], [1], drawn)


def long_chain(n: int = 100) -> Bench:
    """A chain of 100 unlike masses on rubber, one end held: every spring and mass is unknown.

    Every mass has a sensor, five have forces: at a floor of 1e-4 the condition of the scaled
    Jacobian is 54, and all bounds are below 0.4 %.
    """
    rng = np.random.default_rng(100)
    stiffness, mass = 1e6 * rng.uniform(0.9, 1.1, n), rng.uniform(0.9, 1.1, n)
    groups = {}
    for i in range(n):
        K, M = np.zeros((n, n)), np.zeros((n, n))
        K[i, i] = stiffness[i]
        M[i, i] = mass[i]
        if i:
            K[i - 1, i - 1] = stiffness[i]
            K[i - 1, i] = K[i, i - 1] = -stiffness[i]
        groups[f"cell {i + 1}"] = Group(K, M, loss_factor=0.1)
    true = Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])
    modes = updyn.modes(true, n).frequency
    sensors = [f"{i}:X" for i in range(1, n + 1)]
    forces = [f"{i}:X" for i in range(10, n, 20)]
    clean = updyn.response(true, np.linspace(modes[0], modes[-1], 16), sensors, forces)
    near = {"stiffness": 0.1, "mass": 0.1}
    return Bench(
        Case("chain of 100", true, true, clean), springs_and_masses, spread=near, stated=True
    )


def appendages() -> Bench:
    """A steel cantilever in four segments with three light boxes on springs, tuned above the band.

    In the band a box is little more than its mass; its spring shows by (omega / omega_box)^2 only.
    """
    length, per = 1.6, 4
    section = rectangle(0.03, 0.02)
    nodes = {i: [length * i / (4 * per), 0.0, 0.0] for i in range(4 * per + 1)}
    parts = [
        Beam(
            f"segment {s + 1}",
            [[i, i + 1] for i in range(per * s, per * (s + 1))],
            2.1e11,
            7850.0,
            section,
            orientation=[0.0, 0.0, 1.0],
            loss_factor=0.01,
        )
        for s in range(4)
    ]
    # By node of the beam: mass in kg, and frequency on its spring in Hz.
    boxes = {6: (0.05, 450.0), 11: (0.04, 550.0), 15: (0.01, 1400.0)}
    for k, (node, (mass, frequency)) in enumerate(boxes.items(), start=1):
        nodes[100 + k] = nodes[node]
        stiffness = mass * (2 * np.pi * frequency) ** 2
        along = [0.0, 0.0, stiffness, 0.0, 0.0, 0.0]
        parts += [
            Spring(f"mount {k}", node, 100 + k, stiffness=along, loss_factor=0.03),
            PointMass(f"box {k}", 100 + k, mass),
        ]
    planar = [f"{i}:{d}" for i in range(1, 4 * per + 1) for d in ("X", "Y", "RX", "RZ")]
    free_boxes = [f"{100 + k}:{d}" for k in range(1, len(boxes) + 1) for d in ("X", "Y")]
    true = structure(nodes, parts, grounded=[0, *planar, *free_boxes])
    clean = updyn.response(true, np.linspace(5.0, 400.0, 120), ["5:Z", "9:Z", "16:Z"], ["16:Z"])

    def sought(model: Model) -> ParameterSet:
        return updyn.parameters(model, stiffness="all", mass="segment ?", loss_factor="segment ?")

    return Bench(Case("beam with light appendages", true, true, clean), sought)


def portal() -> Bench:
    """A portal frame of two columns and two halves of a girder; its one sensor is amid the girder.

    Force and sensor act across there. Exchanging left and right changes nothing that they see.
    """
    column, girder = rectangle(0.2, 0.2), rectangle(0.3, 0.2)
    height, span, cut = 3.0, 5.0, 2
    nodes: dict[int, list[float]] = {}
    for i in range(cut + 1):
        nodes[1 + i] = [0.0, 0.0, height * i / cut]
        nodes[21 + i] = [span, 0.0, height * i / cut]
    beam = [1 + cut, *range(40, 40 + 2 * cut - 1), 21 + cut]
    for i, node in enumerate(beam):
        nodes[node] = [span * i / (2 * cut), 0.0, height]

    def row(name: str, members: Sequence[int], section, factor: float) -> Beam:
        two = [[a, b] for a, b in itertools.pairwise(members)]
        return Beam(
            name, two, 3e10 * factor, 2400.0, section, orientation=[0.0, 1.0, 0.0], loss_factor=0.02
        )

    parts = [
        row("left column", range(1, 2 + cut), column, 0.8),
        row("right column", range(21, 22 + cut), column, 1.15),
        row("left girder", beam[: cut + 1], girder, 1.0),
        row("right girder", beam[cut:], girder, 1.1),
    ]
    planar = [f"{n}:{d}" for n in nodes if n not in (1, 21) for d in ("Y", "RX", "RZ")]
    true = structure(nodes, parts, grounded=[1, 21, *planar])
    middle = f"{beam[cut]}:X"
    modes = updyn.modes(true, 6).frequency
    clean = updyn.response(true, np.linspace(0.4 * modes[0], modes[5], 120), [middle], [middle])
    mirrored = {"left column": "right column", "left girder": "right girder"}
    mirrored |= {b: a for a, b in mirrored.items()}

    def sought(model: Model) -> ParameterSet:
        return updyn.parameters(model, stiffness="all", loss_factor="all")

    return Bench(Case("symmetric portal", true, true, clean), sought, mirrored=mirrored)


def grillage_frame(turned: Collection[str] = ()) -> Model:
    """Two girders and four cross beams on four columns, of oblong sections.

    Six elements to a girder, of which each is a group by itself; three to a column, one to each
    half of a cross beam.

    Parameters
    ----------
    turned : collection of str
        Groups whose section axes are exchanged.
    """
    nodes: dict[int, list[float]] = {}
    for i in range(7):
        nodes[1 + i], nodes[11 + i] = [0.35 * i, 0.0, 0.9], [0.35 * i, 0.8, 0.9]
    cross, columns = [], []
    for i in (0, 2, 4, 6):
        nodes[21 + i] = [0.35 * i, 0.4, 0.9]
        cross += [[1 + i, 21 + i], [21 + i, 11 + i]]
    for k, top in enumerate((1, 7, 11, 17)):
        x, y, z = nodes[top]
        members = [top, *range(101 + 10 * k, 104 + 10 * k)]
        for j, node in enumerate(members[1:], start=1):
            nodes[node] = [x, y, z - 0.3 * j]
        columns += [[a, b] for a, b in itertools.pairwise(members)]
    up, along = [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]

    def members_of(name, two, section, orientation, loss):
        own = section.exchanged if name in turned else section
        return Beam(name, two, 2.1e11, 7850.0, own, orientation=orientation, loss_factor=loss)

    girder = rectangle(0.05, 0.02)
    left, right = ([[a, a + 1] for a in range(first, first + 6)] for first in (1, 11))
    parts = [
        members_of("left girder", left, girder, up, 0.01),
        members_of("right girder", right, girder, up, 0.02),
        members_of("cross beams", cross, rectangle(0.016, 0.03), up, 0.015),
        members_of("columns", columns, rectangle(0.03, 0.045), along, 0.01),
    ]
    return structure(nodes, parts, grounded=[103, 113, 123, 133])


def grillage() -> Bench:
    """`grillage_frame` with eight sensors, two forces and ten modes."""
    true = grillage_frame()
    sensors = ["2:Z", "4:Z", "6:Y", "12:Z", "14:Y", "16:Z", "23:Z", "7:X"]
    modes = updyn.modes(true, 10).frequency
    freq = np.linspace(0.5 * modes[0], 1.05 * modes[9], 120)
    clean = updyn.response(true, freq, sensors, ["4:Z", "14:Y"], "accelerance")
    return Bench(Case("grillage", true, true, clean), everything, turned=grillage_frame)


def bladed_disc(n: int = 12) -> Bench:
    """A disc of 12 sectors, each with a blade of two masses; blades are mistuned by a few percent.

    Six neighbouring and other blades have sensors at their tips, two of them forces.
    """
    rng = np.random.default_rng(12)
    size = 3 * n  # hub, root half and tip of the blade of each sector
    groups: dict[str, Group] = {}
    disc, mass = np.zeros((size, size)), np.zeros((size, size))
    for s in range(n):
        hub, nxt = 3 * s, 3 * ((s + 1) % n)
        disc[hub, hub] += 4e6
        disc[np.ix_([hub, nxt], [hub, nxt])] += 2.5e6 * np.array([[1.0, -1.0], [-1.0, 1.0]])
        mass[hub, hub] = 0.5
    groups["disc"] = Group(disc, mass, loss_factor=0.005)
    for s in range(n):
        K, M = np.zeros((size, size)), np.zeros((size, size))
        hub, root, tip = 3 * s, 3 * s + 1, 3 * s + 2
        mistuned = 1.0 + 0.04 * rng.standard_normal()
        for a, b, k in ((hub, root, 1.2e6), (root, tip, 0.8e6)):
            K[np.ix_([a, b], [a, b])] += k * mistuned * np.array([[1.0, -1.0], [-1.0, 1.0]])
        M[root, root], M[tip, tip] = 0.12, 0.08
        groups[f"blade {s + 1}"] = Group(K, M, loss_factor=0.005)
    labels = [f"{10 * (s + 1) + k}:Z" for s in range(n) for k in (1, 2, 3)]
    true = Model.from_groups(groups, labels)
    modes = updyn.modes(true, true.n_dofs).frequency
    sensors = [f"{10 * blade + 3}:Z" for blade in (1, 2, 4, 5, 8, 10)]
    clean = updyn.response(
        true, np.linspace(0.9 * modes[0], 1.1 * modes[-1], 120), sensors, [sensors[0], sensors[3]]
    )

    def sought(model: Model) -> ParameterSet:
        return updyn.parameters(model, stiffness="all", mass="disc")

    near = {"stiffness": 0.2, "mass": 0.2}
    return Bench(Case("bladed disc", true, true, clean), sought, spread=near)


STRUCTURES: dict[str, Callable[[], Bench]] = {
    "gear train": lambda: Bench(gear_train(), everything),
    "chain": lambda: Bench(chain12(), everything),
    "building": building,
    "space frame": bridge,
    "solid": block,
    "three outputs": three_outputs,
    "two motors": lambda: train(trains.two_motors(), [1, 3, 6, 7, 11, 13], [1]),
    "planetary": lambda: train(trains.planetary_and_belt(), [1, 2, 6, 9, 10], [1]),
    "chain of 100": long_chain,
    "appendages": appendages,
    "portal": portal,
    "bladed disc": bladed_disc,
    "grillage": grillage,
}


@cache
def bench(name: str) -> Bench:
    return STRUCTURES[name]()
