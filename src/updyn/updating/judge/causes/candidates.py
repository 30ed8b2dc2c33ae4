"""Selection of the faults that are fitted with all unknowns."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from updyn.errors import SolverError
from updyn.updating.judge.causes.catalogue import CAUSES
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.judge.causes.other_model import OtherModel
from updyn.updating.judge.causes.promising import IN_REACH, estimate_gain, select_variants
from updyn.updating.judge.causes.ranking import LITTLE, compared
from updyn.updating.judge.causes.suspects import ScoredFault, score_faults, select_likeliest
from updyn.updating.judge.causes.trial import NOISY, Trial, robust_point, tried
from updyn.updating.judge.causes.wrong_axes import WrongAxes
from updyn.updating.problem.problem import Part

__all__ = ["KEPT", "SMALL", "Begun", "candidates", "is_small"]

_Real = NDArray[np.float64]
#: A fault and the starting point of its fit.
Begun: TypeAlias = "tuple[Fault, _Real]"

#: Largest number of faults that are fitted until convergence.
KEPT = 4
#: Log misfit (rms) and correlation of neighbouring lines below which there is no gross fault.
SMALL, _ALIKE = 0.1, 0.3
#: Largest remaining share of the misfit with which a fault of all data explains everything.
_LEAST = 0.01
#: Logarithm of the odds, to first order, from which a fault is tried if the residual is small;
#: changes of the unknowns during its fit have effects of higher order.
_PROMISED = -5.0


def candidates(
    part: Part,
    without: Trial,
    start: _Real,
    stated: Sequence[Finding],
    others: Sequence[OtherModel] = (),
) -> list[Begun]:
    """Return the faults worth a full fit, the likeliest first, with their starting points.

    `without` is the end of a fit without a fault, `start` a point that does not depend on the data,
    `stated` the faults already found, `others` the variants of the model.
    """
    variants: list[Begun] = []
    for end in _variants_tried(part, others, without, start):
        assert end.fault is not None
        variants.append((end.fault, end.x))
        if _explains_all(end, without):
            return [*variants, *_beside_variant(part, end, stated)]
    return [*variants, *_of_data(part, without, start, stated)]


def _variants_tried(
    part: Part, others: Sequence[OtherModel], without: Trial, start: _Real
) -> Iterator[Trial]:
    """Yield the trials of the most promising variants of the model."""
    for fault in select_variants(part, others, without, start):
        end = tried(part, fault, [start])
        if end is not None:
            yield end


def _beside_variant(part: Part, end: Trial, stated: Sequence[Finding]) -> list[Begun]:
    """Return the faults that explain the data as well as a variant, at the end of its trial."""
    assert isinstance(end.fault, WrongAxes)
    try:
        least = estimate_gain(part, end.fault, end.x) - IN_REACH
    except SolverError:
        return []
    found = [one for one in select_likeliest(score_faults(part, end.x)) if one.gain > least]
    return [(one.fault, one.x) for one in _fresh(found, stated)]


def _of_data(part: Part, without: Trial, start: _Real, stated: Sequence[Finding]) -> list[Begun]:
    """Return the faults worth a full fit with the given model, the likeliest first."""
    if is_small(without):
        return _promising(part, without, stated)
    points = [start, without.x]
    with suppress(SolverError):
        points.append(robust_point(part, start))
    return _followed(part, without, _fresh(_seen_from(part, points), stated), stated)


def is_small(trial: Trial) -> bool:
    """Return whether the residual of a trial is nearly noise, without a gross fault."""
    return trial.power < SMALL**2 and trial.alike < _ALIKE


def _promising(part: Part, without: Trial, stated: Sequence[Finding]) -> list[Begun]:
    """Return the faults that promise a better fit than a trial with a small residual."""
    found = [one for one in score_faults(part, without.x, promising=True) if one.gain >= _PROMISED]
    found = _fresh(select_likeliest(found), stated)
    if len(found) <= KEPT:
        return [(one.fault, one.x) for one in found]
    return _ahead([end for one in found if (end := _glanced(part, one))], without)


def _seen_from(part: Part, points: Sequence[_Real]) -> list[ScoredFault]:
    """Return the suspects of several points, in the order in which they are tried."""
    by_point = [score_faults(part, x) for x in points]
    found = [one for one in by_point[0] if one.fault.affects_all_data]
    for there in by_point:
        found += [one for one in select_likeliest(there) if one not in found]
    return found


def _followed(
    part: Part, without: Trial, found: Sequence[ScoredFault], stated: Sequence[Finding]
) -> list[Begun]:
    """Return the best faults after a few steps of each, the likeliest first.

    If one explains all data, only faults that explain as much at the end of its trial are kept.
    """
    tries = sorted(found, key=lambda one: -one.log_evidence)
    # A fault of all data promises little to first order, but its fit may explain much.
    tries[1:] = sorted(tries[1:], key=lambda one: not one.fault.affects_all_data)
    ends: list[Trial] = []
    for suspect in tries:
        end = _glanced(part, suspect)
        if end is None or end.fault is None:
            continue
        ends.append(end)
        if _explains_all(end, without):
            rivals = _fresh(_as_good(part, end), stated)
            return [(end.fault, end.x), *((one.fault, one.x) for one in rivals)]
    return _ahead(ends, without)


def _fresh(found: Iterable[ScoredFault], stated: Sequence[Finding]) -> list[ScoredFault]:
    """Return the suspects that no finding covers."""
    return [one for one in found if not any(_covers(known, one.fault) for known in stated)]


def _covers(finding: Finding, fault: Fault) -> bool:
    """Return whether a finding makes a fault superfluous."""
    kind = CAUSES[finding.kind]
    same = finding.kind == fault.kind and finding.channels == fault.channels
    gone = kind.omits_channels and not set(finding.channels).isdisjoint(fault.channels)
    return same or gone or fault.kind in kind.imitated_kinds


def _glanced(part: Part, suspect: ScoredFault) -> Trial | None:
    """Return the trial of a suspect after a few steps."""
    return tried(part, suspect.fault, [suspect.x], glance=True)


def _explains_all(end: Trial, without: Trial) -> bool:
    """Return whether a fault explains all but noise; then only similar faults compete with it."""
    assert end.fault is not None
    if end.fault.affects_all_data:
        return end.power < _LEAST * without.power
    return end.alike < _ALIKE and end.power < min(NOISY**2, LITTLE * without.power)


def _ahead(ends: Sequence[Trial], without: Trial) -> list[Begun]:
    """Return the likeliest faults of some trials, the best first, with starting points for fits.

    Of several trials of one fault the likeliest is used.
    """
    best: dict[tuple[str, tuple[str, ...]], Begun] = {}
    for one in compared(ends, without):
        best.setdefault((one.fault.kind, one.fault.channels), (one.fault, one.trial.x))
    return list(best.values())[:KEPT]


def _as_good(part: Part, end: Trial) -> list[ScoredFault]:
    """Return other faults that explain the data as well at the end of a trial, to first order."""
    assert end.fault is not None
    key = (end.fault.kind, end.fault.channels)
    found = select_likeliest(score_faults(part, end.x))
    own = [one.gain for one in found if one.key == key]
    if not own:
        return []
    return [one for one in found if one.gain > own[0] - IN_REACH and one.key != key]
