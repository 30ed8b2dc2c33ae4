"""How often the rigid-body check names a faulty sensor of a free structure, without any fit.

Each draw has random sensors, two random forces, 1 % of noise and a floor of a thousandth of the
rms. Sensitivities are off by 2 % and directions by 1 degree (standard deviations). The true groups
are off by up to 40 % in stiffness and 15 % in mass, and the model has, in addition, a third of the
stiffness, three times the stiffness, or neither. Every second structure hangs on cords, at 2 to 6 %
of its lowest elastic mode; lines start at 2 % of that mode.

- named: the finding names the faulty sensors and no others.
- explained: of these, the seeded fault is among the explanations.
- in doubt: it names the faulty sensors, and others that explain the data as well.
- other: it names something else.

    python benchmarks/rigid_body.py [--structures frame,...] [--faults sign,...] [--draws 20]
"""

from __future__ import annotations

import argparse
import itertools
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from structures import Noise

import updyn
from updyn.elements.structure import Beam, rectangle, structure
from updyn.frf import FRF
from updyn.model import Model
from updyn.updating.judge.causes.data_alone import with_variance
from updyn.updating.judge.causes.rigid_body import RigidBody
from updyn.updating.judge.causes.rigid_shapes import RigidShapes
from updyn.updating.problem.noise import choose_noise
from updyn.updating.problem.problem import FRFPart

NOISE = Noise(0.01, 1e-3)
SENSITIVITY, DIRECTION = 0.02, np.radians(1.0)
STEEL = (2.1e11, 7850.0)


@dataclass(frozen=True)
class Free:
    """A free structure: its model, and the directions and number of its sensors."""

    model: Model
    directions: str
    sensors: int


def members(name: str, elements: list[list[int]], width: float, height: float) -> Beam:
    section, along = rectangle(width, height), [0.31, 0.52, 0.79]
    return Beam(name, elements, *STEEL, section, orientation=along, loss_factor=0.01)


def frame() -> Free:
    """A cube of twelve beams of 0.5 m in two groups; 14 sensors in any direction."""
    nodes, upright, level = {}, [], []
    for number, corner in enumerate(itertools.product((0.0, 0.5), repeat=3), start=1):
        nodes[number] = list(corner)
    for a, b in itertools.combinations(range(1, 9), 2):
        difference = np.subtract(nodes[b], nodes[a])
        if np.count_nonzero(difference) == 1:
            middle = 10 * a + b
            nodes[middle] = list(np.add(nodes[a], nodes[b]) / 2)
            (upright if difference[2] else level).extend([[a, middle], [middle, b]])
    parts = [members("upright", upright, 0.02, 0.015), members("level", level, 0.02, 0.015)]
    return Free(structure(nodes, parts), "XYZ", 14)


def beam() -> Free:
    """A beam of 1 m in two groups; 10 sensors in Y and Z."""
    nodes = {i: [0.1 * i, 0.0, 0.0] for i in range(11)}
    halves = [[[i, i + 1] for i in own] for own in (range(5), range(5, 10))]
    parts = [members(f"half {k}", own, 0.03, 0.01) for k, own in enumerate(halves, start=1)]
    return Free(structure(nodes, parts), "YZ", 10)


def grid() -> Free:
    """A grid of 5 x 5 nodes in two groups; 10 sensors in Z."""
    nodes = {5 * j + i: [0.2 * i, 0.2 * j, 0.0] for i in range(5) for j in range(5)}
    along = [[n, n + 1] for n in nodes if n % 5 < 4]
    across = [[n, n + 5] for n in nodes if n < 20]
    parts = [members("along", along, 0.02, 0.01), members("across", across, 0.02, 0.01)]
    return Free(structure(nodes, parts), "Z", 10)


STRUCTURES = {"frame": frame, "beam": beam, "grid": grid}


@dataclass(frozen=True)
class Test:
    """A measured structure: sensors and forces as labels, and exact FRFs of any labels."""

    sensors: list[str]
    respond: Callable[[list[str]], FRF]
    rng: np.random.Generator

    def turned(self, label: str, angle: float) -> np.ndarray:
        """Exact FRFs of a sensor that is turned towards another direction, shape (n_f, 1, n_j)."""
        node, direction = label.split(":")
        other = str(self.rng.choice([d for d in "XYZ" if d != direction]))
        own, across = (self.respond([f"{node}:{d}"]).values for d in (direction, other))
        return np.cos(angle) * own + np.sin(angle) * across


def none(test: Test, values: np.ndarray, i: int, j: int) -> tuple[str, ...]:
    return ()


def sign(test: Test, values: np.ndarray, i: int, j: int) -> tuple[str, ...]:
    values[:, i] *= -1.0
    return (test.sensors[i],)


def swapped(test: Test, values: np.ndarray, i: int, j: int) -> tuple[str, ...]:
    values[:, [i, j]] = values[:, [j, i]]
    return (test.sensors[i], test.sensors[j])


def turned(test: Test, values: np.ndarray, i: int, j: int) -> tuple[str, ...]:
    """Turned by 30 to 60 degrees."""
    angle = np.radians(test.rng.choice([-1, 1]) * test.rng.uniform(30.0, 60.0))
    values[:, i] = test.turned(test.sensors[i], angle)[:, 0]
    return (test.sensors[i],)


def moved(test: Test, values: np.ndarray, i: int, j: int) -> tuple[str, ...]:
    """In another direction of its node."""
    values[:, i] = test.turned(test.sensors[i], np.pi / 2)[:, 0]
    return (test.sensors[i],)


def calibration(test: Test, values: np.ndarray, i: int, j: int) -> tuple[str, ...]:
    """A factor of 1.2 to 1.6, or its inverse."""
    values[:, i] *= np.exp(test.rng.choice([-1, 1]) * test.rng.uniform(np.log(1.2), np.log(1.6)))
    return (test.sensors[i],)


FAULTS = {f.__name__: f for f in (none, sign, swapped, turned, moved, calibration)}


def on_cords(free: Free, model: Model, rng: np.random.Generator) -> Model:
    """Return the structure on cords at four nodes, at 2 to 6 % of its lowest elastic mode."""
    modes = updyn.modes(model, 7).frequency
    frequency = rng.uniform(0.02, 0.06) * modes[-1]
    along = np.array([dof.direction == "Z" for dof in model.dofs], dtype=float)
    stiffness = float(along @ (model.mass @ along)) * (2 * np.pi * frequency) ** 2 / 4
    nodes = rng.choice(np.unique(model.dofs.nodes), 4, replace=False)
    at = [f"{node}:{d}" for node in nodes for d in "XYZ"]
    return model.with_element("cords", at, stiffness=stiffness, loss_factor=0.05)


def drawn(free: Free, fault: str, seed: int) -> tuple[str, bool]:
    """Return "named", "in doubt", "other" or "missed", and whether the fault is explained."""
    rng = np.random.default_rng([seed, list(FAULTS).index(fault)])
    off = {
        name: {"stiffness": rng.uniform(0.6, 1.4), "mass": rng.uniform(0.85, 1.15)}
        for name in free.model.groups
    }
    true = free.model.scaled(off)
    factor = float(rng.choice([1 / 3, 1.0, 3.0]))
    model = free.model.scaled({name: {"stiffness": factor} for name in free.model.groups})
    elastic = updyn.modes(true, 7).frequency[-1]
    if rng.integers(2):
        true = on_cords(free, true, rng)
    nodes = np.unique(true.dofs.nodes)
    every = [f"{node}:{d}" for node in nodes for d in free.directions]
    sensors = rng.choice(every, free.sensors, replace=False).tolist()
    forces = rng.choice(sensors, 2, replace=False).tolist()
    freq = np.arange(0.02, 2.0, 0.01) * elastic

    def respond(labels: list[str]) -> FRF:
        return updyn.response(true, freq, labels, forces, "accelerance")

    test = Test(sensors, respond, rng)
    clean = respond(sensors)
    values = np.concatenate(
        [test.turned(label, DIRECTION * rng.standard_normal()) for label in sensors], axis=1
    )
    values *= 1.0 + SENSITIVITY * rng.standard_normal((free.sensors, 1))
    i, j = rng.choice(free.sensors, 2, replace=False).tolist()
    wrong = FAULTS[fault](test, values, i, j)
    frf = NOISE.added(replace(clean, values=values), rng)
    frf = with_variance(frf, choose_noise(None, frf))
    shapes = RigidShapes.of(FRFPart.build(model, frf, updyn.parameters(model, stiffness="all")))
    assert shapes is not None
    faults = [one.fault for one in RigidBody.detect_in(frf, shapes)]
    found = [fault for fault in faults if isinstance(fault, RigidBody)]
    if not found:
        return "missed", False
    channels = set(found[0].channels)
    if channels == set(wrong):
        words = {"turned": "a turn by"}.get(fault, f"({fault}:")
        return "named", words in found[0].details
    return ("in doubt" if wrong and set(wrong) < channels else "other"), False


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--structures", default=",".join(STRUCTURES))
    parser.add_argument("--faults", default=",".join(FAULTS))
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    print("| structure | fault | named | explained | in doubt | other |\n|---|---|---|---|---|---|")
    for name in given.structures.split(","):
        free = STRUCTURES[name]()
        for fault in given.faults.split(","):
            seeds = range(given.seed, given.seed + given.draws)
            draws = [drawn(free, fault, seed) for seed in seeds]
            counts = [
                sum(one == kind for one, _ in draws) for kind in ("named", "in doubt", "other")
            ]
            explained = sum(one for _, one in draws)
            print(
                f"| {name} | {fault} | {counts[0]} of {len(draws)} | {explained} | {counts[1]} |"
                f" {counts[2]} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
