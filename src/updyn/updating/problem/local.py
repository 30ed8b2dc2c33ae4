"""The least-squares problem at one point, reduced by QR factors without normal equations."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, lapack

from updyn.linalg.threads import alone

__all__ = [
    "Local",
    "joined",
    "qr_triangle",
    "reduce",
]

_Vector = NDArray[np.float64]
_Matrix = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Local:
    """The least-squares problem at one point.

    Attributes
    ----------
    cost : float
        Half the sum of squared residuals.
    R : ndarray of float, shape (k, n)
        Reduced Jacobian, k <= n.
    q : ndarray of float, shape (k,)
        Reduced residual: the gradient is R^T q.
    """

    cost: float
    R: NDArray[np.float64]
    q: _Vector

    @property
    def gradient(self) -> _Vector:
        """Gradient of the cost, shape (n,)."""
        return np.asarray(self.R.T @ self.q)


#: Columns of a panel of the QR factorisation.
_PANEL = 16
#: Blocks that are stacked at a time.
_TOGETHER = 8


def reduce(blocks: Iterable[_Matrix], n: int) -> Local:
    """Stack blocks [J r], shape (m, n + 1), by QR in the order given, and return the local problem.

    Parameters
    ----------
    blocks : iterable of ndarray of float
        Weighted Jacobian with the residual as last column, or a triangle that stands for it.
    n : int
        Number of unknowns.
    """
    waiting: list[_Matrix] = [np.zeros((0, n + 1))]
    for block in blocks:
        waiting.append(block)
        if len(waiting) > _TOGETHER:
            waiting = [_householder(np.vstack(waiting))]
    triangle = _householder(np.vstack(waiting))
    if len(triangle) < n + 1:
        triangle = np.vstack([triangle, np.zeros((n + 1 - len(triangle), n + 1))])
    last = triangle[:, n]
    return Local(0.5 * float(last @ last), triangle[:n, :n].copy(), last[:n].copy())


#: Rows of a tall block, and of a sample of it, over its columns: the sample shows how the columns
#: depend on each other.
_TALL, _SAMPLE = 20, 4
#: Rows that are worked on at a time: they stay in the processor's cache.
_STRIP = 2048
#: Smallest diagonal entry over the largest of the factor of preconditioned columns. Their condition
#: is about its reciprocal; the square of that times the unit roundoff is the relative error of
#: every singular value.
_EVEN = 0.03
_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


@alone
def qr_triangle(columns: _Matrix, last: _Vector) -> _Matrix:
    """Return R of the QR factors of a block that is usually tall, shape (min(m, n + 1), n + 1).

    Parameters
    ----------
    columns : ndarray of float, shape (n, m)
        The first n columns, one after the other in memory.
    last : ndarray of float, shape (m,)
        The last column.
    """
    if len(last) > _TALL * (len(columns) + 1) and len(columns):
        found = _preconditioned(columns, last)
        if found is not None:
            return found
    return _householder(_rows_of(columns, last, slice(None)))


def _preconditioned(columns: _Matrix, last: _Vector) -> _Matrix | None:
    """Return R by Cholesky of preconditioned columns, or None where rows differ too much.

    R_1 of a sample of the rows makes the columns of A R_1^-1 nearly orthonormal, so that R_2 of
    their Gram matrix is as exact as by reflections: R = R_2 R_1 (Garrison & Ipsen, SIAM J. Matrix
    Anal. Appl. 2024, "A randomized preconditioned Cholesky-QR algorithm"), in less time.
    """
    n, m = len(columns) + 1, len(last)
    # Evenly spread, and out of step with responses, references and lines.
    some = np.sort((np.arange(_SAMPLE * n) * _GOLDEN % 1.0 * m).astype(np.intp))
    sample = _householder(_rows_of(columns, last, some))
    if not np.diag(sample).all():
        return None
    gram = np.zeros((n, n), order="F")
    for first in range(0, m, _STRIP):
        strip = _rows_of(columns, last, slice(first, first + _STRIP))
        Q = blas.dtrsm(1.0, sample, strip, side=1, overwrite_b=True)
        gram = blas.dsyrk(1.0, Q, trans=1, beta=1.0, c=gram, overwrite_c=True)
    factor, failed = lapack.dpotrf(gram, clean=1)
    even = np.diag(factor)
    if failed or not even.min() > _EVEN * even.max():
        return None
    return np.asarray(factor @ sample, dtype=np.float64)


def _rows_of(columns: _Matrix, last: _Vector, rows: Any) -> _Matrix:
    """Return a copy of some rows of [columns^T last] in Fortran order."""
    end = last[rows]
    out = np.empty((len(columns) + 1, len(end)))
    out[:-1] = columns[:, rows]
    out[-1] = end
    return out.T


@alone
def _householder(block: _Matrix) -> _Matrix:
    """Return R by reflections, shape (min(m, n), n); overwrites a block in Fortran order."""
    if min(block.shape) == 0:
        return block[:0]
    # Recursive within narrow panels: for tall blocks several times faster than geqrf, which numpy
    # and scipy call.
    factors, _, info = lapack.dgeqrt(
        min(_PANEL, *block.shape), np.asfortranarray(block), overwrite_a=True
    )
    assert info == 0
    return np.asarray(np.triu(factors[: block.shape[1]]), dtype=np.float64)


def joined(locals_: Sequence[Local], n: int) -> Local:
    """Return the sum of local problems in `n` unknowns as one."""
    if len(locals_) == 1:
        return locals_[0]
    rest = sum(max(local.cost - 0.5 * float(local.q @ local.q), 0.0) for local in locals_)
    whole = reduce([np.hstack([local.R, local.q[:, None]]) for local in locals_], n)
    return Local(whole.cost + rest, whole.R, whole.q)
