"""`conversions`: how well each conversion of structural damping answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from updyn.control.options import Ports
from updyn.control.plant import Plant
from updyn.control.ports import as_ports
from updyn.control.structure import Structure
from updyn.control.task import Task, task_of
from updyn.errors import ModelError
from updyn.model import Model
from updyn.updating.result import UpdateResult

__all__ = ["REFUSED", "ConversionError", "conversions", "error_of", "route_of", "state_of"]

#: Of the structure's own modes.
_OWN = ("modal", "complex", "biot")
#: Conversions that no plant is made by, and why.
REFUSED = {
    "diagonal": "modal damping ratios lose the coupling of the modes by the damping",
    "single-frequency": (
        "structural damping converted at one frequency is right at that frequency only"
    ),
}


@dataclass(frozen=True, slots=True)
class ConversionError:
    """How well a conversion of the damping answers, all modes kept.

    Attributes
    ----------
    name : str
        ``"modal"`` (full modal damping matrix), ``"complex"``, ``"biot"``, ``"diagonal"``,
        ``"single-frequency"``.
    error, peak_error : float
        As those of a `Plant`; nan where it is not possible.
    note : str
        Why not, or where it was made.
    relative_error : float
        As that of a `Plant`.
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
    """Tell how well each conversion of structural damping answers, side by side, all modes kept.

    Parameters
    ----------
    model, inputs, outputs, band, quantity, tier, backend
        As for `plant`.

    Returns
    -------
    tuple of ConversionError
        Routes of `plant` first, then those that it refuses. The single frequency is the middle of
        the band on a logarithmic scale.

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
    task, _ = task_of(Structure.of(model), *ports, band, quantity, tier, backend)
    return tuple(error_of(task, name) for name in (*_OWN, *REFUSED))


def route_of(plant: Plant) -> str:
    """Return the route of a plant, and what of it is fitted.

    Parameters
    ----------
    plant : Plant
        The plant.
    """
    if "fitted" in plant.facts:
        return f"{plant.route}, fitted {plant.facts['fitted']}"
    return plant.route


def state_of(name: str, plant: Plant | None) -> str:
    """Return what a plant has of a conversion: ``"used"``, also that it is fitted; or nothing.

    Parameters
    ----------
    name : str
        Of the conversion.
    plant : Plant or None
        The plant. Where its outputs are fitted, its errors are not those of the conversion.
    """
    if plant is None or plant.route != name:
        return ""
    return "used, then outputs fitted" if "fitted" in plant.facts else "used"


def error_of(task: Task, name: str) -> ConversionError:
    """Return how well a conversion answers; the best where it has variants.

    Parameters
    ----------
    task : Task
        What it is made of, and compared with.
    name : str
        Of the conversion.
    """
    best = ConversionError(name, float("nan"), float("nan"))
    try:
        for conversion in task.tried(name):
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
