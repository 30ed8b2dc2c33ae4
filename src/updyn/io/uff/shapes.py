"""Write mode shapes and operating shapes as universal files: datasets 55 or 2414, with a geometry.

Layouts: SDRC, universal file format; conventions are in docs/formats.md. Both datasets are "data at
nodes" in global directions, with six digits.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from updyn.arrays import NumberArray
from updyn.dofs import DofSet
from updyn.errors import FormatError, OptionError, UpdynWarning
from updyn.geometry import Geometry
from updyn.io.atomic import atomic_path
from updyn.io.uff.modes import FIRST_ORDER, NORMAL, UNCERTAIN
from updyn.io.uff.writing import (
    MOTIONS,
    SI_UNITS,
    check_nodes,
    geometry_chunks,
    text_dataset,
    whole_row,
)
from updyn.modal import ModeSet
from updyn.modal.shapes import Shapes, make_shapes

__all__ = ["write_modes", "write_shapes"]

_DATASETS = (55, 2414)
_FREQUENCY_RESPONSE = 5
_DISPLACEMENT = 8
_REAL, _COMPLEX = 2, 5


@dataclass(frozen=True, slots=True, eq=False)
class _Columns:
    """Shapes in global directions, with the quantity and reference of operating shapes."""

    modes: ModeSet
    dofs: DofSet
    values: NumberArray
    quantity: str = ""
    reference: str = ""


def write_modes(
    modes: ModeSet, path: str | Path, *, geometry: Geometry | None = None, dataset: int = 55
) -> None:
    """Write modes as datasets 55 or 2414 of a universal file.

    They are written as normal modes if all shapes are real, else as complex modes. The format keeps
    six digits. Shapes refer to positive senses: 5:-Z is written as 5:Z with the opposite sign. With
    a geometry, local directions are written as global ones.
    """
    if not modes.has_shapes:
        raise FormatError(
            "a universal file requires mode shapes, and these modes have none; write a table"
            " (.csv)",
            path,
        )
    if geometry is not None:
        write_shapes(make_shapes(modes, geometry), path, dataset=dataset)
        return
    dofs = DofSet.from_arrays(modes.dofs.nodes, modes.dofs.axes)
    _write(_Columns(modes, dofs, modes.shapes * modes.dofs.signs[:, None]), None, path, dataset)


def write_shapes(shapes: Shapes, path: str | Path, *, dataset: int = 55) -> None:
    """Write mode shapes or operating shapes with their geometry."""
    dofs, values = shapes.in_global_axes()
    columns = _Columns(shapes.modes, dofs, values, shapes.quantity, shapes.reference)
    _write(columns, shapes.geometry, path, dataset)


def _write(columns: _Columns, geometry: Geometry | None, path: str | Path, dataset: int) -> None:
    if dataset not in _DATASETS:
        raise OptionError(f"dataset {dataset!r}: expected 55 or 2414", key=("dataset",))
    check_nodes(list(columns.dofs), geometry, path)
    if columns.modes.cov_frequency is not None:
        warnings.warn(
            f"{path}: the covariance of the frequencies is not written; a universal file"
            " cannot store it",
            UpdynWarning,
            stacklevel=4,
        )
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write(text_dataset(164, SI_UNITS))
        if geometry is not None:
            file.writelines(geometry_chunks(geometry, path))
        for number in range(len(columns.modes)):
            file.write(text_dataset(dataset, list(_shape_lines(columns, number, dataset))))
            deviations = _deviation_lines(columns, number, path)
            if deviations:
                file.write(text_dataset(55, deviations))


# -- datasets -----------------------------------------------------------------------------------
def _shape_lines(columns: _Columns, number: int, dataset: int) -> Iterator[str]:
    modes = columns.modes
    real = not columns.quantity and not modes.shapes.imag.any()
    width, characteristic = _width(columns.dofs)
    kind, motion = (_REAL if real else _COMPLEX), _DISPLACEMENT
    analysis = NORMAL if real else FIRST_ORDER
    if columns.quantity:
        analysis, motion = _FREQUENCY_RESPONSE, MOTIONS[columns.quantity][0]
    about = whole_row(1, analysis, characteristic, motion, kind, width)
    names = _names(columns, number)
    if dataset == 55:
        yield from (*names, about, *_parameters_of_55(modes, number, analysis))
    else:
        yield from (f"{number + 1:10d}", names[-1], f"{1:10d}", *names, about)
        place = (0, number + 1) if columns.quantity else (number + 1, 0)
        yield whole_row(1, 0, 1, 0, 1, place[0], 0, place[1])
        yield whole_row(0, 0)
        yield from _parameters_of_2414(modes, number, analysis)
    shape = columns.values[:, number]
    yield from _at_nodes(columns.dofs, shape.real if real else shape, width)


def _names(columns: _Columns, number: int) -> list[str]:
    """Return the five identification lines."""
    modes = columns.modes
    f = float(modes.frequency[number])
    if columns.quantity:
        title = f"Frequency {f:13.5E} reference {columns.reference}"
        return [f"Operating shape, {columns.quantity}", "NONE", "NONE", "NONE", title]
    std = float(modes.std_frequency[number]), float(modes.std_loss_factor[number])
    quality = float(modes.quality[number])
    return [
        "Mode shape",
        "NONE",
        f"standard deviations {std[0]:.6g} Hz, {std[1]:.6g}" if np.isfinite(std).all() else "NONE",
        "NONE" if np.isnan(quality) else f"quality {quality:.6g}",
        _mode_title(modes, number),
    ]


def _mode_title(modes: ModeSet, number: int) -> str:
    return f"Mode {number + 1:10d} Frequency {float(modes.frequency[number]):13.5E}"


def _parameters_of_55(modes: ModeSet, number: int, analysis: int) -> tuple[str, str]:
    f, loss, scaled = _properties(modes, number)
    if analysis == _FREQUENCY_RESPONSE:
        return whole_row(2, 1, 1, number + 1), _row([f])
    if analysis == NORMAL:
        return whole_row(2, 4, 1, number + 1), _row([f, scaled, 0.0, loss])
    s = _eigenvalue(f, loss)
    a = 2.0 * s.imag * scaled
    return whole_row(2, 6, 1, number + 1), _row([s.real, s.imag, 0.0, a, 0.0, 0.0])


def _parameters_of_2414(modes: ModeSet, number: int, analysis: int) -> tuple[str, str]:
    f, loss, scaled = _properties(modes, number)
    if analysis == _FREQUENCY_RESPONSE:
        return _row([0.0, f, 0.0, 0.0, 0.0, 0.0]), _row([0.0] * 6)
    if analysis == NORMAL:
        square = (2.0 * np.pi * f) ** 2
        return _row([0.0, f, square, scaled, 0.0, loss]), _row([0.0] * 6)
    s = _eigenvalue(f, loss)
    a = 2.0 * s.imag * scaled
    return _row([0.0, f, 0.0, 0.0, 0.0, 0.0]), _row([s.real, s.imag, 0.0, a, 0.0, 0.0])


def _properties(modes: ModeSet, number: int) -> tuple[float, float, float]:
    """Return frequency, loss factor (0 if unknown), and modal mass (0 if the scale is unknown)."""
    loss = float(modes.loss_factor[number])
    scaled = float(modes.scaled[number])
    return float(modes.frequency[number]), 0.0 if np.isnan(loss) else loss, scaled


def _eigenvalue(f: float, loss: float) -> complex:
    omega = 2.0 * np.pi * f
    return complex(-0.5 * loss * omega, omega * np.sqrt(max(1.0 - (0.5 * loss) ** 2, 0.0)))


def _deviation_lines(columns: _Columns, number: int, path: str | Path) -> list[str]:
    """Return the lines of the dataset with standard deviations of a shape; empty if unknown."""
    modes = columns.modes
    if modes.std_shapes is None or np.isnan(modes.std_shapes[:, number]).any():
        return []
    if len(columns.dofs) != len(modes.dofs):
        warnings.warn(
            f"{path}: standard deviations of mode {number + 1} are along local directions;"
            " written without",
            UpdynWarning,
            stacklevel=5,
        )
        return []
    width, characteristic = _width(columns.dofs)
    return [
        *(UNCERTAIN, "NONE", "NONE", "NONE", _mode_title(modes, number)),
        whole_row(1, 0, characteristic, _DISPLACEMENT, _REAL, width),
        whole_row(1, 1, 1),
        _row([0.0]),
        *_at_nodes(columns.dofs, modes.std_shapes[:, number], width),
    ]


def _width(dofs: DofSet) -> tuple[int, int]:
    """Return the number of values per node, and its code."""
    return (6, 3) if (dofs.axes >= 3).any() else (3, 2)


def _at_nodes(dofs: DofSet, values: NumberArray, width: int) -> Iterator[str]:
    nodes, place = np.unique(dofs.nodes, return_inverse=True)
    first = np.sort(np.unique(dofs.nodes, return_index=True)[1])
    table = np.zeros((len(nodes), width), dtype=values.dtype)
    table[place, dofs.axes] = values
    for at in place[first].tolist():  # in the order of the DOFs
        yield f"{nodes[at]:10d}"
        flat = table[at].view(np.float64)
        for start in range(0, len(flat), 6):
            yield _row(flat[start : start + 6].tolist())


def _row(values: Sequence[float]) -> str:
    return "".join(f"{value:13.5E}" for value in values)
