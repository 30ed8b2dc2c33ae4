"""Differences between the structures of several tests, which one estimate cannot describe."""

from __future__ import annotations

import numpy as np

from updyn.arrays import RealArray
from updyn.updating.judge.settings import BETWEEN_TESTS
from updyn.updating.problem.local import Local
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import OutputErrorSet, reduce_cached

__all__ = ["describe_separable_share", "find_separable_share"]


def find_separable_share(problem: Problem, errors: OutputErrorSet, x: RealArray) -> float:
    """Return the share of the misfit that an estimate for each test would explain, linearised."""
    locals_ = [reduce_cached(errors.of(i), part, x) for i, part in enumerate(problem.parts)]
    total = sum(2.0 * local.cost for local in locals_)
    return sum(map(_explain_by_step, locals_)) / total if total > 0.0 else 0.0


def _explain_by_step(local: Local) -> float:
    """Return the squared residual that a step to the minimum of a test explains.

    Steps so long that the linearisation fails are not taken.
    """
    U, size, _ = np.linalg.svd(local.R)
    along = U.T @ local.q
    kept = np.abs(along) <= BETWEEN_TESTS.longest_step * size
    return float(along[kept] @ along[kept])


def describe_separable_share(share: float) -> str:
    """Return a sentence on tests of structures that differ; empty if the share is small."""
    if share < BETWEEN_TESTS.separable_share:
        return ""
    return (
        f"Separate estimates for each test would explain about {100.0 * share:.0f} % of the misfit:"
        " the structures may differ. For specimens that scatter, use updyn.update_population."
    )
