"""`LineForces`: the force of an element over one period at each of many lines.

Elements without memory and elements made of springs and sliders are evaluated at all lines at once;
others line by line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from updyn.arrays import ComplexArray, IndexArray, RealArray
from updyn.nonlinear.element import NonlinearElement, PeriodForce
from updyn.nonlinear.masing import MasingElement, follow_cosine, follow_loops

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
    if isinstance(element, MasingElement) and samples % 2 == 0:
        force, by = follow_cosine(element, amplitudes, samples)
    else:
        forces = LineForces.of(element, A * np.cos(tau), -A * omega[:, None] * np.sin(tau))
        force, by = forces.force, forces.parameters
    wave = 2.0 / samples * np.exp(-1j * tau)
    slopes = np.einsum("mnp,n->mp", by, wave) / A
    return np.asarray(force @ wave / amplitudes), slopes


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
            loops, still = follow_loops(element, u), np.zeros_like(u)
            by = loops.parameters
            return cls(loops.force, loops.stiffness, still, by, loops.earlier, loops.memory)
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
