"""Search for the faults that explain a misfit, from model, data and unknowns."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from updyn.errors import SolverError
from updyn.frf import FRF
from updyn.updating.judge.causes.candidates import KEPT, SMALL, Begun, candidates, is_small
from updyn.updating.judge.causes.data_alone import (
    finding_of,
    mask_symptoms,
    shown_by,
    still_shown,
    unexpected,
    with_variance,
)
from updyn.updating.judge.causes.evidence import Evidence, compute_spread
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.judge.causes.halves import compare_band_halves
from updyn.updating.judge.causes.misfit import SEEN, Weighed, log_misfit
from updyn.updating.judge.causes.model_unit import ModelUnit
from updyn.updating.judge.causes.other_model import OtherModel
from updyn.updating.judge.causes.promising import list_other_models
from updyn.updating.judge.causes.ranking import (
    FAR_OFF,
    Ranked,
    compared,
    is_as_likely,
    is_in_reach,
    is_worth_a_word,
)
from updyn.updating.judge.causes.reduced import Stage, stage_of
from updyn.updating.judge.causes.shown import LIKELY
from updyn.updating.judge.causes.trial import (
    MOST_ALIKE,
    Trial,
    adapt_losses,
    damped,
    tried,
    widened,
)
from updyn.updating.judge.causes.wrong_axes import WrongAxes
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import Part

__all__ = ["diagnosed", "strained", "unseen", "weighed"]

_Real = NDArray[np.float64]

#: Number of lines in the search.
_LINES = 60
#: Number of other causes that a statement names.
_NAMED = 2
#: Largest number of refinements of the model for one decision.
_SETTLED = 3
#: Share of the previous misfit above which a further fit has converged.
_ARRIVED = 0.9
#: Rounds in which a fault is tried at further places, and the number of places at each point.
_ROUNDS, _NEXT = 3, 3
#: Difference between the sizes of a fault in the two halves of the band, in standard deviations,
#: above which they contradict each other: 0.3 % of normal errors are larger.
_CONTRADICT = 3.0
#: Largest number of faults of one test.
_MOST = 3
#: Ratio of two mean square errors up to which both sizes fit equally well.
_AS_WELL = 1.2
#: Smallest number of lines for a search for causes.
_FEWEST = 8
#: Log misfit (rms) above which fits are cut short and findings are not reported.
_GROSS = 0.5
#: Number of units of a model that are fitted, and the largest number of DOFs for which they are
#: tried.
_FOLLOWED, _MOST_DOFS = 2, 20_000
#: Mean square of the misfit below which the faults found explain all data.
_EXPLAINED = 1e-3
#: Ratio of the mean square of the misfit to that without the values of a symptom, above which the
#: faults found do not explain the symptom.
_WORSE = 1.5


def strained(part: Part, x: _Real) -> bool:
    """Return whether the unknowns moved farther from their start than models are usually off.

    The data may then be explained and still be wrong by a common factor.
    """
    own = part.coordinates
    off = ((x - own.home) / compute_spread(part))[own.parameters.is_factor]
    return bool(off.size and np.sqrt(np.mean(off**2)) > FAR_OFF)


def unseen(part: Part, noise: NoiseModel) -> str:
    """Return why the data of a test do not permit a search for causes; empty if they do.

    The search needs lines with a value above the noise. Without such lines, any factor that moves
    the data below the noise would explain everything.
    """
    if part.n_lines < _FEWEST:
        return f"causes were not searched for, because {part.n_lines} lines are too few"
    clear = np.abs(part.frf.values) > SEEN * np.sqrt(noise.beforehand(part.frf))
    n_clear = int(clear.any(axis=(1, 2)).sum())
    if n_clear < _FEWEST:
        lost = f"{part.n_lines - n_clear} of {part.n_lines} lines"
        return f"causes were not searched for, because no value is above the noise at {lost}"
    return ""


def diagnosed(part: Part, noise: NoiseModel, points: Sequence[_Real] = ()) -> list[Finding]:
    """Return the faults of one test: those visible in the data alone, then the others by odds.

    `points` are ends of fits, used in addition to the start of the unknowns. If the data are not
    sufficient (`unseen`), only the former are returned.

    Raises
    ------
    SolverError
        If the model cannot be reduced.
    """
    frf = with_variance(part.frf, noise)
    seen = unexpected(shown_by(frf), part)
    for one in seen:
        if one.fault.repair_text:
            frf = one.fault.repair(frf)
    stated = [finding_of(one, part.name) for one in seen]
    whole = part.with_data(frf)
    if unseen(whole, noise):
        return stated
    part, held = widened(whole.thinned(_LINES))
    stage = stage_of(part)
    known = [np.concatenate([x, held]) for x in points]
    explained = _explained(part, whole, stage, known, stated, noise)
    aside = mask_symptoms(seen, part.frf)
    symptoms = explained.findings and aside is not part.frf
    remaining = explained.remaining(part.frf)
    if symptoms and (remaining is None or remaining.power > _EXPLAINED):
        # The values of a symptom may be wrong on their own, and other faults may imitate them.
        by_itself = _explained(part.with_data(aside), whole, stage, known, stated, noise)
        apart = by_itself.remaining(aside)
        if apart is not None and explained.left_of(aside) > _WORSE * apart.power:
            explained, remaining = by_itself, apart
    if remaining is not None and explained.power_of_seen(part.frf, remaining) > _GROSS**2:
        # Model and data differ too much for the likeliest fault to be meaningful.
        return stated + _in_other_units(part, remaining)
    freed = _counted(explained.part.frf, part.frf)
    left = still_shown(seen, frf, explained.findings, (part.frf, freed))
    return [finding_of(one, part.name) for one in left] + list(explained.findings)


@dataclass(frozen=True, slots=True, eq=False)
class _Explained:
    """Findings from model and data, the corrected part, its models and the end of the fit.

    `end` is None without a finding.
    """

    findings: tuple[Finding, ...]
    part: Part
    stage: Stage
    end: _Real | None

    def remaining(self, frf: FRF) -> Trial | None:
        """Return a fit to the corrected data with the weights of `frf`; None without a solution."""
        part = self.part.with_data(_counted(self.part.frf, frf))
        begin = damped(part, part.coordinates.home) if self.end is None else self.end
        return tried(self.stage.near(part, [begin]), None, [begin])

    def power_of_seen(self, frf: FRF, trial: Trial) -> float:
        """Return the mean square residual of the values above the noise.

        A fault that raises the noise of one sensor, or the level of all data, hides the others.
        """
        part = self.part.with_data(_counted(self.part.frf, frf))
        part = self.stage.near(part, [trial.x])
        misfit, weight = log_misfit(part.responses(trial.x), part.frf)
        seen = max(float(np.sum(weight**2)), np.finfo(float).tiny)
        return float(np.sum(np.abs(misfit) ** 2)) / seen

    def left_of(self, frf: FRF) -> float:
        """Return the mean square residual of the fit with the weights of `frf`."""
        trial = self.remaining(frf)
        return np.inf if trial is None else trial.power


def _counted(freed: FRF, frf: FRF) -> FRF:
    """Return corrected data in which only the values with weight in `frf` have weight.

    Their variance is that of the corrected values: the noise of a sensor of another quantity is
    scaled with its values.
    """
    assert freed.variance is not None
    assert frf.variance is not None
    # A variance above the square of the largest value marks a value without weight.
    without, left_out = (v.variance > np.abs(v.values).max() ** 2 for v in (frf, freed))
    return replace(freed, variance=np.where(without | left_out, frf.variance, freed.variance))


def _in_other_units(part: Part, without: Trial) -> list[Finding]:
    """Return the unit in which the model explains data with which it has nothing in common."""
    if part.solver.system.n > _MOST_DOFS:
        return []
    begin = damped(part, part.coordinates.home)
    first: list[tuple[float, ModelUnit]] = []
    for fault in ModelUnit.list_mistakes():
        there = part.with_data(fault.convert_data(part.frf)).thinned(_FEWEST)
        with suppress(SolverError):
            misfit = log_misfit(there.responses(begin), there.frf)[0]
            first.append((float(np.mean(np.abs(misfit) ** 2)), fault))
    first.sort(key=lambda one: one[0])
    ends: list[tuple[Trial, ModelUnit]] = []
    for _, fault in first[:_FOLLOWED]:
        there = part.with_data(fault.convert_data(part.frf))
        with suppress(SolverError):
            trial = tried(stage_of(there).near(there, [begin]), None, [begin])
            if trial is not None and trial.power < _GROSS**2:
                ends.append((trial, fault))
    if not ends:
        return []
    trial, fault = min(ends, key=lambda one: one[0].power)
    log_odds = trial.gain(without) + float(np.log(fault.odds))
    share = 1.0 - trial.power / without.power
    return [_finding([Ranked(trial, fault, log_odds, share, share)], part.name)]


def _explained(
    part: Part,
    whole: Part,
    stage: Stage,
    points: Sequence[_Real],
    stated: Sequence[Finding],
    noise: NoiseModel,
) -> _Explained:
    """Return the faults that model and data show together; their sizes are fitted to all lines."""
    findings: list[Finding] = []
    end: _Real | None = None
    others = list_other_models(part)
    for _ in range(_MOST):
        known = points if end is None else [end]
        found = _likeliest(part, stage, others, known, [*stated, *findings], noise)
        if not found:
            break
        best = found[0]
        sized = _sized(part, whole, stage, best, noise)
        findings.append(_finding([sized, *found[1:]], part.name))
        end = best.trial.x
        if isinstance(best.fault, WrongAxes) and best.fault.other is not None:
            other = best.fault.other
            part, whole, stage = other.instead(part), other.instead(whole), other.stage
            others = list_other_models(part)
            continue
        whole = _freed_whole(whole, stage, sized.fault, end)
        there = replace(stage.near(part, [end]), frf=part.frf)
        # A fault that adapts is subtracted as fitted to all lines; its error on a few lines would
        # look like other faults.
        fault = sized.fault if best.fault.is_adaptive else best.fault
        part = replace(fault.prepare_next_search(there, end), solver=part.solver)
    return _Explained(tuple(findings), part, stage, end)


def _freed_whole(whole: Part, stage: Stage, fault: Fault, x: _Real) -> Part:
    """Return the part with all lines, corrected for a fault if possible."""
    if fault.repair_text:
        return whole.with_data(fault.repair(whole.frf))
    if fault.alters_model:
        there = replace(stage.near(whole, [x]), frf=whole.frf)
        with suppress(SolverError):
            freed = fault.prepare_next_search(there, x[: len(whole.coordinates.home)])
            return replace(freed, solver=whole.solver)
    return whole


def _sized(part: Part, whole: Part, stage: Stage, found: Ranked, noise: NoiseModel) -> Ranked:
    """Return the fault with its size fitted to all lines, with held quantities at their values.

    The fault is unchanged if the data contradict the held values.
    """
    fault, x = found.fault, found.trial.x[: len(whole.coordinates.home)]
    if fault.is_adaptive and fault.repair_text:
        with suppress(SolverError):
            there = stage.near(whole, [found.trial.x])
            return replace(found, fault=fault.fit_all_data(there, x))
    sizes = fault.has_free_size and (fault.repair_text or fault.alters_model)
    if not sizes or fault.is_adaptive or fault.omits_channels:
        return found
    there = stage.near(whole, [found.trial.x])
    trial = tried(there, fault, [x])
    if trial is None or trial.fault is None:
        return found
    trial = tried(weighed(there, trial, noise), trial.fault, [trial.x])
    if trial is None or trial.fault is None:
        return found
    here = stage.near(part, [found.trial.x])
    known = noise.refit(*_freed(here, found.trial), part.n)
    if _error(there, trial, known) > _AS_WELL * _error(here, found.trial, known):
        return found
    return replace(found, fault=trial.fault)


def _error(part: Part, trial: Trial, noise: NoiseModel) -> float:
    """Return the mean square error at the end of a trial, in units of the given noise."""
    H, frf = _freed(part, trial)
    variance = np.maximum(noise.variance(H, frf), np.finfo(float).tiny)
    return float(np.mean(np.abs(frf.values - H) ** 2 / variance))


def _freed(part: Part, trial: Trial) -> tuple[NDArray[np.complex128], FRF]:
    """Return model and data at the end of a trial, corrected for its fault."""
    freed = part if trial.fault is None else trial.fault.correct_part(part, trial.x)
    return freed.responses(trial.x), freed.frf


def weighed(part: Part, trial: Trial, noise: NoiseModel) -> Part:
    """Return the part with data weighted by the noise estimated from the residual of a trial."""
    H, frf = _freed(part, trial)
    variance = noise.refit(H, frf, part.n).variance(H, frf)
    size = np.abs(part.frf.values) / np.maximum(np.abs(frf.values), np.finfo(float).tiny)
    relative = Weighed.near(H, frf, variance).relative
    return part.with_data(Weighed.of(part.frf, size**2 * variance, relative))


def _likeliest(
    part: Part,
    stage: Stage,
    others: Sequence[OtherModel],
    points: Sequence[_Real],
    stated: Sequence[Finding],
    noise: NoiseModel,
) -> list[Ranked]:
    """Return the likeliest fault and those that cannot be distinguished from it; may be empty."""
    home = part.coordinates.home
    here = stage.near(part, [home, *points])
    for _ in range(_SETTLED):
        start = damped(here, home)
        without = tried(here, None, [*points, start])
        if without is None:
            return []
        here, without = _settled(part, here, stage, without)
        if is_small(without):
            part = adapt_losses(part.with_data(weighed(here, without, noise).frf), without.x)
            here = stage.near(part, [without.x])
            without = tried(here, None, [without.x]) or without
        fresh = candidates(here, without, start, stated, others)
        ranked = _ranked(here, fresh, without)
        if not _stands(ranked):
            return []
        there = stage.near(part, [ranked[0].trial.x])
        if there.solver is here.solver:
            break
        here, without = there, tried(there, None, [without.x]) or without
        alike = [one for one in ranked if is_in_reach(one, ranked[0])]
        ranked = _ranked(here, [(one.fault, one.trial.x) for one in alike[:KEPT]], without)
        if _stands(ranked):
            break
        # The apparent fault was an error of the reduced model, which is now smaller.
    if not _stands(ranked):
        return []
    assert without is not None
    # The fit with the fault may only have helped the unknowns out of a poor minimum.
    better = tried(here, None, [ranked[0].trial.x, *_imitating(here, ranked[0])])
    if better is not None and better.gain(without) > 0.0:
        against = compared([one.trial for one in ranked], better)
        ranked = list(filter(is_worth_a_word, against))
    if not _stands(ranked):
        return []
    return [one for one in ranked if is_as_likely(one, ranked[0])]


def _imitating(part: Part, found: Ranked) -> list[_Real]:
    """Return the point at which the unknowns imitate a fault; empty if the fault has no size."""
    if not found.fault.has_free_size:
        return []
    evidence = Evidence(part, found.trial.x)
    try:
        change = np.asarray(found.fault.value * found.fault.slope(evidence), dtype=np.complex128)
        return [evidence.imitate_change(change)]
    except SolverError:
        return []


def _stands(ranked: Sequence[Ranked]) -> bool:
    return bool(ranked) and ranked[0].log_odds >= LIKELY


def _settled(part: Part, here: Part, stage: Stage, trial: Trial) -> tuple[Part, Trial]:
    """Return the part with a model valid at the end of a fit without a fault, and this fit.

    Far from the data, a model valid around the start and a short fit are sufficient.
    """
    for _ in range(_SETTLED):
        if trial.power > SMALL**2:
            break
        before, here = here, stage.near(part, [trial.x])
        gross = trial.power > _GROSS**2
        further = tried(here, None, [trial.x], glance=gross) or trial
        done = further.power > _ARRIVED * trial.power and here.solver is before.solver
        trial = further
        if done:
            break
    return here, trial


def _ranked(part: Part, fresh: Sequence[Begun], without: Trial) -> list[Ranked]:
    """Return the faults worth reporting after a fit of each, the likeliest first."""
    ends = _Ends(part)
    ends.try_all(fresh)
    best: Trial | None = None
    for _ in range(_ROUNDS):
        if ends.best is best:
            break
        best = ends.best
        ends.try_all(ends.list_other_places(fresh))
    return _consistent(part, compared(ends.found.values(), without))


def _consistent(part: Part, found: Sequence[Ranked]) -> list[Ranked]:
    """Return the faults worth reporting, except likely ones whose size depends on the band."""
    left = list(filter(is_worth_a_word, found))
    while _stands(left):
        likely = [one for one in left if is_as_likely(one, left[0])]
        wrong = [one for one in likely if _depends_on_band(part, one)]
        if not wrong:
            break
        left = [one for one in left if not any(one is other for other in wrong)]
    return left


def _depends_on_band(part: Part, found: Ranked) -> bool:
    """Return whether the two halves of the band contradict each other about the size of a fault."""
    fault, trial = found.fault, found.trial
    if not fault.has_constant_size:
        return False
    with suppress(SolverError):
        freed = Evidence(fault.correct_part(part, trial.x), trial.x)
        alike = min(max(trial.alike, 0.0), MOST_ALIKE)
        return compare_band_halves(freed, fault, alike) > _CONTRADICT
    return False


@dataclass(slots=True, eq=False)
class _Ends:
    """The best trial of each fault, and the last trial that leaves only noise."""

    part: Part
    found: dict[tuple[str, tuple[str, ...]], Trial] = field(default_factory=dict)
    noise: Trial | None = None

    def try_all(self, begun: Sequence[Begun]) -> None:
        """Try faults, and those with nearly the same effect."""
        waiting = deque(begun)
        while waiting:
            fault, x = waiting.popleft()
            key = (fault.kind, fault.channels)
            trial = tried(self.part, fault, [x], rival=self.noise)
            if trial is None or trial.fault is None:
                continue
            if key not in self.found or trial.gain(self.found[key]) > 0.0:
                self.found[key] = trial
                waiting += [
                    (other, trial.x) for other in trial.fault.list_similar_faults(self.part)
                ]
                if trial.is_noise:
                    self.noise = trial

    @property
    def best(self) -> Trial | None:
        """The trial with the smallest residual."""
        return min(self.found.values(), key=lambda one: one.power, default=None)

    def list_other_places(self, begun: Sequence[Begun]) -> list[Begun]:
        """Return the best fault at other places, the likeliest at several points.

        The points are the end of its trial and, if that does not leave only noise, the ends of the
        next best trials of its kind and the starting points of the trials of its kind.
        """
        best = self.best
        if best is None or best.fault is None:
            return []
        kind = best.fault.kind
        points = [best.x]
        if not best.is_noise:
            same = sorted((t.power, k[1]) for k, t in self.found.items() if k[0] == kind)
            points += [self.found[kind, channels].x for _, channels in same[1:_NEXT]]
            points += [x for fault, x in begun if fault.kind == kind]
        chosen: dict[tuple[str, ...], Begun] = {}
        for x in points:
            others: list[Fault] = []
            with suppress(SolverError):
                others = list(best.fault.list_other_places(Evidence(self.part, x)))
            if x is not best.x:
                others = [one for one in others if (kind, one.channels) not in self.found]
            new = [one for one in others if one.channels not in chosen]
            chosen |= {one.channels: (one, x) for one in new[:_NEXT]}
        return list(chosen.values())


def _finding(found: Sequence[Ranked], test: str) -> Finding:
    best, *others = found
    fault = best.fault
    statement = fault.statement()
    if others:
        also = " or ".join(one.fault.statement().rstrip(".") for one in others[:_NAMED])
        statement += f" These data do not distinguish this from another cause: {also}."
        tests = dict.fromkeys(one.fault.distinguishing_test for one in found[: _NAMED + 1])
        statement += "".join(f" {test}" for test in tests if test)
    return Finding(
        fault.kind,
        fault.channels,
        fault.value,
        float(np.exp(min(best.log_odds, 700.0))),
        best.explains,
        statement,
        fault.remedy,
        fault.repair_text,
        tuple(one.fault.repair_text or one.fault.name for one in others),
        test,
        best.of_misfit,
    )
