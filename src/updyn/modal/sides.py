"""Responses and references as the two sides of a measurement: shapes from residues at both.

The residue of a mode is its shape at the responses times its shape at the references; a drive point
determines the scale (Ewins, Modal Testing, 2nd ed. 2000, section 4.5). Two modes of one frequency
have a residue of rank two.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from updyn.arrays import ComplexArray, IndexArray, RealArray
from updyn.dofs import Dof
from updyn.frf import FRF, TRANSMISSIBILITY
from updyn.modal.settings import CHANNEL_FIT, PHYSICAL_MODE

__all__ = ["Sides", "as_accelerance"]


def as_accelerance(frf: FRF) -> FRF:
    """Return a measurement as accelerance; a transmissibility has the same modal form already."""
    return frf if frf.quantity == TRANSMISSIBILITY else frf.converted("accelerance")


@dataclass(frozen=True, slots=True, eq=False)
class Sides:
    """Responses and references of a measurement, and their common DOFs."""

    #: Responses and references of the drive points, shape (n_d,).
    rows: IndexArray
    columns: IndexArray
    #: Product of their signs, shape (n_d,).
    sign: RealArray
    #: References that are not among the responses.
    more: IndexArray
    #: Whether shapes are those at the references: without a drive point, if there are more
    #: references than responses, as with a roving hammer.
    at_references: bool
    #: DOFs of the shapes.
    dofs: list[Dof]
    #: Factors for rotations and translations of equal size, shapes (n_i,) and (n_j,): 1 for
    #: translations.
    row_scale: RealArray
    column_scale: RealArray

    @classmethod
    def of(cls, frf: FRF) -> Sides:
        """Return the sides of a measurement."""
        is_force = frf.quantity != TRANSMISSIBILITY
        driven = np.array([is_force and d in frf.responses for d in frf.references])
        columns, more = np.flatnonzero(driven), np.flatnonzero(~driven)
        match = frf.responses.match(frf.references[columns], "reference")
        responses, references = list(frf.responses), list(frf.references)
        roving = not len(columns) and len(references) > len(responses)
        dofs = responses
        if roving:
            dofs = references
        elif len(columns):
            dofs = [*responses, *frf.references[more]]
        scale = _scale_of_rotations(frf)
        row_scale = np.where(frf.responses.axes >= 3, scale, 1.0)
        column_scale = np.where(frf.references.axes >= 3, scale, 1.0)
        return cls(match.index, columns, match.sign, more, roving, dofs, row_scale, column_scale)

    @property
    def is_scaled(self) -> bool:
        """Whether the shapes have unit modal mass."""
        return len(self.rows) > 0

    def shapes(self, product: ComplexArray) -> list[ComplexArray]:
        """Return one or several shapes of one frequency at `dofs`."""
        # `product`, (n_i, n_j), sums the products of these shapes at responses and references.
        # With its singular vectors, product = U W^T, the shapes are U G and W G^-T. At drive
        # points they are equal, so U S = W there with the symmetric S = G G^T (Ewins 2000, section
        # 4.5, for one mode: phi_j = r_jj^(1/2)). Rotations are scaled first: in rad and N m the
        # noise of one channel may exceed a mode in another, and appear as a second mode.
        U, W = self._factors(product)
        if not self.is_scaled:
            if self.at_references:
                return list(W.T)
            return list(U.T)
        S = np.linalg.lstsq(U[self.rows], W[self.columns] * self.sign[:, None], rcond=None)[0]
        G = scipy.linalg.sqrtm((S + S.T) / 2)
        at_responses, at_references = U @ G, np.linalg.solve(G, W.T).T
        return list(np.concatenate([at_responses, at_references[self.more]]).T)

    def _factors(self, product: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Return U and W, shapes (n_i, rank) and (n_j, rank)."""
        scaled = product * self.row_scale[:, None] * self.column_scale
        U, s, Vh = np.linalg.svd(scaled, full_matrices=False)
        largest = max(1, min(len(s), len(self.rows) or len(s)))
        rank = max(1, int((s[:largest] > PHYSICAL_MODE.further_shape_share * s[0]).sum()))
        U, W = U[:, :rank] * np.sqrt(s[:rank]), Vh[:rank].T * np.sqrt(s[:rank])
        return U / self.row_scale[:, None], W / self.column_scale[:, None]

    def deviations(
        self, product: ComplexArray, noise: RealArray, common: ComplexArray
    ) -> RealArray:
        """Return standard deviations of the real shape at `dofs`, for fixed length, shape (N,).

        `noise` and `common` are the `Errors` of the product, shapes (n_i, n_j) and (q, n_i, n_j).
        """
        # They are nan if the product contains two modes, whose shapes are arbitrary in their
        # plane. First order: with dP = dU W^T + U dW^T and dU orthogonal to U, dU and dW follow
        # from dP W^* / |W|^2 and dP^T U^* / |U|^2. The shape x + i y is rotated to x . y = 0, and
        # dx taken orthogonal to x.
        shapes = self.shapes(product)
        if len(shapes) > 1:
            return np.full(len(self.dofs), np.nan)
        U, W = (side[:, 0] for side in self._factors(product))
        u, w = (U * self.row_scale**2).conj(), (W * self.column_scale**2).conj()
        u, w = u / np.sum(u * U), w / np.sum(w * W)
        by_rows, by_columns = self._derivatives(U, W)
        by_rows = by_rows - np.outer(by_rows @ U, u)
        by_rows, by_columns = (_real_part(shapes[0], by) for by in (by_rows, by_columns))
        squares = np.abs(by_rows) ** 2 @ (noise @ np.abs(w) ** 2)
        squares += np.abs(by_columns) ** 2 @ (noise.T @ np.abs(u) ** 2)
        crossed = (by_rows @ (noise * w * u.conj()[:, None])) * by_columns.conj()
        squares = 0.5 * squares + np.sum(crossed.real, axis=1)
        fixed = by_rows @ (common @ w).T + by_columns @ (common.swapaxes(1, 2) @ u).T
        return np.asarray(np.sqrt(np.maximum(squares + np.sum(fixed.real**2, axis=1), 0.0)))

    def _derivatives(self, U: ComplexArray, W: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Return the derivatives of the shape of one mode at `dofs` by U and by W."""
        N = len(self.dofs)
        by_rows, by_columns = (np.zeros((N, len(side)), dtype=np.complex128) for side in (U, W))
        if not self.is_scaled:
            identity = by_columns if self.at_references else by_rows
            np.fill_diagonal(identity, 1.0)
            return by_rows, by_columns
        driven = U[self.rows]
        S = np.vdot(driven, W[self.columns] * self.sign) / np.vdot(driven, driven)
        G = np.sqrt(S)
        np.fill_diagonal(by_rows, G)
        by_columns[np.arange(len(U), N), self.more] = 1.0 / G
        scale = np.concatenate([U, -W[self.more] / S]) / (2.0 * G)
        share = driven.conj() / np.vdot(driven, driven)
        by_rows[:, self.rows] -= np.outer(scale, S * share)
        by_columns[:, self.columns] += np.outer(scale, self.sign * share)
        return by_rows, by_columns


def _real_part(shape: ComplexArray, slope: ComplexArray) -> ComplexArray:
    """Return derivatives with the real part of those, (N, n), of the real shape at fixed length."""
    turn = np.exp(-0.5j * np.angle(np.sum(shape**2)))
    x, y = (shape * turn).real, (shape * turn).imag
    slope = slope * turn
    along = x @ slope / (x @ x)
    turned = (y - 1j * x) @ slope / max(x @ x - y @ y, CHANNEL_FIT.smallest_divisor)
    return np.asarray(slope - np.outer(x, along) + np.outer(y, turned))


def _scale_of_rotations(frf: FRF) -> float:
    """Return the factor on rotations that makes them as large as translations."""
    # The rms values of the kinds of FRF are fitted by level q^-n with n the number of rotations,
    # by least squares in the logarithm.
    rotations = np.add.outer((frf.responses.axes >= 3) * 1, (frf.references.axes >= 3) * 1)
    rows, levels = [], []
    for n in np.unique(rotations):
        level = float(np.sqrt(np.mean(np.abs(frf.values[:, rotations == n]) ** 2)))
        if level > 0:
            rows.append([1.0, -float(n)])
            levels.append(np.log(level))
    if len(rows) < 2:
        return 1.0
    return float(np.exp(np.linalg.lstsq(np.array(rows), np.array(levels), rcond=None)[0][1]))
