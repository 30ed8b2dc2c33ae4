"""The variable of rational fits of FRFs, and conversion of its poles and residues to modes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.modal.vector_fitting import RationalBasis

__all__ = ["Axis"]


@dataclass(frozen=True, slots=True)
class Axis:
    """The variable x of a fit by partial fractions, scaled to the highest frequency.

    For structural damping, x = omega^2 and a mode has the pole omega_r^2 (1 + i eta_r). For viscous
    damping (`mirrored`), x = i omega and a mode has a pole and its mirror image. `unit` is the
    circular frequency of |x| = 1, in rad/s.
    """

    mirrored: bool
    unit: float

    @property
    def basis(self) -> RationalBasis:
        """Fractions, and a polynomial of degree 3 for the modes outside the band."""
        return RationalBasis(3, self.mirrored)

    def at(self, freq: RealArray) -> ComplexArray:
        """Return the variable at lines in Hz."""
        share = 2.0 * np.pi * freq / self.unit
        return np.asarray(1j * share if self.mirrored else share**2, dtype=np.complex128)

    def poles(self, s: ComplexArray) -> ComplexArray:
        """Return poles in x for poles in rad/s."""
        share = s / self.unit
        return np.asarray(share if self.mirrored else -(share**2))

    def pole(self, frequency: RealArray, loss: RealArray | float) -> ComplexArray:
        """Return poles for natural frequencies in Hz and loss factors."""
        share = 2.0 * np.pi * frequency / self.unit
        if self.mirrored:
            return np.asarray(share * (1j * np.sqrt(1.0 - 0.25 * np.square(loss)) - 0.5 * loss))
        return np.asarray(share**2 * (1.0 + 1j * loss))

    def frequency(self, poles: ComplexArray) -> RealArray:
        """Return natural frequencies in Hz; nan for poles that do not oscillate."""
        squared = np.where(poles.real > 0, poles.real, np.nan)
        if self.mirrored:
            squared = np.abs(poles) ** 2
        return np.asarray(np.sqrt(squared) * self.unit / (2.0 * np.pi))

    def loss(self, poles: ComplexArray) -> RealArray:
        """Return loss factors."""
        if self.mirrored:
            return np.asarray(-2.0 * poles.real / np.abs(poles))
        return np.asarray(poles.imag / poles.real)

    def std_frequency(self, poles: ComplexArray, std: RealArray) -> RealArray:
        """Return standard deviations in Hz for those of the poles' parts, shape (2, k)."""
        if self.mirrored:
            return np.asarray(std[1] * self.unit / (2.0 * np.pi))
        return np.asarray(self.frequency(poles) * std[0] / (2.0 * np.abs(poles.real)))

    def std_loss(self, poles: ComplexArray, std: RealArray) -> RealArray:
        """Return standard deviations of loss factors, as `std_frequency`."""
        if self.mirrored:
            return np.asarray(2.0 * std[0] / np.abs(poles))
        return np.asarray(np.hypot(std[1], self.loss(poles) * std[0]) / np.abs(poles.real))

    def modal(self, poles: ComplexArray, residues: ComplexArray) -> ComplexArray:
        """Return phi phi^T for residues of accelerance, both of shape (k, ...)."""
        # s^2 A / (s - p) has the residue p^2 A, with A = phi phi^T / (2 i omega_d); x A / (x - p)
        # has p A.
        factor = 2j * poles.imag / poles**2 if self.mirrored else 1.0 / poles
        return np.asarray(residues * factor.reshape(-1, *(1,) * (residues.ndim - 1)))
