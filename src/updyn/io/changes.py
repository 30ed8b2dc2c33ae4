"""Checks of the changes of groups for `write_properties`: quantities and values."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from updyn.errors import FormatError, suggest
from updyn.group import is_number

__all__ = ["check_changes"]

_QUANTITIES = ("stiffness", "mass", "viscous", "loss_factor")
#: Quantities that may be 0.
_LEAST_ZERO = ("viscous", "loss_factor")


def check_changes(changes: Mapping[str, Mapping[str, float]], deck: Path) -> None:
    """Refuse unknown quantities and invalid values."""
    for name, change in changes.items():
        for quantity, value in change.items():
            if quantity not in _QUANTITIES:
                raise FormatError(
                    f"group {name!r}: no quantity {quantity!r}; {suggest(quantity, _QUANTITIES)}",
                    deck,
                )
            is_least = quantity in _LEAST_ZERO and value == 0
            if not is_number(value) or not (0 < value < float("inf") or is_least):
                wanted = "of at least 0" if quantity in _LEAST_ZERO else "above 0"
                raise FormatError(
                    f"group {name!r}: {quantity} {value!r}; expected a finite number {wanted}",
                    deck,
                )
