"""Steady hysteresis loops by the rules of Masing and of return-point memory.

An element made of springs and sliders follows its initial loading curve F(x) up to the largest |u|.
After each reversal at u_r with the force f_r, it follows

    f = f_r + 2 s F(|u - u_r| / 2),    s = sign(u - u_r),

until it reaches the reversal before; then the inner loop closes, and the branch before continues
(Masing 1926; Segalman, J. Appl. Mech. 72 (2005) 752, section 2). One period that begins at the
largest |u| is therefore the steady loop, of a motion that has grown from rest.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import scipy.sparse as sp

from updyn.arrays import IndexArray, RealArray
from updyn.nonlinear.element import PeriodForce

__all__ = ["LoadingCurve", "follow_loop"]

#: Initial loading curve: from x of at least 0, shape (n,), force, slope, and derivatives by the
#: parameters, shape (n, n_p).
LoadingCurve: TypeAlias = Callable[[RealArray], tuple[RealArray, RealArray, RealArray]]


def follow_loop(curve: LoadingCurve, u: RealArray) -> PeriodForce:
    """Return the steady force over a period of deformations u, shape (n,)."""
    n, start = len(u), int(np.argmax(np.abs(u)))
    moved = np.roll(u, -start)
    origin = _find_origins(moved)
    begins = origin < 0
    change = moved - np.where(begins, 0.0, moved[origin])
    scale = np.where(begins, 1.0, 2.0)
    F, slope, by = curve(np.abs(change) / scale)
    sign = scale * np.sign(change)
    own, partial = sign * F, sign[:, None] * by
    # The force of each branch is added to that of its reversal, which lies on an earlier branch.
    force, total = np.zeros(n), np.zeros_like(partial)
    sample, at = np.arange(n), np.arange(n)
    rows, columns, values = [], [], []
    while len(sample):
        force[sample] += own[at]
        total[sample] += partial[at]
        later = origin[at] >= 0
        earlier = origin[at[later]]
        rows += [sample, sample[later]]
        columns += [at, earlier]
        values += [slope[at], -slope[at[later]]]
        sample, at = sample[later], earlier
    places = [(np.concatenate(index) + start) % n for index in (rows, columns)]
    stiffness = sp.csr_array((np.concatenate(values), tuple(places)), shape=(n, n))
    force, total = np.roll(force, start), np.roll(total, start, axis=0)
    return PeriodForce(force, stiffness, np.zeros(n), total)


def _find_origins(u: RealArray) -> IndexArray:
    """Return the reversal from which each sample's branch begins; -1 for the initial curve.

    The first sample has the largest |u|.
    """
    values = u.tolist()
    origins, reversals = [-1], [0]
    for i in range(1, len(values)):
        now, before = values[i], values[i - 1]
        if (now - before) * (before - values[reversals[-1]]) < 0.0:
            reversals.append(i - 1)
        while len(reversals) > 2:
            last, previous = values[reversals[-1]], values[reversals[-2]]
            if abs(now - last) < abs(previous - last):
                break
            del reversals[-2:]
        origins.append(reversals[-1])
    return np.array(origins, dtype=np.intp)
