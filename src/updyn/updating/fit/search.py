"""Multi-start search for the basin of attraction of a local fit.

The log error has the widest basin of all residuals (benchmarks/basin.py). Three measures widen it:
inflated loss factors make resonances overlap the measured ones, loss factors may become negative on
the way (a bound at zero stops most searches), and a basin is accepted only if further tries end in
it. A try descends on few lines and ends on all. (Measured and rejected: increasing frequencies,
because few low lines let the unknowns diverge; smoothed FRFs first, twice the steps; a common
stiffness factor that aligns the frequency axes, no gain.)

With several workers, tries are evaluated ahead and cached, then repeated in order, so the answer
and its history do not depend on the workers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from updyn.arrays import RealArray
from updyn.errors import SolverError
from updyn.updating.fit.acceptance import Acceptance
from updyn.updating.fit.method import Starts, descend
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.null_space import resolve
from updyn.updating.fit.settings import ACCEPTANCE, FURTHER_ANSWERS, SEARCH, TRY_STARTS
from updyn.updating.fit.trust_region import Outcome, TrustRegion
from updyn.updating.problem.local import Local
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import Residual, add_prior, is_cached, make_log_error
from updyn.updating.problem.session import RecentCache, Record, Session, Stopped

__all__ = [
    "Search",
    "draw_latin_hypercube",
    "scatter_points",
    "thin_problem",
]

_Found: TypeAlias = "tuple[list[tuple[bytes, Record]], int]"
_Points: TypeAlias = "Generator[RealArray, None, None]"
_Attempt: TypeAlias = "Callable[[Problem, tuple[Search, RealArray]], _Found]"


@dataclass(frozen=True, slots=True)
class Search:
    """Multi-start search by log error, with at most `starts` tries of `max_iterations` steps.

    Random tries move factors by up to `spread`, in logarithm, and by twice as much. Without
    `inflate`, every try begins with the loss factors of the start.
    """

    starts: int = 8
    max_iterations: int = SEARCH.steps
    spread: float = 0.5
    seed: int = 0
    inflate: bool = True

    @property
    def _settings(self) -> TrustRegion:
        return TrustRegion(
            self.max_iterations, 1e-9, radius=0.3, min_relative_decrease=SEARCH.negligible_decrease
        )

    def run(self, problem: Problem, noises: Sequence[NoiseModel], monitor: Monitor) -> Starts:
        """Return the ends of tries worth a fit, by increasing log error, for a `thin_problem`."""
        acceptance = Acceptance(problem, all(noise.size_known for noise in noises))
        agreed, data_fault = False, False
        ends: list[Outcome] = []
        with suppress(Stopped):  # return the best so far
            for number in range(SEARCH.most_rounds):
                thinned, first_new = (
                    _select_few_lines(problem) if number == 0 else problem,
                    len(ends),
                )
                starts = self._draw_starts(problem, number)
                agreed = self._run_tries(problem, thinned, starts, acceptance, monitor, ends)
                data_fault = not agreed and not monitor.stopped and monitor.has_data_fault()
                if (
                    agreed
                    and thinned is not problem
                    and not acceptance.is_plausible(min(ends, key=_cost))
                ):
                    agreed = self._repeat_on_all_lines(problem, acceptance, monitor, ends)
                if agreed or data_fault or monitor.stopped:
                    break
                self._refine_best(problem, thinned, first_new, acceptance, monitor, ends)
                if ends and acceptance.is_plausible(min(ends, key=_cost)):
                    break
        home = problem.coordinates.start
        found = [end.x for end in _select_distinct(ends)] or [home]
        points = tuple(np.clip(x, *problem.coordinates.bounds) for x in found)
        exact = agreed and acceptance.is_exact(min(ends, key=_cost))
        return Starts(points, agreed, exact, data_fault)

    def _run_tries(
        self,
        problem: Problem,
        thinned: Problem,
        starts: Iterator[RealArray],
        acceptance: Acceptance,
        monitor: Monitor,
        ends: list[Outcome],
    ) -> bool:
        """Append the ends of tries to `ends`; return whether the best end is accepted."""
        attempt = _try_on_all if thinned is problem else _try
        with closing(self._evaluate_ahead(attempt, problem, starts, thinned)) as points:
            for start in points:
                outcome = self._try_from(problem, thinned, start, monitor)
                if outcome is not None:
                    ends.append(outcome)
                is_accepted = acceptance.is_accepted(ends)
                if (
                    monitor.stopped
                    or is_accepted
                    or self._has_data_fault(acceptance, monitor, ends)
                ):
                    return is_accepted
        return False

    @staticmethod
    def _has_data_fault(acceptance: Acceptance, monitor: Monitor, ends: Sequence[Outcome]) -> bool:
        """Return whether the first tries found no answer because of a fault of the data."""
        if len(ends) < SEARCH.tries_before_doubt or acceptance.is_plausible(min(ends, key=_cost)):
            return False
        return monitor.has_data_fault()

    def _repeat_on_all_lines(
        self, problem: Problem, acceptance: Acceptance, monitor: Monitor, ends: list[Outcome]
    ) -> bool:
        """Repeat the first tries on all lines; return whether the best end is accepted."""
        # On few lines, tries can agree on an end whose residual is more than noise, although they
        # end apart on all lines.
        new_ends: list[Outcome] = []
        agreed = self._run_tries(
            problem, problem, self._draw_starts(problem), acceptance, monitor, new_ends
        )
        ends += new_ends
        return agreed and min(map(_cost, new_ends)) <= min(map(_cost, ends)) * (
            1.0 + ACCEPTANCE.same_basin_share
        )

    def _refine_best(
        self,
        problem: Problem,
        thinned: Problem,
        first_new: int,
        acceptance: Acceptance,
        monitor: Monitor,
        ends: list[Outcome],
    ) -> None:
        """Append the ends of further descents from the best end of the latest round."""
        # Another basin may be nearer to the answer even if its end is not the best of all. Ends
        # before `first_new`, of earlier rounds, are omitted, because their neighbourhood is known.
        best = min(ends[first_new:], key=_cost, default=None)
        if best is None or any(_is_same(best, end) for end in ends[:first_new]):
            return
        self._continue_best(problem, monitor, best, ends)
        self._search_nearby(
            problem, thinned, min(ends[first_new:], key=_cost), acceptance, monitor, ends
        )

    def _continue_best(
        self, problem: Problem, monitor: Monitor, best: Outcome, ends: list[Outcome]
    ) -> None:
        """Append the end of a try continued with a larger number of steps."""
        if best.reason != "max-iterations":
            return
        longer = replace(
            self._settings, max_iterations=SEARCH.continued_ratio * self.max_iterations
        )
        end = self._relaxed_descent(problem, make_log_error(problem), best.x, monitor, longer)
        if end is not None:
            ends.append(end)

    def _search_nearby(
        self,
        problem: Problem,
        thinned: Problem,
        best: Outcome,
        acceptance: Acceptance,
        monitor: Monitor,
        ends: list[Outcome],
    ) -> None:
        """Append the better ends of tries near an end, and near each better one."""
        # Tries that return to an end are not appended: they do not confirm it as tries from
        # elsewhere would.
        number = last = 0
        while number - last < TRY_STARTS.nearby_ratio * self.starts and not (
            monitor.stopped or acceptance.is_plausible(best)
        ):
            end = self._try_nearby(problem, thinned, best.x, number, monitor)
            number += 1
            if end is not None and end.local.cost < best.local.cost * (
                1.0 - ACCEPTANCE.same_basin_share
            ):
                best, last = end, number
                ends.append(best)

    def try_nearby(
        self, problem: Problem, x: RealArray, number: int, monitor: Monitor
    ) -> RealArray | None:
        """Return the end, shape (n,), of try `number` near x, or None if the model is singular."""
        # Minima of the misfit occur in groups, so the next one is more likely near than far. Every
        # third try resets one unknown to its start: the resonance of a part may have been taken
        # for that of another.
        end = self._try_nearby(problem, _select_few_lines(problem), x, number, monitor)
        return None if end is None else np.clip(end.x, *problem.coordinates.bounds)

    def _try_nearby(
        self, problem: Problem, thinned: Problem, x: RealArray, number: int, monitor: Monitor
    ) -> Outcome | None:
        number, on_some = divmod(number, 2)
        if on_some:
            some = _select_some_lines(problem, number, self.seed)
            if some is not None:
                return self._try_from(problem, some, x, monitor)
        resets = (
            list(_reset_single_unknowns(problem, x))
            if number % TRY_STARTS.reset_period == TRY_STARTS.reset_period - 1
            else []
        )
        if resets:
            moved = resets[number // TRY_STARTS.reset_period % len(resets)]
        else:
            is_factor = ~problem.coordinates.parameters.is_damping
            far = np.where(
                is_factor,
                TRY_STARTS.nearby_logs[number % len(TRY_STARTS.nearby_logs)],
                TRY_STARTS.nearby_loss,
            )
            (moved,) = scatter_points(x, far, 1, self.seed + number)
        moved = np.clip(moved, *problem.coordinates.bounds)
        levels = self._loss_levels(problem)
        start = _raise_loss_factors(problem, moved, levels[number % len(levels)])
        return self._try_from(problem, thinned, start, monitor)

    def _try_from(
        self, problem: Problem, thinned: Problem, x: RealArray, monitor: Monitor
    ) -> Outcome | None:
        """Return the end of a try on few lines, then all, or None if the model cannot be solved."""
        if thinned is not problem:
            with monitor.stage("search", thinned):
                lowest = self._relaxed_descent(
                    thinned, make_log_error(thinned), x, monitor, self._settings
                )
            if lowest is None or monitor.stopped:
                return None
            x = lowest.x
        return self._relaxed_descent(problem, make_log_error(problem), x, monitor, self._settings)

    @staticmethod
    def _relaxed_descent(
        problem: Problem, residual: Residual, x: RealArray, monitor: Monitor, settings: TrustRegion
    ) -> Outcome | None:
        """Return the end of a descent from x, or None if the model cannot be solved at x."""

        def evaluate(at: RealArray) -> Local | None:
            local = residual.local(problem, at)
            return None if local is None else add_prior(local, problem, at)

        first = evaluate(x)
        if first is None:
            return None
        monitor.start(x, first)
        relaxed, upper = problem.coordinates.relaxed_lower, problem.coordinates.bounds[1]
        return settings.minimise(evaluate, x, relaxed, upper, monitor.step)

    def _descend(self, problem: Problem, x: RealArray, monitor: Monitor) -> Outcome:
        return descend(problem, make_log_error(problem), x, monitor, self._settings)

    def _evaluate_ahead(
        self,
        attempt: _Attempt,
        problem: Problem,
        points: Iterable[RealArray],
        evaluated_first: Problem,
    ) -> _Points:
        """Yield starts; with several workers, first problems of attempts are evaluated ahead."""
        session = problem.session
        if session.engine.workers == 1 or session.cache is None or problem.is_distributed:
            yield from points
            return
        points, error = list(points), make_log_error(evaluated_first)
        known, items = [], []
        for start in points:
            cached = is_cached(error, evaluated_first, start)
            known.append(cached)
            if not cached:
                items.append((self, start))
        with closing(session.map(attempt, problem, items, spread=True)) as results:
            for start, cached in zip(points, known, strict=True):
                if not cached:
                    found, n_lines = next(results)
                    session.lines_solved += n_lines
                    session.remember(found)
                yield start

    def _loss_levels(self, problem: Problem) -> tuple[float, ...]:
        """Return the levels to which loss factors are raised, in turn."""
        loss = problem.coordinates.parameters.is_damping
        return TRY_STARTS.loss_levels if self.inflate and loss.any() else (0.0,)

    def _draw_starts(self, problem: Problem, number: int = 0) -> Iterator[RealArray]:
        start, bounds = problem.coordinates.start, problem.coordinates.bounds
        is_factor = ~problem.coordinates.parameters.is_damping
        levels = self._loss_levels(problem)
        plain = levels[: self.starts] if number == 0 else ()
        for level in plain:
            yield _raise_loss_factors(problem, start, level)
        rest, far = self.starts - len(plain), self.spread * (1 + number)
        if rest > 0:
            draws = scatter_points(start, 1.0, rest, self.seed + number)
            for i, draw in enumerate(draws):
                moved = start + far * (1 + i % 2) * (draw - start)
                moved = np.clip(np.where(is_factor, moved, start), *bounds)
                yield _raise_loss_factors(problem, moved, levels[i % len(levels)])

    def escape(self, problem: Problem, x: RealArray, monitor: Monitor) -> RealArray:
        """Return a better minimum near a minimum x of the log error, shape (n,), or x itself."""
        # If noise leaves an unknown uncertain, the misfit can have several minima along it. Each
        # is moved alone: this leaves the valley of the misfit, while steps along it were measured
        # to fall back.
        best: Outcome | None = None
        try:
            if not Acceptance(problem).is_noise(x):
                return x
            best = self._descend(problem, x, monitor)
            for _ in range(SEARCH.most_escapes):
                before = best.local.cost
                with closing(
                    self._evaluate_ahead(
                        _descend, problem, self._move_uncertain_unknowns(problem, best), problem
                    )
                ) as points:
                    for start in points:
                        if monitor.stopped:
                            return best.x
                        other = self._descend(problem, start, monitor)
                        if other.local.cost < best.local.cost * (1.0 - ACCEPTANCE.same_basin_share):
                            best = other
                if best.local.cost == before:
                    break
        except Stopped:
            pass  # return the best so far
        return x if best is None else best.x

    @staticmethod
    def _move_uncertain_unknowns(problem: Problem, at: Outcome) -> Iterator[RealArray]:
        unit = np.sqrt(2.0 * at.local.cost / max(2 * problem.n_values - problem.n, 1))
        found = resolve(at.local.R / unit)
        std = np.where(found.involved, 0.0, np.sqrt(np.diag(found.covariance)))
        for i in np.argsort(-std)[: FURTHER_ANSWERS.most_moved]:
            if std[i] > FURTHER_ANSWERS.uncertain_std:
                for sign in (1.0, -1.0):
                    value = at.x[i] + sign * min(FURTHER_ANSWERS.reach_stds * std[i], 1.0)
                    yield problem.coordinates.with_coordinate(at.x, i, value)


def _raise_loss_factors(problem: Problem, x: RealArray, level: float) -> RealArray:
    """Return x with loss factors raised to a level, within bounds; higher ones are kept."""
    loss = problem.coordinates.parameters.is_damping
    return np.where(loss, np.clip(np.maximum(x, level), *problem.coordinates.bounds), x)


def _reset_single_unknowns(problem: Problem, x: RealArray) -> Iterator[RealArray]:
    """Yield points with one unknown of x reset to its start, the farthest from it first."""
    coordinates = problem.coordinates
    home = coordinates.start
    far = np.abs(x - home) / np.where(
        ~coordinates.parameters.is_damping, TRY_STARTS.nearby_logs[0], TRY_STARTS.nearby_loss
    )
    for i in np.argsort(-far):
        if far[i] > 1.0:
            yield coordinates.with_coordinate(x, i, home[i])


def _cost(end: Outcome) -> float:
    return end.local.cost


def _select_distinct(ends: list[Outcome]) -> list[Outcome]:
    """Return one end of each basin, of the tries that are not much worse than the best."""
    found: list[Outcome] = []
    most = SEARCH.fitted_cost_ratio * min(map(_cost, ends), default=0.0)
    for end in sorted(ends, key=_cost):
        if end.local.cost <= most and not any(_is_same(end, other) for other in found):
            found.append(end)
    return found[: SEARCH.most_fitted]


def _is_same(a: Outcome, b: Outcome) -> bool:
    """Return whether the step between two ends hardly changes the residual."""
    moved = b.local.R @ (a.x - b.x)
    return bool(moved @ moved <= ACCEPTANCE.same_basin_share * b.local.cost)


def thin_problem(problem: Problem, noises: Sequence[NoiseModel]) -> Problem:
    """Return the problem of the search: some lines, with the known noise as variance."""
    parts = []
    for part, noise in zip(problem.parts, noises, strict=True):
        frf = replace(part.frf, variance=noise.initial_variance(part.frf))
        parts.append(replace(part, frf=frf).thin(SEARCH.most_lines))
    return replace(problem, parts=tuple(parts))


def _select_few_lines(problem: Problem) -> Problem:
    """Return the problem on few lines; the problem itself if it has hardly more."""
    if not problem.parts:
        return problem
    numbers = sum(2 * part.n_values / part.n_lines for part in problem.parts)
    few = max(SEARCH.few_lines, math.ceil(SEARCH.numbers_per_unknown * problem.n / numbers))
    if all(part.n_lines < 2 * few for part in problem.parts):
        return problem
    return problem.thin(few)


def _select_some_lines(problem: Problem, number: int, seed: int) -> Problem | None:
    """Return the problem on a share of its lines; None if these are too few for the unknowns."""
    # A false minimum on all lines is mostly not one on a part of them; the answer is a minimum on
    # any.
    if not problem.parts:
        return None
    turn, any_lines = divmod(number, 2)
    rng = np.random.default_rng([seed, turn])
    numbers = sum(2 * part.n_values / part.n_lines for part in problem.parts)
    least = math.ceil(SEARCH.numbers_per_unknown * problem.n / numbers)
    parts = []
    for part in problem.parts:
        share = TRY_STARTS.random_share if any_lines else TRY_STARTS.band_share
        n, some = part.n_lines, max(math.ceil(share * part.n_lines), least)
        if some >= n:
            return None
        if any_lines:
            lines = np.sort(rng.choice(n, some, replace=False))
        else:
            lines = round(_van_der_corput(turn) * (n - some)) + np.arange(some)
        parts.append(replace(part, frf=part.frf.select(lines=part.frf.freq[lines])))
    return problem.with_parts(parts)


def _van_der_corput(turn: int) -> float:
    """Return 1/2, 1/4, 3/4, 1/8, ... in turn, each far from those before (van der Corput 1935)."""
    place, share, rest = 0.0, 0.5, turn + 1
    while rest:
        place += share * (rest % 2)
        share, rest = share / 2.0, rest // 2
    return place


def scatter_points(x: RealArray, far: float | RealArray, number: int, seed: int) -> RealArray:
    """Return points of a Latin hypercube of half-width `far` about x, shape (number, n)."""
    return np.asarray(x + far * (2.0 * draw_latin_hypercube(number, len(x), seed) - 1.0))


def draw_latin_hypercube(number: int, n: int, seed: int) -> RealArray:
    """Return points of the unit cube, one in each slice of each axis, shape (number, n).

    McKay, Beckman & Conover, Technometrics 21 (1979) 239-245.
    """
    # The draws of scipy.stats.qmc.LatinHypercube, without half a second for the import.
    rng = np.random.default_rng(seed).spawn(1)[0]
    inside = rng.uniform(size=(number, n))
    slices = np.tile(np.arange(1.0, number + 1.0), (n, 1))
    for axis in slices:
        rng.shuffle(axis)
    return np.asarray((slices.T - inside) / number)


def _try(problem: Problem, item: tuple[Search, RealArray]) -> _Found:
    """Make a try that descends on few lines, in a worker; return all its evaluations."""
    search, start = item
    return _record_evaluations(
        problem,
        lambda alone: search._try_from(alone, _select_few_lines(alone), start, Monitor(alone)),
    )


def _try_on_all(problem: Problem, item: tuple[Search, RealArray]) -> _Found:
    """Make a try on all lines, in a worker; return all its evaluations."""
    search, start = item
    return _record_evaluations(
        problem, lambda alone: search._try_from(alone, alone, start, Monitor(alone))
    )


def _descend(problem: Problem, item: tuple[Search, RealArray]) -> _Found:
    """Make a descent in a worker; return all its evaluations."""
    search, x = item
    return _record_evaluations(problem, lambda alone: search._descend(alone, x, Monitor(alone)))


def _record_evaluations(problem: Problem, work: Callable[[Problem], object]) -> _Found:
    memory = RecentCache(limit=np.inf)
    session = Session(cache=memory)
    with suppress(SolverError):  # raised again when the try takes its turn
        work(problem.with_session(session))
    return memory.items, session.lines_solved
