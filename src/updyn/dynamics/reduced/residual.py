"""What the whole model says to a reduced model's answer at one line."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from updyn.dofs import DofSet
from updyn.dynamics.affine import State
from updyn.dynamics.reduced.basis import Basis
from updyn.dynamics.reduced.solver import ReducedSolver

__all__ = ["Channels", "LineResidual"]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]


class Channels:
    """Which DOFs are read and which are loaded.

    Parameters
    ----------
    rows, columns : ndarray of int
        DOFs of responses and of references.
    dofs : DofSet
        All DOFs of the model.

    Attributes
    ----------
    loaded : ndarray of int, shape (k,)
        Each of them once, ascending.
    read, forced : ndarray of int
        Where responses and references stand in `loaded`.
    """

    __slots__ = ("_turning", "forced", "loaded", "read")

    def __init__(self, rows: NDArray[np.intp], columns: NDArray[np.intp], dofs: DofSet) -> None:
        self.loaded = np.union1d(rows, columns)
        self.read, self.forced = (
            np.searchsorted(self.loaded, rows),
            np.searchsorted(self.loaded, columns),
        )
        self._turning = np.array([dofs[int(d)].direction.startswith("R") for d in self.loaded])

    def levels(self, H: _Complex) -> _Real:
        """Return the largest measured |H| of the same units.

        Parameters
        ----------
        H : ndarray of complex, shape (k, n_j)
            Receptance of all loaded DOFs for the references.

        Returns
        -------
        ndarray of float, shape (k, n_j)
        """
        size, turning, measured = np.abs(H), self._turning, np.isin(np.arange(len(H)), self.read)
        out = np.empty(H.shape)
        for a in (False, True):
            for b in (False, True):
                pushed = turning[self.forced] == b
                block, seen = (
                    np.ix_(turning == a, pushed),
                    np.ix_((turning == a) & measured, pushed),
                )
                # Where no response of this unit is measured, the motion at the forces themselves is
                # the level.
                out[block] = size[seen].max(initial=0.0) or size[block].max(initial=0.0)
        return np.maximum(out, np.finfo(np.float64).tiny)


class LineResidual:
    """The reduced model's answer at one line, and what the whole model says to it.

    Complex fields are real parts beside imaginary ones, shape (N, 2 n_j): the whole model's
    matrices are real.

    Parameters
    ----------
    solver : ReducedSolver
        The reduced model.
    basis : Basis
        Its motions.
    channels : Channels
        What is loaded and read.
    state : State
        Of the model.
    freq : float
        The line in Hz.
    """

    __slots__ = ("H", "_basis", "_c", "_channels", "_q")

    def __init__(
        self, solver: ReducedSolver, basis: Basis, channels: Channels, state: State, freq: float
    ) -> None:
        self._basis, self._channels = basis, channels
        self._c = solver.system.coefficients(state, np.array([2.0 * np.pi * freq]))
        q = solver.solve(self._c, channels.loaded, np.array([freq]))
        self._q = q[:, 0]
        #: Receptance of all loaded DOFs for the references, shape (k, n_j).
        self.H = solver.at(q, channels.loaded)[:, 0][:, channels.forced]

    def residual(self) -> _Real:
        """Return e - Z V q for a unit force at each reference."""
        forced = self._channels.forced
        q = self._q[:, forced]
        R = -self._times(self._basis.moved(np.hstack([q.real, q.imag])))
        R[self._channels.loaded[forced], np.arange(len(forced))] += 1.0
        return R

    def errors(self, Y: _Real) -> _Complex:
        """Return r_i^T y_j for all loaded DOFs i, shape (k, n_j), without their residuals: e_i^T y_j - q_i^T V^T Z y_j.

        Parameters
        ----------
        Y : ndarray of float, shape (N, 2 n_j)
            Fields y_j.
        """
        half = Y.shape[1] // 2
        own, pulled = Y[self._channels.loaded], self._basis.projected(self._times(Y))
        return np.asarray(
            own[:, :half]
            + 1j * own[:, half:]
            - self._q.T @ (pulled[:, :half] + 1j * pulled[:, half:])
        )

    def _times(self, U: _Real) -> _Real:
        """Return Z U, group by group: no matrix of the whole model is put together for a line."""
        out, half = np.zeros_like(U), U.shape[1] // 2
        for term, c in zip(self._basis.system.terms, self._c[:, 0], strict=True):
            own, product = term.own, term.local @ U[term.own]
            out[own] += c.real * product
            if c.imag:
                out[own, :half] -= c.imag * product[:, half:]
                out[own, half:] += c.imag * product[:, :half]
        return out
