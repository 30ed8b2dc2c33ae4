"""Cost of one iteration of a small model over that of one batched solve of the same lines.

A chain of springs in up to 20 groups; stiffness, mass and loss factor of each unknown; up to 30
sensors, 3 references. An iteration is the residual, its exact Jacobian and their QR factors; the
solve is one `numpy.linalg.solve` of all lines for the same right-hand sides. Both are processor
time, the median of many: first of iterations alone, as in a fit, then of solves. One thread is
fastest for both (OMP_NUM_THREADS=1).

    python benchmarks/small.py [--lines 500] [--dofs 50]
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np
from models import chain, sensors

import updyn
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import LogError


def seconds(run: Callable[[], object], repeats: int) -> float:
    """Return the median processor time of some runs after a first one."""
    run()
    times = []
    for _ in range(repeats):
        begun = time.process_time()
        run()
        times.append(time.process_time() - begun)
    return statistics.median(times)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--lines", type=int, default=500)
    parser.add_argument("--dofs", type=int, default=50)
    parser.add_argument("--repeats", type=int, default=30)
    given = parser.parse_args()
    model = chain(given.dofs, parts=min(20, given.dofs))
    freq, at = np.linspace(1.0, 80.0, given.lines), sensors(model)
    data = updyn.response(model, freq, at, at[:3])
    unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    problem = FRFPart.build(model, data, unknowns, tier="dense")
    x, residual = problem.coordinates.to_x(unknowns.start), LogError()
    whole = seconds(lambda: residual.local(Problem.of([problem]), x), given.repeats)
    w = 2.0 * np.pi * freq[:, None, None]
    Z = (model.stiffness + 1j * model.structural).toarray() - w**2 * model.mass.toarray()
    loaded = np.union1d(problem.rows, problem.columns)
    loads = np.broadcast_to(
        np.eye(given.dofs, dtype=np.complex128)[:, loaded], (given.lines, given.dofs, len(loaded))
    )
    bare = seconds(lambda: np.linalg.solve(Z, loads), given.repeats)
    print(
        f"{given.lines} lines x {given.dofs} DOFs x {len(unknowns)} unknowns, {len(loaded)}"
        " right-hand sides"
    )
    print(
        f"iteration {1e3 * whole:.1f} ms, one batched solve {1e3 * bare:.1f} ms, ratio"
        f" {whole / bare:.2f}"
    )


if __name__ == "__main__":
    main()
