"""Short fits under the hypothesis that the data have a fault."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from updyn.errors import SolverError
from updyn.sensitivity import Unknowns
from updyn.updating.fit.method import descend, serial_correlation
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.trust_region import TrustRegion
from updyn.updating.judge.causes.evidence import (
    PERFECT_FIT,
    Evidence,
    HeldQuantity,
    compute_spread,
    find_held,
)
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.misfit import Weighed, log_misfit, n_seen
from updyn.updating.judge.causes.quadratic import Quadratic
from updyn.updating.judge.causes.score import fit_first_order
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.problem import Part, Problem
from updyn.updating.problem.residuals import LineResidual, LogError, OutputError

__all__ = [
    "MOST_ALIKE",
    "NOISY",
    "Trial",
    "adapt_losses",
    "damped",
    "robust_point",
    "tried",
    "widened",
]

_Real = NDArray[np.float64]

#: Number of estimates of the size of a fault, and of steps of each descent: of a whole trial, and
#: of a short one.
_WHOLE, _GLANCE = (5, 20), (1, 8)
#: Ratio of the mean square misfit to that of a trial that leaves noise, above which a fit ends.
_FAR_BEHIND = 4.0
#: Number of reweightings of the robust fit, and of steps after each.
_REWEIGHTED, _FEW = 4, 8
#: Smallest loss factor at the start of a descent, so that resonances overlap.
_DAMPED = 0.1
#: Prior standard deviation of held quantities: of ln(stiffness) and ln(mass); of loss factors, as a
#: share, and its smallest value, since every structure has damping. Largest number of held
#: quantities that are freed; if there are more, none is.
_HELD, _HELD_LOSS, _LEAST_LOSS, _MOST_HELD = 0.05, 0.5, 0.05, 60
#: Share of the misfit at the end of a fit below which the second order is not trusted.
_TRUSTED = 0.5
#: Correlation of neighbouring lines, and log misfit (rms), below which a residual is noise. On few
#: lines an error of the model resembles noise, except in size. The test is useful from about 230
#: real values; with 240, on 30 lines, white noise exceeds the correlation in 7 %.
_WHITE, NOISY = 0.1, 0.05
#: Largest correlation of neighbouring lines that is taken into account.
MOST_ALIKE = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """The end of a short fit.

    Attributes
    ----------
    fault : Fault or None
        Fault for which the data were corrected.
    x : ndarray of float, shape (n,)
        End of the fit.
    power : float
        Mean square of the residual log misfit.
    far : float
        Squared distance of the unknowns from their start, in units of their spread.
    alike : float
        Correlation of the misfit of neighbouring lines.
    n_values : int
        Number of real values with weight.
    numbers : int
        Number of parameters of the fault that the data determine.
    quadratic : Quadratic or None
        The misfit near the end, to second order; None without held quantities.
    """

    fault: Fault | None
    x: _Real
    power: float
    far: float
    alike: float
    n_values: int
    n_parameters: int = 0
    quadratic: Quadratic | None = None

    @property
    def n_held(self) -> int:
        """Number of held stiffnesses and masses."""
        return 0 if self.quadratic is None else int(self.quadratic.held.sum())

    @property
    def far_held(self) -> float:
        """Squared distance of the held quantities from their start, in units of their spread."""
        if self.quadratic is None:
            return 0.0
        way = (self.quadratic.off / self.quadratic.spread)[self.quadratic.held]
        return float(way @ way)

    @property
    def is_noise(self) -> bool:
        """Whether the residual is noise."""
        return self.alike < _WHITE and self.power < NOISY**2

    def gain(self, other: Trial, alike: float | None = None) -> float:
        """Return the logarithm of the ratio of the evidence to that of another trial.

        Values that are correlated along the lines count less; each parameter of a fault costs as
        much as in the Bayesian information criterion (Schwarz, Ann. Stat. 6 (1978) 461). Gains over
        the same trial are comparable if they use the same correlation of neighbouring lines,
        `alike`; by default it is the smaller one of the two trials.
        """
        return self.compared(other, alike)[0]

    def compared(self, other: Trial, alike: float | None = None) -> tuple[float, float]:
        """Return the gain, and the explained share of the misfit of another trial.

        With held quantities, the gain uses for each trial the share of their spread with the
        largest evidence; the explained share uses that of this trial for both.
        """
        alike = min(self.alike, other.alike) if alike is None else alike
        alike = min(max(alike, 0.0), MOST_ALIKE)
        count = self.n_values * (1.0 - alike) / (1.0 + alike)
        cost = 0.5 * (self.n_parameters - other.n_parameters) * np.log(max(count, 2.0))
        if self.quadratic is None or other.quadratic is None:
            level = [t.power + PERFECT_FIT**2 for t in (other, self)]
            gained = 0.5 * count * np.log(level[0] / level[1]) + 0.5 * (other.far - self.far)
            return float(gained - cost), 1.0 - level[1] / level[0]
        least = min(self.power, other.power)
        near = _TRUSTED * self.power, _TRUSTED * other.power
        share, own = self.quadratic.best(count, least, near[0])
        _, best = other.quadratic.best(count, least, near[1])
        there = other.quadratic.outcome(share, count, least, near[1])
        gained = own.log_evidence - best.log_evidence
        left = (own.power + PERFECT_FIT**2) / (there.power + PERFECT_FIT**2)
        return float(gained - cost), 1.0 - left


def tried(
    part: Part,
    fault: Fault | None,
    points: Sequence[_Real],
    *,
    glance: bool = False,
    rival: Trial | None = None,
) -> Trial | None:
    """Return the best of short fits from some points to data corrected for a fault, if any.

    None if the model cannot be solved. With `glance`, the fits have few steps. `rival` is a trial
    that leaves only noise: a fit with a much larger misfit at its best size ends early.
    """
    steps = _GLANCE if glance else _WHOLE
    ends = [_fitted(part, fault, x, *steps, rival) for x in points]
    found = [end for end in ends if end is not None]
    return min(
        found, key=lambda t: t.n_values * np.log(t.power + PERFECT_FIT**2) + t.far, default=None
    )


def _fitted(
    part: Part, fault: Fault | None, x: _Real, rounds: int, steps: int, rival: Trial | None
) -> Trial | None:
    """Return the end of a fit that alternates between the unknowns and the size of a fault."""
    holds = bool(find_held(part).any())
    # With priors, one more round uses the level of the residual found in the first one.
    fewest = 2 if holds else 1
    try:
        fault, x = _begun(part, fault, x, steps)
        for number in range(1, rounds + 1):
            freed = part if fault is None else fault.correct_part(part, x)
            x, power, far, alike = _descent(freed, x, steps)
            sized = number > 1 or fault is None or not (fault.has_free_size or fault.is_adaptive)
            behind = rival is not None and power > _FAR_BEHIND * (rival.power + PERFECT_FIT**2)
            if number == rounds or (sized and behind):
                break
            better = None if fault is None else _resized(part, freed, fault, x)
            if number >= fewest and _is_settled(fault, better):
                break
            fault = better
    except SolverError:
        return None
    if fault is not None and not fault.is_plausible():
        return None
    fault = None if fault is None else fault.add_model_figures(part, x)
    numbers = 0 if fault is None else fault.count_parameters(part.frf)
    quadratic = _about(freed, fault, x) if holds else None
    return Trial(fault, x, power, far, alike, n_seen(part.frf), numbers, quadratic)


def _begun(part: Part, fault: Fault | None, x: _Real, steps: int) -> tuple[Fault | None, _Real]:
    """Return the fault and the starting point of a fit."""
    if fault is None:
        return None, x
    x = fault.choose_start(part, x)
    if fault.omits_channels:
        x = _descent(part.with_data(fault.mask_channels(part.frf)), x, steps)[0]
        fault = fault.search_size(Evidence(part, x))
    return fault, x


def _resized(part: Part, freed: Part, fault: Fault, x: _Real) -> Fault:
    """Return the fault with its size from the data at x, either original or corrected for it."""
    if fault.is_adaptive:
        return fault.adapt_to(Evidence(part, x))
    if not fault.has_free_size:
        return fault
    if fault.omits_channels:
        return fault.search_size(Evidence(part, x))
    if not fault.is_additive:
        return fit_first_order(Evidence(part, x), fault)[1]
    more = fit_first_order(Evidence(freed, x), replace(fault, value=0.0))[1]
    return replace(fault, value=fault.value + more.value)


def _is_settled(fault: Fault | None, better: Fault | None) -> bool:
    """Return whether the size of a fault has converged; False for faults that adapt."""
    if fault is None or better is None:
        return True
    if fault.is_adaptive:
        return False
    return not fault.has_free_size or abs(better.value - fault.value) < 1e-3 * abs(better.value)


def _about(freed: Part, fault: Fault | None, x: _Real) -> Quadratic | None:
    """Return the misfit near the end of a trial, to second order, with a free size of the fault."""
    try:
        evidence = Evidence(freed, x)
        slope = None
        if fault is not None and fault.has_free_size:
            # For faults that add up, the size counts from 0 after the correction.
            slope = (replace(fault, value=0.0) if fault.is_additive else fault).slope(evidence)
        return Quadratic.at(evidence, slope=slope)
    except SolverError:
        return None


def _descent(part: Part, x: _Real, steps: int) -> tuple[_Real, float, float, float]:
    """Return x at the least log error, its mean square, the squared distance, the correlation."""
    problem = _held(part)
    residual = _residual(part)
    unit = max(np.sqrt(_power(part, x)), PERFECT_FIT)
    settings = TrustRegion(steps, 1e-6, radius=0.3, min_relative_decrease=1e-4)
    x = descend(problem, residual, x, Monitor(problem), settings, unit).x
    e = _misfit(part, x)
    centre, weight = problem.coordinates.prior
    far = float(np.sum((weight * (x - centre)) ** 2))
    alike = serial_correlation(e) if len(e) > 1 else 0.0
    return x, float(np.mean(np.abs(e) ** 2)), far, alike


def _residual(part: Part) -> LineResidual:
    """Return the residual of a descent, in the unit of the misfit."""
    frf = part.frf
    if isinstance(frf, Weighed):
        return OutputError(np.asarray(frf.scale))
    return LogError.of_noisy_data(part)


def _misfit(part: Part, x: _Real) -> NDArray[np.complex128]:
    return log_misfit(part.responses(x), part.frf)[0]


def _power(part: Part, x: _Real) -> float:
    return float(np.mean(np.abs(_misfit(part, x)) ** 2))


def _held(part: Part) -> Problem:
    """Return the problem with priors on all unknowns, of the width of their spread."""
    spread = compute_spread(part)
    own = part.coordinates.parameters
    items = [replace(p, prior_std=float(s)) for p, s in zip(own, spread, strict=True)]
    held = replace(part.coordinates, parameters=ParameterSet(tuple(items)))
    return Problem.of([replace(part, coordinates=held)])


def damped(part: Part, x: _Real) -> _Real:
    """Return x with loss factors of at least 0.1, so that resonances overlap."""
    is_factor = part.coordinates.parameters.is_factor
    return np.clip(np.where(is_factor, x, np.maximum(x, _DAMPED)), *part.coordinates.bounds)


def robust_point(part: Part, x: _Real) -> _Real:
    """Return the end of a fit with less weight on channels that disagree with the others.

    The weight of the log error of a channel is 1 / (1 + s^2 / s_0^2), with s its rms and s_0 the
    median of all channels.
    """
    problem, plain = _held(part), LogError.of_noisy_data(part)
    assert plain.weight is not None
    settings = TrustRegion(_FEW, 1e-6, radius=0.3, min_relative_decrease=1e-3)
    for _ in range(_REWEIGHTED):
        size = np.mean(np.abs(_misfit(part, x)) ** 2, axis=0)
        typical = max(float(np.median(size)), PERFECT_FIT**2)
        weight = plain.weight / np.sqrt(1.0 + size / typical)
        residual = replace(plain, weight=weight)
        x = descend(problem, residual, x, Monitor(problem), settings, np.sqrt(typical)).x
    return x


def widened(part: Part) -> tuple[Part, _Real]:
    """Return the part with held quantities as further unknowns, and their start, as x.

    Held quantities are slightly wrong; their errors must not be taken for a fault of the data.
    """
    own, system = part.coordinates.parameters, part.solver.system
    sought = {(drive.group, drive.quantity) for p in own for drive in p.acts_on}
    loss = part.state(part.coordinates.home).loss
    items: list[HeldQuantity] = []
    for t, term in enumerate(system.terms):
        held = (term.group, term.quantity) not in sought and term.quantity in ("stiffness", "mass")
        if held and term.data.any():
            items.append(HeldQuantity(term.group, term.quantity, 1.0, 0.1, 10.0, _HELD))
        lossy = term.quantity == "stiffness" and term.table is None
        if lossy and (term.group, "loss_factor") not in sought:
            spread = max(_LEAST_LOSS, _HELD_LOSS * float(loss[t]))
            items.append(HeldQuantity(term.group, "loss_factor", float(loss[t]), 0.0, 10.0, spread))
    if not 0 < len(items) <= _MOST_HELD:
        return part, np.zeros(0)
    wide = ParameterSet((*own.items, *items))
    coordinates = replace(part.coordinates, parameters=wide, box=None)
    whole = replace(part, unknowns=Unknowns.find(system, wide), coordinates=coordinates)
    return whole, coordinates.home[len(own) :]


def adapt_losses(part: Part, x: _Real) -> Part:
    """Return the part with prior deviations of held loss factors not below their distances at x.

    A held loss factor is often only a guess, or 0. The deviation with the largest prior density of
    a value is its distance from the held one (MacKay, Neural Comput. 4 (1992) 415, section 3).
    """
    coordinates = part.coordinates
    off = np.abs(x - coordinates.home)
    items = [
        replace(p, prior_std=max(float(p.prior_std or 0.0), float(d)))
        if isinstance(p, HeldQuantity) and p.quantity == "loss_factor"
        else p
        for p, d in zip(coordinates.parameters, off, strict=True)
    ]
    return replace(part, coordinates=replace(coordinates, parameters=ParameterSet(tuple(items))))
