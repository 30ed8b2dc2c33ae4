"""Real modes with a real damping matrix: q'' + C q' + Omega^2 q = Phi_u^T u, y = Phi_y q.

Structural damping is not causal as it stands: iD has no counterpart in time. In real modes it
becomes

    C_rs = phi_r^T D phi_s / sqrt(omega_r omega_s),

which equals D at resonance, keeps it symmetric and positive semidefinite (so that every pole is
stable and the plant passive), and couples the modes as D does. Its diagonal alone, the usual modal
damping ratios, loses that coupling; D divided by one frequency is right at that frequency only. A
loss factor with a table is taken at sqrt(f_r f_s).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.control.conversion import Matrices, imaginary, rates
from updyn.control.space import ModalSpace, nonnegative

__all__ = ["SecondOrder", "diagonal", "full", "single_frequency"]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]
_TWO_PI = 2.0 * np.pi


@dataclass(frozen=True, slots=True, eq=False)
class SecondOrder:
    """Modes with a damping matrix.

    Attributes
    ----------
    name : str
        Which conversion made the damping.
    space : ModalSpace
        The modes.
    damping : ndarray of float, shape (r, r)
        All damping, viscous included, in 1/s.
    powers : ndarray of int, shape (n_y,)
        0, 1 or 2: displacement, velocity or acceleration.
    """

    name: str
    space: ModalSpace
    damping: _Real
    powers: NDArray[np.intp]

    @property
    def frequency(self) -> _Real:
        """Natural frequency of each mode in Hz."""
        return self.space.omega / _TWO_PI

    @property
    def always(self) -> NDArray[np.bool_]:
        """Rigid-body modes."""
        return np.arange(len(self.space)) < self.space.rigid

    def costs(self, freq: _Real) -> _Real:
        """Return what leaving each mode out changes, its coupling to others aside."""
        space, s = self.space, imaginary(freq)
        square = np.where(self.always, 1.0, space.omega**2)
        with np.errstate(divide="ignore", invalid="ignore"):  # a mode without damping, on a line
            own = 1.0 / (
                square[None, :] + s[:, None] * np.diag(self.damping) + s[:, None] ** 2
            )  # (n_f, r)
        size = rates(self.powers, s)[:, :, 0]
        out = np.empty((len(space), len(space.outputs), len(space.inputs)))
        for i, power in enumerate(self.powers):
            left = own - 1.0 / square if power == 0 else own
            largest = np.abs(left * size[:, [i]]).max(axis=0)
            out[:, i] = largest[:, None] * np.abs(space.outputs[i][:, None] * space.inputs.T)
        return out

    def potential(self, freq: _Real) -> _Real:
        """Return how large each channel might be by what its two ports have each: |H_ij|^2 <= H_ii H_jj, by mode.

        Parameters
        ----------
        freq : ndarray of float, shape (n_f,)
            Lines in Hz.

        Returns
        -------
        ndarray of float, shape (n_y, n_u)
        """
        space, s = self.space, imaginary(freq)
        square = space.omega**2
        size = np.abs(rates(self.powers, s)[:, :, 0])
        with np.errstate(divide="ignore"):  # a mode without damping, on a line
            own = np.abs(1.0 / (square + s[:, None] * np.diag(self.damping) + s[:, None] ** 2))
        peak = np.stack(
            [np.minimum(own * size[:, [i]], 1e300).max(axis=0) for i in range(len(self.powers))]
        )
        return np.asarray(
            np.sqrt((peak * space.outputs**2).sum(axis=1)[:, None] * (peak @ space.inputs.T**2))
        )

    def response(self, kept: NDArray[np.bool_], freq: _Real) -> _Complex:
        """Return the response with some modes kept."""
        space, s = self.space, imaginary(freq)
        Z = s[:, None, None] * self.damping[np.ix_(kept, kept)]
        at = np.arange(int(kept.sum()))
        Z[:, at, at] += space.omega[kept] ** 2 + s[:, None] ** 2
        q = np.linalg.solve(
            Z, np.broadcast_to(space.inputs[:, kept].T, (len(s), len(at), len(space.inputs)))
        )
        return (space.outputs[:, kept] @ q) * rates(self.powers, s) + self._static(kept)

    def _static(self, kept: NDArray[np.bool_]) -> _Real:
        """Return the flexibility of what is left out, where the output is a displacement."""
        space, out = self.space, ~kept
        rest = (space.outputs[:, out] / space.omega[out] ** 2) @ space.inputs[:, out].T
        return np.where((self.powers == 0)[:, None], rest, 0.0)

    def matrices(self, kept: NDArray[np.bool_]) -> Matrices:
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


def full(space: ModalSpace, powers: NDArray[np.intp]) -> SecondOrder:
    """Return the modes with the full modal damping matrix.

    Parameters
    ----------
    space : ModalSpace
        The modes.
    powers : ndarray of int, shape (n_y,)
        Of each output.
    """
    return SecondOrder("modal", space, space.viscous + _structural(space), powers)


def diagonal(space: ModalSpace, powers: NDArray[np.intp]) -> SecondOrder:
    """Return the modes with its diagonal alone: a damping ratio each."""
    return SecondOrder(
        "diagonal", space, np.diag(np.diag(space.viscous + _structural(space))), powers
    )


def single_frequency(space: ModalSpace, powers: NDArray[np.intp], freq: float) -> SecondOrder:
    """Return the modes with D divided by one circular frequency, that of a line in Hz."""
    D = space.structural(freq)
    return SecondOrder("single-frequency", space, space.viscous + D / (_TWO_PI * freq), powers)


def _structural(space: ModalSpace) -> _Real:
    n = space.rigid
    root = np.sqrt(space.omega[n:])
    C = np.zeros((len(space), len(space)))
    for part in space.lossy:
        between = np.outer(root, root)
        own = part.matrix[n:, n:] / between
        C[n:, n:] += own * part.relative(between.ravel() / _TWO_PI).reshape(own.shape)
    return nonnegative(C)
