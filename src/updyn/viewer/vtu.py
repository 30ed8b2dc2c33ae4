"""Shapes and changes of groups as VTK unstructured grid (VTU), for ParaView.

Layout: VTK file formats, XML, unstructured grid with inline binary data (base64, 64-bit lengths).
"""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from updyn.arrays import RealArray
from updyn.errors import OptionError
from updyn.group import VALUES
from updyn.io.atomic import write_bytes
from updyn.modal.shapes import Shapes
from updyn.model import Model
from updyn.updating.result import UpdateResult
from updyn.viewer.motion import Motion, deviations_of, motion_of, rotations_of
from updyn.viewer.scene import Body

__all__ = ["group_changes", "write_shapes"]

#: Types of VTK: name by kind and size of an array, and codes of cells.
_TYPES = {"f8": "Float64", "i8": "Int64", "u1": "UInt8"}
_VERTEX, _LINE, _TRIANGLE = 1, 3, 5


def write_shapes(shapes: Shapes, path: str | Path) -> None:
    """Write the structure with shapes as point data and changes of groups as cell data."""
    motion = motion_of(shapes)
    groups = motion.body.groups
    if isinstance(shapes.result, UpdateResult) and not groups:
        raise OptionError(
            "structure: changes of groups are drawn on the model, and these shapes are at sensors"
            " only; give shapes of the whole model, such as updyn.modes(result.model, 6), or the"
            " model as structure",
            key=("structure",),
        )
    text = "\n".join(_lines(shapes, motion))
    write_bytes(path, text.encode("utf-8"))


def group_changes(result: UpdateResult) -> dict[str, RealArray]:
    """Return changes of the groups by quantity, each of shape (groups,).

    Factors on mass, stiffness and viscous damping, and values of other damping, for quantities with
    unknowns. The standard deviations follow from the covariance of the unknowns to first order
    (``... std``); they are nan for groups without such an unknown, and for undetermined ones.
    """
    names, at = list(result.start.groups), result.parameters.changes(list(result.values.values()))
    out: dict[str, RealArray] = {}
    for quantity in dict.fromkeys(q for change in at.values() for q in change):
        values = np.array([_start_value(result.start, name, quantity) for name in names])
        std = np.full(len(names), np.nan)
        for number, name in enumerate(names):
            if quantity in at.get(name, {}):
                values[number] = at[name][quantity]
                std[number] = _deviation(result, name, quantity, at[name][quantity])
        label = quantity.replace("_", " ") if quantity in VALUES else f"{quantity} factor"
        out[label], out[f"{label} std"] = values, std
    return out


def _start_value(model: Model, name: str, quantity: str) -> float:
    """Return the factor or value of a group without an unknown; nan for a loss table."""
    if quantity not in VALUES:
        return 1.0
    group = model.groups[name]
    if quantity == "loss_factor" and group.loss_table is not None:
        return float("nan")
    return float(getattr(group, quantity) or 0.0)


def _deviation(result: UpdateResult, name: str, quantity: str, value: float) -> float:
    """Return the standard deviation of a change; nan if it is not determined."""
    slope = np.zeros(len(result.parameters))
    for number, parameter in enumerate(result.parameters):
        for drive in () if parameter.is_channel else parameter.acts_on:
            if (drive.group, drive.quantity) == (name, quantity):
                x = result.values[parameter.name]
                slope[number] += 1.0 if quantity in VALUES else drive.power * value / x
    used = np.flatnonzero(slope)
    covariance = result.covariance[np.ix_(used, used)]
    if not np.isfinite(covariance).all():
        return float("nan")
    return math.sqrt(max(float(slope[used] @ covariance @ slope[used]), 0.0))


# -- XML -------------------------------------------------------------------------------------------
def _lines(shapes: Shapes, motion: Motion) -> Iterator[str]:
    body = motion.body
    cells = _cells(body)
    of_group = np.concatenate([group for _, _, group in cells])
    yield '<?xml version="1.0"?>'
    if body.groups:
        named = ", ".join(f"{number} {name}" for number, name in enumerate(body.groups))
        yield f"<!-- groups: {named.replace('--', '- -')} -->"
    yield (
        '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian"'
        ' header_type="UInt64">'
    )
    yield "<UnstructuredGrid>"
    n_cells = len(of_group)
    yield f'<Piece NumberOfPoints="{len(body.nodes)}" NumberOfCells="{n_cells}">'
    yield from ("<Points>", _array("xyz", body.xyz), "</Points>")
    sizes = np.concatenate([np.full(len(at), at.shape[1]) for _, at, _ in cells])
    kinds = np.concatenate([np.full(len(at), kind, np.uint8) for kind, at, _ in cells])
    yield "<Cells>"
    yield _array("connectivity", np.concatenate([at.ravel() for _, at, _ in cells]))
    yield _array("offsets", np.cumsum(sizes))
    yield from (_array("types", kinds), "</Cells>", "<PointData>")
    yield _array("node", body.nodes)
    yield from _point_data(shapes, motion)
    yield from ("</PointData>", "<CellData>")
    if body.groups:
        yield _array("group", of_group)
    if isinstance(shapes.result, UpdateResult):
        for name, values in group_changes(shapes.result).items():
            yield _array(name, np.append(values, np.nan)[of_group])
    yield from ("</CellData>", "</Piece>", "</UnstructuredGrid>", "</VTKFile>", "")


def _cells(body: Body) -> list[tuple[int, NDArray[np.intp], NDArray[np.intp]]]:
    """Return the type, the nodes and the group of cells; nodes without others are vertices."""
    used = np.concatenate([body.lines.ravel(), body.faces.ravel(), body.points])
    loose = np.setdiff1d(np.arange(len(body.nodes)), used)
    points = np.concatenate([body.points, loose])[:, None]
    point_group = np.concatenate([body.point_group, np.full(len(loose), -1)])
    return [
        (_VERTEX, points, point_group),
        (_LINE, body.lines, body.line_group),
        (_TRIANGLE, body.faces, body.face_group),
    ]


def _point_data(shapes: Shapes, motion: Motion) -> Iterator[str]:
    """Yield displacements, rotations if the shapes have any, and known standard deviations."""
    vectors: Mapping[str, NDArray[np.complex128]] = {"": motion.shapes}
    turned = rotations_of(shapes, motion.body)
    if turned.any():
        vectors = {"": motion.shapes, " rotation": turned}
    for what, of_shapes in vectors.items():
        for title, shape in zip(shapes.titles(), of_shapes, strict=True):
            yield _array(f"{title}{what} real", shape.real)
            if shape.imag.any():
                yield _array(f"{title}{what} imaginary", shape.imag)
    deviations = deviations_of(shapes, motion.body)
    if deviations is not None:
        for title, std in zip(shapes.titles(), deviations, strict=True):
            yield _array(f"{title} std", std)


def _array(name: str, values: NDArray[np.generic]) -> str:
    """Return a data array; vectors have three columns."""
    kind = "i8" if values.dtype.kind == "i" else values.dtype.str[1:]
    data = np.ascontiguousarray(values, dtype=f"<{kind}").tobytes()
    text = base64.b64encode(len(data).to_bytes(8, "little") + data).decode("ascii")
    columns = f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 else ""
    return (
        f'<DataArray type="{_TYPES[kind]}" Name="{html.escape(name)}"{columns}'
        f' format="binary">{text}</DataArray>'
    )
