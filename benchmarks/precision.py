"""Real factorisations in single precision over those in double: time, memory, digits.

Solids of `large.py`; K - s M at s = -1 (P), 0.5 and 1 times the square of the highest line,
factorised by one backend and solved for 33 unit forces. *Moved by a step*: how far a step of
refinement moves an answer, over its size; it decides how many steps answers take.

    OMP_NUM_THREADS=1 python benchmarks/precision.py [--sizes 10k,50k,150k] [--backend pardiso]
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import models
import numpy as np
from large import BANDS

from updyn.dynamics.affine import AffineSystem
from updyn.dynamics.shifted import Shifted
from updyn.linalg.solver import SparseSolver

_FORCES = 33


def measured(A: Any, loads: np.ndarray, backend: str, *, single: bool) -> tuple[float, ...]:
    """Seconds to factorise and to solve, GiB of the backend, and how far a step moves an answer."""
    solver = SparseSolver(backend, real=True, single=single)
    solver.factorise(A, 0.0, error=1.0)  # the first analyses the pattern
    begun = time.process_time()
    factorised = solver.factorise(A, 0.0, error=1.0)
    made = time.process_time()
    X = factorised.solve(loads)
    solved = time.process_time()
    step = factorised.solve(loads - factorised.times(X))
    memory = (solver.peak_bytes or 0) / 2**30
    return made - begun, solved - made, memory, float(np.abs(step).max() / np.abs(X).max())


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", type=lambda text: text.split(","), default=["10k", "50k"])
    parser.add_argument("--backend", default="pardiso")
    given = parser.parse_args()
    print("DOFs, shift: factor s, solve s, GiB, moved by a step; single, double")
    for size in given.sizes:
        system = AffineSystem.compile(models.solid(models.SOLIDS[size]))
        shifted = Shifted(system, (2.0 * np.pi * BANDS[size][1]) ** 2, given.backend)
        loads = np.zeros((system.n, _FORCES))
        loads[np.linspace(0, system.n - 1, _FORCES).astype(int), np.arange(_FORCES)] = 1.0
        for share in (-1.0, 0.5, 1.0):
            A = shifted.matrix(system.start, share * shifted.top)
            for single in (True, False):
                figures = measured(A, loads, given.backend, single=single)
                print(
                    f"{system.n} {share:4} {'single' if single else 'double'}"
                    f"  {figures[0]:.3f} {figures[1]:.3f} {figures[2]:.2f} {figures[3]:.0e}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
