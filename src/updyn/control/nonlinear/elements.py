"""`Backlash` and `CoulombFriction`: nonlinearities and their describing functions.

Both act between one output z of a plant and one input w: w = -T, with the torque T of the twist z
or of the velocity z. The describing function N(A, omega) is the first harmonic of T over that of
z = A sin(omega t).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import BoolArray, ComplexArray, RealArray
from updyn.control.nonlinear.settings import HARMONIC_BALANCE
from updyn.errors import OptionError
from updyn.group import is_number

__all__ = ["Backlash", "CoulombFriction", "Nonlinearity"]

# Limits beyond which harmonic balance deviated by 10 % from simulation, in amplitude or frequency.


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
        c in contact, 0 or above, in N m s/rad.

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

    quantity = "receptance"

    def __post_init__(self) -> None:
        _number("backlash: stiffness", self.stiffness, "N m/rad")
        _number("backlash: gap", self.gap, "rad")
        _number("backlash: damping", self.damping, "N m s/rad", zero=True)

    @property
    def half(self) -> float:
        """Half the gap in rad."""
        return 0.5 * self.gap

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
        The exact first harmonic of the law. For light damping, c omega << k, it is (k + i c omega)
        (1 - (2 / pi) (asin d + d sqrt(1 - d^2))), d = gap / (2
        A): the dead zone (Slotine & Li, Applied Nonlinear Control, 1991, chapter 5; Gelb & Vander
        Velde, Multiple-Input Describing Functions and Nonlinear System Design, 1968, appendix B).
        """
        touches, d, a, psi1, psi2 = self._contact(amplitude, omega)
        sin2 = 0.5 * (psi2 - psi1) - 0.25 * (np.sin(2 * psi2) - np.sin(2 * psi1))
        cos2 = 0.5 * (psi2 - psi1) + 0.25 * (np.sin(2 * psi2) - np.sin(2 * psi1))
        both = 0.5 * (np.sin(psi2) ** 2 - np.sin(psi1) ** 2)
        real = sin2 + d * (np.cos(psi2) - np.cos(psi1)) + a * both
        imag = both - d * (np.sin(psi2) - np.sin(psi1)) + a * cos2
        return np.asarray(np.where(touches, 2.0 / np.pi * self.stiffness * (real + 1j * imag), 0.0))

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

    def doubt(self, amplitude: float, third: float) -> str:
        """Return the reason why a limit cycle is doubtful; else an empty text.

        Parameters
        ----------
        amplitude : float
            In rad.
        third : float
            Third harmonic over the first.

        Returns
        -------
        str
        """
        if amplitude < HARMONIC_BALANCE.least_twist * self.half:
            return (
                f"the twist reaches only {amplitude / self.half:.3g} half gaps: bounces, not a sine"
            )
        return ""

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
        least = HARMONIC_BALANCE.least_gap_ratio
        is_reachable = (wanted > 0) & (wanted < np.abs(self.describing(self.half / least, w)))
        wanted, w = wanted[is_reachable], w[is_reachable]
        # |N| rises with A from 0 to |k + i c omega|: bisection in d = gap / (2 A) from 1 to nearly
        # 0.
        low, high = np.full(wanted.shape, least), np.ones(wanted.shape)
        for _ in range(HARMONIC_BALANCE.bisections):
            mid = np.where(low < 1e-2 * high, np.sqrt(low * high), 0.5 * (low + high))
            more = np.abs(self.describing(self.half / mid, w)) > wanted
            low, high = np.where(more, mid, low), np.where(more, high, mid)
        out[is_reachable] = self.half / (0.5 * (low + high))
        return out


def _contact_phase(d: RealArray, a: RealArray, psi2: RealArray) -> RealArray:
    """Return the phase of contact with a flank while the shaft relaxes, by bisection."""
    twist = (
        np.sin(psi2) - d
    )  # of the shaft over A, at the end of contact with the other flank, half a turn before
    low, high = psi2 - np.pi, np.full(np.shape(psi2), 0.5 * np.pi)
    safe = np.where(a > 0, a, 1.0)
    for _ in range(HARMONIC_BALANCE.bisections):
        mid = 0.5 * (low + high)
        touches = np.sin(mid) + twist * np.exp(-(mid - psi2 + np.pi) / safe) > d
        low, high = np.where(touches, low, mid), np.where(touches, mid, high)
    return np.asarray(0.5 * (low + high))


@dataclass(frozen=True, slots=True)
class CoulombFriction:
    """Dry friction: a constant torque against the velocity; sticks up to a breakaway torque.

    Parameters
    ----------
    level : float
        Torque while moving, above 0, in N m (N).
    breakaway : float, optional
        Largest torque while sticking, `level` or above. None: `level`.

    Raises
    ------
    OptionError
        If a number is out of its range.

    Examples
    --------
    >>> updyn.CoulombFriction(5.0, breakaway=8.0).sticks
    8.0
    """

    level: float
    breakaway: float | None = None

    quantity = "mobility"

    def __post_init__(self) -> None:
        _number("friction: level", self.level, "N m")
        if self.breakaway is not None:
            _number("friction: breakaway", self.breakaway, "N m")
            if self.breakaway < self.level:
                raise OptionError(
                    f"friction: breakaway {self.breakaway:g} is below level {self.level:g};"
                    " expected at least the level"
                )

    @property
    def sticks(self) -> float:
        """Largest torque at rest in N m."""
        return self.level if self.breakaway is None else self.breakaway

    def describing(self, amplitude: ArrayLike, omega: ArrayLike) -> ComplexArray:
        """Return the describing function, 4 level / (pi A), without the breakaway torque.

        Parameters
        ----------
        amplitude : array_like of float
            A of the velocity in rad/s, above 0.
        omega : array_like of float
            In rad/s; has no influence.

        Returns
        -------
        ndarray of complex
            In N m s/rad.

        Notes
        -----
        The describing function of a relay (Slotine & Li 1991, chapter 5; Gelb & Vander Velde 1968,
        appendix B).
        """
        A, _ = np.broadcast_arrays(np.asarray(amplitude, dtype=np.float64), np.asarray(omega))
        return np.asarray(4.0 * self.level / (np.pi * A), dtype=np.complex128)

    def amplitude(self, modulus: ArrayLike, omega: ArrayLike) -> RealArray:
        """Return the amplitude at which |N| has a value.

        Parameters
        ----------
        modulus : array_like of float
            |N| in N m s/rad, above 0.
        omega : array_like of float
            In rad/s; has no influence.

        Returns
        -------
        ndarray of float
            In rad/s.
        """
        wanted, _ = np.broadcast_arrays(np.asarray(modulus, dtype=np.float64), np.asarray(omega))
        return np.asarray(4.0 * self.level / (np.pi * wanted))

    def doubt(self, amplitude: float, third: float) -> str:
        """Return the reason why a limit cycle is doubtful; else an empty text.

        Parameters
        ----------
        amplitude : float
            In rad/s.
        third : float
            Third harmonic over the first.

        Returns
        -------
        str
        """
        if third > HARMONIC_BALANCE.largest_third:
            return f"the loop transmits {third:.2g} of a third harmonic"
        return ""

    def third(self, amplitude: float, omega: float) -> float:
        """Return the magnitude of the third harmonic of T, a third of the first.

        Parameters
        ----------
        amplitude : float
            A of the velocity in rad/s; has no influence.
        omega : float
            In rad/s; has no influence.

        Returns
        -------
        float
            In N m.
        """
        return 4.0 * self.level / (3.0 * np.pi)


Nonlinearity = Backlash | CoulombFriction


def _number(what: str, value: object, unit: str, *, zero: bool = False) -> None:
    if not is_number(value) or not math.isfinite(value) or value < 0 or (value == 0 and not zero):
        raise OptionError(
            f"{what} is {value!r}; expected a number {'of at least' if zero else 'above'} 0, in"
            f" {unit}"
        )
