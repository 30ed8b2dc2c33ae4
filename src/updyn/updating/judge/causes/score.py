"""Misfit of the data with faults at one point of the unknowns, to first order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Generic, TypeVar

import numpy as np
import scipy.linalg

from updyn.arrays import IndexArray, RealArray
from updyn.frf import FRF
from updyn.updating.judge.causes.evidence import Evidence, stack_real_imag
from updyn.updating.judge.causes.fault import Fault, find_channels
from updyn.updating.judge.causes.misfit import add_perfect_fit
from updyn.updating.judge.causes.quadratic import QuadraticMisfit
from updyn.updating.judge.causes.settings import CAUSE_MISFIT

__all__ = ["FirstOrderFit", "FirstOrderModel"]


_Fault = TypeVar("_Fault", bound=Fault)


@dataclass(frozen=True, slots=True, eq=False)
class FirstOrderFit(Generic[_Fault]):
    """A fault with its best size, and the cost with it.

    Products are in units of the rms misfit; `coefficients` and `slope` are components of the misfit
    with the fault and of its slope along the basis of the unknowns, shape (n,).
    """

    fault: _Fault
    cost: float
    coefficients: RealArray
    squared_misfit: float
    slope: RealArray
    squared_slope: float
    slope_times_misfit: float


@dataclass(frozen=True, slots=True, eq=False)
class _ChannelRows:
    """Rows of the least-squares problem that belong to some channels.

    `misfit` has the shape (k,) and `basis`, orthonormal over all rows, (k, n). `coefficients`,
    shape (n,), are those of the misfit of all channels, `prior` the rows of the unknowns, (n, n).
    """

    evidence: Evidence
    positions: IndexArray
    misfit: RealArray
    basis: RealArray
    coefficients: RealArray
    prior: RealArray


@dataclass(frozen=True, eq=False)
class FirstOrderModel:
    """Model and data of one test about a point, to first order, to compare faults."""

    # A fault changes few channels. With b the misfit and P = 1 - Q Q^T the projection by which the
    # unknowns adapt, |P b|^2 = |b|^2 - |Q^T b|^2 needs only the rows of these channels.
    evidence: Evidence
    _rows_by_channels: dict[tuple[str, ...], _ChannelRows] = field(default_factory=dict)

    @property
    def cost(self) -> float:
        """Cost without a fault: -2 ln of the likelihood, with the noise estimated, and prior."""
        rows = self._every_row
        return self._compute_cost(rows, rows.coefficients, self._squared_misfit)

    def fit(self, fault: _Fault) -> FirstOrderFit[_Fault]:
        """Return the fault with the best size, with all unknowns adapted."""
        rows, unit = self._find_rows(fault), self.evidence.rms_misfit
        evidence, misfit = rows.evidence, rows.misfit
        if not (fault.has_free_size and fault.value == 0.0):
            frf = fault.repair_with_model(evidence)
            misfit = evidence.misfit(frf) / unit
            if (frf.responses, frf.references) != (evidence.frf.responses, evidence.frf.references):
                rows = self._exchange_rows(rows, frf)
        change = misfit - rows.misfit
        coefficients = rows.coefficients + change @ rows.basis
        squared = self._squared_misfit + float(change @ (misfit + rows.misfit))
        slope, squared_slope, along = np.zeros_like(coefficients), 0.0, 0.0
        if fault.has_free_size:
            d = stack_real_imag(evidence.weight * fault.slope(evidence)) / unit
            slope, squared_slope, along = d @ rows.basis, float(d @ d), float(d @ misfit)
            free = squared_slope - float(slope @ slope)
            # An effect that the unknowns can produce is attributed to them.
            if free > CAUSE_MISFIT.dependent_share**2 * squared_slope:
                step = (along - float(slope @ coefficients)) / free
                coefficients = coefficients - step * slope
                squared += step * (step * squared_slope - 2.0 * along)
                along -= step * squared_slope
                fault = replace(fault, value=fault.value + step)
        cost = self._compute_cost(rows, coefficients, squared)
        return FirstOrderFit(fault, cost, coefficients, squared, slope, squared_slope, along)

    def approximate(self, fits: Sequence[FirstOrderFit[_Fault]] = ()) -> QuadraticMisfit:
        """Return the misfit to second order, of each fault with its size; without any of none."""
        R = self.evidence.orthonormal_basis[1]
        unit = self.evidence.rms_misfit**2
        coefficients, slope = self._every_row.coefficients, None
        squared = np.asarray(self._squared_misfit)
        if fits:
            coefficients = np.array([one.coefficients for one in fits])
            squared = np.array([one.squared_misfit for one in fits])
            slope = (
                unit * np.array([one.slope for one in fits]) @ R,
                unit * np.array([one.squared_slope for one in fits]),
                unit * np.array([one.slope_times_misfit for one in fits]),
            )
        offset = self.evidence.offset_to_start / self.evidence.spread
        gradient = unit * (coefficients @ R - offset)
        return QuadraticMisfit.at_point(self.evidence, gradient, unit * squared, slope)

    @cached_property
    def _squared_misfit(self) -> float:
        e = self._every_row.misfit
        return float(e @ e)

    def _compute_cost(
        self, rows: _ChannelRows, coefficients: RealArray, squared_misfit: float
    ) -> float:
        evidence = self.evidence
        held = evidence.offset_to_start
        total = squared_misfit + float(held @ held) - float(coefficients @ coefficients)
        held = held - rows.prior @ coefficients
        squared_distance = float(held @ held)
        remaining = max(total - squared_distance, 0.0) * evidence.rms_misfit**2
        power = 2.0 * remaining / len(self._every_row.misfit)
        return evidence.n_values * float(np.log(add_perfect_fit(power))) + squared_distance

    @cached_property
    def _every_row(self) -> _ChannelRows:
        Q, b = self.evidence.orthonormal_basis[0], self.evidence.misfit_with_prior
        m = len(b) - Q.shape[1]
        return _ChannelRows(self.evidence, np.arange(m), b[:m], Q[:m], b @ Q, Q[m:])

    def _find_rows(self, fault: Fault) -> _ChannelRows:
        channels, rows = fault.changed_channels, self._every_row
        if not channels:
            return rows
        if channels not in self._rows_by_channels:
            shape = self.evidence.frf.values.shape
            place = find_channels(channels, self.evidence.frf)
            if len(place.rows) and len(place.columns):
                return rows
            i = place.rows if len(place.rows) else np.arange(shape[1])
            j = place.columns if len(place.columns) else np.arange(shape[2])
            lines = shape[1] * shape[2] * np.arange(shape[0])[:, None, None]
            real = (lines + shape[2] * i[:, None] + j).ravel()
            at = np.concatenate([real, len(rows.misfit) // 2 + real])
            self._rows_by_channels[channels] = replace(
                rows,
                evidence=self.evidence.select_channels(i, j),
                positions=at,
                misfit=rows.misfit[at],
                basis=rows.basis[at],
            )
        return self._rows_by_channels[channels]

    def _exchange_rows(self, rows: _ChannelRows, frf: FRF) -> _ChannelRows:
        """Return the rows with the slopes of the model at other channels, those of data."""
        evidence, spread = self.evidence, self.evidence.spread
        A, (_, R), at = evidence.jacobian_with_prior, evidence.orthonormal_basis, rows.positions
        old = A[at]
        new = rows.evidence.derive_misfit(frf, rows.evidence.weight) / evidence.rms_misfit
        # In these units the normal matrix is 1 plus the part of the data.
        scaled = spread[:, None] * (R.T @ R - old.T @ old + new.T @ new) * spread
        if scaled.max() > CAUSE_MISFIT.largest_entry:
            exchanged = A.copy()
            exchanged[at] = new
            Q, m = np.linalg.qr(exchanged)[0], len(self._every_row.misfit)
            known = evidence.misfit_with_prior @ Q
            return replace(rows, basis=Q[at], coefficients=known, prior=Q[m:])
        pull = self._every_row.coefficients @ R + rows.misfit @ (new - old)
        columns = [spread[:, None] * new.T, spread[:, None] * pull[:, None], np.eye(len(R))]
        L = np.linalg.cholesky(scaled)
        found = scipy.linalg.solve_triangular(L, np.hstack(columns), lower=True)
        k = len(at)
        return replace(
            rows, basis=found[:, :k].T, coefficients=found[:, k], prior=found[:, k + 1 :].T
        )
