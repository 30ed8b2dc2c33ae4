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
from updyn.nonlinear.element import PeriodForce, diagonal

__all__ = ["LoadingCurve", "follow_loop"]

#: Initial loading curve: from x of at least 0, shape (n,), force, slope, and derivatives by the
#: parameters, shape (n, n_p).
LoadingCurve: TypeAlias = Callable[[RealArray], tuple[RealArray, RealArray, RealArray]]


def follow_loop(curve: LoadingCurve, u: RealArray) -> PeriodForce:
    """Return the steady force over a period of deformations u, shape (n,)."""
    n, start = len(u), int(np.argmax(np.abs(u)))
    moved = np.roll(u, -start)
    origin = _find_origins(moved)
    later = np.flatnonzero(origin >= 0)
    to_origin = sp.csr_array((np.ones(len(later)), (later, origin[later])), shape=(n, n))
    change = moved - to_origin @ moved
    scale = np.where(origin < 0, 1.0, 2.0)
    F, slope, by = curve(np.abs(change) / scale)
    sign = scale * np.sign(change)
    # The force of each branch is added to that of its reversal, which lies on an earlier branch.
    force, total = sign * F, sign[:, None] * by
    stiffness = diagonal(slope) @ (sp.eye_array(n, format="csr") - to_origin)
    own = force, total, stiffness
    chain = to_origin
    while chain.nnz:
        force, total = force + chain @ own[0], total + chain @ own[1]
        stiffness = stiffness + chain @ own[2]
        chain = chain @ to_origin
    order = np.roll(np.arange(n), start)
    stiffness = sp.csr_array(stiffness[order][:, order])
    return PeriodForce(force[order], stiffness, np.zeros(n), total[order])


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
