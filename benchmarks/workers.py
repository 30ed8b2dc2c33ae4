"""Time of an update by two processes over that by one, and the difference of their numbers.

A solid of about 10,000 DOFs, 40 lines, 30 sensors, 3 references, 20 unknowns; the log method,
sparse tier, at most five steps; one thread for each process.

    OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 python benchmarks/workers.py [--workers 2] [--size 10k]
"""

from __future__ import annotations

import argparse
import time

import models
import numpy as np

import updyn


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--size", default="10k", choices=models.SOLIDS)
    given = parser.parse_args()
    model = models.solid(models.SOLIDS[given.size])
    sensors = models.sensors(model)
    layers = list(model.groups)[:10]
    truth = model.scaled({g: {"stiffness": 1.1, "loss_factor": 0.03} for g in layers})
    frf = updyn.response(truth, np.linspace(100.0, 2140.0, 40), sensors, sensors[:3])
    unknowns = updyn.parameters(model, stiffness=layers, loss_factor=layers)
    seconds: dict[int | None, list[float]] = {None: [], given.workers: []}
    results = {}
    for engine in (None, given.workers) * 2:
        begun = time.perf_counter()
        results[engine] = updyn.update(
            model, frf, unknowns, "log", tier="sparse", starts=0, max_iterations=5, engine=engine
        )
        seconds[engine].append(time.perf_counter() - begun)
        stages = {k: round(v, 1) for k, v in results[engine].timing_s.items()}
        print(f"{engine or 1} at work: {seconds[engine][-1]:.1f} s {stages}", flush=True)
    one, many = results[None], results[given.workers]
    apart = max(abs(many.values[n] / v - 1.0) for n, v in one.values.items())
    print(
        f"{given.workers} take {min(seconds[given.workers]) / min(seconds[None]):.2f} of the time"
        " of one"
    )
    print(f"values differ by {apart:.1e} at most; histories equal: {one.history == many.history}")


if __name__ == "__main__":
    main()
