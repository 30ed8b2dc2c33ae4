"""Attributes of netCDF variables and HDF5 datasets that define the meaning of their numbers.

Packed numbers and missing values: NetCDF Climate and Forecast conventions 1.11, sections 2.5.1 and
8.1; ``_Unsigned``: NetCDF Users Guide, appendix A.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from updyn.arrays import BoolArray, NumberArray
from updyn.errors import FormatError
from updyn.foreign.attributes import PACKING, UNITS

__all__ = ["PACKING", "read_unit", "unpack"]

_LINEAR = ("scale_factor", "add_offset")


def unpack(
    values: NumberArray, attributes: Mapping[str, object], name: str, path: str | Path
) -> NumberArray:
    """Return the unpacked values, with NaN for missing ones; texts are returned unchanged."""
    if values.dtype.kind not in "iufc" or not any(key in attributes for key in PACKING):
        return values
    stated = {}
    for key in PACKING:
        if key in attributes and key != "_Unsigned":
            stated[key] = _numbers(attributes[key], f"{name}: attribute {key!r}", path)
    if str(attributes.get("_Unsigned", "")).lower() == "true":
        values = _view_unsigned(values)
        stated |= {key: _view_unsigned(stated[key]) for key in stated if key not in _LINEAR}
    out = values
    if any(key in stated for key in _LINEAR):
        scale, offset = (_single_number(stated, key, name, path) for key in _LINEAR)
        out = values * (1.0 if scale is None else scale) + (0.0 if offset is None else offset)
    missing = _is_missing(values, stated) | _is_outside(values, out, stated)
    if missing.any():
        out = np.where(missing, np.nan, out)
    return out


def _numbers(given: object, where: str, path: str | Path) -> NumberArray:
    found = np.atleast_1d(np.asarray(given)).ravel()
    if found.dtype.kind not in "iufc":
        raise FormatError(f"{where} is {_format_value(given)!r}; expected numbers", path)
    return found


def _view_unsigned(values: NumberArray) -> NumberArray:
    """Return signed integers as unsigned integers with the same bits."""
    if values.dtype.kind != "i":
        return values
    return values.astype(f"u{values.dtype.itemsize}")


def _single_number(
    stated: Mapping[str, NumberArray], key: str, name: str, path: str | Path
) -> float | None:
    """Return an attribute that has to be one finite real number; None if it is absent."""
    if key not in stated:
        return None
    found = stated[key]
    if found.size != 1 or found.dtype.kind == "c" or not np.isfinite(found).all():
        raise FormatError(
            f"{name}: attribute {key!r} is {_format_value(found)!r}; expected one number", path
        )
    return float(found[0])


def _is_missing(values: NumberArray, stated: Mapping[str, NumberArray]) -> BoolArray:
    out = np.zeros(values.shape, dtype=bool)
    for key in ("_FillValue", "missing_value"):
        for mark in stated.get(key, ()):
            with np.errstate(over="ignore"):
                # 1e20 in double precision also marks numbers in single precision.
                is_float = values.dtype.kind == "f" and mark.dtype.kind != "c"
                out |= values == (values.dtype.type(mark) if is_float else mark)
    return out


def _is_outside(
    packed: NumberArray, unpacked: NumberArray, stated: Mapping[str, NumberArray]
) -> BoolArray:
    out = np.zeros(packed.shape, dtype=bool)
    for key, side in (("valid_min", 0), ("valid_max", 1), ("valid_range", 0), ("valid_range", 1)):
        bounds = stated.get(key, np.empty(0))
        if not bounds.size or packed.dtype.kind == "c":
            continue
        # Bounds of the packed type apply to packed numbers.
        values = unpacked if bounds.dtype.kind == "f" else packed
        out |= values > bounds[-1] if side else values < bounds[0]
    return out


def _format_value(given: object) -> object:
    return given.tolist() if isinstance(given, np.ndarray) else given


def read_unit(attributes: Mapping[str, object], name: str, path: str | Path) -> str:
    """Return the unit in the attributes ``units`` or ``unit`` (in any case), or an empty text."""
    labels: dict[str, str] = {}
    for key, given in attributes.items():
        if key.lower() in UNITS:
            labels[key] = _label(given, key, name, path)
    if len(set(labels.values())) > 1:
        keys = " and ".join(sorted(map(repr, labels)))
        raise FormatError(f"{name}: attributes {keys} differ: {labels}", path)
    return next(iter(labels.values()), "")


def _label(given: object, key: str, name: str, path: str | Path) -> str:
    if isinstance(given, np.ndarray) and given.size == 1:
        given = given.ravel().tolist()[0]
    if isinstance(given, bytes):
        given = given.decode("utf-8", "replace")
    if not isinstance(given, str):
        raise FormatError(
            f"{name}: attribute {key!r} is {_format_value(given)!r}; expected a text", path
        )
    return given.strip()
