"""Multi-start search for the basin of attraction in which a local fit starts.

The log error has the widest basin of all residuals (measured: benchmarks/basin.py). It is widened
by three things. Loss factors start inflated, so that the model's resonances are broad enough to
overlap the measured ones, and may pass through negative values on the way: a bound at zero stops
most searches for lightly damped parts, whose true values lie on it. And a basin is accepted only
when further tries, with other inflations and then from random points, end in it too. Where they do
not, tries go on beside the best end. A basin that is found on few lines is mostly that of all, so
that a try goes down on few and ends on all; where these leave more than noise, tries go down on
all. (Measured and left out: going up in frequency, where the few low lines let the unknowns run
away; going from smoothed FRFs to sharp ones, which takes twice the steps; a common factor on all
stiffnesses, chosen beforehand so that the frequency axes agree, which finds no more.)

Where there are several workers and the lines of one evaluation are too few to be worth spreading,
whole tries run in them, ahead of their turn. What they evaluated is remembered, and the tries are
then made here as ever: the answer and its history do not depend on the workers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from updyn.errors import SolverError
from updyn.updating.fit.belief import SAME, Belief
from updyn.updating.fit.method import Starts, descend
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.null_space import resolve
from updyn.updating.fit.trust_region import Outcome, TrustRegion
from updyn.updating.problem.local import Local
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import Residual, is_cached, log_error, with_prior
from updyn.updating.problem.session import Recent, Record, Session, Stopped

__all__ = ["MOST_STARTS", "SEARCH_LINES", "SEARCH_STEPS", "Search", "coarse", "scattered"]

_Vector = NDArray[np.float64]
_Found: TypeAlias = "tuple[list[tuple[bytes, Record]], int]"
_Points: TypeAlias = "Generator[_Vector, None, None]"
_Attempt: TypeAlias = "Callable[[Problem, tuple[Search, _Vector]], _Found]"

#: A basin is as wide on some hundred lines as on thousands; more are thinned to this many while it
#: is sought.
SEARCH_LINES = 400
#: A try goes down on about so many of them, and on so many numbers for each unknown.
_FEW, _NUMBERS = 32, 4
#: Largest number of tries: each is a descent, and the starts of all are drawn at once.
MOST_STARTS = 10_000
#: Largest number of steps of a try.
SEARCH_STEPS = 60

#: Loss factors of the first tries. 0.3 is best on average, the others reach part of what it misses.
_INFLATED = (0.3, 0.1, 1.0)
#: How far tries beside a point begin from it, in turn: in logarithms of factors; loss factors.
_BESIDE, _BESIDE_LOSS = (0.1, 0.2), 0.02
#: Every so many of them begin with one unknown put back to its start.
_BY_TURNS = 3
#: Tries that begin in a point itself go down on these shares of the lines first, in turn: any, or
#: neighbours.
_ANY, _NEIGHBOURS = 1.0 / 3.0, 0.5
#: So many for each of the tries are enough, where they find nothing better.
_HOPS_A_TRY = 2
#: After so many tries whose ends cannot be the answer, a fault of the data may be why.
_DOUBTED = 3
#: The best of the tries goes on for so many times their steps.
_LONG = 5
#: How often as many tries are made.
_SEARCHES = 3
#: The ends of tries that are fitted: those within this factor of the least cost, at most so many.
_WORTH, _KEPT = 1.5, 4
#: Unknowns with a larger standard deviation than this are moved.
_UNSURE = 0.01
#: Largest number of unknowns that are moved.
_HOPS = 6
#: How far they are moved, in standard deviations.
_FAR = 8.0
#: How often.
_ROUNDS = 2
#: Stop a try when the remaining decrease is below 0.01 standard deviations.
_ENOUGH = 1e-5


@dataclass(frozen=True, slots=True)
class Search:
    """Multi-start log-error search.

    Parameters
    ----------
    starts : int
        Largest number of tries.
    max_iterations : int
        Steps a try.
    spread : float
        Random tries move factors by up to this, in logarithm, and by twice as much; where none of
        them explains the data and no two agree, as many more begin farther off.
    seed : int
        Of the random tries.
    inflate : bool
        Whether loss factors start inflated; else every try begins with those of the start.
    """

    starts: int = 8
    max_iterations: int = SEARCH_STEPS
    spread: float = 0.5
    seed: int = 0
    inflate: bool = True

    @property
    def _settings(self) -> TrustRegion:
        return TrustRegion(self.max_iterations, 1e-9, radius=0.3, relative_fall=_ENOUGH)

    def run(self, problem: Problem, noises: Sequence[NoiseModel], monitor: Monitor) -> Starts:
        """Return where the tries ended that are worth a fit, least log error first.

        The points are within the bounds.

        Parameters
        ----------
        problem : Problem
            From `coarse`.
        noises : sequence of NoiseModel
            How uncertain the data of each part are.
        monitor : Monitor
            Records the steps.
        """
        belief = Belief(problem, all(noise.size_known for noise in noises))
        agreed, in_vain = False, False
        ends: list[Outcome] = []
        with suppress(Stopped):  # the best so far
            for number in range(_SEARCHES):
                way, begun = _on_few_lines(problem) if number == 0 else problem, len(ends)
                starts = self._points(problem, number)
                agreed = self._tried(problem, way, starts, belief, monitor, ends)
                in_vain = not agreed and not monitor.stopped and monitor.is_in_vain()
                if agreed and way is not problem and not belief.plausible(min(ends, key=_cost)):
                    agreed = self._again(problem, belief, monitor, ends)
                if agreed or in_vain or monitor.stopped:
                    break
                self._deepen(problem, way, begun, belief, monitor, ends)
                if ends and belief.plausible(min(ends, key=_cost)):
                    break
        home = problem.coordinates.home
        found = [end.x for end in _distinct(ends)] or [home]
        points = tuple(np.clip(x, *problem.coordinates.bounds) for x in found)
        exact = agreed and belief.exact(min(ends, key=_cost))
        return Starts(points, agreed, exact, in_vain)

    def _tried(
        self,
        problem: Problem,
        way: Problem,
        starts: Iterator[_Vector],
        belief: Belief,
        monitor: Monitor,
        ends: list[Outcome],
    ) -> bool:
        """Add where tries end; return whether the best end is believed."""
        attempt = _try_on_all if way is problem else _try
        with closing(self._ahead(attempt, problem, starts, way)) as points:
            for start in points:
                outcome = self._try_from(problem, way, start, monitor)
                if outcome is not None:
                    ends.append(outcome)
                believed = belief.believed(ends)
                if monitor.stopped or believed or self._is_in_vain(belief, monitor, ends):
                    return believed
        return False

    @staticmethod
    def _is_in_vain(belief: Belief, monitor: Monitor, ends: Sequence[Outcome]) -> bool:
        """Return whether the first tries found no answer, and a fault of the data is why."""
        if len(ends) < _DOUBTED or belief.plausible(min(ends, key=_cost)):
            return False
        return monitor.is_in_vain()

    def _again(
        self, problem: Problem, belief: Belief, monitor: Monitor, ends: list[Outcome]
    ) -> bool:
        """Make the first tries again on all lines; return whether the best end is believed.

        Few lines lead tries to one end that leaves more than noise, where all lines part them.
        """
        own: list[Outcome] = []
        agreed = self._tried(problem, problem, self._points(problem), belief, monitor, own)
        ends += own
        return agreed and min(map(_cost, own)) <= min(map(_cost, ends)) * (1.0 + SAME)

    def _deepen(
        self,
        problem: Problem,
        way: Problem,
        begun: int,
        belief: Belief,
        monitor: Monitor,
        ends: list[Outcome],
    ) -> None:
        """Add the ends of further descents from the best end of a round, which began at `begun`.

        What was found in an earlier round is left alone, as what is beside it is known. Another
        basin may be nearer to the answer, though its end is not the best of all.
        """
        own = min(ends[begun:], key=_cost, default=None)
        if own is None or any(_is_same(own, end) for end in ends[:begun]):
            return
        self._go_on(problem, monitor, own, ends)
        self._hop(problem, way, min(ends[begun:], key=_cost), belief, monitor, ends)

    def _go_on(
        self, problem: Problem, monitor: Monitor, best: Outcome, ends: list[Outcome]
    ) -> None:
        """Add where a try ends if its number of steps is not limited."""
        if best.reason != "max-iterations":
            return
        longer = replace(self._settings, max_iterations=_LONG * self.max_iterations)
        end = self._relaxed_descent(problem, log_error(problem), best.x, monitor, longer)
        if end is not None:
            ends.append(end)

    def _hop(
        self,
        problem: Problem,
        way: Problem,
        best: Outcome,
        belief: Belief,
        monitor: Monitor,
        ends: list[Outcome],
    ) -> None:
        """Add the better ends of tries beside an end, and beside each better one.

        They go on until it may be the answer, or so many have not found a better one. That others
        come back to it is no sign that tries from elsewhere would; only better ones are added.
        """
        number = last = 0
        while number - last < _HOPS_A_TRY * self.starts and not (
            monitor.stopped or belief.plausible(best)
        ):
            end = self._try_beside(problem, way, best.x, number, monitor)
            number += 1
            if end is not None and end.local.cost < best.local.cost * (1.0 - SAME):
                best, last = end, number
                ends.append(best)

    def beside(self, problem: Problem, x: _Vector, number: int, monitor: Monitor) -> _Vector | None:
        """Return where a try ends that begins beside a point, shape (n,).

        Minima of the misfit stand in groups; a short way off, the next is more likely in reach than
        from a start far from all of them. Every third begins with one unknown put back to its
        start, by turns those that are far from theirs: a part whose resonance has been taken for
        another's.

        Parameters
        ----------
        problem : Problem
            From `coarse`.
        x : ndarray of float, shape (n,)
            The point.
        number : int
            Which of the tries.
        monitor : Monitor
            Records the steps.

        Returns
        -------
        ndarray or None
            None where the model cannot be solved on the way.
        """
        end = self._try_beside(problem, _on_few_lines(problem), x, number, monitor)
        return None if end is None else np.clip(end.x, *problem.coordinates.bounds)

    def _try_beside(
        self, problem: Problem, way: Problem, x: _Vector, number: int, monitor: Monitor
    ) -> Outcome | None:
        number, on_some = divmod(number, 2)
        if on_some:
            some = _on_some_lines(problem, number, self.seed)
            if some is not None:
                return self._try_from(problem, some, x, monitor)
        put_back = list(_put_back(problem, x)) if number % _BY_TURNS == _BY_TURNS - 1 else []
        if put_back:
            moved = put_back[number // _BY_TURNS % len(put_back)]
        else:
            is_factor = problem.coordinates.parameters.is_factor
            far = np.where(is_factor, _BESIDE[number % len(_BESIDE)], _BESIDE_LOSS)
            (moved,) = scattered(x, far, 1, self.seed + number)
        moved = np.clip(moved, *problem.coordinates.bounds)
        levels = self._levels(problem)
        start = _inflated(problem, moved, levels[number % len(levels)])
        return self._try_from(problem, way, start, monitor)

    def _try_from(
        self, problem: Problem, way: Problem, x: _Vector, monitor: Monitor
    ) -> Outcome | None:
        """Return where a try ends, or None where the model cannot be solved on its way.

        It goes down on the lines of `way`, and ends on all.
        """
        if way is not problem:
            with monitor.stage("search", way):
                lowest = self._relaxed_descent(way, log_error(way), x, monitor, self._settings)
            if lowest is None or monitor.stopped:
                return None
            x = lowest.x
        return self._relaxed_descent(problem, log_error(problem), x, monitor, self._settings)

    @staticmethod
    def _relaxed_descent(
        problem: Problem, residual: Residual, x: _Vector, monitor: Monitor, settings: TrustRegion
    ) -> Outcome | None:
        """Return where a descent from x ends, or None where the model cannot be solved there."""

        def evaluate(at: _Vector) -> Local | None:
            local = residual.local(problem, at)
            return None if local is None else with_prior(local, problem, at)

        first = evaluate(x)
        if first is None:
            return None
        monitor.start(x, first)
        relaxed, upper = problem.coordinates.relaxed_lower, problem.coordinates.bounds[1]
        return settings.minimise(evaluate, x, relaxed, upper, monitor.step)

    def _descend(self, problem: Problem, x: _Vector, monitor: Monitor) -> Outcome:
        return descend(problem, log_error(problem), x, monitor, self._settings)

    def _ahead(
        self, attempt: _Attempt, problem: Problem, points: Iterable[_Vector], begun: Problem
    ) -> _Points:
        """Yield starts; with several workers, the attempts from them are evaluated ahead.

        Parameters
        ----------
        attempt : callable
            The attempt from a start.
        problem : Problem
            What it is an attempt at.
        points : iterable of ndarray of float, shape (n,)
            The starts.
        begun : Problem
            What is evaluated first.
        """
        session = problem.session
        if session.engine.workers == 1 or session.memory is None or problem.spreads:
            yield from points
            return
        points, error = list(points), log_error(begun)
        known, items = [], []
        for start in points:
            cached = is_cached(error, begun, start)
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

    def _levels(self, problem: Problem) -> tuple[float, ...]:
        """Return to what loss factors are raised, by turns."""
        loss = ~problem.coordinates.parameters.is_factor
        return _INFLATED if self.inflate and loss.any() else (0.0,)

    def _points(self, problem: Problem, number: int = 0) -> Iterator[_Vector]:
        start, bounds = problem.coordinates.home, problem.coordinates.bounds
        is_factor = problem.coordinates.parameters.is_factor
        levels = self._levels(problem)
        plain = levels[: self.starts] if number == 0 else ()
        for level in plain:
            yield _inflated(problem, start, level)
        rest, far = self.starts - len(plain), self.spread * (1 + number)
        if rest > 0:
            draws = scattered(start, 1.0, rest, self.seed + number)
            for i, draw in enumerate(draws):
                moved = start + far * (1 + i % 2) * (draw - start)
                moved = np.clip(np.where(is_factor, moved, start), *bounds)
                yield _inflated(problem, moved, levels[i % len(levels)])

    def escape(self, problem: Problem, x: _Vector, monitor: Monitor) -> _Vector:
        """Look for a better minimum beside a minimum of the log error, shape (n,).

        Where noise leaves an unknown uncertain, the misfit can have several minima along it. Each
        such unknown is moved alone, well outside its own standard deviation, and all are fitted
        again from there. Moving one unknown by itself leaves the ridge of the misfit; steps along
        the ridge were measured to fall back.
        """
        best: Outcome | None = None
        try:
            if not Belief(problem).is_noise(x):
                return x
            best = self._descend(problem, x, monitor)
            for _ in range(_ROUNDS):
                before = best.local.cost
                with closing(
                    self._ahead(_descend, problem, self._neighbours(problem, best), problem)
                ) as points:
                    for start in points:
                        if monitor.stopped:
                            return best.x
                        other = self._descend(problem, start, monitor)
                        if other.local.cost < best.local.cost * (1.0 - SAME):
                            best = other
                if best.local.cost == before:
                    break
        except Stopped:
            pass  # the best so far
        return x if best is None else best.x

    @staticmethod
    def _neighbours(problem: Problem, at: Outcome) -> Iterator[_Vector]:
        unit = np.sqrt(2.0 * at.local.cost / max(2 * problem.n_values - problem.n, 1))
        found = resolve(at.local.R / unit)
        std = np.where(found.involved, 0.0, np.sqrt(np.diag(found.covariance)))
        for i in np.argsort(-std)[:_HOPS]:
            if std[i] > _UNSURE:
                for sign in (1.0, -1.0):
                    value = at.x[i] + sign * min(_FAR * std[i], 1.0)
                    yield problem.coordinates.with_one(at.x, i, value)


def _inflated(problem: Problem, x: _Vector, level: float) -> _Vector:
    """Return x with loss factors raised to a level; higher ones and bounds are kept."""
    loss = ~problem.coordinates.parameters.is_factor
    return np.where(loss, np.clip(np.maximum(x, level), *problem.coordinates.bounds), x)


def _put_back(problem: Problem, x: _Vector) -> Iterator[_Vector]:
    """Yield points with one unknown of x put back to its start, the farthest from it first."""
    coordinates = problem.coordinates
    home = coordinates.home
    far = np.abs(x - home) / np.where(coordinates.parameters.is_factor, _BESIDE[0], _BESIDE_LOSS)
    for i in np.argsort(-far):
        if far[i] > 1.0:
            yield coordinates.with_one(x, i, home[i])


def _cost(end: Outcome) -> float:
    return end.local.cost


def _distinct(ends: list[Outcome]) -> list[Outcome]:
    """Return the ends of tries that are not much worse than the best, one of each basin."""
    found: list[Outcome] = []
    most = _WORTH * min(map(_cost, ends), default=0.0)
    for end in sorted(ends, key=_cost):
        if end.local.cost <= most and not any(_is_same(end, other) for other in found):
            found.append(end)
    return found[:_KEPT]


def _is_same(a: Outcome, b: Outcome) -> bool:
    """Whether a step from one to the other changes the residual by next to nothing."""
    moved = b.local.R @ (a.x - b.x)
    return bool(moved @ moved <= SAME * b.local.cost)


def coarse(problem: Problem, noises: Sequence[NoiseModel]) -> Problem:
    """Return the problem that is searched: some lines, whose data carry what is known of the noise.

    Parameters
    ----------
    problem : Problem
        All lines.
    noises : sequence of NoiseModel
        How uncertain the data of each part are.
    """
    parts = []
    for part, noise in zip(problem.parts, noises, strict=True):
        frf = replace(part.frf, variance=noise.beforehand(part.frf))
        parts.append(replace(part, frf=frf).thinned(SEARCH_LINES))
    return replace(problem, parts=tuple(parts))


def _on_few_lines(problem: Problem) -> Problem:
    """Return the problem on few lines; itself where it has hardly more."""
    if not problem.parts:
        return problem
    numbers = sum(2 * part.n_values / part.n_lines for part in problem.parts)
    few = max(_FEW, math.ceil(_NUMBERS * problem.n / numbers))
    if all(part.n_lines < 2 * few for part in problem.parts):
        return problem
    return problem.thinned(few)


def _on_some_lines(problem: Problem, number: int, seed: int) -> Problem | None:
    """Return the problem on a share of its lines; None where so few do not hold the unknowns.

    Where all lines have a minimum of the misfit that is not the answer, some of them mostly have
    none; the answer is a minimum on any.
    """
    if not problem.parts:
        return None
    turn, any_lines = divmod(number, 2)
    rng = np.random.default_rng([seed, turn])
    numbers = sum(2 * part.n_values / part.n_lines for part in problem.parts)
    least = math.ceil(_NUMBERS * problem.n / numbers)
    parts = []
    for part in problem.parts:
        share = _ANY if any_lines else _NEIGHBOURS
        n, some = part.n_lines, max(math.ceil(share * part.n_lines), least)
        if some >= n:
            return None
        if any_lines:
            own = np.sort(rng.choice(n, some, replace=False))
        else:
            own = round(_spread(turn) * (n - some)) + np.arange(some)
        parts.append(replace(part, frf=part.frf.select(lines=part.frf.freq[own])))
    return problem.with_parts(parts)


def _spread(turn: int) -> float:
    """Return 1/2, 1/4, 3/4, 1/8, ... by turns, each far from those before (van der Corput 1935)."""
    place, share, rest = 0.0, 0.5, turn + 1
    while rest:
        place += share * (rest % 2)
        share, rest = share / 2.0, rest // 2
    return place


def scattered(x: _Vector, far: float | _Vector, number: int, seed: int) -> NDArray[np.float64]:
    """Return points of a Latin hypercube about x, as far off as `far`, shape (number, n)."""
    from scipy.stats import qmc  # slow to load, and seldom needed

    draws = qmc.LatinHypercube(d=len(x), rng=seed).random(number)
    return np.asarray(x + far * (2.0 * draws - 1.0))


def _try(problem: Problem, item: tuple[Search, _Vector]) -> _Found:
    """Make a try that goes down on few lines elsewhere; return all that it evaluated."""
    search, start = item
    return _recorded(
        problem,
        lambda alone: search._try_from(alone, _on_few_lines(alone), start, Monitor(alone)),
    )


def _try_on_all(problem: Problem, item: tuple[Search, _Vector]) -> _Found:
    """Make a try on all lines elsewhere; return all that it evaluated."""
    search, start = item
    return _recorded(problem, lambda alone: search._try_from(alone, alone, start, Monitor(alone)))


def _descend(problem: Problem, item: tuple[Search, _Vector]) -> _Found:
    """Descend elsewhere; return all that it evaluated."""
    search, x = item
    return _recorded(problem, lambda alone: search._descend(alone, x, Monitor(alone)))


def _recorded(problem: Problem, work: Callable[[Problem], object]) -> _Found:
    memory = Recent(limit=np.inf)
    session = Session(memory=memory)
    with suppress(SolverError):  # to be met again when its turn comes
        work(problem.with_session(session))
    return memory.items, session.lines_solved
