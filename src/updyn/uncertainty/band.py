"""`Band`: an FRF that was predicted, and how surely; pure data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.errors import DataError
from updyn.frf import FRF

__all__ = ["Band"]

_Real = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """A predicted FRF with its band; all arrays of shape (n_f, n_responses, n_references).

    Attributes
    ----------
    frf : FRF
        The answer of the updated model.
    level : float
        Share of the probability within the band, at every value by itself.
    source : {"Laplace", "bootstrap", "sampling"}
        Where the spread of the unknowns comes from.
    with_noise : bool
        Whether the band is about a measurement (True) or about the structure (False).
    lower, upper : ndarray of float
        Of the magnitude, in the unit of the FRF; 0 and inf where the data leave it open.
    phase_lower, phase_upper : ndarray of float
        Of the phase, in rad, about the angle of `frf`; they may go beyond pi.
    std_real, std_imag : ndarray of float
        Standard deviations of real and imaginary part, in the unit of the FRF.
    """

    frf: FRF
    level: float
    source: str
    with_noise: bool
    lower: _Real
    upper: _Real
    phase_lower: _Real
    phase_upper: _Real
    std_real: _Real
    std_imag: _Real

    def __repr__(self) -> str:
        about = "a measurement" if self.with_noise else "the structure"
        return f"Band({100 * self.level:g} % of {about}, {self.source}, {self.frf!r})"

    def covers(self, other: FRF) -> NDArray[np.bool_]:
        """Return which magnitudes of an FRF lie within the band, shape (n_f, n_responses, n_references).

        Parameters
        ----------
        other : FRF
            At the same lines, of the same quantity and DOFs, in any order.

        Raises
        ------
        DataError
            If it differs in lines or quantity.
        DofError
            If it lacks a response or a reference.
        """
        if other.quantity != self.frf.quantity:
            raise DataError(
                f"the band is about {self.frf.quantity}, the FRF about {other.quantity}"
            )
        same = other.select(
            lines=self.frf.freq, responses=self.frf.responses, references=self.frf.references
        )
        size = np.abs(same.values)
        return np.asarray((size >= self.lower) & (size <= self.upper))
