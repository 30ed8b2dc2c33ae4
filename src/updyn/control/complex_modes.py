"""Complex modes of the damped structure as a real, causal and stable system.

With structural damping D the receptance is, in modal coordinates (M = I),

    H(s) = (s^2 I + s C + Omega^2 + i D)^-1 = sum_j  u_j u_j^T / (s - s_j)

    with  u_j^T (2 s_j I + C) u_j = 1

(Tisseur & Meerbergen, SIAM Review 43 (2001) 235-286, for a symmetric pencil). The poles above the
real axis are stable and cause the resonances. Some of those below it are unstable; all of these are
replaced by the conjugates of those above:

    G(s) = sum_{Im s_j > 0}  u_j u_j^T / (s - s_j) + conj(u_j u_j^T) / (s - conj(s_j)).

For one mode with loss factor eta the change is about 3 eta^2 / 8 of its peak at resonance, and at
most eta^2 at 0 Hz. G is passive only if the damping of the structure is nearly causal. Real poles
(rigid-body and overdamped motion) are those of the structure without D.

The residues of a causal structure sum to 0, those of G only nearly: a velocity gets a small
feed-through in the band, which a real pole above the band removes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from updyn.arrays import BoolArray, ComplexArray, IndexArray, NumberArray, RealArray
from updyn.control.settings import COMPLEX_MODES
from updyn.control.space import Matrices, ModalSpace, derivative_factors, laplace_variable
from updyn.control.target import ResponseTarget
from updyn.errors import ModelError

__all__ = [
    "ComplexModes",
    "FittedModes",
    "complex_modes",
    "fit_outputs",
    "slow_motion",
]


_TWO_PI = 2.0 * np.pi


@dataclass(frozen=True, slots=True, eq=False)
class ComplexModes:
    """Poles above the real axis with their vectors u_j at the ports, and the part with real poles.

    `poles` in rad/s, shape (m,), ascend by frequency; the vectors have shapes (n_y, m) and
    (n_u, m). `slow` are A, B, C of the motion with real poles, C of displacements. `powers` are 0,
    1, 2 for displacement, velocity, acceleration. `fast` is the real pole above the band, in rad/s.
    """

    poles: ComplexArray
    at_outputs: ComplexArray
    at_inputs: ComplexArray
    slow: tuple[RealArray, RealArray, RealArray]
    powers: IndexArray
    fast: float
    name: str = "complex"

    @property
    def frequency(self) -> RealArray:
        """Natural frequency of each mode in Hz."""
        return np.abs(self.poles) / _TWO_PI

    @property
    def always_kept(self) -> BoolArray:
        """Mask without any candidate, as rigid-body motion is not a candidate."""
        return np.zeros(len(self.poles), dtype=np.bool_)

    @property
    def is_supported(self) -> bool:
        """Whether no pole is at 0: the structure does not move away under a constant force."""
        size = np.abs(np.linalg.eigvals(self.slow[0]))
        largest = max(size.max(initial=0.0), np.abs(self.poles).max(initial=0.0))
        return bool((size > COMPLEX_MODES.zero_share * largest).all())

    def costs(self, freq: RealArray, level: RealArray) -> RealArray:
        """Return the relative change without each mode."""
        s = laplace_variable(freq)
        out = np.empty(len(self.poles))
        for j, pole in enumerate(self.poles):
            R = np.outer(self.at_outputs[:, j], self.at_inputs[:, j])
            contribution = (
                R / (s - pole)[:, None, None] + R.conj() / (s - pole.conj())[:, None, None]
            ) * derivative_factors(self.powers, s)
            static = np.where((self.powers == 0)[:, None], -2.0 * (R / pole).real, 0.0)
            out[j] = (np.abs(contribution - static) / level).max()
        return out

    def response(self, kept: BoolArray, freq: RealArray) -> ComplexArray:
        """Return the response with a selection of modes."""
        s = laplace_variable(freq)
        out = self.slow_response(s)
        poles, left, right = self.poles[kept], self.at_outputs[:, kept], self.at_inputs[:, kept]
        growth = poles[None, :] ** self.powers[:, None]  # factor of an output at each pole
        for p, U, W in (
            (poles, left * growth, right),
            (poles.conj(), (left * growth).conj(), right.conj()),
        ):
            out += (U[None] / (s[:, None] - p)[:, None, :]) @ W.T
        through, jump = self._through(kept)
        return out + through + jump * (self.fast / (s + self.fast))[:, None, None]

    def slow_response(self, s: ComplexArray) -> ComplexArray:
        """Return the response of the part with real poles, shape (n_f, n_y, n_u)."""
        A, B, _ = self.slow
        if not len(A):
            return np.zeros((len(s), len(self.powers), len(self.at_inputs)), dtype=np.complex128)
        shift = s[:, None, None] * np.eye(len(A)) - A
        return np.asarray(
            self.slow_rows() @ np.linalg.solve(shift, np.broadcast_to(B, (len(s), *B.shape)))
        )

    def slow_rows(self) -> RealArray:
        """Return the output rows of the motion with real poles."""
        A, _, C = self.slow
        return np.stack([C, C @ A, C @ A @ A])[self.powers, np.arange(len(C))]

    def _through(self, kept: BoolArray) -> tuple[RealArray, RealArray]:
        """Return the feed-through, and the part that acts in the band only.

        The first is the static flexibility of omitted modes, or the jump of an acceleration; the
        second is the remaining jump of a velocity.
        """
        R = np.einsum("im,jm->mij", self.at_outputs, self.at_inputs)
        static = -2.0 * (R / self.poles[:, None, None])[~kept].real.sum(axis=0)
        speed = 2.0 * R[kept].real.sum(axis=0)
        jump = 2.0 * (R * self.poles[:, None, None])[kept].real.sum(axis=0)
        A, B, C = self.slow
        if len(A):
            jump = jump + C @ A @ B
            speed = speed + C @ B
        nothing = np.zeros_like(static)
        speed[np.abs(speed) <= COMPLEX_MODES.residue_rounding * np.abs(R).sum(axis=0)] = 0.0
        whole = np.choose(self.powers[:, None], [static, nothing, jump])
        return whole, np.choose(self.powers[:, None], [nothing, speed, nothing])

    def blocks(self, kept: BoolArray, right: ComplexArray) -> tuple[RealArray, RealArray]:
        """Return A and B: the slow part, and real blocks [[a, b], [-b, a]] of the poles a + ib."""
        A0, B0, _ = self.slow
        poles = self.poles[kept]
        n, m = len(A0), len(poles)
        A, B = np.zeros((n + 2 * m, n + 2 * m)), np.zeros((n + 2 * m, len(right)))
        A[:n, :n], B[:n] = A0, B0
        first = n + 2 * np.arange(m)
        second = first + 1
        A[first, first] = A[second, second] = poles.real
        A[first, second], A[second, first] = poles.imag, -poles.imag
        B[first], B[second] = right.real.T, -right.imag.T
        return A, B

    def matrices(self, kept: BoolArray) -> Matrices:
        """Return A, B, C, D: the slow part, a block per pair of poles, and the fast part."""
        left, right = self.at_outputs[:, kept], self.at_inputs[:, kept]
        # Scale both sides of a residue to equal norms.
        balance = np.sqrt(
            np.linalg.norm(left, axis=0) / np.maximum(np.linalg.norm(right, axis=0), 1e-300)
        )
        balance[balance == 0.0] = 1.0
        A0, B0 = self.blocks(kept, right * balance)
        grown = 2.0 * (left / balance) * self.poles[kept] ** self.powers[:, None]
        through, jump = self._through(kept)
        rolled = np.flatnonzero(jump.any(axis=0))  # one state per input
        fast = np.full(len(rolled), self.fast)
        A = scipy.linalg.block_diag(A0, -np.diag(fast))
        B = np.vstack([B0, fast[:, None] * np.eye(B0.shape[1])[rolled]])
        pairs = np.stack([grown.real, grown.imag], axis=2).reshape(len(left), -1)
        return A, B, np.hstack([self.slow_rows(), pairs, jump[:, rolled]]), through


def complex_modes(space: ModalSpace, powers: IndexArray, top: float) -> ComplexModes:
    """Return the complex modes, `top` in Hz; raises ModelError for a defective pole."""
    slow_A, slow_B, slow_C, n_slow = _slow_matrices(space)
    r = len(space)
    wanted = (2 * r - n_slow) // 2
    poles, vectors = _highest_poles(space, space.structural(0.0), wanted)
    if space.has_table:  # loss factors at the frequency of each pole
        poles, vectors = _follow_poles(space, poles, vectors, wanted)
    poles = np.where(poles.real > 0.0, 1j * poles.imag, poles)
    poles = np.minimum(poles.real, -1e-12 * np.abs(poles)) + 1j * poles.imag
    order = np.argsort(np.abs(poles), kind="stable")
    poles, vectors = poles[order], vectors[:, order]
    slow = slow_A, slow_B @ space.inputs.T, space.outputs @ slow_C
    fast = COMPLEX_MODES.velocity_pole_factor * _TWO_PI * top
    return ComplexModes(poles, space.outputs @ vectors, space.inputs @ vectors, slow, powers, fast)


def slow_motion(space: ModalSpace) -> tuple[RealArray, RealArray, RealArray, IndexArray]:
    """Return A, B, C (of displacements) of the motion with real poles, and its velocity states."""
    A, B, C, n = _slow_matrices(space)
    still = len(_undamped_rigid(space))
    return A, B @ space.inputs.T, space.outputs @ C, np.arange(n - still, n)


def _first_order(space: ModalSpace, stiffness: NumberArray) -> NumberArray:
    r = len(space)
    out: NumberArray = np.zeros((2 * r, 2 * r), dtype=stiffness.dtype)
    out[:r, r:], out[r:, :r], out[r:, r:] = np.eye(r), -stiffness, -space.viscous
    return out


def _highest_poles(
    space: ModalSpace, D: RealArray, wanted: int
) -> tuple[ComplexArray, ComplexArray]:
    """Return the poles with the largest imaginary parts, and their vectors."""
    values, vectors = np.linalg.eig(_first_order(space, np.diag(space.omega**2) + 1j * D))
    top = np.argsort(-values.imag, kind="stable")[:wanted]
    values, U = values[top], vectors[: len(space), top]
    norm = np.einsum("im,im->m", U, 2.0 * values * U + space.viscous @ U)
    if (np.abs(norm) <= 1e-12 * np.abs(values) * np.einsum("im,im->m", np.abs(U), np.abs(U))).any():
        raise ModelError("plant: two modes of the damped structure coincide; use route='modal'")
    return values, U / np.sqrt(norm)


def _follow_poles(
    space: ModalSpace, poles: ComplexArray, vectors: ComplexArray, wanted: int
) -> tuple[ComplexArray, ComplexArray]:
    """Return each pole for the loss factors at its own frequency."""
    poles, vectors = poles.copy(), vectors.copy()
    for j in range(len(poles)):
        for _ in range(3):
            found, U = _highest_poles(space, space.structural(abs(poles[j]) / _TWO_PI), wanted)
            overlap = np.abs(vectors[:, j].conj() @ U) / np.linalg.norm(U, axis=0)
            near = int(np.argmax(overlap / (1.0 + np.abs(found - poles[j]) / np.abs(poles[j]))))
            poles[j], vectors[:, j] = found[near], U[:, near]
    return poles, vectors


def _slow_matrices(space: ModalSpace) -> tuple[RealArray, RealArray, RealArray, int]:
    """Return A, B (of modal forces) and C (modal motion) of the real poles, without D."""
    r, still = len(space), _undamped_rigid(space)
    A = np.zeros((0, 0))
    B, C = np.zeros((0, r)), np.zeros((r, 0))
    rest = np.setdiff1d(np.arange(r), still)
    if space.viscous.any():
        ports = np.eye(len(rest))
        viscous = space.viscous[np.ix_(rest, rest)]
        part = ModalSpace(space.omega[rest], 0, ports, ports, viscous, (), "")
        A, B_part, C_part = _real_poles(part)
        B, C = np.zeros((len(A), r)), np.zeros((r, len(A)))
        B[:, rest], C[rest] = B_part, C_part
    n, k = len(A), len(still)
    whole = np.zeros((n + 2 * k,) * 2)
    whole[:n, :n] = A
    whole[n : n + k, n + k :] = np.eye(k)
    forces, motion = np.zeros((n + 2 * k, r)), np.zeros((r, n + 2 * k))
    forces[:n], motion[:, :n] = B, C
    forces[n + k + np.arange(k), still] = 1.0
    motion[still, n + np.arange(k)] = 1.0
    return whole, forces, motion, len(whole)


def _undamped_rigid(space: ModalSpace) -> IndexArray:
    """Return rigid-body modes without a damper: double poles at 0."""
    damping = np.abs(space.viscous[: space.rigid]).max(axis=1, initial=0.0)
    return np.flatnonzero(
        damping <= 1e-12 * max(float(np.abs(space.viscous).max(initial=0.0)), 1e-300)
    )


def _real_poles(space: ModalSpace) -> tuple[RealArray, RealArray, RealArray]:
    """Return A, B, C of the part with real poles, by Schur form and a Sylvester equation."""
    A = _first_order(space, np.diag(space.omega**2))
    r = len(space)
    ratio, moving = COMPLEX_MODES.real_pole_ratio, space.omega[space.omega > 0]
    floor = ratio * float(moving.min()) if len(moving) else 0.0

    def is_real(a: float, b: float) -> bool:
        return bool(abs(b) <= max(ratio * np.hypot(a, b), floor))

    T, Q, n = scipy.linalg.schur(A, sort=is_real)
    if n == 0:
        return np.zeros((0, 0)), np.zeros((0, r)), np.zeros((r, 0))
    X = scipy.linalg.solve_sylvester(T[:n, :n], -T[n:, n:], -T[:n, n:])
    into = Q.T[:n, r:] - X @ Q.T[n:, r:]
    return T[:n, :n], into, Q[:r, :n]


@dataclass(frozen=True, slots=True, eq=False)
class FittedModes:
    """Complex modes and real poles with outputs fitted to a target.

    `extra` are the real poles in rad/s, each with one state per input. With `at_rest`, velocities
    and accelerations of a supported structure are exactly 0 at s = 0, as those of the structure.
    """

    base: ComplexModes
    target: ResponseTarget
    extra: RealArray
    at_rest: bool = True
    name: str = "complex"

    @property
    def frequency(self) -> RealArray:
        """Natural frequency of each mode in Hz."""
        return self.base.frequency

    @property
    def always_kept(self) -> BoolArray:
        """Mask without any candidate, as rigid-body motion is not a candidate."""
        return self.base.always_kept

    def costs(self, freq: RealArray, level: RealArray) -> RealArray:
        """Return the relative change without each mode, before the fit."""
        return self.base.costs(freq, level)

    def response(self, kept: BoolArray, freq: RealArray) -> ComplexArray:
        """Return the response with a selection of modes."""
        rows, through = self._fit(kept)
        modal = np.einsum("yk,fku->fyu", rows, self._states(kept, freq))
        return np.asarray(self.base.slow_response(laplace_variable(freq)) + modal + through)

    def matrices(self, kept: BoolArray) -> Matrices:
        """Return A, B, C, D: the slow part, a block per pair of poles, real poles."""
        rows, through = self._fit(kept)
        A0, B0 = self.base.blocks(kept, self.base.at_inputs[:, kept])
        n_u = B0.shape[1]
        A = scipy.linalg.block_diag(A0, -np.diag(np.repeat(self.extra, n_u)))
        B = np.vstack([B0, *(rate * np.eye(n_u) for rate in self.extra)])
        return A, B, np.hstack([self.base.slow_rows(), rows]), through

    def _states(self, kept: BoolArray, freq: RealArray) -> ComplexArray:
        """Return the states of modes and real poles, shape (n_f, k, n_u), for unit inputs."""
        s, right = laplace_variable(freq), self.base.at_inputs[:, kept].T
        poles = self.base.poles[kept]
        up = right / (s[:, None, None] - poles[:, None])
        down = right.conj() / (s[:, None, None] - poles.conj()[:, None])
        pairs = (
            np.stack([up + down, 1j * (up - down)], axis=2).reshape(
                len(s), 2 * len(poles), len(right.T)
            )
            / 2.0
        )
        real_states = self.extra / (s[:, None] + self.extra)
        eye = np.eye(right.shape[1])
        return np.concatenate(
            [pairs, (real_states[:, :, None, None] * eye).reshape(len(s), -1, right.shape[1])],
            axis=1,
        )

    def _fit(self, kept: BoolArray) -> tuple[RealArray, RealArray]:
        """Return the rows of the outputs for these states, and the feed-through."""
        target, n_u = self.target, len(self.base.at_inputs)
        states = self._states(kept, target.freq)
        wanted = target.values - self.base.slow_response(laplace_variable(target.freq))
        weight = 1.0 / np.maximum(target.broad, np.abs(target.values))
        if target.measure == "relative":
            weight = 1.0 / target.reference
        rows, through = (
            np.zeros((len(self.base.powers), states.shape[1])),
            np.zeros((len(self.base.powers), n_u)),
        )
        eye = np.broadcast_to(np.eye(n_u), (len(states), n_u, n_u))
        rest, slow_rest = self._rest(kept)
        for i, power in enumerate(self.base.powers):
            known, still = states, rest
            if power != 1:  # velocities have no feed-through
                known, still = np.concatenate([states, eye], axis=1), np.vstack([rest, np.eye(n_u)])
            zero = self.at_rest and power > 0 and self.base.is_supported
            A = (known * weight[:, i, None, :]).transpose(0, 2, 1)
            A = A.reshape(len(known) * n_u, known.shape[1])
            b = (wanted[:, i] * weight[:, i]).ravel()
            real = np.vstack([A.real, A.imag])
            found = _constrained_least_squares(
                real,
                np.concatenate([b.real, b.imag]),
                still.T[: n_u * zero],
                -slow_rest[i, : n_u * zero],
            )
            rows[i] = found[: states.shape[1]]
            if power != 1:
                through[i] = found[states.shape[1] :]
        return rows, through

    def _rest(self, kept: BoolArray) -> tuple[RealArray, RealArray]:
        """Return the states at s = 0, shape (k, n_u), and the slow part of a supported model."""
        zero = np.zeros(1)
        slow = np.zeros((len(self.base.powers), len(self.base.at_inputs)))
        if self.base.is_supported:
            slow = self.base.slow_response(laplace_variable(zero))[0].real
        return self._states(kept, zero)[0].real, slow


def _constrained_least_squares(A: RealArray, b: RealArray, E: RealArray, d: RealArray) -> RealArray:
    """Return x of the least |A x - b| with E x = d, by a basis of the null space of E."""
    scale = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
    A, E = A / scale, E / scale
    start: RealArray = np.zeros(A.shape[1])
    free: RealArray = np.eye(A.shape[1])
    if len(E):
        size = np.maximum(np.linalg.norm(E, axis=1), 1e-300)
        E, d = E / size[:, None], d / size
        start = np.asarray(np.linalg.lstsq(E, d, rcond=None)[0], dtype=np.float64)
        free = scipy.linalg.null_space(E)
    found = np.linalg.lstsq(A @ free, b - A @ start, rcond=COMPLEX_MODES.singular_share)[0]
    return np.asarray((start + free @ found) / scale)


def fit_outputs(
    base: ComplexModes, target: ResponseTarget, n: int, *, at_rest: bool = True
) -> FittedModes:
    """Return complex modes with fitted outputs and n real poles, evenly spaced in log frequency."""
    factor = COMPLEX_MODES.band_factor
    low, high = max(target.freq[0], 1e-3 * target.freq[-1]) / factor, target.freq[-1] * factor
    return FittedModes(base, target, _TWO_PI * np.geomspace(low, high, n), at_rest)
