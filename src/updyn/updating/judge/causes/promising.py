"""Selection of the variants of a model that are fitted."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from updyn.arrays import RealArray
from updyn.errors import ModelError, SolverError
from updyn.settings import VARIANTS
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.other_model import CompiledVariant
from updyn.updating.judge.causes.score import FirstOrderModel
from updyn.updating.judge.causes.settings import CAUSE_CANDIDATES, CAUSE_ODDS
from updyn.updating.judge.causes.trial import Trial
from updyn.updating.judge.causes.wrong_axes import WrongAxes
from updyn.updating.problem.problem import FRFPart

__all__ = ["estimate_gain", "list_variants", "select_variants"]


def list_variants(part: FRFPart) -> list[CompiledVariant]:
    """Return the variants of the whole model of a part; empty for a large model."""
    if part.solver.system.n > VARIANTS.largest_model:
        return []
    return [CompiledVariant(part, variant) for variant in part.variants]


def select_variants(
    part: FRFPart, variants: Sequence[CompiledVariant], without: Trial, start: RealArray
) -> list[WrongAxes]:
    """Return the variants worth a fit from the start, the most promising first.

    `without` is the end of a fit of the unchanged model; `start` must not depend on the data.
    """
    faults = [WrongAxes(one.variant.groups, 0.0, one, len(variants)) for one in variants]
    if not faults or _is_needless(without, faults[0].prior):
        return []
    few = part.thin(CAUSE_CANDIDATES.variant_lines)
    found: list[tuple[float, WrongAxes]] = []
    for fault, one in zip(faults, variants, strict=True):
        part.session.check(often=True)
        with suppress(SolverError, ModelError):
            found.append((_compare_parts(few, one.replace_model(few), fault, start), fault))
    found.sort(key=lambda pair: -pair[0])
    best = max([0.0, *(gain for gain, _ in found)])
    least = best - CAUSE_CANDIDATES.reach_log_odds
    return [fault for gain, fault in found[: CAUSE_CANDIDATES.most_variants] if gain > least]


def estimate_gain(part: FRFPart, fault: WrongAxes, x: RealArray) -> float:
    """Return the logarithm of the odds of a variant at a point, to first order."""
    return _compare_parts(part, fault.correct_part(part, x), fault, x)


def _compare_parts(part: FRFPart, variant_part: FRFPart, fault: WrongAxes, x: RealArray) -> float:
    cost, variant_cost = (FirstOrderModel(Evidence(one, x)).cost for one in (part, variant_part))
    return 0.5 * (cost - variant_cost) + float(np.log(fault.prior))


def _is_needless(without: Trial, prior: float) -> bool:
    """Return whether no other model can be likely, because only noise remains near the start."""
    # Another model can gain at most half the squared distance of the unknowns from their start.
    return (
        without.is_noise
        and 0.5 * without.squared_distance + float(np.log(prior)) < CAUSE_ODDS.likely_log_odds
    )
