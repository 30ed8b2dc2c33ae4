"""HDF5 files as plain data, by h5py.

A group is ``{"attributes": {...}, "members": {...}, "meanings": {...}}``; ``meanings`` contains, by
dataset, the attributes that define the meaning of its numbers. Numbers in other files, or missing
ones, are refused, because libhdf5 would follow a link to any file, and read zeros for numbers that
were never written.
"""

from __future__ import annotations

import math
from collections.abc import Collection

import h5py
import numpy as np

from updyn.arrays import NumberArray
from updyn.errors import FormatError
from updyn.foreign.attributes import PACKING, UNITS
from updyn.foreign.limits import ReadLimits, limits_of
from updyn.foreign.plain import Other, to_native
from updyn.foreign.settings import READING

__all__ = ["HDF5Content", "has_no_variable", "load", "plain_value"]

#: Name of a netCDF dimension without variable: a dataset without numbers.
_NO_VARIABLE = b"This is a netCDF dimension but not a netCDF variable"
#: Attributes that define the meaning of the numbers of a dataset, in lower case.
_MEANINGS = tuple(name.lower() for name in (*UNITS, *PACKING))
_LINK_REMEDY = "; it is not followed: store the numbers in the file itself"


def load(path: str, is_ours: bool) -> dict[str, object]:
    """Return the root of a file, which may have any size if updyn wrote it (`is_ours`)."""
    with h5py.File(path, "r") as file:
        return HDF5Content(path, is_ours).group(file)


class HDF5Content:
    """The content of an HDF5 file, checked before it is read."""

    def __init__(self, path: str, is_ours: bool) -> None:
        self.path = path
        self._limits: ReadLimits | None = None if is_ours else limits_of(path)
        self._unpacked = 0

    def group(self, group: h5py.Group, depth: int = 0) -> dict[str, object]:
        """Return a group with all its members, recursively; `depth` is the level of nesting."""
        most = READING.group_depth
        if depth > most:
            raise FormatError(f"{group.name}: groups nested more than {most} deep", self.path)
        members: dict[str, object] = {}
        meanings: dict[str, object] = {}
        for name, item in self.members(group).items():
            if isinstance(item, h5py.Group):
                members[name] = self.group(item, depth + 1)
            elif isinstance(item, h5py.Dataset) and has_no_variable(item):
                members[name] = Other("a dimension without variable")
            elif isinstance(item, h5py.Dataset):
                self.check(item)
                members[name] = _values(item)
                meaning = self.attributes(item, _MEANINGS)
                if meaning:
                    meanings[name] = meaning
            else:
                members[name] = Other(type(item).__name__)
        return {"attributes": self.attributes(group), "members": members, "meanings": meanings}

    def members(self, group: h5py.Group) -> dict[str, h5py.HLObject]:
        """Return the members of a group by name; refuse links to other files."""
        found = {}
        for name in group:
            link = group.get(name, getlink=True)
            if isinstance(link, h5py.ExternalLink):
                raise FormatError(
                    f"{group.name}: {name!r} is a link to the file {link.filename!r}{_LINK_REMEDY}",
                    self.path,
                )
            found[str(name)] = group[name]
        return found

    def attributes(self, item: h5py.HLObject, wanted: Collection[str] = ()) -> dict[str, object]:
        """Return the attributes of an item, all or those with the lower-case names `wanted`."""
        found: dict[str, object] = {}
        for name in item.attrs:
            if wanted and name.lower() not in wanted:
                continue
            stated = item.attrs.get_id(name)
            self._count(math.prod(stated.shape) * stated.dtype.itemsize)
            found[str(name)] = plain_value(item.attrs[name])
        return found

    def check(self, dataset: h5py.Dataset) -> None:
        """Refuse a dataset whose numbers are not all in the file, or are too many."""
        name = dataset.name
        if dataset.is_virtual:
            raise FormatError(f"{name}: a virtual dataset, whose numbers are elsewhere", self.path)
        if dataset.external:
            raise FormatError(
                f"{name}: its numbers are in the file {dataset.external[0][0]!r}{_LINK_REMEDY}",
                self.path,
            )
        self._count(dataset.size * dataset.dtype.itemsize if dataset.shape is not None else 0)
        is_whole = dataset.id.get_space_status() == h5py.h5d.SPACE_STATUS_ALLOCATED
        if dataset.size and not is_whole:
            raise FormatError(
                f"{name}: some numbers were never written; expected all {dataset.size}", self.path
            )

    def _count(self, more: int) -> None:
        self._unpacked += more
        if self._limits is not None:
            self._limits.check(self._unpacked)


def has_no_variable(dataset: h5py.Dataset) -> bool:
    """Return whether a dataset is only a dimension of netCDF, whose numbers are never read."""
    name = dataset.attrs.get("NAME", b"")
    return isinstance(name, bytes) and name.startswith(_NO_VARIABLE)


def _values(dataset: h5py.Dataset) -> NumberArray | Other:
    if h5py.check_string_dtype(dataset.dtype) is not None and dataset.dtype.kind == "O":
        return np.asarray(dataset.asstr()[()], dtype=object)
    if dataset.dtype.kind in "biufcS" and dataset.shape is not None:
        return to_native(np.asarray(dataset[()]))
    return Other(str(dataset.dtype))


def plain_value(value: object) -> str | NumberArray | Other:
    """Return the value of an attribute or a dataset as plain data: a str, an array or `Other`."""
    if isinstance(value, bytes | str):
        return value if isinstance(value, str) else value.decode("utf-8", "replace")
    array = np.asarray(value)
    if array.dtype.kind in "biufcSU":
        return to_native(array)
    if array.dtype.kind == "O" and all(isinstance(text, str) for text in array.flat):
        return array
    return Other(str(array.dtype))
