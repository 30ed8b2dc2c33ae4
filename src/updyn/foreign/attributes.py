"""Names of attributes of datasets that say what the numbers mean."""

from __future__ import annotations

__all__ = ["PACKING", "UNITS"]

#: Attributes that change what stored numbers mean, spelled as the conventions define them.
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
