"""The least-squares problem at one point, reduced by QR factors without normal equations."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from updyn.linalg.threads import alone

__all__ = [
    "Local",
    "joined",
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
            waiting = [qr_triangle(np.vstack(waiting))]
    triangle = qr_triangle(np.vstack(waiting))
    if len(triangle) < n + 1:
        triangle = np.vstack([triangle, np.zeros((n + 1 - len(triangle), n + 1))])
    last = triangle[:, n]
    return Local(0.5 * float(last @ last), triangle[:n, :n].copy(), last[:n].copy())


@alone
def qr_triangle(block: _Matrix) -> _Matrix:
    """Return R of the QR factors, shape (min(m, n), n); overwrites a block in Fortran order."""
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
