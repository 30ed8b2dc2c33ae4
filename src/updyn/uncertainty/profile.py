"""Profile likelihood: how well each unknown is known when all others may follow it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from updyn.engines import Engine, choose_engine
from updyn.errors import OptionError, SolverError
from updyn.uncertainty.humps import STARTS, find_humps
from updyn.uncertainty.likelihood import Likelihood, Point
from updyn.uncertainty.profiles import Hump, Profile, Profiles
from updyn.uncertainty.setting import chosen, restore
from updyn.uncertainty.walk import Walk
from updyn.uncertainty.watch import Progress, Watch
from updyn.updating.problem.session import Session, Stopped
from updyn.updating.result import JointResult, UpdateResult

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["profile"]

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
        at = chosen(names, setting.names)
        watch = Watch("profile", len(at), callback)
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
    watch: Watch,
) -> tuple[dict[int, Profile], Point]:
    """Profile the unknowns; where a better fit turns up on the way, from there again."""
    tops = find_humps(likelihood, best, *search, watch)
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
    return Walk(likelihood, tops, k, drop).run()


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
    humps = tuple(Hump(value(h.lower), value(h.best), value(h.upper), h.drop) for h in found.humps)
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
