"""Peak memory of an exact iteration over that of one factorisation.

Two processes, one after the other, each with the model and the data of `iteration.py`: one makes a
single complex factorisation and solves for the sensors, the other a residual with its Jacobian at
four lines. Compared: the largest memory of each.

    python benchmarks/memory.py [150k]
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys

import numpy as np
from models import SOLIDS, sensors, solid

import updyn
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import LogError


def work(size: str, whole: bool) -> None:
    model = solid(SOLIDS[size])
    freq, at = np.linspace(10.0, 60.0, 4), sensors(model)
    data = updyn.FRF(freq, np.ones((4, len(at), 3)), at, at[:3], "receptance")
    problem = FRFPart.build(
        model, data, updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    )
    x = problem.coordinates.to_x(problem.coordinates.parameters.start)
    if whole:
        assert LogError().local(Problem.of([problem]), x) is not None
    else:
        system = problem.solver.system
        problem.solver.solve(
            system.coefficients(problem.state(x), 2 * np.pi * freq[:1]), problem.rows, freq[:1]
        )
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("size", nargs="?", default="150k", choices=list(SOLIDS))
    parser.add_argument(
        "--part", choices=("factorisation", "iteration"), help="one of the two, in this process"
    )
    given = parser.parse_args()
    if given.part:
        work(given.size, given.part == "iteration")
        return
    peaks = []
    for part in ("factorisation", "iteration"):
        command = [sys.executable, __file__, given.size, "--part", part]
        peaks.append(
            float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
        )
        print(f"{part}: {peaks[-1]:.2f} GiB", flush=True)
    print(f"ratio {peaks[1] / peaks[0]:.2f}")


if __name__ == "__main__":
    main()
