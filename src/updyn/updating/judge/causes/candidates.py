"""Selection of the faults that are fitted with all unknowns."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from typing import TypeAlias

from updyn.arrays import RealArray
from updyn.errors import SolverError
from updyn.updating.judge.causes.catalogue import CAUSES
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.judge.causes.other_model import CompiledVariant
from updyn.updating.judge.causes.promising import estimate_gain, select_variants
from updyn.updating.judge.causes.ranking import rank_faults
from updyn.updating.judge.causes.settings import CAUSE_CANDIDATES, CAUSE_ODDS, CAUSE_TRIAL
from updyn.updating.judge.causes.suspects import ScoredFault, score_faults, select_likeliest
from updyn.updating.judge.causes.trial import Trial, run_trial
from updyn.updating.judge.causes.wrong_axes import WrongAxes
from updyn.updating.problem.problem import FRFPart

__all__ = ["FaultStart", "has_small_residual", "select_candidates"]

#: A fault and the starting point of its fit.
FaultStart: TypeAlias = "tuple[Fault, RealArray]"


def select_candidates(
    part: FRFPart,
    without: Trial,
    start: RealArray,
    stated: Sequence[Finding],
    models: Sequence[CompiledVariant] = (),
) -> list[FaultStart]:
    """Return the faults worth a full fit, the likeliest first, with their starting points.

    `without` is the end of a fit without a fault, `stated` the faults already found. `start` must
    not depend on the data.
    """
    variants: list[FaultStart] = []
    for end in _try_variants(part, models, without, start):
        assert end.fault is not None
        variants.append((end.fault, end.x))
        if _explains_all(end, without):
            return [*variants, *_list_rivals(part, end, stated)]
    return [*variants, *_select_for_model(part, without, start, stated)]


def _try_variants(
    part: FRFPart, models: Sequence[CompiledVariant], without: Trial, start: RealArray
) -> Iterator[Trial]:
    """Yield the trials of the most promising variants of the model."""
    for fault in select_variants(part, models, without, start):
        end = run_trial(part, fault, [start])
        if end is not None:
            yield end


def _select_for_model(
    part: FRFPart, without: Trial, start: RealArray, stated: Sequence[Finding]
) -> list[FaultStart]:
    """Return the faults worth a full fit with the given model, the likeliest first."""
    if has_small_residual(without):
        return _select_by_gain(part, without, stated)
    found = _drop_covered(_score_at_points(part, [start, without.x]), stated)
    return _select_by_short_trials(part, without, found, stated)


def has_small_residual(trial: Trial) -> bool:
    """Return whether the residual of a trial is nearly noise, without a gross fault."""
    small = trial.mean_square < CAUSE_CANDIDATES.small_rms**2
    return small and trial.correlation < CAUSE_CANDIDATES.small_correlation


def _select_by_gain(part: FRFPart, without: Trial, stated: Sequence[Finding]) -> list[FaultStart]:
    """Return the faults that promise a better fit than a trial with a small residual."""
    scored = score_faults(part, without.x, promising=True)
    found = [one for one in scored if one.gain >= CAUSE_CANDIDATES.least_log_odds]
    found = _drop_covered(select_likeliest(found), stated)
    return [(one.fault, one.x) for one in found[: CAUSE_CANDIDATES.most_fitted]]


def _score_at_points(part: FRFPart, points: Sequence[RealArray]) -> list[ScoredFault]:
    """Return the most promising faults of several points, in the order in which they are tried."""
    by_point = [score_faults(part, x) for x in points]
    found = [one for one in by_point[0] if one.fault.affects_all_data]
    for scored in by_point:
        found += [one for one in select_likeliest(scored) if one not in found]
    return found


def _select_by_short_trials(
    part: FRFPart, without: Trial, found: Sequence[ScoredFault], stated: Sequence[Finding]
) -> list[FaultStart]:
    """Return the best faults after a few steps of each, the likeliest first."""
    # If one explains all data, only faults that explain as much at the end of its trial are kept.
    tries = sorted(found, key=lambda one: -one.log_evidence)
    # A fault of all data promises little to first order, but its fit may explain much.
    tries[1:] = sorted(tries[1:], key=lambda one: not one.fault.affects_all_data)
    ends: list[Trial] = []
    for scored in tries:
        end = _run_short_trial(part, scored)
        if end is None or end.fault is None:
            continue
        ends.append(end)
        if _explains_all(end, without):
            return [(end.fault, end.x), *_list_rivals(part, end, stated)]
    return _select_best_trials(ends, without)


def _drop_covered(found: Iterable[ScoredFault], stated: Sequence[Finding]) -> list[ScoredFault]:
    return [one for one in found if not any(_covers(known, one.fault) for known in stated)]


def _covers(finding: Finding, fault: Fault) -> bool:
    kind = CAUSES[finding.kind]
    same = (finding.kind, finding.channels) == fault.key
    is_omitted = kind.omits_channels and not set(finding.channels).isdisjoint(fault.channels)
    return same or is_omitted or fault.kind in kind.imitated_kinds


def _run_short_trial(part: FRFPart, scored: ScoredFault) -> Trial | None:
    """Return the trial of a fault after a few steps."""
    return run_trial(part, scored.fault, [scored.x], is_short=True)


def _explains_all(end: Trial, without: Trial) -> bool:
    """Return whether a fault explains all but noise; then only similar faults compete with it."""
    assert end.fault is not None
    if end.fault.affects_all_data:
        return end.mean_square < CAUSE_CANDIDATES.least_remaining * without.mean_square
    return end.correlation < CAUSE_CANDIDATES.small_correlation and end.mean_square < min(
        CAUSE_TRIAL.noise_rms**2, CAUSE_ODDS.negligible_share * without.mean_square
    )


def _select_best_trials(ends: Sequence[Trial], without: Trial) -> list[FaultStart]:
    """Return the likeliest faults of some trials, the best first, with starting points for fits."""
    best: dict[tuple[str, tuple[str, ...]], FaultStart] = {}
    for one in rank_faults(ends, without):
        best.setdefault(one.fault.key, (one.fault, one.trial.x))
    return list(best.values())[: CAUSE_CANDIDATES.most_fitted]


def _list_rivals(part: FRFPart, end: Trial, stated: Sequence[Finding]) -> list[FaultStart]:
    """Return other faults that explain the data as well at the end of a trial, to first order."""
    fault, found = end.fault, select_likeliest(score_faults(part, end.x))
    assert fault is not None
    gains = [one.gain for one in found if one.fault.key == fault.key]
    if isinstance(fault, WrongAxes):  # not among the faults that are scored
        with suppress(SolverError):
            gains = [estimate_gain(part, fault, end.x)]
    if not gains:
        return []
    least = gains[0] - CAUSE_CANDIDATES.reach_log_odds
    rivals = [one for one in found if one.gain > least and one.fault.key != fault.key]
    return [(one.fault, one.x) for one in _drop_covered(rivals, stated)]
