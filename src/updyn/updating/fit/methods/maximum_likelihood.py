"""The default method: log error to find the basin, maximum likelihood to finish."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from updyn.updating.fit.method import Fit, Method, descend, known_length, stopped_at
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.search import SEARCH_LINES, SEARCH_STEPS, Search
from updyn.updating.fit.trust_region import TrustRegion
from updyn.updating.problem.local import Local
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import Each, LogError, OutputError
from updyn.updating.problem.session import Stopped

__all__ = ["MaximumLikelihood"]

_ROUNDS = 12
#: A fall of half the chi-square that no one could see: a hundredth of a standard deviation.
_FALL = 5e-5


def _one(local: Local) -> float:
    """Return the standard deviation of residuals that are weighted with the noise."""
    return 1.0


@dataclass(frozen=True, slots=True)
class MaximumLikelihood(Method):
    """Output error weighted by the noise, r = (H_A - H_X) / sigma, after a search by log error.

    The weights follow the model, not the noisy data: they are renewed after every descent until the
    estimate stays within a hundredth of its standard deviation (iteratively reweighted least
    squares; Green, J. R. Stat. Soc. B 46 (1984) 149).

    Parameters
    ----------
    max_iterations : int
        Largest number of steps of the final fit, and of each try of the search (there at most 60).
    tolerance : float
        Relative step at which a descent has converged.
    starts : int
        Tries of the search; 0 skips it and starts from where the unknowns start.
    seed : int
        Of the search's random tries.
    inflate : bool
        Whether the loss factors of the search start inflated.
    continuation : bool
        Whether the tries of the search, but the first, go up in frequency.
    """

    max_iterations: int = 100
    tolerance: float = 1e-10
    starts: int = 8
    seed: int = 0
    inflate: bool = True
    continuation: bool = True

    name: ClassVar[str] = "maximum-likelihood"
    label: ClassVar[str] = "fit weighted with the noise"
    reference: ClassVar[str] = "Pintelon & Schoukens 2012; Green 1984"
    calibrates: ClassVar[bool] = True
    can_regularise: ClassVar[bool] = True
    is_likelihood: ClassVar[bool] = True
    states_noise: ClassVar[bool] = True

    def search(self, problem: Problem, monitor: Monitor) -> NDArray[np.float64]:
        """Return where to begin: the best basin of the log error, shape (n,)."""
        x = problem.coordinates.to_x(problem.coordinates.parameters.start)
        if self.starts:
            rough = problem.thinned(SEARCH_LINES)
            steps = min(self.max_iterations, SEARCH_STEPS)
            search = Search(
                self.starts,
                steps,
                seed=self.seed,
                inflate=self.inflate,
                continuation=self.continuation,
            )
            with monitor.stage("search", rough):
                x = search.run(rough, monitor)
            with monitor.stage("log", rough):
                if not monitor.stopped:
                    settings = TrustRegion(self.max_iterations, self.tolerance, relative_fall=1e-6)
                    with suppress(Stopped):
                        x = descend(rough, LogError(), x, monitor, settings).x
            with monitor.stage("search", rough):
                if not monitor.stopped:
                    x = search.escape(rough, x, monitor)
        return x

    def fit(
        self,
        problem: Problem,
        noises: Sequence[NoiseModel],
        monitor: Monitor,
        x: NDArray[np.float64],
    ) -> Fit:
        """Fit the unknowns from x, weighted by the noise."""
        with monitor.stage(self.name):
            x, reason, weighted = self._weighted(problem, noises, x, monitor)
            if weighted is not None:
                with suppress(Stopped):
                    return self._judge(problem, x, *weighted, reason)
            return stopped_at(problem.thinned(SEARCH_LINES), x)  # what the search knows of it

    def _weighted(
        self,
        problem: Problem,
        noises: Sequence[NoiseModel],
        x: NDArray[np.float64],
        monitor: Monitor,
    ) -> tuple[NDArray[np.float64], str, tuple[Sequence[NoiseModel], Each] | None]:
        """Return the estimate, why it ended, and the noise and weights of its last descent."""
        left, reason = self.max_iterations, "converged"
        weighted: tuple[Sequence[NoiseModel], Each] | None = None
        try:
            for number in range(_ROUNDS):
                noises, residual = _weigh(problem, noises, x)
                if monitor.stopped or left <= 0:
                    return x, "stopped" if monitor.stopped else "max-iterations", (noises, residual)
                before = len(monitor.history)
                settings = TrustRegion(left, self.tolerance, fall=_FALL, noise=_one)
                outcome = descend(problem, residual, x, monitor, settings, relax=number == 0)
                weighted = noises, residual
                left -= len(monitor.history) - before
                moved, x, reason = outcome.x - x, outcome.x, outcome.reason
                if reason in ("stopped", "max-iterations"):
                    break
                settled = number > 0 and np.linalg.norm(outcome.local.R @ moved) < 1e-2
                if settled or np.abs(moved).max() <= self.tolerance:
                    break
        except Stopped:
            reason = "stopped"
        return x, reason, weighted

    def _judge(
        self,
        problem: Problem,
        x: NDArray[np.float64],
        noises: Sequence[NoiseModel],
        residual: Each,
        reason: str,
    ) -> Fit:
        local = residual.local(problem, x)
        assert local is not None
        freedom = 2 * problem.n_values - problem.n
        # Without degrees of freedom the noise cannot be estimated from the misfit.
        chi_square = 2.0 * local.cost / freedom if freedom > 0 else 1.0
        known = known_length(
            problem, x, lambda i, H: residual.of(i).weight * (H - problem.parts[i].frf.values)
        )
        length = known.get("correlation_length", 1.0)
        # More misfit than the noise explains widens the error bars; less of it narrows them only
        # where the scale of the noise was not known. A serially correlated misfit holds less
        # information than independent noise.
        scale = max(chi_square, 1.0) if all(noise.scale_known for noise in noises) else chi_square
        inflation = float(np.sqrt(scale * length))
        record = {
            **({"chi_square": chi_square} if freedom > 0 else {}),
            **known,
            "inflation": inflation,
        }
        by_part = tuple({"kind": noise.kind, **record, **noise.figures()} for noise in noises)
        return Fit(
            x, reason, local.R / inflation if inflation > 0 else local.R, by_part, local=local
        )


def _weigh(
    problem: Problem, noises: Sequence[NoiseModel], x: NDArray[np.float64]
) -> tuple[Sequence[NoiseModel], Each]:
    """Return the noise models refitted to the residual at x, and the residual that they weight."""
    looked, errors = [], []
    for part, noise in zip(problem.parts, noises, strict=True):
        H = part.responses(x)
        # Each part pays for its share of the unknowns.
        looked.append(noise.refit(H, part.frf, -(-problem.n * part.n_values // problem.n_values)))
        errors.append(
            OutputError(np.sqrt(2.0 / looked[-1].variance(H, part.frf)), "maximum-likelihood")
        )
    return looked, Each(tuple(errors))
