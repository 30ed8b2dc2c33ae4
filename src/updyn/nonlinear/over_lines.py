"""`LineForces`: the force of an element over one period at each of many lines.

Elements without memory are evaluated at all lines at once, elements made of springs and sliders if
their motion has two reversals in a period; others line by line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, IndexArray, RealArray
from updyn.nonlinear.element import NonlinearElement, PeriodForce
from updyn.nonlinear.masing import MasingElement

__all__ = ["LineForces", "describe_first_harmonic"]


def describe_first_harmonic(
    element: NonlinearElement, amplitudes: RealArray, omega: RealArray, samples: int
) -> tuple[ComplexArray, ComplexArray]:
    """Return the describing function over the deformation, (m,), and derivatives, (m, n_p).

    The motion of the given amplitudes, (m,), is sampled `samples` times a period. The derivatives
    are those by the parameters of the element.
    """
    tau = 2.0 * np.pi * np.arange(samples) / samples
    A = amplitudes[:, None]
    forces = LineForces.of(element, A * np.cos(tau), -A * omega[:, None] * np.sin(tau))
    wave = 2.0 / samples * np.exp(-1j * tau)
    slopes = np.einsum("mnp,n->mp", forces.parameters, wave) / A
    return np.asarray(forces.force @ wave / amplitudes), slopes


@dataclass(frozen=True, slots=True, eq=False)
class LineForces:
    """Forces at m lines and n samples of a period, in N (N m), with their derivatives.

    `force` (m, n); `stiffness` (m, n), with respect to the deformation of the same sample;
    `damping` (m, n), to the velocity; `parameters` (m, n, n_p). The force also depends on the
    deformations of the samples `earlier`, (m, n_r), by `memory`, (m, n, n_r).
    """

    force: RealArray
    stiffness: RealArray
    damping: RealArray
    parameters: RealArray
    earlier: IndexArray
    memory: RealArray

    @classmethod
    def of(cls, element: NonlinearElement, u: RealArray, v: RealArray) -> Self:
        """Return the forces for deformations and velocities, (m, n) each."""
        if not element.has_memory:
            return cls._without_memory(element, u, v)
        if isinstance(element, MasingElement):
            simple = _count_reversals(u) == 2
            if simple.all():
                return cls._of_loops(element, u)
            if simple.any():
                return cls._merge(
                    simple,
                    cls.of(element, u[simple], v[simple]),
                    cls.of(element, u[~simple], v[~simple]),
                )
        return cls._by_line([element.over_period(*line) for line in zip(u, v, strict=True)])

    @classmethod
    def _without_memory(cls, element: NonlinearElement, u: RealArray, v: RealArray) -> Self:
        found = element.over_period(u.ravel(), v.ravel())
        shape, m = u.shape, len(u)
        return cls(
            found.force.reshape(shape),
            found.stiffness.diagonal().reshape(shape),
            found.damping.reshape(shape),
            found.parameters.reshape(*shape, -1),
            np.zeros((m, 0), dtype=np.intp),
            np.zeros((*shape, 0)),
        )

    @classmethod
    def _of_loops(cls, element: MasingElement, u: RealArray) -> Self:
        """Return the forces of loops with two reversals, by Masing's rules."""
        m, n = u.shape
        line = np.arange(m)
        first = np.abs(u).argmax(axis=1)
        second = np.where(u[line, first] > 0.0, u.argmin(axis=1), u.argmax(axis=1))
        since = (np.arange(n) - first[:, None]) % n
        returns = since > ((second - first) % n)[:, None]
        u0, u1 = u[line, first][:, None], u[line, second][:, None]
        change = u - np.where(returns, u1, u0)
        F, k, by = _load(element, 0.5 * np.abs(change))
        start, k0, by0 = _load(element, np.abs(u0))
        turn, k1, by1 = _load(element, 0.5 * np.abs(u1 - u0))
        sign, sign0, sign1 = np.sign(change), np.sign(u0), np.sign(u1 - u0)
        force = sign0 * start + 2.0 * sign * F + returns * (2.0 * sign1 * turn)
        partial = sign0[..., None] * by0 + 2.0 * sign[..., None] * by
        partial = partial + returns[..., None] * (2.0 * sign1[..., None] * by1)
        memory = np.stack([k0 - np.where(returns, k1, k), np.where(returns, k1 - k, 0.0)], axis=2)
        # The force at the first reversal depends on its own deformation only.
        memory[line, first] = 0.0
        k[line, first] = k0[:, 0]
        return cls(force, k, np.zeros_like(u), partial, np.stack([first, second], axis=1), memory)

    @classmethod
    def _by_line(cls, found: Sequence[PeriodForce]) -> Self:
        diagonals = np.stack([one.stiffness.diagonal() for one in found])
        later = [one.stiffness.tocsc() for one in found]
        for matrix, values in zip(later, diagonals, strict=True):
            matrix.setdiag(matrix.diagonal() - values)
            matrix.eliminate_zeros()
        columns = [np.flatnonzero(np.diff(matrix.indptr)) for matrix in later]
        most = max(map(len, columns))
        earlier = np.zeros((len(found), most), dtype=np.intp)
        memory = np.zeros((*diagonals.shape, most))
        for i, (matrix, at) in enumerate(zip(later, columns, strict=True)):
            earlier[i, : len(at)] = at
            memory[i, :, : len(at)] = matrix[:, at].toarray()
        return cls(
            np.stack([one.force for one in found]),
            diagonals,
            np.stack([one.damping for one in found]),
            np.stack([one.parameters for one in found]),
            earlier,
            memory,
        )

    @classmethod
    def _merge(cls, chosen: BoolArray, ones: Self, others: Self) -> Self:
        """Return the forces of lines that are `chosen`, and of the others, in order."""
        most = max(ones.earlier.shape[1], others.earlier.shape[1])
        parts = {}
        for name in cls.__slots__:
            a, b = getattr(ones, name), getattr(others, name)
            if name in ("earlier", "memory"):
                a, b = (_pad(part, most) for part in (a, b))
            out = np.empty((len(chosen), *a.shape[1:]), dtype=a.dtype)
            out[chosen], out[~chosen] = a, b
            parts[name] = out
        return cls(**parts)


def _load(element: MasingElement, x: RealArray) -> tuple[RealArray, RealArray, RealArray]:
    """Return force, slope and derivatives of the initial loading curve, for x of any shape."""
    force, slope, by = element._load(x.ravel())
    return force.reshape(x.shape), slope.reshape(x.shape), by.reshape(*x.shape, -1)


def _count_reversals(u: RealArray) -> IndexArray:
    """Return the number of reversals of each motion in a period, shape (m,)."""
    rising = np.diff(u, axis=1, append=u[:, :1]) > 0.0
    return np.asarray((rising != np.roll(rising, 1, axis=1)).sum(axis=1), dtype=np.intp)


def _pad(array: RealArray, n: int) -> RealArray:
    """Return an array with zeros up to n along its last axis."""
    width = [(0, 0)] * (array.ndim - 1) + [(0, n - array.shape[-1])]
    return np.pad(array, width)
