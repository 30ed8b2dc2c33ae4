"""`Transfer`: a state-space system at many points at once, through one triangular form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import connected_components

from updyn.control.servo.state_space import StateSpace, balanced

__all__ = ["Transfer", "channel_zeros"]

_Complex = NDArray[np.complex128]


@dataclass(frozen=True, slots=True, eq=False)
class Transfer:
    """C (s I - A)^-1 B + D, with A in complex Schur form: a back substitution for all points together.

    Parts of the system that do not touch each other have a form of their own: rounding of fast
    modes does not reach the rigid-body motion.

    Attributes
    ----------
    parts : tuple of (ndarray, ndarray, ndarray)
        T (upper triangular), B and C of each part, shapes (n, n), (n, n_u), (n_y, n).
    D : ndarray of float, shape (n_y, n_u)
        Direct feed-through.
    """

    parts: tuple[tuple[_Complex, _Complex, _Complex], ...]
    D: NDArray[np.float64]

    @classmethod
    def of(cls, system: StateSpace) -> Transfer:
        """Return the triangular forms of a system, balanced before."""
        n_parts, part = (
            connected_components(system.A != 0.0, directed=False)
            if system.n_states
            else (0, np.zeros(0))
        )
        parts = []
        for k in range(n_parts):
            own = np.flatnonzero(part == k)
            A = system.A[np.ix_(own, own)]
            even, scale = balanced(A)
            T, Z = scipy.linalg.schur(even, output="complex")
            parts.append(
                (T, Z.conj().T @ (system.B[own] / scale[:, None]), (system.C[:, own] * scale) @ Z)
            )
        return cls(tuple(parts), system.D)

    @property
    def poles(self) -> _Complex:
        """Eigenvalues in rad/s, shape (n,)."""
        return np.concatenate(
            [np.zeros(0, dtype=np.complex128), *(np.diag(T) for T, _, _ in self.parts)]
        )

    def at(self, s: ArrayLike) -> _Complex:
        """Return the response, shape (*s.shape, n_y, n_u); not finite at a pole.

        Parameters
        ----------
        s : array_like of complex
            In rad/s.
        """
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


def channel_zeros(system: StateSpace) -> _Complex:
    """Return the finite zeros of a system with one input and one output, in rad/s.

    Those far beyond all poles are taken to be infinite: the pencil has them there by rounding.

    Parameters
    ----------
    system : StateSpace
        Of one input and one output.

    Notes
    -----
    Generalised eigenvalues of [[A, B], [C, D]] (Emami-Naeini & Van Dooren 1982, Automatica 18, p.
    415).
    """
    n = system.n_states
    if n == 0:
        return np.zeros(0, dtype=np.complex128)
    even, scale = balanced(system.A)
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
