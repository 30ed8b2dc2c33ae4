"""Experiment advice: further lines, sensors or known values that determine the null space."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from updyn import sensitivity
from updyn.arrays import ComplexArray, IndexArray, NumberArray, RealArray
from updyn.dofs import DofSet
from updyn.errors import SolverError
from updyn.frf import FRF
from updyn.updating.fit.methods.modal import ADVICE
from updyn.updating.judge.identifiability import Analysis
from updyn.updating.judge.nearby import ReducedPart
from updyn.updating.judge.settings import EFFORT, EXPERIMENT_ADVICE, LIST_LENGTHS, SEPARATION
from updyn.updating.problem.problem import FRFPart, Problem

__all__ = ["advise"]


def advise(analysis: Analysis, problem: Problem, x: RealArray, noise: float = 0.0) -> str:
    """Return sentences on undetermined combinations and measurements that determine them."""
    names = problem.coordinates.parameters.names
    if analysis.report.complete:
        if analysis.report.collinearity > SEPARATION.most_collinearity:
            weakest = names[int(np.argmax(np.diag(analysis.covariance)))]
            return (
                "Some unknowns are hard to distinguish (collinearity index"
                f" {analysis.report.collinearity:.3g}; above {SEPARATION.most_collinearity:g} they"
                f" compensate each other under noise); {weakest} is the least certain."
            )
        return ""
    parts = []
    without_effect = np.flatnonzero(np.linalg.norm(analysis.null_space, axis=1) > 1 - 1e-6)
    if without_effect.size:
        parts.append(
            f"The data do not depend on {_join_names([names[i] for i in without_effect])}."
        )
    if not problem.parts:
        return " ".join([*parts, ADVICE])
    lines, sensors = [], []
    for part in problem.parts:
        lines.append((part.name, _find_best_line(analysis, part, x)))
        sensors.append(
            (part.name, _find_best_sensor(analysis, part, x, _choose_candidate_sensors(part)))
        )
    line, sensor = _select_best(lines), _select_best(sensors)
    needed = max(noise, EXPERIMENT_ADVICE.visible_change)
    if line is not None and line[1] > needed:
        parts.append(
            f"Adding a line near {line[0]} would determine all unknowns"
            f"{_describe_accuracy(line[1])}."
        )
    if sensor is not None and sensor[1] > needed:
        parts.append(
            f"Adding a sensor at {sensor[0]} would determine all unknowns"
            f"{_describe_accuracy(sensor[1])}."
        )
    if len(parts) == bool(without_effect.size):
        k = analysis.null_space.shape[1]
        combinations = "combination" if k == 1 else "combinations"
        parts.append("No single further line or sensor on this model would determine all unknowns.")
        if noise > EXPERIMENT_ADVICE.much_noise:
            parts.append(
                "Less noise (more averages) or several further lines and sensors may help."
            )
        parts.append(
            f"Fix {k} of the unknowns in the undetermined {combinations} at known values, join"
            " groups, or give priors."
        )
    return " ".join(parts)


def _select_best(found: list[tuple[str, tuple[str, float] | None]]) -> tuple[str, float] | None:
    """Return the best candidate of all tests, with the name of its test if there are several."""
    candidates = []
    for test, best in found:
        if best is not None:
            place, change = best
            if test:
                place = f"{place} in test {test!r}"
            candidates.append((place, change))
    return max(candidates, key=lambda candidate: candidate[1], default=None)


def _describe_accuracy(change: float) -> str:
    """Return the accuracy of a candidate measurement that determines each combination to 10 %."""
    if change >= 1.0:
        return ""
    return f", to 10 % if it is measured to {10.0 * change:.1g} %"


def _join_names(names: list[str]) -> str:
    text = ", ".join(names[: LIST_LENGTHS.named_items])
    n_more = len(names) - LIST_LENGTHS.named_items
    if n_more > 0:
        text += f" and {n_more} more"
    return text


def _least_relative_changes(along: ComplexArray, H: ComplexArray) -> RealArray:
    """Return the least change along the null space of each candidate measurement, relative to H."""
    H = H.reshape(len(H), -1)
    size = np.abs(H)
    level = np.maximum(size, 1e-6 * size.max(axis=1, keepdims=True, initial=0.0))
    relative = along.reshape(len(along), *H.shape) / np.maximum(level, np.finfo(float).tiny)
    stacked = np.concatenate([relative.real, relative.imag], axis=2).transpose(1, 0, 2)
    if stacked.shape[2] < len(along):
        return np.zeros(len(H))
    return np.asarray(np.linalg.svd(stacked, compute_uv=False)[:, -1])


def _with_candidate_lines(part: FRFPart) -> FRFPart:
    freq = part.frf.freq
    low = float(freq[freq > 0].min(initial=np.inf))
    if np.isinf(low):
        low = 1.0
    high = float(max(freq[-1], 1e-3))
    low, high = 0.7 * low, 1.5 * high
    lines = np.geomspace(low, high, EXPERIMENT_ADVICE.candidate_lines)
    lines = np.unique(np.append(lines, high))
    return replace(part, frf=_make_placeholder(part, lines))


def _choose_candidate_sensors(part: FRFPart) -> IndexArray:
    others = part.solver.other_dofs(part.rows)
    return others[:: max(1, -(-len(others) // EXPERIMENT_ADVICE.candidate_sensors))]


def _find_best_line(analysis: Analysis, part: FRFPart, x: RealArray) -> tuple[str, float] | None:
    """Return the best additional line and its least relative change."""
    # A reduced model finds the line; the full model gives the change.
    candidates = _with_candidate_lines(part)
    lines, nearby = candidates.frf.freq, ReducedPart.of(candidates, x)
    try:
        changes = _changes_at_lines(
            candidates if nearby is None else nearby.part, x, analysis.null_space
        )
        best = int(np.argmax(changes))
        change = float(changes[best])
        if nearby is not None:
            single_line = replace(part, frf=_make_placeholder(part, lines[[best]]))
            change = float(_changes_at_lines(single_line, x, analysis.null_space)[0])
    except SolverError:
        return None
    return f"{lines[best]:.4g} Hz", change


def _changes_at_lines(part: FRFPart, x: RealArray, directions: RealArray) -> RealArray:
    """Return the least relative change at each line of a part, shape (n_f,)."""
    items = [(x, directions, block) for block in part.partition()]
    return np.concatenate(list(part.map_lines(_changes_at_block, items)))


def _changes_at_block(part: FRFPart, item: tuple[RealArray, RealArray, slice]) -> NumberArray:
    x, directions, lines = item
    block = part.block(x, lines)
    assert block.dH is not None
    return _least_relative_changes(np.tensordot(directions, block.dH, axes=(0, 0)), block.H)


def _find_best_sensor(
    analysis: Analysis, part: FRFPart, x: RealArray, others: IndexArray
) -> tuple[str, float] | None:
    """Return the best additional sensor and its least relative change."""
    # A reduced model is not used: its basis lacks the fields of forces at DOFs without a sensor.
    if others.size == 0:
        return None
    freq = part.frf.freq[part.frf.freq > 0]
    if not freq.size:  # static test
        freq = part.frf.freq
    number = EXPERIMENT_ADVICE.sensor_lines
    if part.solver.system.n > EFFORT.small_model_dofs:
        n_undetermined = analysis.null_space.shape[1]
        number = max(
            EXPERIMENT_ADVICE.least_sensor_lines, -(-n_undetermined // (2 * len(part.columns)))
        )
    few = replace(part, frf=_make_placeholder(part, freq[:: max(1, len(freq) // number)]))
    try:
        changes = _changes_at_sensors(few, x, others, analysis.null_space)
    except SolverError:
        return None
    best = int(np.argmax(changes))
    return str(part.solver.system.dofs[int(others[best])]), float(changes[best])


def _changes_at_sensors(
    part: FRFPart,
    x: RealArray,
    others: IndexArray,
    directions: RealArray,
) -> RealArray:
    """Return the least relative change at a sensor at each of some DOFs."""
    n_columns = len(part.columns) * (1 + directions.shape[1])
    items = [(x, others, directions, lines) for lines in part.partition(n_columns)]
    answers, derivatives = zip(*part.map_lines(_receptance_at_others, items), strict=True)
    return _least_relative_changes(
        np.concatenate(derivatives, axis=2), np.concatenate(answers, axis=1)
    )


def _receptance_at_others(
    part: FRFPart,
    item: tuple[RealArray, IndexArray, RealArray, slice],
) -> tuple[ComplexArray, ComplexArray]:
    """Return receptances (n_others, n_f, n_j) at other DOFs, and k derivatives along x."""
    x, others, directions, lines = item
    U, dU = sensitivity.fields_along(
        part.solver,
        part.unknowns,
        part.values(x),
        part.frf.freq[lines],
        part.columns,
        part.coordinates.slope(x)[:, None] * directions,
    )
    along = [part.solver.at(dU[:, :, k], others) for k in range(directions.shape[1])]
    return part.solver.at(U, others), np.stack(along)


def _make_placeholder(part: FRFPart, lines: RealArray) -> FRF:
    """Return data of the part's channels at other lines, with values of 1 as placeholders."""
    shape = (len(lines), len(part.rows), len(part.columns))
    return FRF(
        lines,
        np.ones(shape),
        DofSet(part.frf.responses),
        DofSet(part.frf.references),
        part.frf.quantity,
        decay=part.frf.decay,
    )
