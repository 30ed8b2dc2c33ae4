"""States of a rational approximation: the fewest that hold a tolerance, or those of another."""

from __future__ import annotations

import numpy as np

from updyn.control.passivity import violations
from updyn.control.rational import Rational
from updyn.control.rational_fit import Approximation
from updyn.control.settings import RATIONAL_FIT
from updyn.control.target import CandidateSelection

__all__ = ["find_fewest_states", "refit_poles"]


def find_fewest_states(
    approximation: Approximation, tolerance: float, largest: int | None = None
) -> CandidateSelection:
    """Return the approximation with the fewest states that holds a tolerance.

    `largest` includes the states of the slow motion. If none holds the tolerance, the one with the
    smallest error is returned; see `CandidateSelection.holds`.
    """
    slow = len(approximation.slow.A)
    tried: dict[int, CandidateSelection] = {}

    def at(n: int) -> CandidateSelection:
        if n not in tried:
            tried[n] = _fit_states(approximation, n, tolerance)
        return tried[n]

    inside = int((np.abs(approximation.poles) < approximation.unit).sum())
    top = 2 * inside + RATIONAL_FIT.most_added_states if largest is None else largest - slow
    if top < 0:
        return at(0)
    low, high = 0, min(max(2 * inside, 2), top)
    while not at(high).holds:
        if high == top:
            return min(tried.values(), key=lambda kept: kept.error)
        low, high = high + 1, min(high + 4, top)
    while low < high:
        middle = (low + high) // 2
        if at(middle).holds:
            high = middle
        else:
            low = middle + 1
    return at(high)


def _fit_states(approximation: Approximation, n: int, tolerance: float) -> CandidateSelection:
    """Return the approximation with n states in addition to the slow ones, and its errors."""
    return _judge_approximation(approximation, approximation.fit(n, tolerance), tolerance)


def refit_poles(
    approximation: Approximation, like: Rational, tolerance: float
) -> CandidateSelection:
    """Return an approximation with the states of that of a similar response."""
    n = 2 * len(like.pairs) + len(like.rates)
    single = min(approximation.target.values.shape[1:]) == 1
    tried = RATIONAL_FIT.refit_steps
    for steps in tried[:1] if single else tried:
        rational = approximation.refit(like, tolerance, steps)
        found = _judge_approximation(approximation, rational, tolerance)
        if found.holds:
            return found
    return _fit_states(approximation, n, tolerance)


def _judge_approximation(
    approximation: Approximation, rational: Rational, tolerance: float
) -> CandidateSelection:
    """Return an approximation with its errors, infinite if it is not passive."""
    target, mask = approximation.target, ~rational.always_kept
    errors = target.all_errors(rational.response(mask, target.freq))
    if _is_active(approximation, rational):
        errors = np.full(5, np.inf)
    return CandidateSelection(rational, mask, errors, target.limits(tolerance))


def _is_active(approximation: Approximation, rational: Rational) -> bool:
    """Return whether a collocated channel generates power."""
    A, B, C, D = rational.matrices(~rational.always_kept)
    for i, u in approximation.collocated:
        one = A, B[:, [u]], C[[i]], D[[i]][:, [u]]
        if len(violations(one, int(approximation.powers[i]))):
            return True
    return False
