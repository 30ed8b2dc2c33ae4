"""Cases of several benchmarks: the gear train and the 12-DOF chain, with truth, start and data."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import updyn
from updyn.demos.gear_train import true_model
from updyn.frf import FRF
from updyn.model import Group, Model
from updyn.updating.problem.parameters import ParameterSet

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Case:
    name: str
    true: Model
    start: Model
    clean: FRF
    chosen: ParameterSet | None = None

    @property
    def unknowns(self) -> ParameterSet:
        if self.chosen is not None:
            return self.chosen
        return updyn.parameters(self.start, stiffness="all", mass="all", loss_factor="all")

    @property
    def truth(self) -> dict[str, float]:
        """True values of the unknowns, as factors on the start."""
        out = {}
        for p in self.unknowns:
            true, start = self.true.group(p.group), self.start.group(p.group)
            if p.quantity == "loss_factor":
                out[p.name] = true.loss_factor
            else:
                a, b = getattr(true, p.quantity), getattr(start, p.quantity)
                out[p.name] = float(np.abs(a.data).sum() / np.abs(b.data).sum())
        return out

    def noisy(self, relative: float, rng: np.random.Generator) -> FRF:
        """Proportional noise: E|dH|^2 = (relative |H|)^2, independent, circular."""
        H = self.clean.values
        noise = rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)
        return FRF(
            self.clean.freq,
            H * (1 + relative * noise / np.sqrt(2)),
            self.clean.responses,
            self.clean.references,
            self.clean.quantity,
        )


def gear_train(omega: np.ndarray | None = None, start: Model | None = None) -> Case:
    """The paper's case at 60 lines, geometric over 2-1000 rad/s, sensors 1-4, force on 2."""
    true = true_model()
    omega = np.geomspace(2.0, 1000.0, 60) if omega is None else omega
    clean = updyn.response(true, omega / (2 * np.pi), [f"{i}:RZ" for i in range(1, 5)], ["2:RZ"])
    return Case("gear train", true, true if start is None else start, clean)


def random_gear_train(rng: np.random.Generator) -> Case:
    """Start off by up to 70 % in stiffness and 30 % in mass, undamped."""
    case = gear_train()
    changes = {
        name: {
            "stiffness": 1 + rng.uniform(-0.7, 0.7),
            "mass": 1 + rng.uniform(-0.3, 0.3),
            "loss_factor": 0.0,
        }
        for name in case.true.groups
    }
    return Case(case.name, case.true, case.true.scaled(changes), case.clean)


def chain12() -> Case:
    """A 12-DOF chain fixed at one end, 4 groups, 5 x 5 FRFs at 60 lines from 0.3 f1 to 1.05 f6."""
    data = json.loads((HERE.parent / "tests/data/cases/chain12.json").read_text())
    n = data["dofs"]
    groups, truth = {}, {}
    for g, members in enumerate(data["groups"]):
        K, M = np.zeros((n, n)), np.zeros((n, n))
        for e in members:
            k = data["stiffness"][e - 1]
            M[e - 1, e - 1] = data["mass"][e - 1]
            K[e - 1, e - 1] += k
            if e > 1:
                K[e - 2, e - 2] += k
                K[e - 1, e - 2] -= k
                K[e - 2, e - 1] -= k
        name = f"section {g + 1}"
        groups[name] = Group(K, M, loss_factor=data["start"]["loss_factor"][g])
        truth[name] = {q: data["true_factors"][q][g] for q in ("mass", "stiffness", "loss_factor")}
    start = Model.from_groups(groups, [f"{i}:X" for i in range(1, n + 1)])
    true = start.scaled(truth)
    K, M = true.stiffness.toarray(), true.mass.toarray()
    f = np.sqrt(np.sort(np.linalg.eigvals(np.linalg.solve(M, K)).real)) / (2 * np.pi)
    lines = np.linspace(0.3 * f[0], 1.05 * f[5], 60)
    at = [f"{i}:X" for i in data["measured_dofs_1_based"]]
    return Case("chain", true, start, updyn.response(true, lines, at, at))
