"""Items of FRFs in variables selected by the user, the option ``variables`` of ``read_frf``.

A mapping has the names of variables (with dots into structs and groups) by item of
`updyn.io.named`. ``H`` may be replaced by its parts, such as ``real`` and ``imaginary``, or by
``channels`` as in `updyn.io.channels`. ``name(:,2)`` is the second column of a table. Values are
read only from the selected variables; labels, geometry and so on also from those with their names
by default.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from updyn.arrays import NumberArray
from updyn.errors import InputError, OptionError
from updyn.io.channels import (
    PARTS,
    Key,
    check_keys,
    combine_parts,
    read_channels,
    read_frequency,
)
from updyn.io.items import Items, as_numbers
from updyn.io.named import FRF_ITEMS
from updyn.io.variable_names import (
    find_variable,
    select_column,
    split_column,
    warn_of_omitted,
)

__all__ = ["VariableSource", "select_items"]

_ROOT: Key = ("variables",)
_UNITS = ("frequency_unit", "unit")
_VALUES = ("H", "values", "coherence", "variance")
_PARTS = tuple(part for part in PARTS if part != "complex")
_KEYS = (*(i for i in FRF_ITEMS if not i.startswith("updyn_")), *_PARTS, "channels", *_UNITS)


@dataclass(frozen=True, slots=True)
class VariableSource:
    """The variables of a file, as a `updyn.io.channels.Source`; `units` are by variable."""

    found: Items
    path: str | Path
    units: Mapping[str, str] = field(default_factory=dict)

    def item(self, name: Any, key: Key) -> Any:
        """Return a variable, a field of a struct, or a column of a table."""
        variable, column = split_column(name) if isinstance(name, str) else (name, None)
        value = find_variable(self.found, variable, self.path, key)
        if column is None:
            return _as_texts(value)
        return select_column(as_numbers(value, name, self.path), name, self.path, key)

    def numbers(self, name: Any, key: Key, *, is_complex: bool = False) -> NumberArray:
        """Return the numbers of a variable."""
        numbers = as_numbers(self.item(name, key), str(name), self.path)
        if not is_complex and numbers.dtype.kind == "c" and not numbers.imag.any():
            return np.asarray(numbers.real)
        return numbers

    def title(self, name: Any) -> str:
        """Return the name of a variable without the structs that contain it."""
        return str(name).split(".")[-1]

    def unit(self, name: Any) -> str:
        """Return the unit in the attributes of a variable, or an empty text."""
        return self.units.get(str(name), "")


def _as_texts(value: object) -> object:
    """Return an array of texts as a list, and other items unchanged."""
    if isinstance(value, np.ndarray) and value.dtype.kind in "OSU":
        texts = [t.decode("utf-8", "replace") if isinstance(t, bytes) else t for t in value.flat]
        return texts[0] if value.ndim == 0 else list(map(str, texts))
    return value


def select_items(
    source: VariableSource, variables: Mapping[str, object], order: Sequence[str] | None = None
) -> dict[str, object]:
    """Return the items of FRFs, as arguments of `updyn.io.named.build_frf`."""
    check_keys(variables, _KEYS, (), _ROOT)
    stated = {k: v for k, v in variables.items() if k not in (*_UNITS, *_PARTS, "channels")}
    items = {item: source.item(name, (*_ROOT, item)) for item, name in stated.items()}
    _add_standard_items(items, source, variables)
    name = variables.get("freq", "freq" if "freq" in source.found else None)
    if name is None:
        raise OptionError("variables: missing key 'freq'", key=_ROOT)
    freq_key, unit_key = (*_ROOT, "freq"), (*_ROOT, "frequency_unit")
    freq = read_frequency(source, name, variables.get("frequency_unit"), freq_key, unit_key)
    items["freq"] = freq
    values = _read_values(source, variables)
    if order is None and "channels" not in variables:
        values |= {k: items[k] for k in ("coherence", "variance") if k in items}
        values = {k: _as_channel(v, len(freq)) for k, v in values.items()}
    for item in ("quantity", "responses", "references"):
        if item in values and item in stated:
            raise OptionError(
                f"variables: {item} in addition to channels or unit; expected one of them",
                key=(*_ROOT, item),
            )
    return items | values


def _add_standard_items(
    items: dict[str, object], source: VariableSource, variables: Mapping[str, object]
) -> None:
    """Add unused variables with the names of items, except values, which cause a warning."""
    used: set[str] = set()
    for name in _list_names(variables):
        used |= set(str(name).partition("(")[0].strip().split("."))
    by_channel = ("responses", "references") if "channels" in variables else ()
    for item in FRF_ITEMS:
        if item in source.found and item not in {*items, *used, *_VALUES, *by_channel}:
            items[item] = source.item(item, _ROOT)
    omitted = [item for item in _VALUES if item in source.found and item not in used]
    warn_of_omitted(omitted, source.path)


def _list_names(given: object) -> list[object]:
    if isinstance(given, Mapping):
        return [name for value in given.values() for name in _list_names(value)]
    if isinstance(given, list | tuple):
        return [name for value in given for name in _list_names(value)]
    return [given]


def _read_values(source: VariableSource, variables: Mapping[str, object]) -> dict[str, object]:
    """Return ``H`` in SI units from an array, from its parts, or from channels."""
    ways = {
        "channels": "channels" in variables,
        "H": "H" in variables or "values" in variables,
        "parts": any(part in variables for part in _PARTS),
    }
    if sum(ways.values()) != 1:
        raise OptionError(
            f"variables: found {' and '.join(w for w in ways if ways[w]) or 'no values'}; expected"
            f" H, or its parts ({', '.join(_PARTS)}), or channels",
            key=_ROOT,
        )
    if ways["channels"]:
        return read_channels(source, variables, _ROOT)
    parts = {part: variables[part] for part in _PARTS if part in variables}
    name = "values" if "values" in variables else "H"
    if ways["H"]:
        parts = {"complex": variables[name]}
    try:
        found = combine_parts(source, parts, variables.get("unit"), _ROOT, (*_ROOT, "unit"))
    except InputError as error:
        if error.key == (*_ROOT, "complex"):
            error.key = (*_ROOT, name)
        raise
    items: dict[str, object] = {name: found.values}
    if found.quantity is not None:
        items["quantity"] = found.quantity
    return items


def _as_channel(values: object, n_lines: int) -> object:
    """Return the values of one channel as (lines, 1, 1), other values unchanged."""
    array = np.asarray(values)
    if array.ndim < 3 and array.size == n_lines:
        return array.reshape(n_lines, 1, 1)
    return values
