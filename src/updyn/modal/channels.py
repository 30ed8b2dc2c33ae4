"""Linear least squares of many channels with common columns and separate weights.

A single QR decomposition, with weights between those of all channels, replaces one for each
channel; each solves its normal equations in the orthonormal columns, whose condition depends on the
ratio of its weights to the common ones only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from updyn.arrays import NumberArray, RealArray
from updyn.modal.settings import CHANNEL_FIT

__all__ = ["Columns"]


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Decomposed columns of a linear fit of all channels."""

    #: Orthonormal basis of the columns in common weights, shape (n, m), with m the number of
    #: independent ones.
    Q: NumberArray
    #: Matrix from coefficients of Q to those of the columns, shape (k, m).
    to_coefficients: NumberArray
    #: Common weights, shape (n,): inverse standard deviations of the rows.
    common_weights: RealArray
    #: Squared weights of each channel relative to the common ones, shape (p, n); None if all are
    #: common.
    channel_weights: RealArray | None
    #: Normal matrices of the channels in the basis Q, shape (p, m, m).
    gram: NumberArray | None

    @classmethod
    def of(cls, A: NumberArray, deviation: RealArray) -> Columns:
        """Return the decomposition of columns A, shape (n, k).

        `deviation` are standard deviations, shape (p, n) or, common to all channels, (1, n).
        """
        size = np.linalg.norm(A, axis=0) + CHANNEL_FIT.smallest_divisor
        logs = np.log(deviation)
        common_weights = np.exp(-np.mean(logs, axis=0))
        scaled = (A / size) * common_weights[:, None]
        Q, R = np.linalg.qr(scaled)
        diagonal = np.abs(np.diagonal(R))
        is_independent = diagonal > CHANNEL_FIT.independent_share * diagonal.max(initial=0.0)
        if not is_independent.all():  # the others span it
            Q, R = np.linalg.qr(scaled[:, is_independent])
        to_coefficients = np.zeros((A.shape[1], Q.shape[1]), dtype=Q.dtype)
        to_coefficients[is_independent] = (
            np.linalg.solve(R, np.eye(len(R))) / size[is_independent, None]
        )
        if len(deviation) == 1:
            return cls(Q, to_coefficients, common_weights, None, None)
        channel_weights = 1.0 / (deviation * common_weights) ** 2
        return cls(
            Q, to_coefficients, common_weights, channel_weights, _products(channel_weights, Q, Q)
        )

    def fit(self, Y: NumberArray) -> tuple[NumberArray, NumberArray]:
        """Return coefficients (p, k) of the columns and errors (p, n) for channels Y (p, n)."""
        weights = self.common_weights[:, None]
        to_basis, columns = weights * self.Q.conj(), self.Q / weights
        found = Y @ to_basis
        error = Y - found @ columns.T
        if (
            self.channel_weights is not None
        ):  # correct the common fit, so rounding is relative to its errors
            change = self.solve_normal_equations(
                ((error * self.channel_weights) @ to_basis)[:, :, None]
            )[:, :, 0]
            found = found + change
            error -= change @ columns.T
        return found @ self.to_coefficients.T, error

    def solve_normal_equations(self, B: NumberArray) -> NumberArray:
        """Return the inverses of the normal matrices times B, shape (p, m, j) or (m, j)."""
        return B if self.gram is None else np.linalg.solve(self.gram, B)

    def normalise_squares(self, error: NumberArray, level: RealArray | None = None) -> RealArray:
        """Return squares of errors divided by their variances, shape (p, n).

        Standard deviations are relative to `level`, shape (p, 1) or (1, 1), by default 1.
        """
        squares = np.abs(error)
        squares *= self.common_weights if level is None else self.common_weights / level
        squares *= squares
        return np.asarray(
            squares if self.channel_weights is None else squares * self.channel_weights
        )

    def divide_by_variance(self, error: NumberArray) -> NumberArray:
        """Return errors divided by their variances, shape (p, n)."""
        return np.asarray(
            error
            * self.common_weights**2
            * (1.0 if self.channel_weights is None else self.channel_weights)
        )

    def project_errors(self, error: NumberArray, T: NumberArray) -> NumberArray:
        """Return products of errors, divided by variances, with functions T, (n, j), as (p, j)."""
        weighted = error if self.channel_weights is None else error * self.channel_weights
        return np.asarray(weighted @ (self.common_weights[:, None] ** 2 * T.conj()))

    def project_out(self, T: NumberArray) -> tuple[NumberArray, NumberArray]:
        """Return the residual products and fit coefficients of further columns T, shape (n, j).

        The products have the shape (p, j, j) or (1, j, j), the coefficients (p, k, j) or (1, k, j).
        """
        T = T * self.common_weights[:, None]
        along = self.Q.conj().T @ T
        T = T - self.Q @ along
        if self.channel_weights is None:
            return (T.conj().T @ T)[None], (self.to_coefficients @ along)[None]
        crossed = _products(self.channel_weights, self.Q, T)
        fitted = self.solve_normal_equations(crossed)
        residual_products = _products(self.channel_weights, T, T) - np.matmul(
            crossed.conj().swapaxes(1, 2), fitted
        )
        return residual_products, np.matmul(self.to_coefficients, along + fitted)

    def leverage(self) -> RealArray:
        """Return the leverage of each value, shape (p, n) or (1, n), 0 to 1."""
        if self.channel_weights is None:
            return np.asarray(np.sum(np.abs(self.Q) ** 2, axis=1)[None])
        # q^H G^-1 q of each row q, as a product of matrices over the pairs of its values.
        m = self.Q.shape[1]
        first, second = np.triu_indices(m)
        G = self.solve_normal_equations(np.eye(m))[:, first, second]
        G *= np.where(first == second, 1.0, 2.0)
        out = np.empty(self.channel_weights.shape)
        rows = max(1, CHANNEL_FIT.block_elements // max(1, len(first)))
        for start in range(0, len(self.Q), rows):
            part = slice(start, start + rows)
            pairs = self.Q[part][:, first] * self.Q[part][:, second].conj()
            out[:, part] = G.real @ pairs.real.T
            if np.iscomplexobj(G):
                out[:, part] -= G.imag @ pairs.imag.T
        return out * self.channel_weights

    def covariance(self, columns: list[int]) -> NumberArray:
        """Return the covariance of some coefficients, shape (p, i, i) or (1, i, i)."""
        rows = self.to_coefficients[columns]
        spread = self.solve_normal_equations(rows.conj().T)
        return np.asarray(np.matmul(rows, spread if spread.ndim == 3 else spread[None]))


def _products(channel_weights: RealArray, left: NumberArray, right: NumberArray) -> NumberArray:
    """Return left^H diag(own) right for each channel, shape (p, i, j), as a matrix product."""
    n, i, j = len(left), left.shape[1], right.shape[1]
    first, second = (index.reshape(-1) for index in np.indices((i, j)))
    if left is right:
        first, second = np.triu_indices(i)
    dtype = np.result_type(left, right)
    out = np.zeros((len(channel_weights), len(first)), dtype=dtype)
    rows = max(1, CHANNEL_FIT.block_elements // max(1, len(first)))
    for start in range(0, n, rows):
        part = slice(start, start + rows)
        pairs = np.ascontiguousarray(left[part][:, first].conj() * right[part][:, second])
        out += (channel_weights[:, part] @ pairs.view(np.float64)).view(dtype)
    if left is not right:
        return out.reshape(len(channel_weights), i, j)
    whole = np.empty((len(channel_weights), i, i), dtype=dtype)
    whole[:, second, first] = out.conj()
    whole[:, first, second] = out
    return whole
