"""Log error of FRFs that are smoothed along the lines, model and data alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.updating.problem.problem import Block, Part
from updyn.updating.problem.residuals import LineResidual, clear_of_noise

__all__ = ["SmoothedLogError"]

_Vector = NDArray[np.float64]
_Complex = NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class SmoothedLogError(LineResidual):
    """r = w ln(S H_A / S H_X) with one linear smoothing S along the lines.

    A resonance of model and data that stand apart by more than their widths pull at each other only
    if both are as wide as their distance. Smoothed FRFs have such resonances, so that the error has
    few minima; and as S is linear and the same on both sides, the truth is a minimum at any width.
    (A loss factor widens the resonances of the model alone.)

    Parameters
    ----------
    width : float
        Standard deviation of the Gaussian window in the logarithm of frequency.
    name : str
        How the report calls it.
    """

    width: float
    name: str = "smoothed log"

    @property
    def cache_key(self) -> str:
        """The width."""
        return f"width={self.width!r}"

    def partition(self, part: Part) -> list[slice]:
        """Return all lines as one block: each smoothed line needs those around it."""
        return [slice(0, part.n_lines)]

    def block(self, part: Part, x: _Vector, lines: slice) -> tuple[_Complex, _Complex]:
        """Return residual and derivatives at all lines."""
        blocks = list(part.blocks(x))
        window = _window(part.frf.freq, self.width)
        H = _smoothed(window, np.concatenate([block.H for block in blocks]))
        X = _smoothed(window, part.frf.values)
        assert part.frf.variance is not None
        variance = np.tensordot(window**2, part.frf.variance, axes=1)
        usable = (H != 0) & (X != 0)
        weight = np.where(usable, clear_of_noise(X, variance, part.frf), 0.0)
        H = np.where(usable, H, 1.0)
        slope = weight / H
        J = np.stack([slope * _smoothed(window, dH) for dH in _derivatives(blocks)])
        return weight * np.log(H / np.where(usable, X, 1.0)), J


def _derivatives(blocks: list[Block]) -> list[_Complex]:
    """Return the derivatives by each unknown, shape (n_f, n_i, n_j)."""
    parts = [block.dH for block in blocks if block.dH is not None]
    return [np.concatenate([dH[i] for dH in parts]) for i in range(len(parts[0]))]


def _window(freq: NDArray[np.float64], width: float) -> NDArray[np.float64]:
    """Return the smoothing S, shape (n_f, n_f); its rows add up to 1."""
    lowest = freq[freq > 0].min(initial=np.inf)
    at = np.log(np.maximum(freq, 0.5 * lowest if np.isfinite(lowest) else 1.0))
    window = np.exp(-0.5 * ((at[:, None] - at) / width) ** 2)
    if len(at) > 1:
        window = window * np.gradient(at)  # lines that stand close count less each
    return np.asarray(window / window.sum(axis=1, keepdims=True))


def _smoothed(window: NDArray[np.float64], values: _Complex) -> _Complex:
    flat = np.ascontiguousarray(values).reshape(len(values), -1)
    return (window @ flat.view(np.float64)).view(np.complex128).reshape(values.shape)
