"""The modes of a window, one after the other: each the one that explains most of the residual.

The poles that stay in a stabilisation diagram, the neighbourhood of those already found (a close
pair may look like one pole) and an even grid are tried. A mode is accepted if it lowers the
deviance by more than its free values would by chance (G. Schwarz, Ann. Stat. 6 (1978) 461-464),
times the inflation of the variance by noise that is correlated over lines (`envelope`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.modal.refine import ROUGH, Solved, Weights, Window, deviance, moved, reweighted, solved

__all__ = [
    "LEAST",
    "Seen",
    "chance",
    "is_mode",
    "search_window",
    "shows_on_lines",
]

_Complex = NDArray[np.complex128]
_Real = NDArray[np.float64]

#: Least share that a mode explains of the residual in its half-power band. What it is worth against
#: chance decides: a least share of a half loses true modes of dense bands, of which the neighbours
#: explain most (of 40 modes with 5 % noise 96.0 % are found instead of 98.2 %, of 60 modes 88.5 %
#: instead of 91.5 %; of spurious ones there are 15 instead of 16).
LEAST = 0.1
#: Least share that a mode has of all channels together at its own frequency; its inverse is the
#: largest that other modes may cancel.
_SEEN = 0.1
#: Least share that a mode of a light part has of one channel, so that it shows as a peak there.
_PEAK = 0.5
#: Poles without these that are tried before the search ends.
_REFUSALS = 3
#: Of a pole that is found, trial poles lie at this share of its width on either side.
_BESIDE = 0.7
#: A trial pole is refined if it promises this share of the least gain. A pole of half width a
#: explains 4 a b / ((a + b)^2 + d^2) of one of half width b at a distance d: on the grid, with d up
#: to a / 2 and b from a / 2 to 2 a, at least 0.86.
_PROMISING = 0.5
#: A fit whose residual is less than this share of the squared values is exact.
_EXACT = 1e-11


def chance(window: Window) -> float:
    """Return by how much one more mode may lower the deviance without being there.

    Each number costs the logarithm of the number of values that determine it: for a residue those
    of its channel, for a pole all (M. Delattre, M. Lavielle & M.-A. Poursat, Electron. J. Stat. 8
    (2014) 456-475).
    """
    p, n_f = window.Y.shape
    return float(2 * p * np.log(2 * n_f) + 2 * np.log(2 * p * n_f))


def search_window(window: Window, stable: _Complex, trials: _Complex, most: int) -> Solved:
    """Return the fit of a window with as many modes as it shows.

    Parameters
    ----------
    window : Window
        Lines and what else there is.
    stable, trials : ndarray of complex
        Poles that stay in the diagram, and others that may be modes.
    most : int
        Largest number of modes.

    Notes
    -----
    Before any mode of it is known, a window full of modes looks like one of correlated noise. Poles
    that stay in the diagram, and others within their widths, are accepted as in white noise; those
    that are ripples are removed when all neighbours are fitted (`settle`).
    """
    none = np.zeros(0, dtype=np.complex128)
    fitted, weights = reweighted(window, none, Weights.of(np.abs(window.Y) ** 2))
    whole = float(np.sum(np.abs(window.Y) ** 2))
    refused: list[complex] = []
    while len(fitted.poles) < most and len(refused) < _REFUSALS:
        if float(np.sum(fitted.left)) <= _EXACT * whole:
            break
        own = window.width(fitted.poles)
        sides = [fitted.poles - _BESIDE * own, fitted.poles + _BESIDE * own]
        tried = np.concatenate([stable, trials, *sides])
        promise = _explained(window, fitted, weights, tried)
        for pole in refused:
            promise[np.abs(tried - pole) <= window.width(tried)] = 0.0
        best = tried[int(np.argmax(promise))]
        if promise.max() < _PROMISING * chance(window) * fitted.cost / fitted.error.size:
            break
        more = moved(window, np.append(fitted.poles, best), weights, ROUGH)
        stays = bool((np.abs(stable - best) <= window.width(stable)).any())
        if is_mode(window, fitted, more, weights, white=stays):
            fitted, weights = reweighted(window, more.poles, weights, ROUGH)
        else:
            refused.append(complex(best))
    return fitted


def is_mode(window: Window, fitted: Solved, more: Solved, weights: Weights, *, white: bool) -> bool:
    """Return whether the last pole of a fit may be a mode.

    Parameters
    ----------
    window : Window
        Lines and what else there is.
    fitted, more : Solved
        The fits without and with the pole.
    weights : Weights
        Of both.
    white : bool
        Whether to take all lines as independent.
    """
    pole = complex(more.poles[-1])
    if (-pole.real if window.basis.mirrored else pole.imag) <= 0.0:
        return False
    inflation = 1.0 if white else float(window.inflation(more.poles, weights)[-1])
    if deviance(fitted) - deviance(more) <= inflation * chance(window):
        return False
    if not shows_on_lines(window, fitted, more, weights, inflation):
        return False
    at = window.near(pole)
    if _told(at, fitted, more, weights) < LEAST:
        return False
    shows = Seen.of(window, pole, more.residues[-1], at, more.worths[-1])
    return shows.everywhere or shows.somewhere


def shows_on_lines(
    window: Window, fitted: Solved, more: Solved, weights: Weights, inflation: float
) -> bool:
    """Return whether a pole explains more than one line, as a disturbance would not.

    Parameters
    ----------
    window : Window
        Lines and what else there is.
    fitted, more : Solved
        The fits without and with the pole.
    weights : Weights
        Of the values.
    inflation : float
        Of the pole (`Window.inflation`).
    """
    deviation = weights.channel * weights.line
    strongest = int(np.argmax(np.sum((fitted.left - more.left) / deviation**2, axis=0)))
    if len(window.x) - 1 <= more.columns.Q.shape[1]:
        return False  # too few lines to tell
    others = np.arange(len(window.x)) != strongest
    part = window.of_lines(others)
    weights = Weights(weights.channel, weights.line[:, others])
    without, with_it = (solved(part, fit.poles, weights) for fit in (fitted, more))
    return deviance(without) - deviance(with_it) > inflation * chance(part)


def _told(at: NDArray[np.bool_], fitted: Solved, more: Solved, weights: Weights) -> float:
    """Return the share that the last pole explains of what was left at some lines."""
    weight = 1.0 / (weights.channel * weights.line[:, at]) ** 2
    before, after = (float(np.sum(fit.left[:, at] * weight)) for fit in (fitted, more))
    return 1.0 - after / max(before, 1e-300)


@dataclass(frozen=True, slots=True)
class Seen:
    """How a pole shows at its own frequency.

    Attributes
    ----------
    everywhere : bool
        Whether it has a tenth of all channels together at least.
    somewhere : bool
        Whether it is a peak in one channel.
    cancelled : bool
        Whether other poles cancel nearly all of it.
    """

    everywhere: bool
    somewhere: bool
    cancelled: bool

    @classmethod
    def of(
        cls,
        window: Window,
        pole: complex,
        residues: _Complex,
        at: NDArray[np.bool_],
        worths: _Real,
    ) -> Seen:
        """Return how a pole shows.

        Parameters
        ----------
        window : Window
            Lines and what else there is.
        pole : complex
            The pole.
        residues : ndarray of complex, shape (p,)
            Of each channel.
        at : ndarray of bool, shape (n_f,)
            Lines at its own frequency.
        worths : ndarray of float, shape (p,)
            By how much the cost of each channel would grow without the pole. A channel knows the
            pole if that is more than chance.
        """
        own = np.abs(residues) ** 2 * np.sum(np.abs(1.0 / (window.x[at] - pole)) ** 2)
        measured = np.abs(window.measured) ** 2
        whole = np.maximum(np.sum(measured[:, at], axis=1), 1e-300)
        # Over the window, since everything is large where the channel has an antiresonance.
        level = np.median(measured, axis=1) * np.count_nonzero(at)
        known = worths > np.log(2 * window.Y.size)
        share = np.sum(own) / np.sum(whole)
        return cls(
            bool(share >= _SEEN**2),
            bool(np.any(known & (own >= _PEAK**2 * np.maximum(whole, level)))),
            bool(share > 1.0 / _SEEN**2),
        )


def _explained(window: Window, fitted: Solved, weights: Weights, tried: _Complex) -> _Real:
    """Return by how much the cost would fall with each trial pole, where it is."""
    inverse = weights.common
    Q = np.linalg.qr(_complex(window, fitted.poles) * inverse[:, None])[0]
    columns = inverse[:, None] / (window.x[:, None] - tried)
    columns /= np.linalg.norm(columns, axis=0)
    columns = columns - Q @ (Q.conj().T @ columns)
    left = np.sum(np.abs(columns) ** 2, axis=0)
    error = (window.Y / weights.channel * inverse).T
    error = error - Q @ (Q.conj().T @ error)
    # A column that the fit spans already has nothing of its own but rounding.
    return np.where(
        left > 1e-12,
        np.sum(np.abs(columns.conj().T @ error) ** 2, axis=1) / np.maximum(left, 1e-12),
        0.0,
    )


def _complex(window: Window, poles: _Complex) -> _Complex:
    """Return the functions of the fit with complex weights."""
    both = window.columns(poles)
    if not window.basis.mirrored:
        return np.asarray(both)
    n_f = len(window.x)
    return np.asarray(both[:n_f] + 1j * both[n_f:])
