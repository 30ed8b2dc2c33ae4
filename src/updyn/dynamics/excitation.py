"""Excitation without a measured force: a moving base, or a force of unknown size.

A transmissibility T = u_i / u_j is a ratio of receptances H of one column of forces. A base b moves
as one rigid body, u_b = d, under the forces H_bb^-1 d; one force at k with the motion u_j = 1 is
1 / H_jk. With R for the DOFs whose motion is prescribed and A for those where the forces act, both
are

    U = X_A (X_A at R)^-1 d,       V_i = X_i - X_R (X_A at R)^-T (X_A at i),

where X = Z^-1 E are fields of unit forces. V is the field of a unit force at i with the motion at R
held by forces at A, and dU_i/dp = -V_i^T Z'_p U as for a receptance. A prescribed motion is
independent of the dynamic stiffness between the DOFs of the base, so that springs there, which make
a free structure solvable at 0 Hz, do not change the result.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from updyn.arrays import ComplexArray, IndexArray, IntegerArray, RealArray
from updyn.dofs import Dof, DofSet
from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.fields import EXACT_TIERS, FieldSolver
from updyn.dynamics.pencil import Pencil
from updyn.errors import DataError, DofError, OptionError, SolverError
from updyn.frf import FRF, TRANSMISSIBILITY
from updyn.linalg.settings import SPARSE_SOLVER
from updyn.linalg.threads import use_one_thread
from updyn.model import Model

__all__ = [
    "ChannelIndices",
    "DrivenSolver",
    "Excitation",
    "find_channels",
    "find_excitation",
    "fix_base",
    "hold_base",
]


@dataclass(frozen=True, slots=True, eq=False)
class Excitation:
    """A prescribed motion of a model, and the DOFs where the forces act that cause it."""

    #: DOFs of the model whose motion is prescribed, shape (k,): those of the base, or the
    #: reference.
    moved: IndexArray
    #: Their motion for a unit motion of the reference sensor, shape (k,).
    motion: RealArray
    #: DOFs of the forces, shape (k,): those of the base, or the location of the force.
    forced: IndexArray

    @property
    def is_base(self) -> bool:
        """Whether the forces act where the motion is prescribed."""
        return np.array_equal(self.moved, self.forced)

    def hold(self, system: AffineSystem, highest: float) -> AffineSystem:
        """Return the system with springs to ground at the base, which do not change the result."""
        # Their stiffness is above the dynamic stiffness of the base up to the line `highest` (Hz).
        if not self.is_base:
            return system
        c = system.coefficients(system.start, np.array([0.0, 2.0 * np.pi * highest]))
        size = np.zeros(system.n)
        for term, weights in zip(system.terms, np.abs(c).max(axis=1), strict=True):
            size[term.rows] += weights * np.abs(term.local.diagonal())
        stiffness = max(float(size[self.moved].max()), np.finfo(float).tiny)
        spring = sp.csr_array(
            (np.full(len(self.moved), stiffness), (self.moved, self.moved)),
            shape=(system.n, system.n),
        )
        return system.with_springs(spring)


def find_excitation(dofs: DofSet, frf: FRF) -> Excitation | None:
    """Return the excitation of a measurement in a model with `dofs`; None for measured forces."""
    if frf.quantity != TRANSMISSIBILITY:
        return None
    if frf.base is None and frf.force is None:
        raise DataError(
            "transmissibility: the excitation is not stated; write the DOFs of the model that move"
            f' with the base, such as base = ["{frf.references[0]}"], or the DOF of the only force'
            ' of unknown size, such as force = "12:Z"',
            key=("base",),
        )
    if len(frf.references) > 1:
        raise DataError(
            f"transmissibility: {len(frf.references)} references"
            f" ({', '.join(frf.references.labels)}) with one excitation; a ratio to each of several"
            " references needs as many independent excitations. Select one reference"
            " (references = [...]); measurements with another excitation are another test",
            key=("references",),
        )
    reference = frf.references[0]
    if frf.force is not None:
        return _find_ratio(dofs, reference, frf.force)
    assert frf.base is not None
    return _find_base(dofs, reference, frf.base)


def _find_base(dofs: DofSet, reference: Dof, base: DofSet) -> Excitation:
    try:
        at = dofs.match(base, "base: DOF")
    except DofError as error:
        raise DofError(
            f"{error}. A DOF that the model fixes (support, SPC) is not in its matrices: release it"
            " in the model, and state it as base",
            key=("base",),
        ) from error
    if reference not in base:
        raise DataError(
            f"base: the reference {reference} of the transmissibility is not among"
            f" {', '.join(base.labels)}; expected the DOF of the reference sensor among those of"
            " the base. A sensor with another label is matched by [match] or updyn.match",
            key=("base",),
        )
    of_reference = next(dof for dof in base if abs(dof) == abs(reference))
    motion = at.sign.astype(np.float64) * of_reference.sign * reference.sign
    return Excitation(at.index, motion, at.index)


def _find_ratio(dofs: DofSet, reference: Dof, force: Dof) -> Excitation:
    moved = dofs.match([reference], "reference")
    forced = dofs.match([force], "force")
    return Excitation(moved.index, moved.sign.astype(np.float64), forced.index)


def hold_base(model: Model, frf: FRF) -> tuple[Model, FRF]:
    """Return the model with its base fixed and the data of the sensors off the base."""
    if frf.quantity != TRANSMISSIBILITY:
        return model, frf
    if frf.base is None:
        raise DataError("the peaks of a ratio of two responses are not modes of the structure")
    elsewhere = [dof for dof in frf.responses if dof not in frf.base]
    if not elsewhere:
        raise DataError("all sensors are at the base, which does not move in a mode")
    return fix_base(model, frf), frf.select(responses=elsewhere)


def fix_base(model: Model, frf: FRF) -> Model:
    """Return the model with the base of the data fixed; the model itself without a base."""
    if frf.base is None:
        return model
    model.refuse_nonlinear("base excitation")
    keep = model.dofs.complement(frf.base)
    T = sp.csr_array(sp.eye_array(model.n_dofs, format="csr")[:, keep])
    groups = {
        name: group.transformed(lambda A: sp.csr_array(T.T @ A @ T), T)
        for name, group in model.groups.items()
    }
    return Model(groups, model.dofs[keep], model.geometry, model.title)


@dataclass(frozen=True, slots=True, eq=False)
class DrivenSolver:
    """Fields of a structure under a prescribed motion, for `FieldSolver` of the model with forces.

    The column `drive`, one more than the last DOF, is the field of the prescribed motion; a column
    of a DOF is the field of a unit force there with the prescribed DOFs held.
    """

    inner: FieldSolver
    excitation: Excitation

    @property
    def drive(self) -> IndexArray:
        """The column of the prescribed motion, shape (1,)."""
        return np.array([len(self.inner.system.dofs)])

    @property
    def system(self) -> AffineSystem:
        """The model, or its projection."""
        return self.inner.system

    @property
    def tier(self) -> str:
        """One of `TIERS`."""
        return self.inner.tier

    @property
    def backend(self) -> str:
        """Sparse factorisation."""
        return self.inner.backend

    @property
    def label(self) -> str:
        """Name of the solver within a run."""
        driven = self.excitation  # as lists, because the text of a long array is shortened
        values = (array.tolist() for array in (driven.moved, driven.motion, driven.forced))
        return f"{self.inner.label} {' '.join(map(str, values))}"

    @property
    def solve_counts(self) -> dict[str, int]:
        """Number of sparse solves of each backend here, by name."""
        return self.inner.solve_counts

    def with_decay(self, decay: float) -> DrivenSolver:
        """Return the solver at i omega + decay, in 1/s, instead of i omega."""
        return replace(self, inner=self.inner.with_decay(decay))

    def block_size(self, n_columns: int) -> int:
        """Return the number of lines in a block of bounded memory."""
        return self.inner.block_size(2 * n_columns + 2 * len(self.excitation.moved))

    def pencil(self, state: State, lines: RealArray) -> Pencil | None:
        """Return a solver for all `lines` (Hz) of a state, or None if it does not save time."""
        return self.inner.pencil(state, lines)

    def solve(
        self,
        coefficients: ComplexArray,
        columns: IndexArray,
        freq: RealArray,
        pencil: Pencil | None = None,
    ) -> ComplexArray:
        """Return fields, shape (N, n_lines, r), of unit forces and of the prescribed motion."""
        loaded = self._find_loaded(columns)
        X = self.inner.solve(coefficients, loaded, freq, pencil)
        return self._combine(X, loaded, columns, freq)

    def solve_twice(
        self,
        coefficients: ComplexArray,
        columns: IndexArray,
        freq: RealArray,
        forces: Callable[[ComplexArray, slice], ComplexArray],
    ) -> tuple[ComplexArray, ComplexArray]:
        """Solve as `solve`, then for forces that depend on the result, with the motion held."""
        loaded = self._find_loaded(columns)

        def of_fields(X: ComplexArray, lines: slice) -> ComplexArray:
            return forces(self._combine(X, loaded, columns, freq[lines]), lines)

        X, Y = self.inner.solve_twice(coefficients, loaded, freq, of_fields)
        forced = X[:, :, np.searchsorted(loaded, self.excitation.forced)]
        held = _by_line(self.inner.at(Y, self.excitation.moved))
        S = self._receptance(forced)
        Y = Y - _combine_columns(forced, np.linalg.solve(S, held))
        return self._combine(X, loaded, columns, freq), Y

    def at(self, fields: ComplexArray, dofs: IndexArray) -> ComplexArray:
        """Return the motion at some DOFs from fields."""
        return self.inner.at(fields, dofs)

    def condense(
        self, coefficients: ComplexArray, retained: IndexArray, freq: RealArray
    ) -> tuple[ComplexArray, ComplexArray]:
        """Raise OptionError: there are no measured forces."""
        raise OptionError(
            "the condensed equation error needs measured forces, which a transmissibility does not"
            " have; use method = 'maximum-likelihood', 'log' or 'output-error'"
        )

    def other_dofs(self, excluded: IndexArray) -> IndexArray:
        """Return readable DOFs except `excluded`."""
        return self.inner.other_dofs(excluded)

    def coupled_dofs(self, dof: int) -> IntegerArray:
        """Return the DOFs coupled with a DOF in the model, itself included."""
        return self.inner.coupled_dofs(dof)

    def _find_loaded(self, columns: IndexArray) -> IndexArray:
        """Return the DOFs to load for some columns, ascending."""
        of_dofs = columns[columns < self.drive]
        needed = [self.excitation.forced, of_dofs]
        if len(of_dofs):
            needed.append(self.excitation.moved)
        return np.unique(np.concatenate(needed))

    @use_one_thread
    def _combine(
        self, X: ComplexArray, loaded: IndexArray, columns: IndexArray, freq: RealArray
    ) -> ComplexArray:
        """Return the fields of `columns` from those of unit forces at `loaded`."""
        of_dofs = columns < self.drive
        forced = X[:, :, np.searchsorted(loaded, self.excitation.forced)]
        S = self._receptance(forced)
        out = np.empty((*X.shape[:2], len(columns)), dtype=np.complex128)
        if not of_dofs.all():
            out[:, :, ~of_dofs] = self._move(forced, S, freq)
        if of_dofs.any():
            dofs = columns[of_dofs]
            moved = X[:, :, np.searchsorted(loaded, self.excitation.moved)]
            at_dofs = _by_line(self.inner.at(forced, dofs)).transpose(0, 2, 1)
            weights = np.linalg.solve(S.transpose(0, 2, 1), at_dofs)
            out[:, :, of_dofs] = X[:, :, np.searchsorted(loaded, dofs)]
            out[:, :, of_dofs] -= _combine_columns(moved, weights)
        return out

    def _receptance(self, forced: ComplexArray) -> ComplexArray:
        """Return the motion of the prescribed DOFs for the forces, (n_lines, k, k)."""
        return _by_line(self.inner.at(forced, self.excitation.moved))

    def _move(self, forced: ComplexArray, S: ComplexArray, freq: RealArray) -> ComplexArray:
        """Return the fields of the prescribed motion, shape (N, n_lines, 1)."""
        try:
            weights = np.linalg.solve(S, self.excitation.motion[:, None].astype(np.complex128))
        except np.linalg.LinAlgError:
            weights = np.full((len(S), S.shape[1], 1), np.inf, dtype=np.complex128)
        with np.errstate(invalid="ignore"):
            U = _combine_columns(forced, weights)
        size = np.abs(U).max(axis=(0, 2))
        if self.tier in EXACT_TIERS and not (size < SPARSE_SOLVER.largest_growth).all():
            line = freq[int(np.argmin(size < SPARSE_SOLVER.largest_growth))]
            raise SolverError(
                f"the transmissibility is infinite at {line:g} Hz: without damping, this is a"
                " natural frequency of the structure with the reference held; leave the line out,"
                " or give the model damping"
            )
        return U


@dataclass(frozen=True, slots=True, eq=False)
class ChannelIndices:
    """Channels of a measurement in the columns of a solver.

    `rows` are the DOFs of the responses, `columns` the columns of the references; `sign`, shape
    (n_i, n_j), is the product of their signs.
    """

    rows: IndexArray
    columns: IndexArray
    sign: RealArray


def find_channels(solver: FieldSolver, frf: FRF) -> ChannelIndices:
    """Return the channels of a measurement; a transmissibility has the column of the drive."""
    dofs = solver.system.dofs
    rows = dofs.match(frf.responses, "response")
    if isinstance(solver, DrivenSolver) and frf.quantity == TRANSMISSIBILITY:
        return ChannelIndices(rows.index, solver.drive, rows.sign[:, None])
    columns = dofs.match(frf.references, "reference")
    return ChannelIndices(rows.index, columns.index, rows.sign[:, None] * columns.sign)


def _by_line(values: ComplexArray) -> ComplexArray:
    """Return values (n, n_lines, k) as (n_lines, n, k)."""
    return np.ascontiguousarray(values.transpose(1, 0, 2))


def _combine_columns(fields: ComplexArray, weights: ComplexArray) -> ComplexArray:
    """Return fields (N, n_lines, k) times weights (n_lines, k, r), (N, n_lines, r)."""
    return np.asarray((fields.transpose(1, 0, 2) @ weights).transpose(1, 0, 2))
