"""Records as netCDF-4 (HDF5): each field of a dataclass has a storage format, a `FieldFormat`.

A layout lists the fields in the order of writing: ``{"status": Text(STATUSES), ...}``.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from updyn.arrays import NumberArray
from updyn.errors import FormatError, suggest
from updyn.io.hdf5 import Folder, check_kind, put_kind
from updyn.io.items import as_number, report_library_errors, require_file
from updyn.io.native import write_native
from updyn.io.netcdf import load_netcdf
from updyn.store.values import from_text, to_text

if TYPE_CHECKING:
    import h5py
    import xarray as xr

__all__ = [
    "Array",
    "Arrays",
    "FieldFormat",
    "Mixed",
    "Number",
    "Text",
    "Texts",
    "load_libraries",
    "put_fields",
    "read_dataset",
    "take_fields",
    "texts",
    "variable",
    "write_dataset",
]


_NEEDED = object()


class FieldFormat(Protocol):
    """Storage format of one field of a record in a dataset."""

    def store(self, data: xr.Dataset, name: str, value: Any) -> None:
        """Write the field with this name."""

    def load(self, data: xr.Dataset, name: str, path: Path) -> Any:
        """Return the field with this name; raise a FormatError if it is missing or not valid."""


def put_fields(data: xr.Dataset, record: object, layout: Mapping[str, FieldFormat]) -> None:
    """Write the fields of a record in a layout."""
    for name, field_format in layout.items():
        field_format.store(data, name, getattr(record, name))


def take_fields(data: xr.Dataset, layout: Mapping[str, FieldFormat], path: Path) -> dict[str, Any]:
    """Return the fields in a layout."""
    return {name: field_format.load(data, name, path) for name, field_format in layout.items()}


# -- formats of fields --------------------------------------------------------------------------
class Text:
    """A text, one of `choices` if given, as an attribute."""

    def __init__(self, choices: Sequence[str] = ()) -> None:
        self._choices = choices

    def store(self, data: xr.Dataset, name: str, value: str) -> None:
        """Write the text."""
        data.attrs[name] = value

    def load(self, data: xr.Dataset, name: str, path: Path) -> str:
        """Return the text."""
        value = data.attrs.get(name)
        if not isinstance(value, str):
            raise FormatError(f"attribute {name!r} is {value!r}; expected a text", path)
        if self._choices and value not in self._choices:
            raise FormatError(f"{name} {value!r}; {suggest(value, self._choices)}", path)
        return value


class Number:
    """A number or a flag, as an attribute; a ``bool`` is stored as 0 or 1."""

    def __init__(self, kind: type) -> None:
        self._kind = kind

    def store(self, data: xr.Dataset, name: str, value: float) -> None:
        """Write the number."""
        data.attrs[name] = int(value) if self._kind is bool else value

    def load(self, data: xr.Dataset, name: str, path: Path) -> Any:
        """Return the number."""
        if name not in data.attrs:
            raise FormatError(f"no attribute {name!r}", path)
        return self._kind(as_number(data.attrs[name], name, path))


class Mixed:
    """Mixed values as JSON text (`updyn.store.values`), in a variable or an attribute.

    `kind` is the dataclass of the field, whose fields are stored by name, or None for plain values.
    An attribute without the default `absent` is required.
    """

    def __init__(
        self,
        kind: Callable[..., object] | None = None,
        *,
        is_attribute: bool = False,
        absent: object = _NEEDED,
    ):
        self._kind = kind
        self._is_attribute = is_attribute
        self._absent = absent

    def store(self, data: xr.Dataset, name: str, value: object) -> None:
        """Write the values."""
        if is_dataclass(value) and not isinstance(value, type):
            value = asdict(value)
        text = to_text(value, name)
        if self._is_attribute:
            data.attrs[name] = text
        else:
            data[name] = ((), text)

    def load(self, data: xr.Dataset, name: str, path: Path) -> Any:
        """Return the values."""
        if self._is_attribute:
            if name not in data.attrs and self._absent is not _NEEDED:
                return self._absent
            text = Text().load(data, name, path)
        else:
            text = str(variable(data, name, path)[()])
        value = from_text(text, name, path)
        if self._kind is None:
            return value
        try:
            return self._kind(**value)
        except TypeError as error:
            raise FormatError(f"{name}: {error}", path) from error


class Texts:
    """A tuple of texts, as the coordinate of a dimension."""

    def __init__(self, dim: str) -> None:
        self._dim = dim

    def store(self, data: xr.Dataset, name: str, value: Iterable[str]) -> None:
        """Write the texts."""
        data.coords[self._dim] = (self._dim, texts(value))

    def load(self, data: xr.Dataset, name: str, path: Path) -> tuple[str, ...]:
        """Return the texts."""
        return tuple(map(str, variable(data, self._dim, path)))


class Array:
    """A number array, as a variable, by default named as the field.

    An existing dimension of the dataset must have the same length. With `is_flag`, entries are true
    or false, stored as 0 and 1.
    """

    def __init__(
        self,
        *dims: str,
        variable: str | None = None,
        unit: str | None = None,
        is_flag: bool = False,
    ) -> None:
        self._dims = dims
        self._variable = variable
        self._attributes = {}
        if unit is not None:
            self._attributes["units"] = unit
        self._is_flag = is_flag

    def store(self, data: xr.Dataset, name: str, value: NumberArray) -> None:
        """Write the array."""
        stored = value.astype(np.int8) if self._is_flag else value
        data[self._variable or name] = (self._dims, stored, self._attributes)

    def load(self, data: xr.Dataset, name: str, path: Path) -> NumberArray:
        """Return the array."""
        stored_name = self._variable or name
        value: NumberArray = variable(data, stored_name, path)
        # The dimension ``parameter_other`` is the second one of a square table over ``parameter``.
        expected = tuple(data.sizes.get(dim.removesuffix("_other")) for dim in self._dims)
        if value.shape != expected:
            raise FormatError(
                f"{stored_name}: found shape {value.shape}, expected {expected}", path
            )
        return value.astype(np.bool_) if self._is_flag else value


class Arrays:
    """Number arrays by name, as variables whose names have a prefix."""

    def __init__(self, prefix: str, *dims: str) -> None:
        self._prefix = prefix
        self._dims = dims

    def store(self, data: xr.Dataset, name: str, value: Mapping[str, NumberArray]) -> None:
        """Write the arrays."""
        for key, array in value.items():
            data[self._prefix + key] = (self._dims, array)

    def load(self, data: xr.Dataset, name: str, path: Path) -> dict[str, NumberArray]:
        """Return the arrays."""
        found = {}
        for key in map(str, data.data_vars):
            if key.startswith(self._prefix):
                found[key.removeprefix(self._prefix)] = data[key].values
        return found


def texts(items: Iterable[str]) -> NumberArray:
    """Return texts as an array that xarray can write."""
    return np.array(list(items), dtype=object)


def variable(data: xr.Dataset, name: str, path: Path) -> Any:
    """Return the values of a variable; raise a FormatError if it does not exist."""
    if name not in data.variables:
        raise FormatError(f"no variable {name!r}; {suggest(name, map(str, data.variables))}", path)
    return data[name].values


# -- the file -----------------------------------------------------------------------------------
def load_libraries() -> None:
    """Import the libraries of `write_dataset`, which takes a second or two."""
    # Called before a long computation, so that the results of a stopped one are written at once.
    import xarray as xr

    # Libraries import parts only at first use.
    xr.Dataset({"number": 0.0}).to_netcdf(io.BytesIO(), engine="h5netcdf")


def write_dataset(
    data: xr.Dataset,
    path: str | Path,
    kind: str,
    put_more: Callable[[h5py.File], None] | None = None,
) -> None:
    """Write a dataset as a file of updyn, which is replaced only once the new one is complete.

    `kind` is for `updyn.io.hdf5.check_kind`; `put_more` writes into the open `h5py.File`.
    """
    import h5py

    content = io.BytesIO()
    data.to_netcdf(content, engine="h5netcdf")
    with h5py.File(content, "r+") as file:
        put_kind(file, kind)
        if put_more is not None:
            put_more(file)
    write_native(content, path)


def read_dataset(
    path: str | Path, kind: str, what: str, groups: Sequence[str] = ()
) -> tuple[xr.Dataset, dict[str, Folder]]:
    """Return the root of a file written by `write_dataset`, in memory, and its required groups.

    `what` is the kind in words.
    """
    path = require_file(path)
    found = load_netcdf(path, kind, f"{what} (NetCDF-4)", groups=groups)
    check_kind(found.root, path, kind)
    folders = {}
    for name in groups:
        folder = found.root.members.get(name)
        if not isinstance(folder, Folder):
            raise FormatError(f"no group {name!r}; found: {', '.join(found.root.members)}", path)
        folders[name] = folder
    with report_library_errors(path, f"{what} (NetCDF-4)"):
        return found.data(), folders
