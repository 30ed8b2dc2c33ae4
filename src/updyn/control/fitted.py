"""Complex modes whose part in each output is fitted to the structure's answer over the band.

Where damping is so strong that modes overlap, what `updyn.control.complex_modes` leaves out at
negative frequencies is a smooth but not a small part of the answer in a band without a sharp peak.
The poles stay as they are, and so does what the inputs do to them; the rows of the outputs, a
feed-through and some real poles about the band are fitted by linear least squares to the answer,
the residue step of vector fitting (B. Gustavsen & A. Semlyen, IEEE Trans. Power Delivery 14 (1999)
1052-1061). Stable as before, and right in the band; outside of it no better than before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from updyn.control.complex_modes import ComplexModes
from updyn.control.conversion import Matrices, imaginary
from updyn.control.target import Target

__all__ = ["Fitted", "fitted"]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]

_TWO_PI = 2.0 * np.pi
#: The real poles lie up to this factor beyond the band.
_BEYOND = 3.0
#: Singular values below this share are left out: no large parts that cancel in the band and add up
#: outside.
_RANK = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """Complex modes and real poles with fitted outputs.

    Attributes
    ----------
    base : ComplexModes
        The modes.
    target : Target
        What is fitted, at its lines.
    extra : ndarray of float, shape (n,)
        Real poles, in rad/s; each has a state an input.
    """

    base: ComplexModes
    target: Target
    extra: _Real
    name: str = "complex"

    @property
    def frequency(self) -> _Real:
        """Natural frequency of each mode in Hz."""
        return self.base.frequency

    @property
    def always(self) -> NDArray[np.bool_]:
        """None: what is rigid is not among the candidates."""
        return self.base.always

    def costs(self, freq: _Real) -> _Real:
        """Return what leaving each mode out changes, before the fit."""
        return self.base.costs(freq)

    def response(self, kept: NDArray[np.bool_], freq: _Real) -> _Complex:
        """Return the response with some modes kept."""
        rows, through = self._fit(kept)
        moved = np.einsum("yk,fku->fyu", rows, self._states(kept, freq))
        return np.asarray(self.base.slow_response(imaginary(freq)) + moved + through)

    def matrices(self, kept: NDArray[np.bool_]) -> Matrices:
        """Return A, B, C, D: what is slow, a block of each pair of poles, real poles."""
        rows, through = self._fit(kept)
        A0, B0 = self.base.blocks(kept, self.base.at_inputs[:, kept])
        n_u = B0.shape[1]
        A = scipy.linalg.block_diag(A0, -np.diag(np.repeat(self.extra, n_u)))
        B = np.vstack([B0, *(rate * np.eye(n_u) for rate in self.extra)])
        return A, B, np.hstack([self.base.slow_rows(), rows]), through

    def _states(self, kept: NDArray[np.bool_], freq: _Real) -> _Complex:
        """Return the states of modes and real poles, shape (n_f, k, n_u), for unit inputs."""
        s, right = imaginary(freq), self.base.at_inputs[:, kept].T
        poles = self.base.poles[kept]
        up = right / (s[:, None, None] - poles[:, None])
        down = right.conj() / (s[:, None, None] - poles.conj()[:, None])
        pairs = (
            np.stack([up + down, 1j * (up - down)], axis=2).reshape(
                len(s), 2 * len(poles), len(right.T)
            )
            / 2.0
        )
        own = self.extra / (s[:, None] + self.extra)
        eye = np.eye(right.shape[1])
        return np.concatenate(
            [pairs, (own[:, :, None, None] * eye).reshape(len(s), -1, right.shape[1])], axis=1
        )

    def _fit(self, kept: NDArray[np.bool_]) -> tuple[_Real, _Real]:
        """Return the rows of the outputs on these states, and the feed-through."""
        target, n_u = self.target, len(self.base.at_inputs)
        states = self._states(kept, target.freq)
        wanted = target.values - self.base.slow_response(imaginary(target.freq))
        weight = 1.0 / np.maximum(target.broad, np.abs(target.values))
        rows, through = (
            np.zeros((len(self.base.powers), states.shape[1])),
            np.zeros((len(self.base.powers), n_u)),
        )
        eye = np.broadcast_to(np.eye(n_u), (len(states), n_u, n_u))
        for i, power in enumerate(self.base.powers):
            known = (
                states if power == 1 else np.concatenate([states, eye], axis=1)
            )  # no velocity jumps
            A = (known * weight[:, i, None, :]).transpose(0, 2, 1).reshape(-1, known.shape[1])
            b = (wanted[:, i] * weight[:, i]).ravel()
            real = np.vstack([A.real, A.imag])
            scale = np.maximum(np.linalg.norm(real, axis=0), 1e-300)
            found = (
                np.linalg.lstsq(real / scale, np.concatenate([b.real, b.imag]), rcond=_RANK)[0]
                / scale
            )
            rows[i] = found[: states.shape[1]]
            if power != 1:
                through[i] = found[states.shape[1] :]
        return rows, through


def fitted(base: ComplexModes, target: Target, n: int) -> Fitted:
    """Return complex modes with fitted outputs.

    Parameters
    ----------
    base : ComplexModes
        The modes.
    target : Target
        What to fit.
    n : int
        Number of real poles, even on a logarithmic scale.
    """
    low, high = max(target.freq[0], 1e-3 * target.freq[-1]) / _BEYOND, target.freq[-1] * _BEYOND
    return Fitted(base, target, _TWO_PI * np.geomspace(low, high, n))
