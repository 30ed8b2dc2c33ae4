"""`linearise`: the linear spring and damper that replace an element under random motion.

With a Gaussian deformation u and its velocity v, the error of f - (f_0 + k u + c v) has the least
mean square for (Caughey, J. Acoust. Soc. Am. 35 (1963) 1706; Roberts & Spanos, Random Vibration and
Statistical Linearization, 1990, chapters 4 and 5)

    f_0 = E[f],    k = E[f u] / sigma^2,    c = E[f v] / sigma_v^2.

A force without memory depends on u or on v alone; the expectations are integrals over its normal
distribution. For a force with memory the motion is assumed to have a narrow band: a sine whose
amplitude A has the Rayleigh distribution. With the describing function N(A),

    k = E[A^2 Re N] / (2 sigma^2),    c = E[A^2 Im N] / (2 sigma sigma_v).

Derivatives need no slope of the force: with the Hermite polynomials He_n of z = (u - E[u]) / sigma
and I_n = E[f He_n(z)], Stein's identity E[g'(z)] = E[g(z) z] gives

    dI_n / dE[u] = I_{n+1} / sigma,    dI_n / dsigma = (I_{n+2} + n I_n) / sigma.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial.hermite_e import hermevander

from updyn.arrays import RealArray
from updyn.errors import OptionError
from updyn.nonlinear.element import NonlinearElement
from updyn.nonlinear.friction import CoulombFriction
from updyn.nonlinear.masing import MasingElement
from updyn.nonlinear.quadrature import integrate
from updyn.nonlinear.settings import LINEARISATION

__all__ = ["LinearForce", "derive_linear_force", "linearise"]

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(LINEARISATION.inner_points)


@dataclass(frozen=True, slots=True)
class LinearForce:
    """The force `mean` + `stiffness` (u - E[u]) + `damping` v, in N, N/m and N s/m."""

    mean: float
    stiffness: float
    damping: float


def linearise(
    element: NonlinearElement, sigma: float, sigma_v: float, mean: float = 0.0
) -> LinearForce:
    """Return the linear force of least mean-square error for a Gaussian motion.

    `sigma` in m and `sigma_v` in m/s are standard deviations, `mean` in m that of the deformation.
    Raises OptionError for a force that depends on both u and v, or has another kind of memory than
    Masing's.
    """
    if isinstance(element, MasingElement):
        stiffness, damping = _loop_moments(element, sigma)[:, 0].tolist()
        return LinearForce(0.0, stiffness / sigma, damping / sigma_v)
    average, slope = _gaussian_moments(element, sigma, sigma_v, mean, order=1)[:, 0].tolist()
    average = 0.0 if element.is_odd and not mean else average
    if element.quantity == "mobility":
        return LinearForce(average, 0.0, slope / sigma_v)
    return LinearForce(average, slope / sigma, 0.0)


def derive_linear_force(
    element: NonlinearElement, sigma: float, sigma_v: float, mean: float = 0.0
) -> RealArray:
    """Return the derivatives of mean, stiffness and damping of `linearise`, (3, 3 + n_p).

    Columns are those by `mean`, `sigma`, `sigma_v` and the parameters of the element.
    """
    if isinstance(element, MasingElement):
        (K, K_s, *K_p), (L, L_s, *L_p) = _loop_moments(element, sigma).tolist()
        out = np.zeros((3, 3 + len(K_p)))
        out[1] = [0.0, (K_s - K / sigma) / sigma, 0.0, *(value / sigma for value in K_p)]
        out[2] = [0.0, L_s / sigma_v, -L / sigma_v**2, *(value / sigma_v for value in L_p)]
        return out
    found = _gaussian_moments(element, sigma, sigma_v, mean, order=3)
    (I_1, I_2, I_3), by = found[1:, 0], found[:2, 1:]
    out = np.zeros((3, 3 + by.shape[1]))
    out[0, 3:] = by[0]
    if element.quantity == "mobility":
        out[0, 2] = I_2 / sigma_v
        out[2, 2] = I_3 / sigma_v**2
        out[2, 3:] = by[1] / sigma_v
        return out
    out[0, :2] = I_1 / sigma, I_2 / sigma
    out[1, :2] = I_2 / sigma**2, I_3 / sigma**2
    out[1, 3:] = by[1] / sigma
    return out


def _gaussian_moments(
    element: NonlinearElement, sigma: float, sigma_v: float, mean: float, order: int
) -> RealArray:
    """Return E[f He_n], n = 0 ... order, and with an order above 1 those of df/dp, (n, 1 + n_p)."""
    if element.has_memory:
        raise OptionError(
            f"{type(element).__name__}: random excitation needs elements without memory, or made of"
            " springs and sliders (MasingElement)"
        )
    if isinstance(element, CoulombFriction) and not element.transition:
        element = replace(element, transition=LINEARISATION.sharp_transition * sigma_v)
    by_velocity = element.quantity == "mobility"

    def moments(z: RealArray) -> RealArray:
        found = element.over_period(mean + sigma * z, sigma_v * z)
        other = found.stiffness.data if by_velocity else found.damping
        if other.any():
            raise OptionError(
                f"{type(element).__name__}: the force depends on deformation and velocity; random"
                " excitation needs elements whose force depends on one of them"
            )
        values = found.force[:, None]
        if order > 1:
            values = np.concatenate([values, found.parameters], axis=1)
        weights = hermevander(z, order) * np.exp(-0.5 * z[:, None] ** 2) / np.sqrt(2.0 * np.pi)
        return np.asarray(weights[:, :, None] * values[:, None, :])

    end = LINEARISATION.largest_deviation
    return integrate(moments, np.linspace(-end, end, 1 + 2 * LINEARISATION.intervals))


def _loop_moments(element: MasingElement, sigma: float) -> RealArray:
    """Return k sigma and c sigma_v of an element with memory, and their derivatives, (2, 2 + n_p).

    Derivatives are those by sigma and by the parameters.
    """
    # With the initial loading curve F, a branch from A is F(A) - 2 F(A sin^2(t / 2)). In the
    # integrals over t and A, x = A sin^2(t / 2) = sigma y^2 and A - x = sigma z^2.
    end = np.sqrt(LINEARISATION.largest_deviation)
    z, weights = 0.5 * end * (_POINTS + 1.0), 0.5 * end * _WEIGHTS

    def moments(y: RealArray) -> RealArray:
        F, slope, by = element._load(sigma * y**2)
        r = y[:, None] ** 2 + z**2
        elastic = ((y[:, None] ** 2 - z**2) * r * np.exp(-0.5 * r**2)) @ weights
        lost = 0.5 * y * (2.0 - y**4) * np.exp(-0.5 * y**4)
        values = np.concatenate([F[:, None], (slope * y**2)[:, None], by], axis=1)
        return np.stack([elastic[:, None] * values, lost[:, None] * values], axis=1)

    edges = np.linspace(0.0, end, 1 + LINEARISATION.intervals)
    return np.asarray(8.0 / np.pi * integrate(moments, edges))
