"""`LossFactor` of an undamped mode by its strain energy, with exact derivatives by the unknowns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from updyn.arrays import RealArray
from updyn.dynamics.affine import AffineSystem, State
from updyn.sensitivity import Unknowns

__all__ = ["LossFactor"]


@dataclass(frozen=True, slots=True, eq=False)
class LossFactor:
    """Loss factor of a mode, phi^T D phi / omega^2, and its derivatives.

    From the energy dissipated in the undamped shape (Ungar & Kerwin, J. Acoust. Soc. Am. 34 (1962)
    954; Johnson & Kienholz, AIAA J. 20 (1982) 1284): exact to second order in the loss factors,
    unless modes are closer than their half-power bandwidth. `force` is D phi; `own`, shape (n,),
    and `by_eigenvalue` are derivatives of phi^T D phi by the values and by omega^2 = `value`.
    """

    factor: float
    force: RealArray
    own: RealArray
    by_eigenvalue: float
    value: float

    @classmethod
    def of(
        cls,
        system: AffineSystem,
        unknowns: Unknowns,
        state: State,
        values: RealArray,
        phi: RealArray,
        value: float,
    ) -> LossFactor:
        """Return the loss factor of a mode of unit modal mass, with omega^2 = `value`."""
        omega = np.array([np.sqrt(value)])
        by_term = system.coefficients(state, omega).imag[:, 0]
        force, energy = np.zeros_like(phi), np.zeros(len(system.terms))
        for t, term in enumerate(system.terms):
            product = term.local @ phi[term.row_index]
            energy[t] = phi[term.row_index] @ product
            force[term.row_index] += by_term[t] * product
        own = np.zeros(unknowns.n)
        by_drive = unknowns.slopes(system, state, values, omega).imag[:, 0]
        np.add.at(own, unknowns.owner, by_drive * energy[unknowns.at])
        steeper = float((state.factor * state.rate) @ energy) / (2.0 * float(omega[0]))
        return cls(float(by_term @ energy) / value, force, own, steeper, value)

    def derivatives(self, value: RealArray, along: RealArray, slope: RealArray) -> RealArray:
        """Return the derivatives by x, from those of omega^2, force^T phi and the values."""
        energy = self.own * slope + 2.0 * along + self.by_eigenvalue * value
        return np.asarray((energy - self.factor * value) / self.value)
