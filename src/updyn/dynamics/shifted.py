"""Factorisations of K - s M of a model's states."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from updyn.dynamics.affine import AffineSystem, State
from updyn.errors import SolverError
from updyn.linalg.solver import Factorised, SparseSolver

__all__ = ["Shifted"]

_Real = NDArray[np.float64]

#: States of which no mass and no stiffness differs by more than this share are beside each other.
_CLOSE = 0.1
#: In single precision: relative errors of answers that span a basis, whose rounding would be taken
#: for more of it (`basis._NEW`), and of those that measure what it lacks.
_SPANNING, _MEASURING = 1e-9, 1e-5
#: DOFs from which factors are made in single precision, as they may not fit into memory otherwise.
#: The steps of refinement take as long as is gained.
_HUGE = 400_000
#: How far shifts on a natural frequency are moved, in squares of the highest frequency; and in
#: single precision, which says less the nearer they are.
_NUDGES, _NUDGES_IN_SINGLE = (0.0, 1e-4, 1e-3), (0.0, 3e-3, 1e-2)


@dataclass(slots=True, eq=False)
class Shifted:
    """Real factorisations of a model's states, one alive at a time; that of P may be kept.

    P = K + omega_max^2 M is definite, and close to K - omega^2 M far from resonance.

    Parameters
    ----------
    system : AffineSystem
        The compiled model.
    top : float
        omega_max^2, of the highest line, in 1/s^2.
    backend : str
        Sparse factorisation.
    keeps : bool
        Whether P stays in memory for states beside its own, until `release` or the next one.

    Attributes
    ----------
    count : int
        Factorisations so far.
    """

    system: AffineSystem
    top: float
    backend: str
    keeps: bool = False
    count: int = field(default=0, init=False)
    _solver: SparseSolver = field(init=False)
    _definite: tuple[Factorised, State] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        single = self.system.n > _HUGE
        self._solver = SparseSolver(self.backend, real=True, single=single)

    @property
    def used(self) -> dict[str, int]:
        """How many sparse solves each backend answered, by name."""
        return self._solver.used

    @property
    def _moves(self) -> list[tuple[float, bool]]:
        """How far a shift is moved, in turn, and whether single precision alone has to do there."""
        moves = [(far, False) for far in _NUDGES]
        if self._solver.single:  # double precision, for which there may be no memory, comes last
            moves = [(far, True) for far in _NUDGES_IN_SINGLE] + moves
        return moves

    def weights(self, state: State, shift: float) -> _Real:
        """Return the weight of each term in K - s M."""
        weights = {"stiffness": 1.0, "mass": -shift}
        return np.array([weights.get(t.quantity, 0.0) for t in self.system.terms]) * state.factor

    def matrix(self, state: State, shift: float) -> Any:
        """Return K - s M."""
        values = self.system.real_values(self.weights(state, shift))
        # Symmetric: the CSR arrays are those of CSC, which factorisations want.
        return sp.csc_array(
            (values, self.system.indices, self.system.indptr), shape=(self.system.n,) * 2
        )

    def factorise(
        self,
        state: State,
        shift: float,
        *,
        error: float = _SPANNING,
        single_only: bool = False,
    ) -> Factorised:
        """Factorise K - s M; what was factorised before ends.

        Parameters
        ----------
        state : State
            Of the model.
        shift : float
            s in 1/s^2.
        error : float
            Relative error that answers may have in single precision.
        single_only : bool
            Whether double precision does not take over where that is too far off.

        Raises
        ------
        SolverError
            If it is singular, or memory is short, or single precision alone is too far off.
        """
        self._definite = None
        self.count += 1
        freq = float(np.sqrt(max(shift, 0.0)) / (2.0 * np.pi))
        return self._solver.factorise(
            self.matrix(state, shift), freq, error=error, single_only=single_only
        )

    def solve(self, state: State, shift: float, loads: _Real) -> tuple[float, Factorised, _Real]:
        """Factorise K - s M and solve for loads, shape (N, k); s off a natural frequency.

        Where it is on one, s is moved away from the middle of the band, so that the ends stay out.

        Returns
        -------
        shift : float
            s, where it has been moved to.
        factorised : Factorised
            K - s M.
        X : ndarray of float, shape (N, k)
            The answers.

        Raises
        ------
        SolverError
            As `factorise`.
        """
        away, moves = np.copysign(self.top, shift - 0.5 * self.top), self._moves
        for far, single_only in moves:
            s = float(shift + far * away)
            try:
                factorised = self.factorise(state, s, single_only=single_only)
                return s, factorised, factorised.solve(loads)
            except SolverError:
                if (far, single_only) == moves[-1]:
                    raise
        raise AssertionError

    def below(self, state: State, frequency: float) -> int | None:
        """Return how many modes lie below a frequency in Hz, by Sylvester's law of inertia.

        None where the backend does not count, or the frequency is a natural one.
        """
        try:
            return self.factorise(state, (2.0 * np.pi * frequency) ** 2).negative
        except SolverError:
            return None
        finally:
            self.release()

    def definite(self, state: State) -> Factorised:
        """Return P of a state, factorised, or of a state beside it if at hand.

        It holds until the next factorisation, or `release`.

        Raises
        ------
        SolverError
            If it is not definite.
        """
        if self._definite is None or not _are_close(state, self._definite[1]):
            self._definite = self.factorise(state, -self.top, error=_MEASURING), state
        return self._definite[0]

    def definites(self, states: Sequence[State]) -> Iterator[tuple[Factorised, State]]:
        """Yield states with P of each, or of one beside it."""
        with self.kept():
            for state in states:
                yield self.definite(state), state

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Keep P while it is worked with, and longer only if it is to be kept."""
        try:
            yield
        finally:
            if not self.keeps:
                self.release()

    def release(self) -> None:
        """Give the memory of factorisations back."""
        self._definite = None
        self._solver.release()


def _are_close(state: State, other: State) -> bool:
    """Whether masses and stiffnesses of two states are alike."""
    change = np.abs(state.factor - other.factor)
    return bool((change <= _CLOSE * np.abs(other.factor)).all())
