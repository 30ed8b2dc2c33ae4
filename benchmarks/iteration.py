"""Cost of one residual with its exact Jacobian over that of the bare factorisations and solves.

Three-dimensional solids in 20 layers, 30 sensors, 3 references, stiffness, mass and loss factor of
every layer unknown. The bare cost is that of the same backend factorising the same matrices and
solving for as many right-hand sides; analysis is counted in neither. Both are taken in turn, the
best of a few each.

    python benchmarks/iteration.py [--sizes 10k 50k] [--lines 4] [--backends pardiso superlu]
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
from models import SOLIDS, sensors, solid

import updyn
from updyn.linalg.solver import BACKENDS
from updyn.updating.problem.problem import Part, Problem
from updyn.updating.problem.residuals import LogError

#: Beyond this many DOFs SuperLU takes minutes.
SUPERLU_LIMIT = 20_000


def seconds(run: Callable[[], object]) -> float:
    begun = time.perf_counter()
    run()
    return time.perf_counter() - begun


def compare(model: updyn.Model, backend: str, n_lines: int, repeats: int) -> tuple[float, float]:
    """Seconds of one iteration, and of the bare factorisations and solves."""
    freq, at = np.linspace(10.0, 60.0, n_lines), sensors(model)
    data = updyn.response(model, freq, at, at[:3], backend=backend)
    unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    problem = Part.build(model, data, unknowns, backend=backend)
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
        whole.append(seconds(lambda: residual.local(Problem.of([problem]), x)))
        solved.append(seconds(lambda: [bare.factor(Z)(loads) for Z in matrices]))
    return min(whole), min(solved)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", nargs="+", default=["10k", "50k"], choices=list(SOLIDS))
    parser.add_argument("--lines", type=int, default=4)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--backends", nargs="+", default=list(BACKENDS), choices=list(BACKENDS))
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
            print(
                f"{model.n_dofs:>7} {given.lines:>6} {3 * len(model.groups):>9}  "
                f"{backend:<9}{whole:>12.2f}{bare:>9.2f}{whole / bare:>7.2f}",
                flush=True,
            )
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GiB")


if __name__ == "__main__":
    main()
