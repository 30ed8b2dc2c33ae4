"""Cost of one residual with its exact Jacobian over that of the bare factorisations and solves.

Three-dimensional solids in 20 layers, 30 sensors, 3 references, stiffness, mass and loss factor of
every layer unknown. The bare cost is that of the same backend factorising the same matrices and
solving for as many right-hand sides; analysis is counted in neither. Both are taken in turn, the
best of a few each.

With `--steps` whole fits are timed: from stiffnesses off by up to a factor of 1.35, 1 % noise, the
processor time of the fit without search (`starts = 0`), refused steps and new weights included,
over its steps, and that over the bare cost of its lines.

    python benchmarks/iteration.py [--sizes 10k 50k] [--lines 4] [--backends pardiso superlu]
        [--steps]
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from models import SOLIDS, sensors, solid

import updyn
from updyn.linalg.solver import BACKENDS
from updyn.updating.fit.monitor import Progress
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import LogError

#: Beyond this many DOFs SuperLU takes minutes.
SUPERLU_LIMIT = 20_000
#: Steps of a whole fit.
STEPS = 12


def seconds(run: Callable[[], object]) -> float:
    begun = time.process_time()
    run()
    return time.process_time() - begun


def compare(model: updyn.Model, backend: str, n_lines: int, repeats: int) -> tuple[float, float]:
    """Seconds of one iteration, and of the bare factorisations and solves."""
    freq, at = np.linspace(10.0, 60.0, n_lines), sensors(model)
    data = updyn.response(model, freq, at, at[:3], backend=backend)
    unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    problem = FRFPart.build(model, data, unknowns, backend=backend)
    x = problem.coordinates.to_x(unknowns.start)
    system = problem.solver.system
    coefficients = system.coefficients(problem.state(x), 2 * np.pi * freq)

    def matrix(line: int) -> sp.csc_array:
        values = system.values(coefficients[:, [line]])[:, 0]
        return sp.csc_array((values, system.indices, system.indptr), shape=(system.n, system.n))

    matrices = [matrix(line) for line in range(n_lines)]
    loaded = np.unique(np.concatenate([problem.rows, problem.columns]))
    loads = np.zeros((model.n_dofs, len(loaded)), dtype=np.complex128, order="F")
    loads[loaded, np.arange(len(loaded))] = 1.0
    bare = BACKENDS[backend](matrices[0])
    residual = LogError()
    residual.local(Problem.of([problem]), x)  # the analysis, once
    whole, solved = [], []
    for _ in range(repeats):
        # A copy of the part has none of the derivatives that a part keeps.
        whole.append(seconds(lambda: residual.local(Problem.of([replace(problem)]), x)))
        solved.append(seconds(lambda: [bare.factor(Z)(loads) for Z in matrices]))
    return min(whole), min(solved)


def stepped(model: updyn.Model, backend: str, n_lines: int) -> tuple[float, int, int]:
    """Processor time of a fit from its first evaluation on, its steps, and its evaluations."""
    rng = np.random.default_rng(0)
    freq, at = np.linspace(10.0, 60.0, n_lines), sensors(model)
    data = updyn.response(model, freq, at, at[:3], backend=backend)
    draw = rng.standard_normal((2, *data.values.shape))
    values = data.values * (1.0 + 0.01 * np.sqrt(0.5) * (draw[0] + 1j * draw[1]))
    off = {g: {"stiffness": float(np.exp(rng.uniform(-0.3, 0.3)))} for g in model.groups}
    unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    times: list[float] = []

    def shown(now: Progress) -> None:
        if now.stage == "maximum-likelihood":
            times.append(time.process_time())

    result = updyn.update(
        model.scaled(off),
        replace(data, values=values),
        unknowns,
        tier="sparse",
        backend=backend,
        starts=0,
        max_iterations=STEPS,
        callback=shown,
    )
    return times[-1] - times[0], result.iterations, len(result.history)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", nargs="+", default=["10k", "50k"], choices=list(SOLIDS))
    parser.add_argument("--lines", type=int, default=4)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--backends", nargs="+", default=list(BACKENDS), choices=list(BACKENDS))
    parser.add_argument("--steps", action="store_true", help="time whole fits")
    given = parser.parse_args()
    print(
        f"{'DOFs':>7} {'lines':>6} {'unknowns':>9} "
        f" {'backend':<9}{'iteration s':>12}{'bare s':>9}{'ratio':>7}"
    )
    for size in given.sizes:
        model = solid(SOLIDS[size])
        for backend in given.backends:
            too_large = backend == "superlu" and model.n_dofs > SUPERLU_LIMIT
            if too_large or not BACKENDS[backend].available():
                continue
            whole, bare = compare(model, backend, given.lines, given.repeats)
            if given.steps:
                fit, steps, evaluations = stepped(model, backend, given.lines)
                whole = fit / steps
                print(f"{steps} steps, {evaluations} in the record, {fit:.1f} s:")
            print(
                f"{model.n_dofs:>7} {given.lines:>6} {3 * len(model.groups):>9}  "
                f"{backend:<9}{whole:>12.2f}{bare:>9.2f}{whole / bare:>7.2f}",
                flush=True,
            )
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GiB")


if __name__ == "__main__":
    main()
