"""Bayesian sampling of the posterior, by the ensemble sampler emcee with moves from what the fit knows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, logsumexp

from updyn.dynamics.fields import ACCURACY
from updyn.engines import Engine, choose_engine
from updyn.errors import OptionError, SolverError
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.likelihood import Gaussian, Likelihood, Point, furthest
from updyn.uncertainty.minima import STARTS, find_minima
from updyn.uncertainty.progress import Progress, WorkCounter
from updyn.uncertainty.restored import RestoredFit, restore
from updyn.uncertainty.surrogate import Surrogate, reduced_about
from updyn.updating.problem.session import Session, Stopped
from updyn.updating.result import JointResult, UpdateResult

if TYPE_CHECKING:
    from distributed import Client

__all__ = [
    "CHAINS_AGREE",
    "Mixture",
    "diagnose",
    "sample",
]

_Vector = NDArray[np.float64]

#: Independent ensembles; steps before draws count, and of a round.
_ENSEMBLES, _WARM, _ROUND = 4, 40, 25
#: Share of steps that propose from the mixture of Gaussians, by differences of walkers, and by
#: these with snooker.
_MOVES = (0.7, 0.2, 0.1)
#: A chain has to be so many times as long as its correlation.
_LONG = 20
#: Times that a reduced model is mended where its draws went, and draws at which its error is taken.
_MENDINGS, _CHECKED = 2, 4


@dataclass(frozen=True, slots=True, eq=False)
class _Ensemble:
    """The state of one ensemble between two rounds.

    Attributes
    ----------
    coords : ndarray of float, shape (n_walkers, n)
        Walkers, in the optimiser's coordinates.
    log_prob : ndarray of float, shape (n_walkers,)
        Logarithm of the density there.
    random : tuple
        State of the random numbers.
    """

    coords: NDArray[np.float64]
    log_prob: _Vector
    random: Any


def sample(
    result: UpdateResult | JointResult,
    n: int = 1000,
    seed: int = 0,
    *,
    starts: int | None = None,
    max_evaluations: int = 200_000,
    accuracy: float = ACCURACY,
    engine: int | Client | Engine | None = None,
    callback: Callable[[Progress], bool | None] | None = None,
) -> Draws:
    """Draw from the posterior of the unknowns.

    Parameters
    ----------
    result : UpdateResult or JointResult
        A fit by ``"maximum-likelihood"``. Its noise is kept, inflation included.
    n : int
        Wanted: effective draws of every unknown, in the bulk and in the tails.
    seed : int
        Of all random numbers.
    starts : int, optional
        Random starts from which more humps of the posterior are looked for before; by default 8,
        for large models none.
    max_evaluations : int
        Where to end if the draws are not enough by then.
    accuracy : float
        Large models are sampled in a reduced model about the estimate, of this error; it is checked
        at the draws that lie furthest off, and the model mended there.
    engine : None, int, dask.distributed Client or Engine
        Where the four ensembles are advanced, as for `updyn.update`; the draws do not depend on it.
    callback : callable, optional
        Called with a `Progress` after every round; returning True stops, and what has been drawn is
        returned.

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
    t, one for each hump that was found (Metropolis-Hastings), and by differences of other walkers
    (ter Braak, Stat. Comput. 16 (2006) 239; ter Braak & Vrugt, Stat. Comput. 18 (2008) 435).
    `benchmarks/samplers.py` compares this with other samplers. Split R-hat compares the ensembles;
    effective sizes are those of Vehtari et al., Bayesian Anal. 16 (2021) 667, by ArviZ.
    """
    if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 1:
        raise OptionError(f"n = {n!r}: expected a number of effective draws from 1 up")
    _check_installed()
    with ExitStack() as ending:
        made = choose_engine(engine)
        if made is not engine:
            ending.callback(made.close)
        session = Session(made)
        setting = restore(result, session)
        watch = WorkCounter("sampling", int(n), callback)
        watch.attach(session)
        run = _Run(setting, int(n), seed, starts, max_evaluations, watch)
        surrogate: Surrogate | None = None
        try:
            surrogate, run.setting = reduced_about(setting, accuracy, seed)
            run.all()
            for _ in range(0 if surrogate is None else _MENDINGS):
                far = run.furthest()
                run.error = max(surrogate.error(x) for x in far) if surrogate is not None else 0.0
                if run.error <= accuracy or surrogate is None:
                    break
                surrogate.enrich(list(far))
                run.setting = setting.with_problem(surrogate.task())
                run.all()
        except Stopped:
            pass
    return run.draws(result, surrogate, accuracy)


@dataclass(slots=True, eq=False)
class _Run:
    """Sampling, round by round."""

    setting: RestoredFit
    n: int
    seed: int
    starts: int | None
    max_evaluations: int
    watch: WorkCounter
    chains: NDArray[np.float64] | None = None
    humps: int = 1
    evaluations: int = 0
    accepted: float = 0.0
    error: float = 0.0

    @property
    def walkers(self) -> int:
        """Walkers of an ensemble: an even number, at least twice the number of unknowns."""
        return max(16, 2 * (len(self.setting.x) + 1))

    def all(self) -> None:
        """Find the humps, warm up, and draw until it is enough."""
        self.chains, self.evaluations = None, 0
        likelihood = self.setting.likelihood()
        best = likelihood.descend(self.setting.x)
        if best is None:
            raise SolverError("the model cannot be solved at the estimate")
        starts = (0 if self._is_large else STARTS) if self.starts is None else self.starts
        tops = find_minima(likelihood, best, starts, self.seed, self.watch)
        self.humps = len(tops)
        mixture = Mixture.of(likelihood, tops)
        states = self._begin(likelihood, mixture, tops)
        states, warm, _ = self._advance(likelihood, mixture, states, _WARM)
        mixture = mixture.adapted(warm[:, _WARM // 2 :].reshape(-1, warm.shape[-1]))
        rounds: list[NDArray[np.float64]] = []
        shares: list[float] = []
        while self.evaluations < self.max_evaluations:
            states, drawn, share = self._advance(likelihood, mixture, states, _ROUND)
            rounds.append(drawn)
            shares.append(share)
            self.chains, self.accepted = np.concatenate(rounds, axis=1), float(np.mean(shares))
            found = diagnose(self.chains, _ENSEMBLES)
            effective = min(found["ess_bulk"].min(), found["ess_tail"].min())
            self.watch.done = min(int(effective), self.n)
            self.watch.note = f"{effective:.0f} effective draws, R-hat {found['r_hat'].max():.3f}"
            # The effective size of chains that are short against their own correlation is not to be
            # believed.
            believed = effective * self.chains.shape[1] >= _LONG * self.chains[..., 0].size
            if self.watch.asks() or (
                effective >= self.n and believed and found["r_hat"].max() <= CHAINS_AGREE
            ):
                return

    @property
    def _is_large(self) -> bool:
        return any(part.solver.tier != "dense" for part in self.setting.problem.parts)

    def _begin(
        self, likelihood: Likelihood, mixture: Mixture, tops: Sequence[Point]
    ) -> list[_Ensemble]:
        """Return ensembles drawn from the mixture, within the bounds."""
        lower, upper = likelihood.bounds
        out = []
        for number in range(_ENSEMBLES):
            random = np.random.RandomState(
                np.random.default_rng([self.seed, number]).integers(2**32)
            )
            coords = np.clip(mixture.draw(random, self.walkers), lower, upper)
            log_prob = np.array([-likelihood.cost(x) for x in coords])
            lost = ~np.isfinite(log_prob)
            coords[lost] = tops[0].x  # a minimum can be solved
            log_prob[lost] = -tops[0].cost
            out.append(_Ensemble(coords, log_prob, random.get_state()))
        self.evaluations += _ENSEMBLES * self.walkers
        return out

    def _advance(
        self, likelihood: Likelihood, mixture: Mixture, states: list[_Ensemble], steps: int
    ) -> tuple[list[_Ensemble], NDArray[np.float64], float]:
        """Return the ensembles some steps later, the draws, shape (n_chains, steps, n), and the share accepted."""
        items = [(mixture, state, steps) for state in states]
        problem = likelihood.problem
        found = list(problem.session.map(_steps, likelihood, items, spread=not problem.spreads))
        self.evaluations += steps * self.walkers * len(states)
        chains = np.concatenate([chain.transpose(1, 0, 2) for _, chain, _ in found])
        return (
            [state for state, _, _ in found],
            chains,
            float(np.mean([share for *_, share in found])),
        )

    def furthest(self) -> NDArray[np.float64]:
        """Return the draws that lie furthest off, in the optimiser's coordinates."""
        if self.chains is None:
            return np.zeros((0, len(self.setting.x)))
        return furthest(self.chains.reshape(-1, self.chains.shape[-1]), _CHECKED)

    def draws(
        self, result: UpdateResult | JointResult, surrogate: Surrogate | None, accuracy: float
    ) -> Draws:
        """Return what was drawn, with its diagnosis."""
        coordinates = self.setting.problem.coordinates
        parameters = coordinates.parameters
        names = parameters.names
        options: dict[str, Any] = {
            "n": self.n,
            "seed": self.seed,
            "humps": self.humps,
            "evaluations": self.evaluations,
        }
        options |= {"acceptance": self.accepted, "ensembles": _ENSEMBLES}
        if surrogate is not None:
            options |= {"basis": surrogate.size, "error": self.error, "accuracy": accuracy}
        estimate = coordinates.to_values(self.setting.x) + 0.0
        std = np.array([self.setting.first.std[name] for name in names])
        about = (estimate, std, parameters.lower, parameters.upper, parameters.is_factor)
        if self.chains is None:
            none = np.zeros((1, 0, len(names)))
            text = "Stopped before there was a draw."
            return Draws(
                "sampling", tuple(names), none, *about, {}, {}, False, text, options, result
            )
        values = coordinates.to_values(self.chains)
        found = diagnose(values, _ENSEMBLES)
        said = self._said(found, names, surrogate, accuracy)
        more = [
            f"{self.humps} separate ranges of values fit the data; both the draws and their shares"
            " cover them."
        ]
        text = " ".join(said + (more if self.humps > 1 and not said else []))
        return Draws(
            "sampling", tuple(names), values, *about, found, {}, not said, text, options, result
        )

    def _said(
        self,
        found: dict[str, _Vector],
        names: list[str],
        surrogate: Surrogate | None,
        accuracy: float,
    ) -> list[str]:
        """Return why the draws cannot be relied on, in words; nothing where they can."""
        said = []
        apart = [n for n, r in zip(names, found["r_hat"], strict=True) if not r <= CHAINS_AGREE]
        effective = np.minimum(found["ess_bulk"], found["ess_tail"])
        few = [n for n, e in zip(names, effective, strict=True) if not e >= min(self.n, 400)]
        if self.watch.stopped:
            said.append("Stopped by the caller.")
        if apart:
            said.append(
                f"Not converged: independent ensembles disagree on {', '.join(apart)} (R-hat up to "
                f"{np.nanmax(found['r_hat']):.3f}, above {CHAINS_AGREE:g})."
            )
        if few:
            said.append(f"Too few effective draws of {', '.join(few)} ({effective.min():.0f}).")
        if said and self.evaluations >= self.max_evaluations:
            said.append(
                f"Ended after {self.evaluations} evaluations; allow more by max_evaluations."
            )
        if surrogate is not None and self.error > accuracy:
            said.append(
                f"The reduced model errs by {self.error:.1g} at the furthest draws, not"
                f" {accuracy:g}."
            )
        return said


def _steps(
    likelihood: Likelihood, item: tuple[Mixture, _Ensemble, int]
) -> tuple[_Ensemble, NDArray[np.float64], float]:
    """Advance an ensemble; return its state, its draws, shape (steps, n_walkers, n), and the share accepted."""
    import emcee

    mixture, state, steps = item
    moves = [
        (emcee.moves.MHMove(mixture.propose), _MOVES[0]),
        (emcee.moves.DEMove(), _MOVES[1]),
        (emcee.moves.DESnookerMove(), _MOVES[2]),
    ]

    def log_prob(X: NDArray[np.float64]) -> _Vector:
        return np.array([-likelihood.cost(x) for x in X])

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


_Matrix = NDArray[np.float64]

#: Degrees of freedom: tails heavier than those of any posterior in bounds, at little cost near the
#: middle.
_FREEDOM = 6.0
#: Least share of a hump; more draws than this many times the unknowns are needed to learn its
#: covariance from them.
_LEAST, _ENOUGH = 0.1, 10


@dataclass(frozen=True, slots=True, eq=False)
class Mixture:
    """A density to propose from.

    Attributes
    ----------
    means : ndarray of float, shape (h, n)
        Middles of the humps.
    roots : ndarray of float, shape (h, n, n)
        Roots A of their scale matrices A A^T.
    log_volumes : ndarray of float, shape (h,)
        ln |det A|.
    shares : ndarray of float, shape (h,)
        Their weights; the sum is 1.
    """

    means: _Matrix
    roots: NDArray[np.float64]
    log_volumes: _Vector
    shares: _Vector

    @classmethod
    def of(cls, likelihood: Likelihood, tops: Sequence[Point]) -> Mixture:
        """Return the mixture of what the likelihood looks like about its minima."""
        parts = [Gaussian(likelihood, top) for top in tops]
        volumes = np.array([part.log_volume for part in parts])
        weight = np.array([-top.cost for top in tops]) + volumes
        return cls(
            np.array([part.mean for part in parts]),
            np.array([part.root for part in parts]),
            volumes,
            _floored(np.exp(weight - logsumexp(weight))),
        )

    def adapted(self, X: _Matrix) -> Mixture:
        """Return the mixture with middles, scales and shares as draws X, shape (m, n), say."""
        nearest = np.argmin(
            [_distances(X, m, A) for m, A in zip(self.means, self.roots, strict=True)], axis=0
        )
        means, roots, volumes, shares = [], [], [], []
        for k in range(len(self.means)):
            own = X[nearest == k]
            mean, root, volume = self.means[k], self.roots[k], float(self.log_volumes[k])
            if len(np.unique(own, axis=0)) > _ENOUGH * X.shape[1]:
                mean = own.mean(axis=0)
                _, s, Vt = np.linalg.svd((own - mean) / np.sqrt(len(own) - 1), full_matrices=False)
                if s[-1] > 1e-8 * s[0]:
                    root, volume = Vt.T * s, float(np.sum(np.log(s)))
            means.append(mean)
            roots.append(root)
            volumes.append(volume)
            shares.append(len(own) / len(X))
        return Mixture(
            np.array(means), np.array(roots), np.array(volumes), _floored(np.array(shares))
        )

    def draw(self, random: Any, count: int) -> _Matrix:
        """Return draws, shape (count, n), with numbers from a `numpy.random.RandomState`."""
        n = self.means.shape[1]
        hump = random.choice(len(self.shares), size=count, p=self.shares)
        stretch = np.sqrt(_FREEDOM / random.chisquare(_FREEDOM, size=count))
        z = random.standard_normal((count, n)) * stretch[:, None]
        return np.asarray(self.means[hump] + np.einsum("mij,mj->mi", self.roots[hump], z))

    def log_density(self, X: _Matrix) -> _Vector:
        """Return the logarithm of the density at points X, shape (m, n), up to a constant."""
        n = X.shape[1]
        power = 0.5 * (_FREEDOM + n)
        constant = gammaln(power) - gammaln(0.5 * _FREEDOM)
        terms = [
            np.log(share) - volume - power * np.log1p(_distances(X, mean, root) / _FREEDOM)
            for mean, root, volume, share in zip(
                self.means, self.roots, self.log_volumes, self.shares, strict=True
            )
        ]
        return np.asarray(constant + logsumexp(terms, axis=0))

    def propose(self, X: _Matrix, random: Any) -> tuple[_Matrix, _Vector]:
        """Return new points for walkers at X, shape (m, n), and ln q(X) - ln q(new), as emcee asks for it."""
        new = self.draw(random, len(X))
        return new, self.log_density(X) - self.log_density(new)


def _distances(X: _Matrix, mean: _Vector, root: _Matrix) -> _Vector:
    """Return squared distances in units of the scale, shape (m,)."""
    return np.asarray(np.sum(np.linalg.solve(root, (X - mean).T) ** 2, axis=0))


def _floored(shares: _Vector) -> _Vector:
    """Return shares of which none is so small that its hump is hardly ever proposed."""
    kept = np.maximum(shares, _LEAST / len(shares))
    return np.asarray(kept / kept.sum())


#: R-hat up to which ensembles count as drawing from one density (Vehtari et al. 2021).
CHAINS_AGREE = 1.01


def diagnose(chains: NDArray[np.float64], ensembles: int) -> dict[str, _Vector]:
    """Return R-hat, effective sizes and errors by unknown.

    Parameters
    ----------
    chains : ndarray of float, shape (n_chains, n_draws, n)
        Walkers of all ensembles, those of an ensemble together.
    ensembles : int
        How many; the walkers of one know of each other, those of two do not.

    Returns
    -------
    dict of str to ndarray of float, shape (n,)
        ``r_hat`` between the ensembles, all draws of one counted as one chain; ``ess_bulk``,
        ``ess_tail``, ``mcse_mean``, ``mcse_std`` with the walkers as chains.

    Notes
    -----
    Rank-normalised split R-hat, and effective sizes: Vehtari et al., Bayesian Anal. 16 (2021) 667.
    """
    from arviz_stats.base import array_stats

    n_chains, n_draws, n = chains.shape
    by_unknown = np.moveaxis(chains, -1, 0)
    # An ensemble step by step: its halves are the early and the late draws.
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
