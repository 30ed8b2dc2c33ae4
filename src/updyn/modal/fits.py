"""Fits of windows, and modes made from their poles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np

from updyn.arrays import ComplexArray, IndexArray, RealArray
from updyn.modal.measured import Measured
from updyn.modal.refine import Errors, LineWindow, Weights, WindowFit, fit_with_unknown_noise
from updyn.modal.search import Visibility
from updyn.modal.settings import CHANNEL_FIT, POLE_BUNDLE, POLE_REFINEMENT

__all__ = [
    "Mode",
    "WeightedFit",
    "bundle_poles",
    "fit_together",
    "make_mode",
    "position",
    "take_means",
]


@dataclass(frozen=True, slots=True, eq=False)
class WeightedFit:
    """A window, its fit, and the weights of the fit.

    `added`, shape (k,), is the number of the user's pick for poles that are modes without a test;
    -1 for all others.
    """

    window: LineWindow
    window_fit: WindowFit
    weights: Weights
    added: IndexArray


@dataclass(frozen=True, slots=True, eq=False)
class Mode:
    """A mode of the fits."""

    #: The pole in the unit of the variable; the mean if it varies from run to run.
    pole: complex
    #: Standard deviations of its real and imaginary part, shape (2,); those of the runs if it
    #: varies.
    std: RealArray
    #: Residue of each channel, shape (p,).
    residues: ComplexArray
    #: Errors of the residues.
    errors: Errors
    #: Share of the residual of all other modes within the half-power band that it explains.
    quality: float
    #: Visibility in this band.
    visibility: Visibility
    #: Whether more than one run contains it.
    everywhere: bool = True
    #: Number of the user's pick if it is a mode without a test, else -1.
    added: int = -1
    #: The pole of each channel if it varies from run to run, shape (p,).
    by_channel: ComplexArray | None = None
    #: Whether its residue is that of one mode; further modes have other poles.
    single: bool = False
    #: Change of an amplitude-dependent pole at the largest motion; `pole` is that of small motion.
    shift: complex = 0.0

    @property
    def poles(self) -> ComplexArray:
        """The pole of each channel, shape (p,)."""
        if self.by_channel is None:
            return np.full(len(self.residues), self.pole)
        return self.by_channel


def bundle_poles(measured: Measured, fits: Sequence[WeightedFit]) -> list[list[tuple[int, int]]]:
    """Return groups of close poles by fit and position; each pick is a group."""
    # The poles of one mode have similar damping; a wide pole among narrow ones is background.
    at = [(k, r) for k, fit in enumerate(fits) for r in range(len(fit.window_fit.poles))]
    poles = np.array([fits[k].window_fit.poles[r] for k, r in at], dtype=np.complex128)
    added = np.array([fits[k].added[r] >= 0 for k, r in at], dtype=np.bool_)
    mirrored = measured.axis.mirrored
    along = poles.imag if mirrored else poles.real
    least_width = POLE_REFINEMENT.least_width_share * np.abs(poles)
    width = np.maximum(np.abs(poles.real if mirrored else poles.imag), least_width)
    order = np.argsort(along, kind="stable")
    bundles: list[list[int]] = []
    for r in order[~added[order]].tolist():
        for bundle in reversed(bundles):
            last = bundle[-1]
            ratio = max(width[r], width[last]) / min(width[r], width[last])
            reach = POLE_BUNDLE.largest_distance * (width[r] + width[last])
            if along[r] - along[last] < reach and ratio < POLE_BUNDLE.largest_width_ratio:
                bundle.append(r)
                break
        else:
            bundles.append([r])
    bundles += [[r] for r in np.flatnonzero(added).tolist()]
    return [[at[r] for r in bundle] for bundle in bundles]


def fit_together(
    measured: Measured, fits: Sequence[WeightedFit], members: list[tuple[int, int]]
) -> tuple[WeightedFit, list[int]]:
    """Return a fit that contains all poles of a bundle, and their positions in it."""
    parts = sorted({k for k, _ in members})
    if len(parts) == 1:
        return fits[parts[0]], [r for _, r in members]
    poles = np.array([fits[k].window_fit.poles[r] for k, r in members])
    others = [
        (fit.window_fit.poles[r], fit.window_fit.residues[r])
        for k, fit in enumerate(fits)
        for r in range(len(fit.window_fit.poles))
        if (k, r) not in members
    ]
    other_poles = np.array([pole for pole, _ in others], dtype=np.complex128)
    residues = np.array([r for _, r in others]).reshape(len(others), -1)
    window = measured.window(measured.lines_of(poles), other_poles, residues)
    window = replace(window, envelope=fits[parts[0]].window.envelope)
    fitted, weights = fit_with_unknown_noise(window, poles, Weights.of(np.abs(window.Y) ** 2))
    return WeightedFit(window, fitted, weights, np.full(len(poles), -1)), list(range(len(poles)))


def take_means(fit: WeightedFit, bundle: list[int], modes: int) -> ComplexArray:
    """Return initial poles: means of neighbours with the smallest weighted squares."""
    poles = fit.window_fit.poles[bundle]
    weight = np.abs(fit.window_fit.residues[bundle]).sum(axis=1)
    order = np.argsort(position(poles, fit.window), kind="stable")
    poles, weight = poles[order], weight[order]

    def means(cuts: tuple[int, ...]) -> tuple[float, ComplexArray]:
        parts = list(pairwise((0, *cuts, len(poles))))
        mean = np.array([np.average(poles[a:b], weights=weight[a:b]) for a, b in parts])
        near = np.repeat(mean, [b - a for a, b in parts])
        return float(np.sum(weight * np.abs(poles - near) ** 2)), mean

    tried = [means(cuts) for cuts in combinations(range(1, len(poles)), modes - 1)]
    return min(tried, key=lambda one: one[0])[1]


def position(poles: ComplexArray, window: LineWindow) -> RealArray:
    """Return the positions of poles along the lines, in the unit of the variable."""
    return np.asarray(poles.imag if window.basis.mirrored else poles.real)


def make_mode(
    fit: WeightedFit,
    pole: complex,
    residues: ComplexArray,
    errors: Errors,
    squared_error: RealArray,
    without: RealArray,
) -> Mode:
    """Return a mode of a window; squared residuals, (p, n_f), are with and `without` it."""
    window = fit.window
    at = window.near(pole)
    weight = 1.0 / (fit.weights.channel * fit.weights.line) ** 2
    weight = np.broadcast_to(weight, squared_error.shape)
    quality = 1.0 - np.sum((squared_error * weight)[:, at]) / max(
        np.sum((without * weight)[:, at]), CHANNEL_FIT.smallest_divisor
    )
    worths = np.sum((without - squared_error) * weight, axis=1)
    shows = Visibility.of(window, pole, residues, at, worths)
    return Mode(pole, errors.pole, residues, errors, float(quality), shows)
