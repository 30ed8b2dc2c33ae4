"""MATLAB files as plain data: versions 4 to 7.2 by scipy, 7.3 by h5py.

Arrays have the axes of MATLAB; cells of texts are lists, structs are mappings. Items of an unusable
class become `updyn.foreign.plain.Unread`, because they may not be needed.
"""

from __future__ import annotations

import io
import warnings
import zlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, Literal

import h5py
import numpy as np
import scipy.sparse as sp
from scipy.io import loadmat
from scipy.io.matlab import (
    MatlabFunction,
    MatlabObject,
    MatlabOpaque,
    MatReadError,
    MatReadWarning,
    mat_struct,
)

from updyn.arrays import NumberArray
from updyn.errors import FormatError
from updyn.foreign.hdf5 import HDF5Content
from updyn.foreign.limits import ReadLimits, limits_of
from updyn.foreign.plain import Sparse, Unread, to_native
from updyn.foreign.settings import READING

__all__ = ["load"]

_HEADER_4 = 20  # bytes
_TYPES_4 = 1000  # types below are those of a little-endian file
_BYTES_4 = (8, 4, 4, 2, 2, 1)  # by the tens of the type
_CONTENT_4 = (0, 1, 2)  # full, text, sparse
_HEADER_5 = 128  # bytes
_COMPRESSED_5 = 15
_VARIABLES_5 = (14, _COMPRESSED_5)
#: Fields that may be struct arrays: one struct per group, or per dimension of a unit
#: (`updyn.io.testlab_mat`).
_ARRAYS = ("groups", "quantity_terms")
#: Frequency responses of the Control System and the System Identification Toolbox.
_FRD = ("frd", "idfrd")
_NUMBERS = (
    "double",
    "single",
    "logical",
    "int8",
    "uint8",
    "int16",
    "uint16",
    "int32",
    "uint32",
    "int64",
    "uint64",
)


def load(path: str) -> dict[str, object]:
    """Load all variables by name."""
    if h5py.is_hdf5(path):
        with h5py.File(path, "r") as file:
            return _File73(file, path).variables()
    with Path(path).open("rb") as raw:
        start = raw.read(_HEADER_5)
    if start.startswith((b"MATLAB 7.0", b"MATLAB 7.3")):
        raise FormatError(
            "MATLAB 7.3 file without a readable HDF5 part: truncated or damaged", path
        )
    if 0 in start[:4]:  # the initial text of version 5 has no zero byte
        return _variables(_elements_4(path), path)
    if start[126:128] in (b"IM", b"MI"):
        return _variables(_elements_5(path), path)
    raise FormatError(
        f"not a MATLAB file: it starts with {start[:16]!r}; expected the header of version 5"
        " ('MATLAB 5.0 MAT-file', 128 bytes), HDF5 (version 7.3), or a variable of version 4",
        path,
    )


class _UnusableError(FormatError):
    """A variable of a class or a shape that cannot be used."""


def _read_or_mark(read: Callable[..., object], *given: object) -> object:
    """Return the result of a function, or `Unread` with the reason if the variable is unusable."""
    try:
        return read(*given)
    except _UnusableError as error:
        return Unread(str(error).removeprefix(f"{error.path}: "))


# -- versions 4 and 5 ---------------------------------------------------------------------------
def _variables(elements: Iterable[bytes], path: str) -> dict[str, object]:
    variables: dict[str, object] = {}
    for element in elements:
        for name, value in _stored_5(element, path).items():
            if name.startswith("__"):
                continue
            variable_name = name
            if isinstance(value, MatlabOpaque) and value.size == 1:
                variable_name = _object_fields(value).get("s0") or name
            if variable_name in variables:
                raise FormatError(f"variable {variable_name!r} occurs twice", path)
            variables[variable_name] = _read_or_mark(_item_5, value, variable_name, path)
    return variables


def _stored_5(element: bytes, path: str) -> dict[str, Any]:
    """Return the content of a file of one variable, read by scipy."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", MatReadWarning)
        try:
            # Structs as objects with fields, and all axes as stored, because a squeezed array loses
            # information.
            stored: dict[str, Any] = loadmat(
                io.BytesIO(element),
                appendmat=False,
                squeeze_me=False,
                struct_as_record=False,
                chars_as_strings=True,
                spmatrix=False,
            )
        except (MatReadError, MatReadWarning) as error:
            raise FormatError(f"not a readable MATLAB file ({error})", path) from error
    return stored


def _elements_4(path: str) -> Iterator[bytes]:
    """Yield each variable of a version 4 file as a separate file, its length checked."""
    # A variable is five integers (type, rows, columns, complex or not, length of its name), the
    # name, and the numbers (MathWorks, MAT-File Format, chapter 2).
    limits = limits_of(path)
    with Path(path).open("rb") as file:
        at = 0
        number = 1
        while at < limits.size:
            fault = f"truncated or damaged in variable {number}, at byte {at} of {limits.size}"
            head = file.read(_HEADER_4)
            if len(head) < _HEADER_4:
                raise FormatError(fault, path)
            # The thousands are the byte order, 0 or 1; the type of a big-endian file is never 0.
            is_little = int.from_bytes(head[:4], "little") < _TYPES_4
            kind, *sizes = np.frombuffer(head, "<i4" if is_little else ">i4").tolist()
            order, stored, content = kind // 1000, kind // 10 % 100, kind % 10
            if order != (not is_little) or stored >= len(_BYTES_4) or content not in _CONTENT_4:
                raise FormatError(
                    f"variable {number}: type {kind}; expected a full or sparse matrix or a text of"
                    " version 4, in IEEE numbers",
                    path,
                )
            rows, columns, is_complex, named = sizes
            length = named + rows * columns * (1 + is_complex) * _BYTES_4[stored]
            if min(rows, columns) < 0 or is_complex not in (0, 1) or named < 1:
                raise FormatError(fault, path)
            if at + _HEADER_4 + length > limits.size:
                raise FormatError(fault, path)
            yield head + file.read(length)
            at += _HEADER_4 + length
            number += 1


def _elements_5(path: str) -> Iterator[bytes]:
    """Yield each variable as a separate file, with its lengths, checksums and size checked."""
    places = _check_5(path)
    with Path(path).open("rb") as file:
        header = file.read(_HEADER_5)
        for at, length in places:
            file.seek(at)
            yield header + file.read(length)


def _check_5(path: str) -> list[tuple[int, int]]:
    """Check the stated lengths of the variables; return the start and length of each."""
    # scipy does not check these lengths, and wrong ones may crash the process.
    limits = limits_of(path)
    size = limits.size
    unpacked = 0
    with Path(path).open("rb") as file:
        header = file.read(_HEADER_5)
        order: Literal["little", "big"] = "little" if header[126:128] == b"IM" else "big"
        at = _HEADER_5
        places: list[tuple[int, int]] = []
        while at < size:
            tag = file.read(8)
            kind = int.from_bytes(tag[:4], order)
            length = int.from_bytes(tag[4:], order)
            if len(tag) < 8 or kind not in _VARIABLES_5 or at + 8 + length > size:
                raise FormatError(
                    f"truncated or damaged in variable {len(places) + 1}, at byte {at} of {size}",
                    path,
                )
            if kind == _COMPRESSED_5:
                unpacked = _check_compressed(file, length, limits, unpacked)
            places.append((at, 8 + length))
            at = file.seek(at + 8 + length)
    return places


def _check_compressed(file: BinaryIO, length: int, limits: ReadLimits, unpacked: int) -> int:
    """Unpack a variable, with its checksum; return the unpacked size so far."""
    stream = zlib.decompressobj()
    packed = file.read(length)
    while not stream.eof:
        block = stream.decompress(packed, READING.block_bytes)
        packed = stream.unconsumed_tail
        unpacked += len(block)
        limits.check(unpacked)
        if not block and not packed and not stream.eof:
            raise FormatError("a compressed variable is truncated", limits.path)
    return unpacked


def _item_5(value: Any, name: str, path: str) -> object:
    if sp.issparse(value):
        csc = sp.csc_array(value)
        if csc.nnz != value.nnz:
            raise FormatError(f"{name}: an entry occurs twice", path)
        return Sparse(csc.shape, to_native(csc.data), csc.indices, csc.indptr)
    if isinstance(value, MatlabOpaque) and value.size == 1:
        fields = _object_fields(value)
        kind = fields.get("_Class") or fields.get("s2") or "object"
        raise _UnusableError(f"{name}: {_unusable(kind)}", path)
    if isinstance(value, MatlabObject) and value.classname in _FRD:
        raise _UnusableError(f"{name}: {_unusable(value.classname)}", path)
    if isinstance(value, MatlabFunction | MatlabOpaque) or not isinstance(value, np.ndarray):
        raise _UnusableError(f"{name}: {_unusable('object')}", path)
    if value.dtype.kind == "U":
        return _rows(value.ravel().tolist())
    if value.dtype != object:
        return to_native(value)
    cells = _vector(value, name, path)
    if not cells or not all(isinstance(cell, mat_struct) for cell in cells):
        return [_cell(_item_5(cell, name, path), name, i, path) for i, cell in enumerate(cells)]
    if len(cells) == 1:
        return _struct_5(cells[0], name, path)
    if name.rpartition(".")[2] not in _ARRAYS:
        raise _UnusableError(
            f"{name}: struct array of shape {value.shape}; expected one struct", path
        )
    return [_struct_5(cell, f"{name}({i})", path) for i, cell in enumerate(cells, 1)]


def _object_fields(value: MatlabOpaque) -> dict[str, str]:
    # scipy 1.18 has ``_Class``. Earlier versions have ``s2`` instead, and the name of the variable
    # in ``s0``; they name every such variable "None".
    fields = zip(value.dtype.names, value[0], strict=True)
    return {name: _text(item) for name, item in fields if isinstance(item, bytes | str)}


def _struct_5(struct: mat_struct, name: str, path: str) -> dict[str, object]:
    fields = {}
    for key in struct._fieldnames:
        fields[key] = _read_or_mark(_item_5, getattr(struct, key), f"{name}.{key}", path)
    return fields


# -- version 7.3 --------------------------------------------------------------------------------
class _File73:
    """An open file of version 7.3."""

    def __init__(self, file: h5py.File, path: str) -> None:
        self._file = file
        self._path = path
        self._content = HDF5Content(path, False)

    def variables(self) -> dict[str, object]:
        found = {}
        for name, item in self._content.members(self._file).items():
            if not name.startswith("#"):
                found[name] = _read_or_mark(self._item, item, name, 0)
        return found

    def _item(self, item: h5py.HLObject, name: str, depth: int) -> object:
        path = self._path
        if depth > READING.struct_depth:
            raise FormatError(f"{name}: structs nested more than {READING.struct_depth} deep", path)
        kind = item.attrs.get("MATLAB_class", b"")
        if isinstance(kind, bytes):
            kind = kind.decode("ascii", "replace")
        if not kind:
            raise _UnusableError(
                f"{name}: no attribute MATLAB_class, so the order of its axes is unknown; was it"
                " written by MATLAB?",
                path,
            )
        if isinstance(item, h5py.Group):
            return self._struct(item, str(kind), name, depth)
        values = self._values(item)
        if item.attrs.get("MATLAB_empty"):
            if kind in ("char", "cell"):
                return []
            shape = tuple(map(int, values.ravel()))
            if 0 not in shape:
                raise FormatError(f"{name}: is empty, but has shape {shape}", path)
            return np.empty(shape)  # an empty array is stored as its size
        if kind == "char":
            rows = np.atleast_2d(np.asarray(values, dtype="<u2").T)
            return _rows([row.tobytes().decode("utf-16-le") for row in rows])
        if kind == "cell":
            texts = []
            for i, reference in enumerate(_vector(values, name, path)):
                cell = self._item(self._file[reference], name, depth + 1)
                texts.append(_cell(cell, name, i, path))
            return texts
        if kind not in _NUMBERS:
            raise _UnusableError(f"{name}: {_unusable(str(kind))}", path)
        return _complex(values).T

    def _struct(self, item: h5py.Group, kind: str, name: str, depth: int) -> object:
        members = self._content.members(item)
        if "MATLAB_sparse" in item.attrs:
            return self._sparse(item, members)
        if kind != "struct":
            raise _UnusableError(f"{name}: {_unusable(kind)}", self._path)
        if name.rpartition(".")[2] in _ARRAYS and _is_array(members):
            return self._structs(item, members, name, depth)
        fields = {}
        for key in _fields(item):
            fields[key] = _read_or_mark(self._item, members[key], f"{name}.{key}", depth + 1)
        return fields

    def _structs(
        self, item: h5py.Group, members: dict[str, h5py.Dataset], name: str, depth: int
    ) -> list[dict[str, object]]:
        elements: list[dict[str, object]] = []
        for key in _fields(item):
            references = _vector(self._values(members[key]), name, self._path)
            if not elements:
                elements = [{} for _ in references]
            for i, (element, reference) in enumerate(zip(elements, references, strict=True), 1):
                where = f"{name}({i}).{key}"
                element[key] = self._item(self._file[reference], where, depth + 1)
        return elements

    def _sparse(self, item: h5py.Group, members: dict[str, h5py.Dataset]) -> Sparse:
        rows = int(item.attrs["MATLAB_sparse"])
        indptr = self._values(members["jc"])
        # A matrix without entries has no datasets data and ir.
        data = np.empty(0)
        indices = np.empty(0, dtype=np.int64)
        if "data" in members:
            data = _complex(self._values(members["data"]))
        if "ir" in members:
            indices = self._values(members["ir"])
        return Sparse((rows, len(indptr) - 1), data, indices, indptr)

    def _values(self, dataset: h5py.Dataset) -> NumberArray:
        self._content.check(dataset)
        return to_native(np.asarray(dataset[()]))


def _is_array(members: dict[str, h5py.Dataset]) -> bool:
    # Each field then contains one reference per element, without a class.
    for field in members.values():
        is_reference = getattr(field, "dtype", np.dtype("i1")).kind == "O"
        if "MATLAB_class" in field.attrs or not is_reference:
            return False
    return len(members) > 0


def _fields(struct: h5py.Group) -> list[str]:
    """Return the names of the fields in MATLAB's order, which HDF5 does not keep."""
    names = list(struct)
    stated = struct.attrs.get("MATLAB_fields")
    if stated is None:
        return names
    ordered = ["".join(letter.decode("ascii") for letter in field) for field in stated]
    return ordered if sorted(ordered) == sorted(names) else names


def _complex(values: NumberArray) -> NumberArray:
    if values.dtype.names != ("real", "imag"):
        return values
    out = np.empty(values.shape, dtype=np.complex128)
    out.real = values["real"]
    out.imag = values["imag"]
    return out


# -- both ---------------------------------------------------------------------------------------
def _rows(texts: list[str]) -> list[str]:
    """Return the rows of a char matrix, which MATLAB pads with blanks to one length."""
    if len(texts) <= 1:
        return texts
    return [text.rstrip(" \0") for text in texts]


def _vector(cells: NumberArray, name: str, path: str) -> list[object]:
    if cells.size not in (0, max(cells.shape, default=1)):
        raise _UnusableError(
            f"{name}: cell or struct array of shape {cells.shape}; expected one row or column", path
        )
    return list(cells.ravel())


def _cell(value: object, name: str, at: int, path: str) -> str:
    if isinstance(value, list) and len(value) <= 1:
        return str(value[0]) if value else ""
    raise _UnusableError(
        f"{name}: cell {at + 1} is not a text; expected a cell array of texts", path
    )


def _text(given: object) -> str:
    return given.decode("latin-1") if isinstance(given, bytes) else str(given)


def _unusable(kind: str) -> str:
    if kind in _FRD:
        return (
            f"MATLAB class {kind!r}: an object of a toolbox cannot be read; save its numbers"
            " instead: G = chgFreqUnit(G, 'Hz'); freq = G.Frequency; H = permute(G.ResponseData,"
            " [3 1 2]); with responses, references and quantity, see docs/formats.md"
        )
    hint = ""
    if kind in ("string", "object"):
        hint = " (a MATLAB string array? save cellstr(...) or char(...) of it)"
    return (
        f"MATLAB class {kind!r} cannot be used{hint}; expected numbers, char, a cell array of char,"
        " or a struct"
    )
