"""Leaning peaks: modes whose stiffness depends on the level, which a linear fit splits.

Neighbouring poles are compared by likelihood with one mode of amplitude-dependent pole
(`backbone`). A second round starts with the peaks of the first, because the linear fit of a leaning
peak disturbs its neighbours and the estimate of the noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.special

from updyn.arrays import ComplexArray
from updyn.modal.backbone import Backbone, Level, fit_backbone, predict_gain
from updyn.modal.envelope import Envelope
from updyn.modal.fits import Mode, WeightedFit, make_mode, take_means
from updyn.modal.measured import Measured
from updyn.modal.refine import (
    ChannelNoise,
    LineWindow,
    Weights,
    WindowFit,
    deviance,
    fit_poles,
    fit_residues,
)
from updyn.modal.settings import LEANING_PEAK, POLE_REFINEMENT, UNEXPLAINED_PEAK
from updyn.modal.settle import estimate_envelope

__all__ = ["Bundle", "Leaning", "PolesByRun", "find_leaning"]


#: Largest shift in widths: above 8 / (3 sqrt 3) the motion is not unique (A. H. Nayfeh & D. T.
#: Mook, Nonlinear Oscillations, 1979, section 4.1), and the nonlinearity is not weak.
_LARGEST = 8.0 / (3.0 * np.sqrt(3.0))


@dataclass(frozen=True, slots=True)
class PolesByRun:
    """Poles, by fit and position, that are modes with a pole for each run.

    They are modes unless a leaning peak explains more. `gain` is the gain in deviance over the fit
    with common poles, less that by chance; `cost` that of the fit.
    """

    members: frozenset[tuple[int, int]]
    cost: float
    gain: float


@dataclass(frozen=True, slots=True, eq=False)
class Bundle:
    """Close poles: `members` by fit and position, by ascending frequency, all within `fit`.

    `positions` are those in this fit; `claims` are alternatives for some of them.
    """

    members: list[tuple[int, int]]
    fit: WeightedFit
    positions: list[int]
    claims: list[PolesByRun]

    def rows(self, count: int, taken: set[tuple[int, int]]) -> list[frozenset[tuple[int, int]]]:
        """Return all rows of `count` neighbours among the poles that are not claimed or taken."""
        claimed = {member for claim in self.claims for member in claim.members}
        free = [member for member in self.members if member not in claimed | taken]
        return [frozenset(free[k : k + count]) for k in range(len(free) - count + 1)]


@dataclass(frozen=True, slots=True, eq=False)
class Leaning:
    """A mode in place of poles of the linear fit: `members`, by fit and position.

    `fit` is the linear fit with the window and weights of `backbone`; `gain` the gain in deviance
    over it, less that of free values by chance.
    """

    members: frozenset[tuple[int, int]]
    fit: WeightedFit
    backbone: Backbone
    gain: float

    def mode(self) -> Mode:
        """Return the mode."""
        # Its standard deviation includes the shift along the peak as the root mean square,
        # weighted by the squared motion, because a model without this shift is compared with it.
        window, weights, found = self.fit.window, self.fit.weights, self.backbone
        pole = np.array([found.pole])
        errors = found.spread(window, weights)
        shift = found.shift
        a = found.motion(window)
        along = abs(np.sqrt(np.sum(a**3) / np.sum(a)))
        std = np.hypot(errors.pole, along * np.abs([shift.real, shift.imag]))
        errors = replace(errors, pole=std)
        without = fit_residues(window, pole[:0], weights).squared_error
        squared_error = found.level.join([one.squared_error for one in found.fits])
        mode = make_mode(self.fit, found.pole, found.residues, errors, squared_error, without)
        return replace(mode, shift=shift)


def find_leaning(
    measured: Measured, fits: Sequence[WeightedFit], bundles: Sequence[Bundle]
) -> list[Leaning]:
    """Return the leaning peaks among the poles of all fits."""
    # Forces at all references are assumed to have the same amplitude.
    found: list[Leaning] = []
    for _ in range(LEANING_PEAK.iterations):
        envelope = _estimate_envelope(measured, fits, found)
        found = [
            peak
            for bundle in bundles
            for peak in _find_in_bundle(measured, fits, bundle, found, envelope, len(bundles))
        ]
        if not found:
            break
    return found


def _estimate_envelope(
    measured: Measured, fits: Sequence[WeightedFit], found: Sequence[Leaning]
) -> Envelope:
    """Return the envelope of the residuals; windows with leaning peaks use their fits."""
    if not found:
        return fits[0].window.envelope
    leaning = {k for peak in found for k, _ in peak.members}
    fits_with_deviations = [
        (fit.window_fit, fit.weights.channel * fit.weights.line)
        for k, fit in enumerate(fits)
        if k not in leaning
    ]
    for peak in found:
        deviation = peak.fit.weights.channel * peak.fit.weights.line
        for run, fit in enumerate(peak.backbone.fits):
            fits_with_deviations.append((fit, deviation[peak.backbone.level.runs == run]))
    return estimate_envelope(
        replace(measured, envelope=fits[0].window.envelope), fits_with_deviations
    )


def _find_in_bundle(
    measured: Measured,
    fits: Sequence[WeightedFit],
    bundle: Bundle,
    found: Sequence[Leaning],
    envelope: Envelope,
    count: int,
) -> Iterator[Leaning]:
    """Yield the leaning peaks of a bundle, without poles in common, most poles and gain first."""
    fit = bundle.fit
    if (fit.added[bundle.positions] >= 0).any():
        return
    where = dict(zip(bundle.members, bundle.positions, strict=True))

    def compare(members: frozenset[tuple[int, int]], claim: PolesByRun | None) -> Leaning | None:
        others = [peak for peak in found if not peak.members & members]
        window = _linearise_window(fit.window, fits, others)
        common = fit.window_fit
        if window is not fit.window:
            common = fit_poles(window, common.poles, fit.weights)
        linear = replace(fit, window=replace(window, envelope=envelope), window_fit=common)
        part = sorted(where[member] for member in members)
        compared = _compare(measured, linear, part, claim, count)
        return None if compared is None else Leaning(members, *compared)

    yield from filter(None, (compare(claim.members, claim) for claim in bundle.claims))
    taken: set[tuple[int, int]] = set()
    most = min(LEANING_PEAK.most_poles, len(bundle.members))
    for length in range(most, 0, -1):  # the fewest modes first
        tried = [compare(members, None) for members in bundle.rows(length, taken)]
        for peak in sorted(filter(None, tried), key=lambda peak: -peak.gain):
            if not peak.members & taken:
                taken |= peak.members
                yield peak


def _linearise_window(
    window: LineWindow, fits: Sequence[WeightedFit], found: Sequence[Leaning]
) -> LineWindow:
    """Return a window in which leaning peaks are replaced by their linear fit."""
    for peak in found:
        at, span = peak.fit.window.x, abs(window.x[-1] - window.x[0])
        if max(abs(at[0] - window.x[0]), abs(at[-1] - window.x[-1])) > 2.0 * span:
            continue  # distant: a polynomial in the lines of the window
        change = peak.backbone.response(window)
        for k, r in peak.members:
            linear = fits[k].window_fit
            change = change - _mode_response(window, linear.poles[r], linear.residues[r])
        window = replace(window, Y=window.Y - change, subtracted=window.subtracted + change)
    return window


def _mode_response(window: LineWindow, pole: complex, residues: ComplexArray) -> ComplexArray:
    """Return the contribution of a linear mode to the channels, shape (p, n)."""
    part = residues[:, None] / (window.x - pole)
    if window.basis.mirrored:
        part = part + residues.conj()[:, None] / (window.x - np.conj(pole))
    return np.asarray(part)


def _compare(
    measured: Measured, fit: WeightedFit, part: list[int], claim: PolesByRun | None, count: int
) -> tuple[WeightedFit, Backbone, float] | None:
    """Return poles of a fit as one leaning peak, with its gain; None if it is no better."""
    # It must be better than the poles `part` of the fit, than one linear pole, and than poles for
    # each run (`claim`).
    window, weights, common = fit.window, fit.weights, fit.window_fit
    p, n_f = window.Y.shape
    inflation = 2.0 * float(np.mean(window.inflation(common.poles, weights)[part]))
    # Noise estimated from n - m lines increases deviances by n / (n - m).
    few = n_f / max(n_f - common.columns.Q.shape[1], 1)
    alarm = -np.log(UNEXPLAINED_PEAK.false_alarm / count)  # for two squares of unit variance
    one_more = inflation * max(np.log(2 * p * n_f), few * alarm)
    more = len(part) - 1
    least = one_more - more * inflation * (np.log(2 * p * n_f) + p * np.log(2 * n_f))
    alone = replace(
        window, fixed_poles=np.concatenate([window.fixed_poles, np.delete(common.poles, part)])
    )
    one, rough = common, POLE_REFINEMENT.rough_decrease
    if more:
        one = fit_poles(alone, take_means(fit, part, 1), weights, rough)
    at = 0 if more else part[0]
    pole, level = complex(one.poles[at]), Level.of(one.residues[at], measured.runs[1])
    needed = one.cost - common.cost + 0.5 * least if claim is None else one.cost - claim.cost
    if predict_gain(alone, one, at, level) < max(needed, 0.5 * one_more):  # score test
        return None
    rival = max(0.0, claim.gain) if claim is not None else 0.0
    found = fit_backbone(alone, pole, weights, level)
    if not _is_better(found, common, one, least + rival, one_more):
        return None
    weights = _estimate_weights(found)
    found = fit_backbone(alone, found.pole, weights, level, found.shift)
    end = np.array([found.pole])
    width = float(window.width(end)[0])
    if abs(found.shift) > _LARGEST * width or not measured.is_inside(end)[0]:
        return None
    if found.agreement(width) < _chance_agreement(p, count):
        return None
    gain = deviance(common) - sum(deviance(fit) for fit in found.fits) - least
    return replace(fit, window=alone, weights=weights), found, gain


def _is_better(
    found: Backbone, common: WindowFit, one: WindowFit, least: float, one_more: float
) -> bool:
    """Return whether a leaning peak gains enough over several poles and over one of them."""
    fitted = sum(deviance(fit) for fit in found.fits)
    return deviance(common) - fitted > least and deviance(one) - fitted > one_more


def _chance_agreement(p: int, count: int) -> float:
    """Return Hotelling's T^2 that shifts of p channels exceed by chance at any peak."""
    # Two channels do not determine the variance of a shift with two parts.
    if p < 3:
        return 0.0
    ratio = scipy.special.fdtri(2, p - 2, 1.0 - UNEXPLAINED_PEAK.false_alarm / count)
    return float(2.0 * (p - 1) / (p - 2) * ratio)


def _estimate_weights(found: Backbone) -> Weights:
    deviations = [
        ChannelNoise.of(fit.unbiased_squared_error, fit.size).deviation(fit.size)
        for fit in found.fits
    ]
    return Weights(np.ones((1, 1)), found.level.join(deviations))
