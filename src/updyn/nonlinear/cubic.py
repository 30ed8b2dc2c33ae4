"""`CubicSpring`: a stiffness that grows or falls with the square of the amplitude."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import ComplexArray, RealArray
from updyn.nonlinear.element import PeriodForce, check_number, diagonal

__all__ = ["CubicSpring"]


@dataclass(frozen=True, slots=True)
class CubicSpring:
    """A spring with the force f = c u^3, without a linear part.

    Parameters
    ----------
    coefficient : float
        c in N/m^3 (N m/rad^3); a negative one softens.

    Raises
    ------
    OptionError
        If the coefficient is not finite.

    Examples
    --------
    >>> updyn.CubicSpring(4.0).describing(0.5, 1.0)
    array(0.75+0.j)
    """

    coefficient: float

    parameters: ClassVar[tuple[str, ...]] = ("coefficient",)
    has_memory: ClassVar[bool] = False
    quantity: ClassVar[str] = "receptance"
    is_odd: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_number("cubic spring: coefficient", self.coefficient, "N/m^3", least=-np.inf)

    def over_period(self, u: RealArray, v: RealArray) -> PeriodForce:
        """Return the force at each sample.

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
        square = u**2
        cube = square * u
        c = self.coefficient
        return PeriodForce(c * cube, diagonal(3.0 * c * square), np.zeros_like(u), cube[:, None])

    def at_rest(self) -> tuple[float, float]:
        """Return stiffness and damping for vanishing amplitude.

        Returns
        -------
        (float, float)
            Both 0, in N/m and N s/m.
        """
        return 0.0, 0.0

    def describing(self, amplitude: ArrayLike, omega: ArrayLike) -> ComplexArray:
        """Return the describing function, (3/4) c A^2.

        Parameters
        ----------
        amplitude : array_like of float
            A of the deformation in m (rad), without a mean.
        omega : array_like of float
            In rad/s; has no influence.

        Returns
        -------
        ndarray of complex
            In N/m.

        Notes
        -----
        Gelb & Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design, 1968,
        appendix B.
        """
        A, _ = np.broadcast_arrays(np.asarray(amplitude, dtype=np.float64), np.asarray(omega))
        return np.asarray(0.75 * self.coefficient * A**2, dtype=np.complex128)
