"""Modes whose frequency varies from run to run, told from modes that are close to each other.

Where a sensor moves with its mass, or the structure changes between runs, one mode has another pole
in every run, and a fit with common poles needs several of them. On the side that stays they have
one shape, by which they are told; with few channels there, several common poles and one pole for
each run, which have about as many free values, are compared by how well they fit. What roves,
responses or references, is tried both ways.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from updyn.modal.refine import (
    Errors,
    Solved,
    Weights,
    Window,
    errors_of,
    moved,
    pole_deviation,
    solved,
)
from updyn.modal.search import Seen

__all__ = ["Mode", "Weighted", "is_split_off", "modes_of"]

_Complex = NDArray[np.complex128]
_Real = NDArray[np.float64]

#: Poles nearer than this many of their widths together may be one mode.
_CLOSE = 1.5
#: MAC of shapes that are the same, and the channels that can tell.
_ALIKE, _TELL = 0.97, 4
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

    @property
    def poles(self) -> _Complex:
        """The pole of each channel, shape (p,)."""
        if self.by_channel is None:
            return np.full(len(self.residues), self.pole)
        return self.by_channel


def modes_of(fit: Weighted, runs: tuple[NDArray[np.intp], NDArray[np.intp]]) -> list[Mode]:
    """Return the modes of a window.

    Parameters
    ----------
    fit : Weighted
        With common poles.
    runs : tuple of ndarray of int, shapes (p,)
        Numbers of the response and of the reference of each channel, either of which may be runs.
    """
    modes, errors = [], errors_of(fit.window, fit.solved, fit.weights)
    for bundle in _bundles(fit):
        for alike, roving in _alike(fit, bundle, runs):
            least = np.inf
            if len(roving) > 1:  # not told by the shapes
                least = _criterion(fit, fit.solved.cost, len(alike), len(alike))
                roving = tuple(of for of in roving if _may_rove(fit, alike, of))
            if (fit.added[alike] >= 0).any():
                roving = ()
            tried = [_each(fit, alike, of, least) for of in roving if of.max() > 0]
            each = [one for one in tried if one is not None]
            if each:
                modes.append(min(each, key=lambda one: one.criterion).mode)
            else:
                modes += [_common(fit, r, errors[r]) for r in alike]
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


def _bundles(fit: Weighted) -> list[list[int]]:
    """Return positions of poles, those together that are close; those added alone."""
    poles, window = fit.solved.poles, fit.window
    along, width = poles.imag if window.basis.mirrored else poles.real, window.width(poles)
    order = np.argsort(along, kind="stable")
    bundles: list[list[int]] = []
    for r in order[fit.added[order] < 0]:
        if bundles:
            last = bundles[-1][-1]
            if along[r] - along[last] < _CLOSE * (width[r] + width[last]):
                bundles[-1].append(int(r))
                continue
        bundles.append([int(r)])
    return bundles + [[int(r)] for r in np.flatnonzero(fit.added >= 0)]


def _criterion(fit: Weighted, cost: float, poles: int, residues: int) -> float:
    """Return the residual of a fit, and what its free values are worth by chance.

    After G. Schwarz, Ann. Stat. 6 (1978) 461-464.
    """
    p, n_f = fit.window.Y.shape
    return float(2.0 * cost + (2 * poles + 2 * p * residues) * np.log(2 * p * n_f))


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
    criterion: float
    mode: Mode


def _each(fit: Weighted, bundle: list[int], runs: NDArray[np.intp], least: float) -> _Each | None:
    """Return one mode with a pole for each run, instead of several common ones.

    None where its criterion is not below the least so far.
    """
    window, poles = fit.window, fit.solved.poles
    others = np.delete(poles, bundle)
    weight = np.abs(fit.solved.residues[bundle]).sum(axis=1)
    begin = np.array([np.sum(poles[bundle] * weight) / np.sum(weight)])
    beside = np.concatenate([window.beside, others])
    p = len(window.Y)
    residues = np.zeros(p, dtype=np.complex128)
    noise, common = np.zeros(p), []
    cost, found, deviations = 0.0, [], []
    squares = np.zeros(window.Y.shape)
    count = int(runs.max()) + 1
    for run in range(count):
        own = runs == run
        alone = Window(window.basis, window.x, window.Y[own], beside, envelope=window.envelope)
        weights = fit.weights.of_channels(own)
        one = moved(alone, begin, weights)
        stays = not _is_damped(one.poles[0], window)  # a run that does not know the mode
        if stays:
            one = solved(alone, begin, weights)
        cost += one.cost
        if _criterion(fit, cost, count, 1) >= least:
            return None
        residues[own] = one.residues[0]
        squares[own] = one.left
        found.append(one.poles[0])
        deviation = pole_deviation(alone, one, weights)[:, 0]
        deviations.append(np.full(2, np.inf) if stays else deviation)
        (errors,) = errors_of(alone, one, weights)
        noise[own] = errors.noise
        common.append(np.zeros((len(errors.common), p), dtype=np.complex128))
        common[-1][:, own] = errors.common
    each, std = np.array(found), np.array(deviations).T
    if not np.isfinite(std).any():
        return None
    sure = 1.0 / np.maximum(std, 1e-12 * np.abs(begin)) ** 2
    parts = np.array([each.real, each.imag])
    mean = np.sum(parts * sure, axis=1) / np.sum(sure, axis=1)
    spread = np.sqrt(np.sum((parts - mean[:, None]) ** 2 * sure, axis=1) / np.sum(sure, axis=1))
    pole = complex(mean[0], mean[1])
    without = solved(Window(window.basis, window.x, window.Y, beside), each[:0], fit.weights)
    errors = Errors(noise, np.concatenate(common))
    mode = _mode(fit, pole, spread, residues, errors, squares, without.left)
    share = np.bincount(runs, np.abs(residues) ** 2)
    everywhere = float(np.sum(share)) ** 2 >= _RUNS * float(np.sum(share**2))
    mode = replace(mode, everywhere=everywhere, by_channel=each[runs])
    return _Each(_criterion(fit, cost, count, 1), mode)


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
