"""Modes with a different frequency in each run, distinguished from close modes.

If a sensor moves with its mass, or the structure changes between runs, a fit with common poles
needs several for one mode, of the same shape on the fixed side. If that side has few channels,
common poles are compared with fewer modes that have a pole for each run. Responses and references
are both tried as roving.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, IndexArray, RealArray
from updyn.modal.fits import (
    Mode,
    WeightedFit,
    bundle_poles,
    fit_together,
    make_mode,
    position,
    take_means,
)
from updyn.modal.leaning import Bundle, PolesByRun, find_leaning
from updyn.modal.measured import Measured
from updyn.modal.refine import (
    Errors,
    LineWindow,
    Weights,
    WindowFit,
    deviance,
    estimate_errors,
    fit_poles,
    fit_residues,
)
from updyn.modal.settings import POLE_BUNDLE

__all__ = ["extract_modes", "is_split_off"]


def extract_modes(measured: Measured, fits: Sequence[WeightedFit]) -> list[Mode]:
    """Return the modes of fits with common poles of all runs (responses or references)."""
    errors = [estimate_errors(fit.window, fit.window_fit, fit.weights) for fit in fits]
    bundles, by_run = [], {}
    for members in bundle_poles(measured, fits):
        fit, positions = fit_together(measured, fits, members)
        claims = []
        for poles, roving in _group_by_shape(fit, positions, measured.runs):
            each = _fit_by_run(fit, poles, roving)
            if each is not None:
                claimed = frozenset(members[positions.index(r)] for r in poles)
                by_run[claimed] = each
                claims.append(PolesByRun(claimed, each.cost, each.evidence))
        bundles.append(Bundle(members, fit, positions, claims))
    leaning = find_leaning(measured, fits, bundles) if fits else []
    taken = {member for peak in leaning for member in peak.members}
    modes = [peak.mode() for peak in leaning]
    for claimed, each in by_run.items():
        if not claimed & taken:
            modes += each.modes
            taken |= claimed
    for bundle in bundles:
        unclaimed = [member for member in bundle.members if member not in taken]
        modes += [_mode_with_common_pole(fits[k], r, errors[k][r]) for k, r in unclaimed]
    return modes


def _fit_by_run(
    fit: WeightedFit, poles: list[int], roving: tuple[IndexArray, ...]
) -> _ModesByRun | None:
    """Return modes with poles for each run in place of poles of a bundle; None if no better."""
    if (fit.added[poles] >= 0).any():
        return None
    least, each = -np.inf, None  # the shapes decide
    if len(roving) > 1:
        least, roving = 0.0, tuple(of for of in roving if _may_rove(fit, poles, of))
    for of in (of for of in roving if of.max() > 0):
        criterion = _Criterion.of(fit, poles, of)
        for count in range(1, criterion.most + 1):
            better = _find_modes_by_run(criterion, of, count, least)
            if better is not None:
                each, least = better, better.gain
    return each


def is_split_off(mode: Mode, modes: list[Mode], shape: tuple[int, ...], mirrored: bool) -> bool:
    """Return whether a mode that explains little may be part of another mode.

    Then it explains less than half of the residual without it, and has the shape of the other on
    the fixed side. `shape` are the numbers of responses and references.
    """
    if mode.quality >= POLE_BUNDLE.own_share:
        return False
    shapes, width = _shapes_of_unit_length(mode, shape), _pole_width(mode.pole, mirrored)
    for other in modes:
        reach = width + _pole_width(other.pole, mirrored)
        if other is mode or abs(other.pole - mode.pole) > reach:
            continue
        macs = [
            abs(np.vdot(a, b)) ** 2
            for a, b in zip(shapes, _shapes_of_unit_length(other, shape), strict=True)
        ]
        largest = max((mac for mac, n in zip(macs, shape, strict=True) if n > 1), default=0.0)
        if largest > POLE_BUNDLE.same_shape_mac:
            return True
    return False


def _shapes_of_unit_length(mode: Mode, shape: tuple[int, ...]) -> tuple[ComplexArray, ComplexArray]:
    """Return the shapes of unit length at responses and references."""
    U, _, Vh = np.linalg.svd(mode.residues.reshape(shape), full_matrices=False)
    return U[:, 0], Vh[0]


def _pole_width(pole: complex, mirrored: bool) -> float:
    return abs(pole.real if mirrored else pole.imag)


def _group_by_shape(
    fit: WeightedFit, bundle: list[int], runs: tuple[IndexArray, IndexArray]
) -> list[tuple[list[int], tuple[IndexArray, ...]]]:
    """Return parts of a bundle with one shape each, and the sides that may be roving."""
    # A mode split by runs has poles of the same shape on the fixed side; two modes have it on
    # neither. A side of few channels does not distinguish these cases.
    rows, columns = runs
    residues = fit.window_fit.residues[bundle].reshape(
        len(bundle), rows.max() + 1, columns.max() + 1
    )
    parts: list[tuple[list[int], tuple[IndexArray, ...]]] = []
    remaining = list(range(len(bundle)))
    for side, roving in ((residues, columns), (residues.swapaxes(1, 2), rows)):
        if side.shape[1] < POLE_BUNDLE.least_channels:
            continue
        shapes = np.array([np.linalg.svd(one)[0][:, 0] for one in side])
        mac = np.abs(shapes.conj() @ shapes.T) ** 2
        for seed in range(len(bundle)):
            alike = mac[seed] > POLE_BUNDLE.same_shape_mac
            similar = [r for r in remaining if seed in remaining and alike[r]]
            if len(similar) > 1:
                parts.append(([bundle[r] for r in similar], (roving,)))
                remaining = [r for r in remaining if r not in similar]
    if remaining:
        parts.append(([bundle[r] for r in remaining], runs))
    return parts


def _is_damped(pole: complex, window: LineWindow) -> bool:
    return bool((-pole.real if window.basis.mirrored else pole.imag) > 0.0)


def _may_rove(fit: WeightedFit, bundle: list[int], runs: IndexArray) -> bool:
    """Return whether poles may be one mode with a pole for each run."""
    # For a single pole, one Gauss-Newton step in each run predicts the gain before any fit.
    if len(bundle) > 1:
        return not _are_in_separate_runs(fit, bundle, runs)
    expected_decrease = float(np.sum(_first_steps(fit, bundle[0], runs)[1]))
    required = runs.max() * np.log(2 * fit.window_fit.error.size)
    return bool(expected_decrease > POLE_BUNDLE.promised_share * required)


def _first_steps(fit: WeightedFit, pole: int, runs: IndexArray) -> tuple[ComplexArray, RealArray]:
    """Return a Gauss-Newton step of a pole in each run, and its expected decrease of the cost."""
    found = fit.window_fit
    columns = [pole]
    if fit.window.basis.mirrored:
        columns.append(pole + len(found.poles))
    count = int(runs.max()) + 1
    normal = np.zeros((count, len(columns), len(columns)), dtype=found.normals.dtype)
    gradient = np.zeros((count, len(columns), 1), dtype=found.gradients.dtype)
    np.add.at(normal, runs, found.normals[np.ix_(range(len(runs)), columns, columns)])
    np.add.at(gradient, runs, found.gradients[:, columns, None])
    size = np.trace(normal, axis1=1, axis2=2).real
    normal[size == 0.0] = np.eye(len(columns))
    rounding = 1e-12 * size[:, None, None] * np.eye(len(columns))
    step = np.linalg.solve(normal + rounding, gradient)
    decrease = np.sum((gradient.conj() * step).real, axis=(1, 2))
    step = step[:, :, 0] @ (np.array([1.0, 1j]) if len(columns) == 2 else np.ones(1))
    return np.asarray(step), decrease


@dataclass(frozen=True, slots=True)
class _Criterion:
    """Criterion to compare fits of some lines by cost and number of free values.

    `shapes` is the number of shapes of the poles `bundle` on the fixed side. With fewer shapes than
    poles, each residue counts as determined by all channels (G. Schwarz, Ann. Stat. 6 (1978)
    461-464), else by its channel as in `chance_gain`, so that no accepted mode is lost.
    """

    fit: WeightedFit
    bundle: list[int]
    shapes: int
    #: Mean variance of the residues of the bundle, relative to white noise.
    inflation: float

    @property
    def fewer(self) -> bool:
        """Whether there are fewer shapes than poles."""
        return 0 < self.shapes < len(self.bundle)

    @property
    def most(self) -> int:
        """Largest number of modes with poles for each run to try."""
        return min(self.shapes, len(self.bundle) - 1, POLE_BUNDLE.most_modes) if self.fewer else 1

    @classmethod
    def of(cls, fit: WeightedFit, bundle: list[int], runs: IndexArray) -> _Criterion:
        """Return the criterion for poles that may vary with the runs."""
        inflation = fit.window.inflation(fit.window_fit.poles, fit.weights)[bundle]
        return cls(fit, bundle, _count_shapes(fit, bundle, runs), float(np.mean(inflation)))

    def gain(self, cost: float, poles: int, modes: int) -> float:
        """Return the gain of a fit with numbers of poles and modes over that with common poles."""
        common = self.fit.window_fit.cost
        misfit = max(1.0, common / self.fit.window.Y.size)  # errors common to both fits
        return 2.0 * (common - cost) / misfit - self.least(poles, modes)

    def least(self, poles: int, modes: int) -> float:
        """Return the gain of numbers of poles and modes by chance, in the unit of `gain`."""
        p, n_f = self.fit.window.Y.shape
        count = len(self.bundle)
        values = p * n_f if self.fewer else n_f
        free = (poles - count) * np.log(2 * p * n_f) + p * (modes - count) * np.log(2 * values)
        return float(2.0 * self.inflation * free)


def _count_shapes(fit: WeightedFit, bundle: list[int], runs: IndexArray) -> int:
    """Return the number of shapes of poles at the fixed channels; 0 for a single channel."""
    count = int(runs.max()) + 1
    order = np.argsort(runs, kind="stable")
    if len(runs) == count:
        return 0
    different: list[ComplexArray] = []
    for r in sorted(bundle, key=lambda r: -float(fit.window_fit.cost_increase[r])):
        shape = np.linalg.svd(fit.window_fit.residues[r][order].reshape(count, -1))[2][0]
        macs = [abs(np.vdot(shape, other)) ** 2 for other in different]
        if all(mac <= POLE_BUNDLE.same_shape_mac for mac in macs):
            different.append(shape)
    return len(different)


def _are_in_separate_runs(fit: WeightedFit, bundle: list[int], runs: IndexArray) -> bool:
    """Return whether each run contains only one of the poles."""
    # Example: sensors in two directions of a structure with one mode in each. Poles for each run
    # fit these as well.
    increase = np.array(
        [np.bincount(runs, one) for one in fit.window_fit.cost_increase_by_channel[bundle]]
    )
    known = increase > POLE_BUNDLE.known_share * increase.max(axis=0)
    return bool((known.sum(axis=0) == 1).all())


@dataclass(frozen=True, slots=True, eq=False)
class _ModesByRun:
    """Modes with poles for each run, with their `gain` by the criterion.

    `evidence` is the gain in deviance, with the noise of each fit, to compare with leaning peaks.
    """

    gain: float
    cost: float
    evidence: float
    modes: list[Mode]


def _is_in_several_runs(residues: ComplexArray, runs: IndexArray) -> bool:
    """Return whether the squares of residues, shape (p,), are distributed over several runs."""
    share = np.bincount(runs, np.abs(residues) ** 2)
    least = POLE_BUNDLE.least_effective_runs * float(np.sum(share**2))
    return float(np.sum(share)) ** 2 >= least


@dataclass(frozen=True, slots=True, eq=False)
class _RunFit:
    """Fit of the channels of a run; poles that it does not contain have strayed and are common."""

    channels: BoolArray
    fit: WindowFit
    weights: Weights
    has_strayed: BoolArray


def _fit_each_run(
    criterion: _Criterion,
    runs: IndexArray,
    begin: ComplexArray,
    fixed_poles: ComplexArray,
    least: float,
) -> list[_RunFit] | None:
    """Return the fits of all runs from the poles `begin`; None if the gain is not above `least`."""
    fit, window, count = criterion.fit, criterion.fit.window, int(runs.max()) + 1
    fits: list[_RunFit] = []
    cost = 0.0
    first = np.tile(begin, (count, 1))
    if len(criterion.bundle) == 1:
        step = _first_steps(fit, criterion.bundle[0], runs)[0][:, None]
        first += step / np.maximum(1.0, np.abs(step) / window.width(begin))
    for run in range(count):
        in_run = runs == run
        alone = LineWindow(
            window.basis, window.x, window.Y[in_run], fixed_poles, envelope=window.envelope
        )
        weights = fit.weights.of_channels(in_run)
        one = fit_poles(alone, first[run], weights)
        has_strayed = _have_strayed(fit, criterion.bundle, one.poles)
        if has_strayed.any():
            one = fit_residues(alone, np.where(has_strayed, begin, one.poles), weights)
        cost += one.cost
        if criterion.gain(cost, len(begin) * count, len(begin)) <= least:
            return None
        fits.append(_RunFit(in_run, one, weights, has_strayed))
    return fits


def _find_modes_by_run(
    criterion: _Criterion, runs: IndexArray, modes: int, least: float
) -> _ModesByRun | None:
    """Return modes with poles for each run; None if the gain is not above `least`."""
    fit, bundle = criterion.fit, criterion.bundle
    window, p = fit.window, len(fit.window.Y)
    others = np.delete(fit.window_fit.poles, bundle)
    fixed_poles = np.concatenate([window.fixed_poles, others])
    begin = take_means(fit, bundle, modes)
    count = int(runs.max()) + 1
    fits = _fit_each_run(criterion, runs, begin, fixed_poles, least)
    if fits is None:
        return None
    cost = sum(run.fit.cost for run in fits)
    residues, noise = np.zeros((modes, p), dtype=np.complex128), np.zeros((modes, p))
    common: list[list[ComplexArray]] = [[] for _ in begin]
    found, deviations, fitted = [], [], 0.0
    squares = np.zeros(window.Y.shape)
    for run in fits:
        one, alone, weights, in_run = run.fit, run.fit.window, run.weights, run.channels
        fitted += deviance(one)
        residues[:, in_run], squares[in_run] = one.residues, one.squared_error
        found.append(one.poles)
        errors_of_run = estimate_errors(alone, one, weights)
        deviation = np.array([errors.pole for errors in errors_of_run]).T
        deviations.append(np.where(run.has_strayed, np.inf, deviation))
        for r, errors in enumerate(errors_of_run):
            noise[r, in_run] = errors.noise
            part = np.zeros((len(errors.common), p), dtype=np.complex128)
            part[:, in_run] = errors.common
            common[r].append(part)
    each, std = np.array(found), np.array(deviations)  # (runs, modes), (runs, 2, modes)
    if not np.isfinite(std[:, 0]).any(axis=0).all():
        return None
    out = []
    for r in range(modes):
        pole, spread = _average_poles(each[:, r], std[:, :, r])
        without = _residual_without(window, fixed_poles, each, r, runs, fit.weights)
        errors = Errors(noise[r], np.concatenate(common[r]), spread)
        mode = make_mode(fit, pole, residues[r], errors, squares, without)
        everywhere = _is_in_several_runs(residues[r], runs)
        complete = replace(mode, everywhere=everywhere, by_channel=each[runs, r], single=modes > 1)
        out.append(complete)
    evidence = deviance(fit.window_fit) - fitted - criterion.least(modes * count, modes)
    return _ModesByRun(criterion.gain(cost, modes * count, modes), cost, evidence, out)


def _have_strayed(fit: WeightedFit, bundle: list[int], poles: ComplexArray) -> BoolArray:
    """Return which poles of a run are undamped, or far from the common poles."""
    window, shared = fit.window, fit.window_fit.poles[bundle]
    damped = np.array([_is_damped(complex(pole), window) for pole in poles])
    along = position(shared, window)
    reach = POLE_BUNDLE.run_reach * float(np.max(window.width(shared)))
    near = np.abs(position(poles, window) - 0.5 * (along.min() + along.max()))
    return ~damped | (near > 0.5 * np.ptp(along) + reach)


def _average_poles(each: ComplexArray, std: RealArray) -> tuple[complex, RealArray]:
    """Return mean and spread of the poles of the runs, weighted by their variances."""
    sure = 1.0 / np.maximum(std.T, 1e-12 * np.abs(each)) ** 2
    parts = np.array([each.real, each.imag])
    mean = np.sum(parts * sure, axis=1) / np.sum(sure, axis=1)
    spread = np.sqrt(np.sum((parts - mean[:, None]) ** 2 * sure, axis=1) / np.sum(sure, axis=1))
    return complex(mean[0], mean[1]), spread


def _residual_without(
    window: LineWindow,
    fixed_poles: ComplexArray,
    each: ComplexArray,
    r: int,
    runs: IndexArray,
    weights: Weights,
) -> RealArray:
    """Return the squared residuals without mode `r`, which has a pole for each run, (p, n)."""
    if each.shape[1] == 1:
        window_without = LineWindow(window.basis, window.x, window.Y, fixed_poles)
        return fit_residues(window_without, each[:0, 0], weights).squared_error
    squared_error = np.zeros(window.Y.shape)
    for run, poles in enumerate(each):
        in_run = runs == run
        alone = LineWindow(window.basis, window.x, window.Y[in_run], fixed_poles)
        squared_error[in_run] = fit_residues(
            alone, np.delete(poles, r), weights.of_channels(in_run)
        ).squared_error
    return squared_error


def _mode_with_common_pole(fit: WeightedFit, r: int, errors: Errors) -> Mode:
    window, found = fit.window, fit.window_fit
    others = LineWindow(
        window.basis,
        window.x,
        window.Y,
        np.concatenate([window.fixed_poles, np.delete(found.poles, r)]),
    )
    without = fit_residues(others, found.poles[:0], fit.weights)
    mode = make_mode(
        fit,
        complex(found.poles[r]),
        found.residues[r],
        errors,
        found.squared_error,
        without.squared_error,
    )
    return replace(mode, added=int(fit.added[r]))
