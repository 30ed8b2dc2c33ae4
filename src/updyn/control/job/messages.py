"""Text of the plant of a job: the request and the result."""

from __future__ import annotations

import math
from collections.abc import Sequence

from updyn.cli.layout import fit_text
from updyn.cli.settings import LAYOUT
from updyn.control.conversions import conversion_state, find_route
from updyn.control.job.checks import band_of_plant, beyond_the_data, part_of_plant
from updyn.control.job.plant_result import PlantResult
from updyn.control.job.tables import PlantTable, ServoTable
from updyn.control.plant import Plant
from updyn.control.servo.record import Loop, Servo
from updyn.control.servo.verdict import judge_servo, worst_member
from updyn.job.prepared import Prepared
from updyn.text_table import fit_columns, format_count, text_table

__all__ = [
    "brief_plant_result",
    "describe_plant_result",
    "describe_plant_size",
    "describe_request",
    "name_plant_outcome",
]

#: What an error is relative to, by the measure of a tolerance.
_RELATIVE_TO = {"relative": "|H| at each line", "peak": "a channel's peak"}
#: Heading and attribute of `Margins` of the figures of a loop.
_MARGINS = (
    ("crossover (Hz)", "crossover"),
    ("phase margin (deg)", "phase_margin"),
    ("gain margin (dB)", "gain_margin"),
    ("modulus margin", "modulus_margin"),
)


def describe_plant_result(result: PlantResult) -> str:
    """Return outcome, order, errors, route and conversions of the damping as text."""
    lines = [*_describe_outcome(result), *_describe_plant(result), "", _conversions(result)]
    lines += [f"note: {note}" for note in result.notes]
    for part in (result.servo, *result.nonlinear, result.drive):
        if part is not None:
            lines.append(f"\n{part.summary()}")
    return "\n".join(lines)


def brief_plant_result(result: PlantResult, closing: Sequence[str], width: int | None) -> str:
    """Return outcome, margins of a servo, size and error of the plant and closing lines as text.

    There are as many notes as fit into `LAYOUT.outcome_lines` lines of `width` columns (None:
    unlimited).
    """
    for most in range(LAYOUT.notes, -1, -1):
        lines = [*_describe_outcome(result, most), ""]
        if result.servo is not None:
            lines += [*_margins(result.servo, width), ""]
        if result.plant is not None:
            lines.append(describe_plant_size(result))
        lines.append(result.source)
        lines += [f"note: {note}" for note in result.notes[:most]]
        text = "\n".join([*lines, *closing])
        shown = text if width is None else fit_text(text, width)
        if len(shown.splitlines()) <= LAYOUT.outcome_lines:
            break
    return text


def _describe_outcome(result: PlantResult, most: int | None = None) -> list[str]:
    """Return the verdict on the servo, or on the plant without one, and at most `most` reasons."""
    if result.servo is not None:
        verdict = judge_servo(result.servo)
        text = f"{result.title}: the servo is {verdict.text}."
        return [text, *verdict.reasons[:most]]
    low, high = result.band
    if result.plant is None:
        return [f"{result.title}: no plant from {low:g} to {high:g} Hz.", result.message]
    return [f"{result.title}: plant from {low:g} to {high:g} Hz, within its tolerance."]


def name_plant_outcome(result: PlantResult) -> str:
    """Return the outcome in a few words: the verdict on the servo, or on the plant without one."""
    if not result.holds_tolerance:
        return "tolerance not met"
    return "plant made" if result.servo is None else f"servo {judge_servo(result.servo).text}"


def describe_plant_size(result: PlantResult) -> str:
    """Return size and error of the plant, in the measure of its tolerance, as a sentence."""
    plant = result.plant
    assert plant is not None
    low, high = result.band
    error = plant.relative_error if result.measure == "relative" else plant.error
    return (
        f"Plant from {low:g} to {high:g} Hz: {format_count(plant.n_states, 'state')},"
        f" {format_count(len(plant.inputs), 'input')},"
        f" {format_count(len(plant.outputs), 'output')}; error at most {_percent(error)} of"
        f" {_RELATIVE_TO[result.measure]} (tolerance {_percent(result.tolerance)})."
    )


def _margins(servo: Servo, width: int | None) -> list[str]:
    """Return a table with the margins of each loop, in parentheses the worst of the family."""
    rows = [[loop.name, *_margin_cells(loop)] for loop in servo.all_loops]
    headings = [heading for heading, _ in _MARGINS]
    table = fit_columns(("loop", *headings), rows, width, headings)
    if servo.velocity_loop.members:
        table += "\nin parentheses: the worst plant of the family"
    return [table]


def _margin_cells(loop: Loop) -> list[str]:
    if not loop.margins.stable:
        return ["unstable", *("-" for _ in _MARGINS[1:])]
    cells = []
    for _, name in _MARGINS:
        cell = _figure(name, getattr(loop.margins, name))
        worst = worst_member(loop, name)
        if worst is not None and name != "crossover":
            cell += f" ({_figure(name, worst[0])})"
        cells.append(cell)
    return cells


def _figure(name: str, value: float | None) -> str:
    if value is None:
        return "-"
    if name == "gain_margin":
        value = 20.0 * math.log10(value)
    return f"{value:.4g}"


def _describe_plant(result: PlantResult) -> list[str]:
    """Return order, errors and route of the plant, its samples and its family as lines of text."""
    found = result.plant
    if found is None:
        return [result.source]
    lines = [
        describe_plant_size(result),
        result.source,
        (
            f"{format_count(found.rigid, 'rigid-body mode')},"
            f" {format_count(len(found.modes) - found.rigid, 'flexible mode')}"
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
