"""File formats by name, with the module of each: a lazy registry.

A format of another package is one `Format` and one registration::

    FORMATS.register("toy", Format("toy", "toy_package.files", (".toy",), (), ("read_frf",)))

or an entry point of the group ``updyn.readers`` that refers to such an object. The handler is
imported when a file of that format is read or written. It provides some of
``read_frf(path, *, quantity, duplicates, ...)``, ``write_frf(frf, path)``, ``read_model(path)``,
``write_model(model, path)``, ``read_geometry(path)``, ``read_modes(path)``,
``write_modes(modes, path, ...)``, ``write_shapes(shapes, path, ...)`` (a
`updyn.modal.shapes.Shapes`), ``read_records(path)``,
``write_properties(changes, deck, path)`` and ``read_contents(path)``, which returns the whole
content of a file. A ``read_frf`` with ``responses`` and ``references`` selects while it reads;
otherwise `updyn.io.read_frf` selects afterwards.
"""

from __future__ import annotations

import importlib
import os
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from updyn.errors import FormatError, OptionError, suggest
from updyn.io.items import is_folder, require_file, unreadable_error
from updyn.registry import Registry, load_object

__all__ = ["FORMATS", "Format", "find_format", "load"]


@dataclass(frozen=True, slots=True)
class Format:
    """One file format.

    Parameters
    ----------
    name : str
        Name for users, in ``format=`` and in job files.
    handler : str
        Module of the format, or ``"module:object"`` if the functions are methods of an object.
    suffixes : tuple of str
        File suffixes, lower case, with the dot.
    magic : tuple of bytes
        Possible first bytes of such files; empty if the content does not identify them.
    can : tuple of str
        Provided functions: ``read_frf``, ``write_frf``, ``read_model``, ``write_model``,
        ``read_geometry``, ``read_modes``, ``write_modes``, ``read_records``, ``write_properties``,
        ``read_contents``, ``read_source`` (named arrays, as a
        `updyn.io.frf_variables.VariableSource`).
    needs_magic : bool
        Whether every file of the format starts with one of `magic`. If not, its suffix is enough.
    """

    name: str
    handler: str
    suffixes: tuple[str, ...]
    magic: tuple[bytes, ...]
    can: tuple[str, ...]
    needs_magic: bool = True


_FRF = ("read_frf", "write_frf")
_MODEL = ("read_model", "write_model")
_MODES = ("read_modes", "write_modes")
_NASTRAN = ("read_model", "read_geometry", "write_properties")
_OP2 = ("read_model", "read_geometry", "read_modes", "read_contents")
#: The first record of `updyn.io.nastran.op2_file`: one word, 3 (for a date) or 2 (for a name).
_OP2_STARTS = tuple(
    size.to_bytes(4, order) + words.to_bytes(size, order) + size.to_bytes(4, order)
    for order in ("little", "big")
    for size in (4, 8)
    for words in (3, 2)
)
_HDF5 = b"\x89HDF\r\n\x1a\n"
_ARRAYS = (*_FRF, *_MODEL, "read_records", "read_source")
#: The first releases of MATLAB with version 7.3 wrote 7.0. Version 4 has no magic number.
_MATLAB = (b"MATLAB 5.0 MAT-file", b"MATLAB 7.0 MAT-file", b"MATLAB 7.3 MAT-file")
#: MED files are HDF5 files.
_MESH = (".msh", ".vtu", ".vtk", ".med")
_EXODUS = (".exo", ".e", ".ex2", ".exii", ".g", ".gen")
_DECK = ("read_model", "write_properties")
#: A header of 100 words (flags: integers), of file type 4 or 2.
_ANSYS = b"d\0\0\0\0\0\0\x80"

_BUILT_IN = (
    Format(
        "uff",
        "updyn.io.uff",
        (".uff", ".unv", ".uf", ".bunv"),
        (b"    -1",),
        (*_FRF, "read_geometry", "read_records", *_MODES, "write_shapes"),
        needs_magic=False,
    ),
    Format(
        "netcdf",
        "updyn.io.netcdf",
        (".nc", ".h5", ".hdf5"),
        (_HDF5, b"CDF"),
        (*_FRF, "read_records", "read_source", *_MODES),
    ),
    Format("hdf5", "updyn.io.hdf5", (".h5", ".hdf5"), (_HDF5,), _MODEL),
    Format("npz", "updyn.io.npz", (".npz",), (b"PK\x03\x04",), (*_FRF, *_MODEL, "read_source")),
    Format("mat", "updyn.io.matlab", (".mat",), _MATLAB, _ARRAYS, needs_magic=False),
    Format(
        "csv",
        "updyn.io.csv",
        (".csv", ".txt"),
        (),
        (*_FRF, "read_geometry", "read_records", *_MODES),
    ),
    Format("mtx", "updyn.io.matrix_market", (".mtx", ".toml"), (), _MODEL),
    Format("ansys", "updyn.io.ansys.properties", (".cdb", ".mac"), (), ("write_properties",)),
    Format("ansys_full", "updyn.io.ansys.full", (".full",), (_ANSYS + b"\x04\0\0\0",), _DECK),
    Format("ansys_emat", "updyn.io.ansys.emat", (".emat",), (_ANSYS + b"\x02\0\0\0",), _DECK),
    Format("nastran", "updyn.io.nastran.bdf", (".bdf", ".nas", ".dat"), (), _NASTRAN),
    Format("op4", "updyn.io.nastran.matrices:OP4", (".op4",), (), _MODEL),
    Format("op2", "updyn.io.nastran.op2", (".op2",), _OP2_STARTS, _OP2),
    Format("dmig", "updyn.io.nastran.matrices:DMIG", (".pch", ".dmig"), (), _MODEL),
    Format("calculix", "updyn.io.calculix", (".inp",), (), ("read_model", "write_properties")),
    Format("abaqus", "updyn.io.abaqus.model", (".inp", ".mtx"), (), (*_MODEL, "write_properties")),
    Format("lvm", "updyn.io.lvm", (".lvm",), (b"LabVIEW Measurement",), ("read_records",)),
    Format("wav", "updyn.io.wav", (".wav",), (b"RIFF", b"RIFX"), ("read_records",)),
    Format("tdms", "updyn.io.tdms", (".tdms",), (b"TDSm",), ("read_records",)),
    Format("mdf", "updyn.io.mdf", (".mf4", ".mdf"), (b"MDF     ", b"UnFinMF "), ("read_records",)),
    Format("mesh", "updyn.io.mesh", _MESH, (_HDF5,), ("read_model",), needs_magic=False),
    Format("exodus", "updyn.io.exodus", _EXODUS, (_HDF5, b"CDF"), ("read_geometry",)),
    Format("vtu", "updyn.viewer.vtu", (".vtu",), (), ("write_shapes",)),
    Format("animation", "updyn.plots.animation", (".gif", ".mp4"), (), ("write_shapes",)),
)
#: All formats, in order of preference for shared suffixes.
FORMATS: Registry[Format] = Registry("format", "updyn.readers", {f.name: f for f in _BUILT_IN})


def find_format(path: str | Path, verb: str, name: str | None = None) -> Format:
    """Select the format of a file: by name if given, else by content, else by suffix."""
    if not isinstance(path, str | os.PathLike):
        raise OptionError(f"path: expected the name of a file, found {type(path).__name__}")
    path = Path(path)
    able = [f for f in FORMATS.values() if verb in f.can]
    if name is not None:
        return _find_by_name(name, able, verb, path)
    suffix = path.suffix.lower()
    # A new file has the format of its suffix; for `write_properties`, `path` is the deck.
    candidates = able
    if verb.startswith("read") or verb == "write_properties":
        start = _start(path)
        by_magic = [f for f in able if start.startswith(f.magic)]
        for candidate in by_magic:
            if suffix in candidate.suffixes:
                return candidate
        if by_magic:
            return by_magic[0]
        # A file without the magic number of a binary format does not have this format, whatever
        # its suffix.
        candidates = [f for f in able if not f.magic or not f.needs_magic]
    for candidate in candidates:
        if suffix in candidate.suffixes:
            return candidate
    hint = ""
    if verb == "read_frf":
        hint = "; for a table in text state columns, or format = 'csv' if it has the names of csv"
    known = sorted(set(chain.from_iterable(f.suffixes for f in able)))
    raise FormatError(
        f"neither content nor suffix {path.suffix!r} is of a format that can {verb}; known"
        f" suffixes: {', '.join(known)}{hint}",
        path,
    )


def _find_by_name(name: str, able: list[Format], verb: str, path: Path) -> Format:
    for candidate in able:
        if candidate.name == name:
            return candidate
    raise FormatError(
        f"format {name!r} cannot {verb}; {suggest(name, [f.name for f in able])}",
        path,
        key=("format",),
    )


def _start(path: Path) -> bytes:
    """Return the first bytes of an existing file."""
    if is_folder(path):
        raise FormatError("is a folder, not a file", path)
    require_file(path)
    try:
        with path.open("rb") as file:
            start = file.read(64)
    except OSError as error:
        raise unreadable_error(path, error) from error
    if not start:
        raise FormatError("the file is empty", path)
    return start


def load(chosen: Format) -> Any:
    """Import the handler of a format: a module, or an object in a module."""
    if ":" in chosen.handler:
        return load_object(chosen.handler)
    return importlib.import_module(chosen.handler)
