"""The least-squares problem at one point, reduced by QR factors without normal equations."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import blas, lapack

from updyn.arrays import RealArray
from updyn.linalg.threads import use_one_thread
from updyn.updating.problem.settings import TRIANGLE

__all__ = [
    "Local",
    "join_locals",
    "qr_triangle",
    "reduce_blocks",
]


@dataclass(frozen=True, slots=True, eq=False)
class Local:
    """Reduced least-squares problem at one point: half the sum of squares, R (k, n), k <= n, and q.

    The gradient is R^T q.
    """

    cost: float
    R: RealArray
    q: RealArray

    @property
    def gradient(self) -> RealArray:
        """Gradient of the cost, shape (n,)."""
        return np.asarray(self.R.T @ self.q)


def reduce_blocks(blocks: Iterable[RealArray], n: int) -> Local:
    """Stack blocks [J r], shape (m, n + 1), by QR in the given order; return the local problem."""
    waiting: list[RealArray] = [np.zeros((0, n + 1))]
    for block in blocks:
        waiting.append(block)
        if len(waiting) > TRIANGLE.stacked_blocks:
            waiting = [_householder(np.vstack(waiting))]
    triangle = _householder(np.vstack(waiting))
    if len(triangle) < n + 1:
        triangle = np.vstack([triangle, np.zeros((n + 1 - len(triangle), n + 1))])
    last = triangle[:, n]
    return Local(0.5 * float(last @ last), triangle[:n, :n].copy(), last[:n].copy())


_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


@use_one_thread
def qr_triangle(columns: RealArray, last: RealArray) -> RealArray:
    """Return R of the QR factors of [columns^T last], shape (min(m, n + 1), n + 1)."""
    if len(last) > TRIANGLE.tall_ratio * (len(columns) + 1) and len(columns):
        found = _triangle_by_cholesky(columns, last)
        if found is not None:
            return found
    return _householder(_copy_rows(columns, last, slice(None)))


def _triangle_by_cholesky(columns: RealArray, last: RealArray) -> RealArray | None:
    """Return R by Cholesky of preconditioned columns, or None if rows differ too much."""
    # R_1 of a sample of the rows makes the columns of A R_1^-1 nearly orthonormal. R_2 of their
    # Gram matrix is then as accurate as by reflections, in less time: R = R_2 R_1 (Garrison &
    # Ipsen, SIAM J. Matrix Anal. Appl. 2024, "A randomized preconditioned Cholesky-QR algorithm").
    n, m = len(columns) + 1, len(last)
    # Spread evenly, and not in step with responses, references or lines.
    some = np.sort((np.arange(TRIANGLE.sample_ratio * n) * _GOLDEN % 1.0 * m).astype(np.intp))
    sample = _householder(_copy_rows(columns, last, some))
    if not np.diag(sample).all():
        return None
    gram = np.zeros((n, n), order="F")
    for first in range(0, m, TRIANGLE.strip_rows):
        strip = _copy_rows(columns, last, slice(first, first + TRIANGLE.strip_rows))
        Q = blas.dtrsm(1.0, sample, strip, side=1, overwrite_b=True)
        gram = blas.dsyrk(1.0, Q, trans=1, beta=1.0, c=gram, overwrite_c=True)
    factor, failed = lapack.dpotrf(gram, clean=1)
    even = np.diag(factor)
    if failed or not even.min() > TRIANGLE.least_diagonal_ratio * even.max():
        return None
    return np.asarray(factor @ sample, dtype=np.float64)


def _copy_rows(columns: RealArray, last: RealArray, rows: Any) -> RealArray:
    """Return a copy of some rows of [columns^T last] in Fortran order."""
    end = last[rows]
    out = np.empty((len(columns) + 1, len(end)))
    out[:-1] = columns[:, rows]
    out[-1] = end
    return out.T


@use_one_thread
def _householder(block: RealArray) -> RealArray:
    """Return R by reflections, shape (min(m, n), n); overwrites a block in Fortran order."""
    if min(block.shape) == 0:
        return block[:0]
    # The recursive algorithm with narrow panels is several times faster for tall blocks than geqrf,
    # which numpy and scipy call.
    factors, _, info = lapack.dgeqrt(
        min(TRIANGLE.panel_columns, *block.shape), np.asfortranarray(block), overwrite_a=True
    )
    assert info == 0
    return np.asarray(np.triu(factors[: block.shape[1]]), dtype=np.float64)


def join_locals(locals_: Sequence[Local], n: int) -> Local:
    """Return the sum of local problems in `n` unknowns as one."""
    if len(locals_) == 1:
        return locals_[0]
    rest = sum(max(local.cost - 0.5 * float(local.q @ local.q), 0.0) for local in locals_)
    whole = reduce_blocks([np.hstack([local.R, local.q[:, None]]) for local in locals_], n)
    return Local(whole.cost + rest, whole.R, whole.q)
