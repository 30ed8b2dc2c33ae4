"""`JenkinsElement`: dry friction with the stiffness of its contact."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.nonlinear.element import check_number
from updyn.nonlinear.masing import MasingElement

__all__ = ["JenkinsElement"]


@dataclass(frozen=True, slots=True)
class JenkinsElement(MasingElement):
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

    Notes
    -----
    With cos b = 1 - 2 F / (k A), the describing function is (k / pi) (b - sin(2 b) / 2) + i (4 F /
    (pi A)) (1 - F / (k A)), and k below slip (Griffin, J. Eng. Power 102 (1980) 329).

    Examples
    --------
    >>> import numpy as np
    >>> np.round(updyn.JenkinsElement(10.0, 1.0).describing([0.1, 0.2], 1.0), 6)
    array([10.+0.j      ,  5.+3.183099j])
    """

    stiffness: float
    slip_force: float

    parameters: ClassVar[tuple[str, ...]] = ("stiffness", "slip_force")
    units: ClassVar[Mapping[str, str]] = {"stiffness": "N/m", "slip_force": "N"}

    def __post_init__(self) -> None:
        check_number("Jenkins element: stiffness", self.stiffness, "N/m")
        check_number("Jenkins element: slip_force", self.slip_force, "N")

    def _load(self, x: RealArray) -> tuple[RealArray, RealArray, RealArray]:
        """Return the initial loading curve."""
        sticks = self.stiffness * x < self.slip_force
        force = np.where(sticks, self.stiffness * x, self.slip_force)
        by = np.stack([np.where(sticks, x, 0.0), np.where(sticks, 0.0, 1.0)], axis=1)
        return force, np.where(sticks, self.stiffness, 0.0), by

    def _describe(self, A: RealArray) -> ComplexArray:
        share = np.minimum(self.slip_force / (self.stiffness * A), 1.0)
        b = np.arccos(1.0 - 2.0 * share)
        real = (b - 0.5 * np.sin(2.0 * b)) / np.pi
        return np.asarray(self.stiffness * (real + 4j / np.pi * share * (1.0 - share)))
