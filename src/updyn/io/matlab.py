"""MATLAB ``.mat`` files of a model or of FRFs: versions 5 to 7.3 are read, version 5 is written.

Variables, or the fields of the one struct that the file holds, are named as in `updyn.io.named`::

    K, M, C, loss_factor, dofs                      one group, called "model"; full or sparse
    groups.NAME.K, .M, .C, .loss_factor, dofs       several; .name where NAME cannot be the name
    freq, H, responses, references, quantity        FRFs; H is n_f x n_responses x n_references

Labels are a cell array of texts ({'12:Z'; '13:-Z'}), a char matrix, or an N x 2 table [node
direction] with direction 1..6 for X Y Z RX RY RZ, negative for the opposite sense. MATLAB drops
trailing axes of length 1: with one reference, H is n_f x n_responses. MATLAB string arrays ("text")
are not stored in a documented way: use cellstr.
"""

from __future__ import annotations

import re
import warnings
import zlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from updyn.dofs import Dof
from updyn.errors import FormatError
from updyn.frf import FRF
from updyn.io.atomic import atomic_path
from updyn.io.items import compressed, library
from updyn.io.named import build_frf, build_model, frf_items, model_items
from updyn.model import Model

__all__ = [
    "read_frf",
    "read_model",
    "read_variables",
    "write_frf",
    "write_model",
]

_FIELD = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")


def read_model(path: str | Path) -> Model:
    """Read a model.

    Parameters
    ----------
    path : path
        The file.

    Raises
    ------
    FormatError
        If the file is damaged, or a variable is missing, unknown or not valid.
    """
    return build_model(_contents(path), path)


def read_frf(
    path: str | Path,
    *,
    quantity: str | None = None,
    duplicates: str = "raise",
    response_labels: Iterable[str | Dof] | None = None,
    reference_labels: Iterable[str | Dof] | None = None,
    order: Sequence[str] | None = None,
) -> FRF:
    """Read FRFs.

    Parameters
    ----------
    path : path
        The file.
    quantity : str, optional
        What was measured, where the file does not say; a contradiction is an error.
    duplicates : {"raise"}
        For the sake of the other formats; an array holds every response and reference once.
    response_labels, reference_labels : iterable of str or Dof, optional
        What the rows and columns are, where the file does not say; a contradiction is an error.
    order : sequence of str, optional
        What the axes of the stored array are, by default ``("freq", "response", "reference")``.

    Raises
    ------
    FormatError
        If the file is damaged, or a variable is missing, unknown or not valid.
    """
    return build_frf(
        _contents(path),
        path,
        quantity=quantity,
        duplicates=duplicates,
        response_labels=response_labels,
        reference_labels=reference_labels,
        order=order,
    )


def _contents(path: str | Path) -> Mapping[str, Any]:
    variables = read_variables(path)
    if not variables:
        raise FormatError("holds no variable", path)
    if len(variables) == 1 and "groups" not in variables:
        (only,) = variables.values()
        if isinstance(only, Mapping):
            return only
    return variables


def write_model(model: Model, path: str | Path) -> None:
    """Write a model as a version 5 file, with sparse matrices.

    Parameters
    ----------
    model : Model
        The model.
    path : path
        File to write.

    Raises
    ------
    FormatError
        If a matrix is larger than the format allows (2 GB).
    """
    items = model_items(model)
    groups: dict[str, Any] = {}
    for number, (name, parts) in enumerate(items["groups"].items(), 1):
        is_field = _FIELD.fullmatch(name) and not re.fullmatch(r"group_\d+", name)
        if is_field:
            groups[name] = parts
        else:
            groups[f"group_{number}"] = {**parts, "name": name}
    _save({**items, "groups": groups}, path)


def write_frf(frf: FRF, path: str | Path) -> None:
    """Write FRFs as a version 5 file.

    Parameters
    ----------
    frf : FRF
        The data.
    path : path
        File to write.

    Raises
    ------
    FormatError
        If an array is larger than the format allows (2 GB).
    """
    _save(frf_items(frf), path)


def _save(items: Mapping[str, Any], path: str | Path) -> None:
    from scipy.io import savemat
    from scipy.io.matlab import MatWriteError

    try:
        with atomic_path(path) as temporary:
            savemat(
                temporary,
                _storable(items),
                appendmat=False,
                do_compression=True,
                long_field_names=True,
                oned_as="column",
            )
    except MatWriteError as error:
        raise FormatError(
            f"a .mat file of version 5 cannot hold this ({error}); write HDF5 (.h5) instead", path
        ) from error


def _storable(items: Mapping[str, Any]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for name, value in items.items():
        if isinstance(value, Mapping):
            out[name] = _storable(value)
        elif isinstance(value, list):
            out[name] = np.array(value, dtype=object)[:, None]
        elif sp.issparse(value):
            out[name] = sp.csc_matrix(value)
        elif isinstance(value, np.ndarray) and value.dtype.kind == "i":
            out[name] = value.astype(np.float64)  # node numbers: MATLAB computes with doubles
        elif isinstance(value, int):
            out[name] = float(value)
        else:
            out[name] = value
    return out


_HEADER_5 = 128  # bytes
_COMPRESSED_5 = 15
_VARIABLES_5 = (14, _COMPRESSED_5)
_DEPTH = 8  # structs in structs; a file that goes deeper refers to itself
_ARRAY = "groups"  # what may be a struct array, one struct a group
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


def read_variables(path: str | Path) -> dict[str, Any]:
    """Read all variables.

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    dict
        By name: ndarray (axes as in MATLAB), sparse array, list of str, or dict for a struct.

    Raises
    ------
    FormatError
        If the file is damaged or a variable is of a class that cannot be used.
    """
    import h5py

    with library(path, "MATLAB file"):
        if not h5py.is_hdf5(path):
            with Path(path).open("rb") as file:
                if file.read(10) in (b"MATLAB 7.0", b"MATLAB 7.3"):
                    raise FormatError(
                        "MATLAB 7.3 file without a readable HDF5 part: cut short or damaged", path
                    )
            return _read_5(path)
        with h5py.File(path, "r") as file:
            variables = {}
            for name, item in file.items():
                if not name.startswith("#"):
                    variables[name] = _item_73(file, item, name, path, 0)
            return variables


# -- version 5 ----------------------------------------------------------------------------------
def _read_5(path: str | Path) -> dict[str, Any]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError, MatReadWarning

    _check_5(path)

    with warnings.catch_warnings():
        warnings.simplefilter("error", MatReadWarning)
        try:
            # A struct as an object with fields, and all axes as stored: a squeezed array no longer
            # says what it was.
            stored = loadmat(
                path,
                appendmat=False,
                squeeze_me=False,
                struct_as_record=False,
                chars_as_strings=True,
            )
        except (MatReadError, MatReadWarning) as error:
            raise FormatError(f"not a readable MATLAB file ({error})", path) from error
    variables = {}
    for name, value in stored.items():
        if not name.startswith("__"):
            variables[name] = _item_5(value, name, path)
    return variables


def _check_5(path: str | Path) -> None:
    """Check the stated lengths of the variables of a version 5 file."""
    # scipy trusts these lengths; where they are wrong, the process may crash.
    size = Path(path).stat().st_size
    with Path(path).open("rb") as file:
        header = file.read(_HEADER_5)
        if len(header) < _HEADER_5 or header[126:128] not in (b"IM", b"MI"):
            raise FormatError("not a MATLAB file of version 5: no complete header", path)
        order: Literal["little", "big"] = "little" if header[126:128] == b"IM" else "big"
        at = _HEADER_5
        number = 0
        while at < size:
            number += 1
            tag = file.read(8)
            kind = int.from_bytes(tag[:4], order)
            length = int.from_bytes(tag[4:], order)
            if len(tag) < 8 or kind not in _VARIABLES_5 or at + 8 + length > size:
                raise FormatError(
                    f"cut short or damaged in variable {number}, at byte {at} of {size}", path
                )
            if kind == _COMPRESSED_5:
                zlib.decompress(file.read(length))  # its checksum covers all of the variable
            at = file.seek(at + 8 + length)


def _item_5(value: Any, name: str, path: str | Path) -> Any:
    from scipy.io.matlab import MatlabFunction, MatlabOpaque, mat_struct

    if sp.issparse(value):
        csc = sp.csc_array(value)
        return compressed(sp.csc_array, csc.data, csc.indices, csc.indptr, csc.shape, name, path)
    if isinstance(value, MatlabFunction | MatlabOpaque) or not isinstance(value, np.ndarray):
        raise FormatError(f"{name}: {_unusable('object')}", path)
    if value.dtype.kind == "U":
        return _rows(value.ravel().tolist())
    if value.dtype != object:
        return value
    cells = _vector(value, name, path)
    if not cells or not all(isinstance(cell, mat_struct) for cell in cells):
        return [_cell(_item_5(cell, name, path), name, i, path) for i, cell in enumerate(cells)]
    if len(cells) == 1:
        return _struct_5(cells[0], name, path)
    if name.rpartition(".")[2] != _ARRAY:
        raise FormatError(f"{name}: struct array of shape {value.shape}; expected one struct", path)
    return [_struct_5(cell, f"{name}({i})", path) for i, cell in enumerate(cells, 1)]


def _struct_5(struct: Any, name: str, path: str | Path) -> dict[str, Any]:
    fields = {}
    for key in struct._fieldnames:
        fields[key] = _item_5(getattr(struct, key), f"{name}.{key}", path)
    return fields


# -- version 7.3 --------------------------------------------------------------------------------
def _item_73(file: Any, item: Any, name: str, path: str | Path, depth: int) -> Any:
    import h5py

    if depth > _DEPTH:
        raise FormatError(f"{name}: structs nested more than {_DEPTH} deep", path)
    kind = item.attrs.get("MATLAB_class", b"")
    if isinstance(kind, bytes):
        kind = kind.decode("ascii", "replace")
    if not kind:
        raise FormatError(
            f"{name}: no attribute MATLAB_class, so that its order of axes is not known; was it"
            " written by MATLAB?",
            path,
        )
    if isinstance(item, h5py.Group):
        if "MATLAB_sparse" in item.attrs:
            return _sparse_73(item, name, path)
        if kind != "struct":
            raise FormatError(f"{name}: {_unusable(kind)}", path)
        if name.rpartition(".")[2] == _ARRAY and _is_array_73(item):
            return _array_73(file, item, name, path, depth)
        fields = {}
        for key in _fields(item):
            fields[key] = _item_73(file, item[key], f"{name}.{key}", path, depth + 1)
        return fields
    if item.attrs.get("MATLAB_empty"):
        if kind in ("char", "cell"):
            return []
        return np.empty(tuple(map(int, item[()])))  # an empty array is stored as its size
    values = item[()]
    if kind == "char":
        rows = np.atleast_2d(np.asarray(values, dtype="<u2").T)
        return _rows([row.tobytes().decode("utf-16-le") for row in rows])
    if kind == "cell":
        texts = []
        for i, reference in enumerate(_vector(np.asarray(values), name, path)):
            cell = _item_73(file, file[reference], name, path, depth + 1)
            texts.append(_cell(cell, name, i, path))
        return texts
    if kind not in _NUMBERS:
        raise FormatError(f"{name}: {_unusable(kind)}", path)
    return _complex(np.asarray(values)).T


def _is_array_73(item: Any) -> bool:
    """Return whether a struct is an array of them."""
    # Each field is then one reference an element, of no class.
    for field in item.values():
        is_reference = getattr(field, "dtype", np.dtype("i1")).kind == "O"
        if "MATLAB_class" in field.attrs or not is_reference:
            return False
    return len(item) > 0


def _array_73(file: Any, item: Any, name: str, path: str | Path, depth: int) -> list[Any]:
    """Return a struct array as one dict an element."""
    elements: list[dict[str, Any]] = []
    for key in _fields(item):
        references = _vector(np.asarray(item[key][()]), name, path)
        if not elements:
            elements = [{} for _ in references]
        for i, (element, reference) in enumerate(zip(elements, references, strict=True), 1):
            where = f"{name}({i}).{key}"
            element[key] = _item_73(file, file[reference], where, path, depth + 1)
    return elements


def _fields(struct: Any) -> list[str]:
    """Return the names of the fields in MATLAB's order, which HDF5 itself does not keep."""
    names = list(struct)
    told = struct.attrs.get("MATLAB_fields")
    if told is None:
        return names
    ordered = ["".join(letter.decode("ascii") for letter in field) for field in told]
    return ordered if sorted(ordered) == sorted(names) else names


def _sparse_73(item: Any, name: str, path: str | Path) -> Any:
    rows = int(item.attrs["MATLAB_sparse"])
    indptr = np.asarray(item["jc"][()])
    # A matrix without entries has no data and ir.
    data = np.empty(0)
    indices = np.empty(0, dtype=np.int64)
    if "data" in item:
        data = _complex(np.asarray(item["data"][()]))
    if "ir" in item:
        indices = np.asarray(item["ir"][()])
    return compressed(sp.csc_array, data, indices, indptr, (rows, len(indptr) - 1), name, path)


def _complex(values: NDArray[Any]) -> NDArray[Any]:
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


def _vector(cells: NDArray[Any], name: str, path: str | Path) -> list[Any]:
    if cells.size not in (0, max(cells.shape, default=1)):
        raise FormatError(
            f"{name}: cell or struct array of shape {cells.shape}; expected one row or column", path
        )
    return list(cells.ravel())


def _cell(value: Any, name: str, at: int, path: str | Path) -> str:
    if isinstance(value, list) and len(value) <= 1:
        return str(value[0]) if value else ""
    raise FormatError(f"{name}: cell {at + 1} is not a text; expected a cell array of texts", path)


def _unusable(kind: str) -> str:
    hint = ""
    if kind in ("string", "object"):
        hint = " (a MATLAB string array? save cellstr(...) or char(...) of it)"
    return (
        f"MATLAB class {kind!r} cannot be used{hint}; expected numbers, char, a cell array of char,"
        " or a struct"
    )
