"""Reduced models for the selection, and screening of very many candidates.

The most informative candidates at some lines of a reduced model are kept: references, as if a
sample of all responses were measured, then responses for these. Half of the places after those of
greedy layouts go to the next best in greedy selection, the others to the best separate ones.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from updyn.arrays import IndexArray, RealArray
from updyn.dofs import DofSet
from updyn.dynamics.reduction import Reduction, VectorsPerState
from updyn.planning.criteria import Criterion, Planning
from updyn.planning.information import Candidates, PairInformation
from updyn.planning.settings import CANDIDATE_REDUCTION, SCREENING
from updyn.updating.problem.optimal_design import DesignScore, select_greedily
from updyn.updating.problem.session import Record

__all__ = ["is_many", "reduce_candidates", "screen_candidates"]


def is_many(candidates: Candidates) -> bool:
    """Return whether the number of candidates requires screening."""
    return len(candidates.responses) * len(candidates.references) > SCREENING.most_pairs


def screen_candidates(
    candidates: Candidates,
    points: Sequence[RealArray],
    rule: Criterion,
    wanted: tuple[int, ...],
    counts: tuple[int, int],
) -> Candidates:
    """Return the most informative candidates, with the level of the noise, in a reduced model.

    The first of the `points` is the start of the parameters; `counts` are the numbers of responses
    and references to select.
    """
    solver = _build_reduction(candidates, points).solver()
    rows = np.arange(len(candidates.responses))
    columns = np.arange(len(candidates.references))
    some_rows, some_columns = (
        _sample_dofs(candidates.responses),
        _sample_dofs(candidates.references),
    )
    rough = replace(candidates, reduced=solver)
    rough = rough.with_level(rough.select(rows, some_columns))
    least = SCREENING.least_responses, SCREENING.least_references
    kept = [
        max(few, SCREENING.kept_per_selected * count)
        for few, count in zip(least, counts, strict=True)
    ]
    few = rough.at_lines(_spread_lines(candidates.freq, SCREENING.lines))
    start_point = points[:1]

    sampled = few.select(some_rows, columns)
    information = PairInformation.compute(sampled, start_point)
    score = rule.score(Planning(sampled, information, wanted))
    items = information.of_references(range(len(some_rows)))
    columns = _select_best(items, information.before, kept[1], score)

    sampled = few.select(rows, columns)
    information = PairInformation.compute(sampled, start_point)
    score = rule.score(Planning(sampled, information, wanted))
    rows = _select_responses(information, counts, kept[0], score)

    chosen = reduce_candidates(replace(rough.select(rows, columns), reduced=None), points)
    return chosen if chosen.reduced is None else chosen.without_weak()


def _select_responses(
    information: PairInformation, counts: tuple[int, int], kept: int, score: DesignScore
) -> IndexArray:
    """Return indices of responses: of layouts from several references, then the best of all."""
    # For each reference the layout that greedy selection reaches from it, the best layouts first.
    n_i, n_j = information.shape
    if n_i <= kept:
        return np.arange(n_i)
    before = np.broadcast_to(information.before, information.points_shape)
    alone = information.of_references(range(n_i))
    firsts = np.argsort(-score.score(alone + before), kind="stable")[: SCREENING.layouts]
    layouts: list[tuple[float, list[int]]] = []
    for first in firsts.tolist():
        others = np.setdiff1d(np.arange(n_j), [first])
        order, _ = select_greedily(alone[others], before + alone[first], counts[1] - 1, score)
        items = information.of_responses([first, *others[order].tolist()])
        rows, total = select_greedily(items, before, counts[0], score)
        layouts.append((float(score.score(total)), rows))
    layouts.sort(key=lambda layout: -layout[0])
    of_layouts = list(dict.fromkeys(itertools.chain(*(rows for _, rows in layouts))))[:kept]
    remaining = np.setdiff1d(np.arange(n_i), of_layouts)
    items = information.of_responses(range(n_j))
    more = remaining[
        _select_best(items[remaining], information.before, kept - len(of_layouts), score)
    ]
    return np.union1d(of_layouts, more)


def _build_reduction(candidates: Candidates, points: Sequence[RealArray]) -> Reduction:
    """Return an approximate reduction between all candidates and around all points."""
    part, dofs = candidates.part, candidates.model.dofs
    freq = candidates.freq
    reduction = Reduction(
        part.solver.system,
        dofs.match(candidates.responses).index,
        dofs.match(candidates.references).index,
        (float(freq[0]), float(freq[-1])),
        part.solver.backend,
        CANDIDATE_REDUCTION.most_error,
        poll=part.session.check,
    )
    states = [part.state(x) for x in points]
    often = -(-CANDIDATE_REDUCTION.least_states // len(states))
    vectors = VectorsPerState(
        CANDIDATE_REDUCTION.shifts,
        CANDIDATE_REDUCTION.depth,
        CANDIDATE_REDUCTION.combinations,
        lossy=False,
    )
    reduction.build_around(states * often, across=vectors)
    return reduction


def reduce_candidates(candidates: Candidates, points: Sequence[RealArray]) -> Candidates:
    """Return the candidates in a reduced model that is accurate at all points, if possible."""
    part = candidates.part
    if part.solver.system.n <= CANDIDATE_REDUCTION.most_exact_dofs:
        return candidates
    reduction = _build_reduction(candidates, points)
    states = [part.state(x) for x in points]
    reduction.compress_around(states, candidates.freq, CANDIDATE_REDUCTION.dropped_energy_root)
    error = max(_certify_error(candidates, reduction, x) for x in points)
    if error > CANDIDATE_REDUCTION.most_error:
        return candidates
    return replace(candidates, reduced=reduction.solver(), error=error)


def _certify_error(candidates: Candidates, reduction: Reduction, x: RealArray) -> float:
    """Return the certified error of a reduced model at a point, relative to each line's largest."""
    part = candidates.part
    lines = _spread_lines(candidates.freq, CANDIDATE_REDUCTION.certified_lines)

    def compute() -> Record:
        part.session.check()
        return (np.array(reduction.certify(part.state(x), lines).error),)

    return float(part.session.recall(candidates.key("error", x), compute)[0])


def _spread_lines(freq: RealArray, count: int) -> RealArray:
    """Return evenly spaced lines, including the first and the last."""
    return np.asarray(freq[np.unique(np.linspace(0, len(freq) - 1, count).astype(int))])


def _sample_dofs(dofs: DofSet) -> IndexArray:
    """Return indices of evenly spaced DOFs, of translations and of rotations."""
    is_turned = dofs.axes >= 3
    found = []
    for indices in (np.flatnonzero(~is_turned), np.flatnonzero(is_turned)):
        if indices.size:
            count = min(SCREENING.sampled_dofs, indices.size)
            found.append(indices[np.linspace(0, indices.size - 1, count).astype(int)])
    return np.sort(np.concatenate(found))


def _select_best(items: RealArray, before: RealArray, count: int, score: DesignScore) -> IndexArray:
    """Return indices of items: half by greedy selection, the rest the best separate ones."""
    if len(items) <= count or not count:
        return np.arange(min(len(items), count))
    total = np.broadcast_to(before, items.shape[1:])
    chosen, _ = select_greedily(items, total, count // 2, score)
    alone = score.score(items + before)
    alone[chosen] = np.inf
    return np.sort(np.argsort(-alone, kind="stable")[:count])
