"""`Weight`: a stable, minimum-phase transfer function as zeros, poles and gain, and in state space."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from updyn.control.weight_fit import Bound

__all__ = ["Weight", "roots_of"]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]


@dataclass(frozen=True, slots=True, eq=False)
class Weight:
    """A stable, minimum-phase transfer function W(s) = gain * prod (s - zeros) / prod (s - poles).

    Attributes
    ----------
    zeros, poles : ndarray of complex, shape (order,)
        In rad/s, all in the left half plane; of an odd order the first is a single real one, then
        come pairs.
    gain : float
        W at infinity.
    largest, mean : float
        Largest excess |W| / l of a line, and its geometric mean over log frequency; l counts as the
        floor where it is below.
    peak : float
        Largest l.
    peak_at : float
        Where, in Hz.
    note : str
        What to know of this channel.
    A, B, C, D : ndarray of float, shapes (order, order), (order, 1), (1, order), (1, 1)
        In state space, sections in series, time in s: ``control.ss(w.A, w.B, w.C, w.D)`` in
        python-control.
    """

    zeros: _Complex
    poles: _Complex
    gain: float
    largest: float = 1.0
    mean: float = 1.0
    peak: float = 0.0
    peak_at: float = 0.0
    note: str = ""
    A: _Real = field(init=False, repr=False)
    B: _Real = field(init=False, repr=False)
    C: _Real = field(init=False, repr=False)
    D: _Real = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for name, array in zip("ABCD", _series(self.zeros, self.poles, self.gain), strict=True):
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def __repr__(self) -> str:
        return (
            f"Weight(order {self.order}, at most {self.largest:.3g} times what it bounds,"
            f" {self.mean:.3g} in the mean)"
        )

    @property
    def order(self) -> int:
        """Number of poles."""
        return len(self.poles)

    def at(self, freq: ArrayLike) -> _Complex:
        """Return W at lines.

        Parameters
        ----------
        freq : array_like of float, shape (n_f,)
            In Hz.

        Returns
        -------
        ndarray of complex, shape (n_f,)
        """
        s = 2j * np.pi * np.atleast_1d(np.asarray(freq, dtype=np.float64))[:, None]
        return np.asarray(self.gain * np.prod((s - self.zeros) / (s - self.poles), axis=1))


def roots_of(bound: Bound, lift: float = 0.0) -> tuple[_Complex, _Complex, float]:
    """Return zeros and poles in rad/s, and the gain, of a bound.

    Parameters
    ----------
    bound : Bound
        In sections.
    lift : float
        Logarithm by which it is raised.

    Returns
    -------
    zeros, poles : ndarray of complex, shape (order,)
    gain : float
    """
    zeros: list[complex] = []
    poles: list[complex] = []
    gain = float(np.exp(bound.p[0] + lift))
    at = 1
    if bound.order % 2:
        wz, wp = np.exp(bound.p[1:3])
        zeros.append(complex(-wz))
        poles.append(complex(-wp))
        gain *= wp / wz
        at = 3
    for w_zero, d_zero, w_pole, d_pole in np.exp(bound.p[at:]).reshape(-1, 4):
        zeros += _pair(w_zero, d_zero)
        poles += _pair(w_pole, d_pole)
        gain *= (w_pole / w_zero) ** 2
    return np.array(zeros, dtype=np.complex128), np.array(poles, dtype=np.complex128), gain


def _pair(w: float, damping: float) -> list[complex]:
    """Return the roots of s^2 + 2 damping w s + w^2, the real ones without cancellation."""
    if damping < 1.0:
        turn = np.sqrt(1.0 - damping**2)
        return [complex(-w * damping, w * turn), complex(-w * damping, -w * turn)]
    far = -w * (damping + np.sqrt(damping**2 - 1.0))
    return [complex(w**2 / far), complex(far)]


def _series(zeros: _Complex, poles: _Complex, gain: float) -> tuple[_Real, _Real, _Real, _Real]:
    """Return A, B, C, D of sections in series, each of the scale of its own poles."""
    A, B, C, D = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[float(gain)]])
    first = len(poles) % 2
    cuts = [slice(0, 1)] * first + [slice(k, k + 2) for k in range(first, len(poles), 2)]
    for cut in cuts:
        a, b, c = _section(zeros[cut], poles[cut])
        # The section takes what the ones before it give.
        A = np.block([[A, np.zeros((len(A), len(a)))], [b @ C, a]])
        B = np.vstack([B, b @ D])
        C = np.hstack([C, c])
    return A, B, C, D


def _section(zeros: _Complex, poles: _Complex) -> tuple[_Real, _Real, _Real]:
    """Return A, B, C of one section whose D is 1."""
    if len(poles) == 1:
        pole, zero = float(poles[0].real), float(zeros[0].real)
        return np.array([[pole]]), np.array([[1.0]]), np.array([[pole - zero]])
    a1, a0 = -float(poles.sum().real), float(np.prod(poles).real)
    b1, b0 = -float(zeros.sum().real), float(np.prod(zeros).real)
    w = float(np.sqrt(a0))
    return (
        np.array([[0.0, w], [-w, -a1]]),
        np.array([[0.0], [1.0]]),
        np.array([[(b0 - a0) / w, b1 - a1]]),
    )
