"""Which faults are worth a whole fit."""

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
from updyn.updating.judge.causes.promising import IN_REACH, gain_of, promising_variants
from updyn.updating.judge.causes.ranking import LITTLE, compared
from updyn.updating.judge.causes.suspects import Suspect, likeliest, suspects
from updyn.updating.judge.causes.trial import NOISY, Trial, robust_point, tried
from updyn.updating.judge.causes.wrong_axes import WrongAxes
from updyn.updating.problem.problem import Part

__all__ = ["KEPT", "SMALL", "Begun", "candidates", "is_small"]

_Real = NDArray[np.float64]
#: A fault, and the point to begin from.
Begun: TypeAlias = "tuple[Fault, _Real]"

#: Faults that are fitted to the end.
KEPT = 4
#: A log misfit (rms), and a correlation of neighbouring lines, below which there is nothing gross.
SMALL, _ALIKE = 0.1, 0.3
#: Largest share of the misfit that is left by a fault of all data that explains all.
_LEAST = 0.01
#: Logarithm of the odds, to first order, from which a fault is tried where little is left without
#: one: what the unknowns do on the way to its end is of higher order.
_PROMISED = -5.0


def candidates(
    part: Part,
    without: Trial,
    start: _Real,
    stated: Sequence[Finding],
    others: Sequence[OtherModel] = (),
) -> list[Begun]:
    """Return the faults that are worth a whole fit, the likeliest first.

    Parameters
    ----------
    part : Part
        Model and data of one test, on few lines.
    without : Trial
        The end of a fit without a fault.
    start : ndarray of float, shape (n,)
        A point that is not led by the data.
    stated : sequence of Finding
        What has been found.
    others : sequence of OtherModel
        Variants of the model.

    Returns
    -------
    list of tuple of Fault and ndarray of float, shape (n,)
        Each with the point from which its fit begins.
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
    """Yield the ends of fits of the most promising variants of the model."""
    for fault in promising_variants(part, others, without, start):
        end = tried(part, fault, [start])
        if end is not None:
            yield end


def _beside_variant(part: Part, end: Trial, stated: Sequence[Finding]) -> list[Begun]:
    """Return the faults that explain the data as well as a variant where its trial ended."""
    assert isinstance(end.fault, WrongAxes)
    try:
        least = gain_of(part, end.fault, end.x) - IN_REACH
    except SolverError:
        return []
    found = [one for one in likeliest(suspects(part, end.x)) if one.gain > least]
    return [(one.fault, one.x) for one in _fresh(found, stated)]


def _of_data(part: Part, without: Trial, start: _Real, stated: Sequence[Finding]) -> list[Begun]:
    """Return the faults that are worth a whole fit with the model as it is, the likeliest first."""
    if is_small(without):
        return _promising(part, without, stated)
    points = [start, without.x]
    with suppress(SolverError):
        points.append(robust_point(part, start))
    return _followed(part, without, _fresh(_seen_from(part, points), stated), stated)


def is_small(trial: Trial) -> bool:
    """Return whether the residual of a trial is nearly noise: nothing gross is wrong."""
    return trial.power < SMALL**2 and trial.alike < _ALIKE


def _promising(part: Part, without: Trial, stated: Sequence[Finding]) -> list[Begun]:
    """Return the faults that promise a better fit at the end of one that leaves little."""
    found = [one for one in suspects(part, without.x, promising=True) if one.gain >= _PROMISED]
    found = _fresh(likeliest(found), stated)
    if len(found) <= KEPT:
        return [(one.fault, one.x) for one in found]
    return _ahead([end for one in found if (end := _glanced(part, one))], without)


def _seen_from(part: Part, points: Sequence[_Real]) -> list[Suspect]:
    """Return the suspects of several points, in the order in which they are followed up."""
    by_point = [suspects(part, x) for x in points]
    found = [one for one in by_point[0] if one.fault.changes_all]
    for there in by_point:
        found += [one for one in likeliest(there) if one not in found]
    return found


def _followed(
    part: Part, without: Trial, found: Sequence[Suspect], stated: Sequence[Finding]
) -> list[Begun]:
    """Return the faults that are ahead after a few steps of each, the most promising first.

    Once one explains all data, only those are looked at that explain as much where it ended.
    """
    tries = sorted(found, key=lambda one: -one.log_evidence)
    # What changes all data promises little to first order, and much where its fit ends.
    tries[1:] = sorted(tries[1:], key=lambda one: not one.fault.changes_all)
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


def _fresh(found: Iterable[Suspect], stated: Sequence[Finding]) -> list[Suspect]:
    """Return the suspects of which nothing has been said."""
    return [one for one in found if not any(_covers(known, one.fault) for known in stated)]


def _covers(finding: Finding, fault: Fault) -> bool:
    """Return whether a fault needs no further word beside a finding."""
    kind = CAUSES[finding.kind]
    same = finding.kind == fault.kind and finding.channels == fault.channels
    gone = kind.leaves_out and not set(finding.channels).isdisjoint(fault.channels)
    return same or gone or fault.kind in kind.blurs


def _glanced(part: Part, suspect: Suspect) -> Trial | None:
    """Return where a trial has come after a few steps."""
    return tried(part, suspect.fault, [suspect.x], glance=True)


def _explains_all(end: Trial, without: Trial) -> bool:
    """Return whether a fault explains all but noise, so that only others like it may compete."""
    assert end.fault is not None
    if end.fault.changes_all:
        return end.power < _LEAST * without.power
    return end.alike < _ALIKE and end.power < min(NOISY**2, LITTLE * without.power)


def _ahead(ends: Sequence[Trial], without: Trial) -> list[Begun]:
    """Return the likeliest of some trials, the best first, with the points to go on from.

    Of the trials of one fault that began at several points the likeliest is kept.
    """
    best: dict[tuple[str, tuple[str, ...]], Begun] = {}
    for one in compared(ends, without):
        best.setdefault((one.fault.kind, one.fault.channels), (one.fault, one.trial.x))
    return list(best.values())[:KEPT]


def _as_good(part: Part, end: Trial) -> list[Suspect]:
    """Return other faults that explain the data as well where a trial ended, to first order."""
    assert end.fault is not None
    key = (end.fault.kind, end.fault.channels)
    found = likeliest(suspects(part, end.x))
    own = [one.gain for one in found if one.key == key]
    if not own:
        return []
    return [one for one in found if one.gain > own[0] - IN_REACH and one.key != key]
