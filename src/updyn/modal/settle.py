"""Maximum-likelihood refinement of poles window by window, with removal of spurious poles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from updyn.arrays import ComplexArray, IndexArray, RealArray
from updyn.modal.envelope import Envelope
from updyn.modal.fits import WeightedFit
from updyn.modal.measured import Measured, group_overlapping
from updyn.modal.refine import (
    ChannelNoise,
    LineWindow,
    Weights,
    WindowFit,
    deviance,
    fit_poles,
    fit_residues,
    fit_with_unknown_noise,
)
from updyn.modal.search import chance_gain, shows_on_lines
from updyn.modal.settings import WINDOW_SWEEP

__all__ = ["collect_poles", "estimate_envelope", "fit_all_windows"]


def collect_poles(fits: Sequence[WeightedFit]) -> ComplexArray:
    """Return the poles of all fits."""
    none = np.zeros(0, dtype=np.complex128)
    return np.concatenate([none, *(fit.window_fit.poles for fit in fits)])


def fit_all_windows(
    measured: Measured, poles: ComplexArray, added: IndexArray
) -> list[WeightedFit]:
    """Return the fits of all windows, each with the noise of nearby residuals.

    The initial poles are sorted by frequency. `added`, shape (k,), is the number of the user's pick
    for poles that are kept without a test, and -1 for all others.
    """
    residuals: _Residuals | None = None
    residues: ComplexArray | None = None
    fits: list[WeightedFit] = []
    for _ in range(1 + WINDOW_SWEEP.sweeps):
        fits = []
        for group in group_overlapping(measured.axis.frequency(poles), measured.bandwidth(poles)):
            group_poles = poles[group]
            others = None if residues is None else np.delete(residues, group, axis=0)
            window = measured.window(
                measured.lines_of(group_poles), np.delete(poles, group), others
            )
            noise = None if residuals is None else residuals.noise(measured, group_poles)
            fits.append(_prune_poles(measured, window, group_poles, added[group], noise))
        fits = [fit for fit in fits if len(fit.window_fit.poles)]
        if not fits:
            break
        poles, residues = (
            collect_poles(fits),
            np.concatenate([fit.window_fit.residues for fit in fits]),
        )
        added = np.concatenate([fit.added for fit in fits])
        order = np.argsort(measured.axis.frequency(poles), kind="stable")
        poles, residues, added = poles[order], residues[order], added[order]
        residuals = _Residuals.of(measured, fits)
        with_deviations = [(fit.window_fit, fit.weights.channel * fit.weights.line) for fit in fits]
        measured = replace(measured, envelope=estimate_envelope(measured, with_deviations))
        if not measured.is_inside(poles[added >= 0]).all():
            break
    return [replace(fit, window=replace(fit.window, envelope=measured.envelope)) for fit in fits]


def estimate_envelope(measured: Measured, fits: Sequence[tuple[WindowFit, RealArray]]) -> Envelope:
    """Return the envelope of the residuals of fits, which contain no modes; white stays white."""
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
    """Squared residuals of fits, shapes (p, n), by centre of their windows in Hz."""

    frequency: RealArray
    squares: list[RealArray]
    sizes: list[RealArray]

    @classmethod
    def of(cls, measured: Measured, fits: Sequence[WeightedFit]) -> _Residuals:
        middle = [float(np.mean(measured.axis.frequency(f.window_fit.poles))) for f in fits]
        return cls(
            np.array(middle),
            [f.window_fit.unbiased_squared_error for f in fits],
            [f.window_fit.size for f in fits],
        )

    def noise(self, measured: Measured, poles: ComplexArray) -> ChannelNoise:
        at = float(np.mean(measured.axis.frequency(poles)))
        nearest, lines = np.argsort(np.abs(self.frequency - at), kind="stable"), 0
        chosen: list[int] = []
        for window in nearest.tolist():
            chosen.append(window)
            lines += self.squares[window].shape[1]
            if lines >= WINDOW_SWEEP.noise_lines:
                break
        squares, sizes = ([part[k] for k in chosen] for part in (self.squares, self.sizes))
        return ChannelNoise.of(np.hstack(squares), np.hstack(sizes))


def _prune_poles(
    measured: Measured,
    window: LineWindow,
    poles: ComplexArray,
    added: IndexArray,
    noise: ChannelNoise | None,
) -> WeightedFit:
    """Return the fit of a window without spurious poles."""
    weights = Weights.of(np.abs(window.Y) ** 2)
    if noise is not None:
        size = fit_residues(window, poles, weights).size
        deviation = noise.deviation(size)
        weights = Weights(np.ones((1, 1)), deviation)
        if len(deviation) > WINDOW_SWEEP.most_weighted_channels:
            weights = Weights.near(deviation)
    while True:
        if noise is None:
            fitted, weights = fit_with_unknown_noise(window, poles, weights)
        else:
            fitted = fit_poles(window, poles, weights)
        fitted = _reset_escaped_poles(measured, window, poles, fitted, weights)
        excess_gains = np.array(list(_yield_excess_gains(measured, window, fitted, weights)))
        excess_gains[added >= 0] = np.inf
        if not len(poles) or excess_gains.min() > 0.0:
            return WeightedFit(window, fitted, weights, added)
        last = int(np.argmin(excess_gains))
        poles, added = np.delete(fitted.poles, last), np.delete(added, last)


def _reset_escaped_poles(
    measured: Measured, window: LineWindow, poles: ComplexArray, fitted: WindowFit, weights: Weights
) -> WindowFit:
    """Return the fit with poles reset that left the band or became unstable."""
    escaped = measured.is_inside(poles) & ~measured.is_inside(fitted.poles)
    if not escaped.any():
        return fitted
    return fit_residues(window, np.where(escaped, poles, fitted.poles), weights)


def _yield_excess_gains(
    measured: Measured, window: LineWindow, fitted: WindowFit, weights: Weights
) -> Iterator[float]:
    """Yield the gain in deviance of each pole less that by chance; above 0 for a mode."""
    # The fit without a pole is weighted by its noise: with that of the fit with the pole, a peak
    # with a large share of noise would have little weight at any height.
    inflation = window.inflation(fitted.poles, weights)
    least = chance_gain(window)
    excess = 2.0 * fitted.cost_increase / inflation - least
    for r, inside in enumerate(measured.is_inside(fitted.poles)):
        if not inside:
            yield -np.inf
            continue
        if excess[r] > WINDOW_SWEEP.clear_excess * least:
            yield float(excess[r])
            continue
        without = fit_residues(window, np.delete(fitted.poles, r), weights)
        without = fit_residues(window, without.poles, Weights.from_residual(without))
        shows = shows_on_lines(window, without, fitted, weights, float(inflation[r]))
        gained = deviance(without) - deviance(fitted)
        yield gained / float(inflation[r]) - least if shows else -np.inf
