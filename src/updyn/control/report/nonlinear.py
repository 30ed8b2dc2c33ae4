"""Report of the loop with backlash or friction: predicted limit cycles and simulation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from updyn.arrays import RealArray
from updyn.control.job.servo import Nonlinear
from updyn.control.nonlinear.simulate import Simulation
from updyn.control.report.settings import CONTROL_REPORT
from updyn.nonlinear.backlash import Backlash
from updyn.report.formats import format_count
from updyn.report.formats import number as formatted
from updyn.report.plots import (
    Figure,
    Panel,
    encode_numbers,
    escape_label,
    stack_panels,
    thin_indices,
)

__all__ = ["nonlinear_context", "nonlinear_figures"]

#: Number of periods at the end that are plotted.
_SHOWN = 12
#: Motion that a nonlinearity depends on, by its kind.
_READ = {"backlash": "twist", "friction": "velocity"}


def nonlinear_figures(nonlinear: Sequence[Nonlinear]) -> dict[str, Figure]:
    """Return the series of each simulation, by their place name in the page."""
    return {
        _name(number): _series(found, found.simulation)
        for number, found in enumerate(nonlinear)
        if found.simulation is not None
    }


def _name(number: int) -> str:
    return f"nonlinear-{number}"


def nonlinear_context(number: int, found: Nonlinear) -> dict[str, object]:
    """Return the template values of one nonlinearity; `number` is its index in the job."""
    cycles = []
    for c in found.cycles:
        kind = "stable" if c.stable else "unstable: a boundary"
        amplitude = f"{formatted(c.amplitude, 4)} {c.unit}"
        frequency = f"{formatted(c.frequency, 4)} Hz"
        cycles.append([amplitude, frequency, kind, f"{formatted(100 * c.third, 2)} %", c.doubt])
    caption = ""
    if found.simulation is not None:
        length = formatted(float(found.simulation.time[-1]), 3)
        caption = f"In time, {found.begun}: the end of {length} s."
    return {
        "name": _name(number),
        "kind": found.kind,
        "heading": f"{found.kind.capitalize()} {found.where}",
        "verdict": _verdict(found),
        "notes": [found.disagreement, found.note],
        "reads": _READ[found.kind],
        "cycles": cycles,
        "caption": caption,
    }


def _verdict(found: Nonlinear) -> str:
    count = format_count(len(found.cycles), "limit cycle") if found.cycles else "no limit cycle"
    prediction = f"Harmonic balance predicts {count}."
    ended = found.simulation
    if ended is None:
        return prediction
    if ended.verdict == "limit cycle":
        return (
            f"{prediction} In time the loop ends in one of {formatted(ended.amplitude, 4)}"
            f" {ended.unit} (first harmonic) at {formatted(ended.frequency, 4)} Hz."
        )
    words = {
        "decays": "the oscillation decays",
        "at rest": "the loop comes to rest",
        "grows": "the oscillation still grows at the end",
        "not settled": "the loop has not settled by the end",
    }
    return f"{prediction} In time {words.get(ended.verdict, ended.verdict)}."


def _series(found: Nonlinear, ended: Simulation) -> Figure:
    span = float(ended.time[-1])
    if ended.frequency:
        span = min(span, _SHOWN / ended.frequency)
    inside = np.flatnonzero(ended.time >= ended.time[-1] - span)
    time = ended.time[inside]
    reads = _READ[found.kind]
    torque = "N m" if ended.unit.startswith("rad") else "N"
    marks: tuple[float, ...] = ()
    if isinstance(found.law, Backlash):
        marks = (-found.law.half, found.law.half)
    panels = [
        Panel(
            f"{reads} ({ended.unit})",
            [_line(time, ended.reading[inside], reads, ended.unit, "@after")],
            {},
            1.2,
            marks,
        ),
        Panel(
            f"torque ({torque})",
            [_line(time, ended.torque[inside], "torque", torque, "@third")],
            {},
            0.8,
        ),
    ]
    return stack_panels(
        panels, {"title": {"text": "time (s)"}, "range": [float(time[0]), float(time[-1])]}, 380
    )


def _line(x: RealArray, y: RealArray, name: str, unit: str, colour: str) -> dict[str, object]:
    at = thin_indices(y, CONTROL_REPORT.series_points)
    return {
        "type": "scatter",
        "mode": "lines",
        "name": escape_label(name),
        "x": encode_numbers(x[at]),
        "y": encode_numbers(y[at]),
        "line": {"color": colour, "width": 1.6},
        "hovertemplate": f"%{{x:.5g}} s: {escape_label(name)} %{{y:.4g}} {unit}<extra></extra>",
    }
