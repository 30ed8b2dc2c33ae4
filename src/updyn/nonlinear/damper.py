"""`QuadraticDamper`: damping with the square of the velocity, as in turbulent flow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from updyn.arrays import RealArray
from updyn.nonlinear.element import AmplitudeElement, PeriodForce, check_number, diagonal

__all__ = ["QuadraticDamper"]


@dataclass(frozen=True, slots=True)
class QuadraticDamper(AmplitudeElement):
    """A damper with the force f = c |v| v.

    Parameters
    ----------
    coefficient : float
        c in N s2/m2 (N m s2/rad2), above 0.

    Raises
    ------
    OptionError
        If the coefficient is not above 0.

    Notes
    -----
    The describing function for the amplitude V of the velocity is 8 c V / (3 pi) (odd square law;
    Gelb & Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design, 1968,
    appendix B).

    Examples
    --------
    >>> import numpy as np
    >>> float(np.round(updyn.QuadraticDamper(3.0).describing(np.pi, 1.0).real, 12))
    8.0
    """

    coefficient: float

    parameters: ClassVar[tuple[str, ...]] = ("coefficient",)
    units: ClassVar[Mapping[str, str]] = {"coefficient": "N s2/m2"}
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

    def _describe(self, A: RealArray) -> RealArray:
        return np.asarray(8.0 * self.coefficient / (3.0 * np.pi) * A)
