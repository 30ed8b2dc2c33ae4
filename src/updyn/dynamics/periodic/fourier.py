"""`Fourier`: harmonics of a periodic motion and its samples.

A motion is u(t) = Re(sum of U_k exp(i k omega t)) with complex U_k and a real U_0. Its coordinates
are real: U_0 (if it is among the harmonics), the real parts of the others, then the imaginary ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from updyn.arrays import ComplexArray, IntArray, RealArray

__all__ = ["Fourier"]


@dataclass(frozen=True, slots=True, eq=False)
class Fourier:
    """Transforms between the coordinates of some harmonics and n samples of a period.

    `synthesis`, (n, n_c), gives samples from coordinates, and `rate` those of the derivative by
    omega t. `analysis`, (n_c, n), is its inverse; `beyond`, (n_b, n), gives complex amplitudes of
    the harmonics `next`.
    """

    harmonics: IntArray
    synthesis: RealArray
    rate: RealArray
    analysis: RealArray
    next: IntArray
    beyond: ComplexArray

    @classmethod
    def of(cls, harmonics: Sequence[int], n_next: int, n_samples: int) -> Fourier:
        """Return the transforms of some harmonics, ascending, and of as many next ones."""
        k = np.array(harmonics)
        tau = 2.0 * np.pi * np.arange(n_samples) / n_samples
        later = k[-1] + 1 + np.arange(n_next)
        wave = np.exp(1j * np.outer(tau, k))
        moving = k > 0
        synthesis = np.hstack([wave.real, -wave.imag[:, moving]])
        slope = 1j * k * wave
        rate = np.hstack([slope.real, -slope.imag[:, moving]])
        share = np.append(np.where(moving, 2.0, 1.0), np.full(moving.sum(), 2.0)) / n_samples
        beyond = 2.0 / n_samples * np.exp(-1j * np.outer(later, tau)).astype(np.complex128)
        analysis = np.asarray(share[:, None] * synthesis.T)
        return cls(k, synthesis, rate, analysis, later, beyond)

    @property
    def size(self) -> int:
        """Number of coordinates n_c."""
        return int(self.synthesis.shape[1])

    @property
    def first(self) -> int:
        """Position of the harmonic 1."""
        return int(np.searchsorted(self.harmonics, 1))

    def to_complex(self, x: RealArray) -> ComplexArray:
        """Return complex amplitudes along axis 1 from coordinates, (m, n_c, ...)."""
        n = len(self.harmonics)
        out = x[:, :n].astype(np.complex128)
        out[:, self.harmonics > 0] += 1j * x[:, n:]
        return out

    def to_real(self, U: ComplexArray) -> RealArray:
        """Return coordinates along axis 1 from complex amplitudes."""
        return np.concatenate([U.real, U.imag[:, self.harmonics > 0]], axis=1)
