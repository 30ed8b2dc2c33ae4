"""Factors of one matrix, unchecked: for eigensolvers, which notice wrong solutions themselves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from updyn.arrays import NumberArray
from updyn.linalg.solver import BACKENDS, Backend, Factors, check_backend

if TYPE_CHECKING:
    from scipy.sparse.linalg import SuperLU as Decomposition

    from updyn.group import Matrix

__all__ = ["factorise"]

_SUPERLU = "superlu"


@dataclass(frozen=True, slots=True, eq=False)
class Direct:
    """Factors of a matrix, with the backend that owns them."""

    solve_columns: Callable[[NumberArray], NumberArray]
    #: Number of negative eigenvalues of a real matrix (law of inertia); None if unknown.
    negative: int | None
    backend: Backend | None = None

    def solve(self, B: NumberArray) -> NumberArray:
        """Return X of A X = B, shape (n,) or (n, r)."""
        columns = np.asfortranarray(B.reshape(len(B), -1))
        return np.asarray(self.solve_columns(columns)).reshape(B.shape)


def factorise(A: Matrix) -> Direct:
    """Return the factors of a symmetric matrix by the fastest backend that succeeds.

    Raises RuntimeError if the matrix is exactly singular.
    """
    A = sp.csc_array(A)
    A.sort_indices()
    name = check_backend(None)
    if name != _SUPERLU:
        try:
            backend = BACKENDS[name](A, real=not np.iscomplexobj(A))
            factors: Factors = backend.factor(A)
            return Direct(factors, factors.negative, backend)
        except RuntimeError:  # it may be nearly singular
            pass
    return _factorise_by_superlu(A)


def _factorise_by_superlu(A: sp.csc_array) -> Direct:
    """Return factors with pivots on the diagonal, which count the negative eigenvalues."""
    from scipy.sparse.linalg import splu

    lu: Decomposition = splu(
        A,
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    negative = None
    if np.array_equal(lu.perm_r, lu.perm_c) and not np.iscomplexobj(A):
        negative = int((lu.U.diagonal() < 0).sum())
    return Direct(lu.solve, negative)
