"""Remaining decrease at the end of a fit, and bounds that exclude values required by the data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np

from updyn.arrays import RealArray
from updyn.updating.fit.method import Fit
from updyn.updating.fit.monitor import Iteration
from updyn.updating.judge.settings import FIT_END, SIGNIFICANCE
from updyn.updating.problem.problem import Problem

__all__ = ["ActiveBound", "Ending", "assess_ending"]


@dataclass(frozen=True, slots=True)
class ActiveBound:
    """An unknown at a bound that the data would exceed.

    `deviations` is the square root of twice the decrease of half the chi-square without the bound,
    predicted by the linear model.
    """

    name: str
    side: str
    limit: float
    deviations: float


@dataclass(frozen=True, slots=True)
class Ending:
    """Remaining decrease at the end of a fit, by a full Gauss-Newton step.

    `deviations` is the length of the step in standard deviations, `share` the removed share of the
    misfit, `recent_gain` the decrease by the last ten steps over that by this one (inf if none
    remains), `leading` the unknowns that change most.
    """

    deviations: float
    share: float
    recent_gain: float
    leading: tuple[str, ...] = ()
    active_bounds: tuple[ActiveBound, ...] = ()


def assess_ending(problem: Problem, fit: Fit, history: Sequence[Iteration] = ()) -> Ending | None:
    """Return the remaining decrease at the estimate; None if the method has no reduced problem."""
    local, size = fit.local, float(np.linalg.norm(fit.R))
    if (
        local is None
        or size == 0.0
        or not np.isfinite(local.cost)
        or fit.regularisation is not None
    ):
        return None
    # Scale the residual to the standard deviations by which the fit weighted data against priors,
    # before they were widened for a correlated residual.
    inflation = _inflation(fit)
    scale = inflation * size / float(np.linalg.norm(local.R))
    weight, home = problem.coordinates.prior[1], problem.coordinates.prior[0]
    R = np.vstack([local.R * scale, np.diag(weight)])
    q = np.append(local.q * scale, weight * (fit.x - home))
    lower, upper = problem.coordinates.bounds
    near = 1e-9 * (upper - lower)
    g = R.T @ q
    low, high = (fit.x <= lower + near) & (g > 0.0), (fit.x >= upper - near) & (g < 0.0)
    free = ~(low | high)
    fall, step = _full_step(R[:, free], q)
    names = problem.coordinates.parameters.names
    leading: tuple[str, ...] = ()
    if step.size and np.abs(step).max() > 0.0:
        is_largest = np.abs(step) >= 0.5 * np.abs(step).max()
        leading = tuple(compress(compress(names, free), is_largest))
    active_bounds = []
    for i in np.flatnonzero(~free):
        without_bound = free.copy()
        without_bound[i] = True
        gain = max(_full_step(R[:, without_bound], q)[0] - fall, 0.0)
        deviations = float(np.sqrt(2.0 * gain)) / inflation
        if deviations >= SIGNIFICANCE.stds:
            parameter = problem.coordinates.parameters[int(i)]
            side, limit = ("lower", parameter.lower) if low[i] else ("upper", parameter.upper)
            active_bounds.append(ActiveBound(parameter.name, side, limit, deviations))
    cost = local.cost * scale**2
    recent_gain = _recent_decrease(history) * scale**2 / fall if fall > 0.0 else np.inf
    share = fall / cost if cost > 0.0 else 0.0
    return Ending(
        float(np.sqrt(2.0 * fall)) / inflation, share, recent_gain, leading, tuple(active_bounds)
    )


def _inflation(fit: Fit) -> float:
    """Return the factor by which the standard deviations of a fit were widened."""
    found = float(fit.noise[0].get("inflation", 1.0)) if fit.noise else 1.0
    return found if found > 0.0 else 1.0


def _full_step(R: RealArray, q: RealArray) -> tuple[float, RealArray]:
    """Return the decrease of half the chi-square by a Gauss-Newton step, and the step."""
    if R.shape[1] == 0:
        return 0.0, np.zeros(0)
    norms = np.linalg.norm(R, axis=0)
    norms = np.where(norms > 0.0, norms, 1.0)
    step = np.linalg.lstsq(R / norms, -q, rcond=None)[0] / norms
    change = R @ step
    return max(float(-(change @ q) - 0.5 * (change @ change)), 0.0), step


def _recent_decrease(history: Sequence[Iteration]) -> float:
    """Return the decrease of the cost by the last steps of the last stage."""
    last = [h for h in history if h.stage == history[-1].stage][-FIT_END.recent_steps - 1 :]
    costs = [h.cost for h in last if h.accepted]
    return max(float(costs[0] - costs[-1]), 0.0) if costs else 0.0
