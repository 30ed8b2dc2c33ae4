"""`Rational`: a response as a sum of fractions, and its state space.

    G(s) = rigid-body motion + sum_j  c_j b_j^T / (s - p_j) + conj(c_j b_j^T) / (s - conj(p_j))
           + sum_k  c_k b_k^T / (s + a_k)  (+ E / s + D, of displacements)

Rigid-body motion and real poles of viscous dampers are those of the model. Residues have rank one,
as those of a structure. Velocities have no feed-through and accelerations are 0 at rest, as those
of the model.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.linalg

from updyn.arrays import BoolArray, ComplexArray, IndexArray, RealArray
from updyn.control.space import Matrices, laplace_variable

__all__ = ["Rational", "SlowMotion", "states_of_poles"]


_TWO_PI = 2.0 * np.pi


@dataclass(frozen=True, slots=True, eq=False)
class SlowMotion:
    """The part that an approximation keeps exactly: rigid-body motion and other real poles.

    `displacements`, shape (n_y, n), are the rows of the outputs as displacements; `velocities` the
    states that are velocities of undamped rigid-body modes; `frequency` the natural frequencies of
    its oscillating modes, those below the band, in Hz.
    """

    A: RealArray
    B: RealArray
    displacements: RealArray
    velocities: IndexArray
    frequency: RealArray = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def none(cls, n_y: int, n_u: int) -> SlowMotion:
        """Return a part without states."""
        return cls(np.zeros((0, 0)), np.zeros((0, n_u)), np.zeros((n_y, 0)), np.zeros(0, np.intp))

    def rows(self, powers: IndexArray) -> RealArray:
        """Return the output rows of the states."""
        C = self.displacements
        return np.stack([C, C @ self.A, C @ self.A @ self.A])[powers, np.arange(len(C))]

    def jumps(self, powers: IndexArray) -> RealArray:
        """Return the feed-through of accelerations, shape (n_y, n_u)."""
        return np.where((powers == 2)[:, None], self.displacements @ self.A @ self.B, 0.0)

    def response(self, s: ComplexArray, powers: IndexArray) -> ComplexArray:
        """Return the response, shape (n_f, n_y, n_u)."""
        through = self.jumps(powers)
        out = np.broadcast_to(through.astype(np.complex128), (len(s), *through.shape)).copy()
        if len(self.A):
            shift = s[:, None, None] * np.eye(len(self.A)) - self.A
            states = np.linalg.solve(shift, np.broadcast_to(self.B, (len(s), *self.B.shape)))
            out += self.rows(powers) @ states
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Rational:
    """A rational approximation, which always keeps all of its poles.

    It has m `pairs` (poles above the real axis, rad/s) and k `rates` (a of real poles -a, rad/s).
    `right`, shape (n_u, m + k), are the vectors b, `rows`, shape (n_y, 2 m + k), the output rows of
    their states, `drift` is E, shape (n_y, n_still), and `through` is D. `structure`, shape (m,),
    is the nearest pole of the structure for each pair, in rad/s; nan if none corresponds. `powers`
    are 0, 1, 2 for displacement, velocity, acceleration.
    """

    slow: SlowMotion
    powers: IndexArray
    pairs: ComplexArray
    rates: RealArray
    right: ComplexArray
    rows: RealArray
    drift: RealArray
    through: RealArray
    structure: ComplexArray
    name: str = "rational"

    @property
    def frequency(self) -> RealArray:
        """Natural frequency of each pair in Hz, including those below the band."""
        return np.concatenate([self.slow.frequency, np.abs(self.pairs) / _TWO_PI])

    @property
    def always_kept(self) -> BoolArray:
        """Mask without any pair, as none is rigid."""
        return np.zeros(len(self.frequency), dtype=np.bool_)

    @property
    def n_states(self) -> int:
        """Number of states, including those of the rigid-body motion."""
        return len(self.slow.A) + 2 * len(self.pairs) + len(self.rates)

    def costs(self, freq: RealArray, level: RealArray) -> RealArray:
        """Return infinity, as no pair may be omitted."""
        return np.full(len(self.frequency), np.inf)

    def response(self, kept: BoolArray, freq: RealArray) -> ComplexArray:
        """Return the response."""
        s = laplace_variable(freq)
        pole_response = np.einsum(
            "yk,fku->fyu", self.rows, states_of_poles(s, self.pairs, self.rates, self.right)
        )
        if len(self.slow.velocities):  # without them the band may start at s = 0
            pole_response = (
                pole_response + (self.drift @ self.slow.B[self.slow.velocities]) / s[:, None, None]
            )
        return np.asarray(self.slow.response(s, self.powers) + pole_response + self.through)

    def matrices(self, kept: BoolArray) -> Matrices:
        """Return A, B, C, D: the slow part, blocks [[a, b], [-b, a]] of pairs, real poles."""
        m, n_u = len(self.pairs), len(self.right)
        oscillating = np.zeros((2 * m, 2 * m))
        first = 2 * np.arange(m)
        second = first + 1
        oscillating[first, first] = oscillating[second, second] = self.pairs.real
        oscillating[first, second], oscillating[second, first] = self.pairs.imag, -self.pairs.imag
        into = np.zeros((2 * m, n_u))
        into[first], into[second] = self.right[:, :m].real.T, -self.right[:, :m].imag.T
        A = scipy.linalg.block_diag(self.slow.A, oscillating, -np.diag(self.rates))
        B = np.vstack([self.slow.B, into, self.right[:, m:].real.T])
        slow = self.slow.rows(self.powers).copy()
        slow[:, self.slow.velocities] += self.drift
        return A, B, np.hstack([slow, self.rows]), self.through + self.slow.jumps(self.powers)


def states_of_poles(
    s: ComplexArray, pairs: ComplexArray, rates: RealArray, right: ComplexArray
) -> ComplexArray:
    """Return the states of poles for unit inputs at s in rad/s, shape (n_f, 2 m + k, n_u)."""
    m = len(pairs)
    b = right.T[None]
    up = b[:, :m] / (s[:, None] - pairs)[:, :, None]
    down = b[:, :m].conj() / (s[:, None] - pairs.conj())[:, :, None]
    both = np.stack([up + down, 1j * (up - down)], axis=2) / 2.0
    real = b[:, m:] / (s[:, None] + rates)[:, :, None]
    return np.concatenate([both.reshape(len(s), 2 * m, len(right)), real], axis=1)
