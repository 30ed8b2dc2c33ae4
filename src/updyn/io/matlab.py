"""MATLAB ``.mat`` files: versions 4 to 7.3 are read, version 5 is written.

Variables, or the fields of a single struct, are named as in `updyn.io.named`. Labels may be a cell
array of texts, a char matrix, or an N x 2 table. MATLAB drops trailing axes of length 1: with one
reference, H is n_f x n_responses. The storage of MATLAB string arrays is not documented.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from updyn.dofs import Dof
from updyn.errors import FormatError, UpdynWarning
from updyn.foreign import box
from updyn.foreign.plain import Sparse, Unread
from updyn.frf import FRF
from updyn.io.atomic import atomic_path
from updyn.io.frf_variables import VariableSource, select_items
from updyn.io.items import build_sparse
from updyn.io.model_variables import stated_items
from updyn.io.named import (
    FRF_ITEMS,
    MODEL_ITEMS,
    build_frf,
    build_model,
    frf_items,
    model_items,
)
from updyn.io.pulse_mat import build_pulse_records, is_pulse
from updyn.io.record_arrays import build_records, refuse_without_values
from updyn.io.testlab_mat import (
    Functions,
    is_export,
    read_export,
    read_exported_coherence,
    refuse_export,
)
from updyn.io.variables_proposal import proposing_variables
from updyn.model import Model
from updyn.signals.records import Records

__all__ = [
    "read_coherence",
    "read_frf",
    "read_model",
    "read_records",
    "read_source",
    "read_variables",
    "write_frf",
    "write_model",
]

_FIELD = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")
_READER = "scipy, or libhdf5 for version 7.3"


def read_model(path: str | Path, *, variables: Mapping[str, object] | None = None) -> Model:
    """Read a model; `variables` maps items to variables or fields (`updyn.io.model_variables`)."""
    stored = _variables(path)
    if variables is not None:
        return build_model(stated_items(_unwrap_struct(stored, path), variables, path), path)
    refuse_export(stored, path, "model")
    with _iterate_usable(stored, path, MODEL_ITEMS) as found:
        return build_model(found, path)


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
    """Read FRFs; options declare items that the file does not state, or has by other names.

    Real numbers are refused unless `real_valued`, because they may be magnitudes or decibels.
    The export of Simcenter Testlab is recognised by its structs (`updyn.io.testlab_mat`).
    """
    stored = _variables(path)
    if variables is not None:
        source = VariableSource({**_unwrap_struct(stored, path), **stored}, path)
        return build_frf(
            select_items(source, variables, order),
            path,
            quantity=quantity,
            duplicates=duplicates,
            response_labels=response_labels,
            reference_labels=reference_labels,
            order=order,
            real_valued=real_valued,
        )
    if is_export(stored):
        return read_export(
            stored,
            path,
            quantity=quantity,
            duplicates=duplicates,
            response_labels=response_labels,
            reference_labels=reference_labels,
            order=order,
            real_valued=real_valued,
        )
    with proposing_variables(stored), _iterate_usable(stored, path, FRF_ITEMS) as found:
        return build_frf(
            found,
            path,
            quantity=quantity,
            duplicates=duplicates,
            response_labels=response_labels,
            reference_labels=reference_labels,
            order=order,
            real_valued=real_valued,
        )


def read_records(
    path: str | Path,
    *,
    values: str | Sequence[str] | Mapping[str, str] | None = None,
    channels: Sequence[str] | None = None,
    order: Sequence[str] | None = None,
    time: str | None = None,
    rate: float | str | None = None,
) -> Records:
    """Read time records from variables or fields of structs (`updyn.io.record_arrays`).

    Without `values` these are the records of an export of PULSE (`updyn.io.pulse_mat`), or of some
    of its channels.
    """
    stored = _variables(path)
    if values is None and is_pulse(stored):
        refuse_without_values(order=order, time=time, rate=rate)
        return build_pulse_records(stored, path, channels)
    return build_records(
        stored,
        path,
        values=values,
        channels=channels,
        order=order,
        time=time,
        rate=rate,
    )


def read_source(path: str | Path) -> VariableSource:
    """Return the usable variables of a file, or the fields of a single struct."""
    return VariableSource(_select_usable(_unwrap_struct(_variables(path), path))[0], path)


def read_coherence(path: str | Path) -> Functions:
    """Read the coherence in an export of Simcenter Testlab (`updyn.io.testlab_mat`)."""
    return read_exported_coherence(_variables(path), path)


@contextmanager
def _iterate_usable(
    variables: Mapping[str, object], path: str | Path, items: Collection[str]
) -> Iterator[Mapping[str, object]]:
    """Yield the usable variables of a file in which they have the names of the items."""
    # Unusable variables with other names are reported in a warning after the block; if the block
    # fails, they are reported as the likely reason.
    found, unread = _select_usable(_unwrap_struct(variables, path))
    for name, reason in unread.items():
        if name.partition(".")[0] in items:
            raise FormatError(reason, path)
    try:
        yield found
    except FormatError as error:
        for reason in unread.values():
            raise FormatError(reason, path) from error
        raise
    if unread:
        warnings.warn(
            f"{path}: variables that cannot be read: {'; '.join(unread.values())}",
            UpdynWarning,
            stacklevel=5,
        )


def _select_usable(
    items: Mapping[str, object], before: str = ""
) -> tuple[dict[str, object], dict[str, str]]:
    """Return the usable items, and the reasons for the others by dotted name."""
    found: dict[str, object] = {}
    unread: dict[str, str] = {}
    for name, item in items.items():
        if isinstance(item, Unread):
            unread[before + name] = item.reason
        elif isinstance(item, Mapping):
            found[name], within = _select_usable(item, f"{before}{name}.")
            unread |= within
        else:
            found[name] = item
    return found, unread


def _unwrap_struct(variables: Mapping[str, object], path: str | Path) -> Mapping[str, object]:
    """Return the variables, or the fields of a single struct."""
    if not variables:
        raise FormatError("holds no variable", path)
    if len(variables) == 1 and "groups" not in variables:
        (only,) = variables.values()
        if isinstance(only, Mapping):
            return only
    return variables


def write_model(model: Model, path: str | Path) -> None:
    """Write a model as a version 5 file, with sparse matrices of at most 2 GB."""
    items = model_items(model)
    groups: dict[str, Any] = {}
    for number, (name, parts) in enumerate(items["groups"].items(), 1):
        is_field = _FIELD.fullmatch(name) and not re.fullmatch(r"group_\d+", name)
        if is_field:
            groups[name] = parts
        else:
            groups[f"group_{number}"] = {**parts, "name": name}
    _save({**items, "groups": groups}, path, last="groups")


def write_frf(frf: FRF, path: str | Path) -> None:
    """Write FRFs as a version 5 file, with arrays of at most 2 GB."""
    _save(frf_items(frf), path, last="quantity")


def _save(items: Mapping[str, object], path: str | Path, last: str) -> None:
    from scipy.io import savemat
    from scipy.io.matlab import MatWriteError

    # The format has no end mark. An indispensable item at the end detects a truncated file.
    ordered = {name: value for name, value in items.items() if name != last}
    ordered[last] = items[last]
    try:
        with atomic_path(path) as temporary:
            savemat(
                temporary,
                _to_storable(ordered),
                appendmat=False,
                do_compression=True,
                long_field_names=True,
                oned_as="column",
            )
    except MatWriteError as error:
        raise FormatError(
            f"a .mat file of version 5 cannot hold this ({error}); write HDF5 (.h5) instead", path
        ) from error


def _to_storable(items: Mapping[str, object]) -> dict[str, object]:
    out: dict[str, object] = {}
    for name, value in items.items():
        if isinstance(value, Mapping):
            out[name] = _to_storable(value)
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


def read_variables(path: str | Path) -> dict[str, object]:
    """Read all variables by name, as ndarray (axes as in MATLAB), sparse array, list or dict."""
    variables = _variables(path)
    refuse_export(variables, path, "matrices")
    found, unread = _select_usable(variables)
    for reason in unread.values():
        raise FormatError(reason, path)
    return found


def _variables(path: str | Path) -> dict[str, object]:
    """Return all variables, with unusable ones as `Unread`."""
    found = box.load("updyn.foreign.matlab:load", path, what="MATLAB file", reader=_READER)
    return {name: _check_sparse(value, name, path) for name, value in found.items()}


def _check_sparse(value: object, name: str, path: str | Path) -> object:
    if isinstance(value, Sparse):
        parts = (value.data, value.indices, value.indptr)
        return build_sparse(sp.csc_array, *parts, value.shape, name, path)
    if isinstance(value, Mapping):
        return {key: _check_sparse(item, f"{name}.{key}", path) for key, item in value.items()}
    if isinstance(value, list):
        return [_check_sparse(item, f"{name}({i})", path) for i, item in enumerate(value, 1)]
    return value
