"""`IwanJoint`: a bolted or riveted joint that loses stiffness and dissipates with amplitude."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.special import gamma

from updyn.arrays import ComplexArray, RealArray
from updyn.nonlinear.element import check_number
from updyn.nonlinear.masing import MasingElement

__all__ = ["IwanJoint"]


@dataclass(frozen=True, slots=True)
class IwanJoint(MasingElement):
    """The four-parameter Iwan model of a joint (Segalman, J. Appl. Mech. 72 (2005) 752).

    Jenkins elements in parallel, whose slip deformations have the density R x^chi up to a largest
    one and a finite share of stiffness there. In microslip, the energy lost in a period is
    proportional to the power 3 + chi of the amplitude.

    Parameters
    ----------
    slip_force : float
        Force F_S of macroslip, above 0, in N (N m).
    stiffness : float
        K_T at vanishing amplitude, above 0, in N/m (N m/rad).
    chi : float
        Power of the density, above -1; at most 0 for joints.
    beta : float
        Stiffness that slips last, over that which slips before; 0 or above.

    Raises
    ------
    OptionError
        If a number is out of its range.

    Notes
    -----
    With y = A / `largest_slip`, the describing function is K_T (1 - B y^(chi + 1)) in microslip;
    from macroslip on, it is nan. The imaginary part follows from the energy lost in a period,
    proportional to A^(chi + 3) (Segalman 2005), the real part from Masing's branches.

    Examples
    --------
    >>> import numpy as np
    >>> joint = updyn.IwanJoint(slip_force=4000.0, stiffness=1.5e7, chi=-0.5, beta=0.005)
    >>> float(np.round(1e3 * joint.largest_slip, 6))
    0.792118
    """

    slip_force: float
    stiffness: float
    chi: float
    beta: float

    parameters: ClassVar[tuple[str, ...]] = ("slip_force", "stiffness", "chi", "beta")
    units: ClassVar[Mapping[str, str]] = {"slip_force": "N", "stiffness": "N/m"}

    def __post_init__(self) -> None:
        check_number("Iwan joint: slip_force", self.slip_force, "N")
        check_number("Iwan joint: stiffness", self.stiffness, "N/m")
        check_number("Iwan joint: chi + 1", self.chi + 1.0, "1")
        check_number("Iwan joint: beta", self.beta, "1", least=0.0)

    @property
    def _shape(self) -> float:
        """Force of macroslip over that of the stiffness at rest at the deformation of macroslip."""
        return (self.beta + (self.chi + 1.0) / (self.chi + 2.0)) / (1.0 + self.beta)

    @property
    def largest_slip(self) -> float:
        """Deformation of macroslip in m (rad)."""
        return self.slip_force / (self.stiffness * self._shape)

    def _load(self, x: RealArray) -> tuple[RealArray, RealArray, RealArray]:
        """Return the initial loading curve, (F_S / shape) g(x / largest_slip)."""
        # g(y) = y - y^(chi + 2) / ((chi + 2) (1 + beta)) reaches `shape` at y = 1.
        p, s, b = self.chi + 2.0, self._shape, 1.0 + self.beta
        slips = x >= self.largest_slip
        y = np.where(slips, 1.0, x / self.largest_slip)
        power = y**p
        g = y - power / (p * b)
        slope = np.where(slips, 0.0, 1.0 - y ** (p - 1.0) / b)
        scale = self.slip_force / s
        # y = x K shape / F_S; the parameters act through scale, y, p and b.
        log = np.log(np.where(y > 0.0, y, 1.0))
        g_p = power * (1.0 / p - log) / (p * b)
        g_b = power / (p * b**2)
        s_p = 1.0 / (p**2 * b)
        s_b = 1.0 / (p * b**2)
        by = (
            np.where(slips, 1.0, (g - slope * y) / s),
            scale * slope * y / self.stiffness,
            np.where(slips, 0.0, scale * (g_p + (slope * y - g) * s_p / s)),
            np.where(slips, 0.0, scale * (g_b + (slope * y - g) * s_b / s)),
        )
        return scale * g, self.stiffness * slope, np.stack(by, axis=1)

    def _describe(self, A: RealArray) -> ComplexArray:
        p = self.chi + 2.0
        # With x = A (1 - cos t) / 2 on a branch, both parts are integrals of powers of sin(t / 2).
        wallis = 0.5 * np.sqrt(np.pi) * gamma(p + 0.5) / gamma(p + 1.0)
        real = 8.0 / np.pi * wallis * p / (p + 1.0)
        loss = 4.0 * (p - 1.0) / (np.pi * (p + 1.0))
        y = A / self.largest_slip
        share = y ** (p - 1.0) / (p * (1.0 + self.beta))
        found = self.stiffness * (1.0 - (real - 1j * loss) * share)
        return np.asarray(np.where(y <= 1.0, found, np.nan))
