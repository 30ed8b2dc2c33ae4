"""`CoulombFriction`: dry friction, a force that changes its sign with the velocity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import RealArray
from updyn.errors import OptionError
from updyn.nonlinear.element import AmplitudeElement, PeriodForce, check_number, diagonal

__all__ = ["CoulombFriction"]


@dataclass(frozen=True, slots=True)
class CoulombFriction(AmplitudeElement):
    """Dry friction: a constant torque against the velocity; sticks up to a breakaway torque.

    Parameters
    ----------
    level : float
        Torque while moving, above 0, in N m (N).
    breakaway : float, optional
        Largest torque while sticking, `level` or above. None: `level`.
    transition : float
        Width v_0 of the smooth change of sign, level tanh(v / v_0), in rad/s (m/s), which the
        periodic response of a model needs; 0 or above. Loops use the exact law.

    Raises
    ------
    OptionError
        If a number is out of its range.

    Notes
    -----
    The describing function for the amplitude V of the velocity is that of a relay, 4 level / (pi
    V), without transition and breakaway torque (Slotine & Li, Applied Nonlinear Control, 1991,
    chapter 5; Gelb & Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design,
    1968, appendix B).

    Examples
    --------
    >>> updyn.CoulombFriction(5.0, breakaway=8.0).sticks
    8.0
    """

    level: float
    breakaway: float | None = None
    transition: float = 0.0

    parameters: ClassVar[tuple[str, ...]] = ("level", "transition")
    units: ClassVar[Mapping[str, str]] = {"level": "N", "transition": "m/s"}
    has_memory: ClassVar[bool] = False
    quantity: ClassVar[str] = "mobility"
    is_odd: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_number("friction: level", self.level, "N m")
        check_number("friction: transition", self.transition, "rad/s", least=0.0)
        if self.breakaway is not None:
            check_number("friction: breakaway", self.breakaway, "N m")
            if self.breakaway < self.level:
                raise OptionError(
                    f"friction: breakaway {self.breakaway:g} is below level {self.level:g};"
                    " expected at least the level"
                )

    @property
    def sticks(self) -> float:
        """Largest torque at rest in N m."""
        return self.level if self.breakaway is None else self.breakaway

    def over_period(self, u: RealArray, v: RealArray) -> PeriodForce:
        """Return the force with a smooth change of sign at each sample.

        Parameters
        ----------
        u : ndarray, shape (n,)
            Displacement in rad (m); has no influence.
        v : ndarray, shape (n,)
            Velocity in rad/s (m/s).

        Returns
        -------
        PeriodForce

        Raises
        ------
        OptionError
            If the transition is 0, or the breakaway torque is above the level.
        """
        if not self.transition:
            raise OptionError(
                "friction: a periodic response needs a smooth change of sign; expected transition"
                " above 0, in rad/s (m/s), or a JenkinsElement, which sticks"
            )
        if self.sticks > self.level:
            raise OptionError(
                f"friction: breakaway {self.breakaway:g} acts in time responses of loops only;"
                " expected None in a model"
            )
        shape = np.tanh(v / self.transition)
        slope = self.level / self.transition * (1.0 - shape**2)
        by = np.stack([shape, -slope * v / self.transition], axis=1)
        return PeriodForce(self.level * shape, diagonal(np.zeros_like(u)), slope, by)

    def at_rest(self) -> tuple[float, float]:
        """Return stiffness and damping for vanishing amplitude.

        Returns
        -------
        (float, float)
            In N m/rad and N m s/rad.

        Raises
        ------
        OptionError
            If the transition is 0: the damping is then unbounded.
        """
        if not self.transition:
            raise OptionError(
                "friction: without a transition, it sticks at rest; expected transition above 0"
            )
        return 0.0, self.level / self.transition

    def _describe(self, A: RealArray) -> RealArray:
        return np.asarray(4.0 * self.level / (np.pi * A))

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
