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
from updyn.updating.judge.causes.evidence import SMALLEST, Evidence, Held, held_of, spread_of
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.misfit import Weighed, log_misfit, n_seen
from updyn.updating.judge.causes.quadratic import Quadratic
from updyn.updating.judge.causes.score import fitted
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.problem import Part, Problem
from updyn.updating.problem.residuals import LineResidual, LogError, OutputError

__all__ = ["MOST_ALIKE", "NOISY", "Trial", "damped", "robust_point", "tried", "widened"]

_Real = NDArray[np.float64]

#: How often the size of a fault is estimated anew, and steps of each descent: of a whole trial, of
#: a first one.
_WHOLE, _GLANCE = (5, 20), (1, 8)
#: How many times what noise has no further descent makes good.
_FAR_BEHIND = 4.0
#: Rounds of the robust fit, and its steps in each.
_REWEIGHTED, _FEW = 4, 8
#: Loss factor from which descents begin: resonances overlap.
_DAMPED = 0.1
#: How far what is held of the model is expected to be off: stiffness and mass, in logarithm; loss
#: factors, as a share, and at least by so much: no structure is without. More of it than this is
#: left as it is.
_HELD, _HELD_LOSS, _LEAST_LOSS, _MOST_HELD = 0.05, 0.5, 0.05, 60
#: Share of the misfit at the end of a fit that the second order about it is trusted to leave.
_TRUSTED = 0.5
#: Correlation of neighbouring lines, and log misfit (rms), below which what is left is noise. On
#: few lines an error of the model looks like it, but for its size. It is of use from some 230 real
#: values; of 240, on 30 lines, white noise is above in 7 %.
_WHITE, NOISY = 0.1, 0.05
#: Largest correlation of neighbouring lines that is counted.
MOST_ALIKE = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """The end of a short fit.

    Attributes
    ----------
    fault : Fault or None
        What the data were freed of.
    x : ndarray of float, shape (n,)
        Where it ended.
    power : float
        Mean square of the log misfit that is left.
    far : float
        Sum of squares of the unknowns' way from their start, in units of their spread.
    alike : float
        Correlation of the misfit of neighbouring lines.
    n_values : int
        Number of real values that stand clear of the noise.
    numbers : int
        Numbers of the fault that the data determine.
    quadratic : Quadratic or None
        The misfit about the end; None where nothing is held of the model.
    """

    fault: Fault | None
    x: _Real
    power: float
    far: float
    alike: float
    n_values: int
    numbers: int = 0
    quadratic: Quadratic | None = None

    @property
    def n_held(self) -> int:
        """Number of stiffnesses and masses that are held of the model."""
        return 0 if self.quadratic is None else int(self.quadratic.held.sum())

    @property
    def far_held(self) -> float:
        """Sum of squares of the way of what is held of the model, in units of its spread."""
        if self.quadratic is None:
            return 0.0
        way = (self.quadratic.off / self.quadratic.spread)[self.quadratic.held]
        return float(way @ way)

    @property
    def is_noise(self) -> bool:
        """Whether what is left is noise."""
        return self.alike < _WHITE and self.power < NOISY**2

    def gain(self, other: Trial, alike: float | None = None) -> float:
        """Return by how much the logarithm of the evidence is larger than that of another trial.

        Values that follow each other alike count less; each number of a fault costs what the
        Bayesian information criterion says (Schwarz, Ann. Stat. 6 (1978) 461). Gains over one trial
        are comparable where they are taken with one correlation of neighbouring lines, `alike`;
        else it is the smaller one of the two.
        """
        return self.compared(other, alike)[0]

    def compared(self, other: Trial, alike: float | None = None) -> tuple[float, float]:
        """Return the gain, and the share of the other's misfit that is explained.

        Where something is held of the model, both are taken with that being off as far as suits
        them best, and the other's misfit with that being off as far as suits this one.
        """
        alike = min(self.alike, other.alike) if alike is None else alike
        alike = min(max(alike, 0.0), MOST_ALIKE)
        count = self.n_values * (1.0 - alike) / (1.0 + alike)
        cost = 0.5 * (self.numbers - other.numbers) * np.log(max(count, 2.0))
        if self.quadratic is None or other.quadratic is None:
            level = [t.power + SMALLEST**2 for t in (other, self)]
            gained = 0.5 * count * np.log(level[0] / level[1]) + 0.5 * (other.far - self.far)
            return float(gained - cost), 1.0 - level[1] / level[0]
        least = min(self.power, other.power)
        near = _TRUSTED * self.power, _TRUSTED * other.power
        share, own = self.quadratic.best(count, least, near[0])
        _, best = other.quadratic.best(count, least, near[1])
        there = other.quadratic.outcome(share, count, least, near[1])
        gained = own.log_evidence - best.log_evidence
        left = (own.power + SMALLEST**2) / (there.power + SMALLEST**2)
        return float(gained - cost), 1.0 - left


def tried(
    part: Part,
    fault: Fault | None,
    points: Sequence[_Real],
    *,
    glance: bool = False,
    rival: Trial | None = None,
) -> Trial | None:
    """Return the best end of short fits from some points, the data being freed of a fault.

    Parameters
    ----------
    part : Part
        Model and data of one test, on few lines.
    fault : Fault or None
        By its first size; None: the data are taken as they are.
    points : sequence of ndarray of float, shape (n,)
        Where to begin.
    glance : bool
        Whether few steps are enough.
    rival : Trial, optional
        One that left only noise: what is far behind it by its best size ends there.

    Returns
    -------
    Trial or None
        None where the model cannot be solved.
    """
    steps = _GLANCE if glance else _WHOLE
    ends = [_fitted(part, fault, x, *steps, rival) for x in points]
    found = [end for end in ends if end is not None]
    return min(
        found, key=lambda t: t.n_values * np.log(t.power + SMALLEST**2) + t.far, default=None
    )


def _fitted(
    part: Part, fault: Fault | None, x: _Real, rounds: int, steps: int, rival: Trial | None
) -> Trial | None:
    """Return where the fit ends that takes turns at the unknowns and at the size of a fault."""
    holds = bool(held_of(part).any())
    # Once more, the spread of the residual being known, where priors are to count by it.
    fewest = 2 if holds else 1
    try:
        fault, x = _begun(part, fault, x, steps)
        for number in range(1, rounds + 1):
            freed = part if fault is None else fault.accounted(part, x)
            x, power, far, alike = _descent(freed, x, steps)
            sized = number > 1 or fault is None or not (fault.tunes or fault.adapts)
            behind = rival is not None and power > _FAR_BEHIND * (rival.power + SMALLEST**2)
            if number == rounds or (sized and behind):
                break
            better = None if fault is None else _resized(part, freed, fault, x)
            if number >= fewest and _is_settled(fault, better):
                break
            fault = better
    except SolverError:
        return None
    if fault is not None and not fault.plausible():
        return None
    fault = None if fault is None else fault.described(part, x)
    numbers = 0 if fault is None else fault.numbers(part.frf)
    quadratic = _about(freed, fault, x) if holds else None
    return Trial(fault, x, power, far, alike, n_seen(part.frf), numbers, quadratic)


def _begun(part: Part, fault: Fault | None, x: _Real, steps: int) -> tuple[Fault | None, _Real]:
    """Return the fault and the point that a fit begins from."""
    if fault is None:
        return None, x
    x = fault.begun(part, x)
    if fault.leaves_out:
        x = _descent(part.with_data(fault.others(part.frf)), x, steps)[0]
        fault = fault.searched(Evidence(part, x))
    return fault, x


def _resized(part: Part, freed: Part, fault: Fault, x: _Real) -> Fault:
    """Return the fault as data show it at x: as they are, or as they were freed of it."""
    if fault.adapts:
        return fault.refined(Evidence(part, x))
    if not fault.tunes:
        return fault
    if fault.leaves_out:
        return fault.searched(Evidence(part, x))
    if not fault.adds:
        return fitted(Evidence(part, x), fault)[1]
    more = fitted(Evidence(freed, x), replace(fault, value=0.0))[1]
    return replace(fault, value=fault.value + more.value)


def _is_settled(fault: Fault | None, better: Fault | None) -> bool:
    """Return whether the size of a fault has come to rest; what adapts never does."""
    if fault is None or better is None:
        return True
    if fault.adapts:
        return False
    return not fault.tunes or abs(better.value - fault.value) < 1e-3 * abs(better.value)


def _about(freed: Part, fault: Fault | None, x: _Real) -> Quadratic | None:
    """Return the misfit about the end of a trial, the size of a fault being free, too."""
    try:
        evidence = Evidence(freed, x)
        slope = None
        if fault is not None and fault.tunes:
            # What the data are freed of counts from 0 where two such faults add up.
            slope = (replace(fault, value=0.0) if fault.adds else fault).slope(evidence)
        return Quadratic.at(evidence, slope=slope)
    except SolverError:
        return None


def _descent(part: Part, x: _Real, steps: int) -> tuple[_Real, float, float, float]:
    """Return where the log error has its least value near x, its mean square there, ..."""
    problem = _held(part)
    residual = _residual(part)
    unit = max(np.sqrt(_power(part, x)), SMALLEST)
    settings = TrustRegion(steps, 1e-6, radius=0.3, relative_fall=1e-4)
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
    return LogError.clear_of_noise(part)


def _misfit(part: Part, x: _Real) -> NDArray[np.complex128]:
    return log_misfit(part.responses(x), part.frf)[0]


def _power(part: Part, x: _Real) -> float:
    return float(np.mean(np.abs(_misfit(part, x)) ** 2))


def _held(part: Part) -> Problem:
    """Return the problem with priors on all unknowns, by how far they are expected to be off."""
    spread = spread_of(part)
    own = part.coordinates.parameters
    items = [replace(p, prior_std=float(s)) for p, s in zip(own, spread, strict=True)]
    held = replace(part.coordinates, parameters=ParameterSet(tuple(items)))
    return Problem.of([replace(part, coordinates=held)])


def damped(part: Part, x: _Real) -> _Real:
    """Return x with loss factors of 0.1 at least, so that resonances overlap."""
    is_factor = part.coordinates.parameters.is_factor
    return np.clip(np.where(is_factor, x, np.maximum(x, _DAMPED)), *part.coordinates.bounds)


def robust_point(part: Part, x: _Real) -> _Real:
    """Return where a fit ends in which channels that do not follow the others count less.

    Channel by channel the log error is weighted with 1 / (1 + s^2 / s_0^2), s its rms and s_0 the
    median of all channels.
    """
    problem, plain = _held(part), LogError.clear_of_noise(part)
    assert plain.weight is not None
    settings = TrustRegion(_FEW, 1e-6, radius=0.3, relative_fall=1e-3)
    for _ in range(_REWEIGHTED):
        size = np.mean(np.abs(_misfit(part, x)) ** 2, axis=0)
        typical = max(float(np.median(size)), SMALLEST**2)
        weight = plain.weight / np.sqrt(1.0 + size / typical)
        residual = replace(plain, weight=weight)
        x = descend(problem, residual, x, Monitor(problem), settings, np.sqrt(typical)).x
    return x


def widened(part: Part) -> tuple[Part, _Real]:
    """Return the part with what is held of the model as unknown, too, and where that starts, as x.

    What nobody seeks is a little wrong all the same; it must not be taken for a fault of the data.
    """
    own, system = part.coordinates.parameters, part.solver.system
    sought = {(drive.group, drive.quantity) for p in own for drive in p.acts_on}
    loss = part.state(part.coordinates.home).loss
    items: list[Held] = []
    for t, term in enumerate(system.terms):
        held = (term.group, term.quantity) not in sought and term.quantity in ("stiffness", "mass")
        if held and term.data.any():
            items.append(Held(term.group, term.quantity, 1.0, 0.1, 10.0, _HELD))
        lossy = term.quantity == "stiffness" and term.table is None
        if lossy and (term.group, "loss_factor") not in sought:
            spread = max(_LEAST_LOSS, _HELD_LOSS * float(loss[t]))
            items.append(Held(term.group, "loss_factor", float(loss[t]), 0.0, 10.0, spread))
    if not 0 < len(items) <= _MOST_HELD:
        return part, np.zeros(0)
    wide = ParameterSet((*own.items, *items))
    coordinates = replace(part.coordinates, parameters=wide, box=None)
    whole = replace(part, unknowns=Unknowns.find(system, wide), coordinates=coordinates)
    return whole, coordinates.home[len(own) :]
