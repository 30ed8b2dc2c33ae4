"""NumPy ``.npz`` archives of a model or of FRFs. Pickled objects are never read.

A model with one group: ``K``, ``M``, ``C`` (N, N), ``loss_factor``, ``dofs`` (N labels); the group
is named "model". ``mass_damping``, ``stiffness_damping`` and ``loss_table`` are optional, see
`updyn.io.named`.

A model with several groups, where ``NAME`` is the name of a group (without dots)::

    dofs                          N labels
    groups                        names, in order (optional: by default the order of the file)
    NAME.K, NAME.M, NAME.C        dense (N, N), or sparse in CSR form, the whole matrix:
    NAME.K.data, NAME.K.indices, NAME.K.indptr
    NAME.loss_factor

FRFs: ``freq``, ``H`` (or ``values``), ``responses``, ``references``, ``quantity``, and so on. For
the other names of both see `updyn.io.named`. `write_model` writes sparse groups. A ``System`` of
SDynPy is identified by its names, see `updyn.io.sdynpy`.
"""

from __future__ import annotations

import math
import tokenize
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
import scipy.sparse as sp

from updyn.arrays import NumberArray
from updyn.dofs import Dof
from updyn.errors import FormatError
from updyn.foreign.limits import limits_of
from updyn.foreign.plain import to_native
from updyn.frf import FRF
from updyn.io.atomic import atomic_path
from updyn.io.frf_variables import VariableSource, select_items
from updyn.io.items import build_sparse, describe_kind, format_names, report_library_errors
from updyn.io.named import build_frf, build_model, frf_items, model_items
from updyn.io.sdynpy import is_system, system_model
from updyn.io.variables_proposal import proposing_variables
from updyn.model import Model

__all__ = ["read_arrays", "read_frf", "read_model", "read_source", "write_frf", "write_model"]

_CSR = ("data", "indices", "indptr")
_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def read_model(path: str | Path) -> Model:
    """Read a model from an archive."""
    arrays = read_arrays(path)
    if {"format", "shape", *_CSR} <= set(arrays):
        raise FormatError(
            "holds one sparse matrix written by scipy.sparse.save_npz; a model needs K, M and dofs"
            " in one archive, see updyn.io.npz",
            path,
        )
    if is_system(arrays):
        return system_model(arrays, path)
    return build_model(_nest_items(arrays, path), path)


def write_model(model: Model, path: str | Path) -> None:
    """Write a model with sparse matrices, without loss of digits."""
    items = model_items(model)
    groups = items.pop("groups")
    flat: dict[str, Any] = {**items, "groups": list(groups)}
    for name, parts in groups.items():
        for key, value in parts.items():
            if sp.issparse(value):
                for part in _CSR:
                    flat[f"{name}.{key}.{part}"] = getattr(value, part)
            else:
                flat[f"{name}.{key}"] = value
    _save(flat, path)


def read_frf(
    path: str | Path,
    *,
    quantity: str | None = None,
    duplicates: str = "raise",
    response_labels: Iterable[str | Dof] | None = None,
    reference_labels: Iterable[str | Dof] | None = None,
    order: Sequence[str] | None = None,
    real_valued: bool = False,
    variables: Mapping[str, object] | None = None,
) -> FRF:
    """Read FRFs from an archive; options declare items that it does not state or names otherwise.

    Real numbers are refused unless `real_valued`, because they may be magnitudes or decibels.
    """
    arrays = read_arrays(path)
    if variables is None:
        items = _nest_items(arrays, path)
    else:
        items = select_items(VariableSource(arrays, path), variables, order)
    with proposing_variables({} if variables else arrays):
        return build_frf(
            items,
            path,
            quantity=quantity,
            duplicates=duplicates,
            response_labels=response_labels,
            reference_labels=reference_labels,
            order=order,
            real_valued=real_valued,
        )


def read_source(path: str | Path) -> VariableSource:
    """Return the arrays of an archive."""
    return VariableSource(read_arrays(path), path)


def write_frf(frf: FRF, path: str | Path) -> None:
    """Write FRFs."""
    _save(frf_items(frf), path)


def _save(items: dict[str, object], path: str | Path) -> None:
    arrays = {name: np.asarray(value) for name, value in items.items()}
    # An open file, because numpy appends a suffix to a name without one.
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def read_arrays(path: str | Path) -> dict[str, NumberArray]:
    """Read all arrays of an archive by name; sizes are checked before anything is unpacked."""
    with Path(path).open("rb") as file:
        start = file.read(8)
    if start.startswith(b"\x93NUMPY"):
        raise FormatError(
            "holds one array (.npy); expected an archive of named arrays, see numpy.savez", path
        )
    if not start.startswith(b"PK"):
        raise FormatError(f"not an .npz archive: it starts with {start!r}, expected b'PK'", path)
    out: dict[str, NumberArray] = {}
    with report_library_errors(path, ".npz archive"), zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        limits_of(path).check(sum(member.file_size for member in members))
        for member in members:
            name = member.filename.removesuffix(".npy")
            if name in out:
                raise FormatError(f"holds {name!r} twice", path)
            if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise FormatError(f"{name}: compressed by a method that numpy does not use", path)
            with archive.open(member) as stream:
                out[name] = _array(stream, name, path)
    return out


def _array(stream: IO[bytes], name: str, path: str | Path) -> NumberArray:
    """Return the array of one member, with exactly the number of bytes stated in its header."""
    try:
        version = np.lib.format.read_magic(stream)
        if version not in _HEADERS:
            raise FormatError(f"{name}: version {version} of .npy; expected 1.0 or 2.0", path)
        shape, in_columns, dtype = _HEADERS[version](stream)
    except (ValueError, tokenize.TokenError) as error:
        raise FormatError(f"holds {name!r}, which is not an array ({error})", path) from error
    if dtype.hasobject:
        raise FormatError(
            f"{name}: holds Python objects (pickled), which are never read; store numbers,"
            " or texts as an array of text",
            path,
        )
    content = bytearray(stream.read())
    if dtype.itemsize == 0 or len(content) != math.prod(shape) * dtype.itemsize:
        raise FormatError(
            f"{name}: declares {dtype} of shape {shape}, but {len(content)} bytes follow", path
        )
    flat = np.frombuffer(content, dtype)
    return to_native(flat.reshape(shape, order="F" if in_columns else "C"))


def _nest_items(arrays: dict[str, NumberArray], path: str | Path) -> dict[str, object]:
    """Return the arrays with texts as lists, and ``NAME.K.data`` as sparse matrices of groups."""
    top: dict[str, object] = {}
    groups: dict[str, dict[str, object]] = {}
    for name, array in arrays.items():
        group, dot, part = name.partition(".")
        if dot:
            groups.setdefault(group, {})[part] = _to_plain(array, name, path)
        else:
            top[name] = _to_plain(array, name, path)
    if not groups and "groups" not in top:
        return top
    names = top.pop("groups", list(groups))
    if not isinstance(names, list):
        raise FormatError(
            f"groups: found {describe_kind(names)}; expected an array of group names", path
        )
    for name in names:
        if names.count(name) > 1:
            raise FormatError(f"groups: {name!r} occurs twice", path)
    for unpaired in sorted(set(names) ^ set(groups)):
        state = f"lacks {unpaired!r}"
        if unpaired in names:
            state = f"contains {unpaired!r}, which has no array"
        raise FormatError(f"groups: {state}; found: {format_names(groups)}", path)
    return {**top, "groups": {name: _join_sparse(groups[name], name, path) for name in names}}


def _join_sparse(parts: dict[str, Any], name: str, path: str | Path) -> dict[str, Any]:
    out: dict[str, Any] = {}
    triples: dict[str, dict[str, Any]] = {}
    for key, value in parts.items():
        matrix, dot, part = key.partition(".")
        if dot and part in _CSR:
            triples.setdefault(matrix, {})[part] = value
        else:
            out[key] = value
    for key, triple in triples.items():
        where = f"{name}.{key}"
        lacking = [part for part in _CSR if part not in triple]
        if lacking or key in out:
            fault = (
                f"no '{where}.{lacking[0]}'" if lacking else f"'{where}' is both dense and sparse"
            )
            raise FormatError(
                f"{fault}; a sparse matrix is stored as .data, .indices and .indptr", path
            )
        size = int(np.size(triple["indptr"])) - 1
        out[key] = build_sparse(sp.csr_array, **triple, shape=(size, size), where=where, path=path)
    return out


def _to_plain(array: NumberArray, name: str, path: str | Path) -> object:
    if array.dtype.kind not in "US":
        return array
    if array.ndim > 1:
        raise FormatError(f"{name}: found texts of shape {array.shape}; expected one row", path)
    if array.dtype.kind == "S":
        array = np.char.decode(array, "ascii", "backslashreplace")
    return str(array) if array.ndim == 0 else list(map(str, array))
