"""`NonlinearElement`: the protocol of nonlinear elements, and their force over one period.

An element exerts the force f on the structure, against its deformation u (a displacement or a
rotation, or a difference of such). It is given one period of u and of the velocity v at equidistant
samples, and returns the steady force with its derivatives: the "time" half of the alternating
frequency-time method (Cameron & Griffin, J. Appl. Mech. 56 (1989) 149). An element with memory
returns the steady loop.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from updyn.arrays import ComplexArray, RealArray
from updyn.errors import OptionError
from updyn.group import is_number

__all__ = ["AmplitudeElement", "NonlinearElement", "PeriodForce", "check_number", "diagonal"]


@dataclass(frozen=True, slots=True, eq=False)
class PeriodForce:
    """The force of an element at n samples of a period, in N (N m), with its derivatives.

    Parameters
    ----------
    force : ndarray, shape (n,)
        Force at each sample.
    stiffness : sparse array, shape (n, n)
        Derivative of each force with respect to each deformation, in N/m; diagonal without memory.
    damping : ndarray, shape (n,)
        Derivative of each force with respect to the velocity of that sample, in N s/m.
    parameters : ndarray, shape (n, n_p)
        Derivative with respect to each of the element's `parameters`.
    """

    force: RealArray
    stiffness: sp.csr_array
    damping: RealArray
    parameters: RealArray


class NonlinearElement(Protocol):
    """A nonlinear force between one deformation and its velocity.

    Implementations are frozen dataclasses with numbers as fields, registered in
    `updyn.nonlinear.ELEMENTS`.
    """

    #: Names of the fields that `PeriodForce.parameters` differentiates by.
    parameters: ClassVar[tuple[str, ...]]
    #: Their units by name, of displacements in m; those without a unit may be left out.
    units: ClassVar[Mapping[str, str]]
    #: Whether the force depends on earlier deformations.
    has_memory: ClassVar[bool]
    #: Argument of the describing function: ``"receptance"`` for the amplitude of the deformation,
    #: ``"mobility"`` for that of the velocity.
    quantity: ClassVar[str]

    @property
    def is_odd(self) -> bool:
        """Whether the force changes its sign with the motion."""

    def over_period(self, u: RealArray, v: RealArray) -> PeriodForce:
        """Return the steady force.

        Parameters
        ----------
        u : ndarray, shape (n,)
            Deformation in m (rad), at n equidistant samples of one period.
        v : ndarray, shape (n,)
            Velocity in m/s (rad/s).

        Returns
        -------
        PeriodForce
        """

    def at_rest(self) -> tuple[float, float]:
        """Return stiffness and damping for vanishing amplitude.

        Returns
        -------
        (float, float)
            In N/m and N s/m.
        """

    def describing(self, amplitude: ArrayLike, omega: ArrayLike) -> ComplexArray:
        """Return the describing function, the first harmonic of the force over that of the motion.

        Parameters
        ----------
        amplitude : array_like of float
            Amplitude of `quantity`: m or m/s (rad or rad/s).
        omega : array_like of float
            In rad/s; broadcast with `amplitude`.

        Returns
        -------
        ndarray of complex
            In N/m or N s/m; nan if no closed form exists.
        """


class AmplitudeElement(ABC):
    """Base of elements whose describing function is the same at every frequency."""

    __slots__ = ()

    def describing(self, amplitude: ArrayLike, omega: ArrayLike) -> ComplexArray:
        """Return the describing function, the first harmonic of the force over that of the motion.

        Parameters
        ----------
        amplitude : array_like of float
            Amplitude of `quantity`, above 0 and without a mean: m or m/s (rad or rad/s).
        omega : array_like of float
            In rad/s; has no influence.

        Returns
        -------
        ndarray of complex
            In N/m or N s/m (N m/rad or N m s/rad).
        """
        A, _ = np.broadcast_arrays(np.asarray(amplitude, dtype=np.float64), np.asarray(omega))
        return np.asarray(self._describe(A), dtype=np.complex128)

    @abstractmethod
    def _describe(self, A: RealArray) -> RealArray | ComplexArray:
        """Return the describing function at some amplitudes."""


def diagonal(values: RealArray) -> sp.csr_array:
    """Return a sparse diagonal matrix, shape (n, n)."""
    n = len(values)
    return sp.csr_array((values, np.arange(n), np.arange(n + 1)), shape=(n, n))


def check_number(what: str, value: object, unit: str, *, least: float | None = None) -> None:
    """Raise OptionError unless `value` is above 0, or at least `least` if that is given."""
    if is_number(value) and math.isfinite(value):
        is_allowed = value > 0.0 if least is None else value >= least
        if is_allowed:
            return
    limit = "above 0" if least is None else f"of at least {least:g}"
    if least == -math.inf:
        limit = "that is finite"
    raise OptionError(f"{what} is {value!r}; expected a number {limit}, in {unit}")
