"""`StateSpace`: linear systems and their connection; transfer functions; Pade approximation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike
from scipy.sparse.csgraph import connected_components

from updyn.arrays import ComplexArray, RealArray
from updyn.control.servo.settings import LOOP_STABILITY
from updyn.errors import OptionError

__all__ = [
    "StateSpace",
    "Transfer",
    "balance",
    "bilinear",
    "channel_zeros",
    "connect",
    "connect_sections",
    "delay_approximation",
    "interval_matrices",
    "root_pair",
]


@dataclass(frozen=True, slots=True, eq=False)
class StateSpace:
    """x' = A x + B u, y = C x + D u, in SI units, time in s."""

    A: RealArray
    B: RealArray
    C: RealArray
    D: RealArray

    @classmethod
    def gain(cls, value: float) -> StateSpace:
        """Return a system without states, from one input to one output."""
        return cls(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[float(value)]]))

    def __mul__(self, first: StateSpace) -> StateSpace:
        """Return the series connection: `first`, then this system."""
        A = np.block(
            [[first.A, np.zeros((len(first.A), len(self.A)))], [self.B @ first.C, self.A]],
        )
        return StateSpace(
            A,
            np.vstack([first.B, self.B @ first.D]),
            np.hstack([self.D @ first.C, self.C]),
            self.D @ first.D,
        )

    @property
    def n_states(self) -> int:
        """Order n."""
        return len(self.A)

    @property
    def poles(self) -> ComplexArray:
        """Eigenvalues of A in rad/s, shape (n,)."""
        return np.asarray(np.linalg.eigvals(balance(self.A)[0]), dtype=np.complex128)


def balance(A: RealArray) -> tuple[RealArray, RealArray]:
    """Return A with states of similar size, and their scales: x = scale * (new states)."""
    # The scales of subsystems without mutual coupling are unbounded, so they are limited.
    if not len(A):
        return A, np.ones(0)
    with np.errstate(invalid="ignore"):  # scipy converts the scales to positions and discards these
        scale = scipy.linalg.matrix_balance(A, permute=False, separate=True)[1][0]
    power = np.log2(scale)
    largest = LOOP_STABILITY.largest_log_scale
    scale = np.exp2(np.clip(np.round(power - np.median(power)), -largest, largest))
    return A * scale / scale[:, None], scale


def connect(
    blocks: Sequence[StateSpace],
    wires: RealArray,
    entries: RealArray,
    taps: RealArray | None = None,
) -> StateSpace:
    """Return the interconnection of blocks.

    With u and y the stacked inputs and outputs of all blocks: u = wires y + entries w, and the
    outputs are taps y (by default y).
    """
    A, B, C, D = (scipy.linalg.block_diag(*(getattr(b, name) for b in blocks)) for name in "ABCD")
    # y = C x + D (wires y + entries w)
    around = D @ wires
    solved = np.eye(len(D)) - around
    largest = float(
        np.abs(np.linalg.eigvals(around)).max(initial=1.0)
    )  # unlike a condition number, independent of units
    if abs(np.linalg.det(solved)) < 1e-12 * largest:
        raise OptionError(
            "the loop is algebraic: torque and motion feed back without delay, with a gain of -1"
        )
    C_all, D_all = np.linalg.solve(solved, C), np.linalg.solve(solved, D @ entries)
    taps = np.eye(len(D)) if taps is None else taps
    return StateSpace(
        A + B @ wires @ C_all, B @ (entries + wires @ D_all), taps @ C_all, taps @ D_all
    )


def delay_approximation(delay: float, order: int) -> StateSpace:
    """Return the diagonal Pade approximation of exp(-s delay), an all-pass of order 1 to 12."""
    # Its denominator is a reverse Bessel polynomial, that of a Bessel filter with half the delay.
    # The system consists of second-order factors, which keep high orders well scaled.
    from scipy.signal import besselap  # slow to import

    if not 1 <= order <= 12:
        raise OptionError(f"pade order {order!r}; expected 1 to 12")
    poles = 2.0 / delay * besselap(order, norm="delay")[1]
    above = poles[poles.imag > 0.0]
    pairs = np.column_stack([above, above.conj()]).ravel()
    every = np.concatenate([poles[poles.imag == 0.0], pairs])
    return connect_sections(-every, every, (-1.0) ** order)


def connect_sections(zeros: ComplexArray, poles: ComplexArray, gain: float) -> StateSpace:
    """Return gain prod (s - zeros) / (s - poles) as sections in series, scaled by their poles."""
    # For an odd number of poles the first zero and the first pole are real; pairs follow.
    out = StateSpace.gain(gain)
    first = len(poles) % 2
    cuts = [slice(0, 1)] * first + [slice(k, k + 2) for k in range(first, len(poles), 2)]
    for cut in cuts:
        out = _section(zeros[cut], poles[cut]) * out
    return out


def _section(zeros: ComplexArray, poles: ComplexArray) -> StateSpace:
    """Return a section with one or two zeros and poles, and D = 1."""
    one = np.ones((1, 1))
    if len(poles) == 1:
        pole, zero = float(poles[0].real), float(zeros[0].real)
        return StateSpace(pole * one, one, (pole - zero) * one, one)
    a1, a0 = -float(poles.sum().real), float(np.prod(poles).real)
    b1, b0 = -float(zeros.sum().real), float(np.prod(zeros).real)
    w = float(np.sqrt(a0))
    A, C = np.array([[0.0, w], [-w, -a1]]), np.array([[(b0 - a0) / w, b1 - a1]])
    return StateSpace(A, np.array([[0.0], [1.0]]), C, one)


def root_pair(w: float, damping: float) -> list[complex]:
    """Return the roots of s^2 + 2 damping w s + w^2, real ones without cancellation."""
    if damping < 1.0:
        turn = np.sqrt(1.0 - damping**2)
        return [complex(-w * damping, w * turn), complex(-w * damping, -w * turn)]
    far = -w * (damping + np.sqrt(damping**2 - 1.0))
    return [complex(w**2 / far), complex(far)]


def bilinear(system: StateSpace, dt: float) -> StateSpace:
    """Return a system in z by s = 2 (z - 1) / (dt (z + 1)) (Tustin)."""
    from scipy.signal import cont2discrete  # slow to import

    matrices = system.A, system.B, system.C, system.D
    return StateSpace(*cont2discrete(matrices, dt, "bilinear")[:4])


def interval_matrices(
    A: RealArray, B: RealArray, dt: float
) -> tuple[RealArray, RealArray, RealArray]:
    """Return the matrices of one interval for the states, a constant input and a unit ramp."""
    n, m = B.shape
    if n == 0:
        return A, B, B
    even, scale = balance(A)
    scaled = B / scale[:, None]
    # Scales of inputs, too, are powers of 2, so scaling causes no rounding.
    size = np.abs(scaled).max(axis=0)
    wanted = max(float(np.abs(even).max()), 1.0 / dt)
    unit = np.exp2(np.round(np.log2(np.where(size > 0, size, wanted) / wanted)))
    both = np.zeros((n + 2 * m, n + 2 * m))
    both[:n, :n] = even * dt
    both[:n, n : n + m] = scaled / unit * dt
    both[n : n + m, n + m :] = np.eye(m)
    whole = scipy.linalg.expm(both)[:n]
    back = scale[:, None]
    return (
        back * whole[:, :n] / scale,
        back * whole[:, n : n + m] * unit,
        back * whole[:, n + m :] * unit,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Transfer:
    """C (s I - A)^-1 B + D with A in complex Schur form: one back substitution for all points.

    Each of `parts` is T (upper triangular), B and C of an uncoupled part of the system, so the
    rounding of fast modes does not affect the rigid-body motion.
    """

    parts: tuple[tuple[ComplexArray, ComplexArray, ComplexArray], ...]
    D: RealArray

    @classmethod
    def of(cls, system: StateSpace) -> Transfer:
        """Return the triangular forms of a balanced system."""
        n_parts, part = (
            connected_components(system.A != 0.0, directed=False)
            if system.n_states
            else (0, np.zeros(0))
        )
        parts = []
        for k in range(n_parts):
            columns = np.flatnonzero(part == k)
            A = system.A[np.ix_(columns, columns)]
            even, scale = balance(A)
            T, Z = scipy.linalg.schur(even, output="complex")
            parts.append(
                (
                    T,
                    Z.conj().T @ (system.B[columns] / scale[:, None]),
                    (system.C[:, columns] * scale) @ Z,
                )
            )
        return cls(tuple(parts), system.D)

    @property
    def poles(self) -> ComplexArray:
        """Eigenvalues in rad/s, shape (n,)."""
        return np.concatenate(
            [np.zeros(0, dtype=np.complex128), *(np.diag(T) for T, _, _ in self.parts)]
        )

    def at(self, s: ArrayLike) -> ComplexArray:
        """Return the response at s in rad/s, shape (*s.shape, n_y, n_u); not finite at a pole."""
        s = np.asarray(s, dtype=np.complex128)
        points = s.ravel()
        out = np.broadcast_to(self.D.astype(np.complex128), (len(points), *self.D.shape)).copy()
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for T, B, C in self.parts:
                n, n_u = B.shape
                X = np.empty((n, n_u, len(points)), dtype=np.complex128)
                for i in range(n - 1, -1, -1):
                    known = B[i][:, None]
                    if i < n - 1:
                        known = known + (T[i, i + 1 :] @ X[i + 1 :].reshape(n - 1 - i, -1)).reshape(
                            n_u, -1
                        )
                    X[i] = known / (points - T[i, i])
                out += np.moveaxis((C @ X.reshape(n, -1)).reshape(len(C), n_u, -1), -1, 0)
        return np.asarray(out.reshape(*s.shape, *self.D.shape))


def channel_zeros(system: StateSpace) -> ComplexArray:
    """Return the finite zeros of a system with one input and one output, in rad/s."""
    # Generalised eigenvalues of [[A, B], [C, D]] (Emami-Naeini & Van Dooren 1982, Automatica 18,
    # p. 415). Zeros far above all poles are infinite zeros moved by rounding, and are discarded.
    n = system.n_states
    if n == 0:
        return np.zeros(0, dtype=np.complex128)
    even, scale = balance(system.A)
    B, C = system.B / scale[:, None], system.C * scale
    size = max(float(np.abs(even).max()), 1e-300)
    B = B * (size / max(float(np.abs(B).max()), 1e-300))
    gain = size / max(float(np.abs(C).max()), 1e-300)
    D = system.D * (size / max(float(np.abs(system.B / scale[:, None]).max()), 1e-300)) * gain
    pencil = np.block([[even, B], [C * gain, D]])
    mass = np.zeros_like(pencil)
    mass[:n, :n] = np.eye(n)
    alpha, beta = scipy.linalg.eigvals(pencil, mass, homogeneous_eigvals=True)
    largest = max(float(np.abs(np.linalg.eigvals(even)).max()), 1e-300)
    with np.errstate(divide="ignore", invalid="ignore"):
        zeros = alpha / beta
    return np.asarray(
        zeros[np.isfinite(zeros) & (np.abs(zeros) < 1e3 * largest)], dtype=np.complex128
    )
