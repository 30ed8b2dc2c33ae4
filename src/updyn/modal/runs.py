"""Modes whose frequency varies from run to run, distinguished from modes that are close.

Where a sensor moves with its mass, or the structure changes between runs, one mode has another pole
in every run, and a fit with common poles needs several of them, also in neighbouring windows. On
the side that stays they have one shape; with few channels there, common poles and fewer modes with
a pole for each run are compared by their fit. What roves,
responses or references, is tried both ways.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from updyn.modal.measured import Measured
from updyn.modal.refine import (
    Errors,
    Solved,
    Weights,
    Window,
    errors_of,
    moved,
    pole_deviation,
    reweighted,
    solved,
)
from updyn.modal.search import Seen

__all__ = ["Mode", "Weighted", "is_split_off", "modes_of"]

_Complex = NDArray[np.complex128]
_Real = NDArray[np.float64]

#: Poles nearer than this many of their widths together may be one mode.
_CLOSE = 1.5
#: Ratio of the widths of poles that may be one mode.
_DAMPED = 4.0
#: Most modes that poles of a bundle may be, each with poles for each run.
_TOGETHER = 3
#: A run that does not know a mode moves its pole further than so many widths beyond those shared.
_REACH = 3.0
#: Least width of a pole, as a share of its size: without damping it has none.
_UNDAMPED = 1e-6
#: MAC of shapes that are the same, and the channels that can tell.
_ALIKE, _TELL = 0.97, 4
#: Sine of the angle by which residues of one shape differ in phase if they are a leaning peak:
#: those fitted to cubic softening differ by 20 to 60 degrees.
_TURNED = 0.25
#: A mode that explains this share of what the others leave is no part of another one.
_SURE = 0.5
#: A run knows a pole that is worth more than this share of the one that is worth most to it.
_KNOWN = 0.01
#: A pole for each run is tried where a first step promises this share of what it has to gain.
_PROMISED = 0.25
#: Runs that have to know a mode, counted by how evenly its squares are spread over them.
_RUNS = 1.2


@dataclass(frozen=True, slots=True, eq=False)
class Weighted:
    """A window, its fit, and the weights of the fit.

    Attributes
    ----------
    window : Window
        Lines and what else there is.
    solved : Solved
        The fit.
    weights : Weights
        Of the fit.
    added : ndarray of int, shape (k,)
        Of poles that are modes whatever they are worth, as the user has picked them, the number of
        the pick; of others -1.
    """

    window: Window
    solved: Solved
    weights: Weights
    added: NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Mode:
    """A mode as the fits have it.

    Attributes
    ----------
    pole : complex
        In the unit of the variable; where it varies from run to run, the mean.
    std : ndarray of float, shape (2,)
        Of its real and imaginary part: where it varies from run to run, of the runs.
    residues : ndarray of complex, shape (p,)
        Of each channel.
    errors : Errors
        Of the residues.
    quality : float
        Share that it explains of what the others leave, within its half-power band.
    seen : Seen
        How it shows there.
    everywhere : bool
        Whether more than one run knows it.
    added : int
        Number of the pick of one that is a mode whatever it is worth, else -1.
    by_channel : ndarray of complex, shape (p,), or None
        Where it varies from run to run, the pole of each channel.
    single : bool
        Whether its residue is that of one mode; further modes have other poles.
    """

    pole: complex
    std: _Real
    residues: _Complex
    errors: Errors
    quality: float
    seen: Seen
    everywhere: bool = True
    added: int = -1
    by_channel: _Complex | None = None
    single: bool = False

    @property
    def poles(self) -> _Complex:
        """The pole of each channel, shape (p,)."""
        if self.by_channel is None:
            return np.full(len(self.residues), self.pole)
        return self.by_channel


def modes_of(measured: Measured, fits: Sequence[Weighted]) -> list[Mode]:
    """Return the modes of all fits.

    Parameters
    ----------
    measured : Measured
        The data; its responses or its references may be runs.
    fits : sequence of Weighted
        With poles that all runs share.
    """
    modes: list[Mode] = []
    errors = [errors_of(fit.window, fit.solved, fit.weights) for fit in fits]
    for members in _bundles(measured, fits):
        fit, bundle = _together(measured, fits, members)
        for alike, roving in _alike(fit, bundle, measured.runs):
            least = -np.inf  # told by the shapes
            if len(roving) > 1:
                least, roving = 0.0, tuple(of for of in roving if _may_rove(fit, alike, of))
            if (fit.added[alike] >= 0).any():
                roving = ()
            each = None
            for of in (of for of in roving if of.max() > 0):
                criterion = _Criterion.of(fit, alike, of)
                for count in range(1, criterion.most + 1):
                    better = _each(criterion, of, count, least)
                    if better is not None:
                        each, least = better, better.gain
            if each is not None:
                modes += each.modes
            elif _leans(fit, alike):
                modes.append(_leaning(fit, alike))
            else:
                at = [members[bundle.index(r)] for r in alike]
                modes += [_common(fits[k], r, errors[k][r]) for k, r in at]
    return modes


def is_split_off(mode: Mode, modes: list[Mode], shape: tuple[int, ...], mirrored: bool) -> bool:
    """Return whether a mode that explains little may be a part of another one.

    A mode whose frequency varies from run to run may be left in two: then one of them explains
    less than half of what the other leaves, and has its shape on the side that stays.

    Parameters
    ----------
    mode : Mode
        The mode.
    modes : list of Mode
        All of them.
    shape : (int, int)
        Numbers of responses and references.
    mirrored : bool
        Whether poles have mirror images.
    """
    if mode.quality >= _SURE:
        return False
    own, width = _sides(mode, shape), _width(mode.pole, mirrored)
    for other in modes:
        reach = width + _width(other.pole, mirrored)
        if other is mode or abs(other.pole - mode.pole) > reach:
            continue
        macs = [abs(np.vdot(a, b)) ** 2 for a, b in zip(own, _sides(other, shape), strict=True)]
        if max((mac for mac, n in zip(macs, shape, strict=True) if n > 1), default=0.0) > _ALIKE:
            return True
    return False


def _sides(mode: Mode, shape: tuple[int, ...]) -> tuple[_Complex, _Complex]:
    """Return the shapes of unit length at responses and references."""
    U, _, Vh = np.linalg.svd(mode.residues.reshape(shape), full_matrices=False)
    return U[:, 0], Vh[0]


def _width(pole: complex, mirrored: bool) -> float:
    return abs(pole.real if mirrored else pole.imag)


def _alike(
    fit: Weighted, bundle: list[int], runs: tuple[NDArray[np.intp], NDArray[np.intp]]
) -> list[tuple[list[int], tuple[NDArray[np.intp], ...]]]:
    """Return parts of a bundle of one shape, and what may be runs: the side where they differ.

    Poles into which runs have split one mode have its shape on the side that stayed; two modes have
    the same shape nowhere, but a side of few channels cannot tell.
    """
    rows, columns = runs
    residues = fit.solved.residues[bundle].reshape(len(bundle), rows.max() + 1, columns.max() + 1)
    parts: list[tuple[list[int], tuple[NDArray[np.intp], ...]]] = []
    left = list(range(len(bundle)))
    for side, roving in ((residues, columns), (residues.swapaxes(1, 2), rows)):
        if side.shape[1] < _TELL:
            continue
        shapes = np.array([np.linalg.svd(one)[0][:, 0] for one in side])
        mac = np.abs(shapes.conj() @ shapes.T) ** 2
        for seed in range(len(bundle)):
            own = [r for r in left if seed in left and mac[seed, r] > _ALIKE]
            if len(own) > 1:
                parts.append(([bundle[r] for r in own], (roving,)))
                left = [r for r in left if r not in own]
    if left:
        parts.append(([bundle[r] for r in left], runs))
    return parts


def _is_damped(pole: complex, window: Window) -> bool:
    return bool((-pole.real if window.basis.mirrored else pole.imag) > 0.0)


def _may_rove(fit: Weighted, bundle: list[int], runs: NDArray[np.intp]) -> bool:
    """Return whether one mode with a pole for each run can be what poles stand for.

    Of one pole the decrease of the cost by a Gauss-Newton step of each run tells how much may be
    gained, before any of them is fitted.
    """
    if len(bundle) > 1:
        return not _apart(fit, bundle, runs)
    found = fit.solved
    own = [bundle[0]]
    if fit.window.basis.mirrored:
        own.append(bundle[0] + len(found.poles))
    count = int(runs.max()) + 1
    normal = np.zeros((count, len(own), len(own)), dtype=found.normals.dtype)
    gradient = np.zeros((count, len(own), 1), dtype=found.gradients.dtype)
    np.add.at(normal, runs, found.normals[np.ix_(range(len(runs)), own, own)])
    np.add.at(gradient, runs, found.gradients[:, own, None])
    size = np.trace(normal, axis1=1, axis2=2).real
    known = size > 0.0
    normal, gradient = normal[known], gradient[known]
    rounding = 1e-12 * size[known, None, None] * np.eye(len(own))
    step = np.linalg.solve(normal + rounding, gradient)
    promised = float(np.sum((gradient.conj() * step).real))
    return bool(promised > _PROMISED * (count - 1) * np.log(2 * found.error.size))


def _bundles(measured: Measured, fits: Sequence[Weighted]) -> list[list[tuple[int, int]]]:
    """Return poles by fit and position, those together that are close; those added alone.

    Poles of one mode have about one damping; a wide one among narrow ones is background.
    """
    at = [(k, r) for k, fit in enumerate(fits) for r in range(len(fit.solved.poles))]
    poles = np.array([fits[k].solved.poles[r] for k, r in at], dtype=np.complex128)
    added = np.array([fits[k].added[r] >= 0 for k, r in at], dtype=np.bool_)
    mirrored = measured.axis.mirrored
    along = poles.imag if mirrored else poles.real
    width = np.maximum(np.abs(poles.real if mirrored else poles.imag), _UNDAMPED * np.abs(poles))
    order = np.argsort(along, kind="stable")
    bundles: list[list[int]] = []
    for r in order[~added[order]].tolist():
        for bundle in reversed(bundles):
            last = bundle[-1]
            ratio = max(width[r], width[last]) / min(width[r], width[last])
            if along[r] - along[last] < _CLOSE * (width[r] + width[last]) and ratio < _DAMPED:
                bundle.append(r)
                break
        else:
            bundles.append([r])
    bundles += [[r] for r in np.flatnonzero(added).tolist()]
    return [[at[r] for r in bundle] for bundle in bundles]


def _together(
    measured: Measured, fits: Sequence[Weighted], members: list[tuple[int, int]]
) -> tuple[Weighted, list[int]]:
    """Return a fit that holds all poles of a bundle, and their positions in it."""
    parts = sorted({k for k, _ in members})
    if len(parts) == 1:
        return fits[parts[0]], [r for _, r in members]
    poles = np.array([fits[k].solved.poles[r] for k, r in members])
    others = [
        (fit.solved.poles[r], fit.solved.residues[r])
        for k, fit in enumerate(fits)
        for r in range(len(fit.solved.poles))
        if (k, r) not in members
    ]
    beside = np.array([pole for pole, _ in others], dtype=np.complex128)
    residues = np.array([r for _, r in others]).reshape(len(others), -1)
    window = measured.window(measured.lines_of(poles), beside, residues)
    window = replace(window, envelope=fits[parts[0]].window.envelope)
    fitted, weights = reweighted(window, poles, Weights.of(np.abs(window.Y) ** 2))
    return Weighted(window, fitted, weights, np.full(len(poles), -1)), list(range(len(poles)))


@dataclass(frozen=True, slots=True)
class _Criterion:
    """What fits of some lines leave, and what their free values are worth by chance.

    Attributes
    ----------
    fit : Weighted
        The fit with common poles.
    bundle : list of int
        Its poles that are compared with others.
    shapes : int
        How many shapes these have on the side that stays. If they are fewer, each residue counts as
        determined by all channels (G. Schwarz, Ann. Stat. 6 (1978) 461-464), else by its own as in
        `chance`: no mode that the search has accepted is lost.
    """

    fit: Weighted
    bundle: list[int]
    shapes: int

    @property
    def fewer(self) -> bool:
        """Whether there are fewer shapes than poles."""
        return 0 < self.shapes < len(self.bundle)

    @property
    def most(self) -> int:
        """The most modes with poles for each run that are tried."""
        return min(self.shapes, len(self.bundle) - 1, _TOGETHER) if self.fewer else 1

    @classmethod
    def of(cls, fit: Weighted, bundle: list[int], runs: NDArray[np.intp]) -> _Criterion:
        """Return the criterion for poles that may vary with the runs."""
        return cls(fit, bundle, _shapes(fit, bundle, runs))

    def gain(self, cost: float, poles: int, modes: int) -> float:
        """Return by how much a fit is better than that with common poles.

        Parameters
        ----------
        cost : float
            Of the fit.
        poles, modes : int
            Numbers of poles, and of modes with a residue in each channel.
        """
        p, n_f = self.fit.window.Y.shape
        common, count = self.fit.solved.cost, len(self.bundle)
        values = p * n_f if self.fewer else n_f
        free = (poles - count) * np.log(2 * p * n_f) + p * (modes - count) * np.log(2 * values)
        misfit = max(1.0, common / (p * n_f))  # of neighbours, say, by either fit
        inflation = self.fit.window.inflation(self.fit.solved.poles, self.fit.weights)
        own = float(np.mean(inflation[self.bundle]))
        return float(2.0 * ((common - cost) / misfit - own * free))


def _shapes(fit: Weighted, bundle: list[int], runs: NDArray[np.intp]) -> int:
    """Return how many shapes poles have at the channels that stay; 0 where one channel stays."""
    count = int(runs.max()) + 1
    order = np.argsort(runs, kind="stable")
    if len(runs) == count:
        return 0
    different: list[_Complex] = []
    for r in sorted(bundle, key=lambda r: -float(fit.solved.worth[r])):
        shape = np.linalg.svd(fit.solved.residues[r][order].reshape(count, -1))[2][0]
        if all(abs(np.vdot(shape, other)) ** 2 <= _ALIKE for other in different):
            different.append(shape)
    return len(different)


def _apart(fit: Weighted, bundle: list[int], runs: NDArray[np.intp]) -> bool:
    """Return whether each run knows one of the poles only.

    So do sensors in two directions of a structure that moves in one and in the other: a pole for
    each run fits these as well, but there is one for each direction.
    """
    worth = np.array([np.bincount(runs, one) for one in fit.solved.worths[bundle]])
    known = worth > _KNOWN * worth.max(axis=0)
    return bool((known.sum(axis=0) == 1).all())


@dataclass(frozen=True, slots=True, eq=False)
class _Each:
    gain: float
    modes: list[Mode]


def _each(criterion: _Criterion, runs: NDArray[np.intp], modes: int, least: float) -> _Each | None:
    """Return modes with poles for each run, instead of more common ones.

    None if they gain no more than the least.
    """
    fit, bundle = criterion.fit, criterion.bundle
    window, p = fit.window, len(fit.window.Y)
    others = np.delete(fit.solved.poles, bundle)
    beside = np.concatenate([window.beside, others])
    begin = _begin(fit, bundle, modes)
    residues, noise = np.zeros((modes, p), dtype=np.complex128), np.zeros((modes, p))
    common: list[list[_Complex]] = [[] for _ in begin]
    cost, found, deviations = 0.0, [], []
    squares = np.zeros(window.Y.shape)
    count = int(runs.max()) + 1
    for run in range(count):
        own = runs == run
        alone = Window(window.basis, window.x, window.Y[own], beside, envelope=window.envelope)
        weights = fit.weights.of_channels(own)
        one = moved(alone, begin, weights)
        stays = _has_left(fit, bundle, one.poles)  # of a run that does not know the mode
        if stays.any():
            one = solved(alone, np.where(stays, begin, one.poles), weights)
        cost += one.cost
        if criterion.gain(cost, modes * count, modes) <= least:
            return None
        residues[:, own], squares[own] = one.residues, one.left
        found.append(one.poles)
        deviations.append(np.where(stays, np.inf, pole_deviation(alone, one, weights)))
        for r, errors in enumerate(errors_of(alone, one, weights)):
            noise[r, own] = errors.noise
            part = np.zeros((len(errors.common), p), dtype=np.complex128)
            part[:, own] = errors.common
            common[r].append(part)
    each, std = np.array(found), np.array(deviations)  # (runs, modes), (runs, 2, modes)
    if not np.isfinite(std[:, 0]).any(axis=0).all():
        return None
    out = []
    for r in range(modes):
        pole, spread = _mean(each[:, r], std[:, :, r])
        without = _without(window, beside, each, r, runs, fit.weights)
        errors = Errors(noise[r], np.concatenate(common[r]))
        mode = _mode(fit, pole, spread, residues[r], errors, squares, without)
        share = np.bincount(runs, np.abs(residues[r]) ** 2)
        everywhere = float(np.sum(share)) ** 2 >= _RUNS * float(np.sum(share**2))
        own = replace(mode, everywhere=everywhere, by_channel=each[runs, r], single=modes > 1)
        out.append(own)
    return _Each(criterion.gain(cost, modes * count, modes), out)


def _begin(fit: Weighted, bundle: list[int], modes: int) -> _Complex:
    """Return poles to begin with: means of neighbours, so that their weighted squares are least."""
    poles = fit.solved.poles[bundle]
    weight = np.abs(fit.solved.residues[bundle]).sum(axis=1)
    order = np.argsort(_along(poles, fit.window), kind="stable")
    poles, weight = poles[order], weight[order]

    def means(cuts: tuple[int, ...]) -> tuple[float, _Complex]:
        parts = list(pairwise((0, *cuts, len(poles))))
        mean = np.array([np.average(poles[a:b], weights=weight[a:b]) for a, b in parts])
        near = np.repeat(mean, [b - a for a, b in parts])
        return float(np.sum(weight * np.abs(poles - near) ** 2)), mean

    tried = [means(cuts) for cuts in combinations(range(1, len(poles)), modes - 1)]
    return min(tried, key=lambda one: one[0])[1]


def _has_left(fit: Weighted, bundle: list[int], poles: _Complex) -> NDArray[np.bool_]:
    """Return which poles of a run are not damped, or not near those that all runs share."""
    window, shared = fit.window, fit.solved.poles[bundle]
    damped = np.array([_is_damped(complex(pole), window) for pole in poles])
    along, reach = _along(shared, window), _REACH * float(np.max(window.width(shared)))
    near = np.abs(_along(poles, window) - 0.5 * (along.min() + along.max()))
    return ~damped | (near > 0.5 * np.ptp(along) + reach)


def _along(poles: _Complex, window: Window) -> _Real:
    return np.asarray(poles.imag if window.basis.mirrored else poles.real)


def _mean(each: _Complex, std: _Real) -> tuple[complex, _Real]:
    """Return the mean of the poles of the runs and their spread, weighted by their variances."""
    sure = 1.0 / np.maximum(std.T, 1e-12 * np.abs(each)) ** 2
    parts = np.array([each.real, each.imag])
    mean = np.sum(parts * sure, axis=1) / np.sum(sure, axis=1)
    spread = np.sqrt(np.sum((parts - mean[:, None]) ** 2 * sure, axis=1) / np.sum(sure, axis=1))
    return complex(mean[0], mean[1]), spread


def _without(
    window: Window,
    beside: _Complex,
    each: _Complex,
    r: int,
    runs: NDArray[np.intp],
    weights: Weights,
) -> _Real:
    """Return the squared residuals without a mode of which each run has its pole, shape (p, n)."""
    if each.shape[1] == 1:
        whole = Window(window.basis, window.x, window.Y, beside)
        return solved(whole, each[:0, 0], weights).left
    left = np.zeros(window.Y.shape)
    for run, poles in enumerate(each):
        own = runs == run
        alone = Window(window.basis, window.x, window.Y[own], beside)
        left[own] = solved(alone, np.delete(poles, r), weights.of_channels(own)).left
    return left


def _common(fit: Weighted, r: int, errors: Errors) -> Mode:
    """Return a mode with a pole that all channels share."""
    window, found = fit.window, fit.solved
    others = Window(
        window.basis,
        window.x,
        window.Y,
        np.concatenate([window.beside, np.delete(found.poles, r)]),
    )
    without = solved(others, found.poles[:0], fit.weights)
    mode = _mode(
        fit,
        complex(found.poles[r]),
        pole_deviation(window, found, fit.weights)[:, r],
        found.residues[r],
        errors,
        found.left,
        without.left,
    )
    return replace(mode, added=int(fit.added[r]))


def _leans(fit: Weighted, bundle: list[int]) -> bool:
    """Return whether poles are one leaning peak of a mode whose frequency depends on its motion.

    They have one shape at all channels, which two modes have nowhere, but residues of different
    phase, which two modes of light damping and one shape would not have.
    """
    residues = fit.solved.residues[bundle]
    if len(bundle) < 2 or residues.shape[1] < _TELL or (fit.added[bundle] >= 0).any():
        return False
    first = residues[int(np.argmax(fit.solved.worth[bundle]))]
    ratio = residues @ first.conj()
    mac = np.abs(ratio) ** 2 / (np.sum(np.abs(residues) ** 2, axis=1) * np.vdot(first, first).real)
    turned = np.abs(ratio.imag) > _TURNED * np.abs(ratio)
    return bool((mac > _ALIKE).all() and turned.any())


def _leaning(fit: Weighted, bundle: list[int]) -> Mode:
    """Return one mode in place of the poles of a leaning peak.

    Its frequency and damping depend on the motion; their standard deviations are those of the
    poles, weighted by the squared residues, and those of noise as large as the misfit.
    """
    window, weights = fit.window, fit.weights
    beside = np.concatenate([window.beside, np.delete(fit.solved.poles, bundle)])
    alone = replace(window, beside=beside)
    one = moved(alone, _begin(fit, bundle, 1), weights)
    at = window.near(complex(one.poles[0]))
    misfit = max(1.0, float(np.mean(one.squared[:, at])))
    poles = fit.solved.poles[bundle]
    share = np.sum(np.abs(fit.solved.residues[bundle]) ** 2, axis=1)
    off = np.array([(poles - one.poles[0]).real, (poles - one.poles[0]).imag])
    spread = np.average(off**2, axis=1, weights=share)
    std = np.sqrt(spread + misfit * pole_deviation(alone, one, weights)[:, 0] ** 2)
    (errors,) = errors_of(alone, one, weights)
    errors = Errors(misfit * errors.noise, np.sqrt(misfit) * errors.common)
    without = solved(alone, one.poles[:0], weights).left
    pole = complex(one.poles[0])
    return _mode(fit, pole, std, one.residues[0], errors, one.left, without)


def _mode(
    fit: Weighted,
    pole: complex,
    std: _Real,
    residues: _Complex,
    errors: Errors,
    left: _Real,
    without: _Real,
) -> Mode:
    window = fit.window
    at = window.near(pole)
    weight = 1.0 / (fit.weights.channel * fit.weights.line) ** 2
    weight = np.broadcast_to(weight, left.shape)
    quality = 1.0 - np.sum((left * weight)[:, at]) / max(np.sum((without * weight)[:, at]), 1e-300)
    worths = np.sum((without - left) * weight, axis=1)
    shows = Seen.of(window, pole, residues, at, worths)
    return Mode(pole, std, residues, errors, float(quality), shows)
