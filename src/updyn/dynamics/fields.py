"""Fields: solutions of Z(omega) X = B at many lines, arrays (N, n_lines, n_columns).

Small models are solved in batches of lines; larger ones by one sparse factorisation per line.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, cast

import numpy as np
import scipy.sparse as sp

from updyn.arrays import ComplexArray, IndexArray, IntegerArray, NumberArray, RealArray
from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.pencil import Pencil, PencilCache, StateWeights
from updyn.dynamics.settings import LINE_SOLVER, PENCIL
from updyn.errors import OptionError, SolverError, suggest
from updyn.linalg.settings import SPARSE_SOLVER
from updyn.linalg.solver import (
    SparseSolver,
    check_backend,
    probe_load,
    scaled_growth,
    singular_message,
    unit_scale,
)
from updyn.linalg.threads import use_one_thread

__all__ = [
    "EXACT_TIERS",
    "TIERS",
    "FieldSolver",
    "LineSolver",
    "Partition",
    "solve_dense",
    "solve_lines",
    "split_into_blocks",
]

EXACT_TIERS = ("dense", "sparse")
TIERS = (*EXACT_TIERS, "reduced")


_HELD = "with the retained DOFs held "


class FieldSolver(Protocol):
    """Solver at many lines: exact (`LineSolver`) or of a reduced model (`ReducedSolver`)."""

    @property
    def system(self) -> AffineSystem:
        """The model, or its projection."""

    @property
    def tier(self) -> str:
        """One of `TIERS`."""

    @property
    def backend(self) -> str:
        """Sparse factorisation."""

    @property
    def label(self) -> str:
        """Name of the solver within a run."""

    @property
    def solve_counts(self) -> dict[str, int]:
        """Number of sparse solves of each backend here, by name."""

    def with_decay(self, decay: float) -> FieldSolver:
        """Return the solver at i omega + decay, in 1/s, instead of i omega."""

    def block_size(self, n_columns: int) -> int:
        """Return the number of lines in a block."""

    def pencil(self, state: State, lines: RealArray) -> Pencil | None:
        """Return a solver for many lines (Hz) of a state at once, or None if it does not save time.

        The choice does not depend on the distribution of the lines over blocks and processes.
        """

    def solve(
        self,
        coefficients: ComplexArray,
        columns: IndexArray,
        freq: RealArray,
        pencil: Pencil | None = None,
    ) -> ComplexArray:
        """Return fields, shape (N, n_lines, r), for unit forces on some DOFs."""

    def solve_twice(
        self,
        coefficients: ComplexArray,
        columns: IndexArray,
        freq: RealArray,
        forces: Callable[[ComplexArray, slice], ComplexArray],
    ) -> tuple[ComplexArray, ComplexArray]:
        """Solve for unit forces, then for forces that depend on the result."""

    def at(self, fields: ComplexArray, dofs: IndexArray) -> ComplexArray:
        """Return the motion at some DOFs from fields."""

    def condense(
        self,
        coefficients: ComplexArray,
        retained: IndexArray,
        freq: RealArray,
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return Z_red and T, see `LineSolver.condense`."""

    def other_dofs(self, excluded: IndexArray) -> IndexArray:
        """Return readable DOFs except `excluded`."""

    def coupled_dofs(self, dof: int) -> IntegerArray:
        """Return the DOFs coupled with a DOF in the model, itself included."""


@dataclass(frozen=True, slots=True, eq=False)
class LineSolver:
    """Solver of Z, or of its part on some DOFs, at blocks of lines.

    `tier` is "dense" or "sparse"; `variant` names a variant of the model within a run, else empty.
    """

    system: AffineSystem
    tier: str
    backend: str
    variant: str = ""
    _kept: dict[bytes, Any] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def choose(
        cls, system: AffineSystem, tier: str | None = None, backend: str | None = None
    ) -> LineSolver:
        """Return a solver with tier and backend by size and fill, unless given."""
        if tier is None:
            tier = "dense" if _is_dense(system) else "sparse"
        elif tier not in EXACT_TIERS:
            raise OptionError(f"tier {tier!r}: {suggest(str(tier), EXACT_TIERS)}", key=("tier",))
        return cls(system, tier, check_backend(backend))

    def __reduce__(self) -> tuple[object, ...]:
        # Factorisations stay in their process.
        return LineSolver, (self.system, self.tier, self.backend, self.variant)

    @property
    def label(self) -> str:
        """Name of the solver within a run."""
        return f"{self.tier} {self.variant}" if self.variant else self.tier

    @property
    def solve_counts(self) -> dict[str, int]:
        """Number of sparse solves of each backend here, by name."""
        out: dict[str, int] = {}
        for kept in self._kept.values():
            for solver in kept:
                if not isinstance(solver, SparseSolver):
                    continue
                for name, number in solver.solve_counts.items():
                    out[name] = out.get(name, 0) + number
        return out

    def with_decay(self, decay: float) -> LineSolver:
        """Return the solver at i omega + decay, in 1/s, with the analysed patterns."""
        if decay == self.system.decay:
            return self
        out = replace(self, system=self.system.with_decay(decay))
        out._kept.update(self._kept)
        return out

    def other_dofs(self, excluded: IndexArray) -> IndexArray:
        """Return the DOFs except `excluded`."""
        return np.setdiff1d(np.arange(self.system.n), excluded)

    def coupled_dofs(self, dof: int) -> IntegerArray:
        """Return the DOFs coupled with a DOF, itself included."""
        return self.system.coupled_dofs(dof)

    def block_size(self, n_columns: int) -> int:
        """Return the number of lines in a block of bounded memory."""
        n = self.system.n
        # Only one sparse matrix is in memory, for any number of lines.
        per_line = 16 * n * n_columns
        if self.tier == "dense":
            per_line = 16 * (n * n + 2 * n * n_columns)
        return max(1, int(LINE_SOLVER.block_bytes // max(per_line, 1)))

    def pencil(self, state: State, lines: RealArray) -> Pencil | None:
        """Return a solver for all `lines` (Hz) of a state, or None if it does not save time."""
        if self.tier != "dense":
            return None
        kept = self._kept.setdefault(b"pencil", (PencilCache(PENCIL.least_lines),))
        return cast("PencilCache", kept[0]).find(self.system, state, lines, self._matrices)

    def solve(
        self,
        coefficients: ComplexArray,
        columns: IndexArray,
        freq: RealArray,
        pencil: Pencil | None = None,
    ) -> ComplexArray:
        """Return X of Z X = E, (N, n_lines, r) in m/N; E are columns of the identity."""
        n, r = self.system.n, len(columns)
        B = make_unit_loads(n, columns)
        if self.tier == "dense":

            def exact(lines: IndexArray) -> ComplexArray:
                c = coefficients[:, lines]
                Z = self._dense(self.system.values(c))
                loads = np.broadcast_to(B, (len(lines), n, r))
                X = solve_dense(Z, loads, freq[lines], size=self._sizes(c))
                return X.transpose(1, 0, 2)

            return solve_lines(pencil, self.system, coefficients, freq, B.real, exact)
        solver, Z = self._whole()

        def line(i: int) -> ComplexArray:
            self.system.write(coefficients[:, i], Z.data)
            return solver.solve(Z, B, float(freq[i]))

        if len(freq) == 1:
            return line(0)[:, None]  # avoids a copy for large models
        out = np.empty((len(freq), r, n), dtype=np.complex128)
        for i in range(len(freq)):
            out[i] = line(i).T
        return out.transpose(2, 0, 1)

    def solve_twice(
        self,
        coefficients: ComplexArray,
        columns: IndexArray,
        freq: RealArray,
        forces: Callable[[ComplexArray, slice], ComplexArray],
    ) -> tuple[ComplexArray, ComplexArray]:
        """Solve Z X = E as `solve`, and then Z Y = F(X); sparse, by one factorisation of each line.

        `forces` gets X at n lines, (N, n, r), and the slice of these lines; it returns F, (N, n,
        k).
        """
        if self.tier == "dense":
            X = self.solve(coefficients, columns, freq)
            return X, self.solve_forces(coefficients, forces(X, slice(len(freq))), freq)
        solver, Z = self._whole()
        B = make_unit_loads(self.system.n, columns)
        first, second = [], []
        for i in range(len(freq)):
            self.system.write(coefficients[:, i], Z.data)
            factorised = solver.factorise(Z, float(freq[i]))
            X = factorised.solve(B)[:, None]
            Y = factorised.solve(np.asfortranarray(forces(X, slice(i, i + 1))[:, 0]))
            first.append(X)
            second.append(Y[:, None])
        return np.concatenate(first, axis=1), np.concatenate(second, axis=1)

    def solve_forces(
        self,
        coefficients: ComplexArray,
        forces: ComplexArray,
        freq: RealArray,
    ) -> ComplexArray:
        """Return X of Z X = F, shape (N, n_lines, r), for forces on all DOFs; errors as `solve`."""
        if self.tier == "dense":
            Z = self._dense(self.system.values(coefficients))
            loads = forces.transpose(1, 0, 2)
            X = solve_dense(Z, loads, freq, size=self._sizes(coefficients))
            return X.transpose(1, 0, 2)
        solver, Z = self._whole()
        out = np.empty((len(freq), forces.shape[2], self.system.n), dtype=np.complex128)
        for i in range(len(freq)):
            self.system.write(coefficients[:, i], Z.data)
            out[i] = solver.solve(Z, np.asfortranarray(forces[:, i]), float(freq[i])).T
        return out.transpose(2, 0, 1)

    def at(self, fields: ComplexArray, dofs: IndexArray) -> ComplexArray:
        """Return the motion at some DOFs, shape (len(dofs), n_lines, r), from fields of `solve`."""
        return fields[dofs]

    def condense(
        self,
        coefficients: ComplexArray,
        retained: IndexArray,
        freq: RealArray,
    ) -> tuple[ComplexArray, ComplexArray]:
        """Condense Z exactly onto the retained DOFs (Bao, Wang & Cheng 2010, eqs. 8, 9).

        Returns Z_nn - Z_ns Z_ss^-1 Z_sn, (n_lines, n, n), and T = [I; -Z_ss^-1 Z_sn], (N, n_lines,
        n), rows in the order of the model's DOFs. Raises SolverError if Z_ss is singular at a line:
        a natural frequency of the structure with fixed retained DOFs.
        """
        partition, solver = self._partition(retained)
        eliminated, n = partition.eliminated, len(retained)
        if self.tier == "dense":
            damped = coefficients.imag.any()
            Z = self._dense(self.system.values(coefficients if damped else coefficients.real))
            T = np.zeros((len(freq), self.system.n, n), dtype=np.complex128)
            T[:, retained] = np.eye(n)
            Znn = Z[:, retained[:, None], retained].astype(np.complex128)
            if eliminated.size == 0:
                return Znn, T.transpose(1, 0, 2)
            Zsn = Z[:, eliminated[:, None], retained]
            Zss, size = Z[:, eliminated[:, None], eliminated], self._sizes(coefficients)
            W = solve_dense(Zss, Zsn, freq, _HELD, size=size[:, eliminated])
            T[:, eliminated] = -W
            return Znn - Zsn.transpose(0, 2, 1) @ W, T.transpose(1, 0, 2)
        T = np.zeros((len(freq), n, self.system.n), dtype=np.complex128)
        T[:, :, retained] = np.eye(n)
        Z_red = np.empty((len(freq), n, n), dtype=np.complex128)
        values = np.empty(len(self.system.indices), dtype=np.complex128)
        for i, f in enumerate(freq):
            self.system.write(coefficients[:, i], values)
            Z_red[i], block, Zss = partition.blocks(values)
            if eliminated.size:
                X = solver.solve(Zss, block, float(f), _HELD)
                T[i, :, eliminated] = -X
                Z_red[i] -= block.T @ X
        return Z_red, T.transpose(2, 0, 1)

    def _whole(self) -> tuple[SparseSolver, sp.csc_array]:
        """Return the solver for all of Z and a matrix to write its values into; both are kept."""
        if b"" not in self._kept:
            self._kept[b""] = (
                SparseSolver(self.backend),
                make_empty_matrix(self.system.indptr, self.system.indices),
            )
        return cast("tuple[SparseSolver, sp.csc_array]", self._kept[b""])

    def _partition(self, retained: IndexArray) -> tuple[Partition, SparseSolver]:
        """Return the blocks for some retained DOFs and the solver for Z_ss; both are kept."""
        key = retained.tobytes()
        if key not in self._kept:
            self._kept[key] = Partition.find(self.system, retained), SparseSolver(self.backend)
        return cast("tuple[Partition, SparseSolver]", self._kept[key])

    def _sizes(self, coefficients: ComplexArray) -> RealArray:
        """Return diagonal magnitudes of Z without cancellation of terms, shape (n_lines, N)."""
        key = b"diagonals"
        if key not in self._kept:
            diagonals = np.zeros((len(self.system.terms), self.system.n))
            for diagonal, term in zip(diagonals, self.system.terms, strict=True):
                diagonal[term.rows] = np.abs(term.local.diagonal())
            self._kept[key] = (diagonals,)
        (diagonals,) = self._kept[key]
        return np.asarray(np.abs(coefficients).T @ diagonals)

    def _matrices(self, weights: StateWeights) -> tuple[RealArray, RealArray, RealArray]:
        """Return K, D and M of a state, shape (N, N) each."""
        n, places = self.system.n, self.system.rows_of_entries() * self.system.n
        places += self.system.indices
        K, D, M = np.zeros((3, n * n))
        K[places] = self.system.real_values(weights.stiffness)
        D[places] = self.system.real_values(weights.damping)
        M[places] = self.system.real_values(weights.mass)
        return K.reshape(n, n), D.reshape(n, n), M.reshape(n, n)

    def _dense(self, values: NumberArray) -> NumberArray:
        n = self.system.n
        if len(values) == n * n:
            return values.T.reshape(-1, n, n)
        Z = np.zeros((values.shape[1], n * n), dtype=values.dtype)
        Z[:, self.system.rows_of_entries() * n + self.system.indices] = values.T
        return Z.reshape(-1, n, n)


def make_unit_loads(n: int, columns: IndexArray) -> ComplexArray:
    """Return unit forces on some of n DOFs as columns in Fortran order."""
    B = np.zeros((n, len(columns)), dtype=np.complex128, order="F")
    B[columns, np.arange(len(columns))] = 1.0
    return B


def split_into_blocks(n_lines: int, size: int) -> Iterator[slice]:
    """Yield the lines in blocks of at most `size`, in order."""
    for first in range(0, n_lines, size):
        yield slice(first, min(first + size, n_lines))


def solve_lines(
    pencil: Pencil | None,
    system: AffineSystem,
    coefficients: ComplexArray,
    freq: RealArray,
    B: RealArray,
    exact: Callable[[IndexArray], ComplexArray],
) -> ComplexArray:
    """Return solutions, (n, n_lines, r), by the pencil of the state; other lines one by one.

    `B`, (n, r), is the same at every line. `exact` solves the lines at some positions of the block.
    """
    if pencil is None:
        return exact(np.arange(len(freq)))
    s = np.asarray(2j * np.pi * freq + system.decay, dtype=np.complex128)
    X, accepted = pencil.solve(coefficients, s**2, B)
    rest = np.flatnonzero(~accepted)
    if len(rest):
        X[:, rest] = exact(rest)
    return X


@use_one_thread
def solve_dense(
    Z: NumberArray,
    B: NumberArray,
    freq: RealArray,
    held: str = "",
    *,
    size: RealArray | None = None,
) -> ComplexArray:
    """Return X of Z X = B for dense Z, (n_lines, n, n); SolverError if one is singular.

    `size`, (n_lines, n), are diagonal magnitudes without cancellation of terms (by default those of
    Z). They scale rows and columns for the checks. `held` is the text on fixed DOFs for messages.
    """
    if size is None:
        size = np.abs(np.einsum("fii->fi", Z))
    n_lines, n, r = B.shape
    loads = np.empty((n_lines, n, r + 1), dtype=np.complex128)
    loads[:, :, :r] = B
    scale = unit_scale(size)
    loads[:, :, r:] = probe_load(scale)
    try:
        X = _solve_batch(Z, loads)
    except np.linalg.LinAlgError:
        X = np.stack([_solve_or_infinite(z, load) for z, load in zip(Z, loads, strict=True)])
    answer, probe = X[:, :, :r], X[:, :, r:]
    accepted = scaled_growth(scale, answer, B) <= SPARSE_SOLVER.largest_growth
    accepted &= scaled_growth(scale, probe, loads[:, :, r:]) <= SPARSE_SOLVER.largest_probe_growth
    if not accepted.all():
        first = int(np.argmin(accepted))
        raise SolverError(singular_message(freq[first], held, scale=scale[first]))
    return answer


def _solve_batch(Z: NumberArray, B: ComplexArray) -> ComplexArray:
    """Return the solution of Z X = B, in real arithmetic without damping."""
    if np.iscomplexobj(Z) and Z.imag.any():
        return np.asarray(np.linalg.solve(Z, B), dtype=np.complex128)
    # Real and imaginary parts are separate columns.
    X = np.linalg.solve(Z.real, np.ascontiguousarray(B).view(np.float64))
    return np.ascontiguousarray(X).view(np.complex128)


def _solve_or_infinite(Z: NumberArray, B: ComplexArray) -> ComplexArray:
    """Return the solution of Z X = B at one line, or infinite values if Z has no inverse."""
    try:
        return _solve_batch(Z, B)
    except np.linalg.LinAlgError:
        return np.full_like(B, np.inf)


@dataclass(frozen=True, slots=True, eq=False)
class Partition:
    """Blocks of Z on one pattern for the retained (n) and the eliminated (s) DOFs.

    `nn`, `sn` and `ss_places` have the position of each entry of a block among the values of Z.
    `ss` is the complex block of the last line; all lines share its memory, and its pattern is
    checked once.
    """

    retained: IndexArray
    eliminated: IndexArray
    nn: sp.csr_array
    sn: sp.csr_array
    ss: sp.csc_array
    ss_places: NumberArray

    @classmethod
    def find(cls, system: AffineSystem, retained: IndexArray) -> Partition:
        """Find the blocks for some retained DOFs, in the desired order."""
        n = system.n
        keep = np.zeros(n, dtype=np.bool_)
        keep[retained] = True
        eliminated = np.flatnonzero(~keep)
        counted = np.arange(len(system.indices), dtype=system.indptr.dtype)
        places = sp.csr_array((counted, system.indices, system.indptr), shape=(n, n))
        ss = places[eliminated][:, eliminated]
        ss.sort_indices()
        return cls(
            retained,
            eliminated,
            places[retained][:, retained],
            places[eliminated][:, retained],
            make_empty_matrix(ss.indptr, ss.indices),
            ss.data,
        )

    def blocks(self, values: ComplexArray) -> tuple[ComplexArray, ComplexArray, sp.csc_array]:
        """Return Z_nn and Z_sn dense, and Z_ss sparse (CSC), from the values of Z, shape (nnz,)."""
        np.take(values, self.ss_places, out=self.ss.data, mode="clip")
        return _dense_block(self.nn, values), _dense_block(self.sn, values), self.ss


def make_empty_matrix(indptr: NumberArray, indices: NumberArray) -> sp.csc_array:
    """Return a complex CSC array of zeros of a symmetric CSR pattern (its CSC arrays are equal)."""
    n = len(indptr) - 1
    return sp.csc_array(
        (np.zeros(len(indices), dtype=np.complex128), indices, indptr), shape=(n, n)
    )


def _dense_block(places: sp.csr_array, values: ComplexArray) -> ComplexArray:
    block = sp.csr_array((values[places.data], places.indices, places.indptr), shape=places.shape)
    return np.asarray(block.toarray())


def _is_dense(system: AffineSystem) -> bool:
    """Return whether a model is solved dense, by its size and fill."""
    if system.n <= LINE_SOLVER.dense_dofs:
        return True
    filled = len(system.indices) > LINE_SOLVER.dense_fill * system.n**2
    return filled and system.n <= LINE_SOLVER.filled_dofs
