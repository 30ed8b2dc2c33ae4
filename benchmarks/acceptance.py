"""Stated probabilities of acceptance against the share of models that truly meet the limits.

A building of five floors and a spring-mass chain of eight masses differ from their models by random
errors of stiffness and mass of about the size that the limits allow. Their modes are measured with
noise of known size, and `updyn.accept` states the probability of each requirement.

1. *models*: models as they are; a requirement is truly met if it is by the modes without noise.
2. *updates*: models whose stiffnesses are updated to an earlier test of the structure, before it
   was changed by an error that the model lacks. A requirement is truly met if it is by the modes
   without noise and the model with the true stiffnesses: the unknowns are uncertain, too.

The tables bin the requirements by their stated probability, without those that are certain (below
0.001 or above 0.999), and give the share that is truly met with its 95 % interval
(Clopper-Pearson). A stated probability is calibrated if the interval contains the mean of its
bin.

    OMP_NUM_THREADS=1 python benchmarks/acceptance.py [N]
"""

from __future__ import annotations

import argparse
import itertools
import warnings
from collections.abc import Iterator

import numpy as np
from scipy.stats import beta

import updyn
from updyn.errors import UpdynWarning
from updyn.model import Model

LIMITS = updyn.AcceptanceLimits(frequency=0.05, mac=0.9, mac_off=0.05, cross=0.9, cross_off=0.1)
KINDS = ("frequency", "mac", "mac_off", "cross", "cross_off")
#: Noise of a frequency and, relative to its rms, of a shape.
STD_FREQUENCY, STD_SHAPE = 0.01, 0.05
#: Standard deviation of ln of the stiffnesses and masses of a structure over those of its model.
ERROR = 0.2
N_MODES = 4
EDGES = (0.001, 0.1, 0.3, 0.5, 0.7, 0.9, 0.999)


def build(n: int, stiffness: np.ndarray, mass: np.ndarray) -> Model:
    """Return a chain on the ground, a group for each spring with its mass."""
    groups = {}
    for i in range(n):
        K, M = np.zeros((n, n)), np.zeros((n, n))
        K[i, i] = stiffness[i]
        if i:
            K[i - 1, i - 1] = stiffness[i]
            K[i, i - 1] = K[i - 1, i] = -stiffness[i]
        M[i, i] = mass[i]
        groups[f"floor {i + 1}"] = updyn.Group(stiffness=1e4 * K, mass=M)
    return Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])


def measure(model: Model, rng: np.random.Generator | None, n: int) -> updyn.ModeSet:
    """Return the lowest modes at all DOFs, with noise if there is a generator."""
    found = updyn.modes(model, n)
    shapes = found.shapes.real
    rms = np.sqrt(np.mean(shapes**2, axis=0))
    std_frequency = STD_FREQUENCY * found.frequency
    std_shapes = np.broadcast_to(STD_SHAPE * rms, shapes.shape)
    frequency = found.frequency
    if rng is not None:
        frequency = frequency + std_frequency * rng.normal(size=n)
        shapes = shapes + std_shapes * rng.normal(size=shapes.shape)
    return updyn.ModeSet(
        frequency, shapes, model.dofs, std_frequency=std_frequency, std_shapes=std_shapes
    )


def draw(rng: np.random.Generator, n: int) -> np.ndarray:
    """Return factors on the parts of a structure, of a random size about `ERROR`."""
    return np.exp(ERROR * rng.uniform(0.2, 1.5) * rng.normal(size=n))


def join(stated: updyn.Acceptance, true: updyn.Acceptance) -> Iterator[tuple[str, float, bool]]:
    """Yield kind, stated probability and truth of each requirement.

    Requirements are those of a computed mode, as noise can exchange the order of measured ones;
    models that have not the same number of pairs with and without noise are left out.
    """
    ranks = [sorted({r.computed for r in found.requirements}) for found in (stated, true)]
    if len(ranks[0]) != len(ranks[1]):
        return
    truth = {(r.kind, ranks[1].index(r.computed)): r.outcome == "pass" for r in true.requirements}
    for one in stated.requirements:
        key = one.kind, ranks[0].index(one.computed)
        if one.kind in KINDS and key in truth:
            yield one.kind, one.probability, truth[key]


def study_model(seed: int) -> list[tuple[str, float, bool]]:
    """Return the requirements of a model as it is."""
    rng = np.random.default_rng([seed, 1])
    n = int(rng.choice([5, 8]))
    model, structure = build(n, np.ones(n), np.ones(n)), build(n, draw(rng, n), draw(rng, n))
    stated = updyn.accept(model, measure(structure, rng, N_MODES), LIMITS)
    true = updyn.accept(model, measure(structure, None, N_MODES), LIMITS)
    return list(join(stated, true))


def study_update(seed: int) -> list[tuple[str, float, bool]]:
    """Return the requirements of a model updated to a test before the structure was changed."""
    rng = np.random.default_rng([seed, 2])
    n = 5
    stiffness, mass = np.exp(0.1 * rng.normal(size=n)), np.ones(n)
    before = build(n, stiffness, mass)
    after = build(n, stiffness * draw(rng, n), mass * draw(rng, n))
    model = build(n, np.ones(n), mass)
    unknowns = updyn.parameters(model, stiffness="all")
    result = updyn.update(model, measure(before, rng, n), unknowns, method="modal")
    stated = updyn.accept(result, measure(after, rng, N_MODES), LIMITS)
    true = updyn.accept(before, measure(after, None, N_MODES), LIMITS)
    return list(join(stated, true))


def print_table(found: list[tuple[str, float, bool]]) -> None:
    """Print the reliability table in Markdown."""
    print("| stated | requirements | mean stated | truly met | 95 % interval |")
    print("|---|---|---|---|---|")
    for low, high in itertools.pairwise(EDGES):
        bin_ = [(p, met) for _, p, met in found if low <= p < high]
        n, met = len(bin_), sum(met for _, met in bin_)
        if not n:
            continue
        ends = beta.ppf([0.025, 0.975], [met, met + 1], [n - met + 1, n - met])
        ends = np.nan_to_num(ends, nan=float(met == n))
        mean = np.mean([p for p, _ in bin_])
        text = f"{ends[0]:.3f} to {ends[1]:.3f}"
        print(f"| {low:g} to {high:g} | {n} | {mean:.3f} | {met / n:.3f} | {text} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("n", nargs="?", type=int, default=200, help="models of each kind")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", UpdynWarning)
    for name, study in (("models", study_model), ("updates", study_update)):
        found = [one for seed in range(arguments.n) for one in study(seed)]
        print(f"\n{name}: {arguments.n}, {len(found)} requirements\n")
        print_table(found)
        for kind in KINDS:
            of_kind = [(p, met) for k, p, met in found if k == kind and 0.001 < p < 0.999]
            if not of_kind:
                continue
            stated, met = np.mean(of_kind, axis=0)
            print(f"{kind}: {len(of_kind)}, mean stated {stated:.3f}, truly met {met:.3f}")


if __name__ == "__main__":
    main()
