"""The figures of a plant: Bode diagrams against the model with the error below, and the weight of a family."""

from __future__ import annotations

import numpy as np

from updyn.control.job.plant_result import Planted
from updyn.control.plant import Plant
from updyn.control.weight import UncertaintyWeight
from updyn.report.plots import (
    Figure,
    Panel,
    band_traces,
    curve,
    level_line,
    log_frequency,
    log_range,
    phases,
    stacked,
)

__all__ = ["bode_name", "channels", "degree_axis", "plant_figures", "unit_of", "weight_name"]

#: Channels that are drawn at most; those with the largest errors are.
_DRAWN = 6
_ERROR_FLOOR = 1e-7


def plant_figures(planted: Planted) -> dict[str, Figure]:
    """Return every figure that has something to show, by the name of its place in the page."""
    plant = planted.plant
    if plant is None or planted.freq is None:
        return {}
    out = {bode_name(i, j): _bode(planted, plant, i, j) for i, j in channels(planted)}
    return out | {weight_name(i, j): _weight(found) for (i, j), found in planted.weights.items()}


def channels(planted: Planted) -> list[tuple[int, int]]:
    """Return the channels that are drawn, output by output: all, or those with the largest errors."""
    assert planted.plant is not None
    everything = list(np.ndindex(len(planted.plant.outputs), len(planted.plant.inputs)))
    if len(everything) <= _DRAWN:
        return everything
    errors = planted.channel_errors()
    return sorted(sorted(everything, key=lambda at: -errors[at])[:_DRAWN])


def bode_name(output: int, input: int) -> str:
    """Return the name of the place of a channel's Bode diagram."""
    return f"plant-{output}-{input}"


def weight_name(output: int, input: int) -> str:
    """Return the name of the place of a channel's weight."""
    return f"weight-{output}-{input}"


def unit_of(plant: Plant, output: int, input: int) -> str:
    """Return the unit of a channel, as ``(rad/s)/(N m)``."""
    top, below = plant.output_units[output].replace("s2", "s²"), plant.input_units[input]
    top, below = (f"({u})" if "/" in u or " " in u else u for u in (top, below))
    return f"{top}/{below}"


def _bode(planted: Planted, plant: Plant, i: int, j: int) -> Figure:
    freq, exact, answer = planted.freq, planted.exact, planted.answer
    assert freq is not None
    assert exact is not None
    assert answer is not None
    H, G = exact[:, i, j], answer[:, i, j]
    unit = unit_of(plant, i, j)
    model = "updated model" if planted.updated else "model"
    degrees = phases(H, G)
    level = float(np.abs(H).max()) or 1.0
    error = np.maximum(np.abs(G - H) / level, _ERROR_FLOOR)
    size: list[dict[str, object]] = []
    if planted.family is not None:
        low, high = planted.family.spread(freq)
        size += band_traces(freq, low[:, i, j], high[:, i, j], f"family of {len(planted.family)}")
    size += [
        curve(freq, np.abs(H), model, "@measured", unit=unit, width=4),
        curve(freq, np.abs(G), "plant", "@after", unit=unit),
    ]
    phase = [
        curve(freq, degrees[0], model, "@measured", unit="°", width=4, legend=False),
        curve(freq, degrees[1], "plant", "@after", unit="°", legend=False),
    ]
    off = [
        curve(freq, error, "error", "@third"),
        level_line(freq, plant.tolerance, "tolerance"),
    ]
    panels = [
        Panel(f"magnitude ({unit})", size, log_range(np.abs(np.concatenate([H, G]))), 1.5),
        Panel("phase (°)", phase, degree_axis(np.concatenate(degrees)), 0.9),
        Panel("error / peak", off, log_range([*error, plant.tolerance], 5.0), 0.9),
    ]
    return stacked(panels, log_frequency(freq), 560)


def degree_axis(values: object) -> dict[str, object]:
    """Return an axis of degrees in steps that divide a half turn, around all values."""
    array = np.asarray(values, dtype=np.float64)
    array = array[np.isfinite(array)]
    low, high = (float(array.min()), float(array.max())) if array.size else (-180.0, 0.0)
    step = next((s for s in (45, 90, 180, 360) if (high - low) / s <= 6), 720)
    return {"tick0": 0, "dtick": step, "range": [low - 0.15 * step, high + 0.15 * step]}


def _weight(found: UncertaintyWeight) -> Figure:
    radius = np.asarray(found.radius)[:, 0, 0]
    cover = np.abs(np.asarray(found.at(found.freq))[:, 0, 0])
    traces = [
        curve(found.freq, radius, "family", "@measured", width=3),
        curve(found.freq, cover, "weight |W|", "@after"),
    ]
    axis = log_range(np.concatenate([radius, cover]), 6.0)
    return stacked(
        [Panel("relative to the nominal plant", traces, axis)], log_frequency(found.freq), 320
    )
