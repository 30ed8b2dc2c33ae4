"""Samplers on the posterior of the 12-DOF chain with 12 unknowns: effective draws an evaluation.

    python benchmarks/samplers.py [--budget 60000]

Two cases: all 25 FRFs with 5 % noise, where the posterior is all but Gaussian; and one FRF with 20
% noise, where it is curved and lopsided. Every sampler begins at draws of the Laplace approximation
and is given as many evaluations of the likelihood, after a first fifth that does not count. One
with derivatives counts as three without (measured: 2.4 ms and 0.7 ms). Printed is the smallest of
bulk and tail effective size over the unknowns (ArviZ). Needs emcee, arviz-stats, zeus-mcmc, dynesty
and mici; samplers that are not installed are left out. That size is right only of chains that are
long against their correlation: the budget must not be small.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from cases import chain12

import updyn
from updyn.uncertainty.likelihood import Gaussian, Likelihood, Point
from updyn.uncertainty.restored import restore
from updyn.uncertainty.sampling import Mixture, compute_diagnostics

WITH_SLOPES = 3
#: Independent ensembles, or chains.
GROUPS = 4
#: Draws in which the step size of NUTS is found; they do not count.
WARM = 200


@dataclass
class Target:
    """The density in coordinates in which the Laplace approximation is standard normal, counted."""

    likelihood: Likelihood
    gaussian: Gaussian
    count: int = 0
    log: list[int] = field(default_factory=list)

    @property
    def n(self) -> int:
        return len(self.gaussian.mean)

    def __call__(self, z: np.ndarray) -> float:
        self.count += 1
        return -self.likelihood.cost(self.gaussian.at(z))

    def many(self, Z: np.ndarray) -> np.ndarray:
        return np.array([self(z) for z in Z])

    def start(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Return draws of the Laplace approximation within the bounds, shape (count, n)."""
        kept: list[np.ndarray] = []
        while len(kept) < count:
            z = rng.standard_normal(self.n)
            if np.isfinite(self(z)):
                kept.append(z)
        return np.array(kept)

    def slope(self, z: np.ndarray) -> tuple[float, np.ndarray]:
        """Return minus the logarithm and its slope; beyond the bounds a wall."""
        x = self.gaussian.at(z)
        lower, upper = self.likelihood.bounds
        self.count += WITH_SLOPES
        local = self.likelihood.local(np.clip(x, lower, upper))
        if local is None or not ((x >= lower) & (x <= upper)).all():
            return np.inf, np.zeros(self.n)
        return local.cost, self.gaussian.root.T @ local.gradient


Sampler = Callable[[Target, int], tuple[np.ndarray, int]]


def emcee_with(moves: Callable[[Target], object]) -> Sampler:
    def run(target: Target, budget: int) -> tuple[np.ndarray, int]:
        import emcee

        walkers, chains = 2 * (target.n + 1), []
        steps = budget // (GROUPS * walkers)
        for seed in range(GROUPS):
            random = np.random.RandomState(seed)
            begin = target.start(np.random.default_rng(seed), walkers)
            sampler = emcee.EnsembleSampler(
                walkers, target.n, target.many, moves=moves(target), vectorize=True
            )
            start = emcee.State(begin, random_state=random.get_state())
            sampler.run_mcmc(start, steps)
            chains.append(sampler.get_chain().transpose(1, 0, 2))
        found = np.concatenate(chains)
        return found[:, steps // 5 :], GROUPS

    return run


def differences(target: Target) -> object:
    import emcee

    return [(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.2)]


def mixed(target: Target) -> object:
    """The moves of updyn, with one mode in the mixture."""
    import emcee

    n = target.n
    mixture = Mixture(np.zeros((1, n)), np.eye(n)[None], np.zeros(1), np.ones(1))
    return [
        (emcee.moves.MHMove(mixture.propose), 0.7),
        (emcee.moves.DEMove(), 0.2),
        (emcee.moves.DESnookerMove(), 0.1),
    ]


def zeus(target: Target, budget: int) -> tuple[np.ndarray, int]:
    import zeus as package

    walkers, chains = 2 * (target.n + 1), []
    for seed in range(GROUPS):
        np.random.seed(seed)  # noqa: NPY002  the only way to seed it
        begun, steps = target.count, []
        sampler = package.EnsembleSampler(walkers, target.n, target, verbose=False)
        state = target.start(np.random.default_rng(seed), walkers)
        while target.count - begun < budget // GROUPS:
            sampler.run_mcmc(state, 5, progress=False)
            steps.append(sampler.get_chain()[-5:])
            state = sampler.get_last_sample()
        chains.append(np.concatenate(steps).transpose(1, 0, 2))
    short = min(c.shape[1] for c in chains)
    found = np.concatenate([c[:, -short:] for c in chains])
    return found[:, short // 5 :], GROUPS


def mici(target: Target, budget: int) -> tuple[np.ndarray, int]:
    import mici as package

    cache: dict[bytes, tuple[float, np.ndarray]] = {}

    def at(q: np.ndarray) -> tuple[float, np.ndarray]:
        key = q.tobytes()
        if key not in cache:
            cache.clear()
            cache[key] = target.slope(q)
        return cache[key]

    system = package.systems.EuclideanMetricSystem(
        neg_log_dens=lambda q: at(q)[0], grad_neg_log_dens=lambda q: at(q)[1]
    )
    integrator = package.integrators.LeapfrogIntegrator(system)
    chains = []
    for seed in range(GROUPS):
        rng = np.random.default_rng(seed)
        sampler = package.samplers.DynamicMultinomialHMC(system, integrator, rng)
        steps: list[np.ndarray] = []
        adapter = package.adapters.DualAveragingStepSizeAdapter(0.8)
        state, before = target.start(rng, 1)[0], target.count
        final, *_ = sampler.sample_chains(
            WARM, 0, [state], adapters=[adapter], display_progress=False
        )
        state, begun, target.count = final[0], before, before
        while not steps or target.count - begun < budget // GROUPS:
            out = sampler.sample_chains(
                0, 10, [state], trace_funcs=[lambda s: {"q": s.pos}], display_progress=False
            )
            state = out.final_states[0]
            steps.append(np.array(out.traces["q"][0]))
        chains.append(np.concatenate(steps))
    short = min(len(c) for c in chains)
    return np.array([c[-short:] for c in chains]), GROUPS


def dynesty(target: Target, budget: int) -> tuple[np.ndarray, int]:
    """Nested sampling over a box of 8 standard deviations; draws are independent (Kish's size)."""
    import dynesty as package

    rng = np.random.default_rng(0)
    sampler = package.NestedSampler(
        target,
        lambda u: 16.0 * u - 8.0,
        target.n,
        nlive=max(50, budget // 700),
        sample="rwalk",
        rstate=rng,
    )
    sampler.run_nested(print_progress=False)
    found = sampler.results
    weights = np.exp(found["logwt"] - found["logz"][-1])
    weights /= weights.sum()
    size = int(1.0 / np.sum(weights**2))
    at = rng.choice(len(weights), size=size - size % GROUPS, p=weights)
    return np.asarray(found["samples"])[at].reshape(GROUPS, -1, target.n), GROUPS


SAMPLERS = {
    "emcee, stretch": emcee_with(lambda _: None),
    "emcee, differences": emcee_with(differences),
    "emcee, Laplace mixture and differences (updyn)": emcee_with(mixed),
    "zeus, slices": zeus,
    "dynesty, nested, random walks": dynesty,
    "mici, NUTS with slopes": mici,
}


def targets() -> dict[str, Callable[[], Target]]:
    case = chain12()

    def of(noise: float, few: bool) -> Target:
        data = case.noisy(noise, np.random.default_rng(0))
        if few:
            data = data.select(responses=data.responses[:1], references=data.references[-1:])
        setting = restore(updyn.update(case.start, data, case.unknowns, noise={"relative": noise}))
        likelihood = setting.likelihood()
        top = likelihood.descend(setting.x)
        assert isinstance(top, Point)
        return Target(likelihood, Gaussian(likelihood, top))

    return {
        "25 FRFs, 5 % noise": lambda: of(0.05, False),
        "1 FRF, 20 % noise": lambda: of(0.2, True),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--budget", type=int, default=60_000, help="evaluations a sampler")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    for name, make in targets().items():
        print(
            f"\n{name}\n{'sampler':<50}{'evaluations':>12}{'effective':>10}"
            f"{'R-hat':>8}{'per 1000':>10}{'per s':>8}"
        )
        target = make()
        for label, sampler in SAMPLERS.items():
            target.count, begun = 0, time.perf_counter()
            try:
                chains, groups = sampler(target, given.budget)
            except ImportError as error:
                print(f"{label:<50}{error}")
                continue
            seconds, found = time.perf_counter() - begun, compute_diagnostics(chains, groups)
            effective = float(min(found["ess_bulk"].min(), found["ess_tail"].min()))
            print(
                f"{label:<50}{target.count:>12}{effective:>10.0f}{found['r_hat'].max():>8.3f}"
                f"{1000 * effective / target.count:>10.1f}{effective / seconds:>8.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
