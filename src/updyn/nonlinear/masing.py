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
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.sparse as sp

from updyn.arrays import IndexArray, RealArray
from updyn.nonlinear.element import AmplitudeElement, PeriodForce

__all__ = ["Loops", "MasingElement", "follow_cosine", "follow_loops"]


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
        loops = follow_loops(self, u[None])
        n, earlier = len(u), loops.earlier[0]
        rows = np.concatenate([np.arange(n), np.repeat(np.arange(n), len(earlier))])
        columns = np.concatenate([np.arange(n), np.tile(earlier, n)])
        values = np.concatenate([loops.stiffness[0], loops.memory[0].ravel()])
        stiffness = sp.csr_array((values, (rows, columns)), shape=(n, n))
        return PeriodForce(loops.force[0], stiffness, np.zeros(n), loops.parameters[0])

    def at_rest(self) -> tuple[float, float]:
        """Return stiffness and damping for vanishing amplitude: all sliders stick.

        Returns
        -------
        (float, float)
            In N/m and N s/m.
        """
        _, slope, _ = self._load(np.zeros(1))
        return float(slope[0]), 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Loops:
    """Forces of an element at m motions with n samples each, in N (N m), with derivatives.

    `force` (m, n); `stiffness` (m, n), by the deformation of the same sample; `parameters` (m, n,
    n_p). The force also depends on the deformations at the reversals `earlier`, (m, n_r), by
    `memory`, (m, n, n_r).
    """

    force: RealArray
    stiffness: RealArray
    parameters: RealArray
    earlier: IndexArray
    memory: RealArray


def follow_loops(element: MasingElement, u: RealArray) -> Loops:
    """Return the steady forces of motions u, (m, n), that have grown from rest."""
    m, n = u.shape
    line = np.arange(m)[:, None]
    place = (np.abs(u).argmax(axis=1)[:, None] + np.arange(n)) % n
    moved = u[line, place]
    at, parent, owner = _find_all_branches(moved)
    begins = owner < 0
    change = moved - np.where(begins, 0.0, moved[line, at[line, owner]])
    scale = np.where(begins, 1.0, 2.0)
    F, slope, by = (x.reshape(m, n, -1) for x in element._load((np.abs(change) / scale).ravel()))
    slope, sign = slope[..., 0], scale * np.sign(change)
    own = sign[..., None] * np.concatenate([F, by], axis=2)
    # Force and derivatives of a branch add to those of its reversal, which lies on an earlier
    # branch. The last position is that of no reversal.
    R = at.shape[1]
    total, D = np.zeros((m, R + 1, own.shape[2])), np.zeros((m, R + 1, R + 1))
    each = np.arange(m)
    for r in range(R):
        before, steep = parent[:, r], slope[each, at[:, r]]
        total[:, r] = own[each, at[:, r]] + total[each, before]
        D[:, r] = D[each, before]
        D[:, r, r] += steep
        D[each, r, before] -= steep
    total[:, R], D[:, R], D[:, :, R] = 0.0, 0.0, 0.0
    own += total[line, owner]
    memory = D[line, owner]
    memory[line, np.arange(n), owner] -= slope
    out = np.empty_like(own), np.empty_like(slope), np.empty((m, n, R))
    for values, moved_values in zip(out, (own, slope, memory[..., :R]), strict=True):
        values[line, place] = moved_values
    return Loops(out[0][..., 0], out[1], out[0][..., 1:], place[line, at], out[2])


def follow_cosine(
    element: MasingElement, amplitudes: RealArray, n: int
) -> tuple[RealArray, RealArray]:
    """Return the forces of cosines (m,) at n samples of a period, (m, n), and their derivatives.

    n is even; the derivatives are those by the parameters, (m, n, n_p).
    """
    A = amplitudes[:, None]
    fallen = 0.5 * A * (1.0 - np.cos(2.0 * np.pi * np.arange(n // 2) / n))
    F, _, by = element._load(np.concatenate([A, fallen], axis=1).ravel())
    shape = len(A), n // 2 + 1
    F, by = F.reshape(shape), by.reshape(*shape, -1)
    # The rising branch mirrors the falling one.
    force, slopes = F[:, :1] - 2.0 * F[:, 1:], by[:, :1] - 2.0 * by[:, 1:]
    return np.concatenate([force, -force], axis=1), np.concatenate([slopes, -slopes], axis=1)


def _find_all_branches(u: RealArray) -> tuple[IndexArray, IndexArray, IndexArray]:
    """Return the reversals, the origins of their branches, and the owners of motions (m, n)."""
    step = np.diff(u, axis=1)
    turns = (step[:, 1:] > 0.0) != (step[:, :-1] > 0.0)
    # Most motions fall and rise once.
    if not ((turns.sum(axis=1) == 1) & (step != 0.0).all(axis=1)).all():
        return _pad_branches([_find_branches(motion) for motion in u])
    at = np.zeros((len(u), 2), dtype=np.intp)
    at[:, 1] = turns.argmax(axis=1) + 1
    owner = (np.arange(u.shape[1]) > at[:, 1:]).astype(np.intp)
    owner[:, 0] = -1
    return at, np.tile(np.array([-1, 0], dtype=np.intp), (len(u), 1)), owner


def _find_branches(u: RealArray) -> tuple[list[int], list[int], IndexArray]:
    """Return the samples of the reversals, the reversal from which each is reached, and the owners.

    The owner of a sample is the reversal from which its branch begins; -1 is the initial curve. The
    first sample, which has the largest |u|, is the first reversal.
    """
    moving = np.flatnonzero(np.diff(u))
    rises = u[moving + 1] > u[moving]
    turns = moving[1:][rises[1:] != rises[:-1]].tolist()
    at, parent, stack = [0], [-1], [0]
    owner = np.full(len(u), -1, dtype=np.intp)
    begin = 1
    for end in [*turns, len(u) - 1]:
        while begin <= end:
            owner[begin : end + 1] = stack[-1]
            if len(stack) <= 2:
                break
            last, before = u[at[stack[-1]]], u[at[stack[-2]]]
            closed = np.abs(u[begin : end + 1] - last) >= abs(before - last)
            if not closed.any():
                break
            begin += int(closed.argmax())
            del stack[-2:]
        begin = end + 1
        if begin < len(u):
            at.append(end)
            parent.append(int(owner[end]))
            stack.append(len(at) - 1)
    return at, parent, owner


def _pad_branches(
    found: list[tuple[list[int], list[int], IndexArray]],
) -> tuple[IndexArray, IndexArray, IndexArray]:
    """Return reversals and their origins, (m, n_r), and the owners, (m, n), of all motions."""
    most = max(len(at) for at, _, _ in found)
    at, parent = np.zeros((len(found), most), np.intp), np.full((len(found), most), -1, np.intp)
    for i, (own_at, own_parent, _) in enumerate(found):
        at[i, : len(own_at)], parent[i, : len(own_at)] = own_at, own_parent
    return at, parent, np.stack([owner for _, _, owner in found])
