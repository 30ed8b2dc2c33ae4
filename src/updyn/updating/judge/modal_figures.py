"""Figures of agreement between a model and measured modes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from updyn.arrays import RealArray
from updyn.correlation.clusters import PairingRule, pair_clusters
from updyn.correlation.shapes import find_moving
from updyn.errors import DataError, SolverError
from updyn.modal import ModeSet
from updyn.updating.problem.data import ModalSplit
from updyn.updating.problem.modal import ModalPart, ModalTarget, drop_excluded_shapes

__all__ = ["correlate_measured_modes"]


def correlate_measured_modes(part: ModalPart, x: RealArray, split: ModalSplit) -> dict[str, object]:
    """Return the figures ``before``, ``after`` and, of held-out modes, ``validation`` with both.

    The figures are empty if modes cannot be computed.
    """
    home = part.coordinates.start
    out: dict[str, Any] = {}
    for when, at in (("before", home), ("after", x)):
        out[when] = _compute_figures(part, split.fitted, at)
        if split.held is not None:
            out.setdefault("validation", {})[when] = _compute_figures(part, split.held, at)
    return out


def _compute_figures(part: ModalPart, modes: ModeSet, x: RealArray) -> dict[str, float]:
    """Return the figures of some modes; frequency and damping errors are over the paired modes."""
    modes = drop_excluded_shapes(modes, part.noise)
    selected = replace(part, target=ModalTarget.of(part.system, modes))
    try:
        rows = selected.rows(x, derivatives=False)
        macs, close = _with_subspaces(selected, x, rows.mac)
    except (SolverError, DataError):
        return {}
    figures = {
        "modes_measured": float(len(modes)),
        "modes_paired": float(np.sum(macs >= selected.least_mac)),
    }
    if modes.has_shapes:
        figures |= {"mac_median": float(np.median(macs)), "mac_min": float(macs.min())}
    if len(close):
        figures["modes_close"] = float(len(close))
    by_subspace = [
        close[k]
        for k in rows.unpaired_modes(selected.least_mac).tolist()
        if k in close and macs[k] >= selected.least_mac
    ]
    frequency_errors = np.append(rows.r[rows.of("frequency")], by_subspace)
    if frequency_errors.size:
        figures["frequency_error_rms"] = 100.0 * float(np.sqrt(np.mean(frequency_errors**2)))
        figures["frequency_error_max"] = 100.0 * float(np.abs(frequency_errors).max())
    loss_factor_errors = rows.r[rows.of("loss_factor")]
    if loss_factor_errors.size:
        figures["loss_factor_error_rms"] = 100.0 * float(np.sqrt(np.mean(loss_factor_errors**2)))
    return figures


def _with_subspaces(
    part: ModalPart, x: RealArray, macs: RealArray
) -> tuple[RealArray, dict[int, float]]:
    """Return the MACs, for close modes those of subspaces, and the latter's ln frequency ratios."""
    # The shapes of close modes are an arbitrary basis, in the test and in the model.
    target = part.target
    if not target.can_distinguish_shapes:
        return macs, {}
    modes = part.pairs(x).modes
    move = find_moving(modes.shapes[target.rows], modes.shapes)
    if not move.any():
        return macs, {}
    frequency = np.sqrt(modes.value[move]) / (2.0 * np.pi)
    found = pair_clusters(
        target.at_sensors(modes.shapes[:, move]),
        target.shapes,
        (frequency, target.frequency),
        PairingRule(),
    )
    of_subspaces, close = macs.copy(), {}
    for i, k, mac in zip(*found.pairs, strict=True):
        if any(k in one.measured for one in found.subspaces):
            of_subspaces[k] = mac
            close[int(k)] = float(np.log(frequency[i] / target.frequency[k]))
    return of_subspaces, close
