"""Expected gain by each fault at one point of the unknowns, to first order."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from updyn.arrays import RealArray
from updyn.errors import SolverError
from updyn.updating.judge.causes.catalogue import CAUSES
from updyn.updating.judge.causes.evidence import Evidence, find_held
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.score import FirstOrderFit, FirstOrderModel
from updyn.updating.judge.causes.settings import CAUSE_CANDIDATES
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
    fits: list[FirstOrderFit[Fault]] = []
    for kind in CAUSES:
        if not CAUSES[kind].applies_to(part.frf):
            continue
        for fault in CAUSES[kind].propose_faults(model.evidence):
            part.session.check(often=True)
            if fault.channels and model.evidence.noise_channels.issuperset(fault.channels):
                continue
            try:
                fit = model.fit(fault)
            except SolverError:  # a resonance without damping, under that hypothesis
                continue
            if fit.fault.is_plausible():
                fits.append(fit)
    gains = {id(one): 0.5 * (without - one.cost) for one in fits}
    sized = [one for one in fits if one.fault.has_free_size]
    if promising and sized and find_held(part).any():
        for one, log_evidence in zip(sized, _compare_evidence(model, sized).tolist(), strict=True):
            gains[id(one)] = max(gains[id(one)], log_evidence)
    found = []
    for one in fits:
        fault = one.fault
        cost = 0.5 * fault.count_parameters(part.frf) * np.log(max(model.evidence.n_values, 2))
        gain = gains[id(one)] + float(np.log(fault.prior) - cost)
        found.append(ScoredFault(fault, x, gain, gain - 0.5 * without))
    return sorted(found, key=lambda one: -one.gain)


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
