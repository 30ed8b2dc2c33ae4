"""Short fits under the hypothesis that the data have a fault."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.errors import SolverError
from updyn.sensitivity import Unknowns
from updyn.updating.fit.method import descend, serial_correlation
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.trust_region import TrustRegion
from updyn.updating.judge.causes.evidence import (
    Evidence,
    HeldQuantity,
    compute_spread,
    find_held,
    stack_real_imag,
)
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.misfit import (
    WeightedData,
    add_perfect_fit,
    compute_log_misfit,
    count_values,
)
from updyn.updating.judge.causes.quadratic import QuadraticMisfit
from updyn.updating.judge.causes.score import FirstOrderModel
from updyn.updating.judge.causes.settings import CAUSE_MISFIT, CAUSE_TRIAL, HELD_QUANTITIES
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import LineResidual, LogError, OutputError

__all__ = [
    "Trial",
    "adapt_losses",
    "free_held_quantities",
    "limit_correlation",
    "raise_loss_factors",
    "run_trial",
]


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """The end of a short fit to data corrected for a fault.

    `squared_distance` is that of the unknowns from their start, in units of their spread;
    `correlation` is that of neighbouring lines; `n_parameters` are those of the fault that the data
    determine; `quadratic` is None without held quantities.
    """

    fault: Fault | None
    x: RealArray
    mean_square: float
    squared_distance: float
    correlation: float
    n_values: int
    n_parameters: int = 0
    quadratic: QuadraticMisfit | None = None

    @property
    def n_held(self) -> int:
        """Number of held stiffnesses and masses."""
        return 0 if self.quadratic is None else int(self.quadratic.is_held.sum())

    @property
    def squared_distance_held(self) -> float:
        """Squared distance of the held quantities from their start, in units of their spread."""
        if self.quadratic is None:
            return 0.0
        distance = (self.quadratic.offset / self.quadratic.spread)[self.quadratic.is_held]
        return float(distance @ distance)

    @property
    def is_noise(self) -> bool:
        """Whether the residual is noise."""
        is_white = self.correlation < CAUSE_TRIAL.white_correlation
        return is_white and self.mean_square < CAUSE_TRIAL.noise_rms**2

    def gain(self, other: Trial, correlation: float | None = None) -> float:
        """Return the logarithm of the ratio of the evidence to that of another trial."""
        # Values that are correlated along the lines count less; each parameter of a fault costs as
        # much as in the Bayesian information criterion (Schwarz, Ann. Stat. 6 (1978) 461). Gains
        # are comparable only with the same `correlation`, by default the smaller one of the two
        # trials.
        return self.compare(other, correlation)[0]

    def compare(self, other: Trial, correlation: float | None = None) -> tuple[float, float]:
        """Return the gain, and the explained share of the misfit of another trial.

        With held quantities, the gain uses for each trial the share of their spread with the
        largest evidence; the explained share uses that of this trial for both.
        """
        if correlation is None:
            correlation = min(self.correlation, other.correlation)
        correlation = limit_correlation(correlation)
        count = self.n_values * (1.0 - correlation) / (1.0 + correlation)
        cost = 0.5 * (self.n_parameters - other.n_parameters) * np.log(max(count, 2.0))
        if self.quadratic is None or other.quadratic is None:
            level = [add_perfect_fit(t.mean_square) for t in (other, self)]
            closer = 0.5 * (other.squared_distance - self.squared_distance)
            gained = 0.5 * count * np.log(level[0] / level[1]) + closer
            return float(gained - cost), 1.0 - level[1] / level[0]
        least = min(self.mean_square, other.mean_square)
        trusted = [CAUSE_TRIAL.trusted_share * one.mean_square for one in (self, other)]
        share, own_outcome = self.quadratic.find_best_share(count, least, trusted[0])
        _, best = other.quadratic.find_best_share(count, least, trusted[1])
        other_outcome = other.quadratic.evaluate_share(share, count, least, trusted[1])
        gained = own_outcome.log_evidence - best.log_evidence
        level = [add_perfect_fit(float(one.mean_square)) for one in (other_outcome, own_outcome)]
        return float(gained - cost), 1.0 - level[1] / level[0]


def limit_correlation(correlation: float) -> float:
    """Return the correlation of neighbouring lines that reduces the number of values."""
    return min(max(correlation, 0.0), CAUSE_TRIAL.largest_correlation)


def run_trial(
    part: FRFPart,
    fault: Fault | None,
    points: Sequence[RealArray],
    *,
    is_short: bool = False,
    rival: Trial | None = None,
) -> Trial | None:
    """Return the best of short fits to data corrected for a fault; None if none can be solved.

    A fit ends early if its misfit at the best size is much larger than that of `rival`, whose
    residual is noise.
    """
    rounds = CAUSE_TRIAL.short_rounds if is_short else CAUSE_TRIAL.rounds
    steps = CAUSE_TRIAL.short_steps if is_short else CAUSE_TRIAL.steps
    ends = [_fit_with_fault(part, fault, x, rounds, steps, rival) for x in points]
    found = [end for end in ends if end is not None]
    return min(
        found,
        key=lambda t: t.n_values * np.log(add_perfect_fit(t.mean_square)) + t.squared_distance,
        default=None,
    )


def _fit_with_fault(
    part: FRFPart, fault: Fault | None, x: RealArray, rounds: int, steps: int, rival: Trial | None
) -> Trial | None:
    """Return the end of a fit that alternates between the unknowns and the size of a fault."""
    holds = bool(find_held(part).any())
    # With priors, one more round uses the level of the residual found in the first one.
    fewest = 2 if holds else 1
    try:
        fault, x = _choose_start(part, fault, x, steps)
        for number in range(1, rounds + 1):
            corrected = part if fault is None else fault.correct_part(part, x)
            x, mean_square, squared_distance, correlation = _descend(corrected, x, steps)
            has_size = number > 1 or fault is None or not (fault.has_free_size or fault.is_adaptive)
            behind = rival is not None and mean_square > (
                CAUSE_TRIAL.hopeless_ratio * add_perfect_fit(rival.mean_square)
            )
            if number == rounds or (has_size and behind):
                break
            better = None if fault is None else _estimate_size(part, corrected, fault, x)
            if number >= fewest and _has_converged(fault, better):
                break
            fault = better
    except SolverError:
        return None
    if fault is not None and not fault.is_plausible():
        return None
    fault = None if fault is None else fault.add_model_figures(part, x)
    n_parameters = 0 if fault is None else fault.count_parameters(part.frf)
    quadratic = _approximate_misfit(corrected, fault, x) if holds else None
    return Trial(
        fault,
        x,
        mean_square,
        squared_distance,
        correlation,
        count_values(part.frf),
        n_parameters,
        quadratic,
    )


def _choose_start(
    part: FRFPart, fault: Fault | None, x: RealArray, steps: int
) -> tuple[Fault | None, RealArray]:
    if fault is None:
        return None, x
    x = fault.choose_start(part, x)
    if fault.omits_channels:
        x = _descend(part.with_data(fault.mask_channels(part.frf)), x, steps)[0]
        fault = fault.adapt_to(Evidence(part, x))
    return fault, x


def _estimate_size(part: FRFPart, corrected: FRFPart, fault: Fault, x: RealArray) -> Fault:
    """Return the fault with its size from the data at x, either original or corrected for it."""
    if fault.is_adaptive or fault.omits_channels:
        return fault.adapt_to(Evidence(part, x))
    if not fault.has_free_size:
        return fault
    if not fault.is_additive:
        return FirstOrderModel(Evidence(part, x)).fit(fault).fault
    more = FirstOrderModel(Evidence(corrected, x)).fit(replace(fault, value=0.0))
    return replace(fault, value=fault.value + more.fault.value)


def _has_converged(fault: Fault | None, better: Fault | None) -> bool:
    """Return whether the size of a fault has converged; False for faults that adapt."""
    if fault is None or better is None:
        return True
    if fault.is_adaptive:
        return False
    change = abs(better.value - fault.value)
    return not fault.has_free_size or change < CAUSE_TRIAL.size_change * abs(better.value)


def _approximate_misfit(
    corrected: FRFPart, fault: Fault | None, x: RealArray
) -> QuadraticMisfit | None:
    """Return the misfit near the end of a trial, to second order, with a free size of the fault."""
    try:
        evidence = Evidence(corrected, x)
        J, e, slope = evidence.jacobian, evidence.misfit(corrected.frf), None
        if fault is not None and fault.has_free_size:
            # For faults that add up, the size counts from 0 after the correction.
            at = replace(fault, value=0.0) if fault.is_additive else fault
            d = stack_real_imag(evidence.weight * at.slope(evidence))
            slope = d @ J, d @ d, d @ e
        return QuadraticMisfit.at_point(evidence, e @ J, e @ e, slope)
    except SolverError:
        return None


def _descend(part: FRFPart, x: RealArray, steps: int) -> tuple[RealArray, float, float, float]:
    """Return x at the least log error, its mean square, the squared distance, the correlation."""
    problem = _add_priors(part)
    residual = _make_residual(part)
    unit = max(np.sqrt(_mean_square(part, x)), CAUSE_MISFIT.perfect_rms)
    settings = TrustRegion(
        steps,
        CAUSE_TRIAL.tolerance,
        radius=CAUSE_TRIAL.radius,
        min_relative_decrease=CAUSE_TRIAL.least_decrease,
    )
    x = descend(problem, residual, x, Monitor(problem), settings, unit).x
    e = _compute_misfit(part, x)
    centre, weight = problem.coordinates.prior
    squared_distance = float(np.sum((weight * (x - centre)) ** 2))
    correlation = serial_correlation(e) if len(e) > 1 else 0.0
    return x, float(np.mean(np.abs(e) ** 2)), squared_distance, correlation


def _make_residual(part: FRFPart) -> LineResidual:
    """Return the residual of a descent, in the unit of the misfit."""
    frf = part.frf
    if isinstance(frf, WeightedData):
        return OutputError(np.asarray(frf.misfit_scale))
    return LogError.of_noisy_data(part)


def _compute_misfit(part: FRFPart, x: RealArray) -> ComplexArray:
    return compute_log_misfit(part.responses(x), part.frf)[0]


def _mean_square(part: FRFPart, x: RealArray) -> float:
    return float(np.mean(np.abs(_compute_misfit(part, x)) ** 2))


def _add_priors(part: FRFPart) -> Problem:
    """Return the problem with priors on all unknowns, of the width of their spread."""
    spread = compute_spread(part)
    parameters = part.coordinates.parameters
    items = [replace(p, prior_std=float(s)) for p, s in zip(parameters, spread, strict=True)]
    held = replace(part.coordinates, parameters=ParameterSet(tuple(items)))
    return Problem.of([replace(part, coordinates=held)])


def raise_loss_factors(part: FRFPart, x: RealArray) -> RealArray:
    """Return x with loss factors of at least 0.1, so that resonances overlap."""
    is_factor = ~part.coordinates.parameters.is_damping
    return np.clip(
        np.where(is_factor, x, np.maximum(x, CAUSE_TRIAL.least_start_loss)),
        *part.coordinates.bounds,
    )


def free_held_quantities(part: FRFPart) -> tuple[FRFPart, RealArray]:
    """Return the part with held quantities as further unknowns, and their start, as x."""
    # Held quantities are slightly wrong; their errors must not be taken for a fault of the data.
    parameters, system = part.coordinates.parameters, part.solver.system
    sought = {(drive.group, drive.quantity) for p in parameters for drive in p.acts_on}
    loss = part.state(part.coordinates.start).loss
    items: list[HeldQuantity] = []
    for t, term in enumerate(system.terms):
        if not term.group:
            continue
        held = (term.group, term.quantity) not in sought and term.quantity in ("stiffness", "mass")
        if held and term.data.any():
            std = HELD_QUANTITIES.factor_std
            items.append(HeldQuantity(term.group, term.quantity, 1.0, 0.1, 10.0, std))
        lossy = term.quantity == "stiffness" and term.table is None
        if lossy and (term.group, "loss_factor") not in sought:
            value = float(loss[t])
            std = max(HELD_QUANTITIES.least_loss_std, HELD_QUANTITIES.loss_share * value)
            items.append(HeldQuantity(term.group, "loss_factor", value, 0.0, 10.0, std))
    if not 0 < len(items) <= HELD_QUANTITIES.most:
        return part, np.zeros(0)
    wide = ParameterSet((*parameters.items, *items))
    coordinates = replace(part.coordinates, parameters=wide, box=None)
    whole = replace(part, unknowns=Unknowns.find(system, wide), coordinates=coordinates)
    return whole, coordinates.start[len(parameters) :]


def adapt_losses(part: FRFPart, x: RealArray) -> FRFPart:
    """Return the part with prior deviations of held loss factors not below their distances at x."""
    # A held loss factor is often only a guess, or 0. The deviation with the largest prior density
    # of a value is its distance from the held one (MacKay, Neural Comput. 4 (1992) 415, section
    # 3).
    coordinates = part.coordinates
    off = np.abs(x - coordinates.start)
    items = [
        replace(p, prior_std=max(float(p.prior_std or 0.0), float(d)))
        if isinstance(p, HeldQuantity) and p.quantity == "loss_factor"
        else p
        for p, d in zip(coordinates.parameters, off, strict=True)
    ]
    return replace(part, coordinates=replace(coordinates, parameters=ParameterSet(tuple(items))))
