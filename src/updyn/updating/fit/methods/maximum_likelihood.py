"""The default method: log error to find the basin, maximum likelihood to finish."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from updyn.errors import SolverError
from updyn.updating.fit.answers import (
    Answer,
    as_likely,
    elsewhere,
    equals,
    explains,
    preferred,
    put_back,
    restarted,
    weakly_held,
)
from updyn.updating.fit.method import Fit, Method, Rival, Starts, descend, known_length, stopped_at
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.search import SEARCH_STEPS, Search, coarse
from updyn.updating.fit.trust_region import TrustRegion
from updyn.updating.fit.valley import holding, valleys
from updyn.updating.problem.local import Local
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import Each, OutputError
from updyn.updating.problem.session import Stopped

__all__ = ["MaximumLikelihood"]

_Vector = NDArray[np.float64]

_ROUNDS = 12
#: A fall of half the chi-square that no one could see: a hundredth of a standard deviation.
_FALL = 5e-5
#: A first descent from a further point: at most so many steps, to a fall of half the chi-square
#: below this; it is worth a fit if it ends with a log-likelihood at most so much lower.
_GLANCE, _NEAR, _WORTH = 40, 0.1, 15.0
#: Tries that a search needs for some of them to agree.
_AGREE = 3
#: Tries beside an answer for each of those of the search, and largest number in all;
#: log-likelihoods that differ by less are those of one answer.
_A_TRY, _MOST_TRIES, _SAME = 2, 64, 0.5
#: How often they come back to it, until it is taken: where it leaves more than noise, and not.
_BACK = (6, 2)
#: How often further answers are looked for about a better one.
_HOPS = 2
#: Steps of a descent along a valley; as many as there were before, or so many, are taken in all.
_FOLLOWING, _FEWEST = 12, 50


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
    """

    max_iterations: int = 100
    tolerance: float = 1e-10
    starts: int = 8
    seed: int = 0
    inflate: bool = True

    name: ClassVar[str] = "maximum-likelihood"
    label: ClassVar[str] = "fit weighted with the noise"
    reference: ClassVar[str] = "Pintelon & Schoukens 2012; Green 1984"
    calibrates: ClassVar[bool] = True
    can_regularise: ClassVar[bool] = True
    is_likelihood: ClassVar[bool] = True
    states_noise: ClassVar[bool] = True

    @property
    def stages(self) -> tuple[tuple[str, int], ...]:
        """The search, where there is one, and the fit."""
        fit = (self.name, self.max_iterations)
        if not self.starts:
            return (fit,)
        return (("search", self.starts * min(self.max_iterations, SEARCH_STEPS)), fit)

    def search(self, problem: Problem, noises: Sequence[NoiseModel], monitor: Monitor) -> Starts:
        """Return where to begin: the best basins of the log error."""
        if not self.starts:
            return Method.search(self, problem, noises, monitor)
        rough = coarse(problem, noises)
        with monitor.stage("search", rough):
            return self._tries.run(rough, noises, monitor)

    @property
    def _tries(self) -> Search:
        return Search(
            self.starts,
            min(self.max_iterations, SEARCH_STEPS),
            seed=self.seed,
            inflate=self.inflate,
        )

    def fit(
        self, problem: Problem, noises: Sequence[NoiseModel], monitor: Monitor, x: _Vector
    ) -> Fit:
        """Fit the unknowns from x, weighted by the noise."""
        with monitor.stage(self.name):
            answer = self._answer(problem, noises, x, monitor)
            return self._judged(problem, noises, answer)

    def fit_best(
        self,
        problem: Problem,
        noises: Sequence[NoiseModel],
        monitor: Monitor,
        starts: Starts,
    ) -> Fit:
        """Fit the unknowns from all points, and look for further answers that fit as well."""
        if not self.starts:
            return self.fit(problem, noises, monitor, starts.points[0])
        first, *others = starts.points
        with monitor.stage(self.name):
            answers = [self._answer(problem, noises, first, monitor)]
            answers += self._further(problem, noises, others, monitor, answers[0])
            chosen = preferred(problem, answers)
        if not starts.exact:  # there is nothing better to find
            answers += self._beside(problem, noises, monitor, chosen, starts.agreed)
        chosen = preferred(problem, answers)
        ends: list[Answer] = []
        with monitor.stage("other answers"):
            for _ in range(_HOPS):
                others = self._elsewhere(problem, monitor, chosen)
                answers += self._further(problem, noises, others, monitor, chosen)
                before, chosen = chosen, preferred(problem, answers)
                if chosen is before:
                    break
            for _ in range(_HOPS):
                ends, reached = self._valleys(problem, noises, monitor, chosen)
                answers += reached
                before, chosen = chosen, preferred(problem, answers)
                if chosen is before:
                    break
        with monitor.stage(self.name):
            fit = self._judged(problem, noises, chosen)
        # Ends of valleys of a former answer may be less likely by now.
        as_well = [*equals(chosen, answers), *as_likely(chosen, ends)]
        rivals = [Rival(a.x, a.unlikelihood - chosen.unlikelihood) for a in as_well]
        if monitor.stopped:
            return replace(fit, reason="stopped", rivals=tuple(rivals))
        settled = self.starts < _AGREE or starts.agreed or self._explains(problem, chosen)
        if fit.reason == "converged" and not settled:
            return replace(fit, reason="unsettled", rivals=tuple(rivals))
        return replace(fit, rivals=tuple(rivals))

    def _beside(
        self,
        problem: Problem,
        noises: Sequence[NoiseModel],
        monitor: Monitor,
        best: Answer,
        agreed: bool,
    ) -> list[Answer]:
        """Return the answers of tries beside the best one, until some of them come back to it.

        Where the search agreed on it, they end as soon as it explains the data; and where none of
        so many has found a better one.
        """
        if monitor.stopped:
            return []
        rough, found = coarse(problem, noises), list[Answer]()
        back = last = 0
        explained = self._explains(problem, best)
        for number in range(_MOST_TRIES):
            if monitor.stopped or number - last == _A_TRY * self.starts:
                break
            if back >= _BACK[explained] or (explained and agreed):
                break
            x = None
            with monitor.stage("search", rough), suppress(Stopped):
                x = self._tries.beside(rough, best.x, number, monitor)
            if x is None:
                continue
            with monitor.stage(self.name):
                near = self._further(problem, noises, [x], monitor, best)
            found += near
            for answer in near:
                gained = best.unlikelihood - answer.unlikelihood
                if gained > _SAME:
                    back, last = 0, number + 1
                elif gained > -_SAME:
                    back += 1
                if gained > 0.0:
                    best, explained = answer, self._explains(problem, answer)
        return found

    @staticmethod
    def _explains(problem: Problem, answer: Answer) -> bool:
        with suppress(Stopped):
            return explains(problem, answer)
        return True

    def _elsewhere(self, problem: Problem, monitor: Monitor, at: Answer) -> list[_Vector]:
        """Return points away from an answer from which another may be reached."""

        def unlikelihood(x: _Vector) -> float:
            try:
                return _unlikelihood(problem, at.noises, x)
            except SolverError:
                return np.inf

        points: list[_Vector] = []
        with suppress(Stopped):
            most = 2 * len(monitor.history)  # no more work than the fit was
            further = elsewhere(problem, at, unlikelihood, most)
            loose = restarted(problem, at, self.seed)
            for x in chain(weakly_held(problem, at), loose, put_back(problem, at), further):
                if not any(np.array_equal(x, point) for point in points):
                    points.append(x)
        return points

    def _further(
        self,
        problem: Problem,
        noises: Sequence[NoiseModel],
        points: Sequence[_Vector],
        monitor: Monitor,
        at: Answer,
    ) -> list[Answer]:
        """Return the answers from further points, where a first descent comes near the one known.

        The first descent is weighted as the known answer is, and ends early.
        """
        found: list[Answer] = []
        settings = TrustRegion(min(_GLANCE, self.max_iterations), self.tolerance, fall=_NEAR)
        for x in points:
            if monitor.stopped:
                break
            with suppress(Stopped, SolverError):
                x = descend(problem, at.residual, x, monitor, settings).x
                here = _unlikelihood(problem, _weigh(problem, noises, x)[0], x)
                if here <= at.unlikelihood + _WORTH:
                    found.append(self._answer(problem, noises, x, monitor))
        return found

    def _valleys(
        self, problem: Problem, noises: Sequence[NoiseModel], monitor: Monitor, at: Answer
    ) -> tuple[list[Answer], list[Answer]]:
        """Return the far ends of valleys that are open, and the answers reached from there."""
        if at.local is None:
            return [], []
        lowest = at.local.cost
        settings = TrustRegion(_FOLLOWING, self.tolerance, fall=_NEAR)

        def refitted(x: _Vector, held: int) -> Answer | None:
            with suppress(SolverError):
                there = holding(problem, x, held)
                outcome = descend(there, at.residual, x, monitor, settings, relax=False)
                known, residual = _weigh(problem, noises, outcome.x)
                # The answer is a minimum with its own weights; with renewed ones, next to an error
                # of the model, it need not be.
                rise = outcome.local.cost - lowest
                least = max(_unlikelihood(problem, known, outcome.x), at.unlikelihood + rise)
                return Answer(outcome.x, "held", least, known, residual, outcome.local)
            return None

        ends, reached = list[Answer](), list[Answer]()
        most = len(monitor.history) + max(len(monitor.history), _FEWEST)
        with suppress(Stopped):
            for valley in valleys(problem, at):
                if monitor.stopped or len(monitor.history) >= most:
                    break
                if any(valley.is_covered(end.x) for end in ends):
                    continue
                end = valley.end(refitted)
                if end is not None:
                    ends.append(end)
                    reached += self._further(problem, noises, [end.x], monitor, at)
        return ends, reached

    def _answer(
        self,
        problem: Problem,
        noises: Sequence[NoiseModel],
        x: _Vector,
        monitor: Monitor,
    ) -> Answer:
        """Return where the descent from x ends, its weights renewed until it stays."""
        left, reason = self.max_iterations, "converged"
        residual, local = Each(()), None
        try:
            for number in range(_ROUNDS):
                noises, residual = _weigh(problem, noises, x)
                if monitor.stopped or left <= 0:
                    reason = "stopped" if monitor.stopped else "max-iterations"
                    break
                before = len(monitor.history)
                settings = TrustRegion(left, self.tolerance, fall=_FALL, noise=_one)
                outcome = descend(problem, residual, x, monitor, settings, relax=number == 0)
                left -= len(monitor.history) - before
                moved, x, reason, local = outcome.x - x, outcome.x, outcome.reason, outcome.local
                if reason in ("stopped", "max-iterations"):
                    break
                settled = number > 0 and np.linalg.norm(local.R @ moved) < 1e-2
                if settled or np.abs(moved).max() <= self.tolerance:
                    break
            return Answer(x, reason, _unlikelihood(problem, noises, x), noises, residual, local)
        except Stopped:
            return Answer(x, "stopped", np.inf, noises, residual, local)

    def _judged(self, problem: Problem, noises: Sequence[NoiseModel], answer: Answer) -> Fit:
        if answer.residual.errors:
            with suppress(Stopped):
                return self._judge(problem, answer.x, answer.noises, answer.residual, answer.reason)
        return stopped_at(coarse(problem, noises), answer.x)  # what the search knows of it

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


def _unlikelihood(problem: Problem, noises: Sequence[NoiseModel], x: _Vector) -> float:
    """Return minus the log-likelihood of the data and of the priors at x, but for a constant."""
    total = 0.0
    for part, noise in zip(problem.parts, noises, strict=True):
        total += noise.unlikelihood(part.responses(x), part.frf)
    centre, weight = problem.coordinates.prior
    return total + 0.5 * float(np.sum((weight * (x - centre)) ** 2))


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
