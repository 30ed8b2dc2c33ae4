"""Names of dataset attributes that define the meaning of the numbers."""

from __future__ import annotations

__all__ = ["PACKING", "UNITS"]

#: Attributes that change the meaning of stored numbers, in the spelling of the conventions.
PACKING = (
    "scale_factor",
    "add_offset",
    "_FillValue",
    "missing_value",
    "valid_min",
    "valid_max",
    "valid_range",
    "_Unsigned",
)
#: Attributes that state a unit, in lower case.
UNITS = ("units", "unit")
