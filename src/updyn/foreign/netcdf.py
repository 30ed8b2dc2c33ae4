"""netCDF-4 files as plain data, by h5netcdf.

A file is ``{"attributes": {...}, "names": [...], "variables": {name: [dimensions, values,
attributes]}, "groups": {name: {...}}}``; a group is as returned by `updyn.foreign.hdf5`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import h5netcdf
import h5py

from updyn.foreign.hdf5 import HDF5Content, has_no_variable, plain_value

__all__ = ["load"]


def load(
    path: str, is_ours: bool, kind: str, wanted: Sequence[str], groups: Sequence[str]
) -> dict[str, object]:
    """Load the root of a file, and those of its `groups` that exist.

    Only names and attributes are loaded if the attribute ``updyn_kind`` differs from `kind`, or is
    missing and no name is in `wanted`.
    """
    content = HDF5Content(path, is_ours)
    found: dict[str, Any] = {"variables": {}, "groups": {}}
    with h5py.File(path, "r") as file:
        members = content.members(file)
        found["names"] = sorted(members)
        found["attributes"] = content.attributes(file)
        stored_kind = found["attributes"].get("updyn_kind")
        if stored_kind != kind and (stored_kind is not None or not set(wanted) & set(members)):
            return found
        for item in members.values():
            if isinstance(item, h5py.Dataset) and not has_no_variable(item):
                content.check(item)
        for name in groups:
            if isinstance(members.get(name), h5py.Group):
                found["groups"][name] = content.group(members[name])
    with h5netcdf.File(path, "r", decode_vlen_strings=True) as file:
        found["attributes"] = _attributes(file)
        for name, variable in file.variables.items():
            found["variables"][name] = [
                list(variable.dimensions),
                plain_value(variable[...]),
                _attributes(variable),
            ]
    return found


def _attributes(item: Any) -> dict[str, object]:
    """Return attributes with the meaning of netCDF: an array of one number is a number."""
    return {str(name): plain_value(value) for name, value in item.attrs.items()}
