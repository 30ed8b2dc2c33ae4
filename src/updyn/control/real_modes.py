"""Real modes with a real damping matrix: q'' + C q' + Omega^2 q = Phi_u^T u, y = Phi_y q.

Structural damping D is not causal. In real modes it becomes

    C_rs = phi_r^T D phi_s / sqrt(omega_r omega_s),

which equals D at resonance, is symmetric and positive semidefinite (so every pole is stable and the
plant passive), and couples the modes as D does. Its diagonal, the modal damping ratios, loses that
coupling; D divided by one frequency is correct at that frequency only. A table of loss factors is
evaluated at sqrt(f_r f_s).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls

from updyn.arrays import BoolArray, ComplexArray, IndexArray, RealArray
from updyn.control.settings import REAL_MODES
from updyn.control.space import (
    Lossy,
    Matrices,
    ModalSpace,
    derivative_factors,
    laplace_variable,
    nearest_semidefinite,
)
from updyn.errors import ModelError

__all__ = [
    "Biot",
    "Relaxation",
    "SecondOrder",
    "biot",
    "diagonal_damping_modes",
    "full_damping_modes",
    "relaxation",
    "single_frequency_modes",
]

_TWO_PI = 2.0 * np.pi


@dataclass(frozen=True, slots=True, eq=False)
class SecondOrder:
    """Modes with a damping matrix in 1/s, shape (r, r), including viscous damping."""

    name: str
    space: ModalSpace
    damping: RealArray
    powers: IndexArray

    @property
    def frequency(self) -> RealArray:
        """Natural frequency of each mode in Hz."""
        return self.space.omega / _TWO_PI

    @property
    def always_kept(self) -> BoolArray:
        """Mask of rigid-body modes."""
        return np.arange(len(self.space)) < self.space.rigid

    def costs(self, freq: RealArray, level: RealArray) -> RealArray:
        """Return the relative change without each mode, neglecting its coupling."""
        space, s = self.space, laplace_variable(freq)
        square = np.where(self.always_kept, 1.0, space.omega**2)
        with np.errstate(divide="ignore", invalid="ignore"):  # a mode without damping, on a line
            receptance = 1.0 / (
                square[None, :] + s[:, None] * np.diag(self.damping) + s[:, None] ** 2
            )  # (n_f, r)
        size = derivative_factors(self.powers, s)[:, :, 0]
        out = np.zeros(len(space))
        for i, power in enumerate(self.powers):
            dynamic = receptance
            if power == 0:
                dynamic = receptance - 1.0 / square
            change = np.abs(dynamic * size[:, [i]])
            for j, shape in enumerate(space.inputs):
                largest = (change / level[:, i, j, None]).max(axis=0)
                out = np.maximum(out, largest * np.abs(space.outputs[i] * shape))
        return out

    def potential(self, freq: RealArray) -> RealArray:
        """Return a bound of each channel, (n_f, n_y, n_u): |H_ij|^2 <= H_ii H_jj of its ports."""
        space, s = self.space, laplace_variable(freq)
        size = np.abs(derivative_factors(self.powers, s)[:, :, 0])
        with np.errstate(divide="ignore"):  # a mode without damping, on a line
            receptance = np.abs(
                1.0 / (space.omega**2 + s[:, None] * np.diag(self.damping) + s[:, None] ** 2)
            )
        receptance = np.minimum(receptance, 1e150)
        outputs, inputs = (
            np.sqrt(receptance @ space.outputs.T**2),
            np.sqrt(receptance @ space.inputs.T**2),
        )
        return np.asarray((size * outputs)[:, :, None] * inputs[:, None, :])

    def response(self, kept: BoolArray, freq: RealArray) -> ComplexArray:
        """Return the response with a selection of modes."""
        space, s = self.space, laplace_variable(freq)
        Z = s[:, None, None] * self.damping[np.ix_(kept, kept)]
        at = np.arange(int(kept.sum()))
        Z[:, at, at] += space.omega[kept] ** 2 + s[:, None] ** 2
        q = np.linalg.solve(
            Z, np.broadcast_to(space.inputs[:, kept].T, (len(s), len(at), len(space.inputs)))
        )
        return (space.outputs[:, kept] @ q) * derivative_factors(self.powers, s) + self._static(
            kept
        )

    def _static(self, kept: BoolArray) -> RealArray:
        """Return the static flexibility of omitted modes for displacements."""
        space, out = self.space, ~kept
        rest = (space.outputs[:, out] / space.omega[out] ** 2) @ space.inputs[:, out].T
        return np.where((self.powers == 0)[:, None], rest, 0.0)

    def matrices(self, kept: BoolArray) -> Matrices:
        """Return A, B, C, D in the states omega q (q of rigid-body modes) and q'."""
        space = self.space
        omega, damping = space.omega[kept], self.damping[np.ix_(kept, kept)]
        shapes_out, shapes_in = space.outputs[:, kept], space.inputs[:, kept]
        n = len(omega)
        scale = np.where(omega > 0, omega, 1.0)
        A = np.zeros((2 * n, 2 * n))
        A[:n, n:], A[n:, :n], A[n:, n:] = np.diag(scale), -np.diag(omega**2 / scale), -damping
        B = np.vstack([np.zeros_like(shapes_in.T), shapes_in.T])
        displacement = np.hstack([shapes_out / scale, np.zeros_like(shapes_out)])
        velocity = np.hstack([np.zeros_like(shapes_out), shapes_out])
        acceleration = shapes_out @ A[n:]
        C = np.stack([displacement, velocity, acceleration])[
            self.powers, np.arange(len(self.powers))
        ]
        D = np.where((self.powers == 2)[:, None], shapes_out @ shapes_in.T, self._static(kept))
        return A, B, C, D


def full_damping_modes(space: ModalSpace, powers: IndexArray) -> SecondOrder:
    """Return the modes with the full modal damping matrix."""
    return SecondOrder("modal", space, space.viscous + _structural(space), powers)


def diagonal_damping_modes(space: ModalSpace, powers: IndexArray) -> SecondOrder:
    """Return the modes with the diagonal of the damping matrix: modal damping ratios."""
    return SecondOrder(
        "diagonal", space, np.diag(np.diag(space.viscous + _structural(space))), powers
    )


def single_frequency_modes(space: ModalSpace, powers: IndexArray, freq: float) -> SecondOrder:
    """Return the modes with D divided by one circular frequency, given in Hz."""
    D = space.structural(freq)
    return SecondOrder("single-frequency", space, space.viscous + D / (_TWO_PI * freq), powers)


def _structural(space: ModalSpace) -> RealArray:
    n = space.rigid
    root = np.sqrt(space.omega[n:])
    C = np.zeros((len(space), len(space)))
    for part in space.lossy:
        between = np.outer(root, root)
        modal_damping = part.matrix[n:, n:] / between
        C[n:, n:] += modal_damping * part.relative(between.ravel() / _TWO_PI).reshape(
            modal_damping.shape
        )
    return nearest_semidefinite(C)


@dataclass(frozen=True, slots=True, eq=False)
class Relaxation:
    """Relaxation function g(s) = sum of a s / (s + b), with a >= 0 and b in rad/s."""

    a: RealArray
    b: RealArray

    def at(self, omega: RealArray) -> ComplexArray:
        """Return g(i omega), of the shape of `omega`, in rad/s."""
        s = 1j * np.asarray(omega)[..., None]
        return np.asarray((self.a * (s / (s + self.b))).sum(axis=-1))


def relaxation(part: Lossy, band: tuple[float, float], n: int) -> Relaxation:
    """Return n relaxation terms fitted to the loss factor of a group over a band in Hz."""
    # Rates are evenly spaced in log frequency; the weights are by non-negative least squares.
    low, high = max(band[0], 1e-4 * band[1]), band[1]
    freq = np.geomspace(low, high, REAL_MODES.fitted_lines)
    omega = _TWO_PI * freq
    wanted = part.relative(freq)
    best, least = None, np.inf
    for beyond in (1.0, 1.5, 2.0, 3.0, 5.0):
        if n > 1:
            b = np.geomspace(omega[0] / beyond, omega[-1] * beyond, n)
        else:
            b = np.sqrt(omega[[0]] * omega[[-1]])
        shares = b * omega[:, None] / (omega[:, None] ** 2 + b**2)
        a, residual = nnls(shares, wanted)
        if residual < least:
            best, least = Relaxation(a, b), residual
    assert best is not None
    return best


@dataclass(frozen=True, slots=True, eq=False)
class Biot:
    """Modes with internal variables: one relaxation per lossy group, all with the same rates.

    `base` are the modes with viscous damping only; `ranking`, with the full modal damping matrix,
    ranks them.
    """

    base: SecondOrder
    ranking: SecondOrder
    terms: tuple[Relaxation, ...]
    name: str = "biot"

    @property
    def frequency(self) -> RealArray:
        """Natural frequency of each mode in Hz."""
        return self.base.frequency

    @property
    def always_kept(self) -> BoolArray:
        """Mask of rigid-body modes."""
        return self.base.always_kept

    def costs(self, freq: RealArray, level: RealArray) -> RealArray:
        """Return the relative change without each mode."""
        return self.ranking.costs(freq, level)

    def _stiffness(self, kept: BoolArray) -> RealArray:
        """Return the static stiffness of the selected modes, without that of the relaxing terms."""
        space = self.base.space
        omega = space.omega[kept]
        K = np.diag(omega**2)
        pair = np.sqrt(np.outer(omega, omega))
        for part, term in zip(space.lossy, self.terms, strict=True):
            K -= part.matrix[np.ix_(kept, kept)] * term.at(pair).real
        first = int(self.always_kept[kept].sum())
        flexible = K[first:, first:]
        scale = omega[first:]
        if len(scale) and np.linalg.eigvalsh(flexible / np.outer(scale, scale))[0] <= 0.0:
            raise ModelError(
                "plant: route 'biot': the damping is so strong that a passive stiffness with this"
                " damping over the whole band would be negative at rest; narrow the band, or use"
                " route='complex'"
            )
        return K

    def _relaxing_terms(self, kept: BoolArray) -> list[tuple[float, RealArray]]:
        """Return rate and factor L of each term with the stiffness L L^T."""
        out = []
        lossy = self.base.space.lossy
        for k in range(len(self.terms[0].b) if self.terms else 0):
            W = np.zeros_like(lossy[0].matrix)
            for part, term in zip(lossy, self.terms, strict=True):
                W = W + term.a[k] * part.matrix
            values, vectors = np.linalg.eigh(
                nearest_semidefinite(np.asarray(W)[np.ix_(kept, kept)])
            )
            use = values > REAL_MODES.stiffness_share * max(values[-1], 1e-300)
            if use.any() and values[-1] > 0:
                out.append((float(self.terms[0].b[k]), vectors[:, use] * np.sqrt(values[use])))
        return out

    def response(self, kept: BoolArray, freq: RealArray) -> ComplexArray:
        """Return the response with a selection of modes."""
        space, s = self.base.space, laplace_variable(freq)
        Z = s[:, None, None] * self.base.damping[np.ix_(kept, kept)] + self._stiffness(kept)
        at = np.arange(int(kept.sum()))
        Z[:, at, at] += s[:, None] ** 2
        for rate, L in self._relaxing_terms(kept):
            Z += (s / (s + rate))[:, None, None] * (L @ L.T)
        q = np.linalg.solve(
            Z, np.broadcast_to(space.inputs[:, kept].T, (len(s), len(at), len(space.inputs)))
        )
        return (space.outputs[:, kept] @ q) * derivative_factors(
            self.base.powers, s
        ) + self.base._static(kept)

    def matrices(self, kept: BoolArray) -> Matrices:
        """Return A, B, C, D; the last states are the internal variables, z' = -b z + L^T q'."""
        A0, B0, C0, D = self.base.matrices(kept)
        n = int(kept.sum())
        omega = self.base.space.omega[kept]
        scale = np.where(omega > 0, omega, 1.0)
        A0[n:, :n] = -self._stiffness(kept) / scale
        relaxing = self._relaxing_terms(kept)
        more = sum(L.shape[1] for _, L in relaxing)
        A = np.zeros((2 * n + more,) * 2)
        A[: 2 * n, : 2 * n] = A0
        first = 2 * n
        for rate, L in relaxing:
            states = slice(first, first + L.shape[1])
            A[states, states] = -rate * np.eye(L.shape[1])
            A[states, n : 2 * n], A[n : 2 * n, states] = L.T, -L
            first = states.stop
        C = np.hstack([C0, np.zeros((len(C0), more))])
        if (self.base.powers == 2).any():
            C[self.base.powers == 2] = (self.base.space.outputs[:, kept] @ A[n : 2 * n])[
                self.base.powers == 2
            ]
        return A, np.vstack([B0, np.zeros((more, B0.shape[1]))]), C, D


def biot(space: ModalSpace, ranking: SecondOrder, band: tuple[float, float], n: int) -> Biot:
    """Return the modes with n internal variables per lossy motion, fitted over a band in Hz."""
    plain = replace(ranking, name="viscous", damping=space.viscous)
    return Biot(plain, ranking, _with_same_rates(space, band, n))


def _with_same_rates(
    space: ModalSpace, band: tuple[float, float], n: int
) -> tuple[Relaxation, ...]:
    """Return terms with the rates of the first group, fitted to the loss factors of all groups."""
    found = [relaxation(part, band, n) for part in space.lossy]
    if not found or all(np.array_equal(f.b, found[0].b) for f in found):
        return tuple(found)
    b = found[0].b
    omega = _TWO_PI * np.geomspace(max(band[0], 1e-4 * band[1]), band[1], REAL_MODES.fitted_lines)
    shares = b * omega[:, None] / (omega[:, None] ** 2 + b**2)
    return tuple(Relaxation(nnls(shares, p.relative(omega / _TWO_PI))[0], b) for p in space.lossy)
