"""From model, data and unknowns to the faults that explain a misfit."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from updyn.errors import SolverError
from updyn.frf import FRF
from updyn.updating.judge.causes.catalogue import CAUSES
from updyn.updating.judge.causes.data_alone import (
    finding_of,
    set_aside,
    shown_by,
    still_shown,
    with_variance,
)
from updyn.updating.judge.causes.evidence import Evidence, held_of, spread_of
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.judge.causes.misfit import as_likely, log_misfit
from updyn.updating.judge.causes.quadratic import Quadratic
from updyn.updating.judge.causes.reduced import Stage, stage_of
from updyn.updating.judge.causes.score import fitted
from updyn.updating.judge.causes.shown import LIKELY
from updyn.updating.judge.causes.trial import (
    Trial,
    damped,
    robust_point,
    tried,
    widened,
)
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import Part

__all__ = ["diagnosed", "is_looked_at", "strained"]

_Real = NDArray[np.float64]
#: A fault, and the point to begin from.
_Begun: TypeAlias = "tuple[Fault, _Real]"

#: Lines that are looked at.
_LINES = 60
#: Faults that are refitted from each point, and those of each kind.
_REFITTED, _OF_A_KIND = 6, 2
#: Those of them that are fitted to the end.
_KEPT = 4
#: Logarithm of the odds between two faults below which the data do not tell them apart.
_ALIKE_ODDS = 3.0
#: How far stiffnesses and masses are off at most, as a rule (rms), in units of their spread.
_FAR_OFF = 2.0
#: Share of the way of what is held of the model that a fault makes needless at least.
_BACK = 0.3
#: Share of the misfit that a fault explains at least; less is one of many small errors.
_WORTH = 0.1
#: Correlation of neighbouring lines, and log misfit (rms), below which the residual of a fault is
#: noise: there are no others. On few lines an error of the model looks like it, but for its size.
#: It is of use from some 230 real values; of 240, on 30 lines, white noise is above in 7 %.
_WHITE, _NOISY = 0.1, 0.05
#: Largest share of the misfit that is left by a fault that explains all: one of all data; another,
#: which has to leave noise.
_LEFT = (0.01, 0.05)
#: Logarithm of the odds, to first order, from which a fault is tried where little is left without
#: one: what the unknowns do on the way to its end is of higher order.
_PROMISED = -5.0
#: Logarithm of the odds, to first order, by which another fault may be behind one that leaves only
#: noise and still be tried.
_IN_REACH = 50.0
#: Other causes that are named.
_NAMED = 2
#: How often a model is made better where a decision is taken.
_SETTLED = 3
#: Share of the misfit before it from which a fit has arrived.
_ARRIVED = 0.9
#: Most faults of one test.
_MOST = 3
#: Mean squares of the misfit that differ by less explain the data alike.
_AS_WELL = 1.2
#: Fewer lines say nothing.
_FEWEST = 8
#: A log misfit (rms), and a correlation of neighbouring lines, below which there is nothing gross;
#: a misfit from which the end of a fit need not be found exactly.
_SMALL, _ALIKE, _GROSS = 0.1, 0.3, 0.5
#: Mean square of the misfit below which the faults that were found explain all data.
_EXPLAINED = 1e-3
#: Mean square of the misfit, over that where the values of a symptom are set aside, from which the
#: faults that were found do not explain the symptom.
_WORSE = 1.5


def strained(part: Part, x: _Real) -> bool:
    """Return whether the unknowns had to go farther from their start than models are usually off.

    Then the data may be explained, and be wrong by one factor all the same.
    """
    own = part.coordinates
    off = ((x - own.home) / spread_of(part))[own.parameters.is_factor]
    return bool(off.size and np.sqrt(np.mean(off**2)) > _FAR_OFF)


def is_looked_at(part: Part) -> bool:
    """Return whether the data have lines enough for causes to be looked for."""
    return part.n_lines >= _FEWEST


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """The trial of a fault, and the logarithm of the odds that the data have it."""

    trial: Trial
    fault: Fault
    log_odds: float
    explains: float


def diagnosed(part: Part, noise: NoiseModel, points: Sequence[_Real] = ()) -> list[Finding]:
    """Return the faults of one test's data.

    Parameters
    ----------
    part : Part
        Model, data and unknowns.
    noise : NoiseModel
        How uncertain the data are.
    points : sequence of ndarray of float, shape (n,)
        Where fits ended; the start of the unknowns is looked at in any case.

    Returns
    -------
    list of Finding
        Those that the data show by themselves, then the others, the likeliest first. Of the others
        none where there are too few lines (`is_looked_at`).

    Raises
    ------
    SolverError
        If the model cannot be reduced.
    """
    frf = with_variance(part.frf, noise)
    seen = shown_by(frf)
    for one in seen:
        if one.fault.written:
            frf = one.fault.repair(frf)
    stated = [finding_of(one, part.name) for one in seen]
    whole = part.with_data(frf)
    if not is_looked_at(whole):
        return stated
    part, held = widened(whole.thinned(_LINES))
    stage = stage_of(part)
    known = [np.concatenate([x, held]) for x in points]
    explained = _explained(part, whole, stage, known, stated, noise)
    aside = set_aside(seen, part.frf)
    symptoms = explained.findings and aside is not part.frf
    if symptoms and explained.left_of(part.frf) > _EXPLAINED:
        # Perhaps the values of a symptom are wrong by themselves, and other faults imitate that.
        by_itself = _explained(part.with_data(aside), whole, stage, known, stated, noise)
        if explained.left_of(aside) > _WORSE * by_itself.left_of(aside):
            explained = by_itself
    freed = replace(explained.part.frf, variance=part.frf.variance)
    left = still_shown(seen, frf, explained.findings, (part.frf, freed))
    return [finding_of(one, part.name) for one in left] + list(explained.findings)


@dataclass(frozen=True, slots=True, eq=False)
class _Explained:
    """What model and data show together: findings, the part without them, and where its fit ended.

    The end is None where nothing was found.
    """

    findings: tuple[Finding, ...]
    part: Part
    stage: Stage
    end: _Real | None

    def left_of(self, frf: FRF) -> float:
        """Return the mean square of the remaining misfit of the data that count in others."""
        part = self.part.with_data(replace(self.part.frf, variance=frf.variance))
        begin = damped(part, part.coordinates.home) if self.end is None else self.end
        trial = tried(self.stage.near(part, [begin]), None, [begin])
        return np.inf if trial is None else trial.power


def _explained(
    part: Part,
    whole: Part,
    stage: Stage,
    points: Sequence[_Real],
    stated: Sequence[Finding],
    noise: NoiseModel,
) -> _Explained:
    """Return the faults that model and data show together; sizes are of the whole of the data."""
    findings: list[Finding] = []
    end: _Real | None = None
    for _ in range(_MOST):
        known = points if end is None else [end]
        found = _likeliest(part, stage, known, [*stated, *findings])
        if not found:
            break
        best = found[0]
        sized = _sized(part, whole, stage, best, noise)
        findings.append(_finding([sized, *found[1:]], part.name))
        if sized.fault.written:
            whole = whole.with_data(sized.fault.repair(whole.frf))
        end = best.trial.x
        there = replace(stage.near(part, [end]), frf=part.frf)
        part = replace(best.fault.accounted(there, end), solver=part.solver)
    return _Explained(tuple(findings), part, stage, end)


def _sized(part: Part, whole: Part, stage: Stage, found: _Found, noise: NoiseModel) -> _Found:
    """Return the fault by its size on all lines, what nobody seeks being held as by an update.

    It stays as it was found where the data contradict what is held.
    """
    fault, x = found.fault, found.trial.x[: len(whole.coordinates.home)]
    if fault.adapts and fault.written:
        with suppress(SolverError):
            there = stage.near(whole, [found.trial.x])
            return replace(found, fault=fault.settled(there, x))
    if not (fault.tunes and fault.written) or fault.adapts or fault.leaves_out:
        return found
    there = stage.near(whole, [found.trial.x])
    trial = tried(there, fault, [x])
    if trial is None or trial.fault is None:
        return found
    trial = tried(_as_likely(there, trial, noise), trial.fault, [trial.x])
    if trial is None or trial.fault is None:
        return found
    here = _as_likely(stage.near(part, [found.trial.x]), found.trial, noise)
    before = log_misfit(*_freed(here, found.trial))[0]
    if trial.power > _AS_WELL * float(np.mean(np.abs(before) ** 2)):
        return found
    return replace(found, fault=trial.fault)


def _freed(part: Part, trial: Trial) -> tuple[NDArray[np.complex128], FRF]:
    """Return model and data where a trial ended, without the fault."""
    assert trial.fault is not None
    freed = trial.fault.accounted(part, trial.x)
    return freed.responses(trial.x), freed.frf


def _as_likely(part: Part, trial: Trial, noise: NoiseModel) -> Part:
    """Return the part with its data weighed by the noise that a trial leaves of them."""
    H, frf = _freed(part, trial)
    variance = noise.refit(H, frf, part.n).variance(H, frf)
    size = np.abs(part.frf.values) / np.maximum(np.abs(frf.values), np.finfo(float).tiny)
    return replace(part, frf=replace(part.frf, variance=size**2 * as_likely(H, frf, variance)))


def _likeliest(
    part: Part, stage: Stage, points: Sequence[_Real], stated: Sequence[Finding]
) -> list[_Found]:
    """Return the likeliest fault, and those that cannot be told from it; empty where none is."""
    home = part.coordinates.home
    here = stage.near(part, [home, *points])
    for _ in range(_SETTLED):
        start = damped(here, home)
        without = tried(here, None, [*points, start])
        if without is None:
            return []
        here, without = _settled(part, here, stage, without)
        fresh = _worth_a_trial(here, without, start, stated)
        ranked = _ranked(here, fresh, without)
        if not _stands(ranked):
            return []
        there = stage.near(part, [ranked[0].trial.x])
        if there.solver is here.solver:
            break
        here, without = there, tried(there, None, [without.x]) or without
        alike = [one for one in ranked if one.log_odds > ranked[0].log_odds - 2.0 * _ALIKE_ODDS]
        ranked = _ranked(here, [(one.fault, one.trial.x) for one in alike[:_KEPT]], without)
        if _stands(ranked):
            break
        # It was an error of the model, which is now smaller.
    if not _stands(ranked):
        return []
    assert without is not None
    # What freed the unknowns from a poor minimum may not have been the fault.
    better = tried(here, None, [ranked[0].trial.x])
    lost = max(better.gain(without), 0.0) if better is not None else 0.0
    if ranked[0].log_odds - lost < LIKELY:
        return []
    return [one for one in ranked if _is_as_likely(one, ranked[0])]


def _is_as_likely(one: _Found, best: _Found) -> bool:
    """Return whether the data do not tell a fault from the likeliest.

    A sensor of another state is described by one factor on all stiffnesses. How well that holds
    does not say which of two sensors it is.
    """
    of_a_state = one.fault.leaves_out and best.fault.leaves_out
    if of_a_state and min(one.explains, best.explains) > 1.0 - _LEFT[1]:
        return True
    return one.log_odds > best.log_odds - _ALIKE_ODDS


def _stands(ranked: Sequence[_Found]) -> bool:
    return bool(ranked) and ranked[0].log_odds >= LIKELY


def _settled(part: Part, here: Part, stage: Stage, trial: Trial) -> tuple[Part, Trial]:
    """Return the part with a model that holds where a trial without a fault ends, and that end.

    Far from the data, any model around the start will do, and any end.
    """
    for _ in range(_SETTLED):
        if trial.power > _SMALL**2:
            break
        before, here = here, stage.near(part, [trial.x])
        gross = trial.power > _GROSS**2
        further = tried(here, None, [trial.x], glance=gross) or trial
        done = further.power > _ARRIVED * trial.power and here.solver is before.solver
        trial = further
        if done:
            break
    return here, trial


def _ranked(part: Part, fresh: Sequence[_Begun], without: Trial) -> list[_Found]:
    """Return the faults that are worth a word after a fit of each, the likeliest first."""
    ends: dict[tuple[str, tuple[str, ...]], Trial] = {}
    waiting = deque(fresh)
    noise: Trial | None = None
    while waiting:
        fault, x = waiting.popleft()
        key = (fault.kind, fault.channels)
        trial = tried(part, fault, [x], rival=noise)
        if trial is None or trial.fault is None:
            continue
        if key not in ends or trial.gain(ends[key]) > 0.0:
            ends[key] = trial
            waiting += [(other, trial.x) for other in trial.fault.relatives(part.frf)]
            if _is_noise(trial):
                noise = trial
    return list(filter(_is_worth_a_word, _compared(ends.values(), without)))


def _compared(ends: Iterable[Trial], without: Trial) -> list[_Found]:
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
        log_odds = gain + float(np.log(end.fault.odds))
        out.append(_Found(end, end.fault, log_odds, _share(end, without, explained)))
    return sorted(out, key=lambda one: -one.log_odds)


def _is_worth_a_word(found: _Found) -> bool:
    """Return whether a fault explains a good part of the misfit, or all of it that is not noise.

    Then the data by themselves have to make it likely, and not the residual against a model.
    """
    left = found.trial
    by_data = 0.5 * left.n_values * found.explains + float(np.log(found.fault.odds))
    return found.explains >= _WORTH or (_is_noise(left) and by_data >= LIKELY)


def _is_noise(trial: Trial) -> bool:
    """Return whether the residual of a trial is noise."""
    return trial.alike < _WHITE and trial.power < _NOISY**2


def _covers(finding: Finding, fault: Fault) -> bool:
    """Return whether a fault needs no further word beside a finding."""
    kind = CAUSES[finding.kind]
    same = finding.kind == fault.kind or kind.leaves_out
    return (same and finding.channels == fault.channels) or fault.kind in kind.blurs


def _share(trial: Trial, without: Trial, explained: float) -> float:
    """Return the share of the misfit, or of the unknowns' way, that a fault explains.

    The way counts where it was farther than models are off; of what is held of the model, whose
    spread is known, where the fault brings a good part of it back.
    """
    # What has no size of its own does not do it by chance.
    known = trial.fault is not None and not trial.fault.tunes
    if known and without.far > _FAR_OFF**2 * len(without.x):
        explained = max(explained, 1.0 - trial.far / without.far)
    if without.far_held > _FAR_OFF**2 * without.n_held:
        back = 1.0 - trial.far_held / without.far_held
        if back > _BACK:
            explained = max(explained, back)
    return explained


def _worth_a_trial(
    part: Part, without: Trial, start: _Real, stated: Sequence[Finding]
) -> list[_Begun]:
    """Return the faults that are worth a whole fit, the likeliest first.

    Where the residual without a fault is small, they are those that promise a better fit there.
    Else a few steps of each from several points tell, the most promising first; once one explains
    all data, only those are looked at that explain as much where it ended.
    """

    def fresh(scores: Iterable[_Score]) -> list[_Score]:
        return [one for one in scores if not any(_covers(known, one.fault) for known in stated)]

    if without.power < _SMALL**2 and without.alike < _ALIKE:
        scores = _scored(part, without.x, promising=True)
        found = fresh(_suspected([one for one in scores if one.gain >= _PROMISED]))
        if len(found) <= _KEPT:
            return [(one.fault, one.x) for one in found]
        return _ahead([end for one in found if (end := _glanced(part, one))], without)
    points = [start, without.x]
    with suppress(SolverError):
        points.append(robust_point(part, start))
    by_point = [_scored(part, x) for x in points]
    found = [one for one in by_point[0] if one.fault.changes_all]
    for scores in by_point:
        found += [one for one in _suspected(scores) if one not in found]
    tries = sorted(fresh(found), key=lambda one: -one.log_evidence)
    # What changes all data promises little to first order, and much where its fit ends.
    tries[1:] = sorted(tries[1:], key=lambda one: not one.fault.changes_all)
    ends: list[Trial] = []
    for score in tries:
        end = _glanced(part, score)
        if end is None or end.fault is None:
            continue
        ends.append(end)
        if _explains_all(end, without):
            rivals = fresh(_as_good(part, end))
            return [(end.fault, end.x), *((one.fault, one.x) for one in rivals)]
    return _ahead(ends, without)


def _glanced(part: Part, score: _Score) -> Trial | None:
    """Return where a trial has come after a few steps."""
    return tried(part, score.fault, [score.x], glance=True)


def _explains_all(end: Trial, without: Trial) -> bool:
    """Return whether a fault explains all but noise, so that only others like it may compete."""
    assert end.fault is not None
    if end.fault.changes_all:
        return end.power < _LEFT[0] * without.power
    return end.alike < _ALIKE and end.power < min(_NOISY**2, _LEFT[1] * without.power)


def _ahead(ends: Sequence[Trial], without: Trial) -> list[_Begun]:
    """Return the likeliest of some trials, the best first, with the points to go on from."""
    return [(one.fault, one.trial.x) for one in _compared(ends, without)[:_KEPT]]


def _as_good(part: Part, end: Trial) -> list[_Score]:
    """Return other faults that explain the data as well where a trial ended, to first order."""
    assert end.fault is not None
    key = (end.fault.kind, end.fault.channels)
    scores = _suspected(_scored(part, end.x))
    own = [one.gain for one in scores if one.key == key]
    if not own:
        return []
    return [one for one in scores if one.gain > own[0] - _IN_REACH and one.key != key]


@dataclass(frozen=True, slots=True, eq=False)
class _Score:
    """What a fault promises at a point, to first order.

    Attributes
    ----------
    fault : Fault
        By its best size there.
    x : ndarray of float, shape (n,)
        The point.
    gain : float
        Logarithm of the odds that the data have it.
    log_evidence : float
        The same, comparable between points.
    """

    fault: Fault
    x: _Real
    gain: float
    log_evidence: float

    @property
    def key(self) -> tuple[str, tuple[str, ...]]:
        """What is wrong where, whatever its size."""
        return self.fault.kind, self.fault.channels


def _suspected(scores: Iterable[_Score]) -> list[_Score]:
    """Return the faults of those scored at a point that promise most, few of each kind."""
    chosen: list[_Score] = []
    for score in scores:
        if any(score.key == other.key for other in chosen):
            continue
        if sum(other.fault.kind == score.fault.kind for other in chosen) < _OF_A_KIND:
            chosen.append(score)
        if len(chosen) == _REFITTED:
            break
    return chosen


def _scored(part: Part, x: _Real, *, promising: bool = False) -> list[_Score]:
    """Return what the faults promise at a point, best first.

    Parameters
    ----------
    part : Part
        Model and data.
    x : ndarray of float, shape (n,)
        The point.
    promising : bool
        Whether the residual there is nearly noise, so that the evidence counts.
    """
    try:
        evidence = Evidence(part, x)
        without, _ = fitted(evidence, None)
    except SolverError:
        return []
    weighs = promising and bool(held_of(part).any())
    unheld = _log_evidence(evidence, None) if weighs else 0.0
    scores: list[_Score] = []
    for kind in CAUSES:
        for fault in CAUSES[kind].suspected(evidence):
            try:
                cost, tuned = fitted(evidence, fault)
            except SolverError:  # a resonance without damping, under that hypothesis
                continue
            if tuned is None or not tuned.plausible():
                continue
            gain = 0.5 * (without - cost)
            if weighs and fault.tunes:
                gain = max(gain, _log_evidence(evidence, tuned) - unheld)
            gain += float(np.log(fault.odds))
            gain -= 0.5 * fault.numbers(part.frf) * float(np.log(2 * part.n_values))
            scores.append(_Score(tuned, x, gain, gain - 0.5 * without))
    return sorted(scores, key=lambda one: -one.gain)


def _log_evidence(evidence: Evidence, fault: Fault | None) -> float:
    """Return the evidence near a point where the residual is noise, to first order."""
    frf = slope = None
    if fault is not None:
        frf, slope = fault.undo(evidence), fault.slope(evidence)
    quadratic = Quadratic.at(evidence, frf, slope)
    return quadratic.best(quadratic.n_values, evidence.unit**2)[1].log_evidence


def _finding(found: Sequence[_Found], test: str) -> Finding:
    best, *others = found
    fault = best.fault
    statement = fault.statement()
    if others:
        also = " or ".join(one.fault.statement().rstrip(".") for one in others[:_NAMED])
        statement += f" These data do not tell that from another cause: {also}."
    return Finding(
        fault.kind,
        fault.channels,
        fault.value,
        float(np.exp(min(best.log_odds, 700.0))),
        best.explains,
        statement,
        fault.remedy,
        fault.written,
        tuple(one.fault.written for one in others),
        test,
    )
