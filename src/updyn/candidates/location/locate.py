"""`locate_nonlinearity`: place and kind of a local nonlinearity."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from updyn.arrays import RealArray
from updyn.candidates.location.describing import KindFit, fit_kind
from updyn.candidates.location.exact import Base, BaseFit, ExactFit, ExactProblem
from updyn.candidates.location.kinds import Kind, choose_kinds
from updyn.candidates.location.levels import LevelData
from updyn.candidates.location.place import PlaceFit, PlaceProblem
from updyn.candidates.location.places import check_places
from updyn.candidates.location.result import LocationRow, NonlinearityLocation
from updyn.candidates.location.settings import LOCATION
from updyn.candidates.settings import CANDIDATES
from updyn.dynamics.fields import FieldSolver
from updyn.dynamics.settings import REDUCTION
from updyn.errors import OptionError, SolverError
from updyn.frf import FRF
from updyn.model import Model
from updyn.nonlinear.cubic import CubicSpring
from updyn.nonlinear.element import NonlinearElement
from updyn.nonlinear.local import Place
from updyn.updating.fit.reducing import is_reduced, make_reduction
from updyn.updating.fit.search import scatter_points
from updyn.updating.judge.causes.settings import CAUSE_ODDS
from updyn.updating.problem.coordinates import Coordinates
from updyn.updating.problem.data import Test
from updyn.updating.problem.local_elements import LocalElements
from updyn.updating.problem.noise import NoiseChoice
from updyn.updating.problem.parameters import ParameterSet, collect_unknowns, no_unknowns
from updyn.updating.problem.problem import FRFPart
from updyn.updating.run import run
from updyn.updating.setup import RunOptions

__all__ = ["Location", "Search", "begin_search", "compare_fits", "locate_nonlinearity"]


def locate_nonlinearity(
    model: Model,
    tests: Iterable[FRF],
    places: Mapping[str, Place] | None = None,
    kinds: Iterable[str] | Mapping[str, NonlinearElement] | None = None,
    *,
    unknowns: ParameterSet | None = None,
    noise: NoiseChoice = None,
) -> NonlinearityLocation:
    """Find the place and the kind of a local nonlinearity from FRFs at several force levels.

    Parameters
    ----------
    model : Model
        The model, with the channels of the tests among its DOFs. It may have nonlinear elements
        that are known to exist; the sought one is a further one.
    tests : iterable of FRF
        Measurements of the same channels and lines at two levels or more (`FRF.with_level`), of at
        least two responses: all of sines or all of random forces.
    places : mapping of str to place, optional
        Candidates by name, each a combination of DOFs as for `Model.with_elements`. By default, the
        pairs of DOFs of one direction that the stiffness connects, and the DOFs that it connects to
        ground.
    kinds : iterable of str or mapping of str to element, optional
        Names of `updyn.nonlinear` elements, by default all, or elements by name with parameters
        from which to start.
    unknowns : ParameterSet, optional
        Unknowns of the model that are fitted, too, those of its elements included; by default the
        model is used as it is.
    noise : None, str or mapping
        As for `updyn.update`. If the data do not state it, it is estimated from the residual with
        an element of any kind at the best place; the scatter of neighbouring lines is an upper
        bound.

    Returns
    -------
    NonlinearityLocation
        The candidates that were fitted exactly, the best first.

    Raises
    ------
    InputError
        If models, data, places or options do not fit together.
    SolverError
        If no candidate can be solved.

    Notes
    -----
    Places: the force of an element at a place follows from the responses at each line and level by
    least squares, whatever its kind; the residual, with linear unknowns fitted, ranks the places
    (Noel & Kerschen, Mech. Syst. Signal Process. 83 (2017) 2). Kinds: force over deformation is the
    describing function of the element at the amplitude of the deformation, to which each kind is
    fitted; of a random force, it is the spring and the damper of its linearisation. The best
    candidates are fitted as by `updyn.update`, and compared by their evidence, as `compare_models`
    does.

    Examples
    --------
    >>> import numpy as np
    >>> K = 1e4 * np.array([[2.0, -1.0], [-1.0, 1.0]])
    >>> groups = {"k": updyn.Group(K, loss_factor=0.03), "m": updyn.Group(mass=np.eye(2))}
    >>> model = updyn.Model.from_groups(groups, ["1:X", "2:X"])
    >>> true = model.with_elements({"joint": (updyn.CubicSpring(1e8), ["1:X", "2:X"])})
    >>> freq, ends = np.linspace(7.0, 30.0, 60), ["1:X", "2:X"]
    >>> tests = [updyn.response(true, freq, ends, ["2:X"], level=F).frf for F in (0.5, 2.0)]
    >>> found = updyn.locate_nonlinearity(
    ...     model, tests, kinds=["cubic-spring", "jenkins"], noise={"relative": 0.01}
    ... )
    >>> found.best.place, found.best.kind, f"{found.best.element.coefficient:.3g}"
    ('1:X - 2:X', 'cubic-spring', '1e+08')
    """
    return begin_search(model, tests, places, kinds, unknowns, noise).find().result


def begin_search(
    model: Model,
    tests: Iterable[FRF],
    places: Mapping[str, Place] | None,
    kinds: Iterable[str] | Mapping[str, NonlinearElement] | None,
    unknowns: ParameterSet | None,
    noise: NoiseChoice,
) -> Search:
    """Return the search for an element in addition to those of a model."""
    named, chosen = check_places(model, places), choose_kinds(kinds)
    found = no_unknowns() if unknowns is None else unknowns
    if not isinstance(found, ParameterSet):
        raise OptionError(f"unknowns: expected updyn.parameters(...), found {unknowns!r}")
    found = collect_unknowns(sorted(found, key=lambda p: p.of_element))
    data = LevelData.of(model, list(tests), found, noise)
    solver = None
    if is_reduced(None, model.n_dofs, len(data.part.frf.freq)):
        solver = _reduce(model, named, data.part)
        data = replace(data, part=data.part.with_solver(solver))
    x = Coordinates(found).start
    lowest = _fit_lowest(model, data, noise)
    x[: len(lowest)] = lowest
    return Search(Base(model, found, x, data, solver), named, chosen, lowest)


@dataclass(frozen=True, slots=True, eq=False)
class Location:
    """The end of a search: its result, the best candidate, and the model without it.

    `inflation` is the variance of the noise over the stated one that the odds are based on.
    """

    result: NonlinearityLocation
    best: ExactFit
    base: BaseFit | None
    inflation: float

    @property
    def is_supported(self) -> bool:
        """Whether the best candidate is likelier than the model without it, whatever one line."""
        if not self.result.depends_on_level:
            return False
        if self.base is None:
            return True
        odds = compare_fits(self.best, self.base, self.inflation)
        return odds > CAUSE_ODDS.likely_log_odds


def compare_fits(whole: BaseFit, part: BaseFit, inflation: float) -> float:
    """Return the log odds of one fit over another, without the line that supports it most.

    At one line, the data may lie on a branch of solutions that was not found.
    """
    odds = whole.log_evidence(inflation) - part.log_evidence(inflation)
    gain = float((part.lines - whole.lines).max())
    return odds - max(gain, 0.0) / inflation


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """The search for place and kind of an element in addition to those of a model.

    `lowest` are the unknowns of groups fitted to the lowest level; `refits` are exact fits that are
    repeated if no candidate leaves a residual like noise; `least` is the cost of a better model
    than that without the element.
    """

    base: Base
    places: Mapping[str, Place]
    kinds: Sequence[Kind]
    lowest: RealArray
    refits: int = LOCATION.refits
    least: float = math.inf

    @property
    def data(self) -> LevelData:
        """The data of all levels."""
        return self.base.data

    def find(self) -> Location:
        """Return the candidates, the best first."""
        # If a better model is known, the noise is that of its residual.
        is_known = self.data.is_noise_stated or math.isfinite(self.least)
        search = self if is_known else self._estimate_noise()
        return search._find_from_base()

    def _estimate_noise(self) -> Search:
        """Return the search with the noise of the residual of the best place."""
        base, best = self.base, ""
        for _ in range(LOCATION.noise_rounds):
            place = replace(self, base=base)._rank_places()[0]
            if place.name == best:
                break
            best = place.name
            data = base.data.estimate_noise(place.problem.square_residual(place.x))
            base = replace(base, data=data)
        return replace(self, base=replace(base, data=base.data.detect_dependence()))

    def _find_from_base(self) -> Location:
        """Return the candidates for the weights that the data have."""
        linear = self.base.fit(self.least)
        if linear is not None and self.base.model.nonlinear:
            return replace(self, base=replace(self.base, x=linear.x))._find(linear)
        return self._find(linear)

    def _find(self, linear: BaseFit | None) -> Location:
        """Return the same; `linear` is the fit of the base."""
        ranked = self._rank_places()
        fits = self._fit_candidates(self._rank_kinds(ranked))
        if not fits:
            raise SolverError("no candidate of place and kind can be solved at its start")
        n_numbers = self.data.n_numbers
        inflation = min(fits, key=_cost).inflation(n_numbers)
        fits = _order(fits, inflation)
        top = fits[0].log_evidence(inflation)
        result = NonlinearityLocation(
            tuple(self._row(fit, inflation, top) for fit in fits),
            MappingProxyType({place.name: self._residual(place) for place in ranked}),
            -math.inf if linear is None else linear.log_evidence(inflation) - top,
            math.nan if linear is None else linear.rms(n_numbers),
            inflation <= LOCATION.largest_inflation,
            self.data.depends_on_level,
        )
        return Location(result, fits[0], linear, inflation)

    def _rank_places(self) -> list[PlaceFit]:
        """Return the places by the residual of an element of any kind."""
        unknowns = self.data.part.coordinates.parameters
        found, expected = {}, self.base.expect_forces()
        for name, dofs in self.places.items():
            new = {self.base.new_name: (CubicSpring(1.0), dofs)}
            local = LocalElements.find(self.base.model.with_elements(new), unknowns)
            fit = PlaceProblem(name, local, self.data, expected).fit(self.base.linear_x)
            if fit is not None:
                found[name] = fit
        if not found:
            raise SolverError("an element at none of the places changes a measured response")
        if len(unknowns):
            starts = [self.lowest, self.data.part.coordinates.start]
            self._search_linear(found, starts, len(found))
            self._search_linear(found, self._scatter(), LOCATION.most_searched)
        return sorted(found.values(), key=_cost)

    def _search_linear(
        self, found: dict[str, PlaceFit], starts: Sequence[RealArray], most: int
    ) -> None:
        """Replace fits by better ones from further starts unless the residual is like noise."""
        ordered = sorted(found, key=lambda name: found[name].cost)
        limit = LOCATION.largest_inflation * self.data.n_spare
        if 2.0 * found[ordered[0]].cost <= limit:
            return
        soft = self.data.softened()
        for name in ordered[:most]:
            problem = found[name].problem
            fits = [replace(problem, data=soft).fit(x) for x in starts]
            near = min((fit for fit in fits if fit is not None), key=_cost, default=None)
            fit = None if near is None else problem.fit(near.x)
            if fit is not None and fit.cost < found[name].cost:
                found[name] = fit

    def _scatter(self) -> list[RealArray]:
        """Return further starts of the linear unknowns."""
        coordinates = self.data.part.coordinates
        log, loss = LOCATION.start_spread
        half = np.where(coordinates.parameters.is_damping, loss, log)
        points = scatter_points(coordinates.start, half, LOCATION.starts, seed=0)
        return [np.clip(x, *coordinates.bounds) for x in points]

    def _rank_kinds(self, ranked: Sequence[PlaceFit]) -> list[list[KindFit]]:
        """Return the kinds of the best places by their misfit, and the places by the least."""
        limit = ranked[0].cost + self._excluded_cost(ranked[0].cost)
        out = []
        for place in ranked[: LOCATION.most_places]:
            if place.cost > limit:
                break
            found = self._fit_kinds(place)
            if found:
                out.append(found)
        out.sort(key=lambda found: found[0].cost)
        limit = LOCATION.joint_misfit * self.data.n_forces
        if out and self.base.n_linear and 2.0 * out[0][0].misfit > limit:
            out = [self._fit_jointly(found) for found in out[: LOCATION.fitted_places]]
            out.sort(key=lambda found: found[0].cost)
        return out

    def _fit_kinds(self, place: PlaceFit) -> list[KindFit]:
        """Return the kinds at a place by cost, each at the linear unknowns that suit it best.

        The forces of any kind may make up for errors of linear unknowns, which are then far from
        the right ones at the place fit, but not at a level at which the element hardly acts.
        """
        best = {fit.kind.name: fit for fit in self._fit_kinds_at(place)}
        starts = np.unique([self.lowest, self.base.linear_x], axis=0)
        for x in starts if self.base.n_linear else ():
            near = place.problem.at(x)
            if near is None or near.cost > min(map(_cost, best.values()), default=math.inf):
                continue
            for fit in self._fit_kinds_at(near):
                known = best.get(fit.kind.name)
                if known is None or fit.cost < known.cost:
                    best[fit.kind.name] = fit
        return sorted(best.values(), key=_cost)

    def _fit_kinds_at(self, place: PlaceFit) -> list[KindFit]:
        """Return the kinds at a place with the other elements from their forces."""
        others = self.base.fit_others(place)
        fits = [self._fit_kind(place, kind) for kind in self.kinds]
        return [replace(fit, others=others) for fit in fits if fit is not None]

    def _fit_kind(
        self, place: PlaceFit, kind: Kind, *, in_parallel: bool = False
    ) -> KindFit | None:
        """Return a kind at a place by its describing function; `in_parallel` as for `fit_kind`."""
        about = self.base.model, self.base.new_name, place, self.places[place.name], kind
        return fit_kind(*about, self.data, in_parallel=in_parallel)

    def _fit_jointly(self, found: Sequence[KindFit]) -> list[KindFit]:
        """Return the kinds at a place fitted together with the linear unknowns.

        An error of a linear stiffness at the place adds to the force that a kind is fitted to, so
        each kind is also fitted in parallel with a constant stiffness; the better one is returned.
        """
        fits = []
        for one in found:
            other = self._fit_kind(one.place, one.kind, in_parallel=True)
            starts = [one] if other is None else [one, replace(other, others=one.others)]
            jointly = [self._problem(start).fit_describing() for start in starts]
            fits.append(min(jointly, key=lambda fit: fit.misfit))
        return sorted(fits, key=lambda fit: fit.misfit)

    def _fit_candidates(self, ranked: Sequence[Sequence[KindFit]]) -> list[ExactFit]:
        """Return exact fits: of the best kind at each place, then of other kinds at the best."""
        fits: list[ExactFit] = []
        solved = []
        for kinds in ranked[: LOCATION.fitted_places]:
            first = self._fit_first(kinds, fits)
            if first is not None:
                solved.append(first)
                fits.append(first[0])
        solved.sort(key=lambda one: one[0].cost)
        for fit, others in solved[: LOCATION.compared_places]:
            least = min(one.cost for one in fits)
            if fit.cost > solved[0][0].cost + self._excluded_cost(least):
                continue
            for rank, kind in enumerate(others, 1):
                is_far = kind.misfit > LOCATION.largest_misfit * fit.start.misfit
                if rank >= LOCATION.most_kinds or (rank >= LOCATION.least_kinds and is_far):
                    break
                found = self._fit(kind, fits)
                if found is not None:
                    fits.append(found)
        return self._refit(sorted(fits, key=_cost))

    def _refit(self, fits: Sequence[ExactFit]) -> list[ExactFit]:
        """Return fits, the best of them again unless the first leaves a residual like noise."""
        out = list(fits)
        for i, fit in enumerate(fits[: self.refits]):
            if 2.0 * min(map(_cost, out)) <= LOCATION.largest_inflation * self.data.n_numbers:
                break
            out[i] = fit.problem.refit(fit)
        return out

    def _fit_first(
        self, kinds: Sequence[KindFit], fits: Sequence[ExactFit]
    ) -> tuple[ExactFit, Sequence[KindFit]] | None:
        """Return the exact fit of the first kind at a place that can be solved, and the others."""
        for number, kind in enumerate(kinds[: LOCATION.most_kinds], 1):
            fit = self._fit(kind, fits)
            if fit is not None:
                return fit, kinds[number:]
        return None

    def _residual(self, place: PlaceFit) -> float:
        """Return the rms residual of a place for the numbers that its forces leave."""
        return float(np.sqrt(2.0 * place.cost / self.data.n_spare))

    def _excluded_cost(self, least: float) -> float:
        """Return the excess over the least cost from which a candidate is left out."""
        spare = max(self.data.n_numbers, 1)
        return LOCATION.excluded_log_odds * max(1.0, 2.0 * least / spare)

    def _fit(self, start: KindFit, fits: Sequence[ExactFit] = ()) -> ExactFit | None:
        return self._problem(start).fit(min(map(_cost, fits), default=math.inf))

    def _problem(self, start: KindFit) -> ExactProblem:
        return ExactProblem.of(self.base, start, self.places[start.place.name])

    def _row(self, fit: ExactFit, inflation: float, top: float) -> LocationRow:
        values, std = fit.values, fit.std(inflation)
        name = self.base.new_name
        local = fit.model.nonlinear[name]
        prefix = f"{name}."
        return LocationRow(
            fit.start.place.name,
            fit.start.kind.name,
            local.element,
            {name.removeprefix(prefix): s for name, s in std.items() if name.startswith(prefix)},
            {name: x for name, x in values.items() if not name.startswith(prefix)},
            len(fit.x),
            fit.log_evidence(inflation) - top,
            fit.rms(self.data.n_numbers),
            fit.model,
        )


def _cost(fit: PlaceFit | KindFit | ExactFit) -> float:
    return fit.cost


def _order(fits: Sequence[ExactFit], inflation: float) -> list[ExactFit]:
    """Return the fits by evidence; of equally probable ones, that with fewest unknowns is first."""
    ordered = sorted(fits, key=lambda fit: -fit.log_evidence(inflation))
    limit = ordered[0].log_evidence(inflation) - CANDIDATES.equal_log_odds
    tied = [fit for fit in ordered if fit.log_evidence(inflation) >= limit]
    first = min(tied, key=lambda fit: len(fit.x))
    return [first, *(fit for fit in ordered if fit is not first)]


def _fit_lowest(model: Model, data: LevelData, noise: NoiseChoice) -> RealArray:
    """Return the linear unknowns fitted to the lowest level."""
    coordinates = data.part.coordinates
    if not len(coordinates.parameters):
        return np.zeros(0)
    test = Test(model, data.tests[0], noise=noise)
    (result,) = run([test], coordinates.parameters, RunOptions(seek_causes=False))
    return coordinates.to_x(np.array(list(result.values.values())))


def _reduce(model: Model, places: Mapping[str, Place], part: FRFPart) -> FieldSolver:
    """Return the solver of a reduced model for all places, responses and references."""
    unknowns = part.coordinates.parameters
    if len(unknowns):
        raise OptionError(
            f"unknowns: a model with {model.n_dofs} degrees of freedom is reduced, with fixed"
            " linear parameters; update it to the lowest level first, and leave unknowns out"
        )
    every = {name: (CubicSpring(1.0), place) for name, place in places.items()}
    whole = FRFPart.build(model.with_elements(every), part.frf, unknowns, tier="sparse")
    reduction = make_reduction(whole, REDUCTION.accuracy)
    state = reduction.system.start
    reduction.build(state)
    found = reduction.certify(state, whole.solved_lines)
    if found.error > REDUCTION.accuracy:
        raise SolverError(
            f"{found.size} basis vectors reach an error of {found.error:.1g} of the largest"
            f" receptance of a line, not {REDUCTION.accuracy:g}; leave out lines or places"
        )
    return reduction.solver()
