"""Exact derivatives of receptance and condensed dynamic stiffness by the unknowns.

With u_j = Z^-1 e_j and v_i = Z^-1 e_i (the same solves, as Z is symmetric), dH_ij/dp = -v_i^T Z'_p
u_j; with the condensation matrix T, dZ_red/dp = T^T Z'_p T (Bao, Wang & Cheng 2010, eqs. 11, 17,
18, in closed form). Both are contractions of one stored matrix on its group's own DOFs, shared by
stiffness, loss factor and stiffness-proportional damping, as by mass and its damping.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, IndexArray, RealArray
from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.fields import FieldSolver
from updyn.linalg.threads import use_one_thread

if TYPE_CHECKING:
    from updyn.updating.problem.parameters import Parameter

__all__ = ["Unknowns", "condensed_product", "contract", "fields_along", "receptance"]


_FACTOR, _LOSS, _RATE = range(3)
_NUMBER = {"loss_factor": _LOSS, "mass_damping": _RATE, "stiffness_damping": _RATE}


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """Terms of a compiled model that the unknowns drive: one or more drives per unknown."""

    #: Number of unknowns.
    n: int
    #: Index of the unknown of each drive, shape (n_d,).
    owner: IndexArray
    #: Index of the term of each drive, shape (n_d,).
    at: IndexArray
    #: Driven number of that term, shape (n_d,): 0 factor, 1 loss factor, 2 viscous rate.
    number: IndexArray
    #: Exponent of the value in the factor, shape (n_d,): the product of value**power over the
    #: term's drives.
    power: RealArray

    @classmethod
    def find(cls, system: AffineSystem, parameters: Iterable[Parameter]) -> Unknowns:
        """Return the terms of a compiled model that the unknowns act on."""
        items = list(parameters)
        owners, terms, kinds, powers = [], [], [], []
        for i, parameter in enumerate(items):
            for drive in parameter.acts_on:
                # The model of one test may lack a group that another test has.
                if system.has(drive.group, drive.quantity):
                    owners.append(i)
                    terms.append(system.find(drive.group, drive.quantity))
                    kinds.append(_NUMBER.get(drive.quantity, _FACTOR))
                    powers.append(drive.power)
        return cls(
            len(items),
            np.array(owners, dtype=np.intp),
            np.array(terms, dtype=np.intp),
            np.array(kinds, dtype=np.intp),
            np.array(powers, dtype=np.float64),
        )

    @property
    def scales(self) -> BoolArray:
        """Mask of drives that scale a matrix, shape (n_d,); others are a loss factor or a rate."""
        return np.asarray(self.number == _FACTOR)

    def state(self, system: AffineSystem, values: RealArray) -> State:
        """Return the state of a compiled model at given values of the unknowns."""
        start, given = system.start, values[self.owner]
        factor, loss, rate = start.factor.copy(), start.loss.copy(), start.rate.copy()
        scales = self.scales
        factor[self.at[scales]] = 1.0
        np.multiply.at(factor, self.at[scales], given[scales] ** self.power[scales])
        for number, kept in ((_LOSS, loss), (_RATE, rate)):
            mine = self.number == number
            kept[self.at[mine]] = given[mine]
        return State(factor, loss, rate)

    def slopes(
        self,
        system: AffineSystem,
        state: State,
        values: RealArray,
        omega: RealArray,
    ) -> ComplexArray:
        """Return the derivative of each drive's coefficient by its unknown, shape (n_d, n_f)."""
        # Coefficients at a factor of 1: for a single linear drive, factor / value is exactly 1.
        unit = system.coefficients(replace(state, factor=np.ones_like(state.factor)), omega)[
            self.at
        ]
        scales, factor = self.scales, state.factor[self.at, None]
        share = np.where(
            scales,
            self.power * state.factor[self.at] / np.where(scales, values[self.owner], 1.0),
            1.0,
        )
        unit *= share[:, None]
        lost, rated = self.number == _LOSS, self.number == _RATE
        if lost.any():
            unit[lost] = 1j * factor[lost] * system.relative(self.at[lost], omega)[self.at[lost]]
        if rated.any():
            unit[rated] = factor[rated] * (1j * omega + system.decay)
        return unit


@use_one_thread
def receptance(
    solver: FieldSolver,
    unknowns: Unknowns,
    values: RealArray,
    freq: RealArray,
    rows: IndexArray,
    columns: IndexArray,
    *,
    derivatives: bool = True,
    lines: RealArray | None = None,
    weights: ComplexArray | None = None,
) -> tuple[ComplexArray, ComplexArray | None]:
    """Return H (m/N), (n_f, n_i, n_j), and dH, (n_p, n_f, n_i, n_j), per unit of each unknown.

    `freq` (Hz) is a block of `lines`, on which the choice of the solver depends. dH is multiplied
    by `weights`, (n_p, n_f).
    """
    system, omega = solver.system, 2.0 * np.pi * freq
    state = unknowns.state(system, values)
    coefficients = system.coefficients(state, omega)
    loads = columns
    if derivatives:
        loads = np.concatenate([rows, columns])
    loaded, place = _in_order(loads)
    pencil = solver.pencil(state, freq if lines is None else lines)
    X = solver.solve(coefficients, loaded, freq, pencil)
    U = X[:, :, place[-len(columns) :]]
    H = solver.at(U, rows).transpose(1, 0, 2)
    if not derivatives:
        return H, None
    V = X[:, :, _view(place[: len(rows)])]
    slopes = -unknowns.slopes(system, state, values, omega)
    if weights is not None:
        slopes *= weights[unknowns.owner]
    return H, contract(system, unknowns, slopes, V, U)


@use_one_thread
def fields_along(
    solver: FieldSolver,
    unknowns: Unknowns,
    values: RealArray,
    freq: RealArray,
    columns: IndexArray,
    directions: RealArray,
) -> tuple[ComplexArray, ComplexArray]:
    """Return fields U, (N, n_f, n_j), of unit forces, and dU, (N, n_f, k, n_j), along directions.

    dU = -Z^-1 (dZ U). For many DOFs and few directions, (n_p, k), this takes fewer solves than one
    field per DOF (`receptance`); errors as there.
    """
    system, omega = solver.system, 2.0 * np.pi * freq
    state = unknowns.state(system, values)
    coefficients = system.coefficients(state, omega)
    slopes = -unknowns.slopes(system, state, values, omega)
    along = slopes[:, :, None] * directions[unknowns.owner, None, :]

    def forces(U: ComplexArray, lines: slice) -> ComplexArray:
        out = np.zeros((*U.shape[:2], directions.shape[1], U.shape[2]), dtype=np.complex128)
        for family in _by_rows(system, unknowns.at):
            own: Any = system.terms[family[0][0]].row_index
            u = U[own]
            for t, drives in family:
                times_field = system.terms[t].times(u)[:, :, None, :]
                out[own] += along[drives, lines].sum(axis=0)[:, :, None] * times_field
        return out.reshape(*U.shape[:2], -1)

    U, dU = solver.solve_twice(coefficients, columns, freq, forces)
    return U, dU.reshape(*U.shape[:2], -1, U.shape[2])


@use_one_thread
def condensed_product(
    solver: FieldSolver,
    unknowns: Unknowns,
    values: RealArray,
    freq: RealArray,
    retained: IndexArray,
    motion: ComplexArray,
    *,
    derivatives: bool = True,
) -> tuple[ComplexArray, ComplexArray | None]:
    """Return Z_red h_X, (n_f, n, m), and T^T Z'_p (T h_X) for measured or unit columns h_X."""
    system, omega = solver.system, 2.0 * np.pi * freq
    state = unknowns.state(system, values)
    Z_red, T = solver.condense(system.coefficients(state, omega), retained, freq)
    product = Z_red @ motion
    if not derivatives:
        return product, None
    reduced_motion = (T.transpose(1, 0, 2) @ motion).transpose(1, 0, 2)
    return product, contract(
        system, unknowns, unknowns.slopes(system, state, values, omega), T, reduced_motion
    )


def _in_order(dofs: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Return each DOF once, in order of first appearance, and the position of each of `dofs`."""
    return _order_of(np.asarray(dofs, dtype=np.intp).tobytes())


@lru_cache(maxsize=64)
def _order_of(dofs: bytes) -> tuple[IndexArray, IndexArray]:
    """Return the result of `_in_order`, which all evaluations of a part share."""
    given = np.frombuffer(dofs, dtype=np.intp)
    _, first, place = np.unique(given, return_index=True, return_inverse=True)
    order = np.argsort(first)
    found = given[first[order]], np.argsort(order)[place]
    for array in found:
        array.flags.writeable = False
    return found


def _view(places: IndexArray) -> Any:
    """Return an index for columns: a slice, which copies nothing, if they are the first columns."""
    if np.array_equal(places, np.arange(len(places))):
        return slice(len(places))
    return places


def contract(
    system: AffineSystem, unknowns: Unknowns, slopes: ComplexArray, V: ComplexArray, U: ComplexArray
) -> ComplexArray:
    """Return the sum of slope_d V^T A_d U over the drives of each unknown, (n_p, n_f, n_v, n_u)."""
    owner, n_u = unknowns.owner.tolist(), U.shape[2]
    weights = slopes[:, :, None, None]
    out = np.empty((unknowns.n, U.shape[1], V.shape[2], n_u), dtype=np.complex128)
    begun = [False] * unknowns.n
    for family in _by_rows(system, unknowns.at):
        own: Any = system.terms[family[0][0]].row_index
        u = U[own]
        times_field = np.concatenate([system.terms[t].times(u) for t, _ in family], axis=2)
        product = _product(V[own], times_field)
        for i, (_, drives) in enumerate(family):
            part = product[:, :, i * n_u : (i + 1) * n_u]
            for d in drives:
                p = owner[d]
                if begun[p]:
                    out[p] += weights[d] * part
                else:
                    np.multiply(weights[d], part, out=out[p])
                    begun[p] = True
    out[np.logical_not(begun)] = 0.0
    return out


def _product(V: ComplexArray, U: ComplexArray) -> ComplexArray:
    """Return V^T U at each line, shape (n_f, n_v, n_u), for fields (n, n_f, columns)."""
    return np.asarray(V.transpose(1, 2, 0) @ U.transpose(1, 0, 2))


def _by_rows(system: AffineSystem, at: IndexArray) -> Iterable[list[tuple[int, list[int]]]]:
    """Return the terms at given positions, each with these positions, grouped by equal rows."""
    positions: dict[int, list[int]] = {}
    for d, t in enumerate(at.tolist()):
        positions.setdefault(t, []).append(d)
    together: dict[int, list[tuple[int, list[int]]]] = {}
    for t in sorted(positions):
        together.setdefault(id(system.terms[t].rows), []).append((t, positions[t]))
    return together.values()
