"""`RestoredFit`: the problem, estimate and noise of a finished update, for further analysis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from updyn.arrays import RealArray
from updyn.errors import OptionError, suggest
from updyn.uncertainty.likelihood import Likelihood
from updyn.updating.fit.methods import METHODS, make_method, methods_with, options_of
from updyn.updating.judge.alternatives import Alternative
from updyn.updating.problem.noise import NoiseModel, Robust, choose_noise, restore_noise
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import OutputError, OutputErrorSet
from updyn.updating.problem.session import Session
from updyn.updating.result import JointResult, UpdateResult

__all__ = [
    "AT_MINIMUM",
    "LIKELIHOOD",
    "STATES_NOISE",
    "RestoredFit",
    "at_alternative",
    "estimate_of",
    "find_positions",
    "list_results",
    "restore",
    "solver_options",
    "std_of",
]


#: Attribute of methods (`updyn.updating.fit.method.Method`) that minimise a likelihood.
LIKELIHOOD = "is_likelihood"
#: Attribute of methods whose noise record is enough to generate data.
STATES_NOISE = "states_noise"
#: Statuses of a fit at a minimum.
AT_MINIMUM = ("converged", "not-credible", "not-identifiable", "stalled")


@dataclass(frozen=True, slots=True, eq=False)
class RestoredFit:
    """A finished update, restored for further analysis.

    `whole` has the full models, `problem` the ones that are solved, reduced if large. `x`, shape
    (n,), is the estimate, in the optimiser's coordinates; `inflation` the factor on the standard
    deviations of the noise, as the fit applied it.
    """

    results: tuple[UpdateResult, ...]
    whole: Problem
    problem: Problem
    x: RealArray
    inflation: float

    @property
    def first(self) -> UpdateResult:
        """The result of the first test, for properties common to all tests."""
        return self.results[0]

    @property
    def names(self) -> list[str]:
        """Names of the unknowns."""
        return self.first.parameters.names

    @property
    def is_reduced(self) -> bool:
        """Whether it is solved in reduced models, which are valid only near the estimate."""
        return self.problem is not self.whole

    def with_problem(self, problem: Problem) -> RestoredFit:
        """Return the fit with another problem."""
        return replace(self, problem=problem)

    def noises(self) -> tuple[NoiseModel, ...]:
        """Return the noise model of each part at the end of the fit, with no free parameters."""
        return tuple(
            _restore_noise(result, part, self.x, self.problem.share(part))
            for result, part in zip(self.results, self.problem.parts, strict=True)
        )

    def variances(self) -> list[RealArray]:
        """Return E|dH|^2 of each part, inflation included, in the unit of its data squared."""
        variances = []
        for noise, part in zip(self.noises(), self.problem.parts, strict=True):
            variance = noise.variance(part.responses(self.x), part.frf)
            variances.append(variance * self.inflation**2)
        return variances

    def likelihood(self) -> Likelihood:
        """Return the likelihood of the fit, with the weights at the estimate."""
        residuals = []
        for variance in self.variances():
            residuals.append(OutputError(np.sqrt(2.0 / variance)))
        return Likelihood(self.problem, OutputErrorSet(tuple(residuals)))

    def initial_noises(self) -> tuple[NoiseModel, ...]:
        """Return the noise models at the start of the fit, their levels not estimated yet."""
        return tuple(map(_initial_noise, self.results, self.problem.parts, self.noises()))

    def method(self) -> Any:
        """Return the method with the options of the fit, without its search."""
        known = options_of(self.first.method)
        options = {k: v for k, v in self.first.options.items() if k in known}
        if "starts" in known:
            options["starts"] = 0
        return make_method(self.first.method, options)


def restore(
    result: UpdateResult | JointResult,
    session: Session | None = None,
    attribute: str = LIKELIHOOD,
    statuses: Sequence[str] = AT_MINIMUM,
) -> RestoredFit:
    """Restore the problem, estimate and noise of an update.

    Raises OptionError if it is no result, its method lacks `attribute` (`LIKELIHOOD` or
    `STATES_NOISE`), it is regularised, or the fit did not end with one of the `statuses`.
    """
    results = list_results(result)
    first = results[0]
    if not getattr(METHODS.find(first.method), attribute):
        accepted = " or ".join(map(repr, methods_with(attribute)))
        raise OptionError(
            f"method {first.method!r} does not minimise a likelihood; update with {accepted}"
        )
    if "regularise" in first.options:
        raise OptionError(
            "a regularised fit has no likelihood from which its uncertainty follows; give the"
            " unknowns priors (prior_std)"
        )
    if first.status not in statuses or not all(r.noise for r in results):
        raise OptionError(
            f"the update has ended as {first.status!r}, not at a minimum of the misfit:"
            f" {first.message}"
        )
    session = session or Session()
    parts = []
    for number, one in enumerate(results):
        name = ""
        if len(results) > 1:
            name = str(number)
        parts.append(_build_part(one, session, name))
    problem = Problem.of(parts)
    x = problem.coordinates.to_x(estimate_of(first))
    inflation = float(first.noise.get("inflation", 1.0))
    return RestoredFit(results, problem, problem, x, inflation)


def estimate_of(result: UpdateResult) -> RealArray:
    """Return the estimate in the units of the unknowns, shape (n,)."""
    return np.array([result.values[name] for name in result.parameters.names])


def at_alternative(
    result: UpdateResult | JointResult, other: Alternative, covariance: RealArray | None = None
) -> UpdateResult | JointResult:
    """Return an update with values and models of another answer; by default its covariance."""
    if isinstance(result, JointResult):
        found = {
            name: _at_alternative(one, other, covariance) for name, one in result.results.items()
        }
        return replace(result, results=found)
    return _at_alternative(result, other, covariance)


def _at_alternative(
    result: UpdateResult, other: Alternative, covariance: RealArray | None
) -> UpdateResult:
    names = result.parameters.names
    values = np.array([other.values[name] for name in names])
    model = result.parameters.apply(result.start, values)
    found = replace(result, values=dict(other.values), model=model, alternatives=())
    if covariance is None:
        return found
    std = np.sqrt(np.diag(covariance)).tolist()
    return replace(found, covariance=covariance, std=dict(zip(names, std, strict=True)))


def std_of(result: UpdateResult) -> RealArray:
    """Return the standard deviations in the units of the unknowns, shape (n,)."""
    return np.array([result.std[name] for name in result.parameters.names])


def list_results(result: UpdateResult | JointResult) -> tuple[UpdateResult, ...]:
    """Return the result of each test; OptionError if it is not a result."""
    if not isinstance(result, UpdateResult | JointResult):
        raise OptionError(f"expected the result of an update, found {type(result).__name__}")
    return tuple(result.results.values())


def find_positions(names: Sequence[str] | str | None, known: Sequence[str]) -> list[int]:
    """Return the positions of the named unknowns, by default of all."""
    if names is None:
        return list(range(len(known)))
    if isinstance(names, str):
        names = [names]
    positions: list[int] = []
    for name in names:
        if name not in known:
            raise OptionError(f"no unknown {name!r}; {suggest(str(name), known)}")
        at = list(known).index(name)
        if at in positions:
            raise OptionError(f"unknown {name!r} is named twice")
        positions.append(at)
    if not positions:
        raise OptionError("names: expected at least one unknown, found none")
    return positions


def _build_part(result: UpdateResult, session: Session, name: str) -> FRFPart:
    """Return model and fitted data of one test."""
    frf = result.frf.select(lines=result.lines, responses=result.fitted_responses)
    tier, backend = solver_options(result)
    return FRFPart.build(
        result.start, frf, result.parameters, tier=tier, backend=backend, session=session, name=name
    )


def solver_options(result: UpdateResult) -> tuple[str | None, str | None]:
    """Return tier and backend of the whole model of an update, for `FRFPart.build`."""
    tier = result.options.get("tier")
    if tier == "reduced":
        tier = "sparse"
    return tier, None if tier == "dense" else result.options.get("backend")


def _restore_noise(
    result: UpdateResult, part: FRFPart, x: RealArray, n_unknowns: int
) -> NoiseModel:
    """Return the recorded noise model, weights of outliers evaluated at the estimate."""
    noise = restore_noise(result.noise, result.frf.select(responses=result.fitted_responses))
    if isinstance(noise, Robust):
        return noise.refit(part.responses(x), part.frf, n_unknowns)
    return noise


def _initial_noise(result: UpdateResult, part: FRFPart, noise: NoiseModel) -> NoiseModel:
    """Return the noise model before estimation, or `noise` if nothing was estimated."""
    robust = {}
    if "robust" in result.noise:
        robust["robust"] = str(result.noise["robust"])
    for source in ("estimated", "estimated-by-channel"):
        model = choose_noise({"source": source} | robust, part.frf)
        if model.kind == result.noise.get("kind"):
            return model
    return noise
