"""Start of a fit with nonlinear elements: each is replaced by its describing function.

At given amplitudes of the deformations, the model is linear at each line: no solution jumps, and
the search for the basin is that of a linear model. Under a random force, the element is replaced by
the spring and the damper of a given motion.

Amplitudes are those of the data where all degrees of freedom of an element are measured. Otherwise
they follow from the data and the linear model, or from the model alone if there are fewer responses
than elements; they are renewed until they no longer change the estimate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from updyn.arrays import RealArray
from updyn.errors import SolverError
from updyn.updating.fit.method import Method, Starts, descend
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.search import thin_problem
from updyn.updating.fit.settings import EQUIVALENT_START
from updyn.updating.fit.trust_region import TrustRegion
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.periodic_forward import EquivalentForward, PeriodicForward
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.random_forward import FixedRandomForward, RandomForward
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
    if isinstance(forward, RandomForward):
        return replace(part, forward=FixedRandomForward(forward.local, _estimate(part, forward, x)))
    if not isinstance(forward, PeriodicForward):
        return part
    amplitudes, known = forward.local.measured(part)
    if not known.all():
        other = forward.local.reconstructed(part, x)
        other = _predict(part, forward.amplitudes, x) if other is None else other
        amplitudes[:, ~known] = other[:, ~known]
    floor = EQUIVALENT_START.least_amplitude * amplitudes.max(axis=0)
    amplitudes = np.maximum(amplitudes, np.maximum(floor, np.finfo(np.float64).tiny))
    return replace(part, forward=EquivalentForward(forward.local, part.frf.freq, amplitudes))


def _estimate(part: FRFPart, forward: RandomForward, x: RealArray) -> RealArray:
    """Return mean and standard deviations of the elements at x, measured where they can be."""
    motion = _predict(part, forward.spreads, x)
    measured, known = forward.measured(part)
    motion[1:, known] = measured[:, known]
    motion[1:] = np.maximum(motion[1:], np.finfo(np.float64).tiny ** 0.25)
    return motion


def _predict(
    part: FRFPart, motion: Callable[[FRFPart, RealArray], RealArray], x: RealArray
) -> RealArray:
    """Return the motion at x; that at the start if the equations cannot be solved at x."""
    try:
        return motion(part, x)
    except SolverError:
        return motion(part, part.coordinates.start)
