"""Expected gain by each fault at one point of the unknowns, to first order."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from updyn.arrays import RealArray
from updyn.errors import SolverError
from updyn.updating.judge.causes.catalogue import CAUSES
from updyn.updating.judge.causes.evidence import Evidence, find_held
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.quadratic import QuadraticMisfit
from updyn.updating.judge.causes.score import fit_first_order
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
    try:
        evidence = Evidence(part, x)
        without, _ = fit_first_order(evidence, None)
    except SolverError:
        return []
    weighs = promising and bool(find_held(part).any())
    unheld = _log_evidence(evidence, None) if weighs else 0.0
    found: list[ScoredFault] = []
    for kind in CAUSES:
        if not CAUSES[kind].applies_to(part.frf):
            continue
        for fault in CAUSES[kind].propose_faults(evidence):
            part.session.check(often=True)
            if fault.channels and evidence.noise_channels.issuperset(fault.channels):
                continue
            try:
                cost, tuned = fit_first_order(evidence, fault)
            except SolverError:  # a resonance without damping, under that hypothesis
                continue
            if tuned is None or not tuned.is_plausible():
                continue
            gain = 0.5 * (without - cost)
            if weighs and fault.has_free_size:
                gain = max(gain, _log_evidence(evidence, tuned) - unheld)
            gain += float(np.log(fault.prior))
            gain -= (
                0.5 * fault.count_parameters(part.frf) * float(np.log(max(evidence.n_values, 2)))
            )
            found.append(ScoredFault(tuned, x, gain, gain - 0.5 * without))
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


def _log_evidence(evidence: Evidence, fault: Fault | None) -> float:
    """Return the log evidence near a point whose residual is noise, to first order."""
    frf = slope = None
    if fault is not None:
        frf, slope = fault.repair_with_model(evidence), fault.slope(evidence)
    quadratic = QuadraticMisfit.at_point(evidence, frf, slope)
    return quadratic.find_best_share(evidence.n_values, evidence.rms_misfit**2)[1].log_evidence
