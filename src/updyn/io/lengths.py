"""Units of length of files that state none."""

from __future__ import annotations

from updyn.errors import OptionError, suggest

__all__ = ["LENGTHS", "length"]

#: Units of length in m.
LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}


def length(unit: str) -> float:
    """Return a unit of length in m; raise an OptionError for an unknown unit."""
    if not isinstance(unit, str) or unit not in LENGTHS:
        raise OptionError(f"unit {unit!r}: {suggest(str(unit), LENGTHS)}", key=("unit",))
    return LENGTHS[unit]
