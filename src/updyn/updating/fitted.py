"""Fit of a run: choice of the lines, search and fit."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np

from updyn.errors import SolverError, UpdynWarning
from updyn.settings import ROUNDING
from updyn.updating.assembly import Assembly
from updyn.updating.fit.equivalent import find_equivalent_start
from updyn.updating.fit.method import Fit
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.settings import DESCENT, REDUCED_TIER
from updyn.updating.problem.lines import restrict_to_lines
from updyn.updating.problem.modal import check_any_pair
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.session import Stopped

__all__ = ["Fitted", "fit_tests"]


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A fit, and the problem on the fitted lines with the models at its end."""

    problem: Problem
    fit: Fit


def fit_tests(assembly: Assembly, monitor: Monitor) -> Fitted:
    """Choose the lines and fit; raises `SolverError` if the model is singular near its start, too.

    If it is singular at the start, because a line is a natural frequency of an undamped model, the
    fit starts from slightly changed unknowns.
    """
    return _confirm_modes(assembly, _fit_from_regular_start(assembly, monitor), monitor)


def _confirm_modes(assembly: Assembly, fitted: Fitted, monitor: Monitor) -> Fitted:
    """Compare the modes at the end of a fit with those of the full models; refit if they differ."""
    # With reduced models of FRFs there is no refit, because their certificate belongs to this end.
    setup, problem, fit = assembly.setup, fitted.problem, fitted.fit
    if all(part.reduction is None for part in problem.modal):
        return fitted
    for _ in range(REDUCED_TIER.most_modal_refits):
        if fit.reason in ("stopped", "failed"):
            break
        try:
            with monitor.stage("reduce"):
                confirmed = [part.confirm(fit.x) for part in problem.modal]
                if all(confirmed) or assembly.reduced is not None:
                    break
            refit = setup.driver.fit(problem, setup.noises, monitor, fit.x)
        except Stopped:
            fit = replace(fit, reason="stopped")
            break
        except SolverError:  # the record states that the modes were not compared
            break
        fit = replace(refit, rivals=fit.rivals)
    return replace(fitted, fit=fit)


def _fit_from_regular_start(assembly: Assembly, monitor: Monitor) -> Fitted:
    """Fit from the start, or from slightly changed unknowns if the model is singular there."""
    try:
        return _fit_from_start(assembly, monitor)
    except SolverError as error:
        changed = replace(assembly, problem=_perturb_start(assembly.problem))
        if assembly.reduced is not None:
            assembly.reduced.restart(_perturb_start(assembly.reduced.exact))
        try:
            fitted = _fit_from_start(changed, monitor)
        except SolverError:
            raise error from None  # no unknown affects the singularity
        text = (
            f"{error}. The fit starts 0.1 % from the start of the unknowns, where it can be solved"
        )
        warnings.warn(text, UpdynWarning, stacklevel=4)
        return fitted


def _perturb_start(problem: Problem) -> Problem:
    """Return the problem with a slightly changed start, each unknown by a different amount."""
    # Stiffnesses increase and masses decrease, which changes natural frequencies; damping
    # increases.
    coordinates = problem.coordinates
    x, (lower, upper) = coordinates.start, coordinates.bounds
    share = 0.5 + 0.5 * np.random.default_rng(0).random(len(x))
    is_mass = np.array([p.quantity == "mass" for p in coordinates.parameters])
    step = DESCENT.start_change * share * np.where(is_mass, -1.0, 1.0)
    step = np.where((x + step < lower) | (x + step > upper), -step, step)
    return problem.with_coordinates(coordinates.with_start(x + step))


def _fit_from_start(assembly: Assembly, monitor: Monitor) -> Fitted:
    """Choose the lines and fit from the start; raise `SolverError` if it cannot be solved there."""
    setup, reduced = assembly.setup, assembly.reduced
    problem, x = assembly.problem, assembly.problem.coordinates.start
    try:
        with monitor.stage("start"):
            if reduced is not None:
                reduced.begin()
                problem = reduced.with_reduced_models(problem)
            problem = _on_chosen_lines(assembly, problem)
            monitor.problem = problem
            for part in problem.parts:
                part.responses(x)
            if problem.modal and not problem.parts:
                check_any_pair(problem.modal, x)
        try:
            if reduced is not None:
                return Fitted(*reduced.fit(problem, setup.driver, setup.noises, monitor))
            if not problem.is_linear:
                begin = find_equivalent_start(problem, setup.driver, setup.noises, monitor)
                x = begin.points[0]
                return Fitted(problem, setup.driver.fit(problem, setup.noises, monitor, x))
            starts = setup.driver.search(problem, setup.noises, monitor)
            return Fitted(problem, setup.driver.fit_best(problem, setup.noises, monitor, starts))
        except SolverError as error:
            return Fitted(problem, Fit.without_jacobian(x, "failed", str(error)))
    except Stopped:
        return Fitted(problem, Fit.without_jacobian(x, "stopped"))


def _on_chosen_lines(assembly: Assembly, problem: Problem) -> Problem:
    """Return the problem on the chosen lines, without channels whose values are rounding."""
    lines = [test.lines for test in assembly.setup.frf_tests]
    finest = ROUNDING.receptance_share if assembly.reduced is None else REDUCED_TIER.finest_error
    x = problem.coordinates.start
    parts = map(restrict_to_lines, problem.parts, lines)
    return problem.with_parts([part.without_rounding(x, finest) for part in parts])
