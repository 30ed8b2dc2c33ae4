"""`locate_nonlinearities`: places and kinds of several local nonlinearities."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Self

from updyn.candidates.location.exact import Base, BaseFit
from updyn.candidates.location.locate import Location, Search, begin_search, compare_fits
from updyn.candidates.location.result import LocatedElement, LocatedNonlinearities
from updyn.candidates.location.settings import LOCATION
from updyn.errors import OptionError, SolverError
from updyn.frf import FRF
from updyn.model import Model
from updyn.nonlinear.element import NonlinearElement
from updyn.nonlinear.local import Place
from updyn.updating.judge.causes.settings import CAUSE_ODDS
from updyn.updating.problem.noise import NoiseChoice
from updyn.updating.problem.parameters import ParameterSet

__all__ = ["locate_nonlinearities"]


def locate_nonlinearities(
    model: Model,
    tests: Iterable[FRF],
    places: Mapping[str, Place] | None = None,
    kinds: Iterable[str] | Mapping[str, NonlinearElement] | None = None,
    *,
    unknowns: ParameterSet | None = None,
    noise: NoiseChoice = None,
    most: int = LOCATION.most_elements,
) -> LocatedNonlinearities:
    """Find places and kinds of several local nonlinearities from FRFs at several force levels.

    Parameters
    ----------
    model : Model
        As for `updyn.locate_nonlinearity`.
    tests : iterable of FRF
        Measurements of the same channels and lines at two levels or more (`FRF.with_level`), of
        more responses than `most` plus the elements of the model: all of sines or all of random
        forces.
    places : mapping of str to place, optional
        Candidates as for `updyn.locate_nonlinearity`.
    kinds : iterable of str or mapping of str to element, optional
        Candidates as for `updyn.locate_nonlinearity`.
    unknowns : ParameterSet, optional
        Unknowns of the model that are fitted, too; by default the model is used as it is.
    noise : None, str or mapping
        As for `updyn.locate_nonlinearity`.
    most : int
        Largest number of elements that are found.

    Returns
    -------
    LocatedNonlinearities
        The elements in the order in which they were found, none for a linear structure.

    Raises
    ------
    InputError
        If models, data, places or options do not fit together.
    SolverError
        If no candidate for the first element can be solved.

    Notes
    -----
    Forward selection with a backward step (Efroymson, in Ralston & Wilf, Mathematical Methods for
    Digital Computers, 1960, 191): the best candidate of `updyn.locate_nonlinearity` is added to the
    model at odds of 100 to 1, with all unknowns fitted again; each earlier element is then sought
    again with the others kept, and replaced or left out. If one more element is not supported but
    the residual is above the noise, two more are tried together.

    Examples
    --------
    >>> import numpy as np
    >>> K = 1e4 * np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    >>> groups = {"k": updyn.Group(K, loss_factor=0.03), "m": updyn.Group(mass=np.eye(3))}
    >>> model = updyn.Model.from_groups(groups, ["1:X", "2:X", "3:X"])
    >>> spring, damper = updyn.CubicSpring(3e8), updyn.QuadraticDamper(20.0)
    >>> true = model.with_elements({"a": (spring, ["1:X", "2:X"]), "b": (damper, ["3:X"])})
    >>> freq, at = np.linspace(4.0, 32.0, 30), ["1:X", "2:X", "3:X"]
    >>> tests = [updyn.response(true, freq, at, ["3:X"], level=F).frf for F in (1.0, 5.0)]
    >>> found = updyn.locate_nonlinearities(
    ...     model,
    ...     tests,
    ...     {"joint": ["1:X", "2:X"], "end": ["3:X"]},
    ...     ["cubic-spring", "quadratic-damper"],
    ...     noise={"relative": 0.01},
    ... )
    >>> sorted((one.place, one.kind) for one in found)
    [('end', 'quadratic-damper'), ('joint', 'cubic-spring')]
    """
    if isinstance(most, bool) or not isinstance(most, int) or most < 1:
        raise OptionError(f"most: expected a whole number of at least 1, found {most!r}")
    search = begin_search(model, tests, places, kinds, unknowns, noise)
    # A residual above the noise has further elements as its first cause.
    return _select(replace(search, refits=0), most)


def _select(search: Search, most: int) -> LocatedNonlinearities:
    """Return the elements by forward selection with a backward step after each addition."""
    state = _Selection(search, search.base, None, {})
    first = search.find()
    further: Location | None = first
    if first.base is not None:
        state = replace(state, fit=first.base)
    # An element that is left out again may be found once more.
    for _ in range(2 * most):
        if further is None:
            break
        grown = state.add(further)
        if not further.is_supported:
            grown = grown.add_pair(state, further) if len(grown.found) < most else state
            if grown is state:
                break
        state = grown.revise()
        further = None if len(state.found) >= most else state.search_next()
    state, odds = state.prune()
    return _make_result(state, odds, first, further)


@dataclass(frozen=True, slots=True, eq=False)
class _Selection:
    """A model with the elements found so far: its fit, and the search of each element by name."""

    start: Search
    base: Base
    fit: BaseFit | None
    found: Mapping[str, Location]

    def add(self, location: Location) -> Self:
        """Return the selection with the best candidate of a search."""
        best = location.best
        base = replace(best.problem.whole, x=best.x)
        found = {**self.found, best.problem.base.new_name: location}
        return replace(self, base=base, fit=best, found=found)

    def search_next(self, least: float = math.inf) -> Location | None:
        """Return the search for a further element; None if no candidate can be solved.

        `least` is the cost of a better model than that without it.
        """
        try:
            return replace(self.start, base=self.base, least=least).find()
        except SolverError:
            return None

    def add_pair(self, before: Self, location: Location) -> Self:
        """Return the selection with one more element if it supports both; else that before."""
        result = location.result
        if result.is_adequate or not result.depends_on_level or before.fit is None:
            return before
        second = self.search_next()
        if second is None:
            return before
        odds = compare_fits(second.best, before.fit, second.inflation)
        return self.add(second) if odds > CAUSE_ODDS.likely_log_odds else before

    def revise(self) -> Self:
        """Return the selection with each earlier element replaced or left out if that is better."""
        state = self
        for name in list(self.found)[:-1]:
            state = state._revise_one(name)
        return state

    def _revise_one(self, name: str) -> Self:
        others = replace(self, base=self.base.without(name), found=_leave_out(self.found, name))
        if self.fit is None:
            return self
        location = others.search_next(self.fit.cost)
        if location is None:
            return self
        if not location.is_supported and location.base is not None:
            x = location.base.x
            return replace(others, base=replace(others.base, x=x), fit=location.base)
        inflation = self.fit.inflation(self.base.data.n_numbers)
        gain = location.best.log_evidence(inflation) - self.fit.log_evidence(inflation)
        return others.add(location) if gain > LOCATION.least_decrease else self

    def prune(self) -> tuple[Self, dict[str, float]]:
        """Return the selection of supported elements, and the log odds of each over its absence."""
        state = self
        while True:
            odds = {name: state._log_odds(name) for name in state.found}
            worst = min(odds, key=lambda name: odds[name][0], default=None)
            if worst is None or odds[worst][0] > CAUSE_ODDS.likely_log_odds:
                return state, {name: value for name, (value, _) in odds.items()}
            fit = odds[worst][1]
            assert fit is not None
            base = replace(state.base.without(worst), x=fit.x)
            state = replace(state, base=base, fit=fit, found=_leave_out(state.found, worst))

    def _log_odds(self, name: str) -> tuple[float, BaseFit | None]:
        """Return the log odds of an element over the model without it, and the fit of that."""
        if self.fit is None:
            return math.inf, None
        fit = self.base.without(name).fit(self.fit.cost)
        if fit is None:
            return math.inf, None
        inflation = self.fit.inflation(self.base.data.n_numbers)
        return compare_fits(self.fit, fit, inflation), fit


def _leave_out(found: Mapping[str, Location], name: str) -> dict[str, Location]:
    return {key: location for key, location in found.items() if key != name}


def _make_result(
    state: _Selection, odds: Mapping[str, float], first: Location, further: Location | None
) -> LocatedNonlinearities:
    fit, n_numbers = state.fit, state.base.data.n_numbers
    last = None if further is None else further.result
    if not state.found or fit is None:
        residual = first.result.linear_residual
        return LocatedNonlinearities(
            (), {}, residual, residual, first.result.is_adequate, state.start.base.model, last
        )
    inflation = fit.inflation(n_numbers)
    values, std = fit.values, fit.std(inflation)
    model = fit.coordinates.parameters.apply(state.base.model, fit.coordinates.to_values(fit.x))
    elements = []
    for name, location in state.found.items():
        prefix = f"{name}."
        elements.append(
            LocatedElement(
                name,
                location.best.start.place.name,
                location.best.start.kind.name,
                model.nonlinear[name].element,
                {k.removeprefix(prefix): s for k, s in std.items() if k.startswith(prefix)},
                odds[name],
                location.result,
                model,
            )
        )
    rest = {k: x for k, x in values.items() if k.rpartition(".")[0] not in state.found}
    return LocatedNonlinearities(
        tuple(elements),
        rest,
        fit.rms(n_numbers),
        first.result.linear_residual,
        inflation <= LOCATION.largest_inflation,
        model,
        last,
    )
