"""`SpectralDecomposition`: one decomposition for the response of a damped structure at all lines.

With P = K + Omega^2 M, Omega the upper end of the band, and X^T P X = I, X^T Omega^2 M X =
diag(sigma), the dynamic stiffness without viscous damping is

    X^T Z X = S (I - (1 + omega^2 / Omega^2) N),   S = I + i X^T D X,   N = S^-1 diag(sigma),

so the eigenvalues mu and vectors V of the single matrix N give Z^-1 at every line: S and P are
never singular, even with rigid-body motion or motion without mass. Viscous damping of few dampers,
C = L L^T, is included by the matrix inversion lemma (Woodbury),

    H = H0 - i omega H0 L (I + i omega L^T H0 L)^-1 L^T H0.

If a loss factor depends on frequency, there are many dampers, or the eigenvectors are nearly
dependent, every line is solved separately.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from updyn.arrays import ComplexArray, RealArray
from updyn.control.settings import SPECTRAL
from updyn.control.space import ModalProjection
from updyn.dynamics.affine import State
from updyn.errors import ModelError, SolverError

__all__ = ["SpectralDecomposition"]

_TWO_PI = 2.0 * np.pi


@dataclass(frozen=True, slots=True, eq=False)
class SpectralDecomposition:
    """The response between the ports of a projection, at one state.

    `poles` of the damped structure above the real axis, in rad/s, are of first order in viscous
    damping. `modes` are mu, shape (r,), and vectors at outputs and dampers, (n_y + k, r), and at
    inputs and dampers, (n_u + k, r); None if every line is solved separately.
    """

    projection: ModalProjection
    state: State
    poles: ComplexArray
    modes: tuple[ComplexArray, ComplexArray, ComplexArray] | None

    @classmethod
    def of(cls, projection: ModalProjection, state: State) -> SpectralDecomposition:
        """Return the decomposition of a state; raises ModelError without stiffness and mass."""
        top = (_TWO_PI * projection.band[1]) ** 2
        M, D = projection.combine(state, "mass"), np.zeros_like(projection.matrices[0])
        for matrix, factor, loss in zip(projection.matrices, state.factor, state.loss, strict=True):
            D += factor * loss * matrix
        try:
            share, X = scipy.linalg.eigh(top * M, projection.combine(state, "stiffness") + top * M)
        except scipy.linalg.LinAlgError as error:
            raise ModelError(
                "plant: a motion has neither stiffness nor mass, or a negative one"
            ) from error
        S = np.eye(len(X)) + 1j * (X.T @ D @ X)
        mu, V = np.linalg.eig(np.linalg.solve(S, np.diag(share).astype(np.complex128)))
        dampers = _dampers(X.T @ projection.combine(state, "viscous") @ X)
        observed = np.vstack([projection.outputs @ X, dampers.T])
        forced = np.vstack([projection.inputs @ X, dampers.T])
        try:
            right = np.linalg.solve(S @ V, forced.T).T
        except np.linalg.LinAlgError:  # vectors of a multiple eigenvalue
            right = np.full((len(forced), len(mu)), np.nan, dtype=np.complex128)
        poles = _poles(mu, V, share, dampers, top)
        found = cls(projection, state, poles, (mu, observed @ V, right))
        many = dampers.shape[1] > SPECTRAL.most_dampers_share * len(X)
        tabled = any(t.table is not None for t in projection.system.terms)
        if many or tabled or not found._agrees():
            return cls(projection, state, poles, None)
        return found

    def receptance(self, freq: RealArray) -> ComplexArray:
        """Return the receptance at lines in Hz, shape (n_f, n_y, n_u)."""
        if self.modes is None:
            return self.solve_lines(freq)
        omega, (mu, left, right) = _TWO_PI * freq, self.modes
        top = (_TWO_PI * self.projection.band[1]) ** 2
        factors = 1.0 / (1.0 - (1.0 + omega[:, None] ** 2 / top) * mu)
        whole = (left[None] * factors[:, None, :]) @ right.T
        n_y, n_u = len(self.projection.outputs), len(self.projection.inputs)
        H = whole[:, :n_y, :n_u]
        if whole.shape[1] > n_y:
            rate = 1j * omega[:, None, None]
            around = np.eye(whole.shape[1] - n_y) + rate * whole[:, n_y:, n_u:]
            H = H - rate * (whole[:, :n_y, n_u:] @ np.linalg.solve(around, whole[:, n_y:, :n_u]))
        return np.asarray(H)

    def solve_lines(self, freq: RealArray) -> ComplexArray:
        """Return the receptance by a solution per line; raises SolverError if it is not finite."""
        projection, parts = self.projection, []
        stack = np.stack(projection.matrices)
        for first in range(0, len(freq), SPECTRAL.block_lines):
            omega = _TWO_PI * freq[first : first + SPECTRAL.block_lines]
            c = projection.system.coefficients(self.state, omega)
            Z = np.tensordot(c.T, stack, axes=1)
            loads = np.broadcast_to(projection.inputs.T, (len(omega), *projection.inputs.T.shape))
            try:
                parts.append(projection.outputs @ np.linalg.solve(Z, loads))
            except np.linalg.LinAlgError as error:
                raise SolverError(
                    f"plant: the structure has no finite response between {freq[first]:g} Hz and"
                    f" {omega[-1] / _TWO_PI:g} Hz: it is not damped"
                ) from error
        return np.concatenate(parts)

    def _agrees(self) -> bool:
        low, high = self.projection.band
        freq = np.geomspace(max(low, 1e-3 * high), high, SPECTRAL.checked_lines)
        exact, found = self.solve_lines(freq), self.receptance(freq)
        return bool((np.abs(found - exact) <= SPECTRAL.agreement * np.abs(exact)).all())


def _dampers(C: RealArray) -> RealArray:
    """Return L of C = L L^T, shape (r, k)."""
    size, axes = np.linalg.eigh(0.5 * (C + C.T))
    kept = size > SPECTRAL.damper_share * max(float(size.max(initial=0.0)), 1e-300)
    return np.asarray(axes[:, kept] * np.sqrt(size[kept]))


def _poles(
    mu: ComplexArray, V: ComplexArray, share: RealArray, dampers: RealArray, top: float
) -> ComplexArray:
    """Return the poles above the real axis, in rad/s: s^2 + c s + omega^2 = 0 for each vector."""
    mass = np.einsum("im,i,im->m", V, share, V) / top
    with np.errstate(divide="ignore", invalid="ignore"):
        square = top * (1.0 / mu - 1.0)
        rate = ((dampers.T @ V) ** 2).sum(axis=0) / mass
        root = np.sqrt(square - rate**2 / 4.0)
        poles = -rate / 2.0 + 1j * np.where(root.real < 0, -root, root)
    poles = poles[np.isfinite(poles)]
    return np.asarray(np.where(poles.real > 0.0, 1j * poles.imag, poles))
