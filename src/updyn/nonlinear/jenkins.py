"""`JenkinsElement`: dry friction with the stiffness of its contact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import ComplexArray, RealArray
from updyn.nonlinear.element import PeriodForce, check_number
from updyn.nonlinear.masing import follow_loop

__all__ = ["JenkinsElement"]


@dataclass(frozen=True, slots=True)
class JenkinsElement:
    """A spring and a Coulomb slider in series: stiffness k while sticking, a constant slip force.

    Parameters
    ----------
    stiffness : float
        k while sticking, above 0, in N/m (N m/rad).
    slip_force : float
        Force while slipping, above 0, in N (N m).

    Raises
    ------
    OptionError
        If a number is out of its range.

    Examples
    --------
    >>> import numpy as np
    >>> np.round(updyn.JenkinsElement(10.0, 1.0).describing([0.1, 0.2], 1.0), 6)
    array([10.+0.j      ,  5.+3.183099j])
    """

    stiffness: float
    slip_force: float

    parameters: ClassVar[tuple[str, ...]] = ("stiffness", "slip_force")
    has_memory: ClassVar[bool] = True
    quantity: ClassVar[str] = "receptance"
    is_odd: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_number("Jenkins element: stiffness", self.stiffness, "N/m")
        check_number("Jenkins element: slip_force", self.slip_force, "N")

    def over_period(self, u: RealArray, v: RealArray) -> PeriodForce:
        """Return the steady force at each sample, of a motion that has grown from rest.

        Parameters
        ----------
        u : ndarray, shape (n,)
            Deformation in m (rad).
        v : ndarray, shape (n,)
            Velocity in m/s (rad/s); has no influence.

        Returns
        -------
        PeriodForce
        """
        return follow_loop(self._load, u)

    def _load(self, x: RealArray) -> tuple[RealArray, RealArray, RealArray]:
        """Return the initial loading curve."""
        sticks = self.stiffness * x < self.slip_force
        force = np.where(sticks, self.stiffness * x, self.slip_force)
        by = np.stack([np.where(sticks, x, 0.0), np.where(sticks, 0.0, 1.0)], axis=1)
        return force, np.where(sticks, self.stiffness, 0.0), by

    def at_rest(self) -> tuple[float, float]:
        """Return stiffness and damping for vanishing amplitude: the slider sticks.

        Returns
        -------
        (float, float)
            In N/m and N s/m.
        """
        return self.stiffness, 0.0

    def describing(self, amplitude: ArrayLike, omega: ArrayLike) -> ComplexArray:
        """Return the describing function.

        Parameters
        ----------
        amplitude : array_like of float
            A of the deformation in m (rad).
        omega : array_like of float
            In rad/s; has no influence.

        Returns
        -------
        ndarray of complex
            In N/m.

        Notes
        -----
        With cos b = 1 - 2 F / (k A) it is (k / pi) (b - sin(2 b) / 2) + i (4 F / (pi A)) (1 -
        F / (k A)), and k below slip (Griffin, J. Eng. Power 102 (1980) 329).
        """
        A, _ = np.broadcast_arrays(np.asarray(amplitude, dtype=np.float64), np.asarray(omega))
        share = np.minimum(self.slip_force / (self.stiffness * A), 1.0)
        b = np.arccos(1.0 - 2.0 * share)
        real = (b - 0.5 * np.sin(2.0 * b)) / np.pi
        return np.asarray(self.stiffness * (real + 4j / np.pi * share * (1.0 - share)))
