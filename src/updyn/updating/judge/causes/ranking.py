"""Comparison of the fits with several faults."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.settings import CAUSE_ODDS
from updyn.updating.judge.causes.trial import Trial

__all__ = ["RankedFault", "is_as_likely", "is_in_reach", "is_worth_reporting", "rank_faults"]


@dataclass(frozen=True, slots=True, eq=False)
class RankedFault:
    """The trial of a fault, and the logarithm of the odds that the data have it.

    `explains` is the explained share of the misfit (`of_misfit`), or of the distance of the
    unknowns from their start if that is larger.
    """

    trial: Trial
    fault: Fault
    log_odds: float
    explains: float
    of_misfit: float


def rank_faults(ends: Iterable[Trial], without: Trial) -> list[RankedFault]:
    """Return the faults of trials with their odds, the likeliest first."""
    # All comparisons use the correlation of neighbouring lines of the trial with the smallest
    # residual, because the residuals of the others are not only noise.
    every = list(ends)
    best = min([*every, without], key=lambda end: end.mean_square)
    correlation = min(best.correlation, without.correlation)
    out = []
    for end in every:
        assert end.fault is not None
        gain, explained = end.compare(without, correlation)
        log_odds = gain + float(np.log(end.fault.prior))
        share = _compute_share(end, without, explained)
        out.append(RankedFault(end, end.fault, log_odds, share, explained))
    return sorted(out, key=lambda one: -one.log_odds)


def is_worth_reporting(found: RankedFault) -> bool:
    """Return whether a fault explains a good part of the misfit, or all of it that is not noise."""
    # In the latter case the data themselves have to make it likely, not the residual of a model.
    trial = found.trial
    by_data = 0.5 * trial.n_values * found.explains + float(np.log(found.fault.prior))
    return found.explains >= CAUSE_ODDS.least_share or (
        trial.is_noise and by_data >= CAUSE_ODDS.likely_log_odds
    )


def _compute_share(trial: Trial, without: Trial, explained: float) -> float:
    """Return the share of the misfit, or of the distance of the unknowns, that a fault explains."""
    # The distance counts if it was larger than models are usually off; for held quantities, whose
    # spread is known, also if the fault reduces it by a good part.
    # A fault without a size cannot reduce the distance by chance.
    has_no_size = trial.fault is not None and not trial.fault.has_free_size
    if has_no_size and without.squared_distance > CAUSE_ODDS.usual_distance**2 * len(without.x):
        explained = max(explained, 1.0 - trial.squared_distance / without.squared_distance)
    if without.squared_distance_held > CAUSE_ODDS.usual_distance**2 * without.n_held:
        reduction = 1.0 - trial.squared_distance_held / without.squared_distance_held
        if reduction > CAUSE_ODDS.least_reduction:
            explained = max(explained, reduction)
    return explained


def is_as_likely(one: RankedFault, best: RankedFault) -> bool:
    """Return whether the data do not distinguish a fault from the likeliest one."""
    # One factor on all stiffnesses describes a sensor of another state; its accuracy does not show
    # which of two sensors it is.
    omit_channels = one.fault.omits_channels and best.fault.omits_channels
    if omit_channels and min(one.explains, best.explains) > 1.0 - CAUSE_ODDS.negligible_share:
        return True
    return one.log_odds > best.log_odds - CAUSE_ODDS.indistinct_log_odds


def is_in_reach(one: RankedFault, best: RankedFault) -> bool:
    """Return whether a better model may make a fault as likely as the likeliest one."""
    return one.log_odds > best.log_odds - 2.0 * CAUSE_ODDS.indistinct_log_odds
