"""`conversions`: accuracy of each conversion of structural damping."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from updyn.control.options import Ports
from updyn.control.plant import Plant
from updyn.control.ports import as_ports
from updyn.control.structure import CompiledStructure
from updyn.control.task import PlantTask, build_task
from updyn.errors import ModelError
from updyn.model import Model
from updyn.updating.result import UpdateResult

__all__ = [
    "REFUSED",
    "ConversionError",
    "conversion_error",
    "conversion_state",
    "conversions",
    "find_route",
]

#: Conversions of the structure's modes.
_MODE_CONVERSIONS = ("modal", "complex", "biot")
#: Conversions that are refused, with the reason.
REFUSED = {
    "diagonal": "modal damping ratios lose the coupling of the modes by the damping",
    "single-frequency": (
        "structural damping converted at one frequency is correct at that frequency only"
    ),
}


@dataclass(frozen=True, slots=True)
class ConversionError:
    """Errors of a conversion of the damping with all modes, as those of a `Plant`.

    `name` is ``"modal"`` (full modal damping matrix), ``"complex"``, ``"biot"``, ``"diagonal"`` or
    ``"single-frequency"``. Errors are nan if the conversion is not possible; `note` gives the
    reason.
    """

    name: str
    error: float
    peak_error: float
    note: str = ""
    relative_error: float = float("nan")


def conversions(
    model: Model | UpdateResult,
    inputs: Ports,
    outputs: Ports,
    band: Sequence[float],
    *,
    quantity: str | Sequence[str] = "receptance",
    tier: str | None = None,
    backend: str | None = None,
) -> tuple[ConversionError, ...]:
    """Return the errors of each conversion of structural damping with all modes.

    Parameters
    ----------
    model, inputs, outputs, band, quantity, tier, backend
        As for `plant`.

    Returns
    -------
    tuple of ConversionError
        Routes of `plant` first, then those that it refuses. The single frequency is the centre of
        the band in log frequency.

    Raises
    ------
    OptionError, ModelError, DofError, SolverError
        As `plant`.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> found = updyn.conversions(chain.build(), ["12:X"], ["12:X"], (0.5, 12.0))
    >>> next(c.error < 0.01 for c in found if c.name == "complex")
    True
    """
    ports = as_ports(inputs, "input"), as_ports(outputs, "output")
    task, _ = build_task(CompiledStructure.of(model), *ports, band, quantity, tier, backend)
    return tuple(conversion_error(task, name) for name in (*_MODE_CONVERSIONS, *REFUSED))


def find_route(plant: Plant) -> str:
    """Return the route of a plant, and its fitted parts."""
    if "fitted" in plant.facts:
        return f"{plant.route}, fitted {plant.facts['fitted']}"
    return plant.route


def conversion_state(name: str, plant: Plant | None) -> str:
    """Return ``"used"`` if a plant uses a conversion, with a note on fitted outputs; else empty."""
    if plant is None or plant.route != name:
        return ""
    return "used, then outputs fitted" if "fitted" in plant.facts else "used"


def conversion_error(task: PlantTask, name: str) -> ConversionError:
    """Return the errors of a conversion; those of its best variant."""
    best = ConversionError(name, float("nan"), float("nan"))
    try:
        for conversion in task.conversions(name):
            G = conversion.response(
                np.ones(len(conversion.frequency), dtype=np.bool_), task.target.freq
            )
            found = ConversionError(
                name,
                task.target.error(G),
                task.target.peak_error(G),
                relative_error=task.target.relative_error(G),
            )
            if not best.error <= found.error:
                best = found
    except ModelError as error:
        if not np.isfinite(best.error):
            return replace(best, note=str(error))
    return best
