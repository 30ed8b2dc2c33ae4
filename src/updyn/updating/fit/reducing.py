"""Fit inside a reduced model whose error is certified where the fit ends.

A reduced model is exact at the point of its basis, and less accurate the further the unknowns move.
The fit therefore stays within a trust radius about that point. Where it ends, the full residual
certifies the basis; if that fails, a new basis is built there and the fit goes on. As values and
slopes at the point of the basis are those of the full model, few rounds suffice.

A search moves further: where the unknowns are far off, the basis of the start has local minima that
the model has not, which a fit then takes for the answer. The search is therefore made in another
basis, of the start and of points all around it: accurate enough everywhere to find the basin
(benchmarks/solids.py). A fit from the start comes before it, as it costs little beside that basis;
where its residual looks like noise, there is nothing to search for.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from updyn.dynamics.fields import FieldSolver
from updyn.dynamics.reduced import Certificate, Reduction
from updyn.errors import OptionError, SolverError
from updyn.frf import FRF
from updyn.updating.fit.belief import Belief
from updyn.updating.fit.method import Fit, Method, descend
from updyn.updating.fit.methods import METHODS
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.regularisation import keeps_to_directions
from updyn.updating.fit.search import coarse, scattered
from updyn.updating.fit.trust_region import TrustRegion
from updyn.updating.problem.noise import Approximate, NoiseModel
from updyn.updating.problem.problem import Part, Problem, shares_of
from updyn.updating.problem.residuals import log_error
from updyn.updating.problem.session import Stopped

__all__ = ["FINEST", "Reducing", "fallback", "is_reduced", "reduction_of"]

_Vector = NDArray[np.float64]

#: Larger models than this are reduced where no tier is forced, if there are at least so many lines:
#: from about here on it takes less time (`benchmarks/tiers.py`).
_DOFS = 600
_LINES = 40
#: Trust radius of a basis for logarithms of factors.
_TRUST_RADIUS = 0.2
#: Trust radius for loss factors: this, or half their value if that is larger.
_LOSS_RADIUS = 0.05
#: Largest number of steps of a round that leaves the trust radius.
_MAX_STEPS_PER_ROUND = 12
_ROUNDS = 12
#: Rounds of a fit from the start. Each lowers the log error to this share of the one before, or its
#: residual looks like noise; else the start is far off.
_FIRST_ROUNDS, _LOWERED = 12, 0.8
#: Their trust radius over that of a fit: what they are to find is near the answer, not the answer.
_WIDER = 4.0
#: Their descents.
_DOWN = TrustRegion(_MAX_STEPS_PER_ROUND, 1e-9, radius=0.3, relative_fall=1e-3)
#: Error at the start, from which only figures are taken, over that wanted at the end.
_AT_START = 10.0
#: Within this share of the trust radius a basis is enriched; beyond it a new one is smaller, and
#: takes less time, where factorisations do: up to so many DOFs (`benchmarks/large.py`).
_NEAR, _NEAR_IF_HEAVY, _HEAVY = 0.1, 0.5, 20_000
#: A larger basis is compressed.
_LARGE = 400
#: Points about the start whose vectors make the basis of a search: two for each factor, between
#: these numbers.
_POINTS = (8, 24)
#: Points whose fields choose among these vectors.
_SAMPLES = 40
#: How far they lie from the start, in logarithms of factors.
_AWAY = 1.0
#: Largest loss factor of theirs.
_LOSSY = 0.3
#: Root of the share of the energy of these fields that may be dropped.
_DROPPED = 1e-4
#: Times the error of these fields, what a search is told of it: it is not noise, whose mean is 0.
_MARGIN = 10.0
#: Largest number of lines of a search.
_SEARCHED = 200
#: Wanted besides: the error as a share of the faintest channel; and the finest that is asked for.
_FAINT, FINEST = 1e-3, 1e-9
#: Number of DOFs without a sensor whose error counts too, for the experiment advice.
_ELSEWHERE = 200


def is_reduced(
    tier: str | None,
    n: int,
    n_lines: int,
    method: str | None = None,
    regularise: str | float | None = None,
) -> bool:
    """Return whether a model is to be reduced.

    Parameters
    ----------
    tier : str or None
        The tier that is forced.
    n, n_lines : int
        Degrees of freedom and lines.
    method : str, optional
        Of the update.
    regularise : str or float, optional
        How it is regularised.

    Raises
    ------
    OptionError
        If the reduced tier is forced on a method that needs the exact one.
    """
    refused = ""
    if method is not None:
        refused = METHODS.find(method).needs_exact
    if tier == "reduced" and refused:
        raise OptionError(refused, key=("tier",))
    if tier is not None:
        return tier == "reduced"
    exact = bool(refused) or keeps_to_directions(regularise)
    return not exact and n > _DOFS and n_lines >= _LINES


def reduction_of(part: Part, accuracy: float, others: NDArray[np.intp] | None = None) -> Reduction:
    """Return the reduction of a part's model for its responses, references and band, not made yet.

    Parameters
    ----------
    part : Part
        With its whole model.
    accuracy : float
        Wanted: the error of a receptance as a share of the largest of its line.
    others : ndarray of int, optional
        Further DOFs whose motion counts in its error.
    """
    freq = part.frf.freq
    if others is None:
        others = np.zeros(0, dtype=np.intp)
    return Reduction(
        part.solver.system,
        part.rows,
        part.columns,
        (float(freq[0]), float(freq[-1])),
        part.solver.backend,
        accuracy,
        others,
        part.session.check,
    )


@dataclass(slots=True, eq=False)
class _Part:
    """The reduced models of one test."""

    exact: Part
    reduction: Reduction
    solver: FieldSolver | None = None
    first: FieldSolver | None = None
    certificate: Certificate | None = None
    lost: NDArray[np.float64] | None = None

    @classmethod
    def of(cls, part: Part, accuracy: float) -> _Part:
        others = part.solver.others(np.union1d(part.rows, part.columns))
        stride = max(1, -(-len(others) // _ELSEWHERE))
        reduction = reduction_of(part, accuracy, others[::stride])
        reduction.accuracy = min(accuracy, max(_FAINT * _faintest(part.frf), FINEST))
        return cls(part, reduction)

    def build(self, x: _Vector) -> None:
        state = self.exact.state(x)
        self.reduction.build(state)
        if self.reduction.basis.size > _LARGE:
            self.reduction.compress(state, self.exact.frf.freq)

    def build_around(self, points: Sequence[_Vector], samples: Sequence[_Vector]) -> None:
        first, *others = (self.exact.state(x) for x in points)
        self.reduction.build(first)
        self.reduction.extend(others)
        freq = self.exact.frf.freq
        states = [self.exact.state(x) for x in samples]
        self.lost = self.reduction.compress_around(states, freq, _DROPPED)
        self.solver = self.reduction.solver("reduced, around the start")

    def certify(self, x: _Vector, *, enrich: bool) -> None:
        self.certificate = self.reduction.certify(
            self.exact.state(x), self.exact.frf.freq, enrich=enrich
        )


@dataclass(slots=True, eq=False)
class Reducing:
    """The reduced models of a run, one for each test, renewed as the fit moves.

    Parameters
    ----------
    exact : Problem
        All data, and the whole model of each part.
    accuracy : float
        Wanted: the error of a receptance as a share of the largest of its line.

    Attributes
    ----------
    certified : bool
        Whether the latest certificate is that of the point where the fit ended.
    """

    exact: Problem
    accuracy: float
    certified: bool = field(default=False, init=False)
    _parts: list[_Part] = field(init=False)
    _x: _Vector = field(init=False)
    _reached: _Vector = field(init=False)
    _made: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self._parts = [_Part.of(part, self.accuracy) for part in self.exact.parts]

    @property
    def firsts(self) -> list[FieldSolver]:
        """The reduced model of each part at the start, once they are made."""
        return [part.first for part in self._parts if part.first is not None]

    @property
    def _home(self) -> _Vector:
        return self.exact.coordinates.home

    @property
    def error(self) -> float | None:
        """The largest error of the latest certificates."""
        return max((certificate.error for certificate in self._certificates), default=None)

    @property
    def _certificates(self) -> list[Certificate]:
        """The latest certificate of each part that has one."""
        return [part.certificate for part in self._parts if part.certificate is not None]

    def restart(self, exact: Problem) -> None:
        """Discard the reduced models, for the same problem with other starts."""
        self.exact = exact
        self.__post_init__()

    def begin(self) -> None:
        """Build the reduced models of the start.

        Raises
        ------
        SolverError
            If the model cannot be solved there.
        Stopped
            If the user wants to stop.
        """
        self._make(self._home)
        self._enrich(self._home, _AT_START)  # the figures of the start come from it
        for part in self._parts:
            part.first = part.solver

    def inside(self, problem: Problem) -> Problem:
        """Return a problem with the latest reduced models."""
        parts = []
        for part, made in zip(problem.parts, self._parts, strict=True):
            if made.solver is not None:
                parts.append(replace(part, solver=made.solver))
        return problem.with_parts(parts)

    def fit(
        self, problem: Problem, strategy: Method, noises: Sequence[NoiseModel], monitor: Monitor
    ) -> tuple[Problem, Fit]:
        """Fit from the start; else search in a basis of points around it, and fit where that ends.

        Parameters
        ----------
        problem : Problem
            From `inside`.
        strategy, noises, monitor
            As for `Method.fit`.

        Returns
        -------
        problem : Problem
            With the last reduced model.
        fit : Fit
            The last fit.
        """
        self._reached = self._home
        try:
            if self._may_search(strategy):
                self._reached = self._begun(problem, strategy, noises, monitor)
        except Stopped:
            return problem, Fit.blind(self._reached, "stopped")
        return self._rounds(problem, strategy, noises, monitor, self._reached)

    def _begun(
        self, problem: Problem, strategy: Method, noises: Sequence[NoiseModel], monitor: Monitor
    ) -> _Vector:
        """Return where a fit begins: where descents from the start settle, or a search ends.

        Nothing is searched for where a fault of the data is why they do not settle. The reduced
        models are those of that point.
        """
        with suppress(SolverError):
            x, is_settled = self._from_start(problem, noises, monitor)
            if is_settled or (not monitor.stopped and monitor.is_in_vain()):
                with monitor.stage("reduce"):
                    if not self._is_near(x):
                        self._make(x)
                    self._enrich(x)
                return x
        with monitor.stage("reduce"):
            around = self._around(problem)
        starts = strategy.search(around, self._rough(problem, noises), monitor)
        with monitor.stage("reduce"):
            return self._better(problem, noises, starts.points[0])

    def _from_start(
        self, problem: Problem, noises: Sequence[NoiseModel], monitor: Monitor
    ) -> tuple[_Vector, bool]:
        """Return where rounds from the start end, and whether the residual there is like noise.

        They go down by the log error, whose basin is the widest, and only as far as is worth it:
        where they end a fit begins.
        """
        few = coarse(self.inside(problem), noises)
        x, cost = self._home, _log_cost(few, self._home)
        is_answer = is_enriched = False
        for _ in range(_FIRST_ROUNDS):
            with monitor.stage("approach", few):
                boxed = few.with_box(self._box(_WIDER))
                outcome = descend(boxed, log_error(boxed), x, monitor, _DOWN)
            before, x, cost = cost, outcome.x, outcome.local.cost
            self._reached = x
            is_answer, is_near = _is_answer(few, noises, x, cost), self._is_near(x)
            has_ended = is_near and outcome.reason != "max-iterations"
            if is_near and is_answer:
                break
            is_stuck = cost > _LOWERED * before and (is_enriched or not has_ended)
            if outcome.reason == "stopped" or (is_stuck and not is_answer):
                return x, False
            with monitor.stage("reduce"):
                if has_ended:  # what the basis lacks is no noise either
                    self._enrich(x)
                elif not is_near:
                    self._make(x)
            is_enriched = has_ended
            few = coarse(self.inside(problem), noises)
        return x, is_answer

    @staticmethod
    def _may_search(strategy: Method) -> bool:
        """Whether the method searches."""
        inner = getattr(strategy, "method", strategy)  # the method that a regularised one wraps
        return bool(getattr(inner, "starts", 0))

    def _around(self, problem: Problem) -> Problem:
        """Return a problem with reduced models that hold roughly wherever a search may go."""
        factor = self.exact.coordinates.parameters.is_factor
        number = int(np.clip(2 * factor.sum(), *_POINTS))
        bounds = self.exact.coordinates.bounds
        lowest = np.where(factor, self._home - _AWAY, 0.0)
        highest = np.where(factor, self._home + _AWAY, _LOSSY)
        middle, half = 0.5 * (lowest + highest), 0.5 * (highest - lowest)
        points = np.clip(scattered(middle, half, number, seed=0), *bounds)
        samples = np.clip(scattered(middle, half, _SAMPLES, seed=1), *bounds)
        for part in self._parts:
            part.build_around([self._home, *points], [self._home, *samples])
        return self.inside(problem).thinned(_SEARCHED)

    def _rough(self, problem: Problem, noises: Sequence[NoiseModel]) -> list[NoiseModel]:
        """Return noise models that add what the basis of the search lacks in each channel."""
        out: list[NoiseModel] = []
        for made, part, noise in zip(self._parts, problem.parts, noises, strict=True):
            assert made.lost is not None
            own = made.exact.rows  # those of held-out responses are among them
            at = np.argsort(own)[np.searchsorted(own, part.rows, sorter=np.argsort(own))]
            out.append(Approximate(noise, _MARGIN * made.lost[at]))
        return out

    def _rounds(
        self,
        problem: Problem,
        strategy: Method,
        noises: Sequence[NoiseModel],
        monitor: Monitor,
        x: _Vector,
    ) -> tuple[Problem, Fit]:
        """Fit within a box about the point of the basis, renewed until it is certified."""
        near, left = False, strategy.max_iterations
        fit = Fit.blind(x, "stopped")
        is_ready = True  # the basis is that of x, or enriched there
        try:
            for _ in range(_ROUNDS):
                with monitor.stage("reduce"):
                    if not is_ready and not self._is_near(x):
                        self._make(x)
                    elif not is_ready:
                        self._enrich(x)
                problem, box = self.inside(problem), self._box()
                boxed = problem.with_box(box)
                before = len(monitor.history)
                steps = left
                if not near:
                    steps = min(left, _MAX_STEPS_PER_ROUND)
                fit = replace(strategy, max_iterations=steps).fit(boxed, noises, monitor, x)  # type: ignore[type-var]
                left = max(left - (len(monitor.history) - before), 0)
                near, x, is_ready = not _outside(fit.x, box), fit.x, False
                if fit.reason in ("stopped", "failed"):
                    break
                if left == 0 or (near and fit.reason != "max-iterations"):
                    with monitor.stage("reduce"):
                        if left == 0 or not self._is_near(x):
                            self._check(x)
                        else:  # one factorisation certifies the basis, or enriches it
                            is_ready = self._enrich_or_certify(x)
                    if self.certified or left == 0:
                        break
            else:
                with monitor.stage("reduce"):
                    self._check(x)
        except Stopped:  # the values are kept, without a certificate
            fit = replace(fit, reason="stopped")
        return problem, self._noted(fit)

    def _better(self, problem: Problem, noises: Sequence[NoiseModel], x: _Vector) -> _Vector:
        """Return where a search ended, or the start where its log error is smaller.

        Weighted by the noise, as the search is: the values of faint channels are rounding.
        """
        before = _log_cost(coarse(problem, noises), self._home)
        self._make(x)
        if _log_cost(coarse(self.inside(problem), noises), x) <= before:
            return x
        self._make(self._home)
        return self._home

    def _is_near(self, x: _Vector) -> bool:
        """Return whether the basis is better enriched at a point than made anew there."""
        size = max(part.exact.solver.system.n for part in self._parts)
        return not _outside(x, self._box(_NEAR if size <= _HEAVY else _NEAR_IF_HEAVY))

    def _box(self, share: float = 1.0) -> tuple[_Vector, _Vector]:
        """Return the box of the trust radius about the point of the basis."""
        factor = self.exact.coordinates.parameters.is_factor
        loss = np.maximum(_LOSS_RADIUS, 0.5 * np.abs(self._x))
        radius = share * np.where(factor, _TRUST_RADIUS, loss)
        return self._x - radius, self._x + radius

    def _noted(self, fit: Fit) -> Fit:
        error = self.error
        if error is None or self.certified or fit.reason in ("stopped", "failed"):
            return fit
        note = (
            "The reduced model could not be certified where the fit ended: its error there may be"
            f" {error:.1g} of the largest receptance of a line, not {self.accuracy:g}."
        )
        reason = fit.reason
        if reason == "converged":
            reason = "max-iterations"
        return replace(fit, reason=reason, note=f"{note} {fit.note}".strip())

    @property
    def record(self) -> dict[str, float | int | str]:
        """Record for the result; of several tests, sums and the largest error."""
        found = self._certificates
        if not found:
            return {"accuracy": self.accuracy}
        error: float | str = "not checked where the fit ended"
        channel = error
        if self.certified:
            error, channel = max(c.error for c in found), max(c.channel for c in found)
        used: Counter[str] = Counter()
        for part in self._parts:
            used.update(part.reduction.used)
        return {
            "accuracy": self.accuracy,
            "basis": sum(c.size for c in found),
            "error": error,
            "channel error": channel,
            "factorisations": sum(c.factorisations for c in found),
            **fallback(used, self._parts[0].reduction.backend),
        }

    def _make(self, x: _Vector) -> None:
        """Build reduced models at x, not certified."""
        for part in self._parts:
            part.build(x)
        self._use(x)

    def _enrich(self, x: _Vector, times: float = 1.0) -> None:
        """Add to the reduced models what they lack at x, of some times the error wanted."""
        for part in self._parts:
            state, accuracy = part.exact.state(x), times * part.reduction.accuracy
            part.reduction.settle(state, part.exact.frf.freq, accuracy=accuracy)
        self._use(x)

    def _enrich_or_certify(self, x: _Vector) -> bool:
        """Enrich the bases at x and return True, or certify them where they lack nothing."""
        grown = False
        for part in self._parts:
            before = part.reduction.basis.size
            part.certify(x, enrich=True)
            grown = grown or part.reduction.basis.size != before
        if grown:
            self._use(x)
            return True
        error = self.error
        self.certified = error is not None and error <= self.accuracy
        return False

    def _use(self, x: _Vector) -> None:
        self._made += 1
        self._x, self.certified = x, False
        for part in self._parts:
            part.solver = part.reduction.solver(f"reduced {self._made}")

    def _check(self, x: _Vector) -> None:
        for part in self._parts:
            part.certify(x, enrich=False)
        error = self.error
        self.certified = error is not None and error <= self.accuracy


def fallback(used: Mapping[str, int], backend: str) -> dict[str, str]:
    """Return the record of solves by another backend than the chosen one; empty without any.

    Parameters
    ----------
    used : mapping of str to int
        Solves by backend.
    backend : str
        The one that was chosen.
    """
    others = [f"{name} {number}" for name, number in used.items() if name != backend]
    if not others:
        return {}
    return {"fallback": f"{', '.join(others)} of {sum(used.values())} solves"}


def _faintest(frf: FRF) -> float:
    """Return the level of the faintest channel over the loudest one's, rounding left out."""
    share = shares_of(frf.values, frf)
    return float(share[share > FINEST].min(initial=1.0))


def _is_answer(problem: Problem, noises: Sequence[NoiseModel], x: _Vector, cost: float) -> bool:
    """Whether the residual at x looks like noise; where modes are data, no."""
    belief = Belief(problem, all(noise.size_known for noise in noises))
    return not problem.modal and belief.is_answer(x, cost)


def _log_cost(problem: Problem, x: _Vector) -> float:
    local = log_error(problem).local(problem, x)
    if local is None:
        return np.inf
    return local.cost


def _outside(x: _Vector, box: tuple[_Vector, _Vector]) -> bool:
    """Whether a point lies outside a box, or on its boundary."""
    margin = 1e-6 * (box[1] - box[0])
    return bool(((x <= box[0] + margin) | (x >= box[1] - margin)).any())
