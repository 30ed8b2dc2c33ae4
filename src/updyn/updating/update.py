"""`update`: from a model, a measurement and unknowns to a result."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from updyn import __version__
from updyn.dofs import Dof
from updyn.dynamics.fields import ACCURACY
from updyn.engines import Engine, choose_engine
from updyn.errors import OptionError, ParameterError, SolverError
from updyn.frf import FRF
from updyn.model import Model
from updyn.updating.fit import Fit, Method
from updyn.updating.journal import Journal, fingerprint
from updyn.updating.judge import at_start, judge
from updyn.updating.lines import choose_lines
from updyn.updating.methods import make_method
from updyn.updating.monitor import Monitor, Progress
from updyn.updating.noise import NoiseModel, choose_noise
from updyn.updating.parameters import ParameterSet
from updyn.updating.problem import Problem
from updyn.updating.reducing import Reducing, fallback, is_reduced
from updyn.updating.result import Identifiability, UpdateResult
from updyn.updating.session import Recent, Session, Stopped
from updyn.updating.split import split_data
from updyn.updating.verdict import verdict

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["identifiability", "update"]


def update(
    model: Model,
    frf: FRF,
    parameters: ParameterSet,
    method: str = "maximum-likelihood",
    lines: str | ArrayLike | None = None,
    noise: Mapping[str, float] | str | None = None,
    engine: int | Client | Engine | None = None,
    callback: Callable[[Progress], bool | None] | None = None,
    *,
    validation: Iterable[str | Dof] | tuple[float, float] | None = None,
    title: str = "",
    tier: str | None = None,
    backend: str | None = None,
    accuracy: float = ACCURACY,
    checkpoint: str | Path | None = None,
    resume: bool = False,
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
    engine : None, int, dask.distributed Client or Engine
        Where lines, and the tries of the search, are worked on: here one after the other, in so many processes on this
        machine, or on a cluster. The result does not depend on it.
    callback : callable, optional
        Called with a `Progress` after every step and between blocks of lines; returning True stops the run, with status
        ``"stopped"`` and the best values so far.
    validation : iterable of str or Dof, or (float, float), optional
        Responses, or a band in Hz, held out of the fit and scored afterwards.
    title : str
        For the record.
    tier : {"dense", "sparse", "reduced"}, optional
        How the model is solved; by default chosen by size. ``"reduced"`` (above 20,000 DOFs) fits inside a reduced
        model whose error is bounded where the fit ends.
    backend : str, optional
        Sparse factorisation.
    accuracy : float
        Of the reduced tier: the largest error of a receptance, as a share of the largest of its line.
    checkpoint : path, optional
        File that receives every evaluation as it is made (read `resume`). It stays; remove it once the result is safe.
    resume : bool
        Go on with the run that `checkpoint` holds, however it ended: with the same answer, to the last bit, as if it
        had not been interrupted. Everything has to be as it was but `engine` and ``max_iterations``.
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
        If model, data, unknowns or options do not fit together, or the checkpoint to resume is of another run.
    SolverError
        If the model cannot be solved at a line where it starts.
    """
    begun = time.perf_counter()
    strategy = make_method(method, options)
    _check(model, frf, parameters)
    held: Any = validation if validation is None else list(validation)
    split = split_data(frf, held)
    noise_model = choose_noise(noise, split.fitted)
    with ExitStack() as ending:
        session = Session(_engine(engine, ending), Recent())
        reducing = is_reduced(tier, model.n_dofs, len(frf.freq), method)
        exact = "sparse" if reducing else tier
        whole = Problem.build(model, split.fitted, parameters, tier=exact, backend=backend, session=session)
        reduced = Reducing(whole.with_data(frf), accuracy) if reducing else None
        options_used = {
            **{k: getattr(strategy, k) for k in strategy.__dataclass_fields__},  # type: ignore[attr-defined]
            "lines": lines if isinstance(lines, str) or lines is None else "list",
            "tier": "reduced" if reducing else whole.solver.tier,
            "backend": whole.solver.backend if whole.solver.tier == "sparse" else "lapack",
        }
        if checkpoint is not None:
            decisive = {k: v for k, v in options_used.items() if k != "max_iterations"}
            listed = lines if isinstance(lines, str) or lines is None else np.asarray(lines).tolist()
            decisive |= {"method": method, "lines": listed, "noise": noise, "validation": held, "accuracy": accuracy}
            session.memory = Journal(Path(checkpoint), fingerprint(whole, frf, decisive), resume=resume)
            ending.callback(session.memory.close)
        elif resume:
            raise OptionError("resume: name the checkpoint to go on from")
        monitor = Monitor(whole, callback)
        problem, fit = _fitted(whole, lines, strategy, noise_model, monitor, reduced)
        with monitor.stage("judge"):
            found = judge(problem, frf, split, fit, noise_model, None if reduced is None else reduced.first)
        if found.fit.reason == "stopped" and isinstance(session.memory, Journal):
            session.memory.keep()
    fit = found.fit
    status, message, remedy = verdict(fit, found.analysis, parameters.names, found.advice, found.misfit)
    values = problem.coordinates.to_values(fit.x) + 0.0  # -0.0 becomes 0.0
    # Only the unbounded plain iteration can leave a loss factor below zero; no model has one.
    after = parameters.apply(model, np.where(parameters.is_factor, values, np.maximum(values, 0.0)))
    return UpdateResult(
        status=status,
        message=message,
        remedy=remedy,
        method=method,
        options=options_used | {"engine": session.engine.name} | _solved(whole, reduced),
        start=model,
        model=after,
        frf=frf,
        lines=problem.frf.freq,
        fitted_responses=tuple(split.fitted.responses.labels),
        validation_responses=split.responses,
        validation_band=split.band,
        parameters=parameters,
        values=dict(zip(parameters.names, values.tolist(), strict=True)),
        std=dict(zip(parameters.names, np.sqrt(np.diag(found.covariance)).tolist(), strict=True)),
        covariance=found.covariance,
        at_bound=found.at_bound,
        identifiability=replace(found.analysis.report, advice=found.advice),
        history=tuple(monitor.history),
        noise=dict(fit.noise),
        correlation=found.correlation,
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
    analysis, advice = at_start(problem, choose_noise(noise, problem.frf))
    return replace(analysis.report, advice=advice)


def _solved(whole: Problem, reduced: Reducing | None) -> dict[str, Any]:
    """Return, for the record, how it was solved beyond what was asked for."""
    return fallback(whole.solver.used, whole.solver.backend) if reduced is None else reduced.record


def _engine(engine: int | Client | Engine | None, ending: ExitStack) -> Engine:
    """Return the engine, closed in the end unless the caller made it."""
    made = choose_engine(engine)
    if made is not engine:
        ending.callback(made.close)
    return made


def _fitted(
    whole: Problem,
    lines: str | ArrayLike | None,
    strategy: Method,
    noise: NoiseModel,
    monitor: Monitor,
    reduced: Reducing | None,
) -> tuple[Problem, Fit]:
    """Choose the lines and fit; return the problem on these lines, too."""
    x, problem = whole.coordinates.to_x(whole.coordinates.parameters.start), whole
    try:
        with monitor.stage("start"):
            if reduced is not None:
                reduced.begin()
                problem = whole = reduced.inside(whole)
            problem = monitor.problem = _on_lines(whole, lines)
            problem.responses(x)  # a start that cannot be solved is the user's to know
        try:
            if reduced is not None:
                return reduced.fit(problem, strategy, noise, monitor)
            return problem, strategy.fit(problem, noise, monitor, strategy.search(problem, monitor))
        except SolverError as error:
            return problem, Fit.blind(x, "failed", str(error))
    except Stopped:
        return problem, Fit.blind(x, "stopped")


def _check(model: Model, frf: FRF, parameters: ParameterSet) -> None:
    for given, kind in ((model, Model), (frf, FRF), (parameters, ParameterSet)):
        if not isinstance(given, kind):
            raise OptionError(f"expected a {kind.__name__}, found {type(given).__name__}")
    for p in parameters:
        for d in p.acts_on:
            group = model.group(d.group)
            if getattr(group, "stiffness" if d.quantity == "loss_factor" else d.quantity) is None:
                raise ParameterError(f"unknown {p.name!r}: group {d.group!r} has no {d.quantity} in this model")
    model.dofs.match(frf.responses, "response")
    model.dofs.match(frf.references, "reference")


def _on_lines(problem: Problem, lines: str | ArrayLike | None) -> Problem:
    at = choose_lines(lines, problem)
    return (
        problem
        if len(at) == len(problem.frf.freq)
        else replace(problem, frf=problem.frf.select(lines=problem.frf.freq[at]))
    )
