"""`Backlash`: an elastic contact with a gap, as in gears and loose joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import BoolArray, ComplexArray, RealArray
from updyn.errors import OptionError
from updyn.nonlinear.element import PeriodForce, check_number, diagonal
from updyn.nonlinear.settings import DESCRIBING

__all__ = ["Backlash"]


@dataclass(frozen=True, slots=True)
class Backlash:
    """An elastic mesh with a gap: no torque in the gap, spring and damper at each flank, no pull.

    With z the twist and z_s that of the shaft, z - z_s lies between -gap / 2 and gap / 2. At a
    flank the torque is T = k z_s + c z_s'; if it would pull, contact ends and the shaft relaxes, k
    z_s + c z_s' = 0 (Nordin & Gutman, Automatica 38 (2002) 1633-1649). Without damping this is the
    dead zone T = k (z -+ gap / 2).

    Parameters
    ----------
    stiffness : float
        k of the mesh in contact, above 0, in N m per rad of twist.
    gap : float
        Clearance from flank to flank, above 0, in rad of twist.
    damping : float
        c in contact, 0 or above, in N m s/rad; loops only.
    offset : float
        Twist at the middle of the gap in rad. Beyond half the gap, the mesh is preloaded: contact
        exists at rest.

    Raises
    ------
    OptionError
        If a number is out of its range.

    Examples
    --------
    >>> updyn.Backlash(stiffness=4e5, gap=1e-3).half
    0.0005
    """

    stiffness: float
    gap: float
    damping: float = 0.0
    offset: float = 0.0

    parameters: ClassVar[tuple[str, ...]] = ("stiffness", "gap", "offset")
    units: ClassVar[Mapping[str, str]] = {"stiffness": "N/m", "gap": "m", "offset": "m"}
    has_memory: ClassVar[bool] = False
    quantity: ClassVar[str] = "receptance"

    def __post_init__(self) -> None:
        check_number("backlash: stiffness", self.stiffness, "N m/rad")
        check_number("backlash: gap", self.gap, "rad")
        check_number("backlash: damping", self.damping, "N m s/rad", least=0.0)
        check_number("backlash: offset", self.offset, "rad", least=-np.inf)

    @property
    def half(self) -> float:
        """Half the gap in rad."""
        return 0.5 * self.gap

    @property
    def is_odd(self) -> bool:
        """Whether the gap is centred."""
        return self.offset == 0.0

    def over_period(self, u: RealArray, v: RealArray) -> PeriodForce:
        """Return the force of the mesh without damping at each sample.

        Parameters
        ----------
        u : ndarray, shape (n,)
            Twist in rad (m).
        v : ndarray, shape (n,)
            Velocity in rad/s (m/s); has no influence.

        Returns
        -------
        PeriodForce

        Raises
        ------
        OptionError
            If the mesh has damping.
        """
        if self.damping:
            raise OptionError(
                f"backlash: damping {self.damping:g} acts in loops only; expected 0 in a model,"
                " whose groups can have the damping"
            )
        twist = u - self.offset
        side = np.sign(twist) * (np.abs(twist) > self.half)
        shaft = np.abs(side) * twist - side * self.half
        slope = self.stiffness * np.abs(side)
        by = np.stack([shaft, -0.5 * self.stiffness * side, -slope], axis=1)
        return PeriodForce(self.stiffness * shaft, diagonal(slope), np.zeros_like(u), by)

    def at_rest(self) -> tuple[float, float]:
        """Return stiffness and damping for vanishing amplitude: 0 within the gap.

        Returns
        -------
        (float, float)
            In N m/rad and N m s/rad.
        """
        if abs(self.offset) <= self.half:
            return 0.0, 0.0
        return self.stiffness, self.damping

    def describing(self, amplitude: ArrayLike, omega: ArrayLike) -> ComplexArray:
        """Return the describing function.

        Parameters
        ----------
        amplitude : array_like of float
            A of the twist in rad, above 0; without contact, up to half the gap, N = 0.
        omega : array_like of float
            In rad/s, above 0; broadcast with `amplitude`.

        Returns
        -------
        ndarray of complex
            In N m/rad.

        Notes
        -----
        The exact first harmonic of the law; nan with both damping and an offset. For light damping,
        c omega << k, it is (k + i c omega) (1 - (2 / pi) (asin d + d sqrt(1 - d^2))), d = gap / (2
        A): the dead zone (Slotine & Li, Applied Nonlinear Control, 1991, chapter 5; Gelb & Vander
        Velde, Multiple-Input Describing Functions and Nonlinear System Design, 1968, appendix B).
        """
        if self.offset:
            return self._describe_flanks(amplitude, omega)
        touches, d, a, psi1, psi2 = self._contact(amplitude, omega)
        sin2 = 0.5 * (psi2 - psi1) - 0.25 * (np.sin(2 * psi2) - np.sin(2 * psi1))
        cos2 = 0.5 * (psi2 - psi1) + 0.25 * (np.sin(2 * psi2) - np.sin(2 * psi1))
        both = 0.5 * (np.sin(psi2) ** 2 - np.sin(psi1) ** 2)
        real = sin2 + d * (np.cos(psi2) - np.cos(psi1)) + a * both
        imag = both - d * (np.sin(psi2) - np.sin(psi1)) + a * cos2
        return np.asarray(np.where(touches, 2.0 / np.pi * self.stiffness * (real + 1j * imag), 0.0))

    def _describe_flanks(self, amplitude: ArrayLike, omega: ArrayLike) -> ComplexArray:
        """Return the describing function with an offset, half for each flank; nan if damped."""
        A, _ = np.broadcast_arrays(np.asarray(amplitude, dtype=np.float64), np.asarray(omega))
        out = np.zeros(A.shape, dtype=np.complex128)
        for side in (-1.0, 1.0):
            d = np.clip((self.half + side * self.offset) / A, -1.0, 1.0)
            out += 0.5 - (np.arcsin(d) + d * np.sqrt(1.0 - d**2)) / np.pi
        return np.asarray(np.nan if self.damping else self.stiffness * out)

    def third(self, amplitude: float, omega: float) -> float:
        """Return the magnitude of the third harmonic of T.

        Parameters
        ----------
        amplitude : float
            A of the twist in rad.
        omega : float
            In rad/s.

        Returns
        -------
        float
            In N m.
        """
        touches, d, a, psi1, psi2 = self._contact(amplitude, omega)
        psi = np.linspace(psi1, psi2, 2001)
        T = np.sin(psi) - d + a * np.cos(psi)
        third = complex(np.trapezoid(T * np.exp(-3j * psi), psi))
        size = 2.0 / np.pi * abs(third)
        return float(np.where(touches, self.stiffness * amplitude * size, 0.0))

    def _contact(
        self, amplitude: ArrayLike, omega: ArrayLike
    ) -> tuple[BoolArray, RealArray, RealArray, RealArray, RealArray]:
        """Return whether contact occurs, gap / (2 A), c omega / k, and the phases of contact."""
        A, w = np.broadcast_arrays(
            np.asarray(amplitude, dtype=np.float64), np.asarray(omega, dtype=np.float64)
        )
        touches = np.asarray(self.half < A)
        d = np.where(touches, self.half / np.where(A > 0, A, 1.0), 1.0)
        a = self.damping * w / self.stiffness
        # Contact begins at the flank, and ends when the torque changes its sign.
        psi2 = np.pi - np.arcsin(d / np.sqrt(1.0 + a**2)) - np.arctan(a)
        psi1 = np.arcsin(d) if self.damping == 0.0 else _contact_phase(d, a, psi2)
        return touches, d, a, psi1, psi2

    def amplitude(self, modulus: ArrayLike, omega: ArrayLike) -> RealArray:
        """Return the amplitude at which |N| has a value; nan if it never does.

        Parameters
        ----------
        modulus : array_like of float
            |N| in N m/rad, above 0.
        omega : array_like of float
            In rad/s.

        Returns
        -------
        ndarray of float
            In rad.
        """
        wanted, w = np.broadcast_arrays(
            np.asarray(modulus, dtype=np.float64), np.asarray(omega, dtype=np.float64)
        )
        out = np.full(wanted.shape, np.nan)
        least = DESCRIBING.least_gap_ratio
        is_reachable = (wanted > 0) & (wanted < np.abs(self.describing(self.half / least, w)))
        wanted, w = wanted[is_reachable], w[is_reachable]
        # |N| rises with A from 0 to |k + i c omega|: bisection in d = gap / (2 A) from 1 to nearly
        # 0.
        low, high = np.full(wanted.shape, least), np.ones(wanted.shape)
        for _ in range(DESCRIBING.bisections):
            mid = np.where(low < 1e-2 * high, np.sqrt(low * high), 0.5 * (low + high))
            more = np.abs(self.describing(self.half / mid, w)) > wanted
            low, high = np.where(more, mid, low), np.where(more, high, mid)
        out[is_reachable] = self.half / (0.5 * (low + high))
        return out


def _contact_phase(d: RealArray, a: RealArray, psi2: RealArray) -> RealArray:
    """Return the phase of contact with a flank while the shaft relaxes, by bisection."""
    # Of the shaft over A, at the end of contact with the other flank, half a turn before.
    twist = np.sin(psi2) - d
    low, high = psi2 - np.pi, np.full(np.shape(psi2), 0.5 * np.pi)
    safe = np.where(a > 0, a, 1.0)
    for _ in range(DESCRIBING.bisections):
        mid = 0.5 * (low + high)
        touches = np.sin(mid) + twist * np.exp(-(mid - psi2 + np.pi) / safe) > d
        low, high = np.where(touches, low, mid), np.where(touches, mid, high)
    return np.asarray(0.5 * (low + high))
