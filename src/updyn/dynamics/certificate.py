"""The stated error of a reduced model.

It is the difference to a larger basis, the error of that basis by residuals, and rounding.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.dynamics.affine import State
from updyn.dynamics.basis import Basis
from updyn.dynamics.fields import split_into_blocks
from updyn.dynamics.line_residuals import ChannelDofs, LineResiduals
from updyn.dynamics.reduced_solver import ReducedSolver
from updyn.dynamics.settings import CERTIFICATE
from updyn.linalg.solver import Factorised

__all__ = ["Certificate", "ErrorEstimate", "square_norms"]

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True, eq=False)
class Certificate:
    """The certified error of a reduced model."""

    #: Number of basis vectors.
    size: int
    #: Largest of `errors` relative to the largest |H| of its line, rounding included.
    error: float
    #: Largest error of a channel relative to its rms |H|, at most 1; shows errors of weak channels.
    channel: float
    #: The part of `error` due to rounding.
    rounding: float
    #: Stated |H_reduced - H| at every line, shape (n_f, n_rows, n_columns), in m/N.
    errors: RealArray
    #: Lines of the full residuals, in Hz.
    lines: tuple[float, ...]
    #: Number of real factorisations of the full model so far.
    factorisations: int


@dataclass(frozen=True, slots=True, eq=False)
class ErrorEstimate:
    """The error of a reduced model at all lines; arrays (n_f, loaded DOFs, references).

    `H` is the receptance in the larger basis, `level` the largest |H| of the line among entries of
    the same unit, `reduced` and `rounded` are the stated errors by reduction and by rounding.
    """

    channels: ChannelDofs
    H: ComplexArray
    level: RealArray
    reduced: RealArray
    rounded: RealArray

    @classmethod
    def by_comparison(
        cls,
        wide: ReducedSolver,
        narrow: ReducedSolver,
        basis: Basis,
        channels: ChannelDofs,
        P: RealArray,
        definite: Factorised,
        state: State,
        freq: RealArray,
    ) -> ErrorEstimate:
        """Return the error of a basis by comparison with a larger basis that contains it.

        `narrow` has the first vectors of `basis`, `wide` all. `P` is K + omega_max^2 M in `basis`,
        `definite` that of the full model at this or a close state.
        """
        eps = float(np.finfo(np.float64).eps)
        loaded, forced = channels.loaded, channels.forced
        norms = np.array([np.linalg.norm(A) for A in basis.terms])
        parts, of_wide, of_narrow = [], wide.pencil(state, freq), narrow.pencil(state, freq)
        for block in split_into_blocks(len(freq), wide.block_size(len(loaded))):
            c = wide.system.coefficients(state, 2.0 * np.pi * freq[block])
            q = wide.solve(c, loaded, freq[block], of_wide)
            H = wide.at(q, loaded)[:, :, forced]
            fewer = narrow.solve(c, loaded[forced], freq[block], of_narrow)
            energy, length = square_norms(q, P)
            length = length * (norms @ np.abs(c))[:, None]
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
        residual_errors = np.abs(lines.errors(definite.solve(lines.residual()))) / level[worst]
        remaining = residual_errors.max(axis=(0, 2))[:, None]
        entries = (lines.magnitudes() / products[worst]).max(axis=0)
        return cls(
            channels,
            H,
            level,
            _reduction_error(np.abs(difference), remaining * level),
            CERTIFICATE.entry_rounding * eps * entries * products
            + CERTIFICATE.factor_rounding * eps * factors,
        )

    @property
    def shares(self) -> RealArray:
        """The largest relative error by the reduction at each line, shape (n_f,)."""
        return np.asarray((self.reduced / self.level).max(axis=(1, 2)))

    @property
    def reduction(self) -> float:
        """The largest of `shares`."""
        return float(self.shares.max())

    def certificate(self, size: int, lines: tuple[float, ...], factorisations: int) -> Certificate:
        """Return the certificate of the estimate."""
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


def _reduction_error(difference: RealArray, residual: RealArray) -> RealArray:
    """Return the stated error from the difference of two bases and the error of the larger one."""
    of_difference = CERTIFICATE.difference_factor * difference
    return np.asarray(of_difference + CERTIFICATE.residual_factor * residual)


def square_norms(q: ComplexArray, P: RealArray) -> tuple[RealArray, RealArray]:
    """Return q^H P q and q^H q of fields q, shape (r, ...), by field."""
    # In real arithmetic, which takes half the time of a complex product with a real P.
    parts = np.ascontiguousarray(q.reshape(len(q), -1)).view(np.float64)
    shape = (*q.shape[1:], 2)
    return (
        np.einsum("ik,ik->k", parts, P @ parts).reshape(shape).sum(axis=-1),
        np.einsum("ik,ik->k", parts, parts).reshape(shape).sum(axis=-1),
    )


def _columns(rows: list[tuple[_T, ...]], first: int, last: int) -> list[tuple[_T, ...]]:
    """Return entries `first` to `last` of all rows, by entry."""
    return list(zip(*rows, strict=True))[first:last]


def _validation_lines(shares: RealArray) -> list[int]:
    """Return the line of the largest share in each part of the band."""
    worst = shares.max(axis=(1, 2))
    parts = np.array_split(np.arange(len(worst)), min(CERTIFICATE.residual_lines, len(worst)))
    return [int(part[np.argmax(worst[part])]) for part in parts]
