"""Steady hysteresis loops by the rules of Masing and of return-point memory.

An element made of springs and sliders follows its initial loading curve F(x) up to the largest |u|.
After each reversal at u_r with the force f_r, it follows

    f = f_r + 2 s F(|u - u_r| / 2),    s = sign(u - u_r),

until it reaches the reversal before; then the inner loop closes, and the branch before continues
(Masing 1926; Segalman, J. Appl. Mech. 72 (2005) 752, section 2). One period that begins at the
largest |u| is therefore the steady loop, of a motion that has grown from rest.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import numpy as np
import scipy.sparse as sp

from updyn.arrays import IndexArray, RealArray
from updyn.nonlinear.element import AmplitudeElement, PeriodForce

__all__ = ["MasingElement"]


class MasingElement(AmplitudeElement):
    """Base of elements made of springs and sliders, by their initial loading curve."""

    __slots__ = ()

    has_memory: ClassVar[bool] = True
    quantity: ClassVar[str] = "receptance"
    is_odd: ClassVar[bool] = True

    @abstractmethod
    def _load(self, x: RealArray) -> tuple[RealArray, RealArray, RealArray]:
        """Return force, slope and derivatives by the parameters of the initial loading curve.

        `x`, (n,), is at least 0; the derivatives have the shape (n, n_p).
        """

    def over_period(self, u: RealArray, v: RealArray) -> PeriodForce:
        """Return the steady force at each sample, of a motion that has grown from rest.

        Parameters
        ----------
        u : ndarray, shape (n,)
            Deformation in m (rad).
        v : ndarray, shape (n,)
            Velocity in m/s (rad/s); has no influence.

        Returns
        -------
        PeriodForce
        """
        n, start = len(u), int(np.argmax(np.abs(u)))
        moved = np.roll(u, -start)
        origin = _find_origins(moved)
        begins = origin < 0
        change = moved - np.where(begins, 0.0, moved[origin])
        scale = np.where(begins, 1.0, 2.0)
        F, slope, by = self._load(np.abs(change) / scale)
        sign = scale * np.sign(change)
        own, partial = sign * F, sign[:, None] * by
        # The force of each branch adds to that of its reversal, which lies on an earlier branch.
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

    def at_rest(self) -> tuple[float, float]:
        """Return stiffness and damping for vanishing amplitude: all sliders stick.

        Returns
        -------
        (float, float)
            In N/m and N s/m.
        """
        _, slope, _ = self._load(np.zeros(1))
        return float(slope[0]), 0.0


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
