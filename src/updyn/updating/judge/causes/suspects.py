"""Expected gain by each fault at one point of the unknowns, to first order."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from updyn.arrays import RealArray
from updyn.errors import SolverError
from updyn.updating.judge.causes.catalogue import CAUSES
from updyn.updating.judge.causes.channel_costs import (
    compute_exchange_costs,
    compute_place_costs,
)
from updyn.updating.judge.causes.evidence import Evidence, find_held
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.score import Effect, FirstOrderFit, FirstOrderModel
from updyn.updating.judge.causes.settings import CAUSE_CANDIDATES, CAUSE_SEARCH
from updyn.updating.problem.problem import FRFPart

__all__ = ["ScoredFault", "score_faults", "select_likeliest"]


@dataclass(frozen=True, slots=True, eq=False)
class ScoredFault:
    """A fault of the best size at the point x, and the log odds that the data have it (`gain`).

    `log_evidence` is comparable between points.
    """

    fault: Fault
    x: RealArray
    gain: float
    log_evidence: float


def score_faults(part: FRFPart, x: RealArray, *, promising: bool = False) -> list[ScoredFault]:
    """Return the faults with their expected gain at a point, the best first.

    If `promising`, the residual there is nearly noise, and the evidence is meaningful.
    """
    model = FirstOrderModel(Evidence(part, x))
    try:
        without = model.cost
    except SolverError:
        return []
    costs: list[tuple[Fault, float]] = []
    sized: list[FirstOrderFit[Fault]] = []
    for kind in CAUSES.values():
        part.session.check(often=True)
        faults = _propose_faults(kind, model.evidence)
        if kind.exchanges_data or kind.moves_channel:
            costs += _compare_at_once(model, kind, faults)
            continue
        fits = [one for one in _fit_each(model, faults) if one.fault.is_plausible()]
        costs += [(one.fault, one.cost) for one in fits]
        sized += [one for one in fits if one.fault.has_free_size]
    gains = {id(fault): 0.5 * (without - cost) for fault, cost in costs}
    if promising and sized and find_held(part).any():
        for one, log_evidence in zip(sized, _compare_evidence(model, sized).tolist(), strict=True):
            gains[id(one.fault)] = max(gains[id(one.fault)], log_evidence)
    found = []
    for fault, _ in costs:
        cost = 0.5 * fault.count_parameters(part.frf) * np.log(max(model.evidence.n_values, 2))
        gain = gains[id(fault)] + float(np.log(fault.prior) - cost)
        found.append(ScoredFault(fault, x, gain, gain - 0.5 * without))
    return sorted(found, key=lambda one: -one.gain)


def _propose_faults(kind: type[Fault], evidence: Evidence) -> list[Fault]:
    """Return the faults of a kind that are worth testing, except those of channels of noise."""
    if not kind.applies_to(evidence.frf):
        return []
    noise = evidence.noise_channels
    return [
        one
        for one in kind.propose_faults(evidence)
        if not (one.channels and noise.issuperset(one.channels))
    ]


def _fit_each(model: FirstOrderModel, faults: Sequence[Fault]) -> Iterator[FirstOrderFit[Fault]]:
    """Yield the fits of faults that can be solved."""
    effects: list[Effect[Fault]] = []
    n_values = 0
    for fault in faults:
        model.evidence.part.session.check(often=True)
        with suppress(SolverError):  # a resonance without damping, under that hypothesis
            effects.append(model.find_effect(fault))
            n_values += effects[-1].misfit.size
        if n_values > CAUSE_SEARCH.together_values:
            yield from model.fit_all(effects)
            effects, n_values = [], 0
    yield from model.fit_all(effects)


def _compare_at_once(
    model: FirstOrderModel, kind: type[Fault], faults: Sequence[Fault]
) -> list[tuple[Fault, float]]:
    """Return faults of a kind whose costs are computed together, with these."""
    compute = compute_exchange_costs if kind.exchanges_data else compute_place_costs
    with suppress(SolverError):
        return list(zip(faults, compute(model, faults).tolist(), strict=True))
    return []


def select_likeliest(found: Iterable[ScoredFault]) -> list[ScoredFault]:
    """Return the most promising faults, the best first, with few of each kind."""
    chosen: list[ScoredFault] = []
    for one in found:
        if any(one.fault.key == other.fault.key for other in chosen):
            continue
        n_same = sum(other.fault.kind == one.fault.kind for other in chosen)
        if n_same < CAUSE_CANDIDATES.most_of_kind:
            chosen.append(one)
        if len(chosen) == CAUSE_CANDIDATES.most_tried:
            break
    return chosen


def _compare_evidence(model: FirstOrderModel, fits: Sequence[FirstOrderFit[Fault]]) -> RealArray:
    """Return the log evidence of faults at a point whose residual is noise, less that of none."""
    evidence = model.evidence
    found = []
    for quadratic in (model.approximate(), model.approximate(fits)):
        outcomes = [
            quadratic.evaluate_share(share, evidence.n_values, evidence.rms_misfit**2)
            for share in quadratic.std_shares
        ]
        found.append(np.max([one.log_evidence for one in outcomes], axis=0))
    return np.asarray(found[1] - found[0])
