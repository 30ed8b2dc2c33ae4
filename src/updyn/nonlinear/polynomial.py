"""`PolynomialSpring`: stiffness that changes with amplitude, as a polynomial."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from scipy.special import gamma

from updyn.arrays import RealArray
from updyn.errors import OptionError
from updyn.nonlinear.element import AmplitudeElement, PeriodForce, check_number, diagonal

__all__ = ["PolynomialForce", "PolynomialSpring"]


class PolynomialForce(AmplitudeElement):
    """Base of springs whose force is a polynomial of the deformation."""

    __slots__ = ()

    has_memory: ClassVar[bool] = False
    quantity: ClassVar[str] = "receptance"

    @abstractmethod
    def _terms(self) -> Mapping[int, float]:
        """Return the coefficients by power."""

    @property
    def is_odd(self) -> bool:
        """Whether all powers are odd."""
        return all(power % 2 for power in self._terms())

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
            Its derivatives by parameters are by the coefficients, in their order.
        """
        force, slope, columns = np.zeros_like(u), np.zeros_like(u), []
        for power, value in self._terms().items():
            lower = u ** (power - 1)
            columns.append(lower * u)
            force += value * columns[-1]
            slope += power * value * lower
        return PeriodForce(force, diagonal(slope), np.zeros_like(u), np.stack(columns, axis=1))

    def at_rest(self) -> tuple[float, float]:
        """Return stiffness and damping for vanishing amplitude.

        Returns
        -------
        (float, float)
            In N/m and N s/m.
        """
        return float(self._terms().get(1, 0.0)), 0.0

    def _describe(self, A: RealArray) -> RealArray:
        out = np.zeros(A.shape)
        for power, value in self._terms().items():
            if power % 2:
                out += value * _describe_power(power) * A ** (power - 1)
        return out


@dataclass(frozen=True, slots=True)
class PolynomialSpring(PolynomialForce):
    """A spring with the force f = sum of c_p u^p.

    Parameters
    ----------
    coefficients : mapping of int to float
        Coefficient c_p in N/m^p by the power p, 1 or above. Negative ones soften.

    Raises
    ------
    OptionError
        If a power is not a whole number of at least 1, or a coefficient is not finite.

    Notes
    -----
    The describing function is the sum of b_p c_p A^(p - 1) over odd powers p, with b_p = (2 / pi)
    integral of sin^(p + 1) over half a period: 3/4 for p = 3 and 5/8 for p = 5 (Gelb & Vander
    Velde, Multiple-Input Describing Functions and Nonlinear System Design, 1968, appendix B).

    Examples
    --------
    >>> import numpy as np
    >>> spring = updyn.PolynomialSpring({3: 4.0, 5: -8.0})
    >>> spring.describing(1.0, 1.0)
    array(-2.+0.j)
    """

    coefficients: Mapping[int, float]

    parameters: ClassVar[tuple[str, ...]] = ("coefficients",)
    units: ClassVar[Mapping[str, str]] = {"coefficients": "N/m^p"}

    def __post_init__(self) -> None:
        if not isinstance(self.coefficients, Mapping) or not self.coefficients:
            raise OptionError(
                f"polynomial spring: coefficients {self.coefficients!r}; expected a mapping of"
                " powers to numbers"
            )
        for power, value in self.coefficients.items():
            if not isinstance(power, int) or isinstance(power, bool) or power < 1:
                raise OptionError(
                    f"polynomial spring: power {power!r}; expected a whole number of at least 1"
                )
            check_number(f"polynomial spring: power {power}", value, "N/m^p", least=-np.inf)
        object.__setattr__(self, "coefficients", MappingProxyType(dict(self.coefficients)))

    def __reduce__(self) -> tuple[object, ...]:
        return PolynomialSpring, (dict(self.coefficients),)

    def _terms(self) -> Mapping[int, float]:
        return self.coefficients


def _describe_power(power: float) -> float:
    """Return the first harmonic of |sin|^p sign(sin), for a real power p."""
    return float(2.0 / np.sqrt(np.pi) * gamma(0.5 * power + 1.0) / gamma(0.5 * power + 1.5))
