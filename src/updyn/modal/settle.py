"""Maximum-likelihood refinement of poles window by window, with removal of spurious poles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from updyn.modal.envelope import Envelope
from updyn.modal.fits import Weighted
from updyn.modal.measured import Measured, groups
from updyn.modal.refine import (
    Noise,
    Solved,
    Weights,
    Window,
    deviance,
    moved,
    reweighted,
    solved,
)
from updyn.modal.search import chance, shows_on_lines

__all__ = ["estimate_envelope", "poles_of", "settle"]

_Complex = NDArray[np.complex128]
_Real = NDArray[np.float64]

#: Fits with the noise of the windows, each from the poles of the previous one.
_SWEEPS = 2
#: Up to this number of channels, each channel has its own weights on each line.
_OWN = 4096
#: Number of lines, including those of neighbouring windows, for the estimate of proportional noise
#: and floor of each channel in a window. More would mix noise levels, which may differ by 60 dB
#: over a band of accelerances.
_NOISE_LINES = 60
#: A pole with a gain of this multiple of the smallest gain is a mode for any noise, without a fit
#: that omits it. The value affects only the computing time.
_PLAIN = 20.0


def poles_of(fits: Sequence[Weighted]) -> _Complex:
    """Return the poles of all fits."""
    none = np.zeros(0, dtype=np.complex128)
    return np.concatenate([none, *(fit.solved.poles for fit in fits)])


def settle(measured: Measured, poles: _Complex, added: NDArray[np.intp]) -> list[Weighted]:
    """Return the fits of all windows, each with the noise of nearby residuals.

    The initial poles are sorted by frequency. `added`, shape (k,), is the number of the user's pick
    for poles that are kept without a test, and -1 for all others.
    """
    residuals: _Residuals | None = None
    residues: _Complex | None = None
    fits: list[Weighted] = []
    for _ in range(1 + _SWEEPS):
        fits = []
        for group in groups(measured.axis.frequency(poles), measured.bandwidth(poles)):
            own = poles[group]
            others = None if residues is None else np.delete(residues, group, axis=0)
            window = measured.window(measured.lines_of(own), np.delete(poles, group), others)
            noise = None if residuals is None else residuals.noise(measured, own)
            fits.append(_pruned(measured, window, own, added[group], noise))
        fits = [fit for fit in fits if len(fit.solved.poles)]
        if not fits:
            break
        poles, residues = poles_of(fits), np.concatenate([fit.solved.residues for fit in fits])
        added = np.concatenate([fit.added for fit in fits])
        order = np.argsort(measured.axis.frequency(poles), kind="stable")
        poles, residues, added = poles[order], residues[order], added[order]
        residuals = _Residuals.of(measured, fits)
        left = [(fit.solved, fit.weights.channel * fit.weights.line) for fit in fits]
        measured = replace(measured, envelope=estimate_envelope(measured, left))
        if not measured.inside(poles[added >= 0]).all():
            break
    return [replace(fit, window=replace(fit.window, envelope=measured.envelope)) for fit in fits]


def estimate_envelope(measured: Measured, fits: Sequence[tuple[Solved, _Real]]) -> Envelope:
    """Return the envelope of the residuals of fits, which contain no modes; white stays white.

    `fits` include the standard deviations of their values, shape (p, n) or (1, n).
    """
    if measured.envelope.is_white:
        return measured.envelope
    residuals = []
    for fit, deviation in fits:
        Q, n_f = fit.columns.Q, fit.error.shape[1]
        if len(Q) > n_f:  # real and imaginary parts, half of the columns each
            Q = (Q[:n_f] + 1j * Q[n_f:]) / np.sqrt(2.0)
        residuals.append((Q, fit.error / deviation))
    envelope = Envelope.of_residuals(residuals)
    return measured.envelope if envelope.is_white else envelope


@dataclass(frozen=True, slots=True, eq=False)
class _Residuals:
    """Squared residuals of fits, by position in the band.

    Attributes
    ----------
    frequency : ndarray of float, shape (w,)
        Centre of each window in Hz.
    squares, sizes : list of ndarray of float, shapes (p, n)
        Squared residuals and squared values of each window.
    """

    frequency: _Real
    squares: list[_Real]
    sizes: list[_Real]

    @classmethod
    def of(cls, measured: Measured, fits: Sequence[Weighted]) -> _Residuals:
        """Return the residuals of fits."""
        middle = [float(np.mean(measured.axis.frequency(f.solved.poles))) for f in fits]
        return cls(
            np.array(middle), [f.solved.squares for f in fits], [f.solved.size for f in fits]
        )

    def noise(self, measured: Measured, poles: _Complex) -> Noise:
        """Return the noise around some poles."""
        at = float(np.mean(measured.axis.frequency(poles)))
        nearest, lines = np.argsort(np.abs(self.frequency - at), kind="stable"), 0
        chosen: list[int] = []
        for window in nearest.tolist():
            chosen.append(window)
            lines += self.squares[window].shape[1]
            if lines >= _NOISE_LINES:
                break
        squares, sizes = ([part[k] for k in chosen] for part in (self.squares, self.sizes))
        return Noise.of(np.hstack(squares), np.hstack(sizes))


def _pruned(
    measured: Measured,
    window: Window,
    poles: _Complex,
    added: NDArray[np.intp],
    noise: Noise | None,
) -> Weighted:
    """Return the fit of a window without spurious poles."""
    weights = Weights.of(np.abs(window.Y) ** 2)
    if noise is not None:
        size = solved(window, poles, weights).size
        deviation = noise.deviation(size)
        weights = Weights(np.ones((1, 1)), deviation)
        if len(deviation) > _OWN:
            weights = Weights.near(deviation)
    while True:
        if noise is None:
            fitted, weights = reweighted(window, poles, weights)
        else:
            fitted = moved(window, poles, weights)
        fitted = _held(measured, window, poles, fitted, weights)
        worth = np.array(list(_surpluses(measured, window, fitted, weights)))
        worth[added >= 0] = np.inf
        if not len(poles) or worth.min() > 0.0:
            return Weighted(window, fitted, weights, added)
        last = int(np.argmin(worth))
        poles, added = np.delete(fitted.poles, last), np.delete(added, last)


def _held(
    measured: Measured, window: Window, poles: _Complex, fitted: Solved, weights: Weights
) -> Solved:
    """Return the fit with poles reset that left the band or became unstable."""
    left = measured.inside(poles) & ~measured.inside(fitted.poles)
    if not left.any():
        return fitted
    return solved(window, np.where(left, poles, fitted.poles), weights)


def _surpluses(
    measured: Measured, window: Window, fitted: Solved, weights: Weights
) -> Iterator[float]:
    """Yield the gain in deviance of each pole less that by chance; above 0 for a mode.

    The fit without a pole is weighted by its own estimated noise. With the noise of the fit with
    the pole, a peak with a large share of noise would have little weight at any height.
    """
    inflation = window.inflation(fitted.poles, weights)
    least, whole = chance(window), deviance(fitted)
    plain = 2.0 * fitted.worth / inflation - least
    for r, inside in enumerate(measured.inside(fitted.poles)):
        if not inside:
            yield -np.inf
            continue
        if plain[r] > _PLAIN * least:
            yield float(plain[r])
            continue
        without = solved(window, np.delete(fitted.poles, r), weights)
        without = solved(window, without.poles, Weights.left_by(without))
        shows = shows_on_lines(window, without, fitted, weights, float(inflation[r]))
        yield (deviance(without) - whole) / float(inflation[r]) - least if shows else -np.inf
