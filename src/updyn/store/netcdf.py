"""What is read from an open dataset, or missed in it with the nearest name."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from updyn.errors import FormatError, suggest

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["text_of", "variable"]


def variable(data: xr.Dataset, name: str, path: Path) -> Any:
    """Return the values of a variable.

    Raises
    ------
    FormatError
        If there is none of that name.
    """
    if name not in data.variables:
        raise FormatError(f"no variable {name!r}; {suggest(name, map(str, data.variables))}", path)
    return data[name].values


def text_of(data: xr.Dataset, name: str, path: Path) -> str:
    """Return an attribute that is a text.

    Raises
    ------
    FormatError
        If it is not there, or something else.
    """
    value = data.attrs.get(name)
    if not isinstance(value, str):
        raise FormatError(f"attribute {name!r} is {value!r}; expected a text", path)
    return value
