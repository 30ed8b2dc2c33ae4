"""Time of one exact iteration at each size, tier and backend, and of peers on the same models.

First a table of updyn: one log residual with its exact Jacobian (30 sensors, 3 references), each at
other values of the unknowns, after a first one that is timed by itself: it holds the symbolic
analysis, or the building of a reduced basis. Then a table for each peer: textbook (the paper's
dense form), differences (scipy least_squares, 2-point, SuperLU), sdynpy, opentorsion. In these the
ratio is over the first row; a peer with another answer is not compared.

    python benchmarks/speed.py [--models chain-50 10k 50k] [--tiers sparse reduced] [--lines 4]
                               [--peers textbook differences sdynpy opentorsion | --peers none]
"""

from __future__ import annotations

import argparse
import importlib.util
from collections.abc import Iterator

import models
import numpy as np
from peers import finite_differences, opentorsion_train, sdynpy_system, textbook
from peers.measure import AnotherAnswer, Case, backends, best, machine, once, show, steps

from updyn.dynamics.fields import TIERS
from updyn.dynamics.settings import REDUCTION
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import LogError

PEERS = {
    "textbook": textbook,
    "differences": finite_differences,
    "sdynpy": sdynpy_system,
    "opentorsion": opentorsion_train,
}
#: Larger models would take minutes for one line of this tier or backend; smaller ones need no
#: reduction.
DENSE_MOST, SUPERLU_MOST, REDUCED_LEAST = 2_000, 60_000, 2_000


def build(name: str) -> tuple[models.updyn.Model, float, float]:
    """A model by name, and its band in Hz."""
    if name.startswith("chain-"):
        return models.chain(int(name.removeprefix("chain-")), parts=20), 5.0, 50.0
    return models.solid(models.SOLIDS[name], lumped=name == "1M"), 100.0, 300.0


def ways(n_dofs: int, tiers: list[str]) -> Iterator[tuple[str, str | None]]:
    """Tiers and backends that suit a size."""
    for tier in tiers:
        if tier == "dense" and n_dofs <= DENSE_MOST:
            yield tier, None
        if tier == "sparse":
            yield from ((tier, b) for b in backends() if b != "superlu" or n_dofs <= SUPERLU_MOST)
        if tier == "reduced" and n_dofs >= REDUCED_LEAST:
            yield tier, None


def prepared(case: Case, tier: str, backend: str | None) -> FRFPart:
    """The problem in a tier; a reduced one is built and proved at the start."""
    if tier != "reduced":
        return case.problem(tier, backend)
    from updyn.updating.fit.reducing import Reducing

    exact = Problem.of([case.problem("sparse", backend)])
    reducing = Reducing(exact, REDUCTION.accuracy)
    reducing.begin()
    return reducing.with_reduced_models(exact).parts[0]


def iterations(options: argparse.Namespace) -> None:
    """Print the table of updyn."""
    wanted = [t for t in options.tiers if t in TIERS]
    for tier in set(options.tiers) - set(wanted):
        print(f"tier {tier!r} is not in this version: skipped")
    print(
        f"\n{'model':<12}{'DOFs':>9}{'lines':>7}{'unknowns':>10}  {'tier':<9}{'backend':<9}"
        f"{'first s':>9}{'seconds':>9}{'s/line':>10}{'ratio':>8}"
    )
    for name in options.models:
        model, low, high = build(name)
        base = np.nan
        for tier, backend in ways(model.n_dofs, wanted):
            n_lines = options.reduced_lines if tier == "reduced" else options.lines
            n_unknowns = min(options.n_unknowns, 3 * len(model.groups))
            case = Case.build(model, np.linspace(low, high, n_lines), n_unknowns, only_time=True)
            basis, problem = once(lambda c=case, t=tier, b=backend: prepared(c, t, b))
            step = steps(LogError(), problem)
            first, _ = once(step)
            first += basis if tier == "reduced" else 0.0
            taken = best(step)
            line = taken / n_lines
            base = line if np.isnan(base) else base
            print(
                f"{name:<12}{model.n_dofs:>9}{n_lines:>7}{problem.n:>10}  {tier:<9}"
                f"{problem.solver.backend if tier != 'dense' else '':<9}"
                f"{first:>9.3f}{taken:>9.3f}{line:>10.5f}{line / base:>8.2f}",
                flush=True,
            )


def peers(names: list[str], options: argparse.Namespace) -> None:
    """Print the tables of the peers."""
    for name in names:
        package = getattr(PEERS[name], "PACKAGE", None)
        if package and importlib.util.find_spec(package) is None:
            print(f"\n{name}: {package} is not installed (pip install {package}): skipped")
            continue
        try:
            for title, rows in PEERS[name].tables(options):
                show(title, rows)
        except AnotherAnswer as problem:
            print(f"\n{name}: {problem}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add(
        "--models",
        nargs="*",
        default=["chain-50", "chain-1000", "10k", "50k"],
        help="chain-N or one of the solids",
    )
    add(
        "--tiers",
        nargs="+",
        default=["sparse", "dense", "reduced"],
        help="the first is what ratios are over",
    )
    add("--lines", type=int, default=4)
    add("--reduced-lines", type=int, default=200, help="a reduced basis pays only over many lines")
    add("--n-unknowns", type=int, default=60)
    add("--peers", nargs="+", choices=[*PEERS, "none"], default=list(PEERS))
    add("--dense-dofs", type=int, default=1008, help="textbook, sdynpy: size")
    add("--dense-lines", type=int, default=10)
    add(
        "--sparse",
        nargs="+",
        choices=list(models.SOLIDS),
        default=["10k", "50k"],
        help="differences: solids",
    )
    add("--sparse-lines", type=int, default=1, help="differences: the cost is proportional")
    add("--unknowns", nargs="+", type=int, default=[10, 30, 60], help="differences: how many")
    add(
        "--budget",
        type=float,
        default=60.0,
        help="differences: seconds for one Jacobian, else one evaluation is timed",
    )
    add("--trains", nargs="+", type=int, default=[10, 100, 500], help="opentorsion: inertias")
    add("--train-lines", type=int, default=200)
    options = parser.parse_args()
    print(machine())
    if options.models:
        iterations(options)
    peers([name for name in options.peers if name != "none"], options)


if __name__ == "__main__":
    main()
