"""Other solutions that fit equally well, and sensors that would distinguish them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from updyn import sensitivity
from updyn.arrays import ComplexArray, IndexArray, RealArray
from updyn.errors import SolverError
from updyn.updating.fit.method import Fit
from updyn.updating.judge.settings import EXPERIMENT_ADVICE, SIGNIFICANCE
from updyn.updating.problem.problem import FRFPart, Problem

__all__ = ["Alternative", "find_alternatives", "find_differences", "select_distinct"]


@dataclass(frozen=True, slots=True)
class Alternative:
    """Another solution that fits the data equally well.

    `odds` is the likelihood of the result over that of this solution. An additional sensor at the
    DOF `sensor` (empty if none helps) would measure the largest `difference`: the median over lines
    and references, relative to the larger of the two FRFs; 2 for FRFs of opposite sign.
    """

    values: Mapping[str, float]
    odds: float
    sensor: str = ""
    difference: float = 0.0


def find_alternatives(problem: Problem, fit: Fit) -> tuple[Alternative, ...]:
    """Return the other solutions of a fit, with the sensors that would distinguish them."""
    coordinates, found = problem.coordinates, []
    for rival in fit.rivals:
        values = coordinates.to_values(rival.x).tolist()
        other_problem = rival.problem or problem
        largest = [
            _find_largest_difference(part, fit.x, other_part, rival.x)
            for part, other_part in zip(problem.parts, other_problem.parts, strict=True)
        ]
        difference, sensor = max(largest, default=(0.0, ""))
        if difference < EXPERIMENT_ADVICE.distinct_difference:
            sensor = ""
        names = coordinates.parameters.names
        odds = float(np.exp(rival.worse))
        found.append(Alternative(dict(zip(names, values, strict=True)), odds, sensor, difference))
    return tuple(found)


def find_differences(
    values: Mapping[str, float], std: Mapping[str, float], others: Sequence[Alternative]
) -> list[tuple[str, list[float]]]:
    """Return unknowns that differ significantly, the largest difference first, with all values."""
    found = []
    for name, value in values.items():
        all_values = [value, *(other.values[name] for other in others)]
        distance = (max(all_values) - min(all_values)) / max(std[name], np.finfo(float).tiny)
        if distance > SIGNIFICANCE.stds:
            found.append((distance, name, all_values))
    found.sort(key=lambda item: -item[0])
    return [(name, all_values) for _, name, all_values in found]


def select_distinct(
    values: Mapping[str, float], std: Mapping[str, float], others: Sequence[Alternative]
) -> tuple[Alternative, ...]:
    """Return the solutions that differ significantly from the result."""
    # Its standard deviations are widened if the model does not explain the data, so solutions that
    # the fit distinguished may agree within them.
    return tuple(other for other in others if find_differences(values, std, [other]))


def _find_largest_difference(
    part: FRFPart, x: RealArray, other_part: FRFPart, other_x: RealArray
) -> tuple[float, str]:
    """Return the largest difference of two solutions at the DOFs without a sensor, and its DOF."""
    system = part.solver.system
    dofs = part.solver.other_dofs(part.rows)
    dofs = dofs[:: max(1, -(-len(dofs) // EXPERIMENT_ADVICE.candidate_sensors))]
    freq = part.frf.freq[part.frf.freq > 0]
    if not dofs.size or not freq.size:
        return 0.0, ""
    lines = freq[:: max(1, len(freq) // EXPERIMENT_ADVICE.sensor_lines)]
    try:
        H = _receptance_at(part, x, lines, dofs)
        G = _receptance_at(other_part, other_x, lines, dofs)
    except SolverError:
        return 0.0, ""
    level = np.maximum(np.maximum(np.abs(H), np.abs(G)), np.finfo(float).tiny)
    difference = np.median(np.abs(H - G) / level, axis=(0, 2))
    best = int(np.argmax(difference))
    return float(difference[best]), str(system.dofs[int(dofs[best])])


def _receptance_at(part: FRFPart, x: RealArray, lines: RealArray, dofs: IndexArray) -> ComplexArray:
    """Return receptances at some DOFs, shape (n_f, n_places, n_j)."""
    values = part.values(x)
    return sensitivity.receptance(
        part.solver, part.unknowns, values, lines, dofs, part.columns, derivatives=False
    )[0]
