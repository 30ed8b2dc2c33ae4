"""Time of the judgement of a fit over that of one evaluation of all its lines.

Solids in ten layers, 12 sensors, 2 forces, 1 % noise; the fit begins 3 % off the truth and makes no
search, so that only the judgement counts. Cases: `noise`, where the data hold nothing else;
`open`, with few lines and sensors, so that some unknowns stay undetermined and advice is sought;
`error`, where the mass of a layer that is no unknown is 30 % off, so that the misfit is localised
and its causes are looked for. An evaluation is the residual of all lines and its exact Jacobian;
both are processor time, as are the parts of the judgement.

    python benchmarks/judging.py [--sizes 3x3x18,6x6x22] [--tiers sparse,reduced] [--cases noise]
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import models
import numpy as np

import updyn
import updyn.updating.judged as judged_module
from updyn.updating.judge import assessment
from updyn.updating.judge.causes.of_run import CauseSearch
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import make_log_error
from updyn.updating.problem.session import Session

NOISE, LAYERS = 0.01, 10
#: Parts of the judgement, by the function that does each.
PARTS = {
    "rank": "_equal_row_jacobian",
    "misfit": "_typical_misfit",
    "advice": "advise",
    "agreement": "_correlate_part",
    "rounding": "find_worst_rounding",
    "adequacy": "assess_adequacy",
    "answers": "find_alternatives",
}


class Clock:
    """Processor time by name, of functions that are replaced by timed ones."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self.judged: list[tuple[Problem, Any]] = []

    def time(self, module: Any, function: str, name: str) -> None:
        """Replace a module's function by one that is timed under a name."""
        inner: Callable[..., Any] = getattr(module, function)

        def timed(*args: Any, **kwargs: Any) -> Any:
            if name == "judge":
                self.judged.append((args[0], args[2]))
            begun = time.process_time()
            try:
                return inner(*args, **kwargs)
            finally:
                self.seconds[name] += time.process_time() - begun

        setattr(module, function, timed)


def evaluation(problem: Problem, x: np.ndarray) -> float:
    """Seconds of one evaluation of all lines, the better of two."""
    fresh = problem.with_session(Session())
    variance = [np.full(p.frf.values.shape, 1e-30) for p in fresh.parts]
    parts = [
        p.with_data(
            updyn.FRF(
                p.frf.freq,
                p.frf.values,
                p.frf.responses,
                p.frf.references,
                p.frf.quantity,
                variance=v,
            )
        )
        for p, v in zip(fresh.parts, variance, strict=True)
    ]
    found = []
    for _ in range(2):
        again = fresh.with_parts([replace(part) for part in parts])  # without kept derivatives
        begun = time.process_time()
        make_log_error(again).local(again, x)
        found.append(time.process_time() - begun)
    return min(found)


def case(name: str, model: updyn.Model, lines: int) -> tuple[updyn.FRF, ParameterSet]:
    """Noisy data of the truth, and the unknowns of a model that is off."""
    rng = np.random.default_rng(3)
    layers = list(model.groups)
    changes = {
        g: {q: float(np.exp(rng.uniform(-0.03, 0.03))) for q in ("stiffness", "mass")}
        for g in layers
    }
    sought = layers
    if name == "error":
        changes[layers[4]]["mass"] *= 1.3
        sought = [g for g in layers if g != layers[4]]
    at = models.sensors(model, 3 if name == "open" else 12)
    modes = updyn.modes(model, 8).frequency
    few = 6 if name == "open" else lines
    freq = np.linspace(0.5 * modes[0], (0.9 if name == "open" else 1.05) * modes[6], few)
    clean = updyn.response(model.scaled(changes), freq, at, at[:2])
    real, imaginary = rng.standard_normal((2, *clean.values.shape))
    noisy = clean.values * (1.0 + NOISE / np.sqrt(2.0) * (real + 1j * imaginary))
    frf = updyn.FRF(clean.freq, noisy, clean.responses, clean.references, clean.quantity)
    mass = sought if name != "error" else [g for g in sought if g != layers[5]]
    return frf, updyn.parameters(model, stiffness=sought, mass=mass, loss_factor=sought)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", default="3x3x18,6x6x20")
    parser.add_argument("--tiers", default="sparse,reduced")
    parser.add_argument("--cases", default="noise,open,error")
    parser.add_argument("--lines", type=int, default=80)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    clock = Clock()
    clock.time(judged_module, "judge_fit", "judge")
    clock.time(CauseSearch, "search_after_fit", "causes")
    for name, function in PARTS.items():
        clock.time(assessment, function, name)
    print(
        f"| DOFs | tier | case | lines | evaluation, s | judgement | {' | '.join(PARTS)} | causes |"
    )
    print("|" + "---|" * (len(PARTS) + 7))
    for size in given.sizes.split(","):
        model = models.solid(tuple(map(int, size.split("x"))), parts=LAYERS)
        for name in given.cases.split(","):
            frf, unknowns = case(name, model, given.lines)
            for tier in given.tiers.split(","):
                clock.seconds.clear()
                updyn.update(model, frf, unknowns, tier=tier, starts=0)
                problem, fit = clock.judged[-1]
                one = evaluation(problem, fit.x)
                shares = [f"{clock.seconds[part] / one:.2f}" for part in PARTS]
                print(
                    f"| {model.n_dofs} | {tier} | {name} | {len(frf.freq)} | {one:.2f}"
                    f" | {clock.seconds['judge'] / one:.2f} | {' | '.join(shares)}"
                    f" | {clock.seconds['causes'] / one:.2f} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
