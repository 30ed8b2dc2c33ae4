"""The loop with backlash or friction: limit cycles that are predicted, and what it does in time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from updyn.control.job.servo import Nonlinear
from updyn.control.nonlinear.elements import Backlash
from updyn.control.nonlinear.simulate import Simulation
from updyn.report import formats as w
from updyn.report import markup as m
from updyn.report.plots import Figure, Panel, label, numbers, stacked, with_peaks

__all__ = ["nonlinear_figures", "nonlinear_part"]

#: Periods of the end that are drawn, and points at most.
_SHOWN, _POINTS = 12, 4000


def nonlinear_figures(nonlinear: Sequence[Nonlinear]) -> dict[str, Figure]:
    """Return the series of each simulation, by the name of its place in the page."""
    return {
        _name(number): _series(found, found.simulation)
        for number, found in enumerate(nonlinear)
        if found.simulation is not None
    }


def _name(number: int) -> str:
    return f"nonlinear-{number}"


def nonlinear_part(number: int, found: Nonlinear, figures: Mapping[str, Figure]) -> str:
    """Return words, the table of cycles and the place of the figure."""
    parts = [
        f"<h3>{m.esc(found.kind.capitalize())} {m.esc(found.where)}</h3>",
        m.paragraph(_verdict(found)),
        m.note(found.disputed, found.note),
    ]
    if found.cycles:
        kinds = ("", "", "text", "", "note-cell")
        rows = [
            m.row(
                [
                    f"{w.number(c.amplitude, 4)} {c.unit}",
                    f"{w.number(c.frequency, 4)} Hz",
                    "stable" if c.stable else "unstable: a border",
                    f"{w.number(100 * c.third, 2)} %",
                    c.doubt,
                ],
                kinds,
                "open" if c.doubt else "",
            )
            for c in found.cycles
        ]
        reads = "twist" if found.kind == "backlash" else "velocity"
        head = [f"amplitude of the {reads}", "frequency", "", "third harmonic", "in doubt"]
        caption = "Limit cycles by harmonic balance; the third harmonic is taken for 0"
        parts.append(m.table(head, rows, caption=caption, kinds=kinds))
    if found.simulation is not None:
        caption = (
            f"In time, {found.begun}: the end of {w.number(float(found.simulation.time[-1]), 3)} s."
        )
        height = figures[_name(number)]["height"]
        parts.append(
            m.figure(_name(number), f"The loop with {found.kind} in time", caption, height=height)
        )
    return "".join(parts)


def _verdict(found: Nonlinear) -> str:
    count = len(found.cycles)
    said = (
        "Harmonic balance predicts"
        f" {w.counted(count, 'limit cycle') if count else 'no limit cycle'}."
    )
    ended = found.simulation
    if ended is None:
        return said
    if ended.verdict == "limit cycle":
        return (
            f"{said} In time the loop ends in one of {w.number(ended.amplitude, 4)} {ended.unit}"
            f" (first harmonic) at {w.number(ended.frequency, 4)} Hz."
        )
    words = {
        "decays": "the oscillation decays",
        "at rest": "the loop comes to rest",
        "grows": "the oscillation still grows at the end",
        "not settled": "the loop has not settled by the end",
    }
    return f"{said} In time {words.get(ended.verdict, ended.verdict)}."


def _series(found: Nonlinear, ended: Simulation) -> Figure:
    span = float(ended.time[-1])
    if ended.frequency:
        span = min(span, _SHOWN / ended.frequency)
    inside = np.flatnonzero(ended.time >= ended.time[-1] - span)
    time = ended.time[inside]
    reads = "twist" if found.kind == "backlash" else "velocity"
    torque = "N m" if ended.unit.startswith("rad") else "N"
    marks = (-found.law.half, found.law.half) if isinstance(found.law, Backlash) else ()
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
    return stacked(
        panels, {"title": {"text": "time (s)"}, "range": [float(time[0]), float(time[-1])]}, 380
    )


def _line(x: Any, y: Any, name: str, unit: str, colour: str) -> dict[str, Any]:
    at = with_peaks(y, _POINTS)
    return {
        "type": "scatter",
        "mode": "lines",
        "name": label(name),
        "x": numbers(x[at]),
        "y": numbers(y[at]),
        "line": {"color": colour, "width": 1.6},
        "hovertemplate": f"%{{x:.5g}} s: {label(name)} %{{y:.4g}} {unit}<extra></extra>",
    }
