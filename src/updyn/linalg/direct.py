"""Factors of one matrix, unchecked: for eigensolvers, which notice wrong solutions themselves."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from updyn.arrays import NumberArray
from updyn.linalg.solver import BACKENDS, Backend, Factors, check_backend
from updyn.linalg.superlu import SuperLU

if TYPE_CHECKING:
    from updyn.group import Matrix

__all__ = ["Direct", "Refactorisation", "factorise"]

_SUPERLU = "superlu"


@dataclass(frozen=True, slots=True, eq=False)
class Direct:
    """Factors of a matrix, with the backend that owns their memory."""

    factors: Factors
    backend: Backend

    @property
    def negative(self) -> int | None:
        """Number of negative eigenvalues of a real matrix (law of inertia); None if unknown."""
        return self.factors.negative

    def solve(self, B: NumberArray) -> NumberArray:
        """Return X of A X = B, shape (n,) or (n, r)."""
        columns = np.asfortranarray(B.reshape(len(B), -1))
        return np.asarray(self.factors(columns)).reshape(B.shape)


class Refactorisation:
    """Factorisation of matrices with one sparsity pattern by the fastest backend that succeeds."""

    def __init__(self, pattern: Matrix) -> None:
        name, self._backend = check_backend(None), None
        if name != _SUPERLU:
            with suppress(RuntimeError):  # such as a pattern without its diagonal
                self._backend = BACKENDS[name](pattern, real=not np.iscomplexobj(pattern))

    def factor(self, A: Matrix) -> Direct:
        """Return the factors of A, valid until the next call; RuntimeError if exactly singular."""
        if self._backend is not None:
            with suppress(RuntimeError):  # it may be nearly singular
                return Direct(self._backend.factor(A), self._backend)
        # Pivots on the diagonal count the negative eigenvalues.
        superlu = SuperLU(A, pivot_threshold=0.0)
        return Direct(superlu.factor(A), superlu)


def factorise(A: Matrix) -> Direct:
    """Return the factors by the fastest backend that succeeds; RuntimeError if exactly singular."""
    A = sp.csc_array(A)
    A.sort_indices()
    return Refactorisation(A).factor(A)
