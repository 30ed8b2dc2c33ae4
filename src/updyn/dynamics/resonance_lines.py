"""`resonance_lines`: frequencies at which to compute FRFs so that no resonance is missed."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray

from updyn.dynamics.eigen import mass_rank
from updyn.dynamics.modes import Modes, modes
from updyn.errors import ModelError, SolverError
from updyn.model import Model

__all__ = ["even_lines", "resonance_lines"]

#: Lines about a resonance. Even, so that none falls on the natural frequency itself, where an
#: undamped model has no response; the nearest two reach 0.995 of the peak.
_PER_RESONANCE = 16
_FEWEST = 4
#: Loss factor of a resonance without damping, for the width that its lines cover.
_LEAST_LOSS = 1e-4
#: Modes computed at first.
_FIRST_MODES = 20


def even_lines(low: float, high: float, n: int) -> NDArray[np.float64]:
    """Return lines between two frequencies: half of them evenly spaced, half by equal ratios.

    Parameters
    ----------
    low, high : float
        In Hz, both above 0.
    n : int
        How many, at least 2.

    Returns
    -------
    ndarray of float
        Ascending, in Hz, the ends included; at most `n`.
    """
    half = max(n // 2, 2)
    lines = np.concatenate([np.linspace(low, high, half), np.geomspace(low, high, half)])
    return np.unique(np.clip(lines, low, high))


def resonance_lines(model: Model, low: float, high: float, limit: int) -> NDArray[np.float64]:
    """Return lines that resolve the resonances of a model in a band.

    About a natural frequency f with loss factor eta they are f sqrt(1 + eta tan(theta)), theta
    evenly spaced: at equal distances along the circle that the response of the mode describes in
    the complex plane (Kennedy & Pancu, J. Aeronaut. Sci. 14 (1947) 603-625).

    Parameters
    ----------
    model : Model
        The structure, with its damping.
    low, high : float
        The band in Hz.
    limit : int
        How many lines at most. Of more modes than have four lines each, the lowest are resolved.

    Returns
    -------
    ndarray of float
        Ascending, in Hz, within the band; none where the modes cannot be computed.
    """
    found = _modes_up_to(model, high, limit // _FEWEST)
    if found is None:
        return np.empty(0)
    # A resonance just outside the band bends the curve at its edge.
    inside = (found.frequency > 0.9 * low) & (found.frequency < 1.1 * high)
    frequency, loss = found.frequency[inside], found.loss_factor[inside]
    if not len(frequency):
        return np.empty(0)
    n = int(np.clip(limit // len(frequency), _FEWEST, _PER_RESONANCE))
    n -= n % 2
    theta = np.pi * ((np.arange(n) + 0.5) / n - 0.5)
    square = 1.0 + np.outer(np.maximum(loss, _LEAST_LOSS), np.tan(theta))
    lines = (frequency[:, None] * np.sqrt(np.maximum(square, 0.0))).ravel()
    lines = np.unique(lines[(lines >= low) & (lines <= high)])
    return np.asarray(lines[:limit], dtype=np.float64)


def _modes_up_to(model: Model, high: float, most: int) -> Modes | None:
    """Return the modes of a model up to a frequency, `most` at most; None where there are none."""
    found = None
    n, most = _FIRST_MODES, min(most, mass_rank(model.mass))
    while most > 0:
        n = min(n, most)
        try:
            with warnings.catch_warnings():
                # An indefinite stiffness was reported where the model was made.
                warnings.simplefilter("ignore")
                found = modes(model, n)
        except (ModelError, SolverError):
            return found
        if n == most or found.frequency[-1] > high:
            return found
        n *= 2
    return found
