"""Profile likelihood: intervals of each unknown, with all others fitted again."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import chdtri

from updyn.arrays import RealArray
from updyn.dynamics.settings import REDUCTION
from updyn.engines import Engine, opened_engine
from updyn.errors import OptionError, SolverError, suggest
from updyn.uncertainty.counts import check_count, check_level
from updyn.uncertainty.likelihood import Likelihood, Point
from updyn.uncertainty.minima import find_minima
from updyn.uncertainty.model_error import model_error_of, model_error_remark
from updyn.uncertainty.progress import WorkCounter, WorkProgress
from updyn.uncertainty.restored import RestoredFit, find_positions, restore
from updyn.uncertainty.settings import POSTERIOR_SEARCH, PROFILES
from updyn.uncertainty.surrogate import describe_excess, run_about
from updyn.updating.fit.settings import SEARCH
from updyn.updating.problem.coordinates import Coordinates
from updyn.updating.problem.problem import Problem
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


def profile(
    result: UpdateResult | JointResult,
    names: Sequence[str] | str | None = None,
    *,
    level: float = 0.95,
    starts: int | None = None,
    seed: int = 0,
    accuracy: float = REDUCTION.accuracy,
    engine: int | Client | Engine | None = None,
    callback: Callable[[WorkProgress], bool | None] | None = None,
) -> Profiles:
    """Compute intervals by profile likelihood.

    The unknown is fixed at one value after the other, and all others are fitted again. The interval
    contains the values at which the log-likelihood is lower by at most half the quantile of
    chi-square with one degree of freedom, 1.92 at 95 % (Venzon & Moolgavkar, Appl. Stat. 37 (1988)
    87; Raue et al., Bioinformatics 25 (2009) 1923). Unlike the Laplace covariance it accounts for
    curvature; it may be asymmetric or open, and it stays within the bounds.

    Parameters
    ----------
    result : UpdateResult or JointResult
        A fit by ``"maximum-likelihood"``. Its noise is kept, inflation included, and priors
        count as data; `updyn.uncertainty.likelihood` contains the equations.
    names : str or sequence of str, optional
        Unknowns; by default all.
    level : float
        Confidence level of the intervals, between 0 and 1.
    starts : int, optional
        Random starts of a search for further minima; by default 8, for large models none.
    seed : int
        Seed of these starts.
    accuracy : float
        Large models are profiled in a reduced model about the estimate, of this error
        (`updyn.update`); it is checked at the furthest points, and the model is enriched there.
    engine : None, int, dask.distributed Client or Engine
        Where the work is done, as for `updyn.update`; the figures do not depend on it.
    callback : callable, optional
        Called with a `WorkProgress` after every piece of work; returning True stops with the
        profiles so far.

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

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> result = updyn.update(model, frf, unknowns, starts=0)
    >>> updyn.profile(result, ["part3.stiffness"])
    Profiles(1 unknowns, 95 %)
    """
    check_level(level)
    if starts is not None:
        starts = check_count("starts", starts, "starts", 0, SEARCH.most_tries)
    with opened_engine(engine) as engine_of_run:
        session = Session(engine_of_run)
        restored = restore(result, session)
        at = find_positions(names, restored.names)
        counter = WorkCounter("profile", len(at), callback)
        counter.attach(session)
        run = _ProfileRun(restored, at, 0.5 * float(chdtri(1, 1.0 - level)), starts, seed, counter)
        reduction: Mapping[str, Any] = {}
        with suppress(Stopped):  # before the first profile
            reduction = run_about(restored, accuracy, seed, run.compute)
    profiles, missing = [], []
    for k in at:
        if k in run.found:
            profiles.append(_to_values(run.found[k], restored.whole.coordinates))
        else:
            missing.append(restored.names[k])
    return Profiles(
        tuple(profiles),
        level,
        run.drop,
        tuple(missing),
        run.better,
        reduction,
        model_error_of(restored.first),
    )


@dataclass(slots=True, eq=False)
class _ProfileRun:
    """The request for profiles of some unknowns, and their results."""

    restored: RestoredFit
    at: Sequence[int]
    drop: float
    starts: int | None
    seed: int
    counter: WorkCounter
    found: dict[int, Profile] = field(default_factory=dict)
    better: dict[str, float] = field(default_factory=dict)

    def compute(self, problem: Problem) -> RealArray:
        """Profile the unknowns; return all points, (m, n), in the optimiser's coordinates."""
        restored = self.restored.with_problem(problem)
        likelihood = restored.likelihood()
        self.found, self.better = {}, {}
        first = likelihood.descend(restored.x)
        if first is None:
            raise SolverError("the model cannot be solved at the estimate")
        starts = self.starts
        if starts is None:
            starts = 0 if restored.is_reduced or problem.is_distributed else POSTERIOR_SEARCH.starts
        minima = find_minima(likelihood, first, restored.whole, starts, self.seed, self.counter)
        self.found, best = _trace_profiles(likelihood, minima, self.at, self.drop, self.counter)
        if best.cost < first.cost - PROFILES.better_cost:
            values = problem.coordinates.to_values(best.x)
            self.better = dict(zip(restored.names, values.tolist(), strict=True))
        points = [one.others for one in self.found.values()]
        return np.concatenate([np.zeros((0, problem.n)), *points])


def _trace_profiles(
    likelihood: Likelihood,
    minima: list[Point],
    at: Sequence[int],
    drop: float,
    counter: WorkCounter,
) -> tuple[dict[int, Profile], Point]:
    """Profile the unknowns, and repeat it from a better fit if one is found."""
    for number in range(PROFILES.most_rounds):
        best = minima[0]
        found: dict[int, Profile] = {}
        better = best
        counter.done, counter.total = 0, len(at)
        items = [(minima, k, drop) for k in at]
        problem = likelihood.problem
        results = problem.session.map(
            _trace_profile, likelihood, items, spread=not problem.is_distributed
        )
        try:
            for k, (one, lowest) in zip(at, results, strict=True):
                found[k] = one
                if lowest.cost < better.cost:
                    better = lowest
                if counter.step(one.name):
                    break
        except Stopped:
            pass
        is_last = counter.stopped or number == PROFILES.most_rounds - 1
        if is_last or better.cost > best.cost - PROFILES.better_cost:
            break
        minima = [likelihood.descend(better.x) or better, *minima]
    return found, best


def _trace_profile(
    likelihood: Likelihood, item: tuple[Sequence[Point], int, float]
) -> tuple[Profile, Point]:
    """Profile one unknown; also return the best point on the way."""
    minima, k, drop = item
    return ProfileTracer(likelihood, minima, k, drop).run()


def _to_values(found: Profile, coordinates: Coordinates) -> Profile:
    parameters = coordinates.parameters
    k = parameters.names.index(found.name)
    given = (parameters.lower, parameters.upper)

    def value(x: float) -> float:
        # The exponential of the logarithm of a bound may miss it by the last digit.
        for end, bound in zip(coordinates.bounds, given, strict=True):
            if abs(x - float(end[k])) <= 1e-12 * max(1.0, abs(x)):
                return float(bound[k])
        return float(coordinates.to_values(np.full(len(parameters), x))[k])

    intervals = []
    for one in found.intervals:
        intervals.append(Interval(value(one.lower), value(one.best), value(one.upper), one.drop))
    return replace(
        found,
        estimate=value(found.estimate),
        values=np.array(list(map(value, found.values))),
        others=np.clip(coordinates.to_values(found.others), parameters.lower, parameters.upper),
        intervals=tuple(intervals),
    )


# -- results -----------------------------------------------------------------------------------
#: Reasons for the end of an interval.
ENDS = ("level", "bound", "zero", "unsolved", "stopped")


@dataclass(frozen=True, slots=True)
class Interval:
    """A confidence interval about one minimum, in the unit of the unknown.

    `drop` is the decrease of the log-likelihood from the best value of all intervals to `best`.
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
        Its fixed values, ascending.
    drop : ndarray of float, shape (k,)
        Decrease of the log-likelihood there, all others fitted again.
    others : ndarray of float, shape (k, n)
        All unknowns there.
    intervals : tuple of Interval
        Confidence intervals, ascending; several if separate ranges fit the data.
    lower_end, upper_end : {"level", "bound", "zero", "unsolved"}
        Reason for the outermost ends, in this order: the likelihood has decreased to the level; the
        bound of the unknown was reached first, so the data do not limit it; the lower bound of loss
        factors was reached; the model could not be solved further.
    """

    name: str
    estimate: float
    values: RealArray
    drop: RealArray
    others: RealArray
    intervals: tuple[Interval, ...]
    lower_end: str
    upper_end: str

    @property
    def lower(self) -> float:
        """Lower end of the lowest interval."""
        return self.intervals[0].lower

    @property
    def upper(self) -> float:
        """Upper end of the highest interval."""
        return self.intervals[-1].upper

    @property
    def note(self) -> str:
        """A remark on the ends, in words; may be empty."""
        remarks = []
        open_sides = []
        if self.lower_end == "bound":
            open_sides.append("lower")
        if self.upper_end == "bound":
            open_sides.append("upper")
        if open_sides:
            sides = " and no ".join(open_sides)
            remarks.append(f"no {sides} end within its bounds: the data do not limit it")
        if self.lower_end == "zero":
            remarks.append("zero is among the values that the data allow")
        if "unsolved" in (self.lower_end, self.upper_end):
            remarks.append("the model could not be solved further out")
        if len(self.intervals) > 1:
            ranges = " and ".join(f"{h.lower:.4g} to {h.upper:.4g}" for h in self.intervals)
            remarks.append(f"{len(self.intervals)} separate ranges fit the data: {ranges}")
        return "; ".join(remarks)


@dataclass(frozen=True, slots=True, eq=False)
class Profiles(Mapping[str, Profile]):
    """Profile likelihoods by unknown.

    Attributes
    ----------
    items_ : tuple of Profile
        One for each requested unknown.
    level : float
        Confidence level of the intervals.
    threshold : float
        Decrease of the log-likelihood at their ends.
    missing : tuple of str
        Unknowns that were not reached before the caller stopped.
    better : dict of str to float
        Values of all unknowns at a better fit than the given one, if one was found; the profiles
        are then about that fit.
    reduction : dict
        Of a reduced model: ``basis``, its size; ``error``, the largest error of a receptance at the
        furthest points, as a share of the largest of its line; ``accuracy``, the accepted one.
    model_error : float
        Share of the residual of the update that errors of the model explain; the intervals do not
        include these.
    """

    items_: tuple[Profile, ...]
    level: float
    threshold: float
    missing: tuple[str, ...] = ()
    better: Mapping[str, float] = field(default_factory=dict)
    reduction: Mapping[str, Any] = field(default_factory=dict)
    model_error: float = 0.0

    def __getitem__(self, name: str) -> Profile:
        """Return the profile of an unknown; OptionError if it was not profiled."""
        for profile in self.items_:
            if profile.name == name:
                return profile
        raise OptionError(f"no profile of {name!r}; {suggest(str(name), list(self))}")

    def __iter__(self) -> Iterator[str]:
        return iter([profile.name for profile in self.items_])

    def __len__(self) -> int:
        return len(self.items_)

    def __contains__(self, name: object) -> bool:
        return name in list(self)

    def __repr__(self) -> str:
        return f"Profiles({len(self)} unknowns, {100 * self.level:g} %)"

    def intervals(self) -> dict[str, tuple[float, float]]:
        """Return the outermost ends by unknown, in its unit."""
        return {profile.name: (profile.lower, profile.upper) for profile in self.items_}

    @property
    def message(self) -> str:
        """A remark on all profiles, in words; may be empty."""
        remarks = []
        if self.better:
            remarks.append(
                "A better fit than the estimate was found on the way, and the profiles are about"
                " it: start the update there (`better`)."
            )
        if self.missing:
            remarks.append(f"Stopped before {', '.join(self.missing)}.")
        if errs := describe_excess(self.reduction, "the furthest points"):
            remarks.append(errs)
        if noise_only := model_error_remark(self.model_error):
            remarks.append(noise_only)
        return " ".join(remarks)

    def summary(self) -> str:
        """Return the intervals as text."""
        width = max([26, *map(len, self)]) + 2
        lines = [f"Profile likelihood, {100 * self.level:g} % intervals"]
        if self.message:
            lines.append(self.message)
        lines += ["", f"{'unknown':<{width}}{'lower':>14}{'value':>14}{'upper':>14}  note"]
        for one in self.items_:
            row = f"{one.name:<{width}}{one.lower:>14.6g}{one.estimate:>14.6g}{one.upper:>14.6g}"
            lines.append(f"{row}  {one.note}".rstrip())
        return "\n".join(lines)

    def table(self) -> tuple[RealArray, ...]:
        """Return estimate, lower and upper ends as arrays, each shape (n,)."""
        rows = [(one.estimate, one.lower, one.upper) for one in self.items_]
        return tuple(np.array(rows).reshape(-1, 3).T)


# -- tracing -----------------------------------------------------------------------------------

#: An interval and the reasons for its lower and its upper end.
_EndedInterval = tuple["Interval", str, str]


@dataclass(slots=True, eq=False)
class ProfileTracer:
    """Traces the profile of unknown `k`, in the optimiser's coordinates.

    From each of the `minima`, the lowest first, it goes outwards on both sides until the
    log-likelihood has decreased by `drop`, or a bound is reached.
    """

    likelihood: Likelihood
    minima: Sequence[Point]
    k: int
    drop: float
    _points: list[Point] = field(default_factory=list, init=False)

    @property
    def best(self) -> Point:
        """The lowest minimum."""
        return self.minima[0]

    def run(self) -> tuple[Profile, Point]:
        """Return the profile and the best point on the way."""
        found: list[_EndedInterval] = []
        for minimum in self.minima:
            is_known = any(one.lower <= minimum.x[self.k] <= one.upper for one, _, _ in found)
            if self._drop(minimum) < self.drop and not is_known:
                found.append(self._find_interval(minimum))
        found.sort(key=lambda ended: ended[0].lower)
        points = sorted(self._points, key=lambda point: point.x[self.k])
        others = np.array([point.x for point in points])
        drop = np.array(list(map(self._drop, points)))
        profile = Profile(
            name=self.likelihood.problem.coordinates.parameters.names[self.k],
            estimate=float(self.best.x[self.k]),
            values=others[:, self.k].copy(),
            drop=drop,
            others=others,
            intervals=tuple(_merge_intervals([interval for interval, _, _ in found])),
            lower_end=found[0][1],
            upper_end=max(found, key=lambda ended: ended[0].upper)[2],
        )
        return profile, min(points, key=lambda point: point.cost)

    # -- one interval --------------------------------------------------------------------------
    def _find_interval(self, minimum: Point) -> _EndedInterval:
        """Return the interval about a minimum, and the reason for its end on each side."""
        self._points.append(minimum)
        low, why_low = self._find_end(minimum, -1.0)
        high, why_high = self._find_end(minimum, 1.0)
        best = float(minimum.x[self.k])
        return Interval(low, best, high, self._drop(minimum)), why_low, why_high

    def _find_end(self, minimum: Point, side: float) -> tuple[float, str]:
        """Return the end of the interval about a minimum on one side, and the reason."""
        lower, upper = self.likelihood.bounds
        bound = float(upper[self.k])
        if side < 0:
            bound = float(lower[self.k])
        point = minimum
        for _ in range(PROFILES.most_points):
            room = side * (bound - point.x[self.k])
            if room <= PROFILES.rounding * max(1.0, abs(bound)):
                return bound, self._bound_kind(side, bound)
            next_point = self._advance(point, side, min(self._next_step(point, side), room))
            if next_point is None:
                return float(point.x[self.k]), "unsolved"
            self._points.append(next_point)
            if self._drop(next_point) >= self.drop:
                return self._find_crossing(point, next_point, side), "level"
            point = next_point
        return float(point.x[self.k]), "unsolved"

    def _bound_kind(self, side: float, bound: float) -> str:
        """Return whether a bound is the zero of a loss factor or another bound."""
        is_factor = ~self.likelihood.problem.coordinates.parameters.is_damping[self.k]
        if side < 0 and bound == 0.0 and not is_factor:
            return "zero"
        return "bound"

    def _drop(self, point: Point) -> float:
        return point.cost - self.best.cost

    def _next_step(self, point: Point, side: float) -> float:
        """Return the step to the next point, `_STEP` standard deviations further."""
        z = np.sqrt(2.0 * max(self._drop(point), 0.0)) + PROFILES.step
        lower, upper = self.likelihood.bounds
        largest = float(PROFILES.most_step_share * (upper[self.k] - lower[self.k]))
        return min(self._step_to(point, side, 0.5 * z**2), largest)

    def _step_to(self, point: Point, side: float, drop: float) -> float:
        """Return the step to a given drop by the local model, or inf for a flat profile."""
        # Along the profile the cost is cost + g h + S h^2 / 2, with its slope g by this unknown
        # alone, as the others are at their minimum, and the Schur complement S of its curvature.
        g = side * float(point.local.gradient[self.k])
        S = float(np.sum(self._tangent(point)[1] ** 2))
        remaining = drop - self._drop(point)
        root = float(np.sqrt(max(g * g + 2.0 * S * remaining, 0.0)))
        if g > 0.0:  # this form of the root does not divide by S, which may be rounding
            return 2.0 * remaining / (g + root)
        if S <= 0.0:
            return np.inf
        return (root - g) / S

    def _tangent(self, point: Point) -> tuple[RealArray, RealArray]:
        """Return the derivative of all unknowns by this one along the profile, and R times it."""
        lower, upper = self.likelihood.bounds
        gradient, column = point.local.gradient, point.local.R[:, self.k]
        is_fixed = ((point.x <= lower) & (gradient > 0)) | ((point.x >= upper) & (gradient < 0))
        is_fixed[self.k] = True
        A = point.local.R[:, ~is_fixed]
        norms = np.linalg.norm(A, axis=0)
        scale = np.where(norms > 0, norms, 1.0)
        share = np.linalg.lstsq(A / scale, -column, rcond=1e-10)[0] / scale
        out = np.zeros(len(point.x))
        out[~is_fixed] = share
        out[self.k] = 1.0
        return out, column + A @ share

    def _advance(self, point: Point, side: float, h: float) -> Point | None:
        """Return the profile after a step, shortened while the model cannot be solved there."""
        lower, upper = self.likelihood.bounds
        along = self._tangent(point)[0]
        for _ in range(PROFILES.most_halvings):
            target = float(np.clip(point.x[self.k] + side * h, lower[self.k], upper[self.k]))
            along_tangent = np.clip(point.x + along * (target - point.x[self.k]), lower, upper)
            others_unchanged = np.array(point.x)
            along_tangent[self.k] = others_unchanged[self.k] = target
            for start in (along_tangent, others_unchanged):
                found = self.likelihood.descend(start, self.k)
                if found is not None:
                    return found
            h *= 0.5
        return None

    def _find_crossing(self, inside: Point, outside: Point, side: float) -> float:
        """Return the value at which the drop reaches the level, between two points."""
        wanted = np.sqrt(2.0 * self.drop)
        widths = [np.inf, np.inf]
        for _ in range(PROFILES.most_crossing_points):
            a, za = float(inside.x[self.k]), self._distance(inside)
            b, zb = float(outside.x[self.k]), self._distance(outside)
            is_near = min(wanted - za, zb - wanted) < PROFILES.crossing_tolerance * wanted
            if is_near or abs(b - a) < PROFILES.rounding:
                break
            nearest, other = outside, inside
            if wanted - za < zb - wanted:
                nearest, other = inside, outside
            guess = 0.5 * (a + b)
            if abs(b - a) <= 0.5 * widths[-2]:  # else the bracket shrinks too slowly: bisect
                guess = self._guess_crossing((nearest, other), a, b, side)
            widths.append(abs(b - a))
            trial = self._advance(nearest, 1.0, guess - float(nearest.x[self.k]))
            if trial is None:
                break
            self._points.append(trial)
            if self._drop(trial) >= self.drop:
                outside = trial
            else:
                inside = trial
        # The bracket is below a hundredth of a standard deviation: interpolate linearly.
        if zb - za < PROFILES.rounding:
            return b
        return float(a + (b - a) * np.clip((wanted - za) / (zb - za), 0.0, 1.0))

    def _distance(self, point: Point) -> float:
        """Return the drop as a number of standard deviations."""
        return float(np.sqrt(2.0 * max(self._drop(point), 0.0)))

    def _guess_crossing(
        self, points: tuple[Point, Point], a: float, b: float, side: float
    ) -> float:
        """Return the crossing by the first local model that has one inside the bracket."""
        # Return the middle of the bracket if none has. If another unknown meets its bound, the
        # profile has a kink, and only the model on the same side of it is right.
        margin = 0.02 * abs(b - a)
        low, high = min(a, b) + margin, max(a, b) - margin
        for point in points:
            guess = float(point.x[self.k]) + side * self._step_to(point, side, self.drop)
            if low <= guess <= high:
                return guess
        return 0.5 * (a + b)


def _merge_intervals(intervals: Sequence[Interval]) -> list[Interval]:
    """Return the intervals, ascending in their lower end, with overlapping ones merged."""
    out: list[Interval] = []
    for one in intervals:
        if not out or one.lower > out[-1].upper:
            out.append(one)
            continue
        last = out[-1]
        best = min(last, one, key=lambda interval: interval.drop)
        lower, upper = min(last.lower, one.lower), max(last.upper, one.upper)
        out[-1] = Interval(lower, best.best, upper, best.drop)
    return out
