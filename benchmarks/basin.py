"""From how far away does each method find the truth?

The paper's gear train without noise, from random starts (stiffness off by up to 70 %, mass by up to 30 %, no damping),
60 lines over 2-1000 rad/s, sensors 1-4, force on 2. A start counts as recovered when all 18 unknowns are within 1e-6.

    python benchmarks/basin.py [--starts 200] [--seed 0]
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from cases import random_gear_train

import updyn

METHODS = {
    "maximum-likelihood (default)": {},
    "log": {"method": "log"},
    "log, no search": {"method": "log", "starts": 0},
    "equation-error, trust region": {"method": "equation-error"},
    "equation-error, Gauss-Newton": {"method": "equation-error", "solver": "gauss-newton"},
    "output-error": {"method": "output-error"},
}


def worst_error(case, result) -> float:
    errors = [
        abs(result.values[p.name] - case.truth[p.name]) / (1.0 if p.quantity == "loss_factor" else case.truth[p.name])
        for p in case.unknowns
    ]
    return max(errors)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--starts", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    print(f"{'method':<32}{'recovered':>12}{'steps':>8}{'s each':>8}")
    for name, options in METHODS.items():
        rng = np.random.default_rng(args.seed)
        hits, steps, begun = 0, 0, time.perf_counter()
        for _ in range(args.starts):
            case = random_gear_train(rng)
            result = updyn.update(case.start, case.clean, case.unknowns, **options)
            hits += worst_error(case, result) < 1e-6
            steps += len(result.history)
        each = (time.perf_counter() - begun) / args.starts
        print(f"{name:<32}{100 * hits / args.starts:>10.1f} %{steps / args.starts:>8.0f}{each:>8.2f}", flush=True)


if __name__ == "__main__":
    main()
