"""Comparing what fits under several faults leave."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.shown import LIKELY
from updyn.updating.judge.causes.trial import Trial

__all__ = [
    "FAR_OFF",
    "LITTLE",
    "Ranked",
    "compared",
    "is_as_likely",
    "is_in_reach",
    "is_worth_a_word",
]

#: How far stiffnesses and masses are off at most, as a rule (rms), in units of their spread.
FAR_OFF = 2.0
#: Share of the way of what is held of the model that a fault makes needless at least.
_BACK = 0.3
#: Share of the misfit that a fault explains at least; less is one of many small errors.
_WORTH = 0.1
#: Share of the misfit below which a fault leaves nothing that has to be explained.
LITTLE = 0.05
#: Logarithm of the odds between two faults below which the data do not tell them apart.
_ALIKE_ODDS = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Ranked:
    """The trial of a fault, and the logarithm of the odds that the data have it.

    `explains` is the share of the misfit that it explains, or of the unknowns' way from their start
    where that is more; `of_misfit` is that of the misfit alone.
    """

    trial: Trial
    fault: Fault
    log_odds: float
    explains: float
    of_misfit: float


def compared(ends: Iterable[Trial], without: Trial) -> list[Ranked]:
    """Return what trials say, the likeliest first.

    All are compared by the correlation of neighbouring lines of the one that leaves least: what
    others leave is not only noise.
    """
    every = list(ends)
    best = min([*every, without], key=lambda end: end.power)
    alike = min(best.alike, without.alike)
    out = []
    for end in every:
        assert end.fault is not None
        gain, explained = end.compared(without, alike)
        log_odds = gain + float(np.log(end.fault.prior))
        share = _share(end, without, explained)
        out.append(Ranked(end, end.fault, log_odds, share, explained))
    return sorted(out, key=lambda one: -one.log_odds)


def is_worth_a_word(found: Ranked) -> bool:
    """Return whether a fault explains a good part of the misfit, or all of it that is not noise.

    Then the data by themselves have to make it likely, and not the residual against a model.
    """
    left = found.trial
    by_data = 0.5 * left.n_values * found.explains + float(np.log(found.fault.prior))
    return found.explains >= _WORTH or (left.is_noise and by_data >= LIKELY)


def _share(trial: Trial, without: Trial, explained: float) -> float:
    """Return the share of the misfit, or of the unknowns' way, that a fault explains.

    The way counts where it was farther than models are off; of what is held of the model, whose
    spread is known, where the fault brings a good part of it back.
    """
    # What has no size of its own does not do it by chance.
    known = trial.fault is not None and not trial.fault.tunes
    if known and without.far > FAR_OFF**2 * len(without.x):
        explained = max(explained, 1.0 - trial.far / without.far)
    if without.far_held > FAR_OFF**2 * without.n_held:
        back = 1.0 - trial.far_held / without.far_held
        if back > _BACK:
            explained = max(explained, back)
    return explained


def is_as_likely(one: Ranked, best: Ranked) -> bool:
    """Return whether the data do not tell a fault from the likeliest.

    A sensor of another state is described by one factor on all stiffnesses. How well that holds
    does not say which of two sensors it is.
    """
    of_a_state = one.fault.leaves_out and best.fault.leaves_out
    if of_a_state and min(one.explains, best.explains) > 1.0 - LITTLE:
        return True
    return one.log_odds > best.log_odds - _ALIKE_ODDS


def is_in_reach(one: Ranked, best: Ranked) -> bool:
    """Return whether a better model may make a fault as likely as the likeliest."""
    return one.log_odds > best.log_odds - 2.0 * _ALIKE_ODDS
