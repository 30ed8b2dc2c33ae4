"""Predicted effects of modifications against those on the true structure.

Five structures are updated to FRFs with 2 % noise and a floor of 0.1 %, from a start that is off by
up to a fifth of the usual spread. Each gets ten random modifications: a mass, a spring to the
ground, a dashpot, or a stiffer group. The table has the share of true changes in 95 % intervals, of
frequencies (lowest modes) and of FRF levels (5 lines of all channels), and the median of the
standard deviation of a change of frequency over that of the frequency.

    python benchmarks/modification.py [N] [--structures NAME ...]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np
from scipy.optimize import linear_sum_assignment
from structures import Noise, bench

import updyn
from updyn.model import Model
from updyn.uncertainty.restored import AT_MINIMUM

NAMES = ("chain", "building", "gear train", "portal", "appendages")
NOISE = Noise(0.02, 1e-3)
N_MODES = 4


def draw_change(model: Model, rng: np.random.Generator) -> Callable[[Model], Model]:
    """Return a random modification of a size that matters."""
    kind = rng.choice(["mass", "spring", "dashpot", "group"])
    if kind == "group":
        names = [name for name, group in model.groups.items() if group.stiffness is not None]
        name, factor = str(rng.choice(names)), float(np.exp(rng.uniform(-0.4, 0.4)))
        return lambda m: m.scaled({name: {"stiffness": factor}})
    at = int(rng.integers(model.n_dofs))
    label = str(model.dofs[at])
    stiffness, mass = model.stiffness.diagonal()[at], model.mass.diagonal()[at]
    share = float(rng.uniform(0.05, 0.4))
    if kind == "mass":
        return lambda m: m.with_element("added", [label], mass=share * mass + 1e-9 * stiffness)
    if kind == "spring":
        return lambda m: m.with_element("added", [label], stiffness=share * stiffness)
    rate = share * float(np.sqrt(stiffness * mass)) + 1e-9 * stiffness
    return lambda m: m.with_element("added", [label], viscous=rate)


def study(name: str, n: int) -> tuple[list[bool], list[bool], list[float]]:
    """Return hits of frequencies and of levels, and ratios of standard deviations."""
    case = bench(name)
    true, clean = case.case.true, case.case.clean
    hits, level_hits, ratios = [], [], []
    for seed in range(n):
        rng = np.random.default_rng([seed, len(name)])
        start = case.start(rng, 0.2)
        frf = NOISE.added(clean, rng)
        noise = {"relative": NOISE.relative, "floor": NOISE.floor}
        result = updyn.update(start, frf, case.sought(start), noise=noise)
        if result.status not in AT_MINIMUM:
            print(f"{name}, {seed}: {result.status}; not used")
            continue
        if result.alternatives:
            print(f"{name}, {seed}: another answer fits as well; not used")
            continue
        change = draw_change(true, rng)
        found = updyn.modify(result, change, N_MODES)
        for one, other in zip(found.modes, _true_changes(true, change(true)), strict=True):
            low, high = one.interval()
            if np.isfinite(low) and one.std_change > 1e-9 * one.before:
                hits.append(bool(low < other < high))
                ratios.append(one.std_change / one.std_before)
        lines = np.linspace(clean.freq[0], clean.freq[-1], 5)
        ends = list(clean.responses), list(clean.references)
        low, high = found.frf(lines, *ends).interval()
        with np.errstate(divide="ignore", invalid="ignore"):
            change_db = _level(change(true), lines, ends) - _level(true, lines, ends)
        inside = (low < change_db) & (change_db < high)
        level_hits += inside[high - low > 1e-6].tolist()
    return hits, level_hits, ratios


def _true_changes(true: Model, changed: Model) -> np.ndarray:
    """Return the change of the lowest elastic modes in Hz, paired by their shapes."""
    before, after = (_elastic(model, N_MODES + 2) for model in (true, changed))
    similarity = (before.shapes[:, :N_MODES].real.T @ (true.mass @ after.shapes.real)) ** 2
    rows, columns = linear_sum_assignment(similarity, maximize=True)
    return after.frequency[columns] - before.frequency[rows]


def _elastic(model: Model, n: int) -> updyn.ModeSet:
    """Return the lowest modes without rigid-body modes."""
    found = updyn.modes(model, min(n + 6, model.n_dofs))
    elastic = np.flatnonzero(found.frequency > 1e-4 * found.frequency.max())
    return found.select(elastic[:n])


def _level(model: Model, lines: np.ndarray, ends: tuple[list, list]) -> np.ndarray:
    return 20.0 * np.log10(np.abs(updyn.response(model, lines, *ends).values))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("n", nargs="?", type=int, default=10, help="modifications a structure")
    parser.add_argument("--structures", nargs="+", default=NAMES, choices=NAMES)
    arguments = parser.parse_args()
    every, every_level = [], []
    print("structure     frequencies    levels   std of change / std")
    for name in arguments.structures:
        hits, level_hits, ratios = study(name, arguments.n)
        every, every_level = every + hits, every_level + level_hits
        figures = (100.0 * np.mean(each) for each in (hits, level_hits))
        print("{:<12}{:>10.1f} %{:>9.1f} %{:>10.2f}".format(name, *figures, np.nanmedian(ratios)))
    print(f"all         {100.0 * np.mean(every):>10.1f} %{100.0 * np.mean(every_level):>9.1f} %")


if __name__ == "__main__":
    main()
