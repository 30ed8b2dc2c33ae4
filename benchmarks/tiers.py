"""From which size on a fit in a reduced model takes less time than one line by line.

Solids in six layers (18 unknowns: stiffness, mass and loss factor of each) and frames of a
footbridge (stiffness of each group), 12 sensors, 2 forces, lines over seven modes, 1 % noise;
starts off by up to a factor of 1.35 in stiffness and 1.16 in mass. Each draw is fitted by both
tiers, by default otherwise: processor time, and the largest difference of an estimate in its
standard deviations.

    python benchmarks/tiers.py [--models solid:3x3x18,frame:4x19x12] [--lines 80] [--draws 2]
"""

from __future__ import annotations

import argparse
import time
import warnings

import models
import numpy as np

import updyn

TIERS = ("sparse", "reduced")
MODELS = "frame:2x6x6,solid:3x3x6,solid:3x3x10,frame:2x10x6,solid:3x3x18,solid:4x4x27,frame:4x19x12"
OFF, NOISE = 0.3, 0.01


def structure(name: str) -> tuple[updyn.Model, dict[str, str]]:
    """The true model, and the unknowns."""
    kind, size = name.split(":")
    first, second, third = map(int, size.split("x"))
    if kind == "solid":
        unknowns = {"stiffness": "all", "mass": "all", "loss_factor": "all"}
        return models.solid((first, second, third), parts=6), unknowns
    return models.footbridge(first, second, pieces=third), {"stiffness": "all"}


def measured(true: updyn.Model, lines: int) -> updyn.FRF:
    """Its FRFs without noise."""
    at = models.sensors(true, 12)
    modes = updyn.modes(true, 8).frequency
    freq = np.linspace(0.5 * modes[0], 1.05 * modes[6], lines)
    return updyn.response(true, freq, at, at[:2])


def started(true: updyn.Model, quantities: dict[str, str], rng: np.random.Generator) -> updyn.Model:
    """A model that is off."""
    size = {"stiffness": OFF, "mass": 0.5 * OFF}
    return true.scaled(
        {
            group: {
                quantity: float(np.exp(rng.uniform(-off, off)))
                for quantity, off in size.items()
                if quantity in quantities
            }
            for group in true.groups
        }
    )


def noisy(frf: updyn.FRF, rng: np.random.Generator) -> updyn.FRF:
    real, imaginary = rng.standard_normal((2, *frf.values.shape))
    values = frf.values * (1.0 + NOISE / np.sqrt(2.0) * (real + 1j * imaginary))
    return updyn.FRF(frf.freq, values, frf.responses, frf.references, frf.quantity)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--models", default=MODELS)
    parser.add_argument("--lines", type=int, default=80)
    parser.add_argument("--draws", type=int, default=2)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    print("| model | DOFs | draw | sparse, s | reduced, s | ratio | largest difference |")
    print("|---|---|---|---|---|---|---|")
    for name in given.models.split(","):
        true, quantities = structure(name)
        clean = measured(true, given.lines)
        for draw in range(given.draws):
            rng = np.random.default_rng([7, draw])
            start, data = started(true, quantities, rng), noisy(clean, rng)
            seconds, found = [], []
            for tier in TIERS:
                begun = time.process_time()
                unknowns = updyn.parameters(start, **quantities)
                found.append(updyn.update(start, data, unknowns, tier=tier))
                seconds.append(time.process_time() - begun)
            exact, reduced = found
            apart = max(
                abs(value - reduced.values[key]) / exact.std[key]
                for key, value in exact.values.items()
            )
            print(
                f"| {name} | {true.n_dofs} | {draw} | {seconds[0]:.1f} | {seconds[1]:.1f}"
                f" | {seconds[1] / seconds[0]:.2f} | {apart:.0e} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
