"""Base class of the methods, the result of a fit, and the descents that methods share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.errors import SolverError
from updyn.text_table import format_count
from updyn.updating.fit.answer import Answer
from updyn.updating.fit.models import Models
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.null_space import null_space
from updyn.updating.fit.settings import DESCENT
from updyn.updating.fit.trust_region import Outcome, TrustRegion
from updyn.updating.problem.local import Local
from updyn.updating.problem.noise import ASSUMED, NoiseModel
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import Residual, add_prior, is_cached, make_log_error
from updyn.updating.problem.session import Stopped

__all__ = [
    "UNBIASED",
    "Fit",
    "Method",
    "Regularisation",
    "Rival",
    "Starts",
    "correlation_length",
    "descend",
    "descend_to_scale",
    "divide_by_std",
    "make_stopped_fit",
    "record_correlation_length",
    "residual_std",
    "serial_correlation",
]

#: Method that weights the data by their noise.
UNBIASED = "maximum-likelihood"


@dataclass(frozen=True, slots=True, eq=False)
class Regularisation:
    """Regularisation of a fit.

    Attributes
    ----------
    weight : ndarray of float, shape (n,)
        1 / standard deviation of an equivalent prior, in addition to the unknowns' priors; or 0.
    within : ndarray of float, shape (n, k), or None
        Orthonormal directions to which changes of the unknowns were restricted; None for all.
    note : str
        Description in a sentence.
    record : mapping
        The choice and the curve on which it is based.
    """

    weight: RealArray
    within: RealArray | None
    note: str
    record: Mapping[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class Starts:
    """Starting points of a fit: at least one, in the optimiser's coordinates, the best first.

    `agreed`: tries from different starts ended in the first point. `exact`: its residual is
    rounding of the data. `data_fault`: a fault of the data ended the search, and no search for
    other answers follows.
    """

    points: tuple[RealArray, ...]
    agreed: bool = False
    exact: bool = False
    data_fault: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """Another answer that fits equally well: its values `x`, in the optimiser's coordinates.

    `worse` is the decrease of the log-likelihood from the best answer. `problem` has the reduced
    model in which the answer is certified; None if the model of the fit is exact there.
    """

    x: RealArray
    worse: float
    problem: Problem | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Result of a method.

    Attributes
    ----------
    x : ndarray of float, shape (n,)
        The estimate, in the optimiser's coordinates.
    reason : str
        Why the fit ended: ``"converged"``, ``"unsettled"``, ``"stalled"``, ``"unsolvable"``,
        ``"max-iterations"``, ``"stopped"`` or ``"failed"``. Unsettled: a search found no answer
        that explains the data and no answer twice, or weights and estimate did not settle on each
        other. Unsolvable: the model cannot be solved next to x.
    R : ndarray of float, shape (k, n)
        Reduced Jacobian of the data alone (no prior) at x, in units of one standard deviation of
        the noise.
    noise : tuple of mapping
        Noise record of each part of the problem: kind, figures, chi_square, inflation. Empty if the
        noise is not known.
    note : str
        Note for the user on the figures of this method; may be empty.
    local : Local or None
        Reduced problem of the data alone at x, in the units in which priors count against it; None
        if the method has none.
    unit : float
        Size of these units in the residual, if the method estimated it together with the unknowns.
    regularisation : Regularisation or None
        Regularisation of the fit.
    advice : str
        Experiment advice on undetermined unknowns, from a method that fits other data than FRFs; if
        empty, it is sought among lines and sensors that could be added.
    rivals : tuple of Rival
        Other answers that fit equally well.
    cause : str
        For a fit that failed, stalled, did not settle or ran out of steps: the obstacle in model or
        data (`Method.describe_obstacle`); may be empty.
    remedy : str
        For a fit that failed: the advised action (`Method.failure_remedy`); may be empty.
    better : str
        Method without the bias that the note states, which ends with advice on it; may be empty.
    """

    x: RealArray
    reason: str
    R: RealArray
    noise: tuple[Mapping[str, Any], ...] = ()
    note: str = ""
    local: Local | None = None
    unit: float = 1.0
    regularisation: Regularisation | None = None
    advice: str = ""
    rivals: tuple[Rival, ...] = ()
    cause: str = ""
    remedy: str = ""
    better: str = ""

    @classmethod
    def without_jacobian(cls, x: RealArray, reason: str, note: str = "") -> Fit:
        """Return a fit without a Jacobian; its identifiability is unknown."""
        return cls(x, reason, np.zeros((len(x), len(x))), note=note)


class Method(ABC):
    """Base class of the methods. A method is a frozen dataclass: its fields are its options.

    The run, the comparison of methods and the report read the properties of a method from these
    attributes; method names are not listed elsewhere.

    Attributes
    ----------
    max_iterations : int
        Largest number of steps.
    tolerance : float
        Relative step at which the method has converged.
    name : str
        Registered name.
    label : str
        The minimised quantity, in words for the report; may be empty.
    reference : str
        Publication.
    needs : str
        Requirements on model or data beyond those of every method; may be empty.
    needs_exact : str
        Why the method cannot be used in a reduced model; empty if it can.
    cannot : tuple of str
        Quantities that it cannot update.
    instead : str
        Advice on an unknown of such a quantity, for the message.
    calibrates : bool
        Whether it supports calibration factors, that is, compares with `FRFPart.block`, which
        applies them.
    can_regularise : bool
        Whether it minimises one sum of squares within bounds, to which a penalty can be added.
    is_likelihood : bool
        Whether it minimises the negative logarithm of a likelihood.
    fits_modes : bool
        Whether its data can be modes.
    states_noise : bool
        Whether its noise record is sufficient to simulate data.
    """

    __slots__ = ()

    max_iterations: int
    tolerance: float

    name: ClassVar[str]
    label: ClassVar[str] = ""
    reference: ClassVar[str] = ""
    needs: ClassVar[str] = ""
    needs_exact: ClassVar[str] = ""
    cannot: ClassVar[tuple[str, ...]] = ()
    instead: ClassVar[str] = ""
    calibrates: ClassVar[bool] = False
    can_regularise: ClassVar[bool] = False
    is_likelihood: ClassVar[bool] = False
    fits_modes: ClassVar[bool] = False
    states_noise: ClassVar[bool] = False

    @property
    def stages(self) -> tuple[tuple[str, int], ...]:
        """Stages of its progress, each with the number of steps after which it usually ends."""
        return ((self.name, self.max_iterations),)

    @property
    def failure_remedy(self) -> str:
        """Advice if the iteration breaks down; empty for the usual one, to start closer."""
        return ""

    def describe_obstacle(self, problem: Problem) -> str:
        """Return a sentence on the obstacle to this method in model or data; may be empty.

        Called for a fit that failed, stalled or ran out of steps.

        Parameters
        ----------
        problem : Problem
            Model, data and unknowns, at their start.
        """
        numbers = problem.n_numbers
        if numbers >= problem.n:
            return ""
        return f"The data hold {numbers} real numbers for {format_count(problem.n, 'unknown')}."

    def search(self, problem: Problem, noises: Sequence[NoiseModel], monitor: Monitor) -> Starts:
        """Return the starting points of the fit; by default the unknowns' start.

        Parameters
        ----------
        problem : Problem
            Model, data and unknowns.
        noises : sequence of NoiseModel
            Noise model of each part.
        monitor : Monitor
            Records the steps.
        """
        return Starts((problem.coordinates.start,))

    def fit_best(
        self,
        problem: Problem,
        noises: Sequence[NoiseModel],
        monitor: Monitor,
        starts: Starts,
    ) -> Fit:
        """Fit the unknowns from the points that `search` found; by default from the first one.

        Parameters
        ----------
        problem, noises, monitor
            As for `fit`.
        starts : Starts
            Starting points.
        """
        return self.fit(problem, noises, monitor, starts.points[0])

    def evaluate_answer(
        self,
        problem: Problem,
        noises: Sequence[NoiseModel],
        x: RealArray,
        fixed_unknown: int | None = None,
        valley_start: Answer | None = None,
    ) -> Answer | None:
        """Return the answer at the end of a fit; None (default) if no others are searched for.

        Parameters
        ----------
        problem, noises
            As for `fit`.
        x : ndarray of float, shape (n,)
            End of the fit.
        fixed_unknown : int, optional
            Index of the fixed unknown, at the far end of a valley.
        valley_start : Answer, optional
            Beginning of that valley.
        """
        return None

    def find_candidates(
        self,
        models: Models,
        noises: Sequence[NoiseModel],
        monitor: Monitor,
        at: Answer,
        points: Sequence[RealArray],
    ) -> list[Answer]:
        """Return candidates for other answers that fit equally well, for a certified fit.

        Parameters
        ----------
        models : Models
            Models in which they are searched for.
        noises, monitor
            As for `fit`.
        at : Answer
            The known answer.
        points : sequence of ndarray of float, shape (n,)
            Further points to begin from: the ends of other tries of a search.
        """
        return []

    @abstractmethod
    def fit(
        self, problem: Problem, noises: Sequence[NoiseModel], monitor: Monitor, x: RealArray
    ) -> Fit:
        """Fit the unknowns from x.

        Parameters
        ----------
        problem : Problem
            Model, data and unknowns.
        noises : sequence of NoiseModel
            Noise model of each part.
        monitor : Monitor
            Records the steps.
        x : ndarray of float, shape (n,)
            Starting point.

        Returns
        -------
        Fit
        """


def descend(
    problem: Problem,
    residual: Residual,
    x: RealArray,
    monitor: Monitor,
    settings: TrustRegion,
    unit: float = 1.0,
    *,
    relax: bool = True,
) -> Outcome:
    """Minimise one residual from x, including priors, and record every step.

    With `relax`, loss factors may become negative on the way (`Coordinates.relaxed_lower`); if they
    are negative at the end, the descent continues from the nearest point within the bounds. Of the
    points that fit equally well, it approaches the nearest to the unknowns' start. Raises
    SolverError if the model cannot be solved at x, and Stopped if the user stops before x has been
    evaluated.
    """
    lower, upper = problem.coordinates.bounds
    within = problem.coordinates.within

    def evaluate(at: RealArray) -> Local | None:
        local = residual.local(problem, at)
        return None if local is None else add_prior(divide_by_std(local, unit), problem, at)

    start = evaluate(x)
    if start is None:
        raise SolverError(f"{residual.name}: the model cannot be solved where the fit starts")
    if not monitor.has_begun:
        monitor.start(x, start)
    if monitor.stopped:
        return Outcome(x, start, "stopped")
    if within is not None:
        return settings.minimise(evaluate, x, lower, upper, monitor.step, within)
    outermost = problem.coordinates.relaxed_lower if relax else lower
    # A descent that a box divides into rounds continues with the trust radius of the last round.
    first = settings if problem.coordinates.box is None else monitor.restore_radius(settings, x)
    outcome = first.minimise(evaluate, x, outermost, upper, monitor.step)
    monitor.store_outcome(outcome)
    inside = np.clip(outcome.x, lower, upper)
    if (inside != outcome.x).any():
        try:
            local = evaluate(inside)
        except Stopped:  # with the nearest known Jacobian
            return Outcome(inside, outcome.local, "stopped")
        if local is None:
            raise SolverError(
                f"{residual.name}: the model cannot be solved with its loss factors at zero"
            )
        if outcome.reason == "stopped":
            return Outcome(inside, local, "stopped")
        outcome = settings.minimise(evaluate, inside, lower, upper, monitor.step)
    home = problem.coordinates.start
    for _ in range(DESCENT.most_pulls):
        free = null_space(outcome.local.R)
        if outcome.reason != "converged" or free.shape[1] == 0:
            break
        pulled = np.clip(outcome.x + free @ (free.T @ (home - outcome.x)), lower, upper)
        try:
            if evaluate(pulled) is None:
                break
            back = settings.minimise(evaluate, pulled, lower, upper, monitor.step)
        except Stopped:
            return replace(outcome, reason="stopped")
        nearer = np.linalg.norm(back.x - home) < 0.99 * np.linalg.norm(outcome.x - home)
        if (
            not nearer
            or back.local.cost
            > outcome.local.cost * (1.0 + 1e-6) + DESCENT.exact_cost * problem.n_values
        ):
            break
        outcome = back
    return outcome


def descend_to_scale(
    problem: Problem,
    residual: Residual,
    x: RealArray,
    monitor: Monitor,
    settings: TrustRegion,
    spread: Callable[[RealArray, Local], float] | None = None,
) -> Outcome:
    """Minimise a residual of unknown spread, including priors; raises as `descend`.

    A prior is weighed against the data in standard deviations of both. The spread of the residual
    (`spread`, by default `residual_std`) is therefore estimated in turn with the unknowns until it
    changes by less than 1 %, unless it is given (`Coordinates.unit`).
    """
    if problem.coordinates.unit is not None:
        return descend(problem, residual, x, monitor, settings, problem.coordinates.unit)
    outcome = descend(problem, residual, x, monitor, settings)
    if not problem.coordinates.prior[1].any():
        return outcome
    unit = 1.0
    for _ in range(DESCENT.most_scales):
        if outcome.reason == "stopped":
            break
        try:
            local = residual.local(problem, outcome.x)
            if local is None:
                break
            if spread is None:
                sigma = residual_std(local, problem.n_values, problem.n)
            else:
                sigma = spread(outcome.x, local)
            if sigma == 0.0 or abs(sigma / unit - 1.0) < 0.01:
                break
            unit = sigma
            outcome = descend(problem, residual, outcome.x, monitor, settings, unit)
        except Stopped:
            return replace(outcome, reason="stopped")
    return outcome


def residual_std(local: Local, n_values: int, n: int) -> float:
    """Return the standard deviation of residuals of equal weight: sqrt(2 cost / (2 n_values - n)).

    Return that of `ASSUMED` noise if there are not more measured numbers than unknowns.
    """
    if 2 * n_values <= n:
        return float(ASSUMED["relative"] / np.sqrt(2.0))
    return float(np.sqrt(2.0 * local.cost / (2 * n_values - n)))


def divide_by_std(local: Local, sigma: float) -> Local:
    """Return a reduced problem over the standard deviation of its residuals, unless that is 0."""
    return Local(local.cost / sigma**2, local.R / sigma, local.q / sigma) if sigma > 0.0 else local


def make_stopped_fit(problem: Problem, x: RealArray) -> Fit:
    """Return the fit stopped at x, with the Jacobian of the log error `problem` if it is cached."""
    residual = make_log_error(problem)
    local = residual.local(problem, x) if is_cached(residual, problem, x) else None
    if local is None or local.cost == 0.0:
        return Fit.without_jacobian(x, "stopped")
    sigma = residual_std(local, problem.n_values, problem.n)
    record = {
        "kind": "spread of the log error",
        "relative": float(np.sqrt(2.0) * sigma),
        "chi_square": 1.0,
    }
    return Fit(x, "stopped", local.R / sigma, (record | {"inflation": 1.0},) * len(problem.parts))


def record_correlation_length(
    problem: Problem,
    x: RealArray,
    whitened: Callable[[int, ComplexArray], ComplexArray],
) -> dict[str, float]:
    """Return the record of the correlation length of the residual at x; empty after a stop.

    `whitened` maps the index of a part and the model's H, shape (n_f, ...), to the residual over
    its standard deviation.
    """
    try:
        lengths = [
            correlation_length(whitened(i, p.responses(x))) for i, p in enumerate(problem.parts)
        ]
    except Stopped:
        return {}
    return {
        "correlation_length": float(
            np.average(lengths, weights=[p.n_values for p in problem.parts])
        )
    }


def serial_correlation(whitened: ComplexArray, lag: int = 1) -> float:
    """Return the correlation of a residual, shape (n_f, ...), with itself at a lag; 0 for zeros."""
    power = float(np.mean(np.abs(whitened) ** 2))
    if power == 0.0:
        return 0.0
    return float(np.mean((whitened[lag:] * whitened[:-lag].conj()).real)) / power


def correlation_length(whitened: ComplexArray) -> float:
    """Return the correlation length of a residual in lines: 1 + 2 sum of its autocorrelation.

    `whitened` has the shape (n_f, ...). The sum ends at the first lag whose correlation is within
    two standard deviations of zero. Standard deviations for independent lines are too small by the
    square root of this length (Priestley, Spectral Analysis and Time Series, 1981, section 5.3).
    """
    total = 1.0
    for lag in range(1, len(whitened) // 2):
        rho = serial_correlation(whitened, lag)
        if rho < 2.0 / np.sqrt(2.0 * whitened[lag:].size):
            break
        total += 2.0 * rho
    return total
