"""Mean and scatter of 30 specimens of three masses on six springs, from frequencies and from FRFs.

The structure of Mares, Mottershead & Friswell, MSSP 20 (2006) 1674, constants as in Haddad
Khodaparast, Mottershead & Badcock, MSSP 25 (2011) 1204, section 5: unit masses, k1 to k5 of 1 N/m,
k6 of 3 N/m; k1, k2 and k5 are normal with a mean of 1 and a standard deviation of 0.2. The model
starts at 2; frequencies are fitted without a search. Frequencies have an error of 0.1 %; FRFs of
all points have 1 % noise and a floor. Errors are those of mean and deviation against the drawn
specimens; coverage is that of the true mean and deviation by 95 % intervals.

    python benchmarks/population.py [DRAWS] [--frf]
"""

from __future__ import annotations

import argparse
import dataclasses
import time

import numpy as np

import updyn

NAMES = ("k1", "k2", "k5")
N_SPECIMENS = 30
MEAN, STD, START = 1.0, 0.2, 2.0
FREQUENCY_ERROR = 1e-3


def build() -> updyn.Model:
    """Return the nominal structure: each spring connects two masses, or one and the ground."""
    springs = {"k1": (0,), "k2": (1,), "k3": (2,), "k4": (0, 1), "k5": (1, 2), "k6": (0, 2)}
    groups = {"masses": updyn.Group(mass=np.eye(3))}
    for name, ends in springs.items():
        e = np.zeros(3)
        e[list(ends)] = (1.0, -1.0)[: len(ends)]
        size = 3.0 if name == "k6" else 1.0
        groups[name] = updyn.Group(size * np.outer(e, e), loss_factor=0.02)
    return updyn.Model.from_groups(groups, ["1:X", "2:X", "3:X"])


def measure(
    model: updyn.Model, factors: np.ndarray, rng: np.random.Generator, *, frf: bool
) -> updyn.FRF | updyn.ModeSet:
    """Return noisy frequencies or FRFs of a specimen."""
    changes = {name: {"stiffness": value} for name, value in zip(NAMES, factors, strict=True)}
    specimen = model.scaled(changes)
    if not frf:
        frequency = updyn.modes(specimen, 3).frequency
        noisy = frequency * (1.0 + FREQUENCY_ERROR * rng.standard_normal(3))
        return updyn.ModeSet(noisy, std_frequency=FREQUENCY_ERROR * frequency)
    lines = np.linspace(0.05, 0.6, 111)
    H = updyn.response(specimen, lines, model.dofs, ["1:X"])
    floor = 1e-3 * np.sqrt(np.mean(np.abs(H.values) ** 2))
    std = np.hypot(0.01 * np.abs(H.values), floor)
    noise = rng.standard_normal((2, *H.values.shape)) * std / np.sqrt(2.0)
    return dataclasses.replace(H, values=H.values + noise[0] + 1j * noise[1])


def estimate(seed: int, *, frf: bool) -> tuple[updyn.PopulationResult, np.ndarray]:
    """Return the population of one draw, and the true stiffness of its specimens."""
    rng = np.random.default_rng(seed)
    model = build()
    true = rng.normal(MEAN, STD, (N_SPECIMENS, len(NAMES)))
    tests = [
        updyn.Test(model, measure(model, one, rng, frf=frf), f"specimen {number}")
        for number, one in enumerate(true)
    ]
    unknowns = updyn.parameters(model, stiffness=NAMES).with_start([START] * len(NAMES))
    options = {} if frf else {"starts": 0}
    return updyn.update_population(tests, unknowns, **options), true


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("draws", nargs="?", type=int, default=200)
    parser.add_argument("--frf", action="store_true", help="fit FRFs instead of frequencies")
    arguments = parser.parse_args()
    began = time.process_time()
    mean_error, std_error, mean_hits, std_hits, far = [], [], [], [], 0
    for seed in range(arguments.draws):
        found, true = estimate(seed, frf=arguments.frf)
        mean, std = np.array(list(found.mean.values())), np.array(list(found.std.values()))
        mean_error.append(np.abs(mean / true.mean(axis=0) - 1.0))
        std_error.append(np.abs(std / true.std(axis=0, ddof=1) - 1.0))
        mean_hits += [low < MEAN < high for low, high in found.intervals().values()]
        std_hits += [low < STD < high for low, high in found.std_intervals().values()]
        fits = [list(one.result.values.values()) for one in found.specimens.values()]
        far += int(np.sum(np.abs(np.array(fits) - true).max(axis=1) > 0.2))
    print(f"{arguments.draws} draws of {N_SPECIMENS} specimens, by {parser.prog}")
    for name, errors, hits in (("mean", mean_error, mean_hits), ("std", std_error, std_hits)):
        print(
            f"{name}: error {100 * np.median(errors):.2f} % (median), {100 * np.max(errors):.2f} %"
            f" (largest), coverage {100 * np.mean(hits):.1f} %"
        )
    print(f"{far} of {arguments.draws * N_SPECIMENS} fits are off by more than one deviation")
    print(f"{time.process_time() - began:.0f} s")


if __name__ == "__main__":
    main()
