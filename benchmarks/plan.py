"""Planned layouts against random and classical ones, and what plans expect against repeated fits.

``python benchmarks/plan.py layouts``: on each structure, the size of the confidence ellipsoid (the
geometric mean of its semi-axes: the n-th root of its volume) of 500 random layouts and of the
classical criteria, over that of the plan. ``robust``: the same where the truth is 20 % off the
start, for a plan at the start (``robust=0``), one over four draws (the default) and effective
independence, over that of a plan that knows the truth. ``draws``: the same by number of draws, over
that without. ``fits``: the spread of 300 fits to data with noise over the standard deviations that
the plan expects. The last two take the name of a structure. ``antenna``: time and memory of plans
for the antenna of `updyn demo antenna`, rotors free, and the layouts where the truth is 20 % off.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from models import footbridge, solid
from structures import appendages, everything

import updyn
from updyn.demos import find_demo
from updyn.demos.antenna import BAND
from updyn.demos.antenna_model import antenna as antenna_model
from updyn.frf import FRF
from updyn.job import load_job
from updyn.job.unknowns import choose_unknowns
from updyn.model import Model
from updyn.planning.candidates import find_candidates
from updyn.planning.criteria import CRITERIA, Planning, volume_score
from updyn.planning.information import Candidates, PairInformation
from updyn.planning.options import find_noise
from updyn.updating.problem.parameters import ParameterSet

SENSORS, FORCES = 8, 1
RANDOM, DRAWS, FITS = 500, 10, 300
NOISE = {"relative": 0.05, "floor": 0.001}
#: Of the antenna: candidate sensors and forces, on the reflector and the yoke or any translation,
#: and draws.
_DISH = ("4??:[XYZ]",), ("4[567]?:X", "108:[XYZ]", "118:[XYZ]")
ANTENNA = ((*_DISH, 4), (*_DISH, 0), (("*:[XYZ]",), ("*:[XYZ]",), 4))
ANTENNA_FORCES = 3
CLASSICAL = ("effective-independence", "mac", "driving-point-residue")


@dataclass(frozen=True)
class Structure:
    """A structure to plan for: its unknowns, where sensors and forces may be, and the lines."""

    name: str
    model: Model
    unknowns: Callable[[Model], ParameterSet]
    candidates: tuple[str, ...]
    modes: int
    lines: int

    @property
    def band(self) -> tuple[float, float]:
        frequency = updyn.modes(self.model, self.modes).frequency
        return 0.5 * float(frequency[0]), 1.05 * float(frequency[-1])

    def plan(self, **options) -> updyn.Plan:
        unknowns = self.unknowns(self.model)
        return updyn.plan(
            self.model,
            unknowns,
            self.candidates,
            SENSORS,
            FORCES,
            self.band,
            lines=self.lines,
            noise=NOISE,
            **options,
        )

    def planning(self, model: Model | None = None) -> Planning:
        """The information of all pairs, at the start or of another model."""
        model = model or self.model
        unknowns = self.unknowns(model)
        dofs = find_candidates(model, self.candidates)
        freq = np.linspace(*self.band, self.lines)
        found = Candidates.compile(
            model, unknowns, dofs, dofs, freq, "accelerance", find_noise(NOISE)
        ).with_level()
        information = PairInformation.compute(found, [found.part.coordinates.start])
        return Planning(found, information, tuple(range(len(unknowns))))


def structures() -> list[Structure]:
    beam = appendages()
    return [
        Structure("space frame", footbridge(3, 6), everything, ("*:Z",), 8, 60),
        Structure("solid", solid((2, 2, 12), parts=4), everything, ("*:[XZ]",), 8, 60),
        Structure("beam with boxes", beam.case.true, beam.sought, ("*:Z",), 5, 100),
    ]


def radius(planning: Planning, rows, columns) -> float:
    """The n-th root of the volume of the confidence ellipsoid, but for a constant."""
    information = planning.information.of_layout(rows, columns)
    return float(np.exp(-0.5 * volume_score(planning).score(information)))


def positions(planning: Planning, plan: updyn.Plan) -> tuple[list[int], list[int]]:
    """Where a plan's sensors and forces stand among the candidates."""
    candidates = planning.candidates
    rows = candidates.responses.match(plan.responses).index.tolist()
    return rows, candidates.references.match(plan.references).index.tolist()


def layouts() -> None:
    print("| structure | DOFs | unknowns | candidates | random, planned force | random force"
          " | effective independence | MAC | driving point | s |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|---|")
    for structure in structures():
        begun = time.perf_counter()
        plan = structure.plan()
        seconds = time.perf_counter() - begun
        planning = structure.planning()
        rows, columns = positions(planning, plan)
        own = radius(planning, rows, columns)
        n_i, n_j = planning.information.shape
        rng = np.random.default_rng(0)
        cells = []
        for fixed in (True, False):
            ratios = []
            for _ in range(RANDOM):
                some = rng.choice(n_i, SENSORS, replace=False)
                forces = columns if fixed else rng.choice(n_j, FORCES, replace=False)
                ratios.append(radius(planning, some, forces) / own)
            beaten = 100 * np.mean(np.array(ratios) > 1.0)
            cells.append(f"{np.median(ratios):.2f} ({beaten:.1f} %)")
        for name in CLASSICAL:
            layout = CRITERIA[name]().choose(planning, SENSORS, FORCES)
            with_theirs = radius(planning, layout.rows, layout.columns) / own
            with_ours = radius(planning, layout.rows, columns) / own
            cells.append(f"{with_theirs:.2f}, {with_ours:.2f}")
        n = len(structure.unknowns(structure.model))
        head = [structure.name, str(structure.model.n_dofs), str(n), str(n_i)]
        print(f"| {' | '.join([*head, *cells, f'{seconds:.1f}'])} |", flush=True)


def robust() -> None:
    print("| structure | at the start | over 4 draws | effective independence | worst at the start"
          " | worst over draws |")  # fmt: skip
    print("|---|---|---|---|---|---|")
    for structure in structures():
        plans = [structure.plan(robust=0), structure.plan()]
        rule = CRITERIA["effective-independence"]()
        classical = rule.choose(structure.planning(), SENSORS, FORCES)
        rng = np.random.default_rng(2)
        ratios = []
        for _ in range(DRAWS):
            model = off(structure, rng)
            planning = structure.planning(model)
            score = CRITERIA["d-optimal"]()
            best = score.choose(planning, SENSORS, FORCES)
            least = radius(planning, best.rows, best.columns)
            own = [radius(planning, *positions(planning, plan)) / least for plan in plans]
            theirs = radius(planning, classical.rows, classical.columns) / least
            ratios.append([*own, theirs])
        mean = np.exp(np.mean(np.log(ratios), axis=0))
        worst = np.max(ratios, axis=0)
        cells = [f"{value:.2f}" for value in (*mean, worst[0], worst[1])]
        print(f"| {structure.name} | {' | '.join(cells)} |", flush=True)


def draws(which: str = "") -> None:
    numbers = (0, 2, 4, 8, 16)
    print(f"| structure | {' | '.join(map(str, numbers))} |")
    print("|---|---|---|---|---|---|")
    for structure in structures():
        if which not in structure.name:
            continue
        plans = [structure.plan(robust=number, seed=1) for number in numbers]
        rng = np.random.default_rng(7)
        logs = []
        for _ in range(DRAWS):
            planning = structure.planning(off(structure, rng))
            sizes = [radius(planning, *positions(planning, plan)) for plan in plans]
            logs.append(np.log(sizes) - np.log(sizes[0]))
        cells = [f"{value:.2f}" for value in np.exp(np.mean(logs, axis=0))]
        print(f"| {structure.name} | {' | '.join(cells)} |", flush=True)


def off(structure: Structure, rng: np.random.Generator, share: float = 0.2) -> Model:
    """A structure each of whose unknowns is off by 20 %."""
    changes: dict[str, dict[str, float]] = {}
    for p in structure.unknowns(structure.model):
        factor = float(np.exp(share * rng.standard_normal()))
        changes.setdefault(p.group, {})[p.quantity] = p.start * factor
    return structure.model.scaled(changes)


def antenna() -> None:
    model = antenna_model()
    with tempfile.TemporaryDirectory() as there:
        job = load_job(find_demo("antenna").write_inputs(Path(there)))
        unknowns = choose_unknowns(job, model, [])
    plans: dict[str, updyn.Plan] = {}
    print("| candidates | draws | CPU s | peak memory, MB |")
    print("|---|---|---|---|")
    for sensors, forces, robust in ANTENNA:
        begun = time.process_time()
        found = updyn.plan(
            model, unknowns, sensors, SENSORS, ANTENNA_FORCES, BAND, noise=NOISE,
            reference_candidates=forces, robust=robust, compare=not plans,
        )  # fmt: skip
        seconds = time.process_time() - begun
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        n_i, n_j = len(find_candidates(model, sensors)), len(find_candidates(model, forces))
        print(f"| {n_i} x {n_j} | {robust} | {seconds:.0f} | {memory:.0f} |", flush=True)
        plans[f"{n_i} x {n_j}, {robust} draws"] = found
    first = next(iter(plans.values()))
    for rival in first.rivals:
        if rival.criterion in CLASSICAL:
            layout = replace(first, responses=rival.responses, references=rival.references)
            plans[rival.criterion] = layout
    sizes = np.log(_sizes_off(model, unknowns, list(plans.values())))
    ratios = np.exp(sizes - sizes[:, :1])
    print("\n| layout | mean of 10 truths | worst |")
    print("|---|---|---|")
    for name, own in zip(plans, ratios.T, strict=True):
        print(f"| {name} | {np.exp(np.log(own).mean()):.2f} | {own.max():.2f} |")


def _sizes_off(model: Model, unknowns: ParameterSet, plans: list[updyn.Plan]) -> np.ndarray:
    """Sizes of the ellipsoid of layouts, at ten truths that are 20 % off, shape (truths, layouts).

    The noise has its floor from all DOFs of these layouts.
    """
    rows = find_candidates(model, list(dict.fromkeys(d for p in plans for d in p.responses)))
    columns = find_candidates(model, list(dict.fromkeys(d for p in plans for d in p.references)))
    freq, noise = plans[0].freq, find_noise(NOISE)
    found = Candidates.compile(
        model, unknowns, rows, columns, freq, "accelerance", noise
    ).with_level()
    home, rng = found.part.coordinates.start, np.random.default_rng(2)
    sizes = []
    for _ in range(DRAWS):
        step = 0.2 * rng.standard_normal(len(home))
        x = np.where(unknowns.is_factor, home + step, home * np.exp(step))
        planning = Planning(found, PairInformation.compute(found, [x]), tuple(range(len(home))))
        sizes.append([radius(planning, *positions(planning, plan)) for plan in plans])
    return np.array(sizes)


def fits(which: str = "") -> None:
    print("| structure | fits | RMS error / expected: least | median | largest | s a fit |")
    print("|---|---|---|---|---|---|")
    for structure in structures():
        if which not in structure.name:
            continue
        plan = structure.plan(robust=0)
        unknowns = structure.unknowns(structure.model)
        clean = updyn.response(
            structure.model, plan.freq, plan.responses, plan.references, plan.quantity
        )
        rng = np.random.default_rng(3)
        errors = []
        begun = time.perf_counter()
        for _ in range(FITS):
            found = updyn.update(
                structure.model, noisy(clean, plan, rng), unknowns, noise="variance", starts=0
            )
            errors.append([found.values[p.name] - p.start for p in unknowns])
        seconds = (time.perf_counter() - begun) / FITS
        expected = np.array([plan.std[p.name] for p in unknowns])
        ratio = np.sqrt(np.mean(np.square(errors), axis=0)) / expected
        cells = [f"{value:.2f}" for value in (ratio.min(), np.median(ratio), ratio.max())]
        print(f"| {structure.name} | {FITS} | {' | '.join(cells)} | {seconds:.2f} |", flush=True)


def noisy(clean: FRF, plan: updyn.Plan, rng: np.random.Generator) -> FRF:
    """Data with the noise that the plan expects."""
    draw = rng.standard_normal((2, *clean.values.shape))
    noise = np.sqrt(plan.variance / 2.0) * (draw[0] + 1j * draw[1])
    return replace(clean, values=clean.values + noise, variance=plan.variance)


if __name__ == "__main__":
    tables = {"layouts": layouts, "robust": robust, "draws": draws, "fits": fits}
    {**tables, "antenna": antenna}[sys.argv[1]](*sys.argv[2:])
