"""Options of a plant: ports, band, tolerance, error and quantities, with their checks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from updyn.control.ports import Port
from updyn.dofs import Dof
from updyn.errors import OptionError, suggest
from updyn.frf import check_force_quantity
from updyn.group import is_number

__all__ = ["ERRORS", "Ports", "check_band", "check_error", "check_quantities", "check_tolerance"]

#: Error measures of a tolerance.
ERRORS = ("relative", "peak")

Ports = Iterable[str | Dof | Port] | str | Dof | Port


def check_band(band: Sequence[float]) -> tuple[float, float]:
    """Return lowest and highest frequency of a band in Hz; raises OptionError if invalid."""
    try:
        low, high = (float(f) for f in band)
    except (TypeError, ValueError) as error:
        raise OptionError(f"plant: band {band!r}; expected two frequencies in Hz") from error
    if not (np.isfinite(high) and 0.0 <= low < high):
        raise OptionError(f"plant: band from {low:g} to {high:g} Hz; expected 0 <= low < high")
    return low, high


def check_error(error: str) -> None:
    """Raise OptionError for an unknown error measure."""
    if error not in ERRORS:
        raise OptionError(f"plant: no error {error!r}; {suggest(str(error), ERRORS)}")


def check_tolerance(tolerance: float) -> None:
    """Raise OptionError for a tolerance outside 1e-9 to 0.5."""
    if not is_number(tolerance) or not 1e-9 <= tolerance <= 0.5:
        raise OptionError(f"plant: tolerance {tolerance!r}; expected a share between 1e-9 and 0.5")


def check_quantities(quantity: str | Sequence[str], count: int) -> tuple[str, ...]:
    """Return the quantity of each of `count` outputs; raises OptionError if invalid."""
    named = [quantity] * count if isinstance(quantity, str) else list(quantity)
    quantities = tuple(check_force_quantity(q) for q in named)
    if len(quantities) != count:
        raise OptionError(
            f"plant: {len(quantities)} quantities for {count} outputs; expected one, or one each"
        )
    return quantities
