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

__all__ = ["ChannelRows", "Effect", "FirstOrderFit", "FirstOrderModel"]


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
class ChannelRows:
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


@dataclass(frozen=True, slots=True, eq=False)
class Effect(Generic[_Fault]):
    """A fault and its effect on the misfit of its channels, in units of the rms misfit.

    `misfit` is that of the data without the fault, `slope` its derivative by the size of the fault,
    None without a free size; both have the shape (k,) of the rows.
    """

    fault: _Fault
    rows: ChannelRows
    misfit: RealArray
    slope: RealArray | None

    @property
    def changes_data(self) -> bool:
        """Whether the misfit differs from that of the data as they are."""
        return self.misfit is not self.rows.misfit

    @property
    def change(self) -> RealArray:
        """Change of the misfit, shape (k,)."""
        return self.misfit - self.rows.misfit

    @property
    def vectors(self) -> list[RealArray]:
        """The change, if any, and the slope, if any."""
        vectors = [self.change] if self.changes_data else []
        return vectors if self.slope is None else [*vectors, self.slope]


@dataclass(frozen=True, eq=False)
class FirstOrderModel:
    """Model and data of one test about a point, to first order, to compare faults."""

    # A fault changes few channels. With b the misfit and P = 1 - Q Q^T the projection by which the
    # unknowns adapt, |P b|^2 = |b|^2 - |Q^T b|^2 needs only the rows of these channels.
    evidence: Evidence
    _rows_by_channels: dict[tuple[str, ...], ChannelRows] = field(default_factory=dict)

    @property
    def cost(self) -> float:
        """Cost without a fault: -2 ln of the likelihood, with the noise estimated, and prior."""
        rows = self.every_row
        return self._compute_cost(rows, rows.coefficients, self.squared_misfit)

    def fit(self, fault: _Fault) -> FirstOrderFit[_Fault]:
        """Return the fault with the best size, with all unknowns adapted."""
        (found,) = self.fit_all([self.find_effect(fault)])
        return found

    def find_effect(self, fault: _Fault) -> Effect[_Fault]:
        """Return the effect of a fault of the given size; SolverError if it has none."""
        rows, unit = self.find_rows(fault.changed_channels), self.evidence.rms_misfit
        evidence, misfit, slope = rows.evidence, rows.misfit, None
        if not (fault.has_free_size and fault.value == 0.0):
            frf = fault.repair_with_model(evidence)
            misfit = evidence.misfit(frf) / unit
            if (frf.responses, frf.references) != (evidence.frf.responses, evidence.frf.references):
                rows = self._exchange_rows(rows, frf)
        if fault.has_free_size:
            slope = stack_real_imag(evidence.weight * fault.slope(evidence)) / unit
        return Effect(fault, rows, misfit, slope)

    def fit_all(self, effects: Sequence[Effect[_Fault]]) -> list[FirstOrderFit[_Fault]]:
        """Return faults with the best sizes, with all unknowns adapted, from their effects."""
        # Effects on the same rows are projected together, because a basis of many rows is read
        # from memory for each product.
        together: dict[int, list[int]] = {}
        for i, one in enumerate(effects):
            together.setdefault(id(one.rows), []).append(i)
        found: dict[int, FirstOrderFit[_Fault]] = {}
        for same in together.values():
            vectors = [vector for i in same for vector in effects[i].vectors]
            products = iter(np.array(vectors) @ effects[same[0]].rows.basis if vectors else ())
            for i in same:
                along_basis = [next(products) for _ in effects[i].vectors]
                found[i] = self._fit_effect(effects[i], along_basis)
        return [found[i] for i in range(len(effects))]

    def _fit_effect(
        self, effect: Effect[_Fault], along_basis: Sequence[RealArray]
    ) -> FirstOrderFit[_Fault]:
        """Return the fault with the best size; `along_basis` are the products of its `vectors`."""
        fault, rows, products = effect.fault, effect.rows, iter(along_basis)
        coefficients, squared = rows.coefficients, self.squared_misfit
        if effect.changes_data:
            coefficients = coefficients + next(products)
            squared += float(effect.change @ (effect.misfit + rows.misfit))
        slope, squared_slope, along = np.zeros_like(coefficients), 0.0, 0.0
        if effect.slope is not None:
            d = effect.slope
            slope, squared_slope, along = next(products), float(d @ d), float(d @ effect.misfit)
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
        coefficients, slope = self.every_row.coefficients, None
        squared = np.asarray(self.squared_misfit)
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
    def squared_misfit(self) -> float:
        """Squared misfit of the data, in units of the rms misfit."""
        e = self.every_row.misfit
        return float(e @ e)

    def _compute_cost(
        self, rows: ChannelRows, coefficients: RealArray, squared_misfit: float
    ) -> float:
        offset = self.evidence.offset_to_start - rows.prior @ coefficients
        explained = np.asarray(coefficients @ coefficients)
        return float(self.compute_costs(np.asarray(squared_misfit), explained, offset))

    def compute_costs(
        self, squared_misfit: RealArray, explained: RealArray, offset: RealArray
    ) -> RealArray:
        """Return costs, shape (k,), for the offsets of the adapted unknowns, shape (k, n).

        `explained` is the part of the squared misfit with prior that the unknowns explain.
        """
        evidence = self.evidence
        start = evidence.offset_to_start
        squared_distance = np.sum(offset**2, axis=-1)
        remaining = squared_misfit + start @ start - explained - squared_distance
        remaining = np.maximum(remaining, 0.0) * evidence.rms_misfit**2
        power = add_perfect_fit(2.0 * remaining / len(self.every_row.misfit))
        return np.asarray(evidence.n_values * np.log(power) + squared_distance)

    @cached_property
    def every_row(self) -> ChannelRows:
        """Rows of all channels."""
        Q, b = self.evidence.orthonormal_basis[0], self.evidence.misfit_with_prior
        m = len(b) - Q.shape[1]
        return ChannelRows(self.evidence, np.arange(m), b[:m], Q[:m], b @ Q, Q[m:])

    def find_rows(self, channels: tuple[str, ...]) -> ChannelRows:
        """Return the rows of channels, by real and imaginary part, line, response and reference."""
        rows = self.every_row
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

    def _exchange_rows(self, rows: ChannelRows, frf: FRF) -> ChannelRows:
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
            Q, m = np.linalg.qr(exchanged)[0], len(self.every_row.misfit)
            known = evidence.misfit_with_prior @ Q
            return replace(rows, basis=Q[at], coefficients=known, prior=Q[m:])
        pull = self.every_row.coefficients @ R + rows.misfit @ (new - old)
        columns = [spread[:, None] * new.T, spread[:, None] * pull[:, None], np.eye(len(R))]
        L = np.linalg.cholesky(scaled)
        found = scipy.linalg.solve_triangular(L, np.hstack(columns), lower=True)
        k = len(at)
        return replace(
            rows, basis=found[:, :k].T, coefficients=found[:, k], prior=found[:, k + 1 :].T
        )
