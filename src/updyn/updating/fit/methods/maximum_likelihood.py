"""The default method: log error to find the basin, maximum likelihood to finish."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, ClassVar

import numpy as np

from updyn.arrays import RealArray
from updyn.correlation.modes import BY_FREQUENCY
from updyn.errors import SolverError
from updyn.modal.settings import MODE_DERIVATIVE
from updyn.updating.fit.answer import Answer
from updyn.updating.fit.answers import (
    are_distinct,
    choose_answer,
    find_promising_points,
    find_rivals,
    has_noise_residual,
    is_better,
    move_uncertain_unknowns,
    reset_far_unknowns,
    restart_uncertain_unknowns,
    select_as_likely,
)
from updyn.updating.fit.method import (
    Fit,
    Method,
    Rival,
    Starts,
    descend,
    divide_by_std,
    make_stopped_fit,
    record_correlation_length,
)
from updyn.updating.fit.methods.searching import SearchingMethod
from updyn.updating.fit.methods.settings import FURTHER_DESCENTS, GLOBAL_SEARCH, MAXIMUM_LIKELIHOOD
from updyn.updating.fit.models import Models
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.search import scatter_points, thin_problem
from updyn.updating.fit.settings import ACCEPTANCE, ANSWERS, FURTHER_ANSWERS, TRY_STARTS
from updyn.updating.fit.trust_region import TrustRegion
from updyn.updating.fit.valley import find_valleys, fix_unknown
from updyn.updating.problem.local import Local, join_locals
from updyn.updating.problem.modal import ModalError
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.noise.settings import NOISE_LIMITS
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import OutputError, OutputErrorSet, add_prior
from updyn.updating.problem.session import Stopped

__all__ = ["MaximumLikelihood"]


_UNSETTLED_CAUSE = (
    "The weights of the noise and the estimate do not converge together: the misfit is so large"
    " that each set of weights has another minimum."
)
#: Plural names of the kinds of modal residuals.
_KIND_PLURALS = {
    "frequency": "frequencies",
    "shape": "shapes",
    "loss_factor": "loss factors",
}


def _unit_std(local: Local) -> float:
    """Return 1, the standard deviation of residuals that are weighted with the noise."""
    return 1.0


@dataclass(frozen=True, slots=True)
class MaximumLikelihood(SearchingMethod):
    """Output error weighted by the noise, r = (H_A - H_X) / sigma, after a search by log error.

    Weights are those of the model, not of the noisy data, renewed after every descent until the
    estimate moves by less than a hundredth of its standard deviation (iteratively reweighted least
    squares; Green, J. R. Stat. Soc. B 46 (1984) 149).
    """

    name: ClassVar[str] = "maximum-likelihood"
    label: ClassVar[str] = "fit weighted with the noise"
    reference: ClassVar[str] = "Pintelon & Schoukens 2012; Green 1984"
    calibrates: ClassVar[bool] = True
    can_regularise: ClassVar[bool] = True
    is_likelihood: ClassVar[bool] = True
    fits_modes: ClassVar[bool] = True
    states_noise: ClassVar[bool] = True

    def search(self, problem: Problem, noises: Sequence[NoiseModel], monitor: Monitor) -> Starts:
        """Return the best basins of the log error; with modes only, the unknowns' start."""
        if not self.starts or not problem.parts:
            return Method.search(self, problem, noises, monitor)
        rough = thin_problem(problem, noises)
        with monitor.stage("search", rough):
            return self.tries.run(rough, noises, monitor)

    def fit(
        self, problem: Problem, noises: Sequence[NoiseModel], monitor: Monitor, x: RealArray
    ) -> Fit:
        """Fit the unknowns from x, weighted by the noise."""
        with monitor.stage(self.name):
            answer = self._fit_answer(problem, noises, x, monitor)
            return self._finish_fit(problem, noises, answer)

    def fit_best(
        self,
        problem: Problem,
        noises: Sequence[NoiseModel],
        monitor: Monitor,
        starts: Starts,
    ) -> Fit:
        """Fit the unknowns from all starts, and search for other answers that fit equally well."""
        if not self.starts or starts.data_fault:
            return self.fit(problem, noises, monitor, starts.points[0])
        first, *others = starts.points
        models = Models(problem)
        with monitor.stage(self.name):
            answers = [self._fit_answer(problem, noises, first, monitor)]
            answers += self._fit_promising(models, noises, others, monitor, answers[0])
            chosen = choose_answer(problem, answers)
            if self._has_data_fault(problem, monitor, chosen):
                return self._finish_fit(problem, noises, chosen)
        fitted = max(len(monitor.history), FURTHER_DESCENTS.least_limit)
        if problem.parts and not starts.exact:  # no better answer exists
            answers += self._search_nearby(problem, noises, monitor, chosen, starts.agreed)
        chosen = choose_answer(problem, answers)
        ends: list[Answer] = []
        with monitor.stage("other answers"):
            if not problem.parts:  # tries cover all unknowns: one pass suffices
                answers += self._search_globally(models, noises, monitor, chosen, fitted)
                chosen = choose_answer(problem, answers)
            for _ in range(FURTHER_ANSWERS.most_searches if problem.parts else 0):
                others = self._find_starting_points(models, monitor, chosen)
                answers += self._fit_promising(models, noises, others, monitor, chosen)
                before, chosen = chosen, choose_answer(problem, answers)
                if not are_distinct(chosen, before):
                    break
            most = None if problem.parts else fitted
            for _ in range(FURTHER_ANSWERS.most_searches):
                ends, reached = self._follow_valleys(models, noises, monitor, chosen, most)
                answers += reached
                before, chosen = chosen, choose_answer(problem, answers)
                if not are_distinct(chosen, before):
                    break
        with monitor.stage(self.name):
            fit = self._finish_fit(problem, noises, chosen)
        # Ends of valleys of an earlier answer may be too unlikely compared with a better one.
        as_well = [*find_rivals(chosen, answers), *select_as_likely(chosen, ends)]
        rivals = [
            Rival(a.x, a.negative_log_likelihood - chosen.negative_log_likelihood) for a in as_well
        ]
        if monitor.stopped:
            return replace(fit, reason="stopped", rivals=tuple(rivals))
        settled = (
            self.starts < MAXIMUM_LIKELIHOOD.agreement_tries
            or starts.agreed
            or self._has_noise_residual(problem, chosen)
        )
        if fit.reason == "converged" and not settled:
            return replace(fit, reason="unsettled", rivals=tuple(rivals))
        return replace(fit, rivals=tuple(rivals))

    def evaluate_answer(
        self,
        problem: Problem,
        noises: Sequence[NoiseModel],
        x: RealArray,
        fixed_unknown: int | None = None,
        valley_start: Answer | None = None,
    ) -> Answer | None:
        """Return the answer at the end of a fit; None if this method makes no search."""
        if not self.starts:
            return None
        known, residual = _weigh(problem, noises, x)
        local = residual.local(problem, x)
        if local is None:
            return None
        misfit = _negative_log_likelihood(problem, known, residual, x)
        answer = Answer(x, "", misfit, known, residual, add_prior(local, problem, x), fixed_unknown)
        if valley_start is None:
            return answer
        start_weighted = valley_start.residual.local(problem, x)
        assert start_weighted is not None
        return _limit_likelihood(answer, valley_start, add_prior(start_weighted, problem, x))

    def find_candidates(
        self,
        models: Models,
        noises: Sequence[NoiseModel],
        monitor: Monitor,
        at: Answer,
        points: Sequence[RealArray],
    ) -> list[Answer]:
        """Return candidates for other answers that fit equally well, ends of valleys last."""
        if self._has_data_fault(models.rough, monitor, at):
            return []
        # At most as many steps as the fit took, if each costs more than a step of the fit.
        limit = max(len(monitor.history), FURTHER_DESCENTS.least_limit)
        most = limit if models.only_ranks else None
        with monitor.stage("other answers"):
            points = [*points, *self._find_starting_points(models, monitor, at)]
            found = self._fit_promising(models, noises, points, monitor, at, most)
            ends, reached = self._follow_valleys(models, noises, monitor, at, most)
        return [*find_rivals(at, [*found, *reached], FURTHER_DESCENTS.fitted_log_odds), *ends]

    def _search_nearby(
        self,
        problem: Problem,
        noises: Sequence[NoiseModel],
        monitor: Monitor,
        best: Answer,
        agreed: bool,
    ) -> list[Answer]:
        """Return the answers of tries near the best one, until some of them return to it."""
        # They also end after a fixed number without a better answer and, if the search agreed on
        # the best one, as soon as it explains the data.
        if monitor.stopped:
            return []
        rough, found = thin_problem(problem, noises), list[Answer]()
        back = last = 0
        explained = self._has_noise_residual(problem, best)
        for number in range(FURTHER_DESCENTS.most_nearby_tries):
            if monitor.stopped or number - last == TRY_STARTS.nearby_ratio * self.starts:
                break
            enough = ACCEPTANCE.tries_if_noise if explained else ACCEPTANCE.tries_if_not_noise
            if back >= enough or (explained and agreed):
                break
            x = None
            with monitor.stage("search", rough), suppress(Stopped):
                x = self.tries.try_nearby(rough, best.x, number, monitor)
            if x is None:
                continue
            with monitor.stage(self.name):
                near = self._fit_promising(Models(problem), noises, [x], monitor, best)
            found += near
            for answer in near:
                gained = best.negative_log_likelihood - answer.negative_log_likelihood
                if gained > FURTHER_DESCENTS.same_log_odds:  # the search did not agree on this one
                    back, last, agreed = 0, number + 1, False
                elif gained > -FURTHER_DESCENTS.same_log_odds:
                    back += 1
                if gained > 0.0:
                    best, explained = answer, self._has_noise_residual(problem, answer)
        return found

    def _search_globally(
        self,
        models: Models,
        noises: Sequence[NoiseModel],
        monitor: Monitor,
        first: Answer,
        most: int,
    ) -> list[Answer]:
        """Return the answers of tries from the whole space of the unknowns, for modes only."""
        # If n tries have found w answers, the expected number of answers is w (n - 1) / (n - w -
        # 2); tries end when that is less than w + 1/2 (Boender & Rinnooy Kan, Math. Program. 37
        # (1987) 59-80). All tries are made if the numbers do not exceed the unknowns, as with
        # frequencies alone: several answers are then usual (isospectral systems; Gladwell, Inverse
        # Problems in Vibration, 2nd ed. 2004). In a large model, no try begins after `most` steps.
        # Much less likely answers do not count.
        problem, coordinates = models.exact, models.exact.coordinates
        best, found, ends = first, [first], [first.negative_log_likelihood]
        n_before = len(monitor.history)
        overdetermined = problem.n_numbers > problem.n
        settings = self._further_descent(min(FURTHER_DESCENTS.most_steps, self.max_iterations))
        far = np.where(
            ~coordinates.parameters.is_damping, GLOBAL_SEARCH.log_distance, ANSWERS.loss_spread
        )
        for start in scatter_points(
            coordinates.start, far, GLOBAL_SEARCH.tries_ratio * self.starts, self.seed
        ):
            limit = best.negative_log_likelihood + FURTHER_DESCENTS.fitted_log_odds
            agreed = sum(end <= limit for end in ends)
            number = len(select_as_likely(best, found, FURTHER_DESCENTS.fitted_log_odds))
            enough = overdetermined and agreed > 2 * number**2 + 3 * number + 2
            exhausted = (
                problem.system.n > MODE_DERIVATIVE.most_decomposed_dofs
                and len(monitor.history) - n_before >= most
            )
            if enough or exhausted or monitor.stopped:
                break
            with suppress(Stopped, SolverError):
                x = np.clip(start, *coordinates.bounds)
                _, x = _descend_with_weights(models, x, monitor, settings, best)
                misfit = _negative_log_likelihood(problem, *_weigh(problem, noises, x), x)
                ends.append(misfit)
                if misfit > limit:
                    continue
                if not any(models.is_known(x, answer) for answer in found):
                    answer = self._fit_answer(problem, noises, x, monitor)
                    same = [i for i, other in enumerate(found) if not are_distinct(answer, other)]
                    if not same:
                        found.append(answer)
                    elif is_better(answer, found[same[0]]):
                        found[same[0]] = answer
                    if is_better(answer, best):
                        best = answer
        return [answer for answer in found if answer is not first]

    def _further_descent(self, most_steps: int) -> TrustRegion:
        """Return the settings of a descent that shows whether a point is worth a fit."""
        return TrustRegion(
            most_steps, self.tolerance, min_decrease=FURTHER_DESCENTS.negligible_decrease
        )

    @classmethod
    def _has_data_fault(cls, problem: Problem, monitor: Monitor, answer: Answer) -> bool:
        """Return whether a residual is larger than noise because of a fault of the data."""
        if monitor.stopped or cls._has_noise_residual(problem, answer):
            return False
        with suppress(Stopped):
            return monitor.has_data_fault()
        return False

    @staticmethod
    def _has_noise_residual(problem: Problem, answer: Answer) -> bool:
        with suppress(Stopped):
            return has_noise_residual(problem, answer)
        return True

    def _find_starting_points(
        self, models: Models, monitor: Monitor, at: Answer
    ) -> list[RealArray]:
        """Return points away from an answer from which other answers may be reached."""
        if monitor.stopped:
            return []

        def negative_log_likelihood(x: RealArray) -> float:
            try:
                return _evaluate_point(models, x, at)
            except SolverError:
                return np.inf

        problem = models.exact
        points: list[RealArray] = []
        with suppress(Stopped):
            most = 2 * len(monitor.history)  # no more work than the fit took
            further = find_promising_points(models, at, negative_log_likelihood, most)
            loose = restart_uncertain_unknowns(problem, at, self.seed)
            # The most promising first: points that fit fairly well before any descent.
            for x in chain(
                further,
                loose,
                move_uncertain_unknowns(problem, at),
                reset_far_unknowns(problem, at),
            ):
                if not any(np.array_equal(x, point) for point in points):
                    points.append(x)
        return points

    def _fit_promising(
        self,
        models: Models,
        noises: Sequence[NoiseModel],
        points: Sequence[RealArray],
        monitor: Monitor,
        at: Answer,
        most: int | None = None,
    ) -> list[Answer]:
        """Return the answers from points whose first descent ends near the known likelihood."""
        # The first descent uses the weights of the known answer and ends early.
        found: list[Answer] = []
        n_before = len(monitor.history)
        settings = self._further_descent(min(FURTHER_DESCENTS.most_steps, self.max_iterations))
        for x in points:
            if monitor.stopped or (most is not None and len(monitor.history) - n_before >= most):
                break
            with suppress(Stopped, SolverError):
                problem, x = _descend_with_weights(models, x, monitor, settings, at)
                misfit = _negative_log_likelihood(problem, *_weigh(problem, noises, x), x)
                if (
                    models.is_known(x, at)
                    and misfit >= at.negative_log_likelihood - ANSWERS.equal_log_odds
                ):
                    continue
                if misfit <= at.negative_log_likelihood + FURTHER_DESCENTS.fitted_log_odds:
                    found.append(self._fit_answer(problem, noises, x, monitor))
        return found

    def _follow_valleys(
        self,
        models: Models,
        noises: Sequence[NoiseModel],
        monitor: Monitor,
        at: Answer,
        most: int | None = None,
    ) -> tuple[list[Answer], list[Answer]]:
        """Return the far ends of open valleys, and the answers reached from there."""
        if at.local is None:
            return [], []
        settings = self._further_descent(FURTHER_DESCENTS.valley_steps)

        def refit(x: RealArray, fixed_unknown: int) -> Answer | None:
            with suppress(SolverError):
                problem, x = _descend_with_weights(models, x, monitor, settings, at, fixed_unknown)
                known, residual = _weigh(problem, noises, x)
                misfit = _negative_log_likelihood(problem, known, residual, x)
                local = at.residual.local(problem, x)
                assert local is not None
                local = add_prior(local, problem, x)
                return _limit_likelihood(
                    Answer(x, "held", misfit, known, residual, local, fixed_unknown), at, local
                )
            return None

        ends, reached = list[Answer](), list[Answer]()
        n_before = len(monitor.history)
        most = max(n_before, FURTHER_DESCENTS.least_limit) if most is None else most
        with suppress(Stopped):
            for valley in find_valleys(models.exact, at):
                if monitor.stopped or len(monitor.history) - n_before >= most:
                    break
                if any(valley.is_covered(end.x) for end in ends):
                    continue
                end = valley.find_end(refit)
                if end is not None:
                    ends.append(end)
                    reached += self._fit_promising(models, noises, [end.x], monitor, at)
        return ends, reached

    def _fit_answer(
        self,
        problem: Problem,
        noises: Sequence[NoiseModel],
        x: RealArray,
        monitor: Monitor,
    ) -> Answer:
        """Return the end of the descent from x, with weights renewed until it no longer moves."""
        remaining, reason, length = self.max_iterations, "converged", 0.0
        residual, local = OutputErrorSet(()), None
        try:
            for number in range(MAXIMUM_LIKELIHOOD.weight_rounds):
                noises, residual = _weigh(problem, noises, x)
                assumed = number == 0 and bool(problem.modal)
                if assumed:  # residuals far from the answer do not show the modal noise
                    modal = tuple(ModalError(part.noise) for part in problem.modal)
                    residual = replace(residual, modal=modal)
                if monitor.stopped or remaining <= 0:
                    reason = "stopped" if monitor.stopped else "max-iterations"
                    break
                before = len(monitor.history)
                settings = TrustRegion(
                    remaining,
                    self.tolerance,
                    min_decrease=MAXIMUM_LIKELIHOOD.negligible_decrease,
                    noise=_unit_std,
                )
                outcome = descend(problem, residual, x, monitor, settings, relax=number == 0)
                remaining -= len(monitor.history) - before
                moved, x, reason, local = outcome.x - x, outcome.x, outcome.reason, outcome.local
                if reason in ("stopped", "max-iterations"):
                    break
                length = float(np.linalg.norm(local.R @ moved))
                if assumed:
                    continue
                is_settled = number > 0 and length < MAXIMUM_LIKELIHOOD.settled_stds
                if is_settled or np.abs(moved).max() <= self.tolerance:
                    break
            else:
                if length > MAXIMUM_LIKELIHOOD.unsettled_stds:
                    reason = "unsettled"
            misfit = _negative_log_likelihood(problem, noises, residual, x)
            return Answer(x, reason, misfit, noises, residual, local)
        except Stopped:
            return Answer(x, "stopped", np.inf, noises, residual, local)

    def _finish_fit(self, problem: Problem, noises: Sequence[NoiseModel], answer: Answer) -> Fit:
        if answer.residual.errors or answer.residual.modal:
            with suppress(Stopped):
                fit = self._make_fit(
                    problem, answer.x, answer.noises, answer.residual, answer.reason
                )
                return replace(fit, cause=_UNSETTLED_CAUSE if fit.reason == "unsettled" else "")
        return make_stopped_fit(
            thin_problem(problem, noises), answer.x
        )  # from values that the search cached

    def _make_fit(
        self,
        problem: Problem,
        x: RealArray,
        noises: Sequence[NoiseModel],
        residual: OutputErrorSet,
        reason: str,
    ) -> Fit:
        residual = replace(residual, modal=_refit_modes(problem, residual.without_modes, x))
        found = [
            _information_of_frfs(problem, x, noises, residual),
            _information_of_modes(problem, x, residual),
        ]
        local = residual.local(problem, x)
        assert local is not None
        whitened = join_locals([known.local for known in found if known is not None], problem.n)
        records = [record for known in found if known is not None for record in known.records]
        records = _with_common_freedom(problem, records)
        modal = "" if found[1] is None else found[1].note
        return Fit(
            x,
            reason,
            whitened.R,
            tuple(records),
            modal,
            local=local,
        )


def _descend_with_weights(
    models: Models,
    x: RealArray,
    monitor: Monitor,
    settings: TrustRegion,
    at: Answer,
    fixed_unknown: int | None = None,
) -> tuple[Problem, RealArray]:
    """Return the end of a descent with the weights of answer `at`, and the model there."""
    # If the model is accurate only near the start, the descent continues in the model of its end,
    # unless it has returned to the answer or its misfit is far larger.
    problem, worse, remaining = models.near(x), np.inf, settings.max_iterations
    for _ in range(FURTHER_DESCENTS.most_renewals):
        constrained = problem if fixed_unknown is None else fix_unknown(problem, x, fixed_unknown)
        n_before = len(monitor.history)
        some = replace(settings, max_iterations=remaining)
        x = descend(constrained, at.residual, x, monitor, some, relax=fixed_unknown is None).x
        remaining -= len(monitor.history) - n_before
        before, problem = problem, models.near(x)
        if problem is before or remaining <= 0 or monitor.stopped or models.is_known(x, at):
            break
        last, worse = (
            worse,
            _negative_log_likelihood(problem, at.noises, at.residual, x)
            - at.negative_log_likelihood,
        )
        if worse > max(
            FURTHER_DESCENTS.falling_ratio * last, problem.n_numbers / 2, FURTHER_ANSWERS.fair_rise
        ):
            break
    return problem, x


def _evaluate_point(models: Models, x: RealArray, at: Answer) -> float:
    """Return minus the log-likelihood at a point; inf if a descent leads back to the answer."""
    # The model is refined only while that improves the likelihood of the point.
    problem = models.rough
    misfit, is_rough = (
        _negative_log_likelihood(problem, at.noises, at.residual, x),
        models.is_rough(x),
    )
    while is_rough:
        before, last, problem = problem, misfit, models.near(x)
        misfit = _negative_log_likelihood(problem, at.noises, at.residual, x)
        is_rough = (
            problem is not before
            and misfit - at.negative_log_likelihood
            <= FURTHER_DESCENTS.falling_ratio * (last - at.negative_log_likelihood)
        )
    return np.inf if models.leads_back(x, at, misfit) else misfit


def _limit_likelihood(answer: Answer, valley_start: Answer, local: Local) -> Answer:
    """Limit the likelihood of a valley's far end by that with the weights of its beginning."""
    # The beginning is a minimum with its own weights only. `local`, at the far end, has these
    # weights.
    assert valley_start.local is not None
    least = valley_start.negative_log_likelihood + local.cost - valley_start.local.cost
    return replace(answer, negative_log_likelihood=max(answer.negative_log_likelihood, least))


@dataclass(frozen=True, slots=True, eq=False)
class _Information:
    """Information on the unknowns from data of one kind, in standard deviations of the residual."""

    local: Local
    records: Sequence[Mapping[str, Any]]
    note: str = ""


def _information_of_frfs(
    problem: Problem, x: RealArray, noises: Sequence[NoiseModel], residual: OutputErrorSet
) -> _Information | None:
    if not problem.parts:
        return None
    local = residual.without_modes.local(problem.without_modes, x)
    assert local is not None
    freedom = 2 * problem.n_values - problem.n
    # The noise can be estimated from the misfit only with degrees of freedom.
    chi_square = 2.0 * local.cost / freedom if freedom > 0 else 1.0
    known = record_correlation_length(
        problem, x, lambda i, H: residual.of(i).weight * (H - problem.parts[i].frf.values)
    )
    length = known.get("correlation_length", 1.0)
    # A misfit larger than the noise widens the confidence intervals; a smaller one narrows them
    # only if the scale of the noise was not known. A serially correlated misfit holds less
    # information than independent noise.
    scale = max(chi_square, 1.0) if all(noise.scale_known for noise in noises) else chi_square
    inflation = float(np.sqrt(scale * length))
    record = {
        **({"chi_square": chi_square} if freedom > 0 else {}),
        **known,
        "inflation": inflation,
    }
    by_part = [{"kind": noise.kind, **record, **noise.figures()} for noise in noises]
    return _Information(divide_by_std(local, inflation), by_part)


def _information_of_modes(
    problem: Problem, x: RealArray, residual: OutputErrorSet
) -> _Information | None:
    if not problem.modal:
        return None
    locals_, records, missing = [], [], []
    for part, error in zip(problem.modal, residual.modal, strict=True):
        squares, number = error.power(part, x)
        spare = number * (1.0 - problem.n / problem.n_numbers)  # less its share of unknowns
        chi_square = squares / spare if spare > 0.0 else 1.0
        stated = error.noise.size_known
        inflation = float(np.sqrt(max(chi_square, 1.0))) if stated else 1.0
        locals_.append(divide_by_std(error.local(part, x), inflation))
        rows = error.rows(part, x)
        record: dict[str, Any] = {
            "kind": error.noise.kind,
            "chi_square": chi_square,
            "inflation": inflation,
            **error.noise.figures(rows),
            "modes": len(rows.mac) - len(rows.unpaired_modes(part.least_mac)),
            **part.record_unpaired(rows),
        }
        missing += [record["left_out"]] if "left_out" in record else []
        if error.noise.by_ratio:
            record["by_ratio"] = list(error.noise.by_ratio)
        if error.noise.degrees_of_freedom is not None:
            record["degrees_of_freedom"] = error.noise.degrees_of_freedom
        records.append(record)
    note = _modal_note(records, missing)
    if not all(part.target.has_shapes for part in problem.modal):
        note = f"{BY_FREQUENCY} {note}".rstrip()
    return _Information(join_locals(locals_, problem.n), records, note)


def _with_common_freedom(
    problem: Problem, records: Sequence[Mapping[str, object]]
) -> list[Mapping[str, object]]:
    """Return the noise records with the same degrees of freedom, those of the intervals."""
    # These are 1 / sum s^2 / nu, with s the share of a test in the data (Satterthwaite, Biometrics
    # Bull. 2 (1946) 110).
    if len(records) < 2:
        return list(records)
    name = "degrees_of_freedom"
    sizes = [2 * part.n_values for part in problem.parts]
    sizes += [part.n_numbers for part in problem.modal]
    shares = np.array(sizes) / sum(sizes)
    few = [s**2 / record[name] for s, record in zip(shares, records, strict=True) if name in record]
    freedom = round(1.0 / sum(few)) if few else NOISE_LIMITS.many_freedoms
    if freedom >= NOISE_LIMITS.many_freedoms:
        return [{k: v for k, v in record.items() if k != name} for record in records]
    return [{**record, name: freedom} for record in records]


def _modal_note(records: Sequence[Mapping[str, Any]], missing: Sequence[str]) -> str:
    """Return the note for the user on omitted modes and on their noise."""
    notes = []
    if missing:
        names = ", ".join(missing)
        notes.append(f"Measured modes that resemble no mode of the model are omitted: {names}.")
    kinds = dict.fromkeys(kind for record in records for kind in record.get("by_ratio", ()))
    if kinds:
        *others, last = [_KIND_PLURALS[kind] for kind in kinds]
        named = f"{', '.join(others)} and {last}" if others else last
        notes.append(
            f"State the accuracy of {named} (noise): too few residuals to estimate it, so the"
            " usual values are assumed."
        )
    return " ".join(notes)


def _negative_log_likelihood(
    problem: Problem, noises: Sequence[NoiseModel], residual: OutputErrorSet, x: RealArray
) -> float:
    """Return minus the log-likelihood of the data and the priors at x, except for a constant."""
    total = 0.0
    for part, noise in zip(problem.parts, noises, strict=True):
        total += noise.negative_log_likelihood(part.responses(x), part.frf)
    for modal, error in zip(problem.modal, residual.modal, strict=True):
        total += error.negative_log_likelihood(modal, x)
    centre, weight = problem.coordinates.prior
    return total + 0.5 * float(np.sum((weight * (x - centre)) ** 2))


def _weigh(
    problem: Problem, noises: Sequence[NoiseModel], x: RealArray
) -> tuple[Sequence[NoiseModel], OutputErrorSet]:
    """Return the noise models refitted to the residual at x, and the residual weighted by them."""
    fitted, errors = [], []
    for part, noise in zip(problem.parts, noises, strict=True):
        H = part.responses(x)
        # The degrees of freedom of each part are reduced by its share of the unknowns.
        fitted.append(noise.refit(H, part.frf, problem.share(part)))
        errors.append(
            OutputError(np.sqrt(2.0 / fitted[-1].variance(H, part.frf)), "maximum-likelihood")
        )
    of_frfs = OutputErrorSet(tuple(errors))
    return fitted, replace(of_frfs, modal=_weigh_modes(problem, x))


def _weigh_modes(problem: Problem, x: RealArray) -> tuple[ModalError, ...]:
    """Return the modal residuals, weighted by the known and estimated noise."""
    found = [ModalError(part.noise) for part in problem.modal]
    return tuple(
        ModalError(part.noise.estimate_for_weights(error.rows(part, x)))
        for part, error in zip(problem.modal, found, strict=True)
    )


def _refit_modes(problem: Problem, of_frfs: OutputErrorSet, x: RealArray) -> tuple[ModalError, ...]:
    """Return the modal residuals weighted by standard deviations estimated after the fit."""
    found = [ModalError(part.noise) for part in problem.modal]
    if all(error.noise.size_known for error in found):
        return tuple(found)
    rest = [np.diag(problem.coordinates.prior[1])]
    if problem.parts:
        local = of_frfs.local(problem.without_modes, x)
        if local is None:
            raise SolverError("the model cannot be solved where its noise is estimated")
        rest.append(local.R)
    for i, part in enumerate(problem.modal):
        others = [
            error.local(one, x).R
            for one, error in zip(problem.modal, found, strict=True)
            if one is not part
        ]
        noise = part.noise.refit(found[i].rows(part, x), np.vstack([*rest, *others]))
        found[i] = ModalError(noise)
    return tuple(found)
