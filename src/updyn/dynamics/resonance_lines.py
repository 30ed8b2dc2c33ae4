"""Frequencies of FRFs that resolve all resonances of a model."""

from __future__ import annotations

import warnings

import numpy as np

from updyn.arrays import RealArray
from updyn.dynamics.eigen import mass_rank
from updyn.dynamics.modes import Modes, modes
from updyn.dynamics.settings import RESONANCE_LINES
from updyn.errors import ModelError, SolverError
from updyn.model import Model

__all__ = ["even_lines", "resonance_lines"]


def even_lines(low: float, high: float, n: int) -> RealArray:
    """Return at most n lines between two frequencies, half evenly spaced, half by equal ratios."""
    half = max(n // 2, 2)
    lines = np.concatenate([np.linspace(low, high, half), np.geomspace(low, high, half)])
    return np.unique(np.clip(lines, low, high))


def resonance_lines(model: Model, low: float, high: float, limit: int) -> RealArray:
    """Return lines in a band (Hz) that resolve resonances; none if the modes are not computable."""
    # The lines of a mode are f sqrt(1 + eta tan(theta)) with evenly spaced theta: equal distances
    # along its circle in the complex plane (Kennedy & Pancu, J. Aeronaut. Sci. 14 (1947) 603-625).
    # If `limit` permits fewer than four lines for each mode, only the lowest modes are resolved.
    found = _modes_up_to(model, high, limit // RESONANCE_LINES.least_lines)
    if found is None:
        return np.empty(0)
    # A resonance just outside the band affects the curve at its edge.
    inside = (found.frequency > 0.9 * low) & (found.frequency < 1.1 * high)
    frequency, loss = found.frequency[inside], found.loss_factor[inside]
    if not len(frequency):
        return np.empty(0)
    n = max(limit // len(frequency), RESONANCE_LINES.least_lines)
    n = min(n, RESONANCE_LINES.lines_per_resonance)
    n -= n % 2
    theta = np.pi * ((np.arange(n) + 0.5) / n - 0.5)
    square = 1.0 + np.outer(np.maximum(loss, RESONANCE_LINES.least_loss), np.tan(theta))
    lines = (frequency[:, None] * np.sqrt(np.maximum(square, 0.0))).ravel()
    lines = np.unique(lines[(lines >= low) & (lines <= high)])
    return np.asarray(lines[:limit], dtype=np.float64)


def _modes_up_to(model: Model, high: float, most: int) -> Modes | None:
    """Return at most `most` modes of a model up to a frequency, or None if there are no modes."""
    found = None
    n, most = RESONANCE_LINES.first_modes, min(most, mass_rank(model.mass))
    while most > 0:
        n = min(n, most)
        try:
            with warnings.catch_warnings():
                # An indefinite stiffness was reported when the model was made.
                warnings.simplefilter("ignore")
                found = modes(model, n)
        except (ModelError, SolverError):
            return found
        if n == most or found.frequency[-1] > high:
            return found
        n *= 2
    return found
