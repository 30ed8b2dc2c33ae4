"""A plant in a file, as ``updyn info`` describes it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from updyn.cli.reading import FileKind
from updyn.control.files.items import NO_PLANT
from updyn.control.files.plant_file import plant_format, read_plant
from updyn.control.plant import Plant
from updyn.errors import FormatError
from updyn.text_table import text_table

__all__ = ["PLANT", "describe_plant"]

#: Natural frequencies that are listed.
_MODES = 12


def describe_plant(plant: Plant) -> str:
    """Return size, sampling, band and error, natural frequencies and ports of a plant, as text."""
    told = plant.facts.get("sampling")
    exact = told.get("delay") if isinstance(told, Mapping) else None
    late = (
        ""
        if not plant.delay
        else f", input {exact:g} s late"
        if exact
        else f", input {plant.delay} intervals late"
    )
    sampled = "continuous" if plant.dt is None else f"sampled every {plant.dt:g} s{late}"
    inputs = zip(plant.input_ports, plant.input_units, strict=True)
    outputs = zip(plant.output_ports, plant.output_units, strict=True)
    rows = [
        [port.name, what, unit, ", ".join(f"{w:+.4g} {label}" for label, w in port.weights.items())]
        for what, ports in (("input", inputs), ("output", outputs))
        for port, unit in ports
    ]
    rigid = f", {plant.rigid} of them rigid-body motion" if plant.rigid else ""
    return "\n".join(
        [
            (
                f"Plant: {plant.n_states} states, {len(plant.inputs)} inputs, {len(plant.outputs)}"
                f" outputs, {sampled}"
            ),
            (
                f"made for {plant.band[0]:g} to {plant.band[1]:g} Hz by route {plant.route!r}:"
                f" largest error of a channel {plant.error:.3g} of its peak (asked for"
                f" {plant.tolerance:g}), of a resonance's height {plant.peak_error:.3g}"
            ),
            f"{len(plant.modes)} modes{rigid}, natural frequencies (Hz): "
            + (", ".join(f"{f:.5g}" for f in plant.modes[:_MODES]) or "none")
            + (", ..." if len(plant.modes) > _MODES else ""),
            "",
            text_table(("port", "is", "unit", "weights"), rows),
        ]
    )


def _is_plant(path: Path) -> bool:
    """Tell whether a plant format fits a file."""
    try:
        plant_format(path, "read_plant")
    except FormatError:
        return False
    return True


PLANT = FileKind("a plant", read_plant, describe_plant, _is_plant, NO_PLANT)
