"""Factorisations of K - s M at states of a model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from updyn.arrays import RealArray
from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.settings import BASIS, SHIFTED
from updyn.errors import SolverError
from updyn.linalg.solver import Factorised, SparseSolver

__all__ = ["Shifted"]


@dataclass(slots=True, eq=False)
class Shifted:
    """Real factorisations at states of a model, one at a time; that of P can be kept.

    P = K + omega_max^2 M is definite, and close to K - omega^2 M far from resonance. `top` is
    omega_max^2 in 1/s^2. With `keeps`, P stays in memory for close states, until `release` or the
    next factorisation. `count` is the number of factorisations so far.
    """

    system: AffineSystem
    top: float
    backend: str
    keeps: bool = False
    count: int = field(default=0, init=False)
    _solver: SparseSolver = field(init=False)
    _definite: tuple[Factorised, State] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        single = self.system.n > SHIFTED.double_dofs
        self._solver = SparseSolver(self.backend, real=True, single=single)

    @property
    def solve_counts(self) -> dict[str, int]:
        """Number of sparse solves of each backend, by name."""
        return self._solver.solve_counts

    @property
    def _moves(self) -> list[tuple[float, bool]]:
        """Moves of a shift, in order of use, each with whether single precision is required."""
        moves = [(far, False) for far in SHIFTED.moves]
        if self._solver.single:  # double precision comes last, because it may exceed the memory
            moves = [(far, True) for far in SHIFTED.moves_in_single] + moves
        return moves

    def weights(self, state: State, shift: float) -> RealArray:
        """Return the weight of each term in K - s M."""
        weights = {"stiffness": 1.0, "mass": -shift}
        return np.array([weights.get(t.quantity, 0.0) for t in self.system.terms]) * state.factor

    def matrix(self, state: State, shift: float) -> sp.csc_array:
        """Return K - s M."""
        values = self.system.real_values(self.weights(state, shift))
        # The matrix is symmetric, so its CSR arrays are also the CSC arrays for factorisations.
        return sp.csc_array(
            (values, self.system.indices, self.system.indptr), shape=(self.system.n,) * 2
        )

    def find_dof_scale(self, state: State) -> RealArray:
        """Return the scale of each DOF at a state, the root of the diagonal of P, shape (N,)."""
        diagonal = self.matrix(state, -self.top).diagonal()
        return np.asarray(np.sqrt(np.maximum(diagonal, 1e-16 * diagonal.max())))

    def factorise(
        self,
        state: State,
        shift: float,
        *,
        error: float,
        single_only: bool = False,
    ) -> Factorised:
        """Factorise K - s M (`shift` s in 1/s^2) and release the previous factorisation."""
        self._definite = None
        self.count += 1
        freq = float(np.sqrt(max(shift, 0.0)) / (2.0 * np.pi))
        return self._solver.factorise(
            self.matrix(state, shift), freq, error=error, single_only=single_only
        )

    def solve(
        self, state: State, shift: float, loads: RealArray
    ) -> tuple[float, Factorised, RealArray]:
        """Return s, the factorised K - s M, and solutions for loads (N, k)."""
        # If s is a natural frequency, it is moved away from the middle of the band, which keeps
        # the ends of the band outside.
        away, moves = np.copysign(self.top, shift - 0.5 * self.top), self._moves
        for far, single_only in moves:
            s = float(shift + far * away)
            try:
                factorised = self.factorise(state, s, error=BASIS.new_norm, single_only=single_only)
                return s, factorised, factorised.solve(loads)
            except SolverError:
                if (far, single_only) == moves[-1]:
                    raise
        raise AssertionError

    def count_modes_below(self, state: State, frequency: float) -> int | None:
        """Return the number of modes below a frequency in Hz; None if it cannot be counted."""
        # Sylvester's law of inertia; the frequency must not be a natural frequency.
        try:
            shift = (2.0 * np.pi * frequency) ** 2
            return self.factorise(state, shift, error=BASIS.new_norm).negative
        except SolverError:
            return None
        finally:
            self.release()

    def factor_definite(self, state: State) -> Factorised:
        """Return the factorised P of a state or a close one, valid until the next factorisation."""
        if self._definite is None or not _are_close(state, self._definite[1]):
            definite = self.factorise(state, -self.top, error=SHIFTED.measuring_error)
            self._definite = definite, state
        return self._definite[0]

    def factor_definites(self, states: Sequence[State]) -> Iterator[tuple[Factorised, State]]:
        """Yield states, each with its P or that of a close state."""
        with self.hold():
            for state in states:
                yield self.factor_definite(state), state

    @contextmanager
    def hold(self) -> Iterator[None]:
        """Keep P within the context, and after it only if `keeps` is true."""
        try:
            yield
        finally:
            if not self.keeps:
                self.release()

    def release(self) -> None:
        """Release the memory of factorisations."""
        self._definite = None
        self._solver.release()


def _are_close(state: State, other: State) -> bool:
    """Return whether masses and stiffnesses of two states are close."""
    change = np.abs(state.factor - other.factor)
    return bool((change <= SHIFTED.close_share * np.abs(other.factor)).all())
