"""`Balance`: harmonic balance of the deformations of nonlinear elements.

With the receptances H between elements (q), force (f) and responses, the deformations Q_k and the
element forces T_k of each harmonic k satisfy

    R_k = Q_k + H_qq(k omega) T_k(Q) - H_qf(omega) F [k = 1] = 0,

exactly condensed, whatever the size of the model. T_k follows from samples of a period
(alternating frequency-time: Cameron & Griffin, J. Appl. Mech. 56 (1989) 149; Krack & Gross,
Harmonic Balance for Nonlinear Vibration Problems, 2019, chapters 2 and 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Protocol

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.dynamics.periodic.fourier import Fourier
from updyn.dynamics.periodic.settings import BALANCE
from updyn.dynamics.periodic.transfer import Transfer
from updyn.nonlinear.element import NonlinearElement, PeriodForce

__all__ = [
    "Balance",
    "ControlledBalance",
    "Evaluation",
    "GrowingBalance",
    "Residual",
    "make_fourier",
]


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """The balance at coordinates x of the deformations, (n_e, n_c), and omega in rad/s.

    `residual` R, (n_e, n_c), in m (rad); `jacobian`, (n_e n_c, n_e n_c); `by_omega`, (n_e, n_c);
    `forces` T_k, complex (n_e, n_h), in N (N m); `period` has the samples of each element.
    """

    x: RealArray
    omega: float
    residual: RealArray
    jacobian: RealArray
    by_omega: RealArray
    forces: ComplexArray
    period: tuple[PeriodForce, ...]


class Residual(Protocol):
    """A residual of the coordinates x and a parameter, with its derivatives."""

    #: Limit that the parameter does not reach.
    least: ClassVar[float]

    def evaluate(self, x: RealArray, omega: float) -> Evaluation:
        """Return the residual and its derivatives; `omega` is the parameter."""


@dataclass(frozen=True, slots=True, eq=False)
class Balance:
    """Elements on a linear transfer, with one force of the amplitude `level` in N (N m)."""

    elements: Sequence[NonlinearElement]
    transfer: Transfer
    fourier: Fourier
    level: float

    least: ClassVar[float] = 0.0

    @property
    def n_elements(self) -> int:
        """Number of elements n_e."""
        return len(self.elements)

    def receptances(self, omega: float) -> tuple[ComplexArray, ComplexArray]:
        """Return H and its derivative by omega at each harmonic, (n_h, n_out, n_in)."""
        k = self.fourier.harmonics
        H, slope = self.transfer.at(omega * k[k > 0].astype(np.float64))
        slope *= k[k > 0, None, None]
        if k[0] == 0:
            assert self.transfer.static is not None
            H = np.concatenate([self.transfer.static[None], H])
            slope = np.concatenate([np.zeros_like(slope[:1]), slope])
        return H, slope

    def evaluate(self, x: RealArray, omega: float) -> Evaluation:
        """Return the balance with its exact derivatives."""
        n, f = self.n_elements, self.fourier
        H, slope = self.receptances(omega)
        u, v = x @ f.synthesis.T, omega * (x @ f.rate.T)
        period, T, T_x, T_omega = [], [], [], []
        for element, displacement, velocity in zip(self.elements, u, v, strict=True):
            force = element.over_period(displacement, velocity)
            tangent = force.stiffness @ f.synthesis + omega * force.damping[:, None] * f.rate
            period.append(force)
            T.append(f.analysis @ force.force)
            T_x.append(f.analysis @ tangent)
            T_omega.append(f.analysis @ (force.damping * velocity / omega))
        forces = f.to_complex(np.array(T))
        tangents = f.to_complex(np.array(T_x))
        R = f.to_complex(x) + np.einsum("kef,fk->ek", H[:, :n, :n], forces)
        by_omega = np.einsum("kef,fk->ek", slope[:, :n, :n], forces)
        by_omega += np.einsum("kef,fk->ek", H[:, :n, :n], f.to_complex(np.array(T_omega)))
        R[:, f.first] -= self.level * H[f.first, :n, n]
        by_omega[:, f.first] -= self.level * slope[f.first, :n, n]
        J = f.to_real(np.einsum("kef,fkc->ekfc", H[:, :n, :n], tangents))
        J = J.reshape(n * f.size, n * f.size) + np.eye(n * f.size)
        return Evaluation(x, omega, f.to_real(R), J, f.to_real(by_omega), forces, tuple(period))

    def linear(self, omega: float) -> RealArray:
        """Return the deformations without the elements, (n_e, n_c)."""
        H, _ = self.receptances(omega)
        n, f = self.n_elements, self.fourier
        Q = np.zeros((n, len(f.harmonics)), dtype=np.complex128)
        Q[:, f.first] = self.level * H[f.first, :n, n]
        return f.to_real(Q)

    def find_force(self, found: Evaluation) -> complex:
        """Return the force at a solution, in N (N m)."""
        del found
        return complex(self.level)

    def respond(self, found: Evaluation) -> ComplexArray:
        """Return the harmonics of the responses, (n_h, n_out - n_e), in m (rad)."""
        n, first = self.n_elements, self.fourier.first
        H = self.receptances(found.omega)[0][:, n:]
        out = -np.einsum("kof,fk->ko", H[:, :, :n], found.forces)
        out[first] += self.level * H[first, :, n]
        return np.asarray(out)

    def truncation(self, found: Evaluation) -> float:
        """Return the amplitude of the next harmonics over that of all, largest of an element."""
        n, f = self.n_elements, self.fourier
        T = np.array([f.beyond @ force.force for force in found.period])
        H, _ = self.transfer.at(found.omega * f.next.astype(np.float64))
        missing = np.linalg.norm(np.einsum("kef,fk->ek", H[:, :n, :n], T), axis=1)
        size = np.linalg.norm(found.x, axis=1)
        return float(np.max(missing / np.maximum(size, np.finfo(np.float64).tiny)))


@dataclass(frozen=True, slots=True, eq=False)
class GrowingBalance:
    """A balance at the frequency `at` in rad/s; the parameter is the share of its force."""

    balance: Balance
    at: float

    #: Without damping, the force of a branch changes its sign.
    least: ClassVar[float] = -np.inf

    def evaluate(self, x: RealArray, omega: float) -> Evaluation:
        """Return the balance at the share `omega` of the force."""
        found, unit = self.balance.evaluate(x, self.at), self.balance.linear(self.at)
        residual = found.residual + (1.0 - omega) * unit
        return replace(found, omega=omega, residual=residual, by_omega=-unit)


@dataclass(frozen=True, slots=True, eq=False)
class ControlledBalance(Balance):
    """Balance with a sinusoidal force that holds the first harmonic of a response constant.

    The output `control` of the transfer has the amplitude `level` X of its derivative of the order
    `power`, and the phase 0. The complex force F = (X / omega^power + H_zq T_1) / H_zf is
    eliminated from the first harmonic, so that the deformations are the only unknowns.
    """

    control: int
    power: int

    def receptances(self, omega: float) -> tuple[ComplexArray, ComplexArray]:
        """Return the responses to element forces and to X, and their derivatives by omega."""
        H, slope = Balance.receptances(self, omega)
        first, f, z = self.fourier.first, self.n_elements, self.control
        one, by_omega = H[first].copy(), slope[first].copy()
        ratio = one[:, f] / one[z, f]
        ratio_slope = (by_omega[:, f] - ratio * by_omega[z, f]) / one[z, f]
        H[first] = one - np.outer(ratio, one[z])
        slope[first] = by_omega - np.outer(ratio_slope, one[z]) - np.outer(ratio, by_omega[z])
        share = omega**-self.power
        H[first, :, f] = share * ratio
        slope[first, :, f] = share * (ratio_slope - self.power / omega * ratio)
        return H, slope

    def find_force(self, found: Evaluation) -> complex:
        """Return the force at a solution with its phase, in N (N m)."""
        H = Balance.receptances(self, found.omega)[0][self.fourier.first, self.control]
        moved = self.level * found.omega**-self.power
        n = self.n_elements
        return complex((moved + H[:n] @ found.forces[:, self.fourier.first]) / H[n])


def make_fourier(*, is_free: bool, harmonics: int, samples: int) -> Fourier:
    """Return the transforms up to a harmonic, of odd ones only if the model is free at 0 Hz."""
    kept = range(1, harmonics + 1, 2) if is_free else range(harmonics + 1)
    return Fourier.of(tuple(kept), BALANCE.next_harmonics, samples)
