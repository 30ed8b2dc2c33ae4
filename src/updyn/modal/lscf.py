"""Poles of FRFs by the polyreference least-squares complex frequency method, order by order.

P. Guillaume, P. Verboven, S. Vanlanduit, H. Van der Auweraer & B. Peeters, "A poly-reference
implementation of the least-squares complex frequency-domain estimator", Proc. IMAC XXI (2003); B.
Peeters, H. Van der Auweraer, P. Guillaume & J. Leuridan, Shock Vib. 11 (2004) 395-409. The
coefficient of the denominator that is set to one is that for which poles of noise are unstable (B.
Cauberghe, P. Guillaume, P. Verboven, S. Vanlanduit & E. Parloo, Proc. SEM X (2004), on clear
stabilisation diagrams).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from updyn.arrays import ComplexArray, RealArray
from updyn.modal.settings import STABILISATION

__all__ = ["fit_orders"]


def fit_orders(omega: RealArray, Y: ComplexArray, orders: Iterable[int]) -> Iterator[ComplexArray]:
    """Yield the stable poles s in rad/s within the band for fits of increasing order."""
    # Right matrix fraction Y(omega) = B(omega) A(omega)^-1, Y of shape (n_f, n_o, n_r), in powers
    # of z = exp(-i (omega - omega_1) T), with the band on half of the circle; numerators are
    # eliminated from the normal equations (Peeters et al. 2004, equations 10-17). Each order has
    # n_r poles, counting both of a conjugate pair.
    orders = list(orders)
    n_r, largest = Y.shape[2], max(orders)
    step = np.pi / (omega[-1] - omega[0])
    powers = np.exp(-1j * step * np.outer(omega - omega[0], np.arange(largest + 1)))
    level = np.mean(np.abs(Y) ** 2, axis=(1, 2))
    weight = 1.0 / np.sqrt(level + 1e-12 * level.max())
    scaled = Y * weight[:, None, None]
    products = np.matmul(scaled.conj().swapaxes(1, 2), scaled).reshape(len(omega), -1)
    moments = (powers.T @ np.hstack([(weight**2)[:, None], products])).T
    crossed = (powers.T @ (weight[:, None, None] * scaled).reshape(len(omega), -1)).T
    back = (powers.conj().T @ (weight[:, None, None] * scaled).reshape(len(omega), -1)).T
    lag = np.arange(largest + 1)[None, :] - np.arange(largest + 1)[:, None]
    R = moments[0].real[np.abs(lag)]
    T = _toeplitz(moments[1:].reshape(n_r, n_r, -1), products, powers, lag)
    S = np.where(lag >= 0, crossed[:, np.abs(lag)], back[:, np.abs(lag)]).real
    S = -S.reshape(-1, n_r, *lag.shape).transpose(0, 2, 3, 1)  # (n_o, row, column, reference)
    for n in orders:
        size = n + 1
        cross = S[:, :size, :size].reshape(len(S), size, size * n_r)
        moments_matrix = T[:size, :size].transpose(0, 2, 1, 3).reshape(size * n_r, size * n_r)
        values, vectors = np.linalg.eigh(R[:size, :size])
        kept = values > size * np.finfo(float).eps * values[-1]
        half = (vectors[:, kept] / np.sqrt(values[kept])).T  # half^T half is the inverse of R
        numerators = np.matmul(half, cross).reshape(-1, size * n_r)
        M = moments_matrix - numerators.T @ numerators
        yield _find_roots(M, n, n_r, step, omega)


def _toeplitz(
    moments: ComplexArray, products: ComplexArray, powers: ComplexArray, lag: NDArray[np.int_]
) -> RealArray:
    n_r = len(moments)
    back = (powers.conj().T @ products).T.reshape(n_r, n_r, -1)
    blocks = np.where(lag >= 0, moments[:, :, np.abs(lag)], back[:, :, np.abs(lag)]).real
    return np.ascontiguousarray(blocks.transpose(2, 3, 0, 1))  # (row, column, a, b)


def _find_roots(M: RealArray, n: int, n_r: int, step: float, omega: RealArray) -> ComplexArray:
    """Return stable poles in the band; the last coefficient is one, the others solve M."""
    below = np.linalg.lstsq(M[:-n_r, :-n_r], M[:-n_r, -n_r:], rcond=None)[0]
    companion = np.zeros((n * n_r, n * n_r))
    companion[:n_r] = np.hstack(list(below.reshape(n, n_r, n_r).transpose(0, 2, 1)[::-1]))
    companion[n_r:, :-n_r] = np.eye((n - 1) * n_r)
    z = np.linalg.eigvals(companion)
    with np.errstate(divide="ignore", invalid="ignore"):
        s = -np.log(z) / step
    inside = np.isfinite(s) & (s.imag > 0.0) & (s.imag < np.pi / step)
    s = s[inside] + 1j * omega[0]
    s = s[s.real < STABILISATION.unstable_share * np.abs(s)]
    return np.asarray(-np.abs(s.real) + 1j * s.imag)
