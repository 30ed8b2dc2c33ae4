"""Time of solving all lines of a reduced model by one eigendecomposition over that line by line.

A solid of 2,250 DOFs in 20 layers with loss factors of 1 to 4 %, reduced to its lowest modes; unit
forces at 30 DOFs; "dampers" adds four viscous dampers to ground. Both times are of the processor,
matrices put together included. Without damping the eigendecomposition is real. One thread
(OMP_NUM_THREADS=1).

    python benchmarks/lines.py [--vectors 50 100 225 400] [--lines 64 200]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import models
import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as sla

import updyn
from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.basis import Basis
from updyn.dynamics.fields import split_into_blocks
from updyn.dynamics.reduced_solver import ReducedSolver

_FORCES, _DAMPERS, _REPEATS = 30, 4, 3


def seconds(run: Callable[[], object]) -> float:
    """The least processor time of a few runs."""
    times = []
    for _ in range(_REPEATS):
        begun = time.process_time()
        run()
        times.append(time.process_time() - begun)
    return min(times)


def solve(fresh: ReducedSolver, state: State, freq: np.ndarray, *, at_once: bool) -> None:
    solver = replace(fresh)  # no eigendecomposition is kept
    pencil = solver.pencil(state, freq) if at_once else None
    for block in split_into_blocks(len(freq), 20 if at_once else 6):
        c = solver.system.coefficients(state, 2.0 * np.pi * freq[block])
        solver.solve(c, solver.observed, freq[block], pencil)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--vectors", type=int, nargs="+", default=[50, 100, 225, 400])
    parser.add_argument("--lines", type=int, nargs="+", default=[64, 200])
    given = parser.parse_args()
    model = models.solid((4, 4, 30))
    dampers = np.zeros(model.n_dofs)
    dampers[:: model.n_dofs // _DAMPERS][:_DAMPERS] = 100.0
    groups = {**model.groups, "dampers": updyn.Group(viscous=sp.diags_array(dampers))}
    system = AffineSystem.compile(updyn.Model.from_groups(groups, model.dofs))
    all_used = system.start
    factor = np.array([t.quantity != "viscous" for t in system.terms]) * all_used.factor
    damped = replace(all_used, factor=factor)
    states = {
        "damped": damped,
        "undamped": replace(damped, loss=0.0 * damped.loss),
        "dampers": all_used,
    }
    observed = np.linspace(0, system.n - 1, _FORCES).astype(np.intp)
    K, M = model.stiffness.tocsc(), model.mass.tocsc()
    squares, modes = sla.eigsh(K, max(given.vectors), M, sigma=0.0)
    print(f"{'vectors':>8}{'lines':>7}  {'':<10}{'by line, ms':>12}{'at once, ms':>12}{'ratio':>8}")
    for r in given.vectors:
        basis = Basis(system, np.sqrt(K.diagonal()))
        basis.append(modes[:, :r].copy())
        solver = ReducedSolver.project(system, basis, observed, "superlu")
        # Off the natural frequencies, where the undamped model has no answer.
        highest = 0.3 * np.sqrt(squares[r - 1]) / (2.0 * np.pi)
        for n_lines in given.lines:
            freq = np.linspace(0.05 * highest, highest, n_lines)
            for name, state in states.items():
                one, other = (
                    seconds(lambda s=state, f=freq, a=a, q=solver: solve(q, s, f, at_once=a))
                    for a in (False, True)
                )
                print(
                    f"{r:>8}{n_lines:>7}  {name:<10}{1e3 * one:>12.1f}{1e3 * other:>12.1f}"
                    f"{one / other:>8.2f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
