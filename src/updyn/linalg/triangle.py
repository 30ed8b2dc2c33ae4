"""The upper triangle of a symmetric sparse matrix, as solvers store it."""

from __future__ import annotations

import numpy as np

from updyn.arrays import BoolArray, IntArray, NumberArray
from updyn.linalg.settings import SPARSE_SOLVER

__all__ = ["upper_triangle"]


def upper_triangle(indptr: NumberArray, indices: NumberArray) -> tuple[BoolArray, IntArray]:
    """Return the upper-triangle mask of a symmetric CSC pattern, and its CSR row pointers."""
    # CSC of a symmetric matrix is its CSR: rows of the upper triangle are columns of the lower
    # one.
    n = len(indptr) - 1
    kept = np.empty(len(indices), dtype=np.bool_)
    begin = np.zeros(n + 1, dtype=np.int64)
    for first in range(0, n, SPARSE_SOLVER.entries_per_step):
        last = min(first + SPARSE_SOLVER.entries_per_step, n)
        part = slice(indptr[first], indptr[last])
        column = np.repeat(np.arange(first, last), np.diff(indptr[first : last + 1]))
        kept[part] = indices[part] >= column
        begin[first + 1 : last + 1] = np.bincount(
            column[kept[part]] - first, minlength=last - first
        )
    return kept, np.cumsum(begin)
