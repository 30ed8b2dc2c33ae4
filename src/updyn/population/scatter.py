"""`estimate_scatter`: mean and covariance of quantities over specimens, apart from their noise.

The estimate of specimen i is x_i = mu + b_i + e_i, with the deviation b_i ~ N(0, S) of the specimen
and the error e_i ~ N(0, C_i) of its estimate, C_i known. The restricted likelihood of S is
maximised (Patterson & Thompson, Biometrika 58 (1971) 545; for estimates with known errors Jackson,
White & Thompson, Stat. Med. 29 (2010) 1282). Errors enter by their inverse, the information
L_i = C_i^-1, which is singular for combinations that a specimen does not determine:

    W_i = (S + C_i)^-1 = (1 + L_i S)^-1 L_i,
    V = (sum W_i)^-1,    mu = V sum W_i x_i,    r_i = x_i - mu,
    -2 log l = sum log det(1 + L_i S) + log det(V^-1) + sum r_i^T W_i r_i.

Its derivative by S is G = sum W_i - W_i r_i r_i^T W_i - W_i V W_i, and 2 G B by a factor B of S = B
B^T, which is the variable of the search, so that S is never indefinite. The deviation of a specimen
is predicted by b_i = S W_i r_i (Robinson, Stat. Sci. 6 (1991) 15).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.optimize
from scipy.special import chdtrc

from updyn.arrays import RealArray
from updyn.population.settings import SCATTER

__all__ = ["Scatter", "estimate_scatter"]


@dataclass(frozen=True, slots=True, eq=False)
class Scatter:
    """Mean and covariance of n quantities over m specimens.

    `mean`, shape (n,), with `mean_covariance`; `covariance` of the specimens, shape (n, n);
    `values`, shape (m, n), of each specimen, with `value_covariance`, shape (m, n, n). `p_value` is
    the probability of differences at least as large if all specimens were equal.
    """

    mean: RealArray
    mean_covariance: RealArray
    covariance: RealArray
    values: RealArray
    value_covariance: RealArray
    p_value: float


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Mean, weights and criterion at one covariance S."""

    S: RealArray
    W: RealArray
    V: RealArray
    mean: RealArray
    residual: RealArray
    criterion: float
    gradient: RealArray


def estimate_scatter(x: RealArray, information: RealArray, *, is_full: bool) -> Scatter:
    """Return mean and covariance of quantities over specimens.

    Parameters
    ----------
    x : ndarray of float, shape (m, n)
        Estimates of the specimens.
    information : ndarray of float, shape (m, n, n)
        Inverse covariance of each, singular if a combination is not determined. Their sum is not.
    is_full : bool
        Whether correlations over specimens are estimated; otherwise variances only.
    """
    scale = _scale(x, information)
    x, information = x / scale, information * scale * scale[:, None]
    n = x.shape[1]
    lower = np.tril_indices(n) if is_full else np.diag_indices(n)

    def evaluate(b: RealArray) -> tuple[float, RealArray]:
        B = np.zeros((n, n))
        B[lower] = b
        fit = _fit(x, information, B @ B.T)
        return fit.criterion, 2.0 * (fit.gradient @ B)[lower]

    start = SCATTER.start * np.eye(n)[lower]
    found = scipy.optimize.minimize(
        evaluate, start, jac=True, method="BFGS", options={"gtol": SCATTER.gradient}
    )
    B = np.zeros((n, n))
    B[lower] = found.x
    fit, equal = _fit(x, information, B @ B.T), _fit(x, information, np.zeros((n, n)))
    both = scale * scale[:, None]
    gain = fit.S @ fit.W
    rest = np.eye(n) - gain
    deviations = np.einsum("mij,mj->mi", gain, fit.residual)
    value_covariance = fit.S - gain @ fit.S + rest @ fit.V @ rest.swapaxes(1, 2)
    return Scatter(
        fit.mean * scale,
        fit.V * both,
        fit.S * both,
        (fit.mean + deviations) * scale,
        value_covariance * both,
        _test_equality(equal, information),
    )


def _fit(x: RealArray, information: RealArray, S: RealArray) -> _Fit:
    """Return mean, weights and criterion at a covariance."""
    inner = np.eye(x.shape[1]) + information @ S
    W = np.linalg.solve(inner, information)
    W = 0.5 * (W + W.swapaxes(1, 2))
    total = W.sum(axis=0)
    factor = scipy.linalg.cho_factor(total, lower=True)
    V = scipy.linalg.cho_solve(factor, np.eye(len(total)))
    mean = scipy.linalg.cho_solve(factor, np.einsum("mij,mj->i", W, x))
    residual = x - mean
    pulled = np.einsum("mij,mj->mi", W, residual)
    criterion = (
        np.linalg.slogdet(inner)[1].sum()
        + 2.0 * np.log(np.diag(factor[0])).sum()
        + np.einsum("mi,mi->", residual, pulled)
    )
    gradient = total - pulled.T @ pulled - (W @ V @ W).sum(axis=0)
    return _Fit(S, W, V, mean, residual, float(criterion), gradient)


def _test_equality(equal: _Fit, information: RealArray) -> float:
    """Return the probability of such differences of equal specimens (Cochran, 1954)."""
    square = np.einsum("mi,mij,mj->", equal.residual, information, equal.residual)
    ranks = np.linalg.matrix_rank(information, hermitian=True)
    return float(chdtrc(int(ranks.sum()) - len(equal.mean), square))


def _scale(x: RealArray, information: RealArray) -> RealArray:
    """Return a size of each quantity: its scatter and its error, shape (n,)."""
    weight = np.einsum("mii->mi", information)
    mean = np.sum(weight * x, axis=0) / weight.sum(axis=0)
    square = np.sum(weight * (x - mean) ** 2, axis=0) + 1.0
    return np.asarray(np.sqrt(square / weight.sum(axis=0)))
