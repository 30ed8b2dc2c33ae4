"""The error that is stated of a reduced model.

It is the difference to the answer in a larger basis, what the residuals in that basis leave, and
rounding.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.dynamics.affine import State
from updyn.dynamics.basis import Basis
from updyn.dynamics.fields import line_blocks
from updyn.dynamics.line_residuals import Channels, LineResiduals
from updyn.dynamics.reduced_solver import ReducedSolver
from updyn.linalg.solver import Factorised

__all__ = ["Certificate", "Estimate"]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]

#: Factor on the difference to a larger basis.
_OF_DIFFERENCE = 2.0
#: Factor on the error that residuals give of the larger basis, at other lines and near resonance.
_OF_REMAINING = 16.0
#: Factors on the errors of rounding in the entries of the matrices and in dense factorisations.
_IN_ENTRIES, _IN_FACTORS = 2.0, 0.5
#: Lines at which the error of the larger basis is computed.
_VALIDATION = 4


@dataclass(frozen=True, slots=True, eq=False)
class Certificate:
    """The certified error of a reduced model.

    Attributes
    ----------
    size : int
        Number of basis vectors.
    error : float
        Largest of `errors` as a share of the largest |H| of its line, rounding included.
    channel : float
        Largest error of a channel as a share of the rms |H| of the channel, at most 1: what `error`
        does not show of channels that are weak beside others.
    rounding : float
        What rounding has in `error`.
    errors : ndarray of float, shape (n_f, n_rows, n_columns)
        Stated |H_reduced - H| at every line, in m/N.
    lines : tuple of float
        Lines whose full residual was computed for it, in Hz.
    factorisations : int
        Real factorisations of the whole model so far.
    """

    size: int
    error: float
    channel: float
    rounding: float
    errors: _Real
    lines: tuple[float, ...]
    factorisations: int


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """The error of a reduced model at all lines, for all loaded DOFs and references.

    Attributes
    ----------
    channels : Channels
        What is loaded and read.
    H : ndarray of complex, shape (n_f, k, n_j)
        Receptance in the larger basis.
    level : ndarray of float, shape (n_f, k, n_j)
        The largest |H| of the line, of the same units.
    reduced, rounded : ndarray of float, shape (n_f, k, n_j)
        Stated error by the reduction and by rounding.
    """

    channels: Channels
    H: _Complex
    level: _Real
    reduced: _Real
    rounded: _Real

    @classmethod
    def beside(
        cls,
        wide: ReducedSolver,
        narrow: ReducedSolver,
        basis: Basis,
        channels: Channels,
        P: _Real,
        definite: Factorised,
        state: State,
        freq: _Real,
    ) -> Estimate:
        """Estimate the error of one basis beside a larger one that contains it.

        Parameters
        ----------
        wide, narrow : ReducedSolver
            In the larger basis, and in its first vectors.
        basis : Basis
            The larger one.
        channels : Channels
            What is loaded and read.
        P : ndarray of float, shape (r, r)
            K + omega_max^2 M in the larger basis.
        definite : Factorised
            P of the whole model, or of a state beside this one.
        state : State
            Of the model.
        freq : ndarray of float, shape (n_f,)
            All lines that matter, in Hz.

        Raises
        ------
        SolverError
            If a reduced model is singular at a line.
        """
        eps = float(np.finfo(np.float64).eps)
        loaded, forced = channels.loaded, channels.forced
        norms = np.array([np.linalg.norm(A) for A in basis.terms])
        parts, of_wide, of_narrow = [], wide.pencil(state, freq), narrow.pencil(state, freq)
        for block in line_blocks(len(freq), wide.block_size(len(loaded))):
            c = wide.system.coefficients(state, 2.0 * np.pi * freq[block])
            q = wide.solve(c, loaded, freq[block], of_wide)
            H = wide.at(q, loaded)[:, :, forced]
            fewer = narrow.solve(c, loaded[forced], freq[block], of_narrow)
            energy = np.sum((q.conj() * np.tensordot(P, q, axes=1)).real, axis=0)
            length = np.sum(np.abs(q) ** 2, axis=0) * (norms @ np.abs(c))[:, None]
            parts.append((H, narrow.at(fewer, loaded) - H, energy.T, length.T))
        H, difference = (
            np.concatenate(p, axis=1).transpose(1, 0, 2) for p in _columns(parts, 0, 2)
        )
        energy, length = (np.sqrt(np.concatenate(p, axis=1).T) for p in _columns(parts, 2, 4))
        level = channels.levels(H)
        factors = length[:, :, None] * length[:, None, forced]
        products = energy[:, :, None] * energy[:, None, forced]
        worst = _validation_lines(np.abs(difference) / level)
        lines = LineResiduals(wide, basis, channels, state, freq[worst])
        left = np.abs(lines.errors(definite.solve(lines.residual()))) / level[worst]
        remaining = left.max(axis=(0, 2))[:, None]
        entries = (lines.magnitudes() / products[worst]).max(axis=0)
        return cls(
            channels,
            H,
            level,
            _OF_DIFFERENCE * np.abs(difference) + _OF_REMAINING * remaining * level,
            eps * (_IN_ENTRIES * entries * products + _IN_FACTORS * factors),
        )

    @property
    def shares(self) -> _Real:
        """The largest share of each line that is the error by the reduction, shape (n_f,)."""
        return np.asarray((self.reduced / self.level).max(axis=(1, 2)))

    @property
    def reduction(self) -> float:
        """The largest of `shares`."""
        return float(self.shares.max())

    def certificate(self, size: int, lines: tuple[float, ...], factorisations: int) -> Certificate:
        """Return what is stated."""
        error = self.reduced + self.rounded
        measured = error[:, self.channels.read]
        rms = np.sqrt(np.mean(np.abs(self.H[:, self.channels.read]) ** 2, axis=0))
        rms = np.maximum(rms, np.finfo(np.float64).tiny)
        return Certificate(
            size,
            float((error / self.level).max()),
            min(float((measured / rms).max()), 1.0),
            float((self.rounded / self.level).max()),
            measured,
            lines,
            factorisations,
        )


def _columns(rows: list[Any], first: int, last: int) -> Any:
    """Return entries `first` to `last` of all rows, by entry."""
    return list(zip(*rows, strict=True))[first:last]


def _validation_lines(shares: _Real) -> list[int]:
    """Return the line of largest share, and the worst one of each quarter of the band."""
    worst = shares.max(axis=(1, 2))
    quarters = np.array_split(np.arange(len(worst)), min(_VALIDATION, len(worst)))
    return [int(q[np.argmax(worst[q])]) for q in quarters]
