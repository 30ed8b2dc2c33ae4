"""Description of a plant file for ``updyn info``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from updyn.cli.reading import FileKind
from updyn.control.files.items import NO_PLANT
from updyn.control.files.plant_file import plant_format, read_plant
from updyn.control.plant import Plant
from updyn.control.ports import Port
from updyn.control.settings import PLANT_PICTURES
from updyn.errors import FormatError
from updyn.text_table import text_table

__all__ = ["PLANT", "describe_plant"]


def describe_plant(plant: Plant) -> str:
    """Return size, sampling, band, errors, natural frequencies and ports of a plant as text."""
    sampled = "continuous"
    if plant.dt is not None:
        sampled = f"sampled every {plant.dt:g} s{_delay(plant)}"
    rows = []
    for port in plant.input_ports:
        rows.append([port.name, "input", port.force_unit, _weights(port)])
    for port, unit in zip(plant.output_ports, plant.output_units, strict=True):
        rows.append([port.name, "output", unit, _weights(port)])
    modes = f"{len(plant.modes)} modes"
    if plant.rigid:
        modes += f", {plant.rigid} of them rigid-body motion"
    most = PLANT_PICTURES.listed_modes
    frequencies = ", ".join(f"{f:.5g}" for f in plant.modes[:most]) or "none"
    if len(plant.modes) > most:
        frequencies += ", ..."
    return "\n".join(
        [
            (
                f"Plant: {plant.n_states} states, {len(plant.inputs)} inputs, {len(plant.outputs)}"
                f" outputs, {sampled}"
            ),
            (
                f"made for {plant.band[0]:g} to {plant.band[1]:g} Hz by route {plant.route!r}:"
                f" largest relative error of a channel {_relative(plant)}, error"
                f" {plant.error:.3g} of its peak, of a resonance's height {plant.peak_error:.3g}"
                f" (tolerance {plant.tolerance:g})"
            ),
            f"{modes}, natural frequencies (Hz): {frequencies}",
            "",
            text_table(("port", "is", "unit", "weights"), rows),
        ]
    )


def _relative(plant: Plant) -> str:
    return "unknown" if math.isnan(plant.relative_error) else f"{plant.relative_error:.3g}"


def _delay(plant: Plant) -> str:
    """Return the delay of the input of a sampled plant as text; empty without one."""
    if not plant.delay:
        return ""
    sampling = plant.facts.get("sampling")
    if isinstance(sampling, Mapping) and sampling.get("delay"):
        return f", input {sampling['delay']:g} s late"
    return f", input {plant.delay} intervals late"


def _weights(port: Port) -> str:
    return ", ".join(f"{weight:+.4g} {label}" for label, weight in port.weights.items())


def _is_plant(path: Path) -> bool:
    try:
        plant_format(path, "read_plant")
    except FormatError:
        return False
    return True


PLANT = FileKind("a plant", read_plant, describe_plant, _is_plant, NO_PLANT)
