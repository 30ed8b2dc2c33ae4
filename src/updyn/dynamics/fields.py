"""Fields: solving Z(omega) X = B at many lines, the one place where time is spent.

Work is a line. Small models are solved in batches of lines without a loop over lines; larger ones
by sparse factorisation, one a line. Fields are arrays (N, n_lines, n_columns), in memory as the
solve left them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, cast

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.pencil import Pencil, PencilCache, StateWeights
from updyn.errors import OptionError, SolverError, suggest
from updyn.linalg.solver import (
    LARGEST_GROWTH,
    LARGEST_PROBE_GROWTH,
    SparseSolver,
    check_backend,
    growth,
    probe_load,
    singular_message,
    unit_scale,
)
from updyn.linalg.threads import alone

__all__ = [
    "ACCURACY",
    "DENSE_FILL",
    "DENSE_LIMIT",
    "EXACT_TIERS",
    "TIERS",
    "FieldSolver",
    "LineSolver",
    "Partition",
    "line_blocks",
    "solve_dense",
    "solve_lines",
]

EXACT_TIERS = ("dense", "sparse")
TIERS = (*EXACT_TIERS, "reduced")

#: Of a reduced model where none is asked for: the error of a receptance as a share of the largest
#: of its line.
ACCURACY = 1e-5

#: Models up to this many DOFs are solved dense, in batches of lines.
DENSE_LIMIT = 150

#: So are larger ones, up to a size, whose matrix is filled by more than this share: there a sparse
#: factorisation gains little (PARDISO), or takes two to three times as long (SuperLU).
DENSE_FILL, _LARGEST_DENSE = 0.3, 2000

_HELD = "with the retained DOFs held "
_BLOCK_BYTES = 64 * 2**20


class FieldSolver(Protocol):
    """Solver at many lines: exact (`LineSolver`) or of a reduced model (`ReducedSolver`)."""

    @property
    def system(self) -> AffineSystem:
        """What is solved: the model, or its projection."""

    @property
    def tier(self) -> str:
        """One of `TIERS`."""

    @property
    def backend(self) -> str:
        """Sparse factorisation."""

    @property
    def label(self) -> str:
        """Tells the solvers of a run apart."""

    @property
    def used(self) -> dict[str, int]:
        """How many sparse solves each backend answered here, by name."""

    def decaying(self, decay: float) -> FieldSolver:
        """Return the solver at i omega + decay, in 1/s, instead of i omega."""

    def block_size(self, n_columns: int) -> int:
        """Return how many lines to take at a time."""

    def pencil(self, state: State, lines: NDArray[np.float64]) -> Pencil | None:
        """Return what solves many lines of a state at once; None where that does not pay.

        The choice depends on the model, its state and all its lines (Hz), not on how they are
        distributed over blocks and processes.
        """

    def solve(
        self,
        coefficients: NDArray[np.complex128],
        columns: NDArray[np.intp],
        freq: NDArray[np.float64],
        pencil: Pencil | None = None,
    ) -> NDArray[np.complex128]:
        """Return fields, shape (N, n_lines, r), for unit forces on some DOFs."""

    def solve_twice(
        self,
        coefficients: NDArray[np.complex128],
        columns: NDArray[np.intp],
        freq: NDArray[np.float64],
        forces: Callable[[NDArray[np.complex128], slice], NDArray[np.complex128]],
    ) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Solve for unit forces, then for forces that follow; see `LineSolver.solve_twice`."""

    def at(self, fields: NDArray[np.complex128], dofs: NDArray[np.intp]) -> NDArray[np.complex128]:
        """Return the motion at some DOFs from fields."""

    def condense(
        self,
        coefficients: NDArray[np.complex128],
        retained: NDArray[np.intp],
        freq: NDArray[np.float64],
    ) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Return Z_red and T, see `LineSolver.condense`."""

    def others(self, seen: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return DOFs besides `seen` whose motion can be asked for."""

    def coupled(self, dof: int) -> NDArray[np.integer[Any]]:
        """Return the DOFs that one is coupled with in the model, itself included."""


@dataclass(frozen=True, slots=True, eq=False)
class LineSolver:
    """Solve with Z, or with its part on some DOFs, at blocks of lines.

    Parameters
    ----------
    system : AffineSystem
        The compiled model.
    tier : {"dense", "sparse"}
        How.
    backend : str
        Sparse factorisation, see `updyn.linalg`.
    variant : str
        Distinguishes the model from others of the same run; empty for the model itself.
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
        """Choose tier and backend by size and fill; both can be forced.

        Raises
        ------
        OptionError
            If a name is not known.
        """
        if tier is None:
            filled = system.n <= _LARGEST_DENSE and len(system.indices) > DENSE_FILL * system.n**2
            tier = "sparse"
            if system.n <= DENSE_LIMIT or filled:
                tier = "dense"
        elif tier not in EXACT_TIERS:
            raise OptionError(f"tier {tier!r}: {suggest(str(tier), EXACT_TIERS)}", key=("tier",))
        return cls(system, tier, check_backend(backend))

    def __reduce__(self) -> tuple[Any, ...]:
        # Factorisations stay where they are.
        return LineSolver, (self.system, self.tier, self.backend, self.variant)

    @property
    def label(self) -> str:
        """Tells the solvers of a run apart."""
        return f"{self.tier} {self.variant}" if self.variant else self.tier

    @property
    def used(self) -> dict[str, int]:
        """How many sparse solves each backend answered here, by name."""
        out: dict[str, int] = {}
        for kept in self._kept.values():
            for solver in kept:
                if not isinstance(solver, SparseSolver):
                    continue
                for name, number in solver.used.items():
                    out[name] = out.get(name, 0) + number
        return out

    def decaying(self, decay: float) -> LineSolver:
        """Return the solver at i omega + decay, in 1/s, with the patterns that are analysed."""
        if decay == self.system.decay:
            return self
        out = replace(self, system=self.system.decaying(decay))
        out._kept.update(self._kept)
        return out

    def others(self, seen: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the DOFs besides `seen`."""
        return np.setdiff1d(np.arange(self.system.n), seen)

    def coupled(self, dof: int) -> NDArray[np.integer[Any]]:
        """Return the DOFs that one is coupled with, itself included."""
        return self.system.coupled(dof)

    def block_size(self, n_columns: int) -> int:
        """Return how many lines fit into one block of bounded memory."""
        n = self.system.n
        # One sparse matrix is held, whatever the number of lines.
        per_line = 16 * n * n_columns
        if self.tier == "dense":
            per_line = 16 * (n * n + 2 * n * n_columns)
        return max(1, int(_BLOCK_BYTES // max(per_line, 1)))

    def pencil(self, state: State, lines: NDArray[np.float64]) -> Pencil | None:
        """Return what solves many lines of a state at once; None where that does not pay.

        Parameters
        ----------
        state : State
            Of the model.
        lines : ndarray of float, shape (n_f,)
            All lines that are solved at this state, in Hz.
        """
        if self.tier != "dense":
            return None
        kept = self._kept.setdefault(b"pencil", (PencilCache(),))
        return cast("PencilCache", kept[0]).find(self.system, state, lines, self._matrices)

    def solve(
        self,
        coefficients: NDArray[np.complex128],
        columns: NDArray[np.intp],
        freq: NDArray[np.float64],
        pencil: Pencil | None = None,
    ) -> NDArray[np.complex128]:
        """Solve Z X = E at a block of lines, E the columns `columns` of the identity.

        Parameters
        ----------
        coefficients : ndarray of complex, shape (n_terms, n_lines)
            Of Z.
        columns : ndarray of int, shape (r,)
            DOFs that carry a unit force.
        freq : ndarray of float, shape (n_lines,)
            In Hz; without a pencil for messages.
        pencil : Pencil, optional
            Of the state that the coefficients belong to.

        Returns
        -------
        ndarray of complex, shape (N, n_lines, r)
            Motion of every DOF for each unit force, in m/N.

        Raises
        ------
        SolverError
            If Z is singular at a line; the message names it.
        """
        n, r = self.system.n, len(columns)
        B = unit_loads(n, columns)
        if self.tier == "dense":

            def exact(lines: NDArray[np.intp]) -> NDArray[np.complex128]:
                c = coefficients[:, lines]
                Z = self._dense(self.system.values(c))
                loads = np.broadcast_to(B, (len(lines), n, r))
                X = solve_dense(Z, loads, freq[lines], size=self._sizes(c))
                return X.transpose(1, 0, 2)

            return solve_lines(pencil, freq, self.system.decay, B.real, exact)
        solver, Z = self._whole()

        def line(i: int) -> NDArray[np.complex128]:
            self.system.write(coefficients[:, i], Z.data)
            return solver.solve(Z, B, float(freq[i]))

        if len(freq) == 1:
            return line(0)[:, None]  # of a large model: not copied
        out = np.empty((len(freq), r, n), dtype=np.complex128)
        for i in range(len(freq)):
            out[i] = line(i).T
        return out.transpose(2, 0, 1)

    def solve_twice(
        self,
        coefficients: NDArray[np.complex128],
        columns: NDArray[np.intp],
        freq: NDArray[np.float64],
        forces: Callable[[NDArray[np.complex128], slice], NDArray[np.complex128]],
    ) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Solve Z X = E as `solve`, and then Z Y = F(X); sparse, by one factorisation of each line.

        Parameters
        ----------
        coefficients, columns, freq
            As for `solve`.
        forces : callable
            Returns F, shape (N, n, k) in N, for the fields X at n lines, shape (N, n, r), and the
            slice of these lines.

        Returns
        -------
        X : ndarray of complex, shape (N, n_lines, r)
            In m/N.
        Y : ndarray of complex, shape (N, n_lines, k)
            In m.

        Raises
        ------
        SolverError
            If Z is singular at a line; the message names it.
        """
        if self.tier == "dense":
            X = self.solve(coefficients, columns, freq)
            return X, self.forced(coefficients, forces(X, slice(len(freq))), freq)
        solver, Z = self._whole()
        B = unit_loads(self.system.n, columns)
        first, second = [], []
        for i in range(len(freq)):
            self.system.write(coefficients[:, i], Z.data)
            factorised = solver.factorise(Z, float(freq[i]))
            X = factorised.solve(B)[:, None]
            Y = factorised.solve(np.asfortranarray(forces(X, slice(i, i + 1))[:, 0]))
            first.append(X)
            second.append(Y[:, None])
        return np.concatenate(first, axis=1), np.concatenate(second, axis=1)

    def forced(
        self,
        coefficients: NDArray[np.complex128],
        forces: NDArray[np.complex128],
        freq: NDArray[np.float64],
    ) -> NDArray[np.complex128]:
        """Solve Z X = F at a block of lines for forces on all DOFs.

        Parameters
        ----------
        coefficients : ndarray of complex, shape (n_terms, n_lines)
            Of Z.
        forces : ndarray of complex, shape (N, n_lines, r)
            Columns, in N.
        freq : ndarray of float, shape (n_lines,)
            In Hz, for messages.

        Returns
        -------
        ndarray of complex, shape (N, n_lines, r)
            In m.

        Raises
        ------
        SolverError
            If Z is singular at a line; the message names it.
        """
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

    def at(self, fields: NDArray[np.complex128], dofs: NDArray[np.intp]) -> NDArray[np.complex128]:
        """Return the motion at some DOFs from fields that `solve` returned.

        Parameters
        ----------
        fields : ndarray of complex, shape (N, n_lines, r)
            From `solve`.
        dofs : ndarray of int, shape (n,)
            DOFs of the model.

        Returns
        -------
        ndarray of complex, shape (n, n_lines, r)
            In m/N.
        """
        return fields[dofs]

    def condense(
        self,
        coefficients: NDArray[np.complex128],
        retained: NDArray[np.intp],
        freq: NDArray[np.float64],
    ) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Condense Z exactly onto the retained DOFs (Bao, Wang & Cheng 2010, eqs. 8, 9).

        Parameters
        ----------
        coefficients : ndarray of complex, shape (n_terms, n_lines)
            Of Z.
        retained : ndarray of int, shape (n,)
            DOFs to keep, in the order wanted.
        freq : ndarray of float, shape (n_lines,)
            In Hz, for messages.

        Returns
        -------
        Z_red : ndarray of complex, shape (n_lines, n, n)
            Z_nn - Z_ns Z_ss^-1 Z_sn.
        T : ndarray of complex, shape (N, n_lines, n)
            [I; -Z_ss^-1 Z_sn], rows in the order of the model's DOFs.

        Raises
        ------
        SolverError
            If Z_ss is singular at a line: a natural frequency of the structure with its retained
            DOFs held.
        """
        partition, solver = self._partitioned(retained)
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

    def _whole(self) -> tuple[SparseSolver, Any]:
        """Return the solver for all of Z and a matrix to write its values into; both are kept."""
        if b"" not in self._kept:
            self._kept[b""] = (
                SparseSolver(self.backend),
                empty_matrix(self.system.indptr, self.system.indices),
            )
        return cast("tuple[SparseSolver, Any]", self._kept[b""])

    def _partitioned(self, retained: NDArray[np.intp]) -> tuple[Partition, SparseSolver]:
        """Return the blocks for some retained DOFs and the solver for Z_ss; both are kept."""
        key = retained.tobytes()
        if key not in self._kept:
            self._kept[key] = Partition.find(self.system, retained), SparseSolver(self.backend)
        return cast("tuple[Partition, SparseSolver]", self._kept[key])

    def _sizes(self, coefficients: NDArray[np.complex128]) -> NDArray[np.float64]:
        """Return sizes of the diagonal of Z before its terms cancel, shape (n_lines, N)."""
        key = b"diagonals"
        if key not in self._kept:
            diagonals = np.zeros((len(self.system.terms), self.system.n))
            for diagonal, term in zip(diagonals, self.system.terms, strict=True):
                diagonal[term.rows] = np.abs(term.local.diagonal())
            self._kept[key] = (diagonals,)
        (diagonals,) = self._kept[key]
        return np.asarray(np.abs(coefficients).T @ diagonals)

    def _matrices(
        self, weights: StateWeights
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return K, D and M of a state, shape (N, N) each."""
        n, places = self.system.n, self.system.rows_of_entries() * self.system.n
        places += self.system.indices
        K, D, M = np.zeros((3, n * n))
        K[places] = self.system.real_values(weights.stiffness)
        D[places] = self.system.real_values(weights.damping)
        M[places] = self.system.real_values(weights.mass)
        return K.reshape(n, n), D.reshape(n, n), M.reshape(n, n)

    def _dense(self, values: NDArray[Any]) -> NDArray[Any]:
        n = self.system.n
        if len(values) == n * n:
            return values.T.reshape(-1, n, n)
        Z = np.zeros((values.shape[1], n * n), dtype=values.dtype)
        Z[:, self.system.rows_of_entries() * n + self.system.indices] = values.T
        return Z.reshape(-1, n, n)


def unit_loads(n: int, columns: NDArray[np.intp]) -> NDArray[np.complex128]:
    """Return unit forces on some of n DOFs as columns in Fortran order."""
    B = np.zeros((n, len(columns)), dtype=np.complex128, order="F")
    B[columns, np.arange(len(columns))] = 1.0
    return B


def line_blocks(n_lines: int, size: int) -> Iterator[slice]:
    """Yield the lines in blocks of at most `size`, in order."""
    for first in range(0, n_lines, size):
        yield slice(first, min(first + size, n_lines))


def solve_lines(
    pencil: Pencil | None,
    freq: NDArray[np.float64],
    decay: float,
    B: NDArray[np.float64],
    exact: Callable[[NDArray[np.intp]], NDArray[np.complex128]],
) -> NDArray[np.complex128]:
    """Solve a block of lines by the pencil of their state, and line by line what it does not solve.

    Parameters
    ----------
    pencil : Pencil or None
        Of the state; without one every line is solved by itself.
    freq : ndarray of float, shape (n_lines,)
        In Hz.
    decay : float
        Of the data, in 1/s.
    B : ndarray of float, shape (n, r)
        Loads, the same at every line.
    exact : callable
        Solves the lines at some positions of the block by factorisations: it returns fields, shape
        (n, n_positions, r), and says which line is singular.

    Returns
    -------
    ndarray of complex, shape (n, n_lines, r)
    """
    if pencil is None:
        return exact(np.arange(len(freq)))
    s = np.asarray(2j * np.pi * freq + decay, dtype=np.complex128)
    X, accepted = pencil.solve(s**2, B)
    rest = np.flatnonzero(~accepted)
    if len(rest):
        X[:, rest] = exact(rest)
    return X


@alone
def solve_dense(
    Z: NDArray[Any],
    B: NDArray[Any],
    freq: NDArray[np.float64],
    held: str = "",
    *,
    size: NDArray[np.float64] | None = None,
) -> NDArray[np.complex128]:
    """Solve Z X = B at a block of lines with dense matrices, and check that none is singular.

    Parameters
    ----------
    Z : ndarray of complex or float, shape (n_lines, n, n)
        Matrices.
    B : ndarray of complex or float, shape (n_lines, n, r)
        Right-hand sides.
    freq : ndarray of float, shape (n_lines,)
        In Hz, for messages.
    held : str
        Which DOFs are held, for messages.
    size : ndarray of float, shape (n_lines, n), optional
        Sizes of the diagonal entries, by which rows and columns are scaled where they are judged.
        Those of Z where none are given; of a sum, those of its terms do not cancel.

    Returns
    -------
    ndarray of complex, shape (n_lines, n, r)

    Raises
    ------
    SolverError
        If a matrix is singular; the message names the line.
    """
    if size is None:
        size = np.abs(np.einsum("fii->fi", Z))
    n_lines, n, r = B.shape
    loads = np.empty((n_lines, n, r + 1), dtype=np.complex128)
    loads[:, :, :r] = B
    loads[:, :, r:] = probe_load(unit_scale(size))
    try:
        X = _solved(Z, loads)
    except np.linalg.LinAlgError:
        X = np.stack([_solved_or_infinite(z, load) for z, load in zip(Z, loads, strict=True)])
    answer, probe = X[:, :, :r], X[:, :, r:]
    accepted = growth(size, answer, B) <= LARGEST_GROWTH
    accepted &= growth(size, probe, loads[:, :, r:]) <= LARGEST_PROBE_GROWTH
    if not accepted.all():
        first = int(np.argmin(accepted))
        raise SolverError(singular_message(freq[first], held, scale=unit_scale(size[first])))
    return answer


def _solved(Z: NDArray[Any], B: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the solution of Z X = B, in real arithmetic where nothing damps."""
    if np.iscomplexobj(Z) and Z.imag.any():
        return np.asarray(np.linalg.solve(Z, B), dtype=np.complex128)
    # Real and imaginary parts stand side by side, as columns of their own.
    X = np.linalg.solve(Z.real, np.ascontiguousarray(B).view(np.float64))
    return np.ascontiguousarray(X).view(np.complex128)


def _solved_or_infinite(Z: NDArray[Any], B: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the solution of Z X = B at one line, infinite where Z has no inverse."""
    try:
        return _solved(Z, B)
    except np.linalg.LinAlgError:
        return np.full_like(B, np.inf)


@dataclass(frozen=True, slots=True, eq=False)
class Partition:
    """Blocks of Z on one pattern.

    Attributes
    ----------
    retained, eliminated : ndarray of int
        DOFs, n and s of them.
    nn, sn : sparse CSR of int
        Position of each entry of the block among the values of Z.
    ss : sparse CSC of complex
        The block of the line that was asked for last: its pattern is checked once, its memory
        serves every line.
    ss_places : ndarray of int
        Position of each of its entries among the values of Z.
    """

    retained: NDArray[np.intp]
    eliminated: NDArray[np.intp]
    nn: Any
    sn: Any
    ss: Any
    ss_places: NDArray[Any]

    @classmethod
    def find(cls, system: AffineSystem, retained: NDArray[np.intp]) -> Partition:
        """Find the blocks for some retained DOFs, in the order wanted."""
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
            empty_matrix(ss.indptr, ss.indices),
            ss.data,
        )

    def blocks(
        self, values: NDArray[np.complex128]
    ) -> tuple[NDArray[np.complex128], NDArray[np.complex128], Any]:
        """Return Z_nn and Z_sn dense, and Z_ss sparse (CSC), from the values of Z, shape (nnz,)."""
        np.take(values, self.ss_places, out=self.ss.data, mode="clip")
        return _filled(self.nn, values), _filled(self.sn, values), self.ss


def empty_matrix(indptr: NDArray[Any], indices: NDArray[Any]) -> Any:
    """Return a complex CSC array of a symmetric pattern, whose values are to be written.

    Parameters
    ----------
    indptr, indices : ndarray of int
        Of CSR; as the matrix is symmetric they are those of CSC, which factorisations want.
    """
    n = len(indptr) - 1
    return sp.csc_array(
        (np.zeros(len(indices), dtype=np.complex128), indices, indptr), shape=(n, n)
    )


def _filled(places: Any, values: NDArray[np.complex128]) -> NDArray[np.complex128]:
    block = sp.csr_array((values[places.data], places.indices, places.indptr), shape=places.shape)
    return np.asarray(block.toarray())
