"""Every method from the same starts on the same noisy data: recovery, error and coverage.

The structures are those of `structures.py`: the gear train of Bao, Wang & Cheng (2010), a damped
chain of 12 masses, the IASC-ASCE building, a space frame of 2,037 DOFs, three branched geared
trains, a chain of 100 masses with 200 unknowns, a beam with light appendages, a symmetric portal
with its one sensor on the axis of symmetry, a bladed disc, and a solid of 2,025 DOFs, which takes
minutes a fit. Each draw starts from a model that is off by up to 70 % in stiffness and 30 % in mass
(train of three outputs: 30 and 20 %; bladed disc: 20 %; chain of 100: 10 %), without damping (or
with that of the table, where it is not sought), and is given data with proportional noise and a
noise floor, a share of the rms of all data of one unit. Geared trains and the chain of 100 are told
the noise (`--stated all`, `--stated none`: all or none are).

Beside each draw the default method fits the same data once more from the true model, without a
search: what it cannot recover from there, the data do not determine; `--from-truth` makes these
fits alone. The row `scipy` is the best of
ten starts of `scipy.optimize.least_squares` on log FRFs (`peers/log_least_squares.py`).

`--out FILE` keeps every fit as a line of JSON; fits that are there are not made again, so that a
study can be stopped and gone on with, and its tables printed anew. `tables.py` says what the
columns are.

`--tier reduced` solves the space frame and the solid by reduced models, as is done by default above
600 DOFs; `--off 0.43` takes starts that are off by up to 30 % and 13 %.

    python benchmarks/accuracy.py [--cases chain,...] [--methods maximum-likelihood,scipy,...|all]
    [--noise 0.01] [--floor 0,1e-4,1e-3,1e-2] [--from-truth] [--draws 200] [--slow-draws 4]
    [--out fits.jsonl] [--workers 2]
"""

from __future__ import annotations

import argparse
import os
import time
import warnings
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from kept import Kept
from peers import log_least_squares
from structures import STRUCTURES, Bench, Noise, bench
from tables import DEFAULT, Cell, print_case, print_total

import updyn
from updyn.frf import FRF
from updyn.model import Model
from updyn.updating.fit.methods import METHODS
from updyn.updating.problem.parameters import Parameter, ParameterSet
from updyn.updating.problem.problem import FRFPart

NOISE = (0.0, 0.01, 0.05)
PEER = "scipy"
#: Starts of the peer.
STARTS = 10
#: Structures with few draws.
SLOW = ("solid", "chain of 100")


@dataclass(frozen=True)
class Task:
    """One fit: of which structure, by which method, from where, and to which data.

    `from_truth` fits begin at the true model and do not search.
    """

    case: str
    method: str
    relative: float
    floor: float
    seed: int
    stated: bool
    from_truth: bool = False
    tier: str | None = None
    off: float = 1.0

    @property
    def noise(self) -> Noise:
        return Noise(self.relative, self.floor)


@dataclass(frozen=True)
class Estimate:
    """What a fit says: values and standard deviations by unknown, and how it ended.

    `others` are the values of other answers that it says to fit as well.
    """

    values: dict[str, float]
    std: dict[str, float]
    status: str
    complete: bool
    steps: int
    others: tuple[dict[str, float], ...] = ()


def by_updyn(task: Task, start: Model, frf: FRF, sought: ParameterSet) -> Estimate:
    options = {"starts": 0} if task.from_truth else {}
    stated = {"relative": task.relative, "floor": task.floor}
    noise = stated if task.stated and task.noise else None
    result = updyn.update(start, frf, sought, task.method, noise=noise, tier=task.tier, **options)
    return Estimate(
        dict(result.values),
        dict(result.std),
        result.status,
        result.identifiability.complete,
        len(result.history),
        tuple(dict(other.values) for other in result.alternatives),
    )


def by_peer(task: Task, start: Model, frf: FRF, sought: ParameterSet) -> Estimate:
    spread = {q: task.off * share for q, share in bench(task.case).spread.items()}
    found = log_least_squares.fit(
        start, frf, sought, spread, STARTS, np.random.default_rng([task.seed, STARTS])
    )
    status = "max-iterations"
    if found.ended:
        status = "converged" if found.full_rank else "not-identifiable"
    return Estimate(found.values, found.std, status, found.full_rank, found.evaluations)


def misfit(start: Model, frf: FRF, whole: ParameterSet, values: np.ndarray, var: Any) -> float:
    """Chi-square of the model at `values` by the true variance of the noise."""
    part = FRFPart.build(start, frf, whole)
    H = part.responses(part.coordinates.to_x(values))
    weight = np.zeros(var.shape)
    np.divide(2.0, var, out=weight, where=var > 0)
    return float(np.sum(weight * np.abs(H - frf.values) ** 2))


def fitted(task: Task) -> dict[str, Any]:
    """Errors of the unknowns, what the fit says of them, its chi-square, steps and seconds."""
    made = bench(task.case)
    rng = np.random.default_rng([task.seed, int(1000 * task.relative)])
    start = made.start(np.random.default_rng(task.seed), task.off)
    if task.from_truth:
        start = made.case.true
    frf = task.noise.added(made.case.clean, rng)
    whole = made.sought(start)
    cannot = () if task.method == PEER else METHODS.find(task.method).cannot
    seen = [p.quantity not in cannot for p in whole]
    sought = ParameterSet(tuple(p for p, s in zip(whole, seen, strict=True) if s))
    begun = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = (by_peer if task.method == PEER else by_updyn)(task, start, frf, sought)
    seconds = time.process_time() - begun

    def errors(values: dict[str, float]) -> list[float]:
        return [_error(made, start, p, values.get(p.name, p.start)) for p in whole]

    out: dict[str, Any] = {
        "error": errors(found.values),
        "others": [errors(values) for values in found.others],
        "std": [_std(made, start, p, found.std.get(p.name, 0.0)) for p in whole],
        "seen": seen,
        "status": found.status,
        "complete": found.complete,
        "steps": found.steps,
        "seconds": seconds,
    }
    if task.noise:
        values = np.array([found.values.get(p.name, p.start) for p in whole])
        out["misfit"] = misfit(start, frf, whole, values, task.noise.variance(made.case.clean))
    return out


def _scale(made: Bench, start: Model, p: Parameter) -> float:
    return 1.0 if p.quantity == "loss_factor" else made.truth(p, start)


def _error(made: Bench, start: Model, p: Parameter, value: float) -> float:
    return float(value - made.truth(p, start)) / _scale(made, start, p)


def _std(made: Bench, start: Model, p: Parameter, std: float) -> float | None:
    """Standard deviation as a share of the truth; None where the fit calls it undetermined."""
    return float(std) / _scale(made, start, p) if np.isfinite(std) else None


def attempt(task: Task) -> dict[str, Any]:
    os.environ["OMP_NUM_THREADS"] = "1"
    try:
        return fitted(task)
    except updyn.UpdynError as error:
        return {"refused": str(error)}


def cells(args: argparse.Namespace, name: str) -> list[tuple[list[Task], list[Task]]]:
    """By noise, floor and method: the fits, and those of the same draws from the truth."""
    stated = {"all": True, "none": False}.get(args.stated, bench(name).stated)
    draws = args.slow_draws if name in SLOW else args.draws
    out = []
    for relative, floor, method in product(args.noise, args.floor, args.methods):
        own, true = [], []
        for seed in range(args.seed, args.seed + draws):
            data = {"relative": relative, "floor": floor, "seed": seed, "stated": stated}
            how = {"tier": args.tier, "off": args.off}
            own.append(Task(name, method, **data, **how))
            true.append(Task(name, DEFAULT, **data, from_truth=True, tier=args.tier))
        out.append((own, true))
    return out


def main() -> None:
    args = arguments()
    fits = Kept(args.out, attempt)
    every: list[Cell] = []
    for name in args.cases:
        own: list[Cell] = []
        for tasks, true in cells(args, name):
            method = "from truth" if args.from_truth else tasks[0].method
            if args.from_truth:
                tasks = []
            fits.make([*true, *tasks], args.workers)
            started = [fits[task] for task in true]
            found = [fits[task] for task in tasks] or started
            own.append(Cell(name, method, true[0].noise, found, started))
        print_case(own)
        every += own
    print_total(every)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )

    def numbers(text: str) -> list[float]:
        return [float(word) for word in text.split(",")]

    def methods(text: str) -> list[str]:
        return [*METHODS, PEER] if text == "all" else text.split(",")

    usual = [name for name in STRUCTURES if name != "solid"]
    add = parser.add_argument
    add("--cases", type=lambda text: text.split(","), default=usual, help="default: all but solid")
    add("--methods", type=methods, default=[DEFAULT, PEER], help="'all' for every one")
    add("--noise", type=numbers, default=list(NOISE), help="shares of |H|")
    add("--floor", type=numbers, default=[0.0], help="shares of the rms")
    add("--stated", choices=("as-case", "all", "none"), default="as-case")
    add("--from-truth", action="store_true", help="fits that begin at the true model alone")
    add("--draws", type=int, default=200)
    add("--slow-draws", type=int, default=4, help=f"of {' and '.join(SLOW)}")
    add("--seed", type=int, default=0)
    add("--tier", help="how models are solved")
    add("--off", type=float, default=1.0, help="how far off starts are, times 70 and 30 %%")
    add("--out", type=Path, help="file that keeps the fits")
    add("--workers", type=int, default=2)
    return parser.parse_args()


if __name__ == "__main__":
    from accuracy import main  # under its own name, where processes find what they are sent

    main()
