"""Profile likelihood: how well each unknown is known when all others may follow it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from updyn.engines import Engine, choose_engine
from updyn.errors import OptionError, SolverError, suggest
from updyn.uncertainty.likelihood import Likelihood, Point
from updyn.uncertainty.minima import STARTS, find_minima
from updyn.uncertainty.progress import Progress, WorkCounter
from updyn.uncertainty.restored import positions_of, restore
from updyn.updating.problem.session import Session, Stopped
from updyn.updating.result import JointResult, UpdateResult

if TYPE_CHECKING:
    from distributed import Client

__all__ = [
    "ENDS",
    "Interval",
    "Profile",
    "ProfileTracer",
    "Profiles",
    "profile",
]

_Vector = NDArray[np.float64]

#: A cost that is lower by more than this is another minimum: a tenth of a standard deviation.
_BETTER, _ROUNDS = 0.005, 3


def profile(
    result: UpdateResult | JointResult,
    names: Sequence[str] | str | None = None,
    *,
    level: float = 0.95,
    starts: int | None = None,
    seed: int = 0,
    engine: int | Client | Engine | None = None,
    callback: Callable[[Progress], bool | None] | None = None,
) -> Profiles:
    """Find intervals by profile likelihood.

    The unknown is held at one value after the other, and all others are fitted again. The interval
    holds the values at which the fit is worse by no more than half the quantile of chi-square with
    one degree of freedom, 1.92 at 95 % (Venzon & Moolgavkar, Appl. Stat. 37 (1988) 87; Raue et al.,
    Bioinformatics 25 (2009) 1923). It follows curvature that the Laplace covariance does not see,
    it may be lopsided or open, and it keeps within the bounds.

    Parameters
    ----------
    result : UpdateResult or JointResult
        A fit by ``"maximum-likelihood"``. Its noise is kept, inflation included; what
        is profiled is stated in `updyn.uncertainty.likelihood`, priors count as data.
    names : str or sequence of str, optional
        Unknowns; all where none is named.
    level : float
        Of the intervals, between 0 and 1.
    starts : int, optional
        Random starts from which more humps of the likelihood are looked for; by default 8, for
        large models none.
    seed : int
        Of these starts.
    engine : None, int, dask.distributed Client or Engine
        Where the work is done, as for `updyn.update`; the figures do not depend on it.
    callback : callable, optional
        Called with a `Progress` after every piece of work; returning True stops, and what has been
        found is returned.

    Returns
    -------
    Profiles

    Raises
    ------
    OptionError
        If an unknown or the level is not understood, or the method of the result has no likelihood.
    SolverError
        If the model cannot be solved at the estimate.

    Notes
    -----
    Where an estimate lies on a bound, the interval begins there and is one-sided. Its coverage is
    then at least `level`: a true value on the bound is covered more often, 97.5 % at 95 % (Self &
    Liang, J. Am. Stat. Assoc. 82 (1987) 605).
    """
    if not 0.0 < level < 1.0:
        raise OptionError(f"level = {level!r}: expected a share between 0 and 1, such as 0.95")
    with ExitStack() as ending:
        made = choose_engine(engine)
        if made is not engine:
            ending.callback(made.close)
        session = Session(made)
        setting = restore(result, session)
        at = positions_of(names, setting.names)
        watch = WorkCounter("profile", len(at), callback)
        watch.attach(session)
        likelihood = setting.likelihood()
        drop = 0.5 * float(chi2.ppf(level, 1))
        found: dict[int, Profile] = {}
        better: dict[str, float] = {}
        try:
            first = likelihood.descend(setting.x)
            if first is None:
                raise SolverError("the model cannot be solved at the estimate")
            more = (0 if likelihood.problem.spreads else STARTS) if starts is None else starts
            found, best = _all(likelihood, first, at, drop, (more, seed), watch)
            if best.cost < first.cost - _BETTER:
                values = likelihood.problem.coordinates.to_values(best.x)
                better = dict(zip(setting.names, values.tolist(), strict=True))
        except Stopped:
            pass  # before anything was found
    profiles = tuple(_to_values(found[k], likelihood) for k in at if k in found)
    missing = tuple(setting.names[k] for k in at if k not in found)
    return Profiles(profiles, level, drop, missing, better)


def _all(
    likelihood: Likelihood,
    best: Point,
    at: Sequence[int],
    drop: float,
    search: tuple[int, int],
    watch: WorkCounter,
) -> tuple[dict[int, Profile], Point]:
    """Profile the unknowns; where a better fit turns up on the way, from there again."""
    tops = find_minima(likelihood, best, *search, watch)
    for number in range(_ROUNDS):
        best = tops[0]
        found: dict[int, Profile] = {}
        better = best
        watch.done, watch.total = 0, len(at)
        items = [(tops, k, drop) for k in at]
        problem = likelihood.problem
        results = problem.session.map(_one, likelihood, items, spread=not problem.spreads)
        try:
            for k, (one, lowest) in zip(at, results, strict=True):
                found[k] = one
                better = lowest if lowest.cost < better.cost else better
                if watch.step(one.name):
                    break
        except Stopped:
            pass
        if watch.stopped or better.cost > best.cost - _BETTER or number == _ROUNDS - 1:
            break
        tops = [likelihood.descend(better.x) or better, *tops]
    return found, best


def _one(likelihood: Likelihood, item: tuple[Sequence[Point], int, float]) -> tuple[Profile, Point]:
    """Profile one unknown; also return the best point on the way."""
    tops, k, drop = item
    return ProfileTracer(likelihood, tops, k, drop).run()


def _to_values(found: Profile, likelihood: Likelihood) -> Profile:
    """Return a profile in the unit of its unknown."""
    coordinates = likelihood.problem.coordinates
    parameters = coordinates.parameters
    lower, upper = parameters.lower, parameters.upper
    k = parameters.names.index(found.name)

    def value(x: float) -> float:
        for bound, given in zip(likelihood.bounds, (lower, upper), strict=True):
            if abs(x - bound[k]) <= 1e-12 * max(1.0, abs(x)):
                return float(
                    given[k]
                )  # which the exponential of its logarithm may miss by the last digit
        return float(coordinates.to_values(np.full(len(parameters), x))[k])

    others = np.clip(coordinates.to_values(found.others), lower, upper)
    humps = tuple(
        Interval(value(h.lower), value(h.best), value(h.upper), h.drop) for h in found.humps
    )
    values = np.array([value(x) for x in found.values])
    return Profile(
        found.name,
        value(found.estimate),
        values,
        found.drop,
        others,
        humps,
        found.lower_end,
        found.upper_end,
    )


#: Why an interval ends where it does.
ENDS = ("level", "bound", "zero", "unsolved", "stopped")


@dataclass(frozen=True, slots=True)
class Interval:
    """A range of values that the data allow.

    Attributes
    ----------
    lower, best, upper : float
        Its ends and its most likely value, in the unit of the unknown.
    drop : float
        How much less likely that value is than the best of all, in logarithm.
    """

    lower: float
    best: float
    upper: float
    drop: float


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """The profile likelihood of one unknown.

    Attributes
    ----------
    name : str
        The unknown.
    estimate : float
        Its most likely value.
    values : ndarray of float, shape (k,)
        Values at which it was held, ascending.
    drop : ndarray of float, shape (k,)
        Fall of the logarithm of the likelihood there, all others fitted again.
    others : ndarray of float, shape (k, n)
        All unknowns there.
    humps : tuple of Interval
        Ranges that the data allow, ascending; more than one where they cannot be told apart.
    lower_end, upper_end : {"level", "bound", "zero", "unsolved"}
        Why the outermost ends are where they are: the data say so; the bound of the unknown was
        reached first, so that the data do not limit it; zero, below which no loss factor is; the
        model could not be solved further.
    """

    name: str
    estimate: float
    values: _Vector
    drop: _Vector
    others: NDArray[np.float64]
    humps: tuple[Interval, ...]
    lower_end: str
    upper_end: str

    @property
    def lower(self) -> float:
        """Lower end of the lowest range."""
        return self.humps[0].lower

    @property
    def upper(self) -> float:
        """Upper end of the highest range."""
        return self.humps[-1].upper

    @property
    def note(self) -> str:
        """What to know about the ends, in words; may be empty."""
        said = []
        sides = [
            side
            for side, end in (("lower", self.lower_end), ("upper", self.upper_end))
            if end == "bound"
        ]
        if sides:
            said.append(
                f"no {' and no '.join(sides)} end within its bounds: the data do not limit it"
            )
        if self.lower_end == "zero":
            said.append("zero is among the values that the data allow")
        if "unsolved" in (self.lower_end, self.upper_end):
            said.append("the model could not be solved further out")
        if len(self.humps) > 1:
            ranges = " and ".join(f"{h.lower:.4g} to {h.upper:.4g}" for h in self.humps)
            said.append(f"{len(self.humps)} separate ranges fit the data: {ranges}")
        return "; ".join(said)


@dataclass(frozen=True, slots=True, eq=False)
class Profiles(Mapping[str, Profile]):
    """Profile likelihoods by unknown.

    Attributes
    ----------
    items_ : tuple of Profile
        One for each unknown that was asked for.
    level : float
        Of the intervals.
    threshold : float
        Fall of the log-likelihood at their ends.
    missing : tuple of str
        Unknowns that were not reached before the caller stopped.
    better : dict of str to float
        Values of all unknowns at a fit that is better than the one that was handed in, where one
        was found on the way; the profiles are about that one then.
    """

    items_: tuple[Profile, ...]
    level: float
    threshold: float
    missing: tuple[str, ...] = ()
    better: Mapping[str, float] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Profile:
        """Return the profile of an unknown.

        Raises
        ------
        OptionError
            If it was not profiled; the nearest is named.
        """
        for one in self.items_:
            if one.name == name:
                return one
        raise OptionError(f"no profile of {name!r}; {suggest(str(name), list(self))}")

    def __iter__(self) -> Iterator[str]:
        return iter(one.name for one in self.items_)

    def __len__(self) -> int:
        return len(self.items_)

    def __contains__(self, name: object) -> bool:
        return any(one.name == name for one in self.items_)

    def __repr__(self) -> str:
        return f"Profiles({len(self)} unknowns, {100 * self.level:g} %)"

    def intervals(self) -> dict[str, tuple[float, float]]:
        """Return the outermost ends by unknown, in its unit."""
        return {one.name: (one.lower, one.upper) for one in self.items_}

    @property
    def message(self) -> str:
        """What to know of the whole, in words; may be empty."""
        said = []
        if self.better:
            said.append(
                "A better fit than the estimate was found on the way, and the profiles are about"
                " it: start the update there (`better`)."
            )
        if self.missing:
            said.append(f"Stopped before {', '.join(self.missing)}.")
        return " ".join(said)

    def summary(self) -> str:
        """Return the intervals as text."""
        width = max(28, *(len(name) + 2 for name in self)) if len(self) else 28
        percent = f"{100 * self.level:g} %"
        lines = [f"Profile likelihood, {percent} intervals", *filter(None, [self.message]), ""]
        lines.append(f"{'unknown':<{width}}{'lower':>14}{'value':>14}{'upper':>14}  note")
        for one in self.items_:
            row = (
                f"{one.name:<{width}}{one.lower:>14.6g}{one.estimate:>14.6g}{one.upper:>14.6g} "
                f" {one.note}"
            )
            lines.append(row.rstrip())
        return "\n".join(lines)

    def table(self) -> tuple[NDArray[np.float64], ...]:
        """Return estimate, lower and upper ends as arrays, each shape (n,)."""
        rows = [(one.estimate, one.lower, one.upper) for one in self.items_]
        return tuple(np.array(rows).reshape(-1, 3).T)


#: Steps between two points, in standard deviations, and how near to the level its crossing is
#: found.
_STRIDE, _CLOSE = 0.5, 2e-3
#: Largest step, as a share of the way between the bounds.
_SHARE = 0.1
_STEPS, _HALVINGS, _ROOTS = 60, 5, 40
_ROUNDING = 1e-12


@dataclass(slots=True, eq=False)
class ProfileTracer:
    """The profile of one unknown, in the optimiser's coordinates.

    Parameters
    ----------
    likelihood : Likelihood
        What is profiled.
    tops : sequence of Point
        Its minima, the best first.
    k : int
        The unknown.
    drop : float
        Fall of the log-likelihood at the ends of the interval.
    """

    likelihood: Likelihood
    tops: Sequence[Point]
    k: int
    drop: float
    _points: list[Point] = field(default_factory=list, init=False)

    @property
    def best(self) -> Point:
        """The minimum that falls are counted from."""
        return self.tops[0]

    def run(self) -> tuple[Profile, Point]:
        """Return the profile and the best point on the way."""
        humps: list[tuple[Interval, str, str]] = []
        for top in self.tops:
            if self._fall(top) < self.drop and not _within(top.x[self.k], humps):
                humps.append(self._hump(top))
        humps.sort(key=lambda h: h[0].lower)
        points = sorted(self._points, key=lambda p: p.x[self.k])
        merged = _merged(humps)
        found = Profile(
            self.likelihood.problem.coordinates.parameters.names[self.k],
            float(self.best.x[self.k]),
            np.array([p.x[self.k] for p in points]),
            np.array([p.cost - self.best.cost for p in points]),
            np.array([p.x for p in points]),
            tuple(merged),
            min(humps, key=lambda h: h[0].lower)[1],
            max(humps, key=lambda h: h[0].upper)[2],
        )
        return found, min(points, key=lambda p: p.cost)

    # -- one hump ------------------------------------------------------------------------------------------
    def _hump(self, top: Point) -> tuple[Interval, str, str]:
        """Return the range about a minimum, and why it ends on each side."""
        self._points.append(top)
        (low, why_low), (high, why_high) = (self._end(top, side) for side in (-1.0, 1.0))
        return (
            Interval(low, float(top.x[self.k]), high, top.cost - self.best.cost),
            why_low,
            why_high,
        )

    def _end(self, top: Point, side: float) -> tuple[float, str]:
        """Return where the range about a minimum ends on one side, and why."""
        bound = float(self.likelihood.bounds[0 if side < 0 else 1][self.k])
        here = top
        for _ in range(_STEPS):
            room = side * (bound - here.x[self.k])
            if room <= _ROUNDING * max(1.0, abs(bound)):
                return bound, self._name_of(side, bound)
            there = self._onward(here, side, min(self._stride(here, side), room))
            if there is None:
                return float(here.x[self.k]), "unsolved"
            self._points.append(there)
            if self._fall(there) >= self.drop:
                return self._crossing(here, there, side), "level"
            here = there
        return float(here.x[self.k]), "unsolved"

    def _name_of(self, side: float, bound: float) -> str:
        factor = self.likelihood.problem.coordinates.parameters.is_factor[self.k]
        return "zero" if side < 0 and bound == 0.0 and not factor else "bound"

    def _fall(self, point: Point) -> float:
        return point.cost - self.best.cost

    def _stride(self, here: Point, side: float) -> float:
        """Return the step after which the fall should be that of so many standard deviations more."""
        z = np.sqrt(2.0 * max(self._fall(here), 0.0)) + _STRIDE
        return min(self._reach(here, side, 0.5 * z**2), self._longest)

    @property
    def _longest(self) -> float:
        lower, upper = (b[self.k] for b in self.likelihood.bounds)
        return float(_SHARE * (upper - lower))

    def _reach(self, here: Point, side: float, fall: float) -> float:
        """Return the step to where the fall is as given, by the local model of the profile; inf where it is flat.

        Along the profile the cost is cost + g h + S h^2 / 2: g its slope by this unknown alone, as
        the others are at their minimum, and S what of its curvature the others cannot follow (the
        Schur complement).
        """
        g = side * float(here.local.gradient[self.k])
        S = float(np.sum(self._follow(here)[1] ** 2))
        left = fall - self._fall(here)
        inside = g * g + 2.0 * S * left
        if g > 0.0:  # the larger part of the sum first: S may be rounding
            return 2.0 * left / (g + float(np.sqrt(max(inside, 0.0))))
        return float((np.sqrt(max(inside, 0.0)) - g) / S) if S > 0.0 else np.inf

    def _follow(self, here: Point) -> tuple[_Vector, _Vector]:
        """Return how the others follow this unknown, by unit of it, shape (n,), and what of its column is left."""
        lower, upper = self.likelihood.bounds
        gradient, column = here.local.gradient, here.local.R[:, self.k]
        held = ((here.x <= lower) & (gradient > 0)) | ((here.x >= upper) & (gradient < 0))
        held[self.k] = True
        A = here.local.R[:, ~held]
        norms = np.linalg.norm(A, axis=0)
        scale = np.where(norms > 0, norms, 1.0)
        share = np.linalg.lstsq(A / scale, -column, rcond=1e-10)[0] / scale
        out = np.zeros(len(here.x))
        out[~held] = share
        out[self.k] = 1.0
        return out, column + A @ share

    def _onward(self, here: Point, side: float, h: float) -> Point | None:
        """Return the profile a step further out; a shorter one where the model cannot be solved there."""
        lower, upper = self.likelihood.bounds
        along = self._follow(here)[0]
        for _ in range(_HALVINGS):
            target = float(np.clip(here.x[self.k] + side * h, lower[self.k], upper[self.k]))
            moved = np.clip(here.x + along * (target - here.x[self.k]), lower, upper)
            stayed = np.array(here.x)
            moved[self.k] = stayed[self.k] = target
            for start in (moved, stayed):
                found = self.likelihood.descend(start, self.k)
                if found is not None:
                    return found
            h *= 0.5
        return None

    def _crossing(self, inside: Point, outside: Point, side: float) -> float:
        """Return where the fall is that of the level, between two points of the profile."""
        wanted, widths = np.sqrt(2.0 * self.drop), [np.inf, np.inf]
        for _ in range(_ROOTS):
            a, b = (float(p.x[self.k]) for p in (inside, outside))
            za, zb = (np.sqrt(2.0 * max(self._fall(p), 0.0)) for p in (inside, outside))
            order = (inside, outside) if wanted - za < zb - wanted else (outside, inside)
            if min(wanted - za, zb - wanted) < _CLOSE * wanted or abs(b - a) < 1e-12:
                break
            guess = (
                self._guess(order, a, b, side) if abs(b - a) <= 0.5 * widths[-2] else 0.5 * (a + b)
            )
            widths.append(abs(b - a))
            there = self._onward(order[0], 1.0, guess - float(order[0].x[self.k]))
            if there is None:
                break
            self._points.append(there)
            if self._fall(there) >= self.drop:
                outside = there
            else:
                inside = there
        # What is left is less than a hundredth of a standard deviation: the curve between is
        # straight.
        if zb - za < 1e-12:
            return b
        return float(a + (b - a) * np.clip((wanted - za) / (zb - za), 0.0, 1.0))

    def _guess(self, points: tuple[Point, Point], a: float, b: float, side: float) -> float:
        """Return where the first local model with a crossing inside the bracket puts it; else the middle.

        Where an unknown meets its bound, the profile has a kink, and only the model on that side of
        it is right.
        """
        margin = 0.02 * abs(b - a)
        low, high = min(a, b) + margin, max(a, b) - margin
        for point in points:
            guess = float(point.x[self.k]) + side * self._reach(point, side, self.drop)
            if low <= guess <= high:
                return guess
        return 0.5 * (a + b)


def _within(x: float, humps: list[tuple[Interval, str, str]]) -> bool:
    return any(h.lower <= x <= h.upper for h, _, _ in humps)


def _merged(humps: list[tuple[Interval, str, str]]) -> list[Interval]:
    """Return the ranges, those that overlap as one."""
    out: list[Interval] = []
    for hump, _, _ in humps:
        if out and hump.lower <= out[-1].upper:
            best = min(out[-1], hump, key=lambda h: h.drop)
            out[-1] = Interval(
                min(out[-1].lower, hump.lower), best.best, max(out[-1].upper, hump.upper), best.drop
            )
        else:
            out.append(hump)
    return out
