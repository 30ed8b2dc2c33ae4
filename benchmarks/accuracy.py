"""Every method from the same starts on the same noisy data: recovery, error and coverage.

Five cases: the gear train of Bao, Wang & Cheng (2010), a damped chain of 12 masses, the IASC-ASCE
building, a space frame of 2,037 DOFs, and a solid of 2,025 DOFs, which takes minutes a fit. Each
draw starts from a model that is off by up to 70 % in stiffness and 30 % in mass, without damping
(or with that of the table, where it is not sought), and is given data with 0, 1 or 5 % of
proportional noise. No method is given the size of the noise.

Recovered: every unknown within 1e-6 of the truth without noise; within four standard deviations of
the Cramer-Rao bound with noise. An unknown that a method cannot change stays where it starts. RMS
over bound, and the share of 95 % intervals that cover the truth, are taken over all draws, whether
recovered or not, of the unknowns that the method seeks, and given as the median and the worst over
the unknowns whose bound is below 5 %.

`--tier reduced` solves the space frame and the solid by reduced models, as is done by default above
20,000 DOFs; `--off 0.43` takes starts that are off by up to 30 % and 13 %.

    python benchmarks/accuracy.py [--cases chain,...] [--methods log,...] [--draws 200]
    [--solid-draws 4] [--workers 2]
"""

from __future__ import annotations

import argparse
import json
import os
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from cases import HERE, Case, chain12, gear_train
from models import footbridge, solid

import updyn
from updyn.frf import FRF
from updyn.model import Group, Model
from updyn.updating.fit.methods import METHODS
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.problem import Part, Problem
from updyn.updating.problem.residuals import OutputError

NOISE = (0.0, 0.01, 0.05)
DEFAULT = "maximum-likelihood"
#: Largest error of a recovered unknown: without noise, and in standard deviations with noise.
EXACT = 1e-6
SURE = 4.0
#: Largest bound of the unknowns that figures are taken of.
WELL_KNOWN = 0.05


@dataclass(frozen=True)
class Bench:
    """A true structure, what was measured on it, and what is unknown."""

    case: Case
    sought: Callable[[Model], ParameterSet]

    def start(self, rng: np.random.Generator, off: float = 1.0) -> Model:
        """A model that is off by up to 70 % in stiffness and 30 % in mass, times `off`."""
        changes: dict[str, dict[str, float]] = {}
        for p in self.sought(self.case.true):
            spread = off * {"stiffness": 0.7, "mass": 0.3}.get(p.quantity, 0.0)
            value = 0.0 if p.quantity == "loss_factor" else 1.0 + rng.uniform(-spread, spread)
            changes.setdefault(p.group, {})[p.quantity] = value
        return self.case.true.scaled(changes)

    @cache  # noqa: B019
    def bound(self, relative: float) -> np.ndarray:
        """Standard deviation of each unknown by the Cramer-Rao bound at known noise."""
        unknowns = self.sought(self.case.true)
        part = Part.build(self.case.true, self.case.clean, unknowns)
        # An FRF between motions that are not coupled is exactly 0: no noise, no information.
        size = np.abs(self.case.clean.values)
        weight = np.zeros(size.shape)
        np.divide(np.sqrt(2.0), relative * size, out=weight, where=size > 0)
        x = part.coordinates.to_x(unknowns.start)
        R = OutputError(weight).local(Problem.of([part]), x).R
        return np.linalg.norm(np.linalg.solve(R.T, np.eye(len(R))), axis=0)


def everything(model: Model) -> ParameterSet:
    return updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")


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


CASES: dict[str, Callable[[], Bench]] = {
    "gear train": lambda: Bench(gear_train(), everything),
    "chain": lambda: Bench(chain12(), everything),
    "building": building,
    "space frame": bridge,
    "solid": block,
}


@cache
def bench(name: str) -> Bench:
    return CASES[name]()


def noisy(clean: FRF, relative: float, rng: np.random.Generator) -> FRF:
    draw = rng.standard_normal((2, *clean.values.shape))
    values = clean.values * (1.0 + relative * np.sqrt(0.5) * (draw[0] + 1j * draw[1]))
    return FRF(clean.freq, values, clean.responses, clean.references, clean.quantity)


@dataclass(frozen=True)
class How:
    """Method, tier, and how far off the start is."""

    method: str
    tier: str | None = None
    off: float = 1.0


def size_of(group: Group, quantity: str) -> float:
    return float(np.abs(getattr(group, quantity).data).sum())


def draw(name: str, how: How, relative: float, seed: int) -> dict[str, Any]:
    """One fit: relative errors of the unknowns, coverage of their intervals, steps and seconds."""
    made = bench(name)
    rng = np.random.default_rng([seed, int(1000 * relative)])
    start = made.start(np.random.default_rng(seed), how.off)
    frf = noisy(made.case.clean, relative, rng)
    whole = made.sought(start)
    cannot = METHODS.find(how.method).cannot
    seen = np.array([p.quantity not in cannot for p in whole])
    sought = ParameterSet(tuple(p for p, s in zip(whole, seen, strict=True) if s))
    begun = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = updyn.update(start, frf, sought, how.method, tier=how.tier)
    seconds = time.process_time() - begun
    error, inside = np.empty(len(whole)), np.zeros(len(whole), dtype=bool)
    for i, p in enumerate(whole):
        true, own = made.case.true.group(p.group), start.group(p.group)
        if p.quantity == "loss_factor":
            truth, scale = true.loss_factor, 1.0
        else:
            truth = scale = size_of(true, p.quantity) / size_of(own, p.quantity)
        error[i] = (result.values.get(p.name, p.start) - truth) / scale
        inside[i] = abs(error[i] * scale) <= 1.96 * result.std.get(p.name, 0.0)
    return {
        "error": error,
        "inside": inside,
        "seen": seen,
        "steps": len(result.history),
        "seconds": seconds,
    }


def attempt(name: str, how: How, relative: float, seed: int) -> dict[str, Any] | str:
    os.environ["OMP_NUM_THREADS"] = "1"
    try:
        return draw(name, how, relative, seed)
    except updyn.UpdynError as error:
        return str(error)


def row(name: str, relative: float, found: list[dict[str, Any]], draws: int) -> dict[str, float]:
    """Figures of the fits that were made; a draw that the method refused is not recovered."""
    error = np.array([f["error"] for f in found])
    seen = found[0]["seen"]
    bound = bench(name).bound(relative) if relative else None
    largest = EXACT if bound is None else SURE * bound
    near = (np.abs(error) <= largest).all(axis=1)
    out = {"recovered": 100 * near.sum() / draws, **_cost(found)}
    if bound is None:
        return out
    known = seen & (bound < WELL_KNOWN)
    if known.any():
        ratio = np.sqrt(np.mean(error**2, axis=0)) / bound
        covered = 100 * np.mean([f["inside"] for f in found], axis=0)
        out |= {"ratio": float(np.median(ratio[known])), "worst": float(ratio[known].max())}
        out |= {"covered": float(covered[known].mean()), "least": float(covered[known].min())}
    return out


def _cost(found: list[dict[str, Any]]) -> dict[str, float]:
    return {k: float(np.mean([f[k] for f in found])) for k in ("steps", "seconds")}


def show(method: str, figures: dict[str, float]) -> str:
    def cell(key: str, form: str) -> str:
        return format(figures[key], form) if key in figures else "-"

    return (
        f"{method:<20}{cell('recovered', '.1f'):>10}"
        f" %{cell('ratio', '.2f'):>11}{cell('worst', '.2f'):>9}"
        f"{cell('covered', '.1f'):>9}{cell('least', '.1f'):>8}"
        f"{cell('steps', '.0f'):>8}{cell('seconds', '.2f'):>9}"
    )


def main() -> None:
    from joblib import Parallel, delayed

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", default=",".join(CASES))
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--noise", default=",".join(f"{n:g}" for n in NOISE))
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--solid-draws", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tier", help="how models are solved")
    parser.add_argument(
        "--off", type=float, default=1.0, help="how far off starts are, times 70 and 30 %%"
    )
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    parallel = Parallel(n_jobs=args.workers)
    for name in args.cases.split(","):
        draws = args.solid_draws if name == "solid" else args.draws
        for relative in map(float, args.noise.split(",")):
            print(f"\n{name}, {100 * relative:g} % noise, {draws} draws")
            print(
                f"{'method':<20}{'recovered':>12}{'RMS/bound':>11}{'worst':>9}"
                f"{'covered':>9}{'least':>8}{'steps':>8}{'s each':>9}"
            )
            figures: dict[str, dict[str, float]] = {}
            for method in args.methods.split(","):
                how = How(method, args.tier, args.off)
                seeds = range(args.seed, args.seed + draws)
                found = parallel(delayed(attempt)(name, how, relative, seed) for seed in seeds)
                refused = [f for f in found if isinstance(f, str)]
                if len(refused) == draws:
                    print(f"{method:<20}  does not apply: {refused[0]}", flush=True)
                    continue
                figures[method] = row(
                    name, relative, [f for f in found if not isinstance(f, str)], draws
                )
                note = f"  {len(refused)} refused: {refused[0]}" if refused else ""
                print(show(method, figures[method]) + note, flush=True)
            better(figures, draws)


def better(figures: dict[str, dict[str, float]], draws: int) -> None:
    """Print the methods that recover more than the default, beyond the standard error of that."""
    if DEFAULT not in figures:
        return
    own = figures[DEFAULT]["recovered"] / 100
    for method, found in figures.items():
        share = found["recovered"] / 100
        error = np.sqrt((own * (1 - own) + share * (1 - share)) / draws)
        if share - own > error:
            print(
                f"better than the default: {method}, by {100 * (share - own):.1f} +-"
                f" {100 * error:.1f} %"
            )


if __name__ == "__main__":
    from accuracy import main  # under its own name, where processes find what they are sent

    main()
