"""Solver in the coordinates of a basis, for many lines of a state at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from updyn.arrays import ComplexArray, IndexArray, IntegerArray, NumberArray, RealArray
from updyn.dynamics.affine import AffineSystem, State, Term
from updyn.dynamics.basis import Basis
from updyn.dynamics.fields import solve_dense, solve_lines
from updyn.dynamics.pencil import Pencil, PencilCache, StateWeights
from updyn.dynamics.settings import PENCIL, REDUCTION
from updyn.errors import OptionError
from updyn.linalg.threads import use_one_thread

__all__ = ["NOT_CONDENSED", "ReducedSolver"]


#: Message on the condensed equation error with a reduced model.
NOT_CONDENSED = (
    "tier 'reduced': the condensed equation error needs Z_red = H^-1, which multiplies the error of"
    " a reduced model by the condition number of H; use tier 'sparse', or another method"
)


@dataclass(frozen=True, slots=True, eq=False)
class ReducedSolver:
    """Solver in the coordinates of a basis. It contains no fields of the full model."""

    #: The projected model, with r coordinates and the terms of the full model.
    system: AffineSystem
    #: DOFs of the model that can be loaded and read, shape (k,), ascending.
    observed: IndexArray
    #: The basis at these DOFs, shape (k, r).
    rows: RealArray
    #: The projected matrices, shape (n_terms, r * r).
    stack: RealArray
    #: For each observed DOF, the DOFs coupled with it in the full model.
    coupling: Mapping[int, IntegerArray]
    #: The backend that made the basis.
    backend: str
    #: Name of the reduced model within a run.
    label: str = "reduced"
    _pencils: PencilCache = field(
        default_factory=lambda: PencilCache(PENCIL.least_reduced_lines), init=False, repr=False
    )

    tier: ClassVar[str] = "reduced"

    @property
    def solve_counts(self) -> dict[str, int]:
        """Empty, because there are no sparse solves."""
        return {}

    @classmethod
    def project(
        cls,
        system: AffineSystem,
        basis: Basis,
        observed: IndexArray,
        backend: str,
        label: str = "reduced",
    ) -> ReducedSolver:
        """Return the solver in an unchanged basis; `observed` are the readable DOFs, ascending."""
        r = basis.size
        rows, entries = np.arange(r), np.arange(r * r)
        terms = tuple(
            Term(t.group, t.quantity, rows, A, entries, A.ravel(), t.table)
            for t, A in zip(system.terms, basis.terms, strict=True)
        )
        reduced = AffineSystem(
            terms,
            system.start,
            r * np.arange(r + 1),
            np.tile(rows, r),
            system.dofs,
            decay=system.decay,
        )
        stack = np.stack([A.ravel() for A in basis.terms])
        coupling = {int(d): system.coupled_dofs(int(d)) for d in observed}
        return cls(reduced, observed, basis.at(observed), stack, coupling, backend, label)

    def with_decay(self, decay: float) -> ReducedSolver:
        """Return the solver at i omega + decay, in 1/s, in the same basis."""
        if decay == self.system.decay:
            return self
        out = replace(self, system=self.system.with_decay(decay))
        object.__setattr__(out, "_pencils", self._pencils)  # valid at any s
        return out

    def block_size(self, n_columns: int) -> int:
        """Return the number of lines in a block of bounded memory."""
        r = self.system.n
        lines = REDUCTION.block_bytes // (48 * r * r + 32 * r * n_columns)
        return int(np.clip(lines, 1, REDUCTION.block_lines))

    def pencil(self, state: State, lines: RealArray) -> Pencil | None:
        """Return a solver for all `lines` (Hz) of a state, or None if it does not save time."""
        return self._pencils.find(self.system, state, lines, self._matrices)

    def _matrices(self, weights: StateWeights) -> tuple[RealArray, RealArray, RealArray]:
        """Return K, D and M of a state, shape (r, r) each."""
        parts = np.stack([weights.stiffness, weights.damping, weights.mass]) @ self.stack
        K, D, M = parts.reshape(3, self.system.n, self.system.n)
        return K, D, M

    @use_one_thread
    def solve(
        self,
        coefficients: ComplexArray,
        columns: IndexArray,
        freq: RealArray,
        pencil: Pencil | None = None,
    ) -> ComplexArray:
        """Return the coordinates q of V^T Z V q = V^T E, (r, n_lines, k); `at` returns the motion.

        E are the columns `columns` of the identity. A `pencil` must be that of the same state.
        """
        loads = self._rows_of(columns).T

        def exact(lines: IndexArray) -> ComplexArray:
            forces = np.broadcast_to(loads[:, None], (len(loads), len(lines), len(columns)))
            return self._solve_forces(coefficients[:, lines], forces, freq[lines])

        return solve_lines(pencil, self.system, coefficients, freq, loads, exact)

    def solve_twice(
        self,
        coefficients: ComplexArray,
        columns: IndexArray,
        freq: RealArray,
        forces: Callable[[ComplexArray, slice], ComplexArray],
    ) -> tuple[ComplexArray, ComplexArray]:
        """Solve for unit forces, then for forces of the coordinates (`LineSolver.solve_twice`)."""
        q = self.solve(coefficients, columns, freq)
        return q, self._solve_forces(coefficients, forces(q, slice(len(freq))), freq)

    def _solve_forces(
        self, coefficients: ComplexArray, forces: NumberArray, freq: RealArray
    ) -> ComplexArray:
        """Return coordinates for forces V^T F, both (r, n_lines, k)."""
        r, c = self.system.n, coefficients.T
        Z = np.empty((len(freq), r, r), dtype=np.complex128)
        Z.real = (c.real @ self.stack).reshape(-1, r, r)
        Z.imag = (c.imag @ self.stack).reshape(-1, r, r)
        return solve_dense(Z, forces.transpose(1, 0, 2), freq).transpose(1, 0, 2)

    def at(self, fields: ComplexArray, dofs: IndexArray) -> ComplexArray:
        """Return the response at some DOFs, shape (len(dofs), n_lines, k), from `solve`."""
        r, n_lines, k = fields.shape
        flat = np.ascontiguousarray(fields).reshape(r, -1).view(np.float64)
        moved = np.ascontiguousarray(self._rows_of(dofs) @ flat)
        return moved.view(np.complex128).reshape(len(dofs), n_lines, k)

    def condense(
        self,
        coefficients: ComplexArray,
        retained: IndexArray,
        freq: RealArray,
    ) -> tuple[ComplexArray, ComplexArray]:
        """Raise OptionError: the inverse of H multiplies its error by its condition number."""
        raise OptionError(NOT_CONDENSED)

    def other_dofs(self, excluded: IndexArray) -> IndexArray:
        """Return readable DOFs except `excluded`."""
        return np.setdiff1d(self.observed, excluded)

    def coupled_dofs(self, dof: int) -> IntegerArray:
        """Return the DOFs coupled with a DOF in the full model, itself included."""
        return self.coupling[dof]

    def _rows_of(self, dofs: IndexArray) -> RealArray:
        place = np.searchsorted(self.observed, dofs)
        if (place >= len(self.observed)).any() or (self.observed[place] != dofs).any():
            raise KeyError("the reduced model was built without this DOF")
        return self.rows[place]
