"""What is read from an open dataset, or missed in it with the nearest name."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from updyn.errors import FormatError, suggest

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["existing", "text_of", "variable"]


def existing(path: str | Path) -> Path:
    """Return the path of a file that is there.

    Raises
    ------
    FormatError
        If it is not; the nearest name beside it is given.
    """
    path = Path(path)
    if not path.is_file():
        siblings = [p.name for p in path.parent.iterdir()] if path.parent.is_dir() else []
        raise FormatError(f"no such file; {suggest(path.name, siblings)}", path)
    return path


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
