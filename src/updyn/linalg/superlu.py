"""SuperLU, which is part of scipy and always available."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from updyn.arrays import NumberArray
from updyn.linalg.single import round_to_single, solve_scaled

if TYPE_CHECKING:
    from scipy.sparse import csc_array
    from scipy.sparse.linalg import SuperLU as Decomposition

__all__ = ["SuperLU"]


class SuperLU:
    """Sparse LU with an ordering for symmetric patterns; every matrix is analysed again."""

    install = "pip install scipy"
    has_single = True

    @staticmethod
    def available() -> bool:
        """Return True, as scipy contains SuperLU."""
        return True

    def __init__(
        self,
        pattern: csc_array,
        *,
        real: bool = False,
        single: bool = False,
        pivot_threshold: float = 0.001,
    ) -> None:
        del pattern, real
        self._single = single
        self._pivot_threshold = pivot_threshold

    @property
    def peak_bytes(self) -> None:
        """None, as SuperLU does not report it."""

    def factor(self, A: csc_array) -> _LU:
        """Return the factors of a matrix.

        Raises RuntimeError if A is exactly singular or a value is beyond the range of the
        precision.
        """
        from scipy.sparse.linalg import splu

        if self._single:
            with np.errstate(over="ignore"):
                A = A.astype(np.float32)
            round_to_single(A.data)
        # Minimum degree on A + A^T with nearly diagonal pivots: 1.6 times faster than the default
        # ordering on solids.
        return _LU(
            splu(
                A,
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=self._pivot_threshold,
                options={"SymmetricMode": True},
            ),
            self._single,
        )

    def release(self) -> None:
        """Do nothing, as the result of `factor` owns the memory."""


@dataclass(frozen=True, slots=True, eq=False)
class _LU:
    lu: Decomposition
    is_single: bool

    @property
    def negative(self) -> int | None:
        """Number of negative eigenvalues of a real matrix; None after off-diagonal pivoting."""
        if not np.array_equal(self.lu.perm_r, self.lu.perm_c):
            return None
        pivots = self.lu.U.diagonal()
        if np.iscomplexobj(pivots):
            return None
        return int((pivots < 0).sum())

    def __call__(self, B: NumberArray) -> NumberArray:
        if self.is_single:
            return solve_scaled(self.lu.solve, B)
        return np.asarray(self.lu.solve(B))
