"""Variances that were themselves estimated, line by line, from few averages: made steady without losing their shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Steady", "steady"]

_Real = NDArray[np.float64]

#: Degrees of freedom that a variance should rest on, and what stands out from the lines around it.
_FREEDOM, _APART = 48, 10.0
#: Of the fit of two parts: steps, lines, knots along the lines.
_STEPS, _SAMPLES, _KNOTS = 100, 400, 8


@dataclass(frozen=True, slots=True, eq=False)
class Steady:
    """A variance floor + relative |H|^2, smooth where it was noisy.

    Attributes
    ----------
    floor : ndarray of float, shape (n_f, ...)
        The part that does not depend on |H|, in the unit of the data squared.
    relative : ndarray of float, shape (n_f, ...)
        The other, over |H|^2.
    """

    floor: _Real
    relative: _Real

    def at(self, size: _Real, lines: slice | NDArray[np.intp] = slice(None)) -> _Real:
        """Return the variance where the model has magnitudes `size`, shape (n_f, ...), at some of the lines."""
        return np.asarray(self.floor[lines] + self.relative[lines] * size**2)


def steady(variance: _Real, size: _Real, freedom: int) -> Steady:
    """Return a steady form of variances that scatter as chi-square.

    Two parts, one of them proportional to |H|^2, both piecewise linear along the lines, are fitted
    to each channel by the likelihood of variances that scatter in proportion to themselves (the
    Itakura-Saito divergence, by the multiplicative steps of Fevotte, Bertin & Durrieu, Neural
    Computation 21 (2009) 793, with the exponent 1/2 with which they descend). What the lines hold
    beyond them is a mean over neighbouring lines. A line that stands out by a factor of ten from
    the median around it keeps its own: it is a hum or a glitch, not scatter.

    Parameters
    ----------
    variance : ndarray of float, shape (n_f, ...)
        Estimates above 0, independent from line to line, in the unit of the data squared.
    size : ndarray of float, shape (n_f, ...)
        Magnitude |H_X| of the data.
    freedom : int
        Complex degrees of freedom of each estimate: it scatters as Gamma(freedom) / freedom.

    Returns
    -------
    Steady
        Such that the mean of its inverse is the inverse of the variance, so that it makes unbiased
        weights: for a mean of d Gamma(1) the mean of the inverse is d / (d - 1) too large.
    """
    from scipy.ndimage import uniform_filter1d

    width = min(-(-_FREEDOM // freedom), len(variance) // 4) // 2 * 2 + 1
    floor, relative = _parts(variance, size, freedom, max(width, 7))
    ratio = variance / (floor + relative * size**2)
    usual = _usual(ratio, max(width, 7))
    share = uniform_filter1d(usual.astype(float), width, axis=0, mode="reflect")
    total = uniform_filter1d(np.where(usual, ratio, 0.0), width, axis=0, mode="reflect")
    smooth = np.where(usual, total / np.maximum(share, 1e-9), ratio)
    rests_on = np.where(usual, np.maximum(share * width, 1.0), 1.0) * freedom
    smooth *= rests_on / np.maximum(rests_on - 1.0, 0.5)
    return Steady(floor * smooth, relative * smooth)


def _usual(ratio: _Real, width: int) -> NDArray[np.bool_]:
    """Return where a ratio, shape (n_f, ...), does not stand out from its median over `width` lines."""
    from scipy.ndimage import median_filter

    around = median_filter(ratio, size=(width, *(1,) * (ratio.ndim - 1)), mode="reflect")
    return np.asarray(ratio <= _APART * around)


def _parts(variance: _Real, size: _Real, freedom: int, width: int) -> tuple[_Real, _Real]:
    """Return floor and relative of v = floor + relative |H|^2, each of shape (n_f, ...)."""
    n_f, channels = len(variance), variance.shape[1:]
    knots = int(np.clip(n_f * freedom // _FREEDOM, 1, _KNOTS))
    hats = _hats(n_f, knots)
    v = variance.reshape(n_f, int(np.prod(channels)))
    s = np.maximum(size.reshape(v.shape), np.finfo(float).tiny ** 0.25) ** 2
    level = s.mean(axis=0)
    s = s / level
    floor = np.tile(np.median(v, axis=0), (knots, 1))
    relative = np.tile(np.median(v / s, axis=0), (knots, 1))
    usual = _usual(v / (floor[0] + relative[0] * s), width)
    every = slice(None, None, -(-n_f // _SAMPLES))
    v, s, hat, counts = v[every], s[every], hats[every], usual[every].astype(float)
    for _ in range(_STEPS):
        model = hat @ floor + (hat @ relative) * s
        excess, inverse = counts * v / model**2, counts / model
        gains = [np.sqrt((hat.T @ (b * excess)) / (hat.T @ (b * inverse))) for b in (1.0, s)]
        floor, relative = floor * gains[0], relative * gains[1]
    return (hats @ floor).reshape(n_f, *channels), (hats @ (relative / level)).reshape(
        n_f, *channels
    )


def _hats(n_f: int, knots: int) -> _Real:
    """Return `knots` piecewise linear functions over the lines, shape (n_f, knots), whose sum is 1."""
    if knots == 1:
        return np.ones((n_f, 1))
    at = np.linspace(0.0, knots - 1.0, n_f)
    return np.maximum(1.0 - np.abs(at[:, None] - np.arange(knots)), 0.0)
