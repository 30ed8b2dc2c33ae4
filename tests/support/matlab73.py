"""Writes ``.mat`` files of version 7.3 as MATLAB lays them out, for the tests of the reader.

Written from the documented layout: a user block of 512 bytes with the text header, axes reversed,
complex numbers as a compound of real and imag, sparse matrices as a group of data, ir, jc, char as
uint16, cells as references into #refs#."""

from pathlib import Path

import h5py
import numpy as np
import scipy.sparse as sp

_HEADER = (
    b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Mon Jan  1 00:00:00 2024 HDF5 schema"
    b" 1.00 ."
)


def write_matlab73(path: Path, variables: dict) -> None:
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            _put(file, file, name, value)
    with path.open("r+b") as file:
        file.write(_HEADER.ljust(116) + bytes(8) + b"\x00\x02IM")


def _put(file: h5py.File, parent: h5py.Group, name: str, value: object) -> None:
    if isinstance(value, dict):
        group = parent.create_group(name)
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        fields = np.empty(len(value), dtype=object)
        fields[:] = [np.array(list(key), dtype="S1") for key in value]
        group.attrs.create("MATLAB_fields", fields, dtype=h5py.vlen_dtype(np.dtype("S1")))
        for key, item in value.items():
            _put(file, group, key, item)
    elif isinstance(value, list) and isinstance(
        value[0], dict
    ):  # a struct array: a reference a field and element
        references = file.require_group("#refs#")
        group = parent.create_group(name)
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for key in value[0]:
            cells = []
            for item in value:
                cell = f"c{len(references)}"
                _put(file, references, cell, item[key])
                cells.append(references[cell].ref)
            group.create_dataset(key, data=np.array([cells], dtype=h5py.ref_dtype))
    elif sp.issparse(value):
        csc = sp.csc_array(value)
        group = parent.create_group(name)
        group.attrs["MATLAB_class"] = np.bytes_("double")
        group.attrs["MATLAB_sparse"] = np.uint64(csc.shape[0])
        group["jc"] = csc.indptr.astype(np.uint64)
        if csc.nnz:
            group["ir"] = csc.indices.astype(np.uint64)
            group["data"] = csc.data
    elif isinstance(value, str):
        _char(parent, name, value)
    elif isinstance(value, list) and isinstance(value[0], str):
        references = file.require_group("#refs#")
        cells = []
        for text in value:
            cell = f"c{len(references)}"
            _char(references, cell, text)
            cells.append(references[cell].ref)
        stored = parent.create_dataset(name, data=np.array([cells], dtype=h5py.ref_dtype))
        stored.attrs["MATLAB_class"] = np.bytes_("cell")
    else:
        array = np.asarray(value)
        array = (
            array.reshape(1, 1) if array.ndim == 0 else array[:, None] if array.ndim == 1 else array
        )
        while array.ndim > 2 and array.shape[-1] == 1:  # MATLAB has no trailing axis of length 1
            array = array[..., 0]
        if np.iscomplexobj(array):
            pair = np.empty(array.shape, dtype=[("real", "<f8"), ("imag", "<f8")])
            pair["real"], pair["imag"] = array.real, array.imag
            array = pair
        stored = parent.create_dataset(name, data=np.ascontiguousarray(array.T))
        stored.attrs["MATLAB_class"] = np.bytes_("double")


def _char(parent: h5py.Group, name: str, text: str) -> None:
    if not text:
        stored = parent.create_dataset(name, data=np.zeros(2, dtype=np.uint64))
        stored.attrs["MATLAB_empty"] = np.uint8(1)
    else:
        stored = parent.create_dataset(
            name, data=np.frombuffer(text.encode("utf-16-le"), dtype="<u2")[:, None]
        )
    stored.attrs["MATLAB_class"] = np.bytes_("char")
    stored.attrs["MATLAB_int_decode"] = np.int32(2)
