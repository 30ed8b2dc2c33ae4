"""Model error: how often a good fit raises an alarm, and how often the wrong group is named.

Gear train (60 lines, 4 sensors, 1 reference) and 12-DOF chain (60 lines, 5 x 5), proportional noise
of 1 % and 5 %, stated or estimated; and the chain with noise told by the coherence of 4, 10 and 50
averages. False alarms: all unknowns are fitted, from the truth. Named: one group at a time has a
stiffness or a mass that is wrong by 15 % and is held there, all unknowns of the other groups are
fitted; counted is how often an alarm is raised, how often the first suspect is that group, and how
often also the quantity.

    python benchmarks/alarms.py [--draws 200] [--seed 0]
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from cases import Case, chain12, gear_train

import updyn
from updyn.frf import FRF

WRONG = 1.15


def at_truth(case: Case) -> Case:
    """The case started at the truth."""
    return Case(case.name, case.true, case.true, case.clean)


def false_alarms(
    case: Case, relative: float, stated: bool, draws: int, seed: int
) -> tuple[int, dict[str, int]]:
    """Number of alarms, and of each outcome."""
    rng, outcomes = np.random.default_rng(seed), dict[str, int]()
    for _ in range(draws):
        noise = {"relative": relative} if stated else None
        result = updyn.update(
            case.start, case.noisy(relative, rng), case.unknowns, noise=noise, starts=0
        )
        outcome = "none" if result.adequacy is None else result.adequacy.outcome
        outcomes[outcome] = outcomes.get(outcome, 0) + 1
    return sum(outcomes.get(k, 0) for k in ("structure", "excess")), outcomes


def averaged(case: Case, n: int, rng: np.random.Generator) -> FRF:
    """H1 and coherence of n averages of random inputs with output noise, reference by reference."""
    clean = case.clean.select(references=case.clean.references[:2])
    H = clean.values

    def circular(*shape: int) -> np.ndarray:
        return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2.0)

    X = circular(n, len(H), 1, H.shape[2])
    size = np.hypot(0.03 * np.abs(H), 0.0015 * np.sqrt(np.mean(np.abs(H) ** 2, axis=0)))
    Y = H * X + size * circular(n, *H.shape)
    Sxx = np.mean(np.abs(X) ** 2, axis=0)
    Sxy = np.mean(X.conj() * Y, axis=0)
    Syy = np.mean(np.abs(Y) ** 2, axis=0)
    coherence = np.abs(Sxy) ** 2 / (Sxx * Syy)
    return FRF(
        clean.freq,
        Sxy / Sxx,
        clean.responses,
        clean.references,
        clean.quantity,
        coherence=coherence,
        averages=n,
    )


def false_alarms_of_averages(
    case: Case, n: int, draws: int, seed: int
) -> tuple[int, dict[str, int]]:
    """Number of alarms, and of each outcome, with noise told by coherence."""
    rng, outcomes = np.random.default_rng(seed), dict[str, int]()
    for _ in range(draws):
        result = updyn.update(case.start, averaged(case, n, rng), case.unknowns, starts=0)
        outcome = "none" if result.adequacy is None else result.adequacy.outcome
        outcomes[outcome] = outcomes.get(outcome, 0) + 1
    return sum(outcomes.get(k, 0) for k in ("structure", "excess")), outcomes


def named(
    case: Case, relative: float, stated: bool, draws: int, seed: int
) -> dict[str, np.ndarray]:
    """Shares of draws with an alarm, the right group first, and the right quantity."""
    rng, out = np.random.default_rng(seed), {}
    for group in case.true.groups:
        others = [name for name in case.true.groups if name != group]
        for quantity in ("stiffness", "mass"):
            start = case.true.scaled({group: {quantity: 1.0 / WRONG}})
            unknowns = updyn.parameters(start, stiffness=others, mass=others, loss_factor=others)
            counts = np.zeros(3)
            for _ in range(draws):
                noise = {"relative": relative} if stated else None
                result = updyn.update(
                    start, case.noisy(relative, rng), unknowns, noise=noise, starts=0
                )
                found = result.adequacy
                if found is None or found.adequate:
                    continue
                first = found.explained_by[0] if found.explained_by else None
                right = first is not None and first.group == group
                counts += [1, right, right and first.quantity == quantity]
            out[f"{group}.{quantity}"] = counts / draws
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    begun = time.perf_counter()
    for case in map(at_truth, (gear_train(), chain12())):
        for relative in (0.01, 0.05):
            for stated in (True, False):
                alarms, outcomes = false_alarms(case, relative, stated, chosen.draws, chosen.seed)
                how = "stated" if stated else "estimated"
                print(
                    f"{case.name}, {100 * relative:g} % noise, {how}: {alarms} alarms of"
                    f" {chosen.draws} {outcomes}"
                )
    chain = at_truth(chain12())
    for n in (4, 10, 50):
        alarms, outcomes = false_alarms_of_averages(chain, n, chosen.draws, chosen.seed)
        print(
            f"chain, coherence of {n} averages: {alarms} alarms of {chosen.draws} {outcomes}",
            flush=True,
        )
    few = max(chosen.draws // 20, 1)
    for case in map(at_truth, (gear_train(), chain12())):
        for stated in (True, False):
            shares = named(case, 0.01, stated, few, chosen.seed)
            for name, (alarm, group, quantity) in shares.items():
                print(
                    f"{case.name}, 1 % noise, {'stated' if stated else 'estimated'}, {name} wrong"
                    f" by 15 %: alarm {100 * alarm:.0f} %, group named {100 * group:.0f} %,"
                    f" quantity too {100 * quantity:.0f} %"
                )
    print(f"{time.perf_counter() - begun:.0f} s")


if __name__ == "__main__":
    main()
