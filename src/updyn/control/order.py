"""How many modes a plant keeps: the fewest that hold the tolerance, chosen by what each contributes to the band."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.control.conversion import Conversion
from updyn.control.target import Target

__all__ = ["VIEWS", "Kept", "fewest"]

#: Whether a very sharp peak excuses nothing beside it (`Target.worst`), and whether slow motion hides no resonance. The
#: first view asks for most; where no order holds the tolerance in it, the next one has to do.
VIEWS = ((True, True), (True, False), (False, False))


@dataclass(frozen=True, slots=True, eq=False)
class Kept:
    """A choice of candidates and how well it answers.

    Attributes
    ----------
    conversion : Conversion
        What was chosen from.
    mask : ndarray of bool, shape (n,)
        Which are kept.
    error : float
        Against the model, that of resonances included: what has to be within the tolerance.
    """

    conversion: Conversion
    mask: NDArray[np.bool_]
    error: float


def fewest(conversion: Conversion, target: Target, tolerance: float, *, view: int = 0) -> Kept:
    """Find the fewest candidates that answer within a tolerance. What lies below the band is always kept.

    Modal cost: candidates are ranked by the largest change that leaving each one out makes, as a share of the peak of
    its channel (after R. E. Skelton & P. C. Hughes, J. Dynamic Systems, Measurement, and Control 102 (1980) 151-158, in
    the largest instead of the mean square). Double integrators are always kept and need no Gramian. The number comes by
    bisection, and single ones are then left out as long as the tolerance holds.

    Parameters
    ----------
    conversion : Conversion
        The candidates.
    target : Target
        What to answer like.
    tolerance : float
        On the error and on the height of resonances.
    view : int
        How the error is looked at, one of `VIEWS`.

    Returns
    -------
    Kept
        All candidates, where not even these hold the tolerance.
    """
    costs = (conversion.costs(target.freq) / target.broad).max(axis=(1, 2))
    # A servo closes its loop through what is slow: it is not for a tolerance to leave that out.
    always = conversion.always | (conversion.frequency < target.freq[0])
    costs = np.where(always, np.inf, costs)
    order = np.argsort(-costs, kind="stable")
    whole = _judged(conversion, target, np.ones(len(order), dtype=np.bool_), view)
    if whole.error > tolerance:
        return whole
    low, high, best = int(always.sum()), len(order), whole
    while low < high:
        middle = (low + high) // 2
        tried = _judged(conversion, target, _first(order, middle), view)
        if tried.error <= tolerance:
            high, best = middle, tried
        else:
            low = middle + 1
    for i in order[:high][::-1]:
        if always[i]:
            continue
        mask = best.mask.copy()
        mask[i] = False
        tried = _judged(conversion, target, mask, view)
        if tried.error <= tolerance:
            best = tried
    return best


def _first(order: NDArray[np.intp], count: int) -> NDArray[np.bool_]:
    mask = np.zeros(len(order), dtype=np.bool_)
    mask[order[:count]] = True
    return mask


def _judged(conversion: Conversion, target: Target, mask: NDArray[np.bool_], view: int) -> Kept:
    G = conversion.response(mask, target.freq)
    beside, slow = VIEWS[view]
    error = target.worst(G) if beside else target.error(G)
    return Kept(conversion, mask, max(error, target.peak_error(G, strict=slow)))
