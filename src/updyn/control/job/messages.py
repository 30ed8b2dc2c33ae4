"""The plant of a job as text: what is asked for, and what was made."""

from __future__ import annotations

from updyn.control.job.checks import band_of_plant, beyond_the_data, part_of_plant
from updyn.control.job.plant_result import PlantResult
from updyn.control.job.tables import PlantTable, ServoTable
from updyn.job.prepare import Prepared
from updyn.text_table import text_table

__all__ = ["describe_plant_result", "describe_request"]


def describe_plant_result(made: PlantResult) -> str:
    """Return a plant's figures as text: order, errors, route, and the conversions of the damping side by side."""
    found, (low, high) = made.plant, made.band
    lines = [f"{made.title}: plant from {low:g} to {high:g} Hz", made.source]
    if found is None:
        lines.append(made.message)
    else:
        lines += [
            (
                f"{_counted(found.n_states, 'state')}, {_counted(len(found.inputs), 'input')},"
                f" {_counted(len(found.outputs), 'output')};"
                f" {_counted(found.rigid, 'rigid-body mode')},"
                f" {_counted(len(found.modes) - found.rigid, 'flexible mode')}"
            ),
            (
                f"error {_percent(found.error)} of a channel's peak, {_percent(found.peak_error)}"
                f" of the height of a resonance; tolerance {_percent(made.tolerance)}"
            ),
            f"route: {found.route}",
        ]
        if made.sampled is not None and made.sampled.dt is not None:
            late = f", input late by {made.sampled.delay} intervals" if made.sampled.delay else ""
            lines.append(
                f"sampled every {made.sampled.dt:g} s: {made.sampled.n_states} states{late}"
            )
        if made.family is not None:
            lines.append(made.family.summary())
            lines += [weight.summary() for weight in made.weights.values()]
    rows = [
        [
            c.name,
            _percent(c.error),
            _percent(c.peak_error),
            "used" if found and c.name == found.route else "",
            c.note,
        ]
        for c in made.conversions
    ]
    head = [
        "damping converted by",
        "error / peak",
        "height of resonances",
        "",
        "note" if any(r[4] for r in rows) else "",
    ]
    lines += ["", text_table(head, rows)]
    lines += [f"note: {note}" for note in made.notes]
    lines += [
        f"\n{found.summary()}"
        for found in (made.servo, *made.nonlinear, made.drive)
        if found is not None
    ]
    return "\n".join(lines)


def describe_request(ready: Prepared) -> str:
    """Return what a job asks for with ``[plant]`` and ``[servo]``, as text; empty where it asks for nothing."""
    table, servo = ready.job.table(PlantTable), ready.job.table(ServoTable)
    if table is None:
        return ""
    test = ready.tests[part_of_plant(ready.job)]
    band = band_of_plant(ready.job, test.frf)
    names = (
        ", ".join(p.name for p in table.input_ports),
        ", ".join(p.name for p in table.output_ports),
    )
    lines = [
        f"Plant from {band[0]:g} to {band[1]:g} Hz, tolerance {_percent(table.tolerance)}:"
        f" {_counted(len(table.inputs), 'input')} ({names[0]}),"
        f" {_counted(len(table.outputs), 'output')} ({names[1]})"
    ]
    if servo is not None and servo.controller is not None:
        positioned = f" and {servo.position}" if servo.position else ""
        lines.append(
            f"Servo: {servo.torque or table.input_ports[0].name} by {servo.velocity}{positioned}"
        )
    said = beyond_the_data(band, test.frf)
    return "\n".join([*lines, *([f"note: {said}"] if said else [])])


def _counted(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _percent(share: float) -> str:
    return (
        "-" if share != share else f"{100 * share:.2g} %" if share < 1 else f"{100 * share:.0f} %"
    )
