"""The native model file: one HDF5 file per model, exact to the last bit.

Layout (``*``: optional)::

    /                      attributes updyn_kind = "model", updyn_format = 1 (2: with the damping
                           below), updyn_version, title
    /dofs/node             int64 (N,)         node numbers
    /dofs/direction        text (N,)          X Y Z RX RY RZ
    /geometry *            node int64 (n,), xyz float64 (n, 3) in m, line int64 (m, 2),
                           axes * float64 (n, 3, 3), face * int64 (k, 4)
    /groups/0000 ...       in order; attributes name, loss_factor, mass_damping *,
                           stiffness_damping *
        loss_table *       freq float64 (n,) in Hz, relative float64 (n,)
        members *          of a merged group: name S (m,), and for stiffness, mass and viscous
                           uint8 (m,), 1 if the original group has the matrix
        stiffness *        upper triangle with the diagonal in CSR form: data, indices, indptr;
                           attribute size = N
        mass *
        viscous *

Groups are numbered, because their names may contain characters that HDF5 reserves.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from updyn.arrays import NumberArray
from updyn.dofs import DIRECTIONS, DofSet
from updyn.errors import AbsentError, FormatError, InputError, suggest
from updyn.foreign.plain import Other
from updyn.geometry import Geometry
from updyn.group import MATRICES, VALUES, Group, LossTable, Matrix
from updyn.grouping import GroupOrigin
from updyn.io.attributes import PACKING, read_unit
from updyn.io.items import build_sparse, check_names, locate_errors
from updyn.io.native import load_native, write_native
from updyn.io.settings import MATRIX_FILE
from updyn.model import Model
from updyn.nonlinear.element import NonlinearElement
from updyn.nonlinear.local import Place
from updyn.nonlinear.records import build_element, describe_element

if TYPE_CHECKING:
    import h5py

__all__ = [
    "Folder",
    "check_kind",
    "put_geometry",
    "put_kind",
    "put_model",
    "read_model",
    "take_array",
    "take_attribute",
    "take_geometry",
    "take_model",
    "take_number",
    "take_text",
    "write_model",
]

FORMAT_VERSION = 1
_DAMPED_VERSION = 2  # for groups with content that a reader of version 1 would ignore
_READERS = {
    "model": "read_model",
    "frf": "read_frf",
    "modes": "read_modes",
    "result": "read_result",
    "uncertainty": "read_uncertainty",
}
#: Units that arrays of a model may state, all SI.
_SI = ("m", "N/m", "kg", "N s/m", "Hz")
_LIBVER = (
    "v108",
    "v110",
)  # metadata have checksums from 1.8 on; any HDF5 since 2016 reads it


def write_model(model: Model, path: str | Path) -> None:
    """Write a model to an HDF5 file; an existing file is replaced once the new one is complete."""
    import h5py

    content = io.BytesIO()
    with h5py.File(content, "w", libver=_LIBVER) as file:
        put_kind(file, "model")
        put_model(file, model)
    write_native(content, path)


def read_model(path: str | Path) -> Model:
    """Read a model from an HDF5 file written by `write_model`."""
    found = load_native("updyn.foreign.hdf5:load", path, what="HDF5 file")
    root = Folder.of("/", found)
    check_kind(root, path, "model")
    return take_model(root, path)


@dataclass(frozen=True, slots=True)
class Folder:
    """A loaded group of an HDF5 file, with attributes that define its numbers in `meanings`."""

    name: str
    attributes: Mapping[str, Any]
    members: Mapping[str, Any]
    meanings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @classmethod
    def of(cls, name: str, found: Mapping[str, Any]) -> Folder:
        """Return a group loaded by `updyn.foreign.hdf5` as a folder with its full name."""
        members = {}
        for key, item in found["members"].items():
            is_group = isinstance(item, Mapping)
            members[key] = cls.of(f"{name.rstrip('/')}/{key}", item) if is_group else item
        return cls(name, found["attributes"], members, found["meanings"])


# -- identification of HDF5 files of updyn ------------------------------------------------------
def put_kind(file: h5py.File, kind: str) -> None:
    """Write the attributes that identify the kind of file."""
    from updyn import __version__

    _put_text(file, "updyn_kind", kind)
    file.attrs["updyn_format"] = FORMAT_VERSION
    _put_text(file, "updyn_version", __version__)


def check_kind(root: Folder, path: str | Path, expected: str) -> None:
    """Refuse a file of another kind; the message gives the right reader."""
    if "updyn_kind" not in root.attributes:
        held = ", ".join(sorted(root.members)[:8]) or "nothing"
        raise AbsentError(
            "HDF5 file without the attribute 'updyn_kind': it was not written by updyn as a"
            f" {expected}. It holds: {held}; expected for a model: 'dofs' and 'groups', see"
            " updyn.io.hdf5",
            path,
        )
    kind = take_text(root, "updyn_kind", path)
    if kind != expected:
        right = (
            f"read it with updyn.{_READERS[kind]}" if kind in _READERS else suggest(kind, _READERS)
        )
        raise AbsentError(f"holds updyn_kind {kind!r}, expected {expected!r}; {right}", path)
    version = take_number(root, "updyn_format", path)
    if version not in (FORMAT_VERSION, _DAMPED_VERSION):
        writer = (
            take_text(root, "updyn_version", path)
            if "updyn_version" in root.attributes
            else "(unknown)"
        )
        raise FormatError(
            f"format version {version:g}, written by updyn {writer}; this updyn reads versions"
            f" {FORMAT_VERSION} and {_DAMPED_VERSION}",
            path,
        )


# -- model --------------------------------------------------------------------------------------
def put_model(parent: h5py.Group, model: Model, stored: dict[int, object] | None = None) -> None:
    """Write a model into an HDF5 group; matrices in `stored` (by identity) become links."""
    stored = {} if stored is None else stored
    _put_text(parent, "title", model.title)
    dofs = parent.create_group("dofs")
    _put_array(dofs, "node", model.dofs.nodes)
    _put_array(dofs, "direction", np.array(DIRECTIONS, dtype="S2")[model.dofs.axes])
    if model.geometry is not None:
        put_geometry(parent.create_group("geometry"), model.geometry)
    if model.nonlinear:
        _put_nonlinear(parent.create_group("nonlinear"), model)
    groups = parent.create_group("groups")
    for number, (name, group) in enumerate(model.groups.items()):
        place = groups.create_group(f"{number:04d}")
        _put_text(place, "name", name)
        _put_members(place, group)
        _put_damping(place, group)
        for what in MATRICES:
            matrix = getattr(group, what)
            if matrix is None:
                continue
            if id(matrix) in stored:
                place[what] = stored[id(matrix)]
            else:
                stored[id(matrix)] = _put_matrix(place.create_group(what), matrix)


def _put_nonlinear(place: h5py.Group, model: Model) -> None:
    """Write nonlinear elements as JSON texts, by number."""
    for number, (name, local) in enumerate(model.nonlinear.items()):
        record = {"name": name, "weights": dict(local.weights), **describe_element(local.element)}
        _put_text(place, f"{number:04d}", json.dumps(record))


def _take_nonlinear(place: Folder, path: str | Path) -> dict[str, tuple[NonlinearElement, Place]]:
    """Return the nonlinear elements by name, with their degrees of freedom."""
    out: dict[str, tuple[NonlinearElement, Place]] = {}
    for number in sorted(place.attributes):
        text = take_text(place, number, path)
        try:
            record = json.loads(text)
            name, weights, kind = (record.pop(key) for key in ("name", "weights", "kind"))
        except (ValueError, KeyError, AttributeError, TypeError) as error:
            raise FormatError(f"{place.name}: {text!r} is not a nonlinear element", path) from error
        with locate_errors(path):
            out[str(name)] = build_element(str(kind), record), weights
    return out


def _put_members(place: h5py.Group, group: Group) -> None:
    """Write the original groups of a merged group, and which matrices they have."""
    members = group.origin.members
    if not members:
        return
    table = place.create_group("members")
    _put_array(table, "name", np.array([name.encode() for name in members]))
    for what in MATRICES:
        has = [what in matrices for matrices in members.values()]
        _put_array(table, what, np.array(has, dtype=np.uint8))


def _take_origin(place: Folder, path: str | Path) -> GroupOrigin:
    if "members" not in place.members:
        return GroupOrigin()
    table = _group(place, "members", path)
    names = take_array(table, "name", path, "SO", 1)
    has = {what: take_array(table, what, path, "iu", 1) for what in MATRICES}
    if any(len(flags) != len(names) for flags in has.values()):
        raise FormatError(f"{table.name}: its arrays differ in length", path)
    members: dict[str, tuple[str, ...]] = {}
    for i, raw in enumerate(names):
        name = raw.decode("utf-8", "replace") if isinstance(raw, bytes) else str(raw)
        members[name] = tuple(what for what in MATRICES if has[what][i])
    return GroupOrigin(members=members)


def _put_damping(place: h5py.Group, group: Group) -> None:
    damping = group.damping
    for name in damping.keys() & VALUES.keys():
        place.attrs[name] = damping[name]
    if group.loss_table is not None:
        table = place.create_group("loss_table")
        _put_array(table, "freq", group.loss_table.freq)
        _put_array(table, "relative", group.loss_table.relative)
    if len(damping) > 1:
        place.file.attrs["updyn_format"] = _DAMPED_VERSION


def _take_damping(place: Folder, path: str | Path) -> dict[str, Any]:
    out: dict[str, Any] = {"loss_factor": take_number(place, "loss_factor", path)}
    out |= {name: take_number(place, name, path) for name in VALUES if name in place.attributes}
    if "loss_table" in place.members:
        table = _group(place, "loss_table", path)
        with locate_errors(path, table.name):
            out["loss_table"] = LossTable(
                *(take_array(table, name, path, "iuf", 1) for name in ("freq", "relative"))
            )
    return out


def take_model(parent: Folder, path: str | Path) -> Model:
    """Read a model from a group written by `put_model`."""
    check_names(parent.members, ("dofs", "groups", "geometry", "nonlinear"), path, parent.name)
    dofs = take_dofs(_group(parent, "dofs", path), path)
    place = _group(parent, "groups", path)
    numbered = sorted(place.members, key=lambda n: (len(n), n))
    if not numbered:
        raise FormatError(f"{place.name}: holds no group; a model needs at least one", path)
    groups: dict[str, Group] = {}
    for number in numbered:
        item = _group(place, number, path)
        name = take_text(item, "name", path)
        if name in groups:
            raise FormatError(f"{item.name}: group name {name!r} occurs twice", path)
        groups[name] = _take_group(item, path, name)
    geometry = (
        take_geometry(_group(parent, "geometry", path), path)
        if "geometry" in parent.members
        else None
    )
    title = take_text(parent, "title", path) if "title" in parent.attributes else ""
    with locate_errors(path):
        model = Model.from_groups(groups, dofs, geometry=geometry, title=title)
        if "nonlinear" in parent.members:
            place = _group(parent, "nonlinear", path)
            model = model.with_elements(_take_nonlinear(place, path))
        return model


def _take_group(place: Folder, path: str | Path, name: str) -> Group:
    check_names(place.members, (*MATRICES, "loss_table", "members"), path, place.name)
    matrices = {
        what: _take_matrix(_group(place, what, path), path)
        for what in MATRICES
        if what in place.members
    }
    damping = _take_damping(place, path)
    with locate_errors(path, f"group {name!r}"):
        return Group(**matrices, **damping).with_origin(_take_origin(place, path))


def take_dofs(place: Folder, path: str | Path) -> DofSet:
    """Read DOFs from their nodes and directions."""
    nodes = take_array(place, "node", path, "iu", 1)
    texts = take_array(place, "direction", path, "SO", 1)
    axes = np.full(len(texts), -1)
    for i, direction in enumerate(DIRECTIONS):
        axes[texts == (direction.encode() if texts.dtype.kind == "S" else direction)] = i
    if (axes < 0).any():
        at = int(np.flatnonzero(axes < 0)[0])
        found = texts[at]
        found = (found.decode("utf-8", "replace") if isinstance(found, bytes) else str(found))[:20]
        raise FormatError(
            f"{place.name}: direction {at + 1} is {found!r}; {suggest(found, DIRECTIONS)}", path
        )
    with locate_errors(path, place.name):
        return DofSet.from_arrays(nodes, axes)


def _put_matrix(place: h5py.Group, matrix: Matrix) -> object:
    row = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    upper = matrix.indices >= row  # a mask keeps explicit zeros, which scipy.sparse.triu would drop
    indptr = np.concatenate([[0], np.cumsum(np.bincount(row[upper], minlength=matrix.shape[0]))])
    place.attrs["size"] = matrix.shape[0]
    _put_text(place, "storage", "upper triangle with diagonal, CSR")
    _put_array(place, "data", matrix.data[upper])
    _put_array(place, "indices", matrix.indices[upper])
    _put_array(place, "indptr", indptr.astype(matrix.indptr.dtype))
    return place


def _take_matrix(place: Folder, path: str | Path) -> Matrix:
    size = int(take_number(place, "size", path))
    data = take_array(place, "data", path, "iuf", 1)
    indices = take_array(place, "indices", path, "iu", 1)
    indptr = take_array(place, "indptr", path, "iu", 1)
    upper = build_sparse(sp.csr_array, data, indices, indptr, (size, size), place.name, path)
    row = np.repeat(np.arange(size, dtype=upper.indices.dtype), np.diff(upper.indptr))
    column = upper.indices
    below = np.flatnonzero(column < row)
    if below.size:
        at = int(below[0])
        raise FormatError(
            f"{place.name}: entry ({row[at] + 1}, {column[at] + 1}) is below the diagonal;"
            " expected only the upper triangle",
            path,
        )
    off = column > row
    full = sp.coo_array(
        (
            np.concatenate([upper.data, upper.data[off]]),
            (np.concatenate([row, column[off]]), np.concatenate([column, row[off]])),
        ),
        shape=(size, size),
    )
    return full.tocsr()


# -- geometry -----------------------------------------------------------------------------------
def put_geometry(place: object, geometry: Geometry) -> None:
    """Write node positions into an HDF5 group."""
    _put_array(place, "node", geometry.nodes)
    _put_array(place, "xyz", geometry.xyz)
    _put_array(place, "line", geometry.lines)
    if geometry.axes is not None:
        _put_array(place, "axes", geometry.axes)
    if len(geometry.faces):
        _put_array(place, "face", geometry.faces)


def take_geometry(place: Folder, path: str | Path) -> Geometry:
    """Read node positions from a group; refuse missing, unknown or invalid arrays."""
    check_names(place.members, ("node", "xyz", "line", "axes", "face"), path, place.name)
    nodes = take_array(place, "node", path, "iu", 1)
    xyz = take_array(place, "xyz", path, "iuf", 2)
    lines = (
        take_array(place, "line", path, "iu", 2)
        if "line" in place.members
        else np.empty((0, 2), dtype=np.int64)
    )
    axes = take_array(place, "axes", path, "iuf", 3) if "axes" in place.members else None
    if lines.shape[1] != 2:
        raise FormatError(f"{place.name}: line has shape {lines.shape}; expected (m, 2)", path)
    faces = take_array(place, "face", path, "iu", 2) if "face" in place.members else None
    with locate_errors(path, place.name):
        return Geometry(nodes, xyz, lines, axes, faces)


# -- items --------------------------------------------------------------------------------------
def _put_array(place: h5py.Group, name: str, array: NumberArray) -> None:
    big = array.size >= MATRIX_FILE.compressed_entries
    packed = (
        {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}
        if big
        else {}
    )
    place.create_dataset(name, data=array, **packed)


def _put_text(place: h5py.Group, name: str, text: str) -> None:
    """Write a text of fixed length, because the heap of variable-length texts has no checksum."""
    if "\0" in text:
        raise InputError(f"{name} {text!r} contains a NUL character, which HDF5 cannot store")
    import h5py

    raw = text.encode("utf-8")
    kind = h5py.string_dtype("utf-8", max(len(raw), 1))
    place.attrs.create(name, np.array(raw, dtype=kind), dtype=kind)


def _group(parent: Folder, name: str, path: str | Path) -> Folder:
    found = parent.members.get(name)
    if not isinstance(found, Folder):
        state = f"no group {name!r}" if found is None else f"{name!r} is not a group"
        raise FormatError(
            f"{parent.name}: {state}; found: {', '.join(parent.members) or 'nothing'}", path
        )
    return found


def take_array(parent: Folder, name: str, path: str | Path, kinds: str, n_dims: int) -> NumberArray:
    """Return a dataset, checked for its kind of numbers and number of dimensions."""
    found = parent.members.get(name)
    if not isinstance(found, np.ndarray | Other):
        raise FormatError(
            f"{parent.name}: no dataset {name!r}; {suggest(name, parent.members)}", path
        )
    place = f"{parent.name.rstrip('/')}/{name}"
    if isinstance(found, Other) or found.dtype.kind not in kinds:
        kind = found.kind if isinstance(found, Other) else found.dtype
        is_complex = isinstance(found, np.ndarray) and found.dtype.kind == "c"
        hint = "; give damping as loss_factor or viscous" if is_complex else ""
        raise FormatError(f"{place}: holds {kind}, expected another type of number{hint}", path)
    if found.ndim != n_dims:
        raise FormatError(f"{place}: has shape {found.shape}, expected {n_dims} dimension(s)", path)
    _check_meaning(parent.meanings.get(name, {}), place, path)
    return found


def _check_meaning(meaning: Mapping[str, object], place: str, path: str | Path) -> None:
    """Refuse an array whose attributes state packed numbers or units other than SI."""
    for name in PACKING:
        if name in meaning:
            raise FormatError(
                f"{place}: attribute {name!r}; expected plain numbers without it", path
            )
    unit = read_unit(meaning, place, path)
    if unit and unit not in _SI:
        raise FormatError(
            f"{place}: attribute 'units' is {unit!r}; expected SI: {', '.join(_SI)}", path
        )


def take_attribute(place: Folder, name: str, path: str | Path) -> object:
    """Return an attribute; raise a FormatError if it is missing."""
    if name not in place.attributes:
        raise FormatError(
            f"{place.name}: no attribute {name!r}; {suggest(name, place.attributes)}", path
        )
    return place.attributes[name]


def take_text(place: Folder, name: str, path: str | Path) -> str:
    """Return an attribute that must be a text."""
    value = take_attribute(place, name, path)
    if not isinstance(value, str):
        raise FormatError(f"{place.name}: attribute {name!r} is {value!r}, expected a text", path)
    return value


def take_number(place: Folder, name: str, path: str | Path) -> float:
    """Return an attribute that must be one number."""
    value = np.asarray(take_attribute(place, name, path))
    if value.size != 1 or value.dtype.kind not in "iuf":
        raise FormatError(
            f"{place.name}: attribute {name!r} is {value.tolist()!r}, expected one number", path
        )
    return float(value.reshape(())[()])
