"""`QuadraticDamper`: damping with the square of the velocity, as in turbulent flow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import ComplexArray, RealArray
from updyn.nonlinear.element import PeriodForce, check_number, diagonal

__all__ = ["QuadraticDamper"]


@dataclass(frozen=True, slots=True)
class QuadraticDamper:
    """A damper with the force f = c |v| v.

    Parameters
    ----------
    coefficient : float
        c in N s2/m2 (N m s2/rad2), above 0.

    Raises
    ------
    OptionError
        If the coefficient is not above 0.

    Examples
    --------
    >>> import numpy as np
    >>> float(np.round(updyn.QuadraticDamper(3.0).describing(np.pi, 1.0).real, 12))
    8.0
    """

    coefficient: float

    parameters: ClassVar[tuple[str, ...]] = ("coefficient",)
    has_memory: ClassVar[bool] = False
    quantity: ClassVar[str] = "mobility"
    is_odd: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_number("quadratic damper: coefficient", self.coefficient, "N s2/m2")

    def over_period(self, u: RealArray, v: RealArray) -> PeriodForce:
        """Return the force at each sample.

        Parameters
        ----------
        u : ndarray, shape (n,)
            Deformation in m (rad); has no influence.
        v : ndarray, shape (n,)
            Velocity in m/s (rad/s).

        Returns
        -------
        PeriodForce
        """
        size, c = np.abs(v), self.coefficient
        shape = size * v
        return PeriodForce(c * shape, diagonal(np.zeros_like(u)), 2.0 * c * size, shape[:, None])

    def at_rest(self) -> tuple[float, float]:
        """Return stiffness and damping for vanishing amplitude.

        Returns
        -------
        (float, float)
            Both 0, in N/m and N s/m.
        """
        return 0.0, 0.0

    def describing(self, amplitude: ArrayLike, omega: ArrayLike) -> ComplexArray:
        """Return the describing function, 8 c V / (3 pi).

        Parameters
        ----------
        amplitude : array_like of float
            V of the velocity in m/s (rad/s).
        omega : array_like of float
            In rad/s; has no influence.

        Returns
        -------
        ndarray of complex
            In N s/m.

        Notes
        -----
        Gelb & Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design, 1968,
        appendix B (odd square law).
        """
        V, _ = np.broadcast_arrays(np.asarray(amplitude, dtype=np.float64), np.asarray(omega))
        return np.asarray(8.0 * self.coefficient / (3.0 * np.pi) * V, dtype=np.complex128)
