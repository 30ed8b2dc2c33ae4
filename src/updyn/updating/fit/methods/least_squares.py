"""Methods that minimise one residual of equal weights: log error and output error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from updyn.updating.fit.method import (
    Fit,
    descend_to_scale,
    in_units,
    known_length,
    spread_of,
    stopped_at,
)
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.sandwich import sandwich
from updyn.updating.fit.search import SEARCH_LINES, SEARCH_STEPS, Search
from updyn.updating.fit.trust_region import TrustRegion
from updyn.updating.problem.joint import Task
from updyn.updating.problem.noise import NoiseModel, level_by_unit
from updyn.updating.problem.residuals import Each, LogError, OutputError, Residual
from updyn.updating.problem.session import Stopped

__all__ = ["LogMethod", "OutputMethod", "judged"]


@dataclass(frozen=True, slots=True)
class LogMethod:
    """Log error, r = ln(H_A / H_X), after a search (method ``"log"``).

    Parameters
    ----------
    max_iterations : int
        Largest number of steps of the final fit, and of each try of the search (there at most 60).
    tolerance : float
        Relative step at which it has converged.
    starts : int
        Tries of the search; 0 skips it.
    seed : int
        Of the search's random tries.
    inflate : bool
        Whether the loss factors of the search start inflated.
    continuation : bool
        Whether the tries of the search, but the first, go up in frequency.
    """

    max_iterations: int = 100
    tolerance: float = 1e-10
    starts: int = 8
    seed: int = 0
    inflate: bool = True
    continuation: bool = True

    reference: ClassVar[str] = "Guillaume, Pintelon & Schoukens 1995"
    calibrates: ClassVar[bool] = (
        True  # compares with `Problem.block`, which has the calibration factors
    )

    def search(self, problem: Task, monitor: Monitor) -> NDArray[np.float64]:
        """Return where to begin: the best basin of the log error, shape (n,)."""
        x = problem.coordinates.to_x(problem.coordinates.parameters.start)
        if self.starts:
            rough = problem.thinned(SEARCH_LINES)
            steps = min(self.max_iterations, SEARCH_STEPS)
            search = Search(
                self.starts,
                steps,
                seed=self.seed,
                inflate=self.inflate,
                continuation=self.continuation,
            )
            with monitor.stage("search", rough):
                x = search.run(rough, monitor)
                if not monitor.stopped:
                    x = search.escape(rough, x, monitor)
        return x

    def fit(
        self, problem: Task, noises: Sequence[NoiseModel], monitor: Monitor, x: NDArray[np.float64]
    ) -> Fit:
        """Fit the unknowns from x; all values count the same, and the noise decides how sure the unknowns are."""
        settings = TrustRegion(self.max_iterations, self.tolerance)
        with monitor.stage("log"):
            try:
                return _descend(problem, LogError(), x, monitor, settings, noises)
            except Stopped:
                return stopped_at(problem.thinned(SEARCH_LINES), x)


@dataclass(frozen=True, slots=True)
class OutputMethod:
    """Output error, r = H_A - H_X, equal weight to all values of one unit (method ``"output-error"``).

    The largest peaks decide. It suits noise that does not depend on the level, and needs a start
    close to the truth: there is no search.

    Parameters
    ----------
    max_iterations : int
        Largest number of steps.
    tolerance : float
        Relative step at which it has converged.
    """

    max_iterations: int = 100
    tolerance: float = 1e-10

    reference: ClassVar[str] = "Pintelon & Schoukens 2012"
    calibrates: ClassVar[bool] = (
        True  # compares with `Problem.block`, which has the calibration factors
    )

    def search(self, problem: Task, monitor: Monitor) -> NDArray[np.float64]:
        """Return the start of the unknowns, shape (n,): there is no search."""
        return problem.coordinates.to_x(problem.coordinates.parameters.start)

    def fit(
        self, problem: Task, noises: Sequence[NoiseModel], monitor: Monitor, x: NDArray[np.float64]
    ) -> Fit:
        """Fit the unknowns from x; all values of one unit count the same, whatever their noise."""
        weights = [
            np.broadcast_to(1.0 / level_by_unit(p.frf), p.frf.values.shape) for p in problem.parts
        ]
        settings = TrustRegion(self.max_iterations, self.tolerance)
        with monitor.stage("output-error"):
            try:
                return _descend(
                    problem, Each(tuple(map(OutputError, weights))), x, monitor, settings, noises
                )
            except Stopped:
                return Fit.blind(x, "stopped")


def _descend(
    problem: Task,
    residual: Residual,
    x: np.ndarray,
    monitor: Monitor,
    settings: TrustRegion,
    noises: Sequence[NoiseModel],
) -> Fit:
    outcome = descend_to_scale(problem, residual, x, monitor, settings)
    return judged(problem, residual, outcome.x, outcome.reason, noises=noises)


def judged(
    problem: Task,
    residual: Residual,
    x: NDArray[np.float64],
    reason: str,
    note: str = "",
    noises: Sequence[NoiseModel] = (),
) -> Fit:
    """Return the fit that ended at x, with the covariance that the noise gives it (`updyn.updating.fit.sandwich`).

    Where that cannot be had, the noise is taken as equal everywhere.

    Parameters
    ----------
    problem : Task
        What was fitted.
    residual : Residual
        Log error or output error.
    x : ndarray of float, shape (n,)
        Where the fit ended.
    reason : str
        Why.
    note : str
        What the user should know.
    noises : sequence of NoiseModel
        How uncertain the data of each part are; estimated from the residual where none are given.
    """
    try:
        local = residual.local(problem, x)
    except Stopped:
        return Fit.blind(x, "stopped")
    assert local is not None
    sigma = spread_of(local, problem.n_values, problem.n)
    found = None
    try:
        if isinstance(residual, LogError | Each):
            found = sandwich(problem, residual, local, x, noises)
    except Stopped:
        reason = "stopped"
    if found is not None:
        return Fit(
            x,
            reason,
            found.R,
            found.noise,
            f"{note} {found.note}".strip(),
            in_units(local, sigma),
            sigma,
        )

    def difference(part: int, H: NDArray[np.complex128]) -> NDArray[np.complex128]:
        measured = problem.parts[part].frf.values
        return (H - measured) / np.where(H == 0, 1.0, H) if residual.name == "log" else H - measured

    known = known_length(problem, x, difference)
    length = known.get("correlation_length", 1.0)
    record = {
        "kind": "spread of the residual",
        "relative" if residual.name == "log" else "floor": float(np.sqrt(2.0) * sigma),
        "chi_square": 1.0,
        **known,
        "inflation": float(np.sqrt(length)),
    }
    unit = sigma * float(np.sqrt(length))
    R = local.R / unit if unit > 0 else local.R
    return Fit(x, reason, R, (record,) * len(problem.parts), note, in_units(local, sigma), sigma)
