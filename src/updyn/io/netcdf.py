"""FRFs as netCDF-4, which is HDF5: the dataset of `FRF.to_xarray`, of kind "frf".

xarray opens the file. ``frf`` is complex, stored as by h5netcdf (a compound of two doubles, also
the convention of the netCDF library). For programs that cannot write this, two real variables
``frf_real`` and ``frf_imag`` are read as well. Expected::

    frf (freq, response, reference)        or frf_real and frf_imag
    freq                                   Hz, optional attribute units = "Hz"
    response, reference                    labels such as "12:-Z"
    coherence, variance *                  with the same dimensions
    node, xyz, trace, face, node_axes *    geometry
    level *                                N, by freq, or an attribute
    spectrum *                             of a random force: (n_s, 2), Hz and N^2/Hz
    attributes quantity, averages *, source *, decay *, base *, force *, sweep *, excitation *

Modes are the dataset of `ModeSet.to_xarray`, of kind "modes", without loss of digits.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from updyn.dofs import Dof
from updyn.errors import AbsentError, FormatError, OptionError
from updyn.foreign.plain import Other
from updyn.frf import FRF
from updyn.io.attributes import PACKING, read_unit, unpack
from updyn.io.frf_variables import VariableSource, select_items
from updyn.io.hdf5 import Folder, check_kind, put_kind
from updyn.io.items import check_phase, locate_errors, report_library_errors
from updyn.io.named import build_frf
from updyn.io.native import load_native, write_native
from updyn.io.rattlesnake import (
    build_rattlesnake_frf,
    build_rattlesnake_records,
    holds_frf,
    is_rattlesnake,
)
from updyn.io.record_arrays import build_records, refuse_without_values
from updyn.io.settings import FILE_TEXT
from updyn.io.variables_proposal import proposing_variables
from updyn.modal import ModeSet
from updyn.signals.records import Records

if TYPE_CHECKING:
    import xarray as xr

#: Variables of modes that may be missing.
_OF_MODES = (
    "loss_factor",
    "quality",
    "std_frequency",
    "std_loss_factor",
    "std_shapes",
    "cov_frequency",
)
#: Name of the array returned by `updyn.read_records`.
_RECORDS = "records"

__all__ = [
    "NetCDFContent",
    "load_netcdf",
    "read_frf",
    "read_modes",
    "read_records",
    "read_source",
    "write_frf",
    "write_modes",
]


def read_frf(
    path: str | Path,
    *,
    quantity: str | None = None,
    duplicates: str = "raise",
    real_valued: bool = False,
    response_labels: Iterable[str | Dof] | None = None,
    reference_labels: Iterable[str | Dof] | None = None,
    order: Sequence[str] | None = None,
    variables: Mapping[str, Any] | None = None,
) -> FRF:
    """Read FRFs from a netCDF-4 or HDF5 file; raise an `AbsentError` if it holds other data.

    A real variable ``frf`` is refused unless `real_valued`, because it may contain magnitudes or
    decibels. `variables` select datasets of any HDF5 file (`updyn.io.frf_variables`), and labels
    and `order` declare what these do not state.
    """
    of_arrays = {
        "response_labels": response_labels,
        "reference_labels": reference_labels,
        "order": order,
    }
    if variables is not None:
        return build_frf(
            select_items(read_source(path), variables, order),
            path,
            quantity=quantity,
            duplicates=duplicates,
            response_labels=response_labels,
            reference_labels=reference_labels,
            order=order,
            real_valued=real_valued,
        )
    if duplicates != "raise":
        raise OptionError(
            f"duplicates={duplicates!r}: this format holds every response and reference once;"
            " expected 'raise'"
        )
    found = _load(path, "frf", "frf", "frf_real")
    if order is None and is_rattlesnake(found.root.members, found.root.attributes):
        root = load_native("updyn.foreign.hdf5:load", path, what="netCDF-4 file")
        if holds_frf(root):
            return build_rattlesnake_frf(
                root,
                path,
                quantity=quantity,
                response_labels=response_labels,
                reference_labels=reference_labels,
            )
    for name, given in of_arrays.items():
        if given is not None:
            raise OptionError(
                f"{name} is only used with variables; state variables, too", key=(name,)
            )
    if "updyn_kind" in found.root.attributes:
        check_kind(found.root, path, "frf")
    elif not {"frf", "frf_real"} & set(found.root.members):
        held = ", ".join(sorted(found.root.members)[:8]) or "nothing"
        with proposing_variables(_list_datasets(path)):
            raise AbsentError(
                f"holds no variable 'frf' (see updyn.io.netcdf); it holds: {held}", path
            )
    with report_library_errors(path, "netCDF-4 file"):
        data = _combine_parts(found.data(), path)
        if "frf" in data.variables:
            check_phase(data["frf"].values, real_valued, "frf", path)
        with locate_errors(path):
            return FRF.from_xarray(data, quantity=quantity)


def read_records(
    path: str | Path,
    *,
    values: str | Sequence[str] | Mapping[str, str] | None = None,
    channels: Sequence[str] | None = None,
    order: Sequence[str] | None = None,
    time: str | None = None,
    rate: float | str | None = None,
    group: str | Sequence[str] | None = None,
) -> Records:
    """Read time records written by xarray, or any arrays of HDF5 (`updyn.io.record_arrays`).

    Names of datasets in groups have dots (``run1.force``). `group` is one stream, or several, of a
    file of Rattlesnake (`updyn.io.rattlesnake`).
    """
    if values is not None:
        _refuse_group(group)
        arrays, units = _read_datasets(path)
        return build_records(
            arrays,
            path,
            values=values,
            channels=channels,
            order=order,
            time=time,
            rate=rate,
            units=units,
        )
    found = _load(path, "records", _RECORDS)
    if is_rattlesnake(found.root.members, found.root.attributes):
        refuse_without_values(order=order, time=time, rate=rate)
        root = load_native("updyn.foreign.hdf5:load", path, what="netCDF-4 file")
        return build_rattlesnake_records(root, path, group=group, channels=channels)
    refuse_without_values(channels=channels, order=order, time=time, rate=rate)
    _refuse_group(group)
    if _RECORDS not in found.variables:
        held = ", ".join(sorted(found.root.members)[:8]) or "nothing"
        raise FormatError(
            f"holds no variable {_RECORDS!r}; it holds: {held}; select the datasets of records with"
            " values = { CHANNEL = DATASET }",
            path,
            key=("values",),
        )
    with report_library_errors(path, "netCDF-4 file"), locate_errors(path):
        data = found.data()
        # netCDF lists coordinates other than dimensions in an attribute, which is not read here.
        data = data.set_coords([name for name in ("unit",) if name in data])
        records = Records.from_xarray(data[_RECORDS])
        return replace(records, source=Path(path).name)


def _refuse_group(group: str | Sequence[str] | None) -> None:
    if group is not None:
        raise OptionError("group: only for files of Rattlesnake", key=("group",))


def read_source(path: str | Path) -> VariableSource:
    """Return the datasets of a netCDF-4 or HDF5 file, with their units."""
    arrays, units = _read_datasets(path)
    return VariableSource(arrays, path, units)


def _list_datasets(path: str | Path) -> dict[str, object]:
    """Return the datasets of a file, for messages; none if it is large or cannot be read."""
    if Path(path).stat().st_size > FILE_TEXT.listed_bytes:
        return {}
    try:
        return _read_datasets(path)[0]
    except FormatError:
        return {}


def _read_datasets(path: str | Path) -> tuple[dict[str, Any], dict[str, str]]:
    """Read the datasets of a file and their units, by dotted name."""
    return _datasets(load_native("updyn.foreign.hdf5:load", path, what="HDF5 file"), path)


def _datasets(
    group: Mapping[str, Any], path: str | Path, before: str = ""
) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the unpacked datasets of a group and its groups by dotted name, and their units."""
    arrays: dict[str, object] = {}
    units: dict[str, str] = {}
    for key, item in group["members"].items():
        name = before + key
        if isinstance(item, Mapping):
            inner = _datasets(item, path, f"{name}.")
            arrays |= inner[0]
            units |= inner[1]
            continue
        meaning = group["meanings"].get(key, {})
        is_array = isinstance(item, np.ndarray)
        arrays[name] = unpack(item, meaning, name, path) if is_array else item
        units[name] = read_unit(meaning, name, path)
    return arrays, units


@dataclass(frozen=True, slots=True)
class NetCDFContent:
    """A loaded netCDF-4 file; `variables` are dimensions, values and attributes by name."""

    root: Folder
    variables: Mapping[str, Any]
    path: str | Path

    def data(self) -> xr.Dataset:
        """Return the root as a dataset with unpacked numbers."""
        import xarray as xr

        variables = {}
        for name, (dimensions, values, attributes) in self.variables.items():
            if not isinstance(values, Other):
                unpacked = unpack(values, attributes, name, self.path)
                rest = {key: attributes[key] for key in attributes if key not in PACKING}
                label = read_unit(attributes, name, self.path)
                if label:
                    rest["units"] = label
                variables[name] = (dimensions, unpacked, rest)
        return xr.Dataset(variables, attrs=self.root.attributes)


def _load(path: str | Path, kind: str, *wanted: str) -> NetCDFContent:
    """Load a file as `load_netcdf`; refuse the classic format, which meshes of Exodus may have."""
    with Path(path).open("rb") as file:
        if file.read(3) == b"CDF":
            raise AbsentError(
                "a netCDF file of the classic format (version 3); expected netCDF-4 (HDF5)", path
            )
    return load_netcdf(path, kind, "netCDF-4 file", wanted=wanted)


def load_netcdf(
    path: str | Path,
    kind: str,
    what: str,
    *,
    wanted: Sequence[str] = (),
    groups: Sequence[str] = (),
) -> NetCDFContent:
    """Load a netCDF-4 file; only names and attributes if it is of another kind.

    `wanted` are names of which a file without stated kind has to contain one.
    """
    found = load_native(
        "updyn.foreign.netcdf:load", path, kind, list(wanted), list(groups), what=what
    )
    members: dict[str, Any] = dict.fromkeys(found["names"])
    for name, group in found["groups"].items():
        members[name] = Folder.of(f"/{name}", group)
    return NetCDFContent(Folder("/", found["attributes"], members), found["variables"], path)


def _combine_parts(data: xr.Dataset, path: str | Path) -> xr.Dataset:
    """Return the dataset with ``frf`` combined from its real and imaginary parts, if separate."""
    parts = [name for name in ("frf_real", "frf_imag") if name in data.variables]
    if not parts:
        return data
    if len(parts) == 1 or "frf" in data.variables:
        raise FormatError(
            f"holds {', '.join(sorted(n for n in ('frf', *parts) if n in data.variables))};"
            " expected 'frf', or both 'frf_real' and 'frf_imag'",
            path,
        )
    if data["frf_real"].dims != data["frf_imag"].dims:
        raise FormatError("'frf_real' and 'frf_imag' differ in their dimensions", path)
    units = [data[name].attrs.get("units", "") for name in parts]
    if units[0] != units[1]:
        raise FormatError(
            f"'frf_real' and 'frf_imag' differ in their units: {units[0]!r} and {units[1]!r}", path
        )
    values = data["frf_real"].values + 1j * data["frf_imag"].values
    frf = (data["frf_real"].dims, values, {"units": units[0]})
    return data.assign(frf=frf).drop_vars(parts)


def write_frf(frf: FRF, path: str | Path) -> None:
    """Write FRFs as a netCDF-4 file."""
    _write_dataset(frf.to_xarray(), "frf", path)


def read_modes(path: str | Path) -> ModeSet:
    """Read modes written by `write_modes`."""
    found = _load(path, "modes", "frequency")
    check_kind(found.root, path, "modes")
    data = found.data()
    for name in ("frequency", "shapes", "scaled"):
        if name not in data.variables:
            raise FormatError(f"holds no variable {name!r}; it is not complete", path)
    values: dict[str, Any] = {str(name): data[name].values for name in data.data_vars}
    labels = data["dof"].values.tolist() if "dof" in data.variables else []
    with locate_errors(path):
        return ModeSet(
            values.pop("frequency"),
            values.pop("shapes") if labels else None,
            labels,
            scaled=values.pop("scaled"),
            source=str(data.attrs.get("source", "")),
            **{name: values[name] for name in _OF_MODES if name in values},
        )


def write_modes(modes: ModeSet, path: str | Path) -> None:
    """Write modes as a netCDF-4 file, without the diagram, peaks without a mode, and leaning."""
    _write_dataset(modes.to_xarray(), "modes", path)


def _write_dataset(data: xr.Dataset, kind: str, path: str | Path) -> None:
    import h5py

    content = io.BytesIO()
    data.to_netcdf(content, engine="h5netcdf")
    with h5py.File(content, "r+") as file:
        put_kind(file, kind)
    write_native(content, path)
