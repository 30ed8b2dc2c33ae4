"""States of a rational approximation: the fewest that hold a tolerance, or those of another one."""

from __future__ import annotations

import numpy as np

from updyn.control.passivity import violations
from updyn.control.rational import Rational
from updyn.control.rational_fit import Approximation
from updyn.control.target import Kept

__all__ = ["fewest_states", "with_poles_of"]

#: More states than the modes in the band have are tried up to this number.
_MORE = 16
#: Gauss-Newton steps of an approximation that begins at the poles of another: none where its poles,
#: moved, hold the tolerance. Steps lower the mean square, and may move real poles to where
#: passivity costs more than they gained.
_FEW = (0, 2)


def fewest_states(
    approximation: Approximation, tolerance: float, largest: int | None = None
) -> Kept:
    """Return the approximation with the fewest states that holds a tolerance.

    Parameters
    ----------
    approximation : Approximation
        What is approximated.
    tolerance : float
        On the errors that `Target.measure` names.
    largest : int, optional
        Most states, those of the slow motion included. None: as many as the poles to begin with
        have, and some more.

    Returns
    -------
    Kept
        Of the smallest error reached, where none holds the tolerance; see `Kept.holds`.
    """
    slow = len(approximation.slow.A)
    tried: dict[int, Kept] = {}

    def at(n: int) -> Kept:
        if n not in tried:
            tried[n] = _with_states(approximation, n, tolerance)
        return tried[n]

    inside = int((np.abs(approximation.poles) < approximation.unit).sum())
    top = 2 * inside + _MORE if largest is None else largest - slow
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


def _with_states(approximation: Approximation, n: int, tolerance: float) -> Kept:
    """Return the approximation with n states beside the slow ones, and its errors.

    Parameters
    ----------
    approximation : Approximation
        What is approximated.
    n : int
        Number of states.
    tolerance : float
        On the errors that `Target.measure` names.
    """
    return _kept(approximation, approximation.fitted(n, tolerance), tolerance)


def with_poles_of(approximation: Approximation, like: Rational, tolerance: float) -> Kept:
    """Return an approximation with the states of another, of a response that is little different.

    Parameters
    ----------
    approximation : Approximation
        What is approximated.
    like : Rational
        The other one.
    tolerance : float
        On the errors that `Target.measure` names.
    """
    n = 2 * len(like.pairs) + len(like.rates)
    single = min(approximation.target.values.shape[1:]) == 1
    for steps in _FEW[:1] if single else _FEW:
        made = approximation.refitted(like, tolerance, steps)
        found = _kept(approximation, made, tolerance)
        if found.holds:
            return found
    return _with_states(approximation, n, tolerance)


def _kept(approximation: Approximation, made: Rational, tolerance: float) -> Kept:
    """Return an approximation with its errors, without bound where it is not passive."""
    target, mask = approximation.target, ~made.always
    errors = target.judged(made.response(mask, target.freq))
    if _active(approximation, made):
        errors = np.full(5, np.inf)
    return Kept(made, mask, errors, target.limits(tolerance))


def _active(approximation: Approximation, made: Rational) -> bool:
    """Whether a collocated channel gives off power."""
    A, B, C, D = made.matrices(~made.always)
    for i, u in approximation.collocated:
        one = A, B[:, [u]], C[[i]], D[[i]][:, [u]]
        if len(violations(one, int(approximation.powers[i]))):
            return True
    return False
