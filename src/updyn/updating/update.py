"""`update`: from a model, a measurement and unknowns to a result."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from updyn import __version__
from updyn.correlation import correlate
from updyn.dofs import Dof, DofSet
from updyn.dynamics.response import response
from updyn.errors import DataError, OptionError, ParameterError, SolverError
from updyn.frf import FRF
from updyn.model import Model
from updyn.updating.cure import advise
from updyn.updating.fit import Fit
from updyn.updating.identifiability import Analysis, analyse
from updyn.updating.lines import choose_lines
from updyn.updating.methods import make_method
from updyn.updating.monitor import Monitor, Progress
from updyn.updating.noise import ASSUMED, Estimated, NoiseModel, choose_noise
from updyn.updating.parameters import ParameterSet
from updyn.updating.problem import Problem
from updyn.updating.residuals import OutputError
from updyn.updating.result import Identifiability, UpdateResult
from updyn.updating.verdict import verdict

__all__ = ["identifiability", "update"]


@dataclass(frozen=True, slots=True)
class _Split:
    """Which part of the data is fitted and which is held out."""

    fitted: FRF
    responses: tuple[str, ...] = ()
    band: tuple[float, float] | None = None
    held: FRF | None = None


def update(
    model: Model,
    frf: FRF,
    parameters: ParameterSet,
    method: str = "maximum-likelihood",
    lines: str | ArrayLike | None = None,
    noise: Mapping[str, float] | str | None = None,
    engine: None = None,
    callback: Callable[[Progress], bool | None] | None = None,
    *,
    validation: Iterable[str | Dof] | tuple[float, float] | None = None,
    title: str = "",
    tier: str | None = None,
    backend: str | None = None,
    **options: Any,
) -> UpdateResult:
    """Find the values of the unknowns with which the model answers as the structure does.

    Parameters
    ----------
    model : Model
        The model to start from.
    frf : FRF
        The measurement. Every response and reference has to be a DOF of the model.
    parameters : ParameterSet
        The unknowns, from `updyn.parameters`.
    method : str
        ``"maximum-likelihood"`` (default), ``"log"``, ``"output-error"`` or ``"equation-error"`` (the paper's).
    lines : None, str or array_like of float
        Lines to fit: all, ``"d-optimal:40"``, or a list in Hz.
    noise : None, str or mapping
        None: from the data's variance, else coherence, else estimated from the residual. A mapping with ``relative``
        and/or ``floor`` states E|dH|^2 = (relative |H|)^2 + (floor rms)^2; ``"variance"``, ``"coherence"``,
        ``"estimated"`` force one source.
    engine : None
        Where the lines are solved; so far here, one after the other.
    callback : callable, optional
        Called with a `Progress` after every step; returning True stops the run, with status ``"stopped"``.
    validation : iterable of str or Dof, or (float, float), optional
        Responses, or a band in Hz, held out of the fit and scored afterwards.
    title : str
        For the record.
    tier : {"dense", "sparse"}, optional
        How the model is solved; by default chosen by size.
    backend : str, optional
        Sparse factorisation.
    **options
        Options of the method: ``max_iterations``, ``tolerance``; ``starts``, ``seed`` (maximum-likelihood, log);
        ``solver`` (equation-error).

    Returns
    -------
    UpdateResult
        A fit that fails says so in its status; nothing is raised for it.

    Raises
    ------
    InputError
        If model, data, unknowns or options do not fit together.
    SolverError
        If the model cannot be solved at a line where it starts.
    """
    begun = time.perf_counter()
    if engine is not None:
        raise OptionError(f"engine {engine!r}: only None, lines solved in this process, is available")
    strategy = make_method(method, options)
    _check(model, frf, parameters)
    split = _split(frf, validation)
    problem = _on_lines(Problem.build(model, split.fitted, parameters, tier=tier, backend=backend), lines)
    noise_model = choose_noise(noise, problem.frf)
    problem.responses(problem.coordinates.to_x(parameters.start))  # a start that cannot be solved is the user's to know
    monitor = Monitor(problem, callback)
    try:
        fit = strategy.fit(problem, noise_model, monitor)
    except SolverError as error:
        x = problem.coordinates.to_x(parameters.start)
        fit = Fit(x, "failed", np.zeros((len(parameters),) * 2), note=str(error))
    if fit.reason == "failed":  # where it broke down says nothing about the data; the start does
        analysis, advice = _at_start(problem, noise_model)
        misfit = 0.0
        fit = replace(fit, R=np.zeros((len(parameters),) * 2))
    else:
        analysis = analyse(fit.R, parameters.names)
        misfit = _typical_misfit(problem, fit.x)
        advice = advise(analysis, problem, fit.x, misfit)
    values = problem.coordinates.to_values(fit.x) + 0.0  # -0.0 becomes 0.0
    # Only the unbounded plain iteration can leave a loss factor below zero; no model has one.
    after = parameters.apply(model, np.where(problem.unknowns.is_loss, np.maximum(values, 0.0), values))
    covariance = _covariance(problem, fit)
    status, message, remedy = verdict(fit, analysis, parameters.names, advice, misfit)
    options_used = {
        **{k: getattr(strategy, k) for k in strategy.__dataclass_fields__},  # type: ignore[attr-defined]
        "lines": lines if isinstance(lines, str) or lines is None else "list",
        "tier": problem.solver.tier,
        "backend": problem.solver.backend if problem.solver.tier == "sparse" else "lapack",
    }
    with monitor.stage("judge"):
        correlation = _correlation(model, after, split, frf)
    return UpdateResult(
        status=status,
        message=message,
        remedy=remedy,
        method=method,
        options=options_used,
        start=model,
        model=after,
        frf=frf,
        lines=problem.frf.freq,
        fitted_responses=tuple(split.fitted.responses.labels),
        validation_responses=split.responses,
        validation_band=split.band,
        parameters=parameters,
        values=dict(zip(parameters.names, values.tolist(), strict=True)),
        std=dict(zip(parameters.names, np.sqrt(np.diag(covariance)).tolist(), strict=True)),
        covariance=covariance,
        at_bound=_at_bound(problem, fit.x, parameters),
        identifiability=replace(analysis.report, advice=advice),
        history=tuple(monitor.history),
        noise=dict(fit.noise),
        correlation=correlation,
        timing_s={**monitor.timing_s, "total": time.perf_counter() - begun},
        versions={
            "updyn": __version__,
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "python": platform.python_version(),
            "platform": platform.platform(terse=True),
        },
        title=title,
    )


def identifiability(
    model: Model,
    frf: FRF,
    parameters: ParameterSet,
    lines: str | ArrayLike | None = None,
    noise: Mapping[str, float] | str | None = None,
) -> Identifiability:
    """Say what a measurement could determine, at the start of the unknowns and before any fit.

    Parameters
    ----------
    model, frf, parameters, lines, noise
        As for `update`. Where neither `noise` nor the data say how noisy they are, 5 % of |H| and a floor of 0.1 % of
        the rms are assumed.

    Returns
    -------
    Identifiability

    Raises
    ------
    InputError
        If model, data, unknowns or options do not fit together.
    SolverError
        If the model cannot be solved at a line.
    """
    _check(model, frf, parameters)
    problem = _on_lines(Problem.build(model, frf, parameters), lines)
    analysis, advice = _at_start(problem, choose_noise(noise, problem.frf))
    return replace(analysis.report, advice=advice)


def _at_start(problem: Problem, noise: NoiseModel) -> tuple[Analysis, str]:
    """Analyse the data at the start of the unknowns, and advise."""
    if noise.kind == Estimated.kind:
        noise = choose_noise(ASSUMED, problem.frf)
    x = problem.coordinates.to_x(problem.coordinates.parameters.start)
    H = problem.responses(x)
    variance = noise.variance(H, problem.frf)
    local = OutputError(np.sqrt(2.0 / variance)).local(problem, x)
    if local is None:
        raise SolverError("the model cannot be solved at its start")
    analysis = analyse(local.R, problem.coordinates.parameters.names)
    share = np.median(np.sqrt(variance) / np.maximum(np.abs(H), np.finfo(float).tiny))
    return analysis, advise(analysis, problem, x, float(share))


def _check(model: Model, frf: FRF, parameters: ParameterSet) -> None:
    for given, kind in ((model, Model), (frf, FRF), (parameters, ParameterSet)):
        if not isinstance(given, kind):
            raise OptionError(f"expected a {kind.__name__}, found {type(given).__name__}")
    for p in parameters:
        group = model.group(p.group)
        if getattr(group, "stiffness" if p.quantity == "loss_factor" else p.quantity) is None:
            raise ParameterError(f"unknown {p.name!r}: the group has no {p.quantity} in this model")
    model.dofs.match(frf.responses, "response")
    model.dofs.match(frf.references, "reference")


def _split(frf: FRF, validation: Iterable[str | Dof] | tuple[float, float] | None) -> _Split:
    if validation is None:
        return _Split(frf)
    given = list(validation)
    if not given:
        return _Split(frf)
    if all(isinstance(v, int | float) for v in given):
        if len(given) != 2:
            raise DataError(f"validation {given!r}: expected two frequencies in Hz, or response labels")
        low, high = float(given[0]), float(given[1])  # type: ignore[arg-type]
        held = frf.select(band=(low, high))
        kept = frf.freq[(frf.freq < low) | (frf.freq > high)]
        if kept.size == 0:
            raise DataError(f"validation band {low:g} to {high:g} Hz holds all lines: nothing is left to fit")
        return _Split(frf.select(lines=kept), band=(low, high), held=held)
    chosen = DofSet(given)  # type: ignore[arg-type]
    at = np.sort(frf.responses.match(chosen, "validation response").index)
    rest = np.setdiff1d(np.arange(len(frf.responses)), at)
    if rest.size == 0:
        raise DataError("validation holds out all responses: nothing is left to fit")
    held_set, fitted_set = frf.responses[at], frf.responses[rest]
    return _Split(frf.select(responses=fitted_set), tuple(held_set.labels), held=frf.select(responses=held_set))


def _on_lines(problem: Problem, lines: str | ArrayLike | None) -> Problem:
    at = choose_lines(lines, problem)
    return (
        problem
        if len(at) == len(problem.frf.freq)
        else replace(problem, frf=problem.frf.select(lines=problem.frf.freq[at]))
    )


def _covariance(problem: Problem, fit: Fit) -> NDArray[np.float64]:
    """Return the covariance of the values: from data and priors; inf for unknowns that both leave open."""
    slope = problem.coordinates.slope(fit.x)
    weight = problem.coordinates.prior[1]
    analysis = analyse(np.vstack([fit.R, np.diag(weight)]), problem.coordinates.parameters.names)
    out = analysis.covariance * slope[:, None] * slope
    out[analysis.involved] = np.inf
    out[:, analysis.involved] = np.inf
    return np.asarray(out)


def _typical_misfit(problem: Problem, x: NDArray[np.float64]) -> float:
    """Return the median of |H - H_X| / |H_X|: what noise and model error leave."""
    measured = problem.frf.values
    seen = np.abs(measured) > 0
    misfit = np.abs(problem.responses(x) - measured)[seen] / np.abs(measured)[seen]
    return float(np.median(misfit)) if misfit.size else 0.0


def _at_bound(problem: Problem, x: NDArray[np.float64], parameters: ParameterSet) -> dict[str, str]:
    lower, upper = problem.coordinates.bounds
    near = 1e-9 * (upper - lower)
    sides = np.where(x <= lower + near, "lower", np.where(x >= upper - near, "upper", ""))
    return {n: str(s) for n, s in zip(parameters.names, sides, strict=True) if s}


def _correlation(before: Model, after: Model, split: _Split, frf: FRF) -> dict[str, Any]:
    parts = {"fitted": split.fitted} | ({} if split.held is None else {"held": split.held})
    scored = {when: _scores(model, frf, parts) for when, model in (("before", before), ("after", after))}
    out: dict[str, Any] = {when: scored[when].get("fitted", {}) for when in scored}
    if split.held is not None:
        out["validation"] = {when: scored[when].get("held", {}) for when in scored}
    return out


def _scores(model: Model, frf: FRF, parts: Mapping[str, FRF]) -> dict[str, dict[str, float]]:
    """Score a model on parts of the data, solving it once for all of them; empty where it cannot be solved."""
    try:
        answer = response(model, frf.freq, frf.responses, frf.references, frf.quantity)
    except SolverError:
        return {}
    return {
        name: dict(correlate(answer.select(lines=part.freq, responses=part.responses), part).figures())
        for name, part in parts.items()
    }
