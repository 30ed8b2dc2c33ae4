"""`CubicSpring`: a stiffness that grows or falls with the square of the amplitude."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from updyn.nonlinear.element import check_number
from updyn.nonlinear.polynomial import PolynomialForce

__all__ = ["CubicSpring"]


@dataclass(frozen=True, slots=True)
class CubicSpring(PolynomialForce):
    """A spring with the force f = c u^3, without a linear part.

    Parameters
    ----------
    coefficient : float
        c in N/m^3 (N m/rad^3); a negative one softens.

    Raises
    ------
    OptionError
        If the coefficient is not finite.

    Notes
    -----
    The describing function is (3/4) c A^2, see `PolynomialSpring`.

    Examples
    --------
    >>> updyn.CubicSpring(4.0).describing(0.5, 1.0)
    array(0.75+0.j)
    """

    coefficient: float

    parameters: ClassVar[tuple[str, ...]] = ("coefficient",)
    units: ClassVar[Mapping[str, str]] = {"coefficient": "N/m^3"}

    def __post_init__(self) -> None:
        check_number("cubic spring: coefficient", self.coefficient, "N/m^3", least=-np.inf)

    def _terms(self) -> Mapping[int, float]:
        return {3: self.coefficient}
