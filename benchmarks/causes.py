"""What the search for causes costs: evaluations of the model, and processor time.

One draw of a fault of `faults.py` on each structure, `updyn.diagnose` before any fit; the findings
of the measured beam as `updyn check` makes them; and a solid of twenty layers, with twenty
stiffnesses and as many loss factors unknown, of which one sensor of eight has the wrong sign.
Counted are lines at which the model is evaluated with its derivatives.

    python benchmarks/causes.py [--cases chain,beam,solid,...]
"""

from __future__ import annotations

import argparse
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import faults
import models
import numpy as np
import structures

import updyn
from updyn import sensitivity
from updyn.demos import find_demo
from updyn.job import job_findings, load_job, prepare

#: Draws of `faults.py`: structure and fault.
DRAWS = {
    "chain": ("chain", "sign"),
    "building": ("building", "sign"),
    "gear train": ("gear train", "calibration"),
    "space frame": ("space frame", "sign"),
    "wrong quantity": ("space frame", "quantity"),
}


@dataclass
class Cost:
    """Lines evaluated with derivatives, and seconds of processor time."""

    lines: int = 0
    seconds: float = field(default=0.0)


@contextmanager
def counted() -> Iterator[Cost]:
    """Count what is evaluated meanwhile."""
    cost, evaluate = Cost(), sensitivity.receptance

    def counting(*args, derivatives: bool = True, **options):
        cost.lines += len(args[3]) if derivatives else 0
        return evaluate(*args, derivatives=derivatives, **options)

    sensitivity.receptance = counting
    begun = time.process_time()
    try:
        yield cost
    finally:
        cost.seconds = time.process_time() - begun
        sensitivity.receptance = evaluate


def of_draw(structure: str, fault: str) -> tuple[int, Cost, list[str]]:
    case = faults.seeded_case(faults.Draw(structure, fault, 0, free=False, fits=False))
    assert case is not None
    _, start, sought, seeded = case
    with counted() as cost:
        found = updyn.diagnose(start, seeded.faulty, sought)
    return start.n_dofs, cost, [one.kind for one in found]


def of_beam() -> tuple[int, Cost, list[str]]:
    with tempfile.TemporaryDirectory() as folder:
        ready = prepare(load_job(find_demo("beam").write_inputs(Path(folder))))
        with counted() as cost:
            found = [one for test in ready.tests for one in job_findings(test, ready.parameters)]
    return ready.model.n_dofs, cost, [one.kind for one in found]


def of_solid() -> tuple[int, Cost, list[str]]:
    true = models.solid((12, 12, 20), parts=20)
    at = models.sensors(true, 8)
    modes = updyn.modes(true, 8).frequency
    lines = np.linspace(0.4 * modes[0], 1.05 * modes[5], 60)
    rng = np.random.default_rng(0)
    clean = updyn.response(true, lines, at, at[:2], "accelerance")
    frf = structures.Noise(0.01, 1e-3).added(clean, rng)
    start = true.scaled(
        {name: {"stiffness": rng.uniform(0.75, 1.3), "loss_factor": 0.0} for name in true.groups}
    )
    values = frf.values.copy()
    values[:, 3] *= -1.0
    sought = updyn.parameters(true, stiffness="all", loss_factor="all")
    with counted() as cost:
        found = updyn.diagnose(start, replace(frf, values=values), sought)
    return start.n_dofs, cost, [one.kind for one in found]


CASES: dict[str, Callable[[], tuple[int, Cost, list[str]]]] = {
    **{name: lambda draw=draw: of_draw(*draw) for name, draw in DRAWS.items()},
    "beam": of_beam,
    "solid": of_solid,
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=lambda text: text.split(","), default=list(CASES))
    warnings.simplefilter("ignore")
    print("| model | DOFs | lines evaluated | processor time, s | found |")
    print("|---|---|---|---|---|")
    for name in parser.parse_args().cases:
        dofs, cost, found = CASES[name]()
        said = ", ".join(found) or "-"
        print(f"| {name} | {dofs:,} | {cost.lines:,} | {cost.seconds:.1f} | {said} |", flush=True)


if __name__ == "__main__":
    main()
