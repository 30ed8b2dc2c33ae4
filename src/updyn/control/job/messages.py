"""Text of the plant of a job: the request and the result."""

from __future__ import annotations

import math

from updyn.control.conversions import conversion_state, find_route
from updyn.control.job.checks import band_of_plant, beyond_the_data, part_of_plant
from updyn.control.job.plant_result import PlantResult
from updyn.control.job.tables import PlantTable, ServoTable
from updyn.control.plant import Plant
from updyn.control.servo.record import Servo
from updyn.job.prepared import Prepared
from updyn.text_table import fit_columns, format_count, text_table

__all__ = ["brief_plant_result", "describe_plant_result", "describe_request"]

#: Error measure of a tolerance.
_MEASURES = {"relative": "relative error", "peak": "error as a share of the peak"}
#: Heading and attribute of `Margins` of the figures of a loop.
_MARGINS = (
    ("crossover (Hz)", "crossover"),
    ("phase margin (deg)", "phase_margin"),
    ("gain margin (dB)", "gain_margin_db"),
    ("modulus margin", "modulus_margin"),
)
#: Notes that the brief text has.
_BRIEF_NOTES = 3


def describe_plant_result(result: PlantResult) -> str:
    """Return order, errors, route and conversions of the damping as text."""
    lines = [*_describe_plant(result), "", _conversions(result)]
    lines += [f"note: {note}" for note in result.notes]
    for part in (result.servo, *result.nonlinear, result.drive):
        if part is not None:
            lines.append(f"\n{part.summary()}")
    return "\n".join(lines)


def brief_plant_result(result: PlantResult, width: int | None) -> str:
    """Return order, errors and route of the plant, and the margins of a servo, as text.

    `width` limits the table of margins; None is unlimited.
    """
    lines = _describe_plant(result)
    if result.family is not None:
        lines = [line.splitlines()[0] for line in lines]
    lines += [f"note: {note}" for note in result.notes[:_BRIEF_NOTES]]
    if result.servo is not None:
        lines += ["", _margins(result.servo, width)]
    return "\n".join(lines)


def _margins(servo: Servo, width: int | None) -> str:
    """Return a table with the margins of each loop."""
    broken = () if servo.torque_loop is None else (servo.torque_loop,)
    rows = []
    for loop in (*servo.loops, *broken):
        margins = loop.margins
        figures = [getattr(margins, attribute) for _, attribute in _MARGINS]
        cells = ["-" if value is None else f"{value:.4g}" for value in figures]
        rows.append([loop.name, "yes" if margins.stable else "NO", *cells])
    headings = [heading for heading, _ in _MARGINS]
    header = ("loop", "stable", *headings)
    return fit_columns(header, rows, width, headings[::-1], left=("stable",))


def _describe_plant(result: PlantResult) -> list[str]:
    """Return band, order, errors and route of the plant, or why there is none, as lines of text."""
    found = result.plant
    low, high = result.band
    lines = [f"{result.title}: plant from {low:g} to {high:g} Hz", result.source]
    if found is None:
        lines.append(result.message)
    else:
        lines += [
            (
                f"{format_count(found.n_states, 'state')},"
                f" {format_count(len(found.inputs), 'input')},"
                f" {format_count(len(found.outputs), 'output')};"
                f" {format_count(found.rigid, 'rigid-body mode')},"
                f" {format_count(len(found.modes) - found.rigid, 'flexible mode')}"
            ),
            (
                f"relative error {_percent(found.relative_error)} at most; error"
                f" {_percent(found.error)} of a channel's peak, {_percent(found.peak_error)}"
                f" of the height of a resonance; tolerance {_percent(result.tolerance)}, of the"
                f" {_MEASURES[result.measure]}"
            ),
            f"route: {find_route(found)}",
        ]
        if found.zero_shift:
            lines.append(_zeros(found))
        if result.sampled is not None and result.sampled.dt is not None:
            sampled = result.sampled
            lines.append(f"sampled every {sampled.dt:g} s: {sampled.n_states} states")
            if sampled.delay:
                lines[-1] += f", input late by {sampled.delay} intervals"
        if result.family is not None:
            lines.append(result.family.summary())
            lines += [weight.summary() for weight in result.weights.values()]
    return lines


def _zeros(plant: Plant) -> str:
    known = [zero for zero in plant.zero_shift if not math.isnan(zero.shift)]
    text = f"{format_count(len(plant.zero_shift), 'antiresonance')}"
    if known:
        worst = max(known, key=lambda zero: abs(zero.shift))
        text += (
            f", moved by at most {abs(worst.shift):.2g} % ({worst.output} over {worst.input},"
            f" {worst.frequency:.4g} Hz)"
        )
    if len(known) < len(plant.zero_shift):
        text += f"; {len(plant.zero_shift) - len(known)} not in the plant"
    return text


def _conversions(result: PlantResult) -> str:
    """Return a table of the conversions of the damping (with all modes) and of the plant."""
    rows = []
    for c in result.conversions:
        cells = [_percent(c.relative_error), _percent(c.error), _percent(c.peak_error)]
        rows.append([c.name, *cells, conversion_state(c.name, result.plant), c.note])
    if result.plant is not None:
        p = result.plant
        cells = [_percent(p.relative_error), _percent(p.error), _percent(p.peak_error)]
        rows.append(["the plant itself", *cells, find_route(p), ""])
    note = "note" if any(c.note for c in result.conversions) else ""
    head = [
        "damping converted by",
        "relative error",
        "error / peak",
        "height of resonances",
        "",
        note,
    ]
    return text_table(head, rows)


def describe_request(ready: Prepared) -> str:
    """Return ``[plant]`` and ``[servo]`` of a job as text; empty without them."""
    table = ready.job.table(PlantTable)
    servo = ready.job.table(ServoTable)
    if table is None:
        return ""
    test = ready.tests[part_of_plant(ready.job)]
    band = band_of_plant(ready.job, test.freq)
    inputs = ", ".join(p.name for p in table.input_ports)
    outputs = ", ".join(p.name for p in table.output_ports)
    lines = [
        f"Plant from {band[0]:g} to {band[1]:g} Hz, tolerance {_percent(table.tolerance)}:"
        f" {format_count(len(table.inputs), 'input')} ({inputs}),"
        f" {format_count(len(table.outputs), 'output')} ({outputs})"
    ]
    if servo is not None and servo.controller is not None:
        lines.append(f"Servo: {servo.torque or table.input_ports[0].name} by {servo.velocity}")
        if servo.position:
            lines[-1] += f" and {servo.position}"
    note = beyond_the_data(band, test.freq)
    if note:
        lines.append(f"note: {note}")
    return "\n".join(lines)


def _percent(share: float) -> str:
    if math.isnan(share):
        return "-"
    digits = ".2g" if share < 1 else ".0f"
    return f"{100 * share:{digits}} %"
