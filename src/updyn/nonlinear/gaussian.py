"""`linearise`: the linear spring and damper that replace an element under random motion.

With a Gaussian deformation u and its velocity v, the error of f - (f_0 + k u + c v) has the least
mean square for (Caughey, J. Acoust. Soc. Am. 35 (1963) 1706; Roberts & Spanos, Random Vibration and
Statistical Linearization, 1990, chapters 4 and 5)

    f_0 = E[f],    k = E[f u] / sigma^2,    c = E[f v] / sigma_v^2.

A force without memory depends on u or on v alone; the expectations are integrals over its normal
distribution. For a force with memory the motion is assumed to have a narrow band: a sine whose
amplitude A has the Rayleigh distribution. With the describing function N(A),

    k = E[A^2 Re N] / (2 sigma^2),    c = E[A^2 Im N] / (2 sigma sigma_v).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from updyn.arrays import RealArray
from updyn.errors import OptionError
from updyn.nonlinear.element import NonlinearElement
from updyn.nonlinear.friction import CoulombFriction
from updyn.nonlinear.masing import MasingElement
from updyn.nonlinear.quadrature import integrate
from updyn.nonlinear.settings import LINEARISATION

__all__ = ["LinearForce", "linearise"]

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
        return _linearise_loops(element, sigma, sigma_v)
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
        density = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
        return np.asarray(density[:, None] * np.stack([found.force, found.force * z], axis=1))

    end = LINEARISATION.largest_deviation
    average, slope = integrate(
        moments, np.linspace(-end, end, 1 + 2 * LINEARISATION.intervals)
    ).tolist()
    average = 0.0 if element.is_odd and not mean else average
    if by_velocity:
        return LinearForce(average, 0.0, slope / sigma_v)
    return LinearForce(average, slope / sigma, 0.0)


def _linearise_loops(element: MasingElement, sigma: float, sigma_v: float) -> LinearForce:
    """Return the linear force of an element with memory, for a narrow band."""
    # With the initial loading curve F, a branch from A is F(A) - 2 F(A sin^2(t / 2)). In the
    # integrals over t and A, x = A sin^2(t / 2) = sigma y^2 and A - x = sigma z^2.
    end = np.sqrt(LINEARISATION.largest_deviation)
    z, weights = 0.5 * end * (_POINTS + 1.0), 0.5 * end * _WEIGHTS

    def moments(y: RealArray) -> RealArray:
        F, _, _ = element._load(sigma * y**2)
        r = y[:, None] ** 2 + z**2
        elastic = ((y[:, None] ** 2 - z**2) * r * np.exp(-0.5 * r**2)) @ weights
        lost = 0.5 * y * (2.0 - y**4) * np.exp(-0.5 * y**4)
        return np.stack([F * elastic, F * lost], axis=1)

    edges = np.linspace(0.0, end, 1 + LINEARISATION.intervals)
    stiffness, damping = (8.0 / np.pi * integrate(moments, edges)).tolist()
    return LinearForce(0.0, stiffness / sigma, damping / sigma_v)
