"""`Conversion`: a way to turn structural damping into poles, as candidates that a plant may keep or leave out."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["Conversion", "Matrices", "imaginary", "rates"]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]

#: A, B, C, D.
Matrices = tuple[_Real, _Real, _Real, _Real]


class Conversion(Protocol):
    """What `updyn.control.order` chooses from.

    A candidate that is left out still gives its static flexibility where the output is a
    displacement.
    """

    @property
    def name(self) -> str:
        """What it is called."""

    @property
    def frequency(self) -> _Real:
        """Natural frequency of each candidate in Hz, shape (n,)."""

    @property
    def always(self) -> NDArray[np.bool_]:
        """Which candidates are never left out: rigid-body motion."""

    def costs(self, freq: _Real) -> _Real:
        """Return what leaving each candidate out changes, by channel, shape (n, n_y, n_u): largest over some lines."""

    def response(self, kept: NDArray[np.bool_], freq: _Real) -> _Complex:
        """Return the response with some candidates kept, shape (n_f, n_y, n_u)."""

    def matrices(self, kept: NDArray[np.bool_]) -> Matrices:
        """Return A, B, C, D with some candidates kept, all real."""


def imaginary(freq: _Real) -> _Complex:
    """Return s = i omega at lines in Hz."""
    return np.asarray(2j * np.pi * freq, dtype=np.complex128)


def rates(powers: NDArray[np.intp], s: _Complex) -> _Complex:
    """Return s to the power of each output, shape (n_f, n_y, 1): displacement, velocity, acceleration."""
    return np.asarray((s[:, None] ** powers)[:, :, None])
