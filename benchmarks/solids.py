"""How often reduced models recover a solid from starts far off, beside the number of sensors.

Clamped solids in six layers, 18 unknowns (stiffness, mass and loss factor of each), two forces,
sensors spread over the solid, 60 lines over six modes, 1 % proportional noise. Starts are off by up
to 70 % in stiffness and 30 % in mass, without damping. Recovered: every unknown within four
standard deviations of the Cramer-Rao bound.

    python benchmarks/solids.py [--sizes 864,2025,10140] [--sensors 8,20,30] [--draws 40]
        [--tier reduced] [--seed 0]
"""

from __future__ import annotations

import argparse
import time
import warnings
from functools import cache

import models
import numpy as np

import updyn
from updyn.frf import FRF
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import OutputError

#: Bricks in x, y and z, by the number of DOFs.
CELLS = {"864": (3, 3, 18), "2025": (4, 4, 27), "10140": (12, 12, 20)}
NOISE = 0.01
#: Values below this share of the loudest of their line are rounding, and tell nothing.
FAINTEST = 1e-9
#: Largest error of a recovered unknown in standard deviations.
SURE = 4.0


def everything(model: updyn.Model) -> ParameterSet:
    return updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")


@cache
def measured(size: str, sensors: int) -> tuple[updyn.Model, FRF, np.ndarray]:
    """The true solid, its FRFs without noise, and the Cramer-Rao bound of each unknown."""
    true = models.solid(CELLS[size], parts=6)
    at = models.sensors(true, sensors)
    modes = updyn.modes(true, 8).frequency
    lines = np.linspace(0.4 * modes[0], 1.05 * modes[5], 60)
    clean = updyn.response(true, lines, at, at[:2])
    unknowns = everything(true)
    part = FRFPart.build(true, clean, unknowns)
    x = part.coordinates.to_x(unknowns.start)
    level = np.abs(clean.values)
    spread = NOISE * np.maximum(level, FAINTEST * level.max(axis=(1, 2), keepdims=True))
    R = OutputError(np.sqrt(2.0) / spread).local(Problem.of([part]), x).R
    return true, clean, np.linalg.norm(np.linalg.solve(R.T, np.eye(len(R))), axis=0)


def started(true: updyn.Model, seed: int) -> tuple[updyn.Model, dict[str, float]]:
    """A start, and the true values of the unknowns as factors on it."""
    rng = np.random.default_rng(seed)
    changes, truth = {}, {}
    for p in everything(true):
        if p.quantity == "loss_factor":
            value, truth[p.name] = 0.0, true.group(p.group).loss_factor
        else:
            spread = {"stiffness": 0.7, "mass": 0.3}[p.quantity]
            value = 1.0 + rng.uniform(-spread, spread)
            truth[p.name] = 1.0 / value
        changes.setdefault(p.group, {})[p.quantity] = value
    return true.scaled(changes), truth


def noisy(clean: FRF, seed: int) -> FRF:
    draw = np.random.default_rng([seed, 1]).standard_normal((2, *clean.values.shape))
    values = clean.values * (1.0 + NOISE * np.sqrt(0.5) * (draw[0] + 1j * draw[1]))
    return FRF(clean.freq, values, clean.responses, clean.references, clean.quantity)


def draw(size: str, sensors: int, seed: int, tier: str) -> tuple[float, bool, float]:
    """One fit: largest error in bounds, whether it says converged, seconds."""
    true, clean, bound = measured(size, sensors)
    start, truth = started(true, seed)
    begun = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = updyn.update(start, noisy(clean, seed), everything(start), tier=tier)
    seconds = time.process_time() - begun
    error = np.empty(len(bound))
    for i, (name, value) in enumerate(truth.items()):
        # The bound of a factor is relative.
        scale = 1.0 if name.endswith("loss_factor") else value
        error[i] = abs(found.values[name] - value) / (scale * bound[i])
    print(
        f"  seed {seed}: {error.max():8.1f} bounds, {found.status}, {len(found.history)} steps,"
        f" {seconds:.1f} s, basis {found.options.get('basis', '-')},"
        f" error {found.options.get('error', '-')}, {found.options.get('factorisations', '-')}"
        f" factorisations{', searched' * any(step.stage == 'search' for step in found.history)}",
        flush=True,
    )
    return error.max(), found.status == "converged", seconds


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", default=",".join(CELLS))
    parser.add_argument("--sensors", default="8,20,30")
    parser.add_argument("--draws", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tier", default="reduced")
    args = parser.parse_args()
    for size in args.sizes.split(","):
        for sensors in map(int, args.sensors.split(",")):
            print(f"{size} DOFs, {sensors} sensors")
            found = [
                draw(size, sensors, seed, args.tier)
                for seed in range(args.seed, args.seed + args.draws)
            ]
            right = [error <= SURE for error, _, _ in found]
            wrong = sum(said and error > 6.0 for error, said, _ in found)
            seconds = [s for _, _, s in found]
            print(
                f"{size} DOFs, {sensors} sensors: recovered {sum(right)} of {len(found)}, converged"
                f" over 6 bounds off {wrong}, {np.median(seconds):.1f} s each (median),"
                f" {max(seconds):.1f} s at most",
                flush=True,
            )


if __name__ == "__main__":
    main()
