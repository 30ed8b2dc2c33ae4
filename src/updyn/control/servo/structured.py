"""Upper bound of the structured singular value of complex blocks, by scaling.

mu(M) is 1 / (the smallest norm of a Delta = diag(Delta_1, ..., Delta_m) that makes I - M Delta
singular) (J. C. Doyle, IEE Proc. D 129 (1982) 242-250). For every D = diag(d_i I),

    rho(M) <= mu(M) <= largest singular value of D M D^-1,

and the least upper bound equals mu for up to three full blocks. The iteration starts with equal
norms of row and column of each block (E. E. Osborne, J. ACM 7 (1960) 338-345), which is optimal for
rank one; otherwise it minimises a norm of the singular values, convex in log d. The bound holds for
any D.
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
#: Powers of the singular values whose sum is minimised, in sequence.
_POWERS = (4.0, 32.0, 256.0)
#: Largest slope of the bound in log d that counts as 0.
_FLAT = 1e-6
#: Largest |log d| of a block.
_LARGEST = 40.0


def upper_bound(M: _Complex, sizes: Sequence[int]) -> float:
    """Return an upper bound of mu of one finite matrix; `sizes` are those of its complex blocks."""
    (scales,) = _osborne_scales(M[None], sizes)
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
    """Return the largest upper bound over a stack of matrices, shape (m, n, n), and its index."""
    scale = np.repeat(np.exp(_osborne_scales(M, sizes)), sizes, axis=1)
    rough = np.linalg.norm(scale[:, :, None] * M / scale[:, None, :], 2, axis=(1, 2))
    best, at = -np.inf, 0
    for k in np.argsort(-rough, kind="stable"):
        if rough[k] <= best:  # the remaining ones are smaller
            break
        bound = upper_bound(M[k], sizes)
        if bound > best:
            best, at = bound, int(k)
    return best, at


def _osborne_scales(M: _Complex, sizes: Sequence[int]) -> _Real:
    """Return log d of each matrix by Osborne's iteration, shape (m, number of blocks)."""
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
    """Return log of a norm of the singular values of D M D^-1, and its gradient in log d.

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
    contributions = np.abs(U) ** 2 @ share - (np.abs(Vh) ** 2).T @ share
    slope = np.bincount(block, weights=contributions, minlength=len(scales))
    return float(value), np.asarray(slope, dtype=np.float64)
