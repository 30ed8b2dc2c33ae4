"""Candidates fitted exactly, by harmonic balance, with their evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from updyn.arrays import RealArray
from updyn.candidates.evidence import Prior, log_evidence
from updyn.candidates.location.descent import make_descent
from updyn.candidates.location.describing import ELEMENT, KindFit, choose_parameters
from updyn.candidates.location.levels import LevelData
from updyn.candidates.location.place import linear_local
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
from updyn.updating.problem.parameters import Parameter, ParameterSet
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import OutputErrorSet
from updyn.updating.problem.session import Session

__all__ = ["ExactFit", "ExactProblem", "LinearFit", "fit_linear"]


@dataclass(frozen=True, slots=True, eq=False)
class LinearFit:
    """The linear model fitted to all levels: `local` is the problem of the data at `x`."""

    coordinates: Coordinates
    x: RealArray
    local: Local

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


@dataclass(frozen=True, slots=True, eq=False)
class ExactFit(LinearFit):
    """A candidate fitted exactly, with its problem and its model."""

    problem: ExactProblem
    model: Model

    @property
    def start(self) -> KindFit:
        """The fit to the describing function."""
        return self.problem.start

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


def fit_linear(data: LevelData, x: RealArray) -> LinearFit | None:
    """Return the linear model fitted to all levels from x; None if it cannot be solved."""
    coordinates = data.part.coordinates
    local = linear_local(data, x)
    if local is None:
        return None
    if len(x):
        settings = make_descent(LOCATION.place_steps)
        outcome = settings.minimise(lambda y: linear_local(data, y), x, *coordinates.bounds)
        x, local = outcome.x, outcome.local
    return LinearFit(coordinates, x, local)


@dataclass(frozen=True, slots=True, eq=False)
class ExactProblem:
    """A candidate with the data of all levels."""

    model: Model
    start: KindFit
    data: LevelData
    likelihood: Likelihood

    @classmethod
    def of(
        cls, model: Model, start: KindFit, dofs: Place, data: LevelData, solver: FieldSolver | None
    ) -> ExactProblem:
        """Return the problem; `solver` replaces that of the linear model if it is reduced."""
        own = choose_parameters(model, start.kind, start.start, dofs)
        unknowns = ParameterSet((*data.part.coordinates.parameters, *own))
        whole = model.with_elements({ELEMENT: (start.start, dofs)})
        session = Session()
        parts = [_build(whole, test, unknowns, session, solver) for test in data.tests]
        residual = OutputErrorSet(tuple(data.errors), ())
        return cls(whole, start, data, Likelihood(Problem.of(parts), residual))

    def fit(self, least: float) -> ExactFit | None:
        """Return the fit from the describing functions; None if it cannot be solved.

        It is given up early if its cost remains far above `least`, that of another candidate.
        """
        for share in LOCATION.start_shares:
            x = self._begin(share)
            if share == 1.0:
                x = _descend(self._equivalent(x, self.likelihood.residual), x)
            if self.likelihood.local(x) is not None:
                return self._end(_descend(self.likelihood, x, LOCATION.hopeless_ratio * least))
        return None

    def fit_describing(self) -> KindFit:
        """Return the fit by describing functions together with the linear unknowns."""
        x = self._begin(1.0)
        for error in (LOCATION.soft_error, *[LOCATION.describing_error] * LOCATION.rounds):
            equivalent = self._equivalent(x, OutputErrorSet(tuple(self.data.soften(error)), ()))
            x = _descend(equivalent, x)
        local = equivalent.local(x)
        coordinates = self.likelihood.problem.coordinates
        found = coordinates.parameters.apply(self.model, coordinates.to_values(x))
        return replace(
            self.start,
            element=found.nonlinear[ELEMENT].element,
            x=x[: len(self.start.x)],
            misfit=np.inf if local is None else local.cost,
        )

    def _begin(self, share: float) -> RealArray:
        """Return the unknowns of the start for a share of the force of the element."""
        coordinates, linear = self.likelihood.problem.coordinates, self.data.part.coordinates
        known = linear.to_values(self.start.x).tolist()
        own = _weaken(self.start.element, coordinates.parameters.items[len(known) :], share)
        return np.clip(coordinates.to_x(np.array([*known, *own])), *coordinates.bounds)

    def _equivalent(self, x: RealArray, residual: OutputErrorSet) -> Likelihood:
        """Return the data with the describing function at the amplitudes of x."""
        return Likelihood(make_equivalent(self.likelihood.problem, x), residual)

    def refit(self, fit: ExactFit) -> ExactFit:
        """Return the fit with wider minima first, or the same if that is not better."""
        residual = OutputErrorSet(tuple(self.data.soften(LOCATION.soft_error)), ())
        x = _descend(replace(self.likelihood, residual=residual), fit.x)
        found = self._end(_descend(self.likelihood, x))
        return fit if found is None or found.cost >= fit.cost else found

    def _end(self, x: RealArray) -> ExactFit | None:
        problem = self.likelihood.problem
        local = self.likelihood.residual.local(problem, x)
        if local is None:
            return None
        coordinates = problem.coordinates
        found = coordinates.parameters.apply(self.model, coordinates.to_values(x))
        return ExactFit(coordinates, x, local, self, found)


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
    return part if solver is None else part.with_solver(solver)


def _weaken(element: NonlinearElement, unknowns: Sequence[Parameter], share: float) -> list[float]:
    """Return the values of the unknowns of an element for a share of its force."""
    values = list_parameters(element)
    is_force = {p.quantity: parameter_unit(element, p.quantity).startswith("N") for p in unknowns}
    return [values[name] * (share if force else 1.0) for name, force in is_force.items()]
