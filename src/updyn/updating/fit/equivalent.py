"""Start of a fit with nonlinear elements: each is replaced by its describing function.

At given amplitudes of the deformations, the model is linear at each line: no solution jumps, and
the search for the basin is that of a linear model. Amplitudes are those of the data where all
degrees of freedom of an element are measured. Otherwise they follow from the data and the linear
model, or from the model alone if there are fewer responses than elements; they are renewed until
they no longer change the estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from updyn.arrays import RealArray
from updyn.errors import SolverError
from updyn.updating.fit.method import Method, Starts, descend
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.search import thin_problem
from updyn.updating.fit.settings import EQUIVALENT_START
from updyn.updating.fit.trust_region import TrustRegion
from updyn.updating.problem.forward import EquivalentForward, PeriodicForward
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import make_log_error

__all__ = ["find_equivalent_start", "make_equivalent"]


def find_equivalent_start(
    problem: Problem, strategy: Method, noises: Sequence[NoiseModel], monitor: Monitor
) -> Starts:
    """Return the starts of a fit: the best basins of the equivalent linear models."""
    x = problem.coordinates.start
    equivalent = make_equivalent(problem, x)
    starts = strategy.search(equivalent, noises, monitor)
    best = starts.points[0]
    for _ in range(EQUIVALENT_START.rounds):
        few = thin_problem(make_equivalent(problem, best), noises)
        with monitor.stage("search", few):
            settings = TrustRegion(EQUIVALENT_START.steps, EQUIVALENT_START.tolerance)
            found = descend(few, make_log_error(few), best, monitor, settings)
        moved, best = np.abs(found.x - best).max(), found.x
        if monitor.stopped or moved <= EQUIVALENT_START.settled:
            break
    return replace(starts, points=(best, *starts.points[1:]))


def make_equivalent(problem: Problem, x: RealArray) -> Problem:
    """Return the problem with equivalent linear elements at the amplitudes of x and of the data."""
    return problem.with_parts([_linearise(part, x) for part in problem.parts])


def _linearise(part: FRFPart, x: RealArray) -> FRFPart:
    forward = part.forward
    if not isinstance(forward, PeriodicForward):
        return part
    amplitudes, known = forward.local.measured(part)
    if not known.all():
        other = forward.local.reconstructed(part, x)
        other = _predict(part, forward, x) if other is None else other
        amplitudes[:, ~known] = other[:, ~known]
    floor = EQUIVALENT_START.least_amplitude * amplitudes.max(axis=0)
    amplitudes = np.maximum(amplitudes, np.maximum(floor, np.finfo(np.float64).tiny))
    return replace(part, forward=EquivalentForward(forward.local, part.frf.freq, amplitudes))


def _predict(part: FRFPart, forward: PeriodicForward, x: RealArray) -> RealArray:
    """Return the amplitudes at x; those at the start if the balance cannot be solved at x."""
    try:
        return forward.amplitudes(part, x)
    except SolverError:
        return forward.amplitudes(part, part.coordinates.start)
