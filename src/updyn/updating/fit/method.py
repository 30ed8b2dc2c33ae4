"""Base class of the methods, their outcome, and the descents that they share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from updyn.errors import SolverError
from updyn.text_table import counted
from updyn.updating.fit.answer import Answer
from updyn.updating.fit.models import Models
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.null_space import null_space
from updyn.updating.fit.trust_region import Outcome, TrustRegion
from updyn.updating.problem.local import Local
from updyn.updating.problem.noise import ASSUMED, NoiseModel
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import Residual, is_cached, log_error, with_prior
from updyn.updating.problem.session import Stopped

__all__ = [
    "Fit",
    "Method",
    "Pull",
    "Rival",
    "Starts",
    "correlation_length",
    "descend",
    "descend_to_scale",
    "in_units",
    "known_length",
    "serial_correlation",
    "spread_of",
    "stopped_at",
]

_Vector = NDArray[np.float64]

#: How often the spread of a residual is estimated again.
_SCALES = 8
#: How often a fit with undetermined directions is pulled back towards the start.
_PULLS = 4
#: Cost of a value that is rounding.
_EXACT = 1e-20


@dataclass(frozen=True, slots=True, eq=False)
class Pull:
    """How a fit was regularised.

    Attributes
    ----------
    weight : ndarray of float, shape (n,)
        1 / standard deviation of a prior that would pull as much, beside the unknowns' own; 0 for
        none.
    within : ndarray of float, shape (n, k), or None
        Orthonormal directions, where the unknowns moved along these only.
    note : str
        In a sentence.
    record : mapping
        The choice and the curve that it was made from, for the record.
    """

    weight: _Vector
    within: NDArray[np.float64] | None
    note: str
    record: Mapping[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class Starts:
    """Where a fit begins.

    Attributes
    ----------
    points : tuple of ndarray of float, shape (n,)
        At least one, best first.
    agreed : bool
        Whether tries from different starts ended in the first of them.
    exact : bool
        Whether the first of them leaves only rounding of the data.
    in_vain : bool
        Whether a fault of the data ended the search: no other answer is worth a look.
    """

    points: tuple[_Vector, ...]
    agreed: bool = False
    exact: bool = False
    in_vain: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """Another answer that fits as well.

    Attributes
    ----------
    x : ndarray of float, shape (n,)
        Its values, in the optimiser's coordinates.
    worse : float
        By how much the logarithm of its likelihood is smaller.
    problem : Problem or None
        With the reduced model in which it is certified; None: the model of the fit is exact there.
    """

    x: _Vector
    worse: float
    problem: Problem | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The outcome of a method.

    Attributes
    ----------
    x : ndarray of float, shape (n,)
        The estimate, in the optimiser's coordinates.
    reason : str
        Why it ended: ``"converged"``, ``"unsettled"``, ``"stalled"``, ``"unsolvable"``,
        ``"max-iterations"``, ``"stopped"`` or ``"failed"``. Unsettled where a search found no
        answer that explains the data, and none twice, or weights and estimate did not settle on
        each other; unsolvable where the model cannot be solved
        next to x.
    R : ndarray of float, shape (k, n)
        Reduced Jacobian of the data alone (no prior) at x, in units of one standard deviation of
        the noise.
    noise : tuple of mapping
        For the record, for each part of the problem: kind, figures, chi_square, inflation. Empty:
        nothing is known.
    note : str
        What the user should know about this method's figures; may be empty.
    local : Local or None
        Reduced problem of the data alone at x, in the units in which priors count against it; None
        where the method has none.
    unit : float
        What of the residual these units are, where the method found their size along with the
        unknowns.
    pull : Pull or None
        What regularisation added.
    advice : str
        Experiment advice on undetermined unknowns where the method fits something else than FRFs;
        empty: found among lines and sensors that could be added.
    rivals : tuple of Rival
        Other answers that fit as well.
    cause : str
        Of a fit that failed, stalled, did not settle or ran out of steps: what of model and data
        stood in the way of the method (`Method.cause`); may be empty.
    remedy : str
        Of a fit that failed: what to do about it (`Method.failure_remedy`); may be empty.
    """

    x: _Vector
    reason: str
    R: NDArray[np.float64]
    noise: tuple[Mapping[str, Any], ...] = ()
    note: str = ""
    local: Local | None = None
    unit: float = 1.0
    pull: Pull | None = None
    advice: str = ""
    rivals: tuple[Rival, ...] = ()
    cause: str = ""
    remedy: str = ""

    @classmethod
    def blind(cls, x: _Vector, reason: str, note: str = "") -> Fit:
        """Return a fit without a Jacobian, from which identifiability cannot be judged."""
        return cls(x, reason, np.zeros((len(x), len(x))), note=note)


class Method(ABC):
    """Base of the methods. A method is a frozen dataclass: its fields are its options.

    What a method states of itself is read by the run, the comparison and the report; there are no
    lists of names elsewhere.

    Attributes
    ----------
    max_iterations : int
        Largest number of steps.
    tolerance : float
        Relative step at which it has converged.
    name : str
        How it is called, as registered.
    label : str
        What its steps minimise, in words for the report; may be empty.
    reference : str
        Where it was published.
    needs : str
        What of model or data it needs beyond what every method does; may be empty.
    needs_exact : str
        Why it cannot be used in a reduced model; empty: it can.
    cannot : tuple of str
        Quantities that it cannot update.
    instead : str
        What to do about an unknown of such a quantity, for the message.
    calibrates : bool
        Whether it supports calibration factors: it compares with `Part.block`, which applies them.
    can_regularise : bool
        Whether it minimises one sum of squares within bounds, to which a pull can be added.
    is_likelihood : bool
        Whether it minimises the negative logarithm of a likelihood.
    fits_modes : bool
        Whether modes can be its data.
    states_noise : bool
        Whether its noise record holds all that is needed to simulate data.
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
        """What to do where its iteration breaks down; empty: to start closer."""
        return ""

    def cause(self, problem: Problem) -> str:
        """Return what of model and data stands in the way of this method; may be empty.

        Asked for a fit that failed, stalled or ran out of steps.

        Parameters
        ----------
        problem : Problem
            Model, data and unknowns, at their start.
        """
        numbers = problem.n_numbers
        if numbers >= problem.n:
            return ""
        return f"The data hold {numbers} real numbers for {counted(problem.n, 'unknown')}."

    def search(self, problem: Problem, noises: Sequence[NoiseModel], monitor: Monitor) -> Starts:
        """Return where to begin: by default the unknowns' start.

        Parameters
        ----------
        problem : Problem
            Model, data and unknowns.
        noises : sequence of NoiseModel
            How uncertain the data of each part are.
        monitor : Monitor
            Records the steps.
        """
        return Starts((problem.coordinates.home,))

    def fit_best(
        self,
        problem: Problem,
        noises: Sequence[NoiseModel],
        monitor: Monitor,
        starts: Starts,
    ) -> Fit:
        """Fit the unknowns from what `search` found; by default from the first point.

        Parameters
        ----------
        problem, noises, monitor
            As for `fit`.
        starts : Starts
            Where to begin.
        """
        return self.fit(problem, noises, monitor, starts.points[0])

    def answer(
        self,
        problem: Problem,
        noises: Sequence[NoiseModel],
        x: _Vector,
        held: int | None = None,
        beside: Answer | None = None,
    ) -> Answer | None:
        """Return what is known where a fit ended; by default None: no others are looked for.

        Parameters
        ----------
        problem, noises
            As for `fit`.
        x : ndarray of float, shape (n,)
            Where it ended.
        held : int, optional
            The unknown that was held, at the far end of a valley.
        beside : Answer, optional
            Where that valley begins.
        """
        return None

    def others(
        self,
        models: Models,
        noises: Sequence[NoiseModel],
        monitor: Monitor,
        at: Answer,
        points: Sequence[_Vector],
    ) -> list[Answer]:
        """Return what may be other answers that fit as well, to be fitted in a certified model.

        Parameters
        ----------
        models : Models
            What they are looked for in.
        noises, monitor
            As for `fit`.
        at : Answer
            The answer that is known.
        points : sequence of ndarray of float, shape (n,)
            Where to look, too: the ends of other tries of a search.
        """
        return []

    @abstractmethod
    def fit(
        self, problem: Problem, noises: Sequence[NoiseModel], monitor: Monitor, x: _Vector
    ) -> Fit:
        """Fit the unknowns from x.

        Parameters
        ----------
        problem : Problem
            Model, data and unknowns.
        noises : sequence of NoiseModel
            How uncertain the data of each part are.
        monitor : Monitor
            Records the steps.
        x : ndarray of float, shape (n,)
            Where to begin.

        Returns
        -------
        Fit
        """


def descend(
    problem: Problem,
    residual: Residual,
    x: _Vector,
    monitor: Monitor,
    settings: TrustRegion,
    unit: float = 1.0,
    *,
    relax: bool = True,
) -> Outcome:
    """Minimise one residual from x, priors included, and record every step.

    With `relax`, loss factors may turn negative on the way (`Coordinates.relaxed_lower`); where
    they end so, the descent goes on from the nearest point within the bounds. Where combinations of
    unknowns are undetermined, of all points that fit as well the one nearest to the unknowns' start
    is sought.

    Raises
    ------
    SolverError
        If the model cannot be solved at x.
    Stopped
        If the user wants to stop before x has been evaluated.
    """
    lower, upper = problem.coordinates.bounds
    within = problem.coordinates.within

    def evaluate(at: _Vector) -> Local | None:
        local = residual.local(problem, at)
        return None if local is None else with_prior(in_units(local, unit), problem, at)

    start = evaluate(x)
    if start is None:
        raise SolverError(f"{residual.name}: the model cannot be solved where the fit starts")
    if not monitor.begun:
        monitor.start(x, start)
    if monitor.stopped:
        return Outcome(x, start, "stopped")
    if within is not None:
        return settings.minimise(evaluate, x, lower, upper, monitor.step, within)
    outermost = problem.coordinates.relaxed_lower if relax else lower
    # A descent that a box cuts into rounds need not learn anew how far its steps may go.
    first = settings if problem.coordinates.box is None else monitor.resumed(settings, x)
    outcome = first.minimise(evaluate, x, outermost, upper, monitor.step)
    monitor.ended(outcome)
    inside = np.clip(outcome.x, lower, upper)
    if (inside != outcome.x).any():
        try:
            local = evaluate(inside)
        except Stopped:  # the nearest Jacobian that is known
            return Outcome(inside, outcome.local, "stopped")
        if local is None:
            raise SolverError(
                f"{residual.name}: the model cannot be solved with its loss factors at zero"
            )
        if outcome.reason == "stopped":
            return Outcome(inside, local, "stopped")
        outcome = settings.minimise(evaluate, inside, lower, upper, monitor.step)
    home = problem.coordinates.home
    for _ in range(_PULLS):
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
            or back.local.cost > outcome.local.cost * (1.0 + 1e-6) + _EXACT * problem.n_values
        ):
            break
        outcome = back
    return outcome


def descend_to_scale(
    problem: Problem,
    residual: Residual,
    x: _Vector,
    monitor: Monitor,
    settings: TrustRegion,
    spread: Callable[[_Vector, Local], float] | None = None,
) -> Outcome:
    """Minimise a residual whose spread is not known, priors included.

    A prior counts against the data in standard deviations of both. The spread of the residual is
    found along with the unknowns, each in turn, until it stays within 1 %, unless it is known
    beforehand (`Coordinates.unit`). Without priors it does not matter.

    Parameters
    ----------
    problem, residual, x, monitor, settings
        As for `descend`.
    spread : callable, optional
        Returns the standard deviation of the residual at a point and its local problem, where it
        is not of measured values (`spread_of`).

    Raises
    ------
    SolverError
        If the model cannot be solved at x.
    Stopped
        If the user wants to stop before x has been evaluated.
    """
    if problem.coordinates.unit is not None:
        return descend(problem, residual, x, monitor, settings, problem.coordinates.unit)
    outcome = descend(problem, residual, x, monitor, settings)
    if not problem.coordinates.prior[1].any():
        return outcome
    unit = 1.0
    for _ in range(_SCALES):
        if outcome.reason == "stopped":
            break
        try:
            local = residual.local(problem, outcome.x)
            if local is None:
                break
            if spread is None:
                sigma = spread_of(local, problem.n_values, problem.n)
            else:
                sigma = spread(outcome.x, local)
            if sigma == 0.0 or abs(sigma / unit - 1.0) < 0.01:
                break
            unit = sigma
            outcome = descend(problem, residual, outcome.x, monitor, settings, unit)
        except Stopped:
            return replace(outcome, reason="stopped")
    return outcome


def spread_of(local: Local, n_values: int, n: int) -> float:
    """Return the standard deviation of residuals of equal weight: sqrt(2 cost / (2 n_values - n)).

    With as many unknowns as measured numbers it cannot be estimated; then that of `ASSUMED` noise
    is taken.
    """
    if 2 * n_values <= n:
        return float(ASSUMED["relative"] / np.sqrt(2.0))
    return float(np.sqrt(2.0 * local.cost / (2 * n_values - n)))


def in_units(local: Local, sigma: float) -> Local:
    """Return a reduced problem divided by the standard deviation of its residuals, unless 0."""
    return Local(local.cost / sigma**2, local.R / sigma, local.q / sigma) if sigma > 0.0 else local


def stopped_at(problem: Problem, x: _Vector) -> Fit:
    """Return the fit that was stopped at x, with the Jacobian of the log error where it is cached.

    Parameters
    ----------
    problem : Problem
        What the log error was evaluated on, with data that carry their variance.
    x : ndarray of float, shape (n,)
        The best point so far.
    """
    residual = log_error(problem)
    local = residual.local(problem, x) if is_cached(residual, problem, x) else None
    if local is None or local.cost == 0.0:
        return Fit.blind(x, "stopped")
    sigma = spread_of(local, problem.n_values, problem.n)
    record = {
        "kind": "spread of the log error",
        "relative": float(np.sqrt(2.0) * sigma),
        "chi_square": 1.0,
    }
    return Fit(x, "stopped", local.R / sigma, (record | {"inflation": 1.0},) * len(problem.parts))


def known_length(
    problem: Problem,
    x: _Vector,
    whitened: Callable[[int, NDArray[np.complex128]], NDArray[np.complex128]],
) -> dict[str, float]:
    """Return the record of the correlation length of the residual at x; empty after a stop.

    Parameters
    ----------
    problem : Problem
        What was fitted.
    x : ndarray of float, shape (n,)
        The estimate.
    whitened : callable
        Residual over its standard deviation, for a part of the problem and the model's H there,
        both of shape (n_f, ...).
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


def serial_correlation(whitened: NDArray[np.complex128], lag: int = 1) -> float:
    """Return the correlation of a residual with itself some lines on; 0 of a residual of zeros.

    Parameters
    ----------
    whitened : ndarray of complex, shape (n_f, ...)
        Residual over its standard deviation.
    lag : int
        How many lines.
    """
    power = float(np.mean(np.abs(whitened) ** 2))
    if power == 0.0:
        return 0.0
    return float(np.mean((whitened[lag:] * whitened[:-lag].conj()).real)) / power


def correlation_length(whitened: NDArray[np.complex128]) -> float:
    """Return the correlation length of a residual in lines: 1 + 2 sum of its autocorrelation.

    Parameters
    ----------
    whitened : ndarray of complex, shape (n_f, ...)
        Residual over its standard deviation.

    Returns
    -------
    float
        1 for noise that is independent from line to line. The sum stops at the first lag whose
        correlation is within two standard deviations of zero, so that independent noise gives
        exactly 1 in almost all cases.

    Notes
    -----
    Standard deviations that take the lines as independent are too small by its square root
    (Priestley, Spectral Analysis and Time Series, 1981, section 5.3).
    """
    total = 1.0
    for lag in range(1, len(whitened) // 2):
        rho = serial_correlation(whitened, lag)
        if rho < 2.0 / np.sqrt(2.0 * whitened[lag:].size):
            break
        total += 2.0 * rho
    return total
