"""`realised`: the plant of a selection, with the errors of its matrices."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from updyn.arrays import BoolArray, ComplexArray
from updyn.control.antiresonances import ZeroShift, antiresonance_shifts
from updyn.control.complex_modes import FittedModes
from updyn.control.lines import sweep
from updyn.control.plant import Plant
from updyn.control.servo.state_space import StateSpace, channel_zeros
from updyn.control.target import CandidateSelection, ResponseTarget
from updyn.control.task import PlantTask
from updyn.errors import ModelError

__all__ = ["measure_errors", "realise"]


def realise(
    task: PlantTask,
    found: CandidateSelection,
    title: str,
    quantities: tuple[str, ...],
    tolerance: float,
) -> Plant:
    """Return the plant of a selection; raises ModelError for an unstable pole."""
    A, B, C, D = found.conversion.matrices(found.mask)
    facts: dict[str, Any] = {
        "title": title,
        "basis": task.space.source,
        "lines": len(task.target.freq),
        "candidates": len(found.mask),
        "error": task.target.measure,
    }
    if isinstance(found.conversion, FittedModes):
        facts["fitted"] = f"outputs, with {len(found.conversion.extra)} real poles"
        if not found.conversion.at_rest:
            facts["fitted"] += ", not 0 at rest"
    plant = Plant(
        A,
        B,
        C,
        D,
        *task.ports,
        quantities,
        task.band,
        float(tolerance),
        float(found.errors[1]),
        float(found.errors[2]),
        found.conversion.name,
        task.space.rigid,
        np.concatenate(
            [
                np.zeros(task.space.rigid),
                np.sort(found.conversion.frequency[found.mask & _flexible(found)]),
            ]
        ),
        facts=facts,
    )
    return measure_errors(plant, task.target)


def _flexible(found: CandidateSelection) -> BoolArray:
    return ~found.conversion.always_kept


def measure_errors(plant: Plant, target: ResponseTarget) -> Plant:
    """Return a plant with the errors of its matrices; raises ModelError for an unstable pole."""
    G = sweep(plant, target.freq)
    scale = max(float(np.abs(plant.poles).max(initial=0.0)), 1e-300)
    if (plant.poles.real > 1e-9 * scale).any():
        raise ModelError(
            f"plant: route {plant.route!r} gave an unstable pole,"
            f" {plant.poles[np.argmax(plant.poles.real)]:.4g} rad/s; use another route"
        )
    facts = dict(plant.facts)
    if target.slow:
        facts["peak error of accelerations"] = target.peak_error(G, strict=True)
    return replace(
        plant,
        error=target.error(G),
        peak_error=target.peak_error(G),
        facts=facts,
        relative_error=target.relative_error(G),
        zero_shift=tuple(_zero_shifts(plant, target, G)),
    )


def _zero_shifts(plant: Plant, target: ResponseTarget, G: ComplexArray) -> Iterator[ZeroShift]:
    for i, j in np.ndindex(*target.level.shape):
        matrices = StateSpace(plant.A, plant.B[:, [j]], plant.C[[i]], plant.D[[i]][:, [j]])
        names = plant.outputs[i], plant.inputs[j]

        if target.level[i, j] > target.floor[i, j]:
            zeros = channel_zeros(matrices)
            for found in antiresonance_shifts(
                target.freq, target.values[:, i, j], G[:, i, j], zeros
            ):
                yield ZeroShift(*names, *found)
