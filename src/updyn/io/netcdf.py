"""FRFs as netCDF-4, which is HDF5: the dataset of `FRF.to_xarray`, of kind "frf".

Any xarray opens the file. ``frf`` is complex, stored as h5netcdf stores it (a compound of two
doubles, the convention that the netCDF library shares). For programs that cannot write that, two
real variables ``frf_real`` and ``frf_imag``
are read as well. Expected::

    frf (freq, response, reference)        or frf_real and frf_imag
    freq                                   Hz, attribute units = "Hz" where it has one
    response, reference                    labels such as "12:-Z"
    coherence, variance *                  of the same dimensions
    node, xyz, trace, node_axes *          geometry
    attributes quantity, averages *, source *
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from updyn.errors import FormatError, OptionError
from updyn.frf import FRF
from updyn.io.atomic import atomic_path
from updyn.io.hdf5 import check_kind, put_kind
from updyn.io.items import library, placed

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["read_frf", "write_frf"]


def read_frf(path: str | Path, *, quantity: str | None = None, duplicates: str = "raise") -> FRF:
    """Read FRFs from a netCDF-4 or HDF5 file.

    Parameters
    ----------
    path : path
        The file.
    quantity : str, optional
        What was measured, where the file does not say; a contradiction is an error.
    duplicates : {"raise"}
        For the sake of the other formats; an array holds every response and reference once.

    Returns
    -------
    FRF
        What the file holds, exactly.

    Raises
    ------
    FormatError
        If the file is damaged, holds a model or a result (the right reader is named), or lacks a
        variable.
    """
    import h5py
    import xarray as xr

    if duplicates != "raise":
        raise OptionError(
            f"duplicates={duplicates!r}: this format holds every response and reference once; only"
            " 'raise' applies"
        )
    with Path(path).open("rb") as file:
        if file.read(3) == b"CDF":
            raise FormatError(
                "a netCDF file of the classic format (version 3); expected netCDF-4 (HDF5)", path
            )
    with library(path, "netCDF-4 file"):
        with h5py.File(path, "r") as file:
            if "updyn_kind" in file.attrs:
                check_kind(file, path, "frf")
            elif "frf" not in file and "frf_real" not in file:
                held = ", ".join(sorted(map(str, file))[:8]) or "nothing"
                raise FormatError(
                    f"holds no variable 'frf' (see updyn.io.netcdf); it holds: {held}", path
                )
        with xr.open_dataset(path, engine="h5netcdf", decode_cf=False) as data:
            data.load()
        with placed(path):
            return FRF.from_xarray(_joined(data, path), quantity=quantity)


def _joined(data: xr.Dataset, path: str | Path) -> xr.Dataset:
    """Return the dataset with ``frf`` made of its two parts, where it has those."""
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
    values = data["frf_real"].values + 1j * data["frf_imag"].values
    return data.assign(frf=(data["frf_real"].dims, values)).drop_vars(parts)


def write_frf(frf: FRF, path: str | Path) -> None:
    """Write FRFs as a netCDF-4 file.

    Parameters
    ----------
    frf : FRF
        The data.
    path : path
        File to write, usually ``.nc``.
    """
    import h5py

    data = frf.to_xarray()
    with atomic_path(path) as temporary:
        data.to_netcdf(temporary, engine="h5netcdf")
        with h5py.File(temporary, "r+") as file:
            put_kind(file, "frf")
