"""Exodus II files as plain data: netCDF-4 by h5py, classic netCDF by scipy.

Layout: L. A. Schoof and V. R. Yarberry, EXODUS II: a finite element data model, SAND92-2137,
appendix A.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import h5py
import numpy as np
from scipy.io import netcdf_file

from updyn.errors import FormatError
from updyn.foreign.hdf5 import HDF5Content, plain_value
from updyn.foreign.limits import limits_of

__all__ = ["load"]

_WANTED = re.compile(r"coord[xyz]?|node_num_map|connect[0-9]+")
_MARKS = ("api_version", "version")
_TYPE = "elem_type"


def load(path: str) -> dict[str, object]:
    """Load ``variables``, arrays by name, and ``types``, their attributes ``elem_type``."""
    if h5py.is_hdf5(path):
        return _load_hdf5(path)
    with Path(path).open("rb") as file:
        start = file.read(4)
    if start == b"CDF\x05":
        raise FormatError(
            "a netCDF file of the 64-bit data format (CDF-5), which is not supported; convert it:"
            " nccopy -k netCDF-4 IN OUT",
            path,
        )
    return _load_classic(path)


def _load_hdf5(path: str) -> dict[str, object]:
    content = HDF5Content(path, False)
    with h5py.File(path, "r") as file:
        members = content.members(file)
        _check(content.attributes(file), members, path)
        variables = {}
        types = {}
        for name in _select_names(members):
            item = members[name]
            if not isinstance(item, h5py.Dataset):
                raise FormatError(f"{name}: a group; expected numbers", path)
            content.check(item)
            variables[name] = np.asarray(item[()])
            types[name] = _text(plain_value(item.attrs.get(_TYPE, "")))
        return {"variables": variables, "types": types}


def _load_classic(path: str) -> dict[str, object]:
    limits = limits_of(path)
    with netcdf_file(path, "r", mmap=False) as file:
        _check(file._attributes, file.variables, path)
        variables = {}
        types = {}
        unpacked = 0
        for name in _select_names(file.variables):
            values = file.variables[name].data
            unpacked += values.nbytes
            limits.check(unpacked)
            variables[name] = np.array(values, dtype=values.dtype.newbyteorder("="))
            types[name] = _text(getattr(file.variables[name], _TYPE, b""))
        return {"variables": variables, "types": types}


def _select_names(names: Iterable[str]) -> list[str]:
    """Return the names of the variables to load, blocks of elements by number."""
    wanted = [name for name in names if _WANTED.fullmatch(name)]
    return sorted(wanted, key=lambda name: (len(name), name))


def _check(attributes: Iterable[str], names: Iterable[str], path: str) -> None:
    """Refuse a file that is not Exodus II."""
    has_mark = any(mark in set(attributes) for mark in _MARKS)
    if has_mark and {"coord", "coordx"} & set(names):
        return
    held = ", ".join(sorted(names)[:8]) or "nothing"
    raise FormatError(
        "not an Exodus II file: expected an attribute api_version, and variables coord or coordx,"
        f" coordy and coordz; it holds: {held}",
        path,
    )


def _text(given: object) -> str:
    if isinstance(given, np.ndarray):
        given = given.ravel().tolist()[0] if given.size else ""
    if isinstance(given, bytes):
        given = given.decode("latin-1")
    return str(given).strip(" \0")
