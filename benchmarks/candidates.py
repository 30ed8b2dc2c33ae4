"""The right one of three candidate models, by evidence and by predictive score.

Five structures with random stiffnesses and loss factors are measured with 1 % noise and a floor of
0.1 %, of unknown size. Each case has a right model and two others:

grouping   every part has its stiffness; in the others one of two pairs of parts shares one
nested     one pair shares its stiffness; the others are the model with every stiffness, which is
           right too and has one unknown more, and that in which another pair shares one
joint      a part is an elastic joint; the others have a rigid joint, or viscous damping
damping    damping is structural or viscous, in turn; the others are the other one, and both

    python benchmarks/candidates.py [N] [--first N] [--structures NAME ...]
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from structures import Noise, bench

import updyn
from updyn.frf import FRF
from updyn.model import Model
from updyn.updating.problem.parameters import ParameterSet

NOISE = Noise(0.01, 1e-3)
#: Bounds of factors on stiffness and of loss factors; viscous damping has the same loss amid the
#: band. Both are the prior of the unknowns.
FACTOR, LOSS = (0.3, 3.0), (0.0, 0.3)
#: By structure: two pairs of parts, and the joint with the factor by which it is stiffened before
#: the test.
PARTS = {
    "chain": (("section 1", "section 2"), ("section 3", "section 4"), ("section 3", 5.0)),
    "building": (("storey 1 x", "storey 2 x"), ("storey 3 y", "storey 4 y"), ("storey 2 x", 5.0)),
    "appendages": (("segment 1", "segment 2"), ("segment 3", "segment 4"), ("mount 2", 1.0)),
    "grillage": (("left girder", "right girder"), ("cross beams", "columns"), ("columns", 3.0)),
    "bladed disc": (("blade 1", "blade 2"), ("blade 4", "blade 5"), ("disc", 3.0)),
}
KINDS = ("grouping", "nested", "joint", "damping")
RIGID = 1e4
#: Tries of the search for a start of each fit; parts are off by up to a quarter.
STARTS = 0
MOST_LINES = 60

Pair = tuple[Model, ParameterSet]


@dataclass(frozen=True)
class Sought:
    """The parts of a structure with unknown stiffness and damping, and the middle of the band."""

    name: str
    stiff: tuple[str, ...]
    damped: tuple[str, ...]
    omega: float

    @classmethod
    def of(cls, name: str) -> Sought:
        case = bench(name)
        stiff = {p.group for p in case.sought(case.case.true) if p.quantity == "stiffness"}
        groups = case.case.true.groups
        damped = [g for g in groups if g in stiff and groups[g].loss_factor]
        freq = case.case.clean.freq
        omega = 2.0 * np.pi * float(np.sqrt(freq[0] * freq[-1]))
        return cls(name, tuple(g for g in groups if g in stiff), tuple(damped), omega)

    def stiffness(self, model: Model, *shared: tuple[str, str], without: str = "") -> ParameterSet:
        """Unknown stiffness factors; each pair in `shared` has one."""
        linked = [part for pair in shared for part in pair]
        single = [part for part in self.stiff if part not in (*linked, without)]
        found = updyn.parameters(model, stiffness=single, bounds={"stiffness": FACTOR})
        for pair in shared:
            drives = [f"{part}.stiffness" for part in pair]
            found += updyn.link(model, f"{' and '.join(pair)}.stiffness", drives, bounds=FACTOR)
        return found

    def structural(self, model: Model, without: str = "") -> ParameterSet:
        parts = [part for part in self.damped if part != without]
        return updyn.parameters(model, loss_factor=parts, bounds={"loss_factor": LOSS})

    def viscous(self, model: Model) -> ParameterSet:
        bounds = {"stiffness_damping": (0.0, LOSS[1] / self.omega)}
        return updyn.parameters(model, stiffness_damping=self.damped, bounds=bounds)

    def with_viscous(self, model: Model) -> Model:
        """The model with the same damping amid the band, but viscous."""
        damping = {}
        for part in self.damped:
            loss = model.groups[part].loss_factor
            damping[part] = {"loss_factor": 0.0, "stiffness_damping": loss / self.omega}
        return model.with_damping(damping)


def make_case(name: str, kind: str, rng: np.random.Generator) -> tuple[Model, dict[str, Pair], str]:
    """Return the true model, the candidates, and the name of the right one."""
    sought = Sought.of(name)
    first, second, (joint, stiffened) = PARTS[name]
    start = bench(name).case.start
    if kind == "joint":
        start = start.scaled({joint: {"stiffness": stiffened}})
    factors = dict(zip(sought.stiff, rng.uniform(0.8, 1.25, len(sought.stiff)), strict=True))
    if kind == "nested":
        factors[first[1]] = factors[first[0]]
    true = start.scaled({part: {"stiffness": factor} for part, factor in factors.items()})
    true = true.scaled({part: {"loss_factor": rng.uniform(0.005, 0.05)} for part in sought.damped})
    start = start.scaled({part: {"loss_factor": 0.02} for part in sought.damped})
    structural = sought.structural(start)
    separate = (start, sought.stiffness(start) + structural)
    viscous = sought.with_viscous(start)
    by_pair = {
        f"{' and '.join(pair)} equal": (start, sought.stiffness(start, pair) + structural)
        for pair in (first, second)
    }
    if kind == "grouping":
        return true, {"separate": separate, **by_pair}, "separate"
    if kind == "nested":
        return true, {"separate": separate, **by_pair}, next(iter(by_pair))
    if kind == "joint":
        rigid = start.scaled({joint: {"stiffness": RIGID, "loss_factor": 0.0}})
        unknowns = sought.stiffness(rigid, without=joint) + sought.structural(rigid, joint)
        other = (viscous, sought.stiffness(viscous) + sought.viscous(viscous))
        return true, {"elastic": separate, "rigid": (rigid, unknowns), "viscous": other}, "elastic"
    both = (
        viscous,
        sought.stiffness(viscous) + sought.viscous(viscous) + sought.structural(viscous),
    )
    candidates = {
        "structural": separate,
        "viscous": (viscous, sought.stiffness(viscous) + sought.viscous(viscous)),
        "both": both,
    }
    if rng.random() < 0.5:
        return true, candidates, "structural"
    return sought.with_viscous(true), candidates, "viscous"


def measure(name: str, true: Model, rng: np.random.Generator) -> FRF:
    clean = bench(name).case.clean
    lines = clean.freq[:: -(-len(clean.freq) // MOST_LINES)]
    ends = list(clean.responses), list(clean.references)
    return NOISE.added(updyn.response(true, lines, *ends, clean.quantity), rng)


def study(name: str, seed: int) -> tuple[str, bool, bool, bool, bool]:
    """Return the kind of a case, whether the right model is first, and by each criterion."""
    kind = KINDS[seed % len(KINDS)]
    rng = np.random.default_rng([seed, len(name)])
    true, candidates, right = make_case(name, kind, rng)
    found = updyn.compare_models(candidates, measure(name, true, rng), starts=STARTS)
    by_evidence = max(found, key=lambda row: row.log_evidence).name == right
    fitted = [row for row in found if row.is_fitted]
    by_score = max(fitted, key=lambda row: row.score).name == right
    wrong = found.best != right
    if wrong:
        print(f"{name}, {seed}, {kind}: right is {right}\n{found}\n", flush=True)
    return kind, not wrong, by_evidence, by_score, found.distinguishable


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("n", nargs="?", type=int, default=20, help="cases a structure")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--structures", nargs="+", default=list(PARTS), choices=list(PARTS))
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.n)
    cases = defaultdict(list)
    begin = time.perf_counter()
    for name in arguments.structures:
        for seed in seeds:
            kind, *outcome = study(name, seed)
            cases[kind].append(outcome)
            cases["all"].append(outcome)
    print("cases     number   first   by evidence   by score   distinguishable")
    for kind in (*KINDS, "all"):
        if cases[kind]:
            shares = 100.0 * np.mean(cases[kind], axis=0)
            print(
                "{:<10}{:>6}{:>6.0f} %{:>11.0f} %{:>9.0f} %{:>15.0f} %".format(
                    kind, len(cases[kind]), *shares
                )
            )
    print(f"{time.perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
