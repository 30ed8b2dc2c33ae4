"""What a finished update is brought back to: its problem, its estimate and its noise, to be asked further questions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.errors import OptionError, suggest
from updyn.uncertainty.likelihood import Likelihood
from updyn.updating.fit.methods import METHODS, make_method, methods_with, options_of
from updyn.updating.problem.noise import NoiseModel, Robust, choose_noise, noise_of_record
from updyn.updating.problem.problem import Part, Problem
from updyn.updating.problem.residuals import Each, OutputError
from updyn.updating.problem.session import Session
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["LIKELIHOOD", "WITH_NOISE", "RestoredFit", "parts_of", "positions_of", "restore"]

_Vector = NDArray[np.float64]

#: What methods state (`updyn.updating.fit.method.Method`): that they minimise a likelihood; that
#: their noise record is enough to make data anew.
LIKELIHOOD = "is_likelihood"
WITH_NOISE = "states_noise"
#: How an update has to have ended.
_ENDED = ("converged", "not-identifiable", "stalled")


@dataclass(frozen=True, slots=True, eq=False)
class RestoredFit:
    """An update that has ended, ready to be looked at again.

    Attributes
    ----------
    results : tuple of UpdateResult
        One for each test.
    problem : Problem
        Model, data of the fit and unknowns.
    x : ndarray of float, shape (n,)
        The estimate, in the optimiser's coordinates.
    noises : tuple of NoiseModel
        How uncertain the data of each part are, as the fit ended: nothing is estimated any more.
    inflation : float
        Factor on the standard deviations of the noise, as the fit applied it.
    """

    results: tuple[UpdateResult, ...]
    problem: Problem
    x: _Vector
    noises: tuple[NoiseModel, ...]
    inflation: float

    @property
    def first(self) -> UpdateResult:
        """The result of the first test, for what is the same in all."""
        return self.results[0]

    @property
    def names(self) -> list[str]:
        """The unknowns."""
        return self.first.parameters.names

    def with_problem(self, problem: Problem) -> RestoredFit:
        """Return the setting with a problem that is solved otherwise."""
        return replace(self, problem=problem)

    def variances(self) -> list[NDArray[np.float64]]:
        """Return E|dH|^2 of each part, inflation included, in the unit of its data squared.

        Raises
        ------
        SolverError
            If the model cannot be solved at the estimate.
        """
        pairs = zip(self.noises, self.problem.parts, strict=True)
        return [
            noise.variance(p.responses(self.x), p.frf) * self.inflation**2 for noise, p in pairs
        ]

    def likelihood(self) -> Likelihood:
        """Return the likelihood of the fit, its weights held as they are at the estimate.

        Raises
        ------
        SolverError
            If the model cannot be solved at the estimate.
        """
        return Likelihood(
            self.problem, Each(tuple(OutputError(np.sqrt(2.0 / v)) for v in self.variances()))
        )

    def begun(self) -> tuple[NoiseModel, ...]:
        """Return the noise models as the fit began with them: numbers that are estimated are not known yet."""
        triples = zip(self.results, self.problem.parts, self.noises, strict=True)
        return tuple(_begun(result, part, noise) for result, part, noise in triples)

    def strategy(self) -> Any:
        """Return the method as it was used, without its search."""
        known = options_of(self.first.method)
        options = {k: v for k, v in self.first.options.items() if k in known}
        return make_method(
            self.first.method, options | ({"starts": 0} if "starts" in known else {})
        )


def restore(
    result: UpdateResult | JointResult,
    session: Session | None = None,
    stated: str = LIKELIHOOD,
) -> RestoredFit:
    """Bring an update back to its problem.

    Parameters
    ----------
    result : UpdateResult or JointResult
        A fit that has ended.
    session : Session, optional
        Where lines are solved.
    stated : str
        What the method has to state: `LIKELIHOOD` or `WITH_NOISE`.

    Returns
    -------
    RestoredFit

    Raises
    ------
    OptionError
        If it is no result, its method does not state that, it is regularised, or the fit did not end
        at a minimum.
    SolverError
        If the model cannot be solved at the estimate.
    """
    results = parts_of(result)
    first = results[0]
    if not getattr(METHODS.find(first.method), stated):
        said = " or ".join(repr(name) for name in methods_with(stated))
        raise OptionError(
            f"method {first.method!r} does not minimise a likelihood; update with {said}"
        )
    if "regularise" in first.options:
        raise OptionError(
            "a regularised fit has no likelihood that would say how sure it is; give the unknowns"
            " priors (prior_std)"
        )
    if first.status not in _ENDED or not all(r.noise for r in results):
        raise OptionError(
            f"the update has ended as {first.status!r}, not at a minimum of the misfit:"
            f" {first.message}"
        )
    session = session or Session()
    problems = [
        _problem(r, session, str(i) if len(results) > 1 else "") for i, r in enumerate(results)
    ]
    whole = Problem.of(problems)
    x = whole.coordinates.to_x(np.array([first.values[n] for n in first.parameters.names]))
    shares = [-(-whole.n * p.n_values // whole.n_values) for p in whole.parts]
    noises = tuple(_noise(r, p, x, n) for r, p, n in zip(results, whole.parts, shares, strict=True))
    return RestoredFit(results, whole, x, noises, float(first.noise.get("inflation", 1.0)))


def parts_of(result: UpdateResult | JointResult) -> tuple[UpdateResult, ...]:
    """Return the result of each test.

    Raises
    ------
    OptionError
        If it is no result.
    """
    if not isinstance(result, UpdateResult | JointResult):
        raise OptionError(f"expected the result of an update, found {type(result).__name__}")
    return tuple(result.results.values())


def positions_of(names: Sequence[str] | str | None, known: Sequence[str]) -> list[int]:
    """Return the positions of positions_of unknowns; of all where none is named.

    Raises
    ------
    OptionError
        If a name is not known (the nearest is named) or stands twice, or none is left.
    """
    if names is None:
        return list(range(len(known)))
    listed = [names] if isinstance(names, str) else list(names)
    for name in listed:
        if name not in known:
            raise OptionError(f"no unknown {name!r}; {suggest(str(name), known)}")
        if listed.count(name) > 1:
            raise OptionError(f"unknown {name!r} is named twice")
    if not listed:
        raise OptionError("names: expected at least one unknown, found none")
    return [list(known).index(name) for name in listed]


def _problem(result: UpdateResult, session: Session, name: str) -> Part:
    frf = result.frf.select(lines=result.lines, responses=result.fitted_responses)
    tier = "sparse" if result.options.get("tier") == "reduced" else result.options.get("tier")
    backend = None if tier == "dense" else result.options.get("backend")
    return Part.build(
        result.start, frf, result.parameters, tier=tier, backend=backend, session=session, name=name
    )


def _noise(result: UpdateResult, part: Part, x: _Vector, share: int) -> NoiseModel:
    noise = noise_of_record(result.noise, result.frf.select(responses=result.fitted_responses))
    # Weights of outliers are those at the estimate; the rest is as recorded.
    return noise.refit(part.responses(x), part.frf, share) if isinstance(noise, Robust) else noise


def _begun(result: UpdateResult, part: Part, noise: NoiseModel) -> NoiseModel:
    robust = {k: str(result.noise[k]) for k in ("robust",) if k in result.noise}
    for source in ("estimated", "estimated-by-channel"):
        made = choose_noise({"source": source} | robust, part.frf)
        if made.kind == result.noise.get("kind"):
            return made
    return noise
