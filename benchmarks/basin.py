"""From how far away does each method find the truth?

The paper's gear train without noise, from random starts (stiffness off by up to 70 %, mass by up to
30 %, no damping), 60 lines over 2-1000 rad/s, sensors 1-4, force on 2. A start counts as recovered
when all 18 unknowns are within 1e-6.

Then the IASC-ASCE building of `structures.py`, whose storeys are up to eight times too stiff or too
soft: what does each part of the search contribute?

    python benchmarks/basin.py [--starts 200] [--far 50] [--seed 0]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from cases import Case, random_gear_train
from structures import STRUCTURES

import updyn

METHODS = {
    "maximum-likelihood (default)": {},
    "log": {"method": "log"},
    "log, no search": {"method": "log", "starts": 0},
    "equation-error, trust region": {"method": "equation-error"},
    "equation-error, Gauss-Newton": {"method": "equation-error", "solver": "gauss-newton"},
    "output-error": {"method": "output-error"},
}
SEARCHES = {
    "default": {},
    "without inflated loss factors": {"inflate": False},
    "one try": {"starts": 1},
    "no search": {"starts": 0},
}


def far_building(rng: np.random.Generator) -> Case:
    """Storeys stiffer or softer by a factor of up to eight, no damping."""
    bench = STRUCTURES["building"]()
    changes = {}
    for p in bench.sought(bench.case.true):
        if p.quantity == "stiffness":
            factor = float(np.exp(rng.uniform(-1.0, 1.0) * np.log(8.0)))
            changes[p.group] = {"stiffness": factor, "loss_factor": 0.0}
    start = bench.case.true.scaled(changes)
    return Case("building", bench.case.true, start, bench.case.clean, bench.sought(start))


def worst_error(case, result) -> float:
    errors = []
    for p in case.unknowns:
        truth = case.truth[p.name]
        scale = 1.0 if p.quantity == "loss_factor" else truth
        errors.append(abs(result.values[p.name] - truth) / scale)
    return max(errors)


def study(
    rows: dict[str, dict], made: Callable[[np.random.Generator], Case], starts: int, seed: int
) -> None:
    print(f"{'method':<32}{'recovered':>12}{'steps':>8}{'s each':>8}")
    for name, options in rows.items():
        rng = np.random.default_rng(seed)
        hits, steps, begun = 0, 0, time.perf_counter()
        for _ in range(starts):
            case = made(rng)
            result = updyn.update(case.start, case.clean, case.unknowns, **options)
            hits += worst_error(case, result) < 1e-6
            steps += len(result.history)
        each = (time.perf_counter() - begun) / starts
        print(
            f"{name:<32}{100 * hits / starts:>10.1f} %{steps / starts:>8.0f}{each:>8.2f}",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--starts", type=int, default=200)
    parser.add_argument("--far", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    print("gear train")
    study(METHODS, random_gear_train, args.starts, args.seed)
    print("\nbuilding, far off")
    study(SEARCHES, far_building, args.far, args.seed)


if __name__ == "__main__":
    main()
