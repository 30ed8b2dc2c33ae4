"""Residuals of a reduced model's responses in the equations of the full model."""

from __future__ import annotations

import numpy as np

from updyn.arrays import ComplexArray, IndexArray, RealArray
from updyn.dofs import DofSet
from updyn.dynamics.affine import State
from updyn.dynamics.basis import Basis
from updyn.dynamics.reduced_solver import ReducedSolver

__all__ = ["ChannelDofs", "LineResiduals"]


class ChannelDofs:
    """The DOFs of responses and references of a reduced model.

    `loaded` is the union of both, ascending, shape (k,); `read` and `forced` are their positions in
    it.
    """

    __slots__ = ("_turning", "forced", "loaded", "read")

    def __init__(self, rows: IndexArray, columns: IndexArray, dofs: DofSet) -> None:
        self.loaded = np.union1d(rows, columns)
        self.read, self.forced = (
            np.searchsorted(self.loaded, rows),
            np.searchsorted(self.loaded, columns),
        )
        self._turning = np.array([dofs[int(d)].direction.startswith("R") for d in self.loaded])

    def levels(self, H: ComplexArray) -> RealArray:
        """Return the largest |H| of each line among entries of the same unit, in the shape of H."""
        size, turning = np.abs(H), self._turning
        measured = np.isin(np.arange(len(turning)), self.read)
        out = np.empty(H.shape)
        for a in (False, True):
            for b in (False, True):
                pushed = turning[self.forced] == b
                block = (slice(None), *np.ix_(turning == a, pushed))
                seen = (slice(None), *np.ix_((turning == a) & measured, pushed))
                level = size[seen].max(axis=(1, 2), initial=0.0)
                # If no response of this unit is measured, use the motion at the forces.
                level = np.where(level > 0.0, level, size[block].max(axis=(1, 2), initial=0.0))
                out[block] = level[:, None, None]
        return np.maximum(out, np.finfo(np.float64).tiny)


class LineResiduals:
    """Responses of the reduced model at some lines, and their residuals in the full model.

    Fields are real arrays, (N, n_lines 2 n_j): for each line the real parts for all references,
    then the imaginary parts. Products of the real matrices with many columns take half the time of
    separate lines.
    """

    __slots__ = ("H", "_basis", "_c", "_channels", "_q")

    def __init__(
        self,
        solver: ReducedSolver,
        basis: Basis,
        channels: ChannelDofs,
        state: State,
        freq: RealArray,
    ) -> None:
        self._basis, self._channels = basis, channels
        self._c = solver.system.coefficients(state, 2.0 * np.pi * freq)
        self._q = solver.solve(self._c, channels.loaded, freq)
        #: Receptance of all loaded DOFs for the references, shape (n_lines, k, n_j).
        self.H = solver.at(self._q, channels.loaded)[:, :, channels.forced].transpose(1, 0, 2)

    def residual(self) -> RealArray:
        """Return e - Z V q for a unit force at each reference."""
        forced = self._channels.forced
        q = self._q[:, :, forced]
        moved = self._basis.expand(np.stack([q.real, q.imag], axis=2).reshape(len(q), -1))
        R = -self._times(moved)
        real = self._by_line(R)[:, :, 0]
        real[self._channels.loaded[forced], :, np.arange(len(forced))] += 1.0
        return R

    def errors(self, Y: RealArray) -> ComplexArray:
        """Return e_i^T y_j - q_i^T V^T Z y_j for all loaded DOFs i, shape (n_lines, k, n_j)."""
        direct = self._by_line(Y[self._channels.loaded])
        pulled = self._by_line(self._basis.project(self._times(Y)))
        direct, pulled = (A[:, :, 0] + 1j * A[:, :, 1] for A in (direct, pulled))
        return np.asarray(
            direct.transpose(1, 0, 2) - self._q.transpose(1, 2, 0) @ pulled.transpose(1, 0, 2)
        )

    def magnitudes(self) -> RealArray:
        """Return |u_i|^T |Z| |u_j| for loaded DOFs i and references j, (n_lines, k, n_j)."""
        # |Z| is the sum of the magnitudes of its terms. Times the unit roundoff, this bounds the
        # change of H_ij by a rounding error in each matrix entry (Higham, Accuracy and Stability
        # of Numerical Algorithms (2002), section 7.2).
        out = np.zeros(self.H.shape)
        for line, sum_of in enumerate(out):
            q = self._q[:, line]
            fields = np.hypot(self._basis.expand(q.real), self._basis.expand(q.imag))
            forced = fields[:, self._channels.forced]
            for term, c in zip(self._basis.system.terms, self._c[:, line], strict=True):
                index = term.row_index
                sum_of += abs(c) * (fields[index].T @ (abs(term.local) @ forced[index]))
        return out

    def _by_line(self, U: RealArray) -> RealArray:
        """Return fields as (N, n_lines, 2, n_j), without a copy."""
        n_lines = self._c.shape[1]
        # A group without entries has no rows, so reshape cannot infer the number of columns.
        return U.reshape(len(U), n_lines, 2, U.shape[1] // (2 * n_lines))

    def _times(self, U: RealArray) -> RealArray:
        """Return Z U by groups, without assembling Z."""
        out = np.zeros_like(U)
        parts = self._by_line(out)
        for term, c in zip(self._basis.system.terms, self._c, strict=True):
            index, product = term.row_index, self._by_line(term.local @ U[term.row_index])
            parts[index] += c.real[:, None, None] * product
            if c.imag.any():
                parts[index, :, 0] -= c.imag[:, None] * product[:, :, 1]
                parts[index, :, 1] += c.imag[:, None] * product[:, :, 0]
        return out
