"""Variables of a file by name, with dots between a struct or group and its fields."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

from updyn.arrays import NumberArray
from updyn.errors import FormatError, OptionError, UpdynWarning, suggest
from updyn.foreign.plain import Unread
from updyn.io.items import Items, format_key, format_names

__all__ = ["find_variable", "select_column", "split_column", "warn_of_omitted"]

_COLUMN = re.compile(r"(.+?)\s*\(\s*:\s*,\s*([0-9]+)\s*\)")


def find_variable(
    found: Items, name: object, path: str | Path, key: tuple[str | int, ...] = ()
) -> object:
    """Return a variable, or a field of a struct; a `FormatError` gives the nearest names.

    An unreadable variable, or a struct that contains one, is an error.
    """
    if not isinstance(name, str):
        raise OptionError(f"{format_key(key)} = {name!r}: expected the name of a variable", key=key)
    value: object = found
    if name in found:
        value = found[name]
    else:
        for part in name.split("."):
            if not isinstance(value, Mapping) or part not in value:
                hint = suggest(name, _names(found))
                if not hint.startswith("valid"):
                    hint += f" found: {format_names(dict.fromkeys(_names(found)))}"
                raise FormatError(f"no variable {name!r}; {hint}", path, key=key)
            value = value[part]
    _refuse_unread(value, path)
    return value


def split_column(name: str) -> tuple[str, int | None]:
    """Return the variable and the column of a name such as ``data(:,2)``; None without a column."""
    column = _COLUMN.fullmatch(name)
    return (name, None) if column is None else (column[1], int(column[2]))


def select_column(
    table: NumberArray, name: str, path: str | Path, key: tuple[str | int, ...] = ()
) -> NumberArray:
    """Return the column of a table that a name such as ``data(:,2)`` selects."""
    variable, column = split_column(name)
    assert column is not None
    if table.ndim != 2 or not 1 <= column <= table.shape[1]:
        raise FormatError(
            f"{name}: {variable!r} has shape {table.shape}; expected a table with column {column}",
            path,
            key=key,
        )
    return table[:, column - 1]


def warn_of_omitted(omitted: Sequence[str], path: str | Path) -> None:
    """Warn of variables with the names of items that are not read."""
    if omitted:
        warnings.warn(
            f"{path}: {', '.join(omitted)} of the file not read, because variables do not select"
            f" {'it' if len(omitted) == 1 else 'them'}",
            UpdynWarning,
            stacklevel=3,
        )


def _refuse_unread(value: object, path: str | Path) -> None:
    """Refuse an unusable item, or a struct that contains one."""
    if isinstance(value, Unread):
        raise FormatError(value.reason, path)
    if isinstance(value, Mapping):
        for field in value.values():
            _refuse_unread(field, path)


def _names(found: Items, before: str = "") -> list[str]:
    out = []
    for name, value in found.items():
        out.append(before + name)
        if isinstance(value, Mapping):
            out += _names(value, f"{before}{name}.")
    return out
