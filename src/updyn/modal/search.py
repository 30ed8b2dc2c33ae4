"""Search for the modes of a window, one by one in the order of the explained residual.

Trials are stable poles, poles next to those already found and an even grid. A mode is accepted if
it decreases the deviance by more than its free values would by chance (G. Schwarz, Ann. Stat. 6
(1978) 461-464), times the inflation of the variance by correlated noise (`envelope`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, RealArray
from updyn.modal.refine import (
    LineWindow,
    Weights,
    WindowFit,
    deviance,
    fit_poles,
    fit_residues,
    fit_reweighted,
    fit_with_unknown_noise,
)
from updyn.modal.settings import CHANNEL_FIT, MODE_SEARCH, PHYSICAL_MODE, POLE_REFINEMENT

__all__ = [
    "Visibility",
    "chance_gain",
    "is_mode",
    "search_window",
    "shows_on_lines",
]


def chance_gain(window: LineWindow, n_channels: int | None = None) -> float:
    """Return the decrease of the deviance that a spurious mode reaches by chance.

    `n_channels`, by default those of the window, are the channels that were searched.
    """
    # Each free number costs the logarithm of the number of values that determine it: for a residue
    # those of its channel, for a pole all (M. Delattre, M. Lavielle & M.-A. Poursat, Electron. J.
    # Stat. 8 (2014) 456-475).
    p, n_f = window.Y.shape
    p = n_channels or p
    return float(2 * p * np.log(2 * n_f) + 2 * np.log(2 * p * n_f))


def search_window(
    window: LineWindow, stable: ComplexArray, trials: ComplexArray, most: int
) -> WindowFit:
    """Return the fit of a window with at most `most` modes."""
    # Before any mode is known, a window full of modes looks like correlated noise, so stable poles
    # and poles within their widths are tested as in white noise; `fit_all_windows` removes
    # ripples.
    none, rough = np.zeros(0, dtype=np.complex128), POLE_REFINEMENT.rough_decrease
    fitted, weights = fit_with_unknown_noise(window, none, Weights.of(np.abs(window.Y) ** 2))
    total = float(np.sum(np.abs(window.Y) ** 2))
    rejected: list[complex] = []
    while len(fitted.poles) < most and len(rejected) < MODE_SEARCH.most_rejected:
        if float(np.sum(fitted.squared_error)) <= MODE_SEARCH.exact_squares * total:
            break
        widths = window.width(fitted.poles)
        aside = MODE_SEARCH.side_distance * widths
        sides = [fitted.poles - aside, fitted.poles + aside]
        trial_poles = np.concatenate([stable, trials, *sides])
        gains = _estimate_gains(window, fitted, weights, trial_poles)
        for pole in rejected:
            gains[np.abs(trial_poles - pole) <= window.width(trial_poles)] = 0.0
        best = trial_poles[int(np.argmax(gains))]
        least = MODE_SEARCH.promising_share * chance_gain(window)
        if gains.max() < least * fitted.cost / fitted.error.size:
            break
        more = fit_poles(window, np.append(fitted.poles, best), weights, rough)
        stays = bool((np.abs(stable - best) <= window.width(stable)).any())
        if is_mode(window, fitted, more, weights, white=stays):
            fitted, weights = fit_reweighted(window, more, rough)
        else:
            rejected.append(complex(best))
    return fitted


def is_mode(
    window: LineWindow, fitted: WindowFit, more: WindowFit, weights: Weights, *, white: bool
) -> bool:
    """Return whether the last pole of `more` may be a mode; with `white`, lines are independent."""
    pole = complex(more.poles[-1])
    if (-pole.real if window.basis.mirrored else pole.imag) <= 0.0:
        return False
    inflation = 1.0 if white else float(window.inflation(more.poles, weights)[-1])
    if not _explains_more_than_chance(window, fitted, more, weights, inflation):
        return False
    at = window.near(pole)
    if _compute_explained_share(at, fitted, more, weights) < PHYSICAL_MODE.least_explained_share:
        return False
    shows = Visibility.of(window, pole, more.residues[-1], at, more.cost_increase_by_channel[-1])
    return shows.everywhere or shows.somewhere


def _explains_more_than_chance(
    window: LineWindow, fitted: WindowFit, more: WindowFit, weights: Weights, inflation: float
) -> bool:
    """Return whether the last pole of `more` explains more than chance, and more than one line."""
    # What a pole explains in some channels suffices if it exceeds what it needs in all of them.
    p = len(window.Y)
    if p > 2 * MODE_SEARCH.strong_channels:
        response = np.abs(more.residues[-1]) / weights.channel[:, 0]
        strong = np.zeros(p, dtype=np.bool_)
        strong[np.argsort(response)[-MODE_SEARCH.strong_channels :]] = True
        part, part_weights = window.of_channels(strong), weights.of_channels(strong)
        before, after = (fit_residues(part, fit.poles, part_weights) for fit in (fitted, more))
        if _gains(part, before, after, part_weights, inflation, p):
            return True
    return _gains(window, fitted, more, weights, inflation, p)


def _gains(
    window: LineWindow,
    fitted: WindowFit,
    more: WindowFit,
    weights: Weights,
    inflation: float,
    n_channels: int,
) -> bool:
    if deviance(fitted) - deviance(more) <= inflation * chance_gain(window, n_channels):
        return False
    return shows_on_lines(window, fitted, more, weights, inflation, n_channels)


def shows_on_lines(
    window: LineWindow,
    fitted: WindowFit,
    more: WindowFit,
    weights: Weights,
    inflation: float,
    n_channels: int | None = None,
) -> bool:
    """Return whether the last pole of `more` explains more than one line, unlike a disturbance.

    `n_channels` as for `chance_gain`.
    """
    deviation = weights.channel * weights.line
    strongest = int(
        np.argmax(np.sum((fitted.squared_error - more.squared_error) / deviation**2, axis=0))
    )
    if len(window.x) - 1 <= more.columns.Q.shape[1]:
        return False  # too few lines
    others = np.arange(len(window.x)) != strongest
    part = window.of_lines(others)
    weights = Weights(weights.channel, weights.line[:, others])
    without, with_it = (fit_residues(part, fit.poles, weights) for fit in (fitted, more))
    return deviance(without) - deviance(with_it) > inflation * chance_gain(part, n_channels)


def _compute_explained_share(
    at: BoolArray, fitted: WindowFit, more: WindowFit, weights: Weights
) -> float:
    """Return the share of the residual at some lines that the last pole explains."""
    weight = 1.0 / (weights.channel * weights.line[:, at]) ** 2
    before, after = (float(np.sum(fit.squared_error[:, at] * weight)) for fit in (fitted, more))
    return 1.0 - after / max(before, CHANNEL_FIT.smallest_divisor)


@dataclass(frozen=True, slots=True)
class Visibility:
    """Visibility of a pole at its own frequency.

    `everywhere`: its share in all channels together is at least a tenth. `somewhere`: it is a peak
    in one channel. `cancelled`: other poles cancel nearly all of it.
    """

    everywhere: bool
    somewhere: bool
    cancelled: bool

    @classmethod
    def of(
        cls,
        window: LineWindow,
        pole: complex,
        residues: ComplexArray,
        at: BoolArray,
        worths: RealArray,
    ) -> Visibility:
        """Return the visibility of a pole at its lines `at`.

        A channel contains the pole if the increase of its cost without it, `worths`, is more than
        chance.
        """
        squares = np.abs(residues) ** 2 * np.sum(np.abs(1.0 / (window.x[at] - pole)) ** 2)
        measured = np.abs(window.measured_channels) ** 2
        whole = np.maximum(np.sum(measured[:, at], axis=1), CHANNEL_FIT.smallest_divisor)
        # Median over the window, because any pole is large at an antiresonance of the channel.
        level = np.median(measured, axis=1) * np.count_nonzero(at)
        known = worths > np.log(2 * window.Y.size)
        share = np.sum(squares) / np.sum(whole)
        is_peak = squares >= PHYSICAL_MODE.local_peak_share**2 * np.maximum(whole, level)
        return cls(
            bool(share >= PHYSICAL_MODE.visible_share**2),
            bool(np.any(known & is_peak)),
            bool(share > 1.0 / PHYSICAL_MODE.visible_share**2),
        )


def _estimate_gains(
    window: LineWindow, fitted: WindowFit, weights: Weights, trial_poles: ComplexArray
) -> RealArray:
    """Return the decrease of the cost with each trial pole at its initial position."""
    inverse = weights.common
    Q = np.linalg.qr(_complex_columns(window, fitted.poles) * inverse[:, None])[0]
    columns = inverse[:, None] / (window.x[:, None] - trial_poles)
    columns /= np.linalg.norm(columns, axis=0)
    columns = columns - Q @ (Q.conj().T @ columns)
    independent_part = np.sum(np.abs(columns) ** 2, axis=0)
    error = (window.Y / weights.channel * inverse).T
    error = error - Q @ (Q.conj().T @ error)
    # A column within the span of the fit is only rounding error.
    return np.where(
        independent_part > 1e-12,
        np.sum(np.abs(columns.conj().T @ error) ** 2, axis=1) / np.maximum(independent_part, 1e-12),
        0.0,
    )


def _complex_columns(window: LineWindow, poles: ComplexArray) -> ComplexArray:
    """Return the functions of the fit with complex weights."""
    both = window.columns(poles)
    if not window.basis.mirrored:
        return np.asarray(both)
    n_f = len(window.x)
    return np.asarray(both[:n_f] + 1j * both[n_f:])
