"""Models with elements fitted to all levels without further approximation, with evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.candidates.evidence import Prior, log_evidence
from updyn.candidates.location.descent import make_descent
from updyn.candidates.location.describing import (
    ELEMENT,
    KindFit,
    choose_parameters,
    fit_element,
)
from updyn.candidates.location.levels import LevelData
from updyn.candidates.location.place import ExpectedForces, PlaceFit, linear_local
from updyn.candidates.location.settings import LOCATION
from updyn.dynamics.fields import FieldSolver
from updyn.frf import FRF
from updyn.model import Model
from updyn.nonlinear.element import NonlinearElement
from updyn.nonlinear.local import Place
from updyn.nonlinear.parameters import list_parameters, parameter_unit
from updyn.uncertainty.deviations import find_deviations
from updyn.uncertainty.likelihood import Likelihood
from updyn.updating.fit.equivalent import make_equivalent
from updyn.updating.fit.trust_region import Step
from updyn.updating.problem.coordinates import Coordinates
from updyn.updating.problem.local import Local
from updyn.updating.problem.parameters import Parameter, ParameterSet, collect_unknowns
from updyn.updating.problem.periodic_forward import PeriodicForward
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.random_forward import RandomForward
from updyn.updating.problem.residuals import OutputError, OutputErrorSet
from updyn.updating.problem.session import Session

__all__ = ["Base", "BaseFit", "ExactFit", "ExactProblem"]


@dataclass(frozen=True, slots=True, eq=False)
class BaseFit:
    """A model fitted to all levels: `local` is the problem of the data at `x`.

    `lines` (n_l, n_f) is half the weighted sum of squares of each level and line.
    """

    coordinates: Coordinates
    x: RealArray
    local: Local
    lines: RealArray

    @property
    def cost(self) -> float:
        """Half the weighted sum of squares of the data."""
        return self.local.cost

    def log_evidence(self, inflation: float) -> float:
        """Return the logarithm of the evidence for a variance of the noise times a factor."""
        if not len(self.x):
            return -self.local.cost / inflation
        root = np.sqrt(inflation)
        data = Local(self.local.cost / inflation, self.local.R / root, self.local.q / root)
        return log_evidence(data, self.x, Prior.of(self.coordinates))

    def inflation(self, n_numbers: int) -> float:
        """Return the variance of the residual of n real data over that of the noise, at least 1."""
        return max(1.0, 2.0 * self.cost / max(n_numbers - len(self.x), 1))

    def rms(self, n_numbers: int) -> float:
        """Return the rms of the residual of n real data in standard deviations of the noise."""
        return float(np.sqrt(2.0 * self.cost / n_numbers))

    @property
    def values(self) -> dict[str, float]:
        """Values of the unknowns by name."""
        found = self.coordinates.to_values(self.x).tolist()
        return dict(zip(self.coordinates.parameters.names, found, strict=True))

    def std(self, inflation: float) -> dict[str, float]:
        """Return standard deviations of the unknowns by name, for an inflated variance.

        Those of undetermined unknowns are infinite.
        """
        R = self.local.R / np.sqrt(inflation)
        return find_deviations(R, self.coordinates, self.x)


@dataclass(frozen=True, slots=True, eq=False)
class ExactFit(BaseFit):
    """A candidate fitted exactly, with its problem and its model."""

    problem: ExactProblem
    model: Model

    @property
    def start(self) -> KindFit:
        """The fit to the describing function."""
        return self.problem.start


@dataclass(frozen=True, slots=True, eq=False)
class Base:
    """The model to which an element is added, with the data of all levels.

    It may have elements. `unknowns` are those of groups, then those of elements, and `x` is their
    start. `solver` replaces that of the model without elements if it is reduced.
    """

    model: Model
    unknowns: ParameterSet
    x: RealArray
    data: LevelData
    solver: FieldSolver | None

    @property
    def n_linear(self) -> int:
        """Number of unknowns of groups."""
        return len(self.data.part.coordinates.parameters)

    @property
    def linear_x(self) -> RealArray:
        """Start of the unknowns of groups."""
        return self.x[: self.n_linear]

    @property
    def new_name(self) -> str:
        """Name of the element that is added."""
        names = [ELEMENT, *(f"{ELEMENT} {i}" for i in range(2, len(self.model.nonlinear) + 2))]
        return next(name for name in names if name not in self.model.nonlinear)

    def without(self, name: str) -> Base:
        """Return the base without one of its elements."""
        model = replace(
            self.model, nonlinear={k: v for k, v in self.model.nonlinear.items() if k != name}
        )
        at = [i for i, p in enumerate(self.unknowns) if not (p.of_element and p.group == name)]
        unknowns = collect_unknowns(self.unknowns.items[i] for i in at)
        return replace(self, model=model, unknowns=unknowns, x=self.x[at])

    def likelihood(self) -> Likelihood:
        """Return the likelihood of the data."""
        session, tests = Session(), self.data.tests
        parts = [_build(self.model, test, self.unknowns, session, self.solver) for test in tests]
        return Likelihood(Problem.of(parts), OutputErrorSet(tuple(self.data.errors), ()))

    def fit(self, least: float = np.inf) -> BaseFit | None:
        """Return the model fitted to all levels; None if it cannot be solved.

        It is given up early if its cost remains far above `least`, that of a better model.
        """
        if not self.model.nonlinear:
            return self._fit_linear()
        likelihood = self.likelihood()
        problem = likelihood.problem
        if not len(self.x):
            cost = likelihood.cost(self.x)
            if not np.isfinite(cost):
                return None
            nothing = Local(cost, np.zeros((0, 0)), np.zeros(0))
            return BaseFit(problem.coordinates, self.x, nothing, _split(likelihood, self.x))
        x = np.clip(self.x, *problem.coordinates.bounds)
        x = _descend(likelihood, x, LOCATION.hopeless_ratio * least)
        local = likelihood.residual.local(problem, x)
        if local is None:
            return None
        return BaseFit(problem.coordinates, x, local, _split(likelihood, x))

    def _fit_linear(self) -> BaseFit | None:
        data, x = self.data, self.x
        coordinates = data.part.coordinates
        local = linear_local(data, x)
        if local is None:
            return None
        if len(x):
            settings = make_descent(LOCATION.place_steps)
            outcome = settings.minimise(lambda y: linear_local(data, y), x, *coordinates.bounds)
            x, local = outcome.x, outcome.local
        H = data.part.responses(x)
        lines = [
            _by_line(e, H - test.values) for e, test in zip(data.errors, data.tests, strict=True)
        ]
        return BaseFit(coordinates, x, local, np.array(lines))

    def expect_forces(self) -> ExpectedForces | None:
        """Return the forces of the elements of the base at its unknowns x; None without elements.

        Their relative errors are a multiple of those of the responses at the same line and level.
        """
        if not self.model.nonlinear:
            return None
        z, std = [], []
        for part, error in zip(self.likelihood().problem.parts, self.data.errors, strict=True):
            assert isinstance(part.forward, PeriodicForward | RandomForward)
            found = part.forward.forces(part, self.x).transpose(0, 2, 1)
            r = error.weight * (part.responses(self.x) - part.frf.values)
            share = np.linalg.norm(r, axis=1) / np.linalg.norm(
                error.weight * part.frf.values, axis=1
            )
            size = np.abs(found)
            size = np.hypot(size, LOCATION.least_force * size.max(axis=0))
            size = np.maximum(LOCATION.force_error * share[..., None] * size, np.finfo(float).tiny)
            z.append(found)
            std.append(size)
        return ExpectedForces(np.array(z), np.array(std))

    def fit_others(self, place: PlaceFit) -> RealArray:
        """Return the unknowns of the elements of the base from their forces at a place fit."""
        coordinates = Coordinates(self.unknowns)
        values = coordinates.to_values(self.x)
        for (name, local), measured in zip(self.model.nonlinear.items(), place.others, strict=True):
            at = [i for i, p in enumerate(self.unknowns) if p.of_element and p.group == name]
            if not at:
                continue
            own = collect_unknowns(self.unknowns.items[i] for i in at)
            own = own.with_start(np.clip(values[at], own.lower, own.upper))
            motion = self.data.motion(measured.amplitude)
            found = fit_element(measured, local.element, own, motion)
            if found is not None:
                fitted = list_parameters(found[0])
                values[at] = [fitted[p.quantity] for p in own]
        return coordinates.to_x(values)[self.n_linear :]


@dataclass(frozen=True, slots=True, eq=False)
class ExactProblem:
    """A candidate with the data of all levels."""

    base: Base
    start: KindFit
    whole: Base
    likelihood: Likelihood

    @classmethod
    def of(cls, base: Base, start: KindFit, dofs: Place) -> ExactProblem:
        """Return the problem of a candidate at a place."""
        name = base.new_name
        own = choose_parameters(base.model, name, start.kind, start.start, dofs)
        unknowns = ParameterSet((*base.unknowns, *own))
        model = base.model.with_elements({name: (start.start, dofs)})
        whole = replace(base, model=model, unknowns=unknowns)
        return cls(base, start, whole, whole.likelihood())

    @property
    def data(self) -> LevelData:
        """The data of all levels."""
        return self.base.data

    @property
    def model(self) -> Model:
        """The model with the candidate, with the values of the start."""
        return self.whole.model

    def fit(self, least: float) -> ExactFit | None:
        """Return the fit from the describing functions; None if it cannot be solved.

        It is given up early if its cost remains far above `least`, that of another candidate.
        """
        for share in LOCATION.start_shares:
            start = self._choose_start(share)
            if start is not None:
                likelihood, x = start
                if self._lacks_branches(likelihood, x):
                    likelihood, x = self._fit_most_lines(likelihood, x)
                x = _descend(likelihood, x, LOCATION.hopeless_ratio * least)
                return self._end(likelihood, x)
        return None

    def _lacks_branches(self, likelihood: Likelihood, x: RealArray) -> bool:
        """Return whether lines lack the measured branch at x.

        Responses are then much farther from the data than those by describing functions.
        """
        residual = OutputErrorSet(tuple(self.data.soften(LOCATION.describing_error)), ())
        cost = replace(likelihood, residual=residual).cost(x)
        return cost > LOCATION.branch_misfit * self._equivalent(x, residual).cost(x)

    def _fit_most_lines(self, likelihood: Likelihood, x: RealArray) -> tuple[Likelihood, RealArray]:
        """Return a likelihood, and the end of descents with weights of lines by their residuals.

        A line at which the model at x lacks the measured branch would hide the others.
        """
        for _ in range(LOCATION.branch_rounds):
            errors = self.data.reduce_weights(_split(likelihood, x))
            robust = replace(self.whole.likelihood(), residual=OutputErrorSet(tuple(errors), ()))
            moved, other = _descend(robust, x), self.whole.likelihood()
            if not np.isfinite(other.cost(moved)):
                break
            likelihood, x = other, moved
        return likelihood, x

    def _choose_start(self, share: float) -> tuple[Likelihood, RealArray] | None:
        """Return the unknowns from which an exact fit starts, and its likelihood; None if none.

        The describing function fitted to the responses is nearer than that fitted to the force
        only if that is far from the minimum: its error exceeds the noise.
        """
        x = self._begin(share)
        likelihood, cost = self.likelihood, self.likelihood.cost(x)
        if share == 1.0:
            equivalent = self._equivalent(x, likelihood.residual)
            moved = _descend(equivalent, x)
            other = self.whole.likelihood()
            if equivalent.cost(moved) < cost and other.cost(moved) < cost:
                return other, moved
        return (likelihood, x) if np.isfinite(cost) else None

    def fit_describing(self) -> KindFit:
        """Return the fit by describing functions together with the linear unknowns."""
        x = self._begin(1.0)
        for error in (LOCATION.soft_error, *[LOCATION.describing_error] * LOCATION.rounds):
            equivalent = self._equivalent(x, OutputErrorSet(tuple(self.data.soften(error)), ()))
            x = _descend(equivalent, x)
        local = equivalent.local(x)
        coordinates = self.likelihood.problem.coordinates
        found = coordinates.parameters.apply(self.model, coordinates.to_values(x))
        cost = np.inf if local is None else local.cost
        return replace(
            self.start,
            element=found.nonlinear[self.base.new_name].element,
            x=x[: self.base.n_linear],
            others=x[self.base.n_linear : len(self.base.x)],
            misfit=cost,
            cost=cost,
        )

    def _begin(self, share: float) -> RealArray:
        """Return the unknowns of the start for a share of the force of the element.

        Those of other elements are from their forces, or those of the base if these are better.
        """
        coordinates = self.likelihood.problem.coordinates
        n, n_linear = len(self.base.x), self.base.n_linear
        new = coordinates.parameters.items[n:]
        values = coordinates.start
        own = coordinates.to_values(values)
        own[n:] = _weaken(self.start.element, new, share)
        x = coordinates.to_x(own)
        x[:n_linear] = self.start.x
        starts = []
        for others in (self.start.others, self.base.x[n_linear:]):
            x[n_linear:n] = others
            starts.append(np.clip(x, *coordinates.bounds))
        if n == n_linear:
            return starts[0]
        costs = []
        for one in starts:
            local = self._equivalent(one, self.likelihood.residual).local(one)
            costs.append(np.inf if local is None else local.cost)
        return starts[int(np.argmin(costs))]

    def _equivalent(self, x: RealArray, residual: OutputErrorSet) -> Likelihood:
        """Return the data with the describing function at the amplitudes of x."""
        return Likelihood(make_equivalent(self.likelihood.problem, x), residual)

    def refit(self, fit: ExactFit) -> ExactFit:
        """Return the fit with wider minima first, or the same if that is not better."""
        residual = OutputErrorSet(tuple(self.data.soften(LOCATION.soft_error)), ())
        x = _descend(replace(self.likelihood, residual=residual), fit.x)
        found = self._end(self.likelihood, _descend(self.likelihood, x))
        return fit if found is None or found.cost >= fit.cost else found

    def _end(self, likelihood: Likelihood, x: RealArray) -> ExactFit | None:
        local = likelihood.residual.local(likelihood.problem, x)
        if local is not None and 2.0 * local.cost > (
            LOCATION.largest_inflation * self.data.n_numbers
        ):
            # Branches at all lines are looked for once more.
            other = self.whole.likelihood()
            again = other.residual.local(other.problem, x)
            if again is not None and again.cost < local.cost - LOCATION.least_decrease:
                x = _descend(other, x)
                likelihood, local = other, other.residual.local(other.problem, x)
        if local is None:
            return None
        problem = likelihood.problem
        coordinates = problem.coordinates
        found = coordinates.parameters.apply(self.model, coordinates.to_values(x))
        return ExactFit(coordinates, x, local, _split(likelihood, x), self, found)


def _split(likelihood: Likelihood, x: RealArray) -> RealArray:
    """Return half the weighted sum of squares of each level and line."""
    out = []
    for i, part in enumerate(likelihood.problem.parts):
        out.append(_by_line(likelihood.residual.of(i), part.responses(x) - part.frf.values))
    return np.array(out)


def _by_line(error: OutputError, difference: ComplexArray) -> RealArray:
    return np.asarray(0.5 * np.sum(np.abs(error.weight * difference) ** 2, axis=(1, 2)))


def _descend(likelihood: Likelihood, x: RealArray, limit: float = np.inf) -> RealArray:
    """Return the end of a descent; the start if it cannot be solved.

    It ends after a few steps if the cost remains above the limit.
    """
    if likelihood.local(x) is None:
        return x
    costs: list[float] = []

    def is_hopeless(step: Step) -> bool:
        if step.local is not None:
            costs.append(step.local.cost)
        return len(costs) >= LOCATION.hopeless_steps and min(costs) > limit

    settings = make_descent(LOCATION.exact_steps)
    return settings.minimise(likelihood.local, x, *likelihood.bounds, is_hopeless).x


def _build(
    model: Model,
    test: FRF,
    unknowns: ParameterSet,
    session: Session,
    solver: FieldSolver | None,
) -> FRFPart:
    part = FRFPart.build(model, test, unknowns, session=session)
    if isinstance(part.forward, PeriodicForward):
        part = replace(part, forward=replace(part.forward, memory={}))
    return part if solver is None else part.with_solver(solver)


def _weaken(element: NonlinearElement, unknowns: Sequence[Parameter], share: float) -> list[float]:
    """Return the values of the unknowns of an element for a share of its force."""
    values = list_parameters(element)
    is_force = {p.quantity: parameter_unit(element, p.quantity).startswith("N") for p in unknowns}
    return [values[name] * (share if force else 1.0) for name, force in is_force.items()]
