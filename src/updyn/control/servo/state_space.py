"""`StateSpace`: a linear system, put together from smaller ones; and the Pade approximation of a dead time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb, factorial

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from updyn.errors import OptionError

__all__ = ["StateSpace", "balanced", "connect", "delay_approximation"]

_Real = NDArray[np.float64]

#: Largest scale of a state, as a power of 2.
_LARGEST = 40.0


@dataclass(frozen=True, slots=True, eq=False)
class StateSpace:
    """x' = A x + B u, y = C x + D u.

    Attributes
    ----------
    A, B, C, D : ndarray of float, shapes (n, n), (n, n_u), (n_y, n), (n_y, n_u)
        In SI units, time in s.
    """

    A: _Real
    B: _Real
    C: _Real
    D: _Real

    @classmethod
    def gain(cls, value: float) -> StateSpace:
        """Return a system without states, from one input to one output."""
        return cls(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[float(value)]]))

    def __mul__(self, first: StateSpace) -> StateSpace:
        """Return this system behind another."""
        A = np.block(
            [[first.A, np.zeros((len(first.A), len(self.A)))], [self.B @ first.C, self.A]],
        )
        return StateSpace(
            A,
            np.vstack([first.B, self.B @ first.D]),
            np.hstack([self.D @ first.C, self.C]),
            self.D @ first.D,
        )

    @property
    def n_states(self) -> int:
        """Order n."""
        return len(self.A)

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Eigenvalues of A in rad/s, shape (n,)."""
        return np.asarray(np.linalg.eigvals(balanced(self.A)[0]), dtype=np.complex128)


def balanced(A: _Real) -> tuple[_Real, _Real]:
    """Return A in states of like size, and the scales: x = scale * (its states), powers of 2.

    The scales of parts that act one way only have no bounds of their own; they are given some.

    Parameters
    ----------
    A : ndarray of float, shape (n, n)
        Of a system.

    Returns
    -------
    A : ndarray of float, shape (n, n)
    scale : ndarray of float, shape (n,)
    """
    if not len(A):
        return A, np.ones(0)
    with np.errstate(
        invalid="ignore"
    ):  # scipy takes the scales for positions, too, and drops them again
        scale = scipy.linalg.matrix_balance(A, permute=False, separate=True)[1][0]
    power = np.log2(scale)
    scale = np.exp2(np.clip(np.round(power - np.median(power)), -_LARGEST, _LARGEST))
    return A * scale / scale[:, None], scale


def connect(
    blocks: Sequence[StateSpace], wires: _Real, entries: _Real, taps: _Real | None = None
) -> StateSpace:
    """Return the system that blocks make when outputs are led to inputs.

    With u and y the inputs and outputs of all blocks, one below the other: u = wires y + entries w.

    Parameters
    ----------
    blocks : sequence of StateSpace
        The blocks.
    wires : ndarray of float, shape (n_u, n_y)
        What reaches each input from each output.
    entries : ndarray of float, shape (n_u, n_w)
        What reaches each input from outside.
    taps : ndarray of float, shape (n_z, n_y), optional
        What is read; by default all outputs.

    Raises
    ------
    OptionError
        If the loop is algebraic and its gain is exactly that at which nothing follows from it.
    """
    A, B, C, D = (scipy.linalg.block_diag(*(getattr(b, name) for b in blocks)) for name in "ABCD")
    # y = C x + D (wires y + entries w)
    around = D @ wires
    solved = np.eye(len(D)) - around
    largest = float(
        np.abs(np.linalg.eigvals(around)).max(initial=1.0)
    )  # unlike a condition number, without units
    if abs(np.linalg.det(solved)) < 1e-12 * largest:
        raise OptionError(
            "the loop is algebraic: torque and motion feed each other without delay, with a gain"
            " of -1"
        )
    C_all, D_all = np.linalg.solve(solved, C), np.linalg.solve(solved, D @ entries)
    taps = np.eye(len(D)) if taps is None else taps
    return StateSpace(
        A + B @ wires @ C_all, B @ (entries + wires @ D_all), taps @ C_all, taps @ D_all
    )


def delay_approximation(delay: float, order: int) -> StateSpace:
    """Return the diagonal Pade approximation of exp(-s delay), an all-pass.

    Parameters
    ----------
    delay : float
        In s, above 0.
    order : int
        Order of numerator and denominator, 1 to 12.

    Notes
    -----
    Golub & Van Loan, Matrix Computations, 3rd ed. (1996), section 11.3.1, at -s delay. In factors
    of second order, so that high orders stay well scaled.
    """
    if not 1 <= order <= 12:
        raise OptionError(f"pade order {order!r}; expected 1 to 12")
    coefficients = [
        comb(order, k) * factorial(2 * order - k) / factorial(2 * order) for k in range(order + 1)
    ]
    poles = np.roots(coefficients[::-1])
    out = StateSpace.gain(1.0)
    for pole in poles[poles.imag > 1e-9]:
        out = _all_pass(-2.0 * pole.real / delay, abs(pole) ** 2 / delay**2) * out
    for pole in poles[np.abs(poles.imag) <= 1e-9]:
        a = -pole.real / delay  # (a - s) / (a + s) = -1 + 2 a / (s + a)
        out = (
            StateSpace(np.array([[-a]]), np.ones((1, 1)), np.array([[2.0 * a]]), -np.ones((1, 1)))
            * out
        )
    return out


def _all_pass(a: float, b: float) -> StateSpace:
    """Return (s^2 - a s + b) / (s^2 + a s + b)."""
    w = np.sqrt(b)
    return StateSpace(
        np.array([[0.0, w], [-w, -a]]),
        np.array([[0.0], [1.0]]),
        np.array([[0.0, -2.0 * a]]),
        np.ones((1, 1)),
    )
