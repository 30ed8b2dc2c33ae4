"""Factorisations on a graphics card over those by PARDISO on the processor of the same machine.

Three-dimensional solids in 20 layers, loss factors of 1 to 4 %, 30 right-hand sides: complex and
real matrices at one line. By the clock, as a card has no processor time; the least of a few.
Residuals are the largest normwise backward errors of a column. Answers are compared.

    python benchmarks/card.py [--sizes 10k 50k 150k] [--backends pardiso cudss]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
from large import BANDS
from models import SOLIDS, sensors, solid

import updyn
from updyn.dynamics.affine import AffineSystem
from updyn.linalg.solver import BACKENDS, accuracy, unit_scale


def seconds(run: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    """Return the least time of some runs, and what the last one returned."""
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        made = run()
        times.append(time.perf_counter() - begun)
    return min(times), made


def matrices(model: updyn.Model, freq: float) -> dict[str, sp.csc_array]:
    """Return the dynamic stiffness at a line, and its real part."""
    system = AffineSystem.compile(model)
    c = system.coefficients(system.start, 2 * np.pi * np.array([freq]))
    values = system.values(c)[:, 0]
    where = (system.indices, system.indptr)
    shape = (system.n, system.n)
    return {
        "complex": sp.csc_array((values, *where), shape=shape),
        "real": sp.csc_array((values.real.copy(), *where), shape=shape),
    }


def factorised(A: sp.csc_array, at: np.ndarray, backend: str, repeats: int) -> np.ndarray:
    """Print a row of the table, and return the solution."""
    B = np.zeros((A.shape[0], len(at)), dtype=A.dtype, order="F")
    B[at, np.arange(len(at))] = 1.0
    real = A.dtype == np.float64
    begun = time.perf_counter()
    made = BACKENDS[backend](A, real=real)
    analysed = time.perf_counter() - begun
    factor, solve = seconds(lambda: made.factor(A), repeats)
    solved, X = seconds(lambda: solve(B), repeats)
    error = accuracy(A, unit_scale(A.diagonal()), X, B, 0.0)[0].max()
    print(
        f"{A.shape[0]:>8} {'real' if real else 'complex':<8} {backend:<8} {analysed:>8.2f}"
        f" {factor:>8.3f} {solved:>8.3f} {(made.peak_bytes or np.nan) / 2**30:>8.2f} {error:>9.1e}"
        f" {solve.negative if real else '':>6}",
        flush=True,
    )
    made.release()
    return X


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", nargs="+", default=["10k", "50k", "150k"], choices=list(SOLIDS))
    parser.add_argument("--backends", nargs="+", default=["pardiso", "cudss"])
    parser.add_argument("--kinds", nargs="+", default=["complex", "real"])
    parser.add_argument("--repeats", type=int, default=3)
    given = parser.parse_args()
    print(
        f"{'DOFs':>8} {'matrix':<8} {'backend':<8} {'analyse':>8} {'factor':>8} {'solve':>8}"
        f" {'GiB':>8} {'residual':>9} {'below':>6}"
    )
    for size in given.sizes:
        model = solid(SOLIDS[size], lumped=size == "1M")
        at = model.dofs.match(sensors(model)).index
        for kind, A in matrices(model, BANDS[size][1]).items():
            if kind not in given.kinds:
                continue
            answers = [factorised(A, at, backend, given.repeats) for backend in given.backends]
            for X in answers[1:]:
                apart = np.abs(X - answers[0]).max() / np.abs(answers[0]).max()
                print(f"{'':>8} answers differ by {apart:.1e} of the largest", flush=True)


if __name__ == "__main__":
    main()
