"""True error of a reduced model, by direct solves, over the error that its residual gives.

A solid of about 10,000 DOFs, 30 sensors, 3 references, 14 lines; the basis is that of the start,
neither enriched nor made anew. The ratio is taken before the factor `SAFETY`, which has to exceed
it.

    python benchmarks/error.py [--size 10k]
"""

from __future__ import annotations

import argparse

import models
import numpy as np

from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.fields import LineSolver
from updyn.dynamics.reduced import SAFETY, Reduction
from updyn.linalg.solver import check_backend

BAND = np.linspace(100.0, 2140.0, 14)


def cases(start: State) -> dict[str, State]:
    rng = np.random.default_rng(0)
    moved = np.exp(rng.standard_normal(len(start.factor)))
    lossy = start.loss.copy()
    lossy[np.flatnonzero(lossy)[15]] = 0.8
    return {
        "as it starts": start,
        "factors moved by 3 %": State(start.factor * moved**0.03, start.loss, start.rate),
        "factors moved by 10 %": State(start.factor * moved**0.1, start.loss, start.rate),
        "one layer with a loss factor of 0.8": State(start.factor, lossy, start.rate),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", default="10k", choices=models.SOLIDS)
    size = parser.parse_args().size
    model = models.solid(models.SOLIDS[size])
    system = AffineSystem.compile(model)
    rows = model.dofs.match(models.sensors(model)).index
    exact = LineSolver.choose(system, "sparse")
    print(
        f"{'state':<38}{'largest true error':>20}{'true over estimated, median':>30}{'largest':>10}"
    )
    for name, state in cases(system.start).items():
        reduction = Reduction(
            system, rows, rows[:3], (float(BAND[0]), float(BAND[-1])), check_backend(None)
        )
        reduction.build(system.start)
        definite = reduction._factorised(state, -reduction._top)
        stated = np.array([reduction._check(definite, state, f, enrich=False) for f in BAND])
        c = system.coefficients(state, 2 * np.pi * BAND)
        H = exact.at(exact.solve(c, rows[:3], BAND), rows).transpose(1, 0, 2)
        difference = np.abs(reduction._receptance(state, BAND) - H).max(axis=(1, 2))
        off = difference / np.abs(H).max(axis=(1, 2))
        ratio = off / (stated / SAFETY)
        print(
            f"{name:<38}{off.max():>20.1e}{np.median(ratio):>30.2f}{ratio.max():>10.2f}", flush=True
        )


if __name__ == "__main__":
    main()
