"""Fit in a reduced model whose error is certified at the estimate.

The fit stays within a trust radius of the point of the basis, where values and gradients are those
of the full model. At its end the full residual certifies the basis; if that fails, the fit
continues in a new basis. The basis of the start has local minima that the full model lacks, so a
search is made in a basis of the start and of points around it (benchmarks/solids.py), unless a fit
from the start leaves a residual like noise. Other answers are searched for around the certified one
in its basis, enriched with the factorisation of the answer only.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from updyn.arrays import IndexArray, RealArray
from updyn.dynamics.basis import Basis
from updyn.dynamics.certificate import Certificate
from updyn.dynamics.fields import TIERS, FieldSolver
from updyn.dynamics.kept_basis import KeptBasis
from updyn.dynamics.reduction import Reduction
from updyn.errors import OptionError, SolverError, suggest
from updyn.frf import FRF, TRANSMISSIBILITY
from updyn.linalg.solver import Factorised
from updyn.model import Model
from updyn.updating.fit.acceptance import Acceptance
from updyn.updating.fit.answer import Answer
from updyn.updating.fit.answers import (
    are_distinct,
    choose_answer,
    distance,
    find_rivals,
    is_same,
    is_within_uncertainty,
    select_as_likely,
)
from updyn.updating.fit.equivalent import find_equivalent_start
from updyn.updating.fit.method import Fit, Method, Rival, descend
from updyn.updating.fit.methods import METHODS
from updyn.updating.fit.models import Models
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.regularisation import keeps_to_directions
from updyn.updating.fit.search import scatter_points, thin_problem
from updyn.updating.fit.settings import (
    ANSWERS,
    FURTHER_ANSWERS,
    REDUCED_ANSWERS,
    REDUCED_FIT,
    REDUCED_TIER,
    SEARCH_BASIS,
)
from updyn.updating.fit.trust_region import TrustRegion
from updyn.updating.fit.valley import fix_in_box
from updyn.updating.problem.noise import Approximate, NoiseModel
from updyn.updating.problem.problem import FRFPart, Problem, relative_levels
from updyn.updating.problem.residuals import make_log_error
from updyn.updating.problem.session import Stopped

__all__ = ["Reducing", "are_modes_reduced", "is_reduced", "make_reduction", "record_fallback"]


def is_reduced(
    tier: str | None,
    n: int,
    n_lines: int,
    method: str | None = None,
    regularise: str | float | None = None,
) -> bool:
    """Return whether a model with n DOFs is to be reduced; OptionError for an invalid tier."""
    if tier is not None and tier not in TIERS:
        raise OptionError(f"tier {tier!r}: {suggest(str(tier), TIERS)}", key=("tier",))
    refused = ""
    if method is not None:
        refused = METHODS.find(method).needs_exact
    if tier == "reduced" and refused:
        raise OptionError(refused, key=("tier",))
    if tier is not None:
        return tier == "reduced"
    exact = bool(refused) or keeps_to_directions(regularise)
    return not exact and n > REDUCED_TIER.most_exact_dofs and n_lines >= REDUCED_TIER.least_lines


def are_modes_reduced(tier: str | None, n: int) -> bool:
    """Return whether a model with n DOFs is to be reduced for its modes; OptionError if invalid."""
    if tier is not None and tier not in TIERS:
        raise OptionError(f"tier {tier!r}: {suggest(str(tier), TIERS)}", key=("tier",))
    return tier == "reduced" or (tier is None and n > REDUCED_TIER.most_exact_dofs_of_modes)


def make_reduction(part: FRFPart, accuracy: float, others: IndexArray | None = None) -> Reduction:
    """Return the reduction of a part's model for its responses, references and band, not yet built.

    `accuracy` is the accepted error of a receptance, relative to the largest of its line; the
    motion of `others`, further DOFs, counts too.
    """
    freq = part.solved_lines
    if others is None:
        others = np.zeros(0, dtype=np.intp)
    return Reduction(
        part.solver.system,
        *part.receptance_dofs,
        (float(freq[0]), float(freq[-1])),
        part.solver.backend,
        accuracy,
        others,
        part.session.check,
    )


@dataclass(slots=True, eq=False)
class _Part:
    """Reduced models of one test."""

    exact: FRFPart
    reduction: Reduction
    solver: FieldSolver | None = None
    first: FieldSolver | None = None
    certificate: Certificate | None = None
    lost: RealArray | None = None

    @classmethod
    def of(cls, part: FRFPart, accuracy: float, *, keeps: bool) -> _Part:
        others = part.solver.other_dofs(np.union1d(*part.receptance_dofs))
        stride = max(1, -(-len(others) // REDUCED_TIER.most_other_dofs))
        reduction = make_reduction(part, accuracy, others[::stride])
        allowed = min(accuracy, REDUCED_TIER.faintest_share * _faintest_level(part.frf))
        if part.frf.quantity == TRANSMISSIBILITY:  # a ratio multiplies the error of a receptance
            allowed /= max(1.0, float(np.abs(part.frf.values).max()))
        reduction.accuracy = min(accuracy, max(allowed, REDUCED_TIER.finest_error))
        reduction.shifted.keeps = keeps
        return cls(part, reduction)

    def build(self, x: RealArray) -> None:
        state = self.exact.state(x)
        self.reduction.build(state)
        if self.reduction.basis.size > REDUCED_FIT.most_vectors:
            self.reduction.compress(state, self.exact.solved_lines)

    def build_around(self, points: Sequence[RealArray], samples: Sequence[RealArray]) -> None:
        first, *others = (self.exact.state(x) for x in points)
        self.reduction.build(first)
        self.reduction.extend(others)
        freq = self.exact.solved_lines
        states = [self.exact.state(x) for x in samples]
        self.lost = self.reduction.compress_around(states, freq, SEARCH_BASIS.dropped_energy)
        self.solver = self.reduction.solver("reduced, around the start")

    def certify(self, x: RealArray) -> None:
        state, freq = self.exact.state(x), self.exact.solved_lines
        self.certificate = self.reduction.certify(state, freq, enrich=False)

    def certify_or_enrich(self, x: RealArray) -> bool:
        """Certify the basis at x and return True, or enrich it there and return False."""
        state, freq = self.exact.state(x), self.exact.solved_lines
        self.certificate = self.reduction.certify_or_enrich(state, freq)
        return self.certificate is not None


@dataclass(frozen=True, slots=True, eq=False)
class _Certified:
    """Fit whose reduced models are certified at its end, the point `place`."""

    problem: Problem
    fit: Fit
    answer: Answer
    place: RealArray
    certificates: Sequence[Certificate | None]
    bases: Sequence[Basis]


@dataclass(slots=True, eq=False)
class Reducing:
    """Reduced models of a run, one for each test, renewed as the fit moves.

    `accuracy` is the accepted error of a receptance, relative to the largest of its line.
    `certified`: the latest certificate belongs to the point where the fit ended.
    """

    exact: Problem
    accuracy: float
    certified: bool = field(default=False, init=False)
    _parts: list[_Part] = field(init=False)
    _x: RealArray = field(init=False)
    _latest_x: RealArray = field(init=False)
    _search_ends: Sequence[RealArray] = field(default=(), init=False)
    _n_built: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        # With several tests, the factorisations of all would be in memory at once.
        keeps = len(self.exact.parts) == 1
        self._parts = [_Part.of(part, self.accuracy, keeps=keeps) for part in self.exact.parts]

    @property
    def start_solvers(self) -> list[FieldSolver]:
        """Reduced models of the parts at the start, as far as they are built."""
        return [part.first for part in self._parts if part.first is not None]

    @property
    def _home(self) -> RealArray:
        return self.exact.coordinates.start

    @property
    def error(self) -> float | None:
        """Largest error of the latest certificates; None without certificates."""
        return max((certificate.error for certificate in self._certificates), default=None)

    @property
    def _certificates(self) -> list[Certificate]:
        return [part.certificate for part in self._parts if part.certificate is not None]

    def restart(self, exact: Problem) -> None:
        """Discard the reduced models and continue with the same problem from another start."""
        self.exact = exact
        self.__post_init__()

    def begin(self) -> None:
        """Build the reduced models at the start, where the model must be solvable."""
        self._build(self._home)
        self._enrich(self._home, REDUCED_TIER.start_error_ratio)  # serves the figures of the start
        for part in self._parts:
            part.first = part.solver

    def with_reduced_models(self, problem: Problem) -> Problem:
        """Return the problem with the latest reduced models."""
        parts = []
        for part, reduced in zip(problem.parts, self._parts, strict=True):
            if reduced.solver is not None:
                parts.append(part.with_solver(reduced.solver))
        return problem.with_parts(parts)

    def fit(
        self, problem: Problem, strategy: Method, noises: Sequence[NoiseModel], monitor: Monitor
    ) -> tuple[Problem, Fit]:
        """Fit from the start, or from the end of a search; return the last reduced models too.

        `problem` is that of `with_reduced_models`.
        """
        self._latest_x = self._home
        try:
            if not problem.is_linear:
                self._latest_x = self._find_equivalent_start(problem, strategy, noises, monitor)
            elif self._may_search(strategy):
                self._latest_x = self._find_start(problem, strategy, noises, monitor)
        except Stopped:
            return problem, Fit.without_jacobian(self._latest_x, "stopped")
        problem, fit = self._fit_in_rounds(problem, strategy, noises, monitor, self._latest_x)
        if not (self.certified and problem.is_linear) or fit.reason in ("stopped", "failed"):
            return problem, fit
        return self._search_other_answers(problem, strategy, noises, monitor, fit)

    def _find_start(
        self, problem: Problem, strategy: Method, noises: Sequence[NoiseModel], monitor: Monitor
    ) -> RealArray:
        """Return the point from which to fit, with its models: the end of descents or a search."""
        # No search is made if a fault of the data explains why the descents do not settle.
        with suppress(SolverError):
            x, is_settled = self._descend_from_start(problem, noises, monitor)
            if is_settled or (not monitor.stopped and monitor.has_data_fault()):
                with monitor.stage("reduce"):
                    if not self._is_near(x):
                        self._build(x)
                    self._enrich(x)
                return x
        with monitor.stage("reduce"):
            around = self._build_around_start(problem)
        starts = strategy.search(around, self._add_basis_error(problem, noises), monitor)
        self._search_ends = starts.points[1:]
        with monitor.stage("reduce"):
            return self._choose_start(problem, noises, starts.points[0])

    def _find_equivalent_start(
        self, problem: Problem, strategy: Method, noises: Sequence[NoiseModel], monitor: Monitor
    ) -> RealArray:
        """Return the point from which to fit nonlinear elements, with its models."""
        with monitor.stage("reduce"):
            around = self._build_around_start(problem)
        noises = self._add_basis_error(problem, noises)
        starts = find_equivalent_start(around, strategy, noises, monitor)
        with monitor.stage("reduce"):
            self._build(starts.points[0])
        return starts.points[0]

    def _descend_from_start(
        self, problem: Problem, noises: Sequence[NoiseModel], monitor: Monitor
    ) -> tuple[RealArray, bool]:
        """Return the end of rounds from the start, and whether its residual looks like noise."""
        # The rounds minimise the log error, which has the widest basin of attraction.
        few = thin_problem(self.with_reduced_models(problem), noises)
        x, cost = self._home, _log_error_cost(few, self._home)
        is_answer = is_enriched = False
        settings = TrustRegion(
            REDUCED_FIT.steps_per_round, 1e-9, radius=0.3, min_relative_decrease=1e-3
        )
        for _ in range(REDUCED_FIT.most_rounds):
            with monitor.stage("approach", few):
                boxed = few.with_box(self._box(REDUCED_FIT.wider_ratio))
                outcome = descend(boxed, make_log_error(boxed), x, monitor, settings)
            before, x, cost = cost, outcome.x, outcome.local.cost
            self._latest_x = x
            is_answer, is_near = _is_answer(few, noises, x, cost), self._is_near(x)
            has_ended = is_near and outcome.reason != "max-iterations"
            if is_near and is_answer:
                break
            is_stuck = cost > REDUCED_FIT.slow_decrease * before and (is_enriched or not has_ended)
            if outcome.reason == "stopped" or (is_stuck and not is_answer):
                return x, False
            with monitor.stage("reduce"):
                if has_ended:  # the error of the basis is not noise either
                    self._enrich(x)
                elif not is_near:
                    self._build(x)
            is_enriched = has_ended
            few = thin_problem(self.with_reduced_models(problem), noises)
        return x, is_answer

    @staticmethod
    def _may_search(strategy: Method) -> bool:
        inner = getattr(strategy, "method", strategy)  # the method inside a regularised one
        return bool(getattr(inner, "starts", 0))

    def _build_around_start(self, problem: Problem) -> Problem:
        """Return the problem with models that hold roughly in the whole region of a search."""
        factor = ~self.exact.coordinates.parameters.is_damping
        number = int(np.clip(2 * factor.sum(), SEARCH_BASIS.least_points, SEARCH_BASIS.most_points))
        bounds = self.exact.coordinates.bounds
        lowest = np.where(factor, self._home - ANSWERS.log_spread, 0.0)
        highest = np.where(factor, self._home + ANSWERS.log_spread, ANSWERS.loss_spread)
        middle, half = 0.5 * (lowest + highest), 0.5 * (highest - lowest)
        points = np.clip(scatter_points(middle, half, number, seed=0), *bounds)
        samples = np.clip(scatter_points(middle, half, SEARCH_BASIS.samples, seed=1), *bounds)
        for part in self._parts:
            part.build_around([self._home, *points], [self._home, *samples])
        return self.with_reduced_models(problem).thin(SEARCH_BASIS.most_lines)

    def _add_basis_error(self, problem: Problem, noises: Sequence[NoiseModel]) -> list[NoiseModel]:
        """Return noise models that include the error of the search basis in each channel."""
        out: list[NoiseModel] = []
        for reduced, part, noise in zip(self._parts, problem.parts, noises, strict=True):
            assert reduced.lost is not None
            rows = reduced.exact.rows  # includes held-out responses
            at = np.argsort(rows)[np.searchsorted(rows, part.rows, sorter=np.argsort(rows))]
            lost = reduced.exact.channel_errors(reduced.lost)[at]
            out.append(Approximate(noise, SEARCH_BASIS.error_ratio * lost))
        return out

    def _fit_in_rounds(
        self,
        problem: Problem,
        strategy: Method,
        noises: Sequence[NoiseModel],
        monitor: Monitor,
        x: RealArray,
        fixed_unknown: int | None = None,
    ) -> tuple[Problem, Fit]:
        """Fit within a box about the point of the basis, renewed until the basis is certified."""
        near, remaining = False, strategy.max_iterations
        fit = Fit.without_jacobian(x, "stopped")
        is_ready = True  # the basis was built or enriched at x
        try:
            for number in range(REDUCED_FIT.most_rounds):
                with monitor.stage("reduce"):
                    if not is_ready and number < REDUCED_FIT.most_built and not self._is_near(x):
                        self._build(x)
                    elif not is_ready:
                        self._enrich(x)
                share = REDUCED_FIT.radius_growth ** max(number + 1 - REDUCED_FIT.most_built, 0)
                problem, box = self.with_reduced_models(problem), self._box(share)
                boxed = problem.with_box(
                    box if fixed_unknown is None else fix_in_box(box, x, fixed_unknown)
                )
                before = len(monitor.history)
                steps = remaining
                if not near:
                    steps = min(remaining, REDUCED_FIT.steps_per_round)
                fit = replace(strategy, max_iterations=steps).fit(boxed, noises, monitor, x)  # type: ignore[type-var]
                remaining = max(remaining - (len(monitor.history) - before), 0)
                near, x, is_ready = not _is_outside(fit.x, box), fit.x, False
                if fit.reason in ("stopped", "failed"):
                    break
                if remaining == 0 or (near and fit.reason != "max-iterations"):
                    with monitor.stage("reduce"):
                        if remaining == 0 or not self._is_near(x):
                            self._certify(x)
                        else:  # one factorisation certifies or enriches the basis
                            is_ready = self._enrich_or_certify(x)
                    if self.certified or remaining == 0:
                        break
            else:
                with monitor.stage("reduce"):
                    self._certify(x)
        except Stopped:  # keep the values, without a certificate
            fit = replace(fit, reason="stopped")
        return problem, self._add_note(fit)

    def _search_other_answers(
        self,
        problem: Problem,
        strategy: Method,
        noises: Sequence[NoiseModel],
        monitor: Monitor,
        fit: Fit,
    ) -> tuple[Problem, Fit]:
        """Search for other answers that fit equally well; return the preferred, with rivals."""
        chosen = self._certify_answer(problem, strategy, noises, fit)
        if chosen is None:
            return problem, fit
        known, rivals = [chosen], list[_Certified]()
        with suppress(Stopped):
            for _ in range(FURTHER_ANSWERS.most_searches):
                known += self._fit_candidates(chosen, known, strategy, noises, monitor)
                before, best = (
                    chosen.answer,
                    choose_answer(problem, _select_answers(known, with_fixed_unknown=False)),
                )
                ends = select_as_likely(best, _select_answers(known, with_fixed_unknown=True))
                as_well = [
                    *find_rivals(best, _select_answers(known, with_fixed_unknown=False)),
                    *ends,
                ]
                (chosen,) = (one for one in known if one.answer is best)
                rivals = [one for one in known if any(one.answer is answer for answer in as_well)]
                if not are_distinct(best, before):
                    break
        self._restore(chosen)
        worse = [
            one.answer.negative_log_likelihood - chosen.answer.negative_log_likelihood
            for one in rivals
        ]
        found = [Rival(r.answer.x, w, r.problem) for r, w in zip(rivals, worse, strict=True)]
        reason = "stopped" if monitor.stopped else chosen.fit.reason
        return chosen.problem, replace(chosen.fit, reason=reason, rivals=tuple(found))

    def _fit_candidates(
        self,
        chosen: _Certified,
        known: Sequence[_Certified],
        strategy: Method,
        noises: Sequence[NoiseModel],
        monitor: Monitor,
    ) -> list[_Certified]:
        """Return further certified answers, found around `chosen`."""
        found: list[_Certified] = []
        with suppress(SolverError):
            with monitor.stage("reduce"):
                if self._x is not chosen.place:
                    self._restore(chosen)
            models = _ReducedModels.of(self, chosen)
            for point in strategy.find_candidates(
                models, noises, monitor, chosen.answer, self._search_ends
            ):
                if monitor.stopped:
                    break
                if any(is_same(point, one.answer) for one in [*known, *found]):
                    continue
                with monitor.stage("reduce"):
                    self._build(point.x)
                about = chosen.problem, strategy, noises, monitor, point.x, point.fixed_unknown
                problem, fit = self._fit_in_rounds(*about)
                one = self._certify_answer(
                    problem, strategy, noises, fit, point.fixed_unknown, chosen.answer
                )
                found += [] if one is None else [one]
        return found

    def _certify_answer(
        self,
        problem: Problem,
        strategy: Method,
        noises: Sequence[NoiseModel],
        fit: Fit,
        fixed_unknown: int | None = None,
        valley_start: Answer | None = None,
    ) -> _Certified | None:
        if not self.certified or fit.reason in ("stopped", "failed"):
            return None
        if fixed_unknown is None:
            valley_start = None
        answer = strategy.evaluate_answer(problem, noises, fit.x, fixed_unknown, valley_start)
        if answer is None:
            return None
        certificates = [part.certificate for part in self._parts]
        bases = [part.reduction.basis for part in self._parts]
        bases = [basis.take_leading(basis.size) for basis in bases]
        return _Certified(problem, fit, answer, self._x, certificates, bases)

    def _restore(self, one: _Certified) -> None:
        self._x, self.certified = one.place, True
        for part, solved, certificate, basis in zip(
            self._parts, one.problem.parts, one.certificates, one.bases, strict=True
        ):
            part.solver, part.certificate = solved.solver, certificate
            part.reduction.basis = basis.take_leading(basis.size)

    def kept_basis(self, i: int, model: Model) -> KeptBasis | None:
        """Return the basis of part `i` at the end of the fit; None if not certified."""
        if not self.certified:
            return None
        return KeptBasis.of(model, self._parts[i].reduction)

    def _choose_start(
        self, problem: Problem, noises: Sequence[NoiseModel], x: RealArray
    ) -> RealArray:
        """Return the end of a search, or the start if its log error is smaller."""
        # The log error is weighted with the noise: values of faint channels are rounding.
        before = _log_error_cost(thin_problem(problem, noises), self._home)
        self._build(x)
        if _log_error_cost(thin_problem(self.with_reduced_models(problem), noises), x) <= before:
            return x
        self._build(self._home)
        return self._home

    def _is_near(self, x: RealArray) -> bool:
        """Return whether the basis should be enriched at x rather than built anew there."""
        size = max(part.exact.solver.system.n for part in self._parts)
        share = REDUCED_FIT.enriched_share
        if size > REDUCED_FIT.heavy_dofs:
            share = REDUCED_FIT.enriched_share_if_heavy
        return not _is_outside(x, self._box(share))

    def _box(
        self, share: float = 1.0, place: RealArray | None = None
    ) -> tuple[RealArray, RealArray]:
        """Return the box of the trust radius about a point, by default that of the basis."""
        x = self._x if place is None else place
        factor = ~self.exact.coordinates.parameters.is_damping
        radius = share * np.where(
            factor, REDUCED_FIT.radius, np.maximum(REDUCED_FIT.loss_radius, 0.5 * np.abs(x))
        )
        return x - radius, x + radius

    def _add_note(self, fit: Fit) -> Fit:
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

    def certify_at(self, x: RealArray) -> bool:
        """Certify the current models at a new end of the fit; on failure, keep the certificates."""
        before = [part.certificate for part in self._parts]
        self._certify(x)
        if self.certified:
            return True
        for part, certificate in zip(self._parts, before, strict=True):
            part.certificate = certificate
        self.certified = True
        return False

    def release(self) -> None:
        """Release the memory of the factorisations when no fit follows."""
        for part in self._parts:
            part.reduction.shifted.release()

    @property
    def record(self) -> dict[str, float | int | str]:
        """Record for the result; with several tests, sums and largest errors."""
        found = self._certificates
        if not found:
            return {"accuracy": self.accuracy}
        error: float | str = "not checked where the fit ended"
        channel = error
        if self.certified:
            error, channel = max(c.error for c in found), max(c.channel for c in found)
        used: Counter[str] = Counter()
        for part in self._parts:
            used.update(part.reduction.shifted.solve_counts)
        return {
            "accuracy": self.accuracy,
            "basis": sum(c.size for c in found),
            "error": error,
            "channel error": channel,
            "factorisations": sum(part.reduction.shifted.count for part in self._parts),
            **record_fallback(used, self._parts[0].reduction.backend),
        }

    def _build(self, x: RealArray) -> None:
        """Build reduced models at x without certifying them."""
        for part in self._parts:
            part.build(x)
        self._set_place(x)

    def _enrich(self, x: RealArray, times: float = 1.0) -> None:
        """Enrich the reduced models at x, to `times` the accepted error."""
        for part in self._parts:
            state, accuracy = part.exact.state(x), times * part.reduction.accuracy
            part.reduction.enrich_until_accurate(
                [state], part.exact.solved_lines, accuracy=accuracy
            )
        self._set_place(x)

    def _enrich_or_certify(self, x: RealArray) -> bool:
        """Enrich the bases at x and return True; if complete, certify them and return False."""
        hold = [part.certify_or_enrich(x) for part in self._parts]
        if not all(hold):
            self._set_place(x)
            return True
        error = self.error
        self.certified = error is not None and error <= self.accuracy
        return False

    def _set_place(self, x: RealArray) -> None:
        self._x, self.certified = x, False
        self.renew()

    def renew(self) -> None:
        """Create solvers of the current bases."""
        self._n_built += 1
        for part in self._parts:
            part.solver = part.reduction.solver(f"reduced {self._n_built}")

    def is_outside(self, x: RealArray, share: float) -> bool:
        """Return whether a point is beyond a share of the trust radius."""
        return _is_outside(x, self._box(share))

    def are_near(self, x: RealArray, place: RealArray) -> bool:
        """Return whether a basis that is accurate at `place` is accurate at x, too."""
        return not _is_outside(x, self._box(REDUCED_FIT.enriched_share, place))

    def _certify(self, x: RealArray) -> None:
        for part in self._parts:
            part.certify(x)
        error = self.error
        self.certified = error is not None and error <= self.accuracy


@dataclass(slots=True, eq=False)
class _ReducedModels(Models):
    """Reduced models around an answer, enriched where other answers are searched for."""

    latest: Problem
    _reducing: Reducing
    _definite: Sequence[Factorised]
    _sizes: Sequence[int]
    _places: list[RealArray] = field(default_factory=list)
    _passes: list[int] = field(default_factory=list)

    only_ranks: ClassVar[bool] = True

    @classmethod
    def of(cls, reducing: Reducing, about: _Certified) -> _ReducedModels:
        """Return the models around a certified fit whose bases are in use."""
        parts = reducing._parts
        whole = [
            replace(part, solver=made.exact.solver)
            for part, made in zip(about.problem.parts, parts, strict=True)
        ]
        definite = [
            p.reduction.shifted.factor_definite(p.exact.state(about.answer.x)) for p in parts
        ]
        sizes = [part.reduction.basis.size for part in parts]
        exact, latest = about.problem.with_parts(whole), reducing.with_reduced_models(about.problem)
        return cls(exact, latest, reducing, definite, sizes)

    @property
    def rough(self) -> Problem:
        return self.latest

    def near(self, x: RealArray) -> Problem:
        """Return the problem with models enriched at x, further with each call for a point."""
        if not self._reducing.is_outside(x, REDUCED_ANSWERS.covered_share):
            return self.latest
        indices = (i for i, place in enumerate(self._places) if self._reducing.are_near(x, place))
        i = next(indices, len(self._places))
        if i == len(self._places):
            self._places.append(x)
            self._passes.append(0)
        if self._passes[i] < REDUCED_ANSWERS.most_passes:
            number = self._passes[i]
            is_enriched = self._is_enriched(x, number)
            self._passes[i] = number + 1 if is_enriched else REDUCED_ANSWERS.most_passes
        return self.latest

    def is_rough(self, x: RealArray) -> bool:
        """Return whether a point is outside the trust radius."""
        return self._reducing.is_outside(x, 1.0)

    def is_known(self, x: RealArray, answer: Answer) -> bool:
        """Return whether a point lies within the uncertainty of an answer."""
        return is_within_uncertainty(x, answer)

    def leads_back(self, x: RealArray, answer: Answer, negative_log_likelihood: float) -> bool:
        """Return whether the misfit at a point is that of an answer's quadratic model."""
        # The misfit then falls along the path to the answer, and no other minimum is near.
        rise = negative_log_likelihood - answer.negative_log_likelihood
        return rise > REDUCED_ANSWERS.quadratic_share * 0.5 * distance(answer, x) ** 2

    def _is_enriched(self, x: RealArray, number: int) -> bool:
        """Enrich the bases at x, after a reset of oversized ones; return whether they grew."""
        made = list(zip(self._reducing._parts, self._definite, self._sizes, strict=True))
        most_added = REDUCED_ANSWERS.most_added
        if any(part.reduction.basis.size > size + most_added for part, _, size in made):
            self._passes = [0] * len(self._passes)
            for part, _, size in made:
                part.reduction.basis = part.reduction.basis.take_leading(size)
        grown = []
        for (part, definite, _), part_latest in zip(made, self.latest.parts, strict=True):
            state, level = (
                part.exact.state(x),
                np.linalg.norm(part_latest.responses(x), axis=(1, 2)),
            )
            accuracy = REDUCED_ANSWERS.error_ratio * part.reduction.accuracy
            about = state, part_latest.frf.freq, level, number, accuracy
            grown.append(part.reduction.enrich_with_nearby_factor(definite, *about))
        if any(grown):
            self._reducing.renew()
            self.latest = self._reducing.with_reduced_models(self.latest)
        return any(grown)


def _select_answers(known: Sequence[_Certified], *, with_fixed_unknown: bool) -> list[Answer]:
    return [
        one.answer for one in known if (one.answer.fixed_unknown is not None) == with_fixed_unknown
    ]


def record_fallback(used: Mapping[str, int], backend: str) -> dict[str, str]:
    """Return the record of solves by backends other than the chosen one; empty without any."""
    others = [f"{name} {number}" for name, number in used.items() if name != backend]
    if not others:
        return {}
    return {"fallback": f"{', '.join(others)} of {sum(used.values())} solves"}


def _faintest_level(frf: FRF) -> float:
    """Return the ratio of the faintest channel's level to the loudest one's, without rounding."""
    share = relative_levels(frf.values, frf)
    return float(share[share > REDUCED_TIER.finest_error].min(initial=1.0))


def _is_answer(problem: Problem, noises: Sequence[NoiseModel], x: RealArray, cost: float) -> bool:
    """Return whether the residual at x looks like noise; False if modes are among the data."""
    acceptance = Acceptance(problem, all(noise.size_known for noise in noises))
    return not problem.modal and acceptance.is_answer(x, cost)


def _log_error_cost(problem: Problem, x: RealArray) -> float:
    local = make_log_error(problem).local(problem, x)
    if local is None:
        return np.inf
    return local.cost


def _is_outside(x: RealArray, box: tuple[RealArray, RealArray]) -> bool:
    """Return whether a point lies outside a box or on its boundary."""
    margin = 1e-6 * (box[1] - box[0])
    return bool(((x <= box[0] + margin) | (x >= box[1] - margin)).any())
