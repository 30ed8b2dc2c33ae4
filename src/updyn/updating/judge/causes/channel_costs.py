"""Costs of all exchanges of two channels, and of all other places of sensors and forces, at once.

They differ in the rows of one or two channels each. Products for all of them are computed together,
to first order as in `FirstOrderModel.fit`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from updyn.arrays import ComplexArray, IndexArray, RealArray
from updyn.frf import FRF
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import FORCE, Fault, find_channels
from updyn.updating.judge.causes.misfit import compute_log_misfit
from updyn.updating.judge.causes.score import ChannelRows, FirstOrderModel
from updyn.updating.judge.causes.settings import CAUSE_MISFIT

__all__ = ["compute_exchange_costs", "compute_place_costs"]

_Number = TypeVar("_Number", ComplexArray, RealArray)
#: Axis of the responses and of the references in arrays over lines and channels.
_RESPONSES, _REFERENCES = 1, 2


def compute_exchange_costs(model: FirstOrderModel, faults: Sequence[Fault]) -> RealArray:
    """Return the cost of each exchange of the two channels of a fault, shape (len(faults),)."""
    costs = np.empty(len(faults))
    for axis, at in _iter_sides(faults):
        names = [faults[i].channels for i in at]
        exchanges = _Exchanges.of(model, _list_names(names), axis)
        first, second = exchanges.find_positions(names).T
        coefficients, squared = exchanges.shift_data()
        n, known = len(exchanges.names), model.every_row
        pairs = ((second - first) % n, first), ((first - second) % n, second)
        changed = known.coefficients + sum(coefficients[pair] for pair in pairs)
        costs[at] = model.compute_costs(
            model.squared_misfit + sum(squared[pair] for pair in pairs),
            np.sum(changed**2, axis=1),
            model.evidence.offset_to_start - changed @ known.prior.T,
        )
    return costs


@dataclass(frozen=True, slots=True, eq=False)
class _Exchanges:
    """Rows of the least-squares problem of named responses or references.

    `misfit` has the shape (c, k) and `basis` (c, k, n), by channel.
    """

    names: tuple[str, ...]
    axis: int
    rows: ChannelRows
    unit: float
    H: ComplexArray
    misfit: RealArray
    basis: RealArray

    @classmethod
    def of(cls, model: FirstOrderModel, names: tuple[str, ...], axis: int) -> _Exchanges:
        rows = model.find_rows(names)
        H = rows.evidence.model_response(rows.evidence.frf)
        misfit, basis = (
            _sort_by_channel(one.reshape(2, *H.shape, *one.shape[1:]), axis + 1)
            for one in (rows.misfit, rows.basis)
        )
        basis = basis.reshape(*misfit.shape, -1)
        return cls(names, axis, rows, model.evidence.rms_misfit, H, misfit, basis)

    def find_positions(self, names: Sequence[tuple[str, ...]]) -> IndexArray:
        """Return the positions of pairs of names, shape (len(names), 2)."""
        position = {name: i for i, name in enumerate(self.names)}
        return np.array([[position[name] for name in pair] for pair in names], dtype=np.intp)

    def shift_data(self) -> tuple[RealArray, RealArray]:
        """Return the changes if channel c has the data of channel c + k, modulo their number.

        They are those of the coefficients, shape (c, c, n), and of the squared misfit, (c, c); the
        first index is k.
        """
        n, frf = len(self.names), self.rows.evidence.frf
        assert frf.variance is not None
        coefficients = np.zeros((n, n, self.basis.shape[2]))
        squared = np.zeros((n, n))
        for k in range(1, n):
            values = np.roll(frf.values, -k, self.axis)
            variance = np.roll(frf.variance, -k, self.axis)
            shifted = replace(frf, values=values, variance=variance)
            misfit = compute_log_misfit(self.H, shifted)[0] / self.unit
            misfit = _sort_by_channel(np.stack([misfit.real, misfit.imag]), self.axis + 1)
            change = misfit - self.misfit
            coefficients[k] = (change[:, None] @ self.basis)[:, 0]
            squared[k] = np.einsum("ck,ck->c", change, misfit + self.misfit)
        return coefficients, squared


def compute_place_costs(model: FirstOrderModel, faults: Sequence[Fault]) -> RealArray:
    """Return the cost with the first channel of each fault at the place of the second one."""
    costs = np.empty(len(faults))
    for axis, at in _iter_sides(faults):
        names = _list_names([faults[i].channels[:1] for i in at])
        position = {name: i for i, name in enumerate(names)}
        evidence = _select_channels(model.evidence, names, axis)
        stated = _Products.of(evidence, evidence.frf, axis)
        for some in _split_into_rounds([faults[i].channels for i in at]):
            moved = [faults[i] for i in at[some]]
            evidence = _select_channels(
                model.evidence, tuple(one.channels[0] for one in moved), axis
            )
            frf = evidence.frf
            for fault in moved:
                frf = fault.repair(frf)
            actual = _Products.of(evidence, frf, axis)
            before = stated.select([position[one.channels[0]] for one in moved])
            costs[at[some]] = _cost_of_exchanged_rows(model, before, actual)
    for i in np.flatnonzero(np.isnan(costs)).tolist():
        costs[i] = model.fit(faults[i]).cost
    return costs


@dataclass(frozen=True, slots=True, eq=False)
class _Products:
    """Inner products of the misfit and its changes by the unknowns, of each channel.

    Shapes: normal (c, n, n), pull (c, n), squared (c,).
    """

    normal: RealArray
    pull: RealArray
    squared: RealArray

    @classmethod
    def of(cls, evidence: Evidence, frf: FRF, axis: int) -> _Products:
        """Return the products of data whose channels may be at other places than in `evidence`."""
        misfit = compute_log_misfit(evidence.model_response(frf), frf)[0]
        changes = evidence.weight * evidence.log_slopes(frf)
        e: RealArray = _sort_by_channel(misfit, axis).view(np.float64)
        by_channel = np.ascontiguousarray(np.moveaxis(changes, axis + 1, 0))
        J: RealArray = by_channel.reshape(*by_channel.shape[:2], -1).view(np.float64)
        return cls(J @ J.swapaxes(1, 2), (J @ e[:, :, None])[:, :, 0], np.sum(e**2, axis=1))

    def select(self, at: Sequence[int]) -> _Products:
        """Return the products of some channels."""
        return _Products(self.normal[at], self.pull[at], self.squared[at])


def _cost_of_exchanged_rows(
    model: FirstOrderModel, before: _Products, after: _Products
) -> RealArray:
    """Return the cost with the rows of one channel exchanged; nan if rounding would falsify it."""
    evidence, known = model.evidence, model.every_row
    R, spread, unit = evidence.orthonormal_basis[1], evidence.spread, evidence.rms_misfit**2
    # In units of the spread, the normal matrix is 1 plus the part of the data.
    normal = spread[:, None] * (R.T @ R + (after.normal - before.normal) / unit) * spread
    pull = spread * (known.coefficients @ R + (after.pull - before.pull) / unit)
    squared = model.squared_misfit + (after.squared - before.squared) / unit
    costs = np.full(len(squared), np.nan)
    is_exact = normal.max(axis=(1, 2)) <= CAUSE_MISFIT.largest_entry
    normal, pull = normal[is_exact], pull[is_exact]
    step = np.linalg.solve(normal, pull[:, :, None])[:, :, 0]
    explained = np.sum(pull * step, axis=1)
    costs[is_exact] = model.compute_costs(
        squared[is_exact], explained, evidence.offset_to_start - step
    )
    return costs


def _iter_sides(faults: Sequence[Fault]) -> Iterator[tuple[int, IndexArray]]:
    """Yield the axes of responses and references with the positions of their faults."""
    is_force = np.array([one.channels[0].startswith(FORCE) for one in faults], dtype=np.bool_)
    for axis, own in ((_RESPONSES, ~is_force), (_REFERENCES, is_force)):
        if own.any():
            yield axis, np.flatnonzero(own)


def _list_names(names: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """Return the channels without duplicates."""
    return tuple(dict.fromkeys(name for some in names for name in some))


def _select_channels(evidence: Evidence, names: tuple[str, ...], axis: int) -> Evidence:
    """Return the evidence of some responses, or of some references."""
    n_responses, n_references = evidence.frf.values.shape[1:]
    place = find_channels(names, evidence.frf)
    if axis == _RESPONSES:
        return evidence.select_channels(place.rows, np.arange(n_references))
    return evidence.select_channels(np.arange(n_responses), place.columns)


def _split_into_rounds(channels: Sequence[tuple[str, ...]]) -> Iterator[IndexArray]:
    """Yield positions of faults with different channels, both the stated and the actual ones."""
    rounds: list[tuple[set[str], list[int]]] = []
    for i, names in enumerate(channels):
        free = next((one for one in rounds if one[0].isdisjoint(names)), None)
        if free is None:
            free = set(), []
            rounds.append(free)
        free[0].update(names)
        free[1].append(i)
    for _, some in rounds:
        yield np.array(some, dtype=np.intp)


def _sort_by_channel(values: _Number, axis: int) -> _Number:
    """Return an array with the given axis first, and all axes of lines and channels as one."""
    values = np.moveaxis(values, axis, 0)
    return np.ascontiguousarray(values).reshape(len(values), -1)
