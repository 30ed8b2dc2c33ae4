"""Bayesian sampling of the posterior by the ensemble sampler emcee, with proposals from the fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import compress
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import gammaln, logsumexp

from updyn.arrays import RealArray
from updyn.dynamics.settings import REDUCTION
from updyn.engines import Engine, opened_engine
from updyn.errors import OptionError, SolverError
from updyn.linalg.threads import use_one_thread
from updyn.uncertainty.counts import check_count
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.likelihood import Gaussian, Likelihood, Point
from updyn.uncertainty.minima import find_minima
from updyn.uncertainty.model_error import model_error_of, model_error_remark
from updyn.uncertainty.progress import WorkCounter, WorkProgress
from updyn.uncertainty.restored import RestoredFit, restore, std_of
from updyn.uncertainty.settings import COUNT_LIMITS, MIXTURE, POSTERIOR_SEARCH, SAMPLER
from updyn.uncertainty.surrogate import describe_excess, run_about
from updyn.updating.fit.settings import SEARCH
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.session import Session, Stopped
from updyn.updating.result import JointResult, UpdateResult

if TYPE_CHECKING:
    from distributed import Client

__all__ = [
    "Mixture",
    "compute_diagnostics",
    "sample",
]


@dataclass(frozen=True, slots=True, eq=False)
class _Ensemble:
    """The state of one ensemble between two rounds: walkers, log density and random state."""

    coords: RealArray
    log_prob: RealArray
    random: Any


def sample(
    result: UpdateResult | JointResult,
    n: int = 1000,
    seed: int = 0,
    *,
    starts: int | None = None,
    max_evaluations: int = 200_000,
    accuracy: float = REDUCTION.accuracy,
    engine: int | Client | Engine | None = None,
    callback: Callable[[WorkProgress], bool | None] | None = None,
) -> Draws:
    """Draw from the posterior of the unknowns.

    Parameters
    ----------
    result : UpdateResult or JointResult
        A fit by ``"maximum-likelihood"``. Its noise is kept, inflation included.
    n : int
        Desired effective sample size of every unknown, in bulk and tails, up to a million.
    seed : int
        Seed of all random numbers.
    starts : int, optional
        Random starts of a search for further modes of the posterior; by default 8, for large models
        none.
    max_evaluations : int
        Largest number of evaluations of the likelihood, up to ten million.
    accuracy : float
        Large models are sampled in a reduced model about the estimate, of this error; it is checked
        at the furthest draws, and the model is enriched there.
    engine : None, int, dask.distributed Client or Engine
        Workers for the four ensembles, as in `updyn.update`; the draws do not depend on it.
    callback : callable, optional
        Called with a `WorkProgress` after every round; returning True stops with the draws so far.

    Returns
    -------
    Draws
        Chains are the walkers. ``converged`` and ``message`` say whether they can be relied on.

    Raises
    ------
    OptionError
        If an option is not understood, the method of the result has no likelihood, or emcee or
        arviz-stats is missing.
    SolverError
        If the model cannot be solved at the estimate.

    Notes
    -----
    The density is that of `updyn.uncertainty.likelihood`: Gaussian noise of the variance that the
    fit has found, Gaussian priors where given, else flat within the bounds, all in the logarithm of
    a factor and in a loss factor as it is. Draws are made in these coordinates, so that no Jacobian
    enters; as factors they have the density of the logarithm divided by the factor.

    Walkers of four independent ensembles move by independent proposals from a mixture of Student's
    t, one for each mode of the posterior (Metropolis-Hastings), and by differences of other walkers
    (ter Braak, Stat. Comput. 16 (2006) 239; ter Braak & Vrugt, Stat. Comput. 18 (2008) 435).
    `benchmarks/samplers.py` compares this with other samplers. Split R-hat compares the ensembles;
    effective sizes are those of Vehtari et al., Bayesian Anal. 16 (2021) 667, by ArviZ.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build().scaled(chain.TRUTH), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness=["part1", "part3"])
    >>> result = updyn.update(model, frf, unknowns, starts=0)
    >>> draws = updyn.sample(result, n=100, starts=0)
    >>> draws.converged, draws.values.shape[1]  # unknowns
    (True, 2)
    """
    n = check_count("n", n, "effective draws", 1, COUNT_LIMITS.most_draws)
    max_evaluations = check_count(
        "max_evaluations", max_evaluations, "evaluations", 0, COUNT_LIMITS.most_evaluations
    )
    if starts is not None:
        starts = check_count("starts", starts, "starts", 0, SEARCH.most_tries)
    _check_installed()
    with opened_engine(engine) as engine_of_run:
        session = Session(engine_of_run)
        restored = restore(result, session)
        counter = WorkCounter("sampling", n, callback)
        counter.attach(session)
        run = _SamplingRun(restored, n, seed, starts, max_evaluations, counter)
        with suppress(Stopped):
            run.reduction = run_about(restored, accuracy, seed, run.compute)
    return run.draws(result)


@dataclass(slots=True, eq=False)
class _SamplingRun:
    """A sampling in rounds: its options and its state."""

    restored: RestoredFit
    n: int
    seed: int
    starts: int | None
    max_evaluations: int
    counter: WorkCounter
    chains: RealArray | None = None
    n_modes: int = 1
    evaluations: int = 0
    accepted: float = 0.0
    reduction: Mapping[str, Any] = field(default_factory=dict)

    @property
    def walkers(self) -> int:
        """Number of walkers of an ensemble: even, at least twice the number of unknowns."""
        return max(16, 2 * (len(self.restored.x) + 1))

    def compute(self, problem: Problem) -> RealArray:
        """Find the modes of the posterior, warm up, and return enough draws, shape (m, n)."""
        self.restored = self.restored.with_problem(problem)
        self.chains, self.evaluations = None, 0
        likelihood = self.restored.likelihood()
        best = likelihood.descend(self.restored.x)
        if best is None:
            raise SolverError("the model cannot be solved at the estimate")
        starts = self.starts
        if starts is None:
            starts = POSTERIOR_SEARCH.starts
            if self.restored.is_reduced:
                starts = 0
        whole = self.restored.whole
        minima = find_minima(likelihood, best, whole, starts, self.seed, self.counter)
        self.n_modes = len(minima)
        mixture = Mixture.of(likelihood, minima)
        states = self._begin(likelihood, mixture, minima)
        states, warm, _ = self._advance(likelihood, mixture, states, SAMPLER.warm_up_steps)
        mixture = mixture.adapt(warm[:, SAMPLER.warm_up_steps // 2 :].reshape(-1, warm.shape[-1]))
        rounds: list[RealArray] = []
        shares: list[float] = []
        while self.evaluations < self.max_evaluations:
            states, drawn, share = self._advance(likelihood, mixture, states, SAMPLER.round_steps)
            rounds.append(drawn)
            shares.append(share)
            self.chains, self.accepted = np.concatenate(rounds, axis=1), float(np.mean(shares))
            found = compute_diagnostics(self.chains, SAMPLER.ensembles)
            effective = min(found["ess_bulk"].min(), found["ess_tail"].min())
            self.counter.done = min(int(effective), self.n)
            self.counter.note = f"{effective:.0f} effective draws, R-hat {found['r_hat'].max():.3f}"
            # The effective size is unreliable for chains that are short against their correlation.
            times = effective * self.chains.shape[1] / self.chains[..., 0].size
            is_long = times >= SAMPLER.least_length
            agree = found["r_hat"].max() <= SAMPLER.most_r_hat
            if self.counter.report() or (effective >= self.n and is_long and agree):
                break
        if self.chains is None:
            return np.zeros((0, len(self.restored.x)))
        return self.chains.reshape(-1, self.chains.shape[-1])

    def _begin(
        self, likelihood: Likelihood, mixture: Mixture, minima: Sequence[Point]
    ) -> list[_Ensemble]:
        """Return ensembles drawn from the mixture, within the bounds."""
        lower, upper = likelihood.bounds
        states = []
        for number in range(SAMPLER.ensembles):
            seed = np.random.default_rng([self.seed, number]).integers(2**32)
            random = np.random.RandomState(seed)
            coords = np.clip(mixture.draw(random, self.walkers), lower, upper)
            log_prob = _log_prob(likelihood, coords)
            lost = ~np.isfinite(log_prob)
            # The model can be solved at a minimum.
            coords[lost] = minima[0].x
            log_prob[lost] = -minima[0].cost
            states.append(_Ensemble(coords, log_prob, random.get_state()))
        self.evaluations += SAMPLER.ensembles * self.walkers
        return states

    def _advance(
        self, likelihood: Likelihood, mixture: Mixture, states: list[_Ensemble], steps: int
    ) -> tuple[list[_Ensemble], RealArray, float]:
        """Return the ensembles after some steps, their draws and the acceptance rate."""
        items = [(mixture, state, steps) for state in states]
        problem = likelihood.problem
        found = list(
            problem.session.map(_run_steps, likelihood, items, spread=not problem.is_distributed)
        )
        self.evaluations += steps * self.walkers * len(states)
        after, chains, shares = zip(*found, strict=True)
        drawn = np.concatenate([chain.transpose(1, 0, 2) for chain in chains])
        return list(after), drawn, float(np.mean(shares))

    def draws(self, result: UpdateResult | JointResult) -> Draws:
        """Return the draws with their diagnostics, and a message on limits of their use."""
        coordinates = self.restored.problem.coordinates
        parameters = coordinates.parameters
        options: dict[str, Any] = {
            "n": self.n,
            "seed": self.seed,
            "n_modes": self.n_modes,
            "evaluations": self.evaluations,
            "acceptance": self.accepted,
            "ensembles": SAMPLER.ensembles,
            **self.reduction,
        }
        none = Draws(
            kind="sampling",
            names=tuple(parameters.names),
            chains=np.zeros((1, 0, len(parameters))),
            estimate=coordinates.to_values(self.restored.x) + 0.0,
            std=std_of(self.restored.first),
            lower=parameters.lower,
            upper=parameters.upper,
            is_factor=parameters.is_log & (parameters.lower > 0.0),
            converged=False,
            message="Stopped before there was a draw.",
            options=options,
            result=result,
        )
        if self.chains is None:
            return none
        chains = coordinates.to_values(self.chains)
        diagnostics = compute_diagnostics(chains, SAMPLER.ensembles)
        problems = self._problems(diagnostics, parameters.names)
        message = " ".join(problems)
        if self.n_modes > 1 and not problems:
            message = (
                f"{self.n_modes} separate ranges of values fit the data; both the draws and their"
                " shares cover them."
            )
        noise_only = model_error_remark(model_error_of(self.restored.first))
        return replace(
            none,
            chains=chains,
            diagnostics=diagnostics,
            converged=not problems,
            message=" ".join(filter(None, [message, noise_only])),
        )

    def _problems(self, diagnostics: dict[str, RealArray], names: list[str]) -> list[str]:
        """Return reasons against the use of the draws, one sentence each."""
        problems = []
        r_hat = diagnostics["r_hat"]
        effective = np.minimum(diagnostics["ess_bulk"], diagnostics["ess_tail"])
        # A diagnostic that is nan counts against its unknown.
        disagreeing = list(compress(names, ~(r_hat <= SAMPLER.most_r_hat)))
        few = list(compress(names, ~(effective >= min(self.n, SAMPLER.reliable_draws))))
        if self.counter.stopped:
            problems.append("Stopped by the caller.")
        if disagreeing:
            problems.append(
                f"Not converged: independent ensembles disagree on {', '.join(disagreeing)} (R-hat"
                f" up to {np.nanmax(r_hat):.3f}, above {SAMPLER.most_r_hat:g})."
            )
        if few:
            problems.append(f"Too few effective draws of {', '.join(few)} ({effective.min():.0f}).")
        if problems and self.evaluations >= self.max_evaluations:
            problems.append(
                f"Ended after {self.evaluations} evaluations; allow more by max_evaluations."
            )
        errs = describe_excess(self.reduction, "the furthest draws")
        return [*problems, errs] if errs else problems


def _log_prob(likelihood: Likelihood, X: RealArray) -> RealArray:
    return np.array([-likelihood.cost(x) for x in X])


@use_one_thread
def _run_steps(
    likelihood: Likelihood, item: tuple[Mixture, _Ensemble, int]
) -> tuple[_Ensemble, RealArray, float]:
    """Return an ensemble after some steps, its draws (steps, n_walkers, n) and acceptance rate."""
    import emcee

    mixture, state, steps = item
    moves = [
        (emcee.moves.MHMove(mixture.propose), SAMPLER.mixture_weight),
        (emcee.moves.DEMove(), SAMPLER.difference_weight),
        (emcee.moves.DESnookerMove(), SAMPLER.snooker_weight),
    ]

    log_prob = partial(_log_prob, likelihood)
    sampler = emcee.EnsembleSampler(*state.coords.shape, log_prob, moves=moves, vectorize=True)
    begin = emcee.State(state.coords, log_prob=state.log_prob, random_state=state.random, copy=True)
    end = sampler.run_mcmc(begin, steps, skip_initial_state_check=True)
    after = _Ensemble(np.array(end.coords), np.array(end.log_prob), end.random_state)
    return after, np.array(sampler.get_chain()), float(np.mean(sampler.acceptance_fraction))


def _check_installed() -> None:
    try:
        import arviz_stats  # noqa: F401
        import emcee  # noqa: F401
    except ImportError as error:
        raise OptionError(
            'sampling needs emcee and arviz-stats: pip install "updyn[sampling]"'
        ) from error


# -- proposals ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Mixture:
    """A mixture of h Student's t distributions, one for each mode of the posterior.

    `means` have the shape (h, n); `roots`, shape (h, n, n), are roots A of their scale matrices A
    A^T, with `log_volumes` ln |det A|; the sum of `shares` is 1.
    """

    means: RealArray
    roots: RealArray
    log_volumes: RealArray
    shares: RealArray

    @classmethod
    def of(cls, likelihood: Likelihood, minima: Sequence[Point]) -> Mixture:
        """Return the mixture of the Gaussian approximations about the minima."""
        means, roots, volumes, costs = [], [], [], []
        for point in minima:
            gaussian = Gaussian(likelihood, point)
            means.append(gaussian.mean)
            roots.append(gaussian.root)
            volumes.append(gaussian.log_volume)
            costs.append(point.cost)
        weight = np.array(volumes) - np.array(costs)
        shares = _with_floor(np.exp(weight - logsumexp(weight)))
        return cls(np.array(means), np.array(roots), np.array(volumes), shares)

    def adapt(self, X: RealArray) -> Mixture:
        """Return the mixture with means, scales and shares estimated from draws X, shape (m, n)."""
        means, roots, volumes = map(np.array, (self.means, self.roots, self.log_volumes))
        shares = np.empty(len(means))
        nearest = np.argmin(list(map(partial(_distances, X), means, roots)), axis=0)
        for k in range(len(means)):
            nearest_draws = X[nearest == k]
            shares[k] = len(nearest_draws) / len(X)
            if len(np.unique(nearest_draws, axis=0)) <= MIXTURE.draws_per_unknown * X.shape[1]:
                continue
            means[k] = nearest_draws.mean(axis=0)
            scaled = (nearest_draws - means[k]) / np.sqrt(len(nearest_draws) - 1)
            _, s, Vt = np.linalg.svd(scaled, full_matrices=False)
            if s[-1] > 1e-8 * s[0]:
                roots[k] = Vt.T * s
                volumes[k] = np.sum(np.log(s))
        return Mixture(means, roots, volumes, _with_floor(shares))

    def draw(self, random: Any, count: int) -> RealArray:
        """Return draws, shape (count, n), by a `numpy.random.RandomState`."""
        n = self.means.shape[1]
        chosen = random.choice(len(self.shares), size=count, p=self.shares)
        freedom = MIXTURE.degrees_of_freedom
        stretch = np.sqrt(freedom / random.chisquare(freedom, size=count))
        z = random.standard_normal((count, n)) * stretch[:, None]
        return np.asarray(self.means[chosen] + np.einsum("mij,mj->mi", self.roots[chosen], z))

    def log_density(self, X: RealArray) -> RealArray:
        """Return the logarithm of the density at points X, shape (m, n), up to a constant."""
        n = X.shape[1]
        freedom = MIXTURE.degrees_of_freedom
        power = 0.5 * (freedom + n)
        constant = gammaln(power) - gammaln(0.5 * freedom)
        terms = []
        for k in range(len(self.shares)):
            distance = _distances(X, self.means[k], self.roots[k])
            level = np.log(self.shares[k]) - self.log_volumes[k]
            terms.append(level - power * np.log1p(distance / freedom))
        return np.asarray(constant + logsumexp(terms, axis=0))

    def propose(self, X: RealArray, random: Any) -> tuple[RealArray, RealArray]:
        """Return new points for walkers at X, shape (m, n), and ln q(X) - ln q(new), for emcee."""
        new = self.draw(random, len(X))
        return new, self.log_density(X) - self.log_density(new)


def _distances(X: RealArray, mean: RealArray, root: RealArray) -> RealArray:
    """Return squared Mahalanobis distances, shape (m,)."""
    return np.asarray(np.sum(np.linalg.solve(root, (X - mean).T) ** 2, axis=0))


def _with_floor(shares: RealArray) -> RealArray:
    """Return shares with a lower limit, for sufficient proposals by each component."""
    limited = np.maximum(shares, MIXTURE.least_share / len(shares))
    return np.asarray(limited / limited.sum())


# -- diagnostics -------------------------------------------------------------------------------


def compute_diagnostics(chains: RealArray, ensembles: int) -> dict[str, RealArray]:
    """Return R-hat, effective sizes and errors, shape (n,), by their name in `Draws.diagnostics`.

    For R-hat all draws of one of the `ensembles` are one chain, because its walkers depend on each
    other; for the other figures each walker is a chain. Walkers of an ensemble must be adjacent.
    Rank-normalised split R-hat and effective sizes: Vehtari et al., Bayesian Anal. 16 (2021) 667.
    """
    from arviz_stats.base import array_stats

    n_chains, n_draws, n = chains.shape
    by_unknown = np.moveaxis(chains, -1, 0)
    # All draws of an ensemble as one chain in the order of steps: early and late halves.
    walkers = by_unknown.reshape(n, ensembles, n_chains // ensembles, n_draws)
    whole = walkers.swapaxes(2, 3).reshape(n, ensembles, -1)
    axes = {"chain_axis": -2, "draw_axis": -1}
    with np.errstate(invalid="ignore", divide="ignore"):
        return {
            "r_hat": np.asarray(array_stats.rhat(whole, **axes)),
            "ess_bulk": np.asarray(array_stats.ess(by_unknown, **axes, method="bulk")),
            "ess_tail": np.asarray(
                array_stats.ess(by_unknown, **axes, method="tail", prob=(0.05, 0.95))
            ),
            "mcse_mean": np.asarray(array_stats.mcse(by_unknown, **axes, method="mean")),
            "mcse_std": np.asarray(array_stats.mcse(by_unknown, **axes, method="sd")),
        }
