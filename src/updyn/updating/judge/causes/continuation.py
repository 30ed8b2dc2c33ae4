"""Analytic continuation of measured FRFs from i omega + a to i omega, by local rational models."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from updyn.frf import FRF

__all__ = ["continued"]

#: Lines on either side of each that its local model is fitted to, and degrees of its numerators
#: and of its common denominator.
_SIDE, _ABOVE, _BELOW = 4, 2, 2


def continued(frf: FRF, shift: float) -> FRF:
    """Return FRFs on the axis of real frequency, from those on a line beside it.

    At every line a rational function of s with one denominator for all channels is fitted to the
    lines about it, (n_0 + n_1 d + n_2 d^2) / (1 + b_1 d + b_2 d^2) with d the distance, by linear
    least squares (local rational method: McKelvey & Guerin, IFAC SysId 2012), and taken at
    d = -shift.

    Parameters
    ----------
    frf : FRF
        H(i omega + shift), at nine lines at least.
    shift : float
        In 1/s; what an exponential window exp(-shift t) on all records leaves.

    Returns
    -------
    FRF
        H(i omega).
    """
    n = len(frf.freq)
    omega = 2.0 * np.pi * frf.freq
    flat = frf.values.reshape(n, -1)
    size = np.sqrt(np.mean(np.abs(flat) ** 2, axis=0))
    flat = flat / np.where(size > 0.0, size, 1.0)
    out = np.empty_like(flat)
    width = min(2 * _SIDE + 1, n)
    for line in range(n):
        first = min(max(line - _SIDE, 0), n - width)
        near = slice(first, first + width)
        out[line] = _at(1j * (omega[near] - omega[line]), flat[near], -shift)
    values = (out * np.where(size > 0.0, size, 1.0)).reshape(frf.values.shape)
    return replace(frf, values=values)


def _at(d: NDArray[np.complex128], H: NDArray[np.complex128], to: float) -> NDArray[np.complex128]:
    """Return the local model of each channel at one distance, shape (n_c,)."""
    unit = np.abs(d).max()
    d, to = d / unit, to / unit
    powers = d[:, None] ** np.arange(_ABOVE + 1)
    Q = np.linalg.qr(powers)[0]
    # The numerators are linear in the data: what they cannot follow tells the denominator.
    left = H - Q @ (Q.conj().T @ H)
    columns = [H * d[:, None] ** k for k in range(1, _BELOW + 1)]
    columns = [c - Q @ (Q.conj().T @ c) for c in columns]
    weight = 1.0 / np.maximum(np.abs(H).max(axis=0), np.finfo(float).tiny)
    A = np.stack([(c * weight).ravel() for c in columns], axis=1)
    b = np.linalg.lstsq(A, -(left * weight).ravel(), rcond=None)[0]
    below = 1.0 + sum(b[k - 1] * d**k for k in range(1, _BELOW + 1))
    above = np.linalg.lstsq(powers, H * below[:, None], rcond=None)[0]
    there = to ** np.arange(_ABOVE + 1)
    return np.asarray(there @ above / (1.0 + sum(b[k - 1] * to**k for k in range(1, _BELOW + 1))))
