"""Figures of agreement of a model with measured modes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.errors import DataError, SolverError
from updyn.modal import ModeSet
from updyn.updating.problem.data import ModalSplit
from updyn.updating.problem.modal import ModalPart, Target

__all__ = ["modal_correlation"]


def modal_correlation(part: ModalPart, x: NDArray[np.float64], split: ModalSplit) -> dict[str, Any]:
    """Return the figures before and after a fit, of what was held out, too.

    Parameters
    ----------
    part : ModalPart
        Model and unknowns.
    x : ndarray of float, shape (n,)
        The estimate.
    split : ModalSplit
        The modes.

    Returns
    -------
    dict
        ``before``, ``after`` and, where modes were held out, ``validation`` with both: see
        `updyn.correlation.figures.FIGURE_NAMES`. Empty where modes cannot be computed.
    """
    home = part.coordinates.home
    out: dict[str, Any] = {}
    for when, at in (("before", home), ("after", x)):
        out[when] = _figures(part, split.fitted, at)
        if split.held is not None:
            out.setdefault("validation", {})[when] = _figures(part, split.held, at)
    return out


def _figures(part: ModalPart, modes: ModeSet, x: NDArray[np.float64]) -> dict[str, float]:
    """Return the figures of some modes; of frequencies and damping over those that are paired."""
    own = replace(part, target=Target.of(part.system, modes))
    try:
        rows = own.rows(x, derivatives=False)
    except (SolverError, DataError):
        return {}
    lost = rows.lost(own.like)
    figures = {
        "modes_measured": float(len(modes)),
        "modes_paired": float(len(modes) - len(lost)),
        "mac_median": float(np.median(rows.mac)),
        "mac_min": float(rows.mac.min()),
    }
    off = rows.r[rows.of("frequency")]
    if off.size:
        figures["frequency_error_rms"] = 100.0 * float(np.sqrt(np.mean(off**2)))
        figures["frequency_error_max"] = 100.0 * float(np.abs(off).max())
    damped = rows.r[rows.of("loss_factor")]
    if damped.size:
        figures["loss_factor_error_rms"] = 100.0 * float(np.sqrt(np.mean(damped**2)))
    return figures
