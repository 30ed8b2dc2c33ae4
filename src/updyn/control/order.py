"""How many modes a plant keeps: the fewest that hold the tolerance, chosen by what each contributes to the band."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.control.conversion import Conversion
from updyn.control.target import Target

__all__ = ["Kept", "fewest"]

#: Where a route cannot hold the tolerance beside a sharp peak, it has to come so near to what all
#: its modes reach.
_SHORT = 1.2


@dataclass(frozen=True, slots=True, eq=False)
class Kept:
    """A choice of candidates and how well it answers.

    Attributes
    ----------
    conversion : Conversion
        What was chosen from.
    mask : ndarray of bool, shape (n,)
        Which are kept.
    errors : ndarray of float, shape (4,)
        Against the model, see `Target.judged`.
    limits : ndarray of float, shape (4,)
        What was asked of them.
    """

    conversion: Conversion
    mask: NDArray[np.bool_]
    errors: NDArray[np.float64]
    limits: NDArray[np.float64]

    @property
    def holds(self) -> bool:
        """Whether nothing is beyond its limit."""
        return bool((self.errors <= self.limits).all())

    @property
    def error(self) -> float:
        """The larger of the errors that a plant states."""
        return float(self.errors[:2].max())


def fewest(
    conversion: Conversion, target: Target, tolerance: float, *, lenient: bool = False
) -> Kept:
    """Find the fewest candidates that answer within a tolerance. What lies below the band is always kept.

    Modal cost: candidates are ranked by the largest change that leaving each one out makes, as a
    share of the peak of its channel (after R. E. Skelton & P. C. Hughes, J. Dynamic Systems,
    Measurement, and Control 102 (1980) 151-158, in the largest instead of the mean square). Double
    integrators are always kept and need no Gramian. The number comes by bisection, and single ones
    are then left out as long as the tolerance holds.

    Parameters
    ----------
    conversion : Conversion
        The candidates.
    target : Target
        What to answer like.
    tolerance : float
        On the error and on the height of resonances.
    lenient : bool
        False: all of `Target.judged` has to be within the tolerance. True: what a plant states, and
        of the rest what all candidates together reach.

    Returns
    -------
    Kept
        All candidates, where not even these hold the tolerance; see `Kept.holds`.
    """
    costs = (conversion.costs(target.freq) / target.broad).max(axis=(1, 2))
    # A servo closes its loop through what is slow: it is not for a tolerance to leave that out.
    always = conversion.always | (conversion.frequency < target.freq[0])
    costs = np.where(always, np.inf, costs)
    order = np.argsort(-costs, kind="stable")
    limits = np.full(4, tolerance)
    whole = _judged(conversion, target, np.ones(len(order), dtype=np.bool_), limits)
    if lenient:
        limits[2:] = np.maximum(tolerance, _SHORT * whole.errors[2:])
    if not whole.holds:
        return whole
    low, high, best = int(always.sum()), len(order), whole
    while low < high:
        middle = (low + high) // 2
        tried = _judged(conversion, target, _first(order, middle), limits)
        if tried.holds:
            high, best = middle, tried
        else:
            low = middle + 1
    for i in order[:high][::-1]:
        if always[i]:
            continue
        mask = best.mask.copy()
        mask[i] = False
        tried = _judged(conversion, target, mask, limits)
        if tried.holds:
            best = tried
    return best


def _first(order: NDArray[np.intp], count: int) -> NDArray[np.bool_]:
    mask = np.zeros(len(order), dtype=np.bool_)
    mask[order[:count]] = True
    return mask


def _judged(
    conversion: Conversion, target: Target, mask: NDArray[np.bool_], limits: NDArray[np.float64]
) -> Kept:
    return Kept(conversion, mask, target.judged(conversion.response(mask, target.freq)), limits)
