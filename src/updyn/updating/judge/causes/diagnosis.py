"""Search for the faults that explain a misfit, from model, data and unknowns."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.errors import SolverError
from updyn.frf import FRF
from updyn.linalg.threads import use_one_thread
from updyn.updating.judge.causes.candidates import FaultStart, has_small_residual, select_candidates
from updyn.updating.judge.causes.data_alone import (
    detect_data_faults,
    drop_expected,
    drop_explained_symptoms,
    make_finding,
    mask_symptoms,
    with_variance,
)
from updyn.updating.judge.causes.evidence import Evidence, compute_spread
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.finding import Finding, make_fault_finding
from updyn.updating.judge.causes.halves import compare_band_halves
from updyn.updating.judge.causes.misfit import (
    WeightedData,
    compute_log_misfit,
    find_weightless,
    remove_weight,
)
from updyn.updating.judge.causes.model_unit import ModelUnit
from updyn.updating.judge.causes.other_model import CompiledVariant
from updyn.updating.judge.causes.promising import list_variants
from updyn.updating.judge.causes.ranking import (
    RankedFault,
    is_as_likely,
    is_in_reach,
    is_worth_reporting,
    rank_faults,
)
from updyn.updating.judge.causes.reduced import TrialModels, choose_trial_models
from updyn.updating.judge.causes.rigid_shapes import RigidShapes
from updyn.updating.judge.causes.settings import CAUSE_CANDIDATES, CAUSE_ODDS, CAUSE_SEARCH
from updyn.updating.judge.causes.shown import Detection
from updyn.updating.judge.causes.trial import (
    Trial,
    adapt_losses,
    free_held_quantities,
    limit_correlation,
    raise_loss_factors,
    run_trial,
)
from updyn.updating.judge.causes.wrong_axes import WrongAxes
from updyn.updating.judge.settings import SIGNIFICANCE
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import FRFPart

__all__ = [
    "Diagnosis",
    "count_search_lines",
    "find_causes",
    "find_obstacle",
    "is_far_from_start",
    "weight_by_noise",
]


def is_far_from_start(part: FRFPart, x: RealArray) -> bool:
    """Return whether the unknowns moved farther from their start than models are usually off."""
    # The data may then be explained and still be wrong by a common factor.
    coordinates = part.coordinates
    offset = ((x - coordinates.start) / compute_spread(part))[~coordinates.parameters.is_damping]
    return bool(offset.size and np.sqrt(np.mean(offset**2)) > CAUSE_ODDS.usual_distance)


def find_obstacle(part: FRFPart, noise: NoiseModel) -> str:
    """Return why the data of a test do not permit a search for causes; empty if they do."""
    # Without values above the noise, any factor that moves the data below it explains everything.
    if part.n_lines < CAUSE_SEARCH.least_lines:
        return f"causes were not searched for, because {part.n_lines} lines are too few"
    clear = np.abs(part.frf.values) > SIGNIFICANCE.stds * np.sqrt(noise.initial_variance(part.frf))
    n_clear = int(clear.any(axis=(1, 2)).sum())
    if n_clear < CAUSE_SEARCH.least_lines:
        lines = f"{part.n_lines - n_clear} of {part.n_lines} lines"
        return f"causes were not searched for, because no value is above the noise at {lines}"
    return ""


def count_search_lines(frf: FRF) -> int:
    """Return the number of lines of the search, fewer with many channels."""
    affordable = CAUSE_SEARCH.most_values // (len(frf.responses) * len(frf.references))
    return max(CAUSE_SEARCH.fewest_lines, min(CAUSE_SEARCH.lines, affordable))


def find_causes(part: FRFPart, noise: NoiseModel) -> list[Finding]:
    """Return the faults of one test, from the start of the unknowns; see `Diagnosis`."""
    return Diagnosis(part, noise).find_causes()


@dataclass(slots=True, eq=False)
class Diagnosis:
    """Search for the faults of one test: those visible in the data alone, then the others by odds.

    With insufficient data (`find_obstacle`), only the former are found.
    """

    part: FRFPart
    noise: NoiseModel
    _searched: _SearchedPart | None = field(default=None, init=False)
    _findings: list[Finding] | None = field(default=None, init=False)

    def find_causes(self, points: Sequence[RealArray] = ()) -> list[Finding]:
        """Return the findings; `points` are ends of fits, in addition to the start.

        Earlier findings are returned unless a fit from the points is likelier than from the start.
        """
        if self._searched is None:
            self._searched = _SearchedPart.of(self.part, self.noise)
        if self._findings is None or self._searched.is_fitted_better(points):
            self._findings = self._searched.find_causes(self.noise, points)
        return self._findings


@dataclass(frozen=True, slots=True, eq=False)
class _SearchedPart:
    """The part of a test with the lines of the search, its models, and what its data show alone.

    `trial_models` is None with insufficient data.
    """

    part: FRFPart
    whole: FRFPart
    held: RealArray
    trial_models: TrialModels | None
    rigid: RigidShapes | None
    detections: list[Detection]

    @classmethod
    def of(cls, part: FRFPart, noise: NoiseModel) -> _SearchedPart:
        frf = with_variance(part.frf, noise)
        rigid = RigidShapes.of(part)
        detections = drop_expected(detect_data_faults(frf, rigid), part)
        for one in detections:
            if one.fault.repair_text:
                frf = one.fault.repair(frf)
        whole = part.with_data(frf)
        if find_obstacle(whole, noise):
            return cls(part, whole, np.zeros(0), None, rigid, detections)
        thin, held = free_held_quantities(whole.thin(count_search_lines(whole.frf)))
        return cls(thin, whole, held, choose_trial_models(thin), rigid, detections)

    def is_fitted_better(self, points: Sequence[RealArray]) -> bool:
        """Return whether a fit from one of the points, without a fault, is the likeliest."""
        if self.trial_models is None or not points:
            return False
        known, home = self._complete(points), self.part.coordinates.start
        current = self.trial_models.prepare_part(self.part, [home, *known])
        usual = run_trial(current, None, [raise_loss_factors(current, home)])
        other = run_trial(current, None, known)
        if usual is None or other is None:
            return usual is not other
        return other.gain(usual) > CAUSE_ODDS.likely_log_odds

    def _complete(self, points: Sequence[RealArray]) -> list[RealArray]:
        """Return points with the start of the held quantities."""
        return [np.concatenate([x, self.held]) for x in points]

    def find_causes(self, noise: NoiseModel, points: Sequence[RealArray]) -> list[Finding]:
        """Return the findings from the start and from further points."""
        part, whole, detections = self.part, self.whole, self.detections
        stated = [make_finding(one, part.name) for one in detections]
        if self.trial_models is None:
            return stated
        about = self.trial_models, self._complete(points), stated, noise
        explained = _explain_data(part, whole, *about)
        masked = mask_symptoms(detections, part.frf)
        remaining = explained.fit_remaining(part.frf)
        is_open = remaining is None or remaining.mean_square > CAUSE_SEARCH.explained_mean_square
        if is_open and explained.findings and masked is not part.frf:
            # The values of a symptom may be wrong on their own, and other faults may imitate them.
            masked_whole = whole.with_data(mask_symptoms(detections, whole.frf))
            by_itself = _explain_data(part.with_data(masked), masked_whole, *about)
            fit_apart = by_itself.fit_remaining(masked)
            if fit_apart:
                limit = CAUSE_SEARCH.symptom_ratio * fit_apart.mean_square
                if explained.fit_mean_square(masked) > limit:
                    explained, remaining = by_itself, fit_apart
        gross = CAUSE_SEARCH.gross_rms**2
        if remaining and explained.mean_square_above_noise(masked, remaining) > gross:
            # Model and data differ too much for the likeliest fault to be meaningful.
            return stated + _try_other_units(part, remaining)
        reported = drop_explained_symptoms(detections, whole.frf, explained.findings, self.rigid)
        return [make_finding(one, part.name) for one in reported] + list(explained.findings)


@dataclass(frozen=True, slots=True, eq=False)
class _Explanation:
    """Findings, the corrected part, its models, and the end of the fit (None without a finding).

    `without` is the fit from the start without a finding; None with a finding or another start.
    """

    findings: tuple[Finding, ...]
    part: FRFPart
    trial_models: TrialModels
    end: RealArray | None
    without: Trial | None

    def fit_remaining(self, frf: FRF) -> Trial | None:
        """Return a fit to the corrected data with the weights of `frf`; None without a solution."""
        if self.without is not None and frf is self.part.frf:
            return self.without
        part = self.part.with_data(_restrict_weights(self.part.frf, frf))
        start = raise_loss_factors(part, part.coordinates.start) if self.end is None else self.end
        return run_trial(self.trial_models.prepare_part(part, [start]), None, [start])

    def mean_square_above_noise(self, frf: FRF, trial: Trial) -> float:
        """Return the mean square residual of the values above the noise."""
        # A fault that raises the noise of one sensor, or the level of all data, hides the others.
        part = self.part.with_data(_restrict_weights(self.part.frf, frf))
        part = self.trial_models.prepare_part(part, [trial.x])
        misfit, weight = compute_log_misfit(part.responses(trial.x), part.frf)
        total_weight = max(float(np.sum(weight**2)), np.finfo(float).tiny)
        return float(np.sum(np.abs(misfit) ** 2)) / total_weight

    def fit_mean_square(self, frf: FRF) -> float:
        """Return the mean square residual of the fit with the weights of `frf`."""
        trial = self.fit_remaining(frf)
        return np.inf if trial is None else trial.mean_square


def _restrict_weights(corrected: FRF, frf: FRF) -> FRF:
    """Return corrected data in which only the values with weight in `frf` have weight."""
    # Their variance is that of the corrected values: the noise of a sensor of another quantity is
    # scaled with its values.
    assert corrected.variance is not None
    assert frf.variance is not None
    is_weightless = find_weightless(frf) | find_weightless(corrected)
    return replace(corrected, variance=np.where(is_weightless, frf.variance, corrected.variance))


def _try_other_units(part: FRFPart, without: Trial) -> list[Finding]:
    """Return the unit in which the model explains data with which it has nothing in common."""
    if part.solver.system.n > CAUSE_SEARCH.largest_model:
        return []
    start = raise_loss_factors(part, part.coordinates.start)
    first: list[tuple[float, ModelUnit]] = []
    for fault in ModelUnit.list_mistakes():
        converted = part.with_data(fault.convert_data(part.frf)).thin(CAUSE_SEARCH.glance_lines)
        with suppress(SolverError):
            misfit = compute_log_misfit(converted.responses(start), converted.frf)[0]
            first.append((float(np.mean(np.abs(misfit) ** 2)), fault))
    first.sort(key=lambda one: one[0])
    ends: list[tuple[Trial, ModelUnit]] = []
    for _, fault in first[: CAUSE_SEARCH.most_units]:
        converted = part.with_data(fault.convert_data(part.frf))
        with suppress(SolverError):
            prepared = choose_trial_models(converted).prepare_part(converted, [start])
            trial = run_trial(prepared, None, [start])
            if trial is not None and trial.mean_square < CAUSE_SEARCH.gross_rms**2:
                ends.append((trial, fault))
    if not ends:
        return []
    trial, fault = min(ends, key=lambda one: one[0].mean_square)
    log_odds = trial.gain(without) + float(np.log(fault.odds))
    share = 1.0 - trial.mean_square / without.mean_square
    return [_make_ranked_finding([RankedFault(trial, fault, log_odds, share, share)], part.name)]


def _explain_data(
    part: FRFPart,
    whole: FRFPart,
    trial_models: TrialModels,
    points: Sequence[RealArray],
    stated: Sequence[Finding],
    noise: NoiseModel,
) -> _Explanation:
    """Return the faults that model and data show together; their sizes are fitted to all lines."""
    findings: list[Finding] = []
    end: RealArray | None = None
    without: Trial | None = None
    variants = list_variants(part)
    for _ in range(CAUSE_SEARCH.most_faults):
        known = points if end is None else [end]
        about = part, trial_models, variants, known, [*stated, *findings], noise
        found, fit_without = _find_likeliest(*about)
        if not found:
            without = None if findings or points else fit_without
            break
        best = found[0]
        sized = _fit_size(part, whole, trial_models, best, noise)
        findings.append(_make_ranked_finding([sized, *found[1:]], part.name))
        end = best.trial.x
        if isinstance(best.fault, WrongAxes) and best.fault.compiled_variant is not None:
            variant = best.fault.compiled_variant
            part, whole = variant.replace_model(part), variant.replace_model(whole)
            trial_models = variant.trial_models
            variants = list_variants(part)
            continue
        whole = _correct_whole_part(whole, trial_models, sized.fault, end)
        prepared = replace(trial_models.prepare_part(part, [end]), frf=part.frf)
        # An adaptive fault is subtracted as fitted to all lines; its error on a few lines would
        # look like other faults.
        fault = sized.fault if best.fault.is_adaptive else best.fault
        part = replace(fault.prepare_next_search(prepared, end), solver=part.solver)
        if best.fault.ends_search:
            break
    return _Explanation(tuple(findings), part, trial_models, end, without)


def _correct_whole_part(
    whole: FRFPart, trial_models: TrialModels, fault: Fault, x: RealArray
) -> FRFPart:
    """Return the part with all lines, corrected for a fault if possible."""
    if fault.repair_text:
        return whole.with_data(fault.repair(whole.frf))
    if fault.alters_model:
        prepared = replace(trial_models.prepare_part(whole, [x]), frf=whole.frf)
        with suppress(SolverError):
            corrected = fault.prepare_next_search(prepared, x[: len(whole.coordinates.start)])
            return replace(corrected, solver=whole.solver)
    return whole


def _fit_size(
    part: FRFPart, whole: FRFPart, trial_models: TrialModels, found: RankedFault, noise: NoiseModel
) -> RankedFault:
    """Return the fault with its size fitted to all lines, with held quantities at their values."""
    # The fault is unchanged if the data contradict the held values.
    fault, x = found.fault, found.trial.x[: len(whole.coordinates.start)]
    if fault.is_adaptive and fault.repair_text:
        with suppress(SolverError):
            whole_part = trial_models.prepare_part(whole, [found.trial.x])
            return replace(found, fault=fault.fit_all_data(whole_part, x))
    has_size = fault.has_free_size and (fault.repair_text or fault.alters_model)
    if not has_size or fault.is_adaptive or fault.omits_channels:
        return found
    whole_part = trial_models.prepare_part(whole, [found.trial.x])
    trial = run_trial(whole_part, fault, [x])
    if trial is None or trial.fault is None:
        return found
    trial = run_trial(weight_by_noise(whole_part, trial, noise), trial.fault, [trial.x])
    if trial is None or trial.fault is None:
        return found
    current = trial_models.prepare_part(part, [found.trial.x])
    known_noise = noise.refit(*_evaluate_corrected(current, found.trial), part.n)
    error = _mean_square_error(whole_part, trial, known_noise)
    if error > CAUSE_SEARCH.similar_error * _mean_square_error(current, found.trial, known_noise):
        return found
    return replace(found, fault=trial.fault)


def _mean_square_error(part: FRFPart, trial: Trial, noise: NoiseModel) -> float:
    """Return the mean square error at the end of a trial, in units of the given noise."""
    H, frf = _evaluate_corrected(part, trial)
    variance = np.maximum(noise.variance(H, frf), np.finfo(float).tiny)
    square = np.abs(frf.values - H) ** 2 / variance
    return float(np.mean(square[~find_weightless(part.frf)]))


def _evaluate_corrected(part: FRFPart, trial: Trial) -> tuple[ComplexArray, FRF]:
    """Return model and data at the end of a trial, corrected for its fault."""
    corrected = part if trial.fault is None else trial.fault.correct_part(part, trial.x)
    return corrected.responses(trial.x), corrected.frf


def weight_by_noise(part: FRFPart, trial: Trial, noise: NoiseModel) -> FRFPart:
    """Return the part with data weighted by the noise estimated from the residual of a trial."""
    # Values without weight keep none, and are not used for the estimate.
    H, frf = _evaluate_corrected(part, trial)
    is_weightless = find_weightless(part.frf)
    # Values that are zero in model and data say nothing about the noise.
    seen = replace(frf, values=np.where(is_weightless, 0.0, frf.values))
    variance = noise.refit(np.where(is_weightless, 0.0, H), seen, part.n).variance(H, seen)
    size = np.abs(part.frf.values) / np.maximum(np.abs(frf.values), np.finfo(float).tiny)
    relative_noise = WeightedData.near_response(H, frf, variance).relative_noise
    weighted = WeightedData.of(part.frf, size**2 * variance, relative_noise)
    return part.with_data(remove_weight(weighted, is_weightless))


@use_one_thread
def _find_likeliest(
    part: FRFPart,
    trial_models: TrialModels,
    variants: Sequence[CompiledVariant],
    points: Sequence[RealArray],
    stated: Sequence[Finding],
    noise: NoiseModel,
) -> tuple[list[RankedFault], Trial | None]:
    """Return the likeliest fault with those indistinguishable from it, and the fit without a fault.

    The list may be empty; the fit is None without a solution.
    """
    home = part.coordinates.start
    current = trial_models.prepare_part(part, [home, *points])
    start = raise_loss_factors(current, home)
    first = run_trial(current, None, [*points, start])
    if first is None:
        return [], None
    current, without = _refine_fit(part, current, trial_models, first)
    if has_small_residual(without):
        weighted = weight_by_noise(current, without, noise).frf
        part = adapt_losses(part.with_data(weighted), without.x)
        current = trial_models.prepare_part(part, [without.x])
        without = run_trial(current, None, [without.x]) or without
    fresh = select_candidates(current, without, start, stated, variants)
    ranked = _rank_by_trials(current, fresh, without)
    if not _is_likely(ranked):
        return [], first
    refined = trial_models.prepare_part(part, [ranked[0].trial.x])
    if refined.solver is not current.solver:
        # The apparent fault may be an error of the reduced model, which is now smaller.
        current, without = refined, run_trial(refined, None, [without.x]) or without
        in_reach = [one for one in ranked if is_in_reach(one, ranked[0])]
        starts = [(one.fault, one.trial.x) for one in in_reach[: CAUSE_CANDIDATES.most_fitted]]
        ranked = _rank_by_trials(current, starts, without)
        if not _is_likely(ranked):
            return [], first
    # The fit with the fault may only have helped the unknowns out of a poor minimum.
    better = run_trial(current, None, [ranked[0].trial.x])
    if better is not None and better.gain(without) > 0.0:
        compared = rank_faults([one.trial for one in ranked], better)
        ranked = list(filter(is_worth_reporting, compared))
    if not _is_likely(ranked):
        return [], first
    likely = [one for one in ranked if is_as_likely(one, ranked[0])]
    return _put_special_cases_first(likely), first


def _put_special_cases_first(likely: Sequence[RankedFault]) -> list[RankedFault]:
    """Return equally likely faults in their order, but special cases of others first."""
    special = {case for one in likely for case in one.fault.special_cases}
    return sorted(likely, key=lambda one: one.fault.key not in special)


def _is_likely(ranked: Sequence[RankedFault]) -> bool:
    return bool(ranked) and ranked[0].log_odds >= CAUSE_ODDS.likely_log_odds


def _refine_fit(
    part: FRFPart, current: FRFPart, trial_models: TrialModels, trial: Trial
) -> tuple[FRFPart, Trial]:
    """Return the part with a model valid at the end of a fit without a fault, and this fit."""
    # Far from the data, a model valid around the start is sufficient.
    for _ in range(CAUSE_SEARCH.most_refinements):
        if trial.mean_square > CAUSE_CANDIDATES.small_rms**2:
            break
        before, current = current, trial_models.prepare_part(part, [trial.x])
        longer = run_trial(current, None, [trial.x]) or trial
        done = (
            longer.mean_square > CAUSE_SEARCH.converged_share * trial.mean_square
            and current.solver is before.solver
        )
        trial = longer
        if done:
            break
    return current, trial


def _rank_by_trials(
    part: FRFPart, fresh: Sequence[FaultStart], without: Trial
) -> list[RankedFault]:
    """Return the faults worth reporting after a fit of each, the likeliest first."""
    ends = _BestTrials(part)
    ends.try_all(fresh)
    best: Trial | None = None
    for _ in range(CAUSE_SEARCH.place_rounds):
        if ends.best is best:
            break
        best = ends.best
        ends.try_all(ends.list_other_places(fresh))
    return _drop_inconsistent(part, rank_faults(ends.trials.values(), without))


def _drop_inconsistent(part: FRFPart, found: Sequence[RankedFault]) -> list[RankedFault]:
    """Return the faults worth reporting, except likely ones whose size depends on the band."""
    remaining = list(filter(is_worth_reporting, found))
    while _is_likely(remaining):
        likely = [one for one in remaining if is_as_likely(one, remaining[0])]
        wrong = [one for one in likely if _depends_on_band(part, one)]
        if not wrong:
            break
        remaining = [one for one in remaining if not any(one is other for other in wrong)]
    return remaining


def _depends_on_band(part: FRFPart, found: RankedFault) -> bool:
    """Return whether the two halves of the band contradict each other about the size of a fault."""
    fault, trial = found.fault, found.trial
    if not fault.has_constant_size:
        return False
    with suppress(SolverError):
        corrected = Evidence(fault.correct_part(part, trial.x), trial.x)
        correlation = limit_correlation(trial.correlation)
        return compare_band_halves(corrected, fault, correlation) > SIGNIFICANCE.stds
    return False


@dataclass(slots=True, eq=False)
class _BestTrials:
    """The best trial of each fault, and the last trial that leaves only noise."""

    part: FRFPart
    trials: dict[tuple[str, tuple[str, ...]], Trial] = field(default_factory=dict)
    noise: Trial | None = None

    def try_all(self, starts: Sequence[FaultStart]) -> None:
        """Try faults, and those with nearly the same effect."""
        waiting = deque(starts)
        while waiting:
            fault, x = waiting.popleft()
            trial = run_trial(self.part, fault, [x], rival=self.noise)
            if trial is None or trial.fault is None:
                continue
            known = self.trials.get(fault.key)
            if known is None or trial.gain(known) > 0.0:
                self.trials[fault.key] = trial
                waiting += [
                    (other, trial.x) for other in trial.fault.list_similar_faults(self.part)
                ]
                if trial.is_noise:
                    self.noise = trial

    @property
    def best(self) -> Trial | None:
        """The trial with the smallest residual."""
        return min(self.trials.values(), key=lambda one: one.mean_square, default=None)

    def list_other_places(self, starts: Sequence[FaultStart]) -> list[FaultStart]:
        """Return the best fault at other places, the likeliest at several points."""
        # Further points than the end of its trial are used if that does not leave only noise.
        best = self.best
        if best is None or best.fault is None:
            return []
        kind = best.fault.kind
        points = [best.x]
        if not best.is_noise:
            same = sorted((t.mean_square, k[1]) for k, t in self.trials.items() if k[0] == kind)
            points += [
                self.trials[kind, channels].x for _, channels in same[1 : CAUSE_SEARCH.next_places]
            ]
            points += [x for fault, x in starts if fault.kind == kind]
        chosen: dict[tuple[str, ...], FaultStart] = {}
        for x in points:
            others: list[Fault] = []
            with suppress(SolverError):
                others = list(best.fault.list_other_places(Evidence(self.part, x)))
            if x is not best.x:
                others = [one for one in others if (kind, one.channels) not in self.trials]
            new = [one for one in others if one.channels not in chosen]
            chosen |= {one.channels: (one, x) for one in new[: CAUSE_SEARCH.next_places]}
        return list(chosen.values())


def _make_ranked_finding(found: Sequence[RankedFault], test: str) -> Finding:
    best, *others = found
    finding = make_fault_finding(best.fault, best.log_odds, best.explains, test)
    statement = finding.statement
    if others:
        named = others[: CAUSE_SEARCH.named_causes]
        causes = " or ".join(one.fault.statement().rstrip(".") for one in named)
        statement += f" These data do not distinguish this from another cause: {causes}."
        tests = dict.fromkeys(one.fault.distinguishing_test for one in [best, *named])
        statement += "".join(f" {test}" for test in tests if test)
    also = tuple(one.fault.repair_text or one.fault.name for one in others)
    return replace(finding, statement=statement, also=also, of_misfit=best.of_misfit)
