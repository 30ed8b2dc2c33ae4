"""Methods that minimise a residual with equal weights: log error, output error, registered ones.

Those of log and output error are not the weights of the noise, so the covariance is the sandwich.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.linalg import LinAlgError, cholesky, solve_triangular

from updyn.arrays import ComplexArray, RealArray
from updyn.updating.fit.method import (
    UNBIASED,
    Fit,
    Method,
    Starts,
    descend_to_scale,
    divide_by_std,
    make_stopped_fit,
    record_correlation_length,
    residual_std,
)
from updyn.updating.fit.methods.linear import linearise, make_unweighted_fit
from updyn.updating.fit.methods.searching import SearchingMethod
from updyn.updating.fit.methods.settings import SANDWICH
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.search import thin_problem
from updyn.updating.fit.settings import NULL_SPACE
from updyn.updating.fit.trust_region import TrustRegion
from updyn.updating.problem.local import Local
from updyn.updating.problem.noise import Estimated, NoiseModel
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import (
    LineResidual,
    LogError,
    OutputError,
    OutputErrorSet,
    Residual,
    ResidualSet,
)
from updyn.updating.problem.session import Stopped

__all__ = [
    "LeastSquares",
    "LogMethod",
    "OutputMethod",
    "Sandwich",
    "make_sandwich_fit",
    "sandwich",
]


@dataclass(frozen=True, slots=True)
class LogMethod(SearchingMethod):
    """Log error, r = ln(H_A / H_X), after a search (method ``"log"``)."""

    name: ClassVar[str] = "log"
    label: ClassVar[str] = "fit of logarithmic level and phase"
    reference: ClassVar[str] = "Guillaume, Pintelon & Schoukens 1995"
    calibrates: ClassVar[bool] = True
    can_regularise: ClassVar[bool] = True
    states_noise: ClassVar[bool] = True

    def search(self, problem: Problem, noises: Sequence[NoiseModel], monitor: Monitor) -> Starts:
        """Return the best basin of the log error."""
        if not self.starts:
            return Method.search(self, problem, noises, monitor)
        rough = thin_problem(problem, noises)
        search = self.tries
        with monitor.stage("search", rough):
            starts = search.run(rough, noises, monitor)
            if monitor.stopped or starts.data_fault:
                return starts
            return Starts((search.escape(rough, starts.points[0], monitor),), starts.agreed)

    def fit(
        self,
        problem: Problem,
        noises: Sequence[NoiseModel],
        monitor: Monitor,
        x: RealArray,
    ) -> Fit:
        """Fit the unknowns from x; weights are equal, standard deviations those of the noise."""
        settings = TrustRegion(self.max_iterations, self.tolerance)
        with monitor.stage(self.name):
            try:
                return _descend(problem, LogError(), x, monitor, settings, noises)
            except Stopped:
                return make_stopped_fit(thin_problem(problem, noises), x)


@dataclass(frozen=True, slots=True)
class OutputMethod(Method):
    """Output error, r = H_A - H_X, weighted equally within a unit (method ``"output-error"``).

    The largest peaks dominate. The method suits noise that does not depend on the level, and needs
    a start close to the truth, because it makes no search.
    """

    max_iterations: int = 100
    tolerance: float = 1e-10

    name: ClassVar[str] = "output-error"
    label: ClassVar[str] = "fit of the unweighted FRFs"
    reference: ClassVar[str] = "Pintelon & Schoukens 2012"
    calibrates: ClassVar[bool] = True
    can_regularise: ClassVar[bool] = True
    states_noise: ClassVar[bool] = True

    def fit(
        self,
        problem: Problem,
        noises: Sequence[NoiseModel],
        monitor: Monitor,
        x: RealArray,
    ) -> Fit:
        """Fit the unknowns from x; weights are equal, standard deviations those of the noise."""
        residual = OutputErrorSet(tuple(OutputError.of_data(part) for part in problem.parts))
        settings = TrustRegion(self.max_iterations, self.tolerance)
        with monitor.stage(self.name):
            try:
                return _descend(problem, residual, x, monitor, settings, noises)
            except Stopped:
                return Fit.without_jacobian(x, "stopped")


@dataclass(frozen=True, slots=True)
class LeastSquares(Method):
    """Any registered residual, with equal weights, within bounds and with priors."""

    max_iterations: int = 100
    tolerance: float = 1e-10

    residual: ClassVar[type[LineResidual]]
    can_regularise: ClassVar[bool] = True

    @classmethod
    def of(cls, name: str, residual: type[LineResidual]) -> type[LeastSquares]:
        """Return the method that minimises a residual registered under `name`."""
        stated = {
            "name": name,
            "residual": residual,
            "reference": residual.reference,
            "needs_exact": residual.needs_exact,
            "calibrates": residual.calibrates,
        }
        return type(f"{residual.__name__}Method", (cls,), {"__slots__": (), **stated})

    def fit(
        self,
        problem: Problem,
        noises: Sequence[NoiseModel],
        monitor: Monitor,
        x: RealArray,
    ) -> Fit:
        """Fit the unknowns from x; the noise is estimated from the residual, equal everywhere."""
        residual = ResidualSet(tuple(self.residual.of_data(part) for part in problem.parts))
        settings = TrustRegion(self.max_iterations, self.tolerance)
        with monitor.stage(self.name):
            try:
                linearise(problem, residual, x)  # raises an error that names the line if singular
                outcome = descend_to_scale(problem, residual, x, monitor, settings)
            except Stopped:
                return Fit.without_jacobian(x, "stopped")
            kind = f"spread of the residual {self.name!r}"
            return make_unweighted_fit(problem, residual, outcome.x, outcome.reason, kind, "")


def _descend(
    problem: Problem,
    residual: Residual,
    x: np.ndarray,
    monitor: Monitor,
    settings: TrustRegion,
    noises: Sequence[NoiseModel],
) -> Fit:
    outcome = descend_to_scale(problem, residual, x, monitor, settings)
    return make_sandwich_fit(problem, residual, outcome.x, outcome.reason, noises=noises)


def make_sandwich_fit(
    problem: Problem,
    residual: Residual,
    x: RealArray,
    reason: str,
    note: str = "",
    noises: Sequence[NoiseModel] = (),
) -> Fit:
    """Return the fit that ended at x, with its sandwich covariance.

    If that cannot be computed, the noise is assumed to be equal for all values. Without `noises`,
    it is estimated from the residual.
    """
    try:
        local = residual.local(problem, x)
    except Stopped:
        return Fit.without_jacobian(x, "stopped")
    assert local is not None
    sigma = residual_std(local, problem.n_values, problem.n)
    found = None
    try:
        if isinstance(residual, LogError | OutputErrorSet):
            found = sandwich(problem, residual, local, x, noises)
    except Stopped:
        reason = "stopped"
    if found is not None:
        text = f"{note} {found.note}".strip()
        scaled = divide_by_std(local, sigma)
        better = UNBIASED if text else ""
        return Fit(x, reason, found.R, found.noise, text, scaled, sigma, better=better)

    def difference(part: int, H: ComplexArray) -> ComplexArray:
        misfit = H - problem.parts[part].frf.values
        if residual.name == "log":
            misfit = misfit / np.where(H == 0, 1.0, H)
        return misfit

    known = record_correlation_length(problem, x, difference)
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
    better = UNBIASED if note else ""
    records = (record,) * len(problem.parts)
    return Fit(x, reason, R, records, note, divide_by_std(local, sigma), sigma, better=better)


@dataclass(frozen=True, slots=True, eq=False)
class Sandwich:
    """Covariance of a fit whose fixed weights are not those of the noise.

    R, shape (k, n), has the inverse covariance of the unknowns R^T R; `noise` is the record of each
    part.
    """

    R: RealArray
    noise: tuple[dict[str, Any], ...]
    note: str = ""


def sandwich(
    problem: Problem,
    residual: LogError | OutputErrorSet,
    local: Local,
    x: RealArray,
    noises: Sequence[NoiseModel] = (),
) -> Sandwich | None:
    """Return the sandwich covariance of a fit, or None if it is singular."""
    # With A = J^T J of the weighted Jacobian J, and S the covariance of the weighted residual, it
    # is A^-1 (J^T S J) A^-1 (Huber, Proc. 5th Berkeley Symp. 1 (1967) 221; White, Econometrica 48
    # (1980) 817). S is computed from the noise model, not from the squares of the residuals, which
    # are too few if single peaks dominate (`benchmarks/sandwich.py`), and is scaled up to a larger
    # weighted misfit and by the correlation length of the residual.
    try:
        return _sandwich(problem, residual, local, x, noises or [Estimated()] * len(problem.parts))
    except LinAlgError:
        return None


def _sandwich(
    problem: Problem,
    residual: LogError | OutputErrorSet,
    local: Local,
    x: RealArray,
    noises: Sequence[NoiseModel],
) -> Sandwich | None:
    refitted_noises, weights, spreads, total, loud = [], [], [], 0.0, []
    for i, (part, noise_model) in enumerate(zip(problem.parts, noises, strict=True)):
        H, frf = part.responses(x), part.frf
        # This fit does not weight outliers, so the noise model without outliers is used.
        noise = noise_model.bulk.refit(H, frf, problem.share(part))
        variance = noise.variance(H, frf)
        size = np.abs(H)
        usable = (size > 0.0) & (frf.values != 0.0)
        safe = np.where(usable, size, 1.0)
        if isinstance(residual, LogError):
            weight = np.where(usable, 1.0 / safe, 0.0)
        else:
            weight = residual.of(i).weight
        total += float(np.sum(weight**2 * variance))
        refitted_noises.append(noise)
        weights.append(weight)
        spreads.append(OutputError(weight**2 * np.sqrt(0.5 * variance), "spread"))
        loud.append(np.mean(np.sqrt(variance) > SANDWICH.loud_noise * safe))
    meat = OutputErrorSet(tuple(spreads)).local(problem, x)
    if meat is None or total == 0.0:
        return None
    norms = np.linalg.norm(local.R, axis=0)
    scale = np.where(norms > 0.0, norms, 1.0)
    _, s, Vt = np.linalg.svd(local.R / scale)
    least = SANDWICH.clear_ratio * NULL_SPACE.rank_tolerance
    clear = s > least * max(s[0], np.finfo(float).tiny)
    # along^T along is J^T S J in the basis in which J has unit singular values.
    along = (meat.R / scale) @ Vt[clear].T / s[clear]
    expected = total - float(np.sum(along**2))
    misfit = 1.0
    if expected > 1e-3 * total:
        misfit = 2.0 * local.cost / expected
    known = record_correlation_length(
        problem, x, lambda i, H: weights[i] * (H - problem.parts[i].frf.values)
    )
    excess = misfit
    if all(noise.scale_known for noise in refitted_noises):
        excess = max(misfit, 1.0)
    inflation = float(np.sqrt(excess * known.get("correlation_length", 1.0)))
    factor = inflation * cholesky(along.T @ along, lower=True)
    rows = solve_triangular(factor, s[clear, None] * Vt[clear], lower=True)
    usual = inflation * np.sqrt(total / (2.0 * problem.n_values))
    R = np.vstack([rows, s[~clear, None] * Vt[~clear] / usual]) * scale
    taken = refitted_noises[0].source == "estimated"  # from this same residual
    spread = float(np.sqrt(2.0) * residual_std(local, problem.n_values, problem.n))
    record = {
        "chi_square": 1.0 if taken else float(misfit),
        "spread": spread,
        **known,
        "inflation": inflation,
    }
    records = [{"kind": noise.kind, **noise.figures(), **record} for noise in refitted_noises]
    return Sandwich(R, tuple(records), _note(residual, loud))


def _note(residual: LogError | OutputErrorSet, loud: Sequence[Any]) -> str:
    share = float(np.max(loud))
    if not isinstance(residual, LogError) or share <= SANDWICH.noted_share:
        return ""
    return (
        f"In {100.0 * share:.0f} % of the values the noise is above half of |H|: their logarithm is"
        " biased, which the standard deviations do not include; use maximum likelihood, which"
        " weights them correctly."
    )
