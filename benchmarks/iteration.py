"""What does one exact Jacobian and residual cost beyond the bare factorisations and solves?

Three-dimensional grids of springs in 10 parts, 30 sensors, 3 references, 30 unknowns, 6 lines. The bare cost is that of
the same backend factorising the same matrices and solving for as many right-hand sides; analysis counted in neither.

    python benchmarks/iteration.py [--nodes 15 21 28]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
import scipy.sparse as sp

import updyn
from updyn.linalg.factorise import BACKENDS, _module
from updyn.updating.problem import Problem
from updyn.updating.residuals import LogError

PARTS, LINES = 10, np.linspace(10.0, 60.0, 6)


def grid(m: int) -> updyn.Model:
    """m x m x m unit masses, 1e6 N/m between neighbours, held at the faces; slabs and joints are parts."""
    T, eye = sp.diags_array([-np.ones(m - 1), 2 * np.ones(m), -np.ones(m - 1)], offsets=[-1, 0, 1]), sp.eye_array(m)
    K = 1e6 * sp.csr_array(
        sp.kron(sp.kron(T, eye), eye) + sp.kron(sp.kron(eye, T), eye) + sp.kron(sp.kron(eye, eye), T)
    )
    slab = np.arange(m**3) * PARTS // m**3
    groups = {}
    rest = K
    for part in range(PARTS):
        inside = sp.diags_array((slab == part) * 1.0)
        own = sp.csr_array(inside @ K @ inside)
        rest = rest - own
        groups[f"slab {part + 1}"] = updyn.Group(own, inside, loss_factor=0.02)
    groups["joints"] = updyn.Group(rest + sp.diags_array(np.abs(rest).sum(axis=1)), loss_factor=0.02)
    return updyn.Model.from_groups(groups, [f"{i + 1}:Z" for i in range(m**3)])


def best(run: Callable[[], object], times: int = 3) -> float:
    taken = []
    for _ in range(times):
        begun = time.perf_counter()
        run()
        taken.append(time.perf_counter() - begun)
    return min(taken)


def compare(model: updyn.Model, backend: str) -> tuple[float, float]:
    """Seconds of one iteration, and of the bare factorisations and solves."""
    sensors = [model.dofs[int(i)] for i in np.linspace(0, model.n_dofs - 1, 30)]
    data = updyn.response(model, LINES, sensors, sensors[:3], backend=backend)
    slabs = [g for g in model.groups if g != "joints"]
    unknowns = updyn.parameters(model, stiffness=slabs, mass=slabs, loss_factor=slabs)
    problem = Problem.build(model, data, unknowns, backend=backend)
    x = problem.coordinates.to_x(unknowns.start)
    residual, solver = LogError(), problem.solver
    residual.local(problem, x)  # the analysis, once
    values = solver.system.values(solver.system.coefficients(problem.state(x), 2 * np.pi * LINES))
    matrices = [solver._sparse(values[:, i]) for i in range(len(LINES))]
    bare = getattr(_module(backend), BACKENDS[backend][1])(matrices[0])
    loads = np.eye(model.n_dofs, 1) * np.zeros((1, 30)) + 0j
    loads[problem.rows, np.arange(30)] = 1.0
    return best(lambda: residual.local(problem, x)), best(lambda: [bare.factor(Z)(loads) for Z in matrices])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nodes", type=int, nargs="+", default=[15, 21, 28])
    given = parser.parse_args()
    print(f"{'DOFs':>7}  {'backend':<9}{'iteration s':>12}{'bare s':>9}{'ratio':>7}")
    for m in given.nodes:
        model = grid(m)
        for backend in (b for b in BACKENDS if _module(b).available()):
            whole, bare = compare(model, backend)
            print(f"{model.n_dofs:>7}  {backend:<9}{whole:>12.2f}{bare:>9.2f}{whole / bare:>7.2f}", flush=True)


if __name__ == "__main__":
    main()
