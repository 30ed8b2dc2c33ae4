"""Upper bound of the structured singular value of complex blocks, by scaling.

mu(M) is 1 / (the least largest singular value of a Delta = diag(Delta_1, ..., Delta_m) that makes
I - M Delta singular), 0 where none does (J. C. Doyle, IEE Proc. D 129 (1982) 242-250). For every
D = diag(d_i I) that commutes with Delta,

    rho(M) <= mu(M) <= largest singular value of D M D^-1,

and the least upper bound is mu itself for up to three full blocks; for one block it is the largest
singular value, for M = a b^T and scalar blocks sum |a_i b_i|. log d_i begins where the norms of row
and column of each block agree (E. E. Osborne, J. ACM 7 (1960) 338-345), which is the least already
where M has rank one; elsewhere a norm of the singular values that approaches the largest one is
minimised, which is convex in log d. Whatever D is found, the bound holds.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

__all__ = ["largest_bound", "upper_bound"]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]

#: Rounds of Osborne's scaling.
_ROUNDS = 60
#: Powers of the singular values whose sum is minimised, one after the other.
_POWERS = (4.0, 32.0, 256.0)
#: A slope of the bound by log d below this is none.
_FLAT = 1e-6
#: Largest scale of a block, as a logarithm.
_LARGEST = 40.0


def upper_bound(M: _Complex, sizes: Sequence[int]) -> float:
    """Return an upper bound of mu of one matrix.

    Parameters
    ----------
    M : ndarray of complex, shape (n, n)
        Finite.
    sizes : sequence of int
        Size of each full complex block, in their order; 1 of a scalar. They sum to n.
    """
    (scales,) = _balanced(M[None], sizes)
    block = np.repeat(np.arange(len(sizes)), sizes)
    best, slope = _value(M, scales, block, np.inf)
    if np.abs(slope).max(initial=0.0) <= _FLAT:
        return float(np.exp(best))
    for power in _POWERS:
        found = minimize(
            lambda x, power=power: _value(M, x, block, power),
            scales,
            jac=True,
            bounds=[(-_LARGEST, _LARGEST)] * len(sizes),
        )
        scales = found.x
        best = min(best, _value(M, scales, block, np.inf)[0])
    return float(np.exp(best))


def largest_bound(M: _Complex, sizes: Sequence[int]) -> tuple[float, int]:
    """Return the largest upper bound over a stack of matrices, and its position.

    Parameters
    ----------
    M : ndarray of complex, shape (m, n, n)
        Finite.
    sizes : sequence of int
        As for `upper_bound`.
    """
    scale = np.repeat(np.exp(_balanced(M, sizes)), sizes, axis=1)
    rough = np.linalg.norm(scale[:, :, None] * M / scale[:, None, :], 2, axis=(1, 2))
    best, at = -np.inf, 0
    for k in np.argsort(-rough, kind="stable"):
        if rough[k] <= best:  # no other one can be larger
            break
        own = upper_bound(M[k], sizes)
        if own > best:
            best, at = own, int(k)
    return best, at


def _balanced(M: _Complex, sizes: Sequence[int]) -> _Real:
    """Return log d of each matrix of a stack, shape (m, number of blocks), by Osborne's rounds."""
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    size = np.add.reduceat(np.add.reduceat(np.abs(M) ** 2, starts, axis=1), starts, axis=2)
    k = np.arange(len(sizes))
    size[:, k, k] = 0.0
    scales = np.zeros((len(M), len(sizes)))
    for _ in range(_ROUNDS):
        for i in k:
            weight = np.exp(2.0 * (scales[:, [i]] - scales))
            row, column = (size[:, i] * weight).sum(axis=1), (size[:, :, i] / weight).sum(axis=1)
            known = (row > 0.0) & (column > 0.0)
            scales[known, i] += 0.25 * np.log(column[known] / row[known])
        scales = np.clip(scales - scales[:, :1], -_LARGEST, _LARGEST)
    return scales


def _value(
    M: _Complex, scales: _Real, block: NDArray[np.intp], power: float
) -> tuple[float, _Real]:
    """Return log of a norm of the singular values of D M D^-1, and its slope by log d.

    The norm is the 2 `power`-th root of the mean of sigma^(2 power), or the largest sigma.
    """
    d = np.exp(scales)[block]
    U, sigma, Vh = np.linalg.svd(d[:, None] * M / d)
    largest = max(float(sigma[0]), 1e-300)
    share = (sigma == sigma[0]).astype(np.float64)
    if np.isfinite(power):
        share = (sigma / largest) ** (2.0 * power)
    value = np.log(largest)
    if np.isfinite(power):
        value += np.log(share.mean()) / (2.0 * power)
    share = share / share.sum()
    own = np.abs(U) ** 2 @ share - (np.abs(Vh) ** 2).T @ share
    slope = np.bincount(block, weights=own, minlength=len(scales))
    return float(value), np.asarray(slope, dtype=np.float64)
