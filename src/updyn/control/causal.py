"""Lower bound on the error of any stable plant over a band, with its gain outside limited.

Structural damping is not causal; without a limit on its gain outside, a stable plant approximates H
in the band arbitrarily well. Let |W| be eps times the reference of the errors in the band and the
limit g outside, W outer, and F = H in the band, 0 outside. A stable G with |G - F| <= |W| exists if
and only if the Hankel operator of F / W has a norm of at most 1 (Z. Nehari, Annals of Mathematics
65 (1957) 153-162; for a band, L. Baratchart, J. Leblond & J. R. Partington, Constructive
Approximation 12 (1996) 423-435). Bisection gives the least eps.

On the unit circle, s = i omega_0 tan(theta / 2), a section of the Hankel matrix has at most the
norm of the operator, so the result is a lower bound up to the resolution of the circle. It is
computed for the difference from a known plant, which is small and smooth at resonances.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.optimize import brentq
from scipy.sparse.linalg import LinearOperator, eigsh

from updyn.arrays import ComplexArray, IndexArray, RealArray
from updyn.control.settings import CAUSAL_BOUND
from updyn.control.space import Conversion
from updyn.control.target import CandidateSelection

__all__ = [
    "ChannelDifference",
    "Circle",
    "channel_differences",
    "error_lower_bound",
    "hankel_norm",
]

_TWO_PI = 2.0 * np.pi


@dataclass(frozen=True, slots=True)
class Circle:
    """Evenly spaced points of the unit circle as frequencies; their number n is a power of 2.

    `scale` is the frequency in Hz at a right angle, `margin` the width of the margins of the band,
    as a logarithm of frequency.
    """

    n: int
    scale: float
    margin: float = CAUSAL_BOUND.margin_width

    @classmethod
    def of(cls, band: tuple[float, float]) -> Circle:
        """Return a circle that resolves the ends of a band in Hz."""
        low, high = max(band[0], CAUSAL_BOUND.least_low_share * band[1]), band[1]
        ratio = np.sqrt(high / low)
        width = CAUSAL_BOUND.margin_width
        needed = _TWO_PI * CAUSAL_BOUND.margin_points * (1.0 + ratio**2) / (2.0 * ratio * width)
        limits = CAUSAL_BOUND.least_exponent, CAUSAL_BOUND.most_exponent
        n = 2 ** int(np.clip(np.ceil(np.log2(needed)), *limits))
        return cls(n, float(np.sqrt(low * high)), width * max(1.0, float(needed) / n))

    @property
    def freq(self) -> RealArray:
        """Frequency of each point in Hz, negative on the lower half; neither 0 nor infinite."""
        theta = _TWO_PI * (np.arange(self.n) + 0.5) / self.n
        return np.asarray(self.scale * np.tan(0.5 * theta))

    def coefficients(self, values: RealArray | ComplexArray) -> ComplexArray:
        """Return the Fourier coefficients of values at the points, in the order of an FFT."""
        return np.asarray(np.fft.fft(values) / self.n * self._turn.conj())

    def outer(self, logarithm: RealArray) -> ComplexArray:
        """Return log W of the outer function with a given log |W|, at the points."""
        c = self.coefficients(logarithm)
        k = np.fft.fftfreq(self.n, 1.0 / self.n)
        c = c * np.select([k < 0, k == 0], [2.0, 1.0], 0.0)
        c[self.n // 2] = 0.0
        return np.asarray(np.fft.ifft(c * self._turn) * self.n)

    @property
    def _turn(self) -> ComplexArray:
        return _half_steps(self.n)


@lru_cache(maxsize=2)
def _half_steps(n: int) -> ComplexArray:
    """Return the factors that shift the points by half of their distance, by coefficient."""
    turn = np.asarray(np.exp(1j * np.pi * np.fft.fftfreq(n, 1.0 / n) / n))
    turn.flags.writeable = False
    return turn


@lru_cache(maxsize=2)
def _outer_inside(circle: Circle, band: tuple[float, float]) -> tuple[RealArray, ComplexArray]:
    """Return the share of the band at each point, and the logarithm of its outer function."""
    share = _band_share(np.abs(circle.freq), band, circle.margin)
    follows = circle.outer(share)
    share.flags.writeable = follows.flags.writeable = False
    return share, follows


def hankel_norm(circle: Circle, values: ComplexArray) -> float:
    """Return the distance of a function on the axis from the nearest stable one (Nehari)."""
    # `values` belong to a real system: conjugate at negative frequencies.
    n = circle.n // CAUSAL_BOUND.points_per_row
    c = circle.coefficients(values).real[1 : 2 * n]
    length = 4 * n
    spectrum = np.fft.rfft(c, length)

    def product(v: RealArray) -> RealArray:
        return np.fft.irfft(spectrum * np.fft.rfft(np.ravel(v)[::-1], length), length)[
            n - 1 : 2 * n - 1
        ]

    if not np.abs(c).max(initial=0.0) > 0.0:
        return 0.0
    hankel = LinearOperator((n, n), matvec=product, dtype=np.float64)
    start = 1.0 / (1.0 + np.arange(n))
    tolerance = 0.1 * CAUSAL_BOUND.accuracy
    found = eigsh(hankel, k=1, which="LM", v0=start, tol=tolerance, return_eigenvectors=False)
    return float(np.abs(found[0]))


@dataclass(frozen=True, slots=True, eq=False)
class ChannelDifference:
    """Difference of a structure from a plant in one channel, a function of lines in Hz of the band.

    `reference` is the denominator of the error. Outside the band a stable system differs from the
    plant by at most `above` at higher, and `below` |1 + low / (i f)|^growth at lower frequencies.
    """

    difference: Callable[[RealArray], ComplexArray]
    reference: Callable[[RealArray], RealArray]
    below: float
    above: float
    growth: int = 0


def error_lower_bound(
    channel: ChannelDifference, band: tuple[float, float], known: float = 0.0
) -> float:
    """Return a lower bound on the largest error of any stable system in a band, as a share.

    A larger `known` bound is returned instead, and 0 for a bound that is rounding.
    """
    low, high = band
    circle = Circle.of(band)
    freq = circle.freq
    size = np.abs(freq)
    inside = (size >= low) & (size <= high)
    up = inside & (freq > 0)
    lines, places = size[up], np.flatnonzero(up)
    mirrored = circle.n - 1 - places
    grown = np.asarray((1.0 + low / (1j * freq)) ** channel.growth, dtype=np.complex128)
    wanted = np.zeros(circle.n, dtype=np.complex128)
    wanted[places] = channel.difference(lines)
    wanted[mirrored] = wanted[places].conj()
    reference = channel.reference(lines)
    log_size = np.zeros(circle.n)
    log_size[places] = log_size[mirrored] = np.log(reference / np.abs(grown[places]))
    share, follows = _outer_inside(circle, (low, high))
    limit = np.log(np.where(size < low, channel.below, channel.above))
    if low > 0:  # in the margin at the lower end, use the limit below the band
        limit = np.where(size < circle.scale, np.log(channel.below), limit)
    fixed = wanted / grown * np.exp(-circle.outer(share * log_size + (1.0 - share) * limit))
    reached = float(np.max(np.abs(wanted[places]) / reference))

    def excess(logarithm: float) -> float:
        norm = hankel_norm(circle, fixed * np.exp(-logarithm * follows))
        return float(np.log(max(norm, 1e-300)))

    floor = max(CAUSAL_BOUND.error_rounding, CAUSAL_BOUND.error_rounding * reached, known)
    if reached <= floor or excess(np.log(floor)) <= 0.0:
        return known
    if excess(np.log(reached)) >= 0.0:
        return reached
    return float(np.exp(brentq(excess, np.log(floor), np.log(reached), xtol=CAUSAL_BOUND.accuracy)))


def _band_share(size: RealArray, band: tuple[float, float], margin: float) -> RealArray:
    """Return 1 in the band, 0 outside, and a smooth step within its margins."""
    low, high = band
    with np.errstate(divide="ignore", over="ignore"):
        step = np.clip(np.log(high / size) / margin, 0.0, 1.0)
        if low > 0:
            step = np.minimum(step, np.clip(np.log(size / low) / margin, 0.0, 1.0))
        # Smooth in all derivatives, so its outer function is resolved by the points.
        return np.asarray(1.0 / (1.0 + np.exp(1.0 / step - 1.0 / (1.0 - step))))


def channel_differences(
    freq: RealArray,
    structure: Callable[[RealArray], ComplexArray],
    level: RealArray,
    found: CandidateSelection,
    outside: Conversion,
    growth: IndexArray,
) -> list[ChannelDifference]:
    """Return the differences of a structure from a selection of candidates, channel by channel.

    `freq` must resolve the structure; `outside` are its modes, for the gain outside the band.
    `growth` is the power of the growth of each output towards 0 Hz.
    """
    band = float(freq[0]), float(freq[-1])
    cache: dict[bytes, ComplexArray] = {}

    def difference(lines: RealArray) -> ComplexArray:
        key = lines.tobytes()
        if key not in cache:
            parts = np.array_split(lines, 1 + len(lines) // CAUSAL_BOUND.block_lines)
            cache[key] = np.concatenate(
                [structure(some) - found.conversion.response(found.mask, some) for some in parts]
            )
        return cache[key]

    whole = np.ones(len(outside.frequency), dtype=np.bool_)
    natural = np.concatenate([outside.frequency, found.conversion.frequency])
    limits = []
    for lines in _adjacent_lines(band, natural):
        if not len(lines):
            limits.append(np.ones(level.shape[1:]))
            continue
        grown: RealArray = np.ones((len(lines), len(growth), 1))
        if lines[-1] < band[0]:
            slower: RealArray = np.abs(1.0 + band[0] / (1j * lines))
            grown = np.power(slower[:, None], growth)[:, :, None]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            structure_size = np.abs(outside.response(whole, lines)) / grown
            other = np.abs(found.conversion.response(found.mask, lines)) / grown
            limit = CAUSAL_BOUND.outside_gain * structure_size.max(axis=0) + other.max(axis=0)
        limit = np.where(limit < CAUSAL_BOUND.gain_limit, limit, CAUSAL_BOUND.gain_limit)
        least = CAUSAL_BOUND.error_rounding**2 * level.max(axis=0)  # for a channel without coupling
        limits.append(np.maximum(limit, least))

    def channel(i: int, j: int) -> ChannelDifference:
        return ChannelDifference(
            lambda lines: np.asarray(difference(lines)[:, i, j]),
            # Interpolation overestimates, as |H| is convex except at antiresonances.
            lambda lines: np.asarray(np.interp(lines, freq, level[:, i, j])),
            float(limits[0][i, j]),
            float(limits[1][i, j]),
            int(growth[i]),
        )

    return [channel(i, j) for i, j in np.ndindex(*level.shape[1:])]


def _adjacent_lines(band: tuple[float, float], natural: RealArray) -> tuple[RealArray, RealArray]:
    """Return lines below and above a band, including natural frequencies."""
    low, high = band
    factor, count = CAUSAL_BOUND.outside_factor, CAUSAL_BOUND.outside_lines
    below, above = np.zeros(0), np.geomspace(high, factor * high, count)[1:]
    if low > 0:
        below = np.geomspace(low / factor, low, count)[:-1]
        below = np.union1d(below, natural[(natural > below[0]) & (natural < low)])
    above = np.union1d(above, natural[(natural > high) & (natural < above[-1])])
    return below, above
