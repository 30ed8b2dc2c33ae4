"""A linear least-squares problem by its singular values, and how strongly to regularise it.

|A z - b|^2 + strength^2 |z|^2 for all strengths at once, and the same problem on its first singular vectors alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Spectrum", "corner", "discrepancy", "minimum"]

_Vector = NDArray[np.float64]

#: Strengths that are looked at, evenly in their logarithm, before the best of them is refined.
_GRID = 400


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """min |A z - b|^2, A = U diag(s) V^T, residuals in units of one standard deviation.

    Attributes
    ----------
    s : ndarray of float, shape (k,)
        Singular values, falling.
    beta : ndarray of float, shape (k,)
        U^T b.
    V : ndarray of float, shape (n, k)
        Right singular vectors.
    rest : float
        Squared length of what of b no z reaches.
    n_values : float
        Number of residuals.
    fixed : int
        How many of them further unknowns, which are not regularised, take up.
    """

    s: _Vector
    beta: _Vector
    V: NDArray[np.float64]
    rest: float
    n_values: float
    fixed: int = 0

    @classmethod
    def of(
        cls,
        A: NDArray[np.float64],
        b: _Vector,
        rest: float = 0.0,
        n_values: float = 0.0,
        fixed: int = 0,
    ) -> Spectrum:
        """Return the spectrum of a problem.

        Parameters
        ----------
        A : ndarray of float, shape (m, n)
            Matrix.
        b : ndarray of float, shape (m,)
            Right-hand side.
        rest : float
            Squared length of a residual that is there besides, whatever z.
        n_values : float
            Number of residuals; by default m.
        fixed : int
            How many of them further unknowns take up.

        Returns
        -------
        Spectrum
        """
        U, s, Vt = np.linalg.svd(A, full_matrices=False)
        beta = U.T @ b
        beyond = (
            b - U @ beta
        )  # not |b|^2 - |beta|^2, which is rounding where A reaches nearly all of b
        return cls(s, beta, Vt.T, rest + float(beyond @ beyond), n_values or float(len(b)), fixed)

    def passed(self, strength: float) -> _Vector:
        """Return the share of each singular component that Tikhonov's method lets pass: s^2 / (s^2 + strength^2)."""
        return np.asarray(self.s**2 / np.maximum(self.s**2 + strength**2, np.finfo(float).tiny))

    def kept(self, number: int) -> _Vector:
        """Return the shares of truncated singular values: 1 for the first `number`, else 0."""
        return np.where(np.arange(len(self.s)) < number, 1.0, 0.0)

    def solution(self, shares: _Vector) -> _Vector:
        """Return z, shape (n,)."""
        return np.asarray(self.V @ self._components(shares))

    def distance(self, shares: _Vector) -> float:
        """Return |z|."""
        return float(np.linalg.norm(self._components(shares)))

    def misfit(self, shares: _Vector) -> float:
        """Return |A z - b|, with what no z reaches."""
        return float(np.sqrt(np.sum(((1.0 - shares) * self.beta) ** 2) + self.rest))

    def freedom(self, shares: _Vector) -> float:
        """Return the effective number of unknowns, the trace of the influence matrix."""
        return float(shares.sum()) + self.fixed

    def gcv(self, shares: _Vector) -> float:
        """Return the function of generalised cross-validation (Golub, Heath & Wahba, Technometrics 21 (1979) 215)."""
        return (
            self.n_values
            * self.misfit(shares) ** 2
            / max(self.n_values - self.freedom(shares), 1e-6) ** 2
        )

    def curvature(self, strength: float) -> float:
        """Return the curvature of the L-curve, log |z| over log |A z - b|, positive at its corner.

        Hansen & O'Leary, SIAM J. Sci. Comput. 14 (1993) 1487; here from the derivatives of the
        filter by t = log(strength): df/dt = -2 f (1 - f).
        """
        f = self.passed(strength)
        g, squared = 1.0 - f, self.beta**2
        along = squared / np.maximum(self.s, np.finfo(float).tiny ** 0.25) ** 2
        P, D = float(np.sum(g**2 * squared)) + self.rest, float(np.sum(f**2 * along))
        if P <= 0.0 or D <= 0.0:
            return 0.0
        dP, dD = 4.0 * float(np.sum(f * g**2 * squared)), -4.0 * float(np.sum(f**2 * g * along))
        ddP = 8.0 * float(np.sum(f * g**2 * (2.0 * f - g) * squared))
        ddD = 8.0 * float(np.sum(f**2 * g * (2.0 * g - f) * along))
        x, y = dP / (2.0 * P), dD / (2.0 * D)
        xx, yy = ddP / (2.0 * P) - 2.0 * x**2, ddD / (2.0 * D) - 2.0 * y**2
        speed = (x**2 + y**2) ** 1.5
        return (x * yy - xx * y) / speed if speed > 0.0 else 0.0

    def _components(self, shares: _Vector) -> _Vector:
        seen = self.s > 0.0
        return np.asarray(np.where(seen, shares * self.beta / np.where(seen, self.s, 1.0), 0.0))


def minimum(spectrum: Spectrum, low: float, high: float) -> float:
    """Return the strength of least generalised cross-validation.

    Parameters
    ----------
    spectrum : Spectrum
        The problem.
    low, high : float
        Between which strengths.

    Returns
    -------
    float
    """
    return _best(lambda strength: spectrum.gcv(spectrum.passed(strength)), low, high)


def corner(spectrum: Spectrum, low: float, high: float) -> float:
    """Return the strength at the corner of the L-curve, where its curvature is largest.

    Parameters
    ----------
    spectrum : Spectrum
        The problem.
    low, high : float
        Between which strengths.

    Returns
    -------
    float
    """
    return _best(lambda strength: -spectrum.curvature(strength), low, high)


def discrepancy(spectrum: Spectrum, low: float, high: float) -> float:
    """Return the largest strength at which the misfit has grown no more than the noise explains.

    What the unknowns can change of the residual holds as many numbers as there are unknowns. Of
    these, a fit has to leave the noise of the freedom that it gives up, their number less the
    effective number of unknowns, and may leave one standard deviation more: the compensated
    discrepancy principle (Hansen, Discrete Inverse Problems, SIAM 2010, section 5.2) on this part
    alone. What no unknown changes would only add its own scatter, sqrt(2 n_values).

    Parameters
    ----------
    spectrum : Spectrum
        The problem; the noise has to be known.
    low, high : float
        Between which strengths.

    Returns
    -------
    float
    """
    from scipy.optimize import brentq

    def excess(log: float) -> float:
        given_up = 1.0 - spectrum.passed(float(np.exp(log)))
        expected, scatter = np.sum(given_up), np.sqrt(2.0 * np.sum(given_up**2))
        return float(np.sum((given_up * spectrum.beta) ** 2) - expected - scatter)

    logs = np.linspace(np.log(low), np.log(high), _GRID)
    within = np.flatnonzero([excess(t) <= 0.0 for t in logs])
    if not within.size:
        return low
    last = int(within[-1])
    return (
        high
        if last == _GRID - 1
        else float(np.exp(brentq(excess, logs[last], logs[last + 1], xtol=1e-10)))
    )


def _best(cost: Callable[[float], float], low: float, high: float) -> float:
    """Return the strength of least cost: the best of a grid, refined between its neighbours."""
    from scipy.optimize import minimize_scalar

    logs = np.linspace(np.log(low), np.log(high), _GRID)
    at = int(np.argmin([cost(float(np.exp(t))) for t in logs]))
    bounds = logs[max(at - 1, 0)], logs[min(at + 1, _GRID - 1)]
    found = minimize_scalar(
        lambda t: cost(float(np.exp(t))), bounds=bounds, method="bounded", options={"xatol": 1e-8}
    )
    return float(np.exp(found.x if found.fun <= cost(float(np.exp(logs[at]))) else logs[at]))
