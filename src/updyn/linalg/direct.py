"""Factors of one matrix, unchecked: for eigensolvers, which notice wrong solutions themselves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from updyn.arrays import NumberArray
from updyn.linalg.solver import BACKENDS, Backend, Factors, check_backend
from updyn.linalg.superlu import SuperLU

if TYPE_CHECKING:
    from updyn.group import Matrix

__all__ = ["factorise"]

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


def factorise(A: Matrix) -> Direct:
    """Return the factors by the fastest backend that succeeds; RuntimeError if exactly singular."""
    A = sp.csc_array(A)
    A.sort_indices()
    name = check_backend(None)
    if name != _SUPERLU:
        try:
            backend = BACKENDS[name](A, real=not np.iscomplexobj(A))
            return Direct(backend.factor(A), backend)
        except RuntimeError:  # it may be nearly singular
            pass
    # Pivots on the diagonal count the negative eigenvalues.
    superlu = SuperLU(A, pivot_threshold=0.0)
    return Direct(superlu.factor(A), superlu)
